"""Boxes around fluids: their walls' particles, and the box of particles that came without one."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..particles import Particles
from ..spacing import local_spacing
from .sampling import BEHIND


def box_walls(lo: Any, hi: Any, spacing: float, periodic: Any = (False,) * 3) -> np.ndarray:
    """One layer of particles half a spacing outside of a box's faces: (M, 3) float32.

    Along a periodic axis the layer has no end, and no face closes it.
    """
    lo, hi = np.asarray(lo, float), np.asarray(hi, float)
    n = np.maximum(np.rint((hi - lo) / spacing - 1e-6).astype(int), 1)
    axes, ends = [], []
    for k in range(3):
        step = (hi[k] - lo[k]) / n[k]
        first = 0 if periodic[k] else -1
        i = np.arange(first, n[k] - first)
        axes.append(lo[k] + (i + 0.5) * step)
        ends.append((i < 0) | (i >= n[k]))
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), -1)
    outside = ends[0][:, None, None] | ends[1][None, :, None] | ends[2][None, None, :]
    return np.ascontiguousarray(grid[outside], np.float32)


def of_particles(particles: Particles) -> dict[str, Any]:
    """A fluid in its own box, with as much room again above it: a full box leaves none to flow."""
    d = float(np.median(local_spacing(particles.positions, k=3)))
    lo, hi = (corner.astype(float) for corner in particles.bounds())
    hi[1] += hi[1] - lo[1] + d
    # Where a lattice that touches the walls is at rest: they stand half a spacing outside.
    edge = BEHIND * d
    return {"spacing": d, "domain": (lo - edge, hi + edge)}
