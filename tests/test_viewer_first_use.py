"""What somebody sees who opens the viewer for the first time: words, names, framing, undo."""

import re
from types import SimpleNamespace

import globule as gb
import numpy as np
import pytest
from globule.render.camera import Camera

pytest.importorskip("websockets")
from globule.viewer.first_view import FIRST_SIZE, first_camera, for_window
from globule.viewer.open import open_source
from globule.viewer.overlay import Mark, draw_marks, finish, free_below, origin_seen
from globule.viewer.page.tools import Hand
from globule.viewer.simulation_source import SimulationSource
from globule.viewer.state import State
from viewer_helpers import blob, view

CAMERA = Camera((0, 0, 5), (0, 0, 0))


def test_the_overlay_says_from_where_places_are_given():
    state = State()
    state.set(color__by="y", notes__box=True)
    picture = np.full((480, 640, 3), 200, np.uint8)
    more = {"bounds": np.array([(-1, -1, -1), (1, 1, 1)]), "size": (640, 480)}
    depth = np.full((480, 640), np.inf, np.float32)
    near, far = (
        finish(picture, state, CAMERA, [], [], depth, (0.0, 1.0), origin=origin, **more)
        for origin in ((0.0, 0.0, 0.0), (0.0, 5e6, 0.0))
    )
    changed = np.argwhere((near != far).any(axis=2))
    assert len(changed)
    assert changed[:, 1].max() > 500  # beside the legend
    assert changed[:, 1].min() < 320  # and at the box
    particles = gb.Particles(np.random.default_rng(0).random((99, 3)), origin=(440_750.0, 5e6, 0.0))
    frame = gb.render(gb.Scene(particles), (32, 24))
    assert origin_seen(frame) == (440_750.0, 5e6, 0.0)


def test_names_are_sharp_none_covers_another_and_a_click_takes_the_nearest():
    state = State()
    state.set(color__by="y")
    marks = [Mark(((0.0, 0.5, 0.0),), "scalpel")]
    small, large = (np.full((h, w, 3), 200, np.uint8) for h, w in ((60, 80), (600, 800)))
    seen = [finish(picture, state, CAMERA, marks, [], None, (0.0, 1.0), (800, 600)) for picture in (small, large)]
    assert np.array_equal(*seen)
    assert (seen[0] != large).any()
    assert finish(small, state, CAMERA, [], [], None, (0.0, 1.0)).shape == small.shape
    box = (10.0, 10.0, 60.0, 24.0)
    below = free_below(box, [box, (20.0, 24.0, 50.0, 38.0)])
    assert (below, free_below((100.0, 10.0, 160.0, 24.0), [box])) == (28.0, 0.0)
    picture, here = np.full((300, 400, 3), 200, np.uint8), ((0.0, 0.0, 0.0),)
    one = draw_marks(picture, CAMERA, [Mark(here, "scalpel")])
    two = draw_marks(picture, CAMERA, [Mark(here, "scalpel"), Mark(here, "suction")])
    rows = [np.flatnonzero((p[:, 215:] != 200).any(axis=(1, 2))) for p in (one, two)]
    assert len(rows[1]) > 1.8 * len(rows[0])
    frame, depth = SimpleNamespace(size=(200, 100)), np.full((100, 200), np.inf)
    depth[50, 80], depth[51, 82] = 1.0, 0.5
    hand = SimpleNamespace(_depth=lambda frame: depth)
    for click, found in (
        ((79, 50), (80, 50)),
        ((83, 51), (82, 51)),
        ((78, 50), None),  # 2 of 100 rows away
        ((0, 0), None),
        ((199, 99), None),
    ):
        assert Hand._nearest(hand, frame, *click) == found


@pytest.fixture(scope="module")
def block() -> SimulationSource:
    return SimulationSource("cut-block", gb.Simulation("cut-block", spacing=0.004))


def across(x: float) -> tuple[list, Camera]:
    return [(x, -0.02, 0.03), (x, 0.05, 0.03)], Camera((x, 0.015, 0.4), (x, 0.015, 0), (0, 1, 0))


