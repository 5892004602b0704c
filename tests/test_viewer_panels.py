"""Each group of controls, used in a real browser: its effect in the picture."""

from __future__ import annotations

import re

import globule as gb
import numpy as np
import pytest
from viewer_helpers import (
    Watched,
    blob,
    check,
    choose,
    differs,
    number_box,
    open_folder,
    seen,
    silhouette,
    stroke,
    take_tool,
    type_number,
    type_text,
    until,
)

BROWSERS = True  # see hang_guard
pytestmark = [pytest.mark.browser, pytest.mark.slow]  # quick ones: test_viewer_browser.py


@pytest.fixture(scope="module")
def shared(chromium):
    made = Watched(blob(), chromium)
    made.page()
    yield made
    made.close()


@pytest.fixture
def watched(shared):
    """The same page for all tests of one cloud, each with settings of its own."""
    page = shared.pages[0]
    shared.viewer.state.load_toml("[quality]\nsamples = 1\n")
    shared.viewer.clients[min(shared.viewer.clients)].mark([])
    page.reload()
    gone = page.client
    until(lambda: gone not in shared.viewer.clients.values())
    page.client = until(lambda: next(iter(shared.viewer.clients.values()), None))
    page.get_by_text("Help (H)").wait_for()
    shared.still(page)
    return shared


def test_numbers_end_as_they_are_typed(watched):
    page, state = watched.pages[0], watched.viewer.state
    open_folder(page, "Surface and quality")
    open_folder(page, "Material and light")
    for label, key, texts in (
        ("Support", "surface.support", ("0.5", "0.109", "1.05")),
        ("Threshold", "surface.threshold", ("0.35",)),
        ("Exposure", "look.exposure", ("0.5",)),
        ("Largest width", "quality.width", ("1200",)),
        ("JPEG quality when still", "quality.sharpness", ("85",)),
    ):
        group, name = key.split(".")
        settings = getattr(state, group)
        for text in texts:
            box = number_box(page, label)
            box.click()
            page.keyboard.press("Control+A")
            page.keyboard.type(text, delay=60)
            page.keyboard.press("Tab")
            until(
                lambda settings=settings, name=name, text=text: (
                    getattr(settings, name) == float(text)
                ),
                f"{label} {text}",
            )
            assert box.input_value() == text
    assert not page.get_by_text("Not possible").count()


def test_a_number_outside_of_its_ends_becomes_the_nearest(watched):
    page, state = watched.pages[0], watched.viewer.state
    open_folder(page, "Surface and quality")
    most = watched.viewer.page.binder.widgets["surface.support"].max
    type_number(page, "Support", "1000000000")
    until(lambda: state.surface.support == most, "for the end")
    page.get_by_text(f"expected 0.0875 to {most:g}, got 1e+09").first.wait_for()
    page.keyboard.press("Tab")
    until(lambda: number_box(page, "Support").input_value() == f"{most:g}")


def test_kernel_support_and_root_change_the_surface(watched):
    page = watched.pages[0]
    before = watched.still(page)
    open_folder(page, "Surface and quality")
    choose(page, "Kernel", "wendland_c2")
    wendland = watched.still(page, differs(before))
    type_number(page, "Support", 0.6)
    watched.still(page, lambda p: silhouette(p) > 1.1 * silhouette(wendland))
    watched.viewer.state.set(surface__kernel="murakami", surface__support=None)
    exact = watched.still(page, lambda p: silhouette(p) == silhouette(before))
    choose(page, "Root method", "march")
    marched = watched.still(page, lambda p: not np.array_equal(p, exact))
    assert silhouette(marched) > 0.8 * silhouette(exact)


