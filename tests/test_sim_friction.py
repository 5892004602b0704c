"""Coulomb friction of tissue: it stays or slides as it should, and instruments feel it; on every
backend."""

import numpy as np
import pytest
from globule.sim import blade
from globule.sim.tissue import BALL, HALF_SPACE, Tissue
from sim_helpers import check

from bench.tables import physics_friction as truths
from bench.tables.physics_tissue import DENSITY, SPACING, lattice

MASS = DENSITY * SPACING**3


@pytest.mark.few_backends
@pytest.mark.parametrize("experiment", ["belt", "drag", "collision", "against_rigid"])
def test_truths(backend, experiment):
    check(getattr(truths, experiment)(**backend))


ON_TISSUE = [pytest.param(f"{kind} tissue", "solid", marks=pytest.mark.slow) for kind in ("fixed", "elastic")]


@pytest.mark.few_backends
@pytest.mark.parametrize(("friction", "degrees"), [(0.2, 20.0), (0.5, 20.0), (0.3, 30.0)])
@pytest.mark.parametrize(("floor", "model"), [("wall", "solid"), ("wall", "bonds"), *ON_TISSUE])
def test_a_block_on_a_tilted_floor(backend, floor, model, friction, degrees):
    how = {"floor": floor, "model": model, "friction": friction, "degrees": degrees}
    check(truths.tilted_floor(**backend, **how))


@pytest.mark.few_backends
@pytest.mark.parametrize("model", ["solid", "bonds"])
@pytest.mark.parametrize("experiment", ["tilted_shape", "cut_halves"])
def test_truths_of_both_models(backend, experiment, model):
    check(getattr(truths, experiment)(**backend, model=model))


@pytest.mark.parametrize("model", ["solid", "bonds"])
def test_cut_faces_rub_and_keep_the_momentum(backend, model):
    """Halves of a free block meet while they slide: μ times the impulse that turns them round, or
    all of the sliding, is gone; the whole keeps its momentum, and loses energy."""
    x = lattice(6, 6, 6)
    edge = np.array([[-1.0, -1.0, 2.5 * SPACING], [-1.0, 1.0, 2.5 * SPACING]])
    upper, found = x[:, 2] > 2.5 * SPACING, []
    for friction in (0.0, 0.1, 0.4):
        tissue = Tissue(x, SPACING, 2500.0, DENSITY, model=model, friction=friction, **backend)
        tissue.cut(blade.sweep(edge, edge + [2.0, 0, 0]))
        tissue.velocities = np.where(upper[:, None], [0.02, 0.0, -0.04], [-0.02, 0.0, 0.04])
        for _ in range(20):
            tissue.advance(0.001)
        v = tissue.velocities.astype("f8")
        assert np.abs(v.sum(0)).max() < 1e-6 * np.abs(v).sum()
        apart = v[upper].mean(0) - v[~upper].mean(0)
        found.append((*apart, MASS * (v**2).sum() / 2 + tissue.elastic_energy))
    (free, _, _, first), (slowed, _, turned, second), (stopped, _, _, third) = found
    assert (free - slowed) / (turned + 0.08) == pytest.approx(0.1, rel=0.2)
    assert 0 <= stopped < 0.05 * free
    assert second < first
    assert third < first


def test_friction_drags_stops_and_has_the_larger_coefficient(backend):
    """The shape's or the tissue's, whichever is given."""
    x, speeds = lattice(4, 4, 2), []
    for own, others in ((0.0, 0.3), (0.3, 0.0), (0.3, 0.1), (0.0, 0.0)):
        tissue = Tissue(x, SPACING, 2500.0, DENSITY, friction=own, **backend)
        tissue.velocities = (0.1, 0.0, 0.0)
        tissue.instruments([], [(HALF_SPACE, (0, 0, 0), (0, 0, 1), 0.0, (0, 0, 0), others)])
        for _ in range(10):
            tissue.advance(0.001, (0, 0, -9.81))
        speeds.append(tissue.velocities[:, 0].mean(dtype="f8"))
    assert speeds[0] == speeds[1] == speeds[2] < 0.08
    assert abs(speeds[3] - 0.1) < 1e-6
    tissue = Tissue(lattice(4, 4, 2), SPACING, 2500.0, DENSITY, friction=100.0, damping=30.0, **backend)
    tissue.velocities = (0.05, 0.0, -0.01)
    tissue.instruments([], [(HALF_SPACE, (0, 0, 0), (0, 0, 1), 0.0, (0, 0, 0))])
    for _ in range(200):
        tissue.advance(0.002, (0, 0, -9.81))
        assert np.abs(tissue.velocities[:, 0].mean()) < 0.05
    assert np.abs(tissue.velocities).max() < 1e-3
    x = lattice(8, 8, 3)
    fixed, sums = x[:, 2] < 0.5 * SPACING, {}
    for friction in (0.0, 0.5):
        tissue = Tissue(x, SPACING, 2500.0, DENSITY, fixed=fixed, damping=20.0, **backend)
        force = np.zeros(3)
        for k in range(100):
            at = (0.004 + 0.02 * k * 0.001, 0.007, 0.0065)
            tissue.instruments([], [(BALL, at, at, 0.003, (0.02, 0, 0), friction)])
            tissue.advance(0.001)
            force += tissue.shape_force()[0] / 100
        sums[friction] = force
    assert sums[0.5][2] > 0
    assert (sums[0.0][0] - sums[0.5][0]) / sums[0.5][2] == pytest.approx(0.5, rel=0.25)
