"""What must be known of particles before they are divided."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from .._base.arrays import to_host
from ..data.attributes import MOST_KINDS, attribute_values, found_kinds
from ..data.particles import Particles
from ..data.radii import find_radii
from ..scene.scene import SPHERE_RADIUS
from .partition import box_of
from .store import Layout, Source, both, layout_of


class Survey(NamedTuple):
    """Facts about the particles of a rank, before those of all ranks are put together."""

    low: np.ndarray  # (3,), of their box
    high: np.ndarray
    values: np.ndarray  # the least and the largest of those that color them
    kinds: dict[float, str]  # of a legend
    reach: list[float]  # typical and largest, by support and by radius
    weight: float  # the smallest
    n: int
    factors: float  # the largest of reflection or refraction
    layout: Layout | None


def survey(source: Source, support: float | None, color: tuple[Any, Any, Any]) -> Survey:
    """The facts about a source's particles. color: name, color map and ends, as for `color_by`."""
    name, colormap, ends = color
    low: np.ndarray = np.full(3, np.inf)
    high: np.ndarray = np.full(3, -np.inf)
    values, reach = np.array([np.inf, -np.inf]), [0.0, 0.0, 0.0, 0.0]  # by support, by radius
    weight, n, factors = np.inf, 0, 0.0
    kinds: dict[float, str] = {}
    layout: Layout | None = None
    for some in source.chunks():
        n += len(some)
        if not len(some):
            continue
        lowest, highest = box_of(to_host(some.positions))
        low, high = np.minimum(low, lowest), np.maximum(high, highest)
        found = layout_of(some, support)
        layout = found if layout is None else both(layout, found)
        if some.weight is not None:
            weight = min(weight, float(np.min(to_host(some.weight))))
        for factor in (some.reflection, some.refraction):
            factors = max(factors, 0.0 if factor is None else float(np.max(to_host(factor))))
        for k, axes in (0, reach_of(some, support)), (2, radii_of(some)):
            if axes is not None:
                reach[k] = max(reach[k], float(np.median(axes)))
                reach[k + 1] = max(reach[k + 1], float(np.max(axes)))
        if name is None:
            continue
        try:
            found_values = attribute_values(some, name)
        except ValueError as error:
            raise ValueError(f"color_by: {error}") from None
        if len(kinds) <= MOST_KINDS:
            kinds |= found_kinds(some, name, colormap)
        if ends is None:
            known = found_values[np.isfinite(found_values)]
            if known.size:
                values = np.array([min(values[0], known.min()), max(values[1], known.max())])
    return Survey(low, high, values, kinds, reach, weight, n, factors, layout)


def reach_of(particles: Particles, support: float | None) -> Any:
    """How far kernels reach: one number or (N,); None where the particles do not say."""
    if particles.anisotropy is not None:
        return 1 / np.linalg.eigvalsh(particles.anisotropy.astype(np.float64))[:, 0]
    return support if support else None if particles.support is None else to_host(particles.support)


def radii_of(particles: Particles) -> Any:
    """How far spheres reach: (N,); None where the particles have no radii."""
    radii = find_radii(particles, of_all=False)
    return None if radii is None else radii / SPHERE_RADIUS
