"""Flows of water with a known answer, each at small size.

As in `physics_fluid`, each experiment takes a device and a number of threads, and returns rows
(truth, expected, measured, ok). Slices are 8 spacings deep and repeat along z.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from globule.sim.sampling import BEHIND
from globule.sim.settings import Phase
from globule.sim.simulation import Simulation

from .physics_fluid import GRAVITY, Row, at_most, lattice, near, tank


def slice_of(
    spacing: float, size: float, fluids: list[dict[str, Any]], device: str, threads: int, **solver: Any
) -> Simulation:
    """A simulation without walls and gravity, repeating along z, from -size to size along x, y."""
    domain = {"lo": (-size, -size, 0), "hi": (size, size, 8 * spacing), "periodic": ["z"]}
    scene = {"spacing": spacing, "domain": domain, "gravity": (0, 0, 0), "solver": solver}
    return Simulation({**scene, "fluids": fluids}, device, threads)


def ellipse(seconds: float, rate: float, steps: int = 4000) -> float:
    """Long half axis of Monaghan's drop, whose half axes are 1 at first.

    The velocity is (-A x, A y), the pressure 0 on the ellipse x²/a² + y²/b² = 1:
    a' = -A a, b' = A b, A' = A² (a² - b²) / (a² + b²) (Monaghan 1994, section 4.1).
    """

    def slope(s: np.ndarray) -> np.ndarray:
        a, b, rate = s
        return np.array([-rate * a, rate * b, rate**2 * (a * a - b * b) / (a * a + b * b)])

    state, dt = np.array([1.0, 1.0, rate]), seconds / steps
    for _ in range(steps):  # midpoint rule
        state = state + dt * slope(state + 0.5 * dt * slope(state))
    return float(state[1])


def elliptical_drop(device: str = "cpu", threads: int = 0, cells: int = 20) -> list[Row]:
    """A cylinder of water with the velocity (-100 x, 100 y) 1/s becomes an ellipse.

    Half axes are those of an even ellipse with the particles' second moments. Particles start 0.05
    spacings off their lattice: a perfect lattice under this strain gathers in rows, and the short
    axis ends 26 % too long.
    """
    rate, d = 100.0, 1 / cells
    sim = slice_of(d, 3.2, [{"name": "water", "viscosity": 0.0}], device, threads)
    at = lattice((-1 - d, -1 - d, 0), (1 + d, 1 + d, 8 * d), d)
    r2 = (at[:, :2] ** 2).sum(1)
    at = at[np.argsort(r2, kind="stable")[: round(np.pi / d**2) * 8]]
    at += np.random.default_rng(1).normal(0, 0.05 * d, at.shape)
    sim.add(at, "water", rate * at * (-1.0, 1.0, 0.0))
    first = sim.record.totals()["kinetic"]
    sim.run(0.012)
    kept = sim.record.totals()["kinetic"] / first
    long = ellipse(sim.time, rate)
    a, b = 2 * np.sqrt((sim.positions[:, :2].astype(np.float64) ** 2).mean(0))
    return [
        near("elliptical drop: long half axis at 0.012 s", long, b, 0.02),
        near("elliptical drop: short half axis at 0.012 s", 1 / long, a, 0.04),
        near("elliptical drop: kinetic energy over the first", 1.0, kept, 0.03),
    ]


def rotating_square(device: str = "cpu", threads: int = 0, cells: int = 24) -> list[Row]:
    """A square of water turns freely: angular momentum stays until and beyond one radian."""
    d, spin = 1 / cells, 4.0
    sim = slice_of(d, 2.0, [{"name": "water", "viscosity": 0.0}], device, threads)
    at = lattice((-0.5, -0.5, 0), (0.5, 0.5, 8 * d), d)
    sim.add(at, "water", spin * np.stack([-at[:, 1], at[:, 0], 0 * at[:, 0]], 1))
    first = sim.record.totals()
    sim.run(1.0 / spin)
    now = sim.record.totals()
    turned = now["angular_momentum"][2] / first["angular_momentum"][2]
    return [
        near("rotating square: angular momentum after one radian", 1.0, turned, 0.02),
        at_most("rotating square: kinetic energy over the first", 1.0 + 1e-4, now["kinetic"] / first["kinetic"]),
    ]


def waves(
    device: str, threads: int, length: float, depth: float, nu: float, periodic: str, cells: int,
    periods: float, height: float, disorder: float = 0.0,
) -> tuple[float, float, float]:  # fmt: skip
    """A small standing wave: its frequency, how fast it decays (1/s), and k.

    The first speeds are those of the linear wave, cosh(k (y + depth)) cos(k x) of height `height`;
    without periodic x the tank is half a wave long. The amplitude is the fluid's momentum along
    the mode. `disorder` of the first positions is in spacings.
    """
    k = 2 * np.pi / length
    d = length / cells
    wide = length if periodic else length / 2
    water = {"name": "water", "viscosity": 1000 * nu, "implicit": False}
    hi = (wide, depth + 6 * height + 4 * d, 8 * d)
    sim = tank(d, hi, water, device, threads, periodic + "z", True, max_dt=0.01)
    at = lattice((0, 0, 0), (wide, depth, 8 * d), d)
    at += np.random.default_rng(1).normal(0, disorder * d, at.shape)

    def mode(p: np.ndarray) -> np.ndarray:
        kx, ky = k * p[:, 0], k * p[:, 1]
        return np.stack(
            [-np.sin(kx) * np.cosh(ky), np.cos(kx) * np.sinh(ky), 0 * kx], 1
        ) / np.sinh(k * depth)  # fmt: skip

    omega = np.sqrt(GRAVITY * k * np.tanh(k * depth))
    ids = sim.add(at, "water", omega * height * mode(at))
    times, swing = [], []
    while sim.time < periods * 2 * np.pi / omega:
        sim.step()
        m = mode(sim.positions[ids])
        times.append(sim.time)
        swing.append((sim.velocities[ids] * m).sum() / (m**2).sum())
    t, y = np.array(times), np.array(swing)
    measured, decay = swing_of(t, y, omega)
    return measured, decay, k


def potential_flow(fluid: np.ndarray) -> tuple[np.ndarray, Callable[[np.ndarray], np.ndarray]]:
    """Laplace's equation on the cells (nx, ny) of a slice that are fluid: the number of each, -1 elsewhere, and a
    solver for right sides (n, ...). The potential is given half a cell above the uppermost row: twice it there."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.linalg import splu

    number = np.full(fluid.shape, -1)
    n = int(fluid.sum())
    number[fluid] = np.arange(n)
    ends = []
    for a, b in ((number[:-1], number[1:]), (number[:, :-1], number[:, 1:])):
        both = (a >= 0) & (b >= 0)
        ends.append(np.stack([a[both], b[both]]))
    first, other = np.concatenate(ends, 1)
    diagonal = np.bincount(np.concatenate([first, other]), minlength=n).astype(float)
    diagonal[number[:, -1][fluid[:, -1]]] += 2
    values = np.concatenate([-np.ones(2 * len(first)), diagonal])
    rows = np.concatenate([first, other, np.arange(n)])
    columns = np.concatenate([other, first, np.arange(n)])
    return number, splu(coo_matrix((values, (rows, columns))).tocsc()).solve


