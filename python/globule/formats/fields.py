"""Which array of a file is which field of Particles, and back.

Reading: an array named like a field (support, weight, color, reflection, refraction, rigidity,
anisotropy with nine components) is that field. Where there is none of that name,

    rgb, Cd, colors, rgba                       are taken as color (integers are divided by 255),
    smoothing_length, h                         give support = 2 h, SPH's usual kernel radius; some
                                                formats know that their kernel ends elsewhere,
    radius, pscale, diameter                    give support = 4 radius: a particle's radius is
                                                half the spacing, the support two spacings.

Where the support comes from a smoothing length, mass and density give the weight; see
`_derive_weight`.

The array that a support came from stays an attribute; a fourth color component becomes the
attribute `alpha`. All else is an attribute under its own name. An array that is named like a
field but does not have its shape or range becomes the attribute `<name>_attribute`.

Formats made of columns (.ply, .xyz, .csv) hold an attribute with k components as the columns
`name:0` ... `name:k-1` and know vx vy vz (velocity), nx ny nz (normal), red green blue (color).
"""

from __future__ import annotations

import os
import re
import warnings
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from .._base.arrays import to_host
from .._base.terminal import place_text
from ..data.particles import FIELDS, HERE, SCALAR_FIELDS, Particles, lost_precision, relative
from ..data.radii import find_radii, length_names, n_without_radius, sizes_of
from .errors import bad, faults

_SEVERAL, _TOO_LARGE = 8, 10  # so many particles do not lie within a tenth of a radius
POSITION_NAMES = ("positions", "position", "pos", "points", "p", "coordinates", "coords", "xyz", "x")
# Before or behind an axis in a column's name; behind one; and before a number.
_POSITION_WORDS = (
    "",
    "pos",
    "position",
    "positions",
    "points",
    "point",
    "coord",
    "coords",
    "coordinate",
    "coordinates",
    "location",
    "locationcenter",
    "loc",
    "center",
    "centre",
    "centroid",
    "barycenter",
    "bary",
    "centerofmass",
    "world",
)
_UNIT_WORDS = ("m", "mm", "cm", "um", "nm", "km", "meters", "metres", "angstrom")
_NUMBERED_WORDS = ("pos", "position", "positions", "points", "coord", "coords", "coordinates")
_EAST_NORTH = (("easting", "northing"), ("east", "north"), ("utme", "utmn"), ("utmx", "utmy"))
_HEIGHTS = ("z", "elevation", "elev", "altitude", "alt", "height", "h", "up", "u", "depth")
MOST_LOOKED_AT = 10_000  # rows that tell whether a column numbers them
_LATITUDES = ("lat", "latitude", "latdeg", "latitudedeg", "gpslat", "gpslatitude")
_LONGITUDES = ("lon", "long", "lng", "longitude", "londeg", "longitudedeg", "gpslon", "gpslongitude")
COLUMNS = 'name them: --columns x=…,y=…,z=… or gb.read(path, columns={"x": …})'  # for messages
_COLOR_NAMES = ("color", "rgb", "cd", "colors", "rgba")
_SUPPORT_NAMES = {"smoothing_length": 2, "h": 2, "radius": 4, "pscale": 4, "diameter": 2}
_LENGTH_NAMES = ("smoothing_length", "h")
_MASS_NAMES = ("mass", "masses", "m")
_DENSITY_NAMES = ("density", "densities", "rho", "rhop")
_OF_FLUIDS = 0.02, 3.0  # weights: supports of seven spacings, of one and a half
_VECTORS = {
    ("x", "y", "z"): "positions",
    ("vx", "vy", "vz"): "velocity",
    ("nx", "ny", "nz"): "normal",
    ("red", "green", "blue"): "color",
    ("r", "g", "b"): "color",
    ("diffuse_red", "diffuse_green", "diffuse_blue"): "color",
}
_COMPONENTS = {"velocity": ("vx", "vy", "vz"), "normal": ("nx", "ny", "nz"), "color": ("red", "green", "blue")}


