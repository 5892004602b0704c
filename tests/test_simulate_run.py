"""Runs of scenes: files, checkpoints, records, and what stops a run."""

import csv
import errno
import json
import os
import re
import signal
import subprocess
import sys
from contextlib import ExitStack
from pathlib import Path

import globule as gb
import numpy as np
import pytest
from cli_helpers import refused
from globule.cli import build_parser, main, simulate
from globule.sim import diagnostics
from globule.sim.pictures import Eye
from globule.viewer.first_view import first_camera
from globule.viewer.simulation_source import SimulationSource
from waiting import PATIENCE, until

SCENE = {
    "spacing": 0.05,
    "domain": {"lo": [0, 0, 0], "hi": [1, 0.4, 0.8], "walls": True},
    "fluids": [{"name": "water", "box": {"lo": [0, 0, 0], "hi": [0.4, 0.4, 0.4]}}],
}
TOML = """\
spacing = 0.05
seconds = 0.3
domain = { lo = [0, 0, 0], hi = [1, 0.4, 0.8], walls = true }
[[fluids]]
name = "water"
box = { lo = [0, 0, 0], hi = [0.4, 0.4, 0.4] }
[output]
fps = 20
"""


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A folder with scenes. Runs in it draw no curves, which take longer than the run."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(diagnostics, "plot", lambda *_: False)
    (tmp_path / "dam.toml").write_text(TOML)
    (tmp_path / "long.toml").write_text(TOML.replace("seconds = 0.3", "seconds = 1e30"))
    return tmp_path


def run(*words):
    assert main(["simulate", *map(str, words), "--device", "cpu"]) == 0


def test_restart_is_bit_identical_and_frames_are_read_in_every_format(folder, capsys):
    run("dam.toml", "-o", "whole", "--json")
    whole = json.loads(capsys.readouterr().out)
    run("dam.toml", "-o", "parts", "--seconds", 0.13, "--threads", 1)
    run("dam.toml", "-o", "parts", "--seconds", 0.2, "--resume")
    capsys.readouterr()
    run("dam.toml", "-o", "parts", "--resume", "--json")
    parts = json.loads(capsys.readouterr().out)
    assert parts["steps"] == whole["steps"] == whole["new_steps"] > parts["new_steps"] > 0
    assert (parts["hash"], parts["time"]) == (whole["hash"], pytest.approx(0.3))
    for k in range(7):
        a, b = (gb.read(f"{f}/frame_{k:05d}.vtp").positions for f in ("whole", "parts"))
        assert (a == b).all()
    rows, others = (
        list(csv.DictReader(Path(f, "diagnostics.csv").read_text(encoding="utf-8").splitlines()))
        for f in ("parts", "whole")
    )
    assert ([row["step"] for row in rows], rows) == ([str(i + 1) for i in range(len(rows))], others)
    last = {}
    for kind in ("vtp", "bgeo", "npz", "txt"):
        run("dam.toml", "-o", kind, "--format", kind, "--seconds", 0.1)
        last[kind] = gb.read(f"{kind}/frame_00002.{kind}")
        assert len(last[kind]) == 8**3  # no boundaries
        assert np.allclose(last[kind].positions, last["vtp"].positions, atol=1e-6)
    files = sorted(os.listdir("vtp"))
    assert files[-3:] == [f"frame_{k:05d}.vtp" for k in range(3)]
    assert "checkpoint.npz" in files
    assert last["vtp"].attributes["velocity"].shape == (512, 3)
    Path("parts/frame_00001.vtp").write_bytes(Path("parts/frame_00001.vtp").read_bytes()[:700])
    Path("parts/frame_00002.vtp").unlink()
    run("dam.toml", "-o", "parts", "--resume")
    assert "parts: frame_00001.vtp, frame_00002.vtp missing or damaged" in capsys.readouterr().err


