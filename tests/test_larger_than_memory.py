"""A `Scene` that does not fit is in pieces by itself, says so, draws the same, and refuses what they cannot."""

import os
import subprocess
import sys
import warnings

import globule as gb
import numpy as np
import pytest
from cli_helpers import output_of, run_json
from globule._base import memory
from globule.cli import main, pieces
from globule.pieces import pieces as of_pieces
from globule.pieces import scene
from globule.scene import fitting

SIZE = (64, 48)
RNG = np.random.default_rng(1)
LATTICE = np.stack(np.meshgrid(*[np.arange(14)] * 3, indexing="ij"), -1).reshape(-1, 3)
POSITIONS = (LATTICE + RNG.uniform(-0.25, 0.25, LATTICE.shape)).astype(np.float32)
COLOR = RNG.random(POSITIONS.shape).astype(np.float32)
# Long enough for pieces apart, also with the wide halo of a smooth surface.
BAR = np.stack(np.meshgrid(np.arange(60), *[np.arange(6)] * 2, indexing="ij"), -1).reshape(-1, 3)
BAR = (BAR + RNG.uniform(-0.2, 0.2, BAR.shape)).astype(np.float32)
SPEED = np.linspace(0, 1, len(POSITIONS), dtype=np.float32)
CAMERA = gb.Camera.fit(POSITIONS, size=SIZE, margin=1)
CUT = gb.ClipPlane((1, 0.2, 0), 7.0)
LINE = r"^scene: 2,\d+ particles take about .* GB as one scene on .*: they are in \d+ pieces, .*$"


class Room:
    """Bytes that a scene may take, less than the octree, enough for pieces of a few hundred; readers may more."""

    size = 90_000.0

    def __call__(self, *_):
        return self.size


@pytest.fixture
def little(monkeypatch):
    room = Room()
    monkeypatch.setattr(of_pieces, "OVERHEAD", 0)
    monkeypatch.setattr(memory, "SMALL", 0)
    for module in (scene, of_pieces, pieces):
        monkeypatch.setattr(module, "resident_bytes", lambda: 0)
    for module in (of_pieces, fitting):
        monkeypatch.setattr(module, "room_on", room)
    for module in (scene, pieces):
        monkeypatch.setattr(module, "room", room)
    return room


def scenes(particles, **options):
    """One scene and one in pieces, of the same particles."""
    one = gb.Scene(particles, **options, level=10)  # stays one
    with pytest.warns(UserWarning, match=LINE):
        many = gb.Scene(particles, **options)
    assert type(one) is gb.Scene
    assert isinstance(many, scene.SceneInPieces)
    assert many.pieces.partition.n > 1
    assert len(many) == len(one)
    return one, many


def same(one, many):
    """0 pixels of hit or miss differ, colors by at most a level."""
    assert one.mask.mean() > 0.03
    np.testing.assert_array_equal(one.mask, many.mask)
    assert np.abs(one.image.astype(int) - many.image.astype(int)).max() <= 1


def test_the_image_of_one_scene(little, backend):
    one, many = scenes(gb.Particles(POSITIONS, color=COLOR), support=2.0, **backend)
    same(*(gb.render(s, CAMERA, SIZE, None, [CUT]) for s in (one, many)))
    assert many.threshold == one.threshold
    assert many.support == one.support
    for s in (one, many):
        s.threshold = 1.2
    same(*(gb.render(s, CAMERA, SIZE) for s in (one, many)))
    same(*(gb.render([s, gb.Layer(s, clips=[CUT])], CAMERA, SIZE) for s in (one, many)))


def test_colors_by_a_value(little, backend):
    one, many = scenes(gb.Particles(POSITIONS, attributes={"speed": SPEED}), support=2.0, **backend)
    for _ in "ab":
        same(*(gb.render(s, CAMERA, SIZE, color_by="speed") for s in (one, many)))
    assert many.builds == 2  # divided for the colors, once
    for s in (one, many):
        s.update(POSITIONS)
    same(*(gb.render(s, CAMERA, SIZE, color_by="x", range=[2, 9]) for s in (one, many)))
    with pytest.raises(ValueError, match=r"expected one of .*, got speed"):
        gb.render(many, CAMERA, SIZE, color_by="speed")
    same(*(gb.render(s, CAMERA, SIZE, color_by="x", range=[2, 9]) for s in (one, many)))


