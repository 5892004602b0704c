"""Simulations in a real browser: run, step, reset, cut and pull."""

from __future__ import annotations

import time

import globule as gb
import numpy as np
import pytest
from viewer_helpers import (
    Watched,
    choose,
    differs,
    drag_along,
    next_frame,
    open_folder,
    seen,
    stroke,
    take_tool,
    until,
)

BROWSERS = True  # see hang_guard
pytestmark = [pytest.mark.browser, pytest.mark.slow]


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
    until(lambda: sim.n_steps == 1 and "paused" in dam.viewer.source.status())
    dam.still(page, differs(first, 0))
    assert sim.n_steps == 1
    press(page, "Run")
    until(lambda: sim.time > 0.15, "for time to pass")
    press(page, "Pause")
    until(lambda: "**paused**" in dam.viewer.source.status(), "for the last step to end")
    at = sim.time
    dam.still(page, differs(first, 0.5))
    page.get_by_text("paused", exact=True).wait_for()
    assert sim.time == at
    press(page, "Reset")
    until(lambda: sim.n_steps == 0 and sim.hash() == begin, "for the state of the start")
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
    open_folder(page, "Color by value")
    choose(page, "Color by", "speed")
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


def test_recording_a_simulation_shows_it_moving(dam, tmp_path, monkeypatch):
    av = pytest.importorskip("av")
    from globule.viewer import recording

    shots = []
    shot = recording.Shot
    monkeypatch.setattr(recording, "Shot", lambda *of: shots.append(of) or shot(*of))
    viewer = dam.viewer
    recorder = recording.Recorder(
        viewer.engine, lambda: viewer.first_camera, tmp_path / "dam.mp4", (160, 96), 20.0
    )
    viewer.source.play(True)
    viewer.engine.notify()
    until(lambda: viewer.source.simulation.time > 0.2)
    begun = len(shots)  # a busy machine repeats one of the first step until then
    until(lambda: len(shots) > begun + 1 and recorder.n_pictures > 5)
    recorder.stop()
    with av.open(str(tmp_path / "dam.mp4")) as movie:
        pictures = [f.to_ndarray(format="rgb24").astype(int) for f in movie.decode(video=0)]
    assert len(pictures) == recorder.n_pictures > 5
    assert np.abs(pictures[-1] - pictures[0]).mean() > 0.3


@pytest.fixture
def block(chromium):
    watched = Watched(gb.Simulation("cut-block", spacing=0.003), chromium)
    yield watched
    watched.close()


def outline(watched, page) -> np.ndarray:
    """Where the tissue is in the window: columns and rows of its pixels."""
    source = watched.viewer.source
    box = page.locator("canvas").first.bounding_box()
    size = (round(box["width"]), round(box["height"]))
    with source.lock:
        phase = list(source.simulation.phases).index("block")
        where = source.simulation.positions[source.simulation.arrays.phase == phase]
    from globule.viewer.overlay import project

    return np.array([project(page.client.camera, size, p) for p in where])


def test_a_scalpel_stroke_leaves_two_pieces(block):
    page, sim = block.page(), block.viewer.source.simulation
    assert sim.tissue.n_pieces == 1
    block.viewer.source.cut_depth = None  # all through
    take_tool(page, "Cut")
    page.get_by_text("Draw a line across the surface to cut it.", exact=True).first.wait_for()
    where = outline(block, page)
    middle = where.mean(axis=0)
    stroke(page, (middle[0], where[:, 1].min() - 40), (middle[0], where[:, 1].max() + 40))
    until(lambda: sim.tissue.n_pieces == 2 and block.viewer.source.n_cut > 20, "for the cut")
    open_folder(page, "Statistics")
    page.get_by_text("pieces", exact=True).wait_for()


def test_a_shallow_stroke_leaves_one_piece(block):
    page, source = block.page(), block.viewer.source
    source.cut_depth = 0.012
    take_tool(page, "Cut")
    page.get_by_text("Draw a line across the surface to cut it.", exact=True).first.wait_for()
    where = outline(block, page)
    middle = where.mean(axis=0)
    ends = (middle[0], where[:, 1].min() - 40), (middle[0], where[:, 1].max() + 40)
    drag_along(page, np.linspace(*ends, 13))
    until(lambda: [m.text for m in page.client.marks] == ["12 mm deep"], "for the depth")
    assert source.n_cut == 0  # a preview: the button is still down
    page.mouse.up()
    until(lambda: source.n_cut > 0, "for the cut")
    assert source.simulation.tissue.n_pieces == 1


