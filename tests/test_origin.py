"""Coordinates that float32 would not keep: positions are given from an origin, files keep all."""

import argparse
import re
import warnings

import globule as gb
import numpy as np
import pytest
from cli_helpers import run_json
from globule.cli import main
from globule.data.particles import HERE, relative
from globule.formats.vtk_data import write_polygons
from globule.render.canvas import Canvas
from globule.render.legend import tick_labels
from globule.viewer.open import open_source
from globule.viewer.state import State
from PIL import Image

pytestmark = pytest.mark.usefixtures("folder")
FAR = np.array([440_750.0, 5_000_000.0, 100.0])
MACHINE = ["--device", "cpu", "--size", "96x72"]


def lattice(n: int = 9) -> np.ndarray:
    return np.stack(np.mgrid[:n, :n, :n], -1).reshape(-1, 3) / 8


def read(name: str, how=gb.read):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return how(name)


def pixels(name: str) -> np.ndarray:
    return np.asarray(Image.open(name)).astype(int)


def test_float64_far_away_gets_an_origin_and_nothing_else_does():
    near = lattice()
    for kept in (near, near + 10, (near + FAR).astype("f4"), near[:1] + FAR, np.empty((0, 3))):
        assert relative(kept)[1] == HERE
    positions, origin = relative(near + FAR)
    assert origin != HERE
    np.testing.assert_array_equal(positions + origin, near + FAR)
    assert np.abs(positions).max() < 10
    few, origin = relative(near[:2] + FAR)  # two tell a spacing
    np.testing.assert_array_equal(few + origin, near[:2] + FAR)
    flat, origin = relative((near + FAR)[:, :2])  # 2-D
    assert (flat.shape[1], origin[2]) == (3, 0)


@pytest.mark.parametrize("to", [".npz", ".npy", ".csv", ".ply", ".vtk", ".vtp", ".vtu", ".txt"])
def test_convert_keeps_what_float32_would_destroy(to, capsys):
    np.save("a.npy", lattice() + FAR)
    assert main(["convert", "a.npy", f"b{to}"]) == 0
    assert "a.npy: positions are given from" in capsys.readouterr().err
    got = read(f"b{to}")
    assert got.origin != HERE
    np.testing.assert_allclose(got.world_positions(), lattice() + FAR, rtol=0, atol=2e-9)


def test_the_picture_is_that_of_the_same_particles_here_and_frames_have_one_origin(capsys):
    np.save("a.npy", lattice() + FAR)
    assert main(["convert", "a.npy", "b.bgeo"]) == 2
    assert "b.bgeo: positions: near 5e+06 float32 has steps of 0.5" in capsys.readouterr().err
    np.save("far.npy", lattice() + FAR)
    np.save("near.npy", lattice())
    far = run_json(capsys, "render", "far.npy", "-o", "far.png", *MACHINE)
    near = run_json(capsys, "render", "near.npy", "-o", "near.png", *MACHINE)
    assert (near["origin"], far["counts"]) == ([0, 0, 0], near["counts"])
    x = np.subtract(near["camera"]["eye"], far["camera"]["eye"])
    np.testing.assert_allclose(x, np.subtract(far["origin"], FAR), atol=1e-4)
    assert np.abs(pixels("far.png") - pixels("near.png")).max() <= 3
    for k in range(3):
        np.save(f"s_{k}.npy", lattice() + FAR + (0.4 * k, 0, 0))
    assert main(["track", "s_0.npy", "s_1.npy", "s_2.npy", "-o", "t.csv"]) == 0
    rows = np.genfromtxt("t.csv", delimiter=",", names=True, dtype=None, encoding=None)
    np.testing.assert_allclose(np.diff(rows["x_min"]), 0.4, atol=2e-3)
    np.testing.assert_allclose(rows["z_min"], FAR[2] + lattice()[:, 2].min(), atol=0.2)
    np.testing.assert_allclose(rows["volume"], rows["volume"][0], rtol=1e-4)
    assert main(["render", "s_*.npy", "-o", "s_%d.png", *MACHINE]) == 0
    assert np.abs(pixels("s_0.png") - pixels("s_2.png")).max() > 50  # it moves
    capsys.readouterr()
    words = ["track", "s_0.npy", "--json", "--origin", "440750,5000000,100"]
    assert run_json(capsys, *words)["origin"] == FAR.tolist()


