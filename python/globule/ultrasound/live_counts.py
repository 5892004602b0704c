"""What became of the messages of a stream, and what is wrong with them."""

from __future__ import annotations

from collections import Counter
from typing import Any

import numpy as np

from ..formats.sweeps.transforms import WORLDS, Edges, Transform, find_path, split_name
from .matching import Order

_OTHER_POSES = ("TDATA", "POSITION", "QTDATA", "QTRANS")  # types of messages
_LONGEST = 60.0  # s, of a gap; a longer one is a pause or a wrong stamp
_NEAR = 10.0  # s, of the stamp of a broken image from that of the image before
_STAMPS = 4096  # time stamps whose gaps are counted at a time


class _Stamps:
    """Time stamps, and how many are missing among them, in a memory that does not grow."""

    def __init__(self) -> None:
        self.n = self.n_without = self.n_back = 0  # stamps; those of 0; how often a clock was set back
        self.alike = True
        self.first: float | None = None
        self._order = Order()
        self._back: float | None = None
        self._times: list[float] = []
        self._counted, self._until = 0, -np.inf  # missing ones up to a stamp

    def add(self, time: float) -> None:
        self.first = time if self.first is None else self.first
        self.n, self.alike = self.n + 1, self.alike and time == self.first
        likely, how = self._order.next, self._order.add(time)
        self.n_without += how == "none"
        back, self._back = self._back, time if how == "back" else None
        if how == "anew" and back is not None and back not in self._times:
            self._counted, self._until, self._times = self.missed, -np.inf, [back]
            self.n_back += 1
        if how != "back":  # it may be wrong
            self._add(likely if how == "none" else time)

    def _add(self, time: float) -> None:
        if time < self._until:  # sent again
            return
        self._times.append(time)
        if len(self._times) >= 2 * _STAMPS:
            times = sorted(self._times)
            self._counted += _missed(times[: _STAMPS + 1])
            self._until, self._times = times[_STAMPS], times[_STAMPS:]

    def fill(self, time: float) -> None:
        """A stamp that is known, of a message that may be wrong: only where others are near."""
        if self._times and abs(time - self._times[-1]) < _NEAR:
            self._times.append(time)

    @property
    def missed(self) -> int:
        return self._counted + _missed(self._times)


