"""Scenes in pieces give the image of one scene: the same hits, colors within one level."""

import argparse
import contextlib
import gzip
import os
import sys
import tracemalloc
from pathlib import Path

import globule as gb
import numpy as np
import pytest
from cli_helpers import SMALL, cube, refused, run_json
from format_helpers import DATA
from globule import _core
from globule._base.ranks import Alone, run_threads
from globule.cli import main
from globule.cli.ranks import replicates
from globule.data.attributes import kinds_of
from globule.formats.ranges import has_ranges, ranges
from globule.formats.vtk_data import write_polygons
from globule.pieces import pieces as of_pieces
from globule.pieces import store
from globule.pieces.partition import Partition, histogram, space_around
from globule.pieces.pieces import Pieces
from globule.pieces.shown import shown_scene
from globule.render.fit import fitted
from globule.render.pieces import shading
from globule.render.pieces.image import fit
from pieces_helpers import own_shapes
from PIL import Image
from scenes import KERNELS

SIZE = (96, 72)
RNG = np.random.default_rng(1)
LATTICE = np.stack(np.meshgrid(*[np.arange(14)] * 3, indexing="ij"), -1).reshape(-1, 3)
POSITIONS = (LATTICE + RNG.uniform(-0.25, 0.25, LATTICE.shape)).astype(np.float32)
COLOR = RNG.random(POSITIONS.shape).astype(np.float32)
CAMERA = gb.Camera.fit(POSITIONS, size=SIZE, margin=1)
CUT = gb.ClipPlane((1, 0.2, 0), 7.0)


def agree(scene, pieces, camera=CAMERA, **options):
    one, many = (gb.render(s, camera, SIZE, **options) for s in (scene, pieces))
    assert one.mask.mean() > 0.03
    np.testing.assert_array_equal(one.mask, many.mask)
    assert np.abs(one.image.astype(int) - many.image.astype(int)).max() <= 1
    seen = one.mask
    np.testing.assert_allclose(one.distance[seen], many.distance[seen], atol=2e-4)
    np.testing.assert_allclose(one.position[seen], many.position[seen], atol=5e-4)


def check(particles, n, backend, camera=CAMERA, clips=(), settings=None, **options):
    pieces = Pieces(particles, n, **options, **backend)
    scene = gb.Scene(particles, **options, **backend)
    try:
        agree(scene, pieces, camera, clips=clips, settings=settings)
    finally:
        pieces.close()
    return pieces


@pytest.mark.parametrize("n", [1, 2, 3, 4, 7])
def test_pieces_of_a_colored_lattice_cut_open(n, backend):
    pieces = check(gb.Particles(POSITIONS, color=COLOR), n, backend, clips=[CUT], support=2.0)
    assert pieces.partition.n == n
    assert sum(pieces._files.counts) >= len(POSITIONS)


@pytest.mark.few_backends
@pytest.mark.parametrize("kernel", KERNELS)
def test_every_kernel(kernel, backend):
    support = 3.2 if kernel == "blinn" else 2.5
    check(gb.Particles(POSITIONS, color=COLOR), 3, backend, kernel=kernel, support=support)


@pytest.mark.few_backends
@pytest.mark.parametrize("support", [None, 2.6, np.full(2160, 2.6, np.float32)], ids=["none", "one", "each"])
@pytest.mark.parametrize("cut", [False, True])
def test_smooth_surfaces_with_samples_at_edges(cut, support, backend):
    """A bar that is long enough for pieces apart, also with weights for supports of its own."""
    bar = np.stack(np.meshgrid(np.arange(60), *[np.arange(6)] * 2, indexing="ij"), -1)
    points = bar.reshape(-1, 3) + np.random.default_rng(2).uniform(-0.2, 0.2, (2160, 3))
    weight = None if support is None else np.full(2160, 8 / 2.6**3, np.float32)
    particles = gb.Particles(points.astype(np.float32), color=COLOR[:2160], support=support, weight=weight)
    camera = gb.Camera.fit(particles, size=SIZE, margin=1)
    clips = [gb.ClipPlane((1, 0.2, 0.3), 40)] if cut else []
    pieces = check(particles, 4, backend, camera, clips, surface="smooth", spacing=1.0)
    assert max(pieces._files.counts) < len(particles)


