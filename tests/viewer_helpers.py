"""A viewer with a real browser in front of it."""

from __future__ import annotations

import shutil
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import globule as gb
import numpy as np
import pytest
from globule.viewer.first_view import for_window
from waiting import PATIENCE, until

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
FLAGS = [
    "--headless=new",
    "--no-sandbox",
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
]
WINDOW = {"width": 1000, "height": 760}
CELLS = 24  # of the bar code


@contextmanager
def browser() -> Iterator[Any]:
    """Headless Chromium; skips the test where there is none."""
    pytest.importorskip("viser")
    sync_api = pytest.importorskip("playwright.sync_api")
    if CHROMIUM is None:
        pytest.skip("no chromium: apt-get install chromium")
    with sync_api.sync_playwright() as playwright:
        opened = playwright.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
        try:
            yield opened
        finally:
            opened.close()


def blob(n: int = 400, seed: int = 1) -> gb.Particles:
    """A cloud that fills the middle of its picture."""
    rng = np.random.default_rng(seed)
    positions = rng.normal(size=(n, 3)) * 0.4
    return gb.Particles(positions, support=0.35, attributes={"speed": positions[:, 0]})


class Watched:
    """A viewer, what it has shown, and pages of it."""

    def __init__(self, what: Any, opened: Any, **options: Any):
        self.viewer = gb.view(what, port=0, browser=False, block=False, **options)
        self.fitted = "camera" not in options
        self.viewer.state.set(quality__samples=1)
        self.shown: list[Any] = []
        self.viewer.on_frame(self._keep)
        self.opened = opened
        self.pages: list[Any] = []
        self.requests: list[str] = []

    def _keep(self, frame: Any) -> None:
        self.shown = [*self.shown[-200:], frame]

    def page(self) -> Any:
        """A new browser window that has its first sharp picture."""
        known = set(self.viewer.clients)
        page = self.opened.new_page(viewport=WINDOW, accept_downloads=True)
        page.set_default_timeout(1000 * PATIENCE)
        page.on("request", lambda request: self.requests.append(request.url))
        page.on("websocket", lambda socket: self.requests.append(socket.url))
        page.goto(self.viewer.address)
        self.pages.append(page)
        until(lambda: set(self.viewer.clients) - known, "for the page to connect")
        page.get_by_text("Help (H)").wait_for()
        page.client = self.viewer.clients[max(set(self.viewer.clients) - known)]
        self.still(page)

        if self.fitted:  # once more when the panel has taken its room
            until(lambda: self._fits(page), "for the view to fit its window")
        self.still(page)
        return page

    def _fits(self, page: Any) -> bool:
        """Whether the first view suits the size that the browser's picture has now."""
        next_frame(page)
        box = page.locator("canvas").first.bounding_box()
        size = (round(box["width"]), round(box["height"]))
        viewer, client = self.viewer, page.client
        fitted = for_window(viewer.first_camera, size[0] / size[1], viewer._outline)
        return client.pacer.full == size and np.allclose(
            client.camera.eye, fitted.eye, atol=0.02 * viewer.placement.extent
        )

    def still(
        self, page: Any, changed: Callable[[np.ndarray], bool] = lambda picture: True
    ) -> np.ndarray:
        """The next sharp picture of a page that is as asked, and has arrived."""
        client = page.client

        def settled() -> bool:
            pacer = client.pacer
            if client.frame is None or pacer.in_flight or pacer.making:
                return False
            shown = [f for f in self.shown if f.camera == client.camera and f.still]
            return bool(shown) and pacer._samples > 0 and changed(shown[-1].picture)

        until(settled, "for a sharp picture")
        return [f for f in self.shown if f.camera == client.camera and f.still][-1].picture

    def close(self) -> None:
        for page in self.pages:
            page.close()
        self.viewer.close()


def next_frame(page: Any) -> None:
    """Wait until the browser has drawn once more."""
    page.evaluate("() => new Promise(drawn => requestAnimationFrame(() => drawn()))")


