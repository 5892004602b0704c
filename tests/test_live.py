"""Frames over OpenIGTLink: as a sweep, as a volume that grows, recorded, and after a crash."""

import contextlib
import os
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Callable
from pathlib import Path

import globule as gb
import numpy as np
import pytest
from cli_helpers import refuses, run_json
from globule.cli import main
from globule.formats.sweeps import igs
from globule.ultrasound import senders
from globule.ultrasound.calibration import Calibration
from globule.ultrasound.live import LiveCounts, LiveFrame, parse_address, receive, receive_sweep
from globule.ultrasound.recorder import Recorder
from globule.volumes.files import read_volume
from PIL import Image
from sweep_helpers import small_sweep, spine_data
from waiting import PATIENCE, Waits, until

igtl = pytest.importorskip("pyigtl", reason="live needs pyigtl")
from bench.live_damaged import MUTATIONS  # noqa: E402  needs pyigtl

CPU = ["--device", "cpu"]
LIVE = ["reconstruct", "--idle", "0.5", *CPU]
GROWS = [*LIVE, "--voxel-size", "1"]
pytestmark = pytest.mark.usefixtures("folder", "clock")


@pytest.fixture
def clock(monkeypatch):
    """Of the client."""
    monkeypatch.setattr(senders, "time", waits := Waits())
    return waits


class Server:
    """An OpenIGTLink server that replays a sweep, on loopback."""

    def __init__(self, sweep, embedded: bool = False, names=("ImageToReference",)):
        self.messages = []
        for i in range(len(sweep)):
            matrix = sweep.world_from_image[i]
            when = 1000 + float(sweep.timestamps[i])
            place = matrix if embedded else np.eye(4)
            image = igtl.ImageMessage(
                sweep.frames[i][None], ijk_to_world_matrix=place, timestamp=when,
                device_name="Image",
            )  # fmt: skip
            parts = [image]
            if not embedded:
                for name in names:
                    parts.append(igtl.TransformMessage(matrix, timestamp=when, device_name=name))
            self.messages.append([part.pack() for part in parts])
        self.socket = socket.create_server(("127.0.0.1", 0))
        self.address = f"igtl://127.0.0.1:{self.socket.getsockname()[1]}"

    def serve(self, *parts, between: Callable[[int], object] = lambda n: None) -> threading.Thread:
        """Each connection sends its part of the frames and hangs up. between: called with the number sent."""

        def work():
            for part in parts:
                connection, _ = self.socket.accept()
                with connection, contextlib.suppress(OSError):
                    for n, messages in enumerate(self.messages[part], start=1):
                        for message in messages:
                            connection.sendall(message)
                        between(n)
            self.socket.close()

        thread = threading.Thread(target=work, daemon=True)
        thread.start()
        return thread


def served(sweep, *parts: slice, between=lambda n: None, **options) -> str:
    """The address of a server that sends a sweep, or parts of it after each other."""
    server = Server(sweep, **options)
    server.serve(*(parts or (slice(None),)), between=between)
    return server.address


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


def arrived(live, sweep) -> bool:
    """Whether a sweep came over the line: OpenIGTLink's matrices are float32."""
    return (
        np.array_equal(live.frames, sweep.frames)
        and np.allclose(live.world_from_image, sweep.world_from_image, rtol=1e-5, atol=1e-4)
        and np.allclose(np.diff(live.timestamps), np.diff(sweep.timestamps), atol=1e-6)
    )


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
    words = ["--plus", str(plus), "--method", "pvn-om", "--voxel-size", "0.5", *CPU]
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
    assert main(["reconstruct", "phantom.igs.mha", "-o", "w.npz", "--voxels", "40", *CPU]) == 0
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
    for ours, theirs in zip(Recorder("kept").kept, frames, strict=True):
        assert (ours.time, ours.world, ours.image.dtype) == (theirs.time, theirs.world, theirs.image.dtype)
        assert np.array_equal(ours.image, theirs.image)
        assert np.array_equal(ours.world_from_image, theirs.world_from_image)
    # Times that run backwards: frames and rows still belong together.
    with pytest.warns(UserWarning, match="go back at frame 1 and 3 others"):
        kept = gb.ultrasound.read_sweep("kept")
    assert np.array_equal(kept.world_from_image[2], frames[2].world_from_image)
    Path("kept/frame_000003.png").write_bytes(b"no picture")
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


