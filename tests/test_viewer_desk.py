"""Toolbar, timeline and list of layers: what the server says and accepts, and a real browser."""

import json
import urllib.request
from contextlib import closing
from types import SimpleNamespace

import globule as gb
import numpy as np
import pytest
from viewer_helpers import Watched, blob, drag_along, open_section, told, traced, until, view

pytest.importorskip("websockets")

from globule.viewer.compare_source import CompareSource
from globule.viewer.open import open_source
from viewer_program import hello, link

BROWSERS = True  # see hang_guard


@pytest.fixture
def viewer():
    with view([blob(150), blob(150, 2)]) as made:
        yield made


def test_the_page_has_the_controls_and_a_histogram_of_all_particles(viewer):
    with urllib.request.urlopen(viewer.address) as answer:
        assert b"globule/desk.js" in answer.read()
    scripts = [
        (f"{name}.js", "application/javascript") for name in ("desk", "inspector", "upload", "camera", "handles")
    ]
    for name, kind in [*scripts, ("desk.css", "text/css")]:
        with urllib.request.urlopen(f"{viewer.address}globule/{name}") as answer:
            assert answer.headers["Content-Type"].startswith(kind)
            assert "default-src 'self'" in answer.headers["Content-Security-Policy"]
            assert len(answer.read()) > 1000
    for path in ("globule/../app.py", "globule/desk.py"):
        with pytest.raises(urllib.error.HTTPError):
            urllib.request.urlopen(viewer.address + path)
    viewer.state.set(color__by="speed")
    viewer.engine.source.layers(viewer.state.snapshot())
    plot = viewer.page.desk.model.of(SimpleNamespace(client_id=-1))["plot"]
    speed = blob(150).attributes["speed"]
    assert (sum(plot["counts"]), len(plot["colors"])) == (150, len(plot["counts"]))
    assert (plot["lo"], plot["hi"]) == pytest.approx((speed.min(), speed.max()))


def test_a_model_comes_actions_change_the_settings_and_strangers_are_refused(viewer, caplog):
    with closing(link(viewer.address)) as connection:
        connection.send(hello())
        model = told(connection, lambda m: m["title"])
        assert model["time"]["frames"] == 2
        assert model["color"]["options"]

        def say(do, value=None):
            connection.send(json.dumps({"do": do, "value": value}))

        say("set", {"color__by": "speed"})
        told(connection, lambda m: m["color"]["by"] == "speed")
        say("set", {"time__frame": 1})
        told(connection, lambda m: m["time"]["frame"] == 1)
        say("undo")
        told(connection, lambda m: m["color"]["by"] == "" and m["redo"] == 1)
        say("redo")
        told(connection, lambda m: m["color"]["by"] == "speed")
        say("play")
        until(lambda: viewer.state.time.playing)
        for bad in ({"look__exposure": 2.0}, {"color__by": "nothing"}, "x", {"cuts__plane": 3}):
            say("set", bad)
        for absent in ("close", "step", "reset"):  # two are of simulations
            say(absent)
        connection.send("[1")
        until(lambda: len([r for r in caplog.records if r.levelname == "WARNING"]) >= 8)
        assert sum("expected the name of an action" in r.message for r in caplog.records) == 3
        assert (viewer.state.look.exposure, viewer.state.color.by) == (1.0, "speed")
        assert not viewer.state.cuts.plane
    from websockets.exceptions import ConnectionClosed

    for first, said, code in (("x", "x", 1011), (hello(), 100_000 * "x", 1009)):
        with closing(link(viewer.address)) as one, pytest.raises(ConnectionClosed) as closed:  # noqa: PT012
            one.send(first)
            one.send(said)
            told(one, lambda model: False)
        assert closed.value.rcvd.code == code


def test_two_data_sets_share_camera_and_colors_which_are_seen_through_water():
    first, second = blob(150), blob(150, 2)
    source = CompareSource(open_source(first), open_source(second))
    look, camera = {"color__by": "speed", "look__preset": "clay"}, gb.Camera((0, 0, 6), (0, 0, 0))
    seen = traced(source, camera, (80, 60), compare__at=0.25, **look)
    values = np.concatenate([first.attributes["speed"], second.attributes["speed"]])
    assert source.maker.range == pytest.approx((values.min(), values.max()))
    assert source.second.maker.range == source.first.maker.range
    for at, whole in ((1.0, 0), (0.0, 1)):
        one = traced(source, camera, (80, 60), compare__at=at, **look).picture
        columns = np.s_[:, 20:] if whole else np.s_[:, :20]
        assert np.array_equal(seen.picture[columns], one[columns])
    seen.refine(2)
    assert (seen.samples, seen.distance.shape) == (3, (60, 80))
    with pytest.raises(ValueError, match="compare: expected particles or meshes"):
        CompareSource(open_source(first), open_source([first, second]))
    source = open_source([gb.Layer(blob(150)), gb.Layer(blob(150, 2))])
    camera, size = gb.Camera((0, 0, 6), (0, 0, 0)), (60, 40)
    both, first, second = (traced(source, camera, size, layers__hidden=number).picture for number in ("", "2", "1"))
    assert np.array_equal(first, gb.render(blob(150), camera, size).picture)
    assert not np.array_equal(second, both)
    with view(blob(150), preset="water") as made:
        state, desk = made.state, made.page.desk
        desk._set(None, {"color__by": "speed"})
        assert (state.look.matter, state.look.transmission) == ("own", 0.0)
        desk._set(None, {"color__by": ""})
        assert state.look.matter == "preset"
        state.history.undo()
        assert (state.color.by, state.look.matter) == ("speed", "own")


