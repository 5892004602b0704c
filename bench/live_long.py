"""A hand-held sweep of minutes: memory and delay of a live reconstruction along the run.

    python -m bench.live_long [--frames 10000] [--rate 40] [--crash]

A server sends images of 640x480 with their poses in real time; `globule reconstruct --live` bins them
into 256^3 voxels and writes the volume every 10 s. Delay: from an image being sent until the volume has
it. Memory: resident, of the reconstructing process. With --crash, that process is killed after the
given frames, and the volume on the disk must lack no more than the last 10 s.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import multiprocessing
import os
import signal
import socket
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import pyigtl

EDGE = 128.0  # mm of the volume
SIZE = 480, 640
AROUND = 250  # frames that one figure stands for

CHILD = """
import os, sys, time
import numpy as np
from globule.cli import live, main
take, log, page = live.Live._take, [], os.sysconf("SC_PAGE_SIZE")
def logged(self, n, frame):
    take(self, n, frame)
    resident = int(open("/proc/self/statm").read().split()[1]) * page
    log.append((time.time() - frame.time, resident))
live.Live._take = logged
status = main(sys.argv[2:])
np.save(sys.argv[1], np.array(log))
sys.exit(status)
"""


def pose(i: int) -> np.ndarray:
    """The probe goes to and fro over the volume, 400 images each way, tilting by five degrees."""
    share = i / 400 % 1
    turn = np.radians(5) * np.sin(i / 60)
    matrix = np.eye(4)
    matrix[:3, 0] = EDGE / SIZE[1] * np.array([1, 0, 0])
    matrix[:3, 1] = EDGE / SIZE[0] * np.array([0, np.cos(turn), np.sin(turn)])
    matrix[2, 3] = EDGE * (share if i // 400 % 2 == 0 else 1 - share)
    return matrix


def send(port: int, rate: float, n: int) -> None:
    rng = np.random.default_rng(0)
    shown = rng.integers(1, 255, (8, 1, *SIZE)).astype(np.uint8)
    with socket.create_server(("127.0.0.1", port)) as listener:
        connection, _ = listener.accept()
    begun = time.time() + 0.2
    with connection, contextlib.suppress(OSError):
        for i in range(n):
            time.sleep(max(0.0, begun + i / rate - time.time()))
            image = pyigtl.ImageMessage(shown[i % 8], pose(i), timestamp=begun + i / rate, device_name="Image")
            connection.sendall(image.pack())
        time.sleep(1)


def main() -> None:
    """Run and print a table."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--frames", type=int, default=10_000)
    parser.add_argument("--rate", type=float, default=40.0, help="images a second")
    parser.add_argument("--crash", action="store_true")
    parser.add_argument("more", nargs="*", help="arguments of globule, after --")
    options = parser.parse_args()
    with socket.create_server(("127.0.0.1", 0)) as listener:
        port = listener.getsockname()[1]
    server = multiprocessing.Process(target=send, args=(port, options.rate, options.frames), daemon=True)
    server.start()
    with tempfile.TemporaryDirectory() as folder:
        out, log = Path(folder) / "v.npz", Path(folder) / "log.npy"
        bounds = ",".join(f"{v:g}" for v in (0, 0, 0, EDGE, EDGE, EDGE))
        words = [sys.executable, "-c", CHILD, str(log), "reconstruct", "--live", f"igtl://127.0.0.1:{port}",
                 "--voxel-size", str(EDGE / 256), "--bounds", bounds, "--idle", "3", "--wait", "60",
                 "--device", "cpu", "--json", "-o", str(out), *options.more]  # fmt: skip
        process = subprocess.Popen(words, stdout=subprocess.PIPE, text=True)
        if options.crash:
            time.sleep(options.frames / options.rate)
            process.send_signal(signal.SIGKILL)
            process.communicate()
            from globule.volumes.files import read_volume

            age = time.time() - out.stat().st_mtime
            print(f"killed; the volume on the disk is {age:.1f} s old: {read_volume(str(out)).n_measured:,} voxels")
            server.terminate()
            return
        text, _ = process.communicate()
        if process.returncode:
            raise SystemExit(process.returncode)
        facts, found = json.loads(text), np.load(log)
    server.join()
    used = f"{facts['frames']['used']} of {options.frames} frames used"
    print(f"{os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}; volume {facts['volume']['size']}, {used}")
    print(facts["live"]["counts"], facts["warnings"])
    print("| frames | memory, MiB | delay, median | delay, 99 % |\n|---|---|---|---|")
    for last in [n for n in (500, 1000, 2500, 5000, 10_000, 20_000) if n <= len(found)]:
        delay, memory = found[max(last - AROUND, 0) : last].T
        print(f"| {last:,} | {memory[-1] / 2**20:,.0f} | {1e3 * np.median(delay):.1f} ms | "
              f"{1e3 * np.percentile(delay, 99):.0f} ms |")  # fmt: skip


if __name__ == "__main__":
    main()
