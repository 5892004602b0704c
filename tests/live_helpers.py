"""Servers of OpenIGTLink messages, for tests of live runs."""

import contextlib
import socket
import threading
from collections.abc import Callable

import numpy as np
import pytest
from waiting import PATIENCE

igtl = pytest.importorskip("pyigtl", reason="live needs pyigtl")

LIVE = ["reconstruct", "--idle", "0.5", "--device", "cpu"]
GROWS = [*LIVE, "--voxel-size", "1"]


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


def arrived(live, sweep) -> bool:
    """Whether a sweep came over the line: OpenIGTLink's matrices are float32."""
    return (
        np.array_equal(live.frames, sweep.frames)
        and np.allclose(live.world_from_image, sweep.world_from_image, rtol=1e-5, atol=1e-4)
        and np.allclose(np.diff(live.timestamps), np.diff(sweep.timestamps), atol=1e-6)
    )


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
