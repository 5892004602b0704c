"""Tracked frames from OpenIGTLink servers, as PLUS sends them.

A frame is an IMAGE message and the pose that TRANSFORM messages give for its time stamp. The device
name of a transform names its coordinate frames: ProbeToTracker. Transforms whose stamps differ from
the image's are interpolated. In a stream without transforms, the matrix of the image is its pose
(PLUS: EmbeddedTransformToFrame). Transforms may come from a server of their own with a clock of its
own. The reader takes messages from the socket one by one, so a slow reader slows the server down
and loses nothing. The reader reconnects after the connection breaks.

All poses are returned in LPS. The header of an IMAGE message states the axes of its matrix, RAS or
LPS; a TRANSFORM message states nothing, and its world counts as LPS, as in files of PLUS.
"""

from __future__ import annotations

import itertools
import zlib
from collections.abc import Callable, Iterable, Iterator
from typing import Any

import numpy as np

from .._base.checks import choice, optional
from .._base.interrupts import Later
from ..formats.sweeps.transforms import Edges, split_name
from .live_counts import LiveCounts
from .matching import MOST_GAP, LiveFrame, Matcher
from .senders import Arrived, Broken, Clocks, arrivals
from .setup import Setup
from .sweep import SPACES, Sweep, usable

DEFAULT_PORT = 18944
_RAS = np.diag([-1.0, -1.0, 1.0, 1.0])  # LPS from RAS
_MOST_HELD = 4096  # transforms that wait until the clocks are known
NO_IMAGE = np.zeros((0, 0), np.uint8)  # of a frame whose image is not kept


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
    return optional("pyigtl.messages", "live", "pyigtl").MessageBase


def receive(
    address: str,
    constant: Edges,
    idle: float = 5.0,
    space: str | None = None,
    temporal_offset: float = 0.0,
    wait: float | None = None,
    counts: LiveCounts | None = None,
    tracker: str | None = None,
) -> Iterator[LiveFrame]:
    """Frames as they arrive, until the server has been silent or gone for `idle` seconds.

    Args:
        address: igtl://host[:port].
        constant: transforms that no message brings, such as (Image, Probe) of a calibration.
        idle: s.
        space: axes of the world that the messages' matrices map to, "LPS" or "RAS"; default: what
            the header of an image states for its own matrix, LPS for transforms.
        temporal_offset: s, an image at time t takes the pose at t + offset. An image with a
            positive offset arrives that much later.
        wait: s, until a server must have answered for the first time; default: idle.
        counts: counts what becomes of the images.
        tracker: igtl://host[:port] of a second server, which sends transforms. Both may start in
            any order. If the clocks of the servers differ by more than a second, arrival times
            tell the difference (`counts.clock_difference`).

    Raises:
        MissingPackageError: the extra `live` is not installed.
        ConnectionError: no server answers.
        ValueError: a bad address or space, or nothing but bytes that are not OpenIGTLink. Broken
            messages among others are skipped and counted (`counts.broken`).
    """
    MessageBase = need_pyigtl()
    places = [parse_address(place) for place in (address, tracker) if place is not None]
    if space is not None:
        choice("space", space, SPACES)
    counts = counts or LiveCounts()
    assembler = _Assembler(constant, space, temporal_offset, counts, Clocks() if tracker else None)
    wait = idle if wait is None else wait
    for arrived in arrivals(MessageBase, places, idle, wait, counts.connected):
        yield from assembler.take(arrived)
    if counts.broken and not (counts.images or counts.poses or counts.kinds):
        raise ValueError(f"live: expected OpenIGTLink messages, got {next(iter(counts.broken))}")
    if tracker and not counts.connected[1]:
        raise ConnectionError(f"live: expected a tracker's server at {tracker}, got none")
    yield from assembler.finish()