def test_grasping_pulls_tissue(block):
    page, source = block.page(), block.viewer.source
    sim = source.simulation
    take_tool(page, "Grasp")
    page.get_by_text(
        "Run the simulation, then drag a part of the surface.", exact=True
    ).first.wait_for()
    phase = list(sim.phases).index("block")
    before = sim.positions[sim.arrays.phase == phase]
    where = outline(block, page)
    source.play(True)
    block.viewer.engine.notify()

    def steps(page) -> None:
        at = sim.n_steps
        until(lambda: sim.n_steps > at + 2, "for the simulation to go on")

    middle = where.mean(axis=0)
    drag_along(page, np.linspace(middle, middle - (0, 130), 14), each=steps)

    def moved() -> bool:
        with source.lock:
            now = sim.positions[sim.arrays.phase == phase]
        return np.linalg.norm(now - before, axis=1).max() > 0.006

    until(moved, "for the tissue to follow")
    page.mouse.up()
    until(lambda: source._held is None, "for the grasp to let go")


def test_instruments_move_by_hand(block):
    page, source = block.page(), block.viewer.source
    name, tool = next(iter(source.simulation.tools.items()))
    page.get_by_label(f"Move {name} by hand", exact=True).check()
    began = tool.pose.copy()
    pose = began.copy()
    pose[:3, 3] += (0.0, 0.02, 0.0)
    first = block.still(page)
    source.move(name, pose)
    source.step()
    block.viewer.engine.notify()
    until(lambda: np.allclose(tool.pose, pose))
    block.still(page, lambda p: p.shape == first.shape and (p != first).any())
    page.get_by_label(f"Move {name} by hand", exact=True).uncheck()
    until(lambda: tool._wanted is None)


TAP = """
title = "Tap"
spacing = 0.02
[domain]
lo = [0, 0, 0]
hi = [0.3, 0.3, 0.5]
walls = true
[[fluids]]
name = "water"
box = { lo = [0, 0, 0], hi = [0.3, 0.3, 0.06] }
density = 1000
[[emitters]]
name = "tap"
fluid = "water"
center = [0.15, 0.15, 0.4]
direction = [0, 0, -1]
radius = 0.04
rate = 0.005
"""


def test_an_emitter_is_switched_off_and_on(chromium, tmp_path):
    (tmp_path / "tap.toml").write_text(TAP)
    watched = Watched(str(tmp_path / "tap.toml"), chromium)
    try:
        page, source = watched.page(), watched.viewer.source
        sim = source.simulation
        box = page.get_by_label("Emitter tap", exact=True)
        assert box.is_checked()
        box.uncheck()
        until(lambda: not sim.emitters["tap"].on)
        press(page, "Run")
        until(lambda: sim.n_steps > 6)
        assert sim.emitters["tap"].emitted == 0
        box.check()
        until(lambda: sim.emitters["tap"].emitted > 5, "for water to come")
        box.uncheck()
        until(lambda: not sim.emitters["tap"].on)
        press(page, "Reset")
        until(lambda: sim.emitters["tap"].on and box.is_checked(), "for the start")
        assert not source.by_hand
        assert sim.emitters["tap"].emitted == 0
    finally:
        watched.close()


POOL = """
title = "Pool"
spacing = 0.02
[domain]
lo = [0, 0, 0]
hi = [0.4, 0.3, 0.4]
walls = true
[[fluids]]
name = "water"
box = { lo = [0, 0, 0], hi = [0.4, 0.3, 0.1] }
density = 1000
[[instruments]]
name = "sucker"
kind = "suction"
radius = 0.05
keys = [{ time = 0, position = [0.2, 0.15, 0.3], on = false }]
"""


@pytest.fixture
def pool(chromium, tmp_path):
    (tmp_path / "pool.toml").write_text(POOL)
    watched = Watched(str(tmp_path / "pool.toml"), chromium)
    yield watched
    watched.close()


def window(page) -> tuple[float, float]:
    box = page.locator("canvas").first.bounding_box()
    return box["width"], box["height"]