def columns_advice(names: Iterable[str]) -> str:
    """What to do about a table whose columns are named so, none of them a place."""
    plain = {re.sub("[^a-z]", "", name.lower()): name for name in names}
    north, east = (next((plain[w] for w in words if w in plain), "") for words in (_LATITUDES, _LONGITUDES))
    if not (north and east):
        return COLUMNS
    up = next((f",z={plain[w]}" for w in _HEIGHTS if w in plain), "")
    return f"these are degrees: project them (to UTM), or take them so: --columns x={east},y={north}{up}"


def particles_from(
    path: Any, positions: Any, arrays: Mapping[str, np.ndarray], support_per_h: float = 2.0
) -> Particles:
    """Particles from a file's positions (N, 3) and its other arrays (N,), (N, k), () or (3,).

    `support_per_h` is the radius at which the file's kernel vanishes, in smoothing lengths.
    """
    positions = np.asarray(positions)
    n = len(positions)
    fields: dict[str, Any] = {}
    attributes: dict[str, np.ndarray] = {}
    for name, array in arrays.items():
        if name == "color":
            value = _as_color(array, n)
        elif name in SCALAR_FIELDS:
            value = _as_scalar(array, n)
        elif name == "anisotropy":
            value = _as_matrices(array, n)
        else:
            value = None
        if value is not None:
            fields[name] = value
        else:
            attributes[f"{name}_attribute" if name in FIELDS else name] = array
    if "color" not in fields:
        _take_color(fields, attributes, n)
    if "support" not in fields:
        _derive_support(fields, attributes, positions, support_per_h)
    attributes = {
        name: array
        for name, array in attributes.items()
        if name and array.dtype.kind in "biuf" and array.ndim in (1, 2) and len(array) == n
    }
    positions, origin = relative(positions)
    if origin == HERE and positions.dtype == np.float64:  # which float32 keeps: nobody looks again
        with np.errstate(over="ignore"):
            positions = positions.astype(np.float32)
    with faults(path, refused=(TypeError, ValueError)):
        return Particles(positions, attributes=attributes, origin=origin, **fields)


def check_names(names: Iterable[str]) -> None:
    """Refuse names of arrays that XML, text and zip archives cannot hold: with control characters
    or halves of characters. Raises ValueError."""
    for name in names:
        if re.search("[\x00-\x08\x0b\x0c\x0e-\x1f\ud800-\udfff\ufffe\uffff]", name):
            raise ValueError(f"attributes[{name!r}]: expected a name without control characters; rename it")


def per_particle(particles: Particles) -> dict[str, np.ndarray]:
    """All fields but the positions, and the attributes, as host arrays (N,) or (N, k)."""
    n = len(particles)
    arrays = {}
    for name in (*SCALAR_FIELDS, "color"):
        value = getattr(particles, name)
        if value is not None:
            value = np.asarray(to_host(value), dtype=np.float32)
            shape = (n, 3) if name == "color" else (n,)
            arrays[name] = np.ascontiguousarray(np.broadcast_to(value, shape))
    if particles.anisotropy is not None:
        arrays["anisotropy"] = particles.anisotropy.reshape(n, 9)
    arrays.update({name: to_host(array) for name, array in particles.attributes.items()})
    return arrays


def say_origin(path: Any, origin: tuple[float, float, float]) -> None:
    """Warn that positions are not the file's own."""
    if origin != HERE:
        said = f"positions are given from {place_text(origin)}"
        what = f"{said}, and so are cameras, cuts and legends: float32 would not keep the file's coordinates"
        warnings.warn(f"{os.fspath(path)}: {what}", stacklevel=5)


def say_radii(path: Any, particles: Particles) -> None:
    """Warn of particles without a radius, where others have radii, and of radii in another unit."""
    radii, places = find_radii(particles), particles.finite_positions()
    if radii is not None and len(places) >= _SEVERAL:
        typical, extent = float(np.median(radii)), float(np.ptp(places, axis=0).max())
        if extent and typical > _TOO_LARGE * extent:
            what = f"radii of {typical:.4g}, but all particles lie within {extent:.4g}: in another unit?"
            warnings.warn(f"{os.fspath(path)}: {what}", stacklevel=5)
    if n := n_without_radius(particles):
        have = "have" if n > 1 else "has"
        without = f"{n:,} of {len(particles):,} particles {have} no radius, or a negative one"
        what = f"{without}: left out, except of a smooth surface"
        warnings.warn(f"{os.fspath(path)}: {what}", stacklevel=5)