def test_presets_shadows_and_lights_change_the_light(watched):
    page = watched.pages[0]
    plain = watched.still(page)
    open_folder(page, "Material and light")
    choose(page, "Preset", "water")
    water = watched.still(page, differs(plain, 5))
    assert watched.viewer.state.look.shadows
    check(page, "Shadows", False)
    bright = watched.still(page, differs(water, 0.3))
    assert bright.mean() > water.mean()
    choose(page, "Preset", "clay")
    clay = watched.still(page, differs(bright, 5))
    type_number(page, "Ambient occlusion", 0)
    watched.still(page, differs(clay, 0.3))
    choose(page, "Preset", "plain")
    watched.still(page, lambda p: np.array_equal(p, plain))
    choose(page, "Sky", "gradient")
    watched.still(page, differs(plain, 5))
    choose(page, "Ground", "checker")
    watched.still(page, differs(plain, 5))
    open_folder(page, "Own lights")
    choose(page, "Lights", "own")
    sunny = watched.still(page, differs(plain, 2))
    type_number(page, "Sun azimuth", 120)
    watched.still(page, differs(sunny, 1))


def test_own_material_is_seen(watched):
    page = watched.pages[0]
    watched.viewer.state.set(look__sky="gradient")
    before = watched.still(page)
    open_folder(page, "Material and light")
    open_folder(page, "Own material")
    choose(page, "Material", "own")
    type_number(page, "Reflection", 1.0)
    mirror = watched.still(page, differs(before, 3))
    type_number(page, "Bounces", 0)
    watched.still(page, differs(mirror, 0.5))


