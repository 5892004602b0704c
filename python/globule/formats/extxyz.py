"""Extended XYZ: a count, a line of `key=value` with `Lattice` and `Properties`, one row an atom.

`Properties=species:S:1:pos:R:3:radius:R:1` names the columns. A radius or color that the file
does not have is that of the element; see `elements`.
"""

from __future__ import annotations

import os
import re
from typing import Any

import numpy as np

from ..data.attributes import VELOCITY_NAMES
from .asciinum import numbers_of_words, parse_rows
from .contents import Box, Contents
from .elements import of_elements, type_names
from .errors import bad, require_different, shown
from .fields import particles_from
from .frames import text_frame
from .rows import whole_numbers

_PAIR = re.compile(r"""([\w\-./]+)\s*=\s*(?:"([^"]*)"|'([^']*)'|\{([^}]*)\}|([^\s"'{]+))""")
_NAMES = {
    **dict.fromkeys(VELOCITY_NAMES, "velocity"), "masses": "mass", "forces": "force",
    "Radius": "radius", "Color": "color", "Mass": "mass",  # OVITO
}  # fmt: skip
_MOST_COLUMNS = 1000


def read(path: str | os.PathLike[str], frame: int = 0) -> Contents:
    """Read a frame of an extended XYZ file. Raises FormatError naming the line."""
    lines, before, _, n_frames = text_frame(path, frame, _starts)
    n = int(lines[0])
    rows = lines[2 : 2 + n]
    if len(rows) < n or not all(row.strip() for row in rows):
        got = sum(bool(row.strip()) for row in rows)
        raise bad(path, f"line {before + 1}", f"expected {n} atoms, got {got}")
    pairs = _PAIR.finditer("".join(lines[1:2]))
    about = {pair[1]: next(filter(None, pair.groups()[1:]), "") for pair in pairs}
    where = f"line {before + 2}"
    arrays, words = _arrays(path, where, about.get("Properties", "species:S:1:pos:R:3"), rows,
                            before + 3)  # fmt: skip
    positions = arrays.pop("pos", None)
    if positions is None or positions.shape != (n, 3):
        raise bad(path, where, "expected a property pos:R:3, got none")
    box = _box(path, where, about)
    time = about.get("Time", about.get("time", ""))
    seconds = float(time) if re.fullmatch(r"[-+\d.eE]+", time) and _is_number(time) else None
    of_species = of_elements(words["species"]) if n and "species" in words else {}
    kinds = type_names(words.get("species", []), of_species)
    if of_species:
        if "diameter" in arrays:
            of_species.pop("radius", None)
        arrays = of_species | arrays
    wrapped = positions if box is None else box.wrap(positions)
    particles = particles_from(path, wrapped, arrays)
    particles.names = kinds
    return Contents(particles, box, {"positions": "Å"}, seconds, n_frames)


def _starts(path: Any, lines: list[str]) -> list[int]:
    """Where each frame's count stands. Raises FormatError."""
    starts, at = [], 0
    while at < len(lines) and lines[at].strip():
        text = lines[at].strip()
        if not (text.isascii() and text.isdigit() and len(text) < 16):
            problem = f"expected the number of atoms, got {shown(text)}"
            raise bad(path, f"line {at + 1}", problem)
        starts.append(at)
        at += int(text) + 2
    if not starts:
        raise bad(path, "line 1", "expected the number of atoms, got an empty line")
    return starts


def _arrays(
    path: Any, where: str, properties: str, rows: list[str], first: int
) -> tuple[dict[str, np.ndarray], dict[str, list[str]]]:
    """Arrays of numbers, and of words, by name."""
    parts = properties.split(":")
    if len(parts) % 3:
        raise bad(path, where, f"expected Properties=name:type:columns:…, got {shown(properties)}")
    fields, column = [], 0
    for name, kind, width in zip(parts[::3], parts[1::3], parts[2::3], strict=True):
        if kind not in ("S", "R", "I", "L") or not re.fullmatch("[1-9][0-9]?", width):
            problem = f"expected Properties=name:R:columns, got {shown(f'{name}:{kind}:{width}')}"
            raise bad(path, where, problem)
        fields.append((name, kind, column, int(width)))
        column += int(width)
    names = [name for name, *_ in fields]
    require_different(path, f"{where}, Properties", names)
    if column > _MOST_COLUMNS:
        raise bad(path, where, f"expected at most {_MOST_COLUMNS} columns, got {column}")
    numeric = [i for _, kind, c, w in fields if kind in "RI" for i in range(c, c + w)]
    table = parse_rows(path, rows, first, len(numeric), usecols=numeric)
    split = [row.split() for row in rows] if any(f[1] in "SL" for f in fields) else []
    if any(len(row) < column for row in split):
        raise bad(path, where, f"expected {column} columns in every row, got fewer")
    arrays: dict[str, np.ndarray] = {}
    words: dict[str, list[str]] = {}
    place = {i: k for k, i in enumerate(numeric)}
    for name, kind, c, n in fields:
        if kind == "S":
            words[name] = [row[c] for row in split]
        elif kind == "L":
            arrays[name] = np.array([row[c][:1].upper() == "T" for row in split], bool)
        else:
            values = table[:, place[c] : place[c] + n]
            if kind == "I":
                columns = [whole_numbers(path, name, v, "0", rows, c + k) for k, v in enumerate(values.T)]
                values = np.stack(columns, axis=1)
            values = np.ascontiguousarray(values[:, 0] if n == 1 else values)
            arrays[name if name == "pos" else _NAMES.get(name, name)] = values
    return arrays, words


def _box(path: Any, where: str, about: dict[str, str]) -> Box | None:
    if "Lattice" not in about:
        return None
    edges = _numbers(path, where, "Lattice", about["Lattice"], 9).reshape(3, 3)
    origin = _numbers(path, where, "Origin", about.get("Origin", "0 0 0"), 3)  # OVITO
    flags = about.get("pbc", "T T T").split()
    periodic = [word.upper().startswith(("T", "1")) for word in flags]
    x, y, z = periodic if len(periodic) == 3 else [True] * 3
    return Box(origin, edges, (x, y, z))


def _numbers(path: Any, where: str, name: str, text: str, n: int) -> np.ndarray:
    values = numbers_of_words(text.split())
    if values.shape != (n,) or not np.isfinite(values).all():
        raise bad(path, where, f"expected {n} numbers in {name}, got {shown(text)}")
    return values


def _is_number(word: str) -> bool:
    try:
        return bool(np.isfinite(float(word)))
    except ValueError:
        return False
