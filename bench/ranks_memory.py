"""Memory of a rank: `mpiexec -n 4 python bench/ranks_memory.py`; on one rank, of one scene.

A jittered lattice, dealt to the ranks at random. Each rank makes its scene and updates it three
times. Prints for each rank its particles, the peak of its resident memory less what the program
itself takes, and both over the share: a rank's part of what one scene of all particles takes
(--whole, bytes; default: 86 a particle).
"""

from __future__ import annotations

import argparse
import resource

import globule as gb
import numpy as np
from mpi4py import MPI


def peak() -> int:
    """Bytes that this process has had in memory at most."""
    return 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--n", type=int, default=8_000_000)
    parser.add_argument("--whole", type=float, default=None)
    options = parser.parse_args()
    comm = MPI.COMM_WORLD
    edge = round(options.n ** (1 / 3))
    n = edge**3
    gb.Scene(np.zeros((8, 3), np.float32), support=1.0, device="cpu", threads=1)
    base = peak()
    rng = np.random.default_rng(comm.rank)
    mine = np.arange(comm.rank, n, comm.size)
    positions = np.empty((len(mine), 3), np.float32)
    for axis in range(3):
        positions[:, axis] = mine // edge**axis % edge
    del mine
    positions += rng.random(positions.shape, np.float32) * np.float32(0.4)
    given = peak() - base
    on_ranks = {"comm": comm} if comm.size > 1 else {}
    scene = gb.Scene(positions, support=2.0, device="cpu", threads=1, **on_ranks)
    built = peak() - base
    for _ in range(3):
        scene.update(positions=positions)
    most = peak() - base
    held = sum(len(s) for _, s in scene.pieces().visit()) if comm.size > 1 else n
    share = (options.whole or 86 * n) / comm.size
    line = (
        f"rank {comm.rank}: {held:,} particles ({held * comm.size / n:.2f} of the share), peak "
        f"{given / 1e6:.0f} MB when made, {built / 1e6:.0f} when built, {most / 1e6:.0f} after "
        f"updates: {most / share:.2f} of the share"
    )
    for text in comm.gather(line) or ():
        print(text)


if __name__ == "__main__":
    main()
