"""What people met who used the viewer: each a fault once."""

import base64
import os
import socket
import time

import globule as gb
import numpy as np
import pytest
from viewer_helpers import blob, engine_of, traced, until, view

pytest.importorskip("websockets")

from globule.viewer.open import open_source
from globule.viewer.pacer import STILL_AFTER, Pacer
from globule.viewer.page.statistics import used
from globule.viewer.recording import Shot
from globule.viewer.scenes import usual_range
from globule.viewer.start import Start
from globule.viewer.state import State


def far_sweep() -> gb.ultrasound.Sweep:
    frames, poses = np.full((3, 20, 24), 120, np.uint8), np.repeat(np.eye(4)[None], 3, axis=0)
    poses[:, :3, 3] = [(-70, 200, 40 + i) for i in range(3)]
    return gb.ultrasound.Sweep(frames, poses)


def test_a_sweep_away_from_the_origin_opens_and_shows_its_first_image():
    with view(far_sweep()) as viewer:
        camera, source = viewer.first_camera, viewer.source
        begin = Shot(viewer.engine, camera, (120, 90), 1).picture
        gray = np.ptp(begin.astype(int), axis=2).max(axis=1) == 0
        assert gray.any()
        assert len(source.plates(viewer.state)) == 1
        source.start()
        while source.running:
            time.sleep(0.01)
        assert len(source.plates(viewer.state)) == 3
        assert not np.array_equal(Shot(viewer.engine, camera, (120, 90), 1).picture, begin)


def test_window_and_level_of_a_volume():
    values = np.zeros((6, 6, 6), np.int16)
    values[...] = -1000
    values[2:4] = 400
    source, state = open_source(gb.volumes.Volume(values, np.eye(4), np.zeros(values.shape, np.uint8))), State()
    assert source.window(state.slices) == pytest.approx((-1000, 400), abs=1)
    assert source.lengths() == pytest.approx((5, 5, 5))
    state.set(slices__window=100.0, slices__center=-1000.0)
    assert source.window(state.slices) == (-1050, -950)
    gray = [plate.texture.max() for plate in source.plates(state)]
    state.set(slices__center=-900.0)
    assert next(plate.texture[0, 0].max() for plate in source.plates(state)) < max(gray)
    with pytest.raises(ValueError, match="window"):
        state.set(slices__window=-1.0)


def test_flat_slices_stand_along_the_lower_edge():
    values = np.arange(6 * 8 * 10, dtype=np.float32).reshape(6, 8, 10)
    volume = gb.volumes.Volume(values, np.diag([1.0, 2.0, 3.0, 1.0]), np.zeros(values.shape, np.uint8))
    with engine_of(volume) as engine:
        engine.state.set(slices__x=0.25)
        flats = engine.source.flats(engine.state)
        assert not flats
        camera = gb.Camera((40, -60, 40), (5, 7, 7), (0, 0, 1))
        plain = Shot(engine, camera, (200, 160), 1).picture
        engine.state.set(slices__flat=True)
        flats = engine.source.flats(engine.state)
        assert [flat.title for flat in flats] == ["x 2.2 mm", "y 7.0 mm", "z 7.5 mm"]
        assert [flat.ratio for flat in flats] == pytest.approx([14 / 15, 9 / 15, 9 / 14])
        assert [flat.cross for flat in flats] == [(0.5, 0.5), (0.25, 0.5), (0.25, 0.5)]
        changed = np.argwhere((Shot(engine, camera, (200, 160), 1).picture != plain).any(axis=2))
        assert changed[:, 0].min() > 90


def test_settings_are_assigned_and_a_slip_is_an_error():
    with view(blob(60)) as viewer:
        version = viewer.state.version
        viewer.surface.threshold = 0.5
        assert (viewer.state.surface.threshold, viewer.state.version) == (0.5, version + 1)
        with pytest.raises(AttributeError, match="tresholdd: expected one of kernel, threshold"):
            viewer.state.surface.tresholdd = 1
        with pytest.raises(ValueError, match="threshold"):
            viewer.surface.threshold = -1
        with pytest.raises(AttributeError, match="surfaces"):
            viewer.surfaces  # noqa: B018
        copy = viewer.state.snapshot()
        copy.surface.threshold = 2.0
        assert viewer.surface.threshold == 0.5


