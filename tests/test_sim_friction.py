"""Coulomb friction of tissue: it stays or slides as it should, and instruments feel it; on every
backend."""

import globule as gb
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
@pytest.mark.parametrize("floor", ["wall", "shape"])
@pytest.mark.parametrize("friction", [0.1, 0.2, 0.3, 0.5, 0.7, 0.9, 1.2])
def test_the_limit_of_coulomb(backend, friction, floor):
    """An elastic block without damping, on a slope that is suddenly there: a degree below the limit
    it comes to rest, a degree above it slides as Coulomb has it."""
    for off in (-1.0, 1.0):
        slope = np.arctan(friction) + np.radians(off)
        gravity = 9.81 * np.array([np.sin(slope), 0.0, -np.cos(slope)])
        way, speeds = _slides(backend, floor, friction, gravity)
        if off < 0:
            assert way < 0.5 * SPACING
            assert abs(speeds[-1]) < 1e-3
        else:
            expected = gravity[0] + friction * gravity[2]
            assert (speeds[-1] - speeds[0]) / 0.1 == pytest.approx(expected, rel=0.15)


def _slides(backend, floor, friction, gravity):
    """The way of a block in 0.3 s, and its speeds after 0.2 and 0.3 s."""
    d, speeds = SPACING, []
    if floor == "wall":
        solid = {"name": "block", "box": {"lo": (0, 0, 0), "hi": (12 * d, 8 * d, 4 * d)},
                 "young": 50000.0, "poisson": 0.3}  # fmt: skip
        sim = gb.Simulation({
            "spacing": d, "gravity": gravity.tolist(),
            "domain": {"lo": (-0.05, -0.05, -0.02), "hi": (0.15, 0.1, 0.1)},
            "boundaries": [{"name": "floor", "friction": friction,
                            "box": {"lo": (-0.05, -0.05, -0.012), "hi": (0.15, 0.1, 0)}}],
            "solids": [solid],
        }, **backend)  # fmt: skip
        mine = sim.arrays.phase == list(sim.phases).index("block")
        first = sim.positions[mine]
        for t in (0.2, 0.3):
            sim.run_to(t)
            speeds.append(float(sim.velocities[mine, 0].mean(dtype="f8")))
        return float((sim.positions[mine] - first)[:, 0].mean(dtype="f8")), speeds
    x = lattice(12, 8, 4)
    tissue = Tissue(x, d, 50000.0, DENSITY, poisson=0.3, **backend)
    at = (0, 0, x[:, 2].min())
    tissue.instruments([], [(HALF_SPACE, at, (0, 0, 1), 0.0, (0, 0, 0), friction)])
    for n in (200, 100):
        for _ in range(n):
            tissue.advance(0.001, gravity)
        speeds.append(float(tissue.velocities[:, 0].mean(dtype="f8")))
    return float((tissue.positions - x)[:, 0].mean(dtype="f8")), speeds


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
