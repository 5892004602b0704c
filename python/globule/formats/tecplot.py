"""Tecplot's ASCII files of points, as SPHinXsys, SPHysics and others write them.

`VARIABLES` names the columns, and each `ZONE` has a row per point, or, in blocks, all numbers of a
variable after all of another (DATAPACKING=BLOCK). Zones of different SOLUTIONTIME are frames; others
are one set of particles. Variables of cells (VARLOCATION) are left out.
"""

from __future__ import annotations

import itertools
import math
import os
import re
import warnings
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

from .asciinum import parse_rows, text_lines
from .contents import Contents, frame_index
from .errors import FormatError, bad, names_of, require_different, shown
from .fields import find_positions, join_columns, particles_from, place_names
from .rows import whole_numbers
from .size import check_memory
from .units import held_units, in_one_unit, split_units

_ROW = re.compile(r"\s*(?:[-+.\d]|nan\b|inf\b)", re.IGNORECASE)
_ADVICE = "expected VARIABLES with x and y among them"


class _Zone(NamedTuple):
    """Which lines are a zone's rows, and its time; in blocks, how many numbers each variable has,
    of points and of cells, and which variables are of cells, from 1."""

    rows: list[int]
    time: float | None
    n_points: int = 0
    n_cells: int = 0
    of_cells: frozenset[int] = frozenset()


def read(path: str | os.PathLike[str], frame: int = 0) -> Contents:
    """Read the zones of one time. Raises FormatError naming the line."""
    lines = text_lines(path)
    said, zones = _zones(path, lines)
    names, units = split_units(said)
    times = list(dict.fromkeys(zone.time for zone in zones))
    time = times[frame_index(path, frame, len(times))]
    axes = place_names(names)
    if not axes:
        raise bad(path, "line 1", f"{_ADVICE}, got {names_of(names)}")
    require_different(path, "VARIABLES", names)
    now = [zone for zone in zones if zone.time == time]
    rows, text = [], []
    for zone in now:
        part = _unpacked(path, lines, zone, len(names)) if zone.n_points else lines[zone.rows[0] : zone.rows[-1] + 1]
        rows.append(_parsed(path, part, zone, len(names)))
        text += part
    numbers = np.concatenate(rows)
    words = text[0].split()
    of_cells = frozenset().union(*(zone.of_cells for zone in now))
    if lost := [said[i - 1] for i in sorted(of_cells) if i <= len(said)]:
        warnings.warn(f"{path}: values of cells are left out: {', '.join(lost)[:200]}", stacklevel=2)
    columns = {
        axes.get(name, name): whole_numbers(path, name, numbers[:, i], words[i], text, i, comments="#")
        for i, name in enumerate(names)
        if i + 1 not in of_cells
    }
    units = in_one_unit(path, columns, {axes.get(name, name): unit for name, unit in units.items()})
    arrays = join_columns(columns)
    positions = find_positions(arrays)
    if positions is None:
        raise bad(path, f"line {now[0].rows[0] + 1}", "expected x, y and z of points, got those of cells")
    particles = particles_from(path, positions, arrays)
    return Contents(particles, units=held_units(particles, units), time=time, n_frames=len(times))


def _parsed(path: Any, rows: list[str], zone: _Zone, n: int) -> np.ndarray:
    """Rows (points, n) of numbers. Raises FormatError; of blocks with their first line."""
    where = zone.rows[0] + 1
    try:
        return parse_rows(path, rows, where, n, comments="#")
    except FormatError:
        if not zone.n_points:
            raise
        raise bad(path, f"line {where}", "expected numbers in the blocks of the zone, got other words") from None


def _unpacked(path: Any, lines: list[str], zone: _Zone, n_names: int) -> list[str]:
    """The rows of points of a zone in blocks; nan for what is of cells."""
    words = [word for i in zone.rows for word in lines[i].partition("#")[0].replace(",", " ").split()]
    sizes = [zone.n_cells if i in zone.of_cells else zone.n_points for i in range(1, n_names + 1)]
    where = f"line {zone.rows[0] + 1}"
    if any("*" in word for word in words):  # 3*0.5: a number three times
        check_memory(path, where, 100.0 * sum(sizes))
        words = list(itertools.islice(_repeated(words), sum(sizes)))
    if len(words) < max(sum(sizes), zone.n_points):
        raise bad(path, where, f"expected {sum(sizes)} numbers in the zone, got {len(words)}")
    blocks, begin = [], 0
    for i, size in enumerate(sizes, 1):
        blocks.append(["nan"] * zone.n_points if i in zone.of_cells else words[begin : begin + size])
        begin += size
    return [" ".join(row) for row in zip(*blocks, strict=True)]


