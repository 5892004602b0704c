"""Runs of scenes: files, checkpoints, records, and what stops a run."""

from __future__ import annotations

import csv
import json
import os
import signal
import subprocess
import sys
import time

import globule as gb
import numpy as np
import pytest
from globule.cli import build_parser, main, simulate
from globule.sim import diagnostics

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
    monkeypatch.chdir(tmp_path)
    (tmp_path / "dam.toml").write_text(TOML)
    (tmp_path / "long.toml").write_text(TOML.replace("seconds = 0.3", "seconds = 1e30"))
    return tmp_path


def run(*words):
    assert main(["simulate", *map(str, words), "--device", "cpu"]) == 0


def test_frames_are_read_again_in_every_format(folder, capsys):
    for kind in ("vtp", "bgeo", "npz", "txt"):
        run("dam.toml", "-o", kind, "--format", kind, "--seconds", 0.1)
    files = sorted(os.listdir("vtp"))
    assert files[-3:] == [f"frame_{k:05d}.vtp" for k in range(3)]
    assert "checkpoint.npz" in files
    last = [gb.read(f"{kind}/frame_00002.{kind}") for kind in ("vtp", "bgeo", "npz", "txt")]
    for particles in last:
        assert len(particles) == 8**3  # no boundaries
        assert np.allclose(particles.positions, last[0].positions, atol=1e-6)
    assert last[0].attributes["velocity"].shape == (512, 3)


def test_restart_is_bit_identical(folder, capsys):
    run("dam.toml", "-o", "whole", "--json")
    whole = json.loads(capsys.readouterr().out)
    run("dam.toml", "-o", "parts", "--seconds", 0.13, "--threads", 1)
    run("dam.toml", "-o", "parts", "--seconds", 0.2, "--resume")
    capsys.readouterr()
    run("dam.toml", "-o", "parts", "--resume", "--json")
    parts = json.loads(capsys.readouterr().out)
    assert parts["steps"] == whole["steps"] == whole["new_steps"] > parts["new_steps"] > 0
    assert parts["hash"] == whole["hash"]
    assert parts["time"] == pytest.approx(0.3)
    for k in range(7):
        a, b = (gb.read(f"{f}/frame_{k:05d}.vtp").positions for f in ("whole", "parts"))
        assert (a == b).all()
    rows = list(csv.DictReader(open("parts/diagnostics.csv")))
    assert [row["step"] for row in rows] == [str(i + 1) for i in range(len(rows))]
    assert rows == list(csv.DictReader(open("whole/diagnostics.csv")))


def interrupted(awaited, *words, by=signal.SIGINT):
    """A run that gets Ctrl-C or another signal once a file is there."""
    words = [sys.executable, "-m", "globule", "simulate", *words, "--device", "cpu"]
    process = subprocess.Popen(words, stderr=subprocess.PIPE, text=True)
    limit = time.monotonic() + 60
    while not os.path.exists(awaited) and time.monotonic() < limit:
        time.sleep(0.02)
    process.send_signal(by)
    _, said = process.communicate(timeout=60)
    assert process.returncode == 128 + by
    assert said.endswith("globule: interrupted\n")
    assert "--resume goes on from" in said


@pytest.mark.parametrize("by", [signal.SIGINT, signal.SIGTERM])
def test_ctrl_c_leaves_whole_files_and_a_checkpoint(folder, by):
    interrupted("frames/frame_00004.vtp", "dam.toml", "--seconds", "1000", by=by)
    assert not [name for name in os.listdir("frames") if name.endswith(".tmp")]
    sim = gb.Simulation.load("frames/checkpoint.npz", device="cpu")
    assert sim.time > 0.15
    assert len(gb.read("frames/frame_00004.vtp")) == 512