@pytest.mark.slow
@pytest.mark.parametrize("by", [signal.SIGINT, pytest.param(signal.SIGTERM, marks=pytest.mark.slow)])
def test_ctrl_c_leaves_whole_files_and_a_checkpoint(folder, by):
    words = [sys.executable, "-m", "globule", "simulate", "dam.toml", "--seconds", "1000"]
    process = subprocess.Popen([*words, "--device", "cpu"], stderr=subprocess.PIPE, text=True)
    awaited = "frames/frame_00004.vtp"
    until(lambda: os.path.exists(awaited) or process.poll() is not None)
    process.send_signal(by)
    _, said = process.communicate(timeout=PATIENCE)
    assert process.returncode == 128 + by
    assert said.endswith("globule: interrupted\n")
    assert "--resume continues from" in said
    assert not [name for name in os.listdir("frames") if name.endswith(".tmp")]
    assert gb.Simulation.load("frames/checkpoint.npz", device="cpu").time > 0.15
    assert len(gb.read("frames/frame_00004.vtp")) == 512


FALLING = """\
spacing = 0.05
gravity = [0, 0, -2]
seconds = 0.4
domain = { lo = [0, 0, 0], hi = [1, 1.4, 1.6] }
[[fluids]]
name = "water"
box = { lo = [0, 0.4, 1], hi = [0.4, 0.8, 1.4] }
[output]
fps = 20
[view]
look = "water"
"""
LATE = FALLING.replace(
    "box = { lo = [0, 0.4, 1], hi = [0.4, 0.8, 1.4] }",
    """\
[[emitters]]
name = "tap"
fluid = "water"
center = [0.5, 0.5, 1]
direction = [1, 0, 0]
radius = 0.2
rate = 1.0
start = 0.06""",
)


@pytest.mark.slow
@pytest.mark.parametrize("scene", [FALLING, FALLING + "speeds = [0, 3]\n", LATE], ids=["light", "speeds", "empty"])
def test_pictures_after_a_restart_are_those_of_one_run(folder, scene):
    """Camera, light and ground are found with the first picture, which a resumed run has not."""
    (folder / "drop.toml").write_text(scene)
    small = ["--size", "48x36"]
    run("drop.toml", "-o", "whole", "--images", "whole", *small)
    stopped_at(0.15, "drop.toml", "-o", "parts", "--images", "parts", *small)
    assert not Path("parts/00004.png").exists()
    run("drop.toml", "-o", "parts", "--images", "parts", "--resume", *small)
    images = [f"{k:05d}.png" for k in range(9)]
    for name in (*images, *(f"frame_{k:05d}.vtp" for k in range(9))):
        assert Path("whole", name).read_bytes() == Path("parts", name).read_bytes(), name
    assert len({Path("whole", name).read_bytes() for name in images}) > 6


@pytest.mark.parametrize("up", [(0, 0, 1), (1, 0, 0)])
def test_a_view_without_an_eye_keeps_up_and_fov(up):
    """The camera that is fitted in its place stands in front, a little right and above."""
    sim = gb.Simulation(SCENE | {"view": {"up": up, "fov": 25}}, device="cpu")
    eye = Eye(sim.file, (64, 48))
    assert eye.settled(sim)
    camera = eye._camera
    assert (camera.up, camera.fov) == (up, 25)
    back = np.subtract(camera.eye, camera.look_at)
    assert back @ np.array(up) / np.linalg.norm(back) == pytest.approx(0.45 / 1.25, abs=0.01)
    source = SimulationSource("live", sim)
    live = first_camera(sim.scene, source.up, source.outline(), source.camera, source.fov)
    assert (live.up, live.fov) == (up, 25)


def test_a_scene_without_particles_is_an_empty_picture(folder):
    sim = gb.Simulation(SCENE, device="cpu")
    assert len(sim.scene) == len(sim) == len(sim.particles) > 512
    sim.remove(sim.ids)
    assert len(sim.scene) == 0
    assert not gb.render(sim.scene, gb.Camera((0, 0, 5), (0, 0, 0)), (32, 24)).mask.any()


def movie_pictures(path):
    from globule.formats.pictures.video import read_movie

    return [picture.astype(int) for picture in read_movie(path)]


