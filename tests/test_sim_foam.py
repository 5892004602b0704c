"""Spray, foam and bubbles: closed forms of their motion, and what they must not change."""

import globule as gb
import numpy as np
import pytest
from globule.cli import main
from globule.sim.foam import BUBBLE, FOAM, SPRAY, uniform
from globule.sim.foam_sources import Flow, limits_of, potentials

G = 9.81
SPACING = 0.05
DAM = {
    "spacing": SPACING, "domain": {"lo": [0, 0, 0], "hi": [1.2, 0.3, 1.0], "walls": True},
    "solver": {"max_error": 0.01},
    "fluids": [{"name": "water", "box": {"lo": [0, 0, 0], "hi": [0.4, 0.3, 0.8]}}],
}  # fmt: skip
LIVELY = {"approach": [0.2, 1], "curvature": [0.1, 1], "speed": [0.2, 2]}


def scene(foam=(), **keys):
    base = {"spacing": SPACING, "domain": {"lo": [-1, -1, -1], "hi": [1, 1, 1]}, "fluids": [{"name": "water"}]}
    return gb.Simulation({**base, "foam": dict(foam), **keys}, device="cpu", threads=1)


def lattice(n, at=(0.0, 0.0, 0.0)):
    return (np.mgrid[0:n, 0:n, 0:n].reshape(3, -1).T - (n - 1) / 2) * SPACING + at


def meeting(foam=(), speed=3.0):
    sim = scene(foam)
    sim.add(lattice(5, (-0.14, 0, 0)), "water", (speed, 0, 0))
    sim.add(lattice(5, (0.14, 0, 0)), "water", (-speed, 0, 0))
    return sim


def put(sim, at, velocity=(0.0, 0.0, 0.0), life=10.0):
    sim.foam._add(np.array([at], float), np.array([velocity], float), np.array([life]))
    sim.foam._classify(Flow(sim._solver))


def all_potentials(sim, **limits):
    flow, found = Flow(sim._solver), limits_of(sim.file.foam, G, SPACING) | limits
    return potentials(flow, np.flatnonzero(flow.is_fluid), found)


def test_spray_flies_foam_goes_along_a_bubble_rises_and_water_at_rest_makes_nothing():
    sim = scene()
    sim.add(lattice(12), "water")
    put(sim, (0.0, 0.0, -0.1))
    assert sim.foam.kind.tolist() == [BUBBLE]
    speed, tau = np.sqrt(G * SPACING), np.sqrt(SPACING / G) / 2
    for _ in range(30):  # in water that stays where it is
        sim.foam._move(0.005)
    rise = speed * (0.15 - tau * (1 - np.exp(-0.15 / tau)))
    np.testing.assert_allclose(sim.foam.positions[0], [0, 0, rise - 0.1], atol=1e-6)
    np.testing.assert_allclose(sim.foam.velocities[0, 2], speed * (1 - np.exp(-0.15 / tau)))
    sim = scene()
    sim.add(lattice(6), "water")
    ids, *found = sim.foam.potentials()
    assert ids.tolist() == list(range(216))
    assert not np.any(found)
    sim, at = scene(), lattice(6)
    spin = np.array([3.0, -2.0, 5.0])
    sim.add(at, "water", np.cross(spin, at).astype(np.float32) + np.float32([4, 1, 2]))
    trapped, _, kinetic = all_potentials(sim, approach=(1e-4, 1.0))
    assert not trapped.any()
    assert kinetic.all()
    sim = scene()
    put(sim, (-0.5, 0.1, 0.2), (2.0, 0.5, 1.5))
    for dt in (0.003, 0.002, 0.005, 0.001) * 20:
        sim.step(dt)
    t = sim.time
    assert sim.foam.kind.tolist() == [SPRAY]
    place = [-0.5 + 2 * t, 0.1 + 0.5 * t, 0.2 + 1.5 * t - G * t * t / 2]
    np.testing.assert_allclose(sim.foam.positions[0], place, atol=1e-6)
    np.testing.assert_allclose(sim.foam.velocities[0], [2, 0.5, 1.5 - G * t], atol=1e-5)
    np.testing.assert_allclose(sim.foam.age, [t], rtol=1e-6)
    sim = scene({"approach": [1e3, 2e3], "speed": [10, 20]}, gravity=[0, 0, 0])
    sim.add(lattice(6), "water", (1.0, 0.5, 0.25))
    start = np.array([0.0, 0.0, 2.9 * SPACING])  # above the top face
    put(sim, start)
    assert sim.foam.kind.tolist() == [FOAM]
    for _ in range(40):
        sim.step(0.005)
    assert sim.foam.kind.tolist() == [FOAM]
    np.testing.assert_allclose(sim.foam.positions[0], start + 0.2 * np.array([1, 0.5, 0.25]), atol=1e-5)
    np.testing.assert_allclose(sim.foam.velocities[0], [1, 0.5, 0.25], rtol=1e-5)