def given_from(particles: Particles, origin: Any, path: Any) -> Particles:
    """Particles whose positions are given from an origin, which is said if it is new."""
    if isinstance(origin, str) and origin == "auto":
        say_origin(path, particles.origin)
        return particles
    return particles.at(origin)


def kept_positions(particles: Particles, path: Any) -> np.ndarray:
    """Positions (N, 3) float32, world, for a format that has no longer type.

    Raises ValueError for those that float32 does not keep.
    """
    if particles.origin == HERE:
        return np.asarray(to_host(particles.positions))
    positions = particles.world_positions()
    if lost := lost_precision(positions):
        raise ValueError(f"{path}: {lost}, or write .npz, .vtp or .csv, which keep float64")
    return positions.astype(np.float32)


def check_lengths(path: Any, arrays: Mapping[str, np.ndarray], n: int) -> None:
    """Refuse an array whose name says that it is about the particles, but that is not N long."""
    for name, array in arrays.items():
        lower = name.lower()
        scalar = name in SCALAR_FIELDS or name in _SUPPORT_NAMES
        color = lower in _COLOR_NAMES
        if not (scalar or color or name in FIELDS or name in _COMPONENTS):
            continue
        if array.shape[:1] == (n,) or array.shape == (() if scalar else (3,) if color else None):
            continue
        width = "9" if name == "anisotropy" else "3"
        one = " or one number" if scalar else " or (3,)" if color else ""
        shape = f"({n},)" if scalar else f"({n}, {width})"
        raise bad(path, name, f"expected shape {shape}{one}, got {array.shape}")


def find_positions(arrays: dict[str, np.ndarray]) -> np.ndarray | None:
    """Take the array of positions (N, 3) out of `arrays`; None if there is none."""
    by_lower_name = {name.lower(): name for name in reversed(list(arrays))}
    for lower_name in POSITION_NAMES:
        name = by_lower_name.get(lower_name)
        if name is not None and arrays[name].ndim == 2 and arrays[name].shape[1] == 3:
            return arrays.pop(name)
    return None


def place_names(names: Iterable[str]) -> dict[str, str]:
    """Which of a table's columns are x, y and z: column -> axis, empty where none are.

    Columns x and y come first, in either case; else those of a word for positions and an axis:
    `Pos.x`, `Points_0`, `pos[0]`, `X-coordinate`, `x_m`; else Easting, Northing and Height, or the
    like. Without a third, and an elevation, a table lies in a plane. The axis of a depth is -z.
    """
    plain: dict[str, str] = {}
    for name in names:
        plain.setdefault(re.sub(r"[^a-z0-9]", "", name.lower()), name)
    for key, name in list(plain.items()):  # Particle X-Coordinate, Parcel Centroid[X]
        plain.setdefault(re.sub(r"^(?:particle|parcel|ball|grain)(?=.)", "", key), name)
    forms = [(end, word) for word in _POSITION_WORDS for end in ("{1}{0}", "{0}{1}")]
    forms += [("{0}{1}", word) for word in _UNIT_WORDS] + [("{1}{0}", "r"), ("{0}{1}", "p")]
    forms += [(f"{{1}}{{0}}{unit}", word) for word in _POSITION_WORDS[1:] for unit in _UNIT_WORDS]
    tried: list[tuple[Sequence[str], str, str]] = [("xyz", *form) for form in forms]
    tried += [(a, "{1}{0}", word) for word in _NUMBERED_WORDS for a in ("012", "123")]
    if {"x1", "x2"} <= plain.keys() and "x4" not in plain:  # two alone may be the ends of something
        tried += [(a, "x{0}", "") for a in ("012", "123") if {f"x{k}" for k in a} <= plain.keys()]
    up = next((word for word in _HEIGHTS if word in plain), "")
    tried += [((east, north, up), "{0}", "") for east, north in _EAST_NORTH]
    for axes, form, word in tried:
        found = [plain.get(form.format(axis, word)) for axis in axes]
        if found[0] and found[1]:
            if not found[2] and axes == "xyz":  # X, Y, Elevation
                found[2] = next((plain[word] for word in ("elevation", "elev", "altitude") if word in plain), None)
            names = ("x", "y", "-z" if axes[2] == "depth" else "z")
            return {name: axis for name, axis in zip(found, names, strict=True) if name}
    return {}


