"""Simulations in a real browser: run, step, reset, cut and pull."""

from __future__ import annotations

import time

import globule as gb
import numpy as np
import pytest
from viewer_helpers import Watched, browser, choose, open_folder, until


@pytest.fixture(autouse=True)
def hang_guard():
    """Browsers take their time; `until` has a limit of its own."""


@pytest.fixture(scope="module")
def chromium():
    with browser() as opened:
        yield opened


@pytest.fixture
def dam(chromium):
    watched = Watched(gb.Simulation("dam-break", spacing=0.05), chromium)
    yield watched
    watched.close()


def press(page, name: str) -> None:
    page.get_by_role("button", name=name, exact=True).click()


def test_play_advances_time_and_reset_goes_back(dam):
    page, sim = dam.page(), dam.viewer.source.simulation
    first, begin = dam.still(page), sim.hash()
    press(page, "Step")
    until(lambda: sim.n_steps == 1)
    time.sleep(0.3)
    assert sim.n_steps == 1
    press(page, "Run")
    until(lambda: sim.time > 0.15, "for time to pass")
    press(page, "Pause")
    until(lambda: not dam.viewer.source.running)
    later = dam.still(page, lambda p: p.shape == first.shape and (p != first).any())
    assert np.abs(later.astype(int) - first).mean() > 0.5
    at = sim.time
    time.sleep(0.5)
    assert sim.time == at
    press(page, "Reset")
    until(lambda: sim.n_steps == 0)
    assert sim.hash() == begin
    dam.still(page, lambda p: p.shape == first.shape and np.array_equal(p, first))
    page.mouse.move(330, 380)
    page.keyboard.press("Space")
    until(lambda: sim.n_steps > 2, "for the space bar to run it")
    page.keyboard.press("Space")
    until(lambda: not dam.viewer.source.running)


def test_slow_motion_is_slower(dam):
    source = dam.viewer.source
    source.speed = 0.05
    source.play(True)
    dam.viewer.engine.notify()
    until(lambda: source.simulation.n_steps > 3)
    began, time_then = time.monotonic(), source.simulation.time
    until(lambda: source.simulation.n_steps > 12)
    passed = time.monotonic() - began
    assert source.simulation.time - time_then < 0.05 * (passed + 0.5)


def test_colours_of_values_follow_the_simulation(dam):
    page = dam.page()
    plain = dam.still(page)
    open_folder(page, "Colour by value")
    choose(page, "Colour by", "velocity")
    dam.viewer.source.play(True)
    dam.viewer.engine.notify()
    until(lambda: dam.viewer.source.simulation.time > 0.1)
    dam.viewer.source.play(False)
    colored = dam.still(page, lambda p: p.shape == plain.shape and (p != plain).any())
    assert dam.viewer.source.maker.range[1] > 0.5
    assert np.abs(colored.astype(int) - plain).mean() > 1


def test_a_simulation_that_fails_says_so_and_stands_still(dam):
    page, source = dam.page(), dam.viewer.source
    step = source.simulation.step

    def broken():
        raise ArithmeticError("particle 7 (water) got a velocity that is not a number")

    source.simulation.step = broken
    press(page, "Run")
    page.get_by_text("particle 7 (water)").first.wait_for()
    until(lambda: not source.running)
    source.simulation.step = step
    press(page, "Step")
    until(lambda: source.simulation.n_steps == 1)


def test_recording_a_simulation_shows_it_moving(dam, tmp_path):
    av = pytest.importorskip("av")
    from globule.viewer.recording import Recorder

    viewer = dam.viewer
    recorder = Recorder(viewer.engine, lambda: viewer.first_camera, tmp_path / "dam.mp4",
                        (160, 96), 20.0)
    viewer.source.play(True)
    viewer.engine.notify()
    until(lambda: viewer.source.simulation.time > 0.2)
    recorder.stop()
    with av.open(str(tmp_path / "dam.mp4")) as movie:
        pictures = [f.to_ndarray(format="rgb24").astype(int) for f in movie.decode(video=0)]
    assert len(pictures) == recorder.n_pictures > 5
    assert np.abs(pictures[-1] - pictures[0]).mean() > 0.3
