"""What a hand and instruments feel, on the viewer's page."""

import threading
from types import SimpleNamespace

import globule as gb
import numpy as np
import pytest
from test_sim_force import scene_with_grasper
from viewer_helpers import Watched, drag_along, middle, next_frame, steps, take_tool, until, view
from waiting import PATIENCE

pytest.importorskip("websockets")

from globule.sim.tissue import BALL
from globule.viewer.desk_model import Model
from globule.viewer.forces import force_words, forces, newtons
from globule.viewer.open import open_source
from globule.viewer.page.play import Play
from globule.viewer.plots import over_time
from globule.viewer.simulation_source import GRASP
from globule.viewer.state import State

BROWSERS = True  # see hang_guard


def hand_at(point) -> SimpleNamespace:
    camera = gb.Camera(tuple(np.add(point, (0.3, 0, 0))), tuple(point), (0, 0, 1))
    client = SimpleNamespace(camera=camera, frame=SimpleNamespace(size=(100, 100)))
    return SimpleNamespace(client=client, on_surface=lambda screens: [tuple(point)])


def held_block():
    scene = scene_with_grasper("bonds")
    del scene["instruments"]
    scene["solids"][0]["fixed"] = [{"box": {"lo": [-1, -1, -1], "hi": [1, 1, 0.006]}}]
    return open_source(gb.Simulation(scene, device="cpu")), hand_at((0.008, 0.0, 0.028))


MIDDLE, ABOVE = (0.5, 0.5), (0.5, 0.46)


def test_a_hand_that_pulls_is_said_its_force_in_two_digits():
    source, hand = held_block()
    sim = source.simulation
    steps(source, 2)
    assert source.pull_words() == ""
    source.grasp(hand, "start", MIDDLE, MIDDLE)
    assert source.pull_words() == ""  # until a step has held it
    steps(source, 20)
    rest = np.linalg.norm(sim.tools.grasp_force(GRASP)[0])
    assert source.pull_words() == newtons(rest)
    source.grasp(hand, "move", MIDDLE, ABOVE)
    steps(source, 40)
    force = sim.tools.grasp_force(GRASP)[0]
    assert source.pull_words() == newtons(np.linalg.norm(force))
    assert force[2] < -5 * rest  # the tissue pulls the hand down
    assert forces(sim)["hand"] == np.linalg.norm(force)
    source.grasp(hand, "end", MIDDLE, ABOVE)
    assert source.pull_words() == ""  # before any further step
    steps(source, 1)
    assert forces(sim)["hand"] == 0.0
    plot = over_time(source, "force of hand")
    assert (plot["name"], plot["unit"]) == ("force of hand", "N")
    assert max(plot["y"]) == pytest.approx(np.linalg.norm(force), rel=1e-4)
    source.grasp(hand, "start", MIDDLE, MIDDLE)
    steps(source, 2)
    source.reset()
    assert source.pull_words() == ""
    beside = hand_at((0.03, 0.03, 0.03))
    source.grasp(beside, "start", MIDDLE, MIDDLE)
    assert source.pull_words() == ""  # until a step has looked
    steps(source, 2)
    assert source.pull_words() == "nothing to hold here"
    source.grasp(beside, "end", MIDDLE, MIDDLE)
    assert source.pull_words() == ""
    said = {
        123.0: "120 N", 12.34: "12 N", 1.0: "1.0 N", 0.5: "0.50 N", 0.0123: "0.012 N",
        0.00994: "9.9 mN", 0.00999: "10 mN", 0.00072: "0.72 mN", 0.0: "0 mN",
    }  # fmt: skip
    assert {force: newtons(force) for force in said} == said


def test_the_page_does_not_wait_for_a_step_and_one_asked_for_comes_after_it():
    source, hand = held_block()
    source.grasp(hand, "start", MIDDLE, MIDDLE)
    steps(source, 2)
    model, names = Model(SimpleNamespace(source=source)), source.color_names()
    source.particles()
    source.version += 1  # after a cut; a step in progress would hold up a new copy
    inside, go_on = (threading.Event() for _ in range(2))
    step = source.simulation.step

    def slow():
        inside.set()
        assert go_on.wait(PATIENCE)
        return step()

    source.simulation.step = slow
    thread = threading.Thread(target=steps, args=(source, 1))
    thread.start()
    try:
        assert inside.wait(PATIENCE)
        assert source.color_names() == names
        before = model.pull()
        assert before.endswith("N")
        assert "hand: " + before in force_words(forces(source.simulation))
    finally:
        go_on.set()
        thread.join()
    source, _ = held_block()
    sim, step = source.simulation, source.simulation.step

    def once():
        sim.step = step
        report = step()
        source.step()  # as soon as `n_steps` says that this one is done
        return report

    sim.step = once
    steps(source, 1)
    assert sim.n_steps == 1
    for _ in range(2):
        source.advance(State())
    assert sim.n_steps == 2


