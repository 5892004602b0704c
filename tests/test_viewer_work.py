"""The viewer's work without a browser: kinds of surface, meshes, undo, interrupted images."""

import threading

import globule as gb
import numpy as np
import pytest
from viewer_helpers import engine_of, traced, until, view

pytest.importorskip("websockets")

from globule.viewer.equivalent import python_code
from globule.viewer.first_view import left_out
from globule.viewer.open import open_source
from globule.viewer.recording import Shot
from globule.viewer.state import State


def water(n: int = 8) -> gb.Particles:
    grid = np.mgrid[:n, :n, :n].reshape(3, -1).T * 0.1
    positions = grid + np.random.default_rng(2).uniform(-0.01, 0.01, grid.shape)
    return gb.Particles(positions, attributes={"speed": positions[:, 0]})


def cloud(n: int = 300) -> gb.Particles:
    return gb.Particles(np.random.default_rng(1).normal(size=(n, 3)), support=0.5)


def scene_of(what: object, **settings: object) -> gb.Scene:
    source, state = open_source(what), State()
    state.set(**settings)
    with source.lock:
        return source.layers(state)[0].scene


def test_the_viewer_takes_the_surface_that_render_takes_and_keeps_it():
    for particles in (water(), cloud()):
        assert scene_of(particles).surface == gb.fluids.choose_surface(particles)
    assert (scene_of(water()).surface, scene_of(water()).threshold) == ("smooth", pytest.approx(0.5))
    assert scene_of(water(), color__by="speed").surface == "smooth"
    for asked in ({"surface__kernel": "wyvill"}, {"surface__threshold": 0.6}):
        assert scene_of(water(), **asked).surface == "balls"
    assert scene_of(water(), surface__shape="balls").surface == "balls"
    assert scene_of(cloud(), surface__shape="smooth").surface == "smooth"
    own = gb.Scene(water())
    assert scene_of(own) is own  # a program's own scene stays as it is
    # The image is that of render.
    particles, camera = water(), gb.Camera((2, 1.5, 3), (0.35, 0.35, 0.35))
    source, size = open_source(particles), (160, 120)
    for moving, settings in ((False, None), (True, {"edge_samples": 0})):
        seen = traced(source, camera, size, moving)
        assert np.array_equal(seen.picture, gb.render(particles, camera, size, settings).picture)
    torn = gb.Particles(water().positions, support=np.linspace(0.1, 0.3, 512))
    assert gb.fluids.choose_surface(torn) == "balls"
    source, state = open_source([water(), torn]), State()
    for frame in (0, 1):
        state.set(time__frame=frame)
        source.advance(state)
        with source.lock:
            assert source.layers(state)[0].scene.surface == "smooth"
    source.close()


def test_a_mesh_may_be_first_or_alone(tmp_path):
    vertices = np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)], float)
    faces = np.array([(0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3)])
    mesh = gb.Mesh(vertices, faces)
    both = open_source([mesh, gb.Layer(water())])
    with both.lock:
        assert [type(layer.scene) for layer in both.layers(State())] == [gb.Scene, gb.Mesh]
        assert np.allclose(both.bounds()[1], 1.0)
    camera = gb.Camera((2, 1.5, 3), (0.3, 0.3, 0.3))
    seen = traced(open_source(mesh), camera, (80, 60))
    assert np.array_equal(seen.picture, gb.render(mesh, camera, (80, 60)).picture)
    pytest.importorskip("trimesh").Trimesh(vertices, faces).export(tmp_path / "tank.stl")
    with view(str(tmp_path / "tank.stl")) as viewer:
        assert len(viewer.source.layers(State())[0].scene) == 4
        shot = viewer.screenshot(tmp_path / "tank.png", (80, 60), samples=1)
        command, code = viewer.equivalent(size=(80, 60))
    assert shot.frame.mask.any()
    assert command.startswith("globule render ")
    names: dict = {}
    code = code.replace("picture.png", str(tmp_path / "again.png"))
    exec(code.replace("samples=16", "samples=1"), names)
    assert np.array_equal(names["frame"].picture, shot.picture)


def test_undo_and_redo():
    state, now = State(), [0.0]
    history = state.history
    history.clock = lambda: now[0]
    assert not history.undo()
    assert not history.redo()
    state.set(look__exposure=2.0)
    state.set(surface__kernel="wyvill", surface__threshold=0.7)

    def facts():
        return state.look.exposure, state.surface.kernel, state.surface.threshold, history.lengths

    assert history.undo()
    assert facts() == (2.0, "murakami", None, (1, 1))
    assert history.undo()
    assert facts() == (1.0, "murakami", None, (0, 2))
    assert history.redo()
    assert history.redo()
    assert facts() == (2.0, "wyvill", 0.7, (2, 0))
    assert history.undo()
    state.set(cuts__plane=True)  # a new change ends what could be redone
    assert history.lengths == (2, 0)
    for value in np.linspace(0.2, 0.8, 20):  # one drag of a slider
        now[0] += 0.9
        state.set(surface__threshold=float(value))
    assert history.lengths == (3, 0)
    now[0] += 1.1
    state.set(surface__threshold=0.9)
    assert history.undo()
    assert state.surface.threshold == 0.8
    assert history.undo()
    assert state.surface.threshold is None
    for plane in (False, True):  # switches count one by one
        state.set(cuts__plane=plane)
    assert history.lengths == (4, 0)
    assert history.undo()
    assert history.undo()
    state.set(time__frame=3)
    assert history.lengths == (2, 2)


