"""Speed of the smooth surface: `python -m bench.surface [--device cuda] [--n splash,302751]`.

Every frame rebuilds octree and kernels from positions that moved, then traces one ray a pixel;
`balls` is the same without kernels. Times are those of a loop over frames, by wall clock on a GPU
and in CPU seconds on the CPU. Prints a table with a hash of the last image, and how flat and steady
the surface of a simulated pool at rest is.
"""

from __future__ import annotations

import argparse
import hashlib
import time

import globule as gb
import numpy as np

from .speed import load
from .tables.report import Row, machine, print_table, record
from .tables.resting_pool import resting_pool

SIZE = (1920, 1080)


def measure(name: str, device: str, frames: int, size: tuple[int, int]) -> Row:
    positions, spacing = load("splash" if name == "splash" else f"pool-{name}")
    sets = [positions, positions + np.float32(0.1 * spacing)]
    on_gpu = device.startswith("cuda")
    if on_gpu:
        import cupy

        sets = [cupy.asarray(p) for p in sets]
    clock = time.perf_counter if on_gpu else time.process_time
    camera = gb.Camera.fit(positions, size=size)
    row: Row = {"particles": len(positions)}
    for what, surface, edges in (("balls", "balls", 0), ("smooth", "smooth", 0), ("edges", "smooth", 3)):
        kind = {"spacing": spacing} if surface == "smooth" else {"support": 2 * spacing}
        scene = gb.Scene(sets[0], surface=surface, device=device, **kind)
        settings = gb.RenderSettings(edge_samples=edges)
        for i in range(3):
            scene.update(positions=sets[i % 2])
            frame = gb.render(scene, camera, size, settings=settings)
        _ = frame.image
        begin = clock()
        for i in range(frames):
            scene.update(positions=sets[i % 2])
            frame = gb.render(scene, camera, size, settings=settings)
        _ = frame.distance
        seconds = (clock() - begin) / frames
        row[f"{what}_ms"] = 1e3 * seconds
        if what == "smooth":
            row["build_ms"] = 1e3 * scene.octree.build_seconds
    row["hash"] = hashlib.sha256(frame.image.tobytes()).hexdigest()[:12]
    return row


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--n", default="splash,302751")
    parser.add_argument("--frames", type=int, default=5)
    parser.add_argument("--size", default="1920x1080")
    parser.add_argument("--record", metavar="MACHINE", help="write to docs/measured.csv, too")
    options = parser.parse_args()
    width, height = map(int, options.size.split("x"))
    cases = {}
    for name in options.n.split(","):
        row = measure(name, options.device, options.frames, (width, height))
        scene = "splash" if name == "splash" else "pool"
        cases[f"{scene}, {row['particles']:,} particles, {width}×{height}"] = row
    print_table(machine(options.device), list(cases.values()))
    if options.record:
        record("surface", options.record, cases)
    pool = resting_pool(device=options.device)
    print(f"simulated pool at rest, {pool.n} particles: normals {pool.angle:.2f} degrees rms;", end="")
    print(f" height {pool.height:+.3f} spacings, changes by {pool.flicker:.4f} rms each 20 ms")


if __name__ == "__main__":
    main()
