"""Several devices: `mpiexec -n 2 python -m bench.scale`, or without MPI `python -m bench.scale
--threads-of-one 2`, each thread with a GPU of its own.

A jittered lattice, made on each rank from a seed. --mode pieces: each rank has a slab of it with a
halo, and the nearest of all ranks' hits is the image. --mode replicate: each rank has all of it and
traces its share of the pixels. Every frame builds the octree again, unless --still. --mode shares,
on one device: it traces the shares of 2 and of 4 devices, one after the other. This says what each
of so many devices would take, without their compositing. --table: all of docs/scale.md's cases, on 1, 2, 4
and 8 of the GPUs that there are; with --record MACHINE into docs/measured.csv, of which docs/make_measured.py
makes the page's table.

Times are medians over the frames, of the slowest rank: build and trace on the device, composite
from the ranks' finished frames to the image on rank 0, frame in all. Prints a table, and with
--json or --csv a line of facts; `hits` and `mask` are the same for any number of devices.
"""

from __future__ import annotations

import argparse
import csv
import json
import os
import time
import zlib
from pathlib import Path
from typing import Any

import globule as gb
import numpy as np
from globule._base.device import choose, of_rank
from globule._base.memory import resident_bytes
from globule._base.ranks import Alone, Ranks, local_rank, run_threads
from globule.render.pieces.whole_images import nearest_frame

from .tables.report import record
from .tables.scenes import pool

HALO = 3  # lattice steps: the support, and the noise of both ends
WATER = gb.Material(transmission=1.0, index=1.33, absorption=(0.4, 0.1, 0.05))
LIGHT = {
    "plain": gb.RenderSettings(),
    "water": gb.RenderSettings(material=WATER, sky=gb.Sky(), bounces=4),
    "ambient": gb.RenderSettings(ambient_rays=1),
    "shadow": gb.RenderSettings(shadows=True),
}
# Of --table: options, and the fewest GPUs that hold it.
TABLE = {
    "1 billion": ("--particles 1e9", 1),
    "1 billion, octree stays": ("--particles 1e9 --still", 1),
    "4 billion": ("--particles 4e9", 2),
    "8 billion": ("--particles 8e9", 4),
    "16 billion": ("--particles 16e9", 8),
    "750,000, water": ("--mode replicate --pool --particles 750000 --light water --frames 30", 1),
    "170 million, ambient rays, 3840×2160": (
        "--mode replicate --particles 170e6 --light ambient --size 3840x2160", 1,
    ),
}  # fmt: skip
QUANTITIES = ("build_ms", "trace_ms", "composite_ms", "frame_ms", "fps", "octree_gib", "hits")
POINT = """
    unsigned long long k = first + i;
    unsigned long long cell = k / width * across + k % width + begin;
    unsigned long long row = cell / across;
    float at[3] = {(float)(cell % across), (float)(row % edge), (float)(row / edge)};
    for (int a = 0; a < 3; ++a) {
        unsigned v = (unsigned)(cell * 3 + a) ^ (unsigned)((cell * 3 + a) >> 32) * 0x9e3779b9u;
        v = v * 747796405u + 2891336453u;
        v = ((v >> ((v >> 28) + 4)) ^ v) * 277803737u;
        v = (v >> 22) ^ v;
        p[3 * i + a] = at[a] + 0.25f * ((float)(v >> 8) * 5.9604644775390625e-8f);
    }
"""


