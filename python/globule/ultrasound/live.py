"""Tracked frames from an OpenIGTLink server, as PLUS sends them.

A frame is an IMAGE message and the TRANSFORM messages with the same time stamp. The device name of
a transform names its coordinate frames: ProbeToTracker. In a stream without transforms, the matrix
of the image is its pose (PLUS: EmbeddedTransformToFrame). The reader takes messages from the socket
one by one, so a slow reader slows the server down and loses nothing. The reader reconnects after
the connection breaks.
"""

from __future__ import annotations

import itertools
import socket
import time
import zlib
from collections.abc import Callable, Iterable, Iterator
from typing import Any, NamedTuple

import numpy as np

from .._base.checks import missing
from ..formats.sweeps.transforms import WORLDS, Edges, Transform, chain, find_path, split_name
from .setup import Setup
from .sweep import Sweep, usable

DEFAULT_PORT = 18944
_HEADER = 58  # bytes
_MOST_BODY = 2**30
_MOST_PENDING = 64  # frames that still wait for transforms
_CONNECT_PAUSE = 0.1  # s between attempts


class _Pending(NamedTuple):
    """The messages of one frame so far."""

    time: float
    image: np.ndarray | None = None
    place: Any = np.eye(4)
    edges: Edges = {}  # noqa: RUF012 never changed


class LiveFrame(NamedTuple):
    """One tracked image.

    Attributes:
        time: s, of the server's clock.
        image: (H, W).
        world_from_image: (4, 4), maps the pixel (column, row, 0, 1) to the world, mm.
        world: name of the world's coordinate frame.
    """

    time: float
    image: np.ndarray
    world_from_image: np.ndarray
    world: str


def parse_address(address: str) -> tuple[str, int]:
    """Host and port of igtl://host[:port] (default port: 18944). Raises ValueError."""
    scheme, separator, place = address.partition("://")
    host, colon, port = place.rpartition(":")
    if not colon:
        host, port = place, str(DEFAULT_PORT)
    good = port.isascii() and port.isdigit() and 0 < int(port) < 65536
    if scheme != "igtl" or not separator or not host or not good:
        raise ValueError(f"live: expected igtl://host:port, got {address!r}")
    return host, int(port)


def need_pyigtl() -> Any:
    """pyigtl's base class of messages. Raises MissingPackageError."""
    try:
        from pyigtl.messages import MessageBase
    except ImportError as error:
        raise missing("pyigtl", "live") from error
    return MessageBase


def receive(address: str, constant: Edges, idle: float = 5.0) -> Iterator[LiveFrame]:
    """Frames as they arrive, until the server has been silent or gone for `idle` seconds.

    Args:
        address: igtl://host[:port].
        constant: transforms that no message brings, such as (Image, Probe) of a calibration.
        idle: s.

    Raises:
        MissingPackageError: the extra `live` is not installed.
        ConnectionError: no server answers.
        ValueError: a bad address, or bytes that are not OpenIGTLink.
    """
    MessageBase = need_pyigtl()
    host, port = parse_address(address)
    assembler = _Assembler(constant)
    met = False
    deadline = time.monotonic() + idle
    while time.monotonic() < deadline:
        try:
            connection = socket.create_connection((host, port), timeout=min(idle, 1.0))
        except OSError as error:
            last = error
            time.sleep(_CONNECT_PAUSE)
            continue
        met = True
        with connection:
            connection.settimeout(0.2)
            while True:
                message = _message(MessageBase, connection, deadline)
                if message is None:
                    break
                deadline = time.monotonic() + idle
                yield from assembler.take(message)
    if not met:
        raise ConnectionError(f"live: expected a server at {address}, got none: {last}")


