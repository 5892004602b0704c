"""Fluids that meet bodies, each with a known answer: floating, falling, rising, settling, and a box
that is hit.

As in `physics_fluid`, each experiment takes a device and a number of threads, and returns rows
(truth, expected, measured, ok).
"""

from __future__ import annotations

import numpy as np
from globule.sim.sampling import BEHIND
from globule.sim.settings import Phase
from globule.sim.simulation import Simulation

from .physics_flows import potential_flow, ring, swing_of
from .physics_fluid import GRAVITY, Row, at_most, ball, lattice, near, tank

# Kleefsman et al. 2005, the experiment of SPHERIC's test 2: time in s, depths in m at the gauges
# H2 and H4, 0.992 and 2.638 m from the wall; and when the water reaches the box, 0.8245 m from it.
KLEEFSMAN = np.array(
    [
        (0.41, 0.053, 0.456),
        (0.45, 0.077, 0.443),
        (0.80, 0.147, 0.332),
        (0.87, 0.161, 0.312),
        (1.20, 0.195, 0.233),
        (1.26, 0.204, 0.222),
    ]
)
KLEEFSMAN_ARRIVAL, KLEEFSMAN_DEPTH = 0.408, 0.55


def heave(length: float, depth: float, wide: float, draft: float, cells: int = 10) -> float:
    """Frequency, rad/s, at which a floating box heaves amid a tank: linear potential flow.

    Half of the tank on a grid of `cells` to the draft. The potential at the surface and the box's
    speed determine the flow (Laplace's equation by finite differences); the pressure on the box's
    bottom and the surface's rise then make an eigenvalue problem, whose mode that moves the box
    most is taken. All lengths in m; the box has the density of the water that it displaces.
    """
    s = draft / cells
    nx, ny, nb = round(length / 2 / s), round(depth / s), round(wide / 2 / s)
    fluid = np.ones((nx, ny), bool)
    fluid[:nb, ny - cells :] = False
    number, solve = potential_flow(fluid)
    top, bottom = number[nb:, -1], number[:nb, ny - cells - 1]
    # Unknowns: potentials of the surface's cells, then the box's speed.
    m = len(top)
    given = np.zeros((fluid.sum(), m + 1))
    given[top, np.arange(m)] = 2.0
    given[bottom, m] = s
    potential = solve(given)
    rise = (np.eye(m) - potential[top, :m]) * 2 / s
    by_box = -potential[top, m] * 2 / s
    under = potential[bottom].sum(0) * s
    added = under[m] + s / 2 * nb * s
    mass, stiff = np.eye(m + 1), np.zeros((m + 1, m + 1))
    mass[:m, m], mass[m, m] = -by_box, wide / 2 * draft + added
    stiff[:m, :m], stiff[m, :m] = GRAVITY * rise, -GRAVITY * under[:m]
    stiff[m, m] = GRAVITY * wide / 2
    squares, modes = np.linalg.eig(np.linalg.solve(mass, stiff))
    start = np.zeros(m + 1)
    start[m] = 1.0
    share = np.where(squares.real > 1e-6, np.abs(modes[m] * np.linalg.solve(modes, start)), 0.0)
    return float(np.sqrt(squares.real[share.argmax()]))


def floating_box(device: str = "cpu", threads: int = 0, cells: int = 8) -> list[Row]:
    """A box half as dense as water floats half under water, and heaves as linear theory says.

    Fluid comes a quarter of a spacing nearer to a body than to a lattice's wall: the draft may be
    0.3 spacings too large.
    """
    length, depth, wide, high = 1.0, 0.5, 0.4, 0.4
    d, draft, lift = wide / cells, high / 2, 0.04
    water = {"name": "water", "viscosity": 0.0}
    sim = tank(d, (length, 1.0, 8 * d), water, device, threads, "z", True)
    sim.add_phase(Phase("box", "rigid"))
    at = lattice((0, 0, 0), (length, depth, 8 * d), d)
    left, bottom = (length - wide) / 2, depth - draft + lift
    aside = np.abs(at[:, 0] - length / 2) > wide / 2
    ids = sim.add(at[aside | (at[:, 1] < bottom)], "water")
    box = lattice((left, bottom, 0), (left + wide, bottom + high, 8 * d), d)
    sim.add(box, "box")
    sim.steer.make_rigid("box", 500.0)
    times, heights, drafts = [], [], []
    omega = heave(length, depth, wide, draft)
    while sim.time < 3.0 * 2 * np.pi / omega:
        sim.step()
        p, center = sim.positions[ids], sim.steer.body("box")["center"][1]
        strip = np.abs(p[:, 0] - length / 2) > wide / 2 + d
        level = strip.sum() * d**3 / ((length - wide - 2 * d) * 8 * d)
        times.append(sim.time)
        heights.append(center)
        drafts.append(level - center + high / 2)
    t, y = np.array(times), np.array(heights)
    measured, _ = swing_of(t, y - y.mean(), omega)
    whole = t > t[-1] - 2 * 2 * np.pi / omega
    return [
        near("floating box: draft, m", draft, float(np.mean(np.array(drafts)[whole])), 0.3 * d / draft),
        near("floating box: frequency of heave, rad/s", omega, measured, 0.08),
    ]


