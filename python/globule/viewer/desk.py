"""The talk with the script of our page, which shows images, all controls, and asks for actions.

viser's page is the host: its camera and the handles in the image are used. `Desk` adds a script
(page/desk.js) to it, which hides all else of it. The script talks with `Desk` over a websocket of
its own at the same port, behind the same guard. The server sends images as bytes, and as JSON a
model of what to show, controls that have changed, notes and dialogs; the script sends the name of
an action.
"""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import json
import math
import secrets
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any
from urllib.parse import parse_qs, urlsplit

from .desk_model import Model
from .pacer import Plan
from .plots import over_time
from .roles import LOOKING, Visitor, may_ask, visitor
from .state import MOST_BYTES

PATH = "/globule/desk"
FILES = {
    "/globule/desk.js": ("application/javascript", "desk.js"),
    "/globule/inspector.js": ("application/javascript", "inspector.js"),
    "/globule/upload.js": ("application/javascript", "upload.js"),
    "/globule/desk.css": ("text/css; charset=utf-8", "desk.css"),
}
HEAD = b"".join([  # the first one runs before viser's
    b'<link rel="stylesheet" href="globule/desk.css"><script src="globule/upload.js" data-viewer></script>',
    b'<script defer src="globule/inspector.js"></script><script defer src="globule/desk.js"></script></head>',
])  # fmt: skip
TICK = 0.3  # s between two looks at what changes by itself
MOST_ACTION = 4096  # bytes
MOST_KEPT = 64  # tabs whose camera and tool wait for a reload
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