def test_updates(little, backend):
    one, many = scenes(gb.Particles(POSITIONS, color=COLOR), support=2.0, **backend)
    folder = many.pieces._files._folder.name
    moved = POSITIONS * np.float32(1.1)
    for s in (one, many):
        s.update(positions=moved)
    same(*(gb.render(s, CAMERA, SIZE) for s in (one, many)))
    assert not os.path.exists(folder)
    folder = many.pieces._files._folder.name
    with pytest.raises(TypeError, match=r"^update: unknown field 'place'"):
        many.update(place=1)
    with pytest.raises(ValueError, match=r"^positions: expected"):
        many.update(np.zeros((3, 5)))
    same(*(gb.render(s, CAMERA, SIZE) for s in (one, many)))  # as before the failed update
    del many, s
    assert not os.path.exists(folder)


@pytest.mark.parametrize("name", ["a.npy", "a.npz", "a.h5", "a.vtu", "a.bgeo", "a.vtk"])
def test_files(name, little, folder, monkeypatch):
    """What has ranges is never read whole; other files are read, and then divided."""
    if name == "a.npy":
        np.save(name, POSITIONS)
    elif name == "a.h5":
        h5py = pytest.importorskip("h5py")
        with h5py.File(name, "w") as file:
            file["positions"] = POSITIONS
    else:
        gb.write(name, gb.Particles(POSITIONS))
    with monkeypatch.context() as change:
        if name != "a.vtk":
            change.setattr("globule.formats.read_contents", lambda *_, **__: 1 / 0)
        with pytest.warns(UserWarning, match=LINE):
            many = gb.Scene(name, support=2.0, device="cpu")
    one = gb.Scene(POSITIONS, support=2.0, device="cpu", level=10)
    same(*(gb.render(s, CAMERA, SIZE) for s in (one, many)))
    if name != "a.vtk":
        with pytest.raises(ValueError, match=r"^update: expected particles or a file's name"):
            many.update(color=COLOR)
    many.update(name)
    same(*(gb.render(s, CAMERA, SIZE) for s in (one, many)))


def test_arrays_that_are_mapped_are_not_copied(little, tmp_path):
    np.save(tmp_path / "far.npy", POSITIONS.astype(np.float64))
    mapped = np.load(tmp_path / "far.npy", mmap_mode="r")
    one, many = scenes(mapped, support=2.0, device="cpu")
    assert many._given is mapped
    same(*(gb.render(s, CAMERA, SIZE) for s in (one, many)))
    many.update(positions=POSITIONS * np.float32(1.1))
    one.update(positions=POSITIONS * np.float32(1.1))
    same(*(gb.render(s, CAMERA, SIZE) for s in (one, many)))


@pytest.mark.slow
def test_render_of_what_is_no_scene_yet(little, tmp_path):
    little.size = 160_000
    path, camera = str(tmp_path / "a.npz"), gb.Camera.fit(BAR, size=SIZE, margin=1)
    gb.write(path, gb.Particles(BAR, attributes={"speed": SPEED[: len(BAR)]}))
    with pytest.warns(UserWarning, match=LINE):
        drawn = gb.render(path, camera, SIZE)
    with pytest.warns(UserWarning, match=LINE):
        colored = gb.render(gb.read(path), camera, SIZE, color_by="speed")
    little.size = 1e9
    for many, by in ((drawn, None), (colored, "speed")):
        one = gb.render(path, camera, SIZE, color_by=by)
        assert one.mask.mean() > 0.03
        assert (one.mask == many.mask).mean() > 0.99  # the spacing is measured elsewhere
        seen = one.mask & many.mask
        assert np.abs(one.image.astype(int) - many.image)[seen].mean() < 3


