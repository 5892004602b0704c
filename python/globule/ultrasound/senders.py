"""Messages of several OpenIGTLink servers in one stream, and their clocks."""

from __future__ import annotations

import queue
import re
import socket
import threading
import time
from collections import deque
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

from .. import _core
from .._base.arrays import address

_HEADER = 58  # bytes
_MOST_BODY = 2**30
# Version, and a type of 12 bytes: letters, then zeros.
_TYPES = b"|".join(b"[A-Z][A-Z0-9_]{%d}\\0{%d}" % (n, 11 - n) for n in range(12))
_HEADERS = re.compile(b"\\0[\\1-\\3](?:" + _TYPES + b")")
_CONNECT_PAUSE = 0.1  # s between attempts
_MOST_WAITING = 256  # messages between a socket and their use; then the server waits
OTHER_CLOCK = 1.0  # s between two clocks beyond which stamps do not mean the same time
_WINDOW = 10.0  # s of messages whose fastest tells the difference of two clocks
_FIRST = 0.5  # s of messages before the difference is used


class Arrived(NamedTuple):
    """A message, or what is `Broken`; the number of its server, when it came, s, of this machine's clock, and how many
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


class Broken(NamedTuple):
    """What stood in the place of a message, in words, and of an image whose header is whole its time stamp, s."""

    what: str
    image_time: float | None = None


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
                stream = _Stream(self.base, connection, self.stop)
                while not self.stop.is_set():
                    message = stream.message(deadline)
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


class _Stream:
    """Messages of one connection. Bytes that are no message are skipped up to the next header."""

    def __init__(self, base: Any, connection: socket.socket, stop: threading.Event):
        self.base, self.connection, self.stop = base, connection, stop
        self._bytes = bytearray()
        self._checks = False  # whether the sender's checksums were right once
        self._lost = False  # whether bytes were skipped since the last message

    def message(self, deadline: float) -> Any:
        """The next message, or what is `Broken`; None after the connection broke or stayed silent."""
        while True:
            if not self._fill(_HEADER, deadline):
                rest, self._bytes = self._bytes, bytearray()
                return Broken("a message that was cut off") if rest and not self._lost else None
            header = bytes(self._bytes[:_HEADER])
            size = int.from_bytes(header[42:50], "big")
            named = b"\0" not in header[14:34].rstrip(b"\0")
            if not (_HEADERS.match(header) and named and size <= _MOST_BODY):
                found = self._skip(header)
                if found is not None:
                    return found
                continue
            kind = header[2:14].rstrip(b"\0").decode()
            if not self._fill(_HEADER + size, deadline + 5):
                # A message that was cut off, or a wrong size: others may stand behind its header.
                return self._broken(f"{kind} that was cut off", header)
            body = bytes(memoryview(self._bytes)[_HEADER : _HEADER + size])
            problem, message = self._unpacked(kind, header, body)
            if problem:
                return self._broken(problem, header)
            del self._bytes[: _HEADER + size]
            self._lost = False
            return message

    def _unpacked(self, kind: str, header: bytes, body: bytes) -> tuple[str, Any]:
        if body:
            check = _core.crc64(address(np.frombuffer(body, np.uint8)), len(body), 0)
            right = int.from_bytes(header[50:58], "big") == check
            self._checks |= right
        if body and self._checks and not right:
            return f"{kind} with a wrong checksum", None
        message = self.base.create_message(kind)
        if message is None:
            return "", (kind,)  # of a type that does not matter here
        try:
            message.unpack(self.base.parse_header(header), body)
        except Exception:  # the parser fails in many ways
            return f"{kind} whose content does not fit its header", None
        return "", message

    def _broken(self, what: str, header: bytes) -> Broken:
        """Drop a byte, so that the search goes on for the next header."""
        del self._bytes[:1]
        self._lost = True
        is_image = what.startswith("IMAGE ")
        return Broken(what, int.from_bytes(header[34:42], "big") / 2**32 if is_image else None)

    def _skip(self, header: bytes) -> Broken | None:
        """Drop bytes up to what looks like a header; once for a stretch, say so."""
        found = _HEADERS.search(self._bytes, 1)
        del self._bytes[: found.start() if found else max(1, len(self._bytes) - _HEADER + 1)]
        first, self._lost = not self._lost, True
        return Broken(f"bytes that are no OpenIGTLink message, {header[:14]!r}") if first else None

    def _fill(self, n: int, deadline: float) -> bool:
        """Whether n bytes are there."""
        while len(self._bytes) < n:
            try:
                part = self.connection.recv(max(n - len(self._bytes), _HEADER))
            except TimeoutError:
                if time.monotonic() > deadline or self.stop.is_set():
                    return False
                continue
            except OSError:
                return False
            if not part:
                return False
            self._bytes += part
        return True


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
