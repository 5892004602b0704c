"""How far apart particles are, one number a particle: by near neighbors, or along a mesh's edges.

The spacing that `Scene` measures is one median for all. Where the density varies, as on a mesh's
vertices, each particle needs its own, so that the surface closes where the particles are far apart
and keeps its detail where they are near.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from .._base.arrays import to_host
from .._base.checks import whole
from .particles import FARTHEST, Particles
from .scene import Scene
from .sources import as_particles

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

BLOCK = 4096  # points whose neighbors are looked at together: bounds the memory
# Spacings are kept within these multiples of their median, so that the supports made of them stay
# within the factor of 1e6 that a scene allows, whatever lies apart or on top of each other.
LEAST, MOST = 2e-3, 500.0
_MIX = np.array([0x9E3779B97F4A7C15, 0xC2B2AE3D27D4EB4F, 0x165667B19E3779F9], np.uint64)


def local_spacing(
    positions: Particles | ArrayLike,
    k: int = 6,
    progress: Callable[[int, int], object] | None = None,
) -> np.ndarray:
    """Mean distance of each particle to its k nearest neighbors, without particles at the same
    position.

    Args:
        positions: (N, 3) float32, world, or `Particles`. Particles whose position is not finite get
            the median.
        k: number of neighbors, at least 1; fewer if the set has fewer particles.
        progress: called as progress(done, total) with counts of particles; may raise to stop.

    Returns:
        (N,) float32, world units, > 0, within 0.002 to 500 times the median.
    """
    k = whole("k", k, 1, 2**31)
    positions = to_host(as_particles("positions", positions).positions)
    result = np.full(len(positions), np.nan)
    inside = (np.abs(positions) <= FARTHEST).all(axis=1)
    first, which = merge_coincident(positions[inside])
    distinct = positions[inside][first]
    n, k = len(distinct), min(k, len(distinct) - 1)
    if k < 1:
        return np.ones(len(positions), np.float32)
    scene = Scene(distinct, device="cpu", key_bits=64)
    _, order = scene.octree.sorted_keys(n)
    points = distinct[order]

    nearest, done = np.empty(n), 0
    exponent = np.frexp(_bound(points, k))[1]  # bound < 2^exponent: few radii serve all points
    for e in np.unique(exponent):
        rows = np.flatnonzero(exponent == e)
        for begin in range(0, len(rows), BLOCK):
            block = rows[begin : begin + BLOCK]
            nearest[order[block]] = _mean_of_nearest(scene, points[block], float(2.0**e), k)
            done += len(block)
            if progress:
                progress(done, n)
    result[inside] = nearest[which]
    return within_limits(result)


def edge_spacing(positions: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Length of the longest edge at each vertex of a triangle mesh.

    No point of a triangle is farther from its nearest corner than 0.58 times its longest edge:
    supports of at least that edge leave no hole (docs/reference/formats.md).

    Args:
        positions: (N, 3) world.
        faces: (F, 3) integers into the positions.

    Returns:
        (N,) float32, world units, > 0; the median where a vertex has no edge of finite length.
    """
    longest = np.zeros(len(positions))
    for a, b in ((0, 1), (1, 2), (2, 0)):
        start, end = faces[:, a], faces[:, b]
        length = np.linalg.norm(positions[start].astype(np.float64) - positions[end], axis=1)
        length[~np.isfinite(length)] = 0.0
        np.maximum.at(longest, start, length)
        np.maximum.at(longest, end, length)
    return within_limits(longest)


def merge_coincident(positions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Points at exactly one place as one: (first, which), so that positions[first] are distinct, in
    their old order, and positions[first][which] are the positions (N, 3) again. A NaN is a place
    of its own."""
    order = np.lexsort(positions.T)
    in_order = positions[order]
    new = np.ones(len(positions), bool)
    new[1:] = (in_order[1:] != in_order[:-1]).any(axis=1)
    first = order[new]  # the sort is stable: each group's lowest index
    rank = np.empty(len(first), np.int64)
    rank[np.argsort(first)] = np.arange(len(first))
    which = np.empty(len(positions), np.int64)
    which[order] = rank[np.cumsum(new) - 1]
    return np.sort(first), which


def n_coincident(positions: np.ndarray, every: int = 1) -> int:
    """How many of the particles (N, 3) lie exactly where one before them does.

    every: only the particles of one place in so many are counted; those of a place all or none.
    """
    bits = (np.asarray(positions, np.float32) + np.float32(0)).view(np.uint32)  # -0 is 0
    # Of a million places, two have the same 64 bits once in 3e7 times.
    hashes = bits.astype(np.uint64) @ _MIX
    if every > 1:
        hashes = hashes[hashes < np.uint64(2**64 // every)]
    hashes.sort()
    return int((hashes[1:] == hashes[:-1]).sum())


def within_limits(spacing: np.ndarray) -> np.ndarray:
    """Spacings (N,) within LEAST to MOST times the median of those > 0, which stands for NaN."""
    known = spacing[spacing > 0]  # NaN is not
    middle = float(np.median(known)) if known.size else 1.0
    filled = np.where(np.isnan(spacing), middle, spacing)
    return np.clip(filled, LEAST * middle, MOST * middle).astype(np.float32)


def _bound(points: np.ndarray, k: int) -> np.ndarray:
    """An upper bound of the distance to the k-th neighbor: the k-th of those that are next in
    Morton order, in which the points (N, 3) come."""
    n = len(points)
    distance = np.full((2 * k, n), np.inf)
    points = points.astype(np.float64)  # squares of float32 may overflow
    for step in range(1, k + 1):
        apart = np.linalg.norm(points[step:] - points[:-step], axis=1)
        distance[step - 1, : n - step] = apart
        distance[k + step - 1, step:] = apart
    return np.partition(distance, k - 1, axis=0)[k - 1]


def _mean_of_nearest(scene: Scene, points: np.ndarray, radius: float, k: int) -> np.ndarray:
    """Mean distance (M,) to the k nearest others, all of which lie within the radius."""
    offsets, index = scene.neighbors(points, radius)
    offsets = offsets.astype(np.int64)
    row = np.repeat(np.arange(len(points)), np.diff(offsets))
    positions = scene.particles.positions
    distance = np.linalg.norm(positions[index].astype(np.float64) - points[row], axis=1)
    by_row = distance[np.lexsort((distance, row))]
    # A row's first entry is the point itself, at 0.
    return by_row[offsets[:-1, None] + np.arange(1, k + 1)].mean(axis=1)
