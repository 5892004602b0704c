"""Makes the pictures of docs/understand/viewer.md, with a real browser: docs/images/viewer/*.jpg.

python docs/make_viewer_pictures.py [NAME …]
"""

from __future__ import annotations

import io
import shutil
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import globule as gb
import numpy as np
from PIL import Image
from playwright.sync_api import sync_playwright

FOLDER = Path(__file__).parent / "images/viewer"
FLAGS = [
    "--headless=new",
    "--no-sandbox",
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
]
SIZE = {"width": 1180, "height": 760}


def splash() -> gb.Particles:
    """The embedded splash."""
    from globule._demo import data as demo_data

    positions, colors, spacing = demo_data.splash(30_000)
    return gb.Particles(positions, support=2 * spacing, color=colors)


def section(page: Any, title: str) -> None:
    """Show a section of the inspector."""
    page.get_by_role("tab", name=title, exact=True).click()
    page.wait_for_timeout(500)


def press(page: Any, name: str) -> None:
    """Press a button of the toolbar or the timeline."""
    page.locator("#globule-desk").get_by_role("button", name=name, exact=True).click()


def choose(page: Any, label: str, option: str) -> None:
    page.get_by_label(label, exact=True).first.select_option(option)


def check(page: Any, label: str) -> None:
    page.get_by_label(label, exact=True).first.check()


def first(page: Any, viewer: Any) -> None:
    page.mouse.click(410, 480)


def cut(page: Any, viewer: Any) -> None:
    viewer.state.set(color__by="y", color__legend=False)
    section(page, "Cut")
    check(page, "Plane")
    viewer.state.set(cuts__normal=(0.5, 0.0, 0.85))


def stroke(page: Any, viewer: Any) -> None:
    press(page, "Cut")
    page.wait_for_timeout(1500)
    page.mouse.move(120, 380)
    page.mouse.down()
    for i in range(20):
        page.mouse.move(120 + 30 * i, 380 + 8 * i)
        page.wait_for_timeout(60)


def color(page: Any, viewer: Any) -> None:
    section(page, "Layer")
    choose(page, "Color by", "y")
    choose(page, "Color map", "turbo")


def light(page: Any, viewer: Any) -> None:
    section(page, "Light")
    choose(page, "Preset", "water")


def surface(page: Any, viewer: Any) -> None:
    section(page, "Layer")


def measure(page: Any, viewer: Any) -> None:
    press(page, "Measure")
    page.mouse.click(470, 560)
    page.wait_for_timeout(1500)
    page.mouse.click(720, 540)


def record(page: Any, viewer: Any) -> None:
    section(page, "Save")


def equivalent(page: Any, viewer: Any) -> None:
    record(page, viewer)
    viewer.state.set(surface__threshold=0.8, cuts__plane=True)
    page.get_by_role("button", name="As command and Python").click()


def help_panel(page: Any, viewer: Any) -> None:
    section(page, "Statistics")
    page.mouse.move(300, 400)
    page.keyboard.press("h")


def run(page: Any, viewer: Any) -> None:
    press(page, "Play or pause")
    while viewer.source.simulation.time < 0.45:
        page.wait_for_timeout(200)
    press(page, "Play or pause")


def scalpel(page: Any, viewer: Any) -> None:
    viewer.source.cut_depth = None  # all through
    press(page, "Cut")
    page.wait_for_timeout(1500)
    page.mouse.move(620, 110)
    page.mouse.down()
    for i in range(20):
        page.mouse.move(620 - 4 * i, 110 + 25 * i)
        page.wait_for_timeout(60)
    page.mouse.up()
    page.wait_for_timeout(1500)
    press(page, "Play or pause")
    while viewer.source.simulation.time < 0.07:
        page.wait_for_timeout(50)
    press(page, "Play or pause")


def slices(page: Any, viewer: Any) -> None:
    section(page, "Volume")
    viewer.state.set(slices__overlay=False, look__preset="plain", slices__x=0.35)


def overlay(page: Any, viewer: Any) -> None:
    section(page, "Volume")
    check(page, "Measured / filled")
    check(page, "Show sweep image")
    viewer.state.set(slices__number=10)


