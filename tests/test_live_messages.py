"""What messages say: broken ones, stamps, poses, status and axes; every image is accounted for."""

import threading
import warnings

import globule as gb
import numpy as np
import pytest
from cli_helpers import refuses, run_json
from globule.cli import main
from globule.ultrasound import senders
from globule.ultrasound.calibration import Calibration
from globule.ultrasound.live import parse_address, receive, receive_sweep
from globule.ultrasound.live_counts import LiveCounts
from globule.volumes.files import read_volume
from live_helpers import GROWS, Server, arrived, igtl, served, stream, tracker_and_images
from sweep_helpers import small_sweep

from bench.live_damaged import MUTATIONS

pytestmark = pytest.mark.usefixtures("folder", "clock")


def test_stamps_are_counted_in_a_memory_that_does_not_grow(monkeypatch):
    monkeypatch.setattr("globule.ultrasound.live_counts._STAMPS", 16)
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
    counts = LiveCounts()
    for stamp in [*range(10), 6400, *range(11, 20)]:  # a wrong one, 256 s ahead, is no 6,400 images that never came
        counts.saw(stamp / 25)
    assert counts.missed == 1


def test_frames_with_a_useless_pose_do_not_end_the_stream(sweep):
    sweep.world_from_image[3] = 0
    sweep.world_from_image[5, :3, 3] = np.nan
    sweep.world_from_image[3, 3, 3] = 1
    live = receive_sweep(served(sweep), idle=0.5)
    assert len(live) == 22
    good = np.delete(np.arange(24), [3, 5])
    assert np.array_equal(live.frames, sweep.frames[good])


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


def test_an_own_pose_beside_other_transforms(sweep):
    """A stylus or the reference leads nowhere from the image."""
    server = Server(sweep, embedded=True)
    for i, messages in enumerate(server.messages):
        messages.append(igtl.TransformMessage(np.eye(4), timestamp=1000 + float(sweep.timestamps[i]),
                                              device_name="StylusToReference").pack())  # fmt: skip
    server.serve(slice(None))
    assert arrived(receive_sweep(server.address, idle=0.4), sweep)


@pytest.mark.parametrize("place", [np.eye(4), np.diag([0.5, 0.5, 1, 1]), None])
def test_images_before_the_first_transform_have_no_pose(sweep, place):
    """Their header's matrix, that of the identity's origin or middle or of pixels' sizes, is none in this stream."""
    messages = []
    for i, frame in enumerate(sweep.frames):
        own = np.eye(4) if place is None else place.copy()
        own[:2, 3] = 0 if place is None else [-31.5 * own[0, 0], -29.5 * own[1, 1]]
        messages.append(igtl.ImageMessage(frame[None], own, timestamp=1000 + i / 25, device_name="Image"))
        if i >= 4:
            messages.append(igtl.TransformMessage(sweep.world_from_image[i], timestamp=1000 + i / 25,
                                                  device_name="ImageToTracker"))  # fmt: skip
    counts = LiveCounts()
    live = receive_sweep(stream(messages), idle=0.4, counts=counts)
    assert np.array_equal(live.frames, sweep.frames[4:])
    assert np.allclose(live.world_from_image, sweep.world_from_image[4:], rtol=1e-5, atol=1e-4)
    assert (counts.images, counts.without_pose, live.world) == (24, 4, "Tracker")


