"""Speed of build and trace: `python -m bench.speed [--device cuda] [--scenes splash,pool-302751]`.

Every frame rebuilds the octree from positions that moved, then traces one ray a pixel. Prints a
table and writes CSV; times are medians over frames of one run, fps is a whole loop over wall time.
fps_in_flight is the same with three scenes in turn: one is built while another is traced.
fps_to_host copies every picture out before the next frame is asked for; overlapped: after that.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import globule as gb
import numpy as np

from .tables.report import machine, record, write_csv
from .tables.scenes import pool

SPLASH = Path(__file__).parents[1] / ".carry" / "splash_117649.npz"
SPLASH_SHARED = Path(__file__).parents[2] / "shared" / "data" / "particles" / "splash_117649.npz"
SIZES = {  # particles: picture
    "splash": (1024, 782),
    "pool-302751": (1024, 782),
    "pool-770000": (1920, 1920),
    "pool-10000000": (1920, 1080),
    "pool-100000000": (1920, 1080),
}


def load(name: str) -> tuple[np.ndarray, float]:
    if name == "splash":
        path = SPLASH if SPLASH.exists() else SPLASH_SHARED
        return gb.read(path).positions, 0.02
    return pool(int(name.split("-")[1]))


def measure(name: str, device: str, frames: int, threads: int) -> dict:
    positions, spacing = load(name)
    n = len(positions)
    size = SIZES[name]
    camera = gb.Camera.fit(positions, size=size)
    sets = [positions]
    on_gpu = device.startswith("cuda")
    if on_gpu:
        import cupy

        sets = [cupy.asarray(positions)]
        if n <= 20_000_000:
            sets.append(sets[0] + cupy.float32(0.1 * spacing))
    scene = gb.Scene(gb.Particles(sets[0], support=2 * spacing), threshold=0.6, device=device, threads=threads)
    builds, traces = [], []
    for i in range(frames):
        scene.update(positions=sets[i % len(sets)])
        builds.append(scene.octree.build_seconds)
        traces.append(gb.render(scene, camera, size).trace_seconds)
    start = time.perf_counter()
    for i in range(frames):
        scene.update(positions=sets[i % len(sets)])
        frame = gb.render(scene, camera, size)
    scene._scene.synchronize()
    loop = (time.perf_counter() - start) / frames
    start = time.perf_counter()
    for i in range(frames):
        scene.update(positions=sets[i % len(sets)])
        picture = gb.render(scene, camera, size).picture
    shown = (time.perf_counter() - start) / frames
    start, before = time.perf_counter(), None
    for i in range(frames):
        scene.update(positions=sets[i % len(sets)])
        after = gb.render(scene, camera, size)
        if before is not None:  # copied while the next frame is made
            picture = before.picture
        before = after
    picture = before.picture
    overlapped = (time.perf_counter() - start) / frames
    octree = scene.octree
    del picture
    in_flight = 0.0
    if on_gpu and n <= 2_000_000:
        scenes = [scene] + [
            gb.Scene(gb.Particles(sets[0], support=2 * spacing), threshold=0.6, device=device) for _ in range(2)
        ]
        for start_up in (True, False):
            start = time.perf_counter()
            for i in range(3 if start_up else frames):
                scenes[i % 3].update(positions=sets[i // 3 % len(sets)])
                gb.render(scenes[i % 3], camera, size)
            for one in scenes:
                one._scene.synchronize()
        in_flight = frames / (time.perf_counter() - start)
    return {
        "scene": name,
        "particles": n,
        "rays": size[0] * size[1],
        "device": scene.device.description,
        "build_ms": 1e3 * float(np.median(builds)),
        "trace_ms": 1e3 * float(np.median(traces)),
        "fps": 1 / loop,
        "fps_to_host": 1 / shown,
        "fps_to_host_overlapped": 1 / overlapped,
        "fps_in_flight": in_flight,
        "bytes_per_particle": octree.bytes / n,
        "nodes": octree.n_nodes,
        "hit": float(frame.mask.mean()),
        "hash": octree.key_hash if n <= 20_000_000 else "-",
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--device", default="auto")
    parser.add_argument("--threads", type=int, default=0)
    parser.add_argument("--frames", type=int, default=0, help="0: as many as fit a few seconds")
    parser.add_argument("--scenes", default="splash,pool-302751")
    parser.add_argument("-o", "--output", help="CSV file")
    parser.add_argument("--record", metavar="MACHINE", help="write to docs/measured.csv, too")
    options = parser.parse_args()
    device = gb.Scene(np.zeros((1, 3)), device=options.device).device.name
    rows = []
    for name in options.scenes.split(","):
        if name == "splash" and not (SPLASH.exists() or SPLASH_SHARED.exists()):
            print(f"splash: {SPLASH_SHARED.name} is not there, skipped")
            continue
        frames = options.frames or (200 if device != "cpu" else 5)
        rows.append(measure(name, device, frames if not name.endswith("00000000") else 5, options.threads))
        row = rows[-1]
        print("  ".join(f"{k} {v:.4g}" if isinstance(v, float) else f"{k} {v}" for k, v in row.items()), flush=True)
    print(f"machine: {machine(rows[0]['device'])}")
    if options.output:
        write_csv(options.output, rows)
    if options.record:
        record("speed", options.record, {case_of(row["scene"], row["particles"]): row for row in rows})


def case_of(scene: str, n: int) -> str:
    """The case's name in docs/measured.csv."""
    return "{}, {:,} particles, {}×{}".format(scene.split("-")[0], n, *SIZES[scene])


if __name__ == "__main__":
    main()
