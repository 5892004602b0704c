"""Tissue in a simulation: density solve, boundaries, removal, vessels, checkpoints."""

import globule as gb
import numpy as np
import pytest
from globule.sim.bonds import build_bonds
from globule.sim.operate import NOBODY
from sim_helpers import tissue_and_blood, vessel

from bench.tables import physics_tissue as truths

D = 0.004


def make(backend, positions, young=2500.0, fixed=None, model="solid", gravity=(0, 0, -9.81), **tissue):
    return tissue_and_blood(backend, positions, young, fixed, model, tissue, gravity=gravity)


def block(nx, ny, nz):
    return truths.lattice(nx, ny, nz, D)


def stroke(height, start, end):
    edge = np.array([[0, -0.5, height * D], [0, 0.5, height * D]])
    return edge + [start * D, 0, 0], edge + [end * D, 0, 0]


def test_hanging_tissue_stays_and_its_cut_piece_falls(backend):
    x = block(4, 4, 12)
    top = x[:, 2] > 10.5 * D
    sim = make(backend, x, 2e4, fixed=top, damping=20.0)
    assert sim.tissue.n_pieces == 1
    for _ in range(25):
        sim.step(0.004)
    assert np.array_equal(sim.positions[top], x[top])
    assert np.abs(sim.positions - x).max() < 0.3 * D
    assert (sim.tissue.cut(stroke(5.5, -3, 8)), sim.tissue.n_pieces) == (5 * 16 - 4 * 4, 2)
    sim.phases["tissue"].damping = 0.0
    lower = sim.tissue.piece == 0
    assert lower.sum() == 4 * 4 * 6
    assert (sim.tissue.piece[~lower] == 6).all()
    at, v = sim.positions[lower].mean(0), sim.velocities[lower].mean(0)
    for _ in range(20):
        sim.step(0.004)
    t = 0.08
    fallen = at + v * t + 0.5 * np.array([0, 0, -9.81]) * t * t - sim.positions[lower].mean(0)
    assert np.abs(fallen).max() < 0.01 * 0.5 * 9.81 * t * t
    assert np.abs(sim.positions[~lower] - x[~lower]).max() < 3 * D


def test_grasps_and_boundaries_move_tissue(backend):
    x = block(5, 5, 5)
    sim = make(backend, x, fixed=x[:, 2] < 0.5 * D, gravity=(0, 0, 0), damping=10.0)
    assert sim.tools.grasp(x[-1] + 1.0, 1.2 * D, 3) == 0
    assert sim.tools.grasp(x[0], 1.2 * D, 2) == 1  # its neighbors at the bottom are fixed
    sim.tools.release(2)
    assert sim.tools.grasp(x[-1], 1.2 * D, 3) == 4  # the corner and its neighbors
    sim.tools.move_grasp(3, velocity=(0, 0, 0.05))
    for _ in range(20):
        sim.step(0.002)
    assert np.allclose(sim.positions[-1] - x[-1], [0, 0, 0.002], atol=2e-5)
    sim.tools.release(3)
    for _ in range(100):
        sim.step(0.004)
    assert np.abs(sim.positions[-1] - x[-1]).max() < 0.1 * D
    x = block(4, 4, 6)
    low = x[:, 2] < 0.5 * D
    sim = make(backend, x[~low], None, gravity=(0, 0, 0), damping=5.0)
    sim.add_phase(gb.sim.Phase("plate", kind="boundary"))
    plate = sim.add(x[low], "plate")
    both = np.concatenate([plate, np.arange(80)])
    sim.tissue.bond(both, 2500.0)
    with pytest.raises(ValueError, match="of no body yet, got 96 of another"):
        sim.tissue.bond(both, 2500.0)
    pose = np.eye(4)
    sim.steer.move_boundary("plate", pose)
    for k in range(40):
        pose[0, 3] = 0.1 * 0.002 * (k + 1)
        sim.steer.move_boundary("plate", pose)
        sim.step(0.002)
    y = sim.positions
    assert np.allclose(y[plate] - x[low], [0.008, 0, 0], atol=2e-5)
    assert (y[:80, 0] - x[~low][:, 0]).mean() > 0.003