def test_stamps_are_counted_in_a_memory_that_does_not_grow(monkeypatch):
    monkeypatch.setattr("globule.ultrasound.live._STAMPS", 16)
    counts = LiveCounts()
    lost = {7, 40, 41, 99}
    for i in range(200):
        if i not in lost:
            counts.saw(100 + i / 25)
        if i == 150:  # a server that begins again
            for k in range(140, 150):
                counts.saw(100 + k / 25)
    assert counts.missed == len(lost)
    assert len(counts._times._times) < 40
    assert not counts.without_clock


def test_frames_with_a_useless_pose_do_not_end_the_stream(sweep):
    sweep.world_from_image[3] = 0
    sweep.world_from_image[5, :3, 3] = np.nan
    sweep.world_from_image[3, 3, 3] = 1
    live = receive_sweep(served(sweep), idle=0.5)
    assert len(live) == 22
    good = np.delete(np.arange(24), [3, 5])
    assert np.array_equal(live.frames, sweep.frames[good])


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


def test_a_jump_that_cannot_fit_leaves_the_frames(sweep, capsys):
    sweep.world_from_image[10, :3, 3] += 1e6
    facts = run_json(capsys, *GROWS, "--live", served(sweep), "-o", "v.npz")
    assert facts["frames"] | {"dtype": 0} == {
        "total": 24, "used": 23, "outliers": [10], "size": [64, 60], "dtype": 0
    }  # fmt: skip


@pytest.mark.parametrize("dtype", [np.uint16, np.float32, np.int16])
def test_images_of_other_types(sweep, capsys, dtype):
    sweep.frames = sweep.frames.astype(dtype) * dtype(3)
    assert main([*GROWS, "--live", served(sweep), "-o", "v.npz"]) == 0
    volume = read_volume("v.npz")
    assert volume.values.max() > 400
    if dtype == np.int16:  # no type of a volume's: collected, then brought into one
        assert "only collects frames" in capsys.readouterr().err


def test_what_is_no_openigtlink_is_refused():
    address = stream([b"HTTP/1.1 200 OK\r\n" + b"\xff" * 200])
    refuses("OpenIGTLink", list, receive(address, {}, idle=0.5))


class Bytes:
    """A connection that ends after these bytes."""

    def __init__(self, content: bytes):
        self.content = memoryview(content)

    def recv(self, n: int) -> bytes:
        part, self.content = self.content[: min(n, 700)], self.content[min(n, 700) :]
        return bytes(part)


def received(content: bytes) -> tuple[list, list]:
    """The messages among bytes, by their stamps, and what was broken."""
    connection = senders._Stream(igtl.messages.MessageBase, Bytes(content), threading.Event())
    messages, broken = [], []
    while (message := connection.message(np.inf)) is not None:
        if isinstance(message, senders.Broken):
            broken.append(message.what)
        else:
            messages.append(getattr(message, "timestamp", message))
    return messages, broken


@pytest.mark.parametrize("n_streams", [10, pytest.param(350, marks=pytest.mark.slow)])
@pytest.mark.parametrize("mutation", MUTATIONS)
def test_a_broken_message_costs_no_other(mutation, n_streams):
    made = small_sweep(6)
    whole = [message for parts in Server(made).messages for message in parts]
    stamps, broken = received(b"".join(whole))
    assert len(stamps) == len(whole)
    assert not broken
    for seed in range(n_streams):
        rng = np.random.default_rng(seed)
        which = int(rng.integers(1, len(whole)))
        mutated = MUTATIONS[mutation](rng, whole[which])
        got, broken = received(b"".join([*whole[:which], mutated, *whole[which + 1 :]]))
        others = stamps[:which] + stamps[which + 1 :]
        missing = list(others)
        for stamp in got:
            if stamp in missing:
                missing.remove(stamp)
        assert not missing, (seed, which)
        assert broken or len(got) == len(whole)


