"""The float64 reference by brute force: slow, obvious; everything else is tested against it."""

from typing import Any

import numpy as np
from globule.scene.scene import KERNELS

from .library import call


def _particles(positions: Any, support: Any, weight: Any) -> tuple:
    """Positions, matrices (N, 6) and weights; `support` may hold matrices G (N, 3, 3) instead."""
    p = np.ascontiguousarray(positions, np.float32).reshape(-1, 3)
    n = len(p)
    # float32 first: what the fast paths are given.
    support = np.asarray(support, np.float32).astype(np.float64)
    if support.ndim == 3:
        a = np.ascontiguousarray(support[:, (0, 1, 2, 0, 0, 1), (0, 1, 2, 1, 2, 2)])
    else:
        a = np.zeros((n, 6))
        a[:, :3] = np.divide(1, support, out=np.zeros_like(support), where=support > 0).reshape(-1, 1)
    return p, a, np.ascontiguousarray(np.broadcast_to(np.asarray(weight, np.float32), n), np.float64)


def field(positions: Any, support: Any, weight: Any, kernel: str, points: Any) -> tuple[np.ndarray, np.ndarray]:
    p, a, w = _particles(positions, support, weight)
    x = np.ascontiguousarray(points, np.float64)
    value, gradient = np.empty(len(x)), np.empty((len(x), 3))
    call("oracle_field", len(p), p, a, w, KERNELS.index(kernel), len(x), x, value, gradient)
    return value, gradient


def first_hit(
    positions: Any, support: Any, weight: Any, kernel: str, threshold: float, origins: Any, directions: Any
) -> np.ndarray:
    """Smallest t >= 0 at which the field along o + t d is the threshold, float64; inf: none."""
    p, a, w = _particles(positions, support, weight)
    o = np.ascontiguousarray(origins, np.float32).reshape(-1, 3)
    d = np.ascontiguousarray(directions, np.float32).reshape(-1, 3)
    t = np.empty(len(o))
    call("oracle_first_hit", len(p), p, a, w, KERNELS.index(kernel), float(np.float32(threshold)), len(o), o, d, t)
    return t


def mesh_first_hit(vertices: Any, faces: Any, origins: Any, directions: Any) -> tuple[np.ndarray, ...]:
    """Distance, face and nearness to an edge of the first hits on triangles, each (M,)."""
    v, f = np.ascontiguousarray(vertices, np.float32), np.ascontiguousarray(faces, np.uint32)
    o, d = np.ascontiguousarray(origins, np.float32), np.ascontiguousarray(directions, np.float32)
    t, face, edge = np.empty(len(o)), np.empty(len(o), np.uint32), np.empty(len(o))
    call("oracle_mesh_first_hit", v, len(f), f, len(o), o, d, t, face, edge)
    return t, face, edge


def neighbors(positions: Any, points: Any, radius: float) -> list[np.ndarray]:
    """Indices within `radius` (inclusive) of each point, ascending, by comparing with all."""
    p, r2 = np.asarray(positions, np.float64), float(np.float32(radius)) ** 2
    return [np.nonzero(((p - x) ** 2).sum(1) <= r2)[0] for x in np.asarray(points, np.float64)]
