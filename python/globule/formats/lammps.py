"""LAMMPS and LIGGGHTS: text dumps (`dump custom`, `dump atom`) and data files (`write_data`).

Scaled coordinates (xs) become those of the box, and unwrapped ones (xu) are wrapped into it. The
support follows from a column `radius` or `diameter`.
"""

from __future__ import annotations

import os
import re
from typing import Any

import numpy as np

from .asciinum import parse_rows, text_lines
from .contents import Box, Contents, frame_index
from .errors import FormatError, bad, shown
from .fields import join_columns, particles_from
from .table import whole_numbers

# Columns of the section Atoms after the atom's number, by atom style.
_STYLES = {
    "atomic": "type x y z",
    "charge": "type q x y z",
    "molecular": "molecule type x y z",
    "bond": "molecule type x y z",
    "angle": "molecule type x y z",
    "full": "molecule type q x y z",
    "sphere": "type diameter density x y z",
    "granular": "type diameter density x y z",
    "sph": "type rho esph cv x y z",
    "peri": "type volume density x y z",
}
_MOST_HEADER = 200  # lines


def read_dump(path: str | os.PathLike[str], frame: int = 0) -> Contents:
    """Read a frame of a text dump. Raises FormatError naming the line."""
    lines = text_lines(path)
    starts = [
        _first_item(lines, i) for i, line in enumerate(lines) if line.startswith("ITEM: TIMESTEP")
    ]
    if not starts:
        raise bad(path, "line 1", "expected ITEM: TIMESTEP, got none")
    i = frame_index(path, frame, len(starts))
    begin = starts[i]
    end = starts[i + 1] if i + 1 < len(starts) else len(lines)
    items, sections = _items(lines, begin, end)
    n = _count(path, lines, items.get("NUMBER OF ATOMS", -1))
    if "ATOMS" not in items:
        raise bad(path, f"line {begin + 1}", "expected ITEM: ATOMS, got none")
    box = _dump_box(path, lines, *sections["BOX BOUNDS"]) if "BOX BOUNDS" in items else None
    at, title = sections["ATOMS"]
    names = title.split()
    rows = [line for line in lines[at + 1 : at + 1 + n] if line.strip()]
    if len(rows) != n or at + 1 + n > end:
        raise bad(path, f"line {at + 1}", f"expected {n} atoms, got {min(len(rows), end - at - 1)}")
    columns = _columns(path, names, rows, at + 2)
    time = _number(lines, items.get("TIMESTEP", -1))
    if "TIME" in items:
        time = _number(lines, items["TIME"])
    units = {}
    if lines[0].startswith("ITEM: UNITS"):  # once, before the first frame
        units = {"positions": f"LAMMPS {lines[1].strip()[:20]}"}
    return _contents(path, f"line {at + 1}", columns, box, units, time, len(starts))


def read_data(path: str | os.PathLike[str]) -> Contents:
    """Read the section Atoms of a data file. Raises FormatError naming the line."""
    lines = text_lines(path)
    plain = [line.partition("#")[0].strip() for line in lines[:_MOST_HEADER]]
    head: dict[str, list[str]] = {}
    for line in plain[1:]:
        words = line.split()
        for width, known in ((1, ("atoms",)), (2, ("xlo", "ylo", "zlo")), (3, ("xy",))):
            if len(words) > width and words[width] in known:
                head[words[width]] = words[:width]
    count = head.get("atoms", [""])[0]
    if not (count.isascii() and count.isdigit() and len(count) < 16):
        raise bad(path, "header", "expected a line 'N atoms', got none")
    n = int(count)
    titled = (i for i in range(1, len(lines)) if re.match(r"\s*Atoms\b", lines[i]))  # 0: any text
    at = next(titled, -1)
    if at < 0:
        raise bad(path, "header", "expected a section Atoms, got none")
    style = lines[at].partition("#")[2].strip().split(" ")[0]
    rows = [(i, line) for i, line in enumerate(lines[at + 1 :], at + 1) if line.strip()][:n]
    if len(rows) != n:
        raise bad(path, f"line {at + 1}", f"expected {n} atoms, got {len(rows)}")
    first = rows[0][1].partition("#")[0].split() if rows else []
    names = _atom_columns(path, at, style, len(first)) if rows else ["id", "x", "y", "z"]
    columns = _columns(path, names, [line for _, line in rows], rows[0][0] + 1 if rows else 1)
    try:
        bounds = [[float(v) for v in head[axis]] for axis in ("xlo", "ylo", "zlo")]
        tilt = [float(v) for v in head.get("xy", ("0", "0", "0"))]
        box = _box(bounds, tilt, (True, True, True))
    except (KeyError, ValueError):
        box = None
    return _contents(path, f"line {at + 1}", columns, box, {}, None, 1)


def _first_item(lines: list[str], i: int) -> int:
    """Where a frame begins, whose ITEM: TIMESTEP is line i: TIME and UNITS come before it."""
    while i >= 2 and lines[i - 2].strip() in ("ITEM: TIME", "ITEM: UNITS"):
        i -= 2
    return i


def _items(lines: list[str], begin: int, end: int) -> tuple[dict, dict]:
    """ITEM: name -> the line behind it; and name -> (its line, what follows the name)."""
    values, sections = {}, {}
    i = begin
    while i < end:
        line = lines[i]
        if not line.startswith("ITEM: "):
            i += 1
            continue
        title = line[6:].strip()
        names = ("TIMESTEP", "TIME", "NUMBER OF ATOMS", "BOX BOUNDS", "ATOMS")
        for name in names:
            if title == name or title.startswith(name + " "):
                values[name], sections[name] = i + 1, (i, title[len(name) :].strip())
        if title.startswith("ATOMS"):
            break
        i += 1
    return values, sections


