"""Each group of controls, used in a real browser: its effect in the picture."""

from __future__ import annotations

import re
import signal
import socket
import subprocess
import sys
import threading
import time
from typing import Any

import globule as gb
import numpy as np
import pytest
from PIL import Image
from viewer_helpers import (
    Watched,
    blob,
    browser,
    check,
    choose,
    open_folder,
    seen,
    silhouette,
    type_number,
    type_text,
    until,
)


@pytest.fixture(autouse=True)
def hang_guard():
    """Browsers take their time; `until` has a limit of its own."""


@pytest.fixture(scope="module")
def chromium():
    with browser() as opened:
        yield opened


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


def differs(a: np.ndarray, by: float = 1.0):
    """A test for pictures that are others than `a`."""
    return lambda b: a.shape == b.shape and np.abs(a.astype(int) - b).mean() > by


def test_threshold_changes_the_silhouette(watched):
    page = watched.pages[0]
    before = silhouette(watched.still(page))
    open_folder(page, "Surface and quality")
    type_number(page, "Threshold", 1.8)
    after = watched.still(page, lambda p: silhouette(p) < 0.9 * before)
    assert silhouette(after) > 0
    assert watched.viewer.state.surface.threshold == pytest.approx(1.8)
    page.get_by_role("button", name="Default surface").click()
    watched.still(page, lambda p: silhouette(p) == before)


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
    choose(page, "Matter", "own")
    type_number(page, "Reflection", 1.0)
    mirror = watched.still(page, differs(before, 3))
    type_number(page, "Reflection depth", 0)
    watched.still(page, differs(mirror, 0.5))


def test_colours_of_values_with_their_legend(watched):
    page = watched.pages[0]
    before = watched.still(page)
    open_folder(page, "Colour by value")
    choose(page, "Colour by", "speed")
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
    choose(page, "Colour map", "gray")
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
    page.mouse.move(*at)
    page.mouse.down()
    for i in range(1, 8):
        page.mouse.move(*(np.asarray(at) + way * i / 5))
        time.sleep(0.05)
    page.mouse.up()
    until(lambda: watched.viewer.state.cuts.point != begin, "for the handle to move")
    watched.still(page, differs(first, 0.2))
    camera = page.client.camera
    assert camera == page.client.camera


def test_a_stroke_with_the_tool_cut_cuts(watched):
    page = watched.pages[0]
    before = watched.still(page)
    choose(page, "With the mouse", "Cut")
    page.get_by_text("Draw a line across what is to be cut.", exact=True).wait_for()
    camera = page.client.camera
    time.sleep(1.0)
    page.mouse.move(150, 300)
    page.mouse.down()
    for i in range(1, 12):
        page.mouse.move(150 + 35 * i, 300 + 15 * i)
        time.sleep(0.06)
    page.mouse.up()
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
        frame = gb.render(watched.viewer.source.layers(watched.viewer.state)[0],
                          page.client.camera, (round(box["width"]), round(box["height"])))
    direct = frame.pick(330, 400)
    assert np.linalg.norm(direct.position - found.position) < 0.05
    marked = watched.still(page)
    choose(page, "With the mouse", "Measure")
    page.mouse.click(300, 380)
    until(lambda: len(hand.picked) == 1)
    page.mouse.click(400, 450)
    page.get_by_text(re.compile("Distance")).wait_for()
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
    page.get_by_role("button", name="Keep this view").click()
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
    page.get_by_role("button", name="Perspective / parallel").click()
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
    choose(page, "With the mouse", "Cut")
    time.sleep(1.0)
    page.mouse.move(150, 380)
    page.mouse.down()
    for i in range(1, 12):
        page.mouse.move(150 + 35 * i, 380)
        time.sleep(0.06)
    page.mouse.up()
    until(lambda: viewer.state.cuts.plane, "for the cutting plane")
    assert np.allclose(np.abs(viewer.state.cuts.normal), (0, 1, 0), atol=0.02)
    watched.still(page, lambda p: silhouette(p) < 0.8 * silhouette(picture))
    viewer.state.set(cuts__plane=False)
    choose(page, "With the mouse", "Rotate, pick")
    page.get_by_role("button", name="Perspective / parallel").click()
    until(lambda: page.client.camera.height is None)
    assert page.client.camera.fov == pytest.approx(first.fov, abs=0.1)


def test_a_saved_picture_is_the_servers(watched, tmp_path):
    page = watched.pages[0]
    viewer = watched.viewer
    open_folder(page, "Save and record")
    type_text(page, "Size", "320x200")
    type_number(page, "Samples", 2)
    until(lambda: viewer.page.panels[-3].size.value == "320x200")
    until(lambda: viewer.page.panels[-3].samples.value == 2)
    with page.expect_download() as download:
        page.get_by_role("button", name="Save a picture").click()
    path = tmp_path / "picture.png"
    download.value.save_as(path)
    with Image.open(path) as image:
        got = np.asarray(image)
    from globule.viewer.recording import Shot

    wanted = Shot(viewer.engine, page.client.camera, (320, 200), 2).picture
    assert np.array_equal(got, wanted)
    choose(page, "Picture as", "EXR")
    with page.expect_download() as download:
        page.get_by_role("button", name="Save a picture").click()
    download.value.save_as(tmp_path / "picture.exr")
    from globule.exr import read_exr

    assert read_exr(tmp_path / "picture.exr", 10**6).shape == (200, 320, 3)


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
    viewer.state.set(surface__threshold=1.5)
    time.sleep(1.5)
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
        page.get_by_role("button", name="Save a picture").click()
        page.get_by_text(message).first.wait_for()


