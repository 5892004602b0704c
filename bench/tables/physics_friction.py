"""Experiments on friction of tissue with known answers.

Every experiment takes a device and a number of threads, and returns rows (truth, expected,
measured, ok). The tests run the same experiments.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from globule.sim import blade
from globule.sim.simulation import Simulation
from globule.sim.tissue import HALF_SPACE, Tissue

from .physics_solid import solid
from .physics_tissue import DENSITY, SPACING, Row, lattice, row, springs

_G = 9.81
_D = 0.004  # m, spacing of the scenes
_FLOORS = ("wall", "fixed tissue", "elastic tissue")


def _down(degrees: float) -> np.ndarray:
    """Gravity of a floor that is tilted by an angle, (3,) m/s², in the floor's frame."""
    angle = np.radians(degrees)
    return _G * np.array([np.sin(angle), 0.0, -np.cos(angle)])


def _acceleration(friction: float, degrees: float) -> float:
    """Of a block that slides down, m/s²."""
    angle = np.radians(degrees)
    return _G * (np.sin(angle) - friction * np.cos(angle))


def _fitted(times: list[float], speeds: list[float], start: float) -> float:
    t, v = np.array(times), np.array(speeds)
    return float(np.polyfit(t[t >= start], v[t >= start], 1)[0])


def tilted_shape(device: str, threads: int = 0, model: str = "solid") -> list[Row]:
    """A block on a tilted half-space stays or slides; the half-space feels its weight and the
    friction."""
    rows = []
    x = lattice(6, 6, 3)
    for friction, degrees in ((0.5, 20.0), (0.2, 20.0), (0.3, 30.0)):
        make = solid if model == "solid" else _springs
        damping = 30.0 if _acceleration(friction, degrees) <= 0 else 0.0
        tissue = make(x, friction=friction, damping=damping, device=device, threads=threads)
        tissue.instruments([], [(HALF_SPACE, (0, 0, 0), (0, 0, 1), 0.0, (0, 0, 0))])
        times, speeds, forces, dt = [], [], [], 0.002
        for k in range(150):
            tissue.advance(dt, _down(degrees))
            times.append((k + 1) * dt)
            speeds.append(float(tissue.velocities[:, 0].mean(dtype="f8")))
            forces.append(tissue.shape_force()[0])
        force, weight = np.mean(forces[50:], 0), len(x) * DENSITY * SPACING**3 * _G
        truth = f"{model} on a half-space tilted by {degrees:g} degrees, friction {friction:g}:"
        moved = tissue.positions - x
        rows += _stays_or_slides(truth, friction, degrees, moved, times, speeds, 0.1)
        normal = weight * np.cos(np.radians(degrees))
        along = min(friction, np.tan(np.radians(degrees)))
        rows += [
            row(f"{truth} felt normal force / weight's", 1.0, -force[2] / normal,
                abs(-force[2] / normal - 1) < 0.03),
            row(f"{truth} felt friction / normal force", along, -force[0] / force[2],
                abs(-force[0] / force[2] - along) < 0.03 * along),
        ]  # fmt: skip
    return rows


def _springs(x: np.ndarray, **how: Any) -> Tissue:
    return springs(x, SPACING, 2500.0, DENSITY, **how)


def _stays_or_slides(
    truth: str, friction: float, degrees: float, moved: np.ndarray, times: list[float],
    speeds: list[float], start: float,
) -> list[Row]:  # fmt: skip
    expected = _acceleration(friction, degrees)
    if expected <= 0:
        free = 0.5 * _acceleration(0.0, degrees) * times[-1] ** 2
        way = float(moved[:, 0].mean(dtype="f8")) / free
        return [row(f"{truth} way of what stays / without friction", 0.0, way, abs(way) < 0.03)]
    measured = _fitted(times, speeds, start)
    ratio = measured / expected
    return [row(f"{truth} acceleration", expected, measured, abs(ratio - 1) < 0.04)]