def test_a_stream_goes_on_after_what_is_broken(sweep, capsys):
    """A malformed transform, garbage, an image of three dimensions, and images of another size."""
    server = Server(sweep)
    malformed = bytearray(server.messages[5][1])
    malformed[49] = 20  # bytes of the body
    solid = igtl.ImageMessage(np.zeros((2, 5, 5), np.uint8), timestamp=9, device_name="Image").pack()
    server.messages[5].insert(1, bytes(malformed[: 58 + 20]))
    server.messages[9].append(b"HTTP/1.1 200 OK\r\n" * 9)
    server.messages[12].append(solid)
    for i in range(18, 24):
        part = igtl.ImageMessage(sweep.frames[i][None, :30, :40], timestamp=1000 + float(sweep.timestamps[i]),
                                 device_name="Image")  # fmt: skip
        server.messages[i][0] = part.pack()
    server.serve(slice(None))
    facts = run_json(capsys, *GROWS, "--live", server.address, "-o", "v.npz", "--record", "kept")
    assert facts["frames"]["used"] == 18
    assert facts["live"]["grew"]
    assert facts["others"] == [{"output": "v-2.npz", "frames": 6, "size": [40, 30]}]
    assert facts["live"]["counts"]["frames"] == 24
    assert facts["live"]["recorded"] == 24
    assert sum(facts["live"]["broken"].values()) == 3
    assert any("3 messages skipped" in line for line in facts["warnings"])
    assert read_volume("v-2.npz").values.any()
    assert len(gb.ultrasound.read_sweep("kept-2")) == 6


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


def test_an_own_pose_beside_other_transforms(sweep):
    """A stylus or the reference leads nowhere from the image."""
    server = Server(sweep, embedded=True)
    for i, messages in enumerate(server.messages):
        messages.append(igtl.TransformMessage(np.eye(4), timestamp=1000 + float(sweep.timestamps[i]),
                                              device_name="StylusToReference").pack())  # fmt: skip
    server.serve(slice(None))
    assert arrived(receive_sweep(server.address, idle=0.4), sweep)


def test_the_status_of_a_transform_counts(sweep):
    server = Server(sweep)
    for i in (7, 8):
        lost = igtl.TransformMessage(np.eye(4), timestamp=1000 + float(sweep.timestamps[i]),
                                     device_name="ImageToReference")  # fmt: skip
        lost.header_version, lost.metadata = 2, {"TransformStatus": "OUT_OF_VIEW"}
        server.messages[i][1] = lost.pack()
    server.serve(slice(None))
    counts = LiveCounts()
    live = receive_sweep(server.address, idle=0.4, counts=counts)
    assert np.array_equal(live.frames, np.delete(sweep.frames, [7, 8], axis=0))
    assert counts.useless == 2


@pytest.mark.parametrize("when", [1e9, 0.0])
def test_one_wrong_stamp_costs_one_image(sweep, when):
    """Of a transform that comes after its image: images after it had no pose, as one far ahead was known."""
    server = Server(sweep)
    wrong = igtl.TransformMessage(sweep.world_from_image[3], timestamp=when, device_name="ImageToReference")
    server.messages[3][1] = wrong.pack()
    server.serve(slice(None))
    counts = LiveCounts()
    live = receive_sweep(server.address, idle=0.4, counts=counts)
    assert len(live) >= 23
    assert counts.missed <= 1
    assert counts.frames + counts.without_pose == 24


@pytest.mark.parametrize("first", ["image", "pose"])
def test_a_server_without_a_clock(sweep, capsys, first):
    messages = []
    for frame, place in zip(sweep.frames, sweep.world_from_image, strict=True):
        pair = [igtl.ImageMessage(frame[None], timestamp=0, device_name="Image"),
                igtl.TransformMessage(place, timestamp=0, device_name="ImageToReference")]  # fmt: skip
        messages += pair if first == "image" else pair[::-1]
    facts = run_json(capsys, *GROWS, "--live", stream(messages), "-o", "v.npz", "--record", "kept")
    assert facts["frames"]["used"] == 24
    assert any("one time stamp" in line for line in facts["warnings"])
    kept = gb.ultrasound.read_sweep("kept")
    assert np.array_equal(kept.frames, sweep.frames)
    assert np.allclose(kept.world_from_image, sweep.world_from_image, rtol=1e-5, atol=1e-4)