def test_a_turntable_goes_once_around(watched, tmp_path):
    av = pytest.importorskip("av")
    page = watched.pages[0]
    viewer = watched.viewer
    open_folder(page, "Save and record")
    type_text(page, "Size", "96x64")
    type_number(page, "Turntable, seconds", 1)
    until(lambda: viewer.page.panels[-3].size.value == "96x64"
          and viewer.page.panels[-3].seconds.value == 1)
    with page.expect_download() as download:
        page.get_by_role("button", name="Turntable movie").click()
    download.value.save_as(tmp_path / "turntable.mp4")
    with av.open(str(tmp_path / "turntable.mp4")) as movie:
        pictures = [frame.to_ndarray(format="rgb24").astype(int)
                    for frame in movie.decode(video=0)]
    assert len(pictures) == 30
    away = [np.abs(p - pictures[0]).mean() for p in pictures]
    assert away[15] > 3 and away[-1] < away[15]


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
    too_large = tmp_path / "large.toml"
    too_large.write_text("# " + "x" * 600_000)
    version = state.version
    with page.expect_file_chooser() as chooser:
        page.get_by_role("button", name="Load settings").click()
    chooser.value.set_files(str(too_large))
    time.sleep(1.0)
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
    page.get_by_role("button", name="Close").click()


def frames_that_move(n: int = 5) -> list[gb.Particles]:
    still = blob(150).positions
    return [gb.Particles(still * (1 + 0.25 * i), support=0.35) for i in range(n)]


def test_a_sequence_plays_and_steps(chromium):
    watched = Watched(frames_that_move(), chromium)
    try:
        page = watched.page()
        first = watched.still(page)
        page.get_by_role("button", name="next", exact=True).click()
        watched.still(page, differs(first, 0.5))
        assert watched.viewer.source.frame == 1
        type_number(page, "Frame", 4)
        until(lambda: watched.viewer.source.frame == 4)
        page.get_by_role("button", name="first", exact=True).click()
        watched.still(page, lambda p: np.array_equal(p, first))
        type_number(page, "Frames per second", 5)
        check(page, "Play")
        seen_frames = set()
        until(lambda: seen_frames.add(watched.viewer.source.frame) or len(seen_frames) == 5)
        page.mouse.move(330, 380)
        page.keyboard.press("Space")
        until(lambda: not watched.viewer.state.time.playing)
        check(page, "Loop", False)
        check(page, "Play")
        until(lambda: watched.viewer.source.frame == 4 and not watched.viewer.state.time.playing)
    finally:
        watched.close()


def test_a_broken_frame_stops_the_show_until_it_is_mended(chromium, tmp_path):
    paths = [str(tmp_path / f"frame_{i}.npz") for i in range(4)]
    for path, particles in zip(paths, frames_that_move(4), strict=True):
        gb.write(path, particles)
    (tmp_path / "frame_2.npz").write_bytes(b"no archive")
    watched = Watched(paths, chromium)
    try:
        page, source, state = watched.page(), watched.viewer.source, watched.viewer.state
        check(page, "Play")
        page.get_by_text("frame_2.npz: archive").first.wait_for()
        until(lambda: not state.time.playing)
        assert source.frame == 1
        type_number(page, "Frame", 3)
        until(lambda: source.frame == 3)
        gb.write(paths[2], frames_that_move(4)[2])
        type_number(page, "Frame", 2)
        until(lambda: source.frame == 2)
    finally:
        watched.close()


def ball_volume() -> gb.Volume:
    z, y, x = np.mgrid[-12:13, -12:13, -12:13]
    values = np.clip(220 - 18 * np.sqrt(x * x + y * y + z * z), 0, 255).astype(np.uint8)
    radius = np.where(x > 4, 2, 0).astype(np.uint8)
    pose = np.diag([2.0, 2.0, 2.0, 1.0])
    return gb.Volume(values, pose, radius)


def test_a_volume_with_slices_surface_and_overlay(chromium):
    volume = ball_volume()
    images = np.full((2, 30, 30), 255, np.uint8)
    pose = np.eye(4)
    pose[:3, 3] = (-40, -10, 20)
    poses = np.stack([pose, pose])
    watched = Watched((volume, gb.Sweep(images, poses)), chromium)
    try:
        page = watched.page()
        both = watched.still(page)
        check(page, "Measured / filled")
        tinted = watched.still(page, differs(both, 0.2)).astype(int)
        orange = (tinted[..., 0] > tinted[..., 2] + 40).sum()
        assert orange > 200
        check(page, "Show slices", False)
        surface = watched.still(page, differs(both, 0.5))
        type_number(page, "Surface level", 190)
        smaller = watched.still(page, lambda p: silhouette(p) < 0.8 * silhouette(surface))
        check(page, "Show surface", False)
        watched.still(page, lambda p: silhouette(p) == 0)
        check(page, "Show sweep frame")
        frame = watched.still(page, lambda p: (p == 255).all(axis=2).sum() > 500)
        assert frame.shape == smaller.shape
        check(page, "Show sweep frame", False)
        check(page, "Show slices")
        check(page, "Measured / filled", False)
        type_number(page, "x slice", 0.2)
        watched.still(page, differs(both, 0.2))
    finally:
        watched.close()


