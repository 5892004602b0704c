"""Handles of cuts in a real browser: a person drags them, and no stroke of a tool does."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("viser")
from globule.viewer.overlay import project
from globule.viewer.page.cut_handles import SIZE
from viewer_helpers import Watched, blob, choose, drag_along, next_frame, stroke, take_tool, until

BROWSERS = True  # see hang_guard
pytestmark = [pytest.mark.browser, pytest.mark.slow]


@pytest.fixture
def watched(chromium):
    made = Watched(blob(), chromium)
    yield made
    made.close()


def arrow(watched, page) -> tuple[float, float]:
    """Where the window shows the arrow along the plane's normal."""
    place, cuts = watched.viewer.placement, watched.viewer.state.cuts
    tip = place.to_world(np.add(place.to_page(cuts.point), 0.7 * SIZE * np.array(cuts.normal)))
    box = page.locator("canvas").first.bounding_box()
    x, y = project(page.client.camera, (box["width"], box["height"]), tip)
    return box["x"] + x, box["y"] + y


def drag_arrow(watched, page) -> None:
    cuts = watched.viewer.state.cuts
    before, at = cuts.point, arrow(watched, page)
    drag_along(page, np.linspace(at, (at[0] - 50, at[1] + 8), 10))
    page.mouse.up()
    until(lambda: watched.viewer.state.cuts.point != before, "for the handle to move the plane")


def test_a_stroke_never_drags_a_handle(watched):
    page, state = watched.page(), watched.viewer.state
    hands = watched.viewer.page.tools.hands
    page.get_by_role("button", name="Skip").click()
    page.keyboard.press("c")
    until(lambda: state.cuts.plane)
    (handles,) = watched.viewer.page.panels[3].handles.values()
    until(lambda: handles.plane.visible)
    page.wait_for_timeout(500)
    drag_arrow(watched, page)
    take_tool(page, "Cut")
    assert not handles.plane.visible
    drawn = []
    cut = watched.viewer.cut_along

    def cut_along(points, camera):
        said = cut(points, camera)
        drawn.append(points)
        return said

    watched.viewer.cut_along = cut_along
    for k in range(3):  # the handle of the last stroke's plane would stand in the way of the next
        camera = page.client.camera
        stroke(page, (300, 200), (420, 560))
        until(lambda k=k: len(drawn) == k + 1, "for the stroke")
        ends = np.array([drawn[-1][0], drawn[-1][-1]])
        assert state.cuts.point == pytest.approx(ends.mean(axis=0).tolist(), abs=1e-6)
        assert page.client.camera == camera
        watched.still(page)
    choose(page, "Mouse tool", next(iter(hands.values())).choices[0])
    until(lambda: handles.plane.visible, "for the handle to come back")
    page.wait_for_timeout(500)
    drag_arrow(watched, page)
    page.mouse.move(330, 690)
    next_frame(page)
    camera = page.client.camera
    stroke(page, (330, 690), (390, 720))
    until(lambda: page.client.camera != camera, "for a drag to turn the view again")


def test_a_handle_that_vanishes_under_the_mouse_lets_go(watched):
    page, state = watched.page(), watched.viewer.state
    page.get_by_role("button", name="Skip").click()
    page.keyboard.press("c")
    (handles,) = watched.viewer.page.panels[3].handles.values()
    until(lambda: handles.plane.visible)
    page.wait_for_timeout(500)
    before, at = state.cuts.point, arrow(watched, page)
    drag_along(page, np.linspace(at, (at[0] - 50, at[1] + 8), 10))
    until(lambda: state.cuts.point != before)
    page.keyboard.press("c")
    until(lambda: not handles.plane.visible)
    next_frame(page)
    page.mouse.up()
    assert handles._dragged is None
    take_tool(page, "Cut")
    stroke(page, (300, 200), (420, 560))
    until(lambda: state.cuts.plane, "for the stroke to set the plane again")
    camera = page.client.camera
    choose(page, "Mouse tool", "Rotate, pick")
    stroke(page, (330, 690), (390, 720))
    until(lambda: page.client.camera != camera, "for a drag to turn the view again")