def scene(floor: str, degrees: float, friction: float = 0.0, **block: Any) -> dict[str, Any]:
    """A block of tissue of 6 × 6 × 3 particles on a tilted floor, which has the friction."""
    d = _D
    lower = {"lo": (-0.04, -6 * d, -3 * d), "hi": (0.2, 6 * d, 0.0)}
    found: dict[str, Any] = {
        "spacing": d, "domain": {"lo": (-0.1, -0.1, -0.05), "hi": (0.3, 0.1, 0.1)},
        "gravity": _down(degrees).tolist(),
        "solids": [{
            "name": "block", "box": {"lo": (0, -3 * d, 0), "hi": (6 * d, 3 * d, 3 * d)},
            "young": 30000.0, **block,
        }],
    }  # fmt: skip
    if floor == "wall":
        found["boundaries"] = [{"name": "floor", "box": lower, "friction": friction}]
    else:
        top = -1.5 * d if floor == "elastic tissue" else 1.0
        found["solids"].append({
            "name": "floor", "box": lower, "young": 30000.0, "friction": friction,
            "fixed": [{"box": {"lo": (-1, -1, -1), "hi": (1, 1, top)}}],
        })  # fmt: skip
    return found


def tilted_floor(
    device: str, threads: int = 0, floor: str = "wall", friction: float = 0.2,
    degrees: float = 20.0, **block: Any,
) -> list[Row]:  # fmt: skip
    """A block on a floor of a scene stays or slides. What stays is damped: trembling, it creeps."""
    if _acceleration(friction, degrees) <= 0:
        block["damping"] = 30.0
    sim = Simulation(scene(floor, degrees, friction, **block), device, threads)
    mine = sim.arrays.phase == list(sim.phases).index("block")
    x, times, speeds = sim.positions, [], []
    while sim.time < 0.2:
        sim.step()
        times.append(sim.time)
        speeds.append(float(sim.velocities[mine, 0].mean(dtype="f8")))
    model = sim.file.solids[0].model
    truth = f"{model} on {floor} tilted by {degrees:g} degrees, friction {friction:g}:"
    moved = (sim.positions - x)[mine]
    return _stays_or_slides(truth, friction, degrees, moved, times, speeds, 0.06)


def cut_halves(device: str, threads: int = 0, model: str = "solid") -> list[Row]:
    """The upper half of a cut block stays on the lower one, or slides off it."""
    d, rows = _D, []
    for friction, degrees, least, most in ((1.0, 20.0, 0.0, 0.2), (0.0, 30.0, 1.0, 40.0)):
        sim = Simulation({
            "spacing": d, "domain": {"lo": (-0.1, -0.1, -0.05), "hi": (0.3, 0.1, 0.1)},
            "gravity": _down(degrees).tolist(),
            "solids": [{
                "name": "block", "box": {"lo": (0, 0, 0), "hi": (8 * d, 8 * d, 8 * d)},
                "young": 30000.0, "model": model, "friction": friction,
                "fixed": [{"box": {"lo": (-1, -1, -1), "hi": (1, 1, 2 * d)}}],
            }],
        }, device, threads)  # fmt: skip
        x = sim.positions
        edge = np.array([[-1.0, -1.0, 4 * d], [-1.0, 1.0, 4 * d]])
        sim.tissue.cut(blade.sweep(edge, edge + [2.0, 0, 0]))
        sim.run(0.12)
        way = float((sim.positions - x)[x[:, 2] > 4 * d, 0].mean(dtype="f8")) / d
        truth = f"{model}, half of a cut block tilted by {degrees:g} degrees, friction {friction:g}"
        limit = "at least" if least else ""
        rows.append(row(f"{truth}: way / spacing", least, way, least <= way < most, limit))
    return rows


def belt(device: str, threads: int = 0) -> list[Row]:
    """A half-space that moves like a belt takes a block along: with μ g until both are as fast, and
    feels μ times the normal force until then. The block has come to rest on it before."""
    x, friction, speed, dt = lattice(6, 6, 3), 0.4, 0.2, 0.001
    tissue = solid(x, device=device, threads=threads)
    forces, speeds = [], []
    for k in range(150):
        tissue.instruments([], [(HALF_SPACE, (0, 0, 0), (0, 0, 1), 0.0, (0, 0, 0), friction)])
        tissue.advance(dt, _down(0.0) * min(k / 100, 1.0))
    for k in range(100):
        at = (speed * k * dt, 0, 0)
        tissue.instruments([], [(HALF_SPACE, at, (0, 0, 1), 0.0, (speed, 0, 0), friction)])
        tissue.advance(dt, _down(0.0))
        forces.append(tissue.shape_force()[0])
        speeds.append(float(tissue.velocities[:, 0].mean(dtype="f8")))
    slid = round(speed / (friction * _G) / dt)  # 51 steps
    sliding, taken = np.mean(forces[10 : slid - 5], 0), float(np.mean(speeds[slid + 10 :]))
    ratio = float(sliding[0] / sliding[2])
    early = speeds[slid - 10] / (friction * _G * (slid - 9) * dt)
    return [
        row("belt: felt friction / normal force", friction, ratio,
            abs(ratio - friction) < 0.05 * friction),
        row("belt: speed of a block that slides / μ g t", 1.0, early, abs(early - 1) < 0.03),
        row("belt: speed of a block that was taken along / belt's", 1.0, taken / speed,
            abs(taken / speed - 1) < 0.02),
    ]  # fmt: skip


