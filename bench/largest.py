"""The largest scene: `python -m bench.largest [--device cuda] [--particles 2147483584]`.

Builds and draws a jittered lattice of so many particles, made on the GPU, and tries one more than
the limit and one that finds no memory, which are refused before anything is taken.
"""

from __future__ import annotations

import argparse
import time

import globule as gb

MOST = 2**31 - 64


def lattice(n: int):
    """(n, 3) float32 on the GPU, spacing 1, in a box about as deep as high."""
    import cupy

    edge = round((n / 2) ** (1 / 3))
    points = cupy.empty((n, 3), cupy.float32)
    step = 1 << 26
    for begin in range(0, n, step):
        i = cupy.arange(begin, min(n, begin + step), dtype=cupy.int64)
        part = points[begin : begin + len(i)]
        part[:, 0] = i % (2 * edge)
        part[:, 1] = i // (2 * edge) % edge
        part[:, 2] = i // (2 * edge * edge)
        part += 0.25 * cupy.random.random(part.shape, dtype=cupy.float32)
    cupy.cuda.Device().synchronize()
    return points


class Claim:
    """Says that it is longer than it is."""

    def __init__(self, array, n: int):
        self.array, self.shape, self.dtype = array, (n, 3), array.dtype
        self.__cuda_array_interface__ = {**array.__cuda_array_interface__, "shape": self.shape}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--device", default="cuda")
    parser.add_argument("--particles", type=int, default=MOST)
    options = parser.parse_args()
    import cupy

    points = lattice(options.particles)
    edge = float(points[-1, 2].get())
    camera = gb.Camera((2.6 * edge, 1.8 * edge, -1.5 * edge), (edge, 0.4 * edge, 0.5 * edge))
    start = time.perf_counter()
    scene = gb.Scene(gb.Particles(points, support=2.0), threshold=0.6, key_bits=64,
                     device=options.device)  # fmt: skip
    frame = gb.render(scene, camera, (1920, 1080))
    hit = frame.mask.mean()
    seconds = time.perf_counter() - start
    octree = scene.octree
    print(f"{len(scene):,} particles, {octree.n_nodes:,} nodes, {octree.bytes / 2**30:.1f} GiB, "
          f"build {1e3 * octree.build_seconds:.0f} ms, image {1e3 * frame.trace_seconds:.1f} ms, "
          f"{hit:.0%} of the pixels hit, {seconds:.2f} s in all")  # fmt: skip
    frame.save("build/largest.png")
    cupy.get_default_memory_pool().free_all_blocks()
    before = cupy.cuda.runtime.memGetInfo()[0]
    for what, make in (
        ("one more than the limit", lambda: Claim(points, MOST + 1)),
        ("no memory for it", lambda: points),
    ):
        hog = cupy.empty(max(0, before - (8 << 30)), "u1") if what.startswith("no") else None
        try:
            gb.Scene(gb.Particles(make(), support=2.0), device=options.device)
            print(f"{what}: taken")
        except (ValueError, TypeError, MemoryError) as error:
            print(f"{what}: {error}")
        del hog


if __name__ == "__main__":
    main()
