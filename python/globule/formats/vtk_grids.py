"""Grids of legacy VTK files: STRUCTURED_GRID and RECTILINEAR_GRID, whose points are read, and
STRUCTURED_POINTS, an image."""

from __future__ import annotations

import math
import os
from typing import Any

import numpy as np

from .cells import Cells
from .errors import shown
from .size import check_memory, whole_file
from .vtk_reader import VtkReader

_KINDS = {1: 3, 2: 9, 3: 12}  # lines, quads and hexahedra, by the dimension of the grid
# Corners of one, in steps along the axes that it has.
_CORNERS = ((0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1))


def read_image(path: str | os.PathLike[str]) -> tuple[dict[str, np.ndarray], np.ndarray, np.ndarray]:
    """The point data of STRUCTURED_POINTS by name, each (Z, Y, X); the spacing and origin (3,)."""
    return _Image(path, whole_file(path, 4.0)).image()


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
            self.n_cells = math.prod(max(n - 1, 1) for n in self.size)
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
        wide = [axis for axis in range(3) if self.size[axis] > 1]
        points = np.arange(math.prod(self.size)).reshape(self.size[::-1])
        first = points[tuple(slice(None, -1 if n > 1 else None) for n in self.size[::-1])].ravel()
        strides = [(1, self.size[0], self.size[0] * self.size[1])[axis] for axis in wide]
        steps = [sum(s * c for s, c in zip(strides, corner, strict=False)) for corner in _CORNERS[: 2 ** len(wide)]]
        corners = first[:, None] + np.array(steps)
        n, k = corners.shape
        return Cells(np.full(n, _KINDS.get(len(wide), 1), np.uint8), corners.ravel(), k * np.arange(n + 1))


class _Image(VtkReader):
    """STRUCTURED_POINTS: values on a grid, with the first axis the fastest."""

    data_sets = ("STRUCTURED_POINTS",)

    def __init__(self, path: Any, data: bytes) -> None:
        super().__init__(path, data)
        self.size: tuple[int, ...] = ()  # x, y, z
        self.spacing, self.origin = np.ones(3), np.zeros(3)

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
        try:
            values = np.array([float(word) for word in words[1:]])
        except ValueError:
            values = np.empty(0)
        if len(values) != 3 or not np.isfinite(values).all():
            self.fail(f"expected three numbers after {shown(words[0])}")
        return values
