"""Frames over OpenIGTLink: as a sweep, as a volume that grows, recorded, and after a crash."""

import os
import signal
import socket
import subprocess
import sys
import threading
from pathlib import Path

import globule as gb
import numpy as np
import pytest
from cli_helpers import refuses, run_json
from globule.cli import main
from globule.cli.live import pressed_once
from globule.formats.sweeps import igs
from globule.ultrasound.live import receive, receive_sweep
from globule.ultrasound.matching import LiveFrame
from globule.ultrasound.recorder import Recorder
from globule.volumes.files import read_volume
from live_helpers import GROWS, LIVE, Server, arrived, igtl, served
from PIL import Image
from sweep_helpers import small_sweep, spine_data
from waiting import PATIENCE, until

pytestmark = pytest.mark.usefixtures("folder", "clock")


class Redrawn:
    """Holds a server back after some of its frames until a picture is drawn anew."""

    def __init__(self, name: str, after: tuple[int, ...]):
        self.path, self.after, self.before = Path(name).absolute(), after, 0

    def __call__(self, n: int) -> None:
        if n not in self.after:
            return

        def drawn() -> bool:
            now = self.path.stat().st_mtime_ns if self.path.exists() else 0
            known, self.before = self.before, max(now, self.before)
            return now > known

        until(drawn, f"for {self.path.name} to be drawn")


def test_live_with_transforms_and_with_embedded_poses():
    made = small_sweep(20)
    for embedded in (False, True):
        assert arrived(receive_sweep(served(made, embedded=embedded), idle=0.4), made)


def test_the_real_sweep_replayed(capsys):
    """As PLUS sends it: probe and reference as the tracker sees them, calibration from the XML."""
    path, plus = (spine_data() / name for name in ("SpinePhantomFreehand.igs.mha", "NNMEAN.xml"))
    sweep, recording = gb.ultrasound.read_sweep(path, plus=plus), igs.read(path)

    def replay() -> str:
        server = Server(sweep)
        for i, messages in enumerate(server.messages):
            for names in (("Probe", "Tracker"), ("Reference", "Tracker")):
                messages.append(igtl.TransformMessage(
                    recording.edges[names].matrices[i], device_name=f"{names[0]}To{names[1]}",
                    timestamp=1000 + float(sweep.timestamps[i])).pack())  # fmt: skip
            del messages[1]  # the pose that the image would have by itself
        server.serve(slice(None))
        return server.address

    live = receive_sweep(replay(), plus=plus, idle=1.0)
    assert np.array_equal(live.frames, sweep.frames)
    assert live.world == "Reference"
    assert np.allclose(live.world_from_image, sweep.world_from_image, rtol=1e-5, atol=1e-3)
    words = ["--plus", str(plus), "--method", "pvn-om", "--voxel-size", "0.5", "--device", "cpu"]
    words += ["--live", replay(), "--idle", "1", "-o", "v.npz"]
    facts = run_json(capsys, "reconstruct", *words)
    assert facts["frames"]["used"] == 21
    assert facts["live"]["grew"]
    file = gb.ultrasound.reconstruct(sweep, spacing=0.5, device="cpu")
    assert facts["counts"]["measured"] == pytest.approx(file.n_measured, rel=0.02)


def test_a_restarted_stream_loses_nothing():
    made = small_sweep(30)
    address = served(made, slice(0, 11), slice(11, 12), slice(12, None))
    assert arrived(receive_sweep(address, idle=0.6), made)


def test_live_waits_for_the_better_world():
    made = small_sweep(6)
    address = served(made, names=("ImageToTracker", "StylusToTracker", "ReferenceToTracker"))
    frames = list(receive(address, {}, idle=0.4))
    assert [frame.world for frame in frames] == ["Reference"] * 6
    # All three are the same matrix here, so that Reference is Image.
    assert np.allclose(frames[3].world_from_image, np.eye(4), atol=1e-4)


