"""Random cuts in the surgery scene: `python -m bench.soak [--minutes 30] [--spacing 0.004]`.

Every tenth of a simulated second a scalpel of random place, direction and depth goes through the
brain. Stops with status 1 at the first NaN, at a particle that is neither there nor counted as
gone, or when memory has grown by more than 5 % since the first fifth of the run.
"""

from __future__ import annotations

import argparse
import sys
import time

import globule as gb
import numpy as np

BETWEEN_CUTS = 0.1  # simulated seconds
GROWTH = 1.05


def resident() -> float:
    """This process's memory, MB."""
    with open("/proc/self/statm", encoding="utf-8") as file:
        return int(file.read().split()[1]) * 4096 / 1e6


def stroke(rng: np.random.Generator, tissue: np.ndarray) -> np.ndarray:
    """A blade's sweep as two triangles (2, 3, 3), through a random particle of the tissue."""
    middle = tissue[rng.integers(len(tissue))]
    along, down = rng.normal(size=3), rng.normal(size=3)
    along *= rng.uniform(0.01, 0.04) / np.linalg.norm(along)
    down *= rng.uniform(0.005, 0.02) / np.linalg.norm(down)
    a, b, c, d = middle - along, middle + along, middle + along + down, middle - along + down
    return np.array([[a, b, c], [a, c, d]])


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--minutes", type=float, default=30.0, help="of wall or simulated time")
    parser.add_argument("--spacing", type=float, default=0.004)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--device", default="auto")
    options = parser.parse_args()

    rng = np.random.default_rng(options.seed)
    sim = gb.Simulation("brain-surgery", spacing=options.spacing, device=options.device)
    start, told, memory = time.perf_counter(), 0.0, None
    n_cuts = n_bonds_cut = 0
    print("   wall s     sim s     cuts  bonds cut   pieces    fluid  outside  memory MB")
    while True:
        wall = time.perf_counter() - start
        share = max(wall, sim.time) / (60 * options.minutes)
        if share >= 1:
            break
        sim.run(BETWEEN_CUTS)  # a NaN raises here
        solid = [phase.kind == "tissue" for phase in sim.phases.values()]
        tissue = sim.positions[np.array(solid)[sim.arrays.phase]]
        tissue = tissue[np.isfinite(tissue).all(axis=1)]
        n_bonds_cut += sim.tissue.cut(stroke(rng, tissue))
        n_cuts += 1
        counts = sim.record.counts
        if sim.record.n_born != len(sim) + counts["removed"]:
            print(f"particles do not add up: {sim.record.n_born} born, {counts}")
            return 1
        if not np.isfinite(sim.positions).all() or not np.isfinite(sim.velocities).all():
            print("not a number among positions or velocities")
            return 1
        if memory is None and share > 0.2:
            memory = resident()
        if memory is not None and resident() > GROWTH * memory:
            print(f"memory grew from {memory:.0f} to {resident():.0f} MB")
            return 1
        if wall - told > 20:
            told = wall
            print(
                f"{wall:9.0f} {sim.time:9.2f} {n_cuts:8d} {n_bonds_cut:10d} "
                f"{sim.tissue.n_pieces:8d} "
                f"{counts['fluid']:8d} {counts['escaped']:8d} {resident():10.0f}",
                flush=True,
            )
    print(f"{n_cuts} cuts, {n_bonds_cut} bonds, {sim.tissue.n_pieces} pieces, {sim.time:.1f} s: sound")
    return 0


if __name__ == "__main__":
    sys.exit(main())
