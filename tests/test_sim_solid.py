"""Solids: forces against a float64 reference, moduli, beams, turns, cuts; on every backend."""

import itertools

import globule as gb
import numpy as np
import pytest
import solids
from globule.sim import materials
from globule.sim.bonds import build_bonds
from globule.sim.tissue import Tissue
from sim_helpers import check, jittered

from bench.tables import physics_solid as truths
from bench.tables.physics_tissue import DENSITY, GRAVITY, MODULUS, SPACING, lattice

D = SPACING
MASS = DENSITY * D**3


LONG = [
    ("column", {"poisson": 0.45}), ("squeeze", {}), ("column", {"poisson": 0.3}), ("cantilever", {"poisson": 0.3}),
    ("cantilever", {"poisson": 0.45}), ("turns", {}), ("cantilever", {"across": 9}), ("turned_column", {}),
    ("vibration", {}),
]  # fmt: skip


@pytest.mark.few_backends
@pytest.mark.parametrize(("experiment", "how"), [
    ("column", {"poisson": 0.0}), ("cantilever", {"poisson": 0.0}), ("steps", {}), ("cut_column", {}),
    ("momentum", {}), ("vibration", {"periods": 8}), ("torsion", {}), ("torsion", {"across": 5, "poisson": 0.45}),
    *(pytest.param(*case, marks=pytest.mark.slow) for case in LONG),
])  # fmt: skip
def test_truths(backend, experiment, how):
    check(getattr(truths, experiment)(**backend, **how))


def strained(rest, seed=1, by=0.05):
    x = rest.astype("f8") - rest.mean(0)
    turn, _ = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))
    turn *= np.sign(np.linalg.det(turn))
    x = x @ turn.T * [1.1, 0.95, 1.0] + 5 * x[:, :1] ** 2
    return (x + np.random.default_rng(2).uniform(-by, by, x.shape) * D).astype("f4")


@pytest.mark.parametrize("poisson", [0.0, 0.3, 0.49])
def test_forces_and_energy_are_the_references(backend, poisson):
    rest = jittered((5, 6, 7))
    x, bonds = strained(rest), build_bonds(rest, D, MODULUS)
    energy, force = solids.forces(x, rest, bonds, materials.elasticity(MODULUS, poisson, len(rest)), D)
    tissue = truths.solid(rest, poisson, **backend)
    tissue.positions = x
    assert abs(tissue.elastic_energy / energy - 1) < 1e-4
    dt = 1e-5
    tissue.advance(dt, substeps=1)
    assert np.abs(tissue.velocities.astype("f8") / dt * MASS - force).max() < 2e-5 * np.abs(force).max()


def derivative(reference, x, some):
    """The force of a reference, which is minus the slope of its energy at some particles."""
    _, force = reference(x)
    h = 1e-5 * D
    for i, axis in itertools.product(some, range(3)):
        ends = []
        for sign in (1, -1):
            y = x.copy()
            y[i, axis] += sign * h
            ends.append(reference(y)[0])
        assert abs((ends[1] - ends[0]) / (2 * h) - force[i, axis]) < 1e-6 * np.abs(force).max()
    return force


def test_the_reference_is_its_energys_derivative():
    rest = jittered((4, 4, 4))
    x, bonds = strained(rest).astype("f8"), build_bonds(rest, D, MODULUS)
    material = materials.elasticity(MODULUS, 0.4, len(rest))
    force = derivative(lambda y: solids.forces(y, rest, bonds, material, D), x, (0, 21, 40, 63))
    moment = np.cross(x, force).sum(0)
    assert np.abs(force.sum(0)).max() < 1e-12 * np.abs(force).sum()
    assert np.abs(moment).max() < 1e-10 * np.abs(np.cross(x, force)).sum()


