"""Fluids: neighbors, determinism, changes between steps, what enters and leaves, restart."""

import globule as gb
import numpy as np
import pytest
from globule.sim.emitter import Emitter

from bench.tables import physics_fluid as physics

D = 0.05


def column(walls=True, hi=(1.0, 0.8, 0.4), periodic=(), **more):
    domain = {"lo": (0, 0, 0), "hi": hi, "walls": walls, "periodic": periodic}
    fluids = [{"name": "water", "viscosity": 0.5}]
    return {"spacing": D, "gravity": (0, -9.81, 0), "domain": domain, "fluids": fluids, **more}


def falling(backend, **more):
    sim = gb.Simulation(column(**more), **backend)
    return sim, sim.add(physics.lattice((0, 0, 0), (0.3, 0.5, 0.4), D), "water")


def brute_force(positions, row, period=None):
    away = positions.astype(float) - positions[row].astype(float)
    if period is not None:
        away -= period * np.rint(away / period)
    near = (away**2).sum(1) < float(np.float32(2 * D)) ** 2
    near[row] = False
    return np.flatnonzero(near)


def check_neighbors(sim, period=None):
    ids, offsets, found = sim.arrays.neighbors()
    positions, all_ids = sim.positions, sim.ids
    assert len(ids) > 0
    for k in range(0, len(ids), 3):
        row, mine = np.searchsorted(all_ids, ids[k]), np.sort(found[offsets[k] : offsets[k + 1]])
        np.testing.assert_array_equal(mine, all_ids[brute_force(positions, row, period)])


@pytest.mark.few_backends
def test_it_does_not_matter_where_in_memory_neighbors_are(backend):
    """Slots of neighbors have 16 bits where they lie near each other: not so across this domain."""
    size = 48 * D
    domain = {"lo": (0, 0, 0), "hi": (size, size + 8 * D, size), "periodic": ("x", "z")}
    solver = {"max_iterations": 8}
    scene = {"spacing": D, "gravity": (0, 0, 0), "domain": domain, "fluids": [{"name": "water"}], "solver": solver}
    at = physics.lattice((0, 4 * D, 0), (size, size + 4 * D, size), D)
    at = at + 0.1 * D * np.random.default_rng(5).random(at.shape)
    angle = 2 * np.pi * at / size
    velocities = np.sin(angle)  # together in places, and apart in others
    found = []
    for shift in (0.0, size / 2):
        sim, moved = gb.Simulation(scene, **backend), (at + (shift, 0, shift)) % (size, 1e9, size)
        ids = sim.add(moved, "water", velocities)
        sim.step()
        found.append(sim.velocities[np.argsort(sim.ids)][np.argsort(np.argsort(ids))])
    changed = np.abs(found[0] - velocities).max()
    assert changed > 0.1  # the solver worked
    apart = np.abs(found[0] - found[1]).max(axis=1)
    assert np.quantile(apart, 0.99) < 1e-3 * changed
    assert apart.max() < 1e-2 * changed


def test_same_bits_for_any_thread_count():
    def run(threads):
        water = {"name": "water", "viscosity": 5.0, "implicit": True, "surface_tension": 0.5}
        sim = gb.Simulation(column(gravity=(1.0, -9.81, 0.5), fluids=[water]), device="cpu", threads=threads)
        sim.add(physics.lattice((0, 0, 0), (0.3, 0.5, 0.4), D), "water")
        for _ in range(15):
            report = sim.step()
        return sim.hash(), report.iterations, sim.record.totals()

    assert run(1) == run(2) == run(5)


