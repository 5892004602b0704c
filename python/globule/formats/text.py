"""Nine-column text (.txt, .dat): a count N, then N lines of nine blank-separated numbers

    x y z  r g b  reflection refraction rigidity

with colors and factors in [0, 1].
"""

from __future__ import annotations

import os

import numpy as np

from .._base.files import atomic_write
from ..data.particles import Particles, relative
from .asciinum import format_rows, parse_rows, text_lines
from .errors import bad, shown
from .fields import per_particle

_COLUMNS = ("x", "y", "z", "r", "g", "b", "reflection", "refraction", "rigidity")


def read(path: str | os.PathLike[str]) -> Particles:
    """Read nine-column text. Raises FormatError naming line and column."""
    lines = text_lines(path)
    count = lines[0].strip()
    if not (count.isascii() and count.isdigit() and len(count) < 16):
        remedy = "a table has the names of its columns there, x y z …, and as many words in each row"
        raise bad(path, "line 1", f"expected the number of particles, got {shown(count)}; {remedy}")
    rows = parse_rows(path, lines[1:], 2, len(_COLUMNS))
    if len(rows) != int(count):
        where = f"line {len(lines)}"
        raise bad(path, where, f"expected {int(count)} particles (line 1), got {len(rows)}")
    with np.errstate(over="ignore"):
        values = rows.astype(np.float32)
    good = np.isfinite(values)
    good[:, 3:] &= (rows[:, 3:] >= 0) & (rows[:, 3:] <= 1)
    if not good.all():
        row, column = np.unravel_index(np.argmin(good), good.shape)
        filled = (number for number, line in enumerate(lines[1:], 2) if line.strip())
        line_number = next(number for i, number in enumerate(filled) if i == row)
        where = f"line {line_number}, column {column + 1}"
        expected = "a finite number" if column < 3 else "a number in [0, 1]"
        got = rows[row, column]
        raise bad(path, where, f"expected {expected} for {_COLUMNS[column]}, got {got:g}")
    positions, origin = relative(rows[:, :3])
    return Particles(
        positions,
        origin=origin,
        color=values[:, 3:6],
        reflection=values[:, 6],
        refraction=values[:, 7],
        rigidity=values[:, 8],
    )


def write(path: str | os.PathLike[str], particles: Particles) -> None:
    """Write nine-column text; support, weight and attributes have no place in it.

    The writer replaces missing values by white, and by 0 for reflection, refraction and rigidity.
    Raises ValueError for values that the format does not allow: positions that are not finite,
    factors outside [0, 1].
    """
    n = len(particles)
    arrays = per_particle(particles)
    table = np.zeros((n, len(_COLUMNS)), np.float32)
    positions = particles.world_positions()
    table[:, :3] = positions
    table[:, 3:6] = arrays.get("color", 1.0)
    for column in range(6, 9):
        table[:, column] = arrays.get(_COLUMNS[column], 0.0)
    for column, name in enumerate(_COLUMNS):
        values = table[:, column]
        good = np.isfinite(values) if column < 3 else (values >= 0) & (values <= 1)
        if not good.all():
            expected = "finite numbers" if column < 3 else "numbers in [0, 1]"
            got = values[np.argmin(good)]
            raise ValueError(f"{name}: expected {expected} for {path}, got {got:g}")
    with atomic_write(path) as file:
        file.write(b"%d\n" % n)
        file.writelines(format_rows([*positions.T, *table[:, 3:].T], " "))
