"""What instruments feel of tissue: weights, moduli, momentum, moments; on every backend."""

import globule as gb
import numpy as np
import pytest
from globule.sim.tissue import BALL, CAPSULE, HALF_SPACE, Tissue

from bench.tables.physics_tissue import DENSITY, GRAVITY, MODULUS, SPACING, lattice, layers

D = SPACING
MASS = DENSITY * D**3
FAR = 10.0  # m: a ball of this radius has a flat side


def tissue_of(x, model, **how):
    ratio = {"poisson": 0.0} if model == "solid" else {}
    return Tissue(x, D, MODULUS, DENSITY, model=model, **ratio, **how)


def hold_above(tissue, height):
    """Grasp 0 holds what is above a height."""
    tissue.grasp((0, 0, FAR + height), FAR)


@pytest.mark.parametrize(("model", "share"), [("solid", 1.0), ("bonds", 0.83)])
def test_a_pulled_column_pulls_with_its_modulus(backend, model, share):
    """E A strain of the middle; a lattice of springs has 0.83 of its modulus (5 across: 0.86)."""
    x = lattice(4, 4, 12)
    z = layers(x)
    tissue = tissue_of(x, model, fixed=z == 0, damping=30.0, **backend)
    hold_above(tissue, 10.5 * D)
    stretch, seconds = 0.02 * 11 * D, 0.2
    tissue.instruments([((0, 0, stretch / seconds), (0, 0, 0), (0, 0, 0))])
    for _ in range(12):
        tissue.advance(seconds / 12)
    tissue.instruments([((0, 0, 0),) * 3])
    for _ in range(40):
        tissue.advance(1 / 60)
    force, _ = tissue.grasp_force()
    gauge = (z >= 4) & (z <= 7)
    strain = np.polyfit(x[gauge, 2], tissue.positions[gauge, 2], 1)[0] - 1
    assert 0.015 < strain < 0.025
    expected = -share * MODULUS * (4 * D) ** 2 * strain
    assert abs(force[2] / expected - 1) < (0.02 if model == "solid" else 0.05)
    assert np.abs(force[:2]).max() < 1e-3 * abs(expected)


@pytest.mark.parametrize("model", ["bonds", "solid"])
def test_a_floor_carries_what_stands_on_it_and_impulses_are_what_tissue_gains(backend, model):
    x = lattice(5, 5, 4)
    tissue = tissue_of(x, model, damping=20.0, **backend)
    tissue.instruments([], [(HALF_SPACE, (0, 0, 0), (0, 0, 1), 0.0, (0, 0, 0))])
    for _ in range(40):
        tissue.advance(1 / 60, GRAVITY)
    force, torque = tissue.shape_force()
    weight = len(x) * MASS * 9.81
    np.testing.assert_allclose(force, (0, 0, -weight), atol=0.02 * weight)
    arm = x.mean(0, dtype="f8")
    np.testing.assert_allclose(torque, np.cross(arm, (0, 0, -weight)), atol=0.02 * weight * arm.max())
    x = lattice(5, 5, 5)
    tissue = tissue_of(x, model, **backend)
    middle = tuple(float(v) for v in x.mean(0))
    low, aside = (middle[0], middle[1], -0.006), (-0.006, middle[1], middle[2])
    end = (aside[0], aside[1] + 0.01, aside[2])
    shapes = [(BALL, low, low, 0.005, (0, 0, 0.3)), (CAPSULE, aside, end, 0.004, (0.2, 0, 0))]
    given, dt = np.zeros(3), 0.002
    for k in range(12):
        way = [np.multiply(v, k * dt) for *_, v in shapes]
        moved = [(kind, a + w, b + w, r, v) for w, (kind, a, b, r, v) in zip(way, shapes, strict=True)]
        tissue.instruments([], moved)
        tissue.advance(dt)
        for number in (0, 1):
            given += tissue.shape_force(number)[0] * dt
    gained = MASS * tissue.velocities.sum(0, dtype="f8")
    assert np.linalg.norm(gained) > 1e-5
    np.testing.assert_allclose(given, -gained, atol=2e-4 * np.linalg.norm(gained))