def test_user_changes_between_steps_and_boundaries_follow_their_poses(backend):
    sim = gb.Simulation(column(gravity=(0, 0, 0)), **backend)
    ids = sim.add(physics.lattice((0.4, 0.2, 0.1), (0.7, 0.6, 0.3), D), "water")
    sim.velocities = np.where(np.isin(sim.ids, ids)[:, None], (0.0, 0.1, 0.0), 0.0)
    sim.step()
    np.testing.assert_allclose(sim.velocities[ids, 1].mean(), 0.1, rtol=1e-4)
    before, mass = np.array(sim.record.totals()["momentum"]), sim.record.totals()["mass"]
    sim.steer.apply_force((2.0 / len(ids), 0.0, 0.0), ids)
    report, gained = sim.step(0.001), np.array(sim.record.totals()["momentum"]) - before
    np.testing.assert_allclose(gained[0], 2.0 * report.dt, rtol=0.02)
    sim.phases["water"].density = 500.0
    sim.step()
    np.testing.assert_allclose(sim.record.totals()["mass"], mass / 2, rtol=1e-6)
    sim = gb.Simulation(column(), **backend)
    sim.add_phase(gb.sim.Phase("paddle", kind="boundary"))
    at = physics.lattice((0.1, 0, 0), (0.15, 0.5, 0.4), D)
    paddle = sim.add(at, "paddle")
    water = sim.add(physics.lattice((0.2, 0, 0), (0.5, 0.3, 0.4), D), "water")
    pose = np.eye(4)
    sim.steer.move_boundary("paddle", pose)
    for k in range(1, 41):
        pose[0, 3] = 0.005 * k
        sim.steer.move_boundary("paddle", pose)
        sim.step(0.004)
    np.testing.assert_allclose(sim.positions[paddle], at + (0.2, 0, 0), atol=1e-5)
    assert sim.positions[water, 0].min() > 0.3  # pushed, none left behind
    assert sim.step(0.004).n_escaped == 0


def spray():
    """Few neighbors far apart, so that rows side by side in memory share no candidates; some
    particles are in one place."""
    random = np.random.default_rng(5)
    drops = np.repeat(5 * random.random((60, 3)), random.integers(1, 25, 60), axis=0)
    at = np.concatenate([drops, drops[:40]])
    at[: len(drops)] += D * random.normal(size=drops.shape)
    return np.clip(at, 0.1, 4.9)


@pytest.mark.parametrize(("size", "positions"), [
    (10 * D, 10 * D * np.random.default_rng(3).random((700, 3))),
    (1.0, 0.3 + 0.08 * np.random.default_rng(4).random((300, 3))), (5.0, spray()),
], ids=["periodic", "crowded", "spray"])  # fmt: skip
def test_lists_of_any_cloud_are_complete(backend, size, positions):
    periodic = "xyz" if size == 10 * D else ""
    sim = gb.Simulation(column(walls=False, hi=(size,) * 3, periodic=[*periodic]), **backend)
    sim.add(positions, "water")
    check_neighbors(sim, np.float64(np.float32(size)) if periodic else None)


def test_neighbors_follow_what_was_changed_since_the_last_step(backend):
    sim, ids = falling(backend)
    check_neighbors(sim)  # a lattice: many pairs at exactly the support's distance
    sim.emitters["tap"] = Emitter((0.7, 0.6, 0.2), (0, -1, 0), 0.12, 0.02, "water")
    for _ in range(20):
        sim.step()
    assert sim.emitters["tap"].emitted > 3
    check_neighbors(sim)
    rng = np.random.default_rng(4)
    for _ in range(2):
        sim.step()
        sim.positions = sim.positions + rng.normal(0, 0.2 * D, (len(sim), 3)).astype(np.float32)
        check_neighbors(sim)
        sim.step()
        ids = np.append(ids, sim.add([(0.6, 0.3, 0.2), (0.62, 0.3, 0.2)], "water"))
        check_neighbors(sim)
        sim.step()
        sim.remove(ids[::7])
        ids = np.setdiff1d(ids, ids[::7])
        check_neighbors(sim)


def test_what_is_added_is_removed_sinks_leaves_or_is_no_number(backend):
    sim, ids = falling(backend)
    more = sim.add([(0.8, 0.5, 0.2), (0.8, 0.6, 0.2)], "water", (0, 1, 0))
    assert more.tolist() == [ids[-1] + 1, ids[-1] + 2]
    before = sim.positions[np.searchsorted(sim.ids, more[1])]
    sim.remove(np.concatenate([ids[5:9], more[:1]]))
    assert not np.isin(sim.ids, ids[5:9]).any()
    assert more[1] in sim.ids
    np.testing.assert_array_equal(sim.positions[np.searchsorted(sim.ids, more[1])], before)
    assert sim.add([(0.8, 0.7, 0.2)], "water")[0] == more[1] + 1
    sim, _ = falling(backend)
    n = len(sim)
    sim.steer.set_sinks([((0.0, 0.0, 0.0), (0.1, 0.1, 0.4)), ((0.25, 0.4, 0.2), 0.06)])
    removed = sum(sim.step().n_removed for _ in range(5))
    assert removed > 20
    assert len(sim) == n - removed
    assert not ((sim.positions[sim.arrays.phase == 0] < 0.1).all(1)).any()
    sim = gb.Simulation(column(walls=False), **backend)
    sim.add([(0.5, 0.5, 0.2), (0.2, 0.5, 0.2)], "water", [(30.0, 0, 0), (0, 0, 0)])
    for _ in range(60):
        report = sim.step(0.002)
    assert (report.n_escaped, len(sim), report.n_solved) == (1, 2, 1)
    gone = sim.positions[0]
    sim.step()
    np.testing.assert_array_equal(sim.positions[0], gone)
    sim, _ = falling(backend)
    v = sim._solver.read("velocity")
    v[7] = np.nan
    sim._solver.write("velocity", v)  # assigning it is refused
    with pytest.raises(ArithmeticError, match=r"particle \d+ \(water\) at .* not a number in step"):
        sim.step()


