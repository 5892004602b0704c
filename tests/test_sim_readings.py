"""Forces that boundaries and bodies read, and boundaries that move or turn steadily."""

import globule as gb
import numpy as np
import pytest

from bench.tables.physics_fluid import lattice

D = 0.05


def tank(backend, **keys) -> gb.Simulation:
    domain = {"lo": (0, 0, 0), "hi": (0.4, 0.4, 0.8), "walls": True, "open": ["+z"]}
    water = {"name": "water", "viscosity": 1.0}
    return gb.Simulation({"spacing": D, "domain": domain, "fluids": [water]} | keys, **backend)


@pytest.mark.few_backends
def test_walls_read_the_weight_of_water(backend):
    sim = tank(backend)
    ids = sim.add(lattice((0, 0, 0), (0.4, 0.4, 0.4), D), "water")
    assert sim.record.force("walls")[0].tolist() == [0, 0, 0]  # before the first step
    sim.run(1.0)
    felt, moment = [], []
    for _ in range(20):
        sim.step()
        force, about = sim.record.force("walls", (0.2, 0.2, 0))
        felt.append(force)
        moment.append(about)
    weight = len(ids) * 1000 * D**3 * 9.81
    np.testing.assert_allclose(np.mean(felt, 0), (0, 0, -weight), atol=0.03 * weight)
    assert np.abs(np.mean(moment, 0)).max() < 0.03 * weight * 0.2
    there = sim.record.force("walls", (1.2, 0.2, 0))[1]
    here = sim.record.force("walls", (0.2, 0.2, 0))[1]
    assert there[1] - here[1] == pytest.approx(sim.record.force("walls")[0][2], rel=1e-4)


@pytest.mark.few_backends
def test_a_floating_body_reads_its_weight(backend):
    box = {"name": "box", "density": 500.0, "box": {"lo": (0.1, 0.1, 0.3), "hi": (0.3, 0.3, 0.5)}}
    sim = tank(backend, rigids=[box])
    sim.add(lattice((0, 0, 0), (0.4, 0.4, 0.3), D), "water")
    sim.run(1.5)
    felt = []
    for _ in range(60):
        sim.step()
        felt.append(sim.record.force("box")[0][2])
    assert np.mean(felt) == pytest.approx(500 * 0.2**3 * 9.81, rel=0.1)


def test_what_reads_no_force_is_named():
    sim = tank({"device": "cpu"})
    with pytest.raises(ValueError, match="expected a boundary or a rigid body, got 'water'"):
        sim.record.force("water")
    with pytest.raises(KeyError, match="expected one of"):
        sim.record.force("wall")
    with pytest.raises(ValueError, match="about"):
        sim.record.force("walls", (0, 0))


def test_a_point_to_turn_about_without_a_spin():
    with pytest.raises(ValueError, match="about: expected a spin"):
        turning(about=(0.1, 0, 0))


def turning(**how) -> gb.Simulation:
    domain = {"lo": (-1, -1, -1), "hi": (1, 1, 1)}
    blade = {"name": "blade", "box": {"lo": (0.2, -0.1, -0.1), "hi": (0.6, 0.1, 0.1)}} | how
    return gb.Simulation({"spacing": D, "domain": domain, "gravity": (0, 0, 0), "boundaries": [blade]}, device="cpu")


@pytest.mark.parametrize("rate", [3.0, -50.0])
def test_a_boundary_turns_about_a_point_that_moves(rate):
    """More than half a turn between two looks, too."""
    about, velocity = np.array([0.1, 0.0, 0.0]), np.array([0.05, 0.0, 0.02])
    sim = turning(spin=(0, 0, rate), about=tuple(about), velocity=tuple(velocity))
    first = sim.positions.astype(float)
    sim.run(1.3)
    angle = rate * sim.time
    turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
    expected = about + velocity * sim.time + (first - about) @ turn.T
    np.testing.assert_allclose(sim.positions, expected, atol=1e-4)


def test_a_boundary_moves_by_keys_or_steadily():
    with pytest.raises(ValueError, match="expected keys, or velocity and spin, got both"):
        turning(spin=(0, 0, 1), keys=[{"time": 0.0, "position": (0, 0, 0)}])


def test_a_steady_plate_is_a_plate_with_keys():
    found = []
    for how in ({"velocity": (0.2, 0, 0)}, {"keys": [{"time": 0}, {"time": 10, "position": (2.0, 0, 0)}]}):
        sim = turning(**how)
        sim.run(0.5)
        found.append(sim.positions)
    np.testing.assert_allclose(found[0], found[1], atol=1e-6)
