"""Volume and area of spheres: in closed form where no three of them meet, else by points on and in
each of them."""

from __future__ import annotations

import math

import numpy as np

_POINTS, _FEWEST = 4e6, 256  # on all spheres together; on each at least
_MOST_TESTS, _BLOCK = 4e9, 4e6  # of a point against a sphere, in all and at a time


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


def sampled_union(centers: np.ndarray, radii: np.ndarray) -> tuple[float, float, float, float] | None:
    """The volume of the union of any spheres, its error, the area and its error; None for spheres
    that overlap so much that it would take long.

    Of a sphere counts the share of points on it that no other covers, and of each point in it one
    divided by the number of spheres that cover it. The points are even (Fibonacci), and turned at
    random from sphere to sphere, so that errors do not add up. The errors stated are two standard
    errors, from quarters of the points: too large rather than too small.
    """
    centers, radii = centers.astype(np.float64), radii.astype(np.float64)
    i, j, _ = _pairs(centers, radii)
    a, b = np.concatenate([i, j]), np.concatenate([j, i])
    order = np.argsort(a, kind="stable")
    a, b = a[order], b[order]
    n = 4 * int(np.clip(_POINTS / len(radii), _FEWEST, _POINTS / 8) / 4)
    if n * len(a) > _MOST_TESTS:
        return None
    from scipy.spatial.transform import Rotation

    k = np.arange(n)
    polar = 1 - (2 * k + 1) / n
    around, ring = k * np.pi * (3 - 5**0.5), np.sqrt(1 - polar**2)
    on = np.stack([ring * np.cos(around), ring * np.sin(around), polar], axis=1)
    depth = np.cbrt((k * 2**0.5 + 0.5) % 1)  # of the points in the ball
    turns = Rotation.random(len(radii), rng=np.random.default_rng(0)).as_matrix()
    ends = np.searchsorted(a, np.arange(len(radii) + 1))
    shares = np.ones((2, 4, len(radii)))
    step = max(1, int(_BLOCK / (n * max(1.0, len(a) / len(radii)))))
    for first in range(0, len(radii), step):
        mine = slice(ends[first], ends[min(first + step, len(radii))])
        own, other = a[mine], b[mine]
        met, begins = np.unique(own, return_index=True)
        if not len(met):
            continue
        axis = np.einsum("pij,pj->pi", turns[own], centers[other] - centers[own]) / radii[own, None]
        reach = (radii[other] / radii[own]) ** 2 - np.square(axis).sum(axis=1)
        along = 2 * on @ axis.T
        slack = np.where(other < own, 1e-9, -1e-9)  # of two that are the same, one counts
        bare = ~np.logical_or.reduceat(1 - along <= reach + slack, begins, axis=1)
        held = np.add.reduceat(depth[:, None] ** 2 - depth[:, None] * along <= reach, begins, axis=1, dtype=np.int32)
        for row, values in zip(shares, (bare, 1 / (1 + held)), strict=True):
            row[:, met] = values.reshape(-1, 4, len(met)).mean(axis=0)
    found: list[float] = []
    for row, whole in zip(shares[::-1], (4 / 3 * np.pi * radii**3, 4 * np.pi * radii**2), strict=True):
        error = 2 * np.sqrt(np.sum((whole * row.std(axis=0, ddof=1)) ** 2) / 4)
        found += [float(np.sum(whole * row.mean(axis=0))), float(error)]
    return found[0], found[1], found[2], found[3]


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