def sweep(page: Any, viewer: Any) -> None:
    press(page, "Play or pause")
    page.wait_for_timeout(6000)
    viewer.state.set(slices__level=60.0)


def a_sequence() -> list[gb.Particles]:
    base = splash()
    return [
        gb.Particles(
            np.asarray(base.positions) * (1 + 0.02 * i, 1 - 0.02 * i, 1), support=base.support
        )
        for i in range(24)
    ]


def sequence(page: Any, viewer: Any) -> None:
    viewer.state.set(time__frame=7)


def phantom_sweep() -> gb.ultrasound.Sweep:
    """A curved sweep over a ball and a tube, made here."""
    rng = np.random.default_rng(3)
    frames, poses = [], []
    v, u = np.mgrid[0:90, 0:110] * 0.5
    for i in range(60):
        pose = np.eye(4)
        angle = np.radians(0.4 * (i - 30))
        pose[:3, 0] = 0.5 * np.array([1, 0, 0])
        pose[:3, 1] = 0.5 * np.array([0, np.sin(angle), -np.cos(angle)])
        pose[:3, 2] = np.cross(pose[:3, 0], pose[:3, 1]) / 0.25
        pose[:3, 3] = (-27, 0.9 * (i - 30), 22)
        world = (
            pose[:3, :1] * (2 * u.reshape(1, -1))
            + pose[:3, 1:2] * (2 * v.reshape(1, -1))
            + pose[:3, 3:4]
        )
        x, y, z = world
        ball = x * x + y * y + (z + 2) ** 2 < 13**2
        tube = (x - 12) ** 2 + (z - 10) ** 2 < 5**2
        value = 40 + 150 * ball + 190 * tube
        noisy = value * rng.gamma(9, 1 / 9, len(value))
        frames.append(np.clip(noisy, 0, 255).reshape(90, 110).astype(np.uint8))
        poses.append(pose)
    return gb.ultrasound.Sweep(np.stack(frames), np.stack(poses))


def phantom_volume() -> tuple[gb.volumes.Volume, gb.ultrasound.Sweep]:
    made = phantom_sweep()
    return gb.ultrasound.reconstruct(made, spacing=0.8, max_kernel=5), made


PICTURES: dict[str, tuple[Callable[[], Any], Callable[[Any, Any], None]]] = {
    "first": (splash, first),
    "cut": (splash, cut),
    "stroke": (splash, stroke),
    "color": (splash, color),
    "light": (splash, light),
    "surface": (splash, surface),
    "measure": (splash, measure),
    "record": (splash, record),
    "equivalent": (splash, equivalent),
    "help": (splash, help_panel),
    "sequence": (a_sequence, sequence),
    "simulation": (lambda: "dam-break", run),
    "scalpel": (lambda: "cut-block", scalpel),
    "slices": (phantom_volume, slices),
    "overlay": (phantom_volume, overlay),
    "sweep": (phantom_sweep, sweep),
}


def settled(viewer: Any, samples: int) -> bool:
    pacers = [client.pacer for client in viewer.clients.values()]
    return bool(pacers) and all(
        p._samples >= samples and not p.in_flight and not p.making for p in pacers
    )


def main() -> None:
    FOLDER.mkdir(parents=True, exist_ok=True)
    with sync_playwright() as playwright:
        chromium = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=FLAGS)
        for name in sys.argv[1:] or PICTURES:
            what, act = PICTURES[name]
            viewer = gb.view(what(), port=0, browser=False, block=False)
            viewer.state.set(quality__samples=4)
            page = chromium.new_page(viewport=SIZE)
            page.set_default_timeout(240_000)  # a busy machine
            page.goto(viewer.address)
            page.get_by_role("button", name="Inspector").wait_for()
            while not settled(viewer, 1):
                time.sleep(0.1)
            act(page, viewer)
            page.wait_for_timeout(700)
            while not settled(viewer, 4):
                time.sleep(0.1)
            page.wait_for_timeout(800)
            with Image.open(io.BytesIO(page.screenshot())) as image:
                image.convert("RGB").save(FOLDER / f"{name}.jpg", quality=86)
            print(FOLDER / f"{name}.jpg")
            page.close()
            viewer.close()
        chromium.close()


if __name__ == "__main__":
    main()
