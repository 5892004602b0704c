"""Browsers that come and go, as programs: cameras of their own, slow ones, what they leave."""

import gc
import subprocess
import sys
import threading
from pathlib import Path

import numpy as np
import pytest
from globule._base.memory import resident_bytes
from viewer_helpers import PATIENCE, Watched, blob, our_threads, threads_of_browsers, until

pytest.importorskip("websockets")


@pytest.fixture
def watched():
    with Watched(blob(150)) as made:
        yield made


def test_pictures_arrive_in_order(watched):
    """Each shows its number, as brightness."""

    @watched.viewer.on_frame
    def _(frame):
        return np.full_like(frame.picture, 8 * frame.number)

    page = watched.program()

    def shown() -> list[int]:
        return [round(page.picture(data).mean() / 8) for data in page.images]

    for i in range(1, 8):
        camera = page.client.camera
        page.look(eye=[0.1 * i, 0.0, 4.0])
        until(lambda camera=camera: page.client.camera != camera)
        watched.still(page)
    until(lambda: shown()[-1] == page.client.number)
    assert shown() == sorted(shown())


def test_a_browser_that_never_answers_holds_up_nobody(watched):
    one, two = watched.program(answers=False), watched.program()
    until(lambda: len(one.client.pacer.in_flight) == 2, "for two pictures in flight")
    stuck, camera_of_one = one.client.number, one.client.camera
    for i in range(1, 4):
        camera = two.client.camera
        two.look(eye=[0.1 * i, 0.0, 4.0])
        until(lambda camera=camera: two.client.camera != camera)
        watched.still(two)
    assert (one.client.number, one.client.camera) == (stuck, camera_of_one)


def reloaded(watched, page):
    page.close()
    until(lambda: page.client not in watched.viewer.clients.values())
    return watched.program()


def test_reload_and_kill_leave_nothing_behind():
    threads = threading.active_count()
    with Watched(blob(150)) as watched:
        page, alive = watched.program(), threads_of_browsers()
        for _ in range(3):
            page = reloaded(watched, page)
        until(lambda: threads_of_browsers() == alive, "for threads of browsers that left")
        assert len(our_threads()) <= len(alive) + 2  # the page's pool of two
        assert len(watched.viewer.engine.clients) == 1
        page.close()
        until(lambda: not watched.viewer.clients)
        until(lambda: not watched.viewer.engine.clients)
    until(lambda: not our_threads(), "for our threads")
    gc.collect()
    until(lambda: threading.active_count() <= threads + 1, "for all threads")


def come_and_go() -> None:
    """Frames that wait for their turn are few, but may become one more late: small ones, so that
    those of many clients that are gone would be much more."""
    with Watched(blob(150)) as watched:
        page, sizes = watched.program(), []
        for _ in range(12):
            page = reloaded(watched, page)
            page.ask("size", [480, 320])
            until(lambda page=page: page.client.pacer.full == (480, 320))
            watched.still(page)
            watched.shown.clear()
            gc.collect()
            sizes.append(resident_bytes())
        assert sizes[-1] - sizes[2] < 40e6, [round(s / 1e6) for s in sizes]


@pytest.mark.slow
def test_memory_stays_when_browsers_come_and_go():
    if not resident_bytes():
        pytest.skip("this system does not say how much memory is in use")
    command = [sys.executable, "-c", "import test_viewer_clients as t; t.come_and_go()"]
    folder = Path(__file__).parent
    subprocess.run(command, cwd=folder, check=True, timeout=PATIENCE)


def test_errors_are_said_in_the_page_and_callbacks_change_it(watched, caplog):
    page = watched.program()
    watched.viewer.state.set(surface__kernel="blinn", surface__root="bezier")
    page.heard("Bézier clipping")
    watched.viewer.state.set(surface__root="exact")
    watched.still(page)
    assert "Bézier clipping, got 'blinn'" in caplog.text
    slider = watched.viewer.gui.add_slider("Redness", 0, 255, 1, 0)

    @watched.viewer.on_frame
    def _(frame):
        picture = frame.picture.copy()
        picture[..., 0] = slider.value
        return picture

    @slider.on_update
    def _(event):
        watched.viewer.refresh()

    page = watched.program()
    page.set("Redness", 250)
    until(lambda: page.picture()[..., 0].mean() > 245, "for a red picture")
    page = watched.program()
    before = watched.still(page)
    watched.viewer.source.update(blob(60, seed=3))
    watched.viewer.refresh()
    watched.still(page, lambda p: p.shape == before.shape and not np.array_equal(p, before))


def test_the_first_view_follows_the_window_until_a_person_moves_it(watched):
    page = watched.program()
    first = page.client.camera
    page.ask("size", [60, 180])
    until(lambda: page.client.camera != first, "for the view to be fitted again")
    fitted = page.client.camera
    until(lambda: page.camera["eye"] == list(fitted.eye))
    late = page.camera | {"eye": [9.0, 9.0, 9.0], "moves": page._moves - 1}
    page.ask("look", late)  # sent before the page knew of the server's move
    page.look(eye=[0.0, 0.0, 4.0])
    until(lambda: page.client.camera.eye == (0.0, 0.0, 4.0))
    page.ask("size", [300, 90])
    until(lambda: page.client.pacer.full == (300, 90))
    assert page.client.camera.eye == (0.0, 0.0, 4.0)
    page.ask("look", late)
    page.command("Look from: top")
    until(lambda: page.client.camera.eye[1] > 1, "for the view from above")
    assert page.client.camera.eye != (9.0, 9.0, 9.0)


def test_a_tab_that_is_loaded_again_keeps_camera_and_tool(watched):
    from viewer_program import Program

    page = watched._arrives(lambda: Program(watched.viewer.address, tab="of this test"))
    page.look(eye=[0.0, 1.0, 4.0])
    page.ask("tool", "Measure")
    until(lambda: page.client.camera.eye == (0.0, 1.0, 4.0) and page.hand.tool == "Measure")
    page.close()
    until(lambda: not watched.viewer.clients)
    again = watched._arrives(lambda: Program(watched.viewer.address, tab="of this test"))
    assert (again.client.camera.eye, again.hand.tool) == ((0.0, 1.0, 4.0), "Measure")
    until(lambda: again.camera)
    assert again.camera["eye"] == [0.0, 1.0, 4.0]
