"""Truths at two resolutions: the finer one has to be nearer, and the rows have the order of convergence.

As in `physics_fluid`, each experiment takes a device and a number of threads, and returns rows
(truth, expected, measured, ok).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from globule.sim.simulation import Simulation
from globule.sim.tissue import HALF_SPACE

from .physics_flows import potential_flow, swing_of
from .physics_fluid import GRAVITY, Row, at_least, at_most, lattice, near
from .physics_solid import solid
from .physics_tissue import DENSITY, MODULUS, SPACING, layers, settle
from .physics_tissue import lattice as lattice_of

# Ghia, Ghia & Shin 1982: least u on the vertical middle line, most and least v on the horizontal one,
# over the lid's speed.
GHIA = {100: (-0.21090, 0.17527, -0.24533), 400: (-0.32726, 0.30203, -0.44993)}
# Zick & Homsy 1982, simple cubic arrays: share of the volume, drag over Stokes's.
ZICK_HOMSY = {0.125: 4.292, 0.216: 7.442}


def orders(what: str, coarse: int, fine: int, errors: Sequence[float], noise: float) -> Row:
    """The finer resolution is nearer to the truth: order = log(error ratio) / log(resolution ratio).

    Errors below `noise` are no longer the resolution's: they count as converged.
    """
    first, then = (max(abs(e), 1e-12) for e in errors)
    if then <= noise:
        return at_most(f"{what}: error with {fine}", noise, then)
    return at_least(
        f"{what}: order of convergence, {coarse} to {fine}", 0.0, np.log(first / then) / np.log(fine / coarse)
    )


def twice(
    what: str, at: Callable[[int], float], truth: float, cells: tuple[int, int], relative: float, noise: float = 0.01
) -> list[Row]:
    """Rows of one number at two resolutions."""
    found = [at(n) for n in cells]
    return [
        near(f"{what}, {cells[1]} spacings", truth, found[1], relative),
        orders(what, *cells, [f / truth - 1 for f in found], noise),
    ]


def crossings(times: Sequence[float], values: Sequence[float]) -> np.ndarray:
    """When a swing goes through 0, by straight lines between its values."""
    t, y = np.array(times), np.array(values)
    k = np.flatnonzero((y[1:] > 0) != (y[:-1] > 0))
    return t[k] - y[k] * (t[k + 1] - t[k]) / (y[k + 1] - y[k])


def moving_plate(n: int, device: str, threads: int, speed: float, mu: float, high: float = 0.02) -> Simulation:
    """Oil between two plates of which the upper one slides along x all the time."""
    d = high / n
    domain = {"lo": (0, 0, -6 * d), "hi": (16 * d, 8 * d, high + 6 * d), "periodic": ["x", "y"]}
    oil = {"name": "oil", "viscosity": mu, "box": {"lo": (0, 0, 0), "hi": (16 * d, 8 * d, high)}}
    plates = [
        {"name": "bottom", "plane": {"point": (0, 0, 0), "normal": (0, 0, 1)}},
        {"name": "top", "plane": {"point": (0, 0, high), "normal": (0, 0, -1)}, "velocity": (speed, 0, 0)},
    ]
    scene = {"spacing": d, "domain": domain, "gravity": (0, 0, 0), "fluids": [oil], "boundaries": plates}
    return Simulation({**scene, "solver": {"max_dt": 0.01}}, device, threads)


def couette_start(device: str = "cpu", threads: int = 0, cells: tuple[int, int] = (10, 20)) -> list[Row]:
    """A plate begins to slide over oil at rest: the profile while it builds up, and the shear stress on both plates."""
    speed, mu, high = 0.004, 0.1, 0.02
    nu, errors, stress = mu / 1000, [], 0.0

    def exact(z: np.ndarray, time: float) -> np.ndarray:
        k = np.arange(1, 60)[:, None] * np.pi / high
        waves = np.cos(k * high) * np.exp(-(k**2) * nu * time) * np.sin(k * z) / (k * high)
        return speed * (z / high + 2 * waves.sum(0))

    for n in cells:
        sim = moving_plate(n, device, threads, speed, mu, high)
        fluid = sim.arrays.phase == list(sim.phases).index("oil")
        error = []
        for share in (0.05, 0.1, 0.3):
            sim.run_to(share * high**2 / nu)
            off = sim.velocities[fluid, 0] - exact(sim.positions[fluid, 2].astype(float), sim.time)
            error.append(np.sqrt((off**2).mean()) / speed)
        errors.append(max(error))
        sim.run_to(1.2 * high**2 / nu)
        area = np.prod(np.subtract(sim.file.domain.hi, sim.file.domain.lo)[:2])
        stress = sim.record.force("bottom")[0][0] / (mu * speed / high * area)
    return [
        at_most("Couette flow that starts: rms error / speed", 0.02, errors[-1]),
        orders("Couette flow that starts", *cells, errors, 0.01),
        near("Couette flow: force on the plate at rest / shear stress", 1.0, stress, 0.05),
    ]


def couette_far(device: str = "cpu", threads: int = 0, cells: int = 8, lengths: float = 100.0) -> list[Row]:
    """After a plate has slid so many times along the domain, the flow is what it was."""
    speed, mu, high = 0.2, 0.5, 0.02
    sim = moving_plate(cells, device, threads, speed, mu, high)
    fluid = sim.arrays.phase == list(sim.phases).index("oil")
    length = sim.file.domain.hi[0]
    sim.run_to(lengths * length / speed)
    z, u = sim.positions[fluid, 2].astype(float), sim.velocities[fluid].astype(float)
    off = u[:, 0] - speed * z / high
    return [
        at_most(f"Couette flow after {lengths:g} lengths: rms error / speed", 0.03, np.sqrt((off**2).mean()) / speed),
        at_most("its fastest particle / the plate", 1.02, np.linalg.norm(u, axis=1).max() / speed),
    ]


def cavity(
    device: str = "cpu", threads: int = 0, reynolds: int = 100, cells: tuple[int, int] = (20, 32), turns: float = 15.0
) -> list[Row]:
    """A lid slides over a square of fluid: extremes of the velocity on both middle lines."""
    found = []
    for n in cells:
        d = 1.0 / n
        walls = {"left": ((0, 0, 0), (1, 0, 0)), "right": ((1, 0, 0), (-1, 0, 0)), "floor": ((0, 0, 0), (0, 0, 1))}
        planes: list[dict[str, Any]] = [
            {"name": name, "plane": {"point": point, "normal": normal}} for name, (point, normal) in walls.items()
        ]
        lid = {"name": "lid", "plane": {"point": (0, 0, 1), "normal": (0, 0, -1)}, "velocity": (1, 0, 0)}
        domain = {"lo": (-2 * d, 0, -2 * d), "hi": (1 + 2 * d, 8 * d, 1 + 2 * d), "periodic": ["x", "y"]}
        fluid = {"name": "oil", "density": 1.0, "viscosity": 1 / reynolds}
        scene = {"spacing": d, "domain": domain, "gravity": (0, 0, 0), "boundaries": [*planes, lid]}
        sim = Simulation({**scene, "fluids": [fluid], "solver": {"max_dt": 0.02}}, device, threads)
        ids = sim.add(lattice((0, 0, 0), (1, 8 * d, 1), d), "oil")
        sim.run_to(turns)
        bins = np.linspace(0, 1, n + 1)
        u, v, samples = np.zeros(n), np.zeros(n), 20
        for _ in range(samples):
            sim.run_to(sim.time + 0.1)
            p, w = sim.positions[ids].astype(float), sim.velocities[ids].astype(float)
            for out, across, along, k in ((u, 0, 2, 0), (v, 2, 0, 2)):
                middle = abs(p[:, across] - 0.5) < 0.05
                count, _ = np.histogram(p[middle, along], bins)
                total, _ = np.histogram(p[middle, along], bins, weights=w[middle, k])
                out += total / np.maximum(count, 1) / samples
        found.append((u.min(), v.max(), v.min()))
    truth = GHIA[reynolds]
    rows = []
    for name, i in (("least u", 0), ("most v", 1), ("least v", 2)):
        what = f"cavity, Re {reynolds}: {name}"
        rows.append(near(f"{what}, {cells[1]} spacings", truth[i], found[1][i], 0.1))
        rows.append(orders(what, *cells, [f[i] / truth[i] - 1 for f in found], 0.03))
    return rows


def u_tube_length(leg: float, wide: float, apart: float, cells: int = 16) -> float:
    """Length, over one leg's cross-section, of the water that swings in a U of two legs and a tube of the same width:
    potential flow on a grid of `cells` to the width."""
    s = wide / cells
    fluid = np.ones((round((2 * wide + apart) / s), round(leg / s)), bool)
    fluid[cells:-cells, cells:] = False
    number, solve = potential_flow(fluid)
    left = number[:cells, -1]
    given = np.zeros(fluid.sum())
    given[left] = 2.0
    return wide / (2 * (1 - solve(given)[left]).sum())


def u_tube(device: str = "cpu", threads: int = 0, cells: tuple[int, int] = (6, 10)) -> list[Row]:
    """Water swings in a U of two legs: ω² = 2 g / L, L by potential flow in the corners.

    Half of the height is lost in each half period, whatever the resolution here: the frequency is
    no closer with the finer one.
    """
    wide, apart, leg, rise = 0.1, 0.1, 0.4, 0.02
    truth = float(np.sqrt(2 * GRAVITY / u_tube_length(leg, wide, apart)))

    def frequency(n: int) -> float:
        d = wide / n
        domain = {"lo": (0, 0, 0), "hi": (2 * wide + apart, 8 * d, leg + 0.15), "periodic": ["y"], "walls": True}
        wall = {"box": {"lo": (wide, -d, wide), "hi": (wide + apart, 9 * d, leg + 0.2)}}
        scene = {"spacing": d, "domain": domain, "boundaries": [{"name": "between", **wall}]}
        sim = Simulation(
            {**scene, "fluids": [{"name": "water", "viscosity": 0.0}], "solver": {"max_dt": 0.01}}, device, threads
        )
        ends = ((0.0, leg + rise), (wide + apart, leg - rise))
        legs = [lattice((x, 0, wide), (x + wide, 8 * d, top), d) for x, top in ends]
        ids = sim.add(np.concatenate([lattice((0, 0, 0), (2 * wide + apart, 8 * d, wide), d), *legs]), "water")
        times, swing = [], []
        while sim.time < 1.5 * 2 * np.pi / truth:
            sim.step()
            p, v = sim.positions[ids], sim.velocities[ids, 2].astype(float)
            up = (p[:, 2] > wide) & (p[:, 2] < leg - 2 * rise)
            times.append(sim.time)
            swing.append(v[up & (p[:, 0] < wide)].mean() - v[up & (p[:, 0] > wide + apart)].mean())
        return float(np.hypot(*swing_of(np.array(times), np.array(swing), truth)))

    found = [frequency(n) for n in cells]
    return [near(f"U-tube: frequency, rad/s, {n} spacings", truth, f, 0.15) for n, f in zip(cells, found, strict=True)]


def capillary_wave(
    device: str = "cpu", threads: int = 0, gravity: float = 0.0, cells: tuple[int, int] = (16, 24)
) -> list[Row]:
    """A standing wave that surface tension drives: ω² = (g k + sigma k³ / rho) tanh(k h)."""
    sigma, d, deep = 0.07, 0.001, 0.5

    def ratio(n: int) -> float:
        length = n * d
        k, high = 2 * np.pi / length, round(deep * n) * d
        truth = np.sqrt((gravity * k + sigma * k**3 / 1000) * np.tanh(k * high))
        domain = {"lo": (0, 0, 0), "hi": (length, 8 * d, high + 8 * d), "periodic": ["x", "y"], "walls": True}
        water = {"name": "water", "viscosity": 1e-4, "surface_tension": sigma}
        scene = {"spacing": d, "domain": domain | {"open": ["+z"]}, "gravity": (0, 0, -gravity), "fluids": [water]}
        sim = Simulation(scene, device, threads)

        def mode(p: np.ndarray) -> np.ndarray:
            x, z = k * p[:, 0].astype(float), k * p[:, 2].astype(float)
            return np.stack([-np.sin(x) * np.cosh(z), 0 * x, np.cos(x) * np.sinh(z)], 1) / np.sinh(k * high)

        at = lattice((0, 0, 0), (length, 8 * d, high), d)
        ids = sim.add(at, "water", 0.25 / k * truth * mode(at))
        times, swing = [], []
        while sim.time < 1.4 * 2 * np.pi / truth:
            sim.step()
            m = mode(sim.positions[ids])
            times.append(sim.time)
            swing.append((sim.velocities[ids] * m).sum() / (m**2).sum())
        zeros = crossings(times, swing)
        return float(np.pi / np.diff(zeros).mean() / truth) if len(zeros) > 1 else 0.0

    return twice(f"capillary wave, g = {gravity:g}: frequency over the truth", ratio, 1.0, cells, 0.03)


def sphere_array(
    device: str = "cpu", threads: int = 0, share: float = 0.125, cells: tuple[int, int] = (12, 18)
) -> list[Row]:
    """Honey pushed through a cubic array of spheres at rest: drag over Stokes's, and the force that a sphere reads."""
    truth, force = ZICK_HOMSY[share], 0.0
    wide = 0.02
    radius = wide * (3 * share / (4 * np.pi)) ** (1 / 3)

    def drag(n: int) -> float:
        nonlocal force
        d, mu, push = wide / n, 1.0, 1.0
        domain = {"lo": (0, 0, 0), "hi": (wide, wide, wide), "periodic": ["x", "y", "z"]}
        ball = {"name": "ball", "sphere": {"center": (wide / 2,) * 3, "radius": radius}}
        scene = {"spacing": d, "domain": domain, "gravity": (push, 0, 0), "boundaries": [ball]}
        honey = {"name": "honey", "viscosity": mu, "implicit": True}
        sim = Simulation({**scene, "fluids": [honey], "solver": {"max_dt": 0.002}}, device, threads)
        at = lattice((0, 0, 0), (wide,) * 3, d)
        outside = np.linalg.norm(at - wide / 2, axis=1)
        at = at[np.argsort(-outside, kind="stable")[: round(n**3 * (1 - share))]]
        ids = sim.add(at, "honey")
        sim.run_to(1.5 * wide**2 * 1000 / mu)
        mean = sim.velocities[ids, 0].astype(float).mean() * (1 - share)
        force = sim.record.force("ball")[0][0] / (1000 * push * len(ids) * d**3)
        return 1000 * push * wide**3 / (6 * np.pi * mu * radius * mean)

    rows = twice(f"spheres, {100 * share:g} % of the volume: drag / Stokes's", drag, truth, cells, 0.04)
    return [*rows, near("force on the sphere / what pushes the fluid", 1.0, force, 0.05)]