def test_every_image_is_accounted_for_once(sweep, capsys):
    """A wrong checksum, one cut off and sent again, three that are no plane in gray, and one that was not sent."""
    server = Server(sweep)
    wrong = bytearray(server.messages[5][0])
    wrong[200] ^= 1
    server.messages[5][0] = bytes(wrong)
    solid = igtl.ImageMessage(np.zeros((2, 5, 5), np.uint8), timestamp=1000 + float(sweep.timestamps[9]))
    server.messages[9][0] = solid.pack()
    for i, shape in ((10, (1, 0, 0)), (11, (1, 60, 64, 2))):
        other = igtl.ImageMessage(np.zeros(shape, np.uint8), timestamp=1000 + float(sweep.timestamps[i]))
        server.messages[i][0] = other.pack()
    server.messages[12][:] = [server.messages[12][0][:900]]
    server.messages[12:12] = [server.messages[12].copy()]
    server.messages[13] = Server(sweep).messages[12]
    server.serve(slice(0, 13), slice(13, 18), slice(19, None))
    facts = run_json(capsys, *GROWS, "--live", server.address, "-o", "v.npz")
    counts = facts["live"]["counts"]
    assert (counts["images"], counts["broken_images"], counts["missed"]) == (19, 4, 1)
    assert counts["frames"] == facts["frames"]["used"] == 19
    said = "IMAGE of 5 x 5 x 2 pixels, which is no 2-D image in gray or color (1)"
    assert any(line.startswith("5 messages skipped: ") and said in line for line in facts["warnings"])


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


STAMPS = {  # what stamps of a server do from image 12 on, and what is said of it
    "none": (lambda i: 0.0 if i >= 12 else 1000 + i / 25, "12 of 24 images have no time stamp"),
    "none for a while": (lambda i: 0.0 if 12 <= i < 16 else 1000 + i / 25, "4 of 24 images have no time stamp"),
    "every other none": (lambda i: 0.0 if i % 2 else 1000 + i / 25, "12 of 24 images have no time stamp"),
    "back a little": (lambda i: 1000 + i / 25 - 0.47 * (i >= 12), "was set back once"),
    "back to the start": (lambda i: 1000 * (i < 12) + i / 25, "was set back once"),
    "backwards": (lambda i: 1000 - i / 25, ""),
}


@pytest.mark.parametrize("first", ["image", "pose"])
@pytest.mark.parametrize("name", STAMPS)
def test_stamps_that_end_or_begin_anew(sweep, capsys, name, first):
    """Each image has its own pose, in the order of arrival; none counts as lost."""
    stamp, said = STAMPS[name]
    messages = []
    for i, (frame, place) in enumerate(zip(sweep.frames, sweep.world_from_image, strict=True)):
        pair = [igtl.ImageMessage(frame[None], timestamp=stamp(i), device_name="Image"),
                igtl.TransformMessage(place, timestamp=stamp(i), device_name="ImageToReference")]  # fmt: skip
        messages += pair if first == "image" else pair[::-1]
    facts = run_json(capsys, *GROWS, "--live", stream(messages), "-o", "v.npz", "--record", "kept")
    assert facts["frames"]["used"] == 24
    assert facts["live"]["counts"]["missed"] == facts["live"]["counts"]["missed_poses"] == 0
    assert any(said in line for line in facts["warnings"]) or not said
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        kept = gb.ultrasound.read_sweep("kept")
    order = [int(np.flatnonzero((sweep.frames == frame).all(axis=(1, 2)))[0]) for frame in kept.frames]
    assert sorted(order) == list(range(24))
    assert np.allclose(kept.world_from_image, sweep.world_from_image[order], rtol=1e-5, atol=1e-4)


def test_a_clock_set_back_with_a_tracker_on_stamps_of_its_own():
    """Poses between samples go on after the first image of the new clock, and none is of the old one."""
    tracker, images, truth = tracker_and_images(60)
    messages = []
    for when, message in sorted([*tracker, *images], key=lambda item: item[0]):
        message.timestamp -= 0.9 if when >= 1 else 0
        messages.append(message)
    live = receive_sweep(stream(messages), Calibration(np.eye(4)), idle=0.5)
    assert len(live) >= 57
    number = live.frames[:, 0, 0]
    assert np.allclose(live.world_from_image[:, 0, 3], truth[number], atol=0.01)
    assert (np.diff(number.astype(int)) > 0).all()


