"""A browser's connection to the viewer, by a program."""

import io
import json
import secrets
import threading
from contextlib import suppress
from typing import Any

import numpy as np
from PIL import Image
from waiting import until
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

SIZE = (120, 90)


def hello(size: Any = SIZE, tab: str = "", dark: bool = False) -> str:
    """The first message of a page."""
    return json.dumps({"do": "hello", "value": {"size": size, "tab": tab or secrets.token_hex(8), "dark": dark}})


def link(address: str) -> Any:
    """The connection of a page."""
    begin, _, query = address.partition("?")
    # without pings: on a busy machine an answer may take longer than it would wait
    return connect(f"{begin.replace('http', 'ws', 1)}globule/desk?{query}", max_size=None, ping_interval=None)


class Program:
    """A page, by a program.

    Args:
        address: of the page, as `viewer.address` says it.
        answers: say that an image has arrived, as a page does.
        tab: its name for itself.

    Attributes:
        controls: what is known of each control, by labels.
        commands: names.
        images: JPEGs that have come.
        kept: all messages that have come.
        files: that were downloaded, by name.
        camera: that it has; it follows the server's moves.
        model: the last one.
    """

    def __init__(self, address: str, answers: bool = True, tab: str = ""):
        self.answers = answers
        self.controls: dict[str, dict] = {}
        self.commands: list[str] = []
        self.camera: dict[str, Any] = {}
        self.images: list[bytes] = []
        self.files: dict[str, bytes] = {}
        self.kept: list[dict] = []
        self.model: dict[str, Any] = {}
        self._messages: list[dict] = []
        self._moves = 0
        self._file: list[Any] = []  # that comes: name, size, bytes
        self.connection = link(address)
        self.connection.send(hello(tab=tab))
        self.closed = ""  # why the connection has ended
        threading.Thread(target=self._read, daemon=True).start()

    def _read(self) -> None:
        try:
            for data in self.connection:
                if isinstance(data, bytes):
                    self._came(data[:4], data[4:])
                else:
                    self._take(json.loads(data))
            self.closed = "the connection was closed"
        except ConnectionClosed as error:
            self.closed = str(error)

    def _came(self, number: bytes, data: bytes) -> None:
        if any(number):
            self.images.append(data)
            if self.answers:
                with suppress(ConnectionClosed):
                    self.connection.send(number)
            return
        self._file[2] += data
        if len(self._file[2]) == self._file[1]:
            self.files[self._file[0]] = self._file[2]

    def _take(self, message: dict) -> None:
        if "camera" in message:
            self.camera, self._moves = message["camera"], message["moves"]
        elif "file" in message:
            self._file = [message["file"]["name"], message["file"]["size"], b""]
        elif "title" in message:
            self.model = message
        for control in message.get("controls", ()):
            self.controls[control["label"] or control.get("content", "")] = control
        self.commands = [name for name, *_ in message.get("commands", ())] or self.commands
        self.kept.append(message)
        self._messages.append(message)

    def ask(self, name: str, value: Any = None) -> None:
        """Ask for an action."""
        self.connection.send(json.dumps({"do": name, "value": value}))

    def look(self, **changes: Any) -> None:
        """Have another camera; changes: eye, look_at, up, fov, height."""
        until(lambda: self.camera, "for the first camera")
        self.camera = self.camera | changes
        self.ask("look", self.camera | {"moves": self._moves})

    def set(self, label: str, value: Any = True) -> None:
        """Use the control with a label; for a button, the value is True."""
        self.ask("control", [until(lambda: self.controls.get(label), f"for {label}")["id"], value])

    def command(self, label: str) -> None:
        """Give a command, as its key does."""
        until(lambda: label in self.commands, f"for {label}")
        self.ask("command", label)

    def heard(self, wanted: Any) -> dict:
        """The next message that is as wanted, or has a text in it."""
        if isinstance(wanted, str):
            return self.heard(lambda message: wanted in str(message))

        def found() -> dict | None:
            closed = self.closed  # before the last messages are looked at
            while self._messages:
                message = self._messages.pop(0)
                if wanted(message):
                    return message
            if closed:
                raise AssertionError(f"waited for a message in vain: {closed}")
            return None

        return until(found, "for a message")

    def picture(self, data: bytes | None = None) -> np.ndarray:
        with Image.open(io.BytesIO(data or self.images[-1])) as image:
            return np.asarray(image.convert("RGB"))

    def close(self) -> None:
        self.connection.close()
