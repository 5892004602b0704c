"""Grids of legacy VTK files: STRUCTURED_GRID and RECTILINEAR_GRID, and STRUCTURED_POINTS, an image."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from .asciinum import numbers_of_words
from .cells import GHOSTS, Cells
from .errors import shown
from .size import check_memory, whole_file
from .vtk_reader import VtkReader

_UNEVEN = 1e-3  # of a step: how far points may lie from where they are evenly spaced
_KINDS = {1: 3, 2: 9, 3: 12}  # lines, quads and hexahedra, by the dimension of the grid
# Corners of one, in steps along the axes that it has.
_CORNERS = ((0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1))


def read_image(path: str | os.PathLike[str]) -> tuple[dict[str, np.ndarray], np.ndarray, np.ndarray]:
    """The point data of STRUCTURED_POINTS by name, each (Z, Y, X); the spacing and origin (3,)."""
    return _Image(path, whole_file(path, 4.0)).image()


def n_cells(size: Sequence[int]) -> int:
    """How many cells a grid of so many points along x, y and z has."""
    return math.prod(max(n - 1, 1) for n in size) if min(size) > 0 else 0


def grid_cells(path: Any, size: Sequence[int]) -> Cells:
    """The cells between the points of a grid, x the fastest."""
    check_memory(path, "", 160.0 * n_cells(size))
    wide = [axis for axis in range(3) if size[axis] > 1]
    points = np.arange(math.prod(size)).reshape(size[::-1])
    first = points[tuple(slice(None, -1 if n > 1 else None) for n in size[::-1])].ravel()
    strides = [(1, size[0], size[0] * size[1])[axis] for axis in wide]
    steps = [sum(s * c for s, c in zip(strides, corner, strict=False)) for corner in _CORNERS[: 2 ** len(wide)]]
    corners = first[:, None] + np.array(steps)
    n, k = corners.shape
    return Cells(np.full(n, _KINDS.get(len(wide), 1), np.uint8), corners.ravel(), k * np.arange(n + 1))


def volume_of(
    size: Sequence[int], points: np.ndarray, arrays: Mapping[str, np.ndarray], cell_arrays: Mapping[str, np.ndarray]
) -> tuple[dict[str, np.ndarray], np.ndarray, np.ndarray] | None:
    """What a grid holds as a volume: arrays of one component by name, each (Z, Y, X), the spacing and
    the origin (3,); those of cells where its points have none. None where the points do not lie
    evenly along x, y and z, or there is no such array, or a ghost.
    """
    if min(size) < 2 or any(name in GHOSTS for name in (*arrays, *cell_arrays)):
        return None
    at_points = {name: a for name, a in arrays.items() if a.ndim == 1}
    at_cells = {name: a for name, a in cell_arrays.items() if a.ndim == 1}
    n = np.array(size)
    low, high = points[0].astype(np.float64), points[-1].astype(np.float64)
    if not (at_points or at_cells) or not (np.isfinite(low) & np.isfinite(high) & (high > low)).all():
        return None
    steps = (high - low) / (n - 1)
    near = _UNEVEN * steps + 4 * np.finfo(points.dtype).eps * np.maximum(np.abs(low), np.abs(high))
    if (near > steps / 4).any():
        return None  # steps that the numbers cannot tell
    places = points.reshape(*size[::-1], 3)
    for axis in range(3):
        even = (low[axis] + steps[axis] * np.arange(size[axis])).reshape([-1 if 2 - axis == k else 1 for k in range(3)])
        if not (np.abs(places[..., axis] - even) <= near[axis]).all():
            return None
    if at_points:
        return {name: a.reshape(size[::-1]) for name, a in at_points.items()}, steps, low
    return {name: a.reshape((n - 1)[::-1]) for name, a in at_cells.items()}, steps, low + steps / 2


class VtkGrid(VtkReader):
    """Points in rows, columns and layers, with the first axis the fastest."""

    data_sets = ("STRUCTURED_GRID", "RECTILINEAR_GRID")

    def __init__(self, path: Any, data: bytes) -> None:
        super().__init__(path, data)
        self.size: tuple[int, ...] = ()  # x, y, z
        self.axes: dict[str, np.ndarray] = {}

    def read(self) -> np.ndarray:
        """The points (N, 3), and all arrays."""
        points = super().read()
        if len(points) != math.prod(self.size):
            self.fail(f"expected POINTS {math.prod(self.size)}, as DIMENSIONS says, got {len(points)}")
        return points

    def geometry(self, keyword: str, words: list[bytes]) -> bool:
        """Read a section that says where points are; False for any other."""
        if keyword == "DIMENSIONS":
            self.size = tuple(self.count(words, i) for i in (1, 2, 3))
            self.n_cells = n_cells(self.size)
        elif keyword in ("X_COORDINATES", "Y_COORDINATES", "Z_COORDINATES"):
            self.axes[keyword[0]] = self.numbers(self.count(words, 1), self.type_of(words, 2))
            if len(self.axes) == 3:
                check_memory(self.path, "", 48.0 * math.prod(map(len, self.axes.values())))
                z, y, x = np.meshgrid(*(self.axes[axis] for axis in "ZYX"), indexing="ij")
                self.points = np.stack([x, y, z], -1).reshape(-1, 3)
        else:
            return super().geometry(keyword, words)
        return True

    def cells(self) -> Cells:
        """The cells between the points."""
        return grid_cells(self.path, self.size)

    def volume(self) -> tuple[dict[str, np.ndarray], np.ndarray, np.ndarray] | None:
        """As `volume_of`."""
        points = self.read()
        return volume_of(self.size, points, self.arrays, self.cell_arrays)


class _Image(VtkReader):
    """STRUCTURED_POINTS: values on a grid, with the first axis the fastest."""

    data_sets = ("STRUCTURED_POINTS",)
    size: tuple[int, ...] = ()  # x, y, z
    spacing, origin = np.ones(3), np.zeros(3)

    def image(self) -> tuple[dict[str, np.ndarray], np.ndarray, np.ndarray]:
        self.sections()
        found = {name: a for name, a in self.arrays.items() if a.ndim == 1}
        if not found:
            self.fail("expected POINT_DATA with an array of one component, got none")
        shape = self.size[::-1]
        return {name: a.reshape(shape) for name, a in found.items()}, self.spacing, self.origin

    def geometry(self, keyword: str, words: list[bytes]) -> bool:
        if keyword == "DIMENSIONS":
            self.size = tuple(self.count(words, i) for i in (1, 2, 3))
            self.n_cells = math.prod(max(n - 1, 1) for n in self.size)
        elif keyword in ("SPACING", "ASPECT_RATIO"):
            self.spacing = self.three(words)
        elif keyword == "ORIGIN":
            self.origin = self.three(words)
        else:
            return False
        return True

    def n_points(self) -> int:
        return math.prod(self.size) if self.size else 0

    def three(self, words: list[bytes]) -> np.ndarray:
        values = numbers_of_words(words[1:])
        if len(values) != 3 or not np.isfinite(values).all():
            self.fail(f"expected three numbers after {shown(words[0])}")
        return values
