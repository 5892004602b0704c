"""One image shared out among ranks that all have the whole scene: squares dealt in turn."""

from __future__ import annotations

import time
from functools import cached_property, partialmethod
from math import gcd
from typing import Any

import numpy as np

from .. import _core
from .._base.ranks import ranks_of
from .camera import Camera
from .pieces.whole_images import take_all

SQUARE, WITH_EDGES = 64, 128  # pixels; the search for edges traces some pixels around each
# What the core's frame has: numbers a pixel, and their type.
ARRAYS: dict[str, tuple[int, Any]] = {
    "picture": (3, np.uint8), "layer": (1, np.uint8), "depth": (1, np.float32),
    "normal": (3, np.float32), "albedo": (3, np.float32), "color": (3, np.float32),
    "position": (3, np.float32),
}  # fmt: skip


class Share:
    """This rank's squares of an image, and how all ranks' become one.

    Args:
        comm: an mpi4py communicator, or the ranks that `run_threads` makes.
        edges: whether pixels at edges have more samples.
    """

    def __init__(self, comm: Any, camera: Camera, size: tuple[int, int], edges: bool):
        self.ranks, self.size = ranks_of(comm), size
        self.arrays = ["picture"] if self.ranks.only_image else list(ARRAYS)
        self.square = WITH_EDGES if edges else SQUARE
        n = self.ranks.size
        # A step without a common factor deals each column of squares evenly too.
        self.step = next(s for s in range(max(1, round(0.618 * n)), 2 * n + 1) if gcd(s, n) == 1)
        self._frame = camera.frame(size).ravel().tolist(), *size, camera.height is not None
        self._edges = edges
        self.view = self.view_of(self.ranks.rank)

    def view_of(self, rank: int) -> Any:
        """A rank's part of the camera's rays."""
        return _core.View(*self._frame, (rank, self.ranks.size, self.square, self.step, self._edges))

    @cached_property
    def pixels(self) -> list[int]:
        """How many each rank makes."""
        (width, height), n = self.size, self.ranks.size
        across, down = (-(-pixels // self.square) for pixels in self.size)
        rows, columns = np.arange(down)[:, None], np.arange(across)[None, :]
        owner = (columns + rows * self.step) % n
        ends = [np.minimum(self.square * np.arange(k + 1), m) for k, m in ((down, height), (across, width))]
        area = np.outer(np.diff(ends[0]), np.diff(ends[1]))
        return [int(area[owner == rank].sum()) for rank in range(n)]

    def whole(self, own: Any) -> Whole:
        """The frame of all ranks, of each rank's own; without hits on other ranks than 0."""
        return Whole(self, own)


class Whole:
    """The arrays of a finished image, as the core's frame has them."""

    def __init__(self, share: Share, own: Any):
        self.own, self._share, ranks = own, share, share.ranks
        self._passes = own.passes()
        traced = own.trace_seconds()  # waits for the frame
        start = time.perf_counter()
        self._frame: Any = None  # with all ranks' pixels
        self._arrays: dict[str, np.ndarray] = {}
        taken, facts = take_all(ranks, own, share.arrays, share.size, traced, share.view)
        self.seconds: list[float] = facts
        if taken:
            self._frame = own if ranks.rank == 0 else None
        else:
            self._gather()
        self.composite_seconds = time.perf_counter() - start

    def _gather(self) -> None:
        """All ranks' squares, by way of the hosts."""
        share, (width, height) = self._share, self._share.size
        for name in share.arrays:
            each, kind = ARRAYS[name]
            mine = getattr(self.own, name)(height, width)
            image = mine.reshape(-1).view(np.uint8)
            counts = [n * each * np.dtype(kind).itemsize for n in share.pixels]
            packed = np.empty(counts[share.ranks.rank], np.uint8)
            _core.pack_squares(share.view, image, packed)
            found = share.ranks.gather(packed, counts)
            if found is None:
                continue
            ends = np.cumsum(counts)
            for rank in range(1, share.ranks.size):  # rank 0's squares are there
                squares = found[ends[rank - 1] : ends[rank]]
                _core.unpack_squares(share.view_of(rank), squares, image)
            self._arrays[name] = mine

    def passes(self) -> int:
        """Rays per pixel, at edges left out."""
        return self._passes

    def trace_seconds(self) -> float:
        """Device time of the slowest rank, s."""
        return max(self.seconds)

    def _take(self, name: str, height: int, width: int) -> np.ndarray:
        if self._frame is not None and name in self._share.arrays:
            return getattr(self._frame, name)(height, width)
        if name in self._arrays:
            return self._arrays[name]
        each, kind = ARRAYS[name]
        shape = (height, width) if each == 1 else (height, width, each)
        nothing = {"depth": np.inf, "position": np.nan, "layer": 255}.get(name, 0)
        return np.full(shape, nothing, kind)

    picture = partialmethod(_take, "picture")
    layer = partialmethod(_take, "layer")
    depth = partialmethod(_take, "depth")
    normal = partialmethod(_take, "normal")
    albedo = partialmethod(_take, "albedo")
    color = partialmethod(_take, "color")
    position = partialmethod(_take, "position")