def test_a_stroke_says_what_it_did_and_is_undone(block):
    sim, before = block.simulation, block.simulation.hash()
    block.cut_depth = 0.01
    assert block.cut_along(*across(0.09)) == "The stroke met no tissue."
    with pytest.raises(ValueError, match="undo: expected a cut"):
        block.undo()
    assert block.cut_along(*across(0.025)).startswith(f"**Cut {block.n_cut} bonds**, 1 piece.")
    assert block.n_cut > 10
    shallow = sim.tissue.n_bonds
    block.cut_depth = None
    assert "2 pieces" in block.cut_along(*across(0.0251))
    for _ in range(3):
        sim.step()
    assert "0.0000 s" in block.undo()
    assert (sim.n_steps, sim.tissue.n_bonds, sim.tissue.n_pieces) == (0, shallow, 1)
    block.undo()
    assert sim.hash() == before
    block.cut_depth = 0.01
    for i in range(7):
        block.cut_along(*across(0.01 + 0.004 * i))
    for _ in range(5):  # only so many are kept
        block.undo()
    with pytest.raises(ValueError, match="undo: expected a cut"):
        block.undo()


def test_one_undo_for_settings_and_cuts():
    with view("cut-block") as viewer:
        source, state, page = viewer.source, viewer.state, viewer.page
        source.cut_depth = 0.01
        state.set(look__preset="plain")
        viewer.cut_along(*across(0.025))
        bonds = source.simulation.tissue.n_bonds
        state.set(surface__threshold=0.7)
        assert source.n_cut > 10
        assert not page.cut_is_newest
        page.undo(None)
        assert state.surface.threshold is None
        assert page.cut_is_newest
        page.undo(None)
        assert source.simulation.tissue.n_bonds == bonds + source.n_cut
        assert not page.cut_is_newest
        page.undo(None)
        assert state.look.preset == "tissue"


def test_a_simulation_says_how_it_stands(block):
    block.reset()
    assert block.status() == "**paused** · 0.0000 s · 0 steps"
    block.play(True)
    assert block.status().startswith("**running, first step …**")
    block.advance(State())
    assert re.fullmatch(r"\*\*running\*\* · 0\.0.* · 1 step", block.status())
    block.play(False)
    assert block.status().startswith("**paused**")
    assert block.has_tissue
    assert 0.04 < block.tissue_extent() < 0.06
    assert not SimulationSource("dam-break", gb.Simulation("dam-break", spacing=0.08)).has_tissue


@pytest.mark.parametrize("aspect", [0.6, 1.2, 2.5])
@pytest.mark.parametrize("name", ["dam-break", "cut-block"])
def test_the_first_view_shows_all_of_a_scene(name, aspect):
    source = SimulationSource(name, gb.Simulation(name, spacing=0.08 if name[0] == "d" else 0.004))
    around, scene = source.outline(), source.layers(State())[0].scene
    camera = first_camera(scene, source.up, around, source.camera)
    size = (round(500 * aspect), 500)
    for eye, shape in ((camera, FIRST_SIZE), (for_window(camera, aspect, around), size)):
        seen = eye.project(around, shape) / shape
        assert (seen > 0).all()
        assert (seen < 1).all()
        assert np.ptp(seen, axis=0).max() > 0.6
    if name == "dam-break":  # the dry floor, but not the air above the water
        assert around[:, 0].max() > 1.5
        assert around[:, 2].max() < 0.7


@pytest.mark.parametrize("aspect", [0.6, 1.2, 2.5])
def test_no_surface_is_cut_off_by_the_window(aspect):
    with view(blob()) as viewer:  # the support is a tenth of it
        camera = for_window(viewer.first_camera, aspect, viewer._outline)
        scene = viewer.source.layers(viewer.state)[0].scene
        seen = gb.render(scene, camera, size=(round(200 * aspect), 200)).mask
    assert not seen[[0, -1]].any()
    assert not seen[:, [0, -1]].any()
    rows, columns = np.nonzero(seen)
    assert max(np.ptp(rows) / seen.shape[0], np.ptp(columns) / seen.shape[1]) > 0.7


def test_a_sequence_is_fitted_to_its_ends():
    base = np.random.default_rng(1).uniform(0, 1, (50, 3))
    source = open_source([gb.Particles(base + (0.5 * i, 0, 0), support=0.3) for i in range(5)])
    x = source.outline()[:, 0]
    assert x.min() < 0.1 < 2.9 < x.max()
    source.close()


