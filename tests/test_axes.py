"""What is upwards in a file, and what lies across the periodic faces of its box."""

from pathlib import Path

import globule as gb
import numpy as np
import pytest
from cli_helpers import SMALL, output_of, refused, refuses, run_json
from format_helpers import write_dump, write_extxyz
from globule.cli import main
from globule.data.particles import UP, Z_UP
from globule.formats import Box, read_contents, up_of
from globule.pieces.pieces import Pieces

pytestmark = pytest.mark.usefixtures("folder")
STEP, RADIUS = 0.06, 0.3


def ball(middle: tuple[float, float, float]) -> np.ndarray:
    """A lattice in a ball of `RADIUS`."""
    x = np.stack(np.mgrid[-5:6, -5:6, -5:6], -1).reshape(-1, 3) * STEP
    return x[np.linalg.norm(x, axis=1) < RADIUS] + middle


def test_up_of_formats():
    x = ball((0.5, 0.5, 1))
    write_dump("a.dump", x)
    write_extxyz("a.extxyz", x)
    np.savetxt("a.pts", x, header=str(len(x)), comments="")
    for name in ("a.dump", "a.extxyz", "a.pts"):
        particles = gb.read(name)
        assert (particles.up, particles[:3].up, gb.Scene(particles).up) == (Z_UP,) * 3
        assert up_of(name)[0] == Z_UP
    for name in ("a.npz", "a.csv", "a.vtk", "a.ply"):
        gb.write(name, gb.Particles(x))
        assert (gb.read(name).up, up_of(name)[0]) == (UP, UP)
    refuses(r"up: expected a direction, got \(0, 0, 0\)", gb.Particles, x, up=(0, 0, 0))


def test_images_have_it_upwards(capsys):
    x = ball((0.5, 0.5, 1)) * (1, 1, 0.5)
    write_dump("a.dump", x)
    write_dump("both.dump", x, x)
    own = gb.Camera.fit(gb.read("a.dump"), size=(40, 30))
    assert own.up == Z_UP
    assert own.eye[2] > 0.5 > own.eye[1]  # from the front and above
    said = output_of(capsys, "render", "a.dump", "-o", "a.png", *SMALL).err.splitlines()
    assert [line for line in said if "up is" in line] == [
        "globule: note: up is 0,0,1, as usual in this format (LAMMPS dump); --up chooses another direction"
    ]
    still = run_json(capsys, "render", "a.dump", "-o", "a.png", *SMALL)
    movie = run_json(capsys, "render", "both.dump", "-o", "b_%d.png", *SMALL)
    assert still["camera"]["up"] == movie["frames"][1]["camera"]["up"] == list(Z_UP)
    assert movie["frames"][0]["camera"] == movie["frames"][1]["camera"]
    assert np.array_equal(read_png("a.png"), gb.render("a.dump", (40, 30)).image)
    gb.render_sequence("both.dump", "c_%d.png", size=(40, 30))
    assert np.array_equal(read_png("c_1.png"), read_png("a.png"))
    other = run_json(capsys, "render", "a.dump", "-o", "c.png", "--up", "0,1,0", *SMALL)
    assert other["camera"]["up"] == list(UP)
    assert "--up 0,0,1" in run_json(capsys, "info", "a.dump")["camera"]["flags"]


def read_png(path: str) -> np.ndarray:
    from PIL import Image

    return np.asarray(Image.open(path))


def test_presets_views_and_gauges_have_it_upwards(capsys):
    write_dump("a.dump", ball((0.5, 0.5, 1)))
    scene = gb.Scene("a.dump")
    assert tuple(gb.load_preset("water", scene).ground.normal) == Z_UP
    top = gb.render_views(scene, ("top",), (40, 30)).frames[0]
    assert top.position[top.mask][:, 2].min() > 0.9  # seen from above
    height = gb.measure.gauge("a.dump", (0.5, 0.5))
    assert height == pytest.approx(1 + RADIUS, abs=STEP)
    assert "note: up is 0,0,1" in output_of(capsys, "gauge", "a.dump", "--at", "0.5,0.5", "-o", "a.csv").err
    assert np.genfromtxt("a.csv", delimiter=",", names=True)["height_0"] == pytest.approx(height)


def test_pieces_and_ranks_have_it_upwards():
    write_dump("a.dump", ball((0.5, 0.5, 1)))
    particles = gb.read("a.dump")
    pieces = Pieces(particles, n=2)
    assert pieces.up == Z_UP
    one = gb.render(gb.Scene(particles), (40, 30)).image
    assert np.abs(gb.render(pieces, (40, 30)).image.astype(int) - one).max() <= 1
    pieces.close()