def test_a_sweep_comes_in_and_is_undone(chromium):
    rng = np.random.default_rng(2)
    frames = rng.integers(80, 255, (12, 20, 24)).astype(np.uint8)
    poses = np.repeat(np.eye(4)[None], 12, axis=0)
    poses[:, 2, 3] = np.arange(12)
    watched = Watched(gb.Sweep(frames, poses), chromium)
    source = watched.viewer.source
    try:
        page = watched.page()
        empty = watched.still(page)
        page.get_by_role("button", name="Start", exact=True).click()
        until(lambda: not source.running and source._reconstructor.n_frames == 12)
        full = watched.still(page, differs(empty, 1))
        page.get_by_role("button", name="Undo").click()
        until(lambda: source._reconstructor.n_frames == 11)
        watched.still(page, lambda p: not np.array_equal(p, full))
        choose(page, "Method", "vvn")
        page.get_by_role("button", name="Make the volume by this method").click()
        until(lambda: "method" not in source.volume.info or source.volume.n_filled >= 0)
        choose(page, "Compounding", "maximum")
        until(lambda: source.compounding == "maximum")
        page.get_by_role("button", name="Clear").click()
        until(lambda: source._reconstructor.n_frames == 0)
        watched.still(page, lambda p: p.shape == empty.shape and np.abs(
            p.astype(int) - empty).mean() < 1)
        page.get_by_role("button", name="Start", exact=True).click()
        until(lambda: source._reconstructor.n_frames > 0)
        page.get_by_role("button", name="Stop", exact=True).click()
        until(lambda: not source.running)
    finally:
        watched.close()


def replaying(sweep: gb.Sweep) -> tuple[int, Any]:
    """A server of pyigtl's own on loopback that sends a sweep to whoever comes, and its port."""
    igtl = pytest.importorskip("pyigtl")
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    server = igtl.OpenIGTLinkServer(port=port)

    def replay() -> None:
        while not server.is_connected():
            time.sleep(0.01)
        for i in range(len(sweep)):
            when = 1000 + float(i)
            server.send_message(igtl.ImageMessage(sweep.frames[i][None], timestamp=when,
                                                  device_name="Image"))
            server.send_message(igtl.TransformMessage(
                sweep.world_from_image[i], timestamp=when, device_name="ImageToReference"))
            time.sleep(0.05)

    threading.Thread(target=replay, daemon=True).start()
    return port, server


def test_a_live_scanner_from_the_command_line(chromium):
    """`globule view igtl://…` in a process of its own, a server that replays a sweep, a browser."""
    rng = np.random.default_rng(2)
    frames = rng.integers(80, 255, (20, 40, 48)).astype(np.uint8)
    poses = np.repeat(np.eye(4)[None], 20, axis=0)
    poses[:, 2, 3] = np.arange(20)
    port, server = replaying(gb.Sweep(frames, poses))
    process = subprocess.Popen(
        [sys.executable, "-m", "globule", "view", f"igtl://127.0.0.1:{port}", "--no-browser",
         "--port", "0"], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    page = chromium.new_page(viewport={"width": 1000, "height": 760})
    page.set_default_timeout(60_000)
    try:
        page.goto(re.search(r"http://\S+", process.stdout.readline())[0])
        page.get_by_role("button", name="Start", exact=True).click()
        open_folder(page, "Statistics")
        page.get_by_role("cell", name="frames", exact=True).locator(
            "xpath=following-sibling::td[text()='20']").wait_for()
        page.get_by_role("button", name="Stop", exact=True).click()
        until(lambda: np.ptp(seen(page)[250:500, 200:450].mean(axis=2)) > 60, "for the slices")
        page.get_by_role("button", name="Undo").click()
        page.get_by_role("cell", name="frames", exact=True).locator(
            "xpath=following-sibling::td[text()='19']").wait_for()
    finally:
        page.close()
        process.send_signal(signal.SIGINT)
        _, errors = process.communicate(timeout=60)
        server.stop()
    assert process.returncode == 130 and errors.strip() == "globule: interrupted"


def test_seen_is_what_the_panels_say(watched):
    """The browser's own picture follows the settings too."""
    page = watched.pages[0]
    watched.viewer.state.set(look__background=(0.0, 0.6, 0.0))
    until(lambda: seen(page)[650:740, 20:60].reshape(-1, 3).mean(axis=0)[1]
          > 60 + seen(page)[650:740, 20:60].reshape(-1, 3).mean(axis=0)[0])
