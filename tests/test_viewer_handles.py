"""Handles of cuts in a real browser: a person drags them, and no stroke of a tool does."""

import globule as gb
import numpy as np
import pytest

pytest.importorskip("websockets")
from globule.viewer.picture import sun_direction
from test_viewer_simulation import POOL
from viewer_helpers import Watched, blob, drag_along, middle, next_frame, open_section, stroke, take_tool, until

BROWSERS = True  # see hang_guard
pytestmark = [pytest.mark.browser, pytest.mark.slow]


def drag(page, tip, by, release=True) -> None:
    tip.wait_for()
    next_frame(page)
    box = tip.bounding_box()
    at = np.array([box["x"] + box["width"] / 2, box["y"] + box["height"] / 2])
    drag_along(page, np.linspace(at, at + by, 4))
    if release:
        page.mouse.up()


def drag_arrow(watched, page) -> None:
    cuts = watched.viewer.state.cuts
    before = cuts.point
    drag(page, page.locator("[data-handle=plane] circle"), (-30, 5), release=False)
    until(lambda: cuts.point != before, "for the handle to move the plane")
    assert page.client.camera == watched.seen


def turn(page) -> None:
    camera, at = page.client.camera, middle(page)
    stroke(page, at + (-120, 180), at + (-80, 200))
    until(lambda: page.client.camera != camera, "for a drag to turn the view again")


def test_a_stroke_never_drags_a_handle(chromium):
    with Watched(blob(150), chromium) as watched:
        page, cuts = watched.page(), watched.viewer.state.cuts
        page.keyboard.press("c")
        until(lambda: cuts.plane)
        arrow = page.locator("[data-handle=plane]")
        watched.seen = page.client.camera
        drag_arrow(watched, page)
        page.mouse.up()
        take_tool(page, "Cut")
        arrow.wait_for(state="detached")
        drawn, cut = [], watched.viewer.cut_along
        watched.viewer.cut_along = lambda points, camera: drawn.append(points) or cut(points, camera)
        camera, ends = page.client.camera, np.add(middle(page), ((-60, -60), (60, 80)))
        for k in (1, 2):  # the handle of the last stroke's plane would stand in the way
            stroke(page, *ends)
            until(lambda k=k: len(drawn) == k, "for the stroke")
            watched.still(page)
            along = np.mean([drawn[-1][0], drawn[-1][-1]], axis=0)
            assert (cuts.point, page.client.camera) == (pytest.approx(along.tolist(), abs=1e-6), camera)
        page.hand.use("Rotate, pick")
        arrow.wait_for()
        drag_arrow(watched, page)
        page.keyboard.press("c")  # it vanishes under the mouse, and lets go
        arrow.wait_for(state="detached")
        page.mouse.up()
        turn(page)
        take_tool(page, "Cut")
        stroke(page, *ends)
        until(lambda: cuts.plane, "for the stroke to set the plane again")
        page.hand.use("Rotate, pick")
        turn(page)


def test_the_keyboard_moves_a_handle_and_a_finger_turns_and_zooms(chromium):
    with Watched(blob(150), chromium) as watched:
        page, cuts = watched.page(), watched.viewer.state.cuts
        page.keyboard.press("c")
        until(lambda: cuts.plane)
        page.get_by_role("slider", name="Cutting plane, along its normal").focus()
        before = np.array(cuts.point)
        page.keyboard.press("ArrowUp")
        until(lambda: cuts.point != tuple(before))
        assert np.dot(cuts.point - before, cuts.normal) > 0
        assert np.allclose(np.cross(cuts.point - before, cuts.normal), 0, atol=1e-9)
        touch, at = page.context.new_cdp_session(page), middle(page) - (60, 0)

        def fingers(kind, *places):
            points = [{"x": x, "y": y, "id": i} for i, (x, y) in enumerate(places)]
            touch.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})

        def far() -> float:
            return float(np.linalg.norm(np.subtract(page.client.camera.eye, page.client.camera.look_at)))

        camera, first = page.client.camera, far()
        fingers("touchStart", at)
        for i in range(1, 6):
            fingers("touchMove", at + (8 * i, 0))
        fingers("touchEnd")
        until(lambda: page.client.camera != camera, "for a finger to turn the view")
        assert abs(far() - first) < 1e-3 * first
        fingers("touchStart", at - (40, 0), at + (40, 0))
        for i in range(1, 6):
            fingers("touchMove", at - (40 + 8 * i, 0), at + (40 + 8 * i, 0))
        fingers("touchEnd")
        until(lambda: far() < 0.7 * first, "for two fingers to zoom")


def test_the_sun_and_an_instrument_in_a_browser(chromium):
    """The arrow of the sun swings; a ring of an instrument turns it, and its arrows move it."""
    with Watched(blob(150), chromium) as watched:
        page, look = watched.page(), watched.viewer.state.look
        watched.viewer.state.set(look__lights="own")
        open_section(page, "Light")
        open_section(page, "Layer")
        page.locator("[data-handle=sun]").wait_for(state="detached")
        open_section(page, "Light")
        before, right = look.azimuth, page.client.camera.frame((1, 1))[2]
        sun = np.array(sun_direction(look, watched.viewer.up))
        drag(page, page.locator("[data-handle=sun] circle"), (30, 0))
        until(lambda: look.azimuth != before, "for the sun to turn")
        assert np.dot(sun_direction(look, watched.viewer.up) - sun, right) > 0.05
    with Watched(gb.Simulation(POOL), chromium) as watched:
        page, source = watched.page(), watched.viewer.source
        open_section(page, "Simulation")
        page.get_by_label("Move sucker by hand", exact=True).check()
        tool = source.simulation.tools["sucker"]
        play = next(panel for panel in watched.viewer.page.panels if hasattr(panel, "held"))
        page.locator("[data-handle='instrument sucker']").wait_for()
        before = np.array(play.held["sucker"])
        page.get_by_role("slider", name="sucker, along x").focus()
        page.keyboard.press("ArrowRight")
        until(lambda: not np.allclose(play.held["sucker"][:3, 3], before[:3, 3]), "for it to move")
        away = play.held["sucker"][:3, 3] - before[:3, 3]
        assert np.allclose(np.cross(away, before[:3, 0]), 0, atol=1e-9)
        page.get_by_role("slider", name="sucker, around z").focus()
        page.keyboard.press("ArrowRight")
        until(lambda: not np.allclose(play.held["sucker"][:3, :3], before[:3, :3]), "for it to turn")
        turn = before[:3, :3].T @ play.held["sucker"][:3, :3]
        assert np.degrees(np.arctan2(turn[1, 0], turn[0, 0])) == pytest.approx(5, abs=1e-3)
        until(lambda: tool._wanted is not None and np.allclose(tool._wanted, play.held["sucker"]))
