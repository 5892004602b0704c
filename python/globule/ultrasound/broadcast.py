"""An OpenIGTLink server that sends the newest message of each device to all clients.

A client may connect and leave at any time; a new client first gets the newest message of every
device. A client that reads slowly gets fewer messages, never older ones, and holds up nobody.
"""

from __future__ import annotations

import contextlib
import socket
import threading
import time
from collections import Counter

from ..formats.sweeps.messages import Packed

_STALLED = 30.0  # s without a byte taken, after which a client is let go
_PIECE = 1 << 16


class Broadcaster:
    """Sends messages to every connected client.

    Args:
        host: address to listen at.
        port: 0 takes a free port, which `port` then names.

    Attributes:
        port: of the server.
        sent: messages sent over all clients, by device.
        skipped: messages that a newer message of the device replaced before a client took them.
        connections: clients that have connected.

    Raises OSError if the port is taken.
    """

    def __init__(self, host: str = "127.0.0.1", port: int = 0):
        self._listener = socket.create_server((host, port))
        self.host, self.port = host, int(self._listener.getsockname()[1])
        self.sent: Counter[str] = Counter()
        self.skipped: Counter[str] = Counter()
        self.connections = 0
        self._lock = threading.Condition()
        self._clients: list[_Client] = []
        self._newest: dict[str, Packed] = {}
        self._closed = False
        threading.Thread(target=self._accept, daemon=True).start()

    @property
    def n_clients(self) -> int:
        """Clients that are connected now."""
        with self._lock:
            return len(self._clients)

    def send(self, message: Packed) -> None:
        """Send a message to all clients, instead of an older one of its device that still waits."""
        with self._lock:
            self._newest[message.name] = message
            for client in self._clients:
                self.skipped[message.name] += message.name in client.waiting
                client.waiting[message.name] = message
            self._lock.notify_all()

    def close(self, patience: float = 2.0) -> None:
        """Stop, once the clients have all that waits for them, or after `patience` seconds."""
        deadline = time.monotonic() + patience
        with self._lock:
            while any(client.busy for client in self._clients) and time.monotonic() < deadline:
                self._lock.wait(0.05)
            self._closed = True
            self._lock.notify_all()
            clients = list(self._clients)
        # A thread that waits in accept returns only after a shutdown.
        with contextlib.suppress(OSError):
            self._listener.shutdown(socket.SHUT_RDWR)
        self._listener.close()
        for client in clients:
            client.hang_up()

    def _accept(self) -> None:
        while True:
            try:
                connection, _ = self._listener.accept()
            except OSError:  # closed
                return
            client = _Client(connection, dict(self._newest))
            with self._lock:
                if self._closed:
                    client.hang_up()
                    return
                client.waiting = dict(self._newest)
                self._clients.append(client)
                self.connections += 1
            threading.Thread(target=self._serve, args=(client,), daemon=True).start()
            threading.Thread(target=self._listen, args=(client,), daemon=True).start()

    def _serve(self, client: _Client) -> None:
        while True:
            with self._lock:
                client.sending = False
                self._lock.notify_all()
                while not client.waiting and not client.gone and not self._closed:
                    self._lock.wait()
                if client.gone or self._closed:
                    break
                # The smallest first: a slice does not wait for a volume.
                name = min(client.waiting, key=lambda name: client.waiting[name].n_bytes)
                message = client.waiting.pop(name)
                client.sending = True
            try:
                for part in message.parts:
                    client.connection.sendall(part)
            except OSError:
                break
            with self._lock:
                self.sent[name] += 1
        self._drop(client)

    def _listen(self, client: _Client) -> None:
        """Take what a client sends, so that it does not wait, and notice that it leaves."""
        while True:
            try:
                if not client.connection.recv(_PIECE):
                    break
            except TimeoutError:
                continue
            except OSError:
                break
        self._drop(client)

    def _drop(self, client: _Client) -> None:
        client.hang_up()
        with self._lock:
            if client in self._clients:
                self._clients.remove(client)
            self._lock.notify_all()


class _Client:
    """A connection, and the newest message of each device that it has not got."""

    def __init__(self, connection: socket.socket, waiting: dict[str, Packed]):
        self.connection, self.waiting = connection, waiting
        self.sending = self.gone = False
        connection.settimeout(_STALLED)
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)

    @property
    def busy(self) -> bool:
        return not self.gone and (self.sending or bool(self.waiting))

    def hang_up(self) -> None:
        self.gone = True
        with contextlib.suppress(OSError):
            self.connection.shutdown(socket.SHUT_RDWR)
        with contextlib.suppress(OSError):
            self.connection.close()