@pytest.mark.parametrize(("name", "advice"), [
    ("ProbeToReference", "give --calibration"), ("LinearTransform_3", "expected names as ImageToReference"),
])  # fmt: skip
def test_without_any_pose_the_error_says_what_to_give(sweep, name, advice):
    with pytest.raises(ValueError, match=advice):
        receive_sweep(served(sweep, names=(name,)), idle=0.4)


def test_addresses():
    assert parse_address("igtl://localhost") == ("localhost", 18944)
    assert parse_address("igtl://10.0.0.1:5000") == ("10.0.0.1", 5000)
    for wrong in ("localhost:3", "igtl://", "igtl://:3", "igtl://a:b", "igtl://a:99999"):
        refuses("igtl://host:port", parse_address, wrong)


def stream(messages, ended: threading.Event | None = None) -> str:
    """Serve messages, or bytes, on one connection, which stays until `ended`; the address."""
    listener = socket.create_server(("127.0.0.1", 0))

    def work():
        connection, _ = listener.accept()
        listener.close()  # nobody connects twice
        with connection, contextlib.suppress(OSError):
            for message in messages:
                connection.sendall(message if isinstance(message, bytes) else message.pack())
            if ended:
                ended.wait(PATIENCE)

    threading.Thread(target=work, daemon=True).start()
    return f"igtl://127.0.0.1:{listener.getsockname()[1]}"


