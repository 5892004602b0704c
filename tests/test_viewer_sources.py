"""Sequences, volumes and sweeps: what their controls do, and what is seen."""

import itertools
import threading
from collections import OrderedDict

import globule as gb
import numpy as np
import pytest
from viewer_helpers import PATIENCE, Watched, blob, engine_of, silhouette, until

pytest.importorskip("websockets")

from globule.viewer.open import open_source
from globule.viewer.recording import Shot
from globule.viewer.state import State
from globule.viewer.sweep_source import played


def frames_that_move(n: int) -> list[gb.Particles]:
    still = blob(150).positions
    return [gb.Particles(still * (1 + 0.25 * i), support=0.35) for i in range(n)]


def test_a_sequence_steps_and_plays_at_its_rate():
    with Watched(frames_that_move(5)) as watched:
        page, source, time = watched.program(), watched.viewer.source, watched.viewer.state.time
        first = watched.still(page)
        for frame in (1, 4, 3, 0):
            page.ask("set", {"time__playing": False, "time__frame": frame})
            until(lambda frame=frame: source.frame == frame)
        watched.still(page, lambda p: np.array_equal(p, first))
        page.ask("set", {"time__frame": 2})
        until(lambda: source.frame == 2)
        page.ask("set", {"time__loop": False})
        until(lambda: not time.loop)
        page.ask("play")
        until(lambda: source.frame == 4 and not time.playing, "for the end")
        page.ask("set", {"time__loop": True})
        page.command("Play or pause")
        until(lambda: time.playing and source.frame < 4, "for the beginning")
        page.command("Play or pause")
        until(lambda: not time.playing)
    source, state = open_source(frames_that_move(3)), State()
    state.set(time__playing=True, time__rate=5.0)
    shown = []
    for _ in range(5):
        assert source.advance(state) == pytest.approx(0.2)
        shown.append(source.frame)
    assert shown == [1, 2, 0, 1, 2]
    source.close()


def test_playback_passes_over_a_broken_frame_and_the_time_says_what_is_shown(tmp_path):
    paths = [str(tmp_path / f"frame_{i}.npz") for i in range(4)]
    for path, particles in zip(paths, frames_that_move(4), strict=True):
        gb.write(path, particles)
    (tmp_path / "frame_2.npz").write_bytes(b"no archive")
    with Watched(paths) as watched:
        page, source, state = watched.program(), watched.viewer.source, watched.viewer.state
        state.set(time__loop=False, time__playing=True)
        page.heard("frame_2.npz: archive")
        until(lambda: not state.time.playing)
        assert source.frame == 3  # the broken one was passed over
        state.time.frame = 2
        until(lambda: state.time.frame == 3, "for the number of what is shown")
        gb.write(paths[2], frames_that_move(4)[2])
        state.time.frame = 2
        until(lambda: source.frame == 2)
    source, state = open_source(frames_that_move(2)), State()
    source._frames, source._kept = ["none.npz", "neither.npz"], OrderedDict()
    state.set(time__playing=True)
    with pytest.raises(OSError, match=r"none|neither"):
        source.advance(state)
    assert not state.time.playing


def test_a_volume_with_slices_surface_and_overlay():
    z, y, x = np.mgrid[-12:13, -12:13, -12:13]
    values = np.clip(220 - 18 * np.sqrt(x * x + y * y + z * z), 0, 255).astype(np.uint8)
    radius = np.where(x > 4, 2, 0).astype(np.uint8)
    volume = gb.volumes.Volume(values, np.diag([2.0, 2.0, 2.0, 1.0]), radius)
    pose = np.eye(4)
    pose[:3, 3] = (-40, -10, 20)
    sweep = gb.ultrasound.Sweep(np.full((2, 30, 30), 255, np.uint8), np.stack([pose, pose]))
    camera = gb.Camera((110, -100, 80), (24, 24, 24), (0, 0, 1))
    with engine_of((volume, sweep)) as engine:

        def seen(**settings) -> np.ndarray:
            engine.state.set(**settings)
            return Shot(engine, camera, (160, 120), 1).picture

        both = seen()
        tinted = seen(slices__overlay=True).astype(int)
        assert (tinted[..., 0] > tinted[..., 2] + 40).sum() > 20  # orange
        surface = seen(slices__overlay=False, slices__shown=False)
        assert not np.array_equal(surface, both)
        assert silhouette(seen(slices__level=190.0)) < 0.8 * silhouette(surface)
        assert silhouette(seen(slices__surface=False)) == 0
        assert (seen(slices__frame=True) == 255).all(axis=2).sum() > 50
        assert not np.array_equal(seen(slices__frame=False, slices__shown=True), both)
        middle = seen()
        assert not np.array_equal(seen(slices__x=0.2), middle)


def test_a_sweep_comes_in_and_is_undone():
    frames = np.random.default_rng(2).integers(80, 255, (12, 20, 24)).astype(np.uint8)
    poses = np.repeat(np.eye(4)[None], 12, axis=0)
    poses[:, 2, 3] = np.arange(12)
    sweep = gb.ultrasound.Sweep(frames, poses)
    with Watched(sweep) as watched:
        page, source = watched.program(), watched.viewer.source
        source._open = played(sweep, 1e6)
        empty = watched.still(page)
        page.ask("play")
        until(lambda: not source.running and source._reconstructor.n_frames == 12)
        full = watched.still(page, lambda p: np.abs(p.astype(int) - empty).mean() > 1)
        page.set("Images", "Undo")
        until(lambda: source._reconstructor.n_frames == 11)
        watched.still(page, lambda p: not np.array_equal(p, full))
        page.set("Method", "vvn")
        page.set("Compounding", "maximum")
        until(lambda: source.compounding == "maximum")
        page.set("Reconstruct all images")
        page.heard("**volume by vvn** from 11 images")
        page.set("Images", "Clear")
        until(lambda: source._reconstructor.n_frames == 0)
        watched.still(page, lambda p: np.abs(p.astype(int) - empty).mean() < 1)
        goes_on = threading.Event()

        def slow():
            yield from itertools.islice(played(sweep, 1e6)(), 3)
            goes_on.wait(PATIENCE)
            yield frames[3], poses[3]

        source._open = slow
        page.ask("play")
        until(lambda: source._reconstructor.n_frames == 3)
        page.ask("play")
        until(lambda: not source.running)
        goes_on.set()
        page.heard("**stopped** · 3 images")