def test_what_pieces_cannot_do(little):
    _, many = scenes(gb.Particles(POSITIONS), support=2.0, device="cpu")
    line = r"^scene: expected particles in one scene, got pieces, .* 2,744 particles take .*part"
    for question in (
        lambda: many.field(POSITIONS[:1]),
        lambda: many.gradient(POSITIONS[:1]),
        lambda: many.intersect(POSITIONS[:1], [[0, 0, 1]]),
        lambda: many.neighbors(POSITIONS[:1], 1.0),
        lambda: many.blend(POSITIONS[:1], SPEED),
        lambda: many.integrate(POSITIONS[:1], [[0, 0, 1]], SPEED),
        lambda: many.octree.n_nodes,
        lambda: many.particles,
        lambda: many.become("smooth"),
        lambda: gb.measure.mesh_surface(many),
        lambda: gb.measure.measure_surface(many),
        lambda: gb.measure.project(many, CAMERA),
        lambda: gb.Scene(many),
    ):
        with pytest.raises(ValueError, match=line):
            question()
    frame = gb.render(many, CAMERA, SIZE)
    with pytest.raises(ValueError, match=r"^pick: expected one scene, got pieces; "):
        frame.pick(10, 10)
    with pytest.raises(ValueError, match=r"^annotate: expected None with a scene in pieces: 2,744"):
        gb.render(many, CAMERA, SIZE, annotate=gb.Annotation())
    with pytest.raises(ValueError, match=r"^comm: expected None with a scene in pieces"):
        gb.render(many, CAMERA, SIZE, comm=1)


def test_a_camera_that_fits(little):
    _, many = scenes(gb.Particles(POSITIONS), support=2.0, device="cpu")
    low, high = many.bounds()
    np.testing.assert_array_equal([low, high], [POSITIONS.min(0), POSITIONS.max(0)])
    corners = np.array(np.meshgrid(*zip(low, high, strict=True))).reshape(3, -1).T
    np.testing.assert_allclose(gb.Camera.fit(many).eye, gb.Camera.fit(corners).eye)
    assert gb.render(many, size=SIZE).mask.mean() > 0.1


def test_what_fits_stays_one_scene(little):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for options in ({"level": 10}, {"octree": "dense"}, {"bounds": ((0,) * 3, (14,) * 3)}):
            assert type(gb.Scene(POSITIONS, support=2.0, device="cpu", **options)) is gb.Scene
        assert type(gb.Scene(POSITIONS[:500], support=2.0, device="cpu")) is gb.Scene
        little.size = 1e9
        assert type(gb.Scene(POSITIONS, support=2.0, device="cpu")) is gb.Scene


def test_too_little_for_any_piece(little):
    little.size = 200
    with pytest.raises(MemoryError, match=r"^memory: expected at least .* GB for the smallest"):
        gb.Scene(POSITIONS, support=2.0, device="cpu")


def test_the_command_line(little, capsys, folder):
    np.savez("a.npz", positions=POSITIONS, speed=SPEED)
    words = ["a.npz", "--size", "96x72", "--device", "cpu", "--support", "2", "--eye", "40,30,45",
             "--look-at", "6,6,6"]  # fmt: skip
    many = run_json(capsys, "render", *words, "-o", "many.png")
    assert many["counts"]["pieces"] > 1
    assert "2,744 particles in" in output_of(capsys, "render", *words, "-o", "many.png").err
    assert main(["render", *words, "-o", "other.png", "--pick", "40,30"]) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 2  # a warning and an error
    assert "got pieces, which can be drawn alone" in said
    assert not os.path.exists("other.png")
    little.size = 1e9
    one = run_json(capsys, "render", *words, "-o", "one.png")
    assert one["counts"]["hits"] == many["counts"]["hits"]


PROGRAM = """
import re, sys, globule as gb
gb.set_limits(memory=200e6)
scene = gb.Scene("huge.npy", support=2.0, device="cpu")
gb.render(scene, size=(64, 48))
status = open("/proc/self/status").read()
print(scene, re.search(r"VmHWM:\\s+(\\d+)", status)[1])
"""


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="needs /proc")
def test_the_memory_of_a_process(tmp_path):
    edge = 160
    cells = np.stack(np.meshgrid(*[np.arange(edge, dtype=np.float32)] * 3, indexing="ij"), -1)
    np.save(tmp_path / "huge.npy", cells.reshape(-1, 3))
    run = subprocess.run([sys.executable, "-c", PROGRAM], cwd=tmp_path, capture_output=True,
                         text=True, check=True)  # fmt: skip
    assert "4,096,000 particles take about" in run.stderr
    text, peak = run.stdout.rsplit(maxsplit=1)
    assert "pieces" in text
    assert int(peak) < 200e6 / 1024 + 90_000  # the limit, and the program itself