@pytest.mark.parametrize("n", [2, 7])
@pytest.mark.parametrize("radius", [0, 3])
def test_eyes_inside(n, radius, backend):
    left = POSITIONS[np.linalg.norm(POSITIONS - 6.5, axis=1) >= radius]
    check(gb.Particles(left), n, backend, gb.Camera((6.5, 6.5, 6.5), (13, 9, 7)), support=2.0)


def test_layers_cuts_samples_alpha_and_kernels_of_their_own(backend):
    low, high = POSITIONS[POSITIONS[:, 1] < 7], POSITIONS[POSITIONS[:, 1] > 6]
    scenes = [gb.Scene(p, support=2.0, **backend) for p in (low, high)]
    pieces = [Pieces(p, n, support=2.0, **backend) for p, n in ((low, 3), (high, 2))]
    camera = gb.Camera.fit(POSITIONS, size=SIZE, margin=1, orthographic=True)
    red = gb.Material(color=(0.8, 0.1, 0.1))
    agree(
        [gb.Layer(scenes[0], red), gb.Layer(scenes[1], clips=[CUT])],
        [gb.Layer(pieces[0], red), gb.Layer(pieces[1], clips=[CUT])],
        camera,
    )
    agree(scenes, [scenes[0], pieces[1]], camera)
    settings = {"samples": 4, "transparent": True}
    particles = gb.Particles(POSITIONS, color=COLOR)
    check(particles, 3, backend, support=2.0, settings=settings, clips=[CUT])
    pieces, scene = Pieces(particles, 3, support=2.0), gb.Scene(particles, support=2.0)
    alphas = [gb.render(s, CAMERA, SIZE, settings).alpha for s in (pieces, scene)]
    np.testing.assert_allclose(*alphas, atol=1e-3)
    camera = gb.Camera((6.5, 6.5, 6.5), (13, 9, 7))
    for clip in (gb.ClipSphere((10, 7, 6), 2.0), gb.ClipSphere((6.5, 6.5, 6.5), 2.5)):
        check(gb.Particles(POSITIONS), 3, backend, camera, [clip], support=2.0)
    for particles, options in own_shapes():
        check(particles, 4, backend, **options)


def test_the_same_bits_again_files_are_removed_and_mistakes():
    images = [gb.render(Pieces(POSITIONS, 3, support=2.0), CAMERA, SIZE).color for _ in "ab"]
    assert images[0].tobytes() == images[1].tobytes()
    pieces = Pieces(POSITIONS, 3, support=2.0)
    folder = pieces._files._folder.name
    assert os.listdir(folder)
    pieces.close()
    assert not os.path.exists(folder)
    with pytest.raises(ValueError, match=r"^n: "):
        Pieces(POSITIONS, 0)
    with pytest.raises(ValueError, match=r"^surface: "):
        Pieces(POSITIONS, 2, surface="smooth", support=1.0)
    with pytest.raises(MemoryError, match=r"^memory: expected more than"):
        Pieces(POSITIONS, memory=1e6)


def test_each_piece_holds_all_that_reaches_its_cells():
    """Against every distance between cells and particles."""
    points = RNG.random((400, 3)) * (5, 3, 1)
    reach = np.where(np.arange(400) == 7, 2.0, RNG.uniform(0.05, 0.2, 400))
    space = space_around(points.min(0), points.max(0), 0.2, 2.0)
    partition = Partition(space, histogram(space, points), 5)
    assert set(partition.owners) == set(range(5))
    rows, pieces = partition.needed(points, reach)
    held = np.zeros((400, 5), bool)
    held[rows, pieces] = True
    assert held.sum() == len(rows)
    probes = space.low + space.extent * RNG.random((20000, 3))
    owner = partition.owner(probes)
    for i in range(400):
        near = np.linalg.norm(probes - points[i], axis=1) < reach[i] + space.margin
        assert held[i, owner[near]].all()
    assert held.sum() < 400 * 5  # not everything everywhere