@pytest.mark.parametrize("poisson", [0.0, 0.45])
def test_uniform_strain_has_the_energy_of_the_material(poisson):
    """Whatever the particles' arrangement: the corrected gradient is exact for linear motions."""
    rest = jittered((5, 6, 7), 0.2)
    F = np.array([[1.05, 0.1, 0], [0, 0.9, 0.02], [0.03, 0, 1.0]])
    material = materials.elasticity(MODULUS, poisson, len(rest))
    bonds = build_bonds(rest, D, MODULUS)
    energy, _ = solids.forces(rest.astype("f8") @ F.T, rest, bonds, material, D)
    mu, lam, J = material.shear[0], material.lame[0], np.linalg.det(F)
    density = mu / 2 * ((F**2).sum() - 3) - mu * (J - 1) + (lam + mu) / 2 * (J - 1) ** 2
    assert abs(energy / (density * len(rest) * D**3) - 1) < 1e-10


def test_what_cannot_have_a_gradient_holds_by_springs(backend):
    """A sheet, a chain and a lone particle: their neighbors do not span space."""
    sheet, chain = lattice(6, 6, 1), lattice(1, 1, 6) + np.float32(0.1)
    x = np.concatenate([sheet, chain, np.full((1, 3), 0.2, np.float32)])
    tissue = truths.solid(x, **backend)
    assert tissue.elastic_energy < 1e-15
    tissue.velocities = np.random.default_rng(0).normal(0, 0.02, x.shape)
    for _ in range(30):
        tissue.advance(1 / 60)
    y = tissue.positions
    assert np.isfinite(y).all()
    stretch = np.linalg.norm(y[36:41] - y[37:42], axis=1) / D
    assert 0.5 < stretch.min() <= stretch.max() < 1.6


def dragged_about(seed, n, reach, **how):
    """Tissue that is cut and dragged about by n steps, and how many substeps each took."""
    rng, x = np.random.default_rng(seed), lattice(8, 8, 8)
    tissue = truths.solid(x, 0.45, fixed=x[:, 2] < D / 2, damping=2.0, **how)
    substeps = []
    for k in range(n):
        p, q = rng.uniform(-1, 8, (2, 3)) * D
        w, c, u = rng.normal(size=3) * 2 * D, rng.uniform(0, 8, 3) * D, rng.normal(0, reach, 3)
        if k % 5 == 0:
            tissue.cut(np.array([[p, q, p + w]]))
        if k % 7 == 0:
            tissue.grasp(c, 2 * D, 0)
            tissue.instruments([(u, (0, 0, 0), (0, 0, 0))])
        substeps.append(tissue.advance(1 / 60, GRAVITY))
        tissue.tear(1 / 60)
        assert np.linalg.norm(tissue.velocities, axis=1).max() < 20  # and no NaN
    return substeps


@pytest.mark.slow
@pytest.mark.parametrize("seed", [9, 10])
def test_strained_tissue_gets_shorter_substeps(backend, seed):
    """Dragged about between cuts; with the substeps of rest these two explode."""
    substeps = dragged_about(seed, 100, 0.02, tear=0.7, **backend)
    assert min(substeps) <= 70 < 90 < max(substeps)


@pytest.mark.parametrize(("seed", "how"), [
    (8, {"plastic": 0.1, "creep": 5.0}),
    pytest.param(17, {}, marks=pytest.mark.slow), pytest.param(19, {}, marks=pytest.mark.slow),
])  # fmt: skip
def test_tissue_torn_apart_gets_shorter_substeps(backend, seed, how):
    """Pulled apart at several m/s: with substeps for the strain at hand alone, these three ended
    in NaN after 16 to 26 steps."""
    substeps = dragged_about(seed, 30, 0.05, tear=1.0, **how, **backend)
    assert min(substeps) < max(substeps)