def drag_along(page: Any, places: Any, button: str = "left", each: Any = next_frame) -> None:
    """Drag the mouse along places in the window; `each`, called with the page, follows each move.
    The button stays down after the last."""
    begin, *others = (tuple(map(float, place)) for place in places)
    page.mouse.move(*begin)
    each(page)
    page.mouse.down(button=button)
    for place in others:
        page.mouse.move(*place)
        each(page)


def stroke(page: Any, begin: Any, end: Any, steps: int = 12) -> None:
    """A drag from one place in the window to another."""
    drag_along(page, np.linspace(begin, end, steps + 1))
    page.mouse.up()


def take_tool(page: Any, tool: str) -> None:
    """Choose a tool with which drags draw, and wait until the browser catches them."""
    choose(page, "Mouse tool", tool)
    page.wait_for_function(
        "() => window.__viserSceneTree?.getState()['/strokes']?.dragBindings?.length"
        " && window.__viserMutable?.nodeRefFromName?.['/strokes']"
    )
    next_frame(page)


def silhouette(picture: np.ndarray) -> int:
    """Pixels that are not background."""
    corner = picture[2, 2].astype(int)
    return int((np.abs(picture.astype(int) - corner).sum(axis=2) > 30).sum())


def seen(page: Any) -> np.ndarray:
    """What the browser shows, without the panels: (H, W, 3) uint8."""
    import io

    from PIL import Image

    box = page.locator("canvas").first.bounding_box()
    with Image.open(io.BytesIO(page.screenshot(clip=box))) as image:
        return np.asarray(image.convert("RGB"))


def open_folder(page: Any, title: str) -> None:
    """Open a folder of the panel, unless it is; it stays as an earlier page left it."""
    heading = page.locator(f"xpath=//*[not(self::em) and normalize-space(text())='{title}']").first
    heading.wait_for()
    page.wait_for_timeout(500)  # the page puts folders as they were
    head = heading.locator("xpath=ancestor-or-self::*[contains(@class,'mantine-Paper-root')][1]")
    if not head.locator(".tabler-icon-chevron-up:visible").count():
        heading.click()


def check(page: Any, label: str, on: bool = True) -> None:
    page.get_by_label(label, exact=True).first.set_checked(on)


def choose(page: Any, label: str, option: str) -> None:
    page.get_by_label(label, exact=True).first.click()
    page.get_by_role("option", name=option, exact=True).click()


def number_box(page: Any, label: str) -> Any:
    """The number beside a slider."""
    row = page.locator(f"xpath=//label[.='{label}']/ancestor::div[2]/..").first
    return row.locator("input[inputmode]").first


def type_number(page: Any, label: str, value: float | str) -> None:
    """Type into the number beside a slider."""
    box = number_box(page, label)
    box.fill(str(value))
    box.press("Enter")


def type_text(page: Any, label: str, text: str) -> None:
    row = page.locator(f"xpath=//label[.='{label}']/ancestor::div[2]/..").first
    row.locator("input").first.fill(text)


def with_bar_code(frame: Any) -> np.ndarray:
    """The picture with its number in black and white cells along the lower edge."""
    picture = frame.picture.copy()
    height, width = picture.shape[:2]
    for i in range(CELLS):
        left, right = i * width // CELLS, (i + 1) * width // CELLS
        picture[-(height // 8) :, left:right] = 255 * (frame.number >> i & 1)
    return picture


def bar_code(picture: np.ndarray) -> int | None:
    """The number, or None where the cells are not clear."""
    height, width = picture.shape[:2]
    number = 0
    for i in range(CELLS):
        cell = picture[-(height // 16), (2 * i + 1) * width // (2 * CELLS)].mean()
        if 60 < cell < 195:
            return None
        number |= int(cell > 128) << i
    return number


def our_threads() -> list[str]:
    """The names of our threads, one for each."""
    return sorted(t.name for t in threading.enumerate() if t.name.startswith("globule"))


def threads_of_browsers() -> list[str]:
    """Our threads, but for those of the page's pool, which starts them as it needs them."""
    return [name for name in our_threads() if not name.startswith("globule desk")]


def differs(a: np.ndarray, by: float = 1.0):
    """A test for pictures that are others than `a`."""
    return lambda b: a.shape == b.shape and np.abs(a.astype(int) - b).mean() > by