def test_live_reconstruct(sweep, capsys):
    facts = run_json(capsys, *GROWS, "--live", served(sweep), "-o", "v.npz", "--maps")
    assert facts["frames"]["used"] == 24
    assert facts["live"]["grew"]
    live = read_volume("v.npz")
    low, high = sweep.bounds()
    first = live.world_from_voxel[:3, 3]
    assert (first - 0.51 <= low).all()
    assert (first + live.values.shape[::-1] - 0.49 >= high).all()
    assert 50 < live.values[live.measured].mean() < 130
    assert live.count.sum() == sweep.frames.size
    assert live.source.max() == len(sweep) - 1
    assert live.variance.max() > 0
    # Without a spacing the frames are collected first, and the file's volume comes out.
    words = ["-o", "v.npz", "--voxels", "40"]
    assert not run_json(capsys, *LIVE, "--live", served(sweep), *words)["live"]["grew"]
    assert main(["reconstruct", "phantom.igs.mha", "-o", "w.npz", "--voxels", "40", "--device", "cpu"]) == 0
    live, file = read_volume("v.npz"), read_volume("w.npz")
    assert live.values.shape == file.values.shape
    # Poses in float32 move a pixel in a thousand to the next voxel.
    assert (live.values != file.values).mean() < 0.02


@pytest.mark.slow
def test_a_killed_run_goes_on_with_all_that_it_recorded(sweep, capsys):
    """SIGKILL in the middle of a stream; the server then starts again a few frames back."""
    server = Server(sweep)
    killed = threading.Event()
    server.serve(slice(None), between=lambda n: n < 12 or killed.wait(PATIENCE))
    first = [*GROWS, "--idle", str(PATIENCE), "--live", server.address, "-o", "v.npz"]
    first += ["--record", "kept"]
    process = subprocess.Popen([sys.executable, "-m", "globule", *first], stderr=subprocess.PIPE)
    table = Path("kept/poses.csv")
    try:
        until(
            lambda: process.poll() is not None or (table.is_file() and table.read_bytes().count(b"\n") > 6),
            "for frames on the disk",
        )
    finally:
        process.send_signal(signal.SIGKILL)
        process.communicate()
        killed.set()
    n = table.read_bytes().count(b"\n") - 1
    assert 6 <= n < 24
    assert not Path("v.npz").exists()
    words = [*GROWS, "--live", served(sweep, slice(n - 3, None)), "-o", "v.npz"]
    facts = run_json(capsys, *words, "--record", "kept")
    assert facts["frames"]["used"] == 24
    assert facts["live"]["grew"]
    assert facts["live"]["recorded"] == 24
    # The same as of a stream that was never cut.
    run_json(capsys, *GROWS, "--live", served(sweep), "-o", "w.npz")
    assert np.array_equal(read_volume("v.npz").values, read_volume("w.npz").values)
    again = gb.ultrasound.read_sweep("kept")
    assert np.array_equal(again.frames, sweep.frames)
    assert np.allclose(again.world_from_image, sweep.world_from_image, rtol=1e-5, atol=1e-4)


