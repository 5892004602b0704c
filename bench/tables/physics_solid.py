"""Experiments on solids (`model="solid"`) with known answers.

Every experiment takes a device and a number of threads, and returns rows (truth, expected,
measured, ok). The tests run the small experiments, `python -m bench physics` runs all.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from globule.sim import blade
from globule.sim.tissue import HALF_SPACE, Tissue

from .physics_tissue import DENSITY, GRAVITY, MODULUS, SPACING, Row, lattice, layers, row, settle

_MASS = DENSITY * SPACING**3
_SPEED = np.sqrt(MODULUS / DENSITY)


def solid(positions: np.ndarray, poisson: float = 0.3, **how: Any) -> Tissue:
    """A solid of the experiments' material."""
    return Tissue(positions, SPACING, MODULUS, DENSITY, model="solid", poisson=poisson, **how)


def column(device: str, threads: int = 0, across: int = 5, poisson: float = 0.3) -> list[Row]:
    """A column pulled at its end: strain and lateral strain of its middle third."""
    x = lattice(across, across, 6 * across)
    z, strain = layers(x), 0.003
    tissue = solid(x, poisson, fixed=z == z.max(), damping=25.0, device=device, threads=threads)
    pull = np.zeros_like(x)
    pull[z == 0, 2] = -strain * MODULUS * SPACING**2 / _MASS
    tissue.accelerate(pull)
    y = settle(tissue, 1.5 * across / 5)
    gauge = (z >= 2 * across) & (z <= 4 * across)
    along = np.polyfit(x[gauge, 2], y[gauge, 2], 1)[0] - 1
    aside = np.polyfit(x[gauge, 0], y[gauge, 0], 1)[0] - 1
    modulus, ratio = strain / along, -aside / along
    truth = f"solid column, {across} across, ratio {poisson:g}:"
    return [
        row(f"{truth} E / material's E", 1.0, modulus, abs(modulus - 1) < 0.02),
        row(f"{truth} Poisson's ratio", poisson, ratio, abs(ratio - poisson) < 0.02),
    ]


def turned_column(device: str, threads: int = 0, across: int = 7) -> list[Row]:
    """A column of a lattice that is turned by 45 degrees about y has the same modulus."""
    grid = lattice(12 * across, across, 12 * across, 1.0) - [6 * across, 0, 6 * across]
    x = np.stack([grid[:, 0] - grid[:, 2], np.sqrt(2) * grid[:, 1], grid[:, 0] + grid[:, 2]], 1)
    x = x[(abs(x[:, 0]) <= 0.7 * across) & (x[:, 2] >= -0.1) & (x[:, 2] <= 8 * across)]
    x = x * SPACING / np.sqrt(2)
    half = SPACING / np.sqrt(2)  # between layers
    width = half * len(np.unique(np.rint(x[:, 0] / half)))
    z = np.rint(x[:, 2] / half).astype(int)
    area, strain = width * across * SPACING, 0.003
    low = z <= 1  # two layers make a face: every second particle is in each
    tissue = solid(x, fixed=z >= z.max() - 1, damping=25.0, device=device, threads=threads)
    pull = np.zeros_like(x)
    pull[low, 2] = -strain * MODULUS * area / (_MASS * low.sum())
    tissue.accelerate(pull)
    y = settle(tissue, 2.0)
    gauge = (z >= z.max() / 3) & (z <= z.max() * 2 / 3)
    modulus = strain / (np.polyfit(x[gauge, 2], y[gauge, 2], 1)[0] - 1)
    truth = "solid column of a lattice turned by 45 degrees: E / material's E"
    return [row(truth, 1.0, modulus, abs(modulus - 1) < 0.02)]


def timoshenko(across: int, length: float, force: float, poisson: float) -> float:
    """Deflection of the tip of a clamped beam of square section, m."""
    thick = across * SPACING
    inertia, area, shear = thick**4 / 12, thick**2, MODULUS / (2 * (1 + poisson))
    kappa = 10 * (1 + poisson) / (12 + 11 * poisson)
    return force * length**3 / (3 * MODULUS * inertia) + force * length / (kappa * area * shear)