@pytest.mark.parametrize("positions", [np.zeros((0, 3)), np.full((4, 3), 1e30), [[np.nan] * 3]])
def test_nothing_to_show_is_said_in_one_line(tmp_path, positions):
    path = tmp_path / "nothing.npz"
    np.savez(path, positions=np.asarray(positions, np.float32))
    with pytest.raises(ValueError, match="nothing to show: expected particles"):
        open_source(str(path))


def head() -> gb.volumes.Volume:
    values = np.zeros((20, 24, 28), np.uint8)
    values[4:16, 4:20, 4:24] = 180
    values[10, 12, 14] = 77
    return gb.volumes.Volume(values, np.diag([2.0, 2.0, 2.0, 1.0]), np.zeros(values.shape, np.uint8))


def test_a_slice_says_its_voxel_a_sweep_what_to_do_and_the_tab_its_name():
    source, state = open_source(head()), State()
    assert source.lengths() == pytest.approx((54, 46, 38))
    camera = Camera((28, 24, 200), (28, 24, 20), (0, 1, 0))
    found = source.probe(state, camera, (400, 400), (0.5, 0.5), np.inf).words
    assert (found["value"], found["voxel"]) == ("77", "14, 12, 10")
    assert found["position"].endswith("mm")
    assert source.probe(state, camera, (400, 400), (0.5, 0.5), 100.0) is None
    source, state, closed = open_source(head()), State(), State()
    closed.set(slices__open=False)
    (corner,) = source.layers(state)[0].clips
    assert not source.layers(closed)[0].clips
    towards = first_camera(source.layers(state)[0].scene, source.up, source.outline()).eye
    middle = np.array([28.0, 24.0, 20.0])
    step = 3 * np.sign(np.subtract(towards, middle))
    inside = [((np.array(corner.lo) < at) & (at < corner.hi)).all() for at in (middle + step, middle - step)]
    assert inside == [True, False]
    source, state = open_source(a_sweep()), State()
    assert "Press Play" in source.status()
    assert "press Play" in source.marks()[0].text
    source.start()
    assert source.marks() == []
    while source.advance(state) is not None:
        pass
    assert "3 images" in source.status()


def a_sweep():
    frames, poses = np.full((3, 20, 24), 120, np.uint8), np.repeat(np.eye(4)[None], 3, axis=0)
    poses[:, 2, 3] = np.arange(3)
    return gb.ultrasound.Sweep(frames, poses)


def test_a_range_is_kept():
    particles = blob()
    with view(particles) as viewer:
        color, widgets = viewer.state.color, viewer.page.binder.widgets
        viewer.state.set(color__by="speed")
        with viewer.source.lock:
            viewer.source.layers(viewer.state.snapshot())
        lo, hi = viewer.source.maker.range
        assert (lo, hi) == (*map(float, np.percentile(particles.attributes["speed"], (0, 100))),)

        def person(name: str, value: object) -> None:
            """As a browser does; its callbacks run in several threads, in any order."""
            widgets[name].take(SimpleNamespace(client_id=-1), value)

        person("color.automatic", False)
        assert (color.automatic, color.low, color.high) == (False, lo, hi)
        person("color.automatic", True)
        person("color.low", lo - 1)
        assert (color.automatic, color.low, color.high) == (False, lo - 1, hi)
        person("color.automatic", False)  # which was on its way
        assert (color.low, color.high) == (lo - 1, hi)


def test_saved_settings_open_the_same_view(tmp_path):
    path = tmp_path / "view.toml"
    with view(blob()) as viewer:
        viewer.state.set(surface__threshold=0.7)
        viewer.save_state(path)
    with view(blob(), state=path) as again:
        assert (again.state.surface.threshold, again.first_camera) == (0.7, viewer.first_camera)


@pytest.mark.parametrize("what", ["sequence", "dam-break", "cut-block", "sweep"])
def test_every_control_says_what_it_does(what):
    made = {"sequence": [blob(50), blob(50, 2)], "sweep": a_sweep()}.get(what, what)
    with view(made) as viewer:
        controls = [one for one in viewer.gui.controls.values() if one.kind != "markdown"]
        assert len(controls) > 40
        assert not [one.label for one in controls if not one.hint]