def drag(device: str, threads: int = 0) -> list[Row]:
    """A grasp presses a block on a half-space and drags it: it feels μ times the force that the
    half-space feels; a held slab that is dragged over tissue feels μ times its normal force."""
    friction, speed, dt, d = 0.3, 0.1, 0.001, SPACING
    x = lattice(6, 6, 4)
    tissue = solid(x, 0.0, friction=friction, device=device, threads=threads)
    tissue.grasp((0, 0, 10 + 2.5 * d), 10.0)
    floor = (HALF_SPACE, (0, 0, 0), (0, 0, 1), 0.0, (0, 0, 0))
    felt, carried = [], []
    for k in range(250):  # faster by and by: what swings is not at rest
        velocity = (0, 0, -0.1 * d / 0.05) if k < 50 else (speed * min((k - 49) / 100, 1.0), 0, 0)
        tissue.instruments([(velocity, (0, 0, 0), (0, 0, 0))], [floor])
        tissue.advance(dt)
        felt.append(tissue.grasp_force()[0])
        carried.append(tissue.shape_force()[0])
    grasp, half_space = np.mean(felt[170:], 0), np.mean(carried[170:], 0)
    ratio = float(grasp[0] / half_space[2])
    return [
        row("dragged over a half-space: grasp's friction / normal force", friction, ratio,
            abs(ratio - friction) < 0.03 * friction),
        row("the same: half-space's friction / normal force", friction,
            float(-half_space[0] / half_space[2]),
            abs(-half_space[0] / half_space[2] - friction) < 0.03 * friction),
        *_held_over_tissue(device, threads, friction),
    ]  # fmt: skip


def _held_over_tissue(device: str, threads: int, friction: float) -> list[Row]:
    """The held slab is wider than the tissue: at a rim, contacts lean."""
    d = _D
    sim = Simulation({
        "spacing": d, "domain": {"lo": (-0.1, -0.1, -0.05), "hi": (0.3, 0.1, 0.1)},
        "gravity": (0, 0, 0),
        "solids": [
            {"name": "block", "box": {"lo": (0, 0, -3 * d), "hi": (6 * d, 6 * d, 0)},
             "young": 30000.0, "friction": friction,
             "fixed": [{"box": {"lo": (-1, -1, -1), "hi": (1, 1, -2 * d)}}]},
            {"name": "slab", "box": {"lo": (-8 * d, -3 * d, 0), "hi": (9 * d, 9 * d, 2 * d)},
             "young": 30000.0},
        ],
    }, device, threads)  # fmt: skip
    middle = np.array([0, 0, 10 + 0.2 * d])  # a ball with a flat side
    sim.tools.grasp(middle, 10.0)
    felt: list[np.ndarray] = []
    while sim.time < 0.15:
        velocity = np.array([0, 0, -0.3 * d / 0.03]) if sim.time < 0.03 else np.array([0.2, 0, 0])
        sim.tools.move_grasp(0, velocity, (0, 0, 0), middle)
        report = sim.step()
        middle = middle + velocity * report.dt
        if sim.time > 0.06:
            felt.append(sim.tools.grasp_force()[0] * report.dt)
    force = np.sum(felt, 0)
    ratio = float(-force[0] / force[2])
    truth = "held slab dragged over tissue: friction / normal force"
    return [row(truth, friction, ratio, abs(ratio - friction) < 0.05 * friction)]


