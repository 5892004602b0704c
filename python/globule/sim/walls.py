"""Boxes around fluids: their walls' particles, and the box of particles that came without one."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..scene.particles import Particles
from ..scene.spacing import local_spacing
from .sampling import BEHIND, FACES, shell


def box_walls(lo: Any, hi: Any, spacing: float, periodic: Any = (False,) * 3) -> np.ndarray:
    """One layer of particles half a spacing outside of a box's faces: (M, 3) float32.

    Along a periodic axis the layer has no end, and no face closes it.
    """
    lo, hi = np.asarray(lo, float), np.asarray(hi, float)
    n = np.maximum(np.rint((hi - lo) / spacing - 1e-6).astype(int), 1)
    beyond = np.where(periodic, 0, 1)
    faces = [face for face in FACES if not periodic["xyz".index(face[1])]]
    index = shell(n + 2 * beyond, faces) - beyond
    return np.ascontiguousarray(lo + (index + 0.5) * ((hi - lo) / n), np.float32)


def of_particles(particles: Particles) -> dict[str, Any]:
    """A fluid in its own box, with as much room again above it: a full box leaves none to flow."""
    d = float(np.median(local_spacing(particles.positions, k=3)))
    lo, hi = (corner.astype(float) for corner in particles.bounds())
    hi[1] += hi[1] - lo[1] + d
    # Where a lattice that touches the walls is at rest: they stand half a spacing outside.
    edge = BEHIND * d
    return {"spacing": d, "domain": (lo - edge, hi + edge)}