def cantilever_tip(device: str, threads: int = 0, across: int = 5, poisson: float = 0.3, **how: Any) -> float:
    """Deflection of a clamped beam's tip over Timoshenko's; the beam begins half a spacing beyond
    the two fixed layers, where their cubes end."""
    x = lattice(across, across, 8 * across + 2)
    z = layers(x) - 1
    length = (8 * across - 0.5) * SPACING
    slowest = 3.516 * across * SPACING / np.sqrt(12) * _SPEED / length**2
    tissue = solid(
        x, poisson, fixed=z <= 0, damping=1.5 * slowest, device=device, threads=threads
    )  # fmt: skip
    tip, aim = z == z.max(), 0.01 * length
    pull = np.zeros_like(x)
    pull[tip, 0] = aim / timoshenko(across, length, 1.0, poisson) / (across**2 * _MASS)
    tissue.accelerate(pull)
    y = settle(tissue, 10.0 / slowest, **how)
    return float((y[tip, 0].mean() - x[tip, 0].mean(dtype="f8")) / aim)


def cantilever(
    device: str, threads: int = 0, across: int = 5, poisson: float = 0.3
) -> list[Row]:  # fmt: skip
    """The tip of a clamped beam against Timoshenko's."""
    measured = cantilever_tip(device, threads, across, poisson)
    truth = f"solid cantilever, {across} across, ratio {poisson:g}: tip / Timoshenko's"
    return [row(truth, 1.0, measured, abs(measured - 1) < (0.06 if across < 9 else 0.03))]


def torsion(
    device: str, threads: int = 0, across: int = 4, poisson: float = 0.3
) -> list[Row]:  # fmt: skip
    """A square bar that a couple turns at its end: the twist between its quarters against
    Saint-Venant's."""
    x = lattice(across, across, 6 * across + 2)
    z, d = layers(x) - 1, SPACING
    shear, side = MODULUS / (2 * (1 + poisson)), across * d
    slowest = 0.5 * np.pi * np.sqrt(0.844) * _SPEED / np.sqrt(2 * (1 + poisson)) / (6 * across * d)
    tissue = solid(x, poisson, fixed=z <= 0, damping=2 * slowest, device=device, threads=threads)
    tip, r = z == z.max(), x[:, :2] - x[:, :2].mean(0)
    rate = 0.2 / (6 * across * d)  # radians per meter
    couple = rate * shear * 0.1406 * side**4
    pull = np.zeros_like(x)
    pull[tip, 0], pull[tip, 1] = -r[tip, 1], r[tip, 0]
    pull *= couple / (_MASS * (r[tip] ** 2).sum())
    tissue.accelerate(pull)
    moved = settle(tissue, 10.0 / slowest) - x
    ends, angles = (round(1.5 * across), round(4.5 * across)), []
    for end in ends:
        i = z == end
        across_r = r[i, 0] * moved[i, 1] - r[i, 1] * moved[i, 0]
        angles.append(np.arcsin(across_r.sum() / (r[i] ** 2).sum()))
    found = float((angles[1] - angles[0]) / ((ends[1] - ends[0]) * d) / rate)
    truth = f"solid bar, {across} across, ratio {poisson:g}: twist / Saint-Venant's"
    return [row(truth, 1.0, found, abs(found - 1) < 0.05)]


def turns(device: str, threads: int = 0, kind: str = "solid", **how: Any) -> list[Row]:
    """A free body that turns ten times keeps its shape: springs of no centrifugal force."""
    x = lattice(5, 5, 9)
    tissue = solid(x, device=device, threads=threads, **how)
    middle, rate = x.mean(0, dtype="f8"), 2.0  # rad/s
    r = x - middle
    tissue.velocities = rate * np.stack([-r[:, 1], r[:, 0], 0 * r[:, 0]], 1)
    time = 10 * 2 * np.pi / rate
    for _ in range(300):
        tissue.advance(time / 300)
    y = tissue.positions.astype("f8")
    y -= y.mean(0)
    u, _, v = np.linalg.svd(y.T @ r)
    off = np.linalg.norm(y @ (u @ v) - r, axis=1).max() / np.linalg.norm(r, axis=1).max()
    # density (rate radius)² / E: what the turning itself stretches
    stretch = DENSITY * rate**2 * (r[:, :2] ** 2).sum(1).max() / MODULUS
    energy = tissue.elastic_energy / (MODULUS * len(x) * SPACING**3)
    return [
        row(f"{kind} after 10 turns: change of shape / size", 0.0, off, off < 1e-3),
        row(f"{kind} after 10 turns: elastic energy / E V", 0.0, energy,
            energy < stretch**2 + 1e-8),
    ]  # fmt: skip


