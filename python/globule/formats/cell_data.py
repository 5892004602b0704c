"""The data of cells of VTK's files at their points, and which points are no ghosts."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from .cells import GHOST_CELL, GHOST_POINT, GHOSTS, HIDDEN_CELL, VERTEX, VERTICES, Cells, ghost_flags


def point_arrays(
    n: int, arrays: dict[str, np.ndarray], cell_arrays: dict[str, np.ndarray], n_cells: int, cells: Callable[[], Cells]
) -> tuple[dict[str, np.ndarray], np.ndarray | None]:
    """The arrays of points, with those of cells, and which points (n,) are no ghosts; None: all of
    them. cells: called where the cells matter.

    Raises ValueError for cells whose offsets or points do not exist.
    """
    arrays, cell_arrays = dict(arrays), dict(cell_arrays)
    flags, of_cells = ghost_flags(arrays, n), ghost_flags(cell_arrays, n_cells)
    lost = np.zeros(n, bool) if flags is None else (flags & GHOST_POINT) != 0
    new = {name: a for name, a in cell_arrays.items() if name not in arrays}
    if not new and of_cells is None:
        return arrays, None if flags is None else ~lost
    found = cells()
    if problem := found.problem(n):
        raise ValueError(problem)
    sizes = np.diff(found.offsets)
    used = found.connectivity[found.offsets[0] : found.offsets[-1]]
    owner = np.repeat(np.arange(len(sizes)), sizes)
    if of_cells is not None:
        own = (of_cells & (GHOST_CELL | HIDDEN_CELL)) == 0
        lost |= (np.bincount(used, minlength=n) > 0) & ~(np.bincount(used[own[owner]], minlength=n) > 0)
    vertices = np.isin(found.types, (VERTEX, VERTICES))[owner]
    cell_of = np.full(n, -1)
    cell_of[used[vertices]] = owner[vertices]
    if vertices.any():
        arrays |= {name: _or_nan(values[cell_of], cell_of < 0) for name, values in new.items()}
    else:
        arrays |= at_points(n, found, new)
    return arrays, ~lost if lost.any() else None


def at_points(n: int, cells: Cells, values: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Values of cells at their points (n,), but for those of vertices: the mean of the cells around,
    of whole numbers that of one of them; NaN at points without a cell."""
    sizes = np.diff(cells.offsets)
    faces = np.repeat(~np.isin(cells.types, (VERTEX, VERTICES)), sizes)
    used = cells.connectivity[cells.offsets[0] : cells.offsets[-1]][faces]
    owner = np.repeat(np.arange(len(sizes)), sizes)[faces]
    found: dict[str, np.ndarray] = {}
    if not len(used):
        return found
    count = np.bincount(used, minlength=n)
    for name, array in values.items():
        if name in GHOSTS:
            continue
        here = np.zeros((n, *array.shape[1:]), array.dtype)
        if array.dtype.kind == "f":
            columns = array.reshape(len(array), -1).T
            means = [np.bincount(used, column[owner], n) / np.maximum(count, 1) for column in columns]
            here[...] = np.stack(means, axis=1).reshape(here.shape)
        else:
            here[used] = array[owner]
        found[name] = _or_nan(here, count == 0)
    return found


def _or_nan(values: np.ndarray, bare: np.ndarray) -> np.ndarray:
    """Values with NaN where there are none."""
    if bare.any():
        values = values.astype(np.result_type(values, np.float32))
        values[bare] = np.nan
    return values