def collision(device: str, threads: int = 0, friction: float = 0.1) -> list[Row]:
    """Two free blocks that meet obliquely keep their momentum; their energy never grows."""
    d = _D
    box = {"lo": (0, 0, 0), "hi": (5 * d, 5 * d, 5 * d)}
    other = {"lo": (d, 0, 6 * d), "hi": (6 * d, 5 * d, 11 * d)}
    sim = Simulation({
        "spacing": d, "domain": {"lo": (-0.1,) * 3, "hi": (0.15,) * 3}, "gravity": (0, 0, 0),
        "solids": [
            {"name": "one", "box": box, "young": 30000.0, "friction": friction,
             "density": DENSITY, "velocity": (0.2, 0, 0.1)},
            {"name": "two", "box": other, "young": 30000.0, "density": DENSITY,
             "velocity": (-0.1, 0.05, -0.3)},
        ],
    }, device, threads)  # fmt: skip
    mass = DENSITY * d**3
    middle = sim.positions.mean(0, dtype="f8")

    def totals() -> tuple[np.ndarray, np.ndarray, float]:
        v, r = sim.velocities.astype("f8"), sim.positions.astype("f8") - middle
        energy = 0.5 * mass * (v**2).sum() + sim.tissue.elastic_energy
        return mass * v.sum(0), mass * np.cross(r, v).sum(0), float(energy)

    first_p, first_l, energy = totals()
    one = sim.arrays.phase == 0
    speed = mass * float(np.linalg.norm(sim.velocities, axis=1).sum(dtype="f8"))
    turned = float(np.abs(np.cross(sim.positions - middle, sim.velocities)).sum(dtype="f8")) * mass
    first, least, above = sim.velocities[one].mean(0, dtype="f8"), energy, 0.0
    while sim.time < 0.08:
        sim.step()
        _, _, now = totals()
        least, above = min(least, now), max(above, now - least)
    after_p, after_l, _ = totals()
    gain = sim.velocities[one].mean(0, dtype="f8") - first
    ratio = float(np.hypot(gain[0], gain[1]) / abs(gain[2]))
    drift = float(np.abs(after_p - first_p).max() / speed)
    turn = float(np.abs(after_l - first_l).max() / turned)
    return [
        row("two blocks meet obliquely: momentum's drift, of Σ m |v|", 0.0, drift, drift < 1e-6),
        row("the same: angular momentum's drift, of Σ m |r × v|", 0.0, turn, turn < 0.03),
        row("the same: energy above its least before / first energy", 0.0, above / energy,
            above / energy < 0.03),
        row("the same: impulse along the faces / across", friction, ratio,
            abs(ratio - friction) < 0.05 * friction),
    ]  # fmt: skip


def against_rigid(device: str, threads: int = 0, friction: float = 0.2) -> list[Row]:
    """A free block of tissue meets a free rigid box obliquely; together, they keep momentum."""
    d = _D
    sim = Simulation({
        "spacing": d, "domain": {"lo": (-0.1,) * 3, "hi": (0.15,) * 3}, "gravity": (0, 0, 0),
        "solids": [{
            "name": "block", "box": {"lo": (2 * d, 2 * d, 9 * d), "hi": (6 * d, 6 * d, 13 * d)},
            "young": 30000.0, "density": DENSITY, "velocity": (0.3, 0, -0.3),
        }],
        "rigids": [{
            "name": "box", "box": {"lo": (0, 0, 0), "hi": (8 * d, 8 * d, 8 * d)},
            "density": DENSITY, "friction": friction,
        }],
    }, device, threads)  # fmt: skip
    block = sim.arrays.phase == list(sim.phases).index("block")
    mass = DENSITY * d**3
    rigid = float((~block).sum()) * DENSITY * d**3
    first = sim.velocities[block].mean(0, dtype="f8")
    sim.run(0.04)
    gain = sim.velocities[block].mean(0, dtype="f8") - first
    given = rigid * np.asarray(sim.steer.body("box")["velocity"])
    gained = mass * block.sum() * gain
    drift = float(np.abs(given + gained).max() / np.linalg.norm(gained))
    ratio = float(abs(gain[0] / gain[2]))
    return [
        row("tissue meets a rigid box obliquely: momentum's drift, of what it gains", 0.0, drift,
            drift < 1e-4),
        row("the same: impulse along the face / across", friction, ratio,
            abs(ratio - friction) < 0.05 * friction),
    ]  # fmt: skip


def run(device: str, threads: int = 0, quick: bool = False) -> list[Row]:
    """All rows; `quick` leaves the slower half out."""
    rows = tilted_shape(device, threads) + belt(device, threads) + drag(device, threads)
    for floor in _FLOORS[:1] if quick else _FLOORS:
        rows += tilted_floor(device, threads, floor) + tilted_floor(device, threads, floor, 0.5)
    for experiment in (cut_halves, collision, against_rigid):
        rows += experiment(device, threads)
    return rows
