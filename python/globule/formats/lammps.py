"""LAMMPS and LIGGGHTS: text dumps (`dump custom`, `dump atom`, `dump yaml`) and data files (`write_data`).

A data file's atom style is that of the caller, else the one behind `Atoms #`, else the first whose
columns fit: their number, whole numbers, types up to the header's, positions in the box.

Scaled coordinates (xs) become those of the box, and unwrapped ones (xu) are wrapped into it. The
support follows from a column `radius` or `diameter`, else from the elements (see `elements`).
"""

from __future__ import annotations

import os
import re
import warnings
from itertools import takewhile
from typing import Any

import numpy as np

from .asciinum import is_number, parse_rows, text_lines
from .contents import Box, Contents
from .elements import of_elements, type_names
from .errors import FormatError, bad, require_different, shown
from .fields import join_columns, particles_from
from .frames import text_frame
from .rows import whole_numbers

# Columns of the section Atoms after the atom's number, by atom style.
_STYLES = {
    "atomic": "type x y z",
    "molecular": "molecule type x y z",
    "bond": "molecule type x y z",
    "angle": "molecule type x y z",
    "charge": "type q x y z",
    "full": "molecule type q x y z",
    "sphere": "type diameter density x y z",
    "granular": "type diameter density x y z",
    "ellipsoid": "type ellipsoidflag density x y z",
    "bpm/sphere": "molecule type diameter density x y z",
    "line": "molecule type lineflag density x y z",
    "tri": "molecule type triangleflag density x y z",
    "dipole": "type q x y z mux muy muz",
    "spin": "type x y z spx spy spz sp",
    "sph": "type rho esph cv x y z",
    "peri": "type volume density x y z",
    "mdpd": "type rho x y z",
    "dpd": "type theta x y z",
    "edpd": "type temperature cv x y z",
    "apip": "type lambda lambda_required x y z",
    "body": "type bodyflag mass x y z",
    "rheo": "type status rho x y z",
    "rheo/thermal": "type status rho energy x y z",
    "electron": "type q espin eradius x y z",
    "template": "type molecule template_index template_atom x y z",
    "smd": "type molecule volume mass kernel_radius contact_radius x0 y0 z0 x y z",
    "wavepacket": "type q espin eradius etag cs_re cs_im x y z",
    "dielectric": "molecule type q x y z mux muy muz area ed em epsilon curvature",
}
_HYBRID = "type x y z"  # and what the styles behind the word have beside it
_OPEN = {"tdpd": "type x y z", "hybrid": _HYBRID}  # more columns follow, as many as there are
_WHOLE = {
    "id", "molecule", "type", "ellipsoidflag", "lineflag", "triangleflag", "bodyflag", "status",
    "espin", "etag", "template_index", "template_atom", "ix", "iy", "iz",
}  # fmt: skip
_HEADERS = {"ellipsoids": "ellipsoid", "lines": "line", "triangles": "tri", "bodies": "body"}
_LABEL = r"\s*(\d+)\s+(\S+)"
_LOOKED_AT = 1000  # rows
_MOST_HEADER = 200  # lines


def read_dump(path: str | os.PathLike[str], frame: int = 0) -> Contents:
    """Read a frame of a text dump. Raises FormatError naming the line."""
    lines, before, head, n_frames = text_frame(path, frame, _starts)
    if lines[0].startswith("---"):
        return _yaml_frame(path, lines, before, n_frames)
    items, sections = _items(lines)
    if lost := [f"ITEM: {name}" for name in ("NUMBER OF ATOMS", "ATOMS") if name not in items]:
        problem = f"expected {lost[0]}, got none: only dumps of atoms (dump atom, dump custom) have positions"
        raise bad(path, f"line {before + 1}", problem)
    n = _count(path, lines, items["NUMBER OF ATOMS"], before)
    box = None
    if "BOX BOUNDS" in items:
        at, title = sections["BOX BOUNDS"]
        box = _dump_box(path, lines, at, title, before)
    at, title = sections["ATOMS"]
    names = title.split()
    behind = [line for line in lines[at + 1 :] if line.strip()]
    rows, behind = behind[:n], behind[n : n + 1]
    where = f"line {before + at + 1}"
    if len(rows) != n or (behind and not behind[0].startswith("ITEM:")):
        got = f"{shown(behind[0].strip())} behind them" if behind else len(rows)
        raise bad(path, where, f"expected {n} atoms, got {got}")
    columns, kinds = _with_elements(path, names, rows, before + at + 2)
    time = _number(lines, items.get("TIMESTEP", -1))
    if "TIME" in items:
        time = _number(lines, items["TIME"])
    units = {}
    if head[0].startswith("ITEM: UNITS"):  # once, before the first frame
        units = {"positions": f"LAMMPS {head[1].strip()[:20]}"}
    return _contents(path, where, columns, box, units, time, n_frames, kinds)


