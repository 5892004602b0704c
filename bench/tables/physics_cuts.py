"""Experiments on the contact of what a cut has parted, with known answers.

Every experiment takes a device and a number of threads, and returns rows (truth, expected,
measured, ok). The tests run the same experiments.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from globule.sim import blade
from globule.sim.simulation import Simulation

from .physics_tissue import DENSITY, Row, row

_G = 9.81
_D = 0.004  # m, spacing
_MASS = DENSITY * _D**3


def block(
    device: str, threads: int, sides: tuple[int, int, int], gravity: Any, young: float = 30000.0,
    fixed: float = 0.0, **solid: Any,
) -> Simulation:  # fmt: skip
    """A solid block of a lattice from the origin on; it is fixed below the height `fixed`, m."""
    held = {"fixed": [{"box": {"lo": (-1, -1, -1), "hi": (1, 1, fixed)}}]} if fixed else {}
    return Simulation({
        "spacing": _D, "domain": {"lo": (-0.1, -0.1, -0.05), "hi": (0.3, 0.15, 0.15)},
        "gravity": list(gravity),
        "solids": [{
            "name": "block", "box": {"lo": (0, 0, 0), "hi": [n * _D for n in sides]},
            "young": young, "density": DENSITY, **held, **solid,
        }],
    }, device, threads)  # fmt: skip


def cut_at(sim: Simulation, height: float) -> None:
    """Cut everything by the plane z = height, m."""
    edge = np.array([[-1.0, -1.0, height], [-1.0, 1.0, height]])
    sim.tissue.cut(blade.sweep(edge, edge + [2.0, 0, 0]))


def energy(sim: Simulation, gravity: Any) -> float:
    """Kinetic, potential and elastic energy, J."""
    x, v = sim.positions.astype("f8"), sim.velocities.astype("f8")
    return float(_MASS * ((v**2).sum() / 2 - (x @ np.asarray(gravity)).sum())
                 + sim.tissue.elastic_energy)  # fmt: skip


def follow(sim: Simulation, gravity: Any, until: Callable[[], bool]) -> float:
    """Steps until something is true; the largest rise of the energy above its least before, J."""
    least, above = energy(sim, gravity), 0.0
    while not until():
        sim.step()
        now = energy(sim, gravity)
        least, above = min(least, now), max(above, now - least)
    return above


def slide(device: str, threads: int = 0, degrees: float = 20.0) -> list[Row]:
    """The upper half of a block that a plane has cut slides down on the lower one, without
    friction, by four spacings: as if free, along the plane, without trembling."""
    d, angle = _D, np.radians(degrees)
    gravity = _G * np.array([np.sin(angle), 0.0, -np.cos(angle)])
    sim = block(device, threads, (16, 8, 8), gravity, fixed=2 * d)
    x = sim.positions
    upper = x[:, 2] > 4 * d
    cut_at(sim, 4 * d)
    deepest, fastest, way = 0.0, 0.0, 0.0

    def arrived() -> bool:
        nonlocal deepest, fastest, way
        moved, v = (sim.positions - x)[upper].mean(0, dtype="f8"), sim.velocities[upper]
        way, deepest = float(moved[0]), max(deepest, float(-moved[2]))
        fastest = max(fastest, float(np.linalg.norm(v - v.mean(0), axis=1).max()))
        return way > 4 * d or sim.time > 0.3

    above = follow(sim, gravity, arrived)
    speed = float(sim.velocities[upper, 0].mean(dtype="f8"))
    free = float(np.sqrt(2 * gravity[0] * way))
    weight = float(_MASS * upper.sum() * _G * d)
    truth = f"half of a cut block slides down at {degrees:g} degrees"
    return [
        row(f"{truth}: speed after four spacings / free", 1.0, speed / free,
            abs(speed / free - 1) < 0.05),
        row("the same: deepest, in spacings", 0.0, deepest / d, deepest < 0.15 * d),
        row("the same: fastest particle against its half, m/s", 0.0, fastest, fastest < 0.2),
        row("the same: energy above its least before / weight times spacing", 0.0, above / weight,
            above < 0.1 * weight),
    ]  # fmt: skip


def fresh(device: str, threads: int = 0) -> list[Row]:
    """Faces of a fresh cut part without a push: of a block at rest, and of one that its own
    weight compresses by a tenth."""
    rest = block(device, threads, (8, 8, 8), (0, 0, 0))
    cut_at(rest, 4 * _D)
    rest.run(0.05)
    fastest = float(np.linalg.norm(rest.velocities, axis=1).max())
    gravity = np.array([0, 0, -_G])
    sim = block(device, threads, (8, 8, 16), gravity, 3200.0, _D, damping=40.0)
    x = sim.positions
    sim.run(0.5)
    sim.phases["block"].damping = 0.0
    y = sim.positions
    upper = x[:, 2] > 8 * _D
    cut_at(sim, float(np.median(y[:, 2])))
    first, sunk, thrown = sim.time, 0.0, 0.0

    def over() -> bool:
        nonlocal sunk, thrown
        moved = (sim.positions - y)[:, 2]
        gap = float(moved[upper].mean(dtype="f8") - moved[~upper].mean(dtype="f8"))
        sunk, thrown = max(sunk, -gap), max(thrown, gap)
        return sim.time > first + 0.15

    above = follow(sim, gravity, over)
    weight = float(_MASS * upper.sum() * _G * _D)
    truth = "block compressed by its weight and cut"
    return [
        row("block at rest that is cut: fastest particle, m/s", 0.0, fastest, fastest < 1e-3),
        row(f"{truth}: halves approach, in spacings", 0.0, sunk / _D, sunk < 0.2 * _D),
        row("the same: part, in spacings", 0.0, thrown / _D, thrown < 0.1 * _D),
        row("the same: energy above its least before / weight times spacing", 0.0, above / weight,
            above < 0.2 * weight),
    ]  # fmt: skip


def free_halves(device: str, threads: int = 0) -> list[Row]:
    """Halves of a free block that meet while they slide along each other keep their momentum."""
    sim = block(device, threads, (10, 6, 6), (0, 0, 0))
    x = sim.positions
    upper = x[:, 2] > 3 * _D
    cut_at(sim, 3 * _D)
    sim.velocities = np.where(upper[:, None], [0.2, 0.05, -0.05], [-0.2, 0.0, 0.05])
    before = sim.velocities.sum(0, dtype="f8")
    speed = float(np.linalg.norm(sim.velocities, axis=1).sum(dtype="f8"))
    moving, drift = energy(sim, (0, 0, 0)), 0.0

    def over() -> bool:
        nonlocal drift
        now = sim.velocities.sum(0, dtype="f8")
        drift = max(drift, float(np.abs(now - before).max()) / speed)
        return sim.time > 0.04

    above = follow(sim, (0, 0, 0), over)
    moved = sim.positions - x
    way = float(moved[upper, 0].mean() - moved[~upper, 0].mean()) / _D
    return [
        row("free halves slide along each other: way, in spacings", 4.0, way, abs(way - 4) < 0.15),
        row("the same: momentum's drift, of Σ m |v|", 0.0, drift, drift < 1e-6),
        row("the same: energy above its least before / first energy", 0.0, above / moving,
            above < 0.01 * moving),
    ]  # fmt: skip


def run(device: str, threads: int = 0, quick: bool = False) -> list[Row]:
    """All rows; `quick` leaves the slower half out."""
    rows = slide(device, threads) + free_halves(device, threads)
    return rows if quick else rows + fresh(device, threads)