FALLING = """\
spacing = 0.05
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


@pytest.mark.parametrize(
    "scene", [FALLING, FALLING + "speeds = [0, 3]\n", LATE], ids=["light", "speeds", "empty"]
)
def test_pictures_after_a_restart_are_those_of_one_run(folder, scene):
    """Camera, light and ground are found with the first picture, which a resumed run has not."""
    (folder / "drop.toml").write_text(scene)
    small = ["--size", "96x72"]
    run("drop.toml", "-o", "whole", "--pictures", "whole", *small)
    interrupted(
        "parts/00003.png",
        "drop.toml",
        "-o",
        "parts",
        "--pictures",
        "parts",
        *small,
        "--seconds",
        "2",
    )
    run("drop.toml", "-o", "parts", "--pictures", "parts", "--resume", *small)
    names = [f"{k:05d}.png" for k in range(9)] + [f"frame_{k:05d}.vtp" for k in range(9)]
    for name in names:
        a, b = (open(f"{part}/{name}", "rb").read() for part in ("whole", "parts"))
        assert a == b, name
    assert len({open(f"whole/{name}", "rb").read() for name in names[:9]}) > 6


def test_a_scene_without_particles_is_an_empty_picture(folder):
    sim = gb.Simulation(SCENE, device="cpu")
    assert len(sim.scene) == len(sim) == len(sim.particles) > 512
    sim.remove(sim.ids)
    assert len(sim.scene) == 0
    frame = gb.render(sim.scene, gb.Camera((0, 0, 5), (0, 0, 0)), (32, 24))
    assert not frame.mask.any()


def test_diagnostics_add_up():
    sim = gb.Simulation(SCENE, device="cpu")
    first = sim.measure()
    sim.advance(0.1)
    later = sim.measure()
    mass = 512 * 1000 * 0.05**3
    assert first["kinetic"] == 0
    assert first["potential"] == pytest.approx(mass * 9.81 * 0.2, rel=1e-3)
    assert later["potential"] < first["potential"]
    gain = first["potential"] - later["potential"]
    assert 0.5 * gain < later["kinetic"] <= 1.02 * gain
    assert sim.diagnostics[-1]["kinetic"] == later["kinetic"]
    times = [row["time"] for row in sim.diagnostics]
    assert times == sorted(times)
    assert times[-1] == pytest.approx(0.1)


def test_reset_starts_again():
    sim = gb.Simulation(SCENE, device="cpu")
    start = sim.hash()
    sim.advance(0.05)
    end = sim.hash()
    sim.reset()
    assert sim.hash() == start
    assert sim.time == 0
    assert sim.diagnostics == []
    sim.advance(0.05)
    assert sim.hash() == end


def test_a_dict_a_file_and_a_name_are_the_same_scene(folder):
    hashes = {gb.Simulation(scene, device="cpu").hash() for scene in (SCENE, "dam.toml")}
    assert len(hashes) == 1
    coarse = gb.Simulation("dam-break", device="cpu", spacing=0.1)
    assert coarse.counts["fluid"] == 4 * 4 * 6


def test_a_nan_stops_with_the_particles_story(folder, capsys):
    sim = gb.Simulation(SCENE, device="cpu")
    velocities = sim._read("velocity")
    velocities[np.flatnonzero(sim._read("phase") == list(sim.phases).index("water"))[7]] = np.nan
    sim._write("velocity", velocities)  # assigning them is refused
    with pytest.raises(ArithmeticError, match=r"particle \d+ \(water\) at \(.*\) .* not a number"):
        sim.advance(0.1)


def test_pictures_and_a_movie(folder, capsys):
    pytest.importorskip("av")
    run("dam.toml", "--no-frames", "--video", "dam.mp4", "--pictures", "p", "--size", "64x48",
        "--seconds", 0.1)  # fmt: skip
    assert sorted(os.listdir("p")) == ["00000.png", "00001.png", "00002.png"]
    assert os.path.getsize("dam.mp4") > 1000
    assert not os.path.exists("dam.mp4.frames")
    assert not [name for name in os.listdir("frames") if name.startswith("frame_")]


def movie_pictures(path):
    from globule.formats.pictures.video import read_movie

    return [picture.astype(int) for picture in read_movie(path)]


@pytest.mark.parametrize("more", [[], ["--pictures", "p"]], ids=["decoded", "kept"])
def test_a_finished_movie_goes_on(folder, more):
    pytest.importorskip("av")
    video = ["--video", "dam.mp4", "--size", "65x48", *more]
    run("dam.toml", "--video", "whole.mp4", "--size", "65x48", "--seconds", 0.2)
    run("dam.toml", "-o", "out", "--seconds", 0.1, *video)
    before = open("dam.mp4", "rb").read()
    run("dam.toml", "-o", "out", "--seconds", 0.1, "--resume", *video)
    assert open("dam.mp4", "rb").read() == before
    os.makedirs("dam.mp4.frames")
    run("dam.toml", "-o", "out", "--seconds", 0.2, "--resume", *video)
    assert not os.path.exists("dam.mp4.frames")
    whole, parts = movie_pictures("whole.mp4"), movie_pictures("dam.mp4")
    assert len(whole) == len(parts) == 5
    assert max(np.abs(a - b).mean() for a, b in zip(whole, parts, strict=True)) < 2
    assert np.abs(whole[0] - whole[4]).mean() > 4


def test_a_movie_without_its_first_pictures_is_refused_before_the_work(folder, capsys):
    pytest.importorskip("av")
    run("dam.toml", "-o", "out", "--seconds", 0.1)
    before = sorted(os.listdir("out"))
    capsys.readouterr()
    words = ["simulate", "dam.toml", "-o", "out", "--resume", "--video", "late.mp4"]
    assert main([*words, "--device", "cpu"]) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert "--video: expected the run's first 3 images of 640x480 in late.mp4" in said
    assert "globule render 'out/frame_*.vtp' -o late.mp4" in said
    assert sorted(os.listdir("out")) == before
    assert not os.path.exists("late.mp4.frames")


def test_curves_are_drawn(tmp_path):
    pytest.importorskip("matplotlib")
    rows = [{"time": t, "dt": 0.1, "compression": 0.001 * t} for t in range(5)]
    rows[4]["kinetic"] = 2.0
    assert diagnostics.plot(tmp_path / "d.png", rows)
    assert (tmp_path / "d.png").read_bytes()[:4] == b"\x89PNG"


def test_a_curve_of_one_point_is_seen(tmp_path):
    pytest.importorskip("matplotlib")
    from PIL import Image

    def colored(name, rows):
        diagnostics.plot(tmp_path / name, rows)
        picture = np.asarray(Image.open(tmp_path / name).convert("RGB")).astype(int)
        return (np.ptp(picture, axis=2) > 60).sum()

    assert colored("none.png", [{"time": 0.1, "dt": 0.0}]) == 0
    assert colored("one.png", [{"time": 0.1, "dt": 0.1}]) > 10


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["nowhere.toml"], "expected a .toml file or one of dam-break"),
        (["dam.toml", "--resume"], "--resume: expected frames/checkpoint.npz"),
        (["dam.toml", "--spacing", "9"], "spacing: expected less than half the domain, got 9"),
        (["dam.toml", "--video", "a.avi"], "--video: expected a name ending in .mp4"),
        (["dam.toml", "--format", "xls"], "argument --format"),
        (["dam.toml", "--fps", "1e300"], "--seconds: expected at most 1,000,000 frames"),
        (["long.toml"], "error: long.toml: seconds: expected at most 1,000,000 frames, got 1e+30"),
        (["long.toml", "--seconds", "1e30"], "--seconds: expected at most 1,000,000 frames"),
        (["dam.toml", "--seconds", "0.01"], "seconds: expected at least a frame, 0.05 s, got 0.01"),
        (["dam.toml", "-o", "dam.toml"], "-o: expected a folder, got dam.toml: "),
        (["dam.toml", "-o", "/proc/a/b"], "-o: expected a place that may be written, got /proc/a/"),
        (["dam.toml", "--pictures", "dam.toml"], "--pictures: expected a folder, got dam.toml"),
        (["dam.toml", "--video", "/proc/a.mp4"], "--video: expected a place that may be written"),
    ],
)
def test_mistakes_are_one_line(folder, capsys, words, expected):
    assert main(["simulate", *words]) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert expected in said
    assert not os.path.exists("frames")


def test_a_frame_at_whose_time_one_stops_is_written(folder, capsys):
    words = ["simulate", "dam.toml", "-o", "out", "--seconds", "0.2", "--device", "cpu"]
    job = simulate._Job(build_parser().parse_args(words))
    assert not job.run(lambda: job.sim.time > 2 / 20 - 1e-9)
    assert os.path.exists("out/frame_00002.vtp")
    assert not os.path.exists("out/frame_00003.vtp")
    run(*words[1:-2], "--resume")
    assert sorted(os.listdir("out"))[-5:] == [f"frame_{k:05d}.vtp" for k in range(5)]


@pytest.mark.parametrize(
    ("name", "change", "expected"),
    [
        ("id", lambda a: np.full_like(a, 2**32 - 1), "id: expected each once"),
        ("place", lambda a: a[:-1], "place: expected float32"),
        ("velocity", lambda a: a * np.nan, "velocity: expected finite"),
        ("phase", lambda a: np.full_like(a, 255), "phase: expected numbers below"),
        ("counts", lambda a: np.full_like(a, 2**64 - 1), "counts: expected"),
        ("motion", lambda a: a[:-3], "expected all of the bodies"),
        ("impulse", None, "'impulse' is missing"),
        ("_facts", lambda a: np.frombuffer(b"[1]", np.uint8), "expected a checkpoint"),
    ],
)
def test_a_checkpoint_that_cannot_be_is_refused(folder, capsys, name, change, expected):
    run("dam.toml", "-o", "out", "--seconds", 0.05)
    with np.load("out/checkpoint.npz") as file:
        arrays = dict(file)
    wrong = arrays.pop(name)
    if change:
        arrays[name] = change(wrong)
    np.savez("out/checkpoint.npz", **arrays)
    capsys.readouterr()
    assert main(["simulate", "dam.toml", "-o", "out", "--resume", "--device", "cpu"]) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert "checkpoint.npz" in said
    assert expected in said


def test_resuming_another_scene_is_refused(folder, capsys):
    assert main(["simulate", "dam.toml", "-o", "out", "--seconds", "0.1"]) == 0
    with open("out/checkpoint.npz", "rb") as file:
        before = file.read()
    words = open("dam.toml", encoding="utf-8").read()
    with open("other.toml", "w", encoding="utf-8") as file:
        file.write("gravity = [0, 0, -1]\n" + words)
    capsys.readouterr()
    assert main(["simulate", "other.toml", "-o", "out", "--resume"]) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert "got one with another gravity" in said
    with open("out/checkpoint.npz", "rb") as file:
        assert file.read() == before


@pytest.mark.parametrize(
    ("option", "had", "asked"), [("--fps", "20.0", "40.0"), ("--format", "vtp", "npz")]
)
def test_frames_of_another_number_or_format_do_not_go_on(folder, capsys, option, had, asked):
    run("dam.toml", "-o", "out", "--seconds", 0.1)
    before = sorted(os.listdir("out"))
    capsys.readouterr()
    assert main(["simulate", "dam.toml", "-o", "out", "--resume", option, asked]) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert f"--resume: expected {option} {had}, as the run had, got {asked}" in said
    assert sorted(os.listdir("out")) == before
