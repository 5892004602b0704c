"""Particles in another unit of length."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from .._base.checks import positive
from .particles import Particles
from .radii import length_name

LENGTHS = ("radius", "pscale", "diameter", "smoothing_length", "h")  # attributes, by `length_name`


def scaled(particles: Particles, factor: float) -> Particles:
    """The particles with all lengths times a factor: positions, origin, support, kernels, and the
    attributes of `LENGTHS`. Others, velocities too, stay in the file's units.

    Raises ValueError for a factor that is not above 0.
    """
    factor = positive("scale", factor)
    if factor == 1:
        return particles
    attributes = {
        name: (array * factor).astype(array.dtype if array.dtype.kind == "f" else np.float64)
        if length_name(name) in LENGTHS
        else array
        for name, array in particles.attributes.items()
    }
    fields = {"positions": np.float32(particles.positions * np.float64(factor))}
    if particles.support is not None:
        fields["support"] = particles.support * np.float32(factor)
    if particles.anisotropy is not None:
        fields["anisotropy"] = particles.anisotropy / np.float32(factor)
    x, y, z = (factor * place for place in particles.origin)
    return replace(particles, **fields, attributes=attributes, origin=(x, y, z))
