"""The talk with the page of each browser, which shows images, all controls, and asks for actions.

The server sends images as bytes, and as JSON a model of what to show, controls that have changed,
notes, dialogs and moves of the camera. The page sends its camera, its size, the numbers of images
that have arrived, and names of actions.
"""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import json
from collections import deque
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np

from ..render.camera import Camera
from .desk_model import Model
from .gui import is_like
from .pacer import Plan
from .plots import over_time
from .roles import LOOKING, may_ask
from .state import MOST_BYTES

PATH = "/globule/desk"
HELLO = 10.0  # s in which a page says what it is
TICK = 0.3  # s between two looks at what changes by itself
MOST_ACTION = 4096  # bytes
MOST_WAITING = 32  # actions of a browser; what comes then waits in the connection
MOST_KEPT = 64  # tabs whose camera and tool wait for a reload
PART = 256 * 1024  # bytes of a file at once
MOST_WINDOW = 7680  # pixels of a side of a browser's window
# Settings that the script may change; the controls change all others.
SETTINGS = {
    "color__by",
    "color__automatic",
    "color__low",
    "color__high",
    "cuts__plane",
    "layers__hidden",
    "time__frame",
    "time__playing",
    "time__loop",
    "compare__at",
    "measure__shown",
}


class Note:
    """A note of a browser until `remove`; assigning to title, body or loading changes it."""

    _desk: Desk
    _browser: Any
    title: str
    body: str
    loading: bool

    def __init__(self, desk: Desk, browser: Any, number: int, **facts: Any):
        vars(self).update(facts, _desk=desk, _browser=browser, number=number)
        self._say()

    def __setattr__(self, name: str, value: Any) -> None:
        vars(self)[name] = value
        self._say()

    def _say(self, **more: Any) -> None:
        facts = {name: value for name, value in vars(self).items() if name[0] != "_"}
        self._desk.send(self._browser, {"note": facts | more})

    def remove(self) -> None:
        """Take it from the page."""
        self._say(gone=True)


class Browser:
    """The page of a person: its connection, and what it is sent.

    Attributes:
        client_id: counts the browsers of a viewer.
        role: STEER or LOOK.
        tab: its name for itself, which a reload does not change.
        box: messages for it: dictionaries, and bytes.
        images: on their way to it.
        waiting: actions that it has asked for.
        moves: of its camera by the server; what it says of its camera before the last is late.
    """

    def __init__(self, number: int, connection: Any):
        self.client_id, self.connection, self.role = number, connection, connection.role
        self.loop = asyncio.get_running_loop()
        self.tab, self.moves = "", 0
        self.box: deque[Any] = deque()
        self.images: deque[bytes] = deque()
        self.waiting: deque[tuple[Any, Any]] = deque()
        self.changed, self.painted, self.asked, self.done = (asyncio.Event() for _ in range(4))

    def wake(self, event: asyncio.Event) -> None:
        """Set one of its events, from any thread."""
        with contextlib.suppress(RuntimeError):  # the loop has ended
            self.loop.call_soon_threadsafe(event.set)


