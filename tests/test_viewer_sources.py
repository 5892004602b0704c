"""Sequences, volumes and sweeps in a real browser, and a live scanner."""

from __future__ import annotations

import re
import signal
import socket
import subprocess
import sys
import threading
from typing import Any

import globule as gb
import numpy as np
import pytest
from viewer_helpers import (
    PATIENCE,
    Watched,
    blob,
    check,
    choose,
    differs,
    open_folder,
    seen,
    silhouette,
    type_number,
    until,
)

BROWSERS = True  # see hang_guard
pytestmark = [pytest.mark.browser, pytest.mark.slow]


def frames_that_move(n: int = 5) -> list[gb.Particles]:
    still = blob(150).positions
    return [gb.Particles(still * (1 + 0.25 * i), support=0.35) for i in range(n)]


def test_a_sequence_plays_and_steps(chromium):
    watched = Watched(frames_that_move(), chromium)
    try:
        page = watched.page()
        first = watched.still(page)
        page.get_by_role("button", name="next", exact=True).click()
        watched.still(page, differs(first, 0.5))
        assert watched.viewer.source.frame == 1
        type_number(page, "Frame", 4)
        until(lambda: watched.viewer.source.frame == 4)
        page.get_by_role("button", name="first", exact=True).click()
        watched.still(page, lambda p: np.array_equal(p, first))
        type_number(page, "Frames per second", 5)
        check(page, "Play")
        seen_frames = set()
        until(lambda: seen_frames.add(watched.viewer.source.frame) or len(seen_frames) == 5)
        page.mouse.move(330, 380)
        page.keyboard.press("Space")
        until(lambda: not watched.viewer.state.time.playing)
        check(page, "Loop", False)
        page.get_by_role("button", name="first", exact=True).click()
        until(lambda: watched.viewer.source.frame == 0)
        page.get_by_label("Play", exact=True).first.click()  # it may end before one could look
        until(lambda: watched.viewer.source.frame == 4 and not watched.viewer.state.time.playing)
    finally:
        watched.close()


def test_a_broken_frame_stops_the_show_until_it_is_mended(chromium, tmp_path):
    paths = [str(tmp_path / f"frame_{i}.npz") for i in range(4)]
    for path, particles in zip(paths, frames_that_move(4), strict=True):
        gb.write(path, particles)
    (tmp_path / "frame_2.npz").write_bytes(b"no archive")
    watched = Watched(paths, chromium)
    try:
        page, source, state = watched.page(), watched.viewer.source, watched.viewer.state
        check(page, "Play")
        page.get_by_text("frame_2.npz: archive").first.wait_for()
        until(lambda: not state.time.playing)
        assert source.frame == 1
        type_number(page, "Frame", 3)
        until(lambda: source.frame == 3)
        gb.write(paths[2], frames_that_move(4)[2])
        type_number(page, "Frame", 2)
        until(lambda: source.frame == 2)
    finally:
        watched.close()


def ball_volume() -> gb.Volume:
    z, y, x = np.mgrid[-12:13, -12:13, -12:13]
    values = np.clip(220 - 18 * np.sqrt(x * x + y * y + z * z), 0, 255).astype(np.uint8)
    radius = np.where(x > 4, 2, 0).astype(np.uint8)
    pose = np.diag([2.0, 2.0, 2.0, 1.0])
    return gb.Volume(values, pose, radius)


def test_a_volume_with_slices_surface_and_overlay(chromium):
    volume = ball_volume()
    images = np.full((2, 30, 30), 255, np.uint8)
    pose = np.eye(4)
    pose[:3, 3] = (-40, -10, 20)
    poses = np.stack([pose, pose])
    watched = Watched((volume, gb.Sweep(images, poses)), chromium)
    try:
        page = watched.page()
        both = watched.still(page)
        check(page, "Measured / filled")
        tinted = watched.still(page, differs(both, 0.2)).astype(int)
        orange = (tinted[..., 0] > tinted[..., 2] + 40).sum()
        assert orange > 200
        check(page, "Show slices", False)
        surface = watched.still(page, differs(both, 0.5))
        type_number(page, "Iso-value", 190)
        smaller = watched.still(page, lambda p: silhouette(p) < 0.8 * silhouette(surface))
        check(page, "Show surface", False)
        watched.still(page, lambda p: silhouette(p) == 0)
        check(page, "Show sweep image")
        frame = watched.still(page, lambda p: (p == 255).all(axis=2).sum() > 500)
        assert frame.shape == smaller.shape
        check(page, "Show sweep image", False)
        check(page, "Show slices")
        check(page, "Measured / filled", False)
        type_number(page, "x slice", 0.2)
        watched.still(page, differs(both, 0.2))
    finally:
        watched.close()


