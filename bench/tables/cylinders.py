"""Diameters and separations of parallel cylinders in a volume (Table 4.3)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from globule.volumes.volume import Volume

_REACH = 2.0  # half width of the window that is searched for a circle, in expected radii


class Cylinders(NamedTuple):
    """Diameters (S, C) and separations (S, C - 1) of C cylinders in S slabs, mm."""

    diameters: np.ndarray
    separations: np.ndarray


def measure_cylinders(
    volume: Volume, places: Sequence[tuple[float, float]], diameter: float, slab: float = 1.0,
    margin: float = 0.15,
) -> Cylinders:  # fmt: skip
    """Measure cylinders that run along z, in one slab after the other.

    Args:
        volume: its axes are the world's.
        places: (x, y) near each cylinder's axis, in order, mm; separations are between neighbors.
        diameter: about the expected diameter, mm; bounds the search.
        slab: length along z over which voxels are averaged, mm; hides speckle.
        margin: share of the slices left out at each end.

    Raises ValueError if no slab has all cylinders.

    In every slab, the circle with the largest variance between its inside and its outside gives
    the center, without a threshold. The radius is that of the disc with the missing sum of grays.
    Empty voxels do not count.
    """
    spacing, origin = volume.spacing, volume.world_from_voxel[:3, 3]
    n = volume.values.shape[0]
    thick = max(1, round(slab / float(spacing[2])))
    diameters, centers = [], []
    for z in range(int(n * margin), n - int(n * margin) - thick + 1, thick):
        known = ~volume.empty[z : z + thick]
        sums = (volume.values[z : z + thick] * known).sum(axis=0, dtype=np.float64)
        counts = known.sum(axis=0)
        gray = sums / np.maximum(counts, 1)
        radius = diameter / 2 / float(spacing[0])
        tried = [
            _circle(gray, counts > 0, ((np.array(at) - origin[:2]) / spacing[:2]).tolist(), radius) for at in places
        ]
        found = [circle for circle in tried if circle]
        if len(found) == len(tried):
            diameters.append([2 * r * spacing[0] for _, _, r in found])
            centers.append([(x * spacing[0], y * spacing[1]) for x, y, _ in found])
    if not centers:
        raise ValueError("volume: expected cylinders in at least one slab, got none")
    steps = np.diff(np.array(centers), axis=1)
    return Cylinders(np.array(diameters), np.linalg.norm(steps, axis=2))


def _circle(
    values: np.ndarray, known: np.ndarray, place: list[float], radius: float
) -> tuple[float, float, float] | None:
    """Column, row and radius of the circle near `place`, voxels; None if its window is cut off."""
    reach = int(np.ceil(_REACH * radius)) + 1
    column, row = (round(v) for v in place)
    top, left = row - reach, column - reach
    if top < 0 or left < 0 or row + reach >= values.shape[0] or column + reach >= values.shape[1]:
        return None
    window = (slice(top, row + reach + 1), slice(left, column + reach + 1))
    rows, columns = np.nonzero(known[window])
    gray = values[window][rows, columns].astype(np.float64)
    if len(gray) < 16:
        return None
    x, y = place[0] - left, place[1] - top
    best = (-np.inf, 0.0)
    step = 0.5 * radius
    while step > 0.02:  # a finer and finer search around the best center
        tried = [(x + i * step, y + j * step) for i in (-1, 0, 1) for j in (-1, 0, 1)]
        splits = [_split(columns - u, rows - v, gray, radius) for u, v in tried]
        found = max(range(len(tried)), key=lambda k: splits[k][0])
        if splits[found][0] > best[0]:
            best, (x, y) = splits[found], tried[found]
        if found == 4 or splits[found][0] <= best[0]:
            step /= 2
    return x + left, y + top, _radius(columns - x, rows - y, gray, best[1])


def _radius(x: np.ndarray, y: np.ndarray, gray: np.ndarray, about: float) -> float:
    """The radius of the disc that, in the gray of the core, explains the missing sum of grays.

    Blur and speckle change the edge, but not the sum.
    """
    distance = np.hypot(x, y)
    core, around = distance < 0.6 * about, distance > 1.3 * about
    if not core.any() or not around.any():
        return about
    inside, outside = gray[core].mean(), gray[around].mean()
    if inside == outside:
        return about
    missing = ((outside - gray[~around]) / (outside - inside)).sum()
    return float(np.sqrt(max(missing, 0.0) / np.pi))


def _split(x: np.ndarray, y: np.ndarray, gray: np.ndarray, expected: float) -> tuple[float, float]:
    """Variance between inside and outside of the best circle around 0, and its radius."""
    distance = np.hypot(x, y)
    order = np.argsort(distance, kind="stable")
    distance, gray = distance[order], gray[order]
    inside = np.arange(1, len(gray))
    sums = np.cumsum(gray)[:-1]
    between = (sums / inside - (gray.sum() - sums) / (len(gray) - inside)) ** 2
    between *= inside * (len(gray) - inside)
    allowed = (distance[1:] > 0.4 * expected) & (distance[:-1] < 1.7 * expected)
    if not allowed.any():
        return -np.inf, 0.0
    k = int(np.argmax(np.where(allowed, between, -1)))
    return float(between[k]), float(np.sqrt((k + 1) / np.pi))