@pytest.mark.parametrize(("change", "message"), [
    ({"model": "jelly"}, "model: expected bonds or solid"), ({"poisson": 0.5}, "poisson: expected 0 to 0.49"),
    ({"poisson": -0.1}, "poisson: expected 0 to 0.49"), ({"young": 0.0}, "young"),
    ({"young": np.nan}, "young"), ({"positions": np.zeros((3, 3))}, "positions: expected particles about"),
    ({"relaxation": [(0.5, 0.1)] * 3}, "relaxation: expected up to 2"),
    ({"relaxation": [(0.5, 0.1), (0.5, 1.0)]}, "shares of at most 0.999 .* got 1"),
    ({"relaxation": [(0.0, 0.1)]}, "shares between 0 and 1, got 0"),
    ({"relaxation": [(0.5, 0.0)]}, "times from 1e-06 to .* got 0"),
    ({"relaxation": [(0.5, np.nan)]}, "times .* got nan"),
    ({"relaxation": [0.5, 0.1]}, "relaxation: expected up to 2"),
    ({"relaxation": [(0.5, 0.1)], "model": "bonds"}, 'relaxation: .* model = "solid"'),
])  # fmt: skip
def test_wrong_solids_are_named(change, message):
    good = {"positions": lattice(2, 2, 2), "spacing": D, "young": 2500.0, "model": "solid"}
    with pytest.raises(ValueError, match=message):
        Tissue(**{**good, **change})


def test_solids_do_not_iterate():
    with pytest.raises(ValueError, match="iterations"):
        truths.solid(lattice(2, 2, 2), device="cpu").advance(0.01, iterations=2)


@pytest.mark.parametrize(("ids", "how", "message"), [
    ([*range(27), 3], {}, "ids: expected each particle once, got 1 again"),
    ([0, 1, 27], {}, "ids: expected particles of tissue or of boundaries, got 1 of others"),
    (range(27), {"young": 1e20}, "young: expected at most 100,000 substeps in a step of 0.005"),
    (range(27), {"young": 1e20, "model": "bonds"}, "young: expected at most 100,000 substeps"),
    (range(27), {"fixed": [True, False]}, r"fixed: expected \(27,\) bool, got \(2,\)"),
    (range(27), {"poisson": "a"}, r"poisson: expected one number or \(27,\), got 'a'"),
    (range(27), {"poisson": [0.3] * 26 + [0.6]}, "poisson: expected 0 to 0.49, got 0.6"),
    (range(27), {"poisson": 0.3, "model": "bonds"}, 'poisson: expected model "solid"'),
])  # fmt: skip
def test_bodies_made_by_hand_name_what_is_wrong(ids, how, message):
    sim = gb.Simulation(
        spacing=D, domain={"lo": [-1, -1, -1], "hi": [1, 1, 1]}, device="cpu",
        solids=[{"name": "a"}], fluids=[{"name": "water"}],
    )  # fmt: skip
    x = lattice(3, 3, 3)
    sim.add(x, "a")
    sim.add(x + np.float32(0.1), "water")
    with pytest.raises(ValueError, match=message):
        sim.tissue.bond(list(ids), **how)
    assert sim.tissue.n_bonds == 0
    sim.tissue.bond(range(27))
    assert sim.tissue.n_bonds > 0
    with pytest.raises(ValueError, match="one model"):
        sim.tissue.bond(sim.add(x - np.float32(0.1), "a"), model="bonds")


@pytest.mark.parametrize("jump", [2, 12, 50])
def test_a_grasp_that_jumps_throws_nothing_away(backend, jump):
    d = 0.004
    sim = gb.Simulation({
        "spacing": d, "domain": {"lo": [-0.3] * 3, "hi": [0.4] * 3},
        "solids": [{"name": "a", "young": 5000, "box": {"lo": [0] * 3, "hi": [0.04, 0.02, 0.02]},
                    "fixed": [{"box": {"lo": [0] * 3, "hi": [d, 0.02, 0.02]}}]}],
        "instruments": [{"name": "grip", "kind": "grasper", "radius": 0.012,
                         "keys": [{"time": 0, "position": [0.04, 0.01, 0.01]}]}],
    }, **backend)  # fmt: skip
    sim.run(0.03)
    sim.tools["grip"].move_to((0.04 + jump * d, 0.01, 0.01))
    speed = jump * d / sim.step().dt
    for _ in range(10):
        assert np.abs(sim.velocities).max() < 2.5 * speed + 0.5
        sim.step()


