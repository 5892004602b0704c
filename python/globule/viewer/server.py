"""The server of a page: its files over HTTP, and its talk over a websocket, in a thread of its own."""

from __future__ import annotations

import asyncio
import contextlib
import functools
import gzip
import http
import itertools
import logging
import threading
import weakref
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

from websockets.asyncio.server import ServerConnection, serve
from websockets.datastructures import Headers
from websockets.exceptions import ConnectionClosed
from websockets.frames import DATA_OPCODES, Frame
from websockets.http11 import Response

from .guard import Guard, OneLine
from .roles import Allowance

MOST_MESSAGE = 1024 * 1024  # bytes of one message from a client
CLOSING = 1.0  # s that a client may take to close its side
# Messages of one connection at once, and s for each more: a mouse sends a tenth of that. What comes
# faster waits in the socket, and with it the sender.
FLOOD = 1000, 1 / 500
MOST_TRIES = 1000  # ports, from the first one upwards
KINDS = {".js": "application/javascript", ".css": "text/css; charset=utf-8"}
FILES = {f"/globule/{name}": name for name in (
    "camera.js", "handles.js", "desk.js", "inspector.js", "upload.js", "start.js", "desk.css", "start.css"
)}  # fmt: skip
# The page may load from this server and connect to this server, and to nothing else. No script and
# no style in its text runs.
HEADERS = {
    "Content-Security-Policy": "default-src 'self'; img-src 'self' data: blob:; object-src 'none'; frame-src 'none'; "
    "frame-ancestors 'self'; form-action 'none'; base-uri 'self'",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
    "Cache-Control": "no-cache",
    "Vary": "Accept-Encoding",
}


class Connection(ServerConnection):
    """Hears no more messages than people send, and ends where other frames flood it.

    Attributes:
        role: that its address asks for.
    """

    role: str

    def __init__(self, *given: Any, known: Any, **more: Any):
        super().__init__(*given, **more)
        known.add(self)
        self.allowed, self.allowed_frames = Allowance(*FLOOD), Allowance(*FLOOD)

    async def recv(self, *given: Any, **more: Any) -> Any:
        """The next message, when the sender may send one more."""
        while not self.allowed.take():
            await asyncio.sleep(FLOOD[1])
        return await super().recv(*given, **more)

    def process_event(self, event: Any) -> None:
        """A frame that ends no message, such as a ping: browsers send few of them."""
        ends = isinstance(event, Frame) and event.fin and event.opcode in DATA_OPCODES
        if not ends and not self.allowed_frames.take():
            if not self.transport.is_closing():
                self.logger.warning("a browser sent too many frames without a message")
            self.transport.abort()
            return
        super().process_event(event)

    async def answers(self, seconds: float) -> bool:
        """Whether the other side answers a ping in time; if not, this ends the connection."""

        async def answered() -> None:
            await (await self.ping())

        try:
            await asyncio.wait_for(answered(), seconds)
            return True
        except (asyncio.TimeoutError, ConnectionClosed):
            self.transport.abort()
            return False


class Server:
    """A server until `close`.

    Args:
        guard: checks each request.
        page: HTML at "/".
        path: of the websocket.
        talk: with a `Connection`, until it returns.
        host: the address to listen on.
        port: the first port to try; 0 takes any free one.

    Attributes:
        port: that the server listens on.
        loop: of its thread.

    Raises:
        OSError: no port is free.
    """

    loop: asyncio.AbstractEventLoop

    def __init__(
        self, guard: Guard, page: bytes, path: str, talk: Callable[[Any], Awaitable[None]], host: str, port: int
    ):
        self._guard, self._page, self._path, self._talk = guard, page, path, talk
        self._open: weakref.WeakSet[Connection] = weakref.WeakSet()
        self._packed: dict[str, bytes] = {}
        self._ready = threading.Event()
        self._error: Exception | None = None
        self.port = 0
        self._thread = threading.Thread(
            target=lambda: asyncio.run(self._serve(host, port)), name="globule server", daemon=True
        )
        self._thread.start()
        self._ready.wait()
        if self._error is not None:
            raise self._error

    async def _serve(self, host: str, port: int) -> None:
        self.loop, self._stop = asyncio.get_running_loop(), asyncio.Event()
        said = OneLine()
        self.loop.set_exception_handler(said.of_task)
        made: Any = functools.partial(Connection, known=self._open)
        logger = logging.Logger("globule.viewer.connections", logging.WARNING)
        logger.addHandler(said)
        for tried in range(port, port + (MOST_TRIES if port else 1)):
            try:
                server = await serve(
                    self._talk, host, tried, process_request=self._answer, compression=None, max_size=MOST_MESSAGE,
                    create_connection=made, close_timeout=CLOSING,
                    logger=logger,
                )  # fmt: skip
                break
            except (OSError, OverflowError) as error:
                self._error = error
        else:
            self._ready.set()
            return
        self._error, self.port = None, server.sockets[0].getsockname()[1]
        self._ready.set()
        async with server:
            await self._stop.wait()
            self.drop()

    def drop(self) -> None:
        """End all connections at once; one whose browser reads nothing would be waited for."""
        for connection in list(self._open):
            connection.transport.abort()

    def close(self) -> None:
        """End the connections and free the port."""
        self.call(lambda: self._stop.set())
        if threading.current_thread() is not self._thread:
            self._thread.join(10)

    def call(self, does: Callable[[], Any]) -> None:
        """Call a function in the server's thread, unless that has ended."""
        with contextlib.suppress(RuntimeError):
            self.loop.call_soon_threadsafe(does)

    def _answer(self, connection: Any, request: Any) -> Any:
        """The answer to a request, or None for a websocket."""
        try:
            return self._checked(connection, request)
        except Exception:  # of headers and paths that nobody's browser sends
            why = "globule: expected a request that can be read\n"
            return connection.respond(http.HTTPStatus.FORBIDDEN, why)

    def _checked(self, connection: Any, request: Any) -> Any:
        why = self._guard.refusal(request.path, request.headers)
        if why is not None:
            return connection.respond(http.HTTPStatus.FORBIDDEN, f"globule: {why}\n")
        connection.role = self._guard.role(request.path, request.headers)
        path = self._guard.asked(request.path)[1].partition("?")[0]
        if path == self._path:
            return None  # a websocket, or refused by websockets
        if path != "/" and path not in FILES:
            return connection.respond(http.HTTPStatus.NOT_FOUND, "globule: expected the path of a page\n")
        kind, body = self._file(path)
        headers = Headers(HEADERS | {"Content-Type": kind})
        if "gzip" in ",".join(request.headers.get_all("Accept-Encoding")):
            body = self._packed.setdefault(path, gzip.compress(body))
            headers["Content-Encoding"] = "gzip"
        headers["Content-Length"] = str(len(body))
        if self._guard.tokens:
            headers["Set-Cookie"] = self._guard.cookie(connection.role, request.headers)
        return Response(200, "OK", headers, body)

    def _file(self, path: str) -> tuple[str, bytes]:
        if path == "/":
            return "text/html; charset=utf-8", self._page
        name = FILES[path]
        return KINDS[Path(name).suffix], page_file(name)


def page_file(name: str) -> bytes:
    """A file of the page."""
    return (Path(__file__).with_name("page") / name).read_bytes()


async def silent(connections: dict[int, Connection], seconds: float) -> list[int]:
    """End the connections that answer no ping, such as those of a network that broke; their numbers."""
    heard = await asyncio.gather(*(connection.answers(seconds) for connection in connections.values()))
    return list(itertools.compress(connections, (not one for one in heard)))
