"""The page's own controls: toolbar, timeline and list of layers, over the image.

viser has no toolbar and no timeline. `Desk` therefore adds a script (page/desk.js) to viser's page.
The script talks with `Desk` over a websocket of its own at the same port, behind the same guard, in
JSON: the server sends a model of what to show, the script sends the name of an action.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import secrets
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any
from urllib.parse import parse_qs, urlsplit

from .desk_model import Model
from .plots import over_time
from .roles import LOOKING, Visitor, may_ask, visitor

PATH = "/globule/desk"
FILES = {
    "/globule/desk.js": ("application/javascript", "desk.js"),
    "/globule/desk.css": ("text/css; charset=utf-8", "desk.css"),
}
HEAD = b'<link rel="stylesheet" href="globule/desk.css"><script defer src="globule/desk.js"></script></head>'
TICK = 0.3  # s between two looks at what changes by itself
MOST_ACTION = 4096  # bytes
WIDE_PANEL = 490.0  # pixels, in a 4K window with larger letters
# Settings that the script may change; the panels change all others.
SETTINGS = {
    "surface__shape",
    "color__by",
    "color__automatic",
    "color__low",
    "color__high",
    "look__preset",
    "cuts__plane",
    "layers__hidden",
    "time__frame",
    "time__playing",
    "time__loop",
    "compare__at",
    "measure__shown",
}


class Desk:
    """The controls of all browsers.

    Args:
        viewer: `globule.viewer.app.Viewer`.
    """

    def __init__(self, viewer: Any):
        self.viewer = viewer
        self.model = Model(viewer)
        self._browsers: dict[str, Any] = {}  # by the word that a browser got from us
        self._changed: dict[Any, asyncio.Event] = {}  # by connection
        self._connections: dict[Any, Any] = {}  # of the script of each browser, by its number
        self._busy: dict[int, asyncio.Lock] = {}  # while an action of a browser is done
        self._tellers = ThreadPoolExecutor(2, thread_name_prefix="globule desk")
        # An action for each browser at a time: nobody's actions wait for another one's.
        self._doers = ThreadPoolExecutor(viewer.most_clients, "globule action")
        self._lock = threading.Lock()
        viewer.state.listen(lambda changed: self.refresh())

    def connected(self, browser: Any) -> None:
        """Tell a new browser the word with which its script names itself."""
        from viser import _messages

        word = secrets.token_urlsafe(12)
        self._browsers[word] = browser
        code = f'globalThis.globuleWord="{word}";globalThis.dispatchEvent(new Event("globule"));'
        browser._websock_connection.queue_message(_messages.RunJavascriptMessage(code))

    def disconnected(self, browser: Any) -> None:
        """Forget a browser that has left, and end the talk with its script."""
        self.model.series.pop(browser.client_id, None)
        self._busy.pop(browser.client_id, None)
        connection = self._connections.pop(browser.client_id, None)
        if connection is not None:
            loop = self.viewer.server._websock_server._background_event_loop
            asyncio.run_coroutine_threadsafe(connection.close(1008, "the browser left"), loop)
        for word in [word for word, known in self._browsers.items() if known is browser]:
            del self._browsers[word]

    def refresh(self) -> None:
        """Send the model again where it has changed; any thread may call this."""
        loop = self.viewer.server._websock_server._background_event_loop
        for event in list(self._changed.values()):
            with contextlib.suppress(RuntimeError):  # the loop has ended
                loop.call_soon_threadsafe(event.set)

    async def serve(self, connection: Any) -> None:
        """Talk with the script of one browser until it leaves."""
        from websockets.exceptions import ConnectionClosed

        word = "".join(parse_qs(urlsplit(connection.request.path).query).get("word", []))
        browser = self._browsers.get(word)
        if browser is None:
            await connection.close(1008, "unknown browser")
            return
        before = self._connections.get(browser.client_id)
        self._connections[browser.client_id] = connection
        if before is not None:
            await before.close(1008, "the same browser connected again")
        event = self._changed[connection] = asyncio.Event()
        works = self._tell(connection, browser, event), self._hear(connection, browser)
        talk = [asyncio.create_task(work) for work in works]
        try:
            await asyncio.wait(talk, return_when=asyncio.FIRST_COMPLETED)
        finally:
            del self._changed[connection]
            if self._connections.get(browser.client_id) is connection:
                del self._connections[browser.client_id]
            for task in talk:
                task.cancel()
            for task in talk:
                with contextlib.suppress(asyncio.CancelledError, ConnectionClosed):
                    await task

    async def _tell(self, connection: Any, browser: Any, event: asyncio.Event) -> None:
        """Send the model after each change; a slow browser gets the newest one only."""
        sent, loop = "", asyncio.get_running_loop()
        while True:
            event.clear()
            model = await loop.run_in_executor(self._tellers, self.model.of, browser)
            text = json.dumps(model)
            if text != sent:
                await connection.send(text)
                sent = text
            with contextlib.suppress(asyncio.TimeoutError):
                await asyncio.wait_for(event.wait(), TICK)

    async def _hear(self, connection: Any, browser: Any) -> None:
        """Do what the script asks for, one action after the other: what comes meanwhile waits in
        the connection, which holds the sender up."""
        loop, who = asyncio.get_running_loop(), visitor()
        busy = self._busy.setdefault(browser.client_id, asyncio.Lock())
        async for text in connection:
            if len(text) > MOST_ACTION:
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
            action = self._actions().get(name) if isinstance(name, str) else None
            if action is None:
                raise ValueError(f"page: expected the name of an action that this view has, got {str(name)[:40]}")
            if not (may_ask(who.role, name) and may_ask(client.role, name)):
                raise ValueError(LOOKING)
            action(browser, asked.get("value"))
        except Exception as error:
            page.complain(browser, str(error) or type(error).__name__)
        self.refresh()

    def _actions(self) -> dict[str, Callable[[Any, Any], Any]]:
        """Functions of a browser and a value, by name."""
        page, state, source = self.viewer.page, self.viewer.state, self.viewer.source
        panels = {type(panel).__name__: panel for panel in page.panels}
        play: Any = panels.get("Play")
        only_some = {"play": play, "step": hasattr(source, "step"), "reset": hasattr(source, "reset")}
        actions = {
            "set": lambda browser, value: self._set(browser, value),
            "undo": lambda browser, value: page.undo(browser),
            "redo": lambda browser, value: state.history.redo(),
            "tool": lambda browser, value: page.tools.hands[browser.client_id].use(value),
            "fit": lambda browser, value: panels["View"].fit(browser),
            "picture": lambda browser, value: panels["Save"].picture(browser),
            "state": lambda browser, value: panels["Save"].save_state(browser),
            "record": lambda browser, value: panels["Save"].record(browser),
            "range": lambda browser, value: panels["Color"].take_range(browser),
            "play": lambda browser, value: play.toggle(),
            "step": lambda browser, value: source.step(),
            "reset": lambda browser, value: source.reset(),
            "time": lambda browser, value: self._go(value),
            "series": lambda browser, value: self._watch(browser, value),
            "wide": lambda browser, value: browser.gui.main_panel.set_width(WIDE_PANEL),
            "dark": lambda browser, value: page.paint(browser.gui, bool(value)),
        }
        return {name: action for name, action in actions.items() if only_some.get(name, True)}

    def _set(self, browser: Any, value: Any) -> None:
        """Change settings: {name: value}."""
        if not isinstance(value, dict) or not set(value) <= SETTINGS:
            raise ValueError(f"page: expected settings, got {str(value)[:60]}")
        if "look__preset" in value:
            from .page.look import use_preset

            use_preset(self.viewer, value.pop("look__preset"))
        names = self.viewer.source.color_names()
        if value.get("color__by") and value["color__by"] not in names:
            raise ValueError(f"color: expected one of {', '.join(names)}")
        if value:
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


def file(path: str) -> tuple[str, bytes] | None:
    """Content type and bytes of a file of the page, or None."""
    found = FILES.get(path.partition("?")[0])
    if found is None:
        return None
    return found[0], (Path(__file__).with_name("page") / found[1]).read_bytes()