@pytest.mark.slow
@pytest.mark.few_backends
def test_light_bodies_float_and_heavy_ones_sink(backend):
    heights = {}
    for name, density in (("cork", 300.0), ("stone", 3000.0)):
        sim = gb.Simulation(column(hi=(0.6, 0.8, 0.6)), **backend)
        sim.add_phase(gb.sim.Phase(name, kind="rigid"))
        sim.add(physics.lattice((0, 0, 0), (0.6, 0.3, 0.6), D), "water")
        sim.add(physics.lattice((0.2, 0.35, 0.2), (0.4, 0.5, 0.4), D), name)
        sim.steer.make_rigid(name, density)
        assert sim.run(1.0).n_escaped == 0
        heights[name] = sim.steer.body(name)["center"][1]
        rotation = sim.steer.body(name)["rotation"]
        np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-6)
    assert heights["cork"] > 0.25
    assert 0.05 < heights["stone"] < 0.16


def test_particles_become_a_fluid_if_there_is_room():
    at = physics.lattice((0, 0, 0), (0.4, 0.4, 0.4), D)
    sim = gb.Simulation(gb.Particles(at, attributes={"velocity": np.full_like(at, 0.1)}), "cpu")
    assert sim.settings.spacing == pytest.approx(D, rel=1e-3)
    np.testing.assert_allclose(sim.velocities[sim.arrays.phase == 0], 0.1, rtol=1e-6)
    report = sim.run(0.3)
    assert (report.n_escaped, (sim.arrays.phase == 0).sum()) == (0, len(at))
    assert report.compression < 0.002
    report = gb.Simulation(gb.Particles(at), "cpu").step()  # it starts at rest
    assert report.most_compression < 1e-3
    assert report.most_speed == pytest.approx(physics.GRAVITY * report.dt, rel=0.05)
    sim = gb.Simulation(column(), device="cpu")
    sim.add(physics.lattice((0, 0, 0), (1.0, 0.8, 0.4), 0.9 * D), "water")
    with pytest.raises(ArithmeticError, match="expected room"):
        sim.run(1.0)


@pytest.mark.slow
def test_wcsph_agrees_with_dfsph():
    places = []
    for more in ({}, {"method": "wcsph", "extra_viscosity": 1.0}):
        sim, ids = falling({"device": "cpu"}, solver=more)
        sim.run(0.25)
        places.append(sim.positions[ids, 0].mean())
    assert places[0] == pytest.approx(places[1], rel=0.05)


def deep(layers: int, backend) -> gb.Simulation:
    d = 0.02
    box = {"lo": (0, 0, 0), "hi": (8 * d, 8 * d, (layers + 10) * d)}
    domain = box | {"walls": True, "open": ["+z"], "periodic": ["x", "y"]}
    sim = gb.Simulation({"spacing": d, "domain": domain, "fluids": [{"name": "water"}]}, **backend)
    sim.add(physics.lattice((0, 0, 0), (8 * d, 8 * d, layers * d), d), "water")
    return sim


@pytest.mark.few_backends
@pytest.mark.parametrize("layers", [120, pytest.param(520, marks=pytest.mark.slow)])
def test_deep_water_does_not_fall_into_itself(backend, layers):
    """What is allowed to be left in each layer, a ten-thousandth, let 120 layers fall freely and their toe give way; a
    surface of one layer in 500 is one."""
    sim = deep(layers, backend)
    while sim.time < 0.02:
        report = sim.step()
    assert report.compression < 0.001
    assert -sim.velocities[:, 2].mean() < 0.4 * 9.81 * sim.time


