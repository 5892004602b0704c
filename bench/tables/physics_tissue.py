"""Experiments on the lattice of springs and the knife with known answers.

Every experiment takes a device and a number of threads, and returns rows (truth, expected,
measured, ok). The tests run the small experiments, `python -m bench physics` runs all.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from globule.sim import blade
from globule.sim.tissue import Tissue

Row = dict[str, Any]
SPACING, MODULUS, DENSITY = 0.002, 2500.0, 1000.0
_MASS = DENSITY * SPACING**3
_SPEED = np.sqrt(MODULUS / DENSITY)
GRAVITY = np.array([0, 0, -9.81])
# Of a linear solve of the same lattice, by particles across: E of a column over the material's;
# tip of a clamped beam, 8 times as long as thick, over Timoshenko's.
COLUMN = {5: 0.860, 9: 0.922, 13: 0.946}
CANTILEVER = {5: 1.42, 9: 1.20, 13: 1.12}


def row(truth: str, expected: float, measured: float, ok: bool, limit: str = "") -> Row:
    """A row of the table, as `physics_fluid.Row` has it."""
    return {
        "truth": truth, "expected": expected, "measured": measured, "ok": bool(ok), "limit": limit,
    }  # fmt: skip


def lattice(nx: int, ny: int, nz: int, spacing: float = SPACING) -> np.ndarray:
    """Points of a cubic lattice, (nx ny nz, 3) float32, m."""
    axes: list[np.ndarray] = [np.arange(k, dtype=np.float64) for k in (nx, ny, nz)]
    return (np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3) * spacing).astype("f4")


def springs(x: Any, spacing: float, young: Any, density: float = 1000.0, **how: Any) -> Tissue:
    """A `Tissue` of bonds."""
    return Tissue(x, spacing, young, density, model="bonds", **how)


def layers(positions: np.ndarray) -> np.ndarray:
    """Layer along z of each particle of a lattice, (N,) int."""
    return np.rint(positions[:, 2] / SPACING).astype(int)


def settle(tissue: Tissue, seconds: float, **how: Any) -> np.ndarray:
    """Positions (N, 3) float64 after `seconds` of damped motion, m."""
    for _ in range(round(60 * seconds)):
        tissue.advance(1 / 60, **how)
    return tissue.positions.astype(np.float64)


def column(device: str, threads: int = 0, across: int = 5, **how: Any) -> list[Row]:
    """A column pulled at its end has the strain of its modulus, measured in its middle third."""
    x = lattice(across, across, 6 * across)
    z, strain = layers(x), 0.003
    tissue = springs(
        x, SPACING, MODULUS, DENSITY, fixed=z == z.max(), damping=25.0, device=device,
        threads=threads,
    )  # fmt: skip
    pull = np.zeros_like(x)
    pull[z == 0, 2] = -strain * MODULUS * SPACING**2 / _MASS
    tissue.accelerate(pull)
    y = settle(tissue, 1.5 * across / 5, **how)
    low, high = 2 * across, 4 * across
    gauge = y[z == high, 2].mean() - y[z == low, 2].mean()
    measured = strain / (gauge / ((high - low) * SPACING) - 1)
    truth = f"column, {across} across: E / material's E"
    return [row(truth, COLUMN[across], measured, abs(measured / COLUMN[across] - 1) < 0.01)]


def timoshenko(across: int, length: float, force: float) -> float:
    """Deflection of the tip of a clamped beam of square section, m; shear of ν = 1/4."""
    thick, nu = across * SPACING, 0.25
    inertia, area, shear = thick**4 / 12, thick**2, MODULUS / (2 * (1 + nu))
    kappa = 10 * (1 + nu) / (12 + 11 * nu)
    return force * length**3 / (3 * MODULUS * inertia) + force * length / (kappa * area * shear)


def cantilever_tip(device: str, threads: int, across: int, seconds: float, **how: Any) -> float:
    """Deflection of a clamped beam's tip over Timoshenko's.

    Half of the bonds to the fixed layer bends, so the beam begins half a spacing beyond it.
    """
    x = lattice(across, across, 8 * across + 1)
    z = layers(x)
    thick, length = across * SPACING, (8 * across - 0.5) * SPACING
    slowest = 3.516 * thick / np.sqrt(12) * _SPEED / length**2
    tissue = springs(
        x, SPACING, MODULUS, DENSITY, fixed=z == 0, damping=1.5 * slowest, device=device,
        threads=threads,
    )  # fmt: skip
    tip, aim = z == z.max(), 0.01 * length
    force = aim / timoshenko(across, length, 1.0)
    pull = np.zeros_like(x)
    pull[tip, 0] = force / (across**2 * _MASS)
    tissue.accelerate(pull)
    y = settle(tissue, seconds / slowest, **how)
    return (y[tip, 0].mean() - x[tip, 0].mean(dtype="f8")) / aim


def cantilever(device: str, threads: int = 0, across: int = 5) -> list[Row]:
    """The tip of a clamped beam against Timoshenko's."""
    measured = cantilever_tip(device, threads, across, 10.0)
    expected = CANTILEVER[across]
    truth = f"cantilever, {across} across: tip / Timoshenko's"
    return [row(truth, expected, measured, abs(measured / expected - 1) < 0.015)]


