"""VTK XML files of grids: .vts (StructuredGrid) and .vtr (RectilinearGrid): their points, and the outer
faces of their cells. Those with evenly spaced points are volumes, too."""

from __future__ import annotations

import math
import os
from typing import Any

import numpy as np

from ..data.particles import Particles
from . import vtk_legacy
from .cells import Cells
from .contents import Contents
from .errors import FormatError, shown
from .size import check_memory, whole_file
from .vtk_grids import grid_cells, n_cells, volume_of
from .vtk_xml import VtkXml, named

_MOST_POINTS = 1 << 40


def read(path: str | os.PathLike[str]) -> Contents:
    """Read the points and point data of a .vts or .vtr file, without ghosts."""
    file = _XmlGrid(path, whole_file(path, 2.0))
    return Contents(file.particles(), time=file.time())


def read_triangles(path: str | os.PathLike[str]) -> tuple[Particles, np.ndarray]:
    """Read all points with their data, and the outer faces of the cells as triangles (F, 3)."""
    return _XmlGrid(path, whole_file(path, 4.0)).triangles()


def has_faces(path: str | os.PathLike[str]) -> bool:
    """Whether a grid is no row of points. Raises FormatError for a damaged file."""
    file = _XmlGrid(path, whole_file(path, 2.0))
    return any(sum(n > 1 for n in file.size(piece)) > 1 for piece in file.pieces())


def read_volume(path: str | os.PathLike[str]) -> tuple[dict[str, np.ndarray], np.ndarray, np.ndarray] | None:
    """The arrays of an evenly spaced grid by name, each (Z, Y, X), the one for colors first; its
    spacing and origin (3,). None for another grid; of legacy VTK, too. Raises FormatError."""
    data = whole_file(path, 4.0)
    if data.startswith(b"# vtk"):
        return vtk_legacy.read_volume(path, data)
    file = _XmlGrid(path, data)
    pieces = file.pieces()
    return file.volume(pieces[0]) if len(pieces) == 1 else None


def is_volume(path: str | os.PathLike[str]) -> bool:
    """Whether `read_volume` reads a file; False for a damaged one, whose reader says why."""
    try:
        return read_volume(path) is not None
    except FormatError:
        return False


class _XmlGrid(VtkXml):
    """Points in rows, columns and layers, x the fastest."""

    data_sets = ("StructuredGrid", "RectilinearGrid")

    def size(self, element: Any) -> tuple[int, int, int]:
        """The points of a piece along x, y and z."""
        text = element.get("Extent", "")
        try:
            x0, x1, y0, y1, z0, z1 = map(int, text.split())
        except ValueError:
            raise self.bad("Piece", f"expected Extent of six whole numbers, got {shown(text)}") from None
        size = (x1 - x0 + 1, y1 - y0 + 1, z1 - z0 + 1)
        if min(size) < 0 or math.prod(size) > _MOST_POINTS:
            raise self.bad("Piece", f"expected Extent with sizes from 0, got {shown(text)}")
        return size

    def n_points(self, element: Any) -> int:
        """How many points a piece has."""
        return math.prod(self.size(element))

    def n_cells(self, element: Any) -> int:
        """How many cells a piece has."""
        return n_cells(self.size(element))

    def cells(self, element: Any) -> Cells:
        """The cells of a piece."""
        return grid_cells(self.path, self.size(element))

    def places(self, element: Any, n: int) -> np.ndarray:
        """The points (n, 3) of a piece that has some."""
        if self.root.get("type") == "StructuredGrid":
            return super().places(element, n)
        found = element.findall("Coordinates/DataArray")
        if len(found) != 3:
            raise self.bad("Coordinates", f"expected three arrays, got {len(found)}")
        axes = [self.array(a, k) for a, k in zip(found, self.size(element), strict=True)]
        if any(axis.ndim > 1 for axis in axes):
            raise self.bad("Coordinates", "expected arrays of one component")
        check_memory(self.path, "", 48.0 * n)
        z, y, x = np.meshgrid(*axes[::-1], indexing="ij")
        places = np.stack([x, y, z], -1).reshape(-1, 3)
        return places if places.dtype.kind == "f" else places.astype(np.float64)

    def volume(self, element: Any) -> tuple[dict[str, np.ndarray], np.ndarray, np.ndarray] | None:
        """As `volume_of`, with the array for colors first."""
        if not self.n_points(element):
            return None
        arrays = self.piece(element)
        points = arrays.pop(("", 3))
        found = volume_of(self.size(element), points, named(arrays), self.cell_arrays(element))
        for data in ("PointData", "CellData"):
            scalars = getattr(element.find(data), "attrib", {}).get("Scalars")
            if found and scalars in found[0]:
                return {scalars: found[0].pop(scalars)} | found[0], *found[1:]
        return found