def test_a_recording_that_was_cut_anywhere():
    poses = np.diag([0.5, 0.5, 1, 1]) + np.arange(5)[:, None, None] / 64
    poses[:, 3] = 0, 0, 0, 1
    images = np.random.default_rng(0).integers(0, 65536, (5, 4, 6)).astype(np.uint16)
    frames = [LiveFrame(5.0 - 0.5 * i, images[i], poses[i], "Tracker") for i in range(5)]

    def record() -> int:
        """Record what is left; how many frames were kept before."""
        recorder = Recorder("kept")
        n = len(recorder.kept)
        for frame in frames[n:]:
            recorder.add(frame)
        recorder.close()
        Path("kept/unfinished").touch()  # as a killed run leaves it
        return n

    record()
    table = Path("kept/poses.csv")
    whole = table.read_bytes()
    ends = [i + 1 for i, byte in enumerate(whole) if byte == 10]
    for size in range(0, len(whole) + 1, 37):
        table.write_bytes(whole[:size])
        Path("kept/frame_000005.part").write_bytes(b"cut")
        assert record() == max(sum(end <= size for end in ends) - 1, 0)
        assert table.read_bytes() == whole
    for ours, theirs in zip((again := Recorder("kept")).kept, frames, strict=True):
        assert (ours.time, ours.world, ours.image.dtype) == (theirs.time, theirs.world, theirs.image.dtype)
        assert np.array_equal(ours.image, theirs.image)
        assert np.array_equal(ours.world_from_image, theirs.world_from_image)
    # Times that run backwards: frames and rows still belong together.
    with pytest.warns(UserWarning, match="go back at frame 1 and 3 others"):
        kept = gb.ultrasound.read_sweep("kept")
    assert np.array_equal(kept.world_from_image[2], frames[2].world_from_image)
    again.close()
    refuses("finished recording of 5 images", Recorder, "kept")
    assert table.read_bytes() == whole
    Path("kept/frame_000003.png").write_bytes(b"no picture")
    Path("kept/unfinished").touch()
    refuses(r"frame_000003\.png", list, Recorder("kept").kept)
    Path("other").mkdir()
    Path("other/notes.txt").write_text("mine", encoding="utf-8")
    refuses("new folder", Recorder, "other")


@pytest.mark.parametrize(
    ("flag", "after", "refresh"),
    [("--three-view", (8, 14, 20), "0.001"), pytest.param("--surface-image", (12,), "3600", marks=pytest.mark.slow)],
)
def test_an_image_is_drawn_while_frames_come(sweep, capsys, flag, after, refresh):
    address = served(sweep, between=Redrawn("v.png", after))
    words = [*GROWS, "--live", address, "-o", "v.npz", "--refresh", refresh]
    facts = run_json(capsys, *words, flag, "v.png")
    assert facts["live"]["drawn"] >= len(after)
    drawn = np.asarray(Image.open("v.png"))
    assert drawn.max() > 100
    assert (drawn != drawn[0, 0]).any(axis=2).mean() > 0.05
    assert sorted(os.listdir()) == ["phantom.igs.mha", "v.npz", "v.png"]


def test_the_volume_is_written_while_frames_come(sweep, capsys, monkeypatch):
    monkeypatch.setattr("globule.cli.live.AUTOSAVE", 0.0)
    address = served(sweep, between=Redrawn("v.npz", (8, 14, 20)))
    run_json(capsys, *GROWS, "--live", address, "-o", "v.npz")
    once = read_volume("v.npz")
    run_json(capsys, *GROWS, "--live", served(sweep), "-o", "w.npz")
    assert np.array_equal(once.values, read_volume("w.npz").values)


@pytest.mark.parametrize("wrong", [5, 22])
def test_a_long_stream_keeps_its_last_images_only(sweep, capsys, monkeypatch, wrong):
    """The volume is that of all images, without a frame in a wrong place, though most images are gone."""
    sweep.world_from_image[wrong, :3, 3] += 60
    with monkeypatch.context() as small:
        small.setattr("globule.cli.live.HELD", 8 * sweep.frames[0].nbytes)
        small.setattr("globule.cli.live._FEWEST", 8)
        facts = run_json(capsys, *GROWS, "--live", served(sweep), "-o", "v.npz")
    assert facts["frames"]["outliers"] == [wrong]
    assert facts["frames"]["used"] == 23
    assert facts["live"]["let_go"] >= 8
    run_json(capsys, *GROWS, "--live", served(sweep), "-o", "w.npz")
    thinned, whole = read_volume("v.npz"), read_volume("w.npz")
    assert np.array_equal(thinned.world_from_voxel, whole.world_from_voxel)
    assert np.array_equal(thinned.values, whole.values)


