"""Arrays at places as VTK XML: image data (.vti) and polygonal data (.vtp), appended raw."""

from __future__ import annotations

import os
from collections.abc import Mapping

import numpy as np

from .fields import check_names
from .vtk_xml_data import Appended


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
    check_names(arrays)
    data = Appended()
    body = (
        f'<ImageData WholeExtent="{extent}" Origin="{numbers_text(origin)}" Spacing="{numbers_text(spacing)}" '
        f'Direction="{numbers_text(direction.ravel())}">\n<Piece Extent="{extent}">\n'
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
    check_names(arrays)
    data = Appended()
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


def numbers_text(values: np.ndarray) -> str:
    """Numbers with blanks between them, each of which survives exactly."""
    return " ".join(repr(value) for value in np.asarray(values, np.float64).tolist())