def test_edges_are_crests_and_blocks_that_collide_trap_air():
    sim = scene()
    sim.add(lattice(8), "water", (0.0, 0.0, 3.0))
    _, crest, _ = all_potentials(sim, curvature=(1e-4, 1.0))
    at, top = np.abs(sim.positions / SPACING), sim.positions[:, 2] > 3.4 * SPACING
    crest = crest[np.argsort(Flow(sim._solver).ids)]
    edge = (at[:, :2] > 3.4).sum(axis=1) == 1  # at a corner, the normal is 55 degrees off
    assert crest[top & edge].all()
    assert not crest[top & (at[:, :2] < 1.6).all(axis=1)].any()  # its middle
    assert not crest[sim.positions[:, 2] < 0].any()  # what does not move along its normal
    sim = meeting()
    _, trapped, _, kinetic = sim.foam.potentials()
    gap = np.abs(sim.positions[:, 0])
    assert trapped[gap < 0.05].min() > 0
    assert not trapped[gap > 0.15].any()
    assert kinetic.min() > 0
    sim.add(lattice(2, (0.6, 0, 0)), "water")  # at rest
    assert sim.foam.potentials()[3][-8:].max() == 0
    assert not meeting(speed=-3.0).foam.potentials()[1].any()  # they part


def test_the_count_is_the_rate_times_the_time_and_random_numbers_are_uniform():
    sim = meeting({**LIVELY, "air_rate": 3000.0, "crest_rate": 1000.0})
    ids, trapped, crest, kinetic = sim.foam.potentials()
    dt = 0.002
    n = kinetic * (3000 * trapped + 1000 * crest) * dt
    count = np.floor(n + uniform(0, ids, sim.n_steps, 0))
    assert n.max() > 3
    assert np.all(np.abs(count - n) < 1)
    sim.foam._create(Flow(sim._solver), dt)
    assert len(sim.foam) == count.sum()
    assert abs(count.sum() - n.sum()) < 4 * np.sqrt(len(n) / 4)
    owner = np.repeat(np.arange(250), count.astype(int))
    way = sim.foam.positions - sim.positions[owner]
    along = way[:, 0] * np.sign(sim.velocities[owner, 0])
    assert along.min() >= -3.0 * dt - 1e-6  # where each came by in the step
    assert along.max() <= 1e-6
    assert np.hypot(way[:, 1], way[:, 2]).max() <= SPACING / 2 + 1e-6
    np.testing.assert_array_equal(sim.foam.velocities, sim.velocities[owner])
    u = uniform(1, np.arange(40_000), 7, 0)
    assert 0 <= u.min() < u.max() < 1
    assert abs(u.mean() - 0.5) < 5 / np.sqrt(12 * 40_000)
    assert abs(np.corrcoef(u[:-1], u[1:])[0, 1]) < 5 / np.sqrt(40_000)
    for other in ((2, 7, 0), (1, 8, 0), (1, 7, 1)):
        v = uniform(other[0], np.arange(40_000), *other[1:])
        assert abs(np.corrcoef(u, v)[0, 1]) < 5 / np.sqrt(40_000)


@pytest.fixture(scope="module")
def runs():
    """The dam break without foam, with it, and with two threads."""
    made = []
    for threads, keys in ((1, {}), (1, {"foam": LIVELY}), (2, {"foam": LIVELY})):
        sim = gb.Simulation({**DAM, **keys}, device="cpu", threads=threads)
        sim.run_to(0.25)
        made.append(sim)
    return made


def same_foam(one, two):
    for name, values in one.foam._state().items():
        np.testing.assert_array_equal(values, two.foam._state()[name], err_msg=name)


def test_no_bit_changes_by_threads_or_a_checkpoint_unless_it_is_damaged(runs, tmp_path):
    without, with_, threads = runs
    assert not without.foam.on
    with pytest.raises(ValueError, match="expected a table foam"):
        without.foam.potentials()
    assert len(with_.foam) > 100
    assert (with_.hash(), with_.n_steps) == (without.hash(), without.n_steps)
    same_foam(with_, threads)
    sim = runs[1]
    sim.save(tmp_path / "dam")
    again = gb.Simulation.load(tmp_path / "dam", device="cpu", threads=1)
    for one in (sim, again):
        for _ in range(3):
            one.step(0.002)
    same_foam(sim, again)
    again.reset()
    assert len(again.foam) == 0
    state = runs[1].foam._state()
    for name, value in (
        ("foam_at", state["foam_at"][:, :2]),
        ("foam_age", state["foam_age"].astype(np.float32)),
        ("foam_kind", np.full_like(state["foam_kind"], 3)),
        ("foam_velocity", np.full_like(state["foam_velocity"], np.nan)),
    ):
        with pytest.raises(ValueError, match=name.replace("at", "(at|velocity)")):
            runs[1].foam._take_up({**state, name: value})
        runs[1].foam._take_up(state)


