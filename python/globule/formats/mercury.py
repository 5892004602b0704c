"""MercuryDPM's .data files: for each time a line `N time xmin ymin zmin xmax ymax zmax` and N rows

    x y z  vx vy vz  radius  angles (3)  angular velocity (3)  species

In a plane: `N time xmin ymin xmax ymax` and `x y  vx vy  radius  angle  angular velocity  species`.
"""

from __future__ import annotations

import os
from typing import Any

import numpy as np

from .asciinum import parse_rows
from .contents import Box, Contents
from .errors import bad, shown
from .fields import find_positions, join_columns, particles_from
from .frames import text_frame

_TURNS = [f"{name}:{i}" for name in ("angle", "angular_velocity") for i in range(3)]
_NAMES = {  # by how many words the line before the rows has
    8: ["x", "y", "z", "vx", "vy", "vz", "radius", *_TURNS, "species"],
    6: ["x", "y", "vx", "vy", "radius", "angle", "angular_velocity", "species"],
}


def read(path: str | os.PathLike[str], frame: int = 0) -> Contents:
    """Read the particles of one time. Raises FormatError."""
    found = text_frame(path, frame, _starts)
    head = parse_rows(path, found.lines[:1], found.before + 1, len(found.lines[0].split()))[0]
    names = _NAMES[len(head)]
    rows = parse_rows(path, found.lines[1:], found.before + 2, len(names))
    if not np.isfinite(head).all():
        raise bad(path, f"line {found.before + 1}", f"expected finite numbers, got {shown(found.lines[0])}")
    if len(rows) != head[0]:
        raise bad(path, f"line {found.before + 1}", f"expected {head[0]:.0f} rows, got {len(rows)}")
    columns = dict(zip(names, rows.T, strict=True))
    columns["species"] = columns["species"].astype(np.int64)
    arrays = join_columns({"z": np.zeros(len(rows))} | columns)
    if "vy" in arrays:
        arrays["velocity"] = np.stack([arrays.pop("vx"), arrays.pop("vy"), np.zeros(len(rows))], axis=1)
    positions = find_positions(arrays)
    lo, hi = np.zeros((2, 3))
    lo[: len(head) // 2 - 1], hi[: len(head) // 2 - 1] = head[2:].reshape(2, -1)
    box = Box.of_sizes(lo, hi - lo)
    return Contents(particles_from(path, positions, arrays), box, time=float(head[1]), n_frames=found.n_frames)


def _starts(path: Any, lines: list[str]) -> list[int]:
    """Where each time begins."""
    starts, at = [], 0
    while at < len(lines):
        words = lines[at].split()
        if not words:
            at += 1
            continue
        if len(words) not in _NAMES or not words[0].isdigit() or len(words[0]) > 15:
            raise bad(path, f"line {at + 1}", f"expected N, a time and the corners of a box, got {shown(lines[at])}")
        starts.append(at)
        at += 1 + int(words[0])
    return starts
