"""Solids that relax or yield: against closed forms and a float64 reference, on every backend."""

import globule as gb
import numpy as np
import pytest
import solids
from globule.sim import materials
from globule.sim.bonds import build_bonds
from sim_helpers import assert_same_state, check, jittered, reloaded
from test_sim_solid import derivative

from bench.tables import physics_memory as truths
from bench.tables.physics_solid import solid
from bench.tables.physics_tissue import DENSITY, GRAVITY, MODULUS, SPACING, lattice

D = SPACING
MASS = DENSITY * D**3
TWO = truths.SERIES[1]


LONG = (pytest.param(name, marks=pytest.mark.slow) for name in ("creeping", "cycles", "decays", "turned"))


@pytest.mark.few_backends
@pytest.mark.parametrize("experiment", ["held", "stays", *LONG])
def test_truths(backend, experiment):
    check(getattr(truths, experiment)(**backend))


def deformed(rest, by=0.2):
    x = rest.astype("f8") - rest.mean(0)
    return (x @ (np.eye(3) + by * np.random.default_rng(4).normal(size=(3, 3)))).astype("f4")


def turn():
    q, _ = np.linalg.qr(np.random.default_rng(5).normal(size=(3, 3)))
    return q * np.sign(np.linalg.det(q))


def forces(tissue, positions, dt):
    tissue.positions = positions
    tissue.velocities = np.zeros_like(positions)
    tissue.advance(dt, substeps=1)
    return tissue.velocities.astype("f8") / dt * MASS


@pytest.mark.parametrize("poisson", [0.0, 0.45])
def test_forces_and_energy_are_the_references(backend, poisson):
    rest, dt = jittered((4, 5, 6)), 1e-5
    series, bonds = ((0.5, 2e-4), (0.3, 1e-3)), build_bonds(rest, D, MODULUS)
    material = materials.elasticity(MODULUS, poisson, len(rest), series)
    tissue = solid(rest, poisson, relaxation=series, **backend)
    past = np.broadcast_to(np.eye(3), (2, len(rest), 3, 3))
    for by in (0.1, 0.2, 0.15):
        x = deformed(rest, by)
        F = solids.gradients(x, rest, bonds, D)
        for _ in range(3):
            past, found = solids.relaxed(past, F, material, dt), forces(tissue, x, dt)
        energy, expected = solids.forces(x, rest, bonds, material, D, past)
        assert np.abs(found - expected).max() < 2e-5 * np.abs(expected).max()
        tissue.positions = x
        assert abs(tissue.elastic_energy / energy - 1) < 1e-4


def test_the_reference_with_a_past_is_its_energys_derivative():
    rest = jittered((4, 4, 4))
    x, bonds = deformed(rest, 0.1).astype("f8"), build_bonds(rest, D, MODULUS)
    material = materials.elasticity(MODULUS, 0.4, len(rest), TWO)
    F = solids.gradients(deformed(rest), rest, bonds, D)
    past = solids.relaxed(np.broadcast_to(np.eye(3), (2, 64, 3, 3)), F, material, 0.1)
    derivative(lambda y: solids.forces(y, rest, bonds, material, D, past), x, (0, 21, 63))


@pytest.mark.parametrize("how", [{"relaxation": ((0.5, 2e-4), (0.3, 1e-3))}, {"plastic": 0.02, "creep": 2000.0}])
def test_turned_bodies_have_turned_forces_and_no_less_memory(backend, how):
    rest, dt, q = jittered((4, 5, 6)), 1e-5, turn()
    one, other = (solid(rest, 0.4, **how, **backend) for _ in range(2))
    x = deformed(rest, 0.1)
    fresh = forces(one, x, dt)
    forces(other, x, dt)
    for _ in range(30):
        before, after = forces(one, x, dt), forces(other, x @ q.T, dt)
    assert np.abs(before - fresh).max() > 0.05 * np.abs(fresh).max()
    assert np.abs(after - before @ q.T).max() < 1e-4 * np.abs(before).max()


@pytest.mark.parametrize("how", [{"relaxation": ((0.6, 1e-3),)}, {"plastic": 0.02, "creep": 1000.0}])
def test_held_still_energy_only_falls(backend, how):
    rest = jittered((4, 5, 6))
    tissue = solid(rest, 0.3, fixed=np.ones(len(rest), bool), **how, **backend)
    for by in (0.2, 0.3, 0.1):
        tissue.positions = deformed(rest, by)
        energies = [tissue.elastic_energy]
        for _ in range(50):
            tissue.advance(1e-4, substeps=1)
            energies.append(tissue.elastic_energy)
        assert (np.diff(energies) < 1e-6 * energies[0]).all()
        assert energies[-1] < 0.98 * energies[0]