@pytest.mark.browser
@pytest.mark.slow
def test_toolbar_layers_and_timeline_in_a_browser(chromium):
    with Watched([blob(150), blob(150, 2), blob(150, 3)], chromium) as watched:
        page, state = watched.page(), watched.viewer.state
        desk = page.locator("#globule-desk")

        def press(name):
            desk.get_by_role("button", name=name, exact=True).click()

        press("Layers")
        desk.get_by_label("Color by").select_option("speed")
        until(lambda: state.color.by == "speed")
        histogram = desk.get_by_role("img", name="Histogram of speed")
        histogram.wait_for()
        box = histogram.bounding_box()
        drag_along(page, [(box["x"] + share * box["width"], box["y"] + 20) for share in (0.25, 0.75)])
        page.mouse.up()
        until(lambda: not state.color.automatic)
        lowest, highest = (f(watched.viewer.source.particles().attributes["speed"])
                           for f in (np.min, np.max))  # fmt: skip
        shares = (np.array([state.color.low, state.color.high]) - lowest) / (highest - lowest)
        assert np.allclose(shares, [0.25, 0.75], atol=0.02)
        press("Whole range")
        until(lambda: state.color.automatic)
        press("Layers")
        press("Measure")
        until(lambda: page.hand.tool == "Measure")
        press("Cutting plane")
        until(lambda: state.cuts.plane)
        press("Undo the last change")
        until(lambda: not state.cuts.plane)
        press("Redo the setting")
        until(lambda: state.cuts.plane)
        desk.get_by_label("Position in time").focus()
        page.keyboard.press("End")
        until(lambda: watched.viewer.source.frame == 2)
        desk.get_by_text("3 / 3").wait_for()
        with page.expect_download() as got:
            press("Save view")
        assert 'by = "speed"' in got.value.path().read_text()
        press("Play or pause")
        until(lambda: state.time.playing)
        page.keyboard.press("Space")  # the mouse pressed that button: it is no button's now
        until(lambda: not state.time.playing)
        names = desk.locator("button, select, input").evaluate_all(
            "all => all.map(e => e.getAttribute('aria-label') || e.labels?.[0]?.innerText || e.innerText)"
        )
        assert all(name and name.strip() for name in names)
        open_section(page, "Save")
        desk.get_by_role("button", name="As command and Python").click()
        dialog = page.get_by_role("dialog")
        ends = [edges["x"] + edges["width"] for edges in (
            dialog.get_by_role("button", name="Close").bounding_box(), dialog.bounding_box())]  # fmt: skip
        assert ends[0] < ends[1]  # however long the lines of code are
        page.keyboard.press("Escape")
        open_section(page, "Camera")
        camera = page.client.camera
        page.reload()  # camera, tool and section stay as they are
        until(lambda: len(watched.viewer.clients) == 1 and page not in watched.viewer.clients)
        desk.get_by_role("button", name="Measure", pressed=True).wait_for()
        again = until(lambda: [c for c in watched.viewer.clients.values() if c is not page.client])[0]
        until(lambda: np.allclose(again.camera.eye, camera.eye, atol=1e-4), "for the camera")
        desk.get_by_role("tab", name="Camera", selected=True).wait_for()


@pytest.mark.browser
@pytest.mark.slow
def test_keys_reach_the_view_and_a_server_that_ended_is_said(chromium):
    with Watched(blob(150), chromium) as watched:
        page, state = watched.page(), watched.viewer.state
        page.get_by_role("button", name="Layers").click()
        by = page.get_by_label("Color by")
        by.select_option("speed")
        by.focus()
        page.keyboard.press("c")  # while a list has the focus
        until(lambda: state.cuts.plane)
        assert by.input_value() == "speed"
        banner = page.get_by_role("alert")
        until(lambda: not banner.is_visible())
        page.set_viewport_size({"width": 500, "height": 480})
        by.wait_for(state="hidden")  # as on a phone, where they would cover the image
        watched.viewer.close()
        page.get_by_text("The viewer does not answer").wait_for()


@pytest.mark.browser
@pytest.mark.slow
def test_a_finger_picks_and_cuts(chromium):
    with Watched(blob(150)) as watched:
        context = chromium.new_context(has_touch=True, is_mobile=True, viewport={"width": 390, "height": 700})
        page = context.new_page()
        page.goto(watched.viewer.address)
        client = until(lambda: next(iter(watched.viewer.clients.values()), None))
        page.client, hand = client, until(lambda: next(iter(watched.viewer.page.tools.hands.values()), None))
        watched.still(page)
        until(lambda: client.room.top > 0 and client.pacer.full == (390, 700))
        watched.still(page)
        seen = client.frame.mask
        rows, columns = (int(v) for v in np.argwhere(seen).mean(axis=0) / seen.shape * (700, 390))
        page.touchscreen.tap(columns, rows)
        until(lambda: hand.picked, "for the tap to pick")
        page.get_by_role("button", name="Cut", exact=True).tap()
        until(lambda: hand.tool == "Cut")
        talk = context.new_cdp_session(page)
        page.get_by_role("button", name="Cut", exact=True, pressed=True).wait_for()

        def touch(kind, *places):
            points = [{"x": x, "y": y, "id": 1} for x, y in places]
            talk.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})

        touch("touchStart", (columns - 60, rows - 40))
        for i in range(8):
            touch("touchMove", (columns - 60 + 15 * i, rows - 40 + 10 * i))
        touch("touchEnd")
        until(lambda: watched.viewer.state.cuts.plane, "for the finger's stroke to cut")
        context.close()