def receive_sweep(
    address: str,
    calibration: Any = None,
    plus: Any = None,
    idle: float = 5.0,
    each: Callable[[int, LiveFrame], None] | None = None,
    earlier: Iterable[LiveFrame] = (),
    **region: Any,
) -> Sweep:
    """All frames of a server as one `Sweep`, until the server stops or the user interrupts.

    Args:
        address, idle: as for `receive`.
        calibration, plus: as for `read_sweep`.
        each: called with the number of frames so far and the newest frame.
        earlier: frames of an interrupted run, which come first. Frames that a restarted server
            sends again are dropped.
        region: clip, fan, mask; as for `read_sweep`.

    Returns:
        The sweep, sorted by time.

    Raises:
        MissingPackageError: the extra `live` is not installed.
        ConnectionError: no server answers.
        ValueError: no frame came with its pose, or the images differ in size.
    """
    setup = Setup(calibration, plus, **region)
    frames: list[LiveFrame] = []
    known: set[tuple[float, int, bytes]] = set()
    try:
        for frame in itertools.chain(earlier, receive(address, setup.edges, idle)):
            if frames and frame.image.shape != frames[0].image.shape:
                expected, got = frames[0].image.shape, frame.image.shape
                raise ValueError(f"live: expected images of {expected} as the first, got {got}")
            if not usable(frame.world_from_image):
                continue
            key = (frame.time, zlib.crc32(frame.image.data), frame.world_from_image.tobytes())
            if key in known:
                continue
            known.add(key)
            frames.append(frame)
            if each:
                each(len(frames), frame)
    except KeyboardInterrupt:
        if not frames:
            raise
    if not frames:
        raise ValueError(f"live: expected images with poses from {address}, got none")
    frames.sort(key=lambda frame: frame.time)
    images = np.stack([frame.image for frame in frames])
    return Sweep(
        images, [frame.world_from_image for frame in frames], [frame.time for frame in frames],
        mask=setup.mask(images.shape[1:]), world=frames[0].world,
    )  # fmt: skip


def _message(base: Any, connection: socket.socket, deadline: float) -> Any:
    """The next message; None after the connection broke or stayed silent."""
    header = _read(connection, _HEADER, deadline)
    if header is None:
        return None
    try:
        fields = base.parse_header(header)
    except ValueError:  # no text where the type should be
        fields = {"body_size": -1}
    if not 0 <= fields["body_size"] <= _MOST_BODY:
        raise ValueError(f"live: expected an OpenIGTLink message, got {header[:14]!r}")
    body = _read(connection, fields["body_size"], deadline + 5)
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


def _read(connection: socket.socket, n: int, deadline: float) -> bytes | None:
    parts = bytearray()
    while len(parts) < n:
        try:
            part = connection.recv(n - len(parts))
        except TimeoutError:
            if time.monotonic() > deadline:
                return None
            continue
        except OSError:
            return None
        if not part:
            return None
        parts += part
    return bytes(parts)


class _Assembler:
    """Joins images and transforms with the same time stamp."""

    def __init__(self, constant: Edges):
        self.constant = constant
        self.pending: dict[float, _Pending] = {}
        self.any_transform = False
        self.world: str | None = None

    def take(self, message: Any) -> Iterator[LiveFrame]:
        kind = getattr(message, "message_type", "")
        if kind not in ("IMAGE", "TRANSFORM"):
            return
        when = message.timestamp
        if when not in self.pending and self.world is None:
            # The earlier frames are complete: the best world that they reach is the stream's.
            reached = {f.world for p in self.pending.values() if (f := self._frame(p, WORLDS))}
            self.world = next((world for world in WORLDS if world in reached), None)
        new = self.pending.get(when) or _Pending(when)
        if kind == "IMAGE":
            new = new._replace(image=_plane(message.image), place=message.ijk_to_world_matrix)
        else:
            self.any_transform = True
            name = split_name(message.device_name.removesuffix("Transform"))
            if name is not None:
                matrix = Transform(np.array(message.matrix, np.float64), np.array(True))
                new = new._replace(edges=new.edges | {name: matrix})
        self.pending[when] = new
        worlds = (self.world,) if self.world else WORLDS[:1]
        for time_stamp, pending in sorted(self.pending.items()):
            frame = self._frame(pending, worlds)
            if frame is not None:
                del self.pending[time_stamp]
                yield frame
        while len(self.pending) > _MOST_PENDING:
            del self.pending[min(self.pending)]

    def _frame(self, pending: _Pending, worlds: tuple[str, ...]) -> LiveFrame | None:
        if pending.image is None:
            return None
        if not self.any_transform and not np.array_equal(pending.place, np.eye(4)):
            place = np.array(pending.place, np.float64)
            return LiveFrame(pending.time, pending.image, place, WORLDS[0])
        known = self.constant | pending.edges
        for world in worlds:
            way = find_path(known, "Image", world)
            if way:
                placed = chain(known, way, 1)
                if placed.ok[0]:
                    return LiveFrame(pending.time, pending.image, placed.matrices[0], world)
        return None


def _plane(image: np.ndarray) -> np.ndarray:
    """(1, H, W) or (1, H, W, 3) to (H, W), in native byte order."""
    from ..formats.sweeps.igs import to_grey

    if image.ndim == 4:
        image = to_grey(image[..., :3])
    if image.ndim != 3 or image.shape[0] != 1:
        raise ValueError(f"live: expected 2D images, got shape {image.shape}")
    return np.ascontiguousarray(image[0], image.dtype.newbyteorder("="))
