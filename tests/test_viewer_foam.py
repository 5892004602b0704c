"""Spray, foam and bubbles of a simulation that the viewer runs."""

from types import SimpleNamespace

import globule as gb
import numpy as np
import pytest
from test_sim_foam import DAM, LIVELY
from viewer_helpers import Watched, steps, traced, until, view

pytest.importorskip("websockets")

from globule.render.settings import for_values
from globule.viewer.open import open_source
from globule.viewer.state import State

SIZE = (96, 72)
CAMERA = gb.Camera((0.6, -2.2, 0.6), (0.6, 0.15, 0.4), (0, 0, 1))
VIEW = {"eye": CAMERA.eye, "look_at": CAMERA.look_at}
N = 30  # steps after which there is foam


def made(**keys) -> gb.Simulation:
    keys = {"foam": LIVELY, "view": VIEW, **keys}
    return gb.Simulation({**DAM, **keys}, device="cpu", threads=1)


def foam(source) -> dict[str, np.ndarray]:
    return source.simulation.foam._state()


def same(one: dict[str, np.ndarray], two: dict[str, np.ndarray]) -> bool:
    return all(np.array_equal(one[name], two[name]) for name in one)


def seen(source, **settings) -> np.ndarray:
    return traced(source, CAMERA, SIZE, **{**source.settings, **settings}).picture


def shown_foam(source) -> np.ndarray:
    return traced(source, CAMERA, SIZE)._layers[1].scene.particles.positions


@pytest.fixture(scope="module")
def splash():
    source = open_source(made())
    steps(source, N)
    return source


def test_colors_of_values_are_those_of_the_fluid():
    sim = made(view={**VIEW, "speeds": [0, 3]})
    source = open_source(sim, device="cuda:99")  # the simulation's own device counts
    steps(source, N)
    shown, wanted = seen(source), [source.maker.last_scene, source.simulation.foam.layer()]
    settings = for_values(gb.RenderSettings())
    np.testing.assert_array_equal(shown, gb.render(wanted, CAMERA, SIZE, settings).picture)
    assert np.any(shown != gb.render(wanted[0], CAMERA, SIZE, settings).picture)
    flat = [seen(source, look__preset="flat", layers__hidden=hidden) for hidden in ("", "1", "2")]
    assert all(np.any(flat[0] != other) for other in flat[1:])
    assert np.ptp(flat[1], axis=2).max() < 8  # of the foam alone, which is white


def test_the_page_lists_the_foam_and_shows_what_globule_simulate_does(splash):
    hidden = seen(splash, layers__hidden="2")
    np.testing.assert_array_equal(hidden, gb.render(splash.maker.last_scene, CAMERA, SIZE).picture)
    assert seen(splash, surface__root="march").any()  # the thesis traces the fluid alone
    with view(splash.simulation) as viewer:
        layers = viewer.page.desk.model.of(SimpleNamespace(client_id=-1))["layers"]
        assert [layer["name"] for layer in layers] == ["simulation", "foam"]
    first = traced(splash, CAMERA, SIZE)
    traced(splash, CAMERA, (40, 30))
    first.refine()
    assert first.samples == 2
    sim = splash.simulation
    assert len(sim.foam) > 100
    shown, wanted = seen(splash), [splash.maker.last_scene, sim.foam.layer()]
    np.testing.assert_array_equal(shown, gb.render(wanted, CAMERA, SIZE).picture)
    assert np.any(shown != gb.render(wanted[0], CAMERA, SIZE).picture)


@pytest.mark.slow
def test_reset_and_the_timeline_take_the_foam_along():
    source, after = open_source(made()), []
    for _ in range(N + 10):
        steps(source, 1)
        after.append(foam(source))
    assert len(after[-1]["foam_at"]) > len(after[N - 1]["foam_at"])
    for step in (N, N + 10, N):
        source.go_to(step)
        source.advance(State())
        assert abs(source.place[0] - step) <= 1  # the nearest state that is kept
        assert same(foam(source), after[source.place[0] - 1])
        np.testing.assert_array_equal(shown_foam(source), source.simulation.foam.positions)
    steps(source, 3)
    np.testing.assert_array_equal(shown_foam(source), source.simulation.foam.positions)
    assert same(foam(source), after[source.place[0] - 1])
    source.reset()
    assert (len(source.simulation.foam), len(source.layers(State()))) == (0, 1)
    steps(source, N)
    assert same(foam(source), after[N - 1])


@pytest.mark.slow
def test_a_running_viewer_sends_it():
    with Watched(made(), camera=CAMERA) as watched:
        client, source, errors = watched.program(answers=False).client, watched.viewer.source, []
        client.sink.send = lambda number, data, plan: client.acknowledge(number)
        client.sink.error = errors.append
        client.acknowledge(1000)
        source.play(True)
        watched.viewer.engine.notify()
        until(lambda: source.simulation.n_steps > N, "for foam")
        for size in ((64, 48), (120, 90)):  # other windows, meanwhile and at rest
            client.look(CAMERA, size)
            source.play(not source.running)
            until(lambda: not source._stepping or source.running)
            until(lambda size=size: client.frame.size == size, "for an image of this size")
        assert not errors
        assert len(client.frame._layers) == 2
