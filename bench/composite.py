"""Compositing alone: `mpiexec -n 8 python -m bench.composite`; without MPI `--threads-of-one 8`.

Images of random depth on every rank. `shaded` has a distance and a color for every pixel, as
`bench/scale.py --mode pieces` sends them; of `hits`, as `Scene(comm=)` sends them, every rank has
its share of the pixels, and some that another rank's hits hide. Prints processor time for each
rank: medians over the rounds. All ranks sleep until the last one has come, so that waiting for
others' work before the round does not count; waiting within it does.
"""

from __future__ import annotations

import argparse
import time
from typing import Any

import numpy as np
from globule._base.ranks import Alone, Ranks, run_threads
from globule.render.pieces.hits import Hits, nearest
from globule.render.pieces.whole_images import nearest_image

ROUNDS = 15


def run(ranks: Alone, options: argparse.Namespace, comm: Any = None) -> None:
    """One rank's work; rank 0 prints."""
    width, height = (int(v) for v in options.size.split("x"))
    n = width * height
    rng = np.random.default_rng(ranks.rank)
    depth = rng.random((height, width), np.float32)
    picture = rng.integers(0, 255, (height, width, 3), np.uint8)
    own = np.flatnonzero(rng.random(n) < options.covered * options.behind / ranks.size)
    rows = rng.random((7, len(own)), np.float32)
    times = []
    for _ in range(ROUNDS):
        hits = Hits(n)
        hits.put(own, rows[0], rows[1:4].T, rows[4:].T, 0)
        both = []
        for work in (lambda: nearest_image(ranks, depth, picture),
                     lambda hits=hits: nearest(ranks, hits)):  # fmt: skip
            if comm is None:
                ranks.all(None)
            else:
                request = comm.Ibarrier()
                while not request.Test():
                    time.sleep(0.002)
            start = time.thread_time() if comm is None else time.process_time()
            work()
            both.append((time.thread_time() if comm is None else time.process_time()) - start)
        times.append(both)
    medians = ranks.all(1e3 * np.median(times[3:], axis=0))
    if ranks.rank == 0:
        for name, each in zip(("shaded", "hits"), np.transpose(medians), strict=True):
            print(f"{name}: {', '.join(f'{t:.1f}' for t in each)} ms", flush=True)


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--size", default="1920x1080")
    parser.add_argument("--covered", type=float, default=0.2, help="share of pixels with a hit")
    parser.add_argument("--behind", type=float, default=2.0, help="ranks behind each other")
    parser.add_argument("--threads-of-one", type=int, default=0, metavar="N")
    options = parser.parse_args()
    if options.threads_of_one:
        run_threads(options.threads_of_one, lambda ranks: run(ranks, options))
        return
    from mpi4py import MPI

    run(Ranks(MPI.COMM_WORLD), options, MPI.COMM_WORLD)


if __name__ == "__main__":
    main()