@pytest.mark.parametrize(("which", "said"), [
    ("images", "all images have one time stamp, and transforms have others"),
    ("poses", "all messages of ImageToReference have one time stamp"),
])  # fmt: skip
@pytest.mark.parametrize("stamp", [0.0, 1000.0])
def test_images_or_transforms_with_one_stamp_take_no_wrong_pose(sweep, capsys, which, said, stamp):
    messages = []
    for i, (frame, place) in enumerate(zip(sweep.frames, sweep.world_from_image, strict=True)):
        times = {"images": 1000 + i / 25, "poses": 1000 + i / 25} | {which: stamp}
        messages.append(igtl.ImageMessage(frame[None], timestamp=times["images"], device_name="Image"))
        messages.append(igtl.TransformMessage(place, timestamp=times["poses"], device_name="ImageToReference"))
    status = main([*GROWS, "--live", stream(messages), "-o", "v.npz", "--record", "kept"])
    out = capsys.readouterr()
    assert said in out.err
    assert status == (2 if stamp == 0 else 0)
    if stamp:
        assert len(gb.ultrasound.read_sweep("kept")) == 1


def test_an_image_that_is_sent_again_without_its_pose_counts_once(sweep):
    server = Server(sweep)
    for messages in server.messages:
        messages.append(messages[0])
    server.serve(slice(None))
    counts = LiveCounts()
    assert len(receive_sweep(server.address, idle=0.4, counts=counts)) == 24
    assert counts.repeated >= 23  # the last one comes after all poses
    assert counts.repeated + counts.without_pose == 24


def test_of_two_devices_the_first_counts(sweep, capsys):
    """The other shows the negative at the same times."""
    server = Server(sweep)
    for i, messages in enumerate(server.messages):
        other = igtl.ImageMessage(255 - sweep.frames[i][None], timestamp=1000 + float(sweep.timestamps[i]),
                                  device_name="Video")  # fmt: skip
        messages.insert(1, other.pack())
    server.serve(slice(None))
    facts = run_json(capsys, *GROWS, "--live", server.address, "-o", "v.npz", "--record", "kept")
    assert facts["frames"]["used"] == facts["live"]["counts"]["images"] == 24
    assert facts["live"]["other_devices"] == {"Video": 24}
    assert any("of 2 devices came: those of Image count" in line for line in facts["warnings"])
    assert np.array_equal(gb.ultrasound.read_sweep("kept").frames, sweep.frames)


@pytest.mark.parametrize(("name", "advice"), [
    ("ProbeToReference", "give --calibration"), ("LinearTransform_3", "expected names as ImageToReference"),
    ("", "name no frames: one without a name; expected names as ImageToReference"),
])  # fmt: skip
def test_without_any_pose_the_error_says_what_to_give(sweep, name, advice):
    with pytest.raises(ValueError, match=advice):
        receive_sweep(served(sweep, names=(name,)), idle=0.4)


def test_without_any_pose_that_is_ok_the_error_says_so(sweep):
    sweep.world_from_image[:] = np.nan
    with pytest.raises(ValueError, match="24 images with a pose that is no regular matrix"):
        receive_sweep(served(sweep), idle=0.4)


def test_addresses():
    assert parse_address("igtl://localhost") == ("localhost", 18944)
    assert parse_address("igtl://10.0.0.1:5000") == ("10.0.0.1", 5000)
    for wrong in ("localhost:3", "igtl://", "igtl://:3", "igtl://a:b", "igtl://a:99999"):
        refuses("igtl://host:port", parse_address, wrong)


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
                                    "repeated": 0, "broken_images": 0, "missed": 0,
                                    "missed_poses": 0, "connections": 1}  # fmt: skip


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
    said = r"got 24 images and no pose .*; no TRANSFORM came, and the headers of the images hold no pose"
    refuses(said, receive_sweep, server.address, idle=0.5)