def _yaml_frame(path: Any, lines: list[str], before: int, n_frames: int) -> Contents:
    """A frame of `dump yaml`: a line `key: value` each, and behind a key without a value a line
    `- [ numbers ]` each."""
    keys: dict[str, str] = {}
    lists: dict[str, list[str]] = {}
    first: dict[str, int] = {}
    key = ""
    for i, line in enumerate(lines, before + 1):
        words = re.sub(r"[\[\],]", " ", line)
        if words.lstrip().startswith("- ") and key:
            lists.setdefault(key, []).append(words.replace("-", " ", 1))
            first.setdefault(key, i)
        elif ":" in line and not line.startswith(" "):
            key, _, value = words.partition(":")
            keys[key], first[f"{key}:"] = value.replace("'", " ").replace('"', " ").strip(), i
        elif line.startswith("..."):
            break
    n = _count(path, [keys.get("natoms", "")], 0, first.get("natoms:", before + 1) - 1)
    where = f"line {first.get('data:', before + 1)}"
    rows = lists.get("data", [])
    if len(rows) != n or "keywords" not in keys:
        raise bad(path, where, f"expected keywords and {n} atoms, got {len(rows)}")
    columns, kinds = _with_elements(path, keys["keywords"].split(), rows, first.get("data", before + 1))
    box = None
    if "box" in lists:
        tilt = " ".join(lists["box"][3:4]).split() or ["0"] * 3
        bounds = [f"{edge} {at}" for edge, at in zip(lists["box"][:3], tilt, strict=False)]
        sides = keys.get("boundary", "").split()
        periodic = " ".join(a + b for a, b in zip(sides[::2], sides[1::2], strict=False))
        box = _dump_box(path, ["", *bounds], 0, f"xy xz yz {periodic}", first["box"] - 2)
    time = _number([keys.get("time", keys.get("timestep", ""))], 0)
    units = {"positions": f"LAMMPS {keys['units'][:20]}"} if "units" in keys else {}
    return _contents(path, where, columns, box, units, time, n_frames, kinds)


def _with_elements(path: Any, names: list[str], rows: list[str], first: int) -> tuple[dict[str, Any], dict]:
    """The columns of a dump, with what its words of elements give, and the names of types."""
    columns, kinds = _columns(path, names, rows, first), {}
    if rows and "element" in names and "element" not in columns:
        column = names.index("element")
        words = [row.split()[column] for row in rows]
        found = of_elements(words)
        kinds = type_names(words, found)
        if "type" in columns:  # has the numbers that the words are for
            kinds = {"type": dict(zip(columns["type"].tolist(), words, strict=True))}
        columns = _with(found, columns)
    return columns, kinds


def _starts(path: Any, lines: list[str]) -> list[int]:
    """Where each frame begins. Raises FormatError."""
    if lines[0].startswith("---"):
        return [i for i, line in enumerate(lines) if line.startswith("---") and any(map(str.strip, lines[i + 1 :][:2]))]
    found = (i for i, line in enumerate(lines) if line.startswith("ITEM: TIMESTEP"))
    starts = [_first_item(lines, i) for i in found]
    if not starts:
        raise bad(path, "line 1", "expected ITEM: TIMESTEP, got none")
    return starts


