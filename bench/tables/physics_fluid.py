"""Fluid experiments with a known answer: each returns rows (truth, expected, measured, ok)."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from globule.sim.emitter import Emitter
from globule.sim.sampling import BEHIND
from globule.sim.simulation import Simulation

GRAVITY = 9.81
# Martin & Moyce 1952, a column twice as high as wide: T = t sqrt(2 g / a) -> front Z = x / a.
MARTIN_MOYCE = np.array(
    [(0.832, 1.217), (1.219, 1.474), (1.997, 2.292), (2.547, 2.995), (3.345, 4.134), (4.034, 4.944)]
)


class Row(NamedTuple):
    """One line of the table: statement, expected and measured value, and whether it holds.

    `limit`: "at most" or "at least" where the expected value is a limit, else "".
    """

    truth: str
    expected: float
    measured: float
    ok: bool
    limit: str = ""


def near(truth: str, expected: float, measured: float, relative: float) -> Row:
    """A row that holds if the relative error is at most `relative`."""
    ok = abs(measured - expected) <= relative * abs(expected)
    return Row(truth, expected, float(measured), bool(ok))


def at_most(truth: str, limit: float, measured: float) -> Row:
    """A row that holds up to a limit."""
    return Row(truth, limit, float(measured), bool(measured <= limit), "at most")


def at_least(truth: str, limit: float, measured: float) -> Row:
    """A row that holds from a limit on."""
    return Row(truth, limit, float(measured), bool(measured >= limit), "at least")


def lattice(lo: Any, hi: Any, spacing: float) -> np.ndarray:
    """Centers (M, 3) of the cubes of edge `spacing` that fill the box from `lo` to `hi`, m."""
    lo, hi = np.asarray(lo, float), np.asarray(hi, float)
    n = np.maximum(np.rint((hi - lo) / spacing).astype(int), 1)
    axes = [lo[k] + (np.arange(n[k]) + 0.5) * spacing for k in range(3)]
    return np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)


def tank(
    spacing: float, hi: Any, fluid: dict[str, Any], device: str, threads: int, periodic: str = "",
    settled: bool = False, gravity: Any = (0, -GRAVITY, 0), **solver: Any,
) -> Simulation:  # fmt: skip
    """A simulation without particles but those of its walls, from the origin to `hi`; y is up.

    A wall's layer is BEHIND spacings behind its face, where a lattice starts at rest. Fluid that
    has settled comes as close as if the layer were half a spacing behind: `settled` has it there.
    """
    gap = (BEHIND - 0.5) * spacing if settled else 0.0
    inset = [0.0 if axis in periodic else gap for axis in "xyz"]
    domain = {"lo": inset, "hi": np.subtract(hi, inset), "walls": True, "periodic": [*periodic]}
    fluids = [{"viscosity": 0.0, "implicit": False, **fluid}]
    scene = {"spacing": spacing, "domain": domain, "gravity": gravity, "solver": solver}
    return Simulation({**scene, "fluids": fluids}, device, threads)


def hydrostatic(device: str = "cpu", threads: int = 0, seconds: float = 5.0) -> list[Row]:
    """A tank at rest: pressure grows with depth, the surface keeps its height."""
    d, height, wide = 0.05, 0.6, 0.5
    water = {"name": "water", "viscosity": 1.0}
    sim = tank(d, (wide, 1.5 * height, wide), water, device, threads, settled=True)
    ids = sim.add(lattice((0, 0, 0), (wide, height, wide), d), "water")
    sim.run(seconds)
    n, p, at = 40, np.zeros(len(ids)), np.zeros((len(ids), 3))
    for _ in range(n):
        sim.step()
        p += sim.arrays.pressure[ids] / n
        at += sim.positions[ids] / n
    layer = round((wide / d) ** 2)
    top = np.sort(at[:, 1])[-layer:].mean() + d / 2
    # The layer that touches a wall carries what the wall's missing particles would.
    away = np.minimum(at, wide - at)[:, [0, 2]].min(1) > 2 * d
    inner = away & (at[:, 1] > 2 * d) & (at[:, 1] < height - 2 * d)
    depth = 1000 * GRAVITY * (top - at[:, 1])
    slope = np.polyfit(depth[inner], p[inner], 1)[0]
    ratio = p[inner].mean() / depth[inner].mean()
    return [
        near("hydrostatic: dp/dz over rho g", 1.0, slope, 0.03),
        near("hydrostatic: p over rho g depth, mean", 1.0, ratio, 0.03),
        at_least(f"hydrostatic: height after {seconds:g} s, share", 0.99, top / height),
    ]


def dam_break(device: str = "cpu", threads: int = 0, cells: int = 16) -> list[Row]:
    """A column twice as high as wide falls: position of its front, and compression."""
    a = 0.5
    d = a / cells
    sim = tank(d, (5.5 * a, 2.2 * a, 8 * d), {"name": "water"}, device, threads, "z")
    ids = sim.add(lattice((0, 0, 0), (a, 2 * a, 8 * d), d), "water")
    scale = np.sqrt(2 * GRAVITY / a)
    times, fronts, compression = [], [], []
    while sim.time * scale < MARTIN_MOYCE[-1, 0] + 0.6:
        report = sim.step()
        times.append(sim.time * scale)
        fronts.append((np.sort(sim.positions[ids][:, 0])[-8] + d / 2) / a)
        compression.append(report.compression)
    measured = MARTIN_MOYCE[:, 1]
    delays = np.linspace(-0.6, 0.6, 121)
    errors = [np.abs(np.interp(MARTIN_MOYCE[:, 0] + s, times, fronts) / measured - 1).max() for s in delays]
    return [
        at_most("dam break: front against Martin & Moyce, largest error", 0.1, float(np.min(errors))),
        at_most("dam break: mean compression", 0.001, float(np.mean(compression))),
        at_most("dam break: particles lost", 0, report.n_escaped),
    ]


def poiseuille(device: str = "cpu", threads: int = 0, implicit: bool = False) -> list[Row]:
    """Flow between two plates, driven by a body force.

    The lattice is stretched by 4 % along the flow: particles that slide past each other need more
    space than in the lattice, and a full channel jams.
    """
    height, n, nu, top = 1.0, 20, 0.05, 0.5
    d = height / n
    force = 8 * nu * top / height**2
    water = {"name": "oil", "viscosity": 1000 * nu, "implicit": implicit}
    stretch = np.array([1.04, 1.0, 1.0])
    hi = stretch * (8 * d, height, 8 * d)
    sim = tank(d, hi, water, device, threads, "xz", True, gravity=(force, 0, 0), max_dt=0.02)
    at = lattice((0, 0, 0), (8 * d, height, 8 * d), d) * stretch
    start = 0.9 * 4 * top * at[:, 1] * (height - at[:, 1]) / height**2
    ids = sim.add(at, "oil", np.stack([start, 0 * start, 0 * start], 1))
    sim.run(0.3 * height**2 / nu)
    y, u = sim.positions[ids][:, 1], sim.velocities[ids][:, 0]
    fit = np.polyfit(y - height / 2, u, 2)
    kind = "implicit" if implicit else "explicit"
    return [near(f"Poiseuille, {kind} viscosity: u_max", top, fit[2], 0.02)]


def taylor_green(device: str = "cpu", threads: int = 0, n: int = 32) -> list[Row]:
    """Vortices that decay: their amplitude falls as exp(-8 pi^2 nu t / L^2).

    Particles start a tenth of a spacing off their lattice: in a perfect lattice under strain, the
    forces on every particle cancel until neighbors are half as far apart.
    """
    size, nu, seconds = 1.0, 0.01, 1.0
    d = size / n
    hi, water = (size, size, 8 * d), {"name": "water", "viscosity": 1000 * nu}
    sim = tank(d, hi, water, device, threads, "xyz", gravity=(0, 0, 0), max_dt=0.002)
    at = lattice((0, 0, 0), hi, d)
    at += np.random.default_rng(1).normal(0, 0.1 * d, at.shape)

    def flow(p: np.ndarray) -> np.ndarray:
        x, y = 2 * np.pi * p[:, 0] / size, 2 * np.pi * p[:, 1] / size
        return np.stack([np.sin(x) * np.cos(y), -np.cos(x) * np.sin(y), 0 * x], 1)

    sim.add(at, "water", flow(at))
    sim.run(seconds)
    mode = flow(sim.positions)
    amplitude = (sim.velocities * mode).sum() / (mode**2).sum()
    expected = np.exp(-8 * np.pi**2 * nu * seconds / size**2)
    return [near("Taylor-Green: amplitude after 1 s", expected, amplitude, 0.05)]


def momentum(device: str = "cpu", threads: int = 0) -> list[Row]:
    """Fluid with random velocities in a periodic box, without gravity."""
    d, size = 0.05, 0.6
    hi, water = (size, size, size), {"name": "water", "viscosity": 1.0}
    sim = tank(d, hi, water, device, threads, "xyz", gravity=(0, 0, 0))
    random = np.random.default_rng(1)
    at = lattice((0, 0, 0), hi, d)
    at = at[random.random(len(at)) < 0.8]
    sim.add(at, "water", random.normal(0, 1, at.shape))
    before, size = sim.record.totals(), np.abs(sim.velocities).sum() * 1000 * d**3
    for _ in range(50):
        sim.step()
    drift = np.abs(np.subtract(sim.record.totals()["momentum"], before["momentum"])).sum() / size
    return [at_most("momentum drift, closed, no gravity", 1e-5, drift)]


def free_fall(device: str = "cpu", threads: int = 0) -> list[Row]:
    """A block in free fall: its speed is g t, and its shape stays."""
    d = 0.05
    sim = tank(d, (1, 4, 1), {"name": "water"}, device, threads)
    at = lattice((0.3, 3.2, 0.3), (0.7, 3.6, 0.7), d)
    ids = sim.add(at, "water")
    sim.run(0.5)
    v, moved = sim.velocities[ids], sim.positions[ids] - at
    return [
        near("free fall: speed", GRAVITY * sim.time, -v[:, 1].mean(), 1e-5),
        at_most("free fall: spread of displacements, spacings", 1e-3, np.ptp(moved, axis=0).max() / d),
    ]


def emitter(device: str = "cpu", threads: int = 0) -> list[Row]:
    """An emitter adds exactly rate * time / volume particles, and all of them stay."""
    d, rate = 0.02, 2e-4
    sim = tank(d, (0.6, 0.6, 0.6), {"name": "water"}, device, threads)
    walls = len(sim)
    sim.emitters["tap"] = Emitter((0.3, 0.5, 0.3), (0, -1, 0), 0.05, rate, "water")
    sim.run(1.0)
    expected = rate * sim.time / d**3
    count = len(sim) - walls
    return [Row("emitter: particles after 1 s, to within one", expected, count, abs(count - expected) <= 1)]


def ball(radius: float, spacing: float) -> np.ndarray:
    """Lattice points nearest to the origin, as many as the ball's volume holds, (M, 3) m."""
    at = lattice((-radius - spacing,) * 3, (radius + spacing,) * 3, spacing)
    n = round(4 / 3 * np.pi * radius**3 / spacing**3)
    return at[np.argsort((at**2).sum(1), kind="stable")[:n]]


