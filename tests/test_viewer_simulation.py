"""Simulations: run, step, reset, cut, suck, move instruments; what paces them."""

import globule as gb
import numpy as np
import pytest
from viewer_helpers import Watched, steps, until

pytest.importorskip("websockets")

from globule.viewer.engine import Engine
from globule.viewer.open import open_source
from globule.viewer.source import Source
from globule.viewer.state import State

BROWSERS = True  # see hang_guard


@pytest.fixture
def dam():
    with Watched(gb.Simulation("dam-break", spacing=0.08)) as watched:
        yield watched


def test_play_advances_time_and_reset_goes_back(dam):
    page, source = dam.program(), dam.viewer.source
    sim, first, begin = source.simulation, dam.still(page), source.simulation.hash()
    page.ask("step")
    until(lambda: sim.n_steps == 1 and "paused" in source.status())
    dam.still(page, lambda p: not np.array_equal(p, first))
    dam.viewer.state.set(color__by="speed")
    page.ask("play")
    page.heard("**running**")
    until(lambda: sim.n_steps > 20)
    page.ask("play")
    page.heard("**paused**")
    at = until(lambda: not source._stepping and sim.n_steps)
    until(lambda: dam.still(page) is not None and source.maker.range[1] > 0.1)
    assert sim.n_steps == at
    dam.viewer.state.set(color__by="")
    page.ask("reset")
    until(lambda: sim.n_steps == 0 and sim.hash() == begin, "for the state of the start")
    dam.still(page, lambda p: np.array_equal(p, first))
    page.command("Play or pause")
    until(lambda: sim.n_steps > 2, "for the space bar to run it")
    page.command("Play or pause")
    until(lambda: not source.running)


def test_the_engine_keeps_the_pauses_of_slow_motion():
    """Late steps are caught up, but no more than a quarter of a second of them."""
    now, begun = [100.0], []
    took = [0.0, 0.03, 0.0, 5.0, 0.0, 0.0, 0.0, 0.0]

    class Clock(Source):
        kind = "clock"

        def advance(self, state):
            if len(begun) == len(took):
                return None
            now[0] += took[len(begun)]
            begun.append(now[0])
            return 0.1

    def sleep(seconds):
        now[0] += seconds

    engine = Engine(Clock("clock"), State(), clock=lambda: now[0], sleep=sleep)
    try:
        until(lambda: len(begun) == len(took))
    finally:
        engine.close()
    passed = np.subtract(begun, 100.0)
    assert passed[:3] == pytest.approx([0.0, 0.13, 0.2])
    assert passed[3:] == pytest.approx([5.3, 5.3, 5.3, 5.3, 5.35])
    source = open_source(gb.Simulation("dam-break", spacing=0.1))
    sim = source.simulation
    source.play(True)
    for speed in (1.0, 0.1):
        source.speed, before = speed, sim.time
        assert source.advance(State()) == pytest.approx((sim.time - before) / speed)
    source.close()


def test_a_simulation_that_fails_says_so_and_stands_still(dam):
    page, source = dam.program(), dam.viewer.source
    step = source.simulation.step

    def broken():
        raise ArithmeticError("particle 7 (water) got a velocity that is not a number")

    source.simulation.step = broken
    page.ask("play")
    page.heard("particle 7 (water)")
    until(lambda: not source.running)
    source.simulation.step = step
    page.ask("step")
    until(lambda: source.simulation.n_steps == 1)


def share(page, point) -> tuple[float, float]:
    size = page.client.frame.size
    return tuple(page.client.camera.project([point], size)[0] / size)


def test_a_scalpel_stroke_cuts_as_deep_as_asked():
    with Watched(gb.Simulation("cut-block", spacing=0.004)) as watched:
        page, source = watched.program(), watched.viewer.source
        page.hand.use("Cut")
        source.cut_depth = 0.012
        sim = source.simulation
        tissue = sim.positions[sim.arrays.phase == list(sim.phases).index("block")]
        where = np.array([share(page, p) for p in tissue])
        x = where[:, 0].mean()
        begin, end = ((x, where[:, 1].min() - 0.1), (x, where[:, 1].max() + 0.1))
        page.hand._drawn("start", begin, begin)
        for y in np.linspace(begin[1], end[1], 4):
            page.hand._drawn("move", begin, (x, y))
        assert [mark.text for mark in page.client.marks] == ["12 mm deep"]
        assert source.n_cut == 0  # a preview: the button is still down
        page.hand._drawn("end", begin, end)
        assert source.n_cut > 10
        assert sim.tissue.n_pieces == 1