def read_data(path: str | os.PathLike[str], atom_style: str | None = None) -> Contents:
    """Read the section Atoms of a data file.

    `atom_style`: as of LAMMPS' command atom_style: "full", "hybrid sphere dipole".

    Raises FormatError naming the line, ValueError for a style that LAMMPS does not have.
    """
    if atom_style is not None and not _is_known(atom_style.split()):
        known = " ".join([*_STYLES, *_OPEN])
        raise ValueError(f"atom_style: expected one of {known}, got {atom_style!r}")
    lines = text_lines(path)
    plain = [line.partition("#")[0].strip() for line in lines[:_MOST_HEADER]]
    head: dict[str, list[str]] = {}
    for line in plain[1:]:
        words = line.split()
        counts: tuple[str, ...] = ("atoms", *_HEADERS) if len(words) == 2 else ()
        if len(words) == 3 and words[1:] == ["atom", "types"]:
            head["types"] = words[:1]
        for width, wanted in ((1, counts), (2, ("xlo", "ylo", "zlo")), (3, ("xy", "avec", "bvec", "cvec", "abc"))):
            if len(words) > width and words[width] in wanted:
                head[words[width]] = words[:width]
    count = head.get("atoms", [""])[0]
    if not (count.isascii() and count.isdigit() and len(count) < 16):
        raise bad(path, "header", "expected a line 'N atoms', got none")
    n = int(count)
    titled = (i for i in range(1, len(lines)) if re.match(r"\s*Atoms\b", lines[i]))  # 0: any text
    at = next(titled, -1)
    if at < 0:
        raise bad(path, "header", "expected a section Atoms, got none")
    style = atom_style or lines[at].partition("#")[2].strip()
    rows = [(i, line) for i, line in enumerate(lines[at + 1 :], at + 1) if line.strip()]
    behind = next((line for _, line in rows[n:] if not line.lstrip().startswith("#")), "Z")
    if len(rows) < n or not behind.lstrip()[0].isalpha():
        got = len(rows) if len(rows) < n else f"{shown(behind.strip())} behind them"
        raise bad(path, f"line {at + 1}", f"expected {n} atoms, got {got}")
    rows = rows[:n]
    box = _data_box(head)
    names = ["id", "x", "y", "z"]
    if rows:
        some = [line.partition("#")[0].split() for _, line in rows[:_LOOKED_AT]]
        names = _atom_columns(path, at, style.split(), some, head, box)
    columns = _columns(path, names, [line for _, line in rows], rows[0][0] + 1 if rows else 1)
    elements = _elements(lines[:at])
    kinds = {"type": elements} if elements else {}
    if rows and "type" in names and "type" not in columns:
        column = names.index("type")
        words = [line.split()[column] for _, line in rows]
        of_words = of_elements(words)
        kinds = type_names(words, of_words)
        columns = _with(of_words, columns)
    elif "type" in columns and {*np.unique(columns["type"]).tolist()} <= elements.keys():
        numbers, place = np.unique(columns["type"], return_inverse=True)
        of_types = of_elements([elements[number] for number in numbers.tolist()])
        columns = _with({name: array[place] for name, array in of_types.items()}, columns)
    return _contents(path, f"line {at + 1}", columns | _velocities(path, lines, columns), box, {}, None, 1, kinds)


def _velocities(path: Any, lines: list[str], atoms: dict[str, Any]) -> dict[str, np.ndarray]:
    """vx, vy and vz of the section Velocities, in the order of the atoms; none where it has not all."""
    at = next((i for i in range(1, len(lines)) if re.match(r"\s*Velocities\b", lines[i])), len(lines))
    filled = (line for line in lines[at + 1 :] if line.strip())
    rows = list(takewhile(lambda line: not line.lstrip()[0].isalpha(), filled))
    if not rows or len(rows) != len(atoms["id"]):
        return {}
    names = ["id", "vx", "vy", "vz", *map(str, range(len(rows[0].partition("#")[0].split()) - 4))]
    found = _columns(path, names, rows, at + 2)
    here, there = np.argsort(atoms["id"]), np.argsort(found["id"])
    if not np.array_equal(atoms["id"][here], found["id"][there]):
        return {}
    there[here] = there.copy()
    return {name: found[name][there] for name in names[1:4]}


def _with(of_elements: dict[str, np.ndarray], columns: dict[str, Any]) -> dict[str, Any]:
    """The columns, and what elements give beside them."""
    if "diameter" in columns:
        of_elements.pop("radius", None)
    return of_elements | columns


def _elements(lines: list[str]) -> dict[int, str]:
    """The word of each type of atom: a comment of the section Masses, or its label."""
    found: dict[int, str] = {}
    for title, row in (("Masses", r"\s*(\d+)\s+\S+\s*#\s*(\S+)"), ("Atom Type Labels", _LABEL)):
        at = next((i for i, line in enumerate(lines) if line.strip() == title), len(lines))
        for line in lines[at + 1 :]:
            match = re.match(row, line)
            if match:
                found[int(match[1])] = match[2]
            elif line.strip():
                break
    return found


def _first_item(lines: list[str], i: int) -> int:
    """Where a frame begins, whose ITEM: TIMESTEP is line i: TIME and UNITS come before it."""
    while i >= 2 and lines[i - 2].strip() in ("ITEM: TIME", "ITEM: UNITS"):
        i -= 2
    return i