@pytest.mark.parametrize("time", [1e-6, 1e6])
def test_times_far_from_the_substep_are_stable(backend, time):
    """Below the substep: a solid of the lasting modulus.  Far above: one that does not relax."""
    x = lattice(4, 4, 8)
    v = np.random.default_rng(1).normal(0, 0.02, x.shape)
    relaxing = solid(x, 0.0, relaxation=((0.75, time),), **backend)
    relaxing.velocities = v
    energies = []
    for _ in range(50):
        relaxing.advance(0.01, GRAVITY)
        energies.append(relaxing.elastic_energy)
    assert np.isfinite(energies).all()
    assert max(energies) < 0.5 * MASS * (v**2).sum()
    x = lattice(4, 4, 4)
    sheared = (x @ np.array([[1, 0, 0], [0.2, 1, 0], [0, 0, 1]])).astype("f4")
    fixed, elastic = np.ones(len(x), bool), solid(x, 0.3, **backend)
    relaxing = solid(x, 0.3, fixed=fixed, relaxation=((0.75, time),), **backend)
    elastic.positions = relaxing.positions = sheared
    relaxing.advance(0.001)
    assert abs(relaxing.elastic_energy / elastic.elastic_energy - (0.25 if time < 1 else 1.0)) < 1e-4


def test_crushed_and_inverted_bodies_stay_finite(backend):
    x = lattice(5, 5, 5)
    tissue = solid(x, 0.3, damping=30.0, relaxation=TWO, plastic=0.1, creep=50.0, **backend)
    for squash in ((0.05, 1, 1), (1, -0.5, 1), (2.5, 0.2, 0.2), (0, 1, 1)):
        tissue.positions = x * np.float32(squash)
        tissue.velocities = np.zeros_like(x)
        for _ in range(10):
            tissue.advance(0.005)
        assert np.isfinite(tissue.positions).all()
        assert np.isfinite(tissue.elastic_energy)


def test_flow_is_that_of_principal_stretches(backend):
    """The oracle returns in principal logarithmic stretches."""
    rest, dt, steps = jittered((3, 3, 4)), 1e-5, 100
    bonds = build_bonds(rest, D, MODULUS)
    F = np.eye(3) + 0.2 * np.random.default_rng(4).normal(size=(3, 3))
    x = (rest @ (F / np.cbrt(np.linalg.det(F))).T).astype("f4")
    F = solids.gradients(x, rest, bonds, D)
    material = materials.elasticity(MODULUS, 0.4, len(rest))
    G = np.broadcast_to(np.eye(3), F.shape)
    for _ in range(steps):
        G = solids.yielded(G, F, material, 0.03, 1000.0, dt)
    tissue = solid(rest, 0.4, fixed=np.ones(len(rest), bool), plastic=0.03, creep=1000.0, **backend)
    tissue.positions = x
    full = tissue.elastic_energy
    tissue.advance(steps * dt, substeps=steps)
    flown, _ = solids.forces(x, rest, bonds, material, D, stays=G)
    assert flown < 0.8 * full
    assert abs(tissue.elastic_energy - flown) < 0.01 * (full - flown)
    assert np.allclose(np.linalg.det(G), 1)


def scene(**solid_keys):
    return {
        "spacing": 0.005,
        "domain": {"lo": [-0.05, -0.05, -0.05], "hi": [0.1, 0.1, 0.1]},
        "solids": [{
            "name": "block", "box": {"lo": [0, 0, 0], "hi": [0.03, 0.03, 0.05]}, "young": 5000,
            "model": "solid", "poisson": 0.4, "damping": 2.0,
            "fixed": [{"box": {"lo": [-0.01] * 3, "hi": [0.04, 0.04, 0.006]}}], **solid_keys,
        }],
    }  # fmt: skip


SERIES = [{"share": 0.3, "time": 0.01}, {"share": 0.2, "time": 0.1}]


@pytest.mark.parametrize("keys", [{"relaxation": SERIES}, {"plastic": 0.002, "creep": 50.0}])
def test_checkpoints_cuts_and_sutures_keep_the_memory(tmp_path, keys):
    sim = gb.Simulation(scene(**keys), device="cpu")
    for _ in range(4):
        sim.step()
    name = "tissue_terms" if "relaxation" in keys else "tissue_stays"
    before = sim.arrays.state()[name].copy()
    assert before.view("f4").any()
    first = sim.arrays.state()
    sim.tissue.cut(np.array([[[-1, 0.015, 0.03], [1, 0.015, 0.03], [0, 0.015, 1]]]))
    assert sim.tissue.suture([0.015, 0.015, 0.04], 0.005) > 0
    assert len(sim.tissue.ablate([0.03, 0.03, 0.05], 0.006)) > 0
    assert np.array_equal(sim.arrays.state()[name], before)
    sim.step()
    other = reloaded(sim, tmp_path)
    for _ in range(3):
        sim.step()
        other.step()
    assert_same_state(sim, other)
    assert sim.tissue.elastic_energy == other.tissue.elastic_energy > 0
    assert np.array_equal(first[name], before)


