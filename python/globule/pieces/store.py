"""Particles outside of the memory: chunks of a file, and the pieces' rows in temporary files."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np

from .._base.arrays import to_host
from ..data.attributes import ELEMENT_NAMES
from ..data.particles import FARTHEST, HERE, UP, Particles
from ..data.radii import find_radii
from ..scene.fitting import is_positions
from ..scene.scene import DEFAULT_COLOR
from ..scene.sources import as_particles

CHUNK = 1 << 17  # particles that are in memory at a time while they are dealt out
COLUMNS = {"positions": 3, "support": 1, "weight": 1, "color": 3, "anisotropy": 9,
           "reflection": 1, "refraction": 1}  # fmt: skip
# Attributes by which the surface is chosen.
TELLING: dict[str, Callable[[Particles], np.ndarray | None]] = {
    "radius": lambda particles: find_radii(particles, of_all=False),
    "phase": lambda particles: _told(particles, ("phase", "phases")),
    "element": lambda particles: _told(particles, ELEMENT_NAMES),
}
USUAL = {"color": DEFAULT_COLOR, "reflection": 0.0, "refraction": 0.0}  # of what is missing; else 1


class Source(NamedTuple):
    """Particles that are read range by range.

    n     their number
    read  read(first, last) -> Particles
    up    theirs
    size  particles to read at a time
    """

    n: int
    read: Callable[[int, int], Particles]
    size: int = CHUNK
    up: tuple[float, float, float] = UP
    origin: Callable[[], tuple[float, float, float]] = lambda: HERE

    def chunks(self, first: int = 0, last: int | None = None) -> Iterator[Particles]:
        """All particles that have a position, or those from `first` to `last`, range by range."""
        last = self.n if last is None else last
        for begin in range(first, last, self.size):
            some = self.read(begin, min(begin + self.size, last))
            size = np.abs(to_host(some.positions))
            near = not len(some) or size.max() <= FARTHEST  # no NaN either
            yield some if near else some[(size <= FARTHEST).all(axis=1)]


def source_of(value: Any) -> Source:
    """Ranges of a file, or of anything that `Scene` takes."""
    if isinstance(value, Source):
        return value
    if isinstance(value, (str, os.PathLike)):
        from ..formats import up_of  # formats are loaded when they are needed
        from ..formats.ranges import ranges

        n, read, start = ranges(value)
        return Source(n, read, up=up_of(value)[0], origin=start)
    if is_positions(value):  # of a file mapped into memory, perhaps: never all of them
        return Source(len(value), lambda first, last: Particles(value[first:last]))
    particles = as_particles("particles", value)
    n, up, origin = len(particles), particles.up, particles.origin
    return Source(n, lambda first, last: particles[first:last], up=up, origin=lambda: origin)


class Layout(NamedTuple):
    """How particles become rows of float32.

    each  fields, and attributes that tell, with columns of their own, beside the positions
    one   fields with one value for all particles
    """

    each: tuple[str, ...]
    one: dict[str, Any]

    @property
    def width(self) -> int:
        """Columns of a row."""
        return sum(self.widths)

    def place(self, name: str) -> int:
        """The column where a field begins."""
        return sum(self.widths[: 1 + self.each.index(name)])

    def with_each(self, name: str) -> Layout:
        """With columns for a field."""
        plain = self.without(name)
        return Layout((*plain.each, name), plain.one)

    def without(self, *names: str) -> Layout:
        """Without these."""
        one = {k: v for k, v in self.one.items() if k not in names}
        return Layout(tuple(k for k in self.each if k not in names), one)

    def rows(self, particles: Particles) -> np.ndarray:
        """(N, width) float32."""
        n = len(particles)
        parts = [to_host(particles.positions)]
        for name in self.each:
            own = TELLING[name](particles) if name in TELLING else getattr(particles, name)
            own = USUAL.get(name, 1.0) if own is None else to_host(own)
            value = np.asarray(own, np.float32)
            width = COLUMNS.get(name, 1)
            if value.ndim < (2 if name == "color" else 1):  # one value in this range alone
                value = np.broadcast_to(value, (n, width))
            parts.append(value.reshape(n, width))
        return np.concatenate(parts, axis=1)

    @property
    def widths(self) -> list[int]:
        """Columns of the positions and of each field."""
        return [3, *(COLUMNS.get(name, 1) for name in self.each)]

    def particles(self, rows: np.ndarray) -> Particles:
        """The particles of rows (N, width)."""
        parts = np.split(rows, np.cumsum(self.widths)[:-1], axis=1)
        return self.of([np.ascontiguousarray(part) for part in parts])

    def of(self, columns: list[np.ndarray]) -> Particles:
        """The particles of positions and fields, (N, widths[k]) each, not copied."""
        shapes = {1: (-1,), 3: (-1, 3), 9: (-1, 3, 3)}
        each = [column.reshape(shapes[column.shape[1]]) for column in columns]
        fields: dict[str, Any] = dict(zip(self.each, each[1:], strict=True))
        told = {name: fields.pop(name) for name in TELLING if name in fields}
        return Particles(each[0], **self.one, **fields, attributes=told)


class Columns:
    """The positions and fields of rows that come some at a time."""

    def __init__(self, layout: Layout):
        self._layout = layout
        self._columns = [np.empty((0, width), np.float32) for width in layout.widths]

    def add(self, rows: np.ndarray) -> None:
        """Append rows (N, width)."""
        parts = np.split(rows, np.cumsum(self._layout.widths)[:-1], axis=1)
        for column, part in zip(self._columns, parts, strict=True):
            n = len(column)
            # Where arrays are large, the system moves their pages, not their bytes.
            column.resize((n + len(part), part.shape[1]), refcheck=False)
            column[n:] = part

    def particles(self) -> Particles:
        """All particles."""
        return self._layout.of(self._columns)


def layout_of(particles: Particles, support: float | None) -> Layout:
    """The layout for particles like these. support: in place of theirs."""
    each, one = [], {}
    for name in list(COLUMNS)[1:]:
        value = getattr(particles, name)
        if value is None or (name == "support" and (support or particles.anisotropy is not None)):
            continue
        if np.ndim(value) > (1 if name == "color" else 0):
            each.append(name)
        else:
            one[name] = value
    each += [name for name, find in TELLING.items() if find(particles) is not None]
    return Layout(tuple(each), one)


def _told(particles: Particles, names: tuple[str, ...]) -> np.ndarray | None:
    """The first attribute of these names, one number a particle."""
    found = (to_host(v) for k, v in particles.attributes.items() if k.lower() in names)
    return next((v for v in found if v.ndim == 1 and v.dtype.kind in "biuf"), None)


class Files:
    """The rows of each piece in a temporary file; a context manager that removes them."""

    def __init__(self, n: int, width: int):
        self._folder = tempfile.TemporaryDirectory(prefix="globule-pieces-")
        self._width, self.counts = width, [0] * n

    def add(self, piece: int, rows: np.ndarray) -> None:
        """Append rows (K, width) float32."""
        try:
            with open(self._path(piece), "ab") as file:
                file.write(np.ascontiguousarray(rows, np.float32).data)
        except OSError as error:
            raise MemoryError(
                f"memory: expected room for temporary files in {tempfile.gettempdir()}, which "
                f"TMPDIR names, got: {error.strerror}"
            ) from error
        self.counts[piece] += len(rows)

    def read(self, piece: int) -> np.ndarray:
        """All rows of a piece, (N, width) float32."""
        if not self.counts[piece]:
            return np.empty((0, self._width), np.float32)
        return np.fromfile(self._path(piece), np.float32).reshape(-1, self._width)

    def close(self) -> None:
        """Remove the files."""
        self._folder.cleanup()

    def _path(self, piece: int) -> str:
        return os.path.join(self._folder.name, f"{piece}.rows")


def check_reach(layouts: Sequence[Layout]) -> None:
    """Raise ValueError where some particles say how far their kernels reach and others do not."""
    for name in ("support", "anisotropy"):
        held = [name in x.each or name in x.one for x in layouts]
        if any(held) and not all(held):
            raise ValueError(f"{name}: expected it of all particles or of none, got some without")


def both(a: Layout, b: Layout) -> Layout:
    """A layout for the particles of two."""
    each = [name for name in a.each if name not in TELLING or name in b.each]
    one = {}
    for name in (*b.each, *b.one, *a.one):
        if name in each or name in one or name in TELLING:
            continue
        if name in b.each or not _same(a.one.get(name), b.one.get(name)):
            each.append(name)
        else:
            one[name] = a.one[name]
    return Layout(tuple(each), one)


def _same(a: Any, b: Any) -> bool:
    return a is b if a is None or b is None else np.array_equal(a, b)