def _sphere(density: float, device: str, threads: int, cells: int, seconds: float = 0.02) -> tuple[float, float]:
    """Acceleration, m/s², down: expected and measured, of a sphere that is let go under water.

    The sphere is held until the water's lattice has come to rest around it. Its acceleration is
    that of the first moments: later, the water drags.

    Its added mass over that of the displaced water, C, is 1/2 without bounds (Lamb 1932, section
    92); in a vessel whose walls are b from the center about (b³ + 2 a³) / (2 (b³ - a³)), a: radius.
    """
    diameter, size = 0.2, 0.7
    d, a = diameter / cells, diameter / 2
    water = {"name": "water", "viscosity": 0.0}
    sim = tank(d, (size, size + 4 * d, size), water, device, threads, "", True)
    sim.add_phase(Phase("stone", "rigid"))
    center = np.full(3, size / 2)
    at = lattice((0, 0, 0), (size, size, size), d)
    sim.add(at[np.linalg.norm(at - center, axis=1) > a], "water")
    stone = ball(a, d) + center
    sim.add(stone, "stone")
    while sim.time < 0.4:
        sim.step(0.002)  # what is rigid, but no body yet, stands still
    sim.steer.make_rigid("stone", density)
    start, times, speeds = sim.time, [], []
    while sim.time < start + seconds:
        sim.step(0.002)
        times.append(sim.time)
        speeds.append(-sim.steer.body("stone")["velocity"][1])
    b = size / 2
    added = 1000.0 * (b**3 + 2 * a**3) / (2 * (b**3 - a**3))
    expected = GRAVITY * (density - 1000.0) / (density + added)
    return float(expected), float(np.polyfit(times, speeds, 1)[0])


def falling_sphere(device: str = "cpu", threads: int = 0, cells: int = 8) -> list[Row]:
    """A sphere twice as dense as the water around it begins to fall."""
    expected, measured = _sphere(2000.0, device, threads, cells)
    return [near("falling sphere: acceleration, m/s²", expected, measured, 0.1)]


def rising_sphere(device: str = "cpu", threads: int = 0, cells: int = 8) -> list[Row]:
    """A ball of a tenth of the water's density rises: most of its mass is the water's around it."""
    expected, measured = _sphere(100.0, device, threads, cells, 0.01)
    return [near("rising ball: acceleration, m/s²", -expected, -measured, 0.1)]