def test_a_rank_takes_little_more_than_its_share(monkeypatch):
    """What Python holds while particles go to their ranks, in the share's own bytes."""
    monkeypatch.setattr(of_pieces, "CHUNK", 1 << 12)
    points = RNG.random((200_000, 3), np.float32)
    tracemalloc.start()
    try:
        pieces = Pieces(points, comm=Alone(), support=0.02, device="cpu", threads=1)
        tracemalloc.reset_peak()
        before = tracemalloc.get_traced_memory()[0]
        pieces._to_ranks(store.source_of(points))
        peak = tracemalloc.get_traced_memory()[1] - before
    finally:
        tracemalloc.stop()
    (scene,) = pieces.here().values()
    assert len(scene) == len(points)
    assert peak < 1.3 * points.nbytes
    if sys.platform == "linux":  # the octree has them, and their own pages are gone
        assert np.mean(scene.particles.positions == 0) > 0.95


@pytest.fixture
def files(folder):
    """The same particles in files whose ranges can be read."""
    speed = np.linspace(0, 1, len(POSITIONS), dtype=np.float32)
    np.save("a.npy", POSITIONS)
    np.savez("a.npz", positions=POSITIONS, speed=speed)
    gb.write("own.npz", gb.Particles(POSITIONS, attributes={"speed": speed}))
    return speed


@pytest.mark.parametrize(
    "name", ["a.npy", "a.npz", "own.npz", "a.h5", "a.vtu", "a.vtp", "big_endian.vtu", "a.bgeo", "b.bgeo"]
)
def test_ranges_of_files(name, files):
    if name == "a.h5":
        h5py = pytest.importorskip("h5py")
        with h5py.File(name, "w") as file:
            file["positions"], file["speed"] = POSITIONS, files
    elif name in ("a.vtu", "a.vtp", "a.bgeo"):
        gb.write(name, gb.Particles(POSITIONS, attributes={"speed": files}))
    elif name == "big_endian.vtu":
        Path(name).write_bytes(vtu(POSITIONS.astype(">f4"), files.astype(">f8")))
    elif name == "b.bgeo":  # of SPlisHSPlasH, unpacked
        real = DATA / "dam_break_frame_23_24389_particles.bgeo"
        if not real.exists():
            pytest.skip(f"no {real}")
        Path(name).write_bytes(gzip.decompress(real.read_bytes()))
    found, whole = ranges(name), gb.read(name)
    assert found.n == len(whole)
    some = found.read(100, 300)
    np.testing.assert_array_equal(some.positions, whole.positions[100:300])
    assert some.attributes.keys() == whole.attributes.keys()
    for key, values in some.attributes.items():
        np.testing.assert_array_equal(values, whole.attributes[key][100:300])


def vtu(positions, speed):
    n, kinds = len(positions), ("Float32", "Float64")
    blocks = [np.array(a.nbytes, ">u4").tobytes() + a.tobytes() for a in (positions, speed)]
    arrays = [f'<DataArray type="{kind}" Name="{name}" NumberOfComponents="{k}" '
              f'format="appended" offset="{at}"/>'
              for kind, name, k, at in zip(kinds, ("Points", "speed"), (3, 1),
                                           (0, len(blocks[0])), strict=True)]  # fmt: skip
    return (
        '<VTKFile type="UnstructuredGrid" byte_order="BigEndian" header_type="UInt32">'
        f'<UnstructuredGrid><Piece NumberOfPoints="{n}" NumberOfCells="0">'
        f"<Points>{arrays[0]}</Points><PointData>{arrays[1]}</PointData></Piece>"
        '</UnstructuredGrid><AppendedData encoding="raw">_'
    ).encode() + b"".join(blocks) + b"</AppendedData></VTKFile>"  # fmt: skip


