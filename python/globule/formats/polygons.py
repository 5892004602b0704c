"""Polygons and strips as triangles."""

from __future__ import annotations

import numpy as np


def fans(corners: np.ndarray, offsets: np.ndarray, strips: bool = False) -> np.ndarray | None:
    """Triangles (F, 3) int64 of polygons, each from the polygon's first corner, or of strips.

    Args:
        corners: (K,) vertices of all polygons.
        offsets: (P + 1,) where each polygon begins in `corners`, and the end.
        strips: the cells are strips of triangles.

    Returns None for offsets that do not grow from 0 to at most K.
    """
    sizes = np.diff(offsets)
    if len(offsets) == 0 or offsets[0] < 0 or (sizes < 0).any() or offsets[-1] > len(corners):
        return None
    parts = [np.empty((0, 3), np.int64)]
    for size in np.unique(sizes[sizes > 2]):
        begin = offsets[:-1][sizes == size]
        polygons = corners[begin[:, None] + np.arange(size)]
        for i in range(1, size - 1):
            if not strips:
                three = [0, i, i + 1]
            else:
                three = [i - 1, i, i + 1] if i % 2 else [i, i - 1, i + 1]
            parts.append(polygons[:, three])
    return np.concatenate(parts)
