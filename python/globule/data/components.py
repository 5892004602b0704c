"""Connected components: particles that belong together by their distances."""

from __future__ import annotations

import numpy as np

from .._base.arrays import to_host
from .._base.checks import whole
from .particles import FARTHEST, Particles

JOINED = 1.5  # spacings: a lattice's neighbors along edges and diagonals of faces, and no farther
SAMPLES = 2000  # particles at which the spacing is measured


def component_sizes(particles: Particles) -> np.ndarray:
    """(N,) int64, how many particles the component of each one has; 0 without a finite position.

    Two particles are in one component if they, or others between them, are at most 1.5 spacings
    apart. The spacing is the median distance to the two nearest particles.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import cKDTree

    positions = to_host(particles.positions)
    sizes = np.zeros(len(positions), np.int64)
    inside = np.flatnonzero((np.abs(positions) <= FARTHEST).all(axis=1))
    n = len(inside)
    if n < 2:
        sizes[inside] = 1
        return sizes
    points = positions[inside].astype(np.float64)
    tree = cKDTree(points)
    nearest, _ = tree.query(points[:: 1 + n // SAMPLES], min(n, 3))
    pairs = tree.query_pairs(JOINED * float(np.median(nearest[:, 1:])), output_type="ndarray")
    graph = coo_array((np.ones(len(pairs), bool), (pairs[:, 0], pairs[:, 1])), (n, n))
    _, which = connected_components(graph, directed=False)
    sizes[inside] = np.bincount(which)[which]
    return sizes


def without_small_components(particles: Particles, least: int) -> tuple[Particles, str]:
    """The particles in components of at least so many, and what to say of the others; "" if there
    are none. Raises ValueError for a number below 1."""
    whole("min_component", least, 1, 2**31)
    sizes = component_sizes(particles)
    small = sizes[sizes < least]
    if not len(small):
        return particles, ""
    n = round(float((1 / small[small > 0]).sum()))
    what = f"{n:,} component{'s' * (n != 1)} of fewer than {least:,} particles"
    return particles[sizes >= least], f"{what} left out: {len(small):,} of {len(sizes):,} particles"
