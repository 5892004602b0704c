"""DualSPHysics' .bi4: a tree of items with values and arrays (its classes JBinaryData and
JPartDataBi4).

Particles of a file are those of all its parts; `type` tells boundary (0 fixed, 1 moving), floating
(2) and fluid (3) by the ranges of their numbers. The support is 2 h, the end of the Wendland and of
the cubic kernel.
"""

from __future__ import annotations

import os
import struct
from typing import Any

import numpy as np

from .contents import Box, Contents
from .errors import bad, shown
from .fields import particles_from
from .size import whole_file

_HEADER = 64  # bytes: a title of 60, byte order, whether sizes have 64 bits, two unused
_MOST_ITEMS, _MOST_NESTED = 10_000, 8
_TYPES = {  # number: (dtype, components)
    2: ("i4", 1), 3: ("i1", 1), 4: ("u1", 1), 5: ("i2", 1), 6: ("u2", 1), 7: ("i4", 1),
    8: ("u4", 1), 9: ("i8", 1), 10: ("u8", 1), 11: ("f4", 1), 12: ("f8", 1),
    20: ("i4", 3), 21: ("u4", 3), 22: ("f4", 3), 23: ("f8", 3),
}  # fmt: skip
_TEXT = 1
_NAMES = {"Idp": "id", "Idpd": "id", "Vel": "velocity", "Rhop": "density", "Rho": "density",
          "Mass": "mass", "Hvar": "h"}  # fmt: skip
_UNITS = {"positions": "m", "velocity": "m/s", "density": "kg/m³", "mass": "kg", "h": "m"}


def read(path: str | os.PathLike[str]) -> Contents:
    """Read the particles of a .bi4 file. Raises FormatError."""
    data = whole_file(path, 3.0)
    if data[:9] != b"#FileJBD " or len(data) < _HEADER:
        raise bad(path, "header", f"expected #FileJBD, got {shown(data[:9])}")
    if data[60] not in (0, 10):
        raise bad(path, "header", f"expected little-endian data, got byte order {data[60]}")
    values, arrays = _Tree(path, data, bool(data[61])).all()
    positions = arrays.pop("Posd", arrays.pop("Pos", None))
    if positions is None or positions.ndim != 2:
        names = shown(", ".join(arrays) or "none")
        raise bad(path, "arrays", f"expected Pos or Posd (N, 3), got {names}")
    n = len(positions)
    found = {_NAMES.get(k, k): array for k, array in arrays.items() if len(array) == n}
    _add_type(values, found)
    h, kind = values.get("H"), found.get("type")
    if isinstance(h, float) and h > 0 and "h" not in found:
        found["h"] = np.full(n, h, np.float32)
    bound, fluid = values.get("MassBound"), values.get("MassFluid")
    known = isinstance(bound, float) and isinstance(fluid, float)
    if "mass" not in found and kind is not None and known:
        with np.errstate(over="ignore"):
            found["mass"] = np.where(kind < 3, float(bound or 0), float(fluid or 0)).astype("f4")
    time = values.get("TimeStep")
    particles = particles_from(path, positions, found)
    units = {name: unit for name, unit in _UNITS.items() if name == "positions" or name in found}
    return Contents(particles, _box(values), units, time if isinstance(time, float) else None)


def _add_type(values: dict[str, Any], found: dict[str, np.ndarray]) -> None:
    """The kind of each particle, whose numbers are in the order fixed, moving, floating, fluid."""
    counts = [values.get(name) for name in ("CaseNfixed", "CaseNmoving", "CaseNfloat")]
    number = found.get("id")
    if number is None or number.ndim != 1 or not all(isinstance(c, int) for c in counts):
        return
    ends = np.cumsum(np.array([min(c, 2**40) for c in counts if isinstance(c, int)], np.int64))
    found["type"] = np.searchsorted(ends, number.astype(np.int64), side="right").astype(np.uint8)


def _box(values: dict[str, Any]) -> Box | None:
    lo, hi = values.get("MapPosMin"), values.get("MapPosMax")
    if not (isinstance(lo, list) and isinstance(hi, list)):
        return None
    sizes = np.subtract(hi, lo)
    # The program moves particles through periodic faces itself: nothing is wrapped here.
    return Box.of_sizes(lo, sizes) if np.isfinite([lo, sizes]).all() and sizes.any() else None


class _Tree:
    """Values and arrays of all items, by name; the arrays of parts are joined."""

    def __init__(self, path: Any, data: bytes, wide: bool):
        self.path, self.data, self.at = path, data, _HEADER
        self.size = "<Q" if wide else "<I"
        self.values: dict[str, Any] = {}
        self.arrays: dict[str, np.ndarray] = {}
        self.n_items = 0

    def all(self) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
        self.item(0)
        return self.values, self.arrays

    def take(self, size: int) -> bytes:
        if size > len(self.data) - self.at:
            left = len(self.data) - self.at
            raise bad(self.path, f"offset {self.at}", f"expected {size} bytes, got {left}")
        self.at += size
        return self.data[self.at - size : self.at]

    def number(self, form: str = "<I") -> int:
        return int(struct.unpack(form, self.take(struct.calcsize(form)))[0])

    def text(self) -> str:
        return self.take(self.number()).decode("latin-1")

    def mark(self, expected: str) -> None:
        at, got = self.at, self.text()
        if got != expected:
            problem = f"expected the mark {expected.strip()}, got {shown(got)}"
            raise bad(self.path, f"offset {at}", problem)

    def item(self, depth: int) -> None:
        self.n_items += 1
        if depth > _MOST_NESTED or self.n_items > _MOST_ITEMS:
            raise bad(self.path, f"offset {self.at}", f"expected at most {_MOST_ITEMS} items")
        self.number()  # size of what follows
        self.mark("\nITEM\n")
        self.text()
        self.take(8)  # what is hidden
        self.text(), self.text()  # formats of numbers
        n_arrays, n_items, size = self.number(), self.number(), self.number()
        if size:
            self.mark("\nVALUES")
            for _ in range(self.number()):
                self.value()
        for _ in range(n_arrays):
            self.array()
        for _ in range(n_items):
            self.item(depth + 1)

    def value(self) -> None:
        name, kind = self.text(), self.number()
        if kind == _TEXT:
            self.text()
            return
        code, n = self.kind(kind)
        values = np.frombuffer(self.take(n * np.dtype(code).itemsize), "<" + code).tolist()
        self.values[name] = values[0] if n == 1 else values

    def array(self) -> None:
        self.number()
        self.mark("\nARRAY")
        name = self.text()
        self.number()  # whether it is hidden
        kind, n, size = self.number(), self.number(self.size), self.number(self.size)
        if kind == _TEXT:
            self.take(size)
            return
        code, k = self.kind(kind)
        if size != n * k * np.dtype(code).itemsize:
            problem = f"expected {n} rows in {size} bytes of {code} x {k}"
            raise bad(self.path, shown(name), f"{problem}, got another size")
        values = np.frombuffer(self.take(size), "<" + code).astype(code)
        self.arrays.setdefault(name, values if k == 1 else values.reshape(n, k))

    def kind(self, number: int) -> tuple[str, int]:
        if number not in _TYPES:
            raise bad(self.path, f"offset {self.at}", f"expected a type of data, got {number}")
        return _TYPES[number]