def _items(lines: list[str]) -> tuple[dict, dict]:
    """ITEM: name -> the line behind it; and name -> (its line, what follows the name)."""
    values, sections = {}, {}
    for i, line in enumerate(lines):
        if not line.startswith("ITEM: "):
            continue
        title = line[6:].strip()
        names = ("TIMESTEP", "TIME", "NUMBER OF ATOMS", "BOX BOUNDS", "ATOMS")
        for name in names:
            if title == name or title.startswith(name + " "):
                values[name], sections[name] = i + 1, (i, title[len(name) :].strip())
        if title.startswith("ATOMS"):
            break
    return values, sections


def _count(path: Any, lines: list[str], i: int, before: int) -> int:
    text = lines[i].strip() if 0 <= i < len(lines) else ""
    if not (text.isascii() and text.isdigit() and len(text) < 16):
        where = f"line {before + i + 1}"
        raise bad(path, where, f"expected the number of atoms, got {shown(text)}")
    return int(text)


def _number(lines: list[str], i: int) -> float | None:
    try:
        value = float(lines[i]) if 0 <= i < len(lines) else None
    except ValueError:
        return None
    return value if value is not None and np.isfinite(value) else None


def _dump_box(path: Any, lines: list[str], at: int, title: str, before: int) -> Box | None:
    try:
        rows = [[float(v) for v in line.split()] for line in lines[at + 1 : at + 4]]
    except ValueError:
        raise _bad_box(path, before + at) from None
    general = title.split()[:2] == ["abc", "origin"]
    width = 4 if general else 3 if "xy" in title else 2
    if len(rows) != 3 or any(len(row) < width for row in rows):
        raise _bad_box(path, before + at)
    periodic = tuple(word == "pp" for word in title.split()[-3:])
    if len(periodic) != 3:
        periodic = (False, False, False)
    if general:  # each line: an edge, and one coordinate of the corner
        table = np.array([row[:4] for row in rows])
        return _general_box(table[:, :3], table[:, 3], periodic)
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


def _data_box(head: dict[str, list[str]]) -> Box | None:
    """The box of a data file's header; None without one."""
    try:
        if "avec" in head:
            edges = np.array([head[edge] for edge in ("avec", "bvec", "cvec")], np.float64)
            return _general_box(edges, np.array(head.get("abc", ["0"] * 3), np.float64), (True, True, True))
        bounds = [[float(v) for v in head[axis]] for axis in ("xlo", "ylo", "zlo")]
        return _box(bounds, [float(v) for v in head.get("xy", ("0", "0", "0"))], (True, True, True))
    except (KeyError, ValueError):
        return None


def _general_box(edges: np.ndarray, origin: np.ndarray, periodic: Any) -> Box | None:
    """A box whose edges have any direction."""
    if not (np.isfinite(edges).all() and np.isfinite(origin).all()):
        return None
    return Box(origin.copy(), edges.copy(), periodic)


def _is_known(style: list[str]) -> bool:
    """Whether words are an atom style: one, or hybrid with those that it joins."""
    if style[:1] == ["hybrid"]:
        return all(word in _STYLES or word in _OPEN for word in style[1:])
    return bool(style) and (style[0] in _STYLES or style[0] in _OPEN)


def _own_columns(style: list[str]) -> list[str]:
    """The names of a known style's columns."""
    names = ["id", *(_OPEN.get(style[0]) or _STYLES[style[0]]).split()]
    for word in style[1:] if style[0] == "hybrid" else ():
        names += [c for c in (_OPEN.get(word) or _STYLES[word]).split() if c not in names]
    return names


def _of_style(style: list[str], n: int) -> list[list[str]]:
    """The names of n columns by a known style, in the order of likelihood: without the images of
    periodic boxes, and with them."""
    names = _own_columns(style)
    if style[0] in _OPEN and n > len(names):  # what is behind may or may not be images
        more = [f"column{i + 1}" for i in range(len(names), n)]
        found = [names + more[:-3] + ["ix", "iy", "iz"]] if len(more) >= 3 else []
        return [*found, names + more]
    images = [*names, "ix", "iy", "iz"]
    return [one for one in (images, names) if len(one) == n]