@pytest.mark.slow
@pytest.mark.few_backends
@pytest.mark.parametrize("layers", [60, 240])
def test_deep_water_stays(backend, layers):
    sim = deep(layers, backend)
    while sim.time < 0.4:
        assert sim.step().compression < 0.002


@pytest.mark.few_backends
def test_full_box_goes_on(backend):
    sim = gb.Simulation(column(gravity=(0, 0, 0)), **backend)
    at = physics.lattice((0, 0, 0), (1.0, 0.8, 0.4), D)
    turn = np.pi * at / (1.0, 0.8, 0.4)
    x, y = np.sin(turn[:, 0]) * np.cos(turn[:, 1]), -np.cos(turn[:, 0]) * np.sin(turn[:, 1])
    ids = sim.add(at, "water", 0.3 * np.stack([x, 0.8 * y, 0 * x], 1))
    before = sim.record.totals()["kinetic"]
    for _ in range(100):
        report = sim.step()
        assert report.most_speed < 0.6
    assert report.n_escaped == 0
    assert 0.3 * before < sim.record.totals()["kinetic"] < before
    assert ((sim.positions[ids] > 0) & (sim.positions[ids] < (1.0, 0.8, 0.4))).all()


@pytest.mark.slow
@pytest.mark.few_backends
def test_a_full_box_under_gravity_does_not_pack_at_its_bottom(backend):
    domain = {"lo": (0, 0, 0), "hi": (0.1, 0.1, 0.2), "walls": True}
    box = {"lo": domain["lo"], "hi": domain["hi"]}
    scene = {"spacing": 0.01, "domain": domain, "fluids": [{"name": "water", "box": box}]}
    sim = gb.Simulation(scene, **backend)
    sim.run(0.4)
    rows = sim.record.diagnostics[-20:]
    assert max(row["compression"] for row in rows) < 0.02
    assert np.mean([row["iterations"] for row in rows]) < 100  # 121: they did not suffice
    heights = sim.positions[sim.arrays.phase == list(sim.phases).index("water"), 2]
    n_low, *_, n_high = np.histogram(heights, 5, (0, 0.2))[0]
    assert n_low < 1.08 * 400
    assert n_high > 0.92 * 400


def test_fluid_that_fills_its_space_keeps_its_momentum(backend):
    size = 8 * D
    sim = gb.Simulation(
        column(walls=False, hi=(size, size, size), periodic=("x", "y", "z"), gravity=(0, 0, 0)), **backend
    )
    at = physics.lattice((0, 0, 0), (size, size, size), D)
    wave = 0.1 * np.sin(2 * np.pi * at[:, 1] / size)
    sim.add(at, "water", np.stack([0.3 + wave, 0 * wave, 0 * wave], 1))
    before = sim.record.totals()
    for _ in range(40):
        report = sim.step()
    after, mass = sim.record.totals(), before["mass"]
    np.testing.assert_allclose(after["momentum"], before["momentum"], atol=1e-5 * 0.3 * mass)
    # The shear goes on: rho v^2 / 2 falls by viscosity alone.
    decay = np.exp(-2 * 0.5 / 1000 * (2 * np.pi / size) ** 2 * sim.time)
    drift = 0.5 * mass * 0.3**2
    assert after["kinetic"] - drift == pytest.approx((before["kinetic"] - drift) * decay, rel=0.1)
    assert report.n_escaped == 0


def test_tension_keeps_momentum_and_gathers_a_block():
    d = 0.001
    water = {"name": "water", "surface_tension": 0.07, "viscosity": 0.005}
    domain = {"lo": (-0.02,) * 3, "hi": (0.02,) * 3}
    scene = {"spacing": d, "domain": domain, "gravity": (0, 0, 0), "fluids": [water]}
    sim = gb.Simulation(scene, device="cpu")
    sim.add(physics.lattice((-0.006, -0.003, -0.003), (0.006, 0.003, 0.003), d), "water")
    size = 0.0
    while sim.time < 0.06:
        sim.step()
        size = max(size, np.abs(sim.velocities).sum() * 1000 * d**3)
    assert np.abs(sim.record.totals()["momentum"]).sum() < 1e-5 * size
    spread = sim.positions.std(0)
    assert sim.n_steps > 50
    assert spread.max() < 1.5 * spread.min()