def blob_frames(place, n=9):
    """Frames of 21 x 21 pixels of 1 mm around a place, where one pixel shines."""
    frames = np.zeros((n, 21, 21), np.uint8)
    frames[n // 2, 10, 10] = 250
    poses = np.tile(np.eye(4), (n, 1, 1))
    poses[:, :3, 3] = np.array(place) - (10, 10, n // 2)
    poses[:, 2, 3] += np.arange(n)
    return frames, poses


@pytest.mark.parametrize("embedded", [True, False])
def test_a_stream_in_ras_lies_where_it_is(embedded, capsys):
    """A blob at RAS (30, 20, 10): before, the volume was turned by 180 degrees about z."""
    frames, poses = blob_frames((30, 20, 10))
    messages = []
    for i, (frame, pose) in enumerate(zip(frames, poses, strict=True)):
        place, when = pose if embedded else np.eye(4), 100 + 0.1 * i
        messages.append(igtl.ImageMessage(
            frame[None], ijk_to_world_matrix=place, world_coordinate_system="ras", timestamp=when,
            device_name="Image"))  # fmt: skip
        if not embedded:
            name = "ImageToReference"
            messages.append(igtl.TransformMessage(pose, timestamp=when, device_name=name))
    words = [*GROWS, "--live", stream(messages), "-o", "v.nii.gz"]
    run_json(capsys, *words, *([] if embedded else ["--space", "RAS"]))
    volume = read_volume("v.nii.gz", space="RAS")
    z, y, x = np.unravel_index(np.argmax(volume.values), volume.shape)
    place = volume.world_from_voxel @ (x, y, z, 1)
    assert np.allclose(place[:3], (30, 20, 10), atol=0.6)
    lps = receive_sweep(stream(messages), idle=0.5, space="LPS")
    assert lps.space == "LPS"
    assert np.allclose(lps.world_from_image, poses, atol=1e-4)


def tracker_and_images(n: int = 40, shift: float = 0.0, delay: float = 0.0, clock: float = 0.0):
    """A tracker of 60 Hz, images of 30 Hz that begin `shift` later, each message with its time (s), and
    the places x = 20 sin t that the images show, `delay` later. clock: what the tracker's shows beyond."""
    tracker = []
    for i in range(2 * n):
        matrix = np.eye(4)
        matrix[0, 3] = 20 * np.sin(i / 60)
        sent = igtl.TransformMessage(matrix, timestamp=1000 + i / 60 + clock, device_name="ProbeToReference")
        tracker.append((i / 60, sent))
    times = np.arange(n) / 30 + shift
    pixels = np.arange(n, dtype=np.uint8)[:, None, None, None] * np.ones((1, 8, 8), np.uint8)
    images = [
        (t, igtl.ImageMessage(image, timestamp=1000 + t, device_name="Image"))
        for t, image in zip(times.tolist(), pixels, strict=True)
    ]
    return tracker, images, 20 * np.sin(times - delay)


def tracked(shift: float = 0.0, delay: float = 0.0):
    """The same on one line, in the order of their times."""
    tracker, images, places = tracker_and_images(shift=shift, delay=delay)
    return [message for _, message in sorted([*tracker, *images], key=lambda item: item[0])], places


def test_stamps_of_tracker_and_image_apart():
    """Before: 4 ms apart gave no frame at all."""
    calibration = Calibration(np.eye(4))
    for shift in (0.0, 0.004):
        messages, places = tracked(shift)
        counts = LiveCounts()
        sweep = receive_sweep(stream(messages), calibration, idle=0.5, counts=counts)
        assert len(sweep) == 40
        assert np.allclose(sweep.world_from_image[:, 0, 3], places, atol=1e-3)
        assert counts.as_dict() == {"images": 40, "frames": 40, "without_pose": 0, "useless": 0,
                                    "repeated": 0, "missed": 0, "missed_poses": 0,
                                    "connections": 1}  # fmt: skip


def test_the_calibration_s_temporal_offset_counts():
    """Before: live ignored it."""
    calibration = Calibration(np.eye(4), temporal_offset=-0.1)
    messages, places = tracked(delay=0.1)
    counts = LiveCounts()
    sweep = receive_sweep(stream(messages), calibration, idle=0.5, counts=counts)
    assert counts.images == 40
    assert counts.without_pose == 3  # those before the first pose, of 0.1 s
    assert np.allclose(sweep.world_from_image[:, 0, 3], places[3:], atol=1e-3)
    other = receive_sweep(stream(messages), calibration, idle=0.5, temporal_offset=0.0)
    assert np.abs(other.world_from_image[:, 0, 3] - places).max() > 1
    later = Calibration(np.eye(4), temporal_offset=0.1)
    messages, places = tracked(delay=-0.1)
    sweep = receive_sweep(stream(messages), later, idle=0.5)
    assert np.allclose(sweep.world_from_image[:, 0, 3], places[: len(sweep)], atol=1e-3)
    assert len(sweep) >= 36


def test_embedded_poses_take_the_offset_too():
    messages = []
    for i in range(20):
        place = np.eye(4)
        place[:3, 3] = i, 2, 3
        messages.append(igtl.ImageMessage(np.full((1, 8, 8), i, np.uint8), place, timestamp=i / 10,
                                          device_name="Image"))  # fmt: skip
    sweep = receive_sweep(stream(messages), idle=0.5, temporal_offset=0.05)
    assert np.allclose(sweep.world_from_image[:, 0, 3], sweep.frames[:, 0, 0] + 0.5, atol=1e-4)
    assert len(sweep) == 19


def test_lost_images_are_counted(sweep, capsys):
    """The server gives up twice and goes on later, and a transform stays away for a while."""
    server = Server(sweep)
    for i in (15, 16):
        del server.messages[i][1]
    server.serve(slice(0, 8), slice(11, None))
    facts = run_json(capsys, *GROWS, "--live", server.address, "-o", "v.npz")
    counts = facts["live"]["counts"]
    assert counts["images"] == 21
    assert counts["connections"] >= 2
    assert counts["missed"] == 3
    assert counts["frames"] + counts["without_pose"] == 21
    assert any("3 images never arrived" in line for line in facts["warnings"])
    server = Server(sweep)
    for parts in server.messages:
        del parts[1:]
    server.serve(slice(None))
    refuses(r"got 24 images and no pose", receive_sweep, server.address, idle=0.5)


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