def test_a_step_sees_what_was_changed_before_it(backend):
    """As one that begins with that state, whatever was known from the steps before."""
    x = block(6, 5, 8)
    sims = [make(backend, x, 2500.0, fixed=x[:, 2] < 0.5 * D) for _ in range(2)]
    changes = [
        lambda sim: sim.tools.grasp(x[-1], 2 * D), lambda sim: sim.tissue.cut(stroke(3.5, -3, 3)),
        lambda sim: sim.tissue.ablate(x[len(x) // 2], 1.6 * D), lambda sim: sim.remove(sim.ids[100:104]),
        lambda sim: sim.add([(0.0, 0.0, 9.5 * D)], "blood"), lambda sim: sim.tools.release(),
        lambda sim: setattr(sim, "positions", sim.positions + np.float32(0.3 * D)),
    ]  # fmt: skip
    for change in changes:
        sims[0].step(0.002)
        change(sims[0])
        sims[1].arrays.set_state(sims[0].arrays.state())
        for sim in sims:
            sim.step(0.002)
        np.testing.assert_allclose(sims[1].positions, sims[0].positions, atol=1e-6 * D)
        np.testing.assert_allclose(sims[1].velocities, sims[0].velocities, atol=1e-5)


def test_ablation_counts_and_separates(backend):
    x = block(3, 3, 9)
    sim = make(backend, x, gravity=(0, 0, 0))
    n, gone = len(sim), sim.tissue.ablate((D, D, 4 * D), 1.5 * D)
    assert (len(gone), len(sim)) == (19, n - 19)
    left = build_bonds(np.delete(x, gone, axis=0), D, 2500.0)
    assert sim.tissue.n_bonds == len(left.other) // 2
    assert not any(len(sim.tissue.ablate(p, 0.1 * D)) for p in x[np.abs(x[:, 2] - 4 * D) < 0.1 * D])
    assert sim.tissue.n_pieces == 2
    sim.step(0.001)
    assert len(sim) == n - 19
    sim.remove(sim.ids[:3])
    sim.step(0.001)
    assert (sim.tissue.piece != NOBODY).sum() == len(sim) == n - 22


def test_blood_stains_tissue_and_wet_tissue_shines(backend):
    x = block(6, 6, 3)
    sim = make(backend, x, fixed=x[:, 2] < 0.5 * D, color=(0.3, 0.5, 0.8))
    sim.tissue.add_vessel(vessel([[0, 0, 0], [D, 0, 0]], 0.1 * D, 2000.0, 1e-6))
    sim.phases["blood"].color = (1.0, 0.0, 0.0)
    camera = gb.Camera((0.01, 0.01, 0.1), (0.01, 0.01, 0))
    clean = gb.render(sim.scene, camera, size=(32, 32))
    drop = sim.add(x[-1:] + [0, 0, 1.0 * D], "blood")
    for _ in range(30):
        sim.step(0.004)
    sim.remove(drop)
    red = gb.render(sim.scene, camera, size=(32, 32))
    change = (red.albedo - clean.albedo)[clean.mask & red.mask]
    assert change[:, 0].max() > 0.1
    assert change[:, 2].min() < -0.1
    x = block(8, 8, 3)
    sim = make(backend, x, fixed=np.ones(len(x), bool), color=(0.5, 0.5, 0.5))
    sim.tissue.add_vessel(vessel([[0, 0, 0], [D, 0, 0]], 0.1 * D, 2000.0, 1e-6))
    sim.phases["blood"].color = (0.2, 0.0, 0.0)
    sim.phases["blood"].shown = False
    middle = [3.5 * D, 3.5 * D]
    look = (gb.Camera((*middle, 0.1), (*middle, 0)), (48, 48))
    dull = {"lights": (), "ambient": 1.0, "specular": 0.0, "tone": False}
    shiny = {"lights": [gb.Headlight(0.3)], "ambient": 0.0, "background": (0, 0, 0)}
    dry = [gb.render(sim, *look, settings) for settings in (dull, shiny)]
    sim.add(block(6, 6, 1) + [D, D, 3.0 * D], "blood")
    for _ in range(50):
        sim.step(0.005)
    wet = [gb.render(sim, *look, settings) for settings in (dull, shiny)]
    some = dry[0].mask & wet[0].mask
    darker = (dry[0].color - wet[0].color)[some].mean(axis=1)
    assert darker.max() > 0.3  # 0.5 to nearly the film's 0.07
    assert darker.min() > -1e-3
    # The highlight is the film's: brighter, though the tissue under it is darker.
    assert wet[1].color[..., 2].max() > dry[1].color[..., 2].max()
    assert wet[0].color[some][darker.argmax()] == pytest.approx([0.245, 0.075, 0.075], abs=0.05)


def test_a_cut_that_does_not_gape_bleeds_at_its_lips(backend):
    x = block(10, 5, 6)
    sim = make(backend, x, fixed=np.ones(len(x), bool))  # held: no face gives way
    deep = 2.5 * D
    sim.tissue.add_vessel(vessel([[0, 2 * D, deep], [9 * D, 2 * D, deep]], 0.8 * D, 20000.0, 1e-4))
    blade = np.array([[4.5 * D, -D, 0.5 * D], [4.5 * D, -D, 7 * D]])
    assert sim.tissue.cut((blade, blade + [0, 7 * D, 0])) > 0
    while sim.time < 0.4:
        sim.step()
    blood = sim.positions[sim.arrays.phase == list(sim.phases).index("blood")]
    assert len(blood) > 5
    assert 1e-4 - sim.tissue.pools[0] == pytest.approx(len(blood) * D**3, rel=1e-6)
    assert np.abs(blood[:, 0] - 4.5 * D).min() < D  # over the cut


def test_free_fall_does_not_shorten_steps_but_landing_does(backend):
    """One drop at 2 m/s: steps by its speed alone would take 0.8 ms."""
    x = block(8, 8, 3)
    sim, by_speed = make(backend, x, fixed=np.ones(len(x), bool)), 0.4 * D / 2.0
    drop = sim.add([[3.5 * D, 3.5 * D, 0.09]], "blood", (0, 0, -2.0))
    assert sim.dt > 4 * by_speed
    shortest, n_steps = sim.dt, 0
    while sim.time < 0.08:
        shortest, n_steps = min(shortest, sim.dt), n_steps + 1
        assert sim.step().n_solved == 1
        assert np.linalg.norm(sim.positions[drop[0]] - x, axis=1).min() > 0.6 * D
    assert shortest < 2.5 * by_speed
    assert n_steps < 0.5 * 0.08 / by_speed
    assert np.linalg.norm(sim.velocities[drop[0]]) < 1.0


def test_steps_read_only_what_was_written():
    """109 particles do not fill a SIMD packet; memory that was used before holds NaN."""
    x, rng = block(6, 6, 3), np.random.default_rng(0)
    for _ in range(15):
        used = [np.full(rng.integers(100, 200000), np.nan, np.float32) for _ in range(30)]
        del used
        sim = make({"device": "cpu", "threads": 1}, x, fixed=x[:, 2] < 0.5 * D)
        sim.add(x[-1:] + [0, 0, D], "blood")
        for _ in range(2):
            sim.step(0.004)
        assert np.isfinite(sim.velocities).all()


@pytest.mark.parametrize("model", ["bonds", "solid"])
def test_tissue_that_has_left_the_domain_holds_nothing(backend, model):
    d = 0.004
    scene = {
        "spacing": d, "domain": {"lo": [-0.02, -0.02, -0.02], "hi": [0.04, 0.04, 0.06]},
        "solids": [{"name": "block", "model": model, "young": 20000.0,
                    "box": {"lo": [0, 0, 0], "hi": [4 * d, 4 * d, 10 * d]}}],
    }  # fmt: skip
    sim, parts = gb.Simulation(scene, **backend), set()
    while (report := sim.step()).n_escaped < len(sim):
        parts.add(report.n_escaped)
        if len(parts) == 2 and len(sim) == 160:  # those outside are no part of what is ablated
            top = sim.arrays.positions[np.argmax(sim.arrays.positions[:, 2])]
            assert (len(sim.tissue.ablate(top, 0.5 * d)), len(sim)) == (1, 159)
        assert sim.record.diagnostics[-1]["max_speed"] == pytest.approx(9.81 * sim.time, rel=0.03)
        assert sim.time < 0.15
    assert len(parts) > 3  # it left in parts
    assert sim.tissue.n_bonds == 0


@pytest.mark.parametrize("model", ["solid", "bonds"])
def test_tissue_ends_at_a_periodic_side(backend, model):
    box = {"lo": (0.2, 0.14, 0.14), "hi": (0.3, 0.24, 0.24)}
    scene = {
        "spacing": 0.02, "gravity": (0, 0, 0),
        "domain": {"lo": (0, 0, 0), "hi": (0.4, 0.4, 0.4), "periodic": ["x"]},
        "solids": [{"name": "jelly", "box": box, "velocity": (1, 0, 0), "model": model}],
    }  # fmt: skip
    sim = gb.Simulation(scene, **backend)
    before = sim.record.totals()["kinetic"]
    sim.run(0.3)
    assert sim.record.counts["escaped"] == len(sim)
    for _ in range(3):
        sim.step()
    sim.reset()
    while sim.time < 0.15:
        sim.step()
        assert sim.record.totals()["kinetic"] < 1.05 * before
    assert 0 < sim.record.counts["escaped"] < len(sim)
