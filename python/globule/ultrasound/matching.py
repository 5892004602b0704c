"""The pose of an image in a stream: images and transforms that arrive apart, with stamps of their
own."""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

from ..formats.sweeps.poses import PoseTable, interpolate
from ..formats.sweeps.transforms import WORLDS, Edges, Transform, chain, find_path

MOST_GAP = 0.5  # s between two samples of a transform that still gives a pose between them
_SAME = 1e-6  # s; stamps this near are the same
_AHEAD = 10.0  # s; a sample this far ahead of an image may have a wrong stamp, and others may still come
_MOST_IMAGES = 256  # that wait for their pose
_FIRST_IMAGES = 16  # that wait, if their stamps are alike, before poses of their own count
_MOST_SAMPLES = 4096  # of a transform that are kept
_PATIENCE = 64  # messages within which the transform of an image must come that is known by its stamp alone
_LONGEST = 60.0  # s between two stamps of one clock


class LiveFrame(NamedTuple):
    """One tracked image.

    Attributes:
        time: s, of the server's clock.
        image: (H, W).
        world_from_image: (4, 4), maps the pixel (column, row, 0, 1) to the world, mm, LPS.
        world: name of the world's coordinate frame.
        clock: how often the stamps began anew before; they order frames of one clock only.
    """

    time: float
    image: np.ndarray
    world_from_image: np.ndarray
    world: str
    clock: int = 0


class _Waiting(NamedTuple):
    time: float  # the stamp
    image: np.ndarray
    number: int  # in the order of arrival, of images and samples
    place: np.ndarray | None  # world_from_image of the image's own message
    shown: float  # the time of the frame
    clock: int
    alone: bool  # only a transform with this very stamp, which no other image has taken, is its pose


class Order:
    """The stamps of one device as they come.

    A stamp of 0 says nothing (OpenIGTLink), and one that comes again says no more. A stamp below the two before it
    may be wrong; with the next one it is a clock that was set back, if that goes on from there.
    """

    def __init__(self) -> None:
        self._last: list[float] = []  # two
        self._step = 0.0
        self._back: tuple[float, float] | None = None  # a stamp that went back, and the lower one of two before

    def add(self, time: float) -> str:
        """Of the next stamp: "on", "none", "again", "back" or "anew": the one before went back, and this goes on."""
        if time == 0 and self._last:
            self._last = [*self._last[-1:], self.next]
            return "none"
        before = self._last
        self._last = [*before[-1:], time]
        back, self._back = self._back, None
        if before and time == before[-1]:
            self._back = back
            return "again"
        if before and 0 < time - before[-1] < 1:
            self._step = time - before[-1]
        if len(before) == 2 and time < min(before):
            self._back = time, min(before)
            return "back"
        if back is not None and time < back[1] and time - back[0] < _LONGEST:
            return "anew"
        return "on"

    @property
    def next(self) -> float:
        """The time of a message without a stamp: one step after the last one."""
        return self._last[-1] + self._step if self._last and self._last[-1] else 0.0


