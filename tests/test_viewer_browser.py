"""The viewer's page in a real browser: pictures, cameras, clients that come and go."""

from __future__ import annotations

import contextlib
import gc
import itertools
import os
import re
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from viewer_helpers import (
    PATIENCE,
    Watched,
    bar_code,
    blob,
    choose,
    differs,
    drag_along,
    open_folder,
    our_threads,
    seen,
    silhouette,
    threads_of_browsers,
    type_number,
    type_text,
    until,
    with_bar_code,
)

BROWSERS = True  # see hang_guard
pytestmark = pytest.mark.browser


@pytest.fixture
def watched(chromium):
    made = Watched(blob(), chromium)
    yield made
    made.close()


def close_to(shown: np.ndarray, picture: np.ndarray) -> bool:
    """Whether a browser shows a picture, but for JPEG and the size of its window."""
    small = np.asarray(Image.fromarray(picture).resize(shown.shape[1::-1]), int)
    middle = np.s_[200:560, 100:560]  # no notes of viser's there
    return np.abs(small[middle] - shown[middle].astype(int)).mean() < 4


def drag(page, dx: float, dy: float, button: str = "left") -> None:
    drag_along(page, np.linspace((330, 380), (330 + dx, 380 + dy), 9), button)
    page.mouse.up(button=button)


def test_the_page_shows_the_servers_picture_and_asks_nobody_else(watched):
    page = watched.page()
    picture = watched.still(page)
    until(lambda: close_to(seen(page), picture), "for the browser to show it")
    own = watched.viewer.address.split("/")[2]
    assert watched.requests
    for address in watched.requests:
        assert own in address or address.startswith("data:"), address


@pytest.mark.slow
def test_pictures_arrive_in_order(watched):
    watched.viewer.on_frame(with_bar_code)
    page = watched.page()
    numbers = []
    page.mouse.move(330, 380)
    page.mouse.down()
    turns = itertools.count()

    def several() -> bool:  # while the mouse goes to and fro
        i = next(turns)
        page.mouse.move(330 + 6 * (i % 25), 380 + 3 * (i % 25))
        found = bar_code(seen(page))
        numbers.extend([] if found is None else [found])
        return i > 24 and len(set(numbers)) > 3

    until(several, "for several pictures")
    page.mouse.up()
    assert numbers == sorted(numbers)
    watched.still(page)
    last = page.client.number
    until(lambda: bar_code(seen(page)) == last, "for the last picture")


def test_dragging_moves_the_servers_camera(watched):
    page = watched.page()
    before, first = watched.still(page), page.client.camera
    drag(page, 150, 40)
    until(lambda: page.client.camera != first)
    moved = watched.still(page)
    assert page.client.camera.look_at == pytest.approx(first.look_at, abs=1e-6)
    distance = [np.linalg.norm(np.subtract(c.eye, c.look_at)) for c in (first, page.client.camera)]
    assert distance[0] == pytest.approx(distance[1], rel=1e-3)
    assert moved.shape != before.shape or np.abs(moved.astype(int) - before).mean() > 1
    second = page.client.camera
    page.mouse.move(330, 380)
    page.mouse.wheel(0, -300)
    until(
        lambda: (
            np.linalg.norm(np.subtract(page.client.camera.eye, second.look_at)) < 0.97 * distance[1]
        ),
        "for the wheel to zoom",
    )
    drag(page, 60, 0, button="right")
    until(lambda: page.client.camera.look_at != pytest.approx(first.look_at, abs=1e-3))


def test_threshold_changes_the_silhouette(watched):
    page = watched.page()
    before = silhouette(watched.still(page))
    open_folder(page, "Surface and quality")
    type_number(page, "Threshold", 1.8)
    after = watched.still(page, lambda p: silhouette(p) < 0.9 * before)
    assert silhouette(after) > 0
    assert watched.viewer.state.surface.threshold == pytest.approx(1.8)
    page.get_by_role("button", name="Default surface").click()
    watched.still(page, lambda p: silhouette(p) == before)


