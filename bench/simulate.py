"""How fast the fluid solver is: a developed splash goes on, or a column of any size collapses.

    python -m bench.simulate --steps 100 --error 0.001 --device cpu -o out.csv

`--splash FILE.npz` continues positions and velocities from a file with spacing, box and obstacle;
otherwise `--n` particles fall as a column into a closed box. Prints a table (and CSV), the time of
each stage, iterations and a hash of the final state. `cpu_us` is process time over particle-steps:
what a busy machine does not change. `simulated_per_s` is simulated seconds per second of wall time.

    python -m bench.simulate --n 1000000 --error 0.01 --check --seconds 1

`--check` simulates some seconds and stops with exit code 1 at the first step that loses a particle,
gains energy, compresses the fluid by more than `check` allows, or has more than one particle in
100,000 that is faster than three times a fall from the column's top.
"""

from __future__ import annotations

import argparse
import csv
import os
import platform
import sys
import time

import globule as gb
import numpy as np
from globule.sim.sampling import surface
from globule.sim.shapes import Box

from .tables.report import record


def splash(path: str, error: float, device: str, threads: int) -> gb.Simulation:
    data = np.load(path)
    d = float(data["spacing"])
    # Their boundary particles stand on the box's faces, ours 0.555 spacings outside of them.
    lo, hi = data["box_min"] + d / 2, data["box_max"] - d / 2
    hi[1] = data["box_max"][1] + 1.0
    sim = scene(d, lo, hi, error, device, threads)
    box = surface(Box(data["obstacle_min"], data["obstacle_max"]), d)
    sim.add(box[box[:, 1] > lo[1]], "walls")
    sim.add(data["positions"], "water", data["velocities"])
    return sim


def column(n: int, error: float, device: str, threads: int) -> gb.Simulation:
    """A column of proportions 1 : 2 : 1 at one end of a closed box of 4 : 3 : 1."""
    width = 1.0
    d = (2 * width**3 / n) ** (1 / 3)
    cells = max(1, round(width / d))
    d = width / cells
    sim = scene(d, np.zeros(3), np.array([4.0, 3.0, 1.0]), error, device, threads)
    axes = [(np.arange(c) + 0.5) * d for c in (cells, 2 * cells, cells)]
    sim.add(np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3), "water")
    return sim


def scene(d, lo, hi, error, device, threads) -> gb.Simulation:
    description = {
        "spacing": d,
        "domain": {"lo": lo, "hi": hi, "walls": True},
        "gravity": (0, -9.81, 0),
        "solver": {"max_error": error},
        "fluids": [{"name": "water", "viscosity": 0.0}],
    }
    return gb.Simulation(description, device, threads)


def check(sim: gb.Simulation, seconds: float, error: float, quiet: bool) -> int:
    """Simulate; 1 and a message at the first step that cannot be true, else 0.

    Energy may grow by 1e-3 of the potential energy that the column can lose. Mean compression:
    twice the error. 99.9 % of the particles: 10 times the error, or 10 %.
    """
    start = sim.record.totals()
    mass, first = start["mass"], start["kinetic"] + start["potential"]
    top = start["center"][1] * 2
    most, wall, worst = 1e-3 * start["potential"], time.perf_counter(), dict.fromkeys(WORST, 0.0)
    begin, halved = sim.time, 0
    while sim.time < begin + seconds:
        r = sim.step()
        now = sim.record.totals()
        gain = now["kinetic"] + now["potential"] - first
        # A jet is faster than the fall that makes it, and its spray is faster than the jet.
        n_fast, limit = 0, 3 * np.sqrt(2 * 9.81 * top)
        if r.most_speed > limit:
            n_fast = int((np.square(sim.velocities).sum(1) > limit**2).sum())
        halved += r.n_halved
        row = (r.compression, r.high_compression, r.most_compression, r.most_speed, gain / mass)
        worst = {k: max(worst[k], v) for k, v in zip(WORST, row, strict=True)}
        if not quiet and r.step % 50 == 0:
            print(r, f"energy {gain / mass:+.4g} J/kg", flush=True)
        wrong = [
            text
            for text, bad in (
                (f"{r.n_escaped} particles escaped", r.n_escaped > 0),
                (f"energy grew by {gain / mass:.3g} J/kg", gain > most),
                (f"mean compression {r.compression:.2%}", r.compression > 2 * error),
                (f"99.9th percentile {r.high_compression:.2%}", r.high_compression > max(10 * error, 0.1)),
                (f"{n_fast} particles at up to {r.most_speed:.3g} m/s", n_fast > 1e-5 * r.n_solved),
            )
            if bad
        ]
        if wrong:
            print(f"step {r.step} at {r.time:.4g} s: " + "; ".join(wrong))
            return 1
    wall = time.perf_counter() - wall
    print(f"{sim.time - begin:.4g} s in {sim.n_steps} steps, {halved} halvings, {wall:.4g} s of wall")
    for name, value in worst.items():
        print(f"largest {name:24} {value:.4g}")
    print("nothing lost, no energy gained")
    return 0