def test_suction_follows_a_stroke_on_the_surface(pool):
    from globule.viewer.overlay import project

    page, source = pool.page(), pool.viewer.source
    sim = source.simulation
    take_tool(page, "Suction")
    text = "Run the simulation, then drag over the fluid to remove it."
    page.get_by_text(text, exact=True).first.wait_for()
    press(page, "Run")
    until(lambda: sim.n_steps > 3)
    assert sim.record.n_removed == 0
    camera = page.client.camera
    begin, end = (project(camera, window(page), (x, 0.15, 0.1)) for x in (0.1, 0.3))

    def steps(page) -> None:
        at = sim.n_steps
        until(lambda: sim.n_steps > at, "for the simulation to go on")

    drag_along(page, np.linspace(begin, end, 13), each=steps)
    until(lambda: sim.record.n_removed > 30, "for water to go")
    tool = sim.tools["sucker"]
    until(lambda: abs(tool.pose[0, 3] - 0.3) < 0.08, "for the tip to come to the pointer")
    assert tool.pose[2, 3] < 0.2
    page.mouse.up()
    until(lambda: tool._wanted is None, "for the stroke to end")
    removed = until(lambda: tool.pose[2, 3] > 0.25 and sim.record.n_removed)
    at = sim.n_steps
    until(lambda: sim.n_steps > at + 5)
    assert sim.record.n_removed == removed
    assert page.client.camera == camera


def test_suction_follows_its_handle(pool):
    from globule.viewer.overlay import project

    page, source = pool.page(), pool.viewer.source
    sim = source.simulation
    without = seen(page)
    page.get_by_label("Move sucker by hand", exact=True).check()
    until(lambda: differs(without, 0.05)(seen(page)), "for the handle")
    camera, scale = page.client.camera, pool.viewer.placement.scale
    tip = np.array([0.2, 0.15, 0.3])
    arrow, middle = (project(camera, window(page), tip + (0, 0, up)) for up in (0.2 / scale, 0.0))
    below = project(camera, window(page), tip - (0, 0, 0.2))
    stroke(page, arrow, np.add(arrow, np.subtract(below, middle)))
    tool = sim.tools["sucker"]
    until(lambda: tool._wanted is not None and tool._wanted[2, 3] < 0.15, "for the handle to move")
    assert np.allclose(tool._wanted[:2, 3], tip[:2], atol=0.01)
    press(page, "Run")
    until(lambda: sim.record.n_removed > 20, "for water to go")
    page.get_by_label("Move sucker by hand", exact=True).uncheck()
    until(lambda: sim.tools["sucker"].pose[2, 3] > 0.25)


GAMEPAD = """() => {
  const buttons = Array.from({ length: 17 }, () => ({ pressed: false }));
  window.pad = { connected: true, axes: [0, 0, 0, 0], buttons };
  navigator.getGamepads = () => [window.pad];
  dispatchEvent(new Event("gamepadconnected"));
}"""
CROSS = """() => {
  const s = document.getElementById("globule-pad")?.style;
  return s && [parseFloat(s.left), parseFloat(s.top)];
}"""


def push(page, stick: int, value: float) -> None:
    page.evaluate("([i, v]) => { window.pad.axes[i] = v; }", [stick, value])
    next_frame(page)


def hold(page, pressed: bool) -> None:
    page.evaluate("on => { window.pad.buttons[0].pressed = on; }", pressed)
    next_frame(page)


def steer(page, to) -> None:
    """Push the left stick until the cross is at a place in the window."""
    for axis in (0, 1):
        push(page, axis, 0.2)
        page.wait_for_function("() => document.getElementById('globule-pad')")
        for _ in range(400):
            away = float(to[axis]) - page.evaluate(CROSS)[axis]
            if abs(away) < 4:
                break
            push(page, axis, np.sign(away) * min(1.0, max(0.17, abs(away) / 80)))
        push(page, axis, 0)


def test_a_gamepad_cuts_and_turns(block):
    page, source = block.page(), block.viewer.source
    take_tool(page, "Cut")
    page.evaluate(GAMEPAD)
    where = outline(block, page)
    middle = where.mean(axis=0)
    steer(page, (middle[0], where[:, 1].min() - 40))
    hold(page, True)
    steer(page, (middle[0], where[:, 1].max() + 40))
    hold(page, False)
    until(lambda: source.n_cut > 20, "for the cut")
    eye = np.array(page.client.camera.eye)
    push(page, 2, 1.0)
    until(lambda: np.linalg.norm(page.client.camera.eye - eye) > 0.01, "for the camera to turn")
    push(page, 2, 0)
