"""The viewer for hours: clients come and go, memory is noted. Parts of bench/viewer.py."""

from __future__ import annotations

import argparse
import shutil
import subprocess
import tempfile
import threading
import time
from pathlib import Path
from typing import Any

import globule as gb
import globule.viewer.sequence_source as sequence_source
import numpy as np
from globule._base.memory import resident_bytes
from globule.render.camera_path import orbit
from globule.viewer.engine import Engine
from globule.viewer.simulation_source import SimulationSource
from globule.viewer.state import State

from .socket_sink import SocketSink

N_TURNS = 240
FLAGS = ["--headless=new", "--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--incognito"]


class Memory:
    """Notes the memory of this process; the first fifth of the run counts as start."""

    def __init__(self) -> None:
        self.began = time.monotonic()
        self.rows: list[tuple[float, float]] = []  # s, MB

    def note(self) -> None:
        """Take one value."""
        self.rows.append((time.monotonic() - self.began, resident_bytes() / 1e6))

    def table(self) -> list[tuple[str, str]]:
        """The values over time, and the slope of a straight line through the second half."""
        at, size = np.array(self.rows).T
        step = max(1, len(at) // 10)
        late = at >= at[-1] / 2
        slope = np.polyfit(at[late], size[late], 1)[0] * 3600 if late.sum() > 2 else float("nan")
        return [
            ("memory over time", ", ".join(f"{a:.0f} s {s:.0f} MB" for a, s in self.rows[::step])),
            ("memory at a fifth", f"{size[len(size) // 5]:.0f} MB"),
            ("memory at the end", f"{size[-1]:.0f} MB"),
            ("slope of the second half", f"{slope:+.1f} MB an hour"),
        ]


def of_soak(options: argparse.Namespace) -> list[tuple[str, str]]:
    """The dam break, again and again, with a client that comes and goes."""
    simulation = gb.Simulation("dam-break", device=options.device)
    source = SimulationSource("dam-break", simulation, options.device)
    engine = Engine(source, State(), source.up)
    errors: list[str] = []
    engine.on_error = errors.append
    memory, visits, steps = Memory(), 0, 0
    source.play(True)
    while time.monotonic() - memory.began < options.soak_seconds:
        sink = SocketSink()
        client = engine.add(sink, source.camera)
        sink.client = client
        client.look(source.camera, (960, 540))
        time.sleep(min(options.visit_seconds, options.soak_seconds / 10))
        if simulation.time > 2.0:
            steps += simulation.n_steps
            source.reset()
            source.play(True)
        if visits % 2:
            sink.close()  # the client dies first
        engine.remove(client)
        sink.close()
        visits += 1
        memory.note()
    threads = threading.active_count()
    engine.close()
    return [
        ("seconds", f"{options.soak_seconds:g}"),
        ("visits", str(visits)),
        ("steps", f"{steps + simulation.n_steps:,}"),
        *memory.table(),
        ("threads at the end", str(threads)),
        ("errors", "; ".join(errors) or "none"),
    ]


def write_frames(folder: Path, n: int, n_particles: int) -> list[str]:
    """Files of a ball of particles that goes round in a circle."""
    ball = np.random.default_rng(1).normal(0, 0.15, (n_particles, 3)).astype(np.float32)
    names = []
    for i in range(n):
        angle = 2 * np.pi * i / 500
        moved = ball + np.array([np.cos(angle), np.sin(angle), 0.0], np.float32)
        names.append(str(folder / f"frame_{i:05d}.npz"))
        np.savez(names[-1], positions=moved, support=0.2, speed=moved[:, 0])
    return names


def of_frames(options: argparse.Namespace) -> list[tuple[str, str]]:
    """A sequence of many small files, played and scrubbed, with clients that come and go.

    Each tenth client is a real browser, if there is one; the others are sockets.
    """
    with tempfile.TemporaryDirectory() as folder:
        sequence_source.KEPT_BYTES = options.kept_mb * 10**6
        names = write_frames(Path(folder), options.frames, options.frame_particles)
        viewer = gb.view(names, port=0, browser=False, block=False, device=options.device)
        try:
            return _watched(viewer, options)
        finally:
            viewer.close()


def _watched(viewer: Any, options: argparse.Namespace) -> list[tuple[str, str]]:
    source, state, engine = viewer.source, viewer.state, viewer.engine
    errors: list[str] = []
    engine.on_error = errors.append
    state.set(time__playing=True, time__rate=60.0, color__by="speed")
    seen: set[int] = set()
    rng, memory, visits = np.random.default_rng(2), Memory(), 0
    cameras = orbit(viewer.first_camera, n=N_TURNS)
    memory.note()
    while time.monotonic() - memory.began < options.soak_seconds:
        browser = _browser(viewer.address) if visits % 10 == 9 else None
        sink = SocketSink()
        client = engine.add(sink, viewer.first_camera)
        sink.client = client
        left = time.monotonic() + min(options.visit_seconds, options.soak_seconds / 10)
        scrubs = visits % 3 == 2
        state.set(time__playing=not scrubs)
        while time.monotonic() < left:
            client.look(cameras[int(rng.integers(N_TURNS))], (640, 360))
            if scrubs:
                state.set(time__frame=int(rng.integers(source.n_frames)))
            time.sleep(0.05)
            seen.add(source.frame)
        if visits % 2:
            sink.close()  # the client dies first
        engine.remove(client)
        sink.close()
        if browser is not None:
            browser.terminate()
            browser.wait()
        visits += 1
        memory.note()
    return [
        ("frames", f"{source.n_frames:,} of {options.frame_particles:,} particles"),
        ("seconds", f"{options.soak_seconds:g}"),
        ("visits", f"{visits}, every third scrubs"),
        ("different frames seen by 20 looks a second", f"{len(seen):,}"),
        ("frames in memory at the end", f"{len(source._kept):,}, {source._total / 1e6:.0f} MB"),
        *memory.table(),
        ("threads at the end", str(threading.active_count())),
        ("errors", "; ".join(errors) or "none"),
    ]


def _browser(address: str) -> subprocess.Popen | None:
    """Chromium on the viewer's page, with a profile of its own in memory."""
    chromium = shutil.which("chromium")
    if chromium is None:
        return None
    command = [chromium, *FLAGS, "--enable-unsafe-swiftshader", address]
    return subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