class _Track:
    """One transform over time; samples in the order of their stamps, equal ones as they came."""

    def __init__(self) -> None:
        self.times: list[float] = []
        self.matrices: list[np.ndarray] = []
        self.used: list[bool] = []
        self.numbers: list[int] = []
        self.anew = 0  # number of the first sample of the newest clock
        self._order = Order()

    def add(self, time: float, matrix: np.ndarray, number: int = 0) -> None:
        if self._order.add(time) == "back":
            self.anew = number
        at = bisect_right(self.times, time)
        self.times.insert(at, time)
        self.matrices.insert(at, matrix)
        self.used.insert(at, False)
        self.numbers.insert(at, number)
        if len(self.times) > _MOST_SAMPLES:
            for part in (self.times, self.matrices, self.used, self.numbers):
                del part[: _MOST_SAMPLES // 2]

    def forget(self, number: int) -> None:
        """Drop the samples that came before."""
        gone = [i for i, n in enumerate(self.numbers) if n < number]
        for i in reversed(gone):
            for part in (self.times, self.matrices, self.used, self.numbers):
                del part[i]

    def same(self, time: float, number: int) -> int | None:
        """Of the samples with this stamp that no image has taken, the last that came before the
        image of this number, or else the first after it: servers without a clock stamp all with 0."""
        near = range(bisect_left(self.times, time - _SAME), bisect_right(self.times, time + _SAME))
        free = [i for i in near if not self.used[i]]
        before = [i for i in free if self.numbers[i] < number]
        return before[-1] if before else free[0] if free else None

    def around(self, time: float) -> tuple[np.ndarray | None, bool]:
        """The interpolated sample, and whether a later one may still bring it."""
        times = self.times
        j = bisect_right(times, time)  # the first later one
        i = bisect_left(times, time) - 1  # the last earlier one
        exact = bisect_right(times, time + _SAME) - 1
        near = exact >= 0 and times[exact] >= time - _SAME
        if near and j < len(times):  # stamps advance, so a sample taken before is right, too
            return self.matrices[exact], False
        if j == len(times):
            return None, True
        if i < 0 or times[j] - times[i] > MOST_GAP:
            return None, times[j] - time > _AHEAD
        pair = np.stack([self.matrices[i], self.matrices[j]])
        if not np.isfinite(pair).all():
            return np.full((4, 4), np.nan), False
        try:
            table = PoseTable(np.array([times[i], times[j]]), pair, np.ones(2, bool))
            return interpolate(table, np.array([time]))[0][0], False
        except ValueError:  # mirrored: no rotation leads there
            share = (time - times[i]) / (times[j] - times[i])
            return (1 - share) * pair[0] + share * pair[1], False


class Matcher:
    """Gives images their poses.

    An image takes the transforms with its own stamp. Transforms with other stamps are interpolated
    to the image's time, if two samples at most 0.5 s apart surround it. With a temporal offset, the
    pose is that at the image's time plus the offset. Where no transform leads from the image, the pose
    of its own message counts; the first images wait half a second for such a transform. An image without a stamp of
    its own (0, or that of the image before) takes only a transform with the same stamp, which came next to it. After
    a clock was set back, samples of before count no longer.

    Attributes:
        n_without_pose: images that no pose came for.
    """

    def __init__(self, constant: Edges, temporal_offset: float = 0.0):
        self.constant, self.offset = constant, temporal_offset
        self.tracks: dict[tuple[str, str], _Track] = {}
        self.embedded = _Track()
        self.images: list[_Waiting] = []
        self.world: str | None = None
        self.own_counts = False
        self.n_without_pose = self._n_arrived = 0
        self.clock = 0
        self._order = Order()
        self._back = 0  # number of the image whose stamp went back
        self._image = np.zeros((0, 0), np.uint8)  # the newest one

    def add_transform(self, name: tuple[str, str], time: float, matrix: np.ndarray) -> None:
        """A sample of a transform (source, target)."""
        self._n_arrived += 1
        self.tracks.setdefault(name, _Track()).add(time, matrix, self._n_arrived)

    def add_image(self, time: float, image: np.ndarray, place: np.ndarray | None) -> None:
        """An image; place: world_from_image of its own message, or None."""
        if self.world is None and self.images:
            # The first images have waited until another came: the best world they reach is the
            # stream's.
            self.world = self._reached()
        self._n_arrived += 1
        number, shown = self._n_arrived, time or self._order.next
        how = self._order.add(time)
        if self._back and how != "again":
            if how == "anew":
                self._forget(self._back)
            else:
                self.clock += 1  # the one that went back was wrong
            self._back = 0
        if how == "back":
            self.clock += 1
            self._back = number
        alone = how in ("none", "back") or (how == "again" and not np.array_equal(image, self._image))
        self._image = image
        self.images.append(_Waiting(time, image, number, place, shown, self.clock, alone))
        if place is not None:
            self.embedded.add(time, place, self._n_arrived)
        while len(self.images) > _MOST_IMAGES:
            del self.images[0]
            self.n_without_pose += 1

    def _forget(self, number: int) -> None:
        """A new clock begins with the image of this number: forget samples of the old one."""
        for track in (*self.tracks.values(), self.embedded):
            near = number - track.anew <= _MOST_IMAGES
            track.forget(track.anew if track.anew and near else number)
        self.images = [item._replace(alone=item.alone and item.number != number) for item in self.images]

    def frames(self, ended: bool = False) -> Iterator[LiveFrame]:
        """Images that now have their pose. ended: nothing else will come."""
        if ended and self.world is None:
            self.world = self._reached()
        world = self.world or WORLDS[0]
        names: Edges = dict(self.constant)
        for name in self.tracks:
            names[name] = Transform(np.eye(4), np.array(True))
        way = find_path(names, "Image", world)
        by_transforms = bool(way and self.tracks)
        items, waiting = sorted(self.images, key=lambda item: (item.clock, item.shown)), []
        if not by_transforms and items:
            waited = items[-1].shown - items[0].shown > MOST_GAP or len(items) > _FIRST_IMAGES
            self.own_counts = self.own_counts or ended or waited
        for item in items:
            own = not by_transforms and item.place is not None
            pose, may_come = self._own_pose(item) if own else self._pose(item, way)
            if pose is not None:
                yield LiveFrame(item.shown, item.image, pose, WORLDS[0] if own else world, item.clock)
            elif ended or (not may_come and self.world is not None):
                self.n_without_pose += 1
            else:
                waiting.append(item)
        self.images = waiting

    def _reached(self) -> str | None:
        edges: Edges = dict(self.constant)
        for name in self.tracks:
            edges[name] = Transform(np.eye(4), np.array(True))
        return next((world for world in WORLDS if find_path(edges, "Image", world)), None)

    def _own_pose(self, item: _Waiting) -> tuple[np.ndarray | None, bool]:
        """The pose of an image's own message, and whether it may still come."""
        if not self.own_counts:
            return None, True
        if self.offset == 0:
            return item.place, False
        if item.alone:
            return None, self._n_arrived - item.number < _PATIENCE
        return self.embedded.around(item.time + self.offset)

    def _pose(self, item: _Waiting, way: list[tuple[str, str]] | None) -> tuple[np.ndarray | None, bool]:
        """The pose of an image by transforms, and whether it may still come."""
        if not way:
            return None, True
        time = item.time + self.offset
        edges: Edges = dict(self.constant)
        taken: list[tuple[_Track, int]] = []
        for step in way:
            name = step if step in self.tracks else step[::-1]
            if name not in self.tracks:
                continue
            track = self.tracks[name]
            sample = track.same(time, item.number)
            if sample is not None:
                matrix: Any = track.matrices[sample]
                taken.append((track, sample))
            else:
                matrix, may_come = None, self._n_arrived - item.number < _PATIENCE
                if not item.alone:
                    matrix, may_come = track.around(time)
                if matrix is None:
                    return None, may_come
            edges[name] = Transform(matrix, np.array(True))
        for track, sample in taken:
            track.used[sample] = True
        return chain(edges, way, 1).matrices[0], False
