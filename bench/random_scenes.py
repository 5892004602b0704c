"""Random scenes of fluids: `python -m bench.random_scenes [--n 500] [--first 0] [--jobs 1]`.

Each scene has walls or periodic sides, walls that slide or turn, emitters, rigid bodies, fluids of several densities,
viscosities and tensions, and steps as they come. Counts those that end with a message, and those that go on although
a particle is faster than ten times what gravity, walls, emitters and first speeds can give together.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Iterable
from multiprocessing import get_context
from typing import Any

import globule as gb
import numpy as np

D = 0.02


def scene(seed: int) -> tuple[dict[str, Any], float]:
    """A scene, and the speed that its causes give, m/s."""
    rng = np.random.default_rng(seed)
    cells = rng.integers(10, 20, 3)
    hi = cells * D
    periodic = [axis for axis in "xy" if rng.random() < 0.4]
    gravity = float(rng.choice([0.0, 1.6, 9.81, 9.81, 9.81]))
    causes = [math.sqrt(2 * gravity * hi[2])]
    walls = {"walls": True, "open": ["+z"] if rng.random() < 0.5 else []}
    level = float(rng.uniform(0.2, 0.6) * hi[2])
    fluid: dict[str, Any] = {
        "name": "a", "density": float(rng.choice([800, 1000, 1000, 3000])),
        "viscosity": float(10.0 ** rng.uniform(-4, 1)),
        "implicit": bool(rng.random() < 0.5), "surface_tension": float(rng.choice([0.0, 0.0, 0.07, 1.0])),
        "box": {"lo": (0, 0, 0), "hi": (*hi[:2], level)},
    }  # fmt: skip
    fluid["implicit"] |= fluid["viscosity"] > 0.05
    boundaries, rigids, emitters = [], [], []
    if periodic and rng.random() < 0.6:
        velocity = np.zeros(3)
        velocity["xy".index(periodic[0])] = rng.choice([-1, 1]) * 10.0 ** rng.uniform(-2, 0.5)
        causes.append(float(np.linalg.norm(velocity)))
        plane = {"point": (0, 0, float(2 * D)), "normal": (0, 0, 1)}
        boundaries.append({"name": "belt", "plane": plane, "velocity": tuple(velocity)})
        fluid["box"]["lo"] = (0, 0, 2 * D)
        fluid["box"]["hi"] = (*hi[:2], max(level, 6 * D))
    elif not periodic and rng.random() < 0.5:
        size, middle = hi / 2 - 2 * D, hi / 2
        spin = rng.choice([-1, 1]) * 10.0 ** rng.uniform(-0.5, 1.2)
        reach = float(min(size[:2]))
        causes.append(abs(spin) * reach)
        lo, up = (
            (middle[0] - 0.7 * reach, middle[1] - D, 3 * D),
            (middle[0] + 0.7 * reach, middle[1] + D, hi[2] - 3 * D),
        )
        paddle = {"lo": tuple(lo), "hi": tuple(up)}
        boundaries.append({"name": "paddle", "box": paddle, "spin": (0, 0, float(spin)), "about": (*middle[:2], 0)})
    if not boundaries and rng.random() < 0.5:
        low, wide = level + 2 * D, 4 * D
        if low + wide < hi[2]:
            at = rng.uniform(0, hi[:2] - wide)
            rigids.append({
                "name": "box", "density": float(rng.choice([200, 700, 1500, 7000])),
                "box": {"lo": (*at, low), "hi": (*(at + wide), low + wide)}, "spin": tuple(rng.normal(0, 3, 3)),
            })  # fmt: skip
    if rng.random() < 0.4 and walls["open"]:
        radius = float(rng.uniform(1.5, 3.5) * D)
        speed = float(10.0 ** rng.uniform(-1, 0.7))
        causes.append(speed)
        center = (*rng.uniform(radius + D, hi[:2] - radius - D), hi[2] - 2 * D)
        emitters.append({
            "name": "tap", "fluid": "a", "center": center, "direction": (0, 0, -1), "radius": radius,
            "rate": speed * math.pi * radius**2, "end": 0.3,
        })  # fmt: skip
    domain = {"lo": (0, 0, 0), "hi": tuple(hi), "periodic": periodic, **walls}
    given = {
        "spacing": D, "domain": domain, "gravity": (0, 0, -gravity), "fluids": [fluid], "boundaries": boundaries,
        "rigids": rigids, "emitters": emitters, "solver": {"max_dt": float(rng.choice([0.002, 0.005, 0.02]))},
    }  # fmt: skip
    tension = fluid["surface_tension"]
    causes.append(4 * math.sqrt(tension / (fluid["density"] * D)))
    return given, math.hypot(0.4 * D / given["solver"]["max_dt"], *causes)


def run(seed: int) -> tuple[int, str, float, str]:
    """Seed, "refused", "stopped", "ran away" or "went on", the largest speed over what was given, and a message."""
    given, speed = scene(seed)
    rng = np.random.default_rng(seed + 1_000_000)
    try:
        sim = gb.Simulation(given, device="cpu", threads=1)
    except ValueError as error:
        return seed, "refused", 0.0, str(error)
    most = 0.0
    try:
        while sim.time < 1.0 and sim.n_steps < 2000:
            report = sim.step(sim.dt * float(rng.uniform(0.2, 1.0)) if rng.random() < 0.2 else None)
            most = max(most, report.most_speed / speed)
    except ArithmeticError as error:
        return seed, "stopped", most, str(error)
    return seed, "ran away" if most > 10 or not np.isfinite(sim.positions).all() else "went on", most, ""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--n", type=int, default=500)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--jobs", type=int, default=1)
    options = parser.parse_args()
    seeds: Iterable[int] = range(options.first, options.first + options.n)
    counts: dict[str, int] = {}
    with get_context("spawn").Pool(options.jobs) as pool:
        for seed, what, most, message in pool.imap(run, seeds):
            counts[what] = counts.get(what, 0) + 1
            if what != "went on" or most > 3:
                print(f"{seed}: {what}, {most:.2f} times what was given; {message[:200]}", flush=True)
    print(", ".join(f"{n} {what}" for what, n in sorted(counts.items())))


if __name__ == "__main__":
    main()