class Lattice:
    """About n particles, spacing 1, in a box twice as long as high and deep."""

    def __init__(self, n: int):
        self.edge = max(2, round((n / 2) ** (1 / 3)))
        self.across = 2 * self.edge
        self.n = self.across * self.edge**2
        e = float(self.edge)
        self.camera = gb.Camera((2.6 * e, 1.8 * e, -1.5 * e), (e, 0.4 * e, 0.5 * e))

    def slab(self, begin: int, end: int, device: int | None) -> Any:
        """(M, 3) float32, the points from x = begin to end - 1, on a GPU or, with None, here."""
        begin, end = max(begin, 0), min(end, self.across)
        width = end - begin
        n = width * self.edge**2
        if device is None:
            return self._on_cpu(begin, width, n)
        import cupy

        kernel = cupy.ElementwiseKernel(
            "uint64 first, uint64 width, uint64 begin, uint64 across, uint64 edge",
            "raw float32 p", POINT, "lattice",
        )  # fmt: skip
        with cupy.cuda.Device(device):
            points = cupy.empty((n, 3), cupy.float32)
            step = 1 << 28
            for first in range(0, n, step):
                some = points[first : first + step]
                kernel(first, width, begin, self.across, self.edge, some.ravel(),
                       size=len(some))  # fmt: skip
            cupy.cuda.Device().synchronize()
        return points

    def _on_cpu(self, begin: int, width: int, n: int) -> np.ndarray:
        points = np.empty((n, 3), np.float32)
        for first in range(0, n, 1 << 20):
            k = np.arange(first, min(n, first + (1 << 20)), dtype=np.uint64)
            cell = k // width * self.across + k % width + begin
            at = (cell % self.across, cell // self.across % self.edge,
                  cell // self.across // self.edge)  # fmt: skip
            for axis, whole in enumerate(at):
                c = cell * 3 + axis
                v = c.astype(np.uint32) ^ (c >> 32).astype(np.uint32) * np.uint32(0x9E3779B9)
                v = v * np.uint32(747796405) + np.uint32(2891336453)
                v = ((v >> ((v >> 28) + 4)) ^ v) * np.uint32(277803737)
                v = (v >> 22) ^ v
                noise = (v >> 8).astype(np.float32) * np.float32(2**-24)
                points[first : first + len(k), axis] = whole.astype(np.float32) + np.float32(0.25) * noise
        return points


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    add = parser.add_argument
    add("--mode", choices=("pieces", "replicate", "shares"), default="pieces")
    add("--particles", type=float, default=1e6)
    add("--pool", action="store_true", help="the pool of particles in place of the lattice")
    add("--light", choices=tuple(LIGHT), default="plain")
    add("--size", default="1920x1080")
    add("--frames", type=int, default=5)
    add("--still", action="store_true", help="the octree is built once")
    add("--device", default="auto")
    add("--threads", type=int, default=0, help="of a CPU, for each rank (default: its share)")
    add("--threads-of-one", type=int, default=0, metavar="N", help="N ranks in this process")
    add("--csv", help="file to which a row is added")
    add("--json", action="store_true")
    add("--save", help="PNG of the image")
    add("--table", action="store_true", help="the cases of docs/scale.md")
    add("--record", metavar="MACHINE", help="with --table: into docs/measured.csv, too")
    options = parser.parse_args()
    if options.table:
        return table(parser, options.record)
    if options.mode == "shares":
        return shares(options)
    if options.threads_of_one:
        facts = run_threads(options.threads_of_one, lambda r: run(options, r, r.rank))[0]
    else:
        ranks, local = _mpi()
        facts = run(options, ranks, local)
    if facts:
        report(options, facts)


def table(parser: argparse.ArgumentParser, machine: str | None) -> None:
    """All cases, each on as many GPUs as it takes and more, or on one for each process of MPI; the
    same hits on any number."""
    import cupy

    ranks, local = _mpi()
    there, cases = cupy.cuda.runtime.getDeviceCount(), {}
    numbers = (ranks.size,) if ranks.size > 1 else tuple(k for k in (1, 2, 4, 8) if k <= there)
    for case, (line, fewest) in TABLE.items():
        options = parser.parse_args([*line.split(), "--device", "cuda"])
        found: set[tuple[Any, Any]] = set()
        for n in (k for k in numbers if fewest <= k):
            if ranks.size > 1:
                facts = run(options, ranks, local)
            else:
                facts = run_threads(n, lambda r, options=options: run(options, r, r.rank))[0]
            for k in range(there):
                with cupy.cuda.Device(k):
                    cupy.get_default_memory_pool().free_all_blocks()
            if not facts:
                continue
            report(options, facts)
            found.add((facts["hits"], facts["mask"]) if facts["hits"] else (None, facts["image"]))
            one = ", 1 GPU" if n == 1 else f", {n} GPUs" + ", processes" * (ranks.size > 1)
            cases[case + one] = {k: facts[k] for k in QUANTITIES}
        assert len(found) < 2, f"{case}: other hits on another number of GPUs: {found}"
    if machine and ranks.rank == 0:
        record("scale", machine, cases)


def _mpi() -> tuple[Alone, int]:
    if not any(name in os.environ for name in ("PMI_SIZE", "OMPI_COMM_WORLD_SIZE", "PMIX_RANK")):
        return Alone(), 0
    from mpi4py import MPI

    return Ranks(MPI.COMM_WORLD), local_rank(MPI.COMM_WORLD)


class OneOf(Alone):
    """One of n ranks, whose others are not there."""

    only_image = True

    def __init__(self, rank: int, size: int):
        self.rank, self.size = rank, size

    def all(self, value: Any) -> list[Any]:
        """This rank's value in the place of all."""
        return [value] * self.size

    def gather(self, *_: Any) -> None:
        """Nothing: no image is put together."""


def shares(options: argparse.Namespace) -> None:
    """Print what each of 1, 2 and 4 devices would take for its share of the image."""
    scene, camera, size, positions = made(options, Alone(), 0)[:4]
    for n in (1, 2, 4):
        medians = []
        for rank in range(n):
            comm, times = OneOf(rank, n) if n > 1 else None, []
            for k in range(options.frames + 2):
                if not options.still:
                    scene.update(positions=positions)
                frame = gb.render(scene, camera, size, LIGHT[options.light], comm=comm)
                if k >= 2:
                    times.append((frame.trace_seconds, scene.octree.build_seconds))
            medians.append(1e3 * np.median(times, axis=0))
        trace, build = np.array(medians).T
        each = ", ".join(f"{t:.2f}" for t in trace)
        print(f"{len(scene):,} particles, {options.light}, {options.size}, {n} devices: build "
              f"{build.max():.2f} ms, traces {each} ms", flush=True)  # fmt: skip


def made(options: argparse.Namespace, ranks: Alone, local: int) -> tuple:
    """A rank's scene, the camera, the image's size, positions; device and particles in all."""
    device = choose(of_rank(options.device, local))
    gpu = device.index if device.backend == "cuda" else None
    size = tuple(int(v) for v in options.size.split("x"))
    threads = options.threads or max(1, len(os.sched_getaffinity(0)) // ranks.size)
    if options.pool:
        positions, spacing = pool(int(options.particles))
        n, camera, support = len(positions), gb.Camera.fit(positions, size=size), 2 * spacing
        if gpu is not None:
            import cupy

            with cupy.cuda.Device(gpu):
                positions = cupy.asarray(positions)
    else:
        lattice = Lattice(int(options.particles))
        n, camera, support = lattice.n, lattice.camera, 2.0
        begin, end = 0, lattice.across
        if options.mode == "pieces" and ranks.size > 1:
            begin, end = (lattice.across * k // ranks.size for k in (ranks.rank, ranks.rank + 1))
            begin, end = begin - HALO, end + HALO
        positions = lattice.slab(begin, end, gpu)
    scene = gb.Scene(gb.Particles(positions, support=support), threshold=0.6,
                     device=device.name, threads=threads)  # fmt: skip
    return scene, camera, size, positions, device, n


def run(options: argparse.Namespace, ranks: Alone, local: int) -> dict[str, Any]:
    """One rank's work; rank 0 has the facts."""
    scene, camera, size, positions, device, n = made(options, ranks, local)
    ranks.only_image = True
    rows = []
    for k in range(options.frames + 2):
        ranks.all(0)
        start = time.perf_counter()
        if not options.still:
            scene.update(positions=positions)
        if options.mode == "pieces":
            frame = gb.render(scene, camera, size, LIGHT[options.light])
            trace = frame.trace_seconds  # waits for the frame
            traced = time.perf_counter()
            found = nearest_frame(ranks, frame)
            composite = time.perf_counter() - traced
        else:
            comm = ranks if ranks.size > 1 else None
            frame = gb.render(scene, camera, size, LIGHT[options.light], comm=comm)
            picture = frame.image
            found, trace = (None, picture), frame.trace_seconds
            composite = frame._frame.composite_seconds if comm else 0.0
            if comm:  # this rank's own, for the imbalance
                trace = frame._frame.seconds[ranks.rank]
        end_of_frame = time.perf_counter()
        if k >= 2:  # the first ones take memory
            build = 0.0 if options.still else scene.octree.build_seconds
            rows.append((build, trace, composite, end_of_frame - start))
    times = np.median(np.array(rows), axis=0)
    slowest, all_times = ranks.most(times), ranks.all(times)
    facts = ranks.all({"held": len(scene), "bytes": scene.octree.bytes, "rss": resident_bytes()})
    if ranks.rank:
        return {}
    assert found is not None
    depth, picture = found
    trace_times = [t[1] for t in all_times]
    return {
        "mode": options.mode, "devices": ranks.size, "device": device.description,
        "particles": n, "light": options.light, "size": options.size, "still": options.still,
        "build_ms": 1e3 * slowest[0], "trace_ms": 1e3 * slowest[1],
        "composite_ms": 1e3 * slowest[2], "frame_ms": 1e3 * slowest[3],
        "fps": 1 / slowest[3],
        "imbalance": max(trace_times) / max(float(np.mean(trace_times)), 1e-9),
        "held": [f["held"] for f in facts], "octree_gib": max(f["bytes"] for f in facts) / 2**30,
        "rss_gib": max(f["rss"] for f in facts) / 2**30,
        "hits": int(np.isfinite(depth).sum()) if depth is not None else None,
        "mask": zlib.crc32(np.isfinite(depth).tobytes()) if depth is not None else None,
        "image": zlib.crc32(np.ascontiguousarray(picture).tobytes()), "_picture": picture,
    }  # fmt: skip


def report(options: argparse.Namespace, facts: dict[str, Any]) -> None:
    """Print the facts, and write what the options ask for."""
    picture = facts.pop("_picture")
    if options.save:
        gb.save_png(options.save, picture)
    if options.json:
        print(json.dumps(facts), flush=True)
    else:
        f = facts
        print(f"{f['mode']}, {f['devices']} of {f['device']}: {f['particles']:,} particles, "
              f"{f['light']}, {f['size']}", flush=True)  # fmt: skip
        print(f"  build {f['build_ms']:.1f} ms, trace {f['trace_ms']:.1f} ms (imbalance "
              f"{f['imbalance']:.2f}), composite {f['composite_ms']:.1f} ms, frame "
              f"{f['frame_ms']:.1f} ms = {f['fps']:.2f} fps; octree {f['octree_gib']:.1f} GiB; "
              f"hits {f['hits']}, mask {f['mask']}, image {f['image']}", flush=True)  # fmt: skip
    if options.csv:
        new = not Path(options.csv).exists()
        with open(options.csv, "a", newline="", encoding="utf-8") as file:
            writer = csv.DictWriter(file, facts)
            if new:
                writer.writeheader()
            writer.writerow(facts)


if __name__ == "__main__":
    main()
