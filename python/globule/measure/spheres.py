"""Volume and area of spheres, in closed form where no three of them meet."""

from __future__ import annotations

import math

import numpy as np


def union_of_spheres(centers: np.ndarray, radii: np.ndarray) -> tuple[float, float] | None:
    """The volume and the area of the union of spheres; None where three of them have a common
    point.

    The lens of two spheres counts once, a sphere inside another one not at all. Three have no
    common point where their caps on each of them are apart.

    Args:
        centers: (N, 3) finite, world.
        radii: (N,) world units, > 0.
    """
    centers, radii = centers.astype(np.float64), radii.astype(np.float64)
    i, j, d = _pairs(centers, radii)
    covered = d <= np.abs(radii[i] - radii[j])
    if covered.any():
        kept = np.ones(len(radii), bool)
        kept[np.where(radii[i] < radii[j], i, j)[covered]] = False
        centers, radii = centers[kept], radii[kept]
        i, j, d = _pairs(centers, radii)
    both = np.concatenate([i, j]), np.concatenate([j, i])
    d, (a, b) = np.concatenate([d, d]), both
    height = radii[a] - (d * d + radii[a] ** 2 - radii[b] ** 2) / (2 * d)  # of the cap of a in b
    if _caps_meet(centers, radii, a, b, np.arccos(np.clip(1 - height / radii[a], -1, 1))):
        return None
    volume = 4 / 3 * math.pi * np.sum(radii**3)
    volume -= np.sum(math.pi * height**2 * (3 * radii[a] - height)) / 3
    area = 4 * math.pi * np.sum(radii**2) - 2 * math.pi * np.sum(radii[a] * height)
    return float(volume), float(area)


def _pairs(centers: np.ndarray, radii: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Overlapping spheres i < j once, and the distance of their centers."""
    from scipy.spatial import cKDTree

    tree = cKDTree(centers)
    first, second = [np.empty(0, np.int64)], [np.empty(0, np.int64)]
    for begin in range(0, len(centers), 1 << 14):
        rows = np.arange(begin, min(begin + (1 << 14), len(centers)))
        near = tree.query_ball_point(centers[rows], 2 * radii[rows])  # all smaller ones
        first.append(np.repeat(rows, [len(n) for n in near]))
        second.append(np.concatenate([np.asarray(n, np.int64) for n in near]))
    a, b = np.concatenate(first), np.concatenate(second)
    smaller = (radii[b] < radii[a]) | ((radii[b] == radii[a]) & (a < b))
    a, b = a[smaller], b[smaller]
    d = np.linalg.norm(centers[a] - centers[b], axis=1)
    meet = d < radii[a] + radii[b]
    return a[meet], b[meet], d[meet]


def _caps_meet(centers: np.ndarray, radii: np.ndarray, a: np.ndarray, b: np.ndarray, angle: np.ndarray) -> bool:
    """Whether two caps on one sphere have a common point. a, b: each pair both ways; angle: (P,)
    between the axis of the cap on `a` and its rim."""
    order = np.argsort(a, kind="stable")
    a, b, angle = a[order], b[order], angle[order]
    axis = centers[b] - centers[a]
    axis /= np.linalg.norm(axis, axis=1, keepdims=True)
    counts = np.bincount(a, minlength=len(radii))
    for step in range(1, int(counts.max(initial=0))):
        same = a[step:] == a[:-step]
        cosine = np.einsum("ij,ij->i", axis[step:], axis[:-step])[same]
        between = np.arccos(np.clip(cosine, -1, 1))
        if (between < (angle[step:] + angle[:-step])[same]).any():
            return True
    return False
