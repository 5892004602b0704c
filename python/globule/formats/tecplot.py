"""Tecplot's ASCII files of points, as SPHinXsys, SPHysics and others write them.

`VARIABLES` names the columns, and each `ZONE` has a row per point. Zones of different SOLUTIONTIME
are frames; others are one set of particles. Zones in blocks (DATAPACKING=BLOCK) are not read.
"""

from __future__ import annotations

import math
import os
import re
from typing import Any, NamedTuple

import numpy as np

from .asciinum import parse_rows, text_lines
from .contents import Contents, frame_index
from .errors import bad, require_different, shown
from .fields import find_positions, join_columns, particles_from, place_names
from .table import whole_numbers

_ROW = re.compile(r"\s*(?:[-+.\d]|nan\b|inf\b)", re.IGNORECASE)
_ADVICE = "expected VARIABLES with x and y among them"


class _Zone(NamedTuple):
    """Which lines are a zone's rows, and its time."""

    rows: list[int]
    time: float | None


def read(path: str | os.PathLike[str], frame: int = 0) -> Contents:
    """Read the zones of one time. Raises FormatError naming the line."""
    lines = text_lines(path)
    names, zones = _zones(path, lines)
    times = list(dict.fromkeys(zone.time for zone in zones))
    time = times[frame_index(path, frame, len(times))]
    axes = place_names(names)
    if not axes:
        raise bad(path, "line 1", f"{_ADVICE}, got {shown(' '.join(names))}")
    require_different(path, "VARIABLES", names)
    texts = {zone.rows[0]: lines[zone.rows[0] : zone.rows[-1] + 1] for zone in zones if zone.time == time}
    rows = np.concatenate([parse_rows(path, text, i + 1, len(names), comments="#") for i, text in texts.items()])
    text = [line for part in texts.values() for line in part]
    words = text[0].split()
    columns = {
        axes.get(name, name): whole_numbers(path, name, rows[:, i], words[i], text, i, comments="#")
        for i, name in enumerate(names)
    }
    columns.setdefault("z", np.zeros(len(rows)))
    arrays = join_columns(columns)
    positions = find_positions(arrays)
    return Contents(particles_from(path, positions, arrays), time=time, n_frames=len(times))


def _zones(path: Any, lines: list[str]) -> tuple[list[str], list[_Zone]]:
    """The names of the columns, and the zones that have rows."""
    said = [i for i, line in enumerate(lines) if line.partition("#")[0].strip() and not _ROW.match(line)]
    names: list[str] = []
    zones, head = [], ""
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
    if packing not in ("POINT", "FEPOINT"):
        raise bad(path, f"line {where}", f"expected DATAPACKING=POINT, got {shown(packing)}")
    nodes = keys.get("NODES", keys.get("N", ""))  # elements come behind them
    sides = [nodes] if nodes else [keys[axis] for axis in "IJK" if axis in keys]
    if sides and all(re.fullmatch(r"\d{1,15}", side) for side in sides):
        n = math.prod(map(int, sides))
        if len(rows) < max(n, 1) or (len(rows) > n and not nodes):
            raise bad(path, f"line {where}", f"expected {n} points in the zone, got {len(rows)} rows")
        rows = rows[:n]
    time = keys.get("SOLUTIONTIME", "")
    try:
        at = float(time) if time else None
    except ValueError:
        raise bad(path, f"line {where}", f"expected a number, got {shown(time)}") from None
    return _Zone(rows, at)