def stiffness(device: str, threads: int = 0) -> list[Row]:
    """Static stiffness does not depend on iterations or on the step."""
    x = lattice(4, 4, 12)
    z = layers(x)
    sags = {}
    for substeps, iterations in ((0, 1), (0, 2), (0, 5), (64, 1), (128, 1), (64, 3)):
        tissue = springs(
            x, SPACING, MODULUS, DENSITY, fixed=z == z.max(), damping=30.0, device=device,
            threads=threads,
        )  # fmt: skip
        y = settle(tissue, 1.0, gravity=GRAVITY, substeps=substeps, iterations=iterations)
        sags[substeps, iterations] = (x[z == 0, 2].astype("f8") - y[z == 0, 2]).mean()
    one = sags[0, 1]
    return [
        row(
            f"static sag with {substeps or 'automatic'} substeps of 1/60 s, {iterations} iterations"
            " / automatic, 1",
            1.0, sag / one, abs(sag / one - 1) < 0.02,
        )
        for (substeps, iterations), sag in sags.items()
    ]  # fmt: skip


def plane_cut(device: str, threads: int = 0, across: int = 5, height: float = 9.5) -> list[Row]:
    """A plane through a lattice column breaks 5n² - 4n bonds and leaves two pieces."""
    x = lattice(across, across, 20)
    tissue = springs(x, SPACING, MODULUS, DENSITY, device=device, threads=threads)
    n_before = tissue.n_bonds
    n_cut = tissue.cut(blade.sweep(*_stroke(height, -1, 2 * across)))
    expected = 5 * across**2 - 4 * across
    at = f"plane at {height:g} d through {across} x {across}"
    n_pieces, lost = tissue.n_pieces, n_before - tissue.n_bonds
    return [
        row(f"{at}: bonds cut", expected, n_cut, n_cut == expected and lost == expected),
        row(f"{at}: pieces", 2, n_pieces, n_pieces == 2),
    ]


def partial_cut(device: str, threads: int = 0) -> list[Row]:
    """Half a cut leaves one piece, its second half two, and no bond is cut twice or missed."""
    across, height = 6, 9.0
    tissue = springs(lattice(across, across, 20), SPACING, MODULUS, device=device, threads=threads)
    first = tissue.cut(blade.sweep(*_stroke(height, -1, 2.5)))
    half = tissue.n_pieces
    second = tissue.cut(blade.sweep(*_stroke(height, 2.5, 7)))
    both = tissue.n_pieces
    expected = 5 * across**2 - 4 * across
    return [
        row("half a cut: pieces", 1, half, half == 1),
        row("both halves: bonds cut", expected, first + second, first + second == expected),
        row("both halves: pieces", 2, both, both == 2),
    ]


def _stroke(height: float, start: float, end: float) -> tuple[np.ndarray, np.ndarray]:
    """A straight edge along y at z = height, before and after a motion along x, in spacings."""
    edge = np.array([[0, -1e3, height], [0, 1e3, height]])
    return (edge + [start, 0, 0]) * SPACING, (edge + [end, 0, 0]) * SPACING


def momentum(device: str, threads: int = 0) -> list[Row]:
    """Bonds and cuts keep the momentum of a trembling body without gravity."""
    x = lattice(8, 8, 16)
    tissue = springs(x, SPACING, MODULUS, DENSITY, device=device, threads=threads)
    rng = np.random.default_rng(3)
    v = rng.normal(0, 0.05, x.shape)
    tissue.velocities = v - v.mean(0) + [0.02, 0.0, 0.01]
    before = tissue.velocities.sum(0, dtype="f8")
    speed = np.abs(tissue.velocities).sum(dtype="f8")
    for k in range(10):
        tissue.advance(1 / 120)
        if k == 4:
            tissue.cut(blade.sweep(*_stroke(7.5, -20, 40)))
    drift = np.abs(tissue.velocities.sum(0, dtype="f8") - before).max() / speed
    return [row("momentum drift over 10 steps and a cut, of Σ m |v|", 0.0, drift, drift < 1e-5)]


def free_fall(device: str, threads: int = 0) -> list[Row]:
    """The piece that a cut frees falls g t² / 2; the hanging part stays one piece."""
    x = lattice(5, 5, 16)
    z = layers(x)
    tissue = springs(x, SPACING, 1e4, DENSITY, fixed=z == z.max(), device=device, threads=threads)
    tissue.cut(blade.sweep(*_stroke(7.5, -5, 20)))
    free = tissue.piece == tissue.piece[z == 0][0]
    start = tissue.positions[free].mean(0, dtype="f8")
    t, n = 0.15, 15
    for _ in range(n):
        tissue.advance(t / n, gravity=GRAVITY)
    fallen = start - tissue.positions[free].mean(0, dtype="f8")
    # Symplectic Euler: g t² / 2 plus g t dt / 2, dt the substep.
    expected = -GRAVITY[2] * t**2 / 2
    ok = abs(fallen[2] / expected - 1) < 0.01 and np.abs(fallen[:2]).max() < 1e-5
    return [
        row("freed piece: particles", 5 * 5 * 8, free.sum(), free.sum() == 200),
        row("freed piece: fall in 0.15 s, m", expected, fallen[2], ok),
    ]


