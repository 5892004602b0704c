"""Access control of the page.

On a loopback address every program of this machine may open the page. On any other address, and
behind a reverse proxy, a client needs a token: one token steers, another only looks (`roles.py`).
The guard checks each HTTP request and each websocket handshake before the server answers. The
address of a page says its role, since the tabs of one browser share their cookies: the page below
`LOOK_PATH` and its websocket look, all others steer.
"""

from __future__ import annotations

import hashlib
import hmac
import ipaddress
import logging
import re
from typing import Any
from urllib.parse import parse_qs, urlsplit

from .log import Repeats, log
from .roles import LOOK, STEER, Allowance

REPEAT = 5.0  # s before the same message is logged again
OTHERS = 10, REPEAT  # messages about connections at once, and s for each more
LOOK_PATH = "/look"
LOCAL = ("127.0.0.1", "localhost", "::1")  # addresses to listen on without a token
# A host of a header: a name, or an address of version 6 in brackets, and a port.
HOST = re.compile(r"(?:\[(?P<six>[0-9A-Fa-f:.]+)\]|(?P<name>[0-9A-Za-z.-]+))(?::(?P<port>[0-9]{1,5}))?")


class Guard:
    """The access control of one server.

    Args:
        token: the word that a client must send to steer; None: everyone on this machine steers.
        look_token: the word of a client that only looks.
    """

    def __init__(self, token: str | None, look_token: str | None = None):
        self.tokens = {STEER: token, LOOK: look_token} if token is not None else {}

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
        if type(error).__name__ == "ConnectionClosedError":
            return  # a browser has left, or opens connections that it does not use
        if isinstance(error, RuntimeError) and "after shutdown" in str(error):
            return  # the program ends, while a browser is still there
        first = str(error).partition("\n")[0][:200] if error is not None else ""
        why = "" if error is None else f": {type(error).__name__}{first and ': '}{first}"
        line = f"page: {what}{why}"
        if self._repeats.new(line) and self._others.take():
            log.warning("%s", line)


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