def receive_sweeps(
    address: str,
    calibration: Any = None,
    plus: Any = None,
    idle: float = 5.0,
    each: Callable[[int, LiveFrame], None] | None = None,
    earlier: Iterable[LiveFrame] = (),
    space: str | None = None,
    temporal_offset: float | None = None,
    wait: float | None = None,
    counts: LiveCounts | None = None,
    tracker: str | None = None,
    thin: Callable[[list[LiveFrame]], None] | None = None,
    **region: Any,
) -> list[Sweep]:
    """All frames of a server, until the server stops or the user interrupts: a `Sweep` for each
    size and type of images, in the order in which these came.

    Args:
        address, idle, space, wait, counts, tracker: as for `receive`.
        calibration, plus: as for `read_sweep`.
        each: called with the number of frames so far and the newest frame.
        earlier: frames of an interrupted run, which come first. Frames that a restarted server
            sends again are dropped.
        temporal_offset: as for `receive`; default: the calibration's, or 0.
        thin: called after each frame with all frames of its size and type; may replace frames by
            such with `NO_IMAGE`, which then need no memory.
        region: clip, fan, mask; as for `read_sweep`.

    Returns:
        The sweeps, in LPS, sorted by time; if images are gone, in the order of arrival and with
        black images. An error after the first frame ends the stream only
        (`counts.ended`).

    Raises:
        MissingPackageError: the extra `live` is not installed.
        ConnectionError: no server answers.
        ValueError: no frame came with its pose.
    """
    setup = Setup(calibration, plus, **region)
    counts = counts or LiveCounts()
    offset = setup.temporal_offset if temporal_offset is None else temporal_offset
    stream = receive(address, setup.edges, idle, space, offset, wait, counts, tracker)
    segments: dict[tuple[Any, ...], list[LiveFrame]] = {}
    known: set[int] = set()
    n_taken = 0

    def take(frame: LiveFrame) -> None:
        nonlocal n_taken
        if not usable(frame.world_from_image):
            counts.useless += 1
            return
        key = hash((frame.time, zlib.crc32(frame.image.data), frame.world_from_image.tobytes()))
        if key in known:
            counts.repeated += 1
            return
        known.add(key)
        segment = segments.setdefault((frame.image.shape, frame.image.dtype), [])
        segment.append(frame)
        n_taken += 1
        if each:
            each(n_taken, frame)
        if thin:
            thin(segment)

    def sound() -> Iterator[LiveFrame]:
        try:
            yield from stream
        except (ValueError, OSError) as error:
            if not segments:
                raise
            counts.ended = str(error)

    try:
        for frame in itertools.chain(earlier, sound()):
            with Later():  # Ctrl-C in the middle of a frame would leave locks and files half done
                take(frame)
    except KeyboardInterrupt:
        if not segments and not counts.images:
            raise
    if not segments:
        found = "none"
        if counts.images:
            found = f"{counts.images} images and no pose within {MOST_GAP:g} s of any"
        if counts.useless:
            found = f"{counts.useless} images with a pose that is no regular matrix, or not OK by its status"
        why = counts.unused(setup.edges)
        raise ValueError(f"live: expected images with poses from {address}, got {found}" + (f"; {why}" if why else ""))
    sweeps = []
    for (shape, dtype), frames in segments.items():
        try:
            sweeps.append(_as_sweep(frames, setup, shape, dtype))
        except ValueError as error:  # a region that only fits the first images
            if not sweeps:
                raise
            rows, columns = shape
            counts.broken[f"IMAGE of {columns} x {rows} pixels ({error})"] += len(frames)
    return sweeps


def _as_sweep(frames: list[LiveFrame], setup: Setup, shape: tuple[int, int], dtype: np.dtype) -> Sweep:
    gone = any(frame.image is NO_IMAGE for frame in frames)
    if not gone:
        frames.sort(key=lambda frame: (frame.clock, frame.time))
    images = np.zeros((len(frames), 1, 1), dtype) if gone else np.stack([frame.image for frame in frames])
    mask, world = setup.mask(shape), frames[0].world
    sweep = Sweep(
        images, [frame.world_from_image for frame in frames], [frame.time for frame in frames],
        mask=None if gone else mask, world=world,
    )  # fmt: skip
    if gone:
        sweep.frames, sweep.mask = np.broadcast_to(images, (len(frames), *shape)), mask
    return sweep


def receive_sweep(*args: Any, **options: Any) -> Sweep:
    """The longest of `receive_sweeps`, with the same arguments."""
    return max(receive_sweeps(*args, **options), key=len)