def test_colours_of_values_with_their_legend(watched):
    page = watched.pages[0]
    before = watched.still(page)
    open_folder(page, "Color by value")
    choose(page, "Color by", "speed")
    colored = watched.still(page, differs(before, 3))
    height, width = colored.shape[:2]
    corner = np.s_[height // 2 :, int(0.8 * width) :]
    check(page, "Legend", False)
    without = watched.still(page, lambda p: not np.array_equal(p, colored))
    assert (without[corner] != colored[corner]).any()
    check(page, "Automatic range", False)
    watched.viewer.state.set(color__low=-10.0, color__high=10.0)
    middle = watched.still(page, differs(without, 1))
    face = np.s_[300:460, 250:430]
    assert middle[face][..., 0].std() < without[face][..., 0].std()
    choose(page, "Color map", "gray")
    gray = watched.still(page, differs(middle, 1))
    assert np.ptp(gray[face].astype(int), axis=2).max() < 40


def test_a_plane_a_box_and_a_ball_cut(watched):
    page = watched.pages[0]
    before = watched.still(page)
    open_folder(page, "Cut")
    for label in ("Plane", "Box", "Sphere"):
        check(page, label)
        cut = watched.still(page, differs(before, 0.3))
        assert silhouette(cut) <= silhouette(before)
        check(page, label, False)
        watched.still(page, lambda p: np.array_equal(p, before))
    page.get_by_role("button", name="flip").click()
    flipped = watched.still(page, differs(before, 0.3))
    assert watched.viewer.state.cuts.normal == (-1.0, 0.0, 0.0)
    assert silhouette(flipped) < silhouette(before)


def test_the_planes_handle_moves_the_cut(watched):
    page = watched.pages[0]
    open_folder(page, "Cut")
    check(page, "Plane")
    first = watched.still(page)
    begin = watched.viewer.state.cuts.point
    from globule.viewer.overlay import project

    size = page.locator("canvas").first.bounding_box()
    middle = project(page.client.camera, (size["width"], size["height"]), begin)
    # The handle's arrow of the first axis, a little away from its middle.
    tip = np.asarray(begin) + np.array([0.25, 0, 0]) / watched.viewer.placement.scale
    at = project(page.client.camera, (size["width"], size["height"]), tip)
    way = np.subtract(at, middle)
    stroke(page, at, np.asarray(at) + way * 7 / 5)
    until(lambda: watched.viewer.state.cuts.point != begin, "for the handle to move")
    watched.still(page, differs(first, 0.2))
    camera = page.client.camera
    assert camera == page.client.camera


def test_a_stroke_with_the_tool_cut_cuts(watched):
    page = watched.pages[0]
    before = watched.still(page)
    take_tool(page, "Cut")
    page.get_by_text("Draw a line across the surface to cut it.", exact=True).first.wait_for()
    camera = page.client.camera
    stroke(page, (150, 300), (535, 465))
    until(lambda: watched.viewer.state.cuts.plane, "for the cutting plane")
    assert page.client.camera == camera  # the stroke did not turn the view
    after = watched.still(page, differs(before, 1))
    assert silhouette(after) < 0.9 * silhouette(before)


def test_click_says_what_is_there_and_two_clicks_measure(watched):
    page = watched.pages[0]
    watched.still(page)
    page.mouse.click(330, 400)
    page.get_by_text(re.compile(r"^particle$")).wait_for()
    hand = watched.viewer.page.tools.hands[max(watched.viewer.page.tools.hands)]
    found = hand.picked[0]
    assert f"{found.particle:,}" in hand.text.content
    assert "speed" in hand.text.content
    box = page.locator("canvas").first.bounding_box()
    with watched.viewer.source.lock:
        frame = gb.render(
            watched.viewer.source.layers(watched.viewer.state)[0],
            page.client.camera,
            (round(box["width"]), round(box["height"])),
        )
    direct = frame.pick(330, 400)
    assert np.linalg.norm(direct.position - found.position) < 0.05
    marked = watched.still(page)
    choose(page, "Mouse tool", "Measure")
    page.mouse.click(300, 380)
    until(lambda: len(hand.picked) == 1)
    note = page.locator("#globule-desk .said")
    note.get_by_text("Click the second point.").wait_for()
    page.mouse.click(30, 700)  # beside the surface: the first point stays
    note.get_by_text("There is no surface here.").wait_for()
    page.mouse.click(400, 450)
    note.get_by_text(re.compile("Distance")).wait_for()
    page.get_by_text(re.compile("Distance")).first.wait_for()
    a, b = (p.position.astype(float) for p in hand.picked)
    assert f"{np.linalg.norm(b - a):.6g}" in hand.text.content
    measured = watched.still(page, lambda p: not np.array_equal(p, marked))
    amber = (np.abs(measured.astype(int) - (255, 176, 32)).sum(axis=2) < 60).sum()
    assert amber > 50


def test_views_fit_and_bookmarks(watched):
    page = watched.pages[0]
    viewer = watched.viewer
    page.get_by_role("button", name="right", exact=True).click()

    def from_the_right() -> bool:
        away = np.subtract(page.client.camera.eye, page.client.camera.look_at)
        return away[0] > 0.99 * np.linalg.norm(away)

    until(from_the_right)
    open_folder(page, "Bookmarks")
    page.get_by_role("button", name="Save view").click()
    kept = until(lambda: viewer.state.bookmarks.get("view 1"))
    page.get_by_role("button", name="front", exact=True).click()
    until(lambda: not from_the_right())
    page.get_by_role("button", name="Go", exact=True).click()
    until(from_the_right)
    assert np.allclose(kept.eye, page.client.camera.eye, atol=1e-4)
    page.mouse.move(330, 380)
    page.mouse.wheel(0, 2000)
    until(lambda: not np.allclose(kept.eye, page.client.camera.eye, atol=0.5))
    far = silhouette(watched.still(page))
    page.get_by_role("button", name="Fit all").click()
    watched.still(page, lambda p: silhouette(p) > 1.2 * far)


def test_parallel_rays(watched):
    page, viewer = watched.pages[0], watched.viewer
    near = watched.still(page)
    first = page.client.camera
    page.get_by_role("button", name="Perspective / orthographic").click()
    until(lambda: page.client.camera.height)
    flat, camera = watched.still(page, differs(near, 1)), page.client.camera
    assert 0.7 < silhouette(flat) / silhouette(near) < 1.3
    page.mouse.move(330, 380)
    page.mouse.wheel(0, -300)
    until(lambda: page.client.camera.height < 0.95 * camera.height, "for the wheel to zoom")
    page.keyboard.press("3")
    until(lambda: page.client.camera.eye[0] < -1)
    picture, left = watched.still(page), page.client.camera
    assert left.height
    text = viewer.state.to_toml(left)  # and as a file and a command
    assert viewer.state.load_toml(text) == left
    size = (320, 200)
    assert f"--ortho {left.height:.9g}" in viewer.equivalent(left, size)[0]
    take_tool(page, "Cut")
    stroke(page, (150, 380), (535, 380))
    until(lambda: viewer.state.cuts.plane, "for the cutting plane")
    assert np.allclose(np.abs(viewer.state.cuts.normal), (0, 1, 0), atol=0.02)
    watched.still(page, lambda p: silhouette(p) < 0.8 * silhouette(picture))
    viewer.state.set(cuts__plane=False)
    choose(page, "Mouse tool", "Rotate, pick")
    page.get_by_role("button", name="Perspective / orthographic").click()
    until(lambda: page.client.camera.height is None)
    assert page.client.camera.fov == pytest.approx(first.fov, abs=0.1)


def test_recordings_are_the_servers_pictures(watched, tmp_path):
    av = pytest.importorskip("av")
    page = watched.pages[0]
    viewer = watched.viewer
    open_folder(page, "Save and record")
    type_text(page, "Size", "160x120")
    until(lambda: viewer.page.panels[-3].size.value == "160x120")
    page.get_by_role("button", name="Record", exact=True).click()
    stop = page.get_by_role("button", name="Stop recording")
    stop.wait_for()
    first = until(lambda: next(iter(viewer.page.panels[-3]._recorders.values()), None))[0]
    until(lambda: first.n_pictures > 10, "for the recording to begin")
    viewer.state.set(surface__threshold=1.5)
    at = first.n_pictures
    until(lambda: first.n_pictures > at + 40, "for pictures of the other surface")
    with page.expect_download() as download:
        stop.click()
    download.value.save_as(tmp_path / "movie.mp4")
    with av.open(str(tmp_path / "movie.mp4")) as movie:
        pictures = [frame.to_ndarray(format="rgb24") for frame in movie.decode(video=0)]
    assert len(pictures) > 20
    assert pictures[0].shape == (120, 160, 3)
    assert silhouette(pictures[-1]) < 0.95 * silhouette(pictures[0])


def test_a_picture_too_large_for_the_memory_is_refused(watched):
    page = watched.pages[0]
    open_folder(page, "Save and record")
    for size, message in (("99999x99999", "size: expected sides of"), ("wide", "Size: expected")):
        type_text(page, "Size", size)
        until(lambda size=size: watched.viewer.page.panels[-3].size.value == size)
        page.get_by_role("button", name="Save image").click()
        page.get_by_text(message).first.wait_for()


def test_a_turntable_goes_once_around(watched, tmp_path):
    av = pytest.importorskip("av")
    page = watched.pages[0]
    viewer = watched.viewer
    open_folder(page, "Save and record")
    type_text(page, "Size", "96x64")
    type_number(page, "Turntable, s", 1)
    until(
        lambda: (
            viewer.page.panels[-3].size.value == "96x64"
            and viewer.page.panels[-3].seconds.value == 1
        )
    )
    with page.expect_download() as download:
        page.get_by_role("button", name="Turntable movie").click()
    download.value.save_as(tmp_path / "turntable.mp4")
    with av.open(str(tmp_path / "turntable.mp4")) as movie:
        pictures = [frame.to_ndarray(format="rgb24").astype(int) for frame in movie.decode(video=0)]
    assert len(pictures) == 30
    away = [np.abs(p - pictures[0]).mean() for p in pictures]
    assert away[15] > 3
    assert away[-1] < away[15]


def test_a_turntable_is_cancelled_and_not_started_twice(watched):
    page, save = watched.pages[0], watched.viewer.page.panels[-3]
    open_folder(page, "Save and record")
    type_text(page, "Size", "640x480")
    type_number(page, "Turntable, s", 60)
    until(lambda: save.size.value == "640x480" and save.seconds.value == 60)
    button = page.get_by_role("button", name="Turntable movie")
    button.click()
    page.get_by_text(re.compile(r"[1-9]\d* %, \d+ s left")).first.wait_for()
    button.click()
    page.get_by_text("turntable: one movie is in progress").first.wait_for()
    page.get_by_role("button", name="Cancel", exact=True).click()
    until(lambda: not save._jobs, "for the turntable to end")
    page.get_by_text(re.compile("s left")).first.wait_for(state="detached")
    page.get_by_role("button", name="Cancel", exact=True).wait_for(state="hidden")


def test_settings_are_saved_and_loaded(watched, tmp_path):
    page = watched.pages[0]
    state = watched.viewer.state
    plain = watched.still(page)
    state.set(surface__threshold=1.2, cuts__plane=True, look__exposure=1.5)
    changed = watched.still(page, differs(plain))
    open_folder(page, "Save and record")
    open_folder(page, "All settings")
    with page.expect_download() as download:
        page.get_by_role("button", name="Save settings").click()
    path = tmp_path / "view.toml"
    download.value.save_as(path)
    assert "threshold = 1.2" in path.read_text()
    state.load_toml("[quality]\nsamples = 1\n")
    watched.still(page, differs(changed))
    with page.expect_file_chooser() as chooser:
        page.get_by_role("button", name="Load settings").click()
    chooser.value.set_files(str(path))
    until(lambda: state.cuts.plane, "for the settings to come")
    assert state.surface.threshold == 1.2
    watched.still(page, lambda p: np.abs(p.astype(int) - changed).mean() < 0.2)
    wide = tmp_path / "wide.toml"  # nobody could wait for such a picture
    wide.write_text("[surface]\nsupport = 1e9\n[quality]\nsamples = 1\n")
    with page.expect_file_chooser() as chooser:
        page.get_by_role("button", name="Load settings").click()
    chooser.value.set_files(str(wide))
    support = watched.viewer.page.binder.widgets["surface.support"]
    until(lambda: state.surface.support == support.max == support.value, "for the end")
    page.get_by_text("got 1e+09").first.wait_for()
    too_large = tmp_path / "large.toml"
    too_large.write_text("# " + "x" * 600_000)
    from viser import _messages

    asked, version = [], state.version
    watched.viewer.server._websock_server.register_handler(
        _messages.FileTransferStartUpload, lambda client, message: asked.append(message)
    )
    with page.expect_file_chooser() as chooser:
        page.get_by_role("button", name="Load settings").click()
    chooser.value.set_files(str(too_large))
    until(lambda: asked, "for the browser to ask")
    assert state.version == version
    assert not watched.viewer.server.gui._current_file_upload_states


def test_statistics_and_help_are_shown(watched):
    page = watched.pages[0]
    open_folder(page, "Statistics")
    page.get_by_text("trace", exact=True).wait_for()
    page.get_by_text("latency", exact=True).wait_for()
    page.get_by_text("400", exact=True).wait_for()
    page.mouse.click(330, 700)
    page.keyboard.press("h")
    page.get_by_text("fly forwards").last.wait_for()
    page.get_by_role("button", name="Close", exact=True).click()


def test_seen_is_what_the_panels_say(watched):
    """The browser's own picture follows the settings too."""
    page = watched.pages[0]
    watched.viewer.state.set(look__background=(0.0, 0.6, 0.0))
    until(
        lambda: (
            seen(page)[650:740, 20:60].reshape(-1, 3).mean(axis=0)[1]
            > 60 + seen(page)[650:740, 20:60].reshape(-1, 3).mean(axis=0)[0]
        )
    )