def swing_of(t: np.ndarray, y: np.ndarray, guess: float) -> tuple[float, float]:
    """Frequency and decay rate of a damped swing y(t) by least squares."""
    from scipy.optimize import least_squares

    def rest(p: np.ndarray) -> np.ndarray:
        a, b, omega, decay, c = p
        return np.exp(-decay * t) * (a * np.cos(omega * t) + b * np.sin(omega * t)) + c - y

    found = least_squares(rest, [y[0], 0.0, guess, 0.1, 0.0])
    return float(abs(found.x[2])), float(found.x[3])


def sloshing(device: str = "cpu", threads: int = 0, cells: int = 48) -> list[Row]:
    """The first mode of a tank: omega² = g k tanh(k h), k = pi / L (Lamb 1932, section 228)."""
    length, depth = 2.0, 0.5
    omega, _, k = waves(device, threads, length, depth, 0.0, "", cells, 2.0, 0.04)
    expected = float(np.sqrt(GRAVITY * k * np.tanh(k * depth)))
    return [near("sloshing: frequency of the first mode, rad/s", expected, omega, 0.03)]


def standing_wave(device: str = "cpu", threads: int = 0, cells: int = 32) -> list[Row]:
    """A wave on deep water decays as exp(-2 nu k² t) (Lamb 1932, section 348). A perfect lattice
    resists the wave's strain and swings 4 % faster; hence the disorder."""
    nu, length = 0.01, 1.0
    omega, decay, k = waves(device, threads, length, 0.5, nu, "x", cells, 2.5, 0.03, 0.05)
    rate = 2 * nu * k**2
    expected = float(np.sqrt(GRAVITY * k * np.tanh(0.5 * k)))
    return [
        near("standing wave: frequency, rad/s", expected, omega, 0.03),
        near("standing wave: decay rate, 1/s", rate, decay, 0.1),
    ]