@pytest.mark.parametrize("page", [True, False])
def test_a_client_that_reads_nothing_does_not_hold_up_the_end(page):
    made = Start(lambda name: None) if page else view(blob(60))
    path = "/globule/start" if page else "/globule/desk"
    key = base64.b64encode(os.urandom(16)).decode()
    with socket.create_connection(("127.0.0.1", made.port)) as unread:
        words = f"GET {path} HTTP/1.1\r\nHost: 127.0.0.1:{made.port}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
        unread.sendall(f"{words}Sec-WebSocket-Key: {key}\r\nSec-WebSocket-Version: 13\r\n\r\n".encode())
        assert b"101" in unread.recv(20)
        begin = time.monotonic()
        made.close()
        assert time.monotonic() - begin < 0.5  # 0.01 s on a free machine


def test_one_outlier_leaves_the_colors_of_all_others():
    usual = np.random.default_rng(0).uniform(0, 1, 10_000)
    assert usual_range(usual) == ((usual.min(), usual.max()), 0)
    (low, high), beyond = usual_range(np.append(usual, 1e6))
    assert 0 <= low < 0.01
    assert 0.99 < high <= 1
    assert beyond == pytest.approx(100, abs=5)
    assert usual_range(np.append(np.zeros(1000), 1.0)) == ((0.0, 1.0), 0)  # all others are one value
    assert usual_range(np.empty(0)) == ((0.0, 1.0), 0)
    particles = blob(400)
    particles.attributes["speed"] = np.append(np.linspace(0, 1, 399), 1e6)
    with view(particles) as viewer:
        viewer.state.set(color__by="speed")
        command, program = viewer.equivalent()
        low, high = viewer.source.maker.range
        assert high < 2
        assert f"--range {low:.9g},{high:.9g}" in command
        assert "values.min()" not in program


def test_coloring_changes_no_surface():
    particles = blob(400)
    particles.anisotropy = np.repeat(np.diag([3.0, 5.0, 2.0])[None], 400, axis=0).astype(np.float32)
    camera = gb.Camera((0, 0, 5), (0, 0, 0))
    plain, colored = (traced(open_source(particles), camera, (80, 60), color__by=by).distance for by in ("", "speed"))
    assert np.array_equal(plain, colored)


def test_a_mark_is_drawn_over_the_sharp_image_at_once():
    pacer = Pacer()
    pacer.full = (1280, 720)

    def plan(now, marks):
        found = pacer.plan(now, "view", 4, 92, 1920, marks)
        if found is not None:
            pacer.traced(found, 0.1, 20.0) if pacer.started() is not None else None
            pacer.sent(now, 1, now, 1000, found.still)
            pacer.acknowledge(now, 1)
        return found

    assert not plan(0.0, "none").still
    now = STILL_AFTER + 0.01
    while plan(now, "none") is not None:
        now += 0.01
    marked = plan(now, "a mark")
    assert (marked.still, marked.size, marked.samples, marked.refine) == (True, (1280, 720), 4, True)
    assert plan(now + 0.01, "a mark") is None


def test_a_measurement_needs_no_new_trace():
    with engine_of(blob(60)) as engine:
        state, before = engine.state, engine.state.traced
        state.set(measure__shown=True, measure__end=(1.0, 0.0, 0.0))
        state.set(notes__scale_bar=not state.notes.scale_bar)
        assert state.traced == before
        state.set(surface__threshold=0.7, measure__shown=False)
        assert state.traced == before + 1
        until(lambda: state.version > before)


def test_statistics_say_the_threads_that_are_used():
    words = "CPU, 2 threads, 16 lanes"
    assert used(words, 0) == words
    assert (used(words, 1), used(words, 12)) == ("CPU, 1 thread, 16 lanes", "CPU, 12 threads, 16 lanes")