class Desk:
    """The controls of all browsers.

    Args:
        viewer: `globule.viewer.app.Viewer`.
    """

    def __init__(self, viewer: Any, gui: Any):
        self.viewer, self.gui = viewer, gui
        self.model = Model(viewer)
        self._browsers: dict[str, Any] = {}  # by the word that a browser got from us
        self._changed: dict[Any, asyncio.Event] = {}  # by connection
        self._connections: dict[int, Any] = {}  # of the script of each browser, by its number
        self._boxes: dict[int, list[dict]] = {}  # messages for a browser
        self._pictures: dict[int, asyncio.Queue] = {}
        self._busy: dict[int, asyncio.Lock] = {}  # while an action of a browser is done
        self._tabs: dict[int, str] = {}  # the tab of a browser
        self._kept: dict[str, tuple[Any, str]] = {}  # camera and tool of tabs that have left
        self._numbers = itertools.count(1)
        self._tellers = ThreadPoolExecutor(2, thread_name_prefix="globule desk")
        # An action for each browser at a time: nobody's actions wait for another one's.
        self._doers = ThreadPoolExecutor(viewer.most_clients, "globule action")
        self._lock = threading.Lock()
        viewer.state.listen(lambda changed: self.refresh())
        gui.on_change = self.refresh

    @property
    def _loop(self) -> Any:
        return self.viewer.server.get_event_loop()

    def connected(self, browser: Any) -> None:
        """Tell a new browser the word with which its script names itself."""
        from viser import _messages

        word = secrets.token_urlsafe(12)
        self._browsers[word] = browser
        self._boxes.setdefault(browser.client_id, [])
        code = f'globalThis.globuleWord="{word}";globalThis.dispatchEvent(new Event("globule"));'
        browser._websock_connection.queue_message(_messages.RunJavascriptMessage(code))

    def disconnected(self, browser: Any, client: Any = None) -> None:
        """Forget a browser that has left, and end the talk with its script."""
        number = browser.client_id
        hand = self.viewer.page.tools.hands.get(number)
        tab = self._tabs.pop(number, None)
        if tab and client is not None and hand is not None:
            self._kept[tab] = client.camera, hand.tool
            while len(self._kept) > MOST_KEPT:
                del self._kept[next(iter(self._kept))]
        self.model.series.pop(number, None)
        for table in (self._busy, self._boxes, self._pictures, self.model.sections):
            table.pop(number, None)
        connection = self._connections.pop(number, None)
        if connection is not None:
            asyncio.run_coroutine_threadsafe(connection.close(1008, "the browser left"), self._loop)
        for word in [word for word, known in self._browsers.items() if known is browser]:
            del self._browsers[word]

    # To a browser; any thread may call these

    def refresh(self) -> None:
        """Send the model again where it has changed."""
        for event in list(self._changed.values()):
            with contextlib.suppress(RuntimeError):  # the loop has ended
                self._loop.call_soon_threadsafe(event.set)

    def send(self, browser: Any, message: dict[str, Any]) -> None:
        """Send a message, as soon as the browser's script is there."""
        box = self._boxes.get(browser.client_id)
        if box is not None:
            box.append(message)
            self.refresh()

    def note(self, browser: Any, title: str, body: str, **facts: Any) -> Note:
        """Show a note. facts: loading, wrong, seconds (until it goes by itself)."""
        return Note(self, browser, next(self._numbers), title=title, body=body, **facts)

    def dialog(self, browser: Any, title: str, text: str) -> None:
        """Show Markdown until the person closes it."""
        self.send(browser, {"dialog": {"title": title, "text": text}})

    def picture(self, browser: Any, number: int, data: bytes) -> None:
        """Send an image."""
        packed = number.to_bytes(4, "little") + data

        def put() -> None:
            self._pictures.setdefault(browser.client_id, asyncio.Queue()).put_nowait(packed)

        with contextlib.suppress(RuntimeError):  # the loop has ended
            self._loop.call_soon_threadsafe(put)

    # With its script

    async def serve(self, connection: Any) -> None:
        """Talk with the script of one browser until it leaves."""
        from websockets.exceptions import ConnectionClosed

        word = "".join(parse_qs(urlsplit(connection.request.path).query).get("word", []))
        browser = self._browsers.get(word)
        if browser is None:
            await connection.close(1008, "unknown browser")
            return
        number = browser.client_id
        before = self._connections.get(number)
        self._connections[number] = connection
        if before is not None:
            await before.close(1008, "the same browser connected again")
            client = self.viewer.clients.get(number)
            if client is not None:  # what was on its way is lost
                client.again()
        event = self._changed[connection] = asyncio.Event()
        works = self._tell(connection, browser, event), self._hear(connection, browser), self._show(connection, number)
        talk = [asyncio.create_task(work) for work in works]
        try:
            await asyncio.wait(talk, return_when=asyncio.FIRST_COMPLETED)
        finally:
            del self._changed[connection]
            if self._connections.get(number) is connection:
                del self._connections[number]
            for task in talk:
                task.cancel()
            for task in talk:
                with contextlib.suppress(asyncio.CancelledError, ConnectionClosed):
                    await task

    async def _tell(self, connection: Any, browser: Any, event: asyncio.Event) -> None:
        """Send the model and controls after each change; a slow browser gets the newest only."""
        sent, stamp, loop = "", 0, asyncio.get_running_loop()
        known: set[int] = set()
        begun = False
        while True:
            event.clear()
            if browser.client_id in self.viewer.clients:
                model = await loop.run_in_executor(self._tellers, self.model.of, browser)
                text = json.dumps(model)
                if text != sent:
                    await connection.send(text)
                    sent = text
                if not begun:
                    await connection.send(json.dumps({"commands": self._commands()}))
                    begun = True
                newest, changed = self.gui.stamp, self.gui.since(stamp)
                gone = known - set(self.gui.controls)
                if changed or gone:
                    shown = [control.shown() for control in changed]
                    await connection.send(json.dumps({"controls": shown, "gone": sorted(gone)}))
                    stamp, known = newest, set(self.gui.controls)
            box = self._boxes.get(browser.client_id, [])
            while box:
                await connection.send(json.dumps(box.pop(0)))
            with contextlib.suppress(asyncio.TimeoutError):
                await asyncio.wait_for(event.wait(), TICK)

    def _commands(self) -> list[list[Any]]:
        return [[name, command.key, command.private] for name, command in self.gui.commands.items()]

    async def _show(self, connection: Any, number: int) -> None:
        """Send images in their order."""
        queue = self._pictures.setdefault(number, asyncio.Queue())
        while True:
            await connection.send(await queue.get())

    async def _hear(self, connection: Any, browser: Any) -> None:
        """Do what the script asks for, one action after the other: what comes meanwhile waits in
        the connection, which holds the sender up."""
        loop, who = asyncio.get_running_loop(), visitor()
        busy = self._busy.setdefault(browser.client_id, asyncio.Lock())
        async for text in connection:
            if isinstance(text, bytes) and len(text) == 4:  # an image has arrived
                client = self.viewer.clients.get(browser.client_id)
                if client is not None:
                    client.acknowledge(int.from_bytes(text, "little"))
                continue
            if len(text) > (MOST_BYTES + MOST_ACTION if "load" in str(text[:16]) else MOST_ACTION):
                await connection.close(1009, "too long")
                return
            await busy.acquire()
            done = loop.run_in_executor(self._doers, self._do, text, browser, who)
            done.add_done_callback(lambda _: busy.release())
            await asyncio.shield(done)  # which goes on where this connection ends

    def _do(self, text: str | bytes, browser: Any, who: Visitor) -> None:
        """Do an action; who: what the connection that asks may do."""
        page, client = self.viewer.page, self.viewer.clients.get(browser.client_id)
        if client is None:
            return  # the browser has left, or has no place
        try:
            asked = json.loads(text)
            name: Any = asked.get("do") if isinstance(asked, dict) else None
            value = asked.get("value") if isinstance(asked, dict) else None
            action = self._actions().get(name) if isinstance(name, str) else None
            if action is None:
                raise ValueError(f"page: expected the name of an action that this view has, got {str(name)[:40]}")
            own = self._is_private(name, value)
            if not (may_ask(who.role, name, own) and may_ask(client.role, name, own)):
                self.gui.since(0)
                self._give_back(browser, name, value)
                raise ValueError(LOOKING)
            action(browser, value)
        except Exception as error:
            page.complain(browser, str(error) or type(error).__name__)
        self.refresh()

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
        page, state, source = self.viewer.page, self.viewer.state, self.viewer.source
        panels = {type(panel).__name__: panel for panel in page.panels}
        play: Any = panels.get("Play")
        only_some = {"play": play.wanted(), "step": hasattr(source, "step"), "reset": hasattr(source, "reset"),
                     "open": self.viewer.on_open is not None}  # fmt: skip
        hand = page.tools.hands
        actions = {
            "set": lambda browser, value: self._set(browser, value),
            "control": lambda browser, value: self._control(browser, value),
            "command": lambda browser, value: self._command(browser, value),
            "undo": lambda browser, value: page.undo(browser),
            "redo": lambda browser, value: state.history.redo(),
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
            "series": lambda browser, value: self._watch(browser, value),
            "section": lambda browser, value: self.model.sections.update({browser.client_id: str(value)[:40]}),
            "room": lambda browser, value: self.viewer.give_room(browser, value),
            "dark": lambda browser, value: self.viewer.clients[browser.client_id].darken(bool(value)),
            "tab": lambda browser, value: self._come_back(browser, value),
            "open": lambda browser, value: self.viewer.open_another(),
        }
        return {name: action for name, action in actions.items() if only_some.get(name, True)}

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

    def _come_back(self, browser: Any, value: Any) -> None:
        """A browser tells the name of its tab, which a reload does not change: its camera and tool
        come back."""
        if not isinstance(value, str) or not 8 <= len(value) <= 64:
            raise ValueError("page: expected the name of a tab")
        self._tabs[browser.client_id] = value
        camera, tool = self._kept.pop(value, (None, ""))
        hand = self.viewer.page.tools.hands.get(browser.client_id)
        if camera is not None:
            self.viewer.move(browser, camera)
        if hand is not None and tool in hand.choices:
            hand.use(tool)

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
        self.desk.picture(self.browser, number, data)

    def error(self, message: str) -> None:
        """Show a message as a note."""
        self.desk.note(self.browser, "Not possible", message, wrong=True)


def place_of(value: Any) -> tuple[float, float]:
    """A place in the image, (0, 0) to (1, 1). Raises ValueError."""
    good = isinstance(value, list) and len(value) == 2 and all(type(v) in (int, float) for v in value)
    if not good or not all(math.isfinite(v) for v in value):
        raise ValueError(f"page: expected a place in the image, got {str(value)[:40]}")
    x, y = (min(1.0, max(0.0, float(v))) for v in value)
    return x, y


def file(path: str) -> tuple[str, bytes] | None:
    """Content type and bytes of a file of the page, or None."""
    found = FILES.get(path.partition("?")[0])
    if found is None:
        return None
    return found[0], (Path(__file__).with_name("page") / found[1]).read_bytes()
