"""A viewer's client without a browser: images through a socket to a thread that answers each."""

from __future__ import annotations

import contextlib
import socket
import struct
import threading
from collections.abc import Callable

from globule.viewer.engine import Client

HEAD = struct.Struct("<II")  # number of the picture, bytes


class SocketSink:
    """Pictures through a socket. Whoever reads them answers with each one's number."""

    def __init__(self, through: Callable[[int], int] = lambda port: port):
        listening = socket.create_server(("127.0.0.1", 0))
        port = through(listening.getsockname()[1])
        self.theirs = socket.create_connection(("127.0.0.1", port))
        self.ours, _ = listening.accept()
        for end in (self.ours, self.theirs):
            end.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        listening.close()
        self.client: Client | None = None
        for work in (self._answer, self._listen):
            threading.Thread(target=work, daemon=True).start()

    def send(self, number: int, data: bytes, plan: object) -> None:
        try:
            self.ours.sendall(HEAD.pack(number, len(data)) + data)
        except OSError as error:  # closed by this end already
            raise ConnectionError(str(error)) from error

    def error(self, message: str) -> None:
        raise SystemExit(message)

    def _answer(self) -> None:
        """The other end: takes each picture in and says so."""
        with self.theirs:
            while head := _read(self.theirs, HEAD.size):
                number, size = HEAD.unpack(head)
                if _read(self.theirs, size) is None:
                    return
                try:
                    self.theirs.sendall(struct.pack("<I", number))
                except OSError:  # the run has ended
                    return

    def _listen(self) -> None:
        while answer := _read(self.ours, 4):
            self.client.acknowledge(struct.unpack("<I", answer)[0])

    def close(self) -> None:
        for end in (self.ours, self.theirs):
            with contextlib.suppress(OSError):  # closed already
                end.shutdown(socket.SHUT_RDWR)
            end.close()


def _read(end: socket.socket, n: int) -> bytes | None:
    data = bytearray()
    while len(data) < n:
        try:
            part = end.recv(n - len(data))
        except OSError:
            return None
        if not part:
            return None
        data += part
    return bytes(data)