def test_a_volume_that_cannot_be_read_while_frames_come(sweep, capsys, monkeypatch):
    """Neither the stream nor the last volume ends by it."""
    monkeypatch.setattr("globule.cli.live.AUTOSAVE", 0.0)
    volume, n = gb.ultrasound.Reconstructor.volume, []

    def fails(reconstructor):
        n.append(1)
        if len(n) < 4:
            raise MemoryError("no memory for a copy") if len(n) % 2 else ValueError("no")
        return volume(reconstructor)

    monkeypatch.setattr(gb.ultrasound.Reconstructor, "volume", fails)
    assert main([*GROWS, "--live", served(sweep), "-o", "v.npz", "--three-view", "v.png", "--refresh", "0.001"]) == 0
    assert "could not be written: no" in capsys.readouterr().err
    assert read_volume("v.npz").values.any()
    assert Path("v.png").exists()


def test_ctrl_c_waits_for_the_end_of_a_frame(sweep):
    """In the middle of a frame locks are held, and files half written."""
    whole = []

    def each(n: int, frame: LiveFrame) -> None:
        if n == 10:
            signal.raise_signal(signal.SIGINT)
        whole.append(n)

    live = receive_sweep(served(sweep), idle=5.0, each=each)
    assert len(live) == 10
    assert whole == list(range(1, 11))


def test_ctrl_c_pressed_twice_counts_once():
    """The second one came while the volume was written, and no volume was there."""
    usual = signal.getsignal(signal.SIGINT)
    with pressed_once():
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)
        signal.raise_signal(signal.SIGINT)
    assert signal.getsignal(signal.SIGINT) is usual


def test_a_jump_that_cannot_fit_leaves_the_frames(sweep, capsys):
    sweep.world_from_image[10, :3, 3] += 1e6
    facts = run_json(capsys, *GROWS, "--live", served(sweep), "-o", "v.npz")
    assert facts["frames"] | {"dtype": 0} == {
        "total": 24, "used": 23, "outliers": [10], "size": [64, 60], "dtype": 0
    }  # fmt: skip


@pytest.mark.parametrize("dtype", [np.uint16, np.float32, np.int16])
def test_images_of_other_types(sweep, capsys, dtype):
    sweep.frames = sweep.frames.astype(dtype) * dtype(3)
    assert main([*GROWS, "--live", served(sweep), "-o", "v.npz", "--record", "kept"]) == 0
    volume = read_volume("v.npz")
    assert volume.values.max() > 400
    err = capsys.readouterr().err
    if dtype == np.int16:  # no type of a volume's: collected, then brought into one
        assert "only collects frames" in err
    assert len([*Path("kept").glob("*.png")]) == (24 if dtype == np.uint16 else 0)
    assert ("let the server send 8-bit images" in err) == (dtype != np.uint16)


def test_a_full_disk_ends_neither_stream_nor_volume(sweep, capsys, monkeypatch):
    add, n = Recorder.add, []

    def full(recorder, frame):
        n.append(1)
        if len(n) > 5:
            raise OSError(28, "No space left on device")
        add(recorder, frame)

    def no_picture(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Recorder, "add", full)
    monkeypatch.setattr("globule.cli.live.draw", no_picture)
    words = [*GROWS, "--live", served(sweep), "-o", "v.npz", "--record", "kept"]
    facts = run_json(capsys, *words, "--three-view", "v.png", "--refresh", "0.001")
    assert facts["frames"]["used"] == 24
    assert facts["live"]["recorded"] == 5
    assert any("No space left on device (after 5 frames)" in line for line in facts["warnings"])
    assert read_volume("v.npz").values.any()
    assert Path("v.png").exists()


def test_the_server_may_start_later(sweep, clock, monkeypatch):
    server = Server(sweep)
    _, port = place = server.socket.getsockname()
    server.socket.close()
    pause, pauses = clock.sleep, []

    def sleep(seconds: float) -> None:
        pause(seconds)
        pauses.append(seconds)
        if len(pauses) == 9:
            server.socket = socket.create_server(place)
            server.serve(slice(None))

    monkeypatch.setattr(clock, "sleep", sleep)
    live = receive_sweep(f"igtl://127.0.0.1:{port}", idle=0.4, wait=PATIENCE)
    assert arrived(live, sweep)
    with pytest.raises(ConnectionError, match="expected a server"):
        list(receive(f"igtl://127.0.0.1:{port}", {}, idle=0.2))
