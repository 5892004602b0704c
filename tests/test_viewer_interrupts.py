"""`globule view` as a process: Ctrl-C ends it, whatever it does."""

import contextlib
import os
import re
import signal
import subprocess
import sys
import threading
from pathlib import Path

import globule as gb
import numpy as np
import pytest
from viewer_helpers import PATIENCE, blob, until

pytest.importorskip("websockets")

from viewer_program import Program


@contextlib.contextmanager
def started(*words: str, **options):
    with subprocess.Popen(
        [sys.executable, "-m", "globule", "view", *words, "--no-browser", "--port", "0"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
        **options,
    ) as process:
        try:
            lines = [process.stdout.readline() for _ in range(3)]
            assert "http://127.0.0.1:" in lines[0]
            assert "ssh -L" in lines[1]
            yield process, lines[0].split()[-1]
        finally:
            process.kill()


def ended(process: subprocess.Popen) -> str:
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=PATIENCE)
    assert process.returncode == 130
    return errors.strip()


def status(process: subprocess.Popen, name: str) -> str:
    if not sys.platform.startswith("linux"):
        pytest.skip("needs /proc")
    try:
        return Path(f"/proc/{process.pid}/{name}").read_text(encoding="utf-8")
    except (FileNotFoundError, ProcessLookupError):
        return ""


@pytest.mark.slow
def test_ctrl_c_keeps_what_is_being_recorded(tmp_path):
    av = pytest.importorskip("av")
    gb.write(tmp_path / "blob.npz", blob(50))
    with started("blob.npz", cwd=tmp_path) as (process, address):
        program = Program(address)
        program.command("Record")
        program.heard("button to stop")
        errors = ended(process)
        program.heard("The recording is")
    (movie,) = tmp_path.glob("movie-*.mp4")
    assert str(movie) in errors
    assert len(errors.splitlines()) <= 3  # one more where the movie's end takes long
    with av.open(str(movie)) as opened:
        assert sum(1 for _ in opened.decode(video=0)) > 0
    assert len(list(tmp_path.iterdir())) == 2


def test_ctrl_c_twice_while_a_simulation_runs():
    with started("cut-block") as (process, address):
        program = Program(address)
        program.ask("play")
        program.heard("**running")
        process.send_signal(signal.SIGINT)
        bit = 1 << (signal.SIGINT - 1)

        def got() -> bool:
            pending = re.search(r"ShdPnd:\s*(\w+)", status(process, "status"))
            return pending is None or not int(pending[1], 16) & bit

        until(got, "for the process to get Ctrl-C")
        assert ended(process) == "globule: interrupted"


@pytest.mark.slow
def test_ctrl_c_ends_slow_pictures_too(tmp_path):
    path, state = tmp_path / "blob.npz", tmp_path / "slow.toml"
    np.savez(path, positions=blob(100_000).positions, support=np.float32(0.1))
    state.write_text("[surface]\nsupport = 100.0\n")  # every ray meets all particles
    with started(str(path), "--state", str(state)) as (process, address):

        def processor_seconds() -> float:
            fields = status(process, "stat").rpartition(")")[2].split()
            return sum(map(int, fields[11:13])) / os.sysconf("SC_CLK_TCK")

        Program(address).heard(lambda message: message.get("controls"))
        begun = processor_seconds()
        until(lambda: processor_seconds() > begun + 0.5, "for a picture to be begun")
        assert ended(process) == "globule: interrupted"


@pytest.mark.slow
def test_a_live_scanner_from_the_command_line(request):
    igtl = pytest.importorskip("pyigtl")
    server = igtl.OpenIGTLinkServer(port=0)
    request.addfinalizer(server.stop)

    def replay() -> None:
        until(server.is_connected)
        frames = np.random.default_rng(2).integers(80, 255, (20, 40, 48)).astype(np.uint8)
        for i, frame in enumerate(frames):
            pose = np.eye(4)
            pose[2, 3] = i
            about = {"timestamp": 1000.0 + i}
            server.send_message(igtl.ImageMessage(frame[None], device_name="Image", **about))
            to_reference = {"device_name": "ImageToReference", **about}
            server.send_message(igtl.TransformMessage(pose, **to_reference))

    threading.Thread(target=replay, daemon=True).start()
    scanner = f"igtl://127.0.0.1:{server.server_address[1]}"
    with started(scanner) as (process, address):
        program = Program(address)
        program.ask("section", "Statistics")
        program.ask("play")
        program.heard("| images | 20 |")
        program.ask("play")  # it stops now
        program.heard("**stopped**")
        program.set("Images", "Undo")
        program.heard("| images | 19 |")
        until(lambda: np.ptp(program.picture().mean(axis=2)) > 60, "for the slices")
        assert ended(process) == "globule: interrupted"
