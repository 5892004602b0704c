"""From an HDF5 file to the first image, beside a raw read of the same arrays by h5py.

    python -m bench.read_hdf5 [--particles 10000000] [--device cpu] [--size 1920x1080]

Writes a snapshot in the manner of Gadget (positions, float32; with --lengths also smoothing
lengths), and prints seconds and CPU seconds, with those of child processes: of the raw read, of
`gb.read`, and of file to image. The file is in the system's cache. Medians of three; the first
`gb.read` of a program starts the process that opens HDF5, too.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import resource
import tempfile
import time
from pathlib import Path

import globule as gb
import h5py
import numpy as np

from .tables.scenes import pool

NAMES = ("Coordinates", "SmoothingLength")


def cpu() -> float:
    """Seconds of this process and of its children, those that run as well."""
    used = [resource.getrusage(w) for w in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    seconds = sum(u.ru_utime + u.ru_stime for u in used)
    for path in Path("/proc").glob("[0-9]*/stat"):
        with contextlib.suppress(OSError):
            words = path.read_text(encoding="utf-8").rpartition(")")[2].split()
            if int(words[1]) == os.getpid():
                seconds += sum(map(int, words[11:15])) / os.sysconf("SC_CLK_TCK")
    return seconds


def raw(path: Path) -> list[np.ndarray]:
    with h5py.File(path) as file:
        group = file["PartType0"]
        return [group[name][()] for name in NAMES if name in group]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--particles", type=int, default=10_000_000)
    parser.add_argument("--device", default="auto")
    parser.add_argument("--size", default="1920x1080")
    parser.add_argument("--lengths", action="store_true", help="smoothing lengths, too")
    options = parser.parse_args()
    size = tuple(map(int, options.size.split("x")))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "snapshot.hdf5")
        positions, spacing = pool(options.particles)
        with h5py.File(path, "w") as file:
            file["PartType0/Coordinates"] = positions
            if options.lengths:
                file["PartType0/SmoothingLength"] = np.full(len(positions), 2 * spacing, np.float32)
            file.create_group("Header").attrs["BoxSize"] = 0.0
        del positions
        print(f"{options.particles:,} particles, {path.stat().st_size / 1e6:.0f} MB")
        gb.render(np.zeros((1, 3)), (8, 8))  # loads the device

        def image() -> gb.Frame:
            scene = gb.Scene(gb.read(path), device=options.device)
            return gb.render(scene, size=size).picture

        wall, used = time.perf_counter(), cpu()
        gb.read(path)
        wall, used = time.perf_counter() - wall, cpu() - used
        print(f"{'first gb.read':14} {wall:7.3f} s {used:7.3f} CPU s", flush=True)
        works = {"raw read": lambda: raw(path), "gb.read": lambda: gb.read(path),
                 "file to image": image}  # fmt: skip
        for name, work in works.items():
            times = []
            for _ in range(3):
                wall, used = time.perf_counter(), cpu()
                work()
                times.append((time.perf_counter() - wall, cpu() - used))
            wall, used = np.median(times, axis=0)
            print(f"{name:14} {wall:7.3f} s {used:7.3f} CPU s", flush=True)


if __name__ == "__main__":
    main()