def test_a_saved_picture_is_the_servers(watched, tmp_path):
    page = watched.page()
    viewer = watched.viewer
    open_folder(page, "Save and record")
    type_text(page, "Size", "320x200")
    type_number(page, "Samples", 2)
    until(lambda: viewer.page.panels[-3].size.value == "320x200")
    until(lambda: viewer.page.panels[-3].samples.value == 2)
    with page.expect_download() as download:
        page.get_by_role("button", name="Save image").click()
    path = tmp_path / "picture.png"
    download.value.save_as(path)
    with Image.open(path) as image:
        got = np.asarray(image)
    from globule.viewer.recording import Shot

    wanted = Shot(viewer.engine, page.client.camera, (320, 200), 2).picture
    assert np.array_equal(got, wanted)
    choose(page, "Image format", "EXR")
    with page.expect_download() as download:
        page.get_by_role("button", name="Save image").click()
    download.value.save_as(tmp_path / "picture.exr")
    from globule.formats.pictures.exr import read_exr

    assert read_exr(tmp_path / "picture.exr", 10**6).shape == (200, 320, 3)


@pytest.mark.slow
def test_keys_fly_and_choose_views(watched):
    page = watched.page()
    first = page.client.camera
    page.mouse.move(330, 380)
    page.keyboard.down("w")
    until(lambda: page.client.camera.look_at != first.look_at, "for W to fly")
    page.keyboard.up("w")
    page.keyboard.press("5")

    def from_above() -> bool:
        camera = page.client.camera
        away = np.subtract(camera.eye, camera.look_at)
        return away[1] > 0.99 * np.linalg.norm(away)

    until(from_above, "for the view from above")


@pytest.mark.slow
def test_two_browsers_have_cameras_of_their_own(watched):
    one, two = watched.page(), watched.page()
    first, picture = two.client.camera, watched.still(two)
    drag(one, 150, 60)
    until(lambda: one.client.camera != first)
    watched.still(one)
    assert two.client.camera == first
    assert two.client.frame is not one.client.frame
    assert np.array_equal(watched.still(two), picture)


@pytest.mark.slow
def test_a_slow_browser_holds_up_nobody(watched):
    one, two = watched.page(), watched.page()
    one.client.acknowledge = lambda number: None  # it never says that it has taken in anything
    drag(one, 100, 30)
    until(lambda: len(one.client.pacer.in_flight) == 2, "for two pictures in flight")
    stuck, before = one.client.number, two.client.number
    turns = itertools.count()
    two.mouse.move(330, 380)
    two.mouse.down()

    def goes_on() -> bool:
        two.mouse.move(330 + 5 * (next(turns) % 20), 380)
        return two.client.number > before + 4

    until(goes_on, "for pictures of the other browser")
    two.mouse.up()
    assert one.client.number == stuck


def viewers_threads() -> list[threading.Thread]:
    """All threads but those that encode strips of pictures, which stay for the next viewer."""
    return [t for t in threading.enumerate() if not t.name.startswith("jpeg strips")]


@pytest.mark.slow
def test_reload_and_kill_leave_nothing_behind(chromium):
    threads = len(viewers_threads())
    watched = Watched(blob(), chromium)
    page = watched.page()
    alive = threads_of_browsers()
    for _ in range(3):
        gone = page.client
        page.reload()
        until(lambda gone=gone: gone not in watched.viewer.clients.values())
        page.client = until(lambda: next(iter(watched.viewer.clients.values()), None))
        watched.still(page)
    until(lambda: threads_of_browsers() == alive, "for threads of browsers that left")
    assert len(our_threads()) <= len(alive) + 2  # the page's pool of two
    assert len(watched.viewer.engine.clients) == 1
    page.close()
    watched.pages.clear()
    until(lambda: not watched.viewer.clients)
    until(lambda: not watched.viewer.engine.clients)
    watched.close()
    until(lambda: not our_threads(), "for our threads")
    gc.collect()
    until(lambda: len(viewers_threads()) <= threads + 1, "for all threads")


