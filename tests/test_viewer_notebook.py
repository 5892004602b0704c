"""The notebook's widget: its messages, and its JavaScript in a real browser."""

import base64
import io
import json
from contextlib import closing

import globule as gb
import numpy as np
import pytest
from PIL import Image
from viewer_helpers import blob, our_threads, until

anywidget = pytest.importorskip("anywidget")

BROWSERS = True  # see hang_guard


@pytest.fixture
def made():
    from globule.viewer import widget

    one = widget(blob(), height=200)
    one.state.set(quality__samples=2)
    one.sent = []
    one.send = lambda content, buffers=None: one.sent.append((content, buffers))
    yield one
    one.close()
    until(lambda: not our_threads())


def say(one, **content) -> None:
    one._handle_custom_msg(content, [])


def test_pictures_come_once_the_cell_knows_its_size(made):
    until(lambda: made.client.pacer._wanted, "for the engine to look at the cell")
    assert not made.sent
    view = made.view
    say(made, type="camera", size=[300, 200], **view)

    def sharp():
        for content, _ in list(made.sent):
            if content["type"] == "picture":
                say(made, type="ack", number=content["number"])
        return [s for s in made.sent if s[0]["still"]]

    _, buffers = until(sharp)[-1]
    with Image.open(io.BytesIO(buffers[0])) as image:
        assert image.size == (300, 200)
        picture = np.asarray(image.convert("RGB")).astype(int)
    assert np.abs(picture - gb.render(gb.Scene(blob()), gb.Camera(**view), (300, 200)).picture).mean() < 4


def test_a_cell_that_does_not_answer_gets_two_pictures_and_errors(made):
    for i in range(8):
        view = dict(made.view, eye=np.add(made.view["eye"], (0.1 * i, 0, 0)).tolist())
        say(made, type="camera", size=[160, 120], **view)
        until(lambda c=made.client.camera: (made.client.pacer._wanted or [None])[0] == c)
    until(lambda: len(made.sent) == 2 and not made.client.pacer.making)
    assert [c["number"] for c, _ in made.sent] == [1, 2]
    view = {"eye": [0, 0, 0], "look_at": [0, 0, 0], "up": [0, 1, 0], "fov": 40}
    say(made, type="camera", size=[160, 120], **view)
    assert made.sent[-1][0]["type"] == "error"


def test_a_click_says_values_the_bar_sets_and_a_saved_notebook_holds_the_image(made):
    say(made, type="camera", size=[160, 120], **made.view)
    until(lambda: made.client.frame is not None and made.client.frame.mask.any())
    say(made, type="set", color__by="speed", cuts__plane=True)
    assert (made.state.color.by, made.state.cuts.plane) == ("speed", True)
    say(made, type="set", color__by="nothing")
    assert made.sent[-1][0]["message"].startswith("color: expected one of")
    rows, columns = np.nonzero(made.client.frame.mask)
    size = made.client.frame.size
    say(made, type="click", place=[(columns[0] + 0.5) / size[0], (rows[0] + 0.5) / size[1]])
    text = until(lambda: [c["text"] for c, _ in made.sent if c["type"] == "said"])[-1]
    assert "speed" in text or "no surface" in text
    bundle = made._repr_mimebundle_()
    data = bundle[0] if isinstance(bundle, tuple) else bundle
    with Image.open(io.BytesIO(base64.b64decode(data["image/png"]))) as image:
        assert image.size == (640, 150)


PAGE = """
<div id=here style="width:400px"></div>
<script type=module>
const source = %s;
const url = URL.createObjectURL(new Blob([source], {type: "text/javascript"}));
const widget = (await import(url)).default;
window.sent = [];
const heard = [];
const model = {
  get: (name) => ({height: 200, names: ["speed"], view: {eye: [0, 0, 5], look_at: [0, 0, 0], up: [0, 1, 0],
                                       fov: 40}})[name],
  send: (message) => window.sent.push(message),
  on: (_, called) => heard.push(called), off: () => {},
};
window.show = (number, bytes) =>
  heard[0]({type: "picture", number, still: true}, [new Uint8Array(bytes).buffer]);
widget.render({model, el: document.getElementById("here")});
window.ready = true;
</script>
"""


@pytest.mark.browser
@pytest.mark.slow
def test_the_widget_in_a_browser(chromium):
    from globule.viewer import notebook
    from globule.viewer.encode import jpeg

    script = notebook.script()
    with closing(chromium.new_page()) as page:
        page.set_content(PAGE % json.dumps(script))
        page.wait_for_function("window.ready")
        page.wait_for_function("window.sent.some(m => m.type == 'camera')")
        first = page.evaluate("window.sent.at(-1)")
        assert (first["size"], first["eye"]) == ([400, 200], [0, 0, 5])
        picture = np.zeros((20, 40, 3), np.uint8)
        picture[..., 0] = 250
        page.evaluate("([n, bytes]) => window.show(n, bytes)", [7, list(jpeg(picture, 95))])
        page.wait_for_function("window.sent.some(m => m.type == 'ack' && m.number == 7)")
        with Image.open(io.BytesIO(page.locator("img").screenshot())) as image:
            shown = np.asarray(image.convert("RGB"))
        assert shown[100, 200, 0] > 230
        assert shown[100, 200, 1] < 20
        box = page.locator("img").bounding_box()
        page.mouse.click(box["x"] + 100, box["y"] + 50)
        page.wait_for_function("window.sent.at(-1).type == 'click'")
        assert page.evaluate("window.sent.at(-1).place") == pytest.approx([0.25, 0.25], abs=0.01)
        page.get_by_label("Color by").select_option("speed")
        page.wait_for_function("window.sent.at(-1).color__by == 'speed'")
        page.mouse.move(200, 100)
        page.mouse.down()
        page.mouse.move(300, 100, steps=4)
        page.mouse.up()
        turned = page.evaluate("window.sent.at(-1)")
        assert turned["eye"][0] < -1
        assert abs(np.hypot(*turned["eye"][::2]) - 5) < 1e-6
        page.mouse.wheel(0, 500)
        page.wait_for_function("Math.hypot(...window.sent.at(-1).eye) > 6")
        page.mouse.down(button="right")
        page.mouse.move(260, 150, steps=3)
        page.mouse.up(button="right")
        assert page.evaluate("window.sent.at(-1)")["look_at"] != [0, 0, 0]