def test_a_sweep_comes_in_and_is_undone(chromium):
    rng = np.random.default_rng(2)
    frames = rng.integers(80, 255, (12, 20, 24)).astype(np.uint8)
    poses = np.repeat(np.eye(4)[None], 12, axis=0)
    poses[:, 2, 3] = np.arange(12)
    watched = Watched(gb.Sweep(frames, poses), chromium)
    source = watched.viewer.source
    try:
        page = watched.page()
        empty = watched.still(page)
        page.get_by_role("button", name="Start", exact=True).click()
        until(lambda: not source.running and source._reconstructor.n_frames == 12)
        full = watched.still(page, differs(empty, 1))
        page.get_by_role("button", name="Undo", exact=True).click()
        until(lambda: source._reconstructor.n_frames == 11)
        watched.still(page, lambda p: not np.array_equal(p, full))
        choose(page, "Method", "vvn")
        page.get_by_role("button", name="Reconstruct all images").click()
        until(lambda: "method" not in source.volume.info or source.volume.n_filled >= 0)
        choose(page, "Compounding", "maximum")
        until(lambda: source.compounding == "maximum")
        page.get_by_role("button", name="Clear").click()
        until(lambda: source._reconstructor.n_frames == 0)
        watched.still(
            page, lambda p: p.shape == empty.shape and np.abs(p.astype(int) - empty).mean() < 1
        )
        page.get_by_role("button", name="Start", exact=True).click()
        until(lambda: source._reconstructor.n_frames > 0)
        page.get_by_role("button", name="Stop", exact=True).click()
        until(lambda: not source.running)
    finally:
        watched.close()


def replaying(sweep: gb.Sweep) -> tuple[int, Any]:
    """A server of pyigtl's own on loopback that sends a sweep to whoever comes, and its port."""
    igtl = pytest.importorskip("pyigtl")
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    server = igtl.OpenIGTLinkServer(port=port)

    def replay() -> None:
        until(server.is_connected)
        for i in range(len(sweep)):
            when = 1000 + float(i)
            server.send_message(
                igtl.ImageMessage(sweep.frames[i][None], timestamp=when, device_name="Image")
            )
            server.send_message(
                igtl.TransformMessage(
                    sweep.world_from_image[i], timestamp=when, device_name="ImageToReference"
                )
            )

    threading.Thread(target=replay, daemon=True).start()
    return port, server


def test_a_live_scanner_from_the_command_line(chromium):
    """`globule view igtl://…` in a process of its own, a server that replays a sweep, a browser."""
    rng = np.random.default_rng(2)
    frames = rng.integers(80, 255, (20, 40, 48)).astype(np.uint8)
    poses = np.repeat(np.eye(4)[None], 20, axis=0)
    poses[:, 2, 3] = np.arange(20)
    port, server = replaying(gb.Sweep(frames, poses))
    process = subprocess.Popen(
        [
            sys.executable,
            "-m",
            "globule",
            "view",
            f"igtl://127.0.0.1:{port}",
            "--no-browser",
            "--port",
            "0",
        ],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    page = chromium.new_page(viewport={"width": 1000, "height": 760})
    page.set_default_timeout(1000 * PATIENCE)
    try:
        page.goto(re.search(r"http://\S+", process.stdout.readline())[0])
        page.get_by_role("button", name="Start", exact=True).click()
        open_folder(page, "Statistics")
        page.get_by_role("cell", name="images", exact=True).locator(
            "xpath=following-sibling::td[text()='20']"
        ).wait_for()
        page.get_by_role("button", name="Stop", exact=True).click()
        until(lambda: np.ptp(seen(page)[250:500, 200:450].mean(axis=2)) > 60, "for the slices")
        page.get_by_role("button", name="Undo", exact=True).click()
        page.get_by_role("cell", name="images", exact=True).locator(
            "xpath=following-sibling::td[text()='19']"
        ).wait_for()
    finally:
        page.close()
        process.send_signal(signal.SIGINT)
        _, errors = process.communicate(timeout=PATIENCE)
        server.stop()
    assert process.returncode == 130
    assert errors.strip() == "globule: interrupted"