def thin_fast(device: str, threads: int = 0) -> list[Row]:
    """A thin blade at 100 m/s through moving tissue misses nothing, in one sweep or in many."""
    across = 8
    rows = []
    for n_sweeps in (1, 7, 50):
        x = lattice(across, across, 20)
        tissue = springs(x, SPACING, MODULUS, DENSITY, device=device, threads=threads)
        drift = np.array([0.3, 0.0, 0.1])  # m/s
        tissue.velocities = drift
        dt = 1 / 6000 / n_sweeps
        places = np.linspace(-1, 9, n_sweeps + 1)
        tissue.follow()
        n_cut = 0
        for i in range(n_sweeps):
            tissue.advance(dt)
            edges = [
                edge + drift * t
                for edge, t in zip(_stroke(9.5, places[i], places[i + 1]), (i * dt, (i + 1) * dt), strict=True)
            ]
            n_cut += tissue.cut(blade.sweep(*edges))
            tissue.follow()
        expected = 5 * across**2 - 4 * across
        ok = n_cut == expected and tissue.n_pieces == 2
        rows.append(row(f"thin fast blade in {n_sweeps} sweeps: bonds cut", expected, n_cut, ok))
    return rows


def tearing(device: str, threads: int = 0) -> list[Row]:
    """Bonds break beyond the strain limit and not before."""
    rows = []
    for strain, torn in ((0.19, False), (0.21, True)):
        x = lattice(3, 3, 10)
        tissue = springs(x, SPACING, MODULUS, tear=0.2, device=device, threads=threads)
        tissue.positions = x * [1, 1, 1 + strain]
        n_torn = tissue.tear(0.01)
        # Only the bonds along z reach the whole strain: 9 of them a layer.
        expected = 9 * 9 if torn else 0
        rows.append(row(f"stretched by {strain:g}: bonds torn", expected, n_torn, n_torn == expected))
    return rows


def creep(device: str, threads: int = 0) -> list[Row]:
    """Beyond the yield strain, a share of the strain stays; below it none."""
    rows = []
    for strain, kept in ((0.04, 0.0), (0.25, (0.25 - 0.05) * (1 - np.exp(-2.0)))):
        tissue = springs(
            np.array([[0, 0, 0], [0, 0, SPACING]]), SPACING, MODULUS, plastic=0.05,
            creep=10.0, damping=50.0, device=device, threads=threads,
        )  # fmt: skip
        tissue.positions = np.array([[0, 0, 0], [0, 0, (1 + strain) * SPACING]])
        tissue.tear(0.2)
        a, b = settle(tissue, 0.5)
        left = float(np.linalg.norm(b - a)) / SPACING - 1
        truth = f"stretched by {strain:g}, yield 0.05: strain that stays"
        rows.append(row(truth, kept, left, abs(left - kept) < 1e-3))
    return rows


def contact(device: str, threads: int = 0) -> list[Row]:
    """Cut faces do not pull, and bounce off each other instead of passing through."""
    x = lattice(4, 4, 12)
    upper = layers(x) > 5
    tissue = springs(x, SPACING, MODULUS, DENSITY, device=device, threads=threads)
    tissue.cut(blade.sweep(*_stroke(5.5, -5, 20)))
    speed = 0.05  # m/s
    tissue.velocities = np.where(upper, 1.0, -1.0)[:, None] * np.array([0, 0, speed])
    tissue.advance(0.02)
    apart = tissue.velocities[upper, 2].mean(dtype="f8")
    tissue.positions = x
    tissue.velocities = np.where(upper, -1.0, 1.0)[:, None] * np.array([0, 0, speed])
    nearest = np.inf
    for _ in range(40):
        tissue.advance(0.001)
        z = tissue.positions[:, 2]
        nearest = min(nearest, z[layers(x) == 6].min() - z[layers(x) == 5].max())
    back = tissue.velocities[upper, 2].mean(dtype="f8")
    return [
        row("cut halves part: speed kept", speed, apart, abs(apart / speed - 1) < 1e-4),
        row("halves meet: least gap / spacing", 0.8, nearest / SPACING, nearest > 0.8 * SPACING,
            "at least"),
        row("halves meet: they part again", speed, back, 0.2 * speed < back <= speed, "at most"),
    ]  # fmt: skip


def run(device: str, threads: int = 0, quick: bool = False) -> list[Row]:
    """All rows; `quick` leaves the large ones out."""
    rows = column(device, threads) + cantilever(device, threads) + stiffness(device, threads)
    if not quick:
        for across in (9, 13):
            rows += column(device, threads, across) + cantilever(device, threads, across)
    for across in (3, 5, 9):
        for height in (9.5, 9.0, 9.3):
            rows += plane_cut(device, threads, across, height)
    for experiment in (partial_cut, momentum, free_fall, thin_fast, tearing, creep, contact):
        rows += experiment(device, threads)
    return rows
