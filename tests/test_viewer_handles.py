"""Handles of cuts in a real browser: a person drags them, and no stroke of a tool does."""

import numpy as np
import pytest

pytest.importorskip("viser")
from globule.viewer.page.cut_handles import SIZE
from viewer_helpers import Watched, blob, drag_along, middle, next_frame, stroke, take_tool, until

BROWSERS = True  # see hang_guard
pytestmark = [pytest.mark.browser, pytest.mark.slow]


def drag_arrow(watched, page) -> None:
    place, cuts = watched.viewer.placement, watched.viewer.state.cuts
    before, box = cuts.point, page.locator("canvas").first.bounding_box()
    tip = place.to_world(np.add(place.to_page(cuts.point), 0.7 * SIZE * np.array(cuts.normal)))
    (at,) = page.client.camera.project([tip], (box["width"], box["height"]))
    page.wait_for_function("() => window.__viserMutable?.nodeRefFromName?.['/cut/plane']?.visible")
    next_frame(page)
    drag_along(page, np.linspace(at, at + (-30, 5), 4))
    until(lambda: watched.viewer.state.cuts.point != before, "for the handle to move the plane")


def turn(page) -> None:
    camera, at = page.client.camera, middle(page)
    stroke(page, at + (-120, 180), at + (-80, 200))
    until(lambda: page.client.camera != camera, "for a drag to turn the view again")


def test_a_stroke_never_drags_a_handle(chromium):
    with Watched(blob(150), chromium) as watched:
        page, cuts = watched.page(), watched.viewer.state.cuts
        page.keyboard.press("c")
        until(lambda: cuts.plane)
        cuts_panel = next(p for p in watched.viewer.page.panels if hasattr(p, "handles"))
        (handles,) = cuts_panel.handles.values()
        drag_arrow(watched, page)
        page.mouse.up()
        until(lambda: handles._dragged is None, "for the handle's end")
        take_tool(page, "Cut")
        assert not handles.plane.visible
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
        until(lambda: handles.plane.visible, "for the handle to come back")
        drag_arrow(watched, page)
        page.keyboard.press("c")  # it vanishes under the mouse, and lets go
        until(lambda: not handles.plane.visible)
        page.mouse.up()
        assert handles._dragged is None
        turn(page)
        take_tool(page, "Cut")
        stroke(page, *ends)
        until(lambda: cuts.plane, "for the stroke to set the plane again")
        page.hand.use("Rotate, pick")
        turn(page)
