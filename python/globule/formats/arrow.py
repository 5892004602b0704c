"""Tables of Apache Parquet (.parquet) and Arrow (.arrow, .feather), by pyarrow.

A column is a number a row, or a list of k numbers a row. Columns are named as those of a .csv:
x, y, z, vx, vy, vz, `name:0`. A missing number is NaN; columns of other types are left out. The
metadata `unit` of a column is its unit.
"""

from __future__ import annotations

import io
import os
import warnings
from collections.abc import Mapping
from typing import Any

import numpy as np

from .._base.checks import missing
from .._base.files import atomic_write
from ..data.particles import Particles
from .contents import Contents
from .errors import bad, names_of, shown
from .fields import columns_advice, find_positions, join_columns, particles_from, place_names, split_columns
from .frames import frames_by_column
from .guarded import decode, need
from .units import held_units, in_one_unit


def read(path: str | os.PathLike[str], columns: Mapping[str, str] | None = None) -> Contents:
    """Read a table.

    `columns`: field or attribute -> column; "x", "y" and "z", or "positions", are the position.
    Columns that are not named are left out.

    Raises FormatError, MissingPackageError without pyarrow.
    """
    need("pyarrow", "pyarrow", "tables")
    about: dict[str, Any] = {}

    def choose(claim: dict) -> tuple[float, Any]:
        about.update(claim)
        names = list(claim["columns"])
        if columns is not None:
            for name in columns.values():
                if name not in names:
                    raise bad(path, "", f"expected the column {shown(name)}, got {names_of(names)}")
            names = list(dict.fromkeys(columns.values()))
        return sum(claim["columns"][name] for name in names), names

    facts, sent = decode("arrow", path, "a Parquet or Arrow table", choose=choose)
    found = dict(zip(facts["names"], sent, strict=True))
    for name in facts["ragged"]:
        if name.lower() == "positions" or (columns is not None and name in columns.values()):
            expected = f"expected rows of the same length in the column {name}"
            raise bad(path, "", f"{expected}, got several")
    units = dict(about["units"])
    if columns is not None:
        units = {ours: units[theirs] for ours, theirs in columns.items() if theirs in units}
        found = {ours: found[theirs] for ours, theirs in columns.items()}
    else:
        axes = place_names(found)
        found = {axes.get(name, name): array for name, array in found.items()}
        units = {axes.get(name, name): unit for name, unit in units.items()}
    units = in_one_unit(path, found, units)
    arrays = join_columns({name: a for name, a in found.items() if a.ndim == 1})
    arrays |= {name: a for name, a in found.items() if a.ndim > 1}
    positions = find_positions(arrays)
    if positions is None:
        got = names_of(about["columns"]) if about["columns"] else "no column of numbers"
        raise bad(path, "", f"expected columns x, y and z, got {got}; {columns_advice(about['columns'])}")
    particles = particles_from(path, positions, arrays)
    particles.names = {name: {} for name in about["words"]} if columns is None else {}
    if name := frames_by_column(particles):
        advice = f'--where "{name} == …", where=, chooses one; a .csv of it is a sequence'
        warnings.warn(f"{path}: the rows are those of several frames, by {shown(name)}, all read: {advice}",
                      stacklevel=2)  # fmt: skip
    return Contents(particles, units=held_units(particles, units))


def write(path: str | os.PathLike[str], particles: Particles) -> None:
    """Write a table with a column for each number of a particle. Raises MissingPackageError."""
    try:
        import pyarrow
        import pyarrow.feather
        import pyarrow.parquet
    except ImportError:
        raise missing("pyarrow", "tables") from None
    columns = {name: np.ascontiguousarray(a) for name, a in split_columns(particles).items()}
    table = pyarrow.table({name: pyarrow.array(a) for name, a in columns.items()})
    packed = io.BytesIO()
    if os.fspath(path).lower().endswith(".parquet"):
        pyarrow.parquet.write_table(table, packed)
    else:
        pyarrow.feather.write_feather(table, packed, compression="uncompressed")
    with atomic_write(path) as file:
        file.write(packed.getbuffer())