def names_with_id(path: Any, names: list[str], head: np.ndarray, last: float, n: int) -> list[str]:
    """Names of columns x, y, z, column4 … that nobody has named; id, x, y, z, column5 … where the first
    numbers the rows, and id, type, x, y, z, column6 … where the second has whole numbers and the
    next three have not, with a warning.

    The first numbers the rows if it rises by one from each to the next, and x or y behind it are not
    those of a straight row of lattice points.

    Args:
        path: of the file, for the warning.
        names: of all columns.
        head: (up to MOST_LOOKED_AT, at least 4) the first rows.
        last: the first column's last value.
        n: rows.
    """
    if len(names) < 4 or n < 3:
        return names
    some = head[:, :5].astype(np.float64)
    first = some[0, 0]
    if first != np.rint(first) or last != first + n - 1 or not (np.diff(some[:, 0]) == 1).all():
        return names
    whole = (some == np.rint(some)).all(axis=0)
    steps = np.diff(some[:, 1:3], axis=0)
    turns = (steps < 0).any(axis=0) & (steps > 0).any(axis=0)
    if not ((steps != 0).any(axis=0) & (~whole[1:3] | turns)).any():
        return names
    heads = ["id", "x", "y", "z"]
    if len(names) > 4 and whole[1] and not whole[2:5].any():
        heads.insert(1, "type")
    said = f"the first column numbers the rows: taken as {', '.join(heads)}; names in the first line say otherwise"
    warnings.warn(f"{path}: {said}", stacklevel=2)
    return [*heads, *names[len(heads) :]]


