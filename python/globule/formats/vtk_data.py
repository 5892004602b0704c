"""Arrays at places as VTK XML: image data (.vti) and polygonal data (.vtp), appended raw."""

from __future__ import annotations

import os
from collections.abc import Mapping
from xml.sax.saxutils import quoteattr

import numpy as np

from .._base.files import atomic_write
from .fields import check_names
from .vtk_xml import TYPES

_NAMES = {code: name for name, code in TYPES.items()}


def write_image(
    path: str | os.PathLike[str],
    origin: np.ndarray,
    steps: np.ndarray,
    shape: tuple[int, int, int],
    arrays: Mapping[str, np.ndarray],
) -> None:
    """Write a regular grid with values at its nodes.

    Args:
        path: of the file.
        origin: (3,) world, the first node.
        steps: (3, 3) world; row i leads to the next node along axis i. The rows are orthogonal.
        shape: number of nodes along the three axes; axis 0 is the fastest in the arrays.
        arrays: name -> (n,) or (n, k) values, one row a node.
    """
    spacing = np.linalg.norm(steps, axis=1)
    direction = (steps / spacing[:, None]).T
    extent = " ".join(f"0 {n - 1}" for n in shape)
    data = _Appended()
    body = (
        f'<ImageData WholeExtent="{extent}" Origin="{_text(origin)}" Spacing="{_text(spacing)}" '
        f'Direction="{_text(direction.ravel())}">\n<Piece Extent="{extent}">\n'
        f"<PointData>\n{data.add_all(arrays)}</PointData>\n</Piece>\n</ImageData>\n"
    )
    data.write(path, "ImageData", body)


def write_polygons(
    path: str | os.PathLike[str],
    points: np.ndarray,
    arrays: Mapping[str, np.ndarray],
    verts: np.ndarray | None = None,
    lines: np.ndarray | None = None,
    polys: np.ndarray | None = None,
) -> None:
    """Write points with values, and cells of them.

    Args:
        path: of the file.
        points: (N, 3) float32 world.
        arrays: name -> (N,) or (N, k) values.
        verts, lines, polys: (C, k) indices of each cell's points.
    """
    data = _Appended()
    index = np.int32 if len(points) < 2**31 else np.int64
    cells = {"Verts": verts, "Lines": lines, "Polys": polys}
    counts = "".join(f' NumberOf{name}="{0 if cell is None else len(cell)}"' for name, cell in cells.items())
    parts = [f"<Points>\n{data.add('Points', points)}</Points>\n"]
    parts.append(f"<PointData>\n{data.add_all(arrays)}</PointData>\n")
    for name, cell in cells.items():
        if cell is not None:
            ends = np.arange(1, len(cell) + 1, dtype=index) * cell.shape[1]
            parts.append(
                f"<{name}>\n{data.add('connectivity', cell.reshape(-1).astype(index))}"
                f"{data.add('offsets', ends.astype(index))}</{name}>\n"
            )
    body = f'<PolyData>\n<Piece NumberOfPoints="{len(points)}"{counts}>\n{"".join(parts)}</Piece>\n</PolyData>\n'
    data.write(path, "PolyData", body)


class _Appended:
    """Data arrays behind the XML, each with its size."""

    def __init__(self) -> None:
        self.blocks: list[np.ndarray] = []
        self.offset = 0

    def add_all(self, arrays: Mapping[str, np.ndarray]) -> str:
        return "".join(self.add(name, values) for name, values in arrays.items())

    def add(self, name: str, values: np.ndarray) -> str:
        """The element of an array (n,) or (n, k)."""
        check_names([name])
        if values.dtype == bool:
            values = values.astype(np.uint8)
        values = np.ascontiguousarray(values, values.dtype.newbyteorder("<"))
        k = 1 if values.ndim == 1 else values.shape[1]
        kind = _NAMES[f"{values.dtype.kind}{values.dtype.itemsize}"]
        element = (
            f'<DataArray type="{kind}" Name={quoteattr(name)} NumberOfComponents="{k}" '
            f'format="appended" offset="{self.offset}"/>\n'
        )
        self.blocks.append(values)
        self.offset += 8 + values.nbytes
        return element

    def write(self, path: str | os.PathLike[str], kind: str, body: str) -> None:
        head = (
            f'<?xml version="1.0" encoding="utf-8"?>\n<VTKFile type="{kind}" version="1.0" '
            f'byte_order="LittleEndian" header_type="UInt64">\n{body}'
            '<AppendedData encoding="raw">\n_'
        )
        with atomic_write(path) as file:
            file.write(head.encode())
            for values in self.blocks:
                file.write(values.nbytes.to_bytes(8, "little"))
                file.write(values.tobytes())
            file.write(b"\n</AppendedData>\n</VTKFile>\n")


def _text(values: np.ndarray) -> str:
    return " ".join(repr(value) for value in np.asarray(values, np.float64).tolist())