def ring(radius: float, spacing: float, lo: float, hi: float) -> np.ndarray:
    """Points on a cylinder around the y axis, as dense as a plane of a boundary, (M, 3) m."""
    n = round(2 * np.pi * radius / spacing)
    rows = round((hi - lo) / spacing)
    angle = 2 * np.pi * np.arange(n) / n
    y = lo + (np.arange(rows) + 0.5) * (hi - lo) / rows
    angle, y = np.meshgrid(angle, y, indexing="ij")
    return np.stack([radius * np.cos(angle), y, radius * np.sin(angle)], -1).reshape(-1, 3)


def pipe_poiseuille(device: str = "cpu", threads: int = 0, cells: int = 10) -> list[Row]:
    """Flow through a pipe, driven by a body force g: u_max = g R² / (4 nu) on the axis."""
    radius, nu, top = 0.5, 0.05, 0.5
    d = radius / cells
    force, long = 4 * nu * top / radius**2, 10 * d
    domain = {"lo": (-0.7, 0, -0.7), "hi": (0.7, long, 0.7), "periodic": ["y"]}
    oil = {"name": "oil", "viscosity": 1000 * nu, "implicit": False}
    scene = {
        "spacing": d, "domain": domain, "gravity": (0, force, 0), "solver": {"max_dt": 0.02},
        "fluids": [oil],
    }  # fmt: skip
    sim = Simulation(scene, device, threads)
    sim.add_phase(Phase("pipe", "boundary"))
    sim.add(ring(radius + d / 2, d, 0, long), "pipe")
    # As in poiseuille, fluid that slides past itself needs more room than its lattice.
    at = lattice((-radius, 0, -radius), (radius, long, radius), d)
    r2 = at[:, 0] ** 2 + at[:, 2] ** 2
    n = round(np.pi * radius**2 * long / d**3 / 1.04)
    at = at[np.argsort(r2, kind="stable")[:n]]
    at += np.random.default_rng(1).normal(0, 0.05 * d, at.shape)
    r2 = at[:, 0] ** 2 + at[:, 2] ** 2
    start = 0.9 * top * np.clip(1 - r2 / radius**2, 0, None)
    ids = sim.add(at, "oil", np.stack([0 * start, start, 0 * start], 1))
    sim.run(0.6 * radius**2 / nu)
    x, u = sim.positions[ids], sim.velocities[ids][:, 1]
    r2 = x[:, 0] ** 2 + x[:, 2] ** 2
    fit = np.polyfit(r2, u, 1)
    return [
        near("pipe: u_max", top, fit[1], 0.05),
        near("pipe: radius at which the fitted profile is 0", radius, np.sqrt(-fit[1] / fit[0]), 0.03),
    ]