@pytest.mark.slow
def test_memory_stays_when_browsers_come_and_go(chromium):
    from globule._base.memory import resident_bytes

    if "GLOBULE_TEST_ALONE" not in os.environ:  # in a process whose memory no other test has used
        name = f"{__file__}::test_memory_stays_when_browsers_come_and_go"
        done = subprocess.run(
            [sys.executable, "-m", "pytest", "-q", "--matrix", "-p", "no:cacheprovider", name],
            env=dict(os.environ, GLOBULE_TEST_ALONE="1"),
            capture_output=True,
            text=True,
            timeout=5 * PATIENCE,
        )
        assert done.returncode == 0, done.stdout + done.stderr
        return

    if not resident_bytes():
        pytest.skip("this system does not say how much memory is in use")
    watched = Watched(blob(), chromium)
    try:
        page = watched.page()
        # Frames that wait for their turn are few, but may become one more late: small ones, so
        # that those of many clients that are gone would be much more.
        page.set_viewport_size({"width": 480, "height": 320})
        sizes = []
        for _ in range(12):
            gone = page.client
            page.reload()
            until(lambda gone=gone: gone not in watched.viewer.clients.values())
            page.client = until(lambda: next(iter(watched.viewer.clients.values()), None))
            watched.still(page)
            watched.shown.clear()
            gc.collect()
            sizes.append(resident_bytes())
        assert sizes[-1] - sizes[2] < 40e6, [round(s / 1e6) for s in sizes]
    finally:
        watched.close()


@pytest.mark.slow
def test_errors_are_said_in_the_page(watched, caplog):
    page = watched.page()
    watched.viewer.state.set(surface__kernel="blinn", surface__root="bezier")
    page.get_by_text("root method bezier").first.wait_for()
    watched.viewer.state.set(surface__root="exact")
    watched.still(page)
    assert "bezier" in caplog.text


@pytest.mark.slow
def test_callbacks_and_own_sliders(watched):
    slider = watched.viewer.gui.add_slider("Redness", 0, 255, 1, 0)

    @watched.viewer.on_frame
    def _(frame):
        picture = frame.picture.copy()
        picture[..., 0] = slider.value
        return picture

    @slider.on_update
    def _(event):
        watched.viewer.refresh()

    page = watched.page()
    type_number(page, "Redness", 250)
    until(lambda: seen(page)[300:500, 200:500, 0].min() > 225, "for a red picture")


@pytest.mark.slow
def test_sources_change_while_they_are_seen(watched):
    page = watched.page()
    before = watched.still(page)
    watched.viewer.source.update(blob(60, seed=3))
    watched.viewer.refresh()
    after = watched.still(page, lambda p: p.shape == before.shape and not np.array_equal(p, before))
    assert (after != before).any()


