"""Coulomb friction of tissue: it stays or slides as it should, and instruments feel it; on every
backend."""

from __future__ import annotations

import globule as gb
import numpy as np
import pytest
from globule.bench import physics_friction as truths
from globule.bench.physics_tissue import DENSITY, SPACING, lattice
from globule.sim import blade
from globule.sim.tissue import BALL, HALF_SPACE, Tissue
from sim_helpers import assert_same_state, check, reloaded

D = 0.004
MASS = DENSITY * SPACING**3


@pytest.mark.parametrize("model", ["solid", "bonds"])
def test_a_block_on_a_tilted_half_space(backend, model):
    check(truths.tilted_shape(**backend, model=model))


@pytest.mark.parametrize("experiment", ["belt", "drag", "collision", "against_rigid"])
def test_truths(backend, experiment):
    check(getattr(truths, experiment)(**backend))


@pytest.mark.parametrize(("friction", "degrees"), [(0.2, 20.0), (0.5, 20.0), (0.3, 30.0)])
@pytest.mark.parametrize(
    "floor", ["wall", "fixed tissue", pytest.param("elastic tissue", marks=pytest.mark.slow)]
)
def test_a_block_on_a_tilted_floor(backend, floor, friction, degrees):
    check(truths.tilted_floor(**backend, floor=floor, friction=friction, degrees=degrees))


@pytest.mark.parametrize("friction", [0.2, 0.5])
def test_springs_on_a_tilted_wall(backend, friction):
    check(truths.tilted_floor(**backend, friction=friction, model="bonds"))


@pytest.mark.parametrize("model", ["solid", "bonds"])
def test_halves_of_a_cut_block(backend, model):
    check(truths.cut_halves(**backend, model=model))


@pytest.mark.parametrize("model", ["solid", "bonds"])
def test_cut_faces_rub_and_keep_the_momentum(backend, model):
    """Halves of a free block meet while they slide: μ times the impulse that turns them round, or
    all of the sliding, is gone; the whole keeps its momentum, and loses energy."""
    x = lattice(6, 6, 6)
    edge = np.array([[-1.0, -1.0, 2.5 * SPACING], [-1.0, 1.0, 2.5 * SPACING]])
    upper = x[:, 2] > 2.5 * SPACING
    found = []
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


def test_a_contact_has_the_larger_coefficient(backend):
    """The shape's or the tissue's, whichever is given."""
    x = lattice(4, 4, 2)
    speeds = []
    for own, others in ((0.0, 0.3), (0.3, 0.0), (0.3, 0.1), (0.0, 0.0)):
        tissue = Tissue(x, SPACING, 2500.0, DENSITY, friction=own, **backend)
        tissue.velocities = (0.1, 0.0, 0.0)
        tissue.instruments([], [(HALF_SPACE, (0, 0, 0), (0, 0, 1), 0.0, (0, 0, 0), others)])
        for _ in range(10):
            tissue.advance(0.001, (0, 0, -9.81))
        speeds.append(tissue.velocities[:, 0].mean(dtype="f8"))
    assert speeds[0] == speeds[1] == speeds[2] < 0.08
    assert abs(speeds[3] - 0.1) < 1e-6


def test_any_friction_only_stops(backend):
    """Far more friction than it takes stops a body, and no more: a block swings on its feet."""
    tissue = Tissue(
        lattice(4, 4, 2), SPACING, 2500.0, DENSITY, friction=100.0, damping=30.0, **backend
    )
    tissue.velocities = (0.05, 0.0, -0.01)
    tissue.instruments([], [(HALF_SPACE, (0, 0, 0), (0, 0, 1), 0.0, (0, 0, 0))])
    for _ in range(200):
        tissue.advance(0.002, (0, 0, -9.81))
        assert np.abs(tissue.velocities[:, 0].mean()) < 0.05
    assert np.abs(tissue.velocities).max() < 1e-3


def test_a_ball_drags_what_it_touches(backend):
    """A ball that moves along a surface pulls it along, and feels the opposite."""
    x = lattice(8, 8, 3)
    fixed = x[:, 2] < 0.5 * SPACING
    sums = {}
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


def changing(threads):
    sim = gb.Simulation(truths.scene("elastic tissue", 20.0), device="cpu", threads=threads)
    for friction in (0.0, 0.4, 0.1):
        sim.phases["block"].friction = friction
        sim.run(0.01)
    return sim


def test_same_bits_whatever_the_threads_and_after_a_checkpoint(tmp_path):
    assert_same_state(changing(1), changing(2))
    sim = gb.Simulation(truths.scene("wall", 20.0, 0.3), device="cpu")
    sim.tools.set_pushers([(HALF_SPACE, (0, 0, 0.02), (0, 0, -1), 0.0, (0.1, 0, -0.1), 0.2)])
    sim.run(0.02)
    again = reloaded(sim, tmp_path)
    for s in (sim, again):
        s.run(0.02)
    np.testing.assert_array_equal(sim.positions, again.positions)


def test_a_checkpoint_from_before_friction_has_none(tmp_path):
    sim = gb.Simulation(truths.scene("wall", 20.0), device="cpu")
    sim.run(0.01)

    def before(_, facts):
        for phase in facts["by_hand"]["phases"]:
            del phase["friction"]

    old = reloaded(sim, tmp_path, before)
    assert old.phases["block"].friction == 0.0
    np.testing.assert_array_equal(sim.positions, old.positions)


@pytest.mark.parametrize(
    ("shape", "message"),
    [
        ((HALF_SPACE, (0, 0, 0), (0, 0, 1), 0.0, (0, 0, 0), -1.0), "friction"),
        ((HALF_SPACE, (0, 0, 0), (0, 0, 1), 0.0, (0, 0, 0), 0.1, 0.1), "or"),
    ],
)
def test_wrong_shapes_are_named(shape, message):
    sim = gb.Simulation(truths.scene("wall", 0.0), device="cpu")
    with pytest.raises(ValueError, match=rf"shapes\[0\].*{message}"):
        sim.tools.set_pushers([shape])


def test_wrong_coefficients_are_named():
    with pytest.raises(ValueError, match=r"solids\[0\].friction: expected a number from 0 to 100"):
        gb.Simulation(truths.scene("wall", 0.0) | {
            "solids": [{"name": "block", "box": {"lo": (0, 0, 0), "hi": (0.02,) * 3},
                        "friction": -0.1}],
        }, device="cpu")  # fmt: skip
    sim = gb.Simulation(truths.scene("wall", 0.0), device="cpu")
    with pytest.raises(ValueError, match="friction"):
        sim.phases["floor"].friction = "smooth"