def test_a_finished_movie_goes_on(folder):
    pytest.importorskip("av")
    size = ["--size", "65x48"]
    run("dam.toml", "--video", "whole.mp4", *size, "--seconds", 0.2)
    whole = movie_pictures("whole.mp4")
    assert len(whole) == 5
    assert np.abs(whole[0] - whole[4]).mean() > 4
    for out, more in (("decoded", []), ("kept", ["--images", "p"])):
        name = f"{out}.mp4"
        video = ["-o", out, "--video", name, *size, *more]
        run("dam.toml", "--seconds", 0.1, *video)
        before = Path(name).read_bytes()
        run("dam.toml", "--seconds", 0.1, "--resume", *video)
        assert Path(name).read_bytes() == before
        os.makedirs(f"{name}.frames")
        run("dam.toml", "--seconds", 0.2, "--resume", *video)
        assert not os.path.exists(f"{name}.frames")
        parts = movie_pictures(name)
        assert max(np.abs(a - b).mean() for a, b in zip(whole, parts, strict=True)) < 2


def test_a_movie_without_its_first_pictures_is_refused_before_the_work(folder, capsys):
    pytest.importorskip("av")
    run("dam.toml", "-o", "out", "--seconds", 0.1)
    before = sorted(os.listdir("out"))
    capsys.readouterr()
    words = ["dam.toml", "-o", "out", "--resume", "--video", "late.mp4", "--device", "cpu"]
    said = refused(capsys, "simulate", *words)
    assert "--video: expected the run's first 3 images of 640x480 in late.mp4" in said
    assert "globule render 'out/frame_*.vtp' -o late.mp4" in said
    assert sorted(os.listdir("out")) == before


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    path = tmp_path_factory.mktemp("run")
    (path / "dam.toml").write_text(TOML)
    run(path / "dam.toml", "-o", path / "out", "--seconds", 0.05)
    return path / "out"


@pytest.mark.slow
def test_curves_are_drawn(finished):
    pytest.importorskip("matplotlib")
    assert (finished / "diagnostics.png").read_bytes()[:4] == b"\x89PNG"


def test_a_curve_of_one_point_is_seen(tmp_path):
    pytest.importorskip("matplotlib")
    from PIL import Image

    def colored(name, rows):
        diagnostics.plot(tmp_path / name, rows)
        picture = np.asarray(Image.open(tmp_path / name).convert("RGB")).astype(int)
        return (np.ptp(picture, axis=2) > 60).sum()

    assert colored("none.png", [{"time": 0.1, "dt": 0.0}]) == 0
    assert colored("one.png", [{"time": 0.1, "dt": 0.1}]) > 10


@pytest.mark.parametrize(("words", "expected"), [
    (["dam.toml", "--resume"], "--resume: expected frames/checkpoint.npz"),
    (["dam.toml", "--spacing", "9"], "spacing: expected less than half the domain, 0.2 m, got 9"),
    (["dam.toml", "--video", "a.avi"], "--video: expected a name ending in .mp4"),
    (["dam.toml", "--fps", "1e6", "--seconds", "2"], "--seconds: expected at most 1,000,000"),
    (["long.toml"], "error: long.toml: seconds: expected at most 1,000,000 frames, got 1e+30"),
    (["long.toml", "--seconds", "1e9"], "--seconds: expected at most 1,000,000 frames"),
    (["dam.toml", "--seconds", "0.01"], "seconds: expected at least a frame, 0.05 s, got 0.01"),
    (["dam.toml", "-o", "dam.toml"], "-o: expected a folder, got dam.toml: "),
    (["dam.toml", "-o", "/proc/a/b"], "-o: expected a place that may be written, got /proc/a/"),
    (["dam.toml", "--images", "dam.toml"], "--images: expected a folder, got dam.toml"),
    (["dam.toml", "--video", "/proc/a.mp4"], "--video: expected a place that may be written"),
])  # fmt: skip
def test_mistakes_are_one_line(folder, capsys, words, expected):
    assert expected in refused(capsys, "simulate", *words)


def stopped_at(seconds, *words):
    with ExitStack() as held:
        job = simulate._Job(build_parser().parse_args(["simulate", *words, "--device", "cpu"]), held)
        assert not job.run(lambda: job.sim.time > seconds - 1e-9)


def test_a_frame_at_whose_time_one_stops_is_written(folder, capsys):
    words = ["dam.toml", "-o", "out", "--seconds", "0.2"]
    stopped_at(2 / 20, *words)
    assert os.path.exists("out/frame_00002.vtp")
    assert not os.path.exists("out/frame_00003.vtp")
    run(*words, "--resume")
    assert sorted(os.listdir("out"))[-5:] == [f"frame_{k:05d}.vtp" for k in range(5)]