def test_bodies_with_and_without_a_past_and_their_states(backend):
    """Added one after the other, a body keeps what it remembers; elastic bodies have none."""
    sim = gb.Simulation(
        spacing=D, domain={"lo": [-0.5] * 3, "hi": [0.5] * 3}, gravity=(0, 0, 0),
        solids=[{"name": "a"}, {"name": "b"}, {"name": "c"}], **backend,
    )  # fmt: skip
    x = lattice(3, 3, 5)
    v, rows = 0.1 * (x - x.mean(0)) / D * [0, 0, 1], 32 * -(-len(x) // 32)

    def terms():
        state = sim.arrays.state()["tissue_terms"].view("f4")
        return state.reshape(-1, 8, 32 * -(-sim.tissue._core.n() // 32))

    sim.tissue.bond(sim.add(x, "a", v), 2500.0, model="solid")
    assert "tissue_terms" not in sim.arrays.state()
    at = x + np.float32([0.1, 0, 0])
    sim.tissue.bond(sim.add(at, "b", v), 2500.0, model="solid", relaxation=[(0.5, 0.01)])
    sim.step()
    before = terms()[0]
    assert not before[:, :rows].any()
    assert before[2:, rows : rows + len(x)].any()
    at = x + np.float32([0.2, 0, 0])
    sim.tissue.bond(sim.add(at, "c", v), 2500.0, model="solid", relaxation=TWO)
    after = terms()
    assert np.array_equal(after[0][:, : 2 * rows], before[:, : 2 * rows])
    assert (after[:, 0, 2 * rows] == np.float32([0.4, 0.3])).all()
    sim.step()
    sim = gb.Simulation(scene(), device="cpu")
    sim.step()
    assert not {"tissue_terms", "tissue_stays"} & set(sim.arrays.state())
    # Strain stays from the moment that the phase yields, and is forgotten by going back.
    first = sim.arrays.state()
    sim.phases["block"].plastic = 0.001
    sim.step()
    assert "tissue_stays" in sim.arrays.state()
    sim.arrays.set_state(first)
    assert not {"tissue_terms", "tissue_stays"} & set(sim.arrays.state())


@pytest.mark.parametrize(("series", "message"), [
    ([{"share": 0.5}], "relaxation"), ([{"share": 1.5, "time": 1}], "share: expected"),
    ([*SERIES, SERIES[0]], "relaxation: expected up to 2"),
])  # fmt: skip
def test_wrong_scenes_are_named(series, message):
    with pytest.raises(ValueError, match=message):
        gb.Simulation(scene(relaxation=series), device="cpu")


@pytest.mark.parametrize(("name", "change", "message"), [
    ("tissue_terms", lambda t: t[:-8], "tissue_terms: expected 1 to 2 terms"),
    ("tissue_terms", lambda t: t * np.float32(-1), "tissue_terms: expected shares from 0 to 1"),
    ("tissue_terms", lambda t: t + np.float32(0.4), "tissue_terms: expected shares|positive"),
    ("tissue_stays", lambda t: t[:-6], "tissue_stays: expected"),
    ("tissue_stays", lambda t: t - 1, "tissue_stays: expected positive metrics"),
    ("tissue_stays", lambda t: t + 4, "tissue_stays: expected positive metrics"),
    ("tissue_stays", lambda t: t * np.float32(np.nan), "tissue_stays: expected finite"),
    ("tissue_spared", lambda t: t[:-1], "tissue_spared: expected"),
    ("tissue_spared", lambda t: t - 1, "tissue_spared: expected densities"),
    ("tissue_spared", lambda t: t * np.float32(np.nan), "tissue_spared: expected finite"),
])  # fmt: skip
def test_states_that_cannot_be_are_refused(name, change, message):
    sim = gb.Simulation(scene(relaxation=SERIES, plastic=0.01), device="cpu")
    sim.step()
    state = sim.arrays.state()
    wrong = change(state[name].view("f4")).astype("f4")
    with pytest.raises(ValueError, match=message):
        sim.arrays.set_state({**state, name: wrong.view("u1")})
    sim.arrays.set_state(state)
    sim.step()
