"""Sutures: cut tissue that is joined again is as if it had never been cut."""

import globule as gb
import numpy as np
import pytest

D = 0.004  # m
N, HIGH = 5, 10
CUT = 5 * D  # height of the plane that cuts: between two layers
MIDDLE = (N * D / 2, N * D / 2, CUT)


def column(backend, model="solid", **keys):
    side = N * D
    scene = {
        "spacing": D, "domain": {"lo": [-0.05] * 3, "hi": [0.07] * 3},
        "gravity": [0, 0, 0], "solver": {"max_dt": 0.01},
        "solids": [{
            "name": "column", "model": model, "young": 20000.0, "damping": 20.0,
            "box": {"lo": [0, 0, 0], "hi": [side, side, HIGH * D]},
            "fixed": [{"box": {"lo": [-1, -1, -1], "hi": [1, 1, D]}}],
        }],
        "instruments": [{
            "name": "grip", "kind": "grasper", "radius": 0.0198,
            "keys": [{"time": 0.0, "position": [side / 2, side / 2, HIGH * D + 0.014]},
                     {"time": 0.2, "position": [side / 2, side / 2, HIGH * D + 0.0145]}],
        }],
        **keys,
    }  # fmt: skip
    return gb.Simulation(scene, **backend)


def cut_across(sim):
    edge = np.array([[-1.0, -1.0, CUT], [1.0, -1.0, CUT]])
    return sim.tissue.cut((edge, edge + [0, 2.0, 0]))


@pytest.mark.few_backends
@pytest.mark.parametrize("model", ["bonds", "solid"])
def test_a_sutured_column_is_the_column(backend, model):
    whole, cut, joined = (column(backend, model) for _ in range(3))
    n_bonds = whole.tissue.n_bonds
    for sim in (cut, joined):
        assert (cut_across(sim), sim.tissue.n_pieces) == (5 * N**2 - 4 * N, 2)
    assert joined.tissue.suture(MIDDLE, 1.0) == 5 * N**2 - 4 * N
    assert (joined.tissue.n_bonds, joined.tissue.n_pieces) == (n_bonds, 1)
    for sim in (whole, cut, joined):
        sim.run(0.3)  # the grasper moves by 0.5 mm
    force, free, again = (sim.tools["grip"].force[2] for sim in (whole, cut, joined))
    assert force < -0.05
    assert abs(free) < 0.01 * abs(force)
    assert abs(again / force - 1) < 1e-3
    assert joined.tissue.suture(MIDDLE, 1.0) == 0


def test_a_stitch_joins_the_bonds_in_its_ball_unless_they_gape(backend):
    """Those with their middles in the ball, counted by hand; two stitches apart add up."""
    sim = column(backend)
    n_cut, x = cut_across(sim), sim.positions.astype("f8")
    i, j = np.triu_indices(len(x), 1)
    near = np.linalg.norm(x[i] - x[j], axis=1) < 1.5 * D
    across = near & ((x[i, 2] - CUT) * (x[j, 2] - CUT) < 0)
    assert across.sum() == n_cut
    middle, total = 0.5 * (x[i] + x[j])[across], 0
    for center, radius in (((D, D, CUT), 1.3 * D), ((4 * D, 4 * D, CUT), 1.3 * D)):
        expected = (np.linalg.norm(middle - center, axis=1) <= radius).sum()
        assert 0 < expected < n_cut / 3
        assert sim.tissue.suture(center, radius) == expected
        total += expected
    assert (sim.tissue.n_pieces, sim.tissue.n_bonds) == (1, near.sum() - n_cut + total)
    sim = column(backend)
    n_cut = cut_across(sim)
    sim.tools["grip"].on = False
    moved = sim.positions
    moved[moved[:, 2] > CUT, 2] += 2 * D
    sim.positions = moved
    assert sim.tissue.suture(MIDDLE, 1.0) == 0
    moved[moved[:, 2] > CUT + D, 2] -= 2 * D
    sim.positions = moved
    assert sim.tissue.suture(MIDDLE, 1.0) == n_cut


def bleeding(backend):
    d = 0.002
    course = [[-0.002, 3.5 * d, 3.5 * d], [0.016, 3.5 * d, 3.5 * d]]
    vein = {"name": "vein", "solid": "block", "fluid": "blood", "radius": 0.6 * d, "pressure": 2e5,
            "pool": 100 * d**3, "path": course}  # fmt: skip
    sim = gb.Simulation({
        "spacing": d, "domain": {"lo": [-0.03] * 3, "hi": [0.03] * 3}, "solver": {"max_dt": 0.002},
        "solids": [{
            "name": "block", "young": 2e4, "damping": 20.0, "density": 1000.0,
            "box": {"lo": [0, 0, 0], "hi": [7 * d, 7 * d, 4 * d]},
            "fixed": [{"box": {"lo": [-1, -1, -1], "hi": [1, 1, d]}}],
        }],
        "fluids": [{"name": "blood", "density": 1000.0}], "vessels": [vein],
    }, **backend)  # fmt: skip
    edge = np.array([[4 * d, -0.1, 2.5 * d], [4 * d, 0.1, 2.5 * d]])
    n_cut = sim.tissue.cut((edge, edge + [0, 0, 4 * d]))
    assert n_cut > 0
    sim.run(0.01)
    return sim, n_cut, np.array((4 * d, 3.5 * d, 3.5 * d))


@pytest.mark.parametrize("closed", ["suture", "cauterize", "nothing", "cauterize elsewhere"])
def test_what_stops_blood(backend, closed):
    sim, n_cut, wound = bleeding(backend)
    first = sim.tissue.pools[0]
    assert first < 99.5 * 0.002**3
    if closed == "suture":
        assert sim.tissue.suture(wound, 1.0) == n_cut
    elif closed == "cauterize":
        assert 0 < sim.tissue.cauterize(wound, 0.004) < sim.tissue.n_bonds
    elif closed == "cauterize elsewhere":
        assert sim.tissue.cauterize(wound + [0.006, 0, 0], 0.002) > 0
    sim.run(0.02)
    assert (sim.tissue.pools[0] == first) == (closed in ("suture", "cauterize"))


def test_what_was_cauterized_first_is_cut_without_blood(backend):
    sim, _, wound = bleeding(backend)
    assert sim.tissue.cauterize(wound, 1.0) > 0
    assert sim.tissue.cauterize(wound, 1.0) == 0
    pool = sim.tissue.pools[0]
    edge = np.array([[0.004, -0.1, 0.005], [0.004, 0.1, 0.005]])
    assert sim.tissue.cut((edge, edge + [0, 0, 0.008])) > 0
    sim.run(0.02)
    assert sim.tissue.pools[0] == pool