def test_what_is_asked_for_counts_scenes_keep_it_and_pieces_have_one(capsys, monkeypatch):
    np.save("a.npy", lattice() + FAR)
    got = gb.read("a.npy", origin=FAR)
    assert got.origin == tuple(FAR)
    np.testing.assert_allclose(got.positions, lattice(), atol=1e-6)
    with pytest.warns(UserWarning, match="float32 has steps"):
        gb.read("a.npy", origin=(0, 0, 0))
    for wrong in ((1, 2), "here", (0, 0, np.nan), 3):
        with pytest.raises(ValueError, match="origin: expected"):
            gb.read("a.npy", origin=wrong)
    with pytest.warns(UserWarning, match="float32 has steps"):
        gb.Particles(lattice(), origin=FAR).at((0, 0, 0))
    there = gb.Particles(lattice(), origin=FAR)
    assert there[3:5].origin == tuple(FAR)
    scene = gb.Scene(there, support=0.3)
    scene.update(gb.Particles(lattice() + 1, origin=FAR - 1))
    np.testing.assert_allclose(scene.particles.positions, lattice(), atol=1e-6)
    assert scene.particles.origin == tuple(FAR)
    scene.update(positions=lattice() + 2)
    assert scene.particles.origin == tuple(FAR)
    from globule.formats.ranges import ranges

    np.savez("a.npz", positions=lattice() + FAR)
    n, rows, start = ranges("a.npz")  # who only counts is told nothing
    with pytest.warns(UserWarning, match="positions are given from"):
        rows(0, 1)
    origins = {rows(k, k + 100).origin for k in range(0, n, 100)}
    assert len(origins) == 1
    assert origins == {start()} != {HERE}
    whole = np.concatenate([rows(k, k + 100).world_positions() for k in range(0, n, 100)])
    np.testing.assert_allclose(whole, lattice() + FAR, atol=1e-7)


def write_triangle(name: str, place: np.ndarray) -> None:
    corners = place + [(0, 0, 3), (1, 0, 3), (0, 1, 3)]
    if name.endswith(".vtp"):
        write_polygons(name, corners, {}, polys=np.array([[0, 1, 2]]))
        return
    lines = [f"v {x} {y} {z}" for x, y, z in corners]
    with open(name, "w") as file:
        file.write("\n".join([*lines, "f 1 2 3", ""]))


@pytest.mark.parametrize("to", [".obj", ".vtp"])
def test_a_mesh_alone_has_an_origin_and_one_beside_stands_where_it_is(to, capsys):
    write_triangle(f"far{to}", FAR)
    report = run_json(capsys, "render", f"far{to}", "-o", "far.png", *MACHINE)
    assert np.abs(np.subtract(report["origin"], FAR)).max() < 10
    assert np.abs(report["camera"]["look_at"]).max() < 10
    with pytest.warns(UserWarning, match="positions are given from"):
        mesh = gb.Mesh(f"far{to}")
    world = np.unique(mesh.vertices + np.asarray(mesh.origin), axis=0)
    np.testing.assert_allclose(world, FAR + [(0, 0, 3), (0, 1, 3), (1, 0, 3)], atol=1e-6)
    there = gb.Particles(lattice(), origin=FAR)
    assert np.allclose(gb.Mesh(f"far{to}", origin=FAR).vertices.max(axis=0), (1, 1, 3), atol=1e-6)
    with pytest.raises(ValueError, match="scene: expected layers with one origin"):
        gb.render([gb.Layer(there), gb.Layer(gb.Mesh(f"far{to}", origin=FAR - 1))], size=(96, 72))
    for name, place in (("near", np.zeros(3)), ("far", FAR)):
        np.save(f"{name}.npy", lattice() + place)
        write_triangle(f"{name}{to}", place)
        words = [f"{name}.npy", "-o", f"{name}.png", "--mesh", f"{name}{to}", *MACHINE]
        assert main(["render", *words]) == 0
    assert np.abs(pixels("near.png") - pixels("far.png")).mean() < 0.1


