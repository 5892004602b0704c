"""Tracker and images from two servers; volume, trust map, slice and surface sent back."""

import contextlib
import itertools
import socket
import struct
import threading

import globule as gb
import numpy as np
import pytest
from cli_helpers import refused, refuses, run_json
from globule.formats.sweeps import messages
from globule.ultrasound import live, live_output, senders
from globule.ultrasound.broadcast import Broadcaster
from globule.ultrasound.calibration import Calibration
from globule.ultrasound.live import receive_sweep
from globule.ultrasound.live_counts import LiveCounts
from globule.ultrasound.live_output import LiveOutput, surface
from globule.ultrasound.matching import LiveFrame
from globule.ultrasound.senders import Arrived, Clocks
from globule.volumes.slices import reslice
from interrupts import running
from live_helpers import GROWS, served, stream, tracker_and_images
from waiting import PATIENCE, Waits, until

igtl = pytest.importorskip("pyigtl", reason="live needs pyigtl")
RAS = np.diag([-1.0, -1.0, 1.0, 1.0])
pytestmark = pytest.mark.usefixtures("folder")


def joined(message: messages.Packed) -> bytes:
    return b"".join(bytes(part) for part in message.parts)


def read_triangles(data: bytes) -> tuple[np.ndarray, np.ndarray]:
    """Points and triangles of a POLYDATA, by the protocol's text: a header of ten counts."""
    counts = struct.unpack(">10I", data[58:98])
    n_points, n_cells, n_bytes = counts[0], counts[5], counts[6]
    points = np.frombuffer(data, ">f4", 3 * n_points, 98).reshape(-1, 3)
    cells = np.frombuffer(data, ">u4", n_bytes // 4, 98 + points.nbytes).reshape(n_cells, 4)
    assert (cells[:, 0] == 3).all()
    assert len(data) == 98 + points.nbytes + n_bytes
    return points.astype(float), cells[:, 1:].astype(int)


def some_matrix() -> np.ndarray:
    """An oblique one with unequal spacing."""
    turn, _ = np.linalg.qr(np.random.default_rng(3).normal(size=(3, 3)))
    matrix = np.eye(4)
    matrix[:3, :3] = turn * (0.5, 0.75, 2.0)
    matrix[:3, 3] = 30, 20, 10
    return matrix


@pytest.mark.parametrize("dtype", ["uint8", "uint16", "int16", "float32"])
def test_images_equal_those_of_pyigtl(dtype):
    values = np.arange(2 * 3 * 5).reshape(2, 3, 5).astype(dtype)
    place = some_matrix()
    ours = messages.image("Volume", values, place, 1000.25)
    # The whole message, with its check sum, is that of an independent writer.
    theirs = igtl.ImageMessage(values, RAS @ place, "ras", timestamp=1000.25, device_name="Volume")
    data, expected = joined(ours), theirs.pack()
    assert data[:42] == expected[:42]
    center = slice(58 + 12 + 36, 58 + 12 + 48)  # ours is computed in float64
    a, b = (np.frombuffer(d[center], ">f4") for d in (data, expected))
    assert np.allclose(a, b, atol=1e-5)
    assert data[58 : center.start] == expected[58 : center.start]
    assert data[center.stop :] == expected[center.stop :]
    check = int.from_bytes(data[50:58], "big")
    assert check == igtl.messages.CRC64(data[58:])


def test_transforms_triangles_and_text_equal_those_of_pyigtl():
    place = some_matrix()
    moved = igtl.TransformMessage(RAS @ place, timestamp=5.5, device_name="LiveImageToReference")
    assert joined(messages.transform("LiveImageToReference", place, 5.5)) == moved.pack()
    rng = np.random.default_rng(0)
    vertices = rng.normal(size=(7, 3)).astype(np.float32)
    faces = rng.integers(0, 7, (4, 3))
    ours = joined(messages.triangles("Surface", vertices, faces, 5.5))
    cells = np.column_stack([np.full(4, 3), faces]).ravel()
    theirs = igtl.PolyDataMessage(points=vertices * (-1, -1, 1), polygons=cells, timestamp=5.5,
                                  device_name="Surface")  # fmt: skip
    assert ours == theirs.pack()
    points, triangles = read_triangles(ours)
    assert np.array_equal(points * (-1, -1, 1), vertices)
    assert np.array_equal(triangles, faces)
    words = igtl.StringMessage("3 frames", timestamp=5.5, device_name="Counts")
    assert joined(messages.text("Counts", "3 frames", 5.5)) == words.pack()
    assert joined(messages.triangles("Surface", vertices[:0], faces[:0], 5.5))  # an empty one
    refuses("1 to 20 letters", messages.transform, "x" * 21, place, 0)
    refuses("bool", messages.image, "Volume", np.zeros((1, 2, 3), bool), place, 0, error=TypeError)


def blob_volume() -> gb.volumes.Volume:
    """A blob of radius 8 mm around LPS (-30, -20, 10), which is RAS (30, 20, 10)."""
    axes = np.arange(40) - 20.0
    z, y, x = np.meshgrid(axes, axes, axes, indexing="ij")
    values = np.clip(200 - 12.5 * np.sqrt(x * x + y * y + z * z), 0, 255).astype(np.uint8)
    place = np.eye(4)
    place[:3, 3] = np.array((-30, -20, 10)) - 20
    return gb.volumes.Volume(values, place)


def test_the_surface_lies_where_the_values_are():
    volume = blob_volume()
    vertices, faces = surface(volume, 100.0)
    center = np.array((-30, -20, 10))
    assert np.allclose(np.linalg.norm(vertices - center, axis=1), 8, atol=0.3)
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    enclosed = np.einsum("fi,fi->", a - center, np.cross(b - center, c - center)) / 6
    assert enclosed == pytest.approx(4 / 3 * np.pi * 8**3, rel=0.05)  # positive: outwards
    # Voxels without data do not close the surface, and large volumes are made coarser.
    radius = np.zeros(volume.shape, np.uint8)
    radius[:, :, 20:] = 255
    half, _ = surface(gb.volumes.Volume(volume.values, volume.world_from_voxel, radius), 100.0)
    assert half[:, 0].max() < -30.5
    assert len(half) < 0.6 * len(vertices)
    fine = np.kron(volume.values, np.ones((4, 4, 4), np.uint8))
    place = volume.world_from_voxel @ np.diag([0.25, 0.25, 0.25, 1])
    place[:3, 3] -= 0.375
    coarse, _ = surface(gb.volumes.Volume(fine, place), 100.0)
    assert np.allclose(np.linalg.norm(coarse - center, axis=1), 8, atol=0.5)
    assert surface(gb.volumes.Volume(np.zeros((4, 4, 4), np.uint8), np.eye(4))) is None
    assert surface(volume, 1e6) is None


def test_a_receiver_shows_the_blob_at_its_ras_place():
    volume, server = blob_volume(), Broadcaster()
    frame = LiveFrame(7.0, np.zeros((30, 20), np.uint8), some_matrix(), "Reference")
    frame.world_from_image[:3, 3] = -30, -20, 10
    frame.world_from_image[:3, 2] = 0  # of no length, as some servers send it
    output = LiveOutput(server, lambda: volume, refresh=0.0, level=100.0)
    early = igtl.OpenIGTLinkClient("127.0.0.1", server.port)
    try:
        output.frame(1, frame, "1 frames of 1 images")
        until(lambda: output.n_volumes == 1)
        late = igtl.OpenIGTLinkClient("127.0.0.1", server.port)
        for n, client in enumerate((early, late), 1):  # one connects after the messages were made
            found = {}
            until(lambda c=client, f=found: f.update(
                {m.device_name: m for m in c.get_latest_messages()}) or len(f) == 5)  # fmt: skip
            shown = found["Volume"]
            z, y, x = np.unravel_index(np.argmax(shown.image), shown.image.shape)
            place = shown.ijk_to_world_matrix @ (x, y, z, 1)
            assert shown.world_coordinate_system == "ras"
            assert np.allclose(place[:3], (30, 20, 10), atol=1e-3)
            assert (found["Trust"].image == 1).all()
            assert np.array_equal(found["Trust"].ijk_to_world_matrix, shown.ijk_to_world_matrix)
            assert found["Counts"].string == "1 frames of 1 images"
            moved = RAS @ found["LiveImageToReference"].matrix
            assert np.allclose(moved[:3, [0, 1, 3]], frame.world_from_image[:3, [0, 1, 3]])
            cut = found["Slice"]
            expected = reslice(volume, frame.world_from_image, (20, 30)).values
            assert np.abs(cut.image[0] - expected).max() <= 0.5
            u, v, w = cut.ijk_to_world_matrix[:3, :3].T
            assert np.linalg.norm(w) > 0.1
            assert abs(w @ u) + abs(w @ v) < 1e-5
            until(lambda n=n: server.sent["Surface"] >= n)
            client.stop()
    finally:
        output.close()
        server.close()


def test_frames_go_before_volumes(monkeypatch):
    """While messages wait for their use, no volume delays them; the last frame is always shown."""
    monkeypatch.setattr(live_output, "_LONGEST", 3600.0)
    volume, server = blob_volume(), Broadcaster()
    frame = LiveFrame(7.0, np.zeros((30, 20), np.uint8), some_matrix(), "Reference")
    output = LiveOutput(server, lambda: volume, refresh=0.0, level=100.0)
    try:
        output.frame(1, frame)
        until(lambda: output.n_volumes == 1)
        output.frame(2, frame, waiting=9)
        output.frame(3, frame, waiting=0)
        until(lambda: output.n_frames == 3)
        n_volumes = output.n_volumes  # frame 2 has none of its own
        output.frame(4, frame, waiting=9)
        monkeypatch.setattr(live_output, "_LONGEST", 0.0)
        output.close()
        assert output.n_frames == 4
        assert (n_volumes, output.n_volumes) == (2, 3)
        assert output.error is None
    finally:
        server.close()


def test_a_slow_client_holds_up_nobody():
    server = Broadcaster()
    slow = socket.create_connection(("127.0.0.1", server.port))
    fast = igtl.OpenIGTLinkClient("127.0.0.1", server.port)
    until(lambda: server.n_clients == 2)
    big = np.zeros((200, 200, 200), np.uint8)
    got = []
    for i in range(12):
        big[:] = i
        server.send(messages.image("Volume", big.copy(), np.eye(4), float(i)))
        message = fast.wait_for_message("Volume", timeout=PATIENCE)
        got.append(int(message.image[0, 0, 0]))
    assert got == list(range(12))
    assert server.skipped["Volume"] >= 9  # the slow one's; its newest still waits
    slow.close()
    until(lambda: server.n_clients == 1)
    fast.stop()
    server.close()
    with pytest.raises(ConnectionRefusedError):
        socket.create_connection(("127.0.0.1", server.port))


def connected(port: int) -> socket.socket | None:
    """Where a server listens."""
    with contextlib.suppress(OSError):
        return socket.create_connection(("127.0.0.1", port))


def check_places(sweep) -> None:
    expected = 20 * np.sin(sweep.frames[:, 0, 0] / 30)
    assert np.abs(sweep.world_from_image[:, 0, 3] - expected).max() < 0.07


def test_tracker_and_images_from_two_servers(monkeypatch):
    monkeypatch.setattr(senders, "time", Waits())
    ended = threading.Event()
    tracker, images = ([m for _, m in messages] for messages in tracker_and_images()[:2])
    counts = LiveCounts()
    came = counts.saw_transform
    n_came = itertools.count(1)

    def saw_transform(name: str, time: float) -> None:
        came(name, time)
        if next(n_came) == len(tracker):
            ended.set()  # only now may the server of the images go

    counts.saw_transform = saw_transform
    sweep = receive_sweep(stream(images, ended), Calibration(np.eye(4)), idle=0.5, counts=counts,
                          tracker=stream(tracker, ended))  # fmt: skip
    assert (counts.images, counts.missed, counts.connections) == (40, 0, 2)
    assert len(sweep) == counts.frames == 40 - counts.without_pose
    check_places(sweep)


@pytest.mark.parametrize(("clock", "first"), [(0.0, "tracker"), (0.0, "images"), (-5000.0, "images")])
def test_clocks_of_two_servers(clock, first, monkeypatch):
    """Images arrive 120 ms late, the servers start in any order, clocks together or apart."""
    n, late = 45, 0.4
    tracker, images, _ = tracker_and_images(n, clock=clock)
    came = [Arrived(1, message, 7 + t) for t, message in tracker if t > late or first != "images"]
    came += [Arrived(0, message, 7.12 + t) for t, message in images if t > late or first == "images"]
    came.sort(key=lambda arrived: arrived.when)

    def arrivals(base, places, idle, wait, connected):
        connected[:] = 1, 1
        return iter(came)

    monkeypatch.setattr(live, "arrivals", arrivals)
    counts = LiveCounts()
    sweep = receive_sweep(
        "igtl://images", Calibration(np.eye(4)), counts=counts, tracker="igtl://tracker",
        temporal_offset=-0.12 if clock else 0.0,
    )  # fmt: skip
    assert counts.missed == 0
    assert counts.frames + counts.without_pose == counts.images
    assert len(sweep) == counts.frames >= n - 20  # those before the tracker came
    if clock:
        # Arrival tells the clocks apart up to the delays of the data, which the offset covers.
        assert counts.clock_difference == pytest.approx(4999.88)
    check_places(sweep)


def test_clocks():
    clocks = Clocks()
    clocks.saw(0, 100.0, 1000.05)
    assert clocks.difference is None
    clocks.saw(1, 100.01, 1000.2)  # a common clock, whatever the delay
    assert clocks.difference == 0
    clocks = Clocks()
    rng = np.random.default_rng(1)
    for i in range(2000):  # clocks 3600 s apart, one of them 50 ppm fast; jitter of 5 ms
        t = i / 60
        clocks.saw(0, 500 + t, 9000 + t + rng.exponential(0.005))
        clocks.saw(1, 4100 + t * (1 + 5e-5), 9000 + t + rng.exponential(0.005))
        if t < 0.4:
            assert clocks.difference is None
    assert clocks.difference == pytest.approx(-3600 - t * 5e-5, abs=2e-3)


def test_reconstruct_serves_what_grows(sweep, capsys, monkeypatch):
    """The command between a sender and a receiver: the last volume shown is the one written."""
    monkeypatch.setattr(senders, "time", Waits())
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    got: dict[str, object] = {}
    surfaces = []

    def collect():
        with until(lambda: connected(port)) as connection:
            file = connection.makefile("rb")
            while len(header := file.read(58)) == 58:
                fields = igtl.messages.MessageBase.parse_header(header)
                body = file.read(fields["body_size"])
                if fields["message_type"] == "POLYDATA":
                    surfaces.append(read_triangles(header + body))
                    continue
                read = igtl.messages.MessageBase.create_message(fields["message_type"])
                read.unpack(fields, body)
                got[read.device_name] = read

    def hold(n: int) -> None:
        if n == 12:
            until(lambda: "Volume" in got, "for a volume of the first half")

    with running(collect):
        address = served(sweep, between=hold)
        words = [*GROWS, "--live", address, "-o", "v.npz", "--serve", str(port)]
        facts = run_json(capsys, *words, "--refresh", "0.1")
    volume = gb.volumes.read_volume("v.npz")
    assert np.array_equal(got["Volume"].image, volume.values)
    assert np.allclose(RAS @ got["Volume"].ijk_to_world_matrix, volume.world_from_voxel, atol=1e-4)
    assert np.array_equal(got["Trust"].image > 0, volume.radius != 255)
    assert got["Counts"].string == "24 frames of 24 images"
    assert facts["live"]["clients"] == 1
    assert facts["live"]["sent"]["Volume"] >= 2
    assert len(surfaces[-1][1]) > 50


def test_mistakes_of_serve_and_tracker(capsys):
    stream = ["reconstruct", "--live", "igtl://127.0.0.1:1", "-o", "v.npz"]
    for words, message in (
        (["--serve", "18945"], "--voxel-size"),
        (["--serve", "x", "--voxel-size", "1"], "PORT or HOST:PORT"),
        (["--serve", "18945", "--voxel-size", "1", "--method", "frames"], "pvn-om"),
        (["--tracker", "localhost"], "igtl://host:port"),
    ):
        assert message in refused(capsys, *stream, *words)
    refused(capsys, "reconstruct", "x.mha", "--tracker", "igtl://a", "-o", "v.npz")
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        assert "cannot listen" in refused(capsys, *stream, "--serve", str(port), "--voxel-size", "1")
