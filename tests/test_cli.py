"""The command line as a whole: how it ends, and the commands that inform, convert and help."""

import contextlib
import os
import re
import shlex
import signal
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import globule as gb
import numpy as np
import pytest
from cli_helpers import COMMAND, SMALL, cube, output_of, refused, run_json, volume
from globule.cli import COMMANDS, build_parser, convert, info, main, render
from globule.cli.shared import join_negative
from PIL import Image
from sweep_helpers import example_files
from waiting import PATIENCE

pytestmark = pytest.mark.usefixtures("folder")


@pytest.mark.parametrize("words", [["rendre"], ["render"], ["info"], ["convert", "a.ply"]])
def test_mistakes_of_the_command(capsys, words):
    refused(capsys, *words)


def test_no_command_shows_help(capsys):
    assert main([]) == 2
    out, err = capsys.readouterr()
    assert "render" in out
    assert "expected a command" in err


@pytest.mark.parametrize("by", [signal.SIGINT, signal.SIGTERM])
def test_interrupted(particles, folder, by):
    """Ctrl-C in the middle of a large image: no file, no traceback, 130; 143 by SIGTERM."""
    pty = pytest.importorskip("pty")
    gb.write("many.npz", cube(40))
    command = [*COMMAND, "render", "many.npz", "-o", "a.png", "--size", "14000x14000"]
    before = sorted(os.listdir())
    ours, theirs = pty.openpty()
    process = subprocess.Popen(
        [*command, "--device", "cpu"],
        stdout=subprocess.PIPE, stderr=theirs, text=True,
        # In a shell's background it would be ignored.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )  # fmt: skip
    os.close(theirs)
    shown = os.read(ours, 1000)  # the progress bar
    process.send_signal(by)
    out, _ = process.communicate(timeout=PATIENCE)
    with contextlib.suppress(OSError):  # the end
        while more := os.read(ours, 1000):
            shown += more
    os.close(ours)
    assert process.returncode == 128 + by, shown
    assert out == ""
    assert b"0/" in shown or b"1/" in shown, shown
    assert shown.rsplit(b"\033[K")[-1] == b"globule: interrupted\r\n"
    assert sorted(os.listdir()) == before


@pytest.mark.parametrize(("script", "by"), [(False, signal.SIGINT), (True, signal.SIGINT), (True, signal.SIGTERM)])
def test_interrupted_while_it_loads(folder, script, by):
    Path("numpy.py").write_text("import signal\nprint('loading', flush=True)\nsignal.pause()\n", encoding="utf-8")
    # As pip makes it.
    Path("globule").write_text("import sys\nfrom globule.__main__ import main\nsys.exit(main())\n", encoding="utf-8")
    path = os.pathsep.join([os.getcwd(), os.path.dirname(os.path.dirname(gb.__file__))])
    process = subprocess.Popen(
        [sys.executable, "globule", "demo"] if script else [*COMMAND, "demo"],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        env={**os.environ, "PYTHONPATH": path},
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )  # fmt: skip
    assert process.stdout.readline() == "loading\n"
    process.send_signal(by)
    out, err = process.communicate(timeout=PATIENCE)
    assert (process.returncode, out, err) == (128 + by, "", "globule: interrupted\n")


@pytest.mark.slow
def test_closed_pipe(particles):
    process = subprocess.Popen([*COMMAND, "info", particles], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    process.stdout.close()
    assert process.wait(timeout=PATIENCE) == 1
    assert process.stderr.read() == ""
    process.stderr.close()


@pytest.mark.parametrize(
    ("error", "status", "line"),
    [
        (MemoryError(), 1, "globule: error: not enough memory\n"),
        (KeyError("inside"), 1, "globule: error: 'inside'\n"),
        (OSError(28, "No space left on device", "a.png"), 1, "globule: error: a.png: No space left on device\n"),
        (KeyboardInterrupt(), 130, "globule: interrupted\n"),
    ],
)
def test_other_errors_take_one_line(particles, capsys, monkeypatch, error, status, line):
    def fail(*_, **__):
        raise error

    monkeypatch.setattr("globule.cli.image.render", fail)
    assert main(["render", particles, "-o", "a.png"]) == status
    assert capsys.readouterr() == ("", line)
    assert not os.path.exists("a.png")
    if status == 1:
        monkeypatch.setenv("GLOBULE_TRACEBACK", "1")
        assert main(["render", particles, "-o", "a.png"]) == status
        assert "Traceback" in capsys.readouterr().err


def test_a_file_that_finds_no_room_is_named(folder):
    import resource

    gb.write("many.npz", cube(20, color=np.random.default_rng(1).random((8000, 3))))
    commands = {
        "a.vtp": "convert many.npz a.vtp",
        "a.png": "render many.npz -o a.png --size 200x200",
        "out/frame_00000.vtp": "simulate dam-break -o out --seconds 0.05 --spacing 0.1",
    }
    code = "import sys\nsys.dont_write_bytecode = True  # half of it would stay\n"
    code += "from globule.cli import main\n"
    code += "print(*[main(words.split()) for words in sys.argv[1:]])"
    ended = subprocess.run(
        [sys.executable, "-c", code, *commands.values()], capture_output=True, text=True,
        timeout=PATIENCE, preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (999, 999)),
    )  # fmt: skip
    assert ended.stdout.split() == ["1"] * 3
    said = ended.stderr.splitlines()
    assert said == [f"globule: error: {name}: File too large" for name in commands]
    assert not [file for _, _, files in os.walk(".") for file in files if file != "many.npz"]


def test_info(particles, capsys):
    out = output_of(capsys, "info", particles).out
    assert "216" in out
    assert "speed: float64 216, 0 to 215" in out
    assert "flow" in out
    facts = run_json(capsys, "info", particles)
    assert {"particles": 216, "format": "NumPy archive", "surface": "smooth"}.items() <= facts.items()
    assert facts["bounds"]["lo"] == [0, 0, 0]
    assert facts["spacing"] == pytest.approx(1 / 6, rel=0.02)
    assert facts["default_support"] == pytest.approx(2.25 * facts["spacing"])  # as render says
    speed = {"dtype": "float64", "shape": [216], "min": 0, "max": 215, "nan": 0, "inf": 0}
    assert facts["attributes"]["speed"] == speed


def test_info_of_troubled_particles(capsys):
    positions = np.array([[0, 0, 0], [1, np.nan, 0], [np.inf, 0, 0]])
    values = np.array([np.nan, np.nan, np.nan])
    gb.write("a.npz", gb.Particles(positions, attributes={"v": values}))
    gb.write("none.npz", gb.Particles(np.zeros((0, 3))))
    facts = run_json(capsys, "info", "a.npz")
    assert facts["not_finite"] == 2
    assert facts["spacing"] is None
    assert facts["fields"]["positions"]["nan"] == facts["fields"]["positions"]["inf"] == 1
    assert facts["attributes"]["v"]["min"] is None
    assert facts["attributes"]["v"]["nan"] == 3
    for file in ("a.npz", "none.npz"):
        assert "particles" in output_of(capsys, "info", file).out


def test_convert_says_what_is_lost(folder, capsys):
    p = cube(2, support=0.5, color=(1, 0, 0), attributes={"t": np.arange(8.0)})
    gb.write("a.npz", p)
    lost = {
        "b.vtk": [],
        "b.ply": [],
        "b.csv": [],
        "b.npz": [],
        "b.txt": ["support", "t"],
        "b.npy": ["support", "color", "t"],
        "b.bgeo": ["t"],
    }
    for output, names in lost.items():
        out, err = output_of(capsys, "convert", "a.npz", output)
        assert out == f"{output}: 8 particles\n"
        assert [line.split()[2] for line in err.splitlines()] == names
        assert (gb.read(output).positions == p.positions).all()


def test_convert_mistakes(particles, capsys):
    assert ".npz" in refused(capsys, "convert", particles, "a.obj")
    assert "nowhere" in refused(capsys, "convert", particles, "nowhere/a.ply")
    gb.write("nan.npz", gb.Particles([[np.nan, 0, 0]]))
    assert "finite" in refused(capsys, "convert", "nan.npz", "a.txt")


def test_demo_and_what_it_says_to_type_next(folder, capsys, monkeypatch):
    monkeypatch.setattr("globule.cli.demo.SIZE", (128, 98))
    out, err = output_of(capsys, "demo")
    assert out.startswith("demo/splash.png: 128x98 pixels")
    assert err == ""
    assert Image.open("demo/splash.png").size == (128, 98)
    following = [shlex.split(line) for line in out.splitlines() if line.startswith("  ")]
    assert len(following) == 4
    for words in following:
        at = words.index("globule") + 1
        small = SMALL if "-o" in words else []
        assert words[:at] == COMMAND
        assert main([*words[at:], *small]) == 0
    assert sorted(os.listdir("demo")) == ["near.png", "splash.npz", "splash.png", "water.png"]
    speed = gb.read("demo/splash.npz").attributes["speed"]  # that of the pages that color by it
    assert speed.max() == pytest.approx(5.888, abs=1e-3)  # m/s


def test_examples_in_the_help_are_commands(capsys):
    names = [module.__name__.rpartition(".")[2] for module in COMMANDS]
    for name in names:
        shown = output_of(capsys, name, "--help-all").out
        lines = re.findall(r"^  globule (.*)$", shown, re.MULTILINE)
        assert lines
        for line in lines:
            assert line.startswith(name)
            build_parser().parse_args(join_negative(line.split()))


# What is added to an example that writes files: the property is that it works.
CHEAP = {"render": ["--size", "40x30"], "simulate": ["--size", "40x30", "--spacing", "0.1"]}


QUICK = (convert, info, render)  # the others run in `make test-all`
HAS_ITK = find_spec("SimpleITK") is not None


@pytest.fixture(scope="module")
def examples(tmp_path_factory):
    """A folder with the files that examples name."""
    path = tmp_path_factory.mktemp("examples")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(path)
        for name in ("splash.npz", "frame_0.ply", "frame_1.ply", "before.vtk", "after.vtk"):
            gb.write(name, cube(attributes={"speed": np.arange(216.0)}))
        if HAS_ITK:
            volume("head.nii.gz")
        example_files()
        (path / "view.toml").write_text("[surface]\nthreshold = 0.7\n[quality]\nsamples = 1\n")
    return path


@pytest.mark.parametrize(
    "module",
    [pytest.param(m, marks=() if m in QUICK else pytest.mark.slow) for m in COMMANDS],
    ids=lambda m: m.__name__.rpartition(".")[2],
)
def test_examples_in_the_help_work(module, examples, monkeypatch):
    monkeypatch.chdir(examples)
    name = module.__name__.rpartition(".")[2]
    if name in ("view", "simulate"):  # pages would go on until Ctrl-C
        pytest.importorskip("websockets")
        monkeypatch.setattr("globule.viewer.app.Viewer.wait", lambda viewer: viewer.close())
        monkeypatch.setattr("globule.viewer.app.Viewer.open_browser", lambda viewer: None)
        # The start page, where somebody chooses at once.
        monkeypatch.setattr("globule.viewer.start.Start.wait", lambda start: start._open("splash.npz"))
        monkeypatch.setattr("webbrowser.open", lambda address: True)
    for words in map(str.split, module.EXAMPLES.splitlines()):
        assert words[:2] == ["globule", name]
        if HAS_ITK or "head.nii.gz" not in words:
            more = CHEAP.get(name, []) if "-o" in words and "--pick" not in words else []
            assert main([*words[1:], *more]) == 0


def test_help_and_version(capsys):
    shown = output_of(capsys, "--help").out
    titles = ["everyone", "simulation", "tracked ultrasound", "to try it out"]
    places = [shown.index(f"{word}:\n") for word in titles]
    assert places == sorted(places)
    for name, title in (("info", 0), ("simulate", 1), ("calibrate", 2), ("demo", 3)):
        assert places[title] < shown.index(f"\n  {name} ") < [*places, 9999][title + 1]
    assert output_of(capsys, "--version").out == f"globule {gb.__version__}\n"


def test_a_place_that_cannot_be_written_is_refused_before_the_work(particles, capsys):
    for words in (
        ["render", "cube.npz", "-o", "/proc/a.png"],
        ["convert", "cube.npz", "/proc/a.ply"],
        ["reconstruct", "cube.npz", "-o", "/proc/a.nrrd"],
        ["reconstruct", "--live", "igtl://h:1", "-o", "a.nrrd", "--record", "/proc/a"],
        ["calibrate", "cube.npz", "-o", "/proc/a.toml"],
        ["simulate", "dam-break", "-o", "/proc/a"],
        ["simulate", "dam-break", "--images", "cube.npz"],
        ["demo", "-o", "/proc/a/b"],
        ["demo", "-o", "cube.npz"],
    ):
        said = refused(capsys, *words)
        expected = "expected a folder" if words[-1] == "cube.npz" else "expected a place"
        assert expected in said
        assert words[-1] in said


def test_what_is_too_long_is_refused_in_a_short_line(particles, capsys):
    for words, problem in (
        (["render", "cube.npz", "-o", f"{'a' * 300}.png"], "-o: expected a shorter name, got 304 letters"),
        (["convert", "cube.npz", f"{'a' * 300}.ply"], "OUT: expected a shorter name, got 304 letters"),
        (["info", "cube.npz", "--columns", "a" * 9000], "expected x=NAME,y=NAME,z=NAME, got 'aaa"),
    ):
        said = refused(capsys, *words)
        assert problem in said
        assert len(said) < 700
