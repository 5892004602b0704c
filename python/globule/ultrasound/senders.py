"""Messages of several OpenIGTLink servers in one stream, and their clocks."""

from __future__ import annotations

import queue
import socket
import threading
import time
from collections import deque
from collections.abc import Iterator
from typing import Any, NamedTuple

_HEADER = 58  # bytes
_MOST_BODY = 2**30
_CONNECT_PAUSE = 0.1  # s between attempts
_MOST_WAITING = 256  # messages between a socket and their use; then the server waits
OTHER_CLOCK = 1.0  # s between two clocks beyond which stamps do not mean the same time
_WINDOW = 10.0  # s of messages whose fastest tells the difference of two clocks
_FIRST = 0.5  # s of messages before the difference is used


class Arrived(NamedTuple):
    """A message, the number of its server, when it came, s, of this machine's clock, and how many
    messages wait behind it."""

    server: int
    message: Any
    when: float
    waiting: int = 0


def arrivals(
    base: Any, places: list[tuple[str, int]], idle: float, wait: float, connections: list[int]
) -> Iterator[Arrived]:
    """Messages of all servers as they come, until the first has been silent or gone for `idle`.

    Servers may start in any order; connections that break are made again. A slow reader slows the
    servers.

    Args:
        base: pyigtl's base class of messages.
        places: host and port of each server.
        idle, wait: s; the first server must answer within `wait`.
        connections: counts the connections to each server.

    Raises:
        ConnectionError: the first server does not answer, or none of another one's messages came.
        ValueError: bytes that are not OpenIGTLink.
    """
    came: queue.Queue[Arrived | Exception | None] = queue.Queue(_MOST_WAITING)
    stop = threading.Event()
    for i, place in enumerate(places):
        reader = _Reader(base, i, place, idle, wait if i == 0 else None, came, stop, connections)
        threading.Thread(target=reader.run, daemon=True).start()
    try:
        while True:
            try:
                item = came.get(timeout=0.2)  # with a limit, so that Ctrl-C comes through
            except queue.Empty:
                continue
            if isinstance(item, Exception):
                raise item
            if item is None:
                return
            yield item._replace(waiting=came.qsize())
    finally:
        stop.set()


class _Reader:
    """Reads one server in a thread."""

    def __init__(
        self, base: Any, number: int, place: tuple[str, int], idle: float, wait: float | None,
        came: queue.Queue[Arrived | Exception | None], stop: threading.Event,
        connections: list[int],
    ):  # fmt: skip
        self.base, self.number, self.place, self.idle, self.wait = base, number, place, idle, wait
        self.came, self.stop, self.connections = came, stop, connections

    def run(self) -> None:
        try:
            self._read_all()
            self._put(None if self.wait is not None else _NOTHING)
        except Exception as error:  # of bytes that are no messages
            self._put(error)

    def _put(self, item: Any) -> None:
        while item is not _NOTHING and not self.stop.is_set():
            try:
                self.came.put(item, timeout=0.2)
                return
            except queue.Full:
                continue

    def _read_all(self) -> None:
        first = self.wait is not None
        deadline = time.monotonic() + self.wait if self.wait is not None else float("inf")
        last: OSError | None = None
        while not self.stop.is_set() and time.monotonic() < deadline:
            try:
                connection = socket.create_connection(self.place, timeout=min(self.idle, 1.0))
            except OSError as error:
                last = error
                time.sleep(_CONNECT_PAUSE)
                continue
            if first and not self.connections[self.number]:
                deadline = time.monotonic() + self.idle
            self.connections[self.number] += 1
            with connection:
                connection.settimeout(0.2)
                while not self.stop.is_set():
                    message = _message(self.base, connection, deadline, self.stop)
                    if message is None:
                        break
                    arrived = time.monotonic()
                    self._put(Arrived(self.number, message, arrived))
                    if first:
                        deadline = time.monotonic() + self.idle
        if first and not self.connections[self.number]:
            host, port = self.place
            raise ConnectionError(f"live: expected a server at igtl://{host}:{port}, got none: {last}")


_NOTHING = object()


def _message(base: Any, connection: socket.socket, deadline: float, stop: threading.Event) -> Any:
    """The next message; None after the connection broke or stayed silent."""
    header = _read(connection, _HEADER, deadline, stop)
    if header is None:
        return None
    try:
        fields = base.parse_header(header)
    except ValueError:  # no text where the type should be
        fields = {"body_size": -1}
    if not 0 <= fields["body_size"] <= _MOST_BODY:
        raise ValueError(f"live: expected an OpenIGTLink message, got {header[:14]!r}")
    body = _read(connection, fields["body_size"], deadline + 5, stop)
    if body is None:
        return None
    message = base.create_message(fields["message_type"])
    if message is None:
        return (fields["message_type"],)  # of a type that does not matter here
    try:
        message.unpack(fields, body)
    except Exception as error:  # the parser fails in many ways
        kind = fields["message_type"]
        raise ValueError(f"live: expected a whole {kind} message, got: {error}") from None
    return message


def _read(connection: socket.socket, n: int, deadline: float, stop: threading.Event) -> bytes | None:
    parts = bytearray()
    while len(parts) < n:
        try:
            part = connection.recv(n - len(parts))
        except TimeoutError:
            if time.monotonic() > deadline or stop.is_set():
                return None
            continue
        except OSError:
            return None
        if not part:
            return None
        parts += part
    return bytes(parts)


class Clocks:
    """The difference of two servers' clocks, from stamps and arrivals.

    A message arrives some time after its stamp; the fastest message of the last ten seconds is
    taken to need no time. If the two clocks then differ by more than a second, the stamps do not
    mean the same time, and those of the second server are moved to the clock of the first. A
    smaller difference counts as delay of the data, and is the task of the temporal offset.

    Attributes:
        difference: s that a stamp of the second server is moved by; 0 for a common clock; None
            while not yet known.
    """

    def __init__(self) -> None:
        self._delays: tuple[deque[tuple[float, float]], ...] = (deque(), deque())
        self._since: float | None = None
        self._apart: bool | None = None
        self.difference: float | None = None

    def saw(self, server: int, stamp: float, when: float) -> None:
        """A message with this stamp came at `when`, both s."""
        delays = self._delays[server]
        delay = when - stamp
        # Sorted from the smallest, which is the oldest: the minimum of a moving window.
        while delays and delays[-1][1] >= delay:
            delays.pop()
        delays.append((when, delay))
        while delays[0][0] < when - _WINDOW:
            delays.popleft()
        if not all(self._delays):
            return
        if self._since is None:
            self._since = when
        difference = self._delays[1][0][1] - self._delays[0][0][1]
        if self._apart is None and abs(difference) > OTHER_CLOCK and when < self._since + _FIRST:
            return
        if self._apart is None:
            self._apart = abs(difference) > OTHER_CLOCK
        self.difference = difference if self._apart else 0.0
