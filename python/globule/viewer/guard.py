"""Access control of the page.

On a loopback address every program of this machine may open the page. On any other address, and
behind a reverse proxy, a client needs a token: one token steers, another only looks (`roles.py`).
The guard checks each HTTP request and each websocket handshake before the server answers. The
address of a page says its role, since the tabs of one browser share their cookies: the page below
`LOOK_PATH` and its websockets look, all others steer.

viser has no such check and opens its socket in a thread of its own. `Guard.server` therefore makes
viser's server from copies of two of viser's functions, in which the name of the function that opens
the socket stands for `Guard.serve`. Nothing of viser and websockets is replaced for anyone else.
pyproject.toml pins the versions of viser for which the tests cover this; `Guard.started` tells
whether the socket was opened through the guard.
"""

from __future__ import annotations

import asyncio
import contextlib
import functools
import gzip
import hashlib
import hmac
import html
import http
import ipaddress
import itertools
import logging
import re
import secrets
import warnings
import weakref
from types import FunctionType
from typing import Any
from urllib.parse import parse_qs, urlsplit

from . import desk
from .log import Repeats, log
from .roles import LOOK, REFUSED, STEER, VISITOR, Allowance, Visitor, visitor

REPEAT = 5.0  # s before the same message is logged again
OTHERS = 10, REPEAT  # messages about connections at once, and s for each more
MOST_MESSAGE = 1024 * 1024  # bytes of one message from a client
CLOSING = 1.0  # s that a client may take to close its side
# Messages of one connection at once, and s for each more: a mouse sends a tenth of that. What comes
# faster waits in the socket, and with it the sender.
FLOOD = 1000, 1 / 500
LOOK_PATH = "/look"
LOCAL = ("127.0.0.1", "localhost", "::1")  # addresses to listen on without a token
# The page may load from this server and connect to this server, and to nothing else. Of the scripts
# in its text, those run that carry the server's nonce; viser needs eval.
POLICY = (
    "default-src 'self'; script-src 'self' 'nonce-{nonce}' 'unsafe-eval' blob:; "
    "style-src 'self' 'unsafe-inline'; img-src 'self' data: blob:; font-src 'self' data:; "
    "connect-src 'self' data: blob:; worker-src 'self' blob:; frame-src 'none'; "
    "object-src 'none'; frame-ancestors 'self'; form-action 'none'; base-uri 'self'"
)
# A host of a header: a name, or an address of version 6 in brackets, and a port.
HOST = re.compile(r"(?:\[(?P<six>[0-9A-Fa-f:.]+)\]|(?P<name>[0-9A-Za-z.-]+))(?::(?P<port>[0-9]{1,5}))?")
# viser's page unpacks its script, and adds it to the page as an element.
ADDED = b'document.createElement("script");'