class LiveCounts:
    """What became of the images of a stream.

    Attributes:
        images: images received.
        frames: images with a pose, which `receive` returned.
        without_pose: images whose pose never came.
        useless: frames whose pose is no regular finite matrix, or not OK by its status.
        repeated: frames that a restarted server sent again.
        waiting: messages that waited behind the newest one when it was taken.
        clock_difference: s that the stamps of the tracker's server are moved by.
        broken: how many messages were skipped, by what was wrong with them.
        broken_images: of these, images. With `images` and `missed`, they are all images of the server.
        kinds: how many messages came that are not used, by their type.
        devices: the devices of the images, by their size and type.
        other_devices: images that are left out, by their device: one of the same size came first.
        unnamed: names of transforms that name no coordinate frames.
        ended: why the stream ended early, or "".
    """

    def __init__(self) -> None:
        self.images = self.frames = self.without_pose = self.useless = self.repeated = self.broken_images = 0
        self.connected = [0, 0]
        self.clock_difference = 0.0
        self.waiting = 0
        self.broken: Counter[str] = Counter()
        self.kinds: Counter[str] = Counter()
        self.devices: dict[tuple[Any, ...], str] = {}
        self.other_devices: Counter[str] = Counter()
        self.unnamed: set[str] = set()
        self.ended = ""
        self._broken_times: set[float] = set()
        self._times = _Stamps()
        self._transform_times: dict[str, _Stamps] = {}

    def saw(self, time: float) -> None:
        """Count an image with this stamp, s; one that was broken before counts no longer as such."""
        self.images += 1
        self._times.add(time)
        if (near := round(time, 4)) in self._broken_times:
            self._broken_times.remove(near)
            self.broken_images -= 1

    def saw_broken(self, what: str, image_time: float | None = None) -> None:
        """Count a message that was skipped; an image by its header's stamp, so that it does not count as missed."""
        self.broken[what] += 1
        if image_time is not None:
            self.broken_images += 1
            self._broken_times.add(round(image_time, 4))
            self._times.fill(image_time)

    def saw_transform(self, name: str, time: float) -> None:
        """Count a sample of a transform with this stamp, s."""
        self._transform_times.setdefault(name, _Stamps()).add(time)

    @property
    def without_clock(self) -> bool:
        """Whether all images have one time stamp."""
        return self._times.n > 1 and self._times.alike

    def clock_lines(self) -> list[str]:
        """What is wrong with the time stamps, and what it means."""
        still = [name for name, stamps in self._transform_times.items() if stamps.n > 1 and stamps.alike]
        moves = any(stamps.n > 1 and not stamps.alike for stamps in self._transform_times.values())
        lines, images = [], self._times
        if self.without_clock and moves:
            lines.append(
                "all images have one time stamp, and transforms have others: an image takes only the transform with "
                "its own stamp; let the server stamp its images"
            )
        elif self.without_clock:
            lines.append(
                "all images have one time stamp: each takes the transform that came next to it; let the server stamp "
                "its messages"
            )
        elif still and images.n > 1:
            lines.append(
                f"all messages of {', '.join(still)} have one time stamp, and the images others: let the server stamp "
                "its transforms"
            )
        if images.n_without and not images.alike:
            lines.append(
                f"{images.n_without:,} of {images.n:,} images have no time stamp (0): each takes the transform without "
                "a stamp that came next to it; let the server stamp its messages"
            )
        for name, stamps in self._transform_times.items():
            if stamps.n_without and not stamps.alike and not images.n_without:
                lines.append(f"{stamps.n_without:,} of {stamps.n:,} messages of {name} have no time stamp (0)")
        if images.n_back:
            times = "once" if images.n_back == 1 else f"{images.n_back:,} times"
            lines.append(f"the clock of the images was set back {times}: the frames count in the order of arrival")
        return lines

    def unused(self, constant: Edges) -> str:
        """What came instead of poses, and what to give."""
        lines = []
        edges = dict(constant)
        for name in self._transform_times:
            if (frames := split_name(name.removesuffix("Transform"))) is not None:
                edges[frames] = Transform(np.eye(4), np.array(True))
        if self.unnamed:
            which = ", ".join(sorted(name or "one without a name" for name in self.unnamed))
            lines.append(f"transforms that name no frames: {which}; expected names as ImageToReference")
        starts = {name for pair in edges for name in pair}
        if edges and not any(find_path(edges, "Image", world) for world in WORLDS):
            known = ", ".join("To".join(pair) for pair in edges)
            lines.append(f"no way leads from Image to {', '.join(WORLDS[:-1])} or {WORLDS[-1]} by {known}")
            if "Image" not in starts and "Probe" in starts:
                lines.append("give --calibration or --plus for ImageToProbe")
        others = [f"{n:,} {kind}" for kind, n in self.kinds.items() if kind in _OTHER_POSES]
        if self.images and not (edges or self.unnamed or others):
            lines.append("no TRANSFORM came, and the headers of the images hold no pose")
        lines += self.clock_lines()
        if others:
            lines.append(f"{', '.join(others)} messages are not read: let the server send TRANSFORM")
        return "; ".join(lines)

    @property
    def poses(self) -> int:
        """Samples of transforms that came."""
        return len(self.unnamed) + sum(stamps.n for stamps in self._transform_times.values())

    @property
    def connections(self) -> int:
        """Times that the client connected, to all servers."""
        return sum(self.connected)

    @property
    def missed(self) -> int:
        """Images that the server did not send, from gaps of the stamps of more than 1.8 usual
        intervals: the server has dropped them, or the connection was broken."""
        return self._times.missed

    @property
    def missed_poses(self) -> int:
        """Samples of the transform with most losses that did not come, found as `missed`."""
        return max((stamps.missed for stamps in self._transform_times.values()), default=0)

    def as_dict(self) -> dict[str, int]:
        """All counts by name."""
        names = ("images", "frames", "without_pose", "useless", "repeated", "broken_images", "missed",
                 "missed_poses", "connections")  # fmt: skip
        return {name: getattr(self, name) for name in names}


def _missed(times: list[float]) -> int:
    steps = np.diff(np.unique(times))
    if len(steps) < 4:
        return 0
    usual = float(np.median(steps))
    gaps = steps[(steps > 1.8 * usual) & (steps < _LONGEST)]
    return int(np.rint(gaps / usual - 1).sum())