REST = {"time": 0, "position": [0.2, 0.15, 0.3], "on": False}
POOL = {
    "spacing": 0.02,
    "domain": {"lo": [0, 0, 0], "hi": [0.4, 0.3, 0.4], "walls": True},
    "fluids": [{"name": "water", "box": {"lo": [0, 0, 0], "hi": [0.4, 0.3, 0.1]}}],
    "instruments": [{"name": "sucker", "kind": "suction", "radius": 0.05, "keys": [REST]}],
}


def test_an_emitter_is_switched_off_and_on():
    tap = {"name": "tap", "fluid": "water", "radius": 0.04, "rate": 0.005}
    tap |= {"center": [0.2, 0.15, 0.35], "direction": [0, 0, -1]}
    with Watched(gb.Simulation(POOL | {"emitters": [tap]})) as watched:
        page, source = watched.program(answers=False), watched.viewer.source
        sim = source.simulation
        page.set("Emitter tap", False)
        until(lambda: not sim.emitters["tap"].on)
        page.ask("play")
        until(lambda: sim.n_steps > 6)
        assert sim.emitters["tap"].emitted == 0
        page.set("Emitter tap")
        until(lambda: sim.emitters["tap"].emitted > 5, "for water to come")
        page.set("Emitter tap", False)
        until(lambda: not sim.emitters["tap"].on)
        page.ask("reset")
        until(lambda: sim.emitters["tap"].on, "for the start")
        until(lambda: page.controls["Emitter tap"]["value"] is True, "for the control to say it")
        assert not source.by_hand
        assert sim.emitters["tap"].emitted == 0


@pytest.fixture
def pool():
    with Watched(gb.Simulation(POOL)) as watched:
        yield watched


@pytest.mark.slow
def test_suction_follows_a_stroke_on_the_surface(pool):
    page, source = pool.program(), pool.viewer.source
    sim, tool = source.simulation, source.simulation.tools["sucker"]
    steps(source, 3)
    assert sim.record.n_removed == 0
    page.hand.use("Suction")
    places = [share(page, (x, 0.15, 0.1)) for x in np.linspace(0.1, 0.3, 4)]
    page.hand._drawn("start", places[0], places[0])
    for place in places:
        page.hand._drawn("move", places[0], place)
        steps(source, 10)
    assert sim.record.n_removed > 20
    assert abs(tool.pose[0, 3] - 0.3) < 0.08  # the tip is where the pointer is
    assert tool.pose[2, 3] < 0.2
    page.hand._drawn("end", places[0], places[-1])
    steps(source, 5)
    removed = sim.record.n_removed
    assert tool.pose[2, 3] > 0.25
    steps(source, 5)
    assert sim.record.n_removed == removed


def test_suction_follows_its_handle(pool):
    page, source = pool.program(), pool.viewer.source
    sim, tool = source.simulation, source.simulation.tools["sucker"]
    page.set("Move sucker by hand")
    (handle,) = until(lambda: page.model["handles"], "for the handle")
    assert (handle["label"], handle["turns"], np.shape(handle["axes"])) == ("sucker", True, (3, 3))
    first = pool.still(page)
    for axes in (np.ones((3, 3)), -np.eye(3)):
        page.ask("handle", ["instrument sucker", [0.2, 0.15, 0.08], axes.tolist()])
        page.heard("expected the axes of a rotation")
    page.ask("handle", ["instrument sucker", [0.2, 0.15, 0.08], np.eye(3).tolist()])
    until(lambda: tool._wanted is not None, "for the handle to move")
    assert np.allclose(tool._wanted[:3, 3], (0.2, 0.15, 0.08), atol=1e-3)
    steps(source, 10)
    assert sim.record.n_removed > 20
    pool.viewer.engine.notify()
    pool.still(page, lambda p: (p != first).any())
    page.set("Move sucker by hand", False)
    until(lambda: tool._wanted is None)
    steps(source, 3)
    assert tool.pose[2, 3] > 0.25
