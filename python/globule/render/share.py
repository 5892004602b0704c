"""One image shared out among ranks that all have the whole scene: squares dealt in turn."""

from __future__ import annotations

import time
from collections.abc import Iterator
from functools import partialmethod
from math import gcd
from typing import Any

import numpy as np

from .. import _core
from .._base.ranks import ranks_of
from .camera import Camera

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

    def __init__(
        self,
        comm: Any,
        camera: Camera,
        size: tuple[int, int],
        edges: bool,
    ):
        self.ranks, self.size = ranks_of(comm), size
        self.arrays = ["picture"] if self.ranks.only_image else list(ARRAYS)
        self.square = WITH_EDGES if edges else SQUARE
        n = self.ranks.size
        # A step without a common factor deals each column of squares evenly too.
        step = next(s for s in range(max(1, round(0.618 * n)), 2 * n + 1) if gcd(s, n) == 1)
        across, down = (-(-pixels // self.square) for pixels in size)
        rows, columns = np.arange(down)[:, None], np.arange(across)[None, :]
        self.owner = (columns + rows * step) % n
        own = (self.ranks.rank, n, self.square, step, edges)
        frame = camera.frame(size).ravel().tolist()
        self.view = _core.View(frame, *size, camera.height is not None, own)

    def squares(self, rank: int) -> Iterator[tuple[slice, slice]]:
        """Rows and columns of a rank's squares."""
        width, height = self.size
        for row, column in self.square * np.argwhere(self.owner == rank):
            yield (
                slice(int(row), min(int(row) + self.square, height)),
                slice(int(column), min(int(column) + self.square, width)),
            )

    def whole(self, own: Any) -> Whole:
        """The frame of all ranks, of each rank's own; without hits on other ranks than 0."""
        return Whole(self, own)


class Whole:
    """The arrays of a finished image, as the core's frame has them."""

    def __init__(self, share: Share, own: Any):
        self.own, self._share = own, share
        width, height = share.size
        self.seconds: list[float] = share.ranks.all(own.trace_seconds())
        start = time.perf_counter()
        root = share.ranks.rank == 0
        self._arrays: dict[str, np.ndarray] = {}
        pixels = [
            sum((r.stop - r.start) * (c.stop - c.start) for r, c in share.squares(rank))
            for rank in range(share.ranks.size)
        ]
        for name in share.arrays:
            each, kind = ARRAYS[name]
            mine = getattr(own, name)(height, width)
            parts = [mine[square].reshape(-1) for square in share.squares(share.ranks.rank)]
            packed = np.concatenate(parts or [np.empty(0, kind)]).view(np.uint8)
            counts = [n * each * np.dtype(kind).itemsize for n in pixels]
            found = share.ranks.gather(packed, counts)
            if not root:
                continue
            for rank in range(1, share.ranks.size):  # rank 0's squares are there
                values, at = found[rank].view(kind), 0
                for square in share.squares(rank):
                    place = mine[square]
                    place[...] = values[at : at + place.size].reshape(place.shape)
                    at += place.size
            self._arrays[name] = mine
        self._passes = own.passes()
        self.composite_seconds = time.perf_counter() - start

    def passes(self) -> int:
        """Rays per pixel, at edges left out."""
        return self._passes

    def trace_seconds(self) -> float:
        """Device time of the slowest rank, s."""
        return max(self.seconds)

    def _take(self, name: str, height: int, width: int) -> np.ndarray:
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