def bar_wave(device: str = "cpu", threads: int = 0, cells: tuple[int, int] = (12, 24)) -> list[Row]:
    """A free bar whose ends swing along it: its lowest frequency is that of waves of speed sqrt(E / rho)."""
    across = 3

    def speed(n: int) -> float:
        x = lattice_of(across, across, n)
        tissue = solid(x, 0.0, device=device, threads=threads)
        length, z = n * SPACING, x[:, 2].astype(float)
        mode = np.cos(np.pi * (z - z.min() + SPACING / 2) / length)
        tissue.velocities = np.stack([0 * z, 0 * z, 1e-3 * np.sqrt(MODULUS / DENSITY) * mode], 1)
        period = 2 * length * np.sqrt(DENSITY / MODULUS)
        times, swing, dt = [], [], period / 60
        for step in range(150):
            times.append(step * dt)
            swing.append((tissue.velocities[:, 2].astype(float) * mode).sum())
            tissue.advance(dt)
        return float(period / 2 / np.diff(crossings(times, swing)).mean())

    return twice("waves along a bar: speed / sqrt(E / rho)", speed, 1.0, cells, 0.02, 0.005)


def rebound(device: str = "cpu", threads: int = 0, cells: tuple[int, int] = (12, 24)) -> list[Row]:
    """A bar that flies against a wall, end on, comes back as fast as it came, when a wave has gone to and fro."""
    share = 0.01  # of the waves' speed

    def meet(n: int) -> tuple[float, float]:
        x = lattice_of(3, 3, n).astype(float)
        x[:, 2] += 0.05 * SPACING - x[:, 2].min()
        tissue = solid(x, 0.0, device=device, threads=threads)
        waves = np.sqrt(MODULUS / DENSITY)
        tissue.velocities = np.broadcast_to((0.0, 0.0, -share * waves), x.shape)
        tissue.instruments(shapes=[(HALF_SPACE, (0, 0, 0), (0, 0, 1), 0.0, (0, 0, 0))])
        period = 2 * n * SPACING / waves
        speeds = []
        for _ in range(400):
            tissue.advance(period / 200)
            speeds.append(tissue.velocities[:, 2].mean(dtype="f8") / (share * waves))
        v = np.array(speeds)
        there = np.flatnonzero(v > 0.98 * v[-1])[0] - np.flatnonzero(v > -0.99)[0]
        return v[-1], there / 200

    found = [meet(n) for n in cells]
    rows = []
    for k, (what, relative) in enumerate((("speed after / before", 0.1), ("time of contact / 2 L / c", 0.06))):
        name = f"bar against a wall: {what}"
        rows.append(near(f"{name}, {cells[1]} spacings", 1.0, found[1][k], relative))
        rows.append(orders(name, *cells, [f[k] - 1 for f in found], 0.005))
    return rows