def test_nothing_held_and_nothing_met_is_no_force(backend):
    tissue = tissue_of(lattice(3, 3, 3), "bonds", **backend)
    assert not np.any(tissue.grasp_force())
    tissue.instruments([], [(BALL, (1, 1, 1), (1, 1, 1), 0.01, (0, 0, 0))])
    tissue.advance(0.01)
    assert not np.any(tissue.shape_force())
    hold_above(tissue, -1.0)
    tissue.advance(0.01, (0, 0, -9.81))
    assert abs(tissue.grasp_force()[0][2] + 27 * MASS * 9.81) < 1e-9
    tissue.grasp((5, 5, 5), 0.0)
    tissue.advance(0.01)
    assert not np.any(tissue.grasp_force())


def scene_with_grasper(model):
    d = 0.004
    return {
        "spacing": d, "domain": {"lo": [-0.05] * 3, "hi": [0.05] * 3},
        "gravity": [0, 0, -9.81], "solver": {"max_dt": 0.004},
        "solids": [{
            "name": "block", "box": {"lo": [-0.008, -0.008, 0], "hi": [0.008, 0.008, 0.032]},
            "young": 20000.0, "damping": 20.0, "model": model,
        }],
        "instruments": [{
            "name": "grip", "kind": "grasper", "radius": 0.009,
            "keys": [{"time": 0.0, "position": [0, 0, 0.034]}],
        }],
    }  # fmt: skip


@pytest.mark.parametrize("model", ["bonds", "solid"])
def test_a_grasper_of_a_scene_feels_the_weight(backend, model):
    sim = gb.Simulation(scene_with_grasper(model), **backend)
    grip = sim.tools["grip"]
    assert not np.any(grip.force)
    forces = []
    while sim.time < 0.6:
        sim.step()
        if sim.time > 0.4:
            forces.append(grip.force)
    weight = len(sim) * sim.phases["block"].density * 0.004**3 * 9.81
    np.testing.assert_allclose(np.mean(forces, 0), (0, 0, -weight), atol=0.02 * weight)
    assert np.abs(grip.torque).max() < 0.02 * weight * 0.034
    force, _ = sim.tools.grasp_force(0)
    np.testing.assert_array_equal(force, grip.force)
    grip.on = False
    sim.step()
    assert not np.any(grip.force)


def test_a_grasper_that_turns_feels_the_torque(backend):
    """G J angle / length of a square column of Poisson's ratio 0 (Saint-Venant: J = 0.1406 a⁴); the
    ends of a short column are stiffer."""
    d, across, angle = 0.004, 0.02, 0.1
    scene = scene_with_grasper("solid") | {"gravity": [0, 0, 0], "solver": {"max_dt": 0.01}}
    scene["solids"][0] |= {
        "box": {"lo": [-across / 2, -across / 2, 0], "hi": [across / 2, across / 2, 9 * d]},
        "poisson": 0.0, "fixed": [{"box": {"lo": [-1, -1, -1], "hi": [1, 1, d]}}],
    }  # fmt: skip
    scene["instruments"][0] |= {
        "radius": 0.0198, "keys": [{"time": 0.0, "position": [0, 0, 0.05]}],
    }  # fmt: skip
    sim = gb.Simulation(scene, **backend)
    grip = sim.tools["grip"]
    for turn in angle * np.minimum(np.arange(1, 41) / 20, 1.0):
        pose = grip.pose.copy()
        pose[:2, :2] = [[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]]
        grip.move_to(pose)
        sim.step(0.01)
    assert 1.0 < -grip.torque[2] / angle / (20000.0 / 2 * 0.1406 * across**4 / (8 * d)) < 1.25
    twisted = grip.torque[2]
    assert np.abs(grip.force).max() < 0.02 * abs(twisted) / across
    for grip.on in [False] * 80 + [True] * 5:  # it rings, then rests
        sim.step(0.01)
    # It holds the untwisted column here, and not where it was closed first.
    assert abs(grip.torque[2]) < 0.01 * abs(twisted)