def rotating_bucket(device: str = "cpu", threads: int = 0, cells: int = 12) -> list[Row]:
    """Water that turns in a bucket without friction keeps a parabola, y = omega² r² / (2 g)."""
    radius, spin, depth, seconds = 0.24, 5.0, 0.16, 1.0
    d = radius / cells
    high = depth + spin**2 * radius**2 / GRAVITY
    domain = {"lo": (-0.32, -4 * d, -0.32), "hi": (0.32, high + 4 * d, 0.32)}
    water = {"name": "water", "viscosity": 0.0}
    scene = {"spacing": d, "domain": domain, "gravity": (0, -GRAVITY, 0), "fluids": [water]}
    sim = Simulation(scene, device, threads)
    sim.add_phase(Phase("bucket", "boundary"))
    wall = radius + BEHIND * d
    floor = lattice((-wall, -1.0, -wall), (wall, -1.0 + d, wall), d)
    floor = floor[np.hypot(floor[:, 0], floor[:, 2]) < wall]
    floor[:, 1] = -BEHIND * d
    sim.add(np.concatenate([floor, ring(wall, d, -BEHIND * d + d / 2, high)]), "bucket")
    at = lattice((-radius, 0, -radius), (radius, high, radius), d)
    r2 = at[:, 0] ** 2 + at[:, 2] ** 2
    middle = depth - spin**2 * radius**2 / (4 * GRAVITY)
    at = at[(r2 < (radius - 0.3 * d) ** 2) & (at[:, 1] < middle + spin**2 * r2 / (2 * GRAVITY))]
    flow = spin * np.stack([at[:, 2], 0 * at[:, 0], -at[:, 0]], 1)
    ids = sim.add(at, "water", flow)
    first = sim.record.totals()["angular_momentum"][1]
    found = []
    while sim.time < seconds:
        sim.step()
        if sim.time > seconds / 2:
            found.append(curvature_of(sim.positions[ids], radius, d))
    kept = sim.record.totals()["angular_momentum"][1] / first
    return [
        near("bucket: curvature of the surface, 1/m", spin**2 / GRAVITY, float(np.mean(found)), 0.1),
        near("bucket: angular momentum kept in 1 s", 1.0, kept, 0.1),
    ]


def curvature_of(x: np.ndarray, radius: float, d: float) -> float:
    """Second derivative of the surface's height over the distance to the y axis, by the volume
    under rings of two spacings."""
    r = np.hypot(x[:, 0], x[:, 2])
    edges = np.arange(0, radius + 1e-9, 2 * d)
    count = np.histogram(r, edges)[0]
    area = np.pi * np.diff(edges**2)
    middle2 = 0.5 * (edges[1:] ** 2 + edges[:-1] ** 2)
    # The ring at the wall holds less: particles keep half a spacing away from it.
    height = count * d**3 / area
    inner = slice(0, -1)
    return float(2 * np.polyfit(middle2[inner], height[inner], 1, w=np.sqrt(area[inner]))[0])


def torricelli(device: str = "cpu", threads: int = 0, cells: int = 24) -> list[Row]:
    """Water leaves a slot in the floor of a tank at sqrt(2 g h)."""
    depth = 0.48
    d = depth / cells
    wide, slot, below = 0.64, 0.16, 0.2
    size = (-wide / 2 - 2 * d, -below, 0), (wide / 2 + 2 * d, depth + 2 * d, 8 * d)
    domain = {"lo": size[0], "hi": size[1], "periodic": ["z"]}
    water = {"name": "water", "viscosity": 0.0}
    scene = {"spacing": d, "domain": domain, "gravity": (0, -GRAVITY, 0), "fluids": [water]}
    sim = Simulation(scene, device, threads)
    sim.add_phase(Phase("tank", "boundary"))
    x = np.arange(-wide / 2 - d / 2, wide / 2 + d, d)
    z = (np.arange(8) + 0.5) * d
    floor = np.stack(np.meshgrid(x[np.abs(x) > slot / 2], [-d / 2], z, indexing="ij"), -1)
    y = (np.arange(round(depth / d) + 1) + 0.5) * d
    sides = np.stack(np.meshgrid([x[0], x[-1]], y, z, indexing="ij"), -1)
    sim.add(np.concatenate([floor.reshape(-1, 3), sides.reshape(-1, 3)]), "tank")
    at = lattice((-wide / 2 + d / 2, 0, 0), (wide / 2 - d / 2, depth, 8 * d), d)
    ids = sim.add(at, "water")
    heads, speeds = [], []
    while sim.time < 0.5:
        sim.step()
        if sim.time < 0.25:  # the stream begins
            continue
        p, v = sim.positions[ids], sim.velocities[ids]
        jet = (p[:, 1] < -0.05) & (p[:, 1] > -0.15)
        top = (p[:, 1] > 0) & (np.abs(p[:, 0]) > slot)
        surface = p[top][:, 1].mean() * 2
        heads.append(2 * GRAVITY * (surface - p[jet][:, 1].mean()))
        speeds.append((v[jet] ** 2).sum(1).mean())
    return [near("Torricelli: v² over 2 g h of the jet", 1.0, np.mean(speeds) / np.mean(heads), 0.06)]


