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
from .tables.report import machine
from .tables.resting_pool import resting_pool

SIZE = (1920, 1080)


def measure(name: str, device: str, frames: int, size: tuple[int, int]) -> list[str]:
    positions, spacing = load("splash" if name == "splash" else f"pool-{name}")
    sets = [positions, positions + np.float32(0.1 * spacing)]
    on_gpu = device.startswith("cuda")
    if on_gpu:
        import cupy

        sets = [cupy.asarray(p) for p in sets]
    clock = time.perf_counter if on_gpu else time.process_time
    camera = gb.Camera.fit(positions, size=size)
    cells = [name]
    for surface, edges in (("balls", 0), ("smooth", 0), ("smooth", 3)):
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
        build = scene.octree.build_seconds
        cells += [f"{1e3 * seconds:.2f}", f"{1e3 * build:.2f}"]
    cells.append(hashlib.sha256(frame.image.tobytes()).hexdigest()[:12])
    return cells


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--n", default="splash,302751")
    parser.add_argument("--frames", type=int, default=5)
    parser.add_argument("--size", default="1920x1080")
    options = parser.parse_args()
    width, height = map(int, options.size.split("x"))
    print(machine(options.device))
    print("particles | balls ms | build | smooth ms | build | with edge samples ms | build | hash")
    for name in options.n.split(","):
        print(
            " | ".join(measure(name, options.device, options.frames, (width, height))), flush=True
        )
    pool = resting_pool(device=options.device)
    print(
        f"simulated pool at rest, {pool.n} particles: normals {pool.angle:.2f} degrees rms;", end=""
    )
    print(f" height {pool.height:+.3f} spacings, changes by {pool.flicker:.4f} rms each 20 ms")


if __name__ == "__main__":
    main()