class Kept:
    def __init__(self, engine) -> None:
        self.engine, self.plans, self.errors = engine, [], []
        engine.on_error = self.errors.append
        self.client = engine.add(self, gb.Camera((2, 1.5, 3), (0.5, 0.5, 0.5)))

    def send(self, number: int, data: bytes, plan: object) -> None:
        self.plans.append(plan)
        self.client.acknowledge(number)


@pytest.fixture
def shown():
    with engine_of(water(12), quality__samples=4) as engine:
        yield Kept(engine)


def test_a_change_or_a_person_stops_a_still_image_which_then_begins_again(shown):
    client, engine = shown.client, shown.engine
    client.look(gb.Camera((2, 1.5, 3), (0.5, 0.5, 0.5)), (200, 150))
    until(lambda: shown.plans and shown.plans[-1].still, "for a still image")
    client.look(gb.Camera((2, 1.6, 3), (0.5, 0.5, 0.5)), (4000, 3000))
    until(lambda: engine._still is not None, "for a long image to begin")
    last = gb.Camera((2, 1.7, 3), (0.5, 0.5, 0.5))
    client.look(last, (200, 150))
    until(lambda: shown.plans[-1].samples == 4, "for the next one")
    assert not any(max(plan.size) == 4000 and plan.still for plan in shown.plans)
    assert client.frame.samples == 4
    assert not shown.errors
    fresh = Shot(engine, last, (200, 150), 4).picture
    assert np.array_equal(client.frame.picture, fresh)
    client, engine = shown.client, shown.engine
    client.look(gb.Camera((2, 1.5, 3), (0.5, 0.5, 0.5)), (800, 600))
    until(lambda: engine._still is not None, "for a still image to begin")
    engine.interrupt()
    until(lambda: shown.plans and shown.plans[-1].samples == 4, "for it to be complete")
    assert client.frame.samples == 4
    assert not shown.errors


def test_who_turns_does_not_wait_for_the_samples_of_others(shown):
    engine, other = shown.engine, Kept(shown.engine)
    for one in (shown, other):
        one.client.look(gb.Camera((2, 1.5, 3), (0.5, 0.5, 0.5)), (300, 200))
        until(lambda one=one: one.plans and one.plans[-1].samples == 4, "for all samples")
    until(lambda: not any(client.pacer.making for client in engine.clients))
    with engine.wake:  # the thread that traces waits
        shown.client.pacer._samples = 2  # it has two of four
        assert shown.client.pacer.plan(
            engine.clock(), engine._what(shown.client), 4, 90, 1920, engine._over(shown.client)
        )
        other.client.look(gb.Camera((2, 1.6, 3), (0.5, 0.5, 0.5)), (300, 200))
        for engine._turn in (0, 1):
            client, plan, seen, _ = engine._next()
            assert client is other.client
            assert not client.pacer.gains(plan)
            client.pacer.interrupted(seen)
    until(lambda: other.plans[-1].samples == 4 and len(other.plans) > 3, "for all samples")
    assert not shown.errors


def test_a_failed_thread_begins_again_and_says_so(shown, monkeypatch):
    client, engine = shown.client, shown.engine
    failing, usual = threading.Event(), engine._next

    def fails():
        if not failing.is_set():
            failing.set()
            raise SystemExit("out of order")
        return usual()

    monkeypatch.setattr(engine, "_next", fails)
    client.look(gb.Camera((2, 1.5, 3), (0.5, 0.5, 0.5)), (120, 90))
    until(lambda: shown.plans and shown.plans[-1].samples == 4, "for an image")
    assert failing.is_set()
    assert any("restarted" in error and "out of order" in error for error in shown.errors)


def test_a_simulation_with_tissue_shows_its_own_scene():
    sim = gb.Simulation("cut-block", spacing=0.005, device="cpu")
    assert scene_of(sim) is sim.scene
    for asked in ({"surface__shape": "balls"}, {"surface__threshold": 0.6}, {"color__by": "z"}):
        shown = scene_of(sim, **asked)
        assert shown is not sim.scene
        assert (shown.surface, shown.threshold) == ("balls", 0.6)
    code = python_code(open_source(sim), State(), gb.Camera((0, -1, 0), (0, 0, 0)), (64, 48), (0, 0, 1))
    assert "scene = simulation.scene\n" in code
    # What stands beside the tissue is no mistake in the particles.
    assert sim.scene.octree.n_inside < len(sim)
    assert left_out(sim.scene) == []
    positions = np.eye(3)
    for n, broken in enumerate((np.nan, np.inf)):
        positions[n, 0] = broken
        said = ("1 of 3 particles is not shown", "2 of 3 particles are not shown")[n]
        assert left_out(gb.Scene(gb.Particles(positions, support=1.0)))[0].startswith(said)