class _Assembler:
    """Messages in, frames out."""

    def __init__(
        self, constant: Edges, space: str | None, temporal_offset: float, counts: LiveCounts,
        clocks: Clocks | None,
    ):  # fmt: skip
        self.matcher = Matcher(constant, temporal_offset)
        self.space, self.counts, self.clocks = space, counts, clocks
        self._held: list[tuple[tuple[str, str], float, np.ndarray]] = []

    def take(self, arrived: Arrived) -> Iterator[LiveFrame]:
        self.counts.waiting = arrived.waiting
        if isinstance(arrived.message, Broken):
            self.counts.saw_broken(*arrived.message)
            return
        message, kind = arrived.message, getattr(arrived.message, "message_type", "")
        if kind not in ("IMAGE", "TRANSFORM"):
            self.counts.kinds[kind or message[0]] += 1
            return
        if self.clocks:
            self.clocks.saw(arrived.server, message.timestamp, arrived.when)
            if self._held and self.clocks.difference is not None:
                held, self._held = self._held, []
                for key, stamp, pose in held:
                    self.matcher.add_transform(key, stamp + self.clocks.difference, pose)
        if kind == "IMAGE":
            if arrived.server:
                return  # of the tracker's server, which is asked for poses
            try:
                image = _plane(message.image)
            except ValueError as error:
                self.counts.saw_broken(str(error), message.timestamp)
                return
            device = message.device_name
            if self.counts.devices.setdefault((image.shape, image.dtype), device) != device:
                self.counts.other_devices[device] += 1  # two devices show different things
                return
            self.counts.saw(message.timestamp)
            place = np.array(message.ijk_to_world_matrix, np.float64)
            own: np.ndarray | None = None if _is_no_pose(place, image.shape) else place
            if own is not None and self.space is None and message.world_coordinate_system == "ras":
                own = _RAS @ own
            self.matcher.add_image(message.timestamp, image, own)
        else:
            name = split_name(message.device_name.removesuffix("Transform"))
            if name is None:
                self.counts.unnamed.add(message.device_name)
            else:
                self.counts.saw_transform(message.device_name, message.timestamp)
                matrix = np.array(message.matrix, np.float64)
                if message.metadata.get("TransformStatus", "OK") != "OK":
                    matrix[:] = np.nan
                self._add_transform(name, message.timestamp, matrix, arrived.server)
        yield from self._frames(False)

    def _add_transform(self, name: tuple[str, str], time: float, matrix: np.ndarray, server: int) -> None:
        """A sample, on the clock of the images' server."""
        if server and self.clocks:
            difference = self.clocks.difference
            if difference is None:
                self._held.append((name, time, matrix))
                del self._held[:-_MOST_HELD]
                return
            self.counts.clock_difference = difference
            time += difference
        self.matcher.add_transform(name, time, matrix)

    def finish(self) -> Iterator[LiveFrame]:
        yield from self._frames(True)

    def _frames(self, ended: bool) -> Iterator[LiveFrame]:
        for frame in self.matcher.frames(ended):
            self.counts.frames += 1
            place = frame.world_from_image
            yield frame._replace(world_from_image=_RAS @ place) if self.space == "RAS" else frame
        self.counts.without_pose = self.matcher.n_without_pose


def _is_no_pose(place: np.ndarray, shape: tuple[int, int]) -> bool:
    """Whether a header's matrix is the identity, of the first pixel or of the image's middle."""
    middle = np.array([shape[1] - 1, shape[0] - 1, 0]) / 2
    at_zero = not place[:3, 3].any() or np.allclose(place[:3, 3], -middle, atol=0.51)
    return bool(at_zero and np.array_equal(place[:3, :3], np.eye(3)))


def _plane(image: np.ndarray) -> np.ndarray:
    """(1, H, W) or (1, H, W, 3) to (H, W), in native byte order."""
    from ..formats.sweeps.igs import to_gray

    if image.ndim == 4 and image.shape[-1] in (3, 4):
        image = to_gray(image[..., :3])
    if image.ndim != 3 or image.shape[0] != 1 or not image.size:
        values = f", {image.shape[-1]} values each" if image.ndim == 4 else ""
        size = " x ".join(map(str, image.shape[2::-1]))
        raise ValueError(f"IMAGE of {size} pixels{values}, which is no 2-D image in gray or color")
    return np.ascontiguousarray(image[0], image.dtype.newbyteorder("="))
