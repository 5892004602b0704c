"""Damaged OpenIGTLink streams and network faults: a volume at the end of each, every image accounted for.

    python -m bench.live_damaged [--streams 2000] [--faults 60] [--seed 0]

Each stream has 8 images with their poses and one to three of its messages changed, cut, lengthened, given
another size, or led by garbage. Each network fault cuts or resets the connection inside of a message, is
slow, or begins with garbage. `globule reconstruct --live` must end with a volume that can be read, and all
images must be in a volume or in one of the counts that it reports; none that came may count twice.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import multiprocessing
import os
import socket
import struct
import tempfile
import threading
import time
import warnings
from collections.abc import Callable

import numpy as np
import pyigtl
from globule.cli import main as globule
from globule.volumes.files import read_volume

N = 8  # images of a stream
MUTATIONS: dict[str, Callable[[np.random.Generator, bytes], bytes]] = {
    "flip": lambda rng, m: m[: (i := int(rng.integers(len(m))))] + bytes([m[i] ^ 1 << rng.integers(8)]) + m[i + 1 :],
    "cut": lambda rng, m: m[: int(rng.integers(1, len(m)))],
    "insert": lambda rng, m: m[: (i := int(rng.integers(len(m))))] + rng.bytes(int(rng.integers(1, 200))) + m[i:],
    "delete": lambda rng, m: m[: (i := int(rng.integers(1, len(m))))] + m[i + int(rng.integers(1, 90)) :],
    "garbage": lambda rng, m: rng.bytes(int(rng.integers(1, 3000))) + m,
    "size": lambda rng, m: m[:42] + int(rng.integers(0, 2 ** int(rng.integers(1, 40)))).to_bytes(8, "big") + m[50:],
}
FAULTS = ("cut", "reset", "slow", "garbage")
Part = tuple[str, list[bytes]]  # what happens at the end of a connection, and what is sent before


def messages() -> list[bytes]:
    """Images of a small phantom with their poses, in turn."""
    rng, found = np.random.default_rng(0), []
    for i in range(N):
        pose = np.eye(4)
        pose[:3, 3] = 0.2 * np.sin(i), 0, 0.8 * i
        image = np.clip(60 + 8 * i + rng.normal(0, 20, (1, 24, 30)), 1, 255).astype(np.uint8)
        found.append(pyigtl.ImageMessage(image, timestamp=1000 + i / 25, device_name="Image").pack())
        found.append(pyigtl.TransformMessage(pose, timestamp=1000 + i / 25, device_name="ImageToReference").pack())
    return found


def stream(seed: int) -> list[Part]:
    """One connection with one to three damaged messages."""
    rng, sent = np.random.default_rng(seed), messages()
    for which in rng.choice(len(sent), int(rng.integers(1, 4)), replace=False):
        kind = list(MUTATIONS)[int(rng.integers(len(MUTATIONS)))]
        sent[which] = MUTATIONS[kind](rng, sent[which])
    return [("close", sent)]


def fault(seed: int) -> list[Part]:
    """Connections, of which the first ends early; the server goes on with the next message."""
    rng, sent = np.random.default_rng(seed), messages()
    kind, at = FAULTS[seed % len(FAULTS)], int(rng.integers(2, len(sent) - 1))
    if kind == "slow":
        return [("slow", sent)]
    if kind == "garbage":
        return [("close", [rng.bytes(int(rng.integers(1, 5000))), *sent])]
    inside = sent[at][: int(rng.integers(1, len(sent[at])))]
    return [(kind, [*sent[:at], inside]), ("close", sent[at + 1 :])]


def serve(listener: socket.socket, parts: list[Part]) -> None:
    with listener:
        for how, sent in parts:
            connection, _ = listener.accept()
            with connection, contextlib.suppress(OSError):
                for message in sent:
                    if how == "slow":
                        for i in range(0, len(message), 97):
                            connection.sendall(message[i : i + 97])
                            time.sleep(0.002)
                    else:
                        connection.sendall(message)
                if how == "reset":
                    time.sleep(0.05)
                    connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))


def run(parts: list[Part]) -> str:
    """What is wrong with a run, or ""."""
    listener = socket.create_server(("127.0.0.1", 0))
    words = ["reconstruct", "--live", f"igtl://127.0.0.1:{listener.getsockname()[1]}", "--voxel-size", "1",
             "--idle", "0.25", "--wait", "20", "--device", "cpu", "--threads", "1", "--json", "-o"]  # fmt: skip
    thread = threading.Thread(target=serve, args=(listener, parts), daemon=True)
    thread.start()
    out, said = io.StringIO(), io.StringIO()
    with tempfile.TemporaryDirectory() as folder:
        path = os.path.join(folder, "v.npz")
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(said), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            try:
                status = globule([*words, path])
            except Exception as error:  # what is looked for
                return f"{type(error).__name__}: {error}"
        if status:
            return f"status {status}: {said.getvalue().strip()}"
        if not (read_volume(path).radius < 255).any():
            return "an empty volume"
    facts = json.loads(out.getvalue())
    counts, live = facts["live"]["counts"], facts["live"]
    known = facts["frames"]["total"] + sum(other["frames"] for other in facts["others"])
    known += sum(counts[name] for name in ("without_pose", "useless", "repeated", "missed"))
    if (came := known - counts["missed"] + counts["broken_images"]) > N:
        return f"{came} images of {N} came: {live}"
    known += sum(sum(live[name].values()) for name in ("broken", "unused", "other_devices"))
    return "" if known >= N else f"{N - known} images are nowhere: {live}"


def _run(job: tuple[str, int]) -> tuple[tuple[str, int], str]:
    kind, seed = job
    return job, run(stream(seed) if kind == "stream" else fault(seed))


def main() -> None:
    """Run all and print what is wrong."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--streams", type=int, default=2000)
    parser.add_argument("--faults", type=int, default=60)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    jobs = [("fault", options.seed + i) for i in range(options.faults)]
    jobs += [("stream", options.seed + i) for i in range(options.streams)]
    wrong: dict[str, int] = {"fault": 0, "stream": 0}
    with multiprocessing.Pool(min(8, 2 * (os.cpu_count() or 1))) as pool:  # most of the time waits for silence
        for (kind, seed), what in pool.imap_unordered(_run, jobs):
            if what:
                wrong[kind] += 1
                print(f"{kind} {seed}: {what}", flush=True)
    print(f"{options.streams} damaged streams, {wrong['stream']} wrong; {options.faults} network faults, "
          f"{wrong['fault']} wrong")  # fmt: skip


if __name__ == "__main__":
    main()