def settling_sphere(device: str = "cpu", threads: int = 0, cells: int = 8) -> list[Row]:
    """A heavy sphere sinks in a tube of honey at the speed at which its drag is its weight.

    Drag is Stokes's, 6 pi mu a v, times what a tube of four diameters adds to it (Haberman & Sayre
    1958). A Reynolds number of 0.06 adds nothing that matters. The sphere is twenty times as
    dense: what remains of the lattice's order in honey at rest pushes with up to the weight of the
    honey that the sphere displaces.
    """
    diameter, ratio, mu, density, g = 0.1, 0.25, 30.0, 20000.0, 0.1
    d, radius, high = diameter / cells, diameter / ratio / 2, 2.5 * diameter / ratio / 2
    side = radius + 2 * d
    scene = {
        "spacing": d,
        "domain": {"lo": (-side, 0, -side), "hi": (side, high + 4 * d, side), "walls": True},
        "gravity": (0, -g, 0),
        "solver": {"max_dt": 0.002},
        "fluids": [{"name": "honey", "viscosity": mu}],
    }
    sim = Simulation(scene, device, threads)
    sim.add_phase(Phase("tube", "boundary"))
    sim.add_phase(Phase("stone", "rigid"))
    sim.add(ring(radius + d / 2, d, 0, high + 3 * d), "tube")
    at = lattice((-radius, 0, -radius), (radius, high, radius), d)
    n = round(np.pi * radius**2 * high / d**3)
    at = at[np.argsort(at[:, 0] ** 2 + at[:, 2] ** 2, kind="stable")[:n]]
    center = np.array([0, high / 2, 0])
    stone = ball(diameter / 2, d) + center
    near_it = np.argsort(((at - center) ** 2).sum(1), kind="stable")
    sim.add(at[near_it[len(stone) :]], "honey")
    sim.add(stone, "stone")
    sim.run(0.2)
    sim.steer.make_rigid("stone", density)
    start, seconds, speeds = sim.time, 1.5, []
    while sim.time < start + seconds:
        sim.step()
        if sim.time > start + 2 / 3 * seconds:
            speeds.append(-sim.steer.body("stone")["velocity"][1])
    k = ratio
    tube = (1 - 0.75857 * k**5) / (1 - 2.1050 * k + 2.0865 * k**3 - 1.7068 * k**5 + 0.72603 * k**6)
    speed = 2 / 9 * (density - 1000.0) * g * (diameter / 2) ** 2 / mu / tube
    return [near("settling sphere: speed, m/s", speed, float(np.mean(speeds)), 0.05)]


def kleefsman(device: str = "cpu", threads: int = 0, spacing: float = 0.04025) -> list[Row]:
    """SPHERIC's test 2: a column of water falls and hits a box (Kleefsman et al. 2005)."""
    d = spacing
    size, back = (3.22, 1.0, 1.0), 3.22
    sim = tank(d, size, {"name": "water", "viscosity": 0.0}, device, threads)
    sim.add_phase(Phase("box", "boundary"))
    sim.add(shell((0.6635, 0.0, 0.2955), (0.8245, 0.161, 0.6985), d), "box")
    at = lattice((1.992, 0, 0), (back, KLEEFSMAN_DEPTH, 1.0), d)
    ids = sim.add(at - (at[:, 0].max() + d / 2 - back, 0, 0), "water")
    times, depths, arrival = [], [], 0.0
    while sim.time < KLEEFSMAN[-1, 0] + 0.02:
        report = sim.step()
        p = sim.positions[ids]
        times.append(sim.time)
        depths.append([depth_at(p, x, d) for x in (0.992, 2.638)])
        if not arrival and p[:, 0].min() < 0.8245 + 0.6 * d:
            arrival = sim.time
    t, found = np.array(times), np.array(depths)
    rows = []
    for k, name in enumerate(("H2", "H4")):
        means = [found[np.abs(t - when) < 0.02, k].mean() for when in KLEEFSMAN[:, 0]]
        worst = np.abs(np.array(means) - KLEEFSMAN[:, 1 + k]).max() / KLEEFSMAN_DEPTH
        rows.append(at_most(f"Kleefsman: depth at {name}, largest error over 0.55 m", 0.05, float(worst)))
    return [
        near("Kleefsman: water reaches the box, s", KLEEFSMAN_ARRIVAL, arrival, 0.05),
        *rows,
        at_most("Kleefsman: particles lost", 0, report.n_escaped),
    ]


def depth_at(p: np.ndarray, x: float, d: float) -> float:
    """Depth of water (M, 3) m around a gauge amid the tank, by its volume, m."""
    near_it = (np.abs(p[:, 0] - x) < 0.06) & (np.abs(p[:, 2] - 0.5) < 0.2)
    return float(near_it.sum() * d**3 / (0.12 * 0.4))


def shell(lo: tuple, hi: tuple, d: float) -> np.ndarray:
    """The sides and the top of a box on the floor as a boundary, (M, 3) m."""
    b = BEHIND * d
    inner_lo = np.array(lo) + (b, d / 2, b)
    inner_hi = np.array(hi) - b
    axes = [
        np.linspace(one, two, max(2, round((two - one) / d) + 1)) for one, two in zip(inner_lo, inner_hi, strict=True)
    ]
    at = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)
    outside = np.isclose(at[:, [0, 2]], inner_lo[[0, 2]]) | np.isclose(at, inner_hi)[:, [0, 2]]
    return at[outside.any(1) | np.isclose(at[:, 1], inner_hi[1])]


EXPERIMENTS = (floating_box, falling_sphere, rising_sphere, settling_sphere, kleefsman)
