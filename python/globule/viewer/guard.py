"""Access control of the page.

On a loopback address every program of this machine may open the page. On any other address, and
behind a reverse proxy, a client needs a token: one token steers, another only looks (`roles.py`).
The guard checks each HTTP request and each websocket handshake before the server answers.

viser has no such check and opens its socket in a thread of its own. `Guard.server` therefore makes
viser's server from copies of two of viser's functions, in which the name of the function that opens
the socket stands for `Guard.serve`. Nothing of viser and websockets is replaced for anyone else.
pyproject.toml pins the versions of viser for which the tests cover this; `Guard.started` tells
whether the socket was opened through the guard.
"""

from __future__ import annotations

import asyncio
import gzip
import hashlib
import hmac
import html
import http
import ipaddress
import logging
import re
import secrets
import time
from types import FunctionType
from typing import Any
from urllib.parse import parse_qs, urlsplit

from . import desk
from .log import log
from .roles import LOOK, REFUSED, STEER, VISITOR, Allowance, Visitor, visitor

REPEAT = 5.0  # s before the same message is logged again
MOST_MESSAGE = 1024 * 1024  # bytes of one message from a client
CLOSING = 1.0  # s that a client may take to close its side
# Messages of one connection at once, and s for each more: a mouse sends a tenth of that. What comes
# faster waits in the socket, and with it the sender.
FLOOD = 1000, 1 / 500
# The page may load from this server and connect to this server, and to nothing else. Of the scripts
# in its text, those run that carry the server's nonce; viser needs eval.
POLICY = (
    "default-src 'self'; script-src 'self' 'nonce-{nonce}' 'unsafe-eval' blob:; "
    "style-src 'self' 'unsafe-inline'; img-src 'self' data: blob:; font-src 'self' data:; "
    "connect-src 'self' data: blob:; worker-src 'self' blob:; frame-src 'none'; "
    "object-src 'none'; frame-ancestors 'self'; form-action 'none'; base-uri 'self'"
)
# A host of a header: a name, or an address of version 6 in brackets, and a port.
HOST = re.compile(
    r"(?:\[(?P<six>[0-9A-Fa-f:.]+)\]|(?P<name>[0-9A-Za-z.-]+))(?::(?P<port>[0-9]{1,5}))?"
)
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
        self.token, self.title, self.look_token = token, title, look_token
        self.started = False
        self.desk: Any = None
        self.roles: Any = None
        # Viewers on one host share its cookies, whatever their ports.
        digest = hashlib.sha256((token or "").encode()).hexdigest()
        self._cookie_name = f"globule-{digest[:12]}"
        nonce = secrets.token_urlsafe(18)
        self._policy, self._nonce = POLICY.format(nonce=nonce), nonce.encode()
        self._pages: dict[bytes, bytes] = {}  # viser's page to ours

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
        if self.token is None:
            return None if is_local(host) else "expected a loopback address of this machine"
        if self.role(path, headers) is None:
            return "expected the token in the address: ?token=…"
        return None

    def role(self, path: str, headers: Any) -> str | None:
        """The role that the token of the address, else of the cookie, gives; None: none."""
        if self.token is None:
            return STEER
        for word in (*parse_qs(urlsplit(path).query).get("token", []), self._cookie(headers)):
            for token, role in ((self.token, STEER), (self.look_token, LOOK)):
                if token and hmac.compare_digest(token.encode(), word.encode()):
                    return role
        return None

    def cookie(self, role: str, headers: Any) -> str:
        """The cookie that carries the token of a role in the page's own requests."""
        token = self.token if role == STEER else self.look_token
        secure = "; Secure" if "https" in headers.get_all("X-Forwarded-Proto") else ""
        return f"{self._cookie_name}={token}; Path=/; HttpOnly; SameSite=Strict{secure}"

    def _cookie(self, headers: Any) -> str:
        for line in headers.get_all("Cookie"):
            for part in line.split(";"):
                name, _, value = part.strip().partition("=")
                if name == self._cookie_name:
                    return value
        return ""

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

    def serve(self, handler: Any, host: str, port: int, **options: Any) -> Any:
        """`websockets.asyncio.server.serve`, with this guard before every answer."""
        from websockets.asyncio.server import ServerConnection, serve

        class Slowed(ServerConnection):
            """Hears no more messages than people send."""

            def __init__(own, *given: Any, **more: Any):
                super().__init__(*given, **more)
                own.allowance = Allowance(*FLOOD)

            async def recv(own, *given: Any, **more: Any) -> Any:
                while not own.allowance.take():
                    await asyncio.sleep(FLOOD[1])
                return await super().recv(*given, **more)

        inner = options.pop("process_request")

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
            if request.path.partition("?")[0] == desk.PATH:
                return None  # a websocket, or refused by websockets
            found = desk.file(request.path)
            response = inner(connection, request) if found is None else answer(*found)
            if response is not None:
                self._finish(response)
                response.headers["Content-Security-Policy"] = self._policy
                response.headers["Referrer-Policy"] = "no-referrer"
                response.headers["X-Content-Type-Options"] = "nosniff"
                role = self.role(request.path, request.headers)
                if self.token is not None and role is not None:
                    response.headers["Set-Cookie"] = self.cookie(role, request.headers)
            return response

        async def route(connection: Any) -> None:
            request = connection.request
            VISITOR.set(Visitor(self.role(request.path, request.headers) or REFUSED))
            if request.path.partition("?")[0] != desk.PATH:
                await handler(connection)
            elif self.desk is not None:
                await self.desk.serve(connection)

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

        opening = Renamed(
            websockets,
            asyncio=Renamed(
                websockets.asyncio, server=Renamed(websockets.asyncio.server, serve=self.serve)
            ),
        )

        class Socket(infra.WebsockServer):
            _background_worker = with_names(
                infra.WebsockServer._background_worker, _infra, websockets=opening
            )

            async def _handle_incoming_message(own, client_id: Any, message: Any) -> None:
                who = visitor()
                if self.roles is None or who.role == REFUSED:
                    return
                if self.roles.may(who, message):
                    await super()._handle_incoming_message(client_id, message)
                else:
                    self.roles.refuse(who, client_id, message)

        class Server(viser.ViserServer):
            __init__ = with_names(
                viser.ViserServer.__init__, _viser, infra=Renamed(infra, WebsockServer=Socket)
            )

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
        function.__code__,
        {**vars(module), **names},
        function.__name__,
        function.__defaults__,
        function.__closure__,
    )
    copy.__kwdefaults__ = function.__kwdefaults__
    return copy