def test_the_oldest_go_foam_dies_and_periodic_sides_are_joined():
    sim = scene({"max_particles": 3})
    for k in range(5):
        put(sim, (0.1 * k, 0, 0))
    sim.step(0.001)
    np.testing.assert_allclose(sim.foam.positions[:, 0], [0.2, 0.3, 0.4], atol=1e-6)
    sim = scene(gravity=[0, 0, 0], foam={"approach": [1, 2], "speed": [1, 2]})
    sim.add(lattice(6), "water")
    put(sim, (0, 0, 2.9 * SPACING), life=0.01)
    put(sim, (0.9, 0, 0), (100, 0, 0))
    sim.step(0.006)
    assert len(sim.foam) == 1  # the fast one has left the domain
    sim.step(0.006)
    assert len(sim.foam) == 0
    domain = {"lo": [-0.5, -1, -1], "hi": [0.5, 1, 1], "periodic": ["x"]}
    sim = scene(domain=domain)
    sim.add(lattice(6, (0.35, 0, 0)), "water")
    put(sim, (-0.49, 0, 0), (-4, 0, 0))
    assert sim.foam.kind.tolist() == [FOAM]
    sim = scene(domain=domain)
    put(sim, (-0.49, 0, 0), (-4, 0, 0))
    sim.step(0.005)
    np.testing.assert_allclose(sim.foam.positions[0, 0], 0.49, atol=1e-6)


@pytest.mark.parametrize("periodic", [[], ["x"], ["y"], ["z"], ["x", "y", "z"]])
def test_neighbors_through_periodic_sides_are_those_of_brute_force(periodic):
    size = np.array([0.4, 0.45, 0.5])
    domain = {"lo": [0, 0, 0], "hi": size.tolist(), "periodic": periodic}
    sim, rng = scene(domain=domain), np.random.default_rng(4)
    water, places = rng.uniform(0, size, (300, 3)), rng.uniform(0, size, (100, 3))
    sim.add(water, "water", rng.normal(size=(300, 3)))
    d = places[:, None] - sim.positions.astype(float)
    repeats = np.array([axis in periodic for axis in "xyz"])
    d -= np.where(repeats, np.round(d / size) * size, 0.0)
    r = np.linalg.norm(d, axis=2)
    n, mean = Flow(sim._solver).around(places)
    np.testing.assert_array_equal(n, (r <= 2 * SPACING).sum(axis=1))
    w = np.maximum(1 - r / (2 * SPACING), 0)
    wanted = (w @ sim.velocities) / np.maximum(w.sum(axis=1), 1e-30)[:, None]
    np.testing.assert_allclose(mean, wanted, atol=1e-6)


def test_particles_and_an_image(runs):
    sim = runs[1]
    particles = sim.foam.particles()
    assert set(particles.attributes) == {"velocity", "kind", "age"}
    assert sum(sim.foam.counts.values()) == len(sim.foam) == len(particles)
    camera = gb.Camera((0.6, -2.2, 0.6), (0.6, 0.15, 0.4), (0, 0, 1))
    plain = gb.render(sim.scene, camera, (96, 72)).color
    assert np.any(plain != gb.render([sim.scene, sim.foam.layer()], camera, (96, 72)).color)


@pytest.mark.slow
def test_a_run_writes_foam_beside_its_frames(tmp_path, capsys):
    (tmp_path / "dam.toml").write_text("""
spacing = 0.05
seconds = 0.2
domain = { lo = [0, 0, 0], hi = [0.8, 0.2, 0.8], walls = true }
fluids = [{ name = "water", box = { lo = [0, 0, 0], hi = [0.4, 0.2, 0.6] } }]
foam = { approach = [0.2, 1], speed = [0.2, 2] }
output = { fps = 10 }
""")
    command = ["simulate", str(tmp_path / "dam.toml"), "--device", "cpu", "--images"]
    whole, parts = tmp_path / "whole", tmp_path / "parts"
    assert main([*command, str(whole), "--size", "64x48", "-o", str(whole)]) == 0
    assert main([*command, str(parts), "-o", str(parts), "--seconds", "0.1"]) == 0
    assert main([*command, str(parts), "-o", str(parts), "--resume"]) == 0
    made = [gb.read(folder / "foam_00002.vtp") for folder in (whole, parts)]
    assert len(made[0]) > 20
    assert len(gb.read(whole / "foam_00000.vtp")) == 0
    np.testing.assert_array_equal(made[0].positions, made[1].positions)
    for name in ("velocity", "kind", "age"):
        np.testing.assert_array_equal(made[0].attributes[name], made[1].attributes[name])
    assert len(gb.read(whole / "frame_00002.vtp")) == 8 * 4 * 12


def test_limits_need_gravity_or_numbers():
    with pytest.raises(ValueError, match=r"foam.approach: expected \[m/s, m/s\]"):
        scene(gravity=[0, 0, 0])
    with pytest.raises(ValueError, match=r"foam.speed: expected the lower one first"):
        scene({"speed": [2, 1]})
