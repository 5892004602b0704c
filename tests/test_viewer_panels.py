"""The groups of controls: what their widgets set, what settings do to the image, downloads."""

import io
from types import SimpleNamespace

import globule as gb
import numpy as np
import pytest
from PIL import Image
from viewer_helpers import Watched, blob, engine_of, open_section, silhouette, traced, type_number, until

pytest.importorskip("websockets")

from globule.viewer.page.jobs import Cancelled, Job
from globule.viewer.page.tools import add_color, titled
from globule.viewer.recording import Recorder, Shot, turntable

BROWSERS = True  # see hang_guard
FRONT = gb.Camera((0, 0.5, 5), (0, 0, 0))


@pytest.fixture
def watched():
    with Watched(blob(100)) as made:
        yield made


@pytest.fixture
def page(watched):
    return watched.program()


def panel(watched, name):
    return next(p for p in watched.viewer.page.panels if type(p).__name__ == name)


def another(control, value):
    if isinstance(value, bool):
        return not value
    if control.options:
        return next(option for option in reversed(control.options) if option != value)
    if isinstance(value, str):
        return "words"
    if isinstance(value, tuple):
        return tuple(0.5 * v + 0.1 for v in value)
    if control.max is not None:
        half = (control.min + control.max) / 2
        return type(value)(half if half != value else control.max)
    return value + 1.0


def test_each_control_sets_its_setting_and_a_preset_is_one_change(watched):
    state, binder = watched.viewer.state, watched.viewer.page.binder
    page = watched.program(answers=False)  # gets few images meanwhile
    assert len(binder.widgets) > 40
    for key, control in binder.widgets.items():
        group, name = key.split(".")
        before, value = getattr(getattr(state, group), name), another(control, control.value)
        page.ask("control", [control.number, value])
        until(lambda g=group, n=name, b=before: getattr(getattr(state, g), n) != b, key)
        if not isinstance(before, str):  # some options stand for others
            assert getattr(getattr(state, group), name) == pytest.approx(value), key
        shown = control.value
        state.set(**{key.replace(".", "__"): before})
        until(lambda c=control, s=shown: c.value != s, key)
    state, page = watched.viewer.state, watched.program(answers=False)
    before, version = state.to_toml(), state.version
    page.set("Preset", "glass")
    until(lambda: state.version > version, "for the preset")
    assert (state.look.preset, state.look.shadows) == ("glass", True)
    state.history.undo()
    assert state.to_toml() == before


@pytest.mark.parametrize(("before", "change"), [
    ({}, {"surface__kernel": "wendland_c2"}), ({}, {"surface__support": 0.6}),
    ({}, {"surface__threshold": 1.5}), ({}, {"surface__root": "march"}), ({}, {"look__preset": "water"}),
    ({"look__ground": "plain"}, {"look__ambient_rays": 8}), ({}, {"look__sky": "gradient"}),
    ({}, {"look__ground": "checker"}), ({}, {"look__shadows": True}), ({}, {"look__exposure": 2.0}),
    ({}, {"look__background": (0.0, 0.6, 0.0)}), ({}, {"look__lights": "own"}),
    ({"look__lights": "own"}, {"look__azimuth": 120.0}),
    ({"look__sky": "gradient"}, {"look__matter": "own", "look__reflection": 1.0}),
    ({"look__sky": "gradient", "look__matter": "own", "look__reflection": 1.0}, {"look__bounces": 0}),
    ({}, {"color__by": "speed"}), ({"color__by": "speed"}, {"color__legend": False}),
    ({"color__by": "speed"}, {"color__automatic": False, "color__high": 10.0}),
    ({"color__by": "speed"}, {"color__colormap": "gray"}), ({}, {"notes__scale_bar": True}),
    ({}, {"cuts__plane": True}),
    ({}, {"cuts__box": True, "cuts__lo": (-3.0, -3.0, 0.2), "cuts__hi": (3.0, 3.0, 3.0)}),
    ({}, {"cuts__sphere": True, "cuts__keep_sphere": True, "cuts__radius": 0.5}),
], ids=lambda value: "-".join(value) or "plain")  # fmt: skip
def test_each_setting_changes_the_image(before, change):
    with engine_of(blob(100), **before) as engine:
        first = Shot(engine, FRONT, (160, 120), 1).picture
        engine.state.set(**change)
        second = Shot(engine, FRONT, (160, 120), 1).picture
    assert not np.array_equal(first, second)
    if any(name.startswith("cuts") for name in change):
        assert 0 < silhouette(second) < silhouette(first)
    if change.get("color__colormap") == "gray":
        assert np.ptp(second[50:70, 70:90].astype(int), axis=2).max() < 40


