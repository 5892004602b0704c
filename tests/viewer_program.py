"""A browser's connection to the viewer's page, by a program."""

from __future__ import annotations

from collections import deque

import msgspec
import viser
import zstandard
from waiting import PATIENCE
from websockets.sync.client import connect

CAMERA = {
    "type": "ViewerCameraMessage",
    "wxyz": [1.0, 0.0, 0.0, 0.0],
    "fov": 1.0,
    "position": [0.0, 0.0, 3.0],
    "look_at": [0.0] * 3,
    "up_direction": [0.0, 1.0, 0.0],
    "near": 0.1,
    "far": 9.0,
    "image_height": 90,
    "image_width": 120,
}


class Program:
    """A browser's connection, by a program."""

    def __init__(self, viewer, token):
        address = f"ws://127.0.0.1:{viewer.port}/?token={token}"
        protocol = f"viser-v{viser.__version__}"
        self.connection = connect(address, subprotocols=[protocol], max_size=None)
        self._left: deque = deque()  # messages that nobody has looked at
        self.say(CAMERA)

    def say(self, *messages):
        for message in messages:
            self.connection.send(msgspec.msgpack.encode(message))

    def heard(self, wanted):
        """The next message that is as wanted."""
        while True:
            while self._left:
                message = self._left.popleft()
                if wanted(message):
                    return message
            data = self.connection.recv(timeout=PATIENCE)
            packed = data[16 : 16 + int.from_bytes(data[8:16], "little")]  # as viser has it
            window = msgspec.msgpack.decode(zstandard.ZstdDecompressor().decompress(packed))
            self._left.extend(window["messages"])

    def close(self):
        self.connection.close()