def test_ranges_refuse_other_files(files):
    whole = vtu(POSITIONS.astype(">f4"), files.astype(">f8"))
    longer = whole.replace(b'="2744"', b'="2745"')
    for data, match in ((whole[:5000], "<Appended"), (longer, "bytes")):
        Path("cut.vtu").write_bytes(data)
        with pytest.raises(gb.FormatError, match=match):
            ranges("cut.vtu")
    Path("text.vtu").write_bytes(whole.replace(b"<PointData>", b'<PointData><DataArray format="ascii"/>'))
    np.savez_compressed("small.npz", positions=POSITIONS)
    Path("a.npy.gz").write_bytes(gzip.compress(Path("a.npy").read_bytes()))
    assert has_ranges("a.npy")
    for name in ("a.ply", "a.bgeo.gz"):
        gb.write(name, gb.Particles(POSITIONS))
    for name, match in (
        ("small.npz", "without compression"), ("a.ply", "globule convert"), ("text.vtu", None), ("a.npy.gz", None),
        ("a.bgeo.gz", r"expected .*, \.bgeo without compression .* bgeo;"),
    ):  # fmt: skip
        assert not has_ranges(name)
        with pytest.raises(gb.FormatError, match=match):
            ranges(name)


@pytest.mark.parametrize("name", ["a.npy", "fortran.npy", "own.npz", "a.vtu", "a.bgeo", "a.h5"])
def test_a_file_that_changes_while_it_is_read(name, files):
    """Shorter, with other rows, and gone: an error, not a signal that ends the program."""

    def write(positions):
        if name == "fortran.npy":
            np.save(name, np.asfortranarray(positions))
        elif name == "a.h5":
            with pytest.importorskip("h5py").File(name, "w") as file:
                file["positions"] = positions
        else:
            gb.write(name, gb.Particles(positions))

    write(POSITIONS)
    found = ranges(name)
    np.testing.assert_array_equal(found.read(100, 300).positions, POSITIONS[100:300])
    for change in (lambda: os.truncate(name, 700), lambda: write(POSITIONS[::-1]), lambda: os.unlink(name)):
        write(POSITIONS)
        found = ranges(name)
        change()
        with pytest.raises(gb.FormatError, match=f"{name}: .* got one that changed while"):
            found.read(2000, 2500)


@pytest.fixture
def little(monkeypatch):
    """All memory goes to particles: so little that there are pieces of a few hundred."""
    monkeypatch.setattr(of_pieces, "resident_bytes", lambda: 0)
    monkeypatch.setattr(of_pieces, "OVERHEAD", 0)


def apart(*names) -> int:
    one, many = (np.asarray(Image.open(name), int) for name in names)
    return np.abs(one - many).max()


