"""Triangle meshes as metaballs: one at each vertex, or at points all over the triangles.

Pure geometry: `globule.formats.mesh` and `globule.formats.ply` read the files.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from .particles import Particles
from .spacing import edge_spacing, merge_coincident

MOST_SAMPLES = 50_000_000
# Supports in longest edges at a vertex. The field is then 1.3 at the middle of an equilateral
# triangle and 1.1 at the middle of an edge, where the default threshold is 0.6: no holes, and less
# swelling than with the two spacings of particles that fill a volume.
SUPPORT_OF_EDGE = 1.0


def vertex_particles(vertices: Particles, faces: np.ndarray) -> Particles:
    """The vertices that a face uses as metaballs, each support by its longest edge.

    Vertices at one place become one, with the first one's attributes and the mean color. A
    support that the vertices have already is kept.

    Args:
        vertices: N particles.
        faces: (F, 3) integers into them.
    """
    first, which = merge_coincident(vertices.positions)
    merged = vertices[first]
    if vertices.color is not None and vertices.color.ndim == 2:
        merged.color = _mean_by_group(vertices.color, which, len(first))
    faces = which[faces]
    used = np.zeros(len(first), bool)
    used[faces] = True
    if vertices.support is None:
        merged.support = SUPPORT_OF_EDGE * edge_spacing(merged.positions, faces)
    return merged[used]


def sample_triangles(corners: np.ndarray, spacing: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points all over triangles, about `spacing` apart.

    Each triangle is cut into n x n equal parts whose edges are at most sqrt(2) spacings, and each
    part's middle becomes a point: no point lies on an edge, where two triangles would both have it.

    Args:
        corners: (F, 3, 3) world; triangles with a coordinate that is not finite get no points.
        spacing: world units, > 0.

    Returns:
        triangle (M,) int64, barycentric (M, 3) float64, weight (M,) float32: the part's area by
        that of a point in a regular triangular lattice, <= 1, so that slivers and small triangles
        do not swell the surface.

    Raises ValueError for more than 50 million points, naming the spacing that would do.
    """
    sides = corners - np.roll(corners, 1, axis=1)
    longest = np.linalg.norm(sides, axis=2).max(axis=1, initial=0.0)
    area = np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1) / 2
    good = np.isfinite(longest) & (area > 0)
    cuts = np.where(good, np.ceil(longest / (math.sqrt(2) * spacing)), 0)
    n_points = float(np.square(cuts).sum())
    if n_points > MOST_SAMPLES:
        enough = 1.05 * spacing * math.sqrt(n_points / MOST_SAMPLES)
        raise ValueError(
            f"spacing: expected one that makes at most {MOST_SAMPLES:,} points, got {spacing:g} "
            f"for {n_points:,.0f}; try {enough:.3g}"
        )
    triangles, weights = [np.empty(0, np.int64)], [np.empty(0, np.float32)]
    barycentric = [np.empty((0, 3))]
    for n in np.unique(cuts[cuts > 0]).astype(int):
        these = np.flatnonzero(cuts == n)
        parts = _middles_of_parts(n)
        share = area[these] / (n * n) / (math.sqrt(3) / 2 * spacing**2)
        triangles.append(np.repeat(these, len(parts)))
        barycentric.append(np.tile(parts, (len(these), 1)))
        weights.append(np.repeat(share, len(parts)).astype(np.float32))
    return np.concatenate(triangles), np.concatenate(barycentric), np.concatenate(weights)


def sampled_particles(
    corners: np.ndarray, spacing: float, color: Callable[[np.ndarray, np.ndarray], np.ndarray | None]
) -> Particles:
    """Metaballs all over triangles, with a support of two spacings.

    Args:
        corners: (F, 3, 3) world.
        spacing: world units, > 0.
        color: colors (M, 3), or None, of points given as triangle (M,) and barycentric (M, 3).
    """
    triangle, barycentric, weight = sample_triangles(corners, spacing)
    positions = np.einsum("mk,mkc->mc", barycentric, corners[triangle])
    return Particles(positions, support=2 * spacing, weight=weight, color=color(triangle, barycentric))


def _middles_of_parts(n: int) -> np.ndarray:
    """Barycentric coordinates (n * n, 3) of the middles of a triangle's n x n equal parts."""
    i, j = (grid.reshape(-1) for grid in np.meshgrid(np.arange(n), np.arange(n), indexing="ij"))
    upright, inverted = i + j < n, i + j < n - 1
    u = np.concatenate([i[upright] + 1 / 3, i[inverted] + 2 / 3]) / n
    v = np.concatenate([j[upright] + 1 / 3, j[inverted] + 2 / 3]) / n
    return np.stack([u, v, 1 - u - v], axis=1)


def _mean_by_group(values: np.ndarray, which: np.ndarray, n: int) -> np.ndarray:
    """Mean (n, C) of the values (N, C) whose `which` is the same."""
    count = np.bincount(which, minlength=n)
    columns = [np.bincount(which, column, n) / count for column in values.T]
    return np.clip(np.stack(columns, axis=1), 0, 1)