class Desk:
    """The pages of all browsers.

    Args:
        viewer: `globule.viewer.app.Viewer`.
        gui: `globule.viewer.gui.Gui`.

    Attributes:
        browsers: by their numbers; those without a place are not among them.
    """

    def __init__(self, viewer: Any, gui: Any):
        self.viewer, self.gui = viewer, gui
        self.model = Model(viewer)
        self.browsers: dict[int, Browser] = {}
        self._kept: dict[str, tuple[Camera, str]] = {}  # camera and tool of tabs that have left
        self._numbers, self._notes = itertools.count(), itertools.count(1)
        self._tellers = ThreadPoolExecutor(2, thread_name_prefix="globule desk")
        # An action for each browser at a time: nobody's actions wait for another one's.
        self._doers = ThreadPoolExecutor(viewer.most_clients, "globule action")
        viewer.state.listen(lambda changed: self.refresh())
        gui.on_change = self.refresh

    # To a browser; any thread may call these

    def refresh(self) -> None:
        """Send the model again where it has changed."""
        for browser in list(self.browsers.values()):
            browser.wake(browser.changed)

    def send(self, browser: Browser, *messages: Any) -> None:
        """Send messages: dictionaries, or bytes of a file."""
        browser.box.extend(messages)
        browser.wake(browser.changed)

    def note(self, browser: Browser, title: str, body: str, **facts: Any) -> Note:
        """Show a note. facts: loading, wrong, seconds (until it goes by itself)."""
        return Note(self, browser, next(self._notes), title=title, body=body, **facts)

    def dialog(self, browser: Browser, title: str, text: str) -> None:
        """Show Markdown until the person closes it."""
        self.send(browser, {"dialog": {"title": title, "text": text}})

    def give(self, browser: Browser, name: str, data: bytes) -> None:
        """Let a browser save a file."""
        parts = (bytes(4) + data[i : i + PART] for i in range(0, len(data), PART))
        self.send(browser, {"file": {"name": name, "size": len(data)}}, *parts)

    def move(self, browser: Browser, camera: Camera) -> None:
        """Move a browser's camera."""
        browser.moves += 1
        facts = {name: getattr(camera, name) for name in ("eye", "look_at", "up", "fov", "height")}
        self.send(browser, {"camera": facts, "moves": browser.moves})

    # With its page

    async def serve(self, connection: Any) -> None:
        """Talk with the page of one browser until it leaves."""
        from websockets.exceptions import ConnectionClosed

        browser, talk = Browser(next(self._numbers), connection), []
        with contextlib.suppress(ConnectionClosed):
            hello = json.loads(await asyncio.wait_for(connection.recv(), HELLO))["value"]
            size, tab = size_of(hello["size"]), hello["tab"]
            if not isinstance(tab, str) or not 8 <= len(tab) <= 64:
                raise ValueError("page: expected the name of a tab")
            if not await self.viewer.welcome(browser, size, bool(hello["dark"]), *self._kept.pop(tab, (None, ""))):
                await connection.send(json.dumps(browser.box.pop()))
                async for _ in connection:
                    pass
                return
            browser.tab = tab
            try:
                works = self._tell(browser), self._show(browser), self._hear(browser), self._act(browser)
                talk = [asyncio.create_task(work) for work in works]
                done, _ = await asyncio.wait(talk, return_when=asyncio.FIRST_COMPLETED)
                for task in done:
                    task.result()
            finally:
                self.viewer.left(browser)
                for task in talk:
                    task.cancel()
                await asyncio.gather(*talk, return_exceptions=True)

    def left(self, browser: Browser, client: Any) -> None:
        """Forget a browser that has left."""
        hand = self.viewer.page.tools.hands.get(browser.client_id)
        if browser.tab and client is not None and hand is not None:
            self._kept[browser.tab] = client.camera, hand.tool
            while len(self._kept) > MOST_KEPT:
                del self._kept[next(iter(self._kept))]
        for table in (self.browsers, self.model.series, self.model.sections):
            table.pop(browser.client_id, None)

    async def _tell(self, browser: Browser) -> None:
        """Send the model and controls after each change; a slow browser gets the newest only."""
        sent, stamp, known, loop, connection = "", 0, set[int](), browser.loop, browser.connection
        commands = [[name, command.key, command.private] for name, command in self.gui.commands.items()]
        self.send(browser, {"commands": commands})
        while True:
            browser.changed.clear()
            text = json.dumps(await loop.run_in_executor(self._tellers, self.model.of, browser))
            if text != sent:
                await connection.send(text)
                sent = text
            newest, changed = self.gui.stamp, self.gui.since(stamp)
            gone = known - set(self.gui.controls)
            if changed or gone:
                shown = [control.shown() for control in changed]
                await connection.send(json.dumps({"controls": shown, "gone": sorted(gone)}))
                stamp, known = newest, set(self.gui.controls)
            until = loop.time() + TICK
            while browser.box and loop.time() < until:
                message = browser.box.popleft()
                await connection.send(message if isinstance(message, bytes) else json.dumps(message))
            if not browser.box:
                with contextlib.suppress(asyncio.TimeoutError):
                    await asyncio.wait_for(browser.changed.wait(), TICK)

    async def _show(self, browser: Browser) -> None:
        """Send images in their order."""
        while True:
            browser.painted.clear()
            while browser.images:
                await browser.connection.send(browser.images.popleft())
            await browser.painted.wait()

    async def _hear(self, browser: Browser) -> None:
        """Take what the page sends: arrived images, camera and size at once, actions for `_act`."""
        client = self.viewer.clients[browser.client_id]
        async for text in browser.connection:
            if isinstance(text, bytes) and len(text) == 4:  # an image has arrived
                client.acknowledge(int.from_bytes(text, "little"))
                continue
            if len(text) > (MOST_BYTES + MOST_ACTION if "load" in str(text[:16]) else MOST_ACTION):
                await browser.connection.close(1009, "too long")
                return
            try:
                asked = json.loads(text)
                name, value = asked["do"], asked.get("value")
            except Exception as error:  # of what no page sends
                self.viewer.page.complain(browser, f"page: expected an action, got {type(error).__name__}")
                continue
            if name in ("look", "size"):
                self._do(browser, name, value)
                continue
            if len(browser.waiting) >= MOST_WAITING:
                browser.done.clear()
                await browser.done.wait()
            last = browser.waiting[-1] if browser.waiting else None
            if name == "handle" and last and last[0] == name and same_handle(last[1], value):
                browser.waiting.pop()  # the newest place counts
            browser.waiting.append((name, value))
            browser.asked.set()

    async def _act(self, browser: Browser) -> None:
        """Do what the page asks for, one action after the other."""
        while True:
            browser.asked.clear()
            while browser.waiting:
                asked = browser.waiting.popleft()
                browser.done.set()
                await browser.loop.run_in_executor(self._doers, self._do, browser, *asked)
            await browser.asked.wait()

    def _do(self, browser: Browser, name: Any, value: Any) -> None:
        """Do an action."""
        client = self.viewer.clients.get(browser.client_id)
        if client is None:
            return  # the browser has left
        try:
            action = self._actions().get(name) if isinstance(name, str) else None
            if action is None:
                raise ValueError(f"page: expected the name of an action that this view has, got {str(name)[:40]}")
            if not may_ask(client.role, name, self._is_private(name, value)):
                self._give_back(browser, name, value)
                raise ValueError(LOOKING)
            action(browser, value)
        except Exception as error:
            self.viewer.page.complain(browser, str(error) or type(error).__name__)
        browser.wake(browser.changed)

    def _is_private(self, name: str, value: Any) -> bool:
        """Whether a control or a command changes the browser's own view only."""
        known: dict[Any, Any] = {"control": self.gui.controls, "command": self.gui.commands}.get(name, {})
        key = value[0] if isinstance(value, list) and len(value) == 2 else value
        return isinstance(key, (int, str)) and key in known and known[key].private

    def _give_back(self, browser: Any, name: str, value: Any) -> None:
        """Show a browser again what it tried to change."""
        if name == "control" and isinstance(value, list) and value and isinstance(value[0], int):
            control = self.gui.controls.get(value[0])
            if control is not None:
                self.send(browser, {"controls": [control.shown()], "gone": []})

    def _actions(self) -> dict[str, Callable[[Any, Any], Any]]:
        """Functions of a browser and a value, by name."""
        page, viewer, source = self.viewer.page, self.viewer, self.viewer.source
        panels: dict[str, Any] = {type(panel).__name__: panel for panel in page.panels}
        play = panels["Play"]
        only_some = {"play": play.wanted(), "step": hasattr(source, "step"), "reset": hasattr(source, "reset"),
                     "open": viewer.on_open is not None}  # fmt: skip
        hand = page.tools.hands
        actions = {
            "look": self._look,
            "size": lambda browser, value: viewer.resize(browser, size_of(value)),
            "handle": self._handle,
            "set": self._set,
            "control": self._control,
            "command": self._command,
            "undo": lambda browser, value: page.undo(browser),
            "redo": lambda browser, value: viewer.state.history.redo(),
            "tool": lambda browser, value: hand[browser.client_id].use(value),
            "click": lambda browser, value: hand[browser.client_id].click(place_of(value)),
            "drag": lambda browser, value: hand[browser.client_id].drag(value),
            "fit": lambda browser, value: panels["View"].fit(browser),
            "picture": lambda browser, value: panels["Save"].picture(browser),
            "state": lambda browser, value: panels["Save"].save_state(browser),
            "load": lambda browser, value: panels["Save"].load(browser, value),
            "record": lambda browser, value: panels["Save"].record(browser),
            "range": lambda browser, value: panels["Color"].take_range(browser),
            "play": lambda browser, value: play.toggle(),
            "step": lambda browser, value: source.step(),
            "reset": lambda browser, value: play.reset(),
            "time": lambda browser, value: self._go(value),
            "series": self._watch,
            "section": lambda browser, value: self.model.sections.update({browser.client_id: str(value)[:40]}),
            "room": lambda browser, value: viewer.give_room(browser, value),
            "dark": lambda browser, value: viewer.clients[browser.client_id].darken(bool(value)),
            "open": lambda browser, value: viewer.open_another(),
        }
        return {name: action for name, action in actions.items() if only_some.get(name, True)}

    def _look(self, browser: Browser, value: Any) -> None:
        """The camera that a person has moved."""
        if not isinstance(value, dict):
            raise ValueError(f"page: expected a camera, got {str(value)[:40]}")
        camera = Camera(**{name: value[name] for name in ("eye", "look_at", "up", "fov", "height") if name in value})
        if value.get("moves") == browser.moves:
            self.viewer.look(browser, camera)

    def _handle(self, browser: Browser, value: Any) -> None:
        """A handle in the image that a person has moved: [its name, its place, its axes]."""
        name, at, axes = value if isinstance(value, list) and len(value) == 3 else (None, None, None)
        if not isinstance(name, str) or not is_like((0.0,) * 3, at) or not is_like(((0.0,) * 3,) * 3, axes):
            raise ValueError("page: expected a handle, its place and its axes")
        for panel in self.viewer.page.panels:
            if name in (handle["name"] for handle in panel.handles(browser)):
                panel.pulled(name, np.array(at, float), np.array(axes, float))

    def _control(self, browser: Any, value: Any) -> None:
        """What a person did with a control: [its number, its value]."""
        known = value[0] if isinstance(value, list) and len(value) == 2 else None
        control = self.gui.controls.get(known) if type(known) is int else None
        if control is None:
            raise ValueError("page: expected a control and its value")
        try:
            control.take(browser, value[1])
        except ValueError:
            self._give_back(browser, "control", value)
            raise

    def _command(self, browser: Any, value: Any) -> None:
        """A command by its name."""
        command = self.gui.commands.get(value) if isinstance(value, str) else None
        if command is None:
            raise ValueError(f"page: expected a command, got {str(value)[:40]}")
        command.take(browser, None)

    def _set(self, browser: Any, value: Any) -> None:
        """Change settings: {name: value}."""
        if not isinstance(value, dict) or not set(value) <= SETTINGS:
            raise ValueError(f"page: expected settings, got {str(value)[:60]}")
        names = self.viewer.source.color_names()
        if value.get("color__by") and value["color__by"] not in names:
            raise ValueError(f"color: expected one of {', '.join(names)}")
        if value.get("cuts__plane"):
            self.viewer.begin_plane(browser)
        from .page.color import opaque

        more = opaque(self.viewer, value["color__by"]) if "color__by" in value else {}
        self.viewer.state.set(**value, **more)

    def _go(self, value: Any) -> None:
        """Go to a step of a simulation."""
        go_to = getattr(self.viewer.source, "go_to", None)
        if go_to is None or type(value) is not int or value < 0:
            raise ValueError(f"page: expected a step of a simulation, got {str(value)[:40]}")
        go_to(value)
        self.viewer.engine.notify()

    def _watch(self, browser: Any, value: Any) -> None:
        """Choose what a browser plots over time."""
        plot = over_time(self.viewer.source)
        if value not in (plot["names"] if plot else []):
            raise ValueError(f"plot: expected a quantity, got {str(value)[:40]}")
        self.model.series[browser.client_id] = value

    def close(self) -> None:
        """End the threads."""
        for pool in (self._tellers, self._doers):
            pool.shutdown(wait=False, cancel_futures=True)


