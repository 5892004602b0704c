"""Speed of reconstruction: `python -m bench.ultrasound [--device cuda] [--sizes 128,256,512]`.

A synthetic sweep, 131 frames of 387 x 400 pixels along a hand-like path (thesis Table 4.1), is
binned and its holes are filled up to 9^3. Times are the best of some runs: `bin` and `fill` on the
device from frames that are there (on a GPU: with CuPy), `total` from host frames to a host
volume. Prints a table and hashes of the volumes, the same on every device, and writes CSV.
"""

from __future__ import annotations

import argparse
import hashlib
import os
import platform
import time

import globule as gb
import numpy as np
from globule import _core
from globule._base.device import choose
from globule.ultrasound.grid import bounds, make_grid
from globule.ultrasound.options import METHODS, Options
from globule.ultrasound.reconstruct import crowded, fill, located_frames, start

from .speed import write_csv
from .tables.sweep_speed import placed

THESIS = {  # seconds on a GTX 1080, 131 frames
    (128, "pvn-om"): 0.72, (128, "vvn-om"): 1.07, (128, "pvn"): 4.98, (128, "vvn"): 2.71,
    (256, "pvn-om"): 7.86, (256, "vvn-om"): 8.71, (256, "pvn"): 24.47, (256, "vvn"): 16.22,
    (512, "pvn-om"): 79.79, (512, "vvn-om"): 86.28, (512, "pvn"): 121.71, (512, "vvn"): 239.55,
}  # fmt: skip


def make_sweep(n: int, shape: tuple[int, int]) -> gb.ultrasound.Sweep:
    """Frames of 0.1 mm pixels, 0.3 mm apart, the hand wobbling; blobs and speckle, from integers
    only, so that the sweep is the same on every machine."""
    h, w = shape
    rng = np.random.default_rng(44)
    speckle = rng.integers(0, 64, (h, w), np.int64)
    j, i = np.indices(shape)
    frames = np.empty((n, h, w), np.uint8)
    poses = np.tile(np.eye(4), (n, 1, 1))
    for f in range(n):
        cx, cy = w // 2 + (f * 7) % 40 - 20, h // 2 + (f * 5) % 30 - 15
        inside = (i - cx) ** 2 + (j - cy) ** 2 < (60 + f % 20) ** 2
        frames[f] = np.where(inside, 30, 120) + np.roll(speckle, 17 * f, 1) + (j * 40) // h
        # Angles in multiples of 1/1024, as (cos, sin) of a rational rotation.
        t = (32 + (f % 16) - 8) / 1024
        c, s = (1 - t * t) / (1 + t * t), 2 * t / (1 + t * t)
        poses[f, :3, :3] = 0.125 * np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
        poses[f, :3, 3] = (0.125 * (f % 3), 0.0625 * (f % 5), 0.3125 * f)
        poses[f, 2, 1] = 0.125 * t
    return gb.ultrasound.Sweep(frames, poses)


def measure(sweep: gb.ultrasound.Sweep, size: int, method: str, device: str, threads: int, runs: int) -> dict:
    frames, chosen, options = sweep.frames, choose(device), Options(method)
    low, high = bounds(sweep.world_from_image, None, frames.shape[1:])
    # The thesis' volumes are cubes of `size` voxels.
    middle, half = 0.5 * (low + high), 0.5 * float((high - low).max()) * (1 + 1e-6)
    region = np.array([middle - half, middle + half])
    grid = make_grid(low, high, None, (size, size, size), region)
    poses = grid.poses(sweep.world_from_image)
    whole = located_frames(frames, poses, None)
    core = _core.SweepGrid(chosen.name, threads)
    best = {"bin_ms": np.inf, "fill_ms": np.inf, "total_ms": np.inf}
    dense = None
    there_frames = placed(sweep, device).frames
    there = whole if there_frames is frames else located_frames(there_frames, poses, None)
    for run in range(2 * runs + 1):  # the first run takes the memory
        source = whole if run % 2 == 0 else there
        begin = time.perf_counter()
        start(core, grid, frames, options, crowded(poses, frames.shape[1:]))
        if method == "pvn-om":
            core.add(source, 1)
        elif method == "bezier":
            core.bezier(source)
        dense = fill(core, grid, frames.dtype, options, source, dense)
        total = time.perf_counter() - begin
        facts = core.facts()
        times = {"total_ms": total} if source is whole else {}
        if source is there or there is whole:
            times |= {"bin_ms": facts["bin_seconds"], "fill_ms": facts["fill_seconds"]}
        for name, value in times.items():
            best[name] = min(best[name], 1e3 * value)
    values, radius = dense
    return {
        "method": method,
        "voxels": f"{size}^3",
        **{k: round(v, 3) for k, v in best.items()},
        "thesis_ms": 1e3 * THESIS.get((size, method), float("nan")),
        "measured": int(np.count_nonzero(radius == 0)),
        "filled": int(np.count_nonzero((radius > 0) & (radius < 255))),
        "MiB": round(facts["bytes"] / 2**20),
        "hash": hashlib.sha256(values.tobytes() + radius.tobytes()).hexdigest()[:16],
        "device": chosen.description,
    }


def live(device: str, threads: int, size: int = 256, n: int = 60) -> dict:
    """Frames of 820 x 616 one by one into a volume that is read after each."""
    chosen = choose(device)
    sweep = make_sweep(n, (616, 820))
    low, high = bounds(sweep.world_from_image, None, (616, 820))
    live_volume = gb.ultrasound.Reconstructor(
        float((high - low).max()) / size, region=(low, high), device=device, threads=threads
    )
    times = []
    for f in range(n):
        begin = time.perf_counter()
        live_volume.add(sweep.frames[f], sweep.world_from_image[f])
        volume = live_volume.volume()
        times.append(1e3 * (time.perf_counter() - begin))
    late = times[n // 4 :]
    return {
        "live": f"{size} voxels, 820x616",
        "latency_ms_median": round(float(np.median(late)), 2),
        "latency_ms_worst": round(max(late), 2),
        "frames_per_second": round(1e3 / float(np.mean(late)), 1),
        "hash": hashlib.sha256(volume.values.tobytes()).hexdigest()[:16],
        "device": chosen.description,
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--device", default="auto")
    parser.add_argument("--threads", type=int, default=0)
    parser.add_argument("--sizes", default="128,256,512")
    parser.add_argument("--methods", default="pvn-om,vvn-om,bezier", help=", ".join(METHODS))
    parser.add_argument("--frames", type=int, default=131)
    parser.add_argument("--runs", type=int, default=5)
    parser.add_argument("-o", "--output", help="CSV file")
    options = parser.parse_args()
    sweep = make_sweep(options.frames, (400, 387))
    rows = []
    for size in options.sizes.split(","):
        for method in options.methods.split(","):
            rows.append(measure(sweep, int(size), method, options.device, options.threads, options.runs))
            show(rows[-1])
    show(live(options.device, options.threads))
    print(f"machine: {platform.machine()}, {os.cpu_count()} cores, Python {platform.python_version()}")
    if options.output:
        write_csv(options.output, rows)


def show(row: dict) -> None:
    print("  ".join(f"{k} {v}" for k, v in row.items()), flush=True)


if __name__ == "__main__":
    main()