def _count(path: Any, lines: list[str], i: int) -> int:
    text = lines[i].strip() if 0 <= i < len(lines) else ""
    if not (text.isascii() and text.isdigit() and len(text) < 16):
        raise bad(path, f"line {i + 1}", f"expected the number of atoms, got {shown(text)}")
    return int(text)


def _number(lines: list[str], i: int) -> float | None:
    try:
        value = float(lines[i]) if 0 <= i < len(lines) else None
    except ValueError:
        return None
    return value if value is not None and np.isfinite(value) else None


def _dump_box(path: Any, lines: list[str], at: int, title: str) -> Box | None:
    try:
        rows = [[float(v) for v in line.split()] for line in lines[at + 1 : at + 4]]
    except ValueError:
        raise _bad_box(path, at) from None
    width = 3 if "xy" in title else 2
    if len(rows) != 3 or any(len(row) < width for row in rows):
        raise _bad_box(path, at)
    periodic = tuple(word == "pp" for word in title.split()[-3:])
    if len(periodic) != 3:
        periodic = (False, False, False)
    if "abc" in title.split():
        return None
    tilt = [row[2] for row in rows] if width == 3 else [0.0, 0.0, 0.0]
    bounds = [row[:2] for row in rows]
    # A triclinic box is written as the bounds of its corners (LAMMPS, "Howto triclinic").
    xy, xz, yz = tilt
    bounds[0][0] -= min(0.0, xy, xz, xy + xz)
    bounds[0][1] -= max(0.0, xy, xz, xy + xz)
    bounds[1][0] -= min(0.0, yz)
    bounds[1][1] -= max(0.0, yz)
    return _box(bounds, tilt, periodic)


def _bad_box(path: Any, at: int) -> FormatError:
    return bad(path, f"line {at + 1}", "expected three lines with the bounds of the box")


def _box(bounds: list[list[float]], tilt: list[float], periodic: Any) -> Box | None:
    lo, hi = np.array(bounds, float)[:, :2].T
    xy, xz, yz = tilt
    edges = np.diag(hi - lo)
    edges[1, 0], edges[2, 0], edges[2, 1] = xy, xz, yz
    if not (np.isfinite(edges).all() and np.isfinite(lo).all()):
        return None
    return Box(lo, edges, periodic)


def _atom_columns(path: Any, at: int, style: str, n: int) -> list[str]:
    if style not in _STYLES:
        fits = [s for s, names in _STYLES.items() if len(names.split()) + 1 in (n, n - 3)]
        if not (style == "" and len({_STYLES[s] for s in fits}) == 1):
            known = " ".join(_STYLES)
            problem = f"expected 'Atoms # STYLE' with one of {known}, got {shown(style)}"
            raise bad(path, f"line {at + 1}", problem)
        style = fits[0]
    names = ["id", *_STYLES[style].split()]
    if n == len(names) + 3:
        names += ["ix", "iy", "iz"]
    if n != len(names):
        raise bad(path, f"line {at + 1}", f"expected {len(names)} columns ({style}), got {n}")
    return names


def _columns(path: Any, names: list[str], rows: list[str], first: int) -> dict[str, np.ndarray]:
    """Columns of numbers; those of words, such as an element's symbol, are left out."""
    words = rows[0].split("#")[0].split() if rows else []
    if not rows:
        return {name: np.empty(0) for name in names}
    if len(words) != len(names):
        raise bad(path, f"line {first}", f"expected {len(names)} columns, got {len(words)}")
    numeric = [i for i, word in enumerate(words) if _is_number(word)]
    if len(set(names)) < len(names) or not numeric:
        raise bad(path, f"line {first}", f"expected columns of numbers, got {shown(rows[0])}")
    options: dict[str, Any] = {"comments": "#"}
    if len(numeric) < len(words):
        options["usecols"] = numeric
    table = parse_rows(path, rows, first, len(numeric), **options)
    return {names[i]: whole_numbers(table[:, k], words[i]) for k, i in enumerate(numeric)}


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True


def _contents(
    path: Any,
    where: str,
    columns: dict[str, np.ndarray],
    box: Box | None,
    units: dict[str, str],
    time: float | None,
    n_frames: int,
) -> Contents:
    found = None
    for end in ("", "u", "s", "su"):
        names = [axis + end for axis in "xyz"]
        if set(names) <= columns.keys() and found is None:
            found = np.stack([columns.pop(name) for name in names], axis=1).astype(np.float64)
            if "s" in end:
                if box is None:
                    raise bad(path, where, "expected BOX BOUNDS for scaled coordinates, got none")
                found = box.origin + found @ box.edges
    if found is None:
        given = shown(" ".join(columns))
        raise bad(path, where, f"expected columns x y z (or xu, xs, xsu), got {given}")
    for name in ("ix", "iy", "iz"):
        columns.pop(name, None)
    if "diameter" in columns and "radius" not in columns:
        columns["radius"] = columns["diameter"] / 2
    positions = found if box is None else box.wrap(found)
    particles = particles_from(path, positions, join_columns(columns))
    return Contents(particles, box, units, time, n_frames)