# Mattiasson 1981: load P L² / (E I) -> how far a clamped beam's tip goes aside, over its length.
ELASTICA = {1.0: 0.30172, 2.0: 0.49346}


def elastica(device: str = "cpu", threads: int = 0, load: float = 2.0, cells: tuple[int, int] = (3, 5)) -> list[Row]:
    """A slender clamped beam whose tip is pulled far aside: the elastica."""

    def aside(across: int) -> float:
        x = lattice_of(across, across, 20 * across + 2)
        z = layers(x) - 1
        length, thick = (20 * across - 0.5) * SPACING, across * SPACING
        slowest = 3.516 * thick / np.sqrt(12) * np.sqrt(MODULUS / DENSITY) / length**2
        tissue = solid(x, 0.0, fixed=z <= 0, damping=1.5 * slowest, device=device, threads=threads)
        tip = z == z.max()
        pull = np.zeros_like(x)
        pull[tip, 0] = load * MODULUS * thick**4 / 12 / length**2 / (across**2 * DENSITY * SPACING**3)
        tissue.accelerate(pull)
        y = settle(tissue, 10.0 / slowest)
        return float((y[tip, 0].mean() - x[tip, 0].mean(dtype="f8")) / length)

    what = f"elastica, P L² = {load:g} E I: tip aside / length"
    return twice(what, aside, ELASTICA[load], cells, 0.03, 0.02)