@pytest.mark.parametrize("speed", [pytest.param(10.0, marks=pytest.mark.slow), 50.0])
def test_steps_are_as_short_as_fast_instruments_and_boundaries_need(speed):
    """What is pulled 25 spacings in a step leaves it with 1e14 m/s."""
    away = [{"time": 0.03, "position": [0.04, 0.01, 0.01]},
            {"time": 0.03 + 0.1 / speed, "position": [0.14, 0.01, 0.01]}]  # fmt: skip
    scene = {
        "spacing": 0.004, "domain": {"lo": [-0.1] * 3, "hi": [0.2] * 3},
        "solids": [{
            "name": "block", "box": {"lo": [0, 0, 0], "hi": [0.04, 0.02, 0.02]}, "tear": 0.5,
            "fixed": [{"box": {"lo": [0, 0, 0], "hi": [0.004, 0.02, 0.02]}}],
        }],
    }  # fmt: skip
    pulled = {"instruments": [{"name": "grip", "kind": "grasper", "radius": 0.012,
                               "keys": [{**away[0], "time": 0}, *away]}]}  # fmt: skip
    struck = {"boundaries": [{"name": "plate", "box": {"lo": [-0.05, -0.05, -0.02],
                                                       "hi": [0.07, 0.07, -0.001]},
                              "keys": [{"time": 0}, {"time": 0.1 / speed,
                                                     "position": [0, 0, 0.1]}]}]}  # fmt: skip
    for more in (pulled, struck):
        sim, fastest = gb.Simulation({**scene, **more}, device="cpu"), []
        sim.run(0.06, stop=lambda s=sim, f=fastest: f.append(np.abs(s.velocities).max()))
        assert max(fastest) < 4 * speed
        assert np.isfinite(sim.positions).all()


def in_a_simulation(backend, gravity, **solver):
    return gb.Simulation(
        {
            "spacing": 0.004, "domain": {"lo": [-0.1] * 3, "hi": [0.2] * 3}, "gravity": gravity,
            "solver": {"max_dt": 0.002, **solver},
            "solids": [{"name": "tissue", "density": 1000.0, "damping": 0.0}],
        },
        **backend,
    )  # fmt: skip


def test_a_bent_beam_does_not_tremble_and_fixed_tissue_plays_no_part(backend):
    """The density solve leaves a solid's own pairs to its stress."""
    sim = in_a_simulation(backend, (9.81, 0, 0))
    sim.phases["tissue"].damping = 20.0
    d = sim.settings.spacing
    x = lattice(6, 6, 24, d)
    z = np.rint(x[:, 2] / d).astype(int)
    sim.tissue.bond(sim.add(x, "tissue"), 2e5, z <= 1, model="solid")
    while sim.time < 0.06:
        report = sim.step()
    bent = (sim.positions - x)[z == z.max(), 0].mean()
    assert 0.009 < bent < 0.013  # m
    v = sim.velocities
    off = [(v[z == k] - v[z == k].mean(0))[:, :2] for k in range(2, z.max() + 1)]
    assert np.sqrt((np.concatenate(off) ** 2).mean(0)).max() < 0.004  # m/s
    assert report.compression < 1e-3
    found = []
    for clamped in (2, 8):
        x = lattice(4, 4, 12 + clamped) - [0, 0, clamped * SPACING]
        tissue = truths.solid(x, fixed=x[:, 2] < -0.5 * SPACING, **backend)
        for _ in range(10):
            tissue.advance(1 / 60, (2.0, 0.0, 0.0))
        free = x[:, 2] > -0.5 * SPACING
        found.append(tissue.positions[free] - x[free])
    assert np.abs(found[0]).max() > SPACING
    np.testing.assert_allclose(found[0], found[1], atol=1e-3 * SPACING)
