"""Memory of a rank: `mpiexec -n 4 python -m bench.ranks_memory`; on one rank, of one scene.

A jittered lattice, dealt to the ranks at random. Each rank makes its scene, updates it twice and
renders an image of 480 x 270 after each. Prints for each rank its particles and the peak of its
resident memory, less what the program takes before it has particles. The share is a rank's part of
what one scene of all particles takes: run it on one rank first, and give its peak as --whole.
"""

from __future__ import annotations

import argparse
import re
from pathlib import Path

import globule as gb
import numpy as np
from mpi4py import MPI

SIZE = (480, 270)


def peak() -> int:
    """Bytes that this process has had in memory at most, since the last call."""
    found = re.search(r"VmHWM:\s+(\d+) kB", Path("/proc/self/status").read_text())
    Path("/proc/self/clear_refs").write_text("5")
    return 1024 * int(found[1]) if found else 0


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--n", type=int, default=8_000_000)
    parser.add_argument("--whole", type=float, help="MB of one scene with all particles")
    options = parser.parse_args()
    comm = MPI.COMM_WORLD
    edge = round(options.n ** (1 / 3))
    n = edge**3
    camera = gb.Camera.fit([(0, 0, 0), (edge, edge, edge)], size=SIZE)
    gb.render(gb.Scene(np.zeros((8, 3), np.float32), support=1.0, device="cpu", threads=1), camera)
    peak()
    base = peak()
    rng = np.random.default_rng(comm.rank)
    positions = np.empty((len(range(comm.rank, n, comm.size)), 3), np.float32)
    for first in range(0, len(positions), 1 << 16):
        some = positions[first : first + (1 << 16)]
        cell = comm.rank + comm.size * np.arange(first, first + len(some))
        for axis in range(3):
            some[:, axis] = cell // edge**axis % edge
        some += rng.random(some.shape, np.float32) * np.float32(0.4)
    peak()
    on_ranks = {"comm": comm} if comm.size > 1 else {}
    scene = gb.Scene(positions, support=2.0, device="cpu", threads=1, **on_ranks)
    found = [peak() - base]
    for _ in range(2):
        gb.render(scene, camera, SIZE)
        found.append(peak() - base)
        scene.update(positions=positions)
        found.append(peak() - base)
    held = sum(len(s) for _, s in scene.pieces().visit()) if comm.size > 1 else n
    line = (
        f"rank {comm.rank}: {held:,} particles ({held * comm.size / n:.2f} of the share); MB when "
        f"built, drawn, updated, drawn, updated: {', '.join(f'{p / 1e6:.0f}' for p in found)}"
    )
    if options.whole:
        line += f"; at most {max(found) / 1e6 / options.whole * comm.size:.2f} of the share"
    for text in comm.gather(line) or ():
        print(text)


if __name__ == "__main__":
    main()