def interface(
    device: str, threads: int, light: float, heavy_above: bool, cells: int, seconds: float
) -> tuple[np.ndarray, np.ndarray, float]:
    """Two fluids, 1000 and `light` kg/m³, in a closed box a wave long; the interface starts with
    the linear wave's speeds. Returns times, the mode's amplitude in m/s, and k."""
    length, depth, speed = 1.0, 0.5, 0.02
    d, k = length / cells, 2 * np.pi / length
    fluids = [
        {"name": "heavy", "density": 1000.0, "viscosity": 0.0},
        {"name": "light", "density": light, "viscosity": 0.0},
    ]
    hi = (length, 2 * depth, 8 * d)
    domain = {"lo": (0, 0, 0), "hi": hi, "walls": True, "periodic": ["x", "z"]}
    scene = {
        "spacing": d, "domain": domain, "gravity": (0, -GRAVITY, 0), "fluids": fluids,
        "solver": {"max_dt": 0.005},
    }  # fmt: skip
    sim = Simulation(scene, device, threads)
    at = lattice((0, 0, 0), hi, d)
    at += np.random.default_rng(1).normal(0, 0.02 * d, at.shape)

    def mode(p: np.ndarray) -> np.ndarray:
        kx, y = k * p[:, 0], p[:, 1] - depth
        near_ = np.sinh(k * (depth - np.abs(y))) / np.sinh(k * depth)
        along = np.cosh(k * (depth - np.abs(y))) / np.sinh(k * depth) * np.sign(y)
        return np.stack([along * np.sin(kx), near_ * np.cos(kx), 0 * kx], 1)

    above = at[:, 1] > depth
    for name, part in (("heavy", above == heavy_above), ("light", above != heavy_above)):
        sim.add(at[part], name, speed * mode(at[part]))
    times, swing = [], []
    while sim.time < seconds:
        sim.step()
        m = mode(sim.positions)
        fluid = sim.arrays.phase < 2
        times.append(sim.time)
        swing.append((sim.velocities * m)[fluid].sum() / (m[fluid] ** 2).sum())
    return np.array(times), np.array(swing), k


def rayleigh_taylor(device: str = "cpu", threads: int = 0, cells: int = 32) -> list[Row]:
    """Heavy fluid over light fluid, 2 : 1: a small wave grows as cosh(n t) from its speed,
    n² = A g k tanh(k h), A = 1/3 (Chandrasekhar 1961, section 92)."""
    t, y, k = interface(device, threads, 500.0, True, cells, 0.4)
    n = np.sqrt(GRAVITY * k * np.tanh(0.5 * k) / 3)
    from scipy.optimize import least_squares

    found = least_squares(lambda p: p[0] * np.cosh(p[1] * t) - y, [y[0], n])
    return [near("Rayleigh-Taylor, 2 : 1: growth rate, 1/s", n, abs(found.x[1]), 0.1)]


EXPERIMENTS = (
    elliptical_drop,
    rotating_square,
    sloshing,
    standing_wave,
    pipe_poiseuille,
    rotating_bucket,
    torricelli,
    rayleigh_taylor,
)