def squeeze(device: str, threads: int = 0) -> list[Row]:
    """A block of ratio 0.49 between smooth plates, 20 % shorter, keeps its volume."""
    x = lattice(7, 7, 7)
    z, height = layers(x), 6 * SPACING
    tissue = solid(x, 0.49, damping=30.0, device=device, threads=threads)
    n, speed = 120, 0.1 * height  # m/s of each plate, for one second of 120 steps
    for k in range(2 * n):
        depth, v = speed * min(k, n) / 120, speed if k < n else 0.0
        lower = (HALF_SPACE, (0, 0, depth), (0, 0, 1), 0.0, (0, 0, v))
        upper = (HALF_SPACE, (0, 0, height - depth), (0, 0, -1), 0.0, (0, 0, -v))
        tissue.instruments(shapes=[lower, upper])
        tissue.advance(1 / 120)
    y = tissue.positions.astype("f8")
    volume = _hexahedra(y.reshape(7, 7, 7, 3)) / height**3
    left = (y[z == 6, 2].mean() - y[z == 0, 2].mean()) / height
    return [
        row("solid of ratio 0.49 squeezed: height", 0.8, left, abs(left - 0.8) < 0.002),
        row("solid of ratio 0.49 squeezed: volume", 1.0, volume, abs(volume - 1) < 0.01),
    ]


def _hexahedra(corners: np.ndarray) -> float:
    """Volume of a lattice's cells, (nx, ny, nz, 3) m."""
    c = corners
    volume = 0.0
    o = c[:-1, :-1, :-1]
    far = c[1:, 1:, 1:] - o
    ring = [c[1:, :-1, :-1], c[1:, 1:, :-1], c[:-1, 1:, :-1], c[:-1, 1:, 1:], c[:-1, :-1, 1:],
            c[1:, :-1, 1:]]  # fmt: skip
    for a, b in zip(ring, [*ring[1:], ring[0]], strict=True):
        volume += (np.cross(a - o, b - o) * far).sum() / 6
    return float(volume)


def steps(device: str, threads: int = 0) -> list[Row]:
    """Static sag does not depend on the step."""
    x = lattice(4, 4, 12)
    z = layers(x)
    sags = {}
    for substeps in (0, 64, 128):
        tissue = solid(x, fixed=z == z.max(), damping=30.0, device=device, threads=threads)
        y = settle(tissue, 1.0, gravity=GRAVITY, substeps=substeps)
        sags[substeps] = (x[z == 0, 2].astype("f8") - y[z == 0, 2]).mean()
    return [
        row(f"solid's sag with {n} substeps of 1/60 s / automatic", 1.0, sags[n] / sags[0],
            abs(sags[n] / sags[0] - 1) < 0.01)
        for n in (64, 128)
    ]  # fmt: skip


