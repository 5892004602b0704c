"""Values of particles by name: axes, fields and attributes, and components of vectors."""

from __future__ import annotations

import logging
import re
from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from .._base.arrays import to_host
from .._base.checks import number, shown
from .._base.colormaps import CATEGORICAL, colorize
from .._base.elements import ELEMENTS
from .particles import SCALAR_FIELDS, Particles

log = logging.getLogger("globule")

# Attributes whose whole numbers are kinds, in lower case.
TYPE_NAMES = ("type", "typeid", "species", "label", "phase", "classification")
ELEMENT_NAMES = ("atomic_number", "element")
MOST_KINDS = 24  # in a legend
# How programs name the array of velocities, in lower case; the first that is there counts.
VELOCITY_NAMES = ("velocity", "velocities", "vel", "velo", "v")


class AttributeColors(NamedTuple):
    """Colors of particles by a value.

    color      (N, 3) float32, linear RGB; gray where the value is NaN
    range      values of the color map's ends
    n_unknown  particles whose value is not finite
    """

    color: np.ndarray
    range: tuple[float, float]
    n_unknown: int


def attribute_names(particles: Particles) -> list[str]:
    """All names that `attribute_values` knows, without components."""
    return list(_arrays(particles))


def velocity_name(attributes: Mapping[str, Any]) -> str | None:
    """The name of the attribute that holds velocities, vectors by a name of `VELOCITY_NAMES` in any
    case; None without."""
    vectors = [name for name, array in attributes.items() if array.ndim == 2]
    by_lower_name = {name.lower(): name for name in reversed(vectors)}
    return next((by_lower_name[name] for name in VELOCITY_NAMES if name in by_lower_name), None)


def attribute_values(particles: Particles, name: str) -> np.ndarray:
    """The values (N,) float64 that `name` stands for: x y z, a field, an attribute (a vector's
    length), speed (the length of the velocity), or NAME:0 … for a component.

    Raises TypeError for a name that is no text, ValueError that says which names there are.
    """
    if not isinstance(name, str):
        raise TypeError(f"color_by: expected a name, got {shown(name)}")
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
    words = ", a column of words: write numbers in their place" if particles.names.get(name) == {} else ""
    raise ValueError(f"expected one of {', '.join(arrays)}, got {name}{words}")


def place_label(name: str, origin: Iterable[float]) -> str:
    """The name of values for a legend or an axis: that of an axis, x, y or z, with what its numbers
    are counted from."""
    start = dict(zip("xyz", origin, strict=True)).get(name, 0.0)
    return f"{name} - {start:.15g}".replace("- -", "+ ") if start else name


def colormap_of(name: str, colormap: str) -> str:
    """The color map that "auto" stands for: types or elements for an attribute that names them, in
    any case, else viridis; another one is itself."""
    if colormap != "auto":
        return colormap
    lower = name.lower()
    return "elements" if lower in ELEMENT_NAMES else "types" if lower in TYPE_NAMES else "viridis"


def kinds_of(particles: Particles, name: str, colormap: str) -> tuple[tuple[float, str], ...]:
    """The values that a legend of types or elements lists, and their names; none for another color
    map, or for more than `MOST_KINDS`."""
    return listed(found_kinds(particles, name, colormap))


def found_kinds(particles: Particles, name: str, colormap: str) -> dict[float, str]:
    """The lowest values of types or elements and their names, one more than a legend lists; none
    for another color map."""
    if colormap_of(name, colormap) not in CATEGORICAL:
        return {}
    values = attribute_values(particles, name)
    found = np.unique(values[np.isfinite(values)])
    symbols = {number: symbol for symbol, (number, _, _) in reversed(ELEMENTS.items())}
    of_elements = colormap_of(name, colormap) == "elements"
    names = symbols if of_elements else particles.names.get(name, {})
    return {float(v): names.get(int(v), f"{v:.10g}") for v in found[: MOST_KINDS + 1]}


