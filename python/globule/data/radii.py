"""The radii of particles that are spheres."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

import numpy as np

from .._base.arrays import to_host
from .particles import Particles

_NAMES = {"radius": 1.0, "pscale": 1.0, "diameter": 0.5}  # in lower case, by radii
_SAME = {"radii": "radius", "diameters": "diameter", "diam": "diameter", "dia": "diameter", "rad": "radius"}
_OF = re.compile(r"^(?:particle|parcel|ball|sphere|grain|bead|equivalent|equiv|eq|physical)+")
# Words that may mean something else, by letters and digits: radii where the values may be some.
_SHORT = {"r": "radius", "rp": "radius", "rad": "radius", "dp": "diameter", "particlesize": "diameter"}
_UNIT = re.compile(r"[ _.](?:nm|um|mm|cm|m)$")  # behind a name: radius_m
_NOT_RADIUS = {"g", "b", "green", "theta", "phi"}  # beside r: colors, or other coordinates


def length_name(name: str) -> str:
    """The name of an array of lengths in lower case; that of `Radii` and `Particle Radius` is
    radius."""
    word = re.sub(r"[^a-z]", "", _UNIT.sub("", name.lower()))
    plain = _OF.sub("", word)
    if plain in _NAMES and (plain != word or _UNIT.search(name.lower())):
        return plain
    return _SAME[plain] if plain in _SAME and word != "rad" else name.lower()


def may_be_length(name: str) -> bool:
    """Whether an array of this name is one of sizes where its values may be some."""
    return _letters(name) in _SHORT


def _letters(name: str) -> str:
    return re.sub(r"[^a-z0-9]", "", name.lower())


def length_names(arrays: Mapping[str, Any], positions: Any) -> dict[str, str]:
    """Names of arrays (N,) of particles at positions (N, 3) by `length_name`; of several with one,
    the first, or one that has it itself.

    `r`, `rad`, `d_p`, `Dp` and `Particle Size` are sizes where no array has a longer name for them, and
    the values may be some. OpenFOAM's clouds, which origProcId tells, call their diameters d.
    """
    names = list(arrays)[::-1]
    known = {length_name(name): name for name in names} | {name.lower(): name for name in names}
    if not known.keys() & {*_NAMES, "h", "smoothing_length"}:
        if {"origProcId", "d"} <= known.keys() | arrays.keys():
            return known | {"diameter": "d"}
        for name in names:
            kind = _SHORT.get(_letters(name))
            if kind and not known.keys() & _NOT_RADIUS and _may_be_sizes(to_host(arrays[name]), positions):
                known[kind] = name
    return known


def _may_be_sizes(values: Any, positions: Any) -> bool:
    """Whether values (N,) may be radii of particles: above 0, smaller than what the particles
    extend over, and not their distances from the origin or from an axis."""
    x = to_host(positions)
    if values.ndim != 1 or values.dtype.kind not in "iuf" or len(values) != len(x) or not len(x):
        return False
    there = np.isfinite(values) & np.isfinite(x).all(axis=1)
    values, x = values[there], x[there]
    if not ((values >= 0).all() and values.any()):
        return False
    if len(x) > 1 and np.median(values) > np.ptp(x, axis=0).max():
        return False
    x = x[:1000].astype(np.float64)
    axes = ([0, 1, 2], [0, 1], [0, 2], [1, 2], [0], [1], [2])
    distances = [np.linalg.norm(x[:, some], axis=1) for some in axes if max(some) < x.shape[1]]
    return len(x) < 2 or not any(np.allclose(values[:1000], d, rtol=1e-3) for d in distances)


def sizes_of(values: np.ndarray) -> np.ndarray | None:
    """The values as float32, 0 for those that are negative or not finite; None where none is above 0."""
    with np.errstate(over="ignore", invalid="ignore"):
        sizes = np.asarray(values).astype(np.float32)
        if sizes.size and sizes.min() >= 0 and np.isfinite(most := sizes.max()):  # fast, of most files
            return sizes if most > 0 else None
        sizes = np.where(np.isfinite(sizes) & (sizes > 0), sizes, np.float32(0))
    return sizes if sizes.any() else None


def find_radii(particles: Particles, of_all: bool = True) -> np.ndarray | None:
    """Radii (N,) float32, world units, from the attribute `radius`, `pscale` or `diameter`, 0 for
    those that are negative or not finite; None where no particle has one above 0.

    of_all: whether these are all particles; of a range, all radii may be 0."""
    found = _radii_of(particles, of_all)
    if found is None:
        return None
    radii = sizes_of(found[1] * found[0])
    return np.zeros(len(particles), np.float32) if radii is None else radii


def n_without_radius(particles: Particles) -> int:
    """How many particles have a negative radius or none that is finite, where others have radii."""
    found = _radii_of(particles)
    if found is None or (found[1].min() >= 0 and np.isfinite(found[1].max())):
        return 0
    return int(np.count_nonzero(~(np.isfinite(found[1]) & (found[1] >= 0))))


def _radii_of(particles: Particles, of_all: bool = True) -> tuple[float, np.ndarray] | None:
    """A factor, and the array (N,) that gives radii times it; None where no value is above 0."""
    by_lower_name = length_names(particles.attributes, particles.positions)
    for lower, factor in _NAMES.items():
        if lower not in by_lower_name:
            continue
        values = to_host(particles.attributes[by_lower_name[lower]])
        if values.ndim > 1 and values.shape[1:] == (1,):
            values = values[:, 0]
        if values.ndim != 1 or values.dtype.kind not in "iuf" or not len(values):
            continue
        if not of_all or sizes_of(values) is not None:
            return factor, values
    return None


def with_halved_radii(particles: Particles) -> Particles:
    """The particles of a file whose radii are diameters, and whose support, where it follows from
    them, is twice too large; as they are without an attribute `radius` or `pscale`, or where the
    file's diameters are beside.
    """
    known = length_names(particles.attributes, particles.positions)
    name = known.get("radius", known.get("pscale"))
    if name is None or "diameter" in known:
        return particles
    radii, support = particles.attributes[name], particles.support
    halved = particles[:]
    halved.attributes = {**particles.attributes, name: radii / 2}
    if support is not None and (sizes := sizes_of(radii)) is not None and np.array_equal(support, 4 * sizes):
        halved.support = support / 2
    return halved
