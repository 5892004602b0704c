"""Plots beside the image, measurements in the settings, and what is seen as a notebook."""

import json

import globule as gb
import numpy as np
import pytest
from viewer_helpers import Watched, blob, engine_of, steps, until, view

pytest.importorskip("websockets")

from globule.viewer.export import notebook
from globule.viewer.open import open_source
from globule.viewer.plots import along_line, marks_of, over_time
from globule.viewer.recording import Shot
from globule.viewer.state import State

BROWSERS = True  # see hang_guard
LINE = np.array([[-1.5, 0.1, 0.0], [1.5, 0.1, 0.2]])


def test_measurements_are_settings_and_values_along_a_line_and_over_time(tmp_path):
    source, state = open_source(blob(100)), State()
    assert marks_of(source, state) == []
    start, end = (tuple(p) for p in LINE.tolist())
    state.set(measure__shown=True, measure__start=start, measure__end=end)
    (mark,) = marks_of(source, state)
    assert (mark.points, mark.text) == ((start, end), f"{np.linalg.norm(LINE[1] - LINE[0]):.4g}")
    state.save(tmp_path / "view.toml")
    other = State()
    other.load(tmp_path / "view.toml")
    assert marks_of(source, other) == [mark]
    camera = gb.Camera((0, 0, 5), (0, 0, 0))
    with engine_of(blob(100), measure__start=start, measure__end=end) as engine:
        images = []
        for shown in (True, False):
            engine.state.set(measure__shown=shown)
            images.append(Shot(engine, camera, (160, 120), 1).picture)
    assert not np.array_equal(*images)
    particles = blob(200)
    particles.attributes["velocity"] = np.float32(particles.positions) * (1, 2, 3)
    scene, shares = gb.Scene(particles), np.linspace(0, 1, 160)
    points = np.float32(LINE[0] + shares[:, None] * (LINE[1] - LINE[0]))
    for name in ("speed", "field", ""):
        plot = along_line(scene, LINE, name)
        want = gb.measure.sample(scene, points, [plot["name"]])[plot["name"]]
        found = np.array([np.nan if v is None else v for v in plot["y"]])
        np.testing.assert_allclose(found, want, rtol=2e-5, atol=1e-6)
        assert plot["x"][-1] == pytest.approx(np.linalg.norm(LINE[1] - LINE[0]), rel=1e-5)
    plot = along_line(scene, LINE, "velocity")  # colored by its length
    reached = np.array([v is not None for v in plot["y"]])
    assert reached.any()
    assert not reached.all()
    assert min(v for v in plot["y"] if v is not None) >= 0
    json.dumps(plot, allow_nan=False)
    assert along_line(gb.Mesh(np.eye(3), [[0, 1, 2]]), LINE, "") is None
    source = open_source("dam-break")
    assert over_time(source) is None
    steps(source, 3)
    rows, plot = source.simulation.record.diagnostics, over_time(source, "compression")
    assert plot["x"] == pytest.approx([row["time"] for row in rows], rel=1e-5)
    assert plot["y"] == pytest.approx([100 * row["compression"] for row in rows], rel=1e-5)
    assert (plot["name"], plot["unit"]) == ("compression", "%")
    assert over_time(source, "nothing")["name"] == "largest speed"
    rows[1:2] = [dict(rows[1], time=rows[1]["time"] + 1e-9 * i) for i in range(5000)]
    long = over_time(source)
    assert len(long["x"]) <= 2 * 240
    assert long["x"][-1] == pytest.approx(rows[-1]["time"], rel=1e-5)
    assert over_time(open_source(blob(20))) is None


def test_a_notebook_has_the_code_the_command_and_what_it_needs(folder):
    facts = json.loads(notebook("t", "globule reconstruct a -o b && globule render b  # x", "1\n"))
    assert "the files of `globule reconstruct a -o b`" in "".join(facts["cells"][0]["source"])
    assert "# x" not in "".join(facts["cells"][3]["source"])
    gb.write("particles.npz", blob(200))
    with view("particles.npz") as viewer:
        viewer.state.set(color__by="speed", quality__samples=2)
        facts = json.loads(viewer.notebook(size=(120, 90)))
        command, code = viewer.equivalent(size=(120, 90))
    assert (facts["nbformat"], facts["nbformat_minor"]) == (4, 5)
    cells = ["".join(cell["source"]) for cell in facts["cells"]]
    kinds = [cell["cell_type"] for cell in facts["cells"]]
    assert (kinds, cells[1]) == (["markdown", "code", "code", "markdown"], code.rstrip("\n"))
    assert command.startswith("globule render particles.npz")
    assert command in cells[3]
    try:
        import nbformat
    except ImportError:
        return
    nbformat.validate(nbformat.from_dict(facts))


@pytest.mark.browser
@pytest.mark.slow
def test_a_measured_line_is_plotted_and_brushed(chromium):
    with Watched(blob(600), chromium) as watched:
        page, state = watched.page(), watched.viewer.state
        desk = page.locator("#globule-desk")
        state.set(color__by="speed")
        desk.get_by_role("button", name="Measure").click()
        hand = page.hand
        until(lambda: hand.tool == "Measure")
        card = desk.locator(".inspector").bounding_box()["x"]  # beside it, the view is fitted again
        until(lambda: page.client.room.right > 0)
        watched.still(page)
        row = page.client.frame.mask.shape[0] // 2
        first, second = np.percentile(np.flatnonzero(page.client.frame.mask[row]), (30, 60))
        assert second < card
        page.mouse.click(first, row)
        until(lambda: hand.picked)
        page.mouse.click(second, row)
        until(lambda: state.measure.shown)
        plot = desk.get_by_role("img", name="speed from 0 to")
        plot.wait_for()
        box = plot.bounding_box()
        y = box["y"] + box["height"] / 2
        page.mouse.move(box["x"] + 0.2 * box["width"], y)
        page.mouse.down()
        page.mouse.move(box["x"] + 0.7 * box["width"], y, steps=3)
        desk.locator(".plots .ends").get_by_text("at ").wait_for()
        page.mouse.up()
        until(lambda: not state.color.automatic)
        assert state.color.low < state.color.high
        desk.get_by_role("button", name="Remove the measurement").click()
        until(lambda: not state.measure.shown)
        until(lambda: not plot.is_visible())