class DeskSink:
    """The sink of one browser: images, and errors as notes."""

    def __init__(self, desk: Desk, browser: Any):
        self.desk, self.browser = desk, browser

    def send(self, number: int, data: bytes, plan: Plan) -> None:
        """Send one JPEG."""
        self.browser.images.append(number.to_bytes(4, "little") + data)
        self.browser.wake(self.browser.painted)

    def error(self, message: str) -> None:
        """Show a message as a note."""
        self.desk.note(self.browser, "Not possible", message, wrong=True)


def place_of(value: Any) -> tuple[float, float]:
    """A place in the image, (0, 0) to (1, 1). Raises ValueError."""
    if not is_like((0.0, 0.0), value):
        raise ValueError(f"page: expected a place in the image, got {str(value)[:40]}")
    x, y = (min(1.0, max(0.0, float(v))) for v in value)
    return x, y


def size_of(value: Any) -> tuple[int, int]:
    """Width and height of a window, pixels. Raises ValueError."""
    if not is_like((0.0, 0.0), value):
        raise ValueError(f"page: expected a width and a height, got {str(value)[:40]}")
    width, height = (min(max(int(v), 1), MOST_WINDOW) for v in value)
    return width, height


def same_handle(one: Any, other: Any) -> bool:
    """Whether two moves are of one handle."""
    return isinstance(one, list) and isinstance(other, list) and one[:1] == other[:1]