def drop(radius: float, d: float, sigma: float, mu: float, device: str, threads: int) -> Simulation:
    """A ball of fluid with surface tension `sigma`, N/m, and viscosity `mu`, Pa s, no gravity."""
    water = {"name": "water", "surface_tension": sigma, "viscosity": mu}
    domain = {"lo": (-2 * radius,) * 3, "hi": (2 * radius,) * 3}
    scene = {"spacing": d, "domain": domain, "gravity": (0, 0, 0), "fluids": [water]}
    sim = Simulation(scene, device, threads)
    sim.add(ball(radius, d), "water")
    return sim


def laplace(device: str = "cpu", threads: int = 0, sizes: tuple[int, ...] = (5, 7, 10)) -> list[Row]:
    """Pressure in drops at rest, whose radii are some numbers of spacings."""
    d, sigma, n = 0.001, 0.07, 100
    rows = []
    for cells in sizes:
        radius = cells * d
        sim = drop(radius, d, sigma, 0.02, device, threads)
        sim.run(0.05)
        p = 0.0
        for _ in range(n):
            sim.step()
            r = np.linalg.norm(sim.positions - np.array(sim.record.totals()["center"]), axis=1)
            p += sim.arrays.pressure[r < 0.5 * radius].mean() / n
        name = f"drop of {cells} spacings: pressure over 2 sigma / R"
        rows.append(near(name, 1.0, p * radius / (2 * sigma), 0.05))
    return rows