class Guard:
    """The access control of one server.

    Args:
        token: the word that a client must send to steer; None: everyone on this machine steers.
        title: of the page, in the browser's tab.
        look_token: the word of a client that only looks.

    Attributes:
        started: whether the server's socket was opened through this guard.
        desk: `globule.viewer.desk.Desk`, which talks with our own controls.
        roles: `globule.viewer.roles.Roles`, which refuses messages of those who look.
    """

    def __init__(self, token: str | None, title: str = "globule", look_token: str | None = None):
        self.title = title
        self.tokens = {STEER: token, LOOK: look_token} if token is not None else {}
        self.started = False
        self.desk: Any = None
        self.roles: Any = None
        nonce = secrets.token_urlsafe(18)
        self._policy, self._nonce = POLICY.format(nonce=nonce), nonce.encode()
        self._pages: dict[bytes, bytes] = {}  # viser's page to ours
        self._open: weakref.WeakSet[Any] = weakref.WeakSet()  # connections

    def end(self) -> None:
        """End all connections; one whose browser reads nothing would be waited for. Any thread."""
        for connection in list(self._open):
            with contextlib.suppress(RuntimeError):  # the loop has ended
                connection.loop.call_soon_threadsafe(connection.transport.abort)

    def refusal(self, path: str, headers: Any) -> str | None:
        """The reason to refuse a request, or None.

        Args:
            path: of the request, with its query.
            headers: `websockets.datastructures.Headers`.
        """
        hosts, origins = headers.get_all("Host"), headers.get_all("Origin")
        if len(hosts) != 1 or len(origins) > 1:
            return "expected one host"
        (host,) = hosts
        if origins and origins[0] not in (f"http://{host}", f"https://{host}"):
            return "expected a page of this server, got a page of another one"
        if not self.tokens:
            return None if is_local(host) else "expected a loopback address of this machine"
        if self.role(path, headers) is None:
            return "expected the token in the address: ?token=…"
        return None

    def role(self, path: str, headers: Any) -> str | None:
        """The role that the address asks for, if its token or the role's cookie is right; None."""
        role, _ = self.asked(path)
        if not self.tokens:
            return role
        token, words = self.tokens[role], parse_qs(urlsplit(path).query).get("token", [])
        for line in headers.get_all("Cookie"):
            pairs = (part.strip().partition("=") for part in line.split(";"))
            words += [word for name, _, word in pairs if name == self._cookie_name(role)]
        right = token and any(hmac.compare_digest(token.encode(), word.encode()) for word in words)
        return role if right else None

    def asked(self, path: str) -> tuple[str, str]:
        """The role that the path of a request asks for, and the path below the role's page."""
        rest = path.removeprefix(LOOK_PATH)
        if LOOK in self.tokens and rest != path and rest[:1] in ("", "/", "?"):
            return LOOK, rest if rest[:1] == "/" else "/" + rest
        return STEER, path

    def cookie(self, role: str, headers: Any) -> str:
        """The cookie that carries the token of a role in the page's own requests."""
        secure = "; Secure" if "https" in headers.get_all("X-Forwarded-Proto") else ""
        carried = f"{self._cookie_name(role)}={self.tokens[role]}"
        return f"{carried}; Path=/; HttpOnly; SameSite=Strict{secure}"

    def _cookie_name(self, role: str) -> str:
        """Viewers on one host share its cookies, whatever their ports."""
        return f"globule-{hashlib.sha256((self.tokens[role] or '').encode()).hexdigest()[:12]}"

    def _finish(self, response: Any) -> None:
        """Replace the title in viser's page, which is "Viser", add our own controls, and let the
        page's scripts run."""
        if not response.headers.get("Content-Type", "").startswith("text/html"):
            return
        body = response.body
        if body not in self._pages:
            packed = response.headers.get("Content-Encoding") == "gzip"
            page = gzip.decompress(body) if packed else body
            page = page.replace(b"<script", b'<script nonce="%s"' % self._nonce)
            page = page.replace(ADDED, b'%se.nonce="%s";' % (ADDED, self._nonce))
            name = f"<title>{html.escape(self.title)}</title>".encode()
            if b"<title>Viser</title>" in page:  # not the start page
                page = page.replace(b"<title>Viser</title>", name, 1)
                page = page.replace(b"</head>", desk.HEAD, 1)
            self._pages[body] = gzip.compress(page) if packed else page
        response.body = self._pages[body]
        del response.headers["Content-Length"]
        response.headers["Content-Length"] = str(len(response.body))

    def serve(self, handler: Any, host: str, port: int, protocol: str | None = None, **options: Any) -> Any:
        """`websockets.asyncio.server.serve`, with this guard before every answer.

        protocol: of websockets that `handler` talks with; None: any.
        """
        from websockets.asyncio.server import ServerConnection, serve
        from websockets.frames import DATA_OPCODES, Frame

        class Slowed(ServerConnection):
            """Hears no more messages than people send, and ends where other frames flood it."""

            def __init__(own, *given: Any, **more: Any):
                super().__init__(*given, **more)
                known.add(own)
                own.messages, own.frames = Allowance(*FLOOD), Allowance(*FLOOD)

            async def recv(own, *given: Any, **more: Any) -> Any:
                while not own.messages.take():
                    await asyncio.sleep(FLOOD[1])
                return await super().recv(*given, **more)

            def process_event(own, event: Any) -> None:
                """A frame that ends no message, such as a ping: browsers send few of them."""
                ends = isinstance(event, Frame) and event.fin and event.opcode in DATA_OPCODES
                if not ends and not own.frames.take():
                    if not own.transport.is_closing():
                        own.logger.warning("a browser sent too many frames without a message")
                    own.transport.abort()
                    return
                super().process_event(event)

        inner, known = options.pop("process_request"), self._open

        def check(connection: Any, request: Any) -> Any:
            try:
                return answered(connection, request)
            except Exception:  # of headers and paths that nobody's browser sends
                why = "globule: expected a request that can be read\n"
                return connection.respond(http.HTTPStatus.FORBIDDEN, why)

        def answered(connection: Any, request: Any) -> Any:
            why = self.refusal(request.path, request.headers)
            if why is not None:
                return connection.respond(http.HTTPStatus.FORBIDDEN, f"globule: {why}\n")
            connection.role = self.role(request.path, request.headers)
            _, request.path = self.asked(request.path)
            if request.path.partition("?")[0] == desk.PATH:
                return None  # a websocket, or refused by websockets
            found = desk.file(request.path)
            response = inner(connection, request) if found is None else answer(*found)
            if response is not None:
                self._finish(response)
                response.headers["Content-Security-Policy"] = self._policy
                response.headers["Referrer-Policy"] = "no-referrer"
                response.headers["X-Content-Type-Options"] = "nosniff"
                if self.tokens:
                    response.headers["Set-Cookie"] = self.cookie(connection.role, request.headers)
            return response

        async def route(connection: Any) -> None:
            VISITOR.set(Visitor(connection.role))
            if connection.request.path.partition("?")[0] == desk.PATH:
                if self.desk is not None:
                    await self.desk.serve(connection)
            elif protocol not in (None, connection.subprotocol):  # viser would print what it is
                await connection.close(1002, f"expected {protocol}: reload the page")
            else:
                await handler(connection)

        options["max_size"], options["create_connection"] = MOST_MESSAGE, Slowed
        options["close_timeout"] = CLOSING
        options["logger"] = connection_logger()
        self.started = True
        return serve(route, host, port, process_request=check, **options)

    def server(self, host: str, port: int) -> Any:
        """A `viser.ViserServer` whose socket this guard opens.

        Args:
            host: the address to listen on.
            port: the first port to try; 0 takes any free one.
        """
        import viser
        import websockets
        from viser import _viser, infra
        from viser.infra import _infra

        serve = functools.partial(self.serve, protocol=f"viser-v{viser.__version__}")
        opening = Renamed(
            websockets, asyncio=Renamed(websockets.asyncio, server=Renamed(websockets.asyncio.server, serve=serve))
        )

        class Socket(infra.WebsockServer):
            _background_worker = with_names(infra.WebsockServer._background_worker, _infra, websockets=opening)

            async def _handle_incoming_message(own, client_id: Any, message: Any) -> None:
                who = visitor()
                if self.roles is None or who.role == REFUSED:
                    return
                if self.roles.may(who, message):
                    await super()._handle_incoming_message(client_id, message)
                else:
                    self.roles.refuse(who, client_id, message)

        class Server(viser.ViserServer):
            __init__ = with_names(viser.ViserServer.__init__, _viser, infra=Renamed(infra, WebsockServer=Socket))

        return Server(host, port, verbose=False)