@pytest.mark.parametrize(("name", "change", "expected"), [
    ("id", lambda a: np.full_like(a, 2**32 - 1), "id: expected each once"),
    ("place", lambda a: a[:-1], "place: expected float32"),
    ("velocity", lambda a: a * np.nan, "velocity: expected finite"),
    ("phase", lambda a: np.full_like(a, 255), "phase: expected numbers below"),
    ("counts", lambda a: np.full_like(a, 2**64 - 1), "counts: expected"),
    ("motion", lambda a: a[:-3], "expected all of the bodies"), ("growth", None, "'growth' is missing"),
    ("_facts", lambda a: np.frombuffer(b"[1]", np.uint8), "expected a checkpoint"),
])  # fmt: skip
def test_a_checkpoint_that_cannot_be_is_refused(folder, finished, capsys, name, change, expected):
    with np.load(finished / "checkpoint.npz") as file:
        arrays = dict(file)
    wrong = arrays.pop(name)
    if change:
        arrays[name] = change(wrong)
    os.mkdir("out")
    np.savez("out/checkpoint.npz", **arrays)
    said = refused(capsys, "simulate", "dam.toml", "-o", "out", "--resume", "--device", "cpu")
    assert "checkpoint.npz" in said
    assert expected in said


@pytest.mark.parametrize(("scene", "options", "expected"), [
    ("other.toml", [], "got a checkpoint with another gravity"),
    ("dam.toml", ["--fps", "40.0"], "--resume: expected --fps 20.0, .* got 40.0"),
    ("dam.toml", ["--format", "npz"], "--resume: expected --format vtp, .* got npz"),
])  # fmt: skip
def test_another_run_than_before_does_not_go_on(folder, capsys, scene, options, expected):
    (folder / "other.toml").write_text("gravity = [0, 0, -1]\n" + TOML)
    run("dam.toml", "-o", "out", "--seconds", 0.1)
    before = {path.name: path.read_bytes() for path in Path("out").iterdir()}
    capsys.readouterr()
    assert re.search(expected, refused(capsys, "simulate", scene, "-o", "out", "--resume", *options))
    assert {path.name: path.read_bytes() for path in Path("out").iterdir()} == before


def test_progress_is_told_of_every_step_and_diagnostics_add_up():
    sim = gb.Simulation(SCENE | {"seconds": 0.05}, device="cpu")
    told = []
    sim.run(progress=lambda done, total: told.append((done, total)))
    assert (sim.time, len(told), told) == (pytest.approx(0.05), sim.n_steps, sorted(told))
    assert told[-1] == (1000, 1000)
    assert told[0][0] > 0
    assert sim.run() is None  # the scene has ended
    assert sim.run(0.02, stop=lambda: True).step == sim.n_steps == len(told) + 1
    sim = gb.Simulation(SCENE, device="cpu")
    first = sim.record.measure()
    sim.run(0.1)
    later, mass = sim.record.measure(), 512 * 1000 * 0.05**3
    assert first["kinetic"] == 0
    assert first["potential"] == pytest.approx(mass * 9.81 * 0.2, rel=1e-3)
    assert later["potential"] < first["potential"]
    gain = first["potential"] - later["potential"]
    assert 0.5 * gain < later["kinetic"] <= 1.02 * gain
    assert sim.record.diagnostics[-1]["kinetic"] == later["kinetic"]
    times = [row["time"] for row in sim.record.diagnostics]
    assert (times, times[-1]) == (sorted(times), pytest.approx(0.1))


def test_the_log_says_what_was_made_and_saved(tmp_path, caplog, capsys):
    with caplog.at_level("INFO", "globule"):
        gb.Simulation(SCENE, device="cpu").save(tmp_path / "state")
    assert caplog.records[0].message.startswith("Simulation(512 water")
    assert caplog.records[1].message == f"{tmp_path / 'state'}.npz: checkpoint at 0 s"
    assert capsys.readouterr() == ("", "")