def test_rigid_bodies_beside_stand_where_they_are(monkeypatch):
    from globule.cli import meshes

    class Bodies:
        def __init__(self, folder, **options):
            self.together = gb.Mesh([(9, 0, 0), (10, 0, 0), (9, 1, 0)], [(0, 1, 2)])

    monkeypatch.setattr(meshes, "RigidBodies", Bodies)
    options = argparse.Namespace(device="cpu", threads=1, origin=(8.0, 0.0, 0.0))
    bounds = meshes.read_bodies("bodies", options).together.bounds()
    np.testing.assert_array_equal(bounds, [(1, 0, 0), (2, 1, 0)])


@pytest.mark.parametrize("to", [".ply", ".obj", ".vtp", ".stl"])
def test_meshes_are_written_in_world_coordinates(to, capsys):
    np.save("a.npy", lattice() + FAR)
    assert main(["mesh", "a.npy", "-o", f"b{to}"]) == 0
    said, mesh = capsys.readouterr().err, read(f"b{to}", gb.Mesh)
    middle = np.mean(mesh.bounds(), axis=0) + mesh.origin
    if to == ".stl":  # float32
        assert "b.stl: positions are given from" in said
        middle += read("a.npy").origin
    np.testing.assert_allclose(middle, FAR + 0.5, atol=0.01)


@pytest.mark.parametrize("command", [["slice", "--grid"], ["project"], ["gauge", "--map"]])
def test_samples_are_written_in_world_coordinates(command, capsys):
    np.save("a.npy", lattice() + FAR)
    name, *words = command
    for to in (".csv", ".npz", ".vti", ".vtp"):
        assert main([name, "a.npy", *words, "--sample-spacing", "0.25", "-o", f"b{to}"]) == 0
    world = np.load("b.npz")["points"].reshape(-1, 3)
    rows = np.genfromtxt("b.csv", delimiter=",", names=True)
    np.testing.assert_allclose(np.stack([rows[k] for k in "xyz"], 1), world, rtol=0, atol=1e-6)
    np.testing.assert_allclose(read("b.vtp").world_positions(), world, rtol=0, atol=1e-6)
    np.testing.assert_allclose(world[:, :2].mean(axis=0), (FAR + 0.5)[:2], atol=0.3)
    with open("b.vti", "rb") as file:
        origin = re.search(rb'Origin="([^"]*)"', file.read())[1].split()
    if name != "gauge":  # whose points have heights
        np.testing.assert_allclose(np.array(origin, float), world[0], rtol=0, atol=1e-6)


def test_planes_and_lines_are_of_the_world(capsys):
    heights = lattice().astype("f8")[:, 2]
    for name, start in (("far", FAR), ("near", np.zeros(3))):
        np.savez(f"{name}.npz", positions=lattice() + start, height=heights)
        level, (x, y, z) = 2 * start[2] + 1, start + 0.5
        for words, to in (
            (["--plane", f"0,0,2,{float(level)!r}"], "plane"),
            ([f"--line={float(x)!r},{float(y)!r},{float(z)!r},{float(x)!r},{float(y)!r},{float(z + 0.5)!r}"], "line"),
        ):
            assert main(["slice", f"{name}.npz", *words, "--sample-spacing", "0.1", "-o", f"{name}-{to}.csv"]) == 0
    for to in ("plane", "line"):
        far, near = (np.genfromtxt(f"{name}-{to}.csv", delimiter=",", names=True) for name in ("far", "near"))
        assert np.isfinite(far["height"]).any()
        np.testing.assert_allclose(far["height"], near["height"], atol=1e-5)
        for axis, start in zip("xyz", FAR, strict=True):
            np.testing.assert_allclose(far[axis] - start, near[axis], atol=1e-6)