def answer(kind: str, body: bytes) -> Any:
    """A response with a file; kind: its content type."""
    from websockets.datastructures import Headers
    from websockets.http11 import Response

    length = str(len(body))
    headers = Headers({"Content-Type": kind, "Content-Length": length, "Cache-Control": "no-cache"})
    return Response(200, "OK", headers, body)


class Renamed:
    """A module in which a few names mean something else; the module itself stays as it is."""

    def __init__(self, module: Any, **names: Any):
        self._module = module
        vars(self).update(names)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._module, name)


def with_names(function: Any, module: Any, **names: Any) -> Any:
    """A copy of a module's function in which some global names mean something else."""
    copy = FunctionType(
        function.__code__, {**vars(module), **names}, function.__name__, function.__defaults__, function.__closure__
    )
    copy.__kwdefaults__ = function.__kwdefaults__
    return copy


class OneLine(logging.Handler):
    """Logs what a client did wrong as one line without a traceback, and not again for a while.

    A stranger's bytes are no error of this program, so a traceback would not help.
    """

    def __init__(self) -> None:
        super().__init__(logging.WARNING)
        self._repeats, self._others = Repeats(REPEAT), Allowance(*OTHERS)

    def emit(self, record: logging.LogRecord) -> None:
        """Log a record of websockets."""
        self.say(record.getMessage(), record.exc_info[1] if record.exc_info else None)

    def of_task(self, loop: Any, context: dict[str, Any]) -> None:
        """Log what an event loop could not handle (`loop.set_exception_handler`)."""
        self.say("a message of a browser was refused", context.get("exception"))

    def say(self, what: str, error: BaseException | None) -> None:
        """Log a sentence with the error's first line, at most every `REPEAT` seconds."""
        if isinstance(error, RuntimeError) and "after shutdown" in str(error):
            return  # the program ends, while a browser is still there
        first = str(error).partition("\n")[0][:200] if error is not None else ""
        why = "" if error is None else f": {type(error).__name__}{first and ': '}{first}"
        line = f"page: {what}{why}"
        if self._repeats.new(line) and self._others.take():
            log.warning("%s", line)