def _atom_columns(
    path: Any, at: int, style: list[str], rows: list[list[str]], head: dict, box: Box | None
) -> list[str]:
    """The names of the columns of the section Atoms, from its first rows."""
    n, where = len(rows[0]), f"line {at + 1}"
    known = _is_known(style)
    styles = [style] if known else [[one] for one in _STYLES]
    hints = [_HEADERS[k] for k in _HEADERS if head.get(k, ["0"])[0] not in ("0", "")]
    if not known and not style:
        styles.sort(key=lambda one: one[0] not in hints)
    scores: dict[tuple[str, ...], tuple[float, str]] = {}
    for one in styles:
        for names in _of_style(one, n):
            score = _likeness(names, rows, head, box)
            if score >= 0:
                scores.setdefault(tuple(names), (score, " ".join(one)))
    best = max((score for score, _ in scores.values()), default=0.0)
    found = {names: one for names, (score, one) in scores.items() if known or score == best}
    if not found and known:  # with positions that are anywhere
        found = {tuple(names): "" for names in _of_style(style, n)[:1]}
    if not found:
        if known:
            columns = " ".join(_own_columns(style))
            raise bad(path, where, f"expected the columns {columns} ({' '.join(style)}), got {n}")
        raise bad(path, where, f"expected columns of a known atom style, got {n}; name it: "
                  f"--atom-style, gb.read(path, atom_style=…): {' '.join(_STYLES)}")  # fmt: skip
    if len(found) > 1 and not known:
        first, *others = dict.fromkeys(found.values())
        if others and first not in hints:
            warnings.warn(f"{path}: expected 'Atoms # STYLE', got none that is known: read as "
                          f"{first}; {' '.join(others)} would fit, too: --atom-style",
                          stacklevel=2)  # fmt: skip
    return list(next(iter(found)))


def _likeness(names: list[str], rows: list[list[str]], head: dict, box: Box | None) -> float:
    """How well rows of words fit these columns: on how many axes the positions differ, weighted by
    how much of the box they take; -1 if they cannot be these columns."""
    if any(len(row) != len(names) for row in rows):
        return -1.0
    columns = dict(zip(names, zip(*rows, strict=True), strict=True))
    n_types = head.get("types", [""])[0]
    for name in _WHOLE & columns.keys():
        whole = all(re.fullmatch(r"[+-]?\d+", word) for word in columns[name])
        if not whole and not (name == "type" and not any(map(is_number, columns[name]))):
            return -1.0
    types = [word for word in columns["type"] if word.isdigit()]
    if n_types.isdigit() and not all(1 <= int(word) <= int(n_types) for word in types):
        return -1.0
    try:
        places = np.array([columns[axis] for axis in "xyz"], float).T
    except ValueError:
        return -1.0
    spread = np.ptp(places, axis=0)
    if box is None:
        return float((spread > 0).sum())
    sizes = np.abs(box.edges).sum(axis=0)
    lo, hi = box.origin - sizes, box.origin + np.maximum(box.edges, 0).sum(axis=0) + sizes
    if not ((places >= lo) & (places <= hi)).all():
        return -1.0
    shares = np.divide(spread, sizes, out=np.zeros(3), where=sizes > 0)
    return float(np.round(np.minimum(shares, 1.0), 1).sum())


def _columns(path: Any, names: list[str], rows: list[str], first: int) -> dict[str, np.ndarray]:
    """Columns of numbers; those of words, such as an element's symbol, are left out."""
    words = rows[0].split("#")[0].split() if rows else []
    if not rows:
        return {name: np.empty(0) for name in names}
    if len(words) != len(names):
        raise bad(path, f"line {first}", f"expected {len(names)} columns, got {len(words)}")
    numeric = [i for i, word in enumerate(words) if is_number(word)]
    again = [i for i, name in enumerate(names) if name in names[:i]]  # LIGGGHTS' own dumps: id type type x y z
    if not numeric:
        raise bad(path, f"line {first}", f"expected columns of numbers, got {shown(rows[0])}")
    options: dict[str, Any] = {"comments": "#"}
    if len(numeric) < len(words):
        options["usecols"] = numeric
    table = parse_rows(path, rows, first, len(numeric), **options)
    of_name = {names[i]: table[:, k] for k, i in reversed([*enumerate(numeric)])}
    if not all(i in numeric and np.array_equal(table[:, numeric.index(i)], of_name[names[i]]) for i in again):
        require_different(path, f"line {first - 1}", names)
    return {
        names[i]: whole_numbers(path, names[i], table[:, k], words[i], rows, i, comments="#")
        for k, i in enumerate(numeric)
        if i not in again
    }


def _contents(
    path: Any,
    where: str,
    columns: dict[str, np.ndarray],
    box: Box | None,
    units: dict[str, str],
    time: float | None,
    n_frames: int,
    kinds: dict[str, dict[int, str]],
) -> Contents:
    """kinds: the words of numbers, by the name of the column."""
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
    particles.names = kinds
    return Contents(particles, box, units, time, n_frames)