def join_columns(columns: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Columns (N,) gathered to arrays: x y z -> positions, v:0 v:1 -> v (N, 2), and so on. A depth
    -z counts down; x and y without z lie in the plane z = 0."""
    columns = dict(columns)
    arrays: dict[str, np.ndarray] = {}
    if "-z" in columns:
        columns["z"] = -columns.pop("-z")
    by_lower_name = {name.lower(): name for name in reversed(list(columns))}
    if by_lower_name.keys() >= {"x", "y"} and "z" not in by_lower_name:
        by_lower_name["z"], columns["z"] = "z", np.zeros(len(columns[by_lower_name["x"]]))
    if "positions" in columns and by_lower_name.keys() >= {"x", "y", "z"}:
        columns["positions_attribute"] = columns.pop("positions")
    for components, vector in _VECTORS.items():
        names = [by_lower_name[part] for part in components if part in by_lower_name]
        if len(names) < 3 or vector in columns or vector in arrays:
            continue
        arrays[vector] = np.stack([columns.pop(name) for name in names], axis=1)
    for name in list(columns):
        stem, colon, index = name.rpartition(":")
        if name not in columns:
            continue  # went into an earlier vector
        if not (colon and stem and index == "0") or stem in columns or stem in arrays:
            arrays[name] = columns[name]
            continue
        parts: list[np.ndarray] = []
        while f"{stem}:{len(parts)}" in columns:
            parts.append(columns.pop(f"{stem}:{len(parts)}"))
        arrays[stem] = np.stack(parts, axis=1)
    return arrays


def split_columns(particles: Particles) -> dict[str, np.ndarray]:
    """The reverse of join_columns, for all that `particles` hold; x y z come first.

    Raises ValueError if an attribute's column name is taken.
    """
    positions = particles.world_positions()
    columns = {"x": positions[:, 0], "y": positions[:, 1], "z": positions[:, 2]}
    for name, array in per_particle(particles).items():
        if array.ndim == 1:
            names, parts = [name], [array]
        else:
            parts = list(array.T)
            names = [f"{name}:{i}" for i in range(len(parts))]
            if name in _COMPONENTS and len(parts) == 3:
                names = list(_COMPONENTS[name])
        for column_name, part in zip(names, parts, strict=True):
            if column_name in columns:
                raise ValueError(f"attributes[{name!r}]: expected a name of its own, got column {column_name!r}")
            columns[column_name] = part
    return columns


def _as_scalar(array: np.ndarray, n: int) -> np.ndarray | None:
    if array.dtype.kind not in "biuf":
        return None
    if array.shape == (n, 1):
        return array.reshape(n)
    return array if array.shape in ((), (n,)) else None


def _as_color(array: np.ndarray, n: int) -> np.ndarray | None:
    """float32 colors in [0, 1], (3,) or (N, 3), or None if the array holds no colors."""
    if array.shape not in ((3,), (n, 3)) or array.dtype.kind not in "uif":
        return None
    if array.dtype.kind == "f":
        if bool(((array >= 0) & (array <= 1)).all()):
            return array.astype(np.float32)
        if not (array == np.rint(array)).all():
            return None
    if array.size and not 0 <= array.min() <= array.max() <= 65535:
        return None
    most = 65535 if array.dtype == np.uint16 or (array.size and array.max() > 255) else 255
    return array.astype(np.float32) / np.float32(most)


def _as_matrices(array: np.ndarray, n: int) -> np.ndarray | None:
    if array.dtype.kind not in "iuf" or array.shape not in ((n, 9), (n, 3, 3)):
        return None
    return array.reshape(n, 3, 3)


def _take_color(fields: dict[str, Any], attributes: dict[str, np.ndarray], n: int) -> None:
    for name in [name for name in attributes if name.lower() in _COLOR_NAMES]:
        array = attributes[name]
        color = _as_color(array[..., :3] if array.ndim == 2 else array, n)
        if color is None or array.shape[-1] > 4:
            continue
        fields["color"] = color
        del attributes[name]
        if array.shape == (n, 4):
            attributes.setdefault("alpha", array[:, 3])
        return


def _derive_support(
    fields: dict[str, Any], attributes: dict[str, np.ndarray], positions: np.ndarray, support_per_h: float
) -> None:
    n = len(positions)
    lower = length_names({name: a for name, a in attributes.items() if name != "H"}, positions)  # enthalpy
    for name, factor in _SUPPORT_NAMES.items():
        held = name if name in attributes else lower.get(name)
        value = _as_scalar(attributes[held], n) if held else None
        if value is None:
            continue
        sizes = sizes_of(value) if name not in _LENGTH_NAMES else None
        if sizes is not None or bool((np.isfinite(value) & (value >= 0)).all()):
            of_h = name in _LENGTH_NAMES
            with np.errstate(over="ignore"):
                known = value.astype(np.float32) if sizes is None else sizes
                fields["support"] = (support_per_h if of_h else factor) * known
            if of_h and "weight" not in fields and value.shape == (n,):
                _derive_weight(fields, attributes, positions)
            return


def _derive_weight(fields: dict[str, Any], attributes: dict[str, np.ndarray], positions: np.ndarray) -> None:
    """weight = 8 m / (rho R^3), with the support R.

    In SPH a particle stands for the volume m / rho, and a kernel of support R is scaled by 1 / R^3
    (Monaghan 2005, eq. 2.8). A particle whose volume is the cube of half its support, as the
    default support of two spacings has it, gets the weight 1. In the plane, m / rho is an area, and
    the weight 4 m / (rho R^2): where particles lie in one, unless the first one is that of a fluid.
    """
    n, lower = len(positions), {name.lower(): name for name in attributes}
    found = []
    for names in (_MASS_NAMES, _DENSITY_NAMES):
        name = next((lower[k] for k in names if k in lower), None)
        value = None if name is None else _as_scalar(attributes[name], n)
        if value is None or value.shape != (n,):
            return
        found.append(value.astype(np.float64))
    mass, density = found
    half = fields["support"].astype(np.float64) / 2
    with np.errstate(all="ignore"):
        weight, flat = ((mass / (density * half**axes)).astype("f4") for axes in (3, 2))
    in_plane = n > 0 and bool((np.ptp(positions, axis=0) == 0).any())
    if in_plane and not _OF_FLUIDS[0] < np.median(weight) < _OF_FLUIDS[1]:
        weight = flat
    if bool((np.isfinite(weight) & (weight > 0)).all()):
        fields["weight"] = weight
