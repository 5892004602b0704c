"""Values of particles by name: axes, fields and attributes, and components of vectors."""

from __future__ import annotations

import re
from typing import Any

import numpy as np

from .._base.arrays import to_host
from .particles import SCALAR_FIELDS, Particles


def attribute_names(particles: Particles) -> list[str]:
    """All names that `attribute_values` knows, without components."""
    return list(_arrays(particles))


def attribute_values(particles: Particles, name: str) -> np.ndarray:
    """The values (N,) float64 that `name` stands for: x y z, a field, an attribute (a vector's
    length), or NAME:0 … for a component.

    Raises ValueError that says which names there are.
    """
    arrays = _arrays(particles)
    if name in arrays:
        array = np.asarray(to_host(arrays[name]), np.float64)
        return array if array.ndim == 1 else _lengths(array)
    stem, _, index = name.rpartition(":")
    if stem in arrays and arrays[stem].ndim == 2 and re.fullmatch(r"\d{1,4}", index):
        k = arrays[stem].shape[1]
        if int(index) >= k:
            raise ValueError(f"expected {stem}:0 to {stem}:{k - 1}, got {name}")
        return np.asarray(to_host(arrays[stem]), np.float64)[:, int(index)]
    raise ValueError(f"expected one of {', '.join(arrays)}, got {name}")


def _arrays(particles: Particles) -> dict[str, Any]:
    positions = to_host(particles.positions)
    arrays: dict[str, Any] = {axis: positions[:, i] for i, axis in enumerate("xyz")}
    for field in SCALAR_FIELDS:
        value = getattr(particles, field)
        if value is not None:
            arrays[field] = np.broadcast_to(to_host(value), len(particles))
    return arrays | particles.attributes


def _lengths(array: np.ndarray) -> np.ndarray:
    """Rows' lengths, without overflow; NaN stays NaN."""
    largest = np.abs(array).max(axis=1, initial=0.0)
    scale = np.where(np.isfinite(largest) & (largest > 0), largest, 1.0)
    with np.errstate(invalid="ignore"):
        return scale * np.sqrt(np.square(array / scale[:, None]).sum(axis=1))