def flips(device: str = "cpu", threads: int = 0, cells: tuple[int, int] = (4, 8)) -> list[Row]:
    """A brick that turns about its middle axis flips over, and over again: when, by Euler's equations; its energy and
    momentum stay. The brick is cells × 2 cells × 3 cells, so that the inertia is the same."""
    spin = np.array([0.02, 0.02, 10.0])

    def euler(inertia: np.ndarray, until: float) -> np.ndarray:
        """Times at which the spin about the middle axis changes its sign."""

        def slope(w: np.ndarray) -> np.ndarray:
            return -np.cross(w, inertia * w) / inertia

        w, t, dt, out = spin.copy(), 0.0, 1e-4, []
        while t < until:
            a = slope(w)
            b = slope(w + 0.5 * dt * a)
            c = slope(w + 0.5 * dt * b)
            after = w + dt / 6 * (a + 2 * b + 2 * c + slope(w + dt * c))
            if after[2] * w[2] < 0:
                out.append(t + dt * w[2] / (w[2] - after[2]))
            w, t = after, t + dt
        return np.array(out)

    rows = []
    for n in cells:
        d = 0.1 / n
        size = np.array([1, 3, 2]) * 0.1
        domain = {"lo": (-1, -1, -1), "hi": (1, 1, 1)}
        brick = {"name": "brick", "density": 500.0, "spin": tuple(spin), "box": {"lo": -size / 2, "hi": size / 2}}
        scene = {"spacing": d, "domain": domain, "gravity": (0, 0, 0), "rigids": [brick]}
        sim = Simulation({**scene, "solver": {"max_dt": 0.005}}, device, threads)
        x = sim.positions.astype(float)
        own = d**2 / 6
        square = (x**2).mean(0)
        inertia = square.sum() - square + own
        until = 6.0
        truth = euler(inertia, until)
        times, signs = [], []
        while sim.time < until:
            sim.step()
            body = sim.steer.body("brick")
            times.append(sim.time)
            own_spin = body["rotation"].T @ body["spin"]
            signs.append(own_spin[2])
        found = crossings(times, signs)
        name = f"brick that flips, {n} spacings thin"
        rows += [
            Row(f"{name}: flips in {until:g} s", len(truth), len(found), len(found) == len(truth)),
            near(f"{name}: time of the last, s", truth[-1], found[-1] if len(found) else 0.0, 0.01),
            near(f"{name}: energy over the first", 1.0, inertia @ own_spin**2 / (inertia @ spin**2), 1e-3),
        ]
    return rows


EXPERIMENTS = (
    couette_start, couette_far, cavity, u_tube, capillary_wave, sphere_array, bar_wave, rebound, elastica, flips,
)  # fmt: skip
