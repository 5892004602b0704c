"""A viewer with a real browser in front of it."""

from __future__ import annotations

import json
import shutil
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Any

import globule as gb
import numpy as np
import pytest
from globule.viewer.engine import Engine
from globule.viewer.open import open_source
from globule.viewer.picture import trace
from globule.viewer.state import State
from waiting import PATIENCE, until

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
FLAGS = ["--headless=new", "--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
WINDOW = {"width": 700, "height": 480}


@contextmanager
def browser() -> Iterator[Any]:
    """Headless Chromium; skips the test where there is none."""
    pytest.importorskip("websockets")
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
    positions = np.random.default_rng(seed).normal(size=(n, 3)) * 0.4
    return gb.Particles(positions, support=0.35, attributes={"speed": positions[:, 0]})


def view(what: Any, **options: Any) -> Any:
    return gb.view(what, port=0, browser=False, block=False, **options)


@contextmanager
def engine_of(what: Any, **settings: Any) -> Iterator[Engine]:
    source = open_source(what)
    engine = Engine(source, State(), source.up)
    try:
        engine.state.set(**settings)
        yield engine
    finally:
        engine.close()


def traced(source: Any, camera: gb.Camera, size: Any, moving: bool = False, **settings: Any) -> Any:
    state = State()
    state.set(**settings)
    with source.lock:
        return trace(source, state, camera, size, source.up, moving=moving)


def steps(source: Any, n: int) -> None:
    for _ in range(n):
        source.step()
        source.advance(State())


def talk(port: int, path: str, page: str = "") -> Any:
    """A connection of a page's script to its server. page: its path; "/look": of who looks."""
    from websockets.sync.client import connect

    return connect(f"ws://127.0.0.1:{port}{page}/globule/{path}", max_size=None)


def told(connection: Any, wanted: Callable[[dict], Any] = lambda message: True) -> dict:
    while True:
        data = connection.recv(timeout=PATIENCE)
        if isinstance(data, bytes):
            continue  # an image
        message = json.loads(data)
        with suppress(KeyError):  # of another kind
            if wanted(message):
                return message


class Watched:
    """A viewer, what it has shown, and its pages: of a real browser or of programs."""

    def __init__(self, what: Any, opened: Any = None, **options: Any):
        self.viewer = view(what, **options)
        self.fitted = "camera" not in options
        self.viewer.state.set(quality__samples=1)
        self.shown: list[Any] = []
        self.viewer.on_frame(self._keep)
        self.opened = opened
        self.pages: list[Any] = []
        self.requests: list[str] = []

    def _keep(self, frame: Any) -> None:
        self.shown = [*self.shown[-200:], frame]

    def _arrives(self, come: Callable[[], Any]) -> Any:
        """The page or program that `come` makes, with its `client`."""
        known, page = set(self.viewer.clients), come()
        self.pages.append(page)
        number = until(lambda: set(self.viewer.clients) - known, "for the page to connect").pop()
        page.client = self.viewer.clients[number]
        page.hand = until(lambda: self.viewer.page.tools.hands.get(number), "for its tools")
        return page

    def program(self, address: str | None = None, answers: bool = True) -> Any:
        """A new page of a `Program`, which has its first sharp picture if it answers."""
        from viewer_program import Program  # needs websockets

        program = self._arrives(lambda: Program(address or self.viewer.address, answers))
        if answers:
            self.still(program)
        return program

    def page(self) -> Any:
        """A new browser window that has its first sharp picture."""

        def come() -> Any:
            page = self.opened.new_page(viewport=WINDOW, accept_downloads=True)
            page.set_default_timeout(1000 * PATIENCE)
            page.on("request", lambda request: self.requests.append(request.url))
            page.on("websocket", lambda socket: self.requests.append(socket.url))
            page.goto(self.viewer.address)
            return page

        page = self._arrives(come)
        page.get_by_role("button", name="Inspector").wait_for()
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
        fitted = viewer._fitted(client, size[0] / size[1])
        return (
            client.room.top > 0
            and client.pacer.full == size
            and np.allclose(client.camera.eye, fitted.eye, atol=0.02 * viewer.extent)
        )

    def still(self, page: Any, changed: Callable[[np.ndarray], bool] = lambda picture: True) -> np.ndarray:
        client = page.client

        def settled() -> bool:
            pacer = client.pacer
            if client.frame is None or pacer.in_flight or pacer.making or pacer._changed is not None:
                return False
            engine = self.viewer.engine
            if (pacer._wanted, pacer._marks) != (engine._what(client), engine._over(client)):
                return False  # of settings that are no more
            shown = [f for f in self.shown if f.camera == client.camera and f.still]
            return bool(shown) and pacer._samples > 0 and changed(shown[-1].picture)

        until(settled, "for a sharp picture")
        return [f for f in self.shown if f.camera == client.camera and f.still][-1].picture

    def __enter__(self) -> Watched:
        return self

    def __exit__(self, *_: object) -> None:
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


def stroke(page: Any, begin: Any, end: Any, steps: int = 3) -> None:
    drag_along(page, np.linspace(begin, end, steps + 1))
    page.mouse.up()


def middle(page: Any) -> np.ndarray:
    box = page.locator("canvas").first.bounding_box()
    return np.array([box["x"] + box["width"] / 2, box["y"] + box["height"] / 2])


def take_tool(page: Any, tool: str) -> None:
    """Take a tool with which drags draw, and wait until the page knows."""
    page.hand.use(tool)
    page.locator("#globule-desk .tools").get_by_role(
        "button", name=tool.split(",")[0], exact=True, pressed=True
    ).wait_for()


def silhouette(picture: np.ndarray) -> float:
    """The share of pixels that are not background: the page may still change its size."""
    corner = picture[2, 2].astype(int)
    return float((np.abs(picture.astype(int) - corner).sum(axis=2) > 30).mean())


def open_section(page: Any, title: str) -> None:
    """Show a section of the inspector."""
    button = page.get_by_role("button", name="Inspector")
    if button.get_attribute("aria-pressed") != "true":
        button.click()
    page.get_by_role("tab", name=title, exact=True).click()


def type_number(page: Any, label: str, value: float | str) -> Any:
    """Type into the number beside a slider; the box."""
    box = page.get_by_label(f"{label}, value", exact=True)
    box.fill(str(value))
    box.press("Enter")
    return box


def our_threads() -> list[str]:
    return sorted(t.name for t in threading.enumerate() if t.name.startswith("globule"))


def threads_of_browsers() -> list[str]:
    """Our threads, but for those of the page's pool, which starts them as it needs them."""
    return [name for name in our_threads() if not name.startswith("globule desk")]