def connection_logger() -> logging.Logger:
    """The logger for the connections of one server; `OneLine` shortens its records."""
    made = logging.Logger("globule.viewer.connections", logging.WARNING)
    made.addHandler(OneLine())
    return made


def quiet_tasks(server: Any) -> None:
    """Log one line, too, for messages that a viser server cannot handle, and none about values of
    browsers and messages to those that have left, of which viser warns."""
    warnings.filterwarnings("ignore", r"(?s)\[viser\] .* does not match annotation |Queued a \w+ on a closed ")
    loop = server._websock_server._background_event_loop
    loop.call_soon_threadsafe(loop.set_exception_handler, OneLine().of_task)


def is_local(host: str) -> bool:
    """Whether a Host header names a loopback address of this machine.

    A name that a foreign name server gives to this address does not count (DNS rebinding).
    """
    parts = HOST.fullmatch(host)
    if not parts or int(parts["port"] or 0) > 65535:
        return False
    if (parts["name"] or "").lower() == "localhost":
        return True
    try:
        address = parts["six"] or parts["name"]
        version = ipaddress.IPv6Address if parts["six"] else ipaddress.IPv4Address
        return version(address).is_loopback
    except ValueError:
        return False


async def silent(server: Any, numbers: list[int], seconds: float) -> list[int]:
    """End the connections that answer no ping, such as those of a network that broke.

    Args:
        server: a `viser.ViserServer`.
        numbers: of the browsers to ask.
        seconds: in which a browser has to answer.

    Returns:
        The numbers of those that did not.
    """
    from websockets.exceptions import ConnectionClosed

    alive = server._websock_server._live_connections

    async def is_silent(number: int) -> bool:
        connection = alive.get(number)
        if connection is None:  # it is about to leave
            return True
        try:
            await asyncio.wait_for(answered(connection), seconds)
            return False
        except (asyncio.TimeoutError, ConnectionClosed):
            connection.transport.abort()
            return True

    async def answered(connection: Any) -> None:
        await (await connection.ping())

    said = await asyncio.gather(*map(is_silent, numbers))
    return list(itertools.compress(numbers, said))


def no_uploads(browser: Any) -> None:
    """Take no files for a browser's own widgets, none of which asks for one."""
    from viser import _messages

    for message in (_messages.FileTransferStartUpload, _messages.FileTransferPart):
        if message in browser._websock_connection._incoming_handlers:
            browser._websock_connection.unregister_handler(message)
