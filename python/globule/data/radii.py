"""The radii of particles that are spheres."""

from __future__ import annotations

import re
from collections.abc import Iterable

import numpy as np

from .._base.arrays import to_host
from .particles import Particles

_NAMES = {"radius": 1.0, "pscale": 1.0, "diameter": 0.5}  # in lower case, by radii
_SAME = {"radii": "radius", "particleradius": "radius", "particleradii": "radius",
         "diameters": "diameter", "particlediameter": "diameter"}  # fmt: skip


def length_name(name: str) -> str:
    """The name of an array of lengths in lower case; that of `Radii` and `Particle Radius` is
    radius."""
    return _SAME.get(re.sub(r"[^a-z]", "", name.lower()), name.lower())


def length_names(names: Iterable[str]) -> dict[str, str]:
    """Names by `length_name`; of several with one, the first, or one that has it itself. OpenFOAM's
    clouds, which origProcId tells, call their diameters d."""
    found = list(names)[::-1]
    known = {"diameter": "d"} if {"origProcId", "d"} <= set(found) else {}
    return known | {length_name(name): name for name in found} | {name.lower(): name for name in found}


def find_radii(particles: Particles) -> np.ndarray | None:
    """Radii (N,) float32, world units, from the attribute `radius`, `pscale` or `diameter`; None
    where the particles have none, one that is negative or not finite, or none above 0."""
    by_lower_name = length_names(particles.attributes)
    for lower, factor in _NAMES.items():
        if lower not in by_lower_name:
            continue
        values = to_host(particles.attributes[by_lower_name[lower]])
        if values.ndim > 1 and values.shape[1:] == (1,):
            values = values[:, 0]
        if values.ndim != 1 or values.dtype.kind not in "iuf" or not len(values):
            continue
        with np.errstate(over="ignore"):
            radii = (factor * values).astype(np.float32)
        if np.isfinite(radii).all() and (radii >= 0).all() and radii.any():
            return radii
    return None


def with_halved_radii(particles: Particles) -> Particles:
    """The particles of a file whose radii are diameters, and whose support, where it follows from
    them, is twice too large; as they are without an attribute `radius` or `pscale`, or where the
    file's diameters are beside.
    """
    if any(length_name(n) == "diameter" for n in particles.attributes):
        return particles
    name = next((n for n in particles.attributes if length_name(n) in ("radius", "pscale")), None)
    if name is None:
        return particles
    radii, support = particles.attributes[name], particles.support
    halved = particles[:]
    halved.attributes = {**particles.attributes, name: radii / 2}
    if support is not None and np.array_equal(support, 4 * radii.astype(np.float32)):
        halved.support = support / 2
    return halved
