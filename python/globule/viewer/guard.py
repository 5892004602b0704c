"""Who may see the page. On this machine's own address everybody on it; on others who knows the
token. Checked before any file or message goes out, at the HTTP and at the websocket's level.

viser has no such check, and opens its server in a thread of its own. While that starts, the
function with which it opens the socket is replaced by one that adds ours (viser is pinned to the
versions for which this is tested); `started` says whether that has happened.
"""

from __future__ import annotations

import gzip
import hmac
import html
import http
import ipaddress
import logging
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any
from urllib.parse import parse_qs, urlsplit

REPEAT = 5.0  # s until the same line is said again
MOST_MESSAGE = 1024 * 1024  # bytes that a client may send at once
# The page may load and connect to nothing but this server.
POLICY = (
    "default-src 'self'; script-src 'self' 'unsafe-inline' 'unsafe-eval' blob:; "
    "style-src 'self' 'unsafe-inline'; img-src 'self' data: blob:; font-src 'self' data:; "
    "connect-src 'self' data: blob:; worker-src 'self' blob:; frame-ancestors 'self'; "
    "form-action 'none'; base-uri 'self'"
)


class Guard:
    """token: what a client must know, or None on this machine's own address. title: of the page,
    in the browser's tab."""

    def __init__(self, token: str | None, title: str = "globule"):
        self.token, self.title = token, title
        self.started = False
        self._titled: dict[bytes, bytes] = {}  # the page by viser's own

    def refusal(self, path: str, headers: Any) -> str | None:
        """Why a request is not answered, if it is not."""
        host, origin = headers.get("Host", ""), headers.get("Origin")
        if origin is not None and urlsplit(origin).netloc != host:
            return "expected a page of this server, got another"
        if self.token is None:
            return None if is_local(host) else "expected an address of this machine"
        given = [*parse_qs(urlsplit(path).query).get("token", []), self._cookie(headers)]
        known = any(hmac.compare_digest(self.token.encode(), word.encode()) for word in given)
        return None if known else "expected the token in the address: ?token=…"

    def cookie(self) -> str:
        """What lets the page's own requests in."""
        return f"globule={self.token}; Path=/; HttpOnly; SameSite=Strict"

    def _cookie(self, headers: Any) -> str:
        for line in headers.get_all("Cookie"):
            for part in line.split(";"):
                name, _, value = part.strip().partition("=")
                if name == "globule":
                    return value
        return ""

    def _give_title(self, response: Any) -> None:
        """The page that viser has is called Viser."""
        if not response.headers.get("Content-Type", "").startswith("text/html"):
            return
        body = response.body
        if body not in self._titled:
            packed = response.headers.get("Content-Encoding") == "gzip"
            page = gzip.decompress(body) if packed else body
            name = f"<title>{html.escape(self.title)}</title>".encode()
            page = page.replace(b"<title>Viser</title>", name, 1)
            self._titled[body] = gzip.compress(page) if packed else page
        response.body = self._titled[body]
        del response.headers["Content-Length"]
        response.headers["Content-Length"] = str(len(response.body))

    @contextmanager
    def watching(self) -> Iterator[None]:
        """Servers that viser opens in this block are guarded."""
        import websockets.asyncio.server as module

        serve = module.serve

        def guarded(handler: Any, host: str, port: int, **options: Any) -> Any:
            inner = options.pop("process_request")

            def check(connection: Any, request: Any) -> Any:
                why = self.refusal(request.path, request.headers)
                if why is not None:
                    return connection.respond(http.HTTPStatus.FORBIDDEN, f"globule: {why}\n")
                response = inner(connection, request)
                if response is not None:
                    self._give_title(response)
                    response.headers["Content-Security-Policy"] = POLICY
                    response.headers["Referrer-Policy"] = "no-referrer"
                    response.headers["X-Content-Type-Options"] = "nosniff"
                    if self.token is not None:
                        response.headers["Set-Cookie"] = self.cookie()
                return response

            options["max_size"] = MOST_MESSAGE
            options["logger"] = one_line_logger()
            self.started = True
            return serve(handler, host, port, process_request=check, **options)

        module.serve = guarded
        try:
            yield
        finally:
            module.serve = serve


class OneLine(logging.Handler):
    """What went wrong as one line in the terminal, the same not again for a while: what a stranger
    sends is no mistake of ours that a traceback would help to find."""

    def __init__(self) -> None:
        super().__init__(logging.WARNING)
        self._said: dict[str, float] = {}

    def emit(self, record: logging.LogRecord) -> None:
        self.say(record.getMessage(), record.exc_info[1] if record.exc_info else None)

    def of_task(self, loop: Any, context: dict[str, Any]) -> None:
        """An event loop's exception handler."""
        self.say("a message of a browser was refused", context.get("exception"))

    def say(self, what: str, error: BaseException | None) -> None:
        first = str(error).partition("\n")[0][:200] if error is not None else ""
        why = "" if error is None else f": {type(error).__name__}{first and ': '}{first}"
        line, now = f"globule: page: {what}{why}", time.monotonic()
        if self._said.get(line, -REPEAT) <= now - REPEAT:
            self._said = {line: now}
            print(line, file=sys.stderr)


def one_line_logger() -> logging.Logger:
    """For the connections of one server."""
    logger = logging.Logger("globule.viewer", logging.WARNING)
    logger.addHandler(OneLine())
    return logger


def quiet_tasks(server: Any) -> None:
    """Have one line, too, for messages that viser cannot make anything of."""
    loop = server._websock_server._background_event_loop
    loop.call_soon_threadsafe(loop.set_exception_handler, OneLine().of_task)


def is_local(host: str) -> bool:
    """Whether a Host header names this machine: a name that somebody else's server gives to our
    address does not (DNS rebinding)."""
    name = urlsplit(f"//{host}").hostname or ""
    if name == "localhost":
        return True
    try:
        return ipaddress.ip_address(name).is_loopback
    except ValueError:
        return False


def limit_messages(server: Any, most_bytes: int) -> None:
    """Refuse uploads above a size, and the request to share the page through viser's own server on
    the internet, which any browser could send."""
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