def _repeated(words: list[str]) -> Iterator[str]:
    for word in words:
        count, star, number = word.partition("*")
        yield from itertools.repeat(number, int(count)) if star and count.isdigit() else [word]


def _zones(path: Any, lines: list[str]) -> tuple[list[str], list[_Zone]]:
    """The names of the columns, and the zones that have rows."""
    said = [i for i, line in enumerate(lines) if line.partition("#")[0].strip() and not _ROW.match(line)]
    names: list[str] = []
    zones, head = [], ""
    if not said:
        raise bad(path, "line 1", f"{_ADVICE}, got none")
    for i, after in zip(said, [*said[1:], len(lines)], strict=True):
        head += f" {lines[i].partition('#')[0]}"
        rows = [k for k in range(i + 1, after) if _ROW.match(lines[k])]
        if not rows:
            continue
        names = _names(head) or names
        if not names:
            raise bad(path, f"line {i + 1}", f"{_ADVICE}, got none")
        zones.append(_zone(path, head, i + 1, rows))
        head = ""
    if not zones:
        raise bad(path, f"line {len(lines)}", "expected a zone with rows, got none")
    return names, zones


def _names(head: str) -> list[str]:
    found = re.search(r"\bVARIABLES\s*=(.*?)(?=\b(?:ZONE|TITLE|DATASETAUXDATA)\b|$)", head, re.I)
    words = re.findall(r'"([^"]*)"|([^\s,"]+)', found[1]) if found else []
    return [quoted.strip() or plain for quoted, plain in words]


def _zone(path: Any, head: str, where: int, rows: list[int]) -> _Zone:
    keys: dict[str, str] = dict(re.findall(r"\b(\w+)\s*=\s*\"?([^\s,\"]+)", head.upper()))
    packing = keys.get("DATAPACKING", keys.get("F", "POINT"))
    if packing not in ("POINT", "FEPOINT", "BLOCK", "FEBLOCK"):
        raise bad(path, f"line {where}", f"expected DATAPACKING=POINT or BLOCK, got {shown(packing)}")
    nodes = keys.get("NODES", keys.get("N", ""))  # elements come behind them
    sides = [nodes] if nodes else [keys[axis] for axis in "IJK" if axis in keys]
    told = sides and all(re.fullmatch(r"\d{1,15}", side) for side in sides)
    n = math.prod(map(int, sides)) if told else 0
    block: tuple[int, int, frozenset[int]] = (0, 0, frozenset())
    if packing.endswith("BLOCK"):
        if n < 1:
            raise bad(path, f"line {where}", "expected the number of points (I=, NODES=) of a zone in blocks, got none")
        cells = keys.get("ELEMENTS", keys.get("E", "")) if nodes else ""
        n_cells = math.prod(max(int(side) - 1, 1) for side in sides)
        block = n, int(cells) if re.fullmatch(r"\d{1,15}", cells) else n_cells, _of_cells(head)
    elif told:
        if len(rows) < max(n, 1) or (len(rows) > n and not nodes):
            raise bad(path, f"line {where}", f"expected {n} points in the zone, got {len(rows)} rows")
        rows = rows[:n]
    time = keys.get("SOLUTIONTIME", "")
    try:
        at = float(time) if time else None
    except ValueError:
        raise bad(path, f"line {where}", f"expected a number, got {shown(time)}") from None
    return _Zone(rows, at, *block)


def _of_cells(head: str) -> frozenset[int]:
    """The numbers of the variables that VARLOCATION says to be of cells."""
    found = re.search(r"\bVARLOCATION\s*=\s*\(((?:\[[^\]]*\]|[^)])*)\)", head, re.I)
    if found is None:
        return frozenset()
    if "=" not in found[1]:
        return frozenset(i for i, word in enumerate(found[1].split(","), 1) if "CELL" in word.upper())
    numbers: set[int] = set()
    for which in re.findall(r"([\d\s,-]+)\]?\s*=\s*CELLCENTERED", found[1], re.I):
        for first, last in re.findall(r"(\d{1,4})(?:\s*-\s*(\d{1,4}))?", which):
            numbers.update(range(int(first), int(last or first) + 1))
    return frozenset(numbers)
