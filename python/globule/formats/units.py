"""Units of length in the names and metadata of columns."""

from __future__ import annotations

import re
import warnings
from collections.abc import Mapping
from typing import Any

import numpy as np

from ..data.particles import Particles
from ..data.radii import length_name, may_be_length
from ..data.scale import LENGTHS
from .errors import bad, shown

_METERS = {
    "nm": 1e-9, "um": 1e-6, "µm": 1e-6, "μm": 1e-6, "mm": 1e-3, "cm": 1e-2, "dm": 0.1, "m": 1.0, "km": 1e3,
    "å": 1e-10, "angstrom": 1e-10, "micron": 1e-6, "in": 0.0254, "inch": 0.0254, "ft": 0.3048, "foot": 0.3048,
    "feet": 0.3048,
}  # fmt: skip
_PREFIXES = {"": 1.0, "nano": 1e-9, "micro": 1e-6, "milli": 1e-3, "centi": 1e-2, "kilo": 1e3}
_METERS |= {p + meter: factor for p, factor in _PREFIXES.items() for meter in ("meter", "metre")}
_BEHIND = re.compile(r"(.+)[ _.](nm|um|mm|cm|m)")  # a unit at the end of a column's name
_PLACE = re.compile(r"(?:pos|position|positions|coord|coords|coordinate|point|points)?[ _.]?[xyz]")
_PLACES = ("x", "y", "z", "-z", "positions")


def split_units(names: list[str]) -> tuple[list[str], dict[str, str]]:
    """Names without their units, and the units: `x [m]` -> x, m. As they are where two would become
    one; a smoothing length h of another unit than one of length, an enthalpy, keeps it in its name.
    """
    plain, units = [], {}
    for name in names:
        found = re.fullmatch(r"(.*\S)\s*(?:\[([^\]]*)\]|\(([^)]*)\))", name)
        unit = (found[2] or found[3] or "").strip() if found else ""
        if found and unit and not unit.isdigit() and (found[1].lower() != "h" or meters(unit)):
            plain.append(found[1])
            units[found[1]] = unit
        else:  # name[0] is a component
            plain.append(name)
            behind = _BEHIND.fullmatch(name.lower())
            if behind and (_PLACE.fullmatch(behind[1]) or length_name(behind[1]) in LENGTHS):
                units[name] = behind[2]  # x_m, radius_mm
    if len(set(plain)) < len(plain):
        return names, {}
    return plain, units


def meters(unit: str) -> float:
    """A unit of length in m; 0 where it is not known: `mm`, `0.01 m`, `meters`."""
    found = re.fullmatch(r"\s*(\d[\d.e+-]*)?\s*(\D+?)\s*", unit)
    if not found:
        return 0.0
    word = found[2] if found[2] in _METERS else found[2].lower()
    try:
        return float(found[1] or 1) * _METERS.get(word, _METERS.get(word.removesuffix("s"), 0.0))
    except ValueError:
        return 0.0


def in_one_unit(path: Any, columns: dict[str, np.ndarray], units: Mapping[str, str]) -> dict[str, str]:
    """Convert the columns of lengths to the unit of x, or of positions, with a warning. Returns the
    units that hold after.

    Raises FormatError for units that are not the same, one of which is not known.
    """
    after = dict(units)
    place = next((name for name in ("x", "positions", "y") if name in units), "")
    for name in columns:
        is_length = name in _PLACES or name == "support" or length_name(name) in LENGTHS
        if name not in units or not (is_length or (may_be_length(name) and meters(units[name]))):
            continue
        have, want = meters(units[name]), meters(units[place]) if place else 0.0
        if not place or units[name] == units[place] or (have and have == want):
            continue
        if not (have and want):
            got = f"{shown(units[place])} for {place} and {shown(units[name])} for {shown(name)}"
            raise bad(path, "", f"expected one unit of length, or known ones, got {got}; rename one, or --columns "
                      "leaves it out")  # fmt: skip
        columns[name] = columns[name] * (have / want)
        after[name] = units[place]
        warnings.warn(f"{path}: {name} is in {units[name]} and becomes {units[place]}, as {place} is", stacklevel=2)
    return after


def held_units(particles: Particles, units: Mapping[str, str]) -> dict[str, str]:
    """The units of what particles hold, of those of columns."""
    held = {name: unit for name, unit in units.items() if name in particles.attributes or name in ("support", "weight")}
    place = units.get("positions", units.get("x", units.get("y", "")))
    return held | ({"positions": place} if place else {})


def scaled_units(units: Mapping[str, str], lengths: Any, factor: float) -> dict[str, str]:
    """The units of arrays whose lengths, those of these names, were multiplied by a factor."""
    return {name: _scaled(unit, factor) if name in lengths else unit for name, unit in units.items()}


def _scaled(unit: str, factor: float) -> str:
    """A unit that is `1 / factor` of one: mm for m and 1000."""
    if size := meters(unit):
        word = next((u for u, m in _METERS.items() if abs(m * factor / size - 1) < 1e-6), "")
        return word or f"{size / factor:.6g} m"
    return f"{1 / factor:.6g} {unit}"
