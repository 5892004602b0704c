"""Experiments on solids that relax (Prony series) or yield, with known answers.

Every experiment takes a device and a number of threads, and returns rows (truth, expected,
measured, ok). The tests run all, as does `python -m bench physics`.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from globule.sim.materials import LONGEST, elasticity
from globule.sim.tissue import Tissue

from .physics_solid import solid, turns
from .physics_tissue import DENSITY, MODULUS, SPACING, Row, lattice, layers, row

_MASS = DENSITY * SPACING**3
SERIES = (((0.5, 0.3),), ((0.4, 0.1), (0.3, 1.0)))  # (share, s), of one and two terms


def shear_left(series: Any, time: Any) -> Any:
    """G(t) / G(0)."""
    return 1 - sum(share * (1 - np.exp(-np.asarray(time) / tau)) for share, tau in series)


def compliance(series: Any, poisson: float, time: np.ndarray) -> np.ndarray:
    """Strain of a bar under a stress of E that sets in at time 0: the correspondence principle.

    1 / E = 1 / (3 μ) + 1 / (3 (3 λ + 2 μ)), with μ(s) = μ (1 - Σ share / (1 + s time)); λ stays.
    """
    material = elasticity(1.0, poisson, 1)
    mu, lame = float(material.shear[0]), float(material.lame[0])
    bottom = np.poly1d([1.0])
    for _, tau in series:
        bottom *= np.poly1d([tau, 1.0])
    top = bottom * 1.0
    for share, tau in series:
        top = top - share * np.polydiv(bottom.c, [tau, 1.0])[0]
    total = np.zeros_like(time)
    for modulus in (3 * mu * top, 3 * (3 * lame * bottom + 2 * mu * top)):
        # of 1 / (s modulus / bottom): a constant, and an exponential of each root
        total += bottom(0.0) / modulus(0.0)
        slope = modulus.deriv()
        for root in modulus.roots:
            total += (bottom(root) / (root * slope(root)) * np.exp(root * time)).real
    return total


def _bar(
    device: str, threads: int, poisson: float, strain: float, n: int = 15, **how: Any
) -> tuple[Tissue, np.ndarray, float]:
    """A bar of 5 x 5 x n that is stretched at once and held at its ends; its positions before; the
    force on its end before anything relaxed."""
    x = lattice(5, 5, n)
    z = layers(x)
    aside = (1 + strain) ** -poisson
    stretched = (x - x[0]) * [aside, aside, 1 + strain] + x[0]
    top = stretched[z == n - 1].mean(0)

    def held(positions: np.ndarray, **how: Any) -> Tissue:
        tissue = solid(x, poisson, fixed=z == 0, device=device, threads=threads, **how)
        tissue.positions = positions
        tissue.grasp(top + [0, 0, 99.5 * SPACING], 100 * SPACING)  # so large a ball holds one layer
        return tissue

    slow = [(share, LONGEST) for share, _ in how.get("relaxation", ())]
    before = held(stretched, damping=100.0, relaxation=slow)
    for _ in range(60):
        before.advance(0.005)
    return held(before.positions, **how), x, _end_force(before)


def held(device: str, threads: int = 0) -> list[Row]:
    """Force on the end of a bar that is held stretched by 0.3 %, over the force at once."""
    rows = []
    for series in SERIES:
        tissue, _, first = _bar(device, threads, 0.0, 0.003, damping=100.0, relaxation=series)
        dt, off = 0.005, 0.0
        for k in range(160):
            n = tissue.advance(dt)
            # The force is the mean of n substeps, each of the stress at its end.
            left = shear_left(series, (k + 0.5 * (n + 1) / n) * dt)
            off = max(off, abs(_end_force(tissue) / first - left))
        truth = f"bar held stretched, {len(series)} Prony terms: force / first - G(t) / G(0), worst"
        rows.append(row(truth, 0.0, off, off < 0.003))
    return rows


def _end_force(tissue: Tissue) -> float:
    return -tissue.grasp_force()[0][2]


def creeping(device: str, threads: int = 0) -> list[Row]:
    """Strain of a hanging bar after its load set in."""
    rows = []
    for series in SERIES:
        x = lattice(5, 5, 15)
        z, strain = layers(x), 0.003
        tissue = solid(
            x, 0.45, fixed=z == 14, damping=25.0, relaxation=series, device=device, threads=threads
        )  # fmt: skip
        pull = np.zeros_like(x)
        pull[z == 0, 2] = -strain * MODULUS * SPACING**2 / _MASS
        tissue.accelerate(pull)
        gauge = (z >= 5) & (z <= 9)
        times, found = np.array([0.4, 0.8, 1.2]), []
        for _ in times:
            for _ in range(40):
                tissue.advance(0.01)
            y = tissue.positions
            found.append((np.polyfit(x[gauge, 2], y[gauge, 2], 1)[0] - 1) / strain)
        expected = compliance(series, 0.45, times)
        off = np.abs(np.array(found) / expected - 1).max()
        truth = f"loaded bar, {len(series)} Prony terms: strain / closed form - 1, worst"
        rows.append(row(truth, 0.0, off, off < 0.02))
    return rows


def cycles(device: str, threads: int = 0) -> list[Row]:
    """Loss tangent of a bar whose end goes to and fro."""
    rows = []
    for series in SERIES:
        tissue, *_ = _bar(device, threads, 0.0, 0.0, n=9, damping=5.0, relaxation=series)
        rate, per_cycle, n_cycles, reach = 2 * np.pi * 1.0, 200, 4, 0.01 * 8 * SPACING
        dt = 2 * np.pi / rate / per_cycle
        forces = []
        for k in range(n_cycles * per_cycle):
            speed = reach * (np.sin(rate * (k + 1) * dt) - np.sin(rate * k * dt)) / dt
            tissue.instruments([((0, 0, speed), (0, 0, 0), (0, 0, 0))])
            tissue.advance(dt)
            forces.append(_end_force(tissue))
        phase = rate * (np.arange(len(forces)) + 0.5) * dt
        late = slice(-per_cycle, None)
        force, phase = np.array(forces)[late], phase[late]
        stored, lost = np.mean(force * np.sin(phase)), np.mean(force * np.cos(phase))
        modulus = 1 - sum(share / (1 + 1j * rate * tau) for share, tau in series)
        expected, found = modulus.imag / modulus.real, lost / stored
        truth = f"bar to and fro, {len(series)} Prony terms: loss tangent"
        rows.append(row(truth, expected, found, abs(found / expected - 1) < 0.02))
    return rows


def decays(device: str, threads: int = 0) -> list[Row]:
    """Kinetic and elastic energy of a free beam of no damping: it falls and never grows."""
    x = lattice(4, 4, 16)
    tissue = solid(x, relaxation=SERIES[1], device=device, threads=threads)
    s = (x[:, 2] - x[:, 2].mean(dtype="f8")) / (16 * SPACING)
    v = np.zeros_like(x)
    v[:, 0] = 0.1 * np.cos(2 * np.pi * s)
    tissue.velocities = v - v.mean(0)
    energies = []
    for _ in range(200):
        tissue.advance(0.002, substeps=60)  # positions and velocities half a substep apart
        u = tissue.velocities.astype("f8")
        energies.append(0.5 * _MASS * (u**2).sum() + tissue.elastic_energy)
    growth = (np.array(energies) / np.minimum.accumulate(energies) - 1).max()
    return [
        row("free beam that relaxes: energy above its least before", 0.0, growth, growth < 1e-3),
        row("free beam that relaxes: energy left after 0.4 s", 0.0, energies[-1] / energies[0],
            energies[-1] < 0.5 * energies[0]),
    ]  # fmt: skip


def turned(device: str, threads: int = 0) -> list[Row]:
    """Turning is no strain: nothing of it is remembered."""
    return turns(device, threads, "solid that relaxes and yields", relaxation=SERIES[1],
                 plastic=0.001, creep=10.0)  # fmt: skip


def _stretches(tissue: Tissue, x: np.ndarray) -> np.ndarray:
    """(3,) of the middle of a bar."""
    gauge = abs(layers(x) - 7) <= 2
    y = tissue.positions
    return np.array([np.polyfit(x[gauge, k], y[gauge, k], 1)[0] for k in range(3)])


def stays(device: str, threads: int = 0) -> list[Row]:
    """A bar pulled beyond its yield strain keeps a part of its strain; below it none."""
    rows = []
    for strain in (0.04, 0.25):
        creep, dt, kept = 2.5, 0.02, 0.0
        tissue, x, _ = _bar(
            device, threads, 0.45, strain, damping=50.0, plastic=0.05, creep=creep
        )  # fmt: skip
        for _ in range(40):
            tissue.advance(dt)
            # The ends cannot flow sideways, so that the middle has more than its share of strain.
            beyond = max(np.log(_stretches(tissue, x)[2]) - 0.05, 0.0)
            kept = beyond + (kept - beyond) * np.exp(-creep * dt)
        tissue.grasp((0, 0, 0), 0.0)
        for _ in range(60):
            tissue.advance(0.01)
        left = _stretches(tissue, x)
        found, volume = np.log(left[2]), left.prod()
        truth = f"solid bar stretched by {strain:g}, yield 0.05: logarithmic strain that stays"
        rows += [
            row(truth, kept, found, abs(found - kept) < max(0.02 * kept, 1e-4)),
            row(f"solid bar stretched by {strain:g}, let go: volume", 1.0, volume,
                abs(volume - 1) < 0.01),
        ]  # fmt: skip
    return rows


def run(device: str, threads: int = 0) -> list[Row]:
    """All rows."""
    rows = []
    for experiment in (held, creeping, cycles, decays, turned, stays):
        rows += experiment(device, threads)
    return rows