WORST = ("mean compression", "99.9th percentile", "compression", "speed, m/s", "energy gain, J/kg")


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--splash", metavar="FILE.npz")
    parser.add_argument("--n", type=int, default=100_000, help="particles of the column")
    parser.add_argument("--error", type=float, default=0.001)
    parser.add_argument("--steps", type=int, default=100)
    parser.add_argument("--warm", type=int, default=5, help="steps before the clock starts")
    parser.add_argument("--device", default="auto")
    parser.add_argument("--threads", type=int, default=0)
    parser.add_argument("--check", action="store_true", help="stop at what cannot be true")
    parser.add_argument("--seconds", type=float, default=1.0, help="simulated by --check")
    parser.add_argument("--quiet", action="store_true")
    parser.add_argument("-o", "--output", metavar="FILE.csv")
    parser.add_argument("--record", metavar="MACHINE", help="write to docs/measured.csv, too")
    a = parser.parse_args()

    sim = splash(a.splash, a.error, a.device, a.threads) if a.splash else column(a.n, a.error, a.device, a.threads)
    if a.check:
        return check(sim, a.seconds, a.error, a.quiet)
    for _ in range(a.warm):
        report = sim.step()
    n, start = report.n_solved, sim.time
    wall, cpu = time.perf_counter(), time.process_time()
    reports = [sim.step() for _ in range(a.steps)]
    wall, cpu = time.perf_counter() - wall, time.process_time() - cpu

    steps = n * a.steps
    row = {
        "device": sim.scene.device.description,
        "particles": n,
        "boundary": len(sim) - n,
        "error": a.error,
        "steps": a.steps,
        "steps_per_s": a.steps / wall,
        "particle_steps_per_s": steps / wall,
        "simulated_per_s": (sim.time - start) / wall,
        "cpu_us": 1e6 * cpu / steps,
        "iterations": np.mean([r.iterations for r in reports]),
        "divergence_iterations": np.mean([r.divergence_iterations for r in reports]),
        "compression": np.mean([r.compression for r in reports]),
        "high_compression": max(r.high_compression for r in reports),
        "most_compression": max(r.most_compression for r in reports),
        "most_speed": max(r.most_speed for r in reports),
        "halved": sum(r.n_halved for r in reports),
        "dt": (sim.time - start) / a.steps,
        "escaped": reports[-1].n_escaped,
        "hash": sim.hash(),
        "machine": f"{platform.machine()} {os.cpu_count()} cores",
    }
    for stage in reports[0].seconds:
        row[f"ms_{stage}"] = 1e3 * np.mean([r.seconds[stage] for r in reports])
    for name, value in row.items():
        print(f"{name:24} {value:.6g}" if isinstance(value, float) else f"{name:24} {value}")
    if a.output:
        new = not os.path.exists(a.output)
        with open(a.output, "a", encoding="utf-8", newline="") as file:
            writer = csv.DictWriter(file, row)
            if new:
                writer.writeheader()
            writer.writerow(row)
    if a.record:
        case = f"{'splash' if a.splash else 'column'}, {n:,} particles, error {100 * a.error:g} %"
        record("simulate", a.record, {case: row})
    return 0


if __name__ == "__main__":
    sys.exit(main())
