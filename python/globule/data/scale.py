"""Particles in another unit of length."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from .._base.checks import positive
from .particles import Particles
from .radii import length_name, length_names

LENGTHS = ("radius", "pscale", "diameter", "smoothing_length", "h")  # attributes, by `length_name`


def lengths_of(particles: Particles) -> set[str]:
    """The names of attributes that are lengths."""
    found = length_names(particles.attributes, particles.positions)
    known = {found[kind] for kind in LENGTHS if kind in found}
    return known | {name for name in particles.attributes if length_name(name) in LENGTHS}


def scaled(particles: Particles, factor: float) -> Particles:
    """The particles with all lengths times a factor: positions, origin, support, kernels, and the
    attributes of `LENGTHS`. Others, velocities too, stay in the file's units.

    Raises ValueError for a factor that is not above 0.
    """
    factor = positive("scale", factor)
    if factor == 1:
        return particles
    lengths = lengths_of(particles)
    attributes = {
        name: (array * factor).astype(array.dtype if array.dtype.kind == "f" else np.float64)
        if name in lengths
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