def test_the_viewer_has_it_upwards():
    from globule.viewer.open import open_source

    write_dump("a.dump", ball((0.5, 0.5, 1)), ball((0.5, 0.5, 1.1)))
    assert open_source("a.dump", "cpu").up == Z_UP
    assert open_source("a.dump", "cpu", frame=0).up == Z_UP
    source = open_source("a.dump", "cpu", frame=0, center=True)
    assert source.option_words() == ["--frame", "0", "--center"]


def usd_layer(path: str, up: str) -> None:
    from pxr import Usd, UsdGeom, Vt

    stage = Usd.Stage.CreateNew(path)
    UsdGeom.SetStageUpAxis(stage, up)
    UsdGeom.SetStageMetersPerUnit(stage, 0.01)
    for k, name in enumerate(("seen", "hidden", "blinks")):
        points = UsdGeom.Points.Define(stage, f"/World/{name}")
        points.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(np.float32(ball((0, 0, k)))))
    UsdGeom.Points.Get(stage, "/World/hidden").MakeInvisible()
    for name, purpose in (("guide", "guide"), ("proxy", "proxy"), ("seen", "render")):
        UsdGeom.Points.Define(stage, f"/World/{name}").CreatePurposeAttr(purpose)
    UsdGeom.Points.Get(stage, "/World/guide").CreatePointsAttr([(99, 99, 99)])
    UsdGeom.Points.Get(stage, "/World/proxy").CreatePointsAttr([(99, 99, 99)])
    blinks = UsdGeom.Points.Get(stage, "/World/blinks")
    x = Vt.Vec3fArray.FromNumpy(np.float32(ball((0, 0, 2))))
    for time, word in ((0, "inherited"), (1, "invisible")):
        blinks.CreateVisibilityAttr().Set(word, time)
        blinks.GetPointsAttr().Set(x, time)
    beads = UsdGeom.PointInstancer.Define(stage, "/World/beads")
    beads.CreatePositionsAttr([(0, 0, 5), (1, 0, 5), (2, 0, 5)])
    beads.CreateIdsAttr([7, 8, 9])
    beads.CreateInvisibleIdsAttr([8])
    stage.GetRootLayer().Save()


@pytest.mark.parametrize("up", ["Y", "Z"])
def test_usd_visibility_up_and_unit(up, capsys):
    pytest.importorskip("pxr")
    usd_layer("a.usda", up)
    n = len(ball((0, 0, 0)))
    first, second = (read_contents("a.usda", frame=k) for k in (0, 1))
    assert (len(first.particles), len(second.particles)) == (2 * n + 2, n + 2)
    assert gb.read("a.usda", species="/World/beads").attributes["id"].tolist() == [7, 9]
    assert len(gb.read("a.usda", species="/World/hidden")) == n  # asked for by its name
    axis = Z_UP if up == "Z" else UP
    assert (first.particles.up, up_of("a.usda")[0]) == (axis, axis)
    assert first.units["positions"] == "0.01 m"
    gb.write("b.usda", first.particles)
    assert gb.read("b.usda").up == axis
    assert main(["convert", "a.usda", "c.usda", "--frame", "0"]) == 0
    assert "unit of 0.01 m become m: --scale 0.01 keeps" in capsys.readouterr().err
    assert "unit of" not in output_of(capsys, "convert", "a.usda", "c.usda", "--frame", "0", "--scale", "0.01").err


def test_a_droplet_across_a_face_is_whole(capsys):
    x = ball((0.02, 0.97, 1.0))
    write_dump("a.dump", x % (1, 1, 2))
    write_extxyz("a.extxyz", x)  # not wrapped
    for name in ("a.dump", "a.extxyz"):
        lo, hi = gb.read(name).bounds()
        assert (hi - lo)[:2].min() > 0.9  # in two parts
        lo, hi = gb.read(name, center=True).bounds()
        assert np.allclose(lo, (0.26, 0.26, 0.76), atol=1e-5)
        assert np.allclose(hi, (0.74, 0.74, 1.24), atol=1e-5)
    table = run_json(capsys, "track", "a.dump", "--center")
    assert table["volume"][0] == pytest.approx(len(x) * STEP**3, rel=0.03)
    assert table["x_max"][0] - table["x_min"][0] == pytest.approx(2 * RADIUS, abs=STEP)
    cut = run_json(capsys, "render", "a.dump", "-o", "a.png", *SMALL)
    assert cut["warnings"] == [
        "a.dump: the particles lie across the periodic faces along x and y; --center shows them whole"
    ]
    whole = run_json(capsys, "render", "a.dump", "-o", "a.png", "--center", *SMALL)
    assert whole["warnings"] == []
    part = gb.read("a.dump", center=True, where="id < 5")
    assert np.allclose(np.add(*part.bounds())[:2], 1, atol=1e-5)  # those that are left