class OneLine(logging.Handler):
    """Logs what a client did wrong as one line without a traceback, and not again for a while.

    A stranger's bytes are no error of this program, so a traceback would not help.
    """

    def __init__(self) -> None:
        super().__init__(logging.WARNING)
        self._said: dict[str, float] = {}

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
        line, now = f"page: {what}{why}", time.monotonic()
        if self._said.get(line, -REPEAT) <= now - REPEAT:
            self._said = {line: now}
            log.warning("%s", line)


def connection_logger() -> logging.Logger:
    """The logger for the connections of one server; `OneLine` shortens its records."""
    made = logging.Logger("globule.viewer.connections", logging.WARNING)
    made.addHandler(OneLine())
    return made


def quiet_tasks(server: Any) -> None:
    """Log one line, too, for messages that a viser server cannot handle."""
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


def no_uploads(browser: Any) -> None:
    """Take no files for a browser's own widgets, none of which asks for one."""
    from viser import _messages

    for message in (_messages.FileTransferStartUpload, _messages.FileTransferPart):
        if message in browser._websock_connection._incoming_handlers:
            browser._websock_connection.unregister_handler(message)


def limit_messages(server: Any, most_bytes: int) -> None:
    """Refuse large uploads and requests to share the page.

    Any browser could ask viser to share the page through viser's own server on the internet.

    Args:
        server: a `viser.ViserServer`.
        most_bytes: of one upload.
    """
    from viser import _messages

    gui, websocket = server.gui, server._websock_server
    for message in (_messages.ShareUrlRequest, _messages.ShareUrlDisconnect):
        websocket.unregister_handler(message)
    begin = gui._handle_file_transfer_start
    websocket.unregister_handler(_messages.FileTransferStartUpload, begin)

    def check(client_id: int, message: Any) -> None:
        waiting = len(gui._current_file_upload_states)
        if message.size_bytes <= most_bytes and message.part_count <= 1 and waiting < 8:
            begin(client_id, message)

    websocket.register_handler(_messages.FileTransferStartUpload, check)
