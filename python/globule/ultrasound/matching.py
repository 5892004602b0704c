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


class Posed(NamedTuple):
    """An image and its pose: time, s; image (H, W); world_from_image (4, 4), mm; world."""

    time: float
    image: np.ndarray
    world_from_image: np.ndarray
    world: str


class _Waiting(NamedTuple):
    time: float
    image: np.ndarray
    number: int  # in the order of arrival, of images and samples
    place: np.ndarray | None  # world_from_image of the image's own message


class _Track:
    """One transform over time; samples in the order of their stamps, equal ones as they came."""

    def __init__(self) -> None:
        self.times: list[float] = []
        self.matrices: list[np.ndarray] = []
        self.used: list[bool] = []
        self.numbers: list[int] = []

    def add(self, time: float, matrix: np.ndarray, number: int = 0) -> None:
        at = bisect_right(self.times, time)
        self.times.insert(at, time)
        self.matrices.insert(at, matrix)
        self.used.insert(at, False)
        self.numbers.insert(at, number)
        if len(self.times) > _MOST_SAMPLES:
            for part in (self.times, self.matrices, self.used, self.numbers):
                del part[: _MOST_SAMPLES // 2]

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
    of its own message counts; the first images wait half a second for such a transform.

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
        self.images.append(_Waiting(time, image, self._n_arrived, place))
        if place is not None:
            self.embedded.add(time, place)
        while len(self.images) > _MOST_IMAGES:
            del self.images[0]
            self.n_without_pose += 1

    def frames(self, ended: bool = False) -> Iterator[Posed]:
        """Images that now have their pose. ended: nothing else will come."""
        if ended and self.world is None:
            self.world = self._reached()
        world = self.world or WORLDS[0]
        names: Edges = dict(self.constant)
        for name in self.tracks:
            names[name] = Transform(np.eye(4), np.array(True))
        way = find_path(names, "Image", world)
        by_transforms = bool(way and self.tracks)
        items, waiting = sorted(self.images, key=lambda item: item.time), []
        if not by_transforms and items:
            waited = items[-1].time - items[0].time > MOST_GAP or len(items) > _FIRST_IMAGES
            self.own_counts = self.own_counts or ended or waited
        for item in items:
            own = not by_transforms and item.place is not None
            pose, may_come = self._own_pose(item) if own else self._pose(item, way)
            if pose is not None:
                yield Posed(item.time, item.image, pose, WORLDS[0] if own else world)
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
        return (item.place, False) if self.offset == 0 else self.embedded.around(item.time + self.offset)

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
                matrix, may_come = track.around(time)
                if matrix is None:
                    return None, may_come
            edges[name] = Transform(matrix, np.array(True))
        for track, sample in taken:
            track.used[sample] = True
        return chain(edges, way, 1).matrices[0], False
