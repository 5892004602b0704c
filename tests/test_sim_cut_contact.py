"""What cuts have parted meets like two bodies, whatever the distance at rest; on every backend."""

import globule as gb
import numpy as np
import pytest
from globule.sim import blade
from globule.sim.bonds import build_bonds
from sim_helpers import assert_same_state, check, jittered, reloaded

from bench.tables import physics_cuts as truths

D = 0.004
DOWN = 9.81 * np.array([np.sin(0.35), 0.0, -np.cos(0.35)])


@pytest.mark.few_backends
@pytest.mark.parametrize("experiment", ["slide", "fresh", "free_halves"])
def test_truths(backend, experiment):
    check(getattr(truths, experiment)(**backend))


def uneven(backend):
    x, domain = jittered((7, 6, 6), 0.15, 5, D), {"lo": [-0.05] * 3, "hi": [0.08] * 3}
    sim = gb.Simulation(spacing=D, domain=domain, gravity=(0, 0, 0), solids=[{"name": "tissue"}], **backend)
    sim.tissue.bond(sim.add(x, "tissue"), 30000.0)
    return sim, x


def listed(sim):
    """(N, N) whether the density solve sees a pair."""
    rows, offsets, other = sim.arrays.neighbors()
    found = np.zeros((len(sim), len(sim)), bool)
    found[np.repeat(rows, np.diff(offsets).astype(int)), other] = True
    return found


def distances(x):
    return np.linalg.norm(x[:, None].astype("f8") - x[None], axis=2)


def test_the_density_solve_sees_exactly_the_pairs_that_a_cut_parted(backend):
    """A cut half through: a pair that one or two whole bonds still join, round the end of the cut,
    stays out. The body is shrunk: then pairs that were up to 2.2 spacings apart are in reach."""
    sim, x = uneven(backend)
    sim.positions = 0.9 * x
    assert not listed(sim).any()
    sim.positions = x
    height, end = 2.5 * D, 3.6 * D
    edge = np.array([[-1.0, -1.0, height], [-1.0, 1.0, height]])
    n_cut = sim.tissue.cut(blade.sweep(edge, edge + [1.0 + end, 0, 0]))
    sim.positions = 0.9 * x
    bonds, ever = build_bonds(x, D, 30000.0), np.zeros((len(x), len(x)), int)
    ever[bonds.first_ends, bonds.other] = 1
    z = x[:, 2].astype("f8") - height
    with np.errstate(divide="ignore", invalid="ignore"):
        crossing = x[:, None, 0] + (x[None, :, 0] - x[:, None, 0]) * (z[:, None] / (z[:, None] - z))
    crosses = (z[:, None] * z < 0) & (crossing < end)
    whole = ever * ~crosses
    assert (ever - whole).sum() == 2 * n_cut > 0
    near = (distances(0.9 * x) < 2 * D) & (distances(x) < 2.6 * D)
    parted = near & (ever + ever @ ever > 0) & (whole + whole @ whole == 0)
    assert np.array_equal(listed(sim), parted)
    assert (parted & ~crosses).sum() < 0.1 * parted.sum()


@pytest.mark.parametrize("parted_by", ["ablation", "tears"])
def test_halves_that_no_knife_parted_do_not_pass_through_each_other(backend, parted_by):
    """A layer is taken away, or tears; the halves then meet at 0.2 m/s, half a spacing beside."""
    sim = truths.block(backend["device"], backend.get("threads", 0), (5, 5, 9), (0, 0, 0))
    x = sim.positions
    middle = np.abs(x[:, 2] - 4.5 * D) < 0.1 * D
    upper, lower = x[:, 2] > 4.6 * D, x[:, 2] < 4.4 * D
    if parted_by == "ablation":
        for place in x[middle]:
            sim.tissue.ablate(place, 0.1 * D)
        upper, lower = upper[~middle], lower[~middle]
    else:
        sim.phases["block"].tear = 0.5
        lower |= middle
        moved = sim.positions
        moved[upper, 2] += 1.5 * D
        sim.positions = moved
        sim.step(1e-5)
        sim.phases["block"].tear = 0.0
    assert sim.tissue.n_pieces == 2
    moved = sim.positions
    moved[upper] += [0.5 * D, 0.5 * D, 0.0]
    sim.positions = moved
    sim.velocities = np.where(upper, -0.1, 0.1)[:, None] * np.array([0, 0, 1.0])
    first, nearest = sim.positions, np.inf
    for _ in range(80):
        sim.step()
        y = sim.positions
        nearest = min(nearest, y[upper, 2].mean() - y[lower, 2].mean())
    gap = nearest - (first[upper, 2].mean() - first[lower, 2].mean())
    assert first[upper, 2].min() - first[lower, 2].max() + gap > 0.6 * D
    assert sim.velocities[upper, 2].mean() > 0 > sim.velocities[lower, 2].mean()
    assert np.linalg.norm(sim.velocities, axis=1).max() < 0.3


def sliding(threads):
    sim = truths.block("cpu", threads, (8, 6, 6), DOWN, fixed=D, friction=0.1)
    truths.cut_at(sim, 3 * D)
    sim.run(0.05)
    return sim


def test_same_bits_whatever_the_threads_and_after_a_checkpoint(tmp_path):
    one, two = sliding(1), sliding(2)
    spared = one.arrays.state()["tissue_spared"].view("f4")
    assert (spared >= 0).any()
    assert (spared == -1).any()
    again = reloaded(one, tmp_path)
    for sim in (one, two, again):
        sim.run(0.03)
    assert_same_state(one, two)
    assert_same_state(one, again)


@pytest.mark.parametrize("name", ["tissue_spared", "tissue_body"])
def test_a_checkpoint_without_an_array_is_refused(name, tmp_path):
    with pytest.raises(ValueError, match=f"state.npz: .*'{name}' is missing"):
        reloaded(sliding(1), tmp_path, lambda arrays, facts: arrays.pop(name))


def body_of(sim):
    return sim.arrays.state()["tissue_body"].view("u4")


def test_bodies_stay_what_they_were_after_a_suture_and_a_new_body(backend):
    """Two blocks touch, the lower one is cut and sutured: all pairs between the blocks stay."""
    sim, lower = uneven(backend)
    upper = lower + np.array([0, 0, 6.2 * D], "f4")
    sim.tissue.bond(sim.add(upper, "tissue"), 30000.0)
    bodies, n = np.unique(body_of(sim)[body_of(sim) < len(body_of(sim))]), len(lower)
    between = listed(sim)[:n, n:]
    assert between.any()
    truths.cut_at(sim, 3 * D)
    assert listed(sim)[:n, :n].any()
    assert sim.tissue.suture((0, 0, 3 * D), 1.0) > 0
    assert not listed(sim)[:n, :n].any()
    np.testing.assert_array_equal(listed(sim)[:n, n:], between)
    assert len(np.unique(body_of(sim))) >= len(bodies) > 1
    sim, x = uneven(backend)
    truths.cut_at(sim, 3 * D)
    before = body_of(sim).copy()
    sim.tissue.bond(sim.add(x + np.array([0, 0, 0.04], "f4"), "tissue"), 30000.0)
    after = body_of(sim)
    np.testing.assert_array_equal(after[: len(before)], before)
    assert len(np.unique(after)) > len(np.unique(before))
