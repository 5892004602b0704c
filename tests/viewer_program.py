"""A browser's connections to the viewer's page, by a program."""

import io
import json
import threading
from contextlib import suppress
from typing import Any

import msgspec
import numpy as np
import viser
import zstandard
from PIL import Image
from waiting import until
from websockets.exceptions import ConnectionClosed, WebSocketException
from websockets.sync.client import connect

CAMERA = {
    "type": "ViewerCameraMessage", "wxyz": [1.0, 0.0, 0.0, 0.0], "fov": 1.0,
    "position": [0.0, 0.0, 3.0], "look_at": [0.0] * 3, "up_direction": [0.0, 1.0, 0.0], "near": 0.1,
    "far": 9.0, "image_height": 90, "image_width": 120,
}  # fmt: skip
MOVES = {  # of the camera, by the server: its part, and the field
    "SetCameraPositionMessage": ("position", "position"),
    "SetCameraUpDirectionMessage": ("up_direction", "position"),
    "SetCameraLookAtMessage": ("look_at", "look_at"),
    "SetCameraFovMessage": ("fov", "fov"),
}


class Program:
    """A browser's two connections, by a program: of viser's page, and of our script.

    Args:
        address: of the page, as `viewer.address` says it.
        answers: say that an image has arrived, as a page does.
        script: connect our script, too.

    Attributes:
        controls: what is known of each control, by labels.
        commands: names.
        images: JPEGs that have come.
        kept: all messages that have come.
        desk: our script's connection, or None.
        files: that were downloaded, by name.
        camera: that it has; it follows the server's moves.
        word: with which its script names itself; "" before it came.
    """

    def __init__(self, address: str, answers: bool = True, script: bool = True):
        self.answers, self.script = answers, script
        self.controls: dict[str, dict] = {}
        self.commands: list[str] = []
        self.desk: Any = None
        self._address = address
        self.camera = dict(CAMERA)
        self.images: list[bytes] = []
        self.files: dict[str, bytes] = {}
        self.word = ""
        self.kept: list[dict] = []
        self._messages: list[dict] = []
        self._names: dict[str, str] = {}  # of files that come
        self.connection = connect(
            address.replace("http", "ws", 1),
            subprotocols=[f"viser-v{viser.__version__}"],
            max_size=None,
            ping_interval=None,  # on a busy machine an answer may take longer than it would wait
        )
        self.closed = ""  # why the connection has ended
        threading.Thread(target=self._read, daemon=True).start()
        self.look()

    def _read(self) -> None:
        try:
            for data in self.connection:
                packed = data[16 : 16 + int.from_bytes(data[8:16], "little")]  # as viser has it
                window = zstandard.ZstdDecompressor().decompress(packed)
                before = dict(self.camera)
                for message in msgspec.msgpack.decode(window)["messages"]:
                    self._take(message)
                if self.camera != before:
                    self.look()
            self.closed = "the connection was closed"
        except ConnectionClosed as error:
            self.closed = str(error)

    def _take(self, message: dict) -> None:
        kind = message["type"]
        if kind in MOVES:
            self.camera[MOVES[kind][0]] = message[MOVES[kind][1]]
        elif kind == "RunJavascriptMessage" and 'globuleWord="' in message["source"]:
            self.word = message["source"].split('"')[1]
            if self.script:
                threading.Thread(target=self._talk, daemon=True).start()
        elif kind == "FileTransferStartDownload":
            self._names[message["transfer_uuid"]] = message["filename"]
        elif kind == "FileTransferPart":
            name = self._names[message["transfer_uuid"]]
            self.files[name] = self.files.get(name, b"") + message["content"]
        self._messages.append(message)
        self.kept.append(message)

    def _talk(self) -> None:
        """What the page's script does."""
        begin, _, query = self._address.partition("?")
        path = f"{begin.replace('http', 'ws', 1)}globule/desk?word={self.word}&{query}"
        with suppress(WebSocketException, OSError, EOFError):
            self.desk = connect(path, max_size=None, ping_interval=None)
            for data in self.desk:
                if isinstance(data, bytes):
                    self.images.append(data[4:])
                    if self.answers:
                        self.desk.send(data[:4])
                    continue
                message = json.loads(data)
                for control in message.get("controls", ()):
                    self.controls[control["label"] or control.get("content", "")] = control
                self.commands = [name for name, *_ in message.get("commands", ())] or self.commands
                self.kept.append({"type": "desk", **message})
                self._messages.append({"type": "desk", **message})

    def ask(self, name: str, value: Any = None) -> None:
        """Ask for an action, as our script does."""
        until(lambda: self.desk, "for the script's connection").send(json.dumps({"do": name, "value": value}))

    def say(self, *messages: dict) -> None:
        for message in messages:
            self.connection.send(msgspec.msgpack.encode(message))

    def look(self, **changes: Any) -> None:
        """Have another camera; changes: of `CAMERA`, page units and pixels."""
        self.camera |= changes
        self.say(self.camera)

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
        if self.desk is not None:
            self.desk.close()