def test_render_with_memory_has_the_radii_of_the_file(files, little, capsys):
    common = ["a.npz", "--size", "96x72", "--device", "cpu", "--support", "2", "--eye", "40,30,45",
              "--look-at", "6,6,6", "--color-by", "speed"]  # fmt: skip
    in_pieces = [*common, "-o", "many.png", "--memory", "100000"]
    whole = run_json(capsys, "render", *common, "-o", "one.png")
    many = run_json(capsys, "render", *in_pieces)
    assert many["counts"]["pieces"] > 1
    assert many["counts"]["hits"] == whole["counts"]["hits"]
    assert apart("one.png", "many.png") <= 1
    assert main(["render", *in_pieces]) == 0
    assert "particles in" in capsys.readouterr().err  # a line says so
    words = ["render", "a.npz", "-o", "a.png", "--support", "2", "--memory", "100000"]
    Path("b.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    for flag in ("spheres", "lines", "mesh", "with"):
        error = refused(capsys, *words, f"--{flag}", "b.obj" if flag == "mesh" else "a.npz")
        assert f"--{flag}: expected none with a scene in pieces" in error
    radii = RNG.uniform(0.2, 0.45, len(LATTICE))
    atoms = {"radius": np.full(len(LATTICE), 0.9), "atomic_number": np.ones(len(LATTICE), np.int32)}
    several = {"phase": np.arange(len(LATTICE)) // 300}
    shown = {"g": ({"radius": radii}, "spheres"), "a": (atoms, "spheres"), "p": (several, "balls")}
    for name, (attributes, surface) in shown.items():
        gb.write(f"{name}.npz", gb.Particles(LATTICE, attributes=attributes))
        words = ["render", f"{name}.npz", "--device", "cpu", "--size", "80x60"]
        one = run_json(capsys, *words, "-o", "one.png")
        many = run_json(capsys, *words, "-o", "many.png", "--memory", "100000")
        assert (one["surface"], many["surface"]) == (surface, surface)
        assert many["counts"]["pieces"] > 1
        assert apart("one.png", "many.png") <= 1


def test_legend_and_box_of_pieces_far_from_the_origin(files, little, capsys):
    start = np.array([440_750.0, 3_750_150.0, 100.0])
    np.savez("far.npz", positions=LATTICE + start)
    words = ["render", "far.npz", "--device", "cpu", "--size", "320x240", "--support", "2", "--color-by", "x",
             "--legend", "--box"]  # fmt: skip
    one = run_json(capsys, *words, "-o", "one.png")
    many = run_json(capsys, *words, "-o", "many.png", "--memory", "100000")
    assert many["counts"]["pieces"] > 1
    assert many["origin"] == one["origin"] != [0, 0, 0]
    assert many["camera"] == one["camera"]  # with room for the legend
    assert apart("one.png", "many.png") <= 1


def test_pieces_are_of_the_frame_that_is_asked_for(files, little, capsys):
    h5py = pytest.importorskip("h5py")
    with h5py.File("run.h5part", "w") as file:
        for i in range(2):
            group = file.create_group(f"Step#{i}")
            for k, name in enumerate("xyz"):
                group[name] = POSITIONS[:: 2 - i, k]
    words = ["render", "run.h5part", "-o", "a.png", "--size", "40x30", "--device", "cpu",
             "--support", "2", "--memory", "100000"]  # fmt: skip
    counts = [run_json(capsys, *words, "--frame", k)["counts"] for k in "01"]
    assert [c["particles"] for c in counts] == [len(POSITIONS[::2]), len(POSITIONS)]


@pytest.mark.parametrize("radius", [0.3, -0.3])
def test_ranges_without_radii_beside_those_with(backend, radius):
    radii = np.where(np.arange(len(LATTICE)) < 1000, radius, np.nan)
    particles = gb.Particles(LATTICE, attributes={"radius": radii})
    pieces = Pieces(store.source_of(particles)._replace(size=500), 3, surface="spheres", **backend)
    agree(gb.Scene(particles, surface="spheres", **backend), pieces)
    pieces.close()


def test_faces_are_not_drawn_in_pieces(files, little, capsys):
    n = 50
    corners = np.stack([*np.meshgrid(np.arange(n), np.arange(n)), np.zeros((n, n))], -1)
    corner = np.arange(n * n).reshape(n, n)
    quads = np.stack([corner[:-1, :-1], corner[:-1, 1:], corner[1:, 1:], corner[1:, :-1]], -1)
    write_polygons("m.vtp", corners.reshape(-1, 3), {}, polys=quads.reshape(-1, 4))
    words = ["render", "m.vtp", "-o", "a.png", "--device", "cpu", "--size", "40x30"]
    assert run_json(capsys, *words, "--memory", "100000")["counts"]["triangles"] == 2 * (n - 1) ** 2
    names = "ranks resample level label frame species where origin center min_component scale"
    given = dict.fromkeys((*names.split(), "columns", "atom_style", "ground"))
    options = argparse.Namespace(particles=["m.vtp"], as_particles=False, radius_is="radius", **given)
    light = argparse.Namespace(_matter={}, _own={})
    assert replicates(options, light)  # on each rank of mpiexec, too


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="needs a device that is full")
def test_no_room_for_temporary_files(files, little, capsys, monkeypatch):
    monkeypatch.setattr(store.Files, "_path", lambda *_: "/dev/full")
    words = ["render", "a.npz", "-o", "full.png", "--support", "2", "--memory", "100000"]
    error = refused(capsys, *words)
    assert "--memory: expected room for temporary files in" in error
    assert "TMPDIR" in error
    assert "No space left on device" in error
    assert not os.path.exists("full.png")


def test_memory_that_suffices_and_mistakes(files, capsys):
    common = ["render", "a.npy", "-o", "a.png"]
    assert "pieces" not in run_json(capsys, *common, *SMALL, "--memory", "8G")["counts"]
    assert "8G" in refused(capsys, *common, "--memory", "much")
    assert "more than" in refused(capsys, *common, "--memory", "1M")
    assert "--preset" in refused(capsys, *common, "--memory", "1M", "--preset", "water")
    for name in ("gone.npy", "gone.npz"):
        error = refused(capsys, "render", name, "-o", "a.png", "--support", "2")
        assert f"{name}: expected a file to read" in error
    np.savez("b.npz", positions=POSITIONS)
    series = ["render", "a.npz", "b.npz", "-o", "c_%d.png", "--support", "2", *SMALL]
    error = refused(capsys, *series, "--memory", "1M")
    assert "--memory: expected one image where a file is read in pieces, as a.npz" in error
    assert main([*series, "--memory", "8G"]) == 0


def test_particles_without_a_place_are_counted(files, little, capsys):
    lost = POSITIONS.copy()
    lost[100:103] = np.nan
    np.save("lost.npy", lost)
    np.save("none.npy", POSITIONS[:0])
    words = ["-o", "a.png", "--support", "2", "--threads", "1", "--memory", "100K", *SMALL]
    assert main(["render", "lost.npy", *words]) == 0
    out, err = capsys.readouterr()
    assert "warning: 3 of 2,744 particles have no finite position" in err
    assert "CPU, 1 thread," in out
    np.save("nowhere.npy", np.full_like(POSITIONS, np.nan))
    for name in ("none.npy", "nowhere.npy"):
        error = refused(capsys, "render", name, *words)
        assert f"{name}: expected particles, got none with a finite position" in error
    pieces = Pieces(np.zeros((9, 3)), memory=1e9)  # a box without extent
    assert pieces.partition.n == 1


@pytest.mark.parametrize("own", [False, True])  # a support that all have
def test_what_is_measured_is_that_of_one_scene(own):
    """Surface, spacing and camera of pieces and ranks, by themselves."""
    rng, points = np.random.default_rng(3), np.stack(np.mgrid[:14, :12, :10], -1).reshape(-1, 3)
    points = (points + rng.uniform(-0.1, 0.1, points.shape)).astype("f4")
    support = 2.0 if own else None
    one = shown_scene(gb.Particles(points, support=support), device="cpu")
    camera = fitted(one, (160, 120), None)

    def measured(pieces):
        assert pieces.surface == one.surface == "smooth"
        assert (pieces.spacing, fit(pieces, (160, 120))) == (one.spacing, camera)

    def rank(ranks):
        first, last = (len(points) * r // ranks.size for r in (ranks.rank, ranks.rank + 1))
        share = gb.Particles(points[first:last], support=support)
        measured(Pieces(share, comm=ranks, surface="auto", device="cpu"))

    whole = gb.Particles(points, support=support)
    with contextlib.closing(Pieces(whole, n=3, surface="auto", device="cpu")) as pieces:
        measured(pieces)
    run_threads(3, rank)


@pytest.mark.skipif(_core.cpu_backends()[-1] == "cpu_v2", reason="x86-64-v2 fuses nothing")
@pytest.mark.parametrize("height", [None, 9.0])
def test_rays_of_samples_are_the_cores(height):
    """Bit by bit: else rays that graze the surface meet it here and miss it there."""
    camera = gb.Camera((31, 22, 40), (6, 6, 6), height=height)
    scene = gb.Scene(POSITIONS, support=2.0, device="cpu")
    frame = gb.render(scene, camera, (80, 60), settings={"edge_samples": 0})
    origins, directions = shading.rays_of(camera, (80, 60), np.arange(80 * 60))
    hit = frame.mask.ravel()
    assert hit.sum() > 500
    t = frame.distance.reshape(-1, 1)[hit].astype(np.float64)
    places = (t * directions[hit] + origins[hit]).astype(np.float32)
    assert (places == frame.position.reshape(-1, 3)[hit]).all()


def test_legends_of_pieces_name_types():
    particles = cube(6)
    particles.attributes["type"] = np.arange(216) % 3
    particles.names = {"type": {0: "water", 1: "salt"}}
    for name in ("type", "x"):
        found = Pieces(particles, n=3, color_by=name, support=0.3, device="cpu").kinds
        assert found == kinds_of(particles, name, "auto")
    particles.attributes["type"] = np.arange(216) % 25
    assert not Pieces(particles, n=3, color_by="type", support=0.3, device="cpu").kinds