def vibration(device: str, threads: int = 0, periods: int = 100) -> list[Row]:
    """A free beam vibrates without damping: its energy stays."""
    x = lattice(4, 4, 24)
    tissue = solid(x, device=device, threads=threads)
    length, thick = 24 * SPACING, 4 * SPACING
    frequency = 22.373 / (2 * np.pi) * thick / np.sqrt(12) * _SPEED / length**2  # Hz, Euler's
    s = (x[:, 2] - x[:, 2].mean(dtype="f8")) / length
    v = np.zeros_like(x)
    v[:, 0] = 0.03 * np.cos(2 * np.pi * s)
    tissue.velocities = v - v.mean(0)
    energies, crossings, before = [], 0, 1.0
    per_period = 12
    for _ in range(periods * per_period):
        tissue.advance(1 / frequency / per_period)
        u = tissue.velocities.astype("f8")
        energies.append(0.5 * _MASS * (u**2).sum() + tissue.elastic_energy)
        mode = float((u[:, 0] * v[:, 0]).sum())
        crossings += mode * before < 0
        before = mode
    window = min(10, periods // 2) * per_period
    late, early = np.mean(energies[-window:]), np.mean(energies[:window])
    drift = abs(late / early - 1)
    return [
        row(f"free beam: energy drift over {periods} periods", 0.0, drift, drift < 0.01),
        row("free beam: half periods seen / Euler's", 1.0, crossings / (2 * periods),
            0.8 < crossings / (2 * periods) < 1.02),
    ]  # fmt: skip


def cut_column(device: str, threads: int = 0) -> list[Row]:
    """A blade cuts 5n² - 4n pairs; both halves stay free of stress, and a half has the modulus of
    the whole: corrections beside the cut are those of a surface."""
    across = 5
    x = lattice(across, across, 48)
    z = layers(x)
    tissue = solid(x, fixed=z == 47, damping=25.0, device=device, threads=threads)
    edge = np.array([[-1.0, -1e3, 19.5], [-1.0, 1e3, 19.5]])
    n_cut = tissue.cut(blade.sweep(edge * SPACING, (edge + [20.0, 0, 0]) * SPACING))
    expected = 5 * across**2 - 4 * across
    energy = tissue.elastic_energy / (MODULUS * len(x) * SPACING**3)
    pull = np.zeros_like(x)
    pull[z == 20, 2] = -0.003 * MODULUS * SPACING**2 / _MASS
    tissue.accelerate(pull)
    y = settle(tissue, 1.5)
    gauge = (z >= 29) & (z <= 39)
    modulus = 0.003 / (np.polyfit(x[gauge, 2], y[gauge, 2], 1)[0] - 1)
    return [
        row("solid, plane through 5 x 5: pairs cut", expected, n_cut, n_cut == expected),
        row("solid, plane through 5 x 5: pieces", 2, tissue.n_pieces, tissue.n_pieces == 2),
        row("solid just cut: elastic energy / E V", 0.0, energy, energy < 1e-10),
        row("half of a cut column: E / material's", 1.0, modulus, abs(modulus - 1) < 0.02),
    ]


def momentum(device: str, threads: int = 0) -> list[Row]:
    """Pairs and cuts keep the momentum of a trembling solid."""
    x = lattice(8, 8, 16)
    tissue = solid(x, 0.45, device=device, threads=threads)
    rng = np.random.default_rng(3)
    v = rng.normal(0, 0.05, x.shape)
    tissue.velocities = v - v.mean(0) + [0.02, 0.0, 0.01]
    before = tissue.velocities.sum(0, dtype="f8")
    speed = np.abs(tissue.velocities).sum(dtype="f8")
    edge = np.array([[-20.0, -1e3, 7.5], [-20.0, 1e3, 7.5]])
    for k in range(10):
        tissue.advance(1 / 120)
        if k == 4:
            tissue.cut(blade.sweep(edge * SPACING, (edge + [60.0, 0, 0]) * SPACING))
    drift = np.abs(tissue.velocities.sum(0, dtype="f8") - before).max() / speed
    truth = "solid's momentum drift over 10 steps and a cut, of Σ m |v|"
    return [row(truth, 0.0, drift, drift < 1e-6)]


def run(device: str, threads: int = 0, quick: bool = False) -> list[Row]:
    """All rows; `quick` leaves the large ones out."""
    rows = []
    for poisson in (0.0, 0.3, 0.45):
        rows += column(device, threads, 5, poisson) + cantilever(device, threads, 5, poisson)
    for across in (4,) if quick else (4, 5, 6):
        rows += torsion(device, threads, across)
    if not quick:
        rows += cantilever(device, threads, 9)
    for experiment in (turned_column, turns, squeeze, steps, vibration, cut_column, momentum):
        rows += experiment(device, threads)
    return rows