def test_a_click_says_the_value_that_colors_though_no_attribute_has_its_name():
    velocity = np.tile((3.0, 4.0, 0.0), (150, 1))
    moving = gb.Particles(blob(150).positions, support=0.35, attributes={"velocities": velocity})
    with engine_of(moving) as engine:
        frame = traced(engine.source, FRONT, (40, 30), color__by="speed")
        found = frame.pick(20, 15)
        add_color(found, frame, "speed")
        add_color(found, frame, "no such value")
    assert titled(found, "speed") == "speed 5"
    assert list(found.attributes) == ["speed", "velocities"]


def test_a_click_says_what_is_there_two_measure_and_buttons_cut(watched, page):
    hand = page.hand

    def click(x, y):
        hand.click((x, y))

    click(0.5, 0.5)
    (found,) = hand.picked
    assert f"| particle | {found.particle:,} |" in hand.text
    assert "speed" in hand.text
    scene, size = watched.viewer.source.layers(watched.viewer.state)[0], page.client.frame.size
    direct = gb.render(scene, page.client.camera, size).pick(size[0] // 2, size[1] // 2)
    assert np.allclose(direct.position, found.position, atol=1e-5)
    hand.use("Measure")
    click(0.45, 0.5)
    assert hand.said == "Click the second point."
    click(0.01, 0.99)  # beside the surface: the first point stays
    assert hand.said == "There is no surface here."
    click(0.55, 0.55)
    a, b = (p.position.astype(float) for p in hand.picked)
    assert f"Distance {np.linalg.norm(b - a):.6g}" in hand.said
    assert watched.viewer.state.measure.shown
    cuts = watched.viewer.state.cuts
    for face, normal in (("x", (1, 0, 0)), ("flip", (-1, 0, 0)), ("z", (0, 0, 1))):
        page.set("Faces", face)
        until(lambda normal=normal: cuts.plane and cuts.normal == normal)
    page.set("Faces", "view")
    until(lambda: cuts.normal != (0.0, 0.0, 1.0))
    camera = page.client.camera
    away = np.subtract(camera.eye, camera.look_at)
    assert np.allclose(cuts.normal, away / np.linalg.norm(away), atol=1e-3)
    page.set("Remove all cuts")
    until(lambda: not cuts.plane)
    hand.use("Rotate, pick")
    click(0.5, 0.5)
    assert (len(hand.picked), len(page.client.marks)) == (1, 1)
    watched.viewer.state.set(color__by="speed")
    assert (len(hand.picked), len(page.client.marks)) == (1, 1)
    watched.viewer.state.set(cuts__plane=True)  # the point may be gone
    assert (hand.picked, page.client.marks, hand.said) == ([], [], "")
    watched.viewer.state.set(cuts__plane=False, color__by="")


def test_views_bookmarks_and_fit(watched, page):
    viewer, first = watched.viewer, page.client.camera

    def from_the(axis, sign) -> bool:
        away = np.subtract(page.client.camera.eye, page.client.camera.look_at)
        return sign * away[axis] > 0.99 * np.linalg.norm(away)

    page.set("Look from", "left")
    until(lambda: from_the(0, -1))
    page.set("Add bookmark")
    kept = until(lambda: viewer.state.bookmarks.get("view 1"))
    page.command("Look from: top")
    until(lambda: from_the(1, 1))
    page.set("Go")
    until(lambda: from_the(0, -1))
    assert np.allclose(kept.eye, page.client.camera.eye, atol=1e-4)
    until(lambda: page.camera["eye"] == list(page.client.camera.eye), "for the page to know")
    page.look(eye=(4 * np.array(kept.eye)).tolist())
    until(lambda: np.linalg.norm(page.client.camera.eye) > 3 * np.linalg.norm(kept.eye))
    far = silhouette(watched.still(page))
    page.ask("fit")
    watched.still(page, lambda p: silhouette(p) > 1.2 * far)
    page.command("First view")
    until(lambda: page.client.camera == first, "for the view that the page began with")
    assert page.client.first


def test_parallel_rays(watched, page):
    viewer, near = watched.viewer, silhouette(watched.still(page))
    first = page.client.camera
    page.command("Perspective or orthographic")
    until(lambda: page.client.camera.height)
    assert 0.7 < silhouette(watched.still(page)) / near < 1.3
    page.command("Look from: left")
    until(lambda: page.client.camera.eye[0] < -1)
    whole, left = silhouette(watched.still(page)), page.client.camera
    assert left.height
    assert viewer.state.load_toml(viewer.state.to_toml(left)) == left
    assert f"--ortho {left.height:.9g}" in viewer.equivalent(left, (320, 200))[0]
    page.hand.use("Cut")
    for phase, x in (("start", 0.2), ("move", 0.5), ("end", 0.8)):
        page.hand._drawn(phase, (0.2, 0.5), (x, 0.5))
    assert np.allclose(np.abs(viewer.state.cuts.normal), (0, 1, 0), atol=0.02)
    watched.still(page, lambda p: silhouette(p) < 0.8 * whole)
    page.command("Perspective or orthographic")
    until(lambda: page.client.camera.height is None)
    assert page.client.camera.fov == pytest.approx(first.fov, abs=0.1)


def test_a_saved_picture_is_the_servers(watched, page, tmp_path):
    from globule.formats.pictures.exr import read_exr

    page.set("Size", "99999x99999")
    until(lambda: panel(watched, "Save").size.value == "99999x99999")
    page.ask("picture")
    page.heard("size: expected sides of")
    page.set("Size", "80x60")
    page.set("Samples", 2)
    until(lambda: panel(watched, "Save").size.value == "80x60")
    until(lambda: panel(watched, "Save").samples.value == 2)
    page.command("Save image")
    data = until(lambda: page.files.get("100_particles.png"))
    wanted = Shot(watched.viewer.engine, page.client.camera, (80, 60), 2).picture
    with Image.open(io.BytesIO(data)) as image:
        assert np.array_equal(np.asarray(image), wanted)
    page.set("Image format", "EXR")
    until(lambda: panel(watched, "Save").format.value == "EXR")
    page.ask("picture")
    (tmp_path / "a.exr").write_bytes(until(lambda: page.files.get("100_particles.exr")))
    assert read_exr(tmp_path / "a.exr", 10**6).shape == (60, 80, 3)


def pictures(path) -> np.ndarray:
    av = pytest.importorskip("av")
    with av.open(str(path)) as movie:
        return np.array([f.to_ndarray(format="rgb24").astype(int) for f in movie.decode(video=0)])


def test_a_recording_is_as_long_as_its_time(tmp_path):
    """30 images a second, whatever the time that they take; each shows what is there then."""
    pytest.importorskip("av")
    path, now = tmp_path / "a.mp4", [5.0]
    with engine_of(blob(60)) as engine:
        recorder = Recorder(engine, lambda: FRONT, path, (80, 60), 30.0, clock=lambda: now[0])
        until(lambda: recorder.n_pictures == 1)
        now[0] += 0.5
        until(lambda: recorder.n_pictures == 16)
        engine.state.set(surface__threshold=1.8)
        now[0] += 1.0
        until(lambda: recorder.n_pictures == 46)
        recorder.stop()
    found = pictures(path)
    assert found.shape == (46, 60, 80, 3)
    assert silhouette(found[-1]) < 0.95 * silhouette(found[0])


def test_record_stops_where_it_was_started(watched, page, tmp_path):
    pytest.importorskip("av")
    save = panel(watched, "Save")
    save.size.value = "64x48"
    page.ask("record")
    page.heard("button to stop")
    page.ask("record")
    (tmp_path / "a.mp4").write_bytes(until(lambda: page.files.get("100_particles.mp4")))
    assert pictures(tmp_path / "a.mp4").shape[1:] == (48, 64, 3)
    assert not save._recorders


def test_a_turntable_goes_once_around(tmp_path):
    pytest.importorskip("av")
    path, said = tmp_path / "a.mp4", []
    with engine_of(blob(60)) as engine:
        turntable(engine, FRONT, path, (96, 64), 1.0, 12, samples=1, progress=said.append)
    found = pictures(path)
    away = [np.abs(p - found[0]).mean() for p in found]
    assert len(found) == 12
    assert away[6] > 3
    assert away[-1] < away[6]
    assert (said, said[0], said[-1]) == (sorted(said), 0.0, 1.0)


def test_a_job_says_how_far_it_is():
    note, now = SimpleNamespace(body="0 %"), [0.0]
    job = Job(lambda *_, **__: note, "T", lambda: now[0])
    for time, share, said in ((0.1, 0.1, "0 %"), (10, 0.2, "20 %, 40 s left"), (30, 0.95, "95 %")):
        now[0] = time
        job.progress(share)
        assert note.body.startswith(said)
    assert "left" not in note.body
    job.cancelled = True
    with pytest.raises(Cancelled):
        job.progress(0.99)


def test_one_turntable_at_a_time_which_can_be_cancelled(watched, page):
    pytest.importorskip("av")
    save = panel(watched, "Save")
    save.size.value, save.seconds.value = "640x480", 60
    page.set("Turntable movie")
    until(lambda: save._jobs)
    page.set("Turntable movie")
    page.heard("turntable: one is in progress")
    page.set("Cancel")
    until(lambda: not save._jobs, "for the turntable to end")
    until(lambda: not save.cancel_button.visible, "for its button to go")


def test_settings_are_saved_and_loaded_and_statistics_shown(watched, page):
    state = watched.viewer.state
    state.set(surface__threshold=1.2, cuts__plane=True, look__exposure=1.5)
    page.ask("state")
    saved = until(lambda: page.files.get("100_particles-view.toml")).decode()
    state.load_toml("[quality]\nsamples = 1\n")
    page.ask("load", ["view.toml", saved])
    until(lambda: state.cuts.plane, "for the settings to come")
    assert (state.surface.threshold, state.look.exposure) == (1.2, 1.5)
    wide = "[surface]\nsupport = 1e9\n"  # nobody could wait for such a picture
    page.ask("load", ["wide.toml", wide])
    support = watched.viewer.page.binder.widgets["surface.support"]
    until(lambda: state.surface.support == support.max == support.value, "for the end")
    page.heard("got 1e+09")
    version = state.version
    for text, said in (
        ("[look]\nsky = 3\n", "bad.toml: look.sky"),
        ("# " + 262_200 * "x", "bad.toml: state: expected at"),
    ):
        page.ask("load", ["bad.toml", text])
        page.heard(said)
    assert state.version == version
    table = panel(watched, "Statistics").table(page.client)
    for words in ("trace", "latency", "| particles | 100 |", "| browsers | 1 |"):
        assert words in table


@pytest.mark.browser
@pytest.mark.slow
def test_each_kind_of_widget_in_a_browser(chromium, tmp_path):
    with Watched(blob(100), chromium) as watched:
        page, state = watched.page(), watched.viewer.state
        open_section(page, "Layer")
        for text in ("0.5", "0.109", "1.05"):
            box = type_number(page, "Support", text)
            until(lambda text=text: state.surface.support == float(text))
            assert box.input_value() == text
        assert not page.get_by_text("Not possible").count()
        type_number(page, "Support", "1000000000")
        page.get_by_text("got 1e+09").first.wait_for()
        page.get_by_label("Kernel", exact=True).select_option("wendland_c2")
        until(lambda: state.surface.kernel == "wendland_c2")
        open_section(page, "Image")
        page.get_by_label("Scale bar", exact=True).set_checked(not state.notes.scale_bar)
        open_section(page, "Camera")
        page.get_by_role("button", name="right", exact=True).click()
        until(lambda: page.client.camera.eye[0] > 1)
        page.keyboard.press("5")
        until(lambda: page.client.camera.eye[1] > 1, "for the view from above")
        before = page.client.camera.look_at
        page.keyboard.down("w")
        until(lambda: page.client.camera.look_at != before, "for W to fly")
        page.keyboard.up("w")
        for _ in range(2):  # one dialog, which Escape closes
            page.keyboard.press("h")
            page.locator("dialog").get_by_text("fly forwards").wait_for()
            assert page.locator("dialog[open]").count() == 1
            page.keyboard.press("Escape")
            until(lambda: not page.locator("dialog[open]").count())
        page.keyboard.press("Control+k")
        page.keyboard.type("azimuth")
        page.keyboard.press("Enter")
        page.get_by_label("Sun azimuth", exact=True).wait_for()
        open_section(page, "Save")
        size = page.get_by_label("Size", exact=True)
        size.fill("64x48")
        size.press("Enter")
        until(lambda: panel(watched, "Save").size.value == "64x48")
        with page.expect_download() as download:
            page.get_by_role("button", name="Screenshot").click()
        assert download.value.suggested_filename == "100_particles.png"
        with Image.open(download.value.path()) as image:
            assert image.size == (64, 48)
        (tmp_path / "view.toml").write_text("[cuts]\nplane = true\n")
        with page.expect_file_chooser() as chooser:
            page.get_by_role("button", name="Load view").click()
        chooser.value.set_files(str(tmp_path / "view.toml"))
        until(lambda: state.cuts.plane, "for the settings to come")


HOSTILE = ["<iframe srcdoc='<script>x</script>'>", "![x](http://x.example/)", "{x}", "`x`", "|x|"]


def sent_as_markdown(program):
    for message in program.kept:
        for control in message.get("controls", ()):
            if text := control.get("content"):
                yield text
        if text := message.get("dialog", {}).get("text") or message.get("picked"):
            yield text


def hostile_particles():
    cloud = blob(400)
    attributes = {name: cloud.attributes["speed"] for name in HOSTILE}
    return gb.Particles(cloud.positions, support=0.35, attributes=attributes)


def hostile_simulation():
    ball = {"center": [0.7, 0.7, 0.7], "radius": 0.2}
    box = {"lo": [0.2, 0.2, 0.2], "hi": [0.6, 0.6, 0.6]}
    return gb.Simulation({
        "spacing": 0.1, "domain": {"lo": [0, 0, 0], "hi": [1, 1, 1]},
        "fluids": [{"name": HOSTILE[0], "box": box}], "rigids": [{"name": HOSTILE[1], "sphere": ball}],
    }, device="cpu")  # fmt: skip


@pytest.mark.parametrize("make", [hostile_particles, hostile_simulation])
def test_names_of_a_file_are_text(make):
    """The page writes no HTML; and names may mean nothing as Markdown either."""
    shown = make()
    with Watched(shown, title=HOSTILE[0]) as made:
        program, names = made.program(), made.viewer.source.color_names()
        for name in [n for n in HOSTILE if n in names] or names[:1]:
            made.viewer.state.set(color__by=name)
        program.hand.click((0.5, 0.5))
        until(lambda: any("position" in text for text in sent_as_markdown(program)))
        panel(made, "Save").show_equivalent(next(iter(made.viewer.page.desk.browsers.values())))
        until(lambda: any("```sh" in text for text in sent_as_markdown(program)))
        found = list(sent_as_markdown(program))
        assert len(found) > 3
        for text in found:
            for name in HOSTILE:
                assert name not in text or text.startswith("```"), text


def test_code_ends_where_it_ends():
    from globule.viewer.markdown import code

    assert (code("x", "sh"), code("\n````\n<b>", "sh")) == ("```sh\nx\n```", "`````sh\n\n````\n<b>\n`````")