def oscillation(device: str = "cpu", threads: int = 0, cells: int = 8) -> list[Row]:
    """A stretched drop oscillates at omega^2 = 8 sigma / (rho R^3) (Rayleigh 1879).

    The law holds for small amplitudes. An axis longer by a quarter lowers omega^2 by 7 %, an axis
    longer by a tenth by 1 % (Tsamopoulos & Brown 1983).
    """
    d, sigma = 0.001, 0.07
    radius = cells * d
    sim = drop(radius, d, sigma, 0.0005, device, threads)
    sim.run(0.01)
    v = 0.1 * np.sqrt(8 * sigma / (1000 * radius**3))
    x = sim.positions - np.array(sim.record.totals()["center"])
    sim.velocities = v * x * (1.0, -0.5, -0.5)
    omega = np.sqrt(8 * sigma / (1000 * radius**3))
    times, shape = [], []
    while sim.time < 0.01 + 2.2 * 2 * np.pi / omega:
        sim.step()
        x = sim.positions - np.array(sim.record.totals()["center"])
        q = (x**2).mean(0)
        times.append(sim.time)
        shape.append(q[0] - 0.5 * (q[1] + q[2]))
    measured = frequency(np.array(times), np.array(shape))
    return [near("drop: omega^2 R^3 rho / sigma", 8.0, measured**2 * 1000 * radius**3 / sigma, 0.05)]


def frequency(t: np.ndarray, y: np.ndarray) -> float:
    """Of a damped swing: the best of many by least squares."""
    best, guess = (np.inf, 0.0, 0.0), 2 * np.pi * 2.2 / (t[-1] - t[0])
    omegas = guess * np.linspace(0.4, 1.8, 141)
    for _ in range(2):  # the second time around the best of the first
        for omega in omegas:
            for damping in omega * np.array([0.0, 0.01, 0.02, 0.03, 0.05, 0.1, 0.2, 0.3]):
                e = np.exp(-damping * (t - t[0]))
                wave = e * np.cos(omega * t), e * np.sin(omega * t), np.ones_like(t)
                rest = np.linalg.lstsq(np.stack(wave, 1), y, rcond=None)[1]
                if len(rest) and rest[0] < best[0]:
                    best = (float(rest[0]), float(np.hypot(omega, damping)), float(omega))
        omegas = best[2] + 0.01 * guess * np.linspace(-1, 1, 21)
    return best[1]


EXPERIMENTS = (free_fall, momentum, hydrostatic, dam_break, poiseuille, taylor_green, emitter, laplace, oscillation)
