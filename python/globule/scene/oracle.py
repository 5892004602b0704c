"""The float64 reference by brute force: slow, obvious; everything else is tested against it."""

from __future__ import annotations

from typing import Any

import numpy as np

from .. import _core
from .._base.arrays import address
from .scene import KERNELS


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
    w = np.ascontiguousarray(np.broadcast_to(np.asarray(weight, np.float32), n), np.float64)
    return p, a, w


def field(positions: Any, support: Any, weight: Any, kernel: str, points: Any) -> tuple[np.ndarray, np.ndarray]:
    """Field (M,) and gradient (M, 3), float64."""
    p, a, w = _particles(positions, support, weight)
    x = np.ascontiguousarray(points, np.float64)
    value, gradient = np.empty(len(x)), np.empty((len(x), 3))
    _core.oracle_field(
        len(p),
        address(p),
        address(a),
        address(w),
        KERNELS.index(kernel),
        len(x),
        address(x),
        address(value),
        address(gradient),
    )
    return value, gradient


def first_hit(
    positions: Any, support: Any, weight: Any, kernel: str, threshold: float, origins: Any, directions: Any
) -> np.ndarray:
    """Smallest t >= 0 at which the field along o + t d is the threshold, float64; inf: none."""
    p, a, w = _particles(positions, support, weight)
    o = np.ascontiguousarray(origins, np.float32).reshape(-1, 3)
    d = np.ascontiguousarray(directions, np.float32).reshape(-1, 3)
    t = np.empty(len(o))
    _core.oracle_first_hit(
        len(p),
        address(p),
        address(a),
        address(w),
        KERNELS.index(kernel),
        float(np.float32(threshold)),
        len(o),
        address(o),
        address(d),
        address(t),
    )
    return t


def neighbors(positions: Any, points: Any, radius: float) -> list[np.ndarray]:
    """Indices within `radius` (inclusive) of each point, ascending, by comparing with all."""
    p = np.asarray(positions, np.float64)
    r2 = float(np.float32(radius)) ** 2
    return [np.nonzero(((p - x) ** 2).sum(1) <= r2)[0] for x in np.asarray(points, np.float64)]
