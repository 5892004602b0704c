"""How far apart particles are, of whatever has particles."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from .._base.arrays import to_host
from .._base.checks import whole
from ..data.particles import Particles
from ..data.spacing import neighbor_spacing
from ..scene.sources import as_particles

if TYPE_CHECKING:
    from numpy.typing import ArrayLike


def measure_spacing(
    positions: Particles | ArrayLike, k: int = 6, progress: Callable[[int, int], object] | None = None
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
    return neighbor_spacing(to_host(as_particles("positions", positions).positions), k, progress)