def test_tissue_bonded_by_hand_is_not_forgotten_by_reset():
    sim = gb.Simulation(spacing=0.01, domain={"lo": (0, 0, 0), "hi": (0.1, 0.1, 0.1)},
                        solids=[{"name": "jelly"}], device="cpu")  # fmt: skip
    at = np.indices((3, 3, 3)).reshape(3, -1).T * 0.01 + 0.03
    sim.tissue.bond(sim.add(at))
    assert sim.tissue.n_bonds == 126
    with pytest.raises(ValueError, match="reset: expected a scene's own tissue"):
        sim.reset()
    sim.step()
    assert len(sim) == 27


def test_a_folder_is_of_one_run_and_frames_of_a_longer_one_are_named(folder, capsys):
    run("dam.toml", "-o", "out", "--seconds", 0.2)
    assert "earlier run" not in capsys.readouterr().err
    run("dam.toml", "-o", "out", "--seconds", 0.1)
    said = capsys.readouterr().err
    assert "warning: out keeps 2 frames of an earlier run after frame_00002.vtp" in said
    run("dam.toml", "-o", "out", "--seconds", 0.2)
    assert "earlier run" not in capsys.readouterr().err
    pytest.importorskip("fcntl")
    words = [sys.executable, "-m", "globule", "simulate", "long.toml", "-o", "two", "--device"]
    words += ["cpu", "--seconds", "1000"]
    with subprocess.Popen(words, stderr=subprocess.DEVNULL) as first:
        try:
            until(lambda: os.path.exists("two/frame_00001.vtp"))
            said = refused(capsys, "simulate", "dam.toml", "-o", "two", "--spacing", "0.04")
            assert "got two, to which another run writes" in said
        finally:
            first.kill()
    run("dam.toml", "-o", "two", "--seconds", 0.05)  # nothing is left of a run that was killed
    run("dam.toml", "-o", "two", "--seconds", 0.1, "--resume")


@pytest.mark.parametrize(("more", "said"), [
    ([], "cannot use them; delete the folder or run again"),
    (["--checkpoint", "0.05"], "continues from frames/checkpoint.npz"),
])  # fmt: skip
def test_the_first_error_is_said(folder, capsys, monkeypatch, more, said):
    """Of a full disk the frame, not the diagnostics after it; and what stays of the movie."""
    pytest.importorskip("av")
    write = gb.formats.write

    def full(path, *things):
        if not str(path).endswith("4.vtp"):
            return write(path, *things)
        raise OSError(errno.ENOSPC, "No space left on device", path)

    def plot(path, *_):
        raise OSError(errno.ENOSPC, "No space left on device", path)

    monkeypatch.setattr("globule.formats.write", full)
    monkeypatch.setattr(diagnostics, "plot", plot)
    words = ["simulate", "dam.toml", "--video", "v.mp4", "--size", "32x24", "--device", "cpu"]
    assert main([*words, *more]) == 1
    lines = [line for line in capsys.readouterr().err.splitlines() if line.startswith("globule")]
    assert "note: v.mp4.frames keeps 4 images of the movie: " in lines[-2]
    assert lines[-2].endswith(said)
    assert "frame_00004.vtp" in lines[-1]


def test_a_movie_lies_in_the_runs_folder_and_the_terminal_does_not_obey_a_scene(folder, capsys):
    pytest.importorskip("av")
    words = ["dam.toml", "-o", "new", "--seconds", 0.05, "--size", "32x24", "--no-frames"]
    run(*words, "--video", "new/v.mp4")
    assert os.path.getsize("new/v.mp4") > 500
    assert not os.path.exists("new/v.mp4.frames")
    assert not [name for name in os.listdir("new") if name.startswith("frame_")]
    assert main(["simulate", *map(str, words), "--video", "other/v.mp4"]) == 2
    assert "--video: expected an existing folder, got other" in capsys.readouterr().err
    (folder / "odd.toml").write_text('title = "\\u001b[31mred"\n' + TOML)
    run("odd.toml", "-o", "a\x1bb", "--seconds", 0.05)
    out = capsys.readouterr().out
    assert "\x1b" not in out
    assert out.startswith("\\x1b[31mred: ")
    assert "a\\x1bb" in out
    assert main(["simulate", "no\x1b[31m.toml"]) == 2
    assert "\x1b" not in capsys.readouterr().err