def test_instruments_have_their_force_in_record_panel_and_plot():
    with view(gb.Simulation(scene_with_grasper("bonds"), device="cpu")) as viewer:
        source, panel = viewer.source, next(p for p in viewer.page.panels if isinstance(p, Play))
        sim = source.simulation
        assert "Force" not in panel.status.content
        sim.tools.set_pushers([(BALL, (0, 0, 0.002), (0, 0, 0.002), 0.004, (0, 0, 0))])
        for n in range(1, 4):
            source.step()
            viewer.engine.notify()
            until(lambda n=n: source.place == (n, n))
        row = sim.record.diagnostics[-1]
        grip, pusher = (np.linalg.norm(f) for f in (sim.tools["grip"].force,
                                                    sim.tools.pusher_force()[0]))  # fmt: skip
        assert (row["force_grip"], row["force_pusher 0"]) == (grip, pusher)
        assert grip > 0
        assert pusher > 0
        words = f"grip: {newtons(grip)} · pusher 0: {newtons(pusher)}"
        until(lambda: words in panel.status.content)
        browser, desk = SimpleNamespace(client_id=-1), viewer.page.desk
        assert "force of grip" in desk.model.of(browser)["series"]["names"]
        desk._watch(browser, "force of grip")
        assert desk.model.of(browser)["series"]["y"][-1] == pytest.approx(grip, rel=1e-4)
        with pytest.raises(ValueError, match="plot: expected a quantity"):
            desk._watch(browser, "force of nobody")


class Widget:
    """A widget that counts its updates, each of which every browser draws."""

    updates = 0
    label, color, content = "Run", None, ""

    def __setattr__(self, name, value):
        super().__setattr__(name, value)
        type(self).updates += 1


@pytest.mark.parametrize("held", [False, True])
def test_forces_cost_the_panel_no_update_more(held, monkeypatch):
    monkeypatch.setattr(Widget, "updates", 0)
    source, hand = held_block()
    if held:
        source.grasp(hand, "start", MIDDLE, ABOVE)
    panel = object.__new__(Play)
    panel.viewer = SimpleNamespace(source=source)
    panel.status = Widget()
    for n in range(1, 6):
        steps(source, 1)
        panel.tick()
        assert Widget.updates == n
        force = forces(source.simulation)["hand"]
        assert (force > 0, f"hand: {newtons(force)}" in panel.status.content) == (held, held)
        panel.tick()
        assert Widget.updates == n


@pytest.mark.parametrize(("size", "unit", "factor"), [(0.05, "mm", 1e3), (1, "m", 1.0)])
def test_slider_and_label_say_the_depth_in_one_unit(size, unit, factor):
    domain = {"lo": [-size] * 3, "hi": [size] * 3}
    with view(gb.Simulation(scene_with_grasper("bonds") | {"domain": domain}, device="cpu")) as viewer:
        source, controls = viewer.source, viewer.gui.controls.values()
        slider = next(one for one in controls if one.label.startswith("Cut depth"))
        assert slider.label == f"Cut depth, {unit}"
        assert slider.hint.startswith(f"Depth below the surface, {unit};")
        assert slider.max == pytest.approx(factor * source.tissue_extent(), rel=0.05)
        assert slider.value == pytest.approx(factor * source.cut_depth)
        assert source.cut_words() == f"{slider.value:.3g} {unit} deep"
        slider.take(None, 0.5 * slider.max)
        assert source.cut_depth == pytest.approx(0.5 * slider.max / factor)
        assert source.cut_words() == f"{0.5 * slider.max:.3g} {unit} deep"
        slider.take(None, slider.max)
        assert source.cut_words() == "all through"


@pytest.mark.browser
@pytest.mark.slow
def test_a_label_says_the_force_while_a_hand_pulls(chromium):
    with Watched(gb.Simulation("cut-block", spacing=0.005), chromium) as watched:
        page, source = watched.page(), watched.viewer.source
        desk = page.locator("#globule-desk")
        label = desk.locator(".force")
        take_tool(page, "Grasp")
        desk.get_by_role("button", name="Grasp", pressed=True).wait_for()
        begin = middle(page)
        pointer = begin - (0, 90)
        drag_along(page, np.linspace(begin, pointer, 4))
        assert not label.is_visible()  # nothing is held before a step
        until(lambda: source._target is not None, "for the drag to arrive")
        for n in range(1, 5):
            source.step()
            watched.viewer.engine.notify()
            until(lambda n=n: source.simulation.n_steps == n)
        until(lambda: label.is_visible() and label.text_content() == source.pull_words())
        assert label.text_content().endswith("N")
        at = label.bounding_box()
        assert 0 < at["x"] - pointer[0] < 30  # beside the pointer
        assert -30 < at["y"] + at["height"] - pointer[1] < 10
        meter = page.context.new_cdp_session(page)
        meter.send("Performance.enable")

        def layouts() -> int:
            told = meter.send("Performance.getMetrics")["metrics"]
            return next(one["value"] for one in told if one["name"] == "LayoutCount")

        before = layouts()
        for way in np.linspace(0, 30, 31):
            page.mouse.move(*(pointer + (way, 0)))
            next_frame(page)
        assert layouts() - before < 15  # the label follows without a new layout
        page.mouse.up()
        label.wait_for(state="hidden")
        until(lambda: source.pull_words() == "")
        page.mouse.move(*begin)
        assert not label.is_visible()
