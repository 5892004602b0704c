"""The commands that measure a surface: files and facts, sequences, refusals."""

import csv
import os
from pathlib import Path

import globule as gb
import numpy as np
import pytest
from cli_helpers import cube, output_of, refused, run_json, volume
from globule.cli import main
from PIL import Image

pytest.importorskip("skimage", reason="pip install 'globule[measure]'")
SHARED = Path(__file__).resolve().parents[2] / "shared/data"
CPU = ["--device", "cpu"]


def table(path: str) -> dict[str, list[str]]:
    with open(path, encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    return {name: [row[name] for row in rows] for name in rows[0]}


@pytest.fixture
def sequence(folder):
    """Three frames of a cube that rises by 0.25 a frame."""
    for i in range(3):
        p = cube(support=0.4)
        p.positions[:, 1] += 0.25 * i
        gb.write(f"frame_{i}.npz", p)
    return "frame_*.npz"


def test_slice(particles, capsys):
    facts = run_json(capsys, "slice", particles, "--plane", "0,0,1,0.4", "-o", "a.csv", *CPU)
    found = gb.measure.sample(particles, gb.measure.SamplePlane((0, 0, 1), 0.4), device="cpu")
    assert facts["places"] == {"v": found.shape[0], "u": found.shape[1]}
    columns = table("a.csv")
    assert [*columns] == ["x", "y", "z", "field", "inside", "speed", "flow:0", "flow:1", "flow:2"]
    np.testing.assert_array_equal(np.array(columns["speed"], np.float32), found["speed"].astype(np.float32).ravel())
    for words in (
        ["--grid", "-o", "a.vti"],
        ["--line", "0,0,0,1,1,1", "-o", "a.vtp", "--value", "flow:1"],
        ["--plane", "1,1,0,0.5", "-o", "a.npz", "--sample-spacing", "0.05", "--value", "gradient"],
    ):
        assert main(["slice", particles, *words, *CPU]) == 0
    with np.load("a.npz") as arrays:
        assert {*arrays} == {"points", "gradient"}
    capsys.readouterr()
    out = output_of(capsys, "slice", particles, "--plane", "0,0,1,99", "-o", "a.csv", *CPU).out
    assert "speed nowhere" in out
    assert "nan" not in out


def test_slice_as_an_image(particles, capsys):
    words = ["slice", particles, "--plane", "0,0,1,0.4", "--value", "speed", *CPU]
    for name, more in (("a.png", []), ("b.png", ["--inside", "--range", "0,300"])):
        assert main([*words, "-o", name, *more]) == 0
    a, b = (np.asarray(Image.open(f"{name}.png")) for name in "ab")
    assert a.shape == b.shape
    white = [(image == 255).all(2).mean() for image in (a, b)]
    assert 0.1 < white[0] < white[1] < 0.9
    assert "speed" in capsys.readouterr().out


def test_gauge(sequence, capsys):
    words = ["gauge", sequence, "--at", "0.4,0.4", "--at", "9,9", "--fps", "4", "-o", "g.csv", *CPU]
    facts = run_json(capsys, *words)
    columns = table("g.csv")
    assert columns["frame"] == ["0", "1", "2"]
    assert columns["time"] == ["0.0", "0.25", "0.5"]
    assert columns["file"] == [f"frame_{i}.npz" for i in range(3)]
    heights = np.array(columns["height_0"], float)
    np.testing.assert_allclose(np.diff(heights), 0.25, atol=1e-5)
    assert heights[0] == pytest.approx(float(gb.measure.gauge("frame_0.npz", (0.4, 0.4), device="cpu")), abs=1e-6)
    assert columns["height_1"] == ["nan"] * 3
    assert facts["height_1"] == [None] * 3


def test_gauge_plot_and_map(sequence, capsys):
    pytest.importorskip("matplotlib")
    words = ["gauge", "frame_0.npz", *CPU]
    assert main([*words, "--at", "0.4,0.4", "-o", "g.csv", "--plot", "g.png"]) == 0
    assert Image.open("g.png").size[0] > 300
    for name in ("m.csv", "m.vti", "m.npz", "m.vtp"):
        assert main([*words, "--map", "-o", name]) == 0
    heights = np.array(table("m.csv")["height"], float)
    assert np.nanmax(heights) == pytest.approx(float(gb.measure.gauge("frame_0.npz", (0.4, 0.4))), abs=0.1)


def test_mesh(particles, capsys):
    words = ["mesh", particles, "--value", "speed", *CPU]
    facts = run_json(capsys, *words, "-o", "a.ply")
    truth = gb.measure.measure_surface(particles, device="cpu")
    assert facts["volume"] == pytest.approx(truth.volume, rel=1e-6)
    assert facts["area_error"] == pytest.approx(truth.area_error, rel=1e-4)
    for name in ("a.stl", "a.obj", "a.vtp"):
        assert main([*words, "-o", name]) == 0
    assert "triangles, volume " in capsys.readouterr().out


def test_mesh_of_other_surfaces(particles, capsys):
    """The surface's flags reach the scene."""
    base = run_json(capsys, "mesh", particles, "-o", "a.ply", *CPU)
    seen = {base["volume"]}
    for more in (["--threshold", "1"], ["--support", "0.5"], ["--kernel", "wyvill"],
                 ["--anisotropic"]):  # fmt: skip
        seen.add(run_json(capsys, "mesh", particles, "-o", "a.ply", *more, *CPU)["volume"])
    assert len(seen) == 5
    coarse = run_json(capsys, "mesh", particles, "-o", "a.ply", "--sample-spacing", "0.1666666", *CPU)
    assert coarse["triangles"] < base["triangles"] / 2


def test_mesh_of_a_volume(folder, capsys):
    pytest.importorskip("SimpleITK")
    volume("ball.nii.gz")
    facts = run_json(capsys, "mesh", "ball.nii.gz", "--level", "100", "-o", "a.ply", *CPU)
    # Values of 100 lie at radius sqrt(ln 2 / 2) of a grid that is 2 wide, 15 voxels of 1 mm.
    radius = np.sqrt(np.log(2) / 2) * 7.5
    assert facts["volume"] == pytest.approx(4 / 3 * np.pi * radius**3, rel=0.1)


def test_track(sequence, capsys):
    facts = run_json(capsys, "track", sequence, "--fps", "4", "-o", "t.csv", *CPU)
    columns = table("t.csv")
    assert [*columns][:4] == ["frame", "time", "file", "volume"]
    np.testing.assert_allclose(np.diff(np.array(columns["y_max"], float)), 0.25, atol=2e-3)
    np.testing.assert_allclose(np.diff(facts["volume"]), 0, atol=facts["volume_error"][0])
    here = gb.measure.track_surface(sequence, device="cpu")
    for name, column in here.items():
        np.testing.assert_allclose(column, np.array(columns[name], float), rtol=1e-6)
    again = gb.measure.track_surface([gb.read(f"frame_{i}.npz") for i in range(3)], device="cpu")
    np.testing.assert_array_equal(again["volume"], here["volume"])


def test_track_of_an_empty_frame_and_plot(sequence, capsys):
    pytest.importorskip("matplotlib")
    gb.write("frame_1.npz", gb.Particles(np.empty((0, 3))))
    words = ["track", sequence, "-o", "t.csv", "--plot", "t.png", "--plot-column", "y_max", *CPU]
    assert main(words) == 0
    columns = table("t.csv")
    assert columns["x_max"][1] == "nan"
    assert float(columns["volume"][1]) == 0 < float(columns["volume"][2])
    assert Image.open("t.png").size[0] > 300


def test_project(folder, capsys):
    p = cube(10, support=0.25)
    p.attributes = {"mass": np.full(1000, 2.0), "density": np.full(1000, 2000.0)}
    gb.write("a.npz", p)
    facts = run_json(capsys, "project", "a.npz", "-o", "a.vti", "--axis", "1,0,0", *CPU)
    assert facts["total"]["density"] == pytest.approx(2000, rel=1e-3)
    for words in (["-o", "a.png", "--log", "--range", "2,4"], ["-o", "a.csv", "--value", "x"]):
        assert main(["project", "a.npz", *words, *CPU]) == 0
    assert Image.open("a.png").size[0] > 400
    capsys.readouterr()
    assert main(["project", "a.npz", "-o", "a.csv", "--scale", "0.1", *CPU]) == 0
    assert "volumes are the file's masses over densities, which --scale leaves" in (capsys.readouterr().err)
    words = ["--scale", "0.1", "--particle-volume", "1e-6"]
    assert not output_of(capsys, "project", "a.npz", "-o", "a.csv", *words, *CPU).err
    gb.write("b.npz", cube(10, support=0.25))
    facts = run_json(capsys, "project", "b.npz", "-o", "a.npz", "--particle-volume", "0.5", *CPU)
    assert facts["total"]["thickness"] == pytest.approx(500, rel=1e-3)


def test_refused(particles, capsys):
    for words, message in (
        (["slice", "cube.npz", "-o", "a.csv"], "--plane"),
        (["slice", "cube.npz", "--plane", "0,0,0,1", "-o", "a.csv"], "expected a direction"),
        (["slice", "cube.npz", "--line", "0,0,0,0,0,0", "-o", "a.csv"], "another point"),
        (["slice", "cube.npz", "--grid", "-o", "a.png"], "--plane: expected --plane beside a .png"),
        (["slice", "cube.npz", "--grid", "-o", "a.txt"], "-o: expected a name ending in"),
        (["slice", "cube.npz", "--grid", "-o", "a.csv", "--inside"], "--inside: expected a .png"),
        (["slice", "cube.npz", "--plane", "0,0,1,9", "--value", "speed", "-o", "a.png"], "plane"),
        (["slice", "cube.npz", "--grid", "--value", "v", "-o", "a.csv"], "--value: expected one"),
        (["slice", "no.npz", "--grid", "-o", "a.csv"], "no.npz: expected a file to read"),
        (["slice", "none.npz", "--grid", "-o", "a.csv"], "none.npz: expected particles"),
        (["gauge", "cube.npz", "-o", "a.csv"], "--at"),
        (["gauge", "cube.npz", "--at", "1,2", "--up", "1,1,0", "-o", "a.csv"], "--up: expected"),
        (["gauge", "cube.npz", "--at", "1,2", "-o", "a.vti"], "-o: expected a name ending in .csv"),
        (["gauge", "cube.npz", "cube.npz", "--map", "-o", "a.vti"], "--map: expected one file"),
        (["gauge", "cube.npz", "--map", "-o", "a.vti", "--plot", "a.png"], "--plot: expected --at"),
        (["gauge", "none_*.npz", "--at", "1,2", "-o", "a.csv"], "expected a pattern that matches"),
        (["mesh", "cube.npz", "-o", "a.glb"], "-o: expected a name ending in .ply"),
        (["mesh", "cube.npz", "-o", "a.ply", "--sample-spacing", "1e-6"], "--sample-spacing"),
        (["mesh", "cube.npz", "-o", "a.ply", "--sample-spacing", "5"], "--sample-spacing: expected one that meets"),
        (["mesh", "cube.npz", "-o", "a.ply", "--threshold", "1e6"], "expected a surface, got none"),
        (["mesh", "cube.npz", "-o", "a.ply", "--level", "3"], "--level: expected a volume"),
        (["project", "cube.npz", "-o", "a.csv", "--log"], "--log: expected a .png"),
    ):
        gb.write("none.npz", gb.Particles(np.empty((0, 3))))
        assert message in refused(capsys, *words, *CPU)


@pytest.mark.parametrize(
    "words",
    [["slice", "--plane", "0,0,1,2"], ["gauge", "--at", "2,2"], ["mesh"], ["track"], ["project", "--axis", "0,0,1"]],
    ids=lambda words: words[0],
)
def test_particles_that_are_left_out_are_named(words, folder, capsys):
    positions = cube(5).positions.astype(np.float64)
    positions[3], positions[4:6] = np.nan, 1e25
    np.savez("lost.npz", positions=positions)
    out = "a.ply" if words[0] == "mesh" else "a.csv"
    more = [*words[1:], "-o", out, *CPU]
    err = output_of(capsys, words[0], "lost.npz", *more).err
    assert "lost.npz: 1 of 125 particles has no finite position, left out" in err
    assert "lost.npz: 2 of 125 particles have a coordinate beyond 1e+18, left out" in err
    positions[:100] = 1e25
    np.savez("lost.npz", positions=positions)
    os.remove(out)
    assert refused(capsys, words[0], "lost.npz", *more).startswith(
        "globule: error: lost.npz: expected coordinates up to 1e+18, got farther ones of 100 of 125"
    )
    assert not os.path.exists(out)


def test_without_packages(particles, capsys, monkeypatch):
    modules = __import__("sys").modules
    monkeypatch.setitem(modules, "matplotlib.figure", None)
    words = ["gauge", particles, "--at", "0,0", "-o", "a.csv", "--plot", "a.png", *CPU]
    assert "globule[figures]" in refused(capsys, *words)
    monkeypatch.setitem(modules, "skimage.measure", None)
    assert "globule[measure]" in refused(capsys, "mesh", particles, "-o", "a.ply", *CPU)


@pytest.mark.slow
def test_one_surface_and_one_spacing_for_all(folder, capsys):
    """All commands speak of the same spacing, that of the fluid's volume; giving it again changes nothing."""
    axis = np.arange(-0.9, 1, 0.2)
    p = np.stack(np.meshgrid(axis, axis, axis), axis=-1).reshape(-1, 3)
    p = p[(p**2).sum(axis=1) < 1]
    p = gb.Particles(p + np.random.default_rng(0).uniform(-0.02, 0.02, p.shape))
    gb.write("ball.npz", p)
    scene = gb.Scene(p, surface="smooth", device="cpu")
    spacing = run_json(capsys, "info", "ball.npz")["spacing"]
    assert spacing == scene.spacing == pytest.approx(0.2, rel=0.02)
    facts = run_json(capsys, "render", "ball.npz", "-o", "a.png", "--size", "40x30", *CPU)
    assert facts["surface"] == "smooth"
    assert facts["spacing"] == spacing
    again = ["--particle-spacing", repr(spacing)]
    first = run_json(capsys, "mesh", "ball.npz", "-o", "a.stl", *CPU)
    assert first["volume"] == pytest.approx(len(p) * 0.2**3, rel=0.03)
    for more in ([], again, ["--surface", "smooth"]):
        facts = run_json(capsys, "mesh", "ball.npz", "-o", "a.stl", *more, *CPU)
        assert facts["volume"] == pytest.approx(gb.measure.measure_surface(scene).volume, rel=1e-6)
        facts = run_json(capsys, "gauge", "ball.npz", "--at", "0,0", "-o", "g.csv", *more, *CPU)
        assert facts["height_0"][0] == pytest.approx(float(gb.measure.gauge(scene, (0, 0))), abs=1e-5)
    total = len(p) * spacing**3
    for more in ([], again):
        facts = run_json(capsys, "project", "ball.npz", "-o", "a.npz", *more, *CPU)
        assert facts["total"]["thickness"] == pytest.approx(total, rel=1e-3)


def test_tables_without_a_file_are_printed(sequence, capsys):
    for words, column in ((["gauge", sequence, "--at", "0.5,0.5"], "height_0"), (["track", sequence], "volume")):
        assert main([*words, "-o", "a.csv", *CPU]) == 0
        capsys.readouterr()
        assert output_of(capsys, *words, *CPU).out == Path("a.csv").read_text()
        assert np.isfinite(run_json(capsys, *words, *CPU)[column]).all()
    error = refused(capsys, "gauge", "frame_0.npz", "--map")
    assert "-o: expected a file beside --map, got none" in error


def test_a_torn_splash_has_one_spacing(capsys, folder):
    """Neighbors are further apart than the cube root of a particle's volume says."""
    path = SHARED / "particles" / "double_dam_break_frame_26_4732_particles.vtk"
    if not path.exists():
        pytest.skip(f"needs {path}")
    scene = gb.Scene(gb.read(path), surface="smooth", device="cpu")
    assert run_json(capsys, "info", str(path))["spacing"] == scene.spacing
    facts = run_json(capsys, "project", str(path), "-o", "a.npz", "--value", "thickness", *CPU)
    assert facts["total"]["thickness"] == pytest.approx(4732 * scene.spacing**3, rel=1e-3)
    assert scene.spacing < 0.9 * gb.Scene(gb.read(path), device="cpu").spacing


def test_a_mesh_is_no_particles(folder, capsys):
    """Balls around the vertices of a hull are not the hull: nobody measures them by mistake."""
    Path("hull.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\nf 1 2 4\n")
    words = ["mesh", "hull.obj", "-o", "a.ply", *CPU]
    assert "expected particles or a volume, got a mesh" in refused(capsys, *words)
    assert main([*words, "--resample", "0.1"]) == 0


def test_frames_have_the_numbers_and_times_of_their_file(folder, capsys):
    g = np.stack(np.mgrid[:4, :4, :4], -1).reshape(-1, 3) * 0.1
    with open("a.dump", "w") as file:
        for k in range(3):
            file.write(f"ITEM: TIMESTEP\n{500 * k}\nITEM: NUMBER OF ATOMS\n64\nITEM: BOX BOUNDS ff ff ff\n")
            file.write("0 9\n" * 3 + "ITEM: ATOMS x y z\n")
            np.savetxt(file, g + k, "%.6f")
    found = run_json(capsys, "track", "a.dump")
    assert (found["frame"], found["time"]) == ([0, 1, 2], [0, 500, 1000])
    for frame in ("2", "-1"):
        found = run_json(capsys, "track", "a.dump", "--frame", frame)
        assert (found["frame"], found["time"]) == ([2], [1000])
        assert found["x_min"][0] == pytest.approx(2, abs=0.1)
    assert run_json(capsys, "track", "a.dump", "--frame", "1", "--fps", "10")["time"] == [0.1]
    found = run_json(capsys, "gauge", "a.dump", "--frame", "1", "--at", "1.1,1.1")
    assert (found["frame"], found["time"]) == ([1], [500])
    capsys.readouterr()
    assert main(["track", "a.dump"]) == 0
    assert "one time" not in capsys.readouterr().err
    assert main(["track", "a.dump", "a.dump"]) == 0  # as of two processors, or of a run that was continued
    assert "warning: rows 0 and 3 have one time, 0: a frame in several files" in capsys.readouterr().err
    gb.write("a_0.ply", gb.Particles(g))
    assert "time" not in run_json(capsys, "track", "a_0.ply")
    assert main(["track", "a.dump", "--frame", "3"]) == 2
    assert "frame: expected -3 to 2 for a.dump, got 3" in capsys.readouterr().err