def listed(kinds: Mapping[float, str]) -> tuple[tuple[float, str], ...]:
    """The kinds of a legend, in order; none of too many."""
    return tuple(sorted(kinds.items())) if len(kinds) <= MOST_KINDS else ()


def attribute_colors(
    particles: Particles, name: str, colormap: str = "auto", range: tuple[float, float] | None = None
) -> AttributeColors:
    """Colors by a field or attribute, as `color_by` makes them, with what a legend needs.

    Raises TypeError and ValueError as `attribute_values`, `ends_of_map` and `checked_range` do.
    """
    values = attribute_values(particles, name)
    known = values[np.isfinite(values)]
    if range is not None:
        lo, hi = checked_range(range)
    else:
        lo, hi = ends_of_map(name, known, len(values))
    color = colorize(values, colormap_of(name, colormap), lo, hi)
    return AttributeColors(color, (lo, hi), len(values) - len(known))


def color_by(
    particles: Particles, name: str, colormap: str = "auto", range: tuple[float, float] | None = None
) -> Particles:
    """The particles with colors by a field or attribute.

    Args:
        particles: N particles.
        name: x, y, z, a field (support), an attribute (a vector's length), speed (the length of
            the velocity, see `velocity_name`), or NAME:0 … for a component.
        colormap: viridis, magma, inferno, plasma, cividis, turbo, coolwarm, gray, types or
            elements, as for `colorize`; auto: types or elements for an attribute of that name, else
            viridis.
        range: (lo, hi), values of the map's first and last color; lo may be above hi. Default: the
            lowest and highest finite value. Values outside have the color of the nearest end; NaN
            is gray.

    Returns:
        New particles that share all other arrays.

    Raises ValueError for an unknown name, map or range, and without a range where no value is
    finite; logs a warning for values that are not finite.
    """
    try:
        found = attribute_colors(particles, name, colormap, range)
    except ValueError as error:
        prefix = "color_by: " if str(error).startswith("expected") else ""
        raise ValueError(f"{prefix}{error}") from None
    if found.n_unknown:
        log.warning("%d of %d particles have no finite %s", found.n_unknown, len(particles), name)
    return replace(particles, color=found.color)


def ends_of_map(name: str | None, known: np.ndarray, n: int) -> tuple[float, float]:
    """The values at the ends of a color map: the lowest and highest of the finite values of n
    particles; without particles 0 and 1.

    Raises ValueError where none of the values is finite.
    """
    if n and not known.size:
        raise ValueError(f"expected a finite {name}, got none; give a range")
    return (float(known.min()), float(known.max())) if known.size else (0.0, 1.0)


def checked_range(range: Any) -> tuple[float, float]:
    """(lo, hi), two finite numbers."""
    try:
        lo, hi = range
    except (TypeError, ValueError):
        raise TypeError(f"range: expected (lo, hi), got {shown(range)}") from None
    return number("range", lo), number("range", hi)


def _arrays(particles: Particles) -> dict[str, Any]:
    positions = to_host(particles.positions)
    arrays: dict[str, Any] = {axis: positions[:, i] for i, axis in enumerate("xyz")}
    for field in SCALAR_FIELDS:
        value = getattr(particles, field)
        if value is not None:
            arrays[field] = np.broadcast_to(to_host(value), len(particles))
    arrays |= particles.attributes
    velocity = velocity_name(particles.attributes)
    if velocity is not None and "speed" not in arrays:
        at = list(arrays).index(velocity)
        pairs = list(arrays.items())
        arrays = dict([*pairs[:at], ("speed", arrays[velocity]), *pairs[at:]])
    return arrays


def _lengths(array: np.ndarray) -> np.ndarray:
    """Rows' lengths, without overflow; NaN stays NaN."""
    largest = np.abs(array).max(axis=1, initial=0.0)
    scale = np.where(np.isfinite(largest) & (largest > 0), largest, 1.0)
    with np.errstate(invalid="ignore"):
        return scale * np.sqrt(np.square(array / scale[:, None]).sum(axis=1))