def test_gauges_images_and_large_ids_are_said_as_in_the_world(capsys):
    np.save("a.npy", lattice() + FAR)
    words = ["gauge", "a.npy", "--at", "440750.5,5000000.5", "--up", "0,0,-1", "--origin", "440750,5000000,100"]
    assert main([*words, "-o", "g.csv"]) == 0
    height = np.genfromtxt("g.csv", delimiter=",", names=True)["height_0"]
    np.testing.assert_allclose(height, -FAR[2], atol=0.2)  # that of the lowest layer
    assert main(["render", "a.npy", "-o", "a.png", "--aov", "a.npz", *MACHINE]) == 0
    aov = np.load("a.npz")
    np.testing.assert_allclose(aov["position"][aov["mask"]].mean(axis=0), FAR + 0.5, atol=0.7)
    ids = 2**53 + 1 + 2 * np.arange(729, dtype=np.uint64)
    gb.write("a.npz", gb.Particles(lattice().astype("f4"), attributes={"id": ids}))
    assert main(["info", "a.npz"]) == 0
    assert f"id: uint64 729, {ids[0]} to {ids[-1]}" in capsys.readouterr().out
    words = ["render", "a.npz", "-o", "a.png", "--pick", "48,36", *MACHINE]
    picked = run_json(capsys, *words)["picked"]["attributes"]["id"]
    assert picked in ids.tolist()
    assert main(words) == 0
    assert f"id {picked}" in capsys.readouterr().out
    texts = [text for _, text in tick_labels(float(ids[0]), float(ids[-1]), 5)]
    assert len({*texts}) == len(texts) > 2


def drifting(n: int = 3) -> list[gb.Particles]:
    shift = np.array([100.0, 0, 0])
    return [gb.Particles(lattice(), origin=FAR + k * shift) for k in range(n)]


def test_the_viewer_its_command_and_values_of_places_have_one_origin():
    for k, frame in enumerate(drifting()):
        gb.write(f"s_{k}.npz", frame)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for what in ([f"s_{k}.npz" for k in range(3)], drifting()):
            source, state = open_source(what, device="cpu"), State()
            assert np.ptp(source.outline(), axis=0)[0] > 200
            state.time.frame = 2
            source.advance(state)
            np.testing.assert_allclose(source.bounds()[0], (200, 0, 0), atol=1e-4)
            (layer,) = source.layers(state)
            np.testing.assert_allclose(layer.scene.particles.bounds(), source.bounds(), atol=1e-4)
            source.close()
        assert open_source(["s_0.npz", "s_2.npz"]).reading["origin"] == tuple(FAR)
    one, other, _ = (gb.Scene(frame, support=0.3) for frame in drifting())
    with pytest.raises(ValueError, match="scene: expected layers with one origin"):
        open_source([one, other])
    from globule.viewer.source import Source

    source = Source.__new__(Source)
    source.reading = {"labels": [1, 2], "origin": tuple(FAR), "columns": {"x": "a"}}
    words = "--label 1 --label 2 --origin 440750,5000000,100 --columns x=a"
    assert source.option_words() == words.split()
    frames, empty = drifting(), gb.Particles(np.empty((0, 3)))
    assert gb.find_value_range([empty, *frames], "x") == (0, 201)
    cameras = [gb.Camera((100 * k + 0.5, 0.5, 4), (100 * k + 0.5, 0.5, 0.5)) for k in range(3)]
    gb.render_sequence(frames, "s_%d.png", cameras, (96, 72), color_by="x", range=(0, 201))
    middles = np.array([pixels(f"s_{k}.png")[36, 48] for k in range(3)])
    assert np.abs(np.diff(middles, axis=0)).max(axis=1).min() > 30


def test_images_say_from_where_their_numbers_are_given(monkeypatch, capsys):
    """Axes of the box and legends of places, on the command line and in Python."""
    words = []
    plain = Canvas.text
    monkeypatch.setattr(
        Canvas, "text", lambda self, at, text, *a, **k: words.append(text) or plain(self, at, text, *a, **k)
    )
    np.save("a.npy", lattice() + FAR)
    np.save("near.npy", lattice())
    look = ["--box", "--color-by", "z", "--legend", "--size", "640x480"]
    assert main(["render", "a.npy", "-o", "a.png", "--device", "cpu", *look]) == 0
    assert "from 440750,5000000,100, and so are cameras, cuts and legends" in capsys.readouterr().err
    assert {"x - 440750", "y - 5000000", "z - 100"} <= {*words}
    assert words.count("z - 100") == 2
    words.clear()
    notes = gb.Annotation(box=True, legend=True)
    gb.render(read("a.npy"), (640, 480), color_by="x", annotate=notes).save("b.png")
    assert words.count("x - 440750") == 2
    words.clear()
    gb.render("near.npy", (640, 480), color_by="x", annotate=notes).save("b.png")
    assert words.count("x") == 2
