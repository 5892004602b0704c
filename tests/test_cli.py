"""The command line: what it writes, what it says, and how it ends."""

from __future__ import annotations

import json
import os
import signal
import stat
import subprocess
import sys
import time
from importlib.util import find_spec

import globule as gb
import numpy as np
import pytest
from globule.cli import COMMANDS, main
from globule.colormaps import NAMES, colorize
from PIL import Image
from sweep_helpers import example_files

COMMAND = [sys.executable, "-m", "globule"]
SMALL = ["--size", "40x30", "--device", "cpu"]


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    """Every test in an empty folder of its own."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("GLOBULE_TRACEBACK", raising=False)
    return tmp_path


def cube(n: int = 6, **fields) -> gb.Particles:
    axis = np.arange(n, dtype=np.float32) / n
    return gb.Particles(np.stack(np.meshgrid(axis, axis, axis), axis=-1).reshape(-1, 3), **fields)


@pytest.fixture
def particles(folder):
    p = cube()
    speed = np.arange(len(p), dtype=np.float64)
    p.attributes = {"speed": speed, "flow": np.stack([speed, speed, speed], axis=1)}
    gb.write("cube.npz", p)
    return "cube.npz"


def volume(path) -> None:
    """A bright ball in a dark volume."""
    import SimpleITK as sitk

    z, y, x = np.mgrid[-1:1:16j, -1:1:16j, -1:1:16j]
    sitk.WriteImage(sitk.GetImageFromArray(200 * np.exp(-(x * x + y * y + z * z) * 2)), str(path))


def run(*words: str, **options) -> subprocess.CompletedProcess:
    return subprocess.run(
        [*COMMAND, *words], capture_output=True, text=True, timeout=100, **options
    )


def refused(capsys, *words: str) -> str:
    """The one line that a mistake is answered with; nothing may have been written."""
    before = sorted(os.listdir())
    assert main(list(words)) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith("globule: error: ") and err.count("\n") == 1, err
    assert sorted(os.listdir()) == before
    return err


# render


def test_render_writes_a_picture(particles, capsys):
    assert main(["render", particles, "-o", "a.png", *SMALL]) == 0
    out, err = capsys.readouterr()
    assert out.startswith("a.png: 216 particles") and out.count("\n") == 1
    assert err == ""
    picture = np.asarray(Image.open("a.png"))
    assert picture.shape == (30, 40, 3)
    assert (picture[15, 20] != picture[0, 0]).any()


def test_render_json(particles, capsys):
    assert main(["render", particles, "-o", "a.png", "--json", "--aov", "a.npz", *SMALL]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert facts["images"] == ["a.png"] and facts["aov"] == "a.npz"
    assert set(facts["times"]) == {"read", "build", "trace", "write", "total"}
    assert all(t >= 0 for t in facts["times"].values())
    assert facts["memory"]["octree"] > 0
    counts = facts["counts"]
    assert counts["particles"] == counts["inside"] == 216 and counts["outside"] == 0
    assert counts["leaves"] <= counts["nodes"] and 0 < counts["hits"] < 40 * 30
    assert "CPU" in facts["device"]
    assert facts["kernel"] == "murakami" and facts["threshold"] == 0.6
    assert facts["support"] == pytest.approx(2 * facts["spacing"])
    assert facts["spacing"] == pytest.approx(1 / 6, rel=0.02)
    scene = gb.Scene(gb.read(particles), device="cpu")
    assert facts["hashes"] == {
        "key_hash": scene.octree.key_hash, "node_hash": scene.octree.node_hash
    }
    with np.load("a.npz") as arrays:
        assert {"color", "depth", "position", "normal", "mask"} <= set(arrays)
        assert arrays["mask"].sum() == counts["hits"]


def test_render_is_what_the_library_makes(particles):
    words = "--eye -1,2,3 --look-at 0,0,0 --up 0,0,1 --fov 30 --kernel wyvill --support 0.4 "
    words += "--threshold 0.5 --ambient 0.2 --background 0.1,0.2,0.3 --light head "
    words += "--light dir:-1,0,1 --light point:-3,3,3"
    assert main(["render", particles, "-o", "a.png", *SMALL, *words.split()]) == 0
    scene = gb.Scene(gb.read(particles), "wyvill", 0.5, 0.4, device="cpu")
    third = (1 / 3,) * 3
    settings = gb.RenderSettings(
        lights=(
            gb.Headlight(third),
            gb.DirectionalLight((-1, 0, 1), third),
            gb.PointLight((-3, 3, 3), third),
        ),
        ambient=0.2,
        background=(0.1, 0.2, 0.3),
    )
    camera = gb.Camera((-1, 2, 3), (0, 0, 0), (0, 0, 1), 30)
    frame = gb.render(scene, camera, (40, 30), settings)
    assert frame.mask.any()
    assert (np.asarray(Image.open("a.png")) == frame.picture).all()


def test_orthographic_and_octree_options(particles, capsys):
    words = ["--ortho", "4", "--octree", "dense", "--depth", "4", "--threads", "1", "--json"]
    assert main(["render", particles, "-o", "a.png", *SMALL, *words]) == 0
    wide = json.loads(capsys.readouterr().out)["counts"]["hits"]
    words = ["--ortho", "2", "--key-bits", "64", "--depth", "18", "--json"]
    assert main(["render", particles, "-o", "a.png", *SMALL, *words]) == 0
    assert json.loads(capsys.readouterr().out)["counts"]["hits"] > 3 * wide


@pytest.mark.parametrize("up", ["1,0,0", "0,1,0", "0,0,1", "0,0,-1", "1,1,1"])
def test_fit_shows_all_whatever_is_upwards(particles, up):
    assert main(["render", particles, "-o", "a.png", "--up", up, *SMALL, "--aov", "a.npz"]) == 0
    with np.load("a.npz") as arrays:
        mask = arrays["mask"]
    assert mask.any() and not (mask[0].any() or mask[-1].any() or mask[:, 0].any())


def test_color_by(particles, capsys):
    for name in ("speed", "flow", "flow:1", "x"):
        command = ["render", particles, "-o", "a.png", "--color-by", name, "--colormap", "magma"]
        assert main([*command, "--aov", "a.npz", *SMALL]) == 0
        with np.load("a.npz") as arrays:
            albedo = arrays["albedo"][arrays["mask"]]
        assert np.ptp(albedo, axis=0).max() > 0.1
    assert main([*command, "--range", "-1000,-999", "--aov", "a.npz", *SMALL]) == 0
    with np.load("a.npz") as arrays:
        albedo = arrays["albedo"][arrays["mask"]]
    assert np.allclose(albedo, colorize([1.0], "magma", 0, 1), atol=1e-3)
    capsys.readouterr()
    err = refused(capsys, "render", particles, "-o", "b.png", "--color-by", "sped")
    assert "speed" in err and "flow" in err and "sped" in err
    assert "flow:2" in refused(capsys, "render", particles, "-o", "b.png", "--color-by", "flow:3")


def test_color_by_values_that_are_not_finite(folder, capsys):
    p = cube()
    gb.write("a.npz", gb.Particles(p.positions, attributes={"t": np.full(216, np.nan)}))
    assert main(["render", "a.npz", "-o", "a.png", "--color-by", "t", *SMALL]) == 0
    assert "216 of 216 particles without a finite t" in capsys.readouterr().err


@pytest.mark.parametrize("name", NAMES)
def test_colormaps(name):
    ends = colorize([0.0, 1.0], name, 0, 1)
    assert ends.dtype == np.float32 and ((0 <= ends) & (ends <= 1)).all()
    assert (colorize([-5.0, np.inf], name, 0, 1) == ends).all()
    assert np.isfinite(colorize([3.0, np.nan], name, 3, 3)).all()
    assert np.isfinite(colorize([-1e308, 1e308], name, -1e308, 1e308)).all()


# several files


@pytest.mark.parametrize(
    "output, names",
    [
        ("pictures", ["pictures/a.png", "pictures/b.c.png"]),
        ("pictures/", ["pictures/a.png", "pictures/b.c.png"]),
        ("p_{}.png", ["p_a.png", "p_b.c.png"]),
        ("p%03d.png", ["p000.png", "p001.png"]),
    ],
)
def test_several_files(folder, capsys, output, names):
    (folder / "pictures").mkdir()
    gb.write("a.ply", cube())
    gb.write("b.c.bgeo.gz", cube())
    assert main(["render", "a.ply", "b.c.bgeo.gz", "-o", output, "--json", *SMALL]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert facts["images"] == names and len(facts["frames"]) == 2
    assert all(os.path.getsize(name) for name in names)
    assert facts["counts"]["particles"] == 432


def test_several_files_need_a_pattern(particles, capsys):
    gb.write("other.ply", cube())
    assert "%d" in refused(capsys, "render", particles, "other.ply", "-o", "a.png")
    gb.write("cube.ply", cube())
    assert "twice" in refused(capsys, "render", particles, "cube.ply", "-o", "a_{}.png")


# mistakes


@pytest.mark.parametrize(
    "words, part",
    [
        (["-o", "a.exr"], ".png"),
        (["-o", "a"], ".png"),
        (["-o", "nowhere/a.png"], "nowhere"),
        (["-o", "nowhere/"], "nowhere"),
        ([], "-o"),
        (["-o", "a.png", "--size", "0x5"], "0x5"),
        (["-o", "a.png", "--size", "axb"], "axb"),
        (["-o", "a.png", "--size", "99999x99999"], "99999x99999"),
        (["-o", "a.png", "--kernel", "gauss"], "murakami"),
        (["-o", "a.png", "--support", "0"], "--support"),
        (["-o", "a.png", "--support", "nan"], "--support"),
        (["-o", "a.png", "--threshold", "-1"], "--threshold"),
        (["-o", "a.png", "--eye", "1,2"], "X,Y,Z"),
        (["-o", "a.png", "--eye", "1,2,x"], "'x'"),
        (["-o", "a.png", "--eye", "1,2,3", "--look-at", "1,2,3"], "look_at"),
        (["-o", "a.png", "--look-at", "1,2,3"], "--eye"),
        (["-o", "a.png", "--fit", "--eye", "1,2,3"], "--fit"),
        (["-o", "a.png", "--fov", "180"], "fov"),
        (["-o", "a.png", "--ortho", "-2"], "--ortho"),
        (["-o", "a.png", "--octree", "loose"], "sparse"),
        (["-o", "a.png", "--depth", "11"], "depth"),
        (["-o", "a.png", "--key-bits", "48"], "--key-bits"),
        (["-o", "a.png", "--octree", "dense", "--key-bits", "64"], "key_bits"),
        (["-o", "a.png", "--colormap", "jet"], "viridis"),
        (["-o", "a.png", "--color-by", "x", "--range", "1"], "LO,HI"),
        (["-o", "a.png", "--light", "sun"], "dir:X,Y,Z"),
        (["-o", "a.png", "--light", "dir:0,0,0"], "direction"),
        (["-o", "a.png", *["--light", "head"] * 9], "at most 8"),
        (["-o", "a.png", "--background", "#12345"], "#12345"),
        (["-o", "a.png", "--ambient", "-1"], ">= 0"),
        (["-o", "a.png", "--device", "tpu"], "tpu"),
        (["-o", "a.png", "--device", "cuda:99"], "cuda:99"),
        (["-o", "a.png", "--threads", "-1"], "--threads"),
        (["-o", "a.png", "--aov", "a.exr"], ".npz"),
        (["-o", "a.png", "--aov", "cube.npz"], "cube.npz"),
        (["-o", "a.png", "--no-such-option"], "--no-such-option"),
        (["-o", "a.png", "--siz", "4x4"], "--siz"),
    ],
)
def test_mistakes_of_render(particles, capsys, words, part):
    assert part in refused(capsys, "render", particles, *words)


@pytest.mark.parametrize("words", [["rendre"], ["render"], ["info"], ["convert", "a.ply"]])
def test_mistakes_of_the_command(capsys, words):
    refused(capsys, *words)


def test_no_command_shows_help(capsys):
    assert main([]) == 2
    out, err = capsys.readouterr()
    assert "render" in out and "expected a command" in err


def test_input_mistakes(folder, capsys):
    (folder / "folder.ply").mkdir()
    (folder / "bad.ply").write_text("ply\nnonsense\n")
    (folder / "a.xls").write_text("1 2 3\n")
    for command in (["render", "-o", "a.png"], ["info"]):
        assert "no.ply" in refused(capsys, command[0], "no.ply", *command[1:])
        assert "folder.ply" in refused(capsys, command[0], "folder.ply", *command[1:])
        assert "bad.ply" in refused(capsys, command[0], "bad.ply", *command[1:])
        assert ".npz" in refused(capsys, command[0], "a.xls", *command[1:])


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write everywhere")
def test_places_without_permission(particles, folder, capsys):
    (folder / "locked").mkdir()
    (folder / "locked" / "a.ply").write_text("")
    os.chmod(folder / "locked", 0)
    try:
        refused(capsys, "render", particles, "-o", "locked/a.png")
        refused(capsys, "info", "locked/a.ply")
    finally:
        os.chmod(folder / "locked", stat.S_IRWXU)


def test_the_old_picture_stays_after_a_mistake(particles, folder, capsys):
    (folder / "a.png").write_text("old")
    refused(capsys, "render", particles, "-o", "a.png", "--color-by", "nothing")
    assert (folder / "a.png").read_text() == "old"


# particles that make trouble


@pytest.mark.parametrize("aim", [[], ["--eye", "0.5,0.5,3", "--look-at", "0.5,0.5,0"]])
@pytest.mark.parametrize("positions", [np.zeros((0, 3)), np.full((3, 3), np.nan)])
def test_no_particles_make_a_picture_of_the_background(positions, aim):
    gb.write("none.npz", gb.Particles(positions))
    done = run("render", "none.npz", "-o", "a.png", "--json", *SMALL, *aim)
    assert done.returncode == 0, done.stderr
    facts = json.loads(done.stdout)
    assert facts["counts"]["particles"] == len(positions)
    assert facts["counts"]["inside"] == facts["counts"]["hits"] == 0
    assert "warning: " in done.stderr and done.stderr.count("\n") == 1
    picture = np.asarray(Image.open("a.png"))
    assert (picture == picture[0, 0]).all()


def test_particles_without_a_position_are_counted(capsys):
    p = cube()
    positions = p.positions.copy()
    positions[0] = np.nan
    positions[1, 2] = np.inf
    positions[2] = -np.inf
    speed = np.arange(216.0)
    gb.write("a.npz", gb.Particles(positions, attributes={"speed": speed}))
    command = ["render", "a.npz", "-o", "a.png", "--color-by", "speed", "--json", *SMALL]
    assert main(command) == 0
    out, err = capsys.readouterr()
    assert "3 of 216 particles have no finite position" in err
    counts = json.loads(out)["counts"]
    assert (counts["particles"], counts["inside"], counts["outside"]) == (216, 213, 3)
    assert counts["hits"] > 0


def test_a_threshold_that_nothing_reaches(particles, capsys):
    command = ["render", particles, "-o", "a.png", *SMALL]
    assert main([*command, "--threshold", "1000"]) == 0
    err = capsys.readouterr().err
    assert "threshold 1000 is above the highest field" in err
    assert main([*command, "--threshold", err.split("--threshold")[1].strip()]) == 0
    assert capsys.readouterr().err == ""


def test_a_camera_that_looks_past(particles, capsys):
    words = ["--eye", "0,0,9", "--look-at", "0,0,99"]
    assert main(["render", particles, "-o", "a.png", *SMALL, *words]) == 0
    assert "looks past" in capsys.readouterr().err


# how it ends


def test_interrupted(particles, folder):
    """Ctrl-C in the middle of a large picture: no file, no traceback, 130."""
    gb.write("many.npz", cube(40))
    command = [*COMMAND, "render", "many.npz", "-o", "a.png", "--size", "14000x14000"]
    before = sorted(os.listdir())
    process = subprocess.Popen(
        [*command, "--device", "cpu"], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    time.sleep(2)
    assert process.poll() is None, process.communicate()
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=60)
    assert process.returncode == 130
    assert out == "" and err == "globule: interrupted\n"
    assert sorted(os.listdir()) == before


def test_closed_pipe(particles):
    process = subprocess.Popen(
        [*COMMAND, "info", particles], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    process.stdout.close()
    assert process.wait(timeout=60) == 1
    assert process.stderr.read() == ""
    process.stderr.close()


def test_pipes_get_no_progress_bar(particles):
    done = run("render", particles, "-o", "a.png", *SMALL)
    assert done.returncode == 0 and done.stderr == ""
    assert "\r" not in done.stdout and "\033" not in done.stdout


def test_a_terminal_gets_a_progress_bar(particles):
    pty = pytest.importorskip("pty")
    ours, theirs = pty.openpty()
    done = subprocess.run(
        [*COMMAND, "render", particles, "-o", "a.png", *SMALL],
        stdout=subprocess.PIPE, stderr=theirs, timeout=100,
    )
    os.close(theirs)
    shown = os.read(ours, 100_000).decode()
    os.close(ours)
    assert done.returncode == 0
    assert "4/4" in shown or "3/4" in shown
    assert shown.endswith("\r\033[K")
    assert b"\r" not in done.stdout


@pytest.mark.parametrize(
    "error, status, line",
    [
        (MemoryError(), 1, "globule: error: not enough memory\n"),
        (KeyError("inside"), 1, "globule: error: 'inside'\n"),
        (OSError(28, "No space left on device", "a.png"), 1,
         "globule: error: [Errno 28] No space left on device: 'a.png'\n"),
        (KeyboardInterrupt(), 130, "globule: interrupted\n"),
    ],
)
def test_other_errors_take_one_line(particles, capsys, monkeypatch, error, status, line):
    def fail(*_, **__):
        raise error

    monkeypatch.setattr("globule.cli.render.render", fail)
    assert main(["render", particles, "-o", "a.png"]) == status
    assert capsys.readouterr() == ("", line)
    assert not os.path.exists("a.png")
    if status == 1:
        monkeypatch.setenv("GLOBULE_TRACEBACK", "1")
        assert main(["render", particles, "-o", "a.png"]) == status
        assert "Traceback" in capsys.readouterr().err


# the other commands


def test_info(particles, capsys):
    assert main(["info", particles]) == 0
    out = capsys.readouterr().out
    assert "216" in out and "speed: float64 216, 0 to 215" in out and "flow" in out
    assert main(["info", particles, "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert facts["particles"] == 216 and facts["format"] == "NumPy archive"
    assert facts["bounds"]["lo"] == [0, 0, 0]
    assert facts["spacing"] == pytest.approx(1 / 6, rel=0.02)
    assert facts["attributes"]["speed"] == {
        "dtype": "float64", "shape": [216], "min": 0, "max": 215, "nan": 0, "inf": 0
    }


def test_info_of_troubled_particles(capsys):
    positions = np.array([[0, 0, 0], [1, np.nan, 0], [np.inf, 0, 0]])
    values = np.array([np.nan, np.nan, np.nan])
    gb.write("a.npz", gb.Particles(positions, attributes={"v": values}))
    gb.write("none.npz", gb.Particles(np.zeros((0, 3))))
    assert main(["info", "a.npz", "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert facts["not_finite"] == 2 and facts["spacing"] is None
    assert facts["fields"]["positions"]["nan"] == facts["fields"]["positions"]["inf"] == 1
    assert facts["attributes"]["v"]["min"] is None and facts["attributes"]["v"]["nan"] == 3
    for file in ("a.npz", "none.npz"):
        assert main(["info", file]) == 0
        assert "particles" in capsys.readouterr().out


def test_convert_says_what_is_lost(folder, capsys):
    p = cube(2, support=0.5, color=(1, 0, 0))
    gb.write("a.npz", gb.Particles(
        p.positions, support=0.5, color=(1, 0, 0), attributes={"t": np.arange(8.0)}
    ))
    lost = {
        "b.vtk": [], "b.ply": [], "b.csv": [], "b.npz": [],
        "b.txt": ["support", "t"], "b.npy": ["support", "color", "t"], "b.bgeo": ["t"],
    }
    for output, names in lost.items():
        assert main(["convert", "a.npz", output]) == 0
        out, err = capsys.readouterr()
        assert out == f"{output}: 8 particles\n"
        assert [line.split()[2] for line in err.splitlines()] == names
        assert (gb.read(output).positions == p.positions).all()


def test_convert_mistakes(particles, capsys):
    assert ".npz" in refused(capsys, "convert", particles, "a.obj")
    assert "nowhere" in refused(capsys, "convert", particles, "nowhere/a.ply")
    gb.write("nan.npz", gb.Particles([[np.nan, 0, 0]]))
    assert "finite" in refused(capsys, "convert", "nan.npz", "a.txt")


def test_demo_and_what_it_says_to_type_next(folder):
    start = time.perf_counter()
    done = run("demo")
    assert done.returncode == 0, done.stderr
    assert time.perf_counter() - start < 60  # hangs and the like; speed is bench's business
    assert done.stdout.startswith("demo/splash.png") and done.stderr == ""
    assert Image.open("demo/splash.png").size == (1024, 782)
    following = [line.strip() for line in done.stdout.splitlines() if line.startswith("  ")]
    assert len(following) == 4
    for line in following:
        subprocess.run(line, shell=True, check=True, stdout=subprocess.DEVNULL, timeout=100)
    assert sorted(os.listdir("demo")) == ["near.png", "splash.npz", "splash.png", "water.png"]


def test_demo_mistakes(folder, capsys):
    (folder / "file").write_text("")
    assert "file" in refused(capsys, "demo", "-o", "file")
    refused(capsys, "demo", "--device", "tpu")


@pytest.mark.parametrize("module", COMMANDS, ids=lambda m: m.__name__.rpartition(".")[2])
def test_examples_in_the_help_work(module, folder, capsys, monkeypatch):
    monkeypatch.setattr("globule.bench.ultrasound.CYLINDER_METHODS", ("pvn-om",))  # the fast one
    for name in ("splash.npz", "frame_0.ply", "frame_1.ply"):
        gb.write(name, cube())
    if has_itk := find_spec("SimpleITK") is not None:
        volume(folder / "head.nii.gz")
    example_files()
    name = module.__name__.rpartition(".")[2]
    assert main([name, "--help"]) == 0
    shown = capsys.readouterr().out
    examples = [line.split() for line in module.EXAMPLES.splitlines()]
    assert examples
    for words in examples:
        assert " ".join(words) in shown
        assert words[:2] == ["globule", name]
        if has_itk or "head.nii.gz" not in words:
            assert main(words[1:]) == 0


def test_help_and_version(capsys):
    assert main(["--help"]) == 0
    assert "example" in capsys.readouterr().out
    assert main(["--version"]) == 0
    assert capsys.readouterr().out == f"globule {gb.__version__}\n"