@contextlib.contextmanager
def started(*words: str, **options):
    """`globule view` in a process of its own, and the page's address."""
    pytest.importorskip("viser")
    with subprocess.Popen(
        [sys.executable, "-m", "globule", "view", *words, "--no-browser", "--port", "0"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=os.environ.copy(),
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
        **options,
    ) as process:
        try:
            lines = [process.stdout.readline() for _ in range(3)]
            assert "http://127.0.0.1:" in lines[0]
            assert "ssh -L" in lines[1]
            yield process, lines[0].split()[-1]
        finally:
            process.kill()


def connected(chromium, address: str):
    """A page of another process, which has its own tools."""
    page = chromium.new_page()
    page.set_default_timeout(1000 * PATIENCE)
    page.goto(address)
    page.get_by_text("Mouse tool").wait_for()
    return page


def test_ctrl_c_ends_it_cleanly(tmp_path):
    path = tmp_path / "blob.npz"
    np.savez(path, positions=blob(50).positions, support=np.float32(0.4))
    with started(str(path)) as (process, _):
        process.send_signal(signal.SIGINT)
        _, errors = process.communicate(timeout=PATIENCE)
    assert process.returncode == 130
    assert errors.strip() == "globule: interrupted"


@pytest.mark.slow
def test_ctrl_c_ends_slow_pictures_too(chromium, tmp_path):
    path, state = tmp_path / "blob.npz", tmp_path / "slow.toml"
    np.savez(path, positions=blob(100_000).positions, support=np.float32(0.1))
    state.write_text("[surface]\nsupport = 100.0\n")  # every ray meets all particles
    with started(str(path), "--state", str(state)) as (process, address):
        page = connected(chromium, address)
        begun = processor_seconds(process)
        until(lambda: processor_seconds(process) > begun + 0.5, "for a picture to be begun")
        process.send_signal(signal.SIGINT)
        _, errors = process.communicate(timeout=PATIENCE)
        page.close()
    assert process.returncode == 130
    assert errors.strip() == "globule: interrupted"


def processor_seconds(process: subprocess.Popen) -> float:
    """The processor time that a process has used."""
    return sum(map(int, process_status(process, "stat").rpartition(")")[2].split()[11:13])) / (
        os.sysconf("SC_CLK_TCK")
    )


def process_status(process: subprocess.Popen, name: str) -> str:
    """A file of Linux about a process; "" when the process has ended."""
    if not sys.platform.startswith("linux"):
        pytest.skip("needs /proc")
    try:
        return Path(f"/proc/{process.pid}/{name}").read_text(encoding="utf-8")
    except (FileNotFoundError, ProcessLookupError):
        return ""


def interrupt(process: subprocess.Popen) -> None:
    """Send Ctrl-C, and wait until the process has got it."""
    process.send_signal(signal.SIGINT)
    bit = 1 << (signal.SIGINT - 1)

    def got() -> bool:
        pending = re.search(r"ShdPnd:\s*(\w+)", process_status(process, "status"))
        return pending is None or not int(pending[1], 16) & bit

    until(got, "for the process to get Ctrl-C")


@pytest.mark.slow
def test_ctrl_c_twice_while_a_simulation_runs(chromium):
    with started("cut-block") as (process, address):
        page = connected(chromium, address)
        page.get_by_role("button", name="Run", exact=True).click()
        page.locator("strong", has_text=re.compile("^running")).wait_for()
        interrupt(process)
        process.send_signal(signal.SIGINT)
        _, errors = process.communicate(timeout=PATIENCE)
        page.close()
    assert process.returncode == 130
    assert errors.strip() == "globule: interrupted"


@pytest.mark.slow
def test_ctrl_c_keeps_what_is_being_recorded(chromium, tmp_path):
    av = pytest.importorskip("av")
    np.savez(tmp_path / "blob.npz", positions=blob(50).positions, support=np.float32(0.4))
    with started("blob.npz", cwd=tmp_path) as (process, address):
        page = connected(chromium, address)
        page.keyboard.press("r")
        page.get_by_text("button to stop").wait_for()
        began, first = time.monotonic(), seen(page)
        drag(page, 150, 40)
        until(lambda: differs(first)(seen(page)), "for the view to turn")
        seconds = time.monotonic() - began
        process.send_signal(signal.SIGINT)
        _, errors = process.communicate(timeout=PATIENCE)
        page.get_by_text("The recording is").wait_for()
        assert not page.get_by_text("button to stop").count()
        page.close()
    (movie,) = tmp_path.glob("movie-*.mp4")
    assert process.returncode == 130
    assert str(movie) in errors
    assert len(errors.splitlines()) <= 3  # one more where the movie's end takes long
    with av.open(str(movie)) as opened:
        n_pictures = sum(1 for _ in opened.decode(video=0))
    assert n_pictures >= min(10, 10 * seconds)  # of 30 a second, where encoding keeps up
    assert len(list(tmp_path.iterdir())) == 2