def test_a_droplet_that_leaves_through_a_face_stays_whole(capsys):
    write_dump("a.dump", *(ball((0.7 + 0.1 * k, 0.5, 1)) % (1, 1, 2) for k in range(5)))
    table = run_json(capsys, "track", "a.dump", "--center")
    assert np.ptp(table["x_min"]) < 1e-3
    assert np.ptp(table["volume"]) < 1e-3 * table["volume"][0]
    assert output_of(capsys, "track", "a.dump").err.count("--center shows them whole") == 1


def test_what_cannot_be_centered(capsys):
    x = ball((0, 0.5, 1))
    write_dump("walls.dump", x % (1, 1, 2), faces="ff ff ff")
    gb.write("a.npz", gb.Particles(x))
    for name, got in (("walls.dump", "one without"), ("a.npz", "no box")):
        error = refused(capsys, "track", name, "--center")
        assert f"{name}: center: expected a file with a box and periodic faces, got {got}" in error


def test_box_of_any_shape():
    edges = np.array([[2, 0, 0], [0.6, 1.5, 0], [0.3, -0.4, 3]])
    box = Box(np.array([-1.0, 4, 0]), edges, (True, True, True))
    x = ball((0, 0, 0))
    for corner in ((0, 0, 0), (1, 0, 1), (0.5, 0.02, 0.5)):
        wrapped = box.wrap(x + box.origin + corner @ edges)
        moved = box.center(wrapped)
        assert np.allclose(moved, x + box.origin + 0.5 * edges.sum(axis=0), atol=1e-6)
        assert box.cut_axes(wrapped)
        assert box.cut_axes(moved) == []
    flat = Box.of_sizes(0, (1, 1, 0), True)
    y = ball((0, 0.5, 0)) * (1, 1, 0)
    assert np.allclose(flat.center(y), y + (0.5, 0, 0), atol=1e-6)
    full = np.random.default_rng(0).random((5000, 3))
    assert np.array_equal(Box.of_sizes(0, 1, True).center(full), full)  # it has no middle
    assert Box.of_sizes(0, 1, True).cut_axes(full) == []
    nothing = np.full((3, 3), np.nan)
    assert np.isnan(Box.of_sizes(0, 1, True).center(nothing)).all()


def test_npz_keeps_up_and_names(capsys):
    """What is converted looks as before: z upwards, and types by their names."""
    x = ball((0.5, 0.5, 0.5))
    with open("a.extxyz", "w") as file:
        file.write(f"{len(x)}\nProperties=species:S:1:pos:R:3\n")
        file.write("".join(f"{'AB'[k % 2]} {a:.9g} {b:.9g} {c:.9g}\n" for k, (a, b, c) in enumerate(x)))
    assert "dropped" not in output_of(capsys, "convert", "a.extxyz", "a.npz").err
    err = output_of(capsys, "convert", "a.extxyz", "a.vtp").err
    assert "note: up, 0,0,1, is dropped: .vtp cannot store it; --up 0,0,1 draws" in err
    assert "note: the names of type are dropped" in err
    given, kept = gb.read("a.extxyz"), gb.read("a.npz")
    assert kept.names == given.names != {}
    assert kept.up == given.up == Z_UP == Pieces("a.npz", 2, support=0.1).up
    assert up_of("a.npz") == (Z_UP, "the file says so")
    np.savez("plain.npz", positions=x)
    assert (gb.read("plain.npz").up, up_of("plain.npz")) == (UP, (UP, "the default"))
    data = Path("a.npz").read_bytes()
    for other in (b'[1, {"up"', b'{"up": [0, 0, 0], "n"', b'{"up": [0, 0, {}], "'):  # of the same length
        place = data.rindex(b'{"up": [0')
        Path("b.npz").write_bytes(data[:place] + other + data[place + len(other) :])
        assert gb.read("b.npz").up == UP