def test_tension_keeps_the_momentum_of_every_cloud(backend):
    """All vertices of a facet find it, also where two of them are two spacings apart, or where
    somebody at the end of a ball is two spacings from one of them: in each of 4,096 clouds of
    24 particles, tension alone moves particles, and its pulls add up to nothing."""
    d, n = 0.001, 24
    side = np.arange(16) * 7 * d + 4 * d
    middle = np.stack(np.meshgrid(side, side, side, indexing="ij"), -1).reshape(-1, 1, 3)
    x = middle + np.random.default_rng(2).uniform(-2 * d, 2 * d, (len(middle), n, 3))
    domain, water = {"lo": (0, 0, 0), "hi": (0.12, 0.12, 0.12)}, {"name": "water", "surface_tension": 0.07}
    sim = gb.Simulation(spacing=d, gravity=(0, 0, 0), domain=domain, fluids=[water], **backend)
    sim.add(x.reshape(-1, 3), "water")
    sim.step(1e-6)
    v = sim.velocities.astype(float).reshape(-1, n, 3)
    moved = np.abs(v).sum((1, 2))
    assert moved.min() > 1e-5
    assert (np.abs(v.sum(1)).max(1) / moved).max() < 1e-6


def test_walls_go_on_across_a_periodic_axis():
    sim = gb.Simulation(column(hi=(0.5, 0.5, 0.5), periodic=["x"]), device="cpu")
    x = np.unique(sim.positions[:, 0].round(4))
    np.testing.assert_allclose(x, D * (np.arange(10) + 0.5), atol=1e-4)
    y = np.unique(sim.positions[:, 1].round(4))
    np.testing.assert_allclose([y[0], y[-1]], [-0.555 * D, 0.5 + 0.555 * D], atol=1e-4)


def test_an_emitter_as_wide_as_its_tube_fills_it(backend):
    """What comes in pushes what is there: Poiseuille's flow, from a plug."""
    radius, length, speed, d = 0.006, 0.03, 0.1, 0.0015
    rate = np.pi * radius**2 * speed
    tube = {"cylinder": {"start": (-0.002, 0, 0), "end": (length, 0, 0), "radius": radius}}
    sim = gb.Simulation(
        spacing=d, gravity=(0, 0, 0), domain={"lo": (-0.003, -0.01, -0.01), "hi": (length + 0.01, 0.01, 0.01)},
        fluids=[{"name": "blood", "viscosity": 0.0175, "density": 1055}],
        boundaries=[{"name": "tube", **tube, "hollow": True, "open": ["start", "end"]}],
        emitters=[{"name": "in", "fluid": "blood", "center": (0.0005, 0, 0), "direction": (1, 0, 0),
                   "radius": radius, "rate": rate}],
        sinks=[{"name": "out", "box": {"lo": (length - 0.004, -0.01, -0.01), "hi": (length + 0.01, 0.01, 0.01)}}],
        **backend,
    )  # fmt: skip
    sim.run(0.6)
    fluid = np.asarray(sim.arrays.phase) == list(sim.phases).index("blood")
    x, v = sim.positions[fluid], sim.velocities[fluid, 0]
    there = (x[:, 0] > 0.012) & (x[:, 0] < 0.022)
    r = np.hypot(x[:, 1], x[:, 2])
    assert v[there].sum() * d**3 / 0.01 == pytest.approx(rate, rel=0.06)
    assert 1.4 < v[there & (r < radius / 3)].mean() / speed < 1.9
    assert v[there & (r > 0.75 * radius)].mean() / speed < 0.7
    assert fluid.sum() * d**3 > 0.9 * np.pi * radius**2 * (length - 0.004)


def test_an_emitter_under_water_throws_nothing(backend):
    water = {"name": "water", "box": {"lo": (-0.1, -0.1, 0), "hi": (0.1, 0.1, 0.16)}}
    tap = {"name": "tap", "fluid": "water", "center": (0, 0, 0.1), "direction": (0, 0, 1), "radius": 0.03}
    sim = gb.Simulation(
        spacing=0.0125, domain={"lo": (-0.1, -0.1, 0), "hi": (0.1, 0.1, 0.3), "walls": True, "open": ["+z"]},
        fluids=[water], emitters=[{**tap, "rate": 2e-3}], **backend,
    )  # fmt: skip
    fastest = max(sim.step().most_speed for _ in range(60))
    assert sim.time > 0.1
    assert fastest < 3 * 2e-3 / (np.pi * 0.03**2)
