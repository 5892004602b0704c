"""The same scene turned, moved, or in other steps has the same answer within stated bounds."""

import globule as gb
import numpy as np
import pytest

from bench.tables.physics_fluid import lattice

D, HIGH = 0.05, 0.5


def collapse(order=(0, 1, 2), shift=0.0, shorter=1.0) -> np.ndarray:
    """Mean place of a column of water that has fallen for 0.3 s: along the flow, across it, and its height.

    order: which axis of the world is the flow's, which is across, and which is up; shift: of all of it, in spacings.
    """
    place = np.empty(3, int)
    place[list(order)] = range(3)

    def world(v, by=shift * D):
        return (np.asarray(v, float)[..., place]) + by

    domain = {"lo": tuple(world((0, 0, 0))), "hi": tuple(world((1.5, 0.3, 1.0))), "walls": True}
    scene = {"spacing": D, "domain": domain, "gravity": tuple(world((0, 0, -9.81), 0.0)), "fluids": [{"name": "water"}]}
    sim = gb.Simulation(scene, device="cpu", threads=1)
    ids = sim.add(world(lattice((0, 0, 0), (HIGH, 0.3, HIGH), D)), "water")
    while sim.time < 0.3:
        sim.step(min(sim.dt / shorter, 0.3001 - sim.time))
    return (sim.positions[ids].astype(float) - shift * D).mean(0)[list(order)]


@pytest.fixture(scope="module")
def usual() -> np.ndarray:
    return collapse()


@pytest.mark.parametrize("order", [(1, 2, 0), (2, 0, 1), (1, 0, 2)])
def test_axes_are_alike(usual, order):
    np.testing.assert_allclose(collapse(order), usual, atol=0.02 * HIGH)


@pytest.mark.parametrize("shift", [-100.0, 3000.0])
def test_places_are_alike(usual, shift):
    np.testing.assert_allclose(collapse(shift=shift), usual, atol=0.02 * HIGH)


def test_steps_of_a_25th_fall_alike(usual):
    np.testing.assert_allclose(collapse(shorter=25.0), usual, atol=0.03 * HIGH)


def test_a_million_spacings_away_is_refused():
    with pytest.raises(ValueError, match="from the origin"):
        collapse(shift=1e6)
