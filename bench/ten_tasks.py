"""Ten tasks of a new user in a real browser, by what a person sees: seconds, clicks, images.

    python -m bench.ten_tasks -o tasks
    python -m bench.ten_tasks -o tasks --only cut_tissue grasp --size 1920x1080

Starts `globule view` without a file, opens scenes from its start page, and finds controls by their
visible words and places in the image by their pixels. Needs chromium and playwright. A task that
takes longer than a minute, or does not show what was asked for, is a failure.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import globule as gb
import numpy as np
from PIL import Image
from playwright.sync_api import sync_playwright

FLAGS = ["--headless=new", "--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
MOST = 60.0  # s, for a task
# The image, then all controls over it: left, top, right, bottom, pixels.
BOXES = """() => [document.querySelector("#globule-image"), ...document.querySelectorAll(
    "#globule-desk > *, .note, .banner")]
  .map((part) => part.getBoundingClientRect())
  .map((b) => [b.left, b.top, b.right, b.bottom].map(Math.round))
  .filter(([left, top, right, bottom]) => right > left && bottom > top)"""
PAUSE = 0.15  # s between two moves of a mouse in a drag


class Person:
    """A person in front of a page, with what they see and do.

    Args:
        page: playwright's page.
    """

    def __init__(self, page: Any):
        self.page, self.clicks, self.looked = page, 0, 0.0

    def see(self) -> np.ndarray:
        """The window's pixels, (H, W, 3). The time that this takes is not the person's."""
        begin = time.monotonic()
        with Image.open(io.BytesIO(self.page.screenshot(timeout=1000 * MOST))) as image:
            pixels = np.asarray(image.convert("RGB")).astype(int)
        self.looked += time.monotonic() - begin
        return pixels

    def press(self, words: str) -> None:
        """Press the button that says these words; the toolbar is seen first."""
        tool = self.page.locator("#globule-desk .tools button").filter(has_text=words)
        tile = self.page.locator("main button").filter(has_text=words)
        tool.or_(tile).first.click(timeout=1000 * MOST)
        self.clicks += 1

    def read(self, words: str) -> str:
        """Wait for words on the page; returns them."""
        found = self.page.locator(":visible", has_text=re.compile(words)).last
        found.wait_for(timeout=1000 * MOST)
        return found.inner_text()

    def until(self, true: Callable[[], Any], what: str) -> Any:
        """Look until something is true."""
        end = time.monotonic() + MOST
        while time.monotonic() < end:
            if found := true():
                return found
            self.page.wait_for_timeout(100)
        raise TimeoutError(what)

    def changes(self, before: np.ndarray, by: float = 0.5) -> None:
        """Wait until the image is another."""
        self.until(lambda: np.abs(self.see() - before).mean() > by, "the image to change")

    def rests(self) -> np.ndarray:
        """Wait until nothing moves, though it may still get finer; returns what is seen."""
        seen = [self.see()]

        def same() -> bool:
            self.page.wait_for_timeout(200)
            seen.append(self.see())
            return np.abs(seen[-1] - seen[-2]).mean() < 1.0

        self.until(same, "the image to rest")
        return seen[-1]

    def thing(self, at: tuple[float, float] = (0.5, 0.5), red: bool = False) -> tuple[float, float]:
        """A place of what is shown: shares of its width and height, of pixels unlike those around.

        The place is on the thing: the nearest of its pixels. red: only what is red, as tissue.
        """
        picture, free = self.see(), self._free()
        if red:
            mask = free & (picture[..., 0] - picture[..., 1] > 60)
        else:
            corner = np.median(picture[free], axis=0)
            mask = free & (np.abs(picture - corner).sum(axis=2) > 40)
        rows, columns = np.nonzero(mask)
        if len(rows) < 100:
            raise LookupError("nothing is seen in the image")
        ends = np.percentile(columns, [3, 97]), np.percentile(rows, [3, 97])
        x, y = (lo + share * (hi - lo) for (lo, hi), share in zip(ends, at, strict=True))
        i = np.argmin((columns - x) ** 2 + (rows - y) ** 2)
        return float(columns[i]), float(rows[i])

    def _free(self) -> np.ndarray:
        """Pixels of the image on which no control stands."""
        width, height = self.page.viewport_size["width"], self.page.viewport_size["height"]
        image, *controls = self.page.evaluate(BOXES)
        free = np.zeros((height, width), bool)
        x, y, right, low = image
        free[y:low, x:right] = True
        for x, y, right, low in controls:
            free[max(0, y - 8) : low + 8, max(0, x - 8) : right + 8] = False
        return free

    def drag(self, begin: tuple, end: tuple, steps: int = 10, hold: bool = False) -> None:
        """Drag the mouse as a hand does."""
        mouse = self.page.mouse
        mouse.move(*begin)
        mouse.down()
        for share in np.linspace(0, 1, steps + 1)[1:]:
            mouse.move(*(np.asarray(begin) + share * (np.subtract(end, begin))))
            self.page.wait_for_timeout(1000 * PAUSE / 3)
        if not hold:
            mouse.up()
        self.clicks += 1


# Tasks: each with the page of its scene


def open_scene(person: Person, title: str) -> str:
    person.press(title)
    person.page.locator("#globule-desk .tools button").first.wait_for(timeout=1000 * MOST)
    person.until(lambda: len(np.unique(person.see()[person._free()], axis=0)) > 50, "an image")
    return "the image is there"


def orbit(person: Person) -> str:
    before = person.rests()
    x, y = person.thing()
    person.drag((x, y), (x + 150, y + 40))
    person.changes(before)
    return "the view turns"


def color_by_speed(person: Person) -> str:
    before = person.rests()
    select = person.page.get_by_label("Color by").locator("visible=true")
    if not select.count():
        person.press("Layers")
    person.page.locator("#globule-desk select").first.select_option("speed", timeout=1000 * MOST)
    person.clicks += 2
    person.changes(before)
    return "colored"


def measure(person: Person) -> str:
    person.press("Measure")
    person.rests()
    for at in ((0.3, 0.6), (0.7, 0.6)):
        person.page.mouse.click(*person.thing(at))
        person.clicks += 1
        person.page.wait_for_timeout(700)
    return person.read(r"Distance [\d.]+").splitlines()[0]


def cut(person: Person) -> str:
    person.press("Cut")
    before = person.rests()
    (x, _), (_, low), (_, high) = (person.thing((0.5, at)) for at in (0.5, 0.0, 1.0))
    person.drag((x, low - 20), (x, high + 20))
    person.changes(before, 2.0)
    return "cut open"


def save_state(person: Person) -> str:
    with person.page.expect_download(timeout=1000 * MOST) as download:
        person.press("Save view")
    return download.value.suggested_filename


def record(person: Person) -> str:
    person.press("Rotate")
    person.press("Movie")
    x, y = person.thing()
    person.drag((x, y), (x + 100, y), steps=20)
    with person.page.expect_download(timeout=1000 * MOST) as download:
        person.press("Movie")
    return f"{download.value.suggested_filename}, {os.path.getsize(download.value.path()):,} bytes"


def play(person: Person) -> str:
    before = person.rests()
    person.page.get_by_role("button", name="Play or pause").click()
    person.clicks += 1
    person.changes(before)
    return "it moves"


def color_while_playing(person: Person) -> str:
    return color_by_speed(person)


def compare(person: Person, folder: Path) -> str:
    for name, seed in (("first.npz", 1), ("second.npz", 2)):
        positions = np.random.default_rng(seed).normal(size=(400 * seed, 3))
        gb.write(folder / name, gb.Particles(positions, support=0.5))
    with person.page.expect_file_chooser() as chooser:
        person.page.get_by_text("Drop a file here").click()
    chooser.value.set_files([folder / "first.npz", folder / "second.npz"])
    person.clicks += 2
    person.page.locator("#globule-desk .tools button").first.wait_for(timeout=1000 * MOST)
    person.rests()
    before = person.see()
    box = person.page.get_by_label("Divider between the two data sets").bounding_box()
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    person.drag((x, y), (x + 150, y))
    person.changes(before, 0.2)
    return "the divider moves"


def cut_tissue(person: Person) -> str:
    person.press("Cut")
    person.rests()
    (x, top), (_, low) = (person.thing((0.5, at), red=True) for at in (0.0, 1.0))
    person.drag((x, top - 10), (x + 20, low + 10))
    return person.read(r"Cut [\d,]+ bonds").splitlines()[0]


def grasp(person: Person) -> str:
    person.press("Grasp")
    x, y = person.thing((0.2, 0.3), red=True)
    person.page.get_by_role("button", name="Play or pause").click()
    person.clicks += 1
    person.drag((x, y), (x - 60, y - 60), hold=True)
    force = person.page.locator("#globule-desk .force:visible")
    try:
        said = person.until(lambda: force.count() and re.search(r"[\d.]+ m?N", force.inner_text()), "a force")
        return f"force {said[0]}"
    finally:
        person.page.mouse.up()


SCENES: dict[str, tuple[Callable, ...]] = {
    "splash": (orbit, color_by_speed, measure, cut, save_state, record),
    "dam-break": (play, color_while_playing),
    "": (compare,),
    "cut-block": (cut_tissue, grasp),
}


@contextlib.contextmanager
def start_page(folder: Path) -> Iterator[str]:
    """The address of `globule view` without a file."""
    command = [sys.executable, "-m", "globule", "view", "--no-browser", "--port", "0"]
    process = subprocess.Popen(command, cwd=folder, stdout=subprocess.PIPE, text=True)
    try:
        assert process.stdout is not None
        lines = iter(process.stdout.readline, "")
        yield next(found[0] for line in lines if (found := re.search(r"http://\S+", line)))
    finally:
        process.terminate()
        process.wait()


def timed(person: Person, name: str, does: Callable[[], str], folder: Path) -> bool:
    """Do a task, print what came of it, keep what is seen; whether it was done within a minute."""
    person.clicks, person.looked, begin = 0, 0.0, time.monotonic()
    try:
        said, done = does(), True
    except Exception as error:
        said, done = f"{type(error).__name__}: {str(error).splitlines()[0]}", False
    seconds = time.monotonic() - begin - person.looked
    done &= seconds < MOST
    told = f"{name:24} {'done' if done else 'NOT DONE':8} {seconds:5.1f} s and {person.looked:.1f} s"
    print(f"{told} of looking, {person.clicks} clicks: {said}", flush=True)
    person.page.screenshot(path=folder / f"{name.replace(' ', '-')}.png", timeout=1000 * MOST)
    return done


def main() -> int:
    """Run the command line of this file."""
    parser = argparse.ArgumentParser(description="Ten tasks of a new user in a real browser.")
    parser.add_argument("-o", "--output", type=Path, required=True, help="folder for images")
    parser.add_argument("--size", default="1280x800", help="of the window (default: %(default)s)")
    parser.add_argument("--only", nargs="*", default=(), help="names of tasks")
    options = parser.parse_args()
    width, height = map(int, options.size.split("x"))
    options.output.mkdir(parents=True, exist_ok=True)
    chromium = shutil.which("chromium") or shutil.which("chromium-browser")
    failed = 0
    with sync_playwright() as playwright, tempfile.TemporaryDirectory() as folder:
        browser = playwright.chromium.launch(executable_path=chromium, args=FLAGS)
        for title, tasks in SCENES.items():
            wanted = [t for t in tasks if not options.only or t.__name__ in options.only]
            if not wanted:
                continue
            with start_page(Path(folder)) as address:
                page = browser.new_page(viewport={"width": width, "height": height}, accept_downloads=True)
                page.goto(address)
                person = Person(page)
                if title:
                    opens = partial(open_scene, person, title)
                    failed += not timed(person, f"open {title}", opens, options.output)
                for task in wanted:
                    does = partial(task, person, *((Path(folder),) if task is compare else ()))
                    name = task.__name__.replace("_", " ")
                    failed += not timed(person, name, does, options.output)
                page.close()
        browser.close()
    return failed


if __name__ == "__main__":
    sys.exit(main())
