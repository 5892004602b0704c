"""How far apart particles are, one number a particle: by near neighbors, or along a mesh's edges.

The spacing that `Scene` measures is one median for all. Where the density varies, as on a mesh's
vertices, each particle needs its own, so that the surface closes where the particles are far apart
and keeps its detail where they are near.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from .. import _core
from .particles import FARTHEST

BLOCK = 1 << 16  # points whose neighbors are looked for between two calls of progress
# Spacings are kept within these multiples of their median, so that the supports made of them stay
# within the factor of 1e6 that a scene allows, whatever lies apart or on top of each other.
LEAST, MOST = 2e-3, 500.0
FEW = 1000  # particles: fewer are tessellated, as in src/api/spacing.cpp
_MIX = np.array([0x9E3779B97F4A7C15, 0xC2B2AE3D27D4EB4F, 0x165667B19E3779F9], np.uint64)


def neighbor_spacing(
    positions: np.ndarray, k: int = 6, progress: Callable[[int, int], object] | None = None
) -> np.ndarray:
    """Mean distance (N,) float32 of each of the positions (N, 3) to its k nearest neighbors, as
    `globule.fluids.measure_spacing`, which says more."""
    from scipy.spatial import cKDTree

    result = np.full(len(positions), np.nan)
    inside = (np.abs(positions) <= FARTHEST).all(axis=1)
    first, which = merge_coincident(positions[inside])
    distinct = positions[inside][first].astype(np.float64)
    n, k = len(distinct), min(k, len(distinct) - 1)
    if k < 1:
        return np.ones(len(positions), np.float32)
    tree, nearest = cKDTree(distinct), np.empty(n)
    for begin in range(0, n, BLOCK):
        block = distinct[begin : begin + BLOCK]
        distance, _ = tree.query(block, k + 1)  # the first is the point itself
        nearest[begin : begin + len(block)] = distance[:, 1:].mean(axis=1)
        if progress:
            progress(begin + len(block), n)
    result[inside] = nearest[which]
    return within_limits(result)


def axes_of(positions: np.ndarray) -> np.ndarray:
    """Orthonormal axes (D, 3), the longest first, of the line, plane or space that holds finite
    positions (N, 3); none where all are at one place. One particle far away does not make the
    others flat."""
    positions = np.ascontiguousarray(positions, np.float32)
    return np.array(_core.axes_of(positions.ctypes.data, len(positions)))


def normal_of(positions: np.ndarray) -> np.ndarray | None:
    """Unit normal (3,) of the plane that holds finite positions (N, 3), if there is one; towards an
    eye that sees the plane's x, or else its y, point to the right, with z or else y upwards."""
    axes = axes_of(positions)
    if len(axes) != 2:
        return None
    normal = np.cross(*axes)
    normal[np.abs(normal) < 1e-6] = 0.0
    normal /= np.linalg.norm(normal)
    right = np.cross(upwards(normal), normal)
    return normal if right[np.argmax(np.abs(right))] > 0 else 0.0 - normal


def upwards(normal: np.ndarray) -> tuple[int, int, int]:
    """What is upwards in an image along the normal of a plane."""
    return (0, 1, 0) if abs(normal[2]) > 0.9 else (0, 0, 1)


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
