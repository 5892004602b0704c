"""The viewer's page in a real browser: what `make test` looks at; other files have the rest."""

import io
from contextlib import contextmanager

import numpy as np
import pytest
from PIL import Image
from viewer_helpers import (
    Watched,
    blob,
    drag_along,
    middle,
    open_section,
    silhouette,
    stroke,
    take_tool,
    type_number,
    until,
)

BROWSERS = True  # see hang_guard
pytestmark = pytest.mark.browser


@pytest.fixture(scope="module")
def shared(chromium):
    with Watched(blob(150), chromium, demand_token=True) as made:
        made.page()
        yield made


@pytest.fixture
def watched(shared):
    shared.viewer.state.load_toml("[quality]\nsamples = 1\n")
    return shared


def shows(page, picture: np.ndarray) -> bool:
    """Whether the middle of a browser's image is a picture's, but for JPEG and the size."""
    box = page.locator("canvas").first.bounding_box()
    with Image.open(io.BytesIO(page.screenshot(clip=box))) as image:
        shown = np.asarray(image.convert("RGB"))
    small = np.asarray(Image.fromarray(picture).resize(shown.shape[1::-1]), int)
    rows, columns = (slice(n // 3, 2 * n // 3) for n in shown.shape[:2])
    return np.abs(small[rows, columns] - shown[rows, columns].astype(int)).mean() < 4


def test_the_page_shows_the_servers_picture_and_asks_nobody_else(watched):
    (page,) = watched.pages
    assert page.title() == "150 particles · globule"
    picture = watched.still(page)
    until(lambda: shows(page, picture), "for the browser to show it")
    own = watched.viewer.address.split("/")[2]
    assert watched.requests
    for address in watched.requests:
        assert own in address or address.startswith("data:"), address


def test_dragging_moves_the_servers_camera(watched):
    (page,) = watched.pages
    before, first = watched.still(page), page.client.camera
    at = middle(page)
    stroke(page, at, at + (100, 40))
    until(lambda: page.client.camera != first)
    watched.still(page, lambda p: p.shape != before.shape or np.abs(p.astype(int) - before).mean() > 1)
    moved = page.client.camera
    assert moved.look_at == pytest.approx(first.look_at, abs=1e-6)
    away = [np.linalg.norm(np.subtract(c.eye, c.look_at)) for c in (first, moved)]
    assert away[0] == pytest.approx(away[1], rel=1e-3)
    page.mouse.wheel(0, -300)

    def nearer() -> bool:
        camera = page.client.camera
        return np.linalg.norm(np.subtract(camera.eye, camera.look_at)) < 0.97 * away[1]

    until(nearer, "for the wheel to zoom")
    drag_along(page, [at, at + (40, 0)], "right")
    page.mouse.up(button="right")
    until(lambda: page.client.camera.look_at != pytest.approx(first.look_at, abs=1e-3))


def test_a_stroke_with_the_tool_cut_cuts(watched):
    (page,) = watched.pages
    before, camera = silhouette(watched.still(page)), page.client.camera
    take_tool(page, "Cut")
    at = middle(page)
    stroke(page, at - (120, 50), at + (120, 50))
    until(lambda: watched.viewer.state.cuts.plane, "for the cutting plane")
    assert page.client.camera == camera  # the stroke did not turn the view
    watched.still(page, lambda p: silhouette(p) < 0.9 * before)
    page.hand.use("Rotate, pick")


def test_a_number_of_the_inspector_changes_the_image_and_default_surface_takes_it_back(watched):
    (page,) = watched.pages
    before = silhouette(watched.still(page))
    open_section(page, "Layer")
    type_number(page, "Threshold", 1.8)
    assert silhouette(watched.still(page, lambda p: silhouette(p) < 0.9 * before)) > 0
    assert watched.viewer.state.surface.threshold == pytest.approx(1.8)
    page.get_by_role("button", name="Default surface").click()
    watched.still(page, lambda p: silhouette(p) == pytest.approx(before, rel=0.02))


@contextmanager
def looking(watched):
    (steering,) = watched.pages
    viewer = watched.viewer
    known = set(viewer.clients)
    with steering.context.expect_page() as opened:  # a tab with the steering page's cookies
        steering.evaluate("address => { open(address); }", viewer.look_address)
    try:
        until(lambda: set(viewer.clients) - known, "for the second browser")
        yield opened.value, viewer.clients[max(viewer.clients)]
    finally:
        opened.value.close()


def cutting_plane(page):
    return page.locator("#globule-desk").get_by_role("button", name="Cutting plane")


@pytest.mark.slow
def test_who_looks_cannot_steer_also_after_both_connect_again(watched):
    (steering,) = watched.pages
    viewer, before = watched.viewer, steering.client.camera
    with looking(watched) as (page, own):
        assert (steering.client.role, own.role) == ("steer", "look")
        page.get_by_role("button", name="Layers").click()
        page.locator("#globule-desk").get_by_text("You look · 2 of 16 browsers").wait_for()
        page.get_by_role("button", name="Layers").click()
        plane = cutting_plane(page)
        assert plane.is_disabled()
        cutting_plane(steering).click()
        page.wait_for_function("b => b.ariaPressed == 'true'", arg=plane.element_handle())
        assert viewer.state.cuts.plane
        cutting_plane(steering).click()
        until(lambda: not viewer.state.cuts.plane)
        other, at = own.camera, middle(page)
        stroke(page, at, at + (60, 30))
        until(lambda: own.camera != other, "for the camera to move")
        assert steering.client.camera == before
        open_section(page, "Image")
        assert page.get_by_label("Scale bar", exact=True).is_disabled()
    with looking(watched) as (page, _):
        known = set(viewer.clients)
        viewer.server.call(viewer.server.drop)
        until(lambda: len(set(viewer.clients) - known) == 2, "for both")
        assert sorted(client.role for client in viewer.clients.values()) == ["look", "steer"]
        until(cutting_plane(page).is_disabled)
        cutting_plane(steering).click()
        until(lambda: viewer.state.cuts.plane)
