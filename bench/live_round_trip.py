"""Live reconstruction from two senders, received back: frames accounted for, and the delay.

    python -m bench.live_round_trip --seconds 600

A tracker sends poses at 60 Hz, a scanner images at 30 Hz, each in a process of its own, images 120
ms after their stamps. `globule reconstruct --live --tracker --serve` reconstructs a volume of
N^3 voxels, and a client receives the volume. Delay: from an image being sent until a client has
received the whole volume that contains the image.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import multiprocessing
import os
import socket
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import pyigtl

LATE = 0.12  # s from an image's stamp until it is sent
EDGE = 128.0  # mm of the volume
PIXELS = 512


def pose(when: float) -> np.ndarray:
    """The probe goes to and fro over the volume in 20 s."""
    matrix = np.diag([EDGE / PIXELS, EDGE / PIXELS, 1, 1])
    share = when / 20 % 1
    matrix[2, 3] = EDGE * (2 * share if share < 0.5 else 2 - 2 * share)
    return matrix


def send(port: int, rate: float, seconds: float, begun: float, images: bool) -> None:
    """A server that sends one kind of message in real time."""
    rng = np.random.default_rng(0)
    shown = rng.integers(1, 255, (8, 1, PIXELS, PIXELS)).astype(np.uint8)
    with socket.create_server(("127.0.0.1", port)) as listener:
        connection, _ = listener.accept()
    longest = 0.0
    with connection, contextlib.suppress(OSError):
        for i in range(int(seconds * rate)):
            when = begun + i / rate
            due = when + (LATE if images else 0)
            if images:
                data = pyigtl.ImageMessage(shown[i % 8], timestamp=when, device_name="Image").pack()
            else:
                message = pyigtl.TransformMessage(pose(when - begun), timestamp=when, device_name="ImageToReference")
                data = message.pack()
            time.sleep(max(0.0, due - time.time()))
            connection.sendall(data)
            longest = max(longest, time.time() - due)
        time.sleep(1 if images else 30)
    if images:
        print(f"images were sent at most {1000 * longest:.0f} ms late", file=sys.stderr)


def receive(port: int, found: multiprocessing.Queue) -> None:
    """A client that takes every message; the delays of volumes and slices, s."""
    delays: dict[str, list[float]] = {"Volume": [], "Slice": []}
    sizes: list[int] = []
    while True:
        with contextlib.suppress(OSError):
            connection = socket.create_connection(("127.0.0.1", port))
            break
        time.sleep(0.05)
    buffer = bytearray(1 << 27)

    def read(n: int) -> memoryview | None:
        view, at = memoryview(buffer)[:n], 0
        while at < n:
            got = connection.recv_into(view[at:])
            if not got:
                return None
            at += got
        return view

    with contextlib.suppress(OSError):
        while (header := read(58)) is not None:
            fields = pyigtl.messages.MessageBase.parse_header(bytes(header))
            if read(fields["body_size"]) is None:
                break
            name = fields["device_name"]
            if name in delays:
                delays[name].append(time.time() - fields["timestamp"] - LATE)
            if name == "Volume":
                sizes.append(fields["body_size"])
    found.put((delays, sizes))


def main() -> None:
    """Run and print a table."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--seconds", type=float, default=30)
    parser.add_argument("--voxels", type=int, default=256, help="along an edge of the volume")
    options = parser.parse_args()
    with contextlib.ExitStack() as stack:
        made = [stack.enter_context(socket.create_server(("127.0.0.1", 0))) for _ in range(3)]
        scanner, tracker, served = (one.getsockname()[1] for one in made)
    begun = time.time() + 3
    found: multiprocessing.Queue = multiprocessing.Queue()
    workers = [
        multiprocessing.Process(target=receive, args=(served, found)),
        multiprocessing.Process(target=send, args=(scanner, 30, options.seconds, begun, True)),
        multiprocessing.Process(target=send, args=(tracker, 60, options.seconds + 3, begun, False)),
    ]
    for worker in workers:
        worker.start()
    with tempfile.TemporaryDirectory() as folder:
        edge = EDGE / options.voxels
        bounds = ",".join(f"{v:g}" for v in (0, 0, 0, EDGE, EDGE, EDGE))
        words = [
            sys.executable, "-m", "globule", "reconstruct",
            "--live", f"igtl://127.0.0.1:{scanner}", "--tracker", f"igtl://127.0.0.1:{tracker}",
            "--serve", str(served), "--voxel-size", str(edge), "--bounds", bounds, "--json",
            "--idle", "3", "--wait", "60", "--keep-outliers", "--device", "cpu", "--refresh", "2",
            "-o", str(Path(folder) / "v.npz"),
        ]  # fmt: skip
        done = subprocess.run(words, capture_output=True, text=True)
    if done.returncode:
        raise SystemExit(done.stderr)
    facts = json.loads(done.stdout)
    delays, sizes = found.get()
    for worker in workers:
        worker.terminate()
        worker.join()
    counts, live = facts["live"]["counts"], facts["live"]
    n = int(options.seconds * 30)
    print(f"{os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}; {n} images sent; {counts}")
    unaccounted = n - counts["images"] - counts["missed"]
    unaccounted += counts["images"] - counts["frames"] - counts["without_pose"]
    print(f"frames unaccounted for: {unaccounted}; in the volume: {facts['frames']['used']}")
    print(f"volume {facts['volume']['size']}, messages of {max(sizes) / 2**20:.1f} MiB")
    print(f"a frame enters the volume in {1000 * live['median_seconds']:.1f} ms (median)")
    for name, values in delays.items():
        p = np.percentile(1000 * np.array(values), (50, 95, 100))
        delay = f"{p[0]:.0f} ms median, {p[1]:.0f} ms 95 %, {p[2]:.0f} ms longest"
        print(f"{name:<7} {len(values):6} received, delay {delay}")


if __name__ == "__main__":
    main()
