"""Ranges of particles of a file, for data sets that are larger than the memory: .npy, .npz without
compression, HDF5, .bgeo without compression, and .vtu and .vtp whose one piece is appended raw.

`Ranges.read(first, last)` returns what `read` would for these rows alone.
"""

from __future__ import annotations

import functools
import mmap
import os
import zipfile
from collections.abc import Callable, Collection, Mapping
from typing import Any, Literal, NamedTuple

import numpy as np

from .._base.checks import MissingPackageError
from .._base.memory import always_fits, largest_ratio
from ..data.particles import FIELDS, HERE, Particles
from ..data.radii import with_halved_radii
from ..data.scale import scaled
from .bgeo import MappedBgeo
from .bgeo import is_mappable as bgeo_is_mappable
from .errors import FormatError, bad, faults
from .fields import POSITION_NAMES, find_positions, particles_from, say_origin, say_radii
from .kind import kind_of
from .numpy_format import DAMAGED, from_columns, in_rows, is_table, names_of_columns, read_header, rows_of, with_places
from .numpy_format import is_mappable as npz_is_mappable
from .packed import is_packed
from .vtk_xml import MappedVtk
from .vtk_xml import is_mappable as vtk_is_mappable

FORMATS = ("npy", "hdf5")
MAPPABLE = {
    "npz": npz_is_mappable, "vtu": vtk_is_mappable, "vtp": vtk_is_mappable, "bgeo": bgeo_is_mappable,
}  # fmt: skip
NAMES = ".npy, .npz, HDF5, .bgeo without compression or raw appended .vtu"  # for messages
MOST_BYTES = 64.0  # that a scene takes for one byte of a file without compression
_LOCAL_HEADER = 30  # bytes before a zip member's name and extra field


class Ranges(NamedTuple):
    """A file that is read range by range.

    n       particles
    read    read(first, last) -> Particles, rows [first, last)
    origin  origin() -> (x, y, z), world, from which positions are given
    """

    n: int
    read: Callable[[int, int], Particles]
    origin: Callable[[], tuple[float, float, float]] = lambda: HERE


def has_ranges(path: str | os.PathLike[str], given: Collection[str] = ()) -> bool:
    """Whether the format of a file allows ranges, read with these options of `read`."""
    kind = kind_of(path, "particles").format
    if is_packed(path):
        return False
    if kind == "hdf5":
        return not {"where", "center", "min_component"} & {*given}
    mappable = MAPPABLE.get(kind)
    if kind in ("npy", "npz") and _is_whole(path, kind):
        return False
    return {*given} <= {"radius_is", "origin", "scale"} and (
        kind in FORMATS or (mappable is not None and mappable(path))
    )


def _is_whole(path: Any, kind: str) -> bool:
    """Whether positions have an axis of frames, or arrays have fields; False of a damaged file."""
    try:
        arrays = {"positions": _mapped(path, "array", 0)} if kind == "npy" else _members(path)
    except (FormatError, OSError):
        return False
    return any(a.dtype.names or (name.lower() in POSITION_NAMES and a.ndim == 3) for name, a in arrays.items())


def ranges(path: str | os.PathLike[str], **options: Any) -> Ranges:
    """Open a file to read ranges of its particles.

    Args:
        path: of the file.
        options: as for `read`, of those with which `has_ranges`.

    Raises FormatError for a damaged file or another format; `read` also for a file that has changed
    since.
    """
    halved = options.pop("radius_is", "radius") == "diameter"
    origin, scale = options.pop("origin", "auto"), options.pop("scale", 1.0)
    before, (n, read, _) = _state(path), _ranges(path, **options)

    def given(first: int, last: int) -> Particles:
        rows = read(first, last)
        return scaled(with_halved_radii(rows) if halved else rows, scale)

    @functools.cache
    def start() -> tuple[float, float, float]:
        """One origin for all ranges; who only counts the rows reads none."""
        if origin != "auto":
            return origin
        found = given(0, min(n, 10_000)).origin
        say_origin(path, found)
        return found

    def unchanged(first: int, last: int) -> Particles:
        # Other contents may also look damaged: what has changed comes first.
        try:
            rows = given(first, last).at(start())
            say_radii(path, rows)
            return rows
        finally:
            if _state(path) != before:
                raise bad(path, "", "expected a file that stays as it is, got one that changed "
                          "while it was read")  # fmt: skip

    return Ranges(n, unchanged, start)


def _state(path: str | os.PathLike[str]) -> tuple[int, ...] | None:
    """What tells a file from the same one after a change; None where there is none."""
    try:
        found = os.stat(path)
    except OSError:
        return None
    return found.st_dev, found.st_ino, found.st_size, found.st_mtime_ns


def _ranges(path: str | os.PathLike[str], **options: Any) -> Ranges:
    kind = kind_of(path, "particles")
    if kind.format == "npy":
        return _of_array(path, _mapped(path, "array", 0))
    if kind.format == "npz":
        arrays = _members(path)
        return _of_array(path, *arrays.values()) if is_table(arrays) else _of_arrays(path, arrays)
    if kind.format == "hdf5":
        from . import hdf5

        n = hdf5.count(path, **options)
        return Ranges(n, lambda first, last: hdf5.read(path, rows=(first, last), **options).particles)
    if has_ranges(path):
        return _of_bgeo(path) if kind.format == "bgeo" else _of_vtk(path)
    raise FormatError(
        f"{path}: expected {NAMES}, whose ranges can be read, got {kind.format}; globule convert writes .npz"
    )


def counted_rows(path: str, **options: Any) -> tuple[int, float] | None:
    """The number of particles in a file, and the bytes that one takes when it is read; None for a
    file that is read whole, cannot be read, or is so small that it fits whatever it has."""
    try:
        most = os.path.getsize(path) * max(largest_ratio(), MOST_BYTES)
        if always_fits(most) or not has_ranges(path, options):
            return None
        n, read, _ = ranges(path, **options)
        first = read(0, min(n, 1))
    except (ValueError, TypeError, OSError, MissingPackageError):
        return None  # who reads it says what is wrong
    arrays = [getattr(first, name) for name in FIELDS] + list(first.attributes.values())
    return n, float(sum(getattr(array, "nbytes", 0) for array in arrays))


def _of_vtk(path: Any) -> Ranges:
    file = MappedVtk(path)
    arrays = file.piece(file.pieces()[0])
    positions = arrays.pop(("", 3))

    def read(first: int, last: int) -> Particles:
        rows = [_rows(a, first, last).astype(a.dtype.newbyteorder("="), copy=False)
                for a in (positions, *arrays.values())]  # fmt: skip
        names = [name for name, _ in arrays]
        return particles_from(path, rows[0], dict(zip(names, rows[1:], strict=True)))

    return Ranges(len(positions), read)


def _of_bgeo(path: Any) -> Ranges:
    file = MappedBgeo(path)

    def read(first: int, last: int) -> Particles:
        return file.particles(_rows(file.words, first, last))

    return Ranges(len(file.words), read)


def _mapped(path: Any, name: str, offset: int) -> np.ndarray:
    """The .npy stream at an offset of a file, mapped into memory."""
    with open(path, "rb") as file:
        held = os.fstat(file.fileno()).st_size
        file.seek(offset)
        shape, fortran, dtype = read_header(path, name, file, held - offset, records=True)
        start = file.tell()
    if not np.prod(shape):
        return np.empty(shape, dtype)
    order: Literal["F", "C"] = "F" if fortran else "C"
    return np.memmap(path, dtype, "r", start, shape, order)


def _of_array(path: Any, array: np.ndarray) -> Ranges:
    if array.ndim != 2:
        raise bad(path, "array", f"expected numbers of shape (N, 3) or wider, got {array.shape}")
    array = rows_of(path, array)
    names = names_of_columns(path, array) if array.shape[1] > 3 else None
    return Ranges(len(array), lambda first, last: from_columns(path, _rows(array, first, last), names))


def _rows(array: np.ndarray, first: int, last: int) -> np.ndarray:
    """A copy of rows, read from the file: a mapped page ends the program where the file has become
    shorter, and stays in this process's memory."""
    rows = array[first:last]
    if not isinstance(array, np.memmap) or not rows.size:
        return np.array(rows)
    if not rows.flags.c_contiguous:  # columns one after the other, as Fortran has them
        return np.stack([_rows(column, first, last) for column in np.moveaxis(array, -1, 0)], -1)
    # The mapping begins at a whole page.
    begin = np.frombuffer(array._mmap, np.uint8).ctypes.data  # type: ignore[attr-defined]
    place = array.offset - array.offset % mmap.ALLOCATIONGRANULARITY + rows.ctypes.data - begin
    found = np.fromfile(str(array.filename), rows.dtype, rows.size, offset=place)
    if found.size < rows.size:
        raise bad(array.filename, "", f"expected {rows.nbytes} bytes at byte {place}, got "
                  f"{found.nbytes}")  # fmt: skip
    return found.reshape(rows.shape)


def _members(path: Any) -> dict[str, np.ndarray]:
    """The arrays of an .npz, mapped into memory."""
    found = {}
    damaged = faults(path, "archive", "an .npz archive", refused=DAMAGED)
    with damaged, open(path, "rb") as file, zipfile.ZipFile(file) as archive:
        for info in archive.infolist():
            if not info.filename.endswith(".npy"):
                continue
            name = info.filename.removesuffix(".npy")
            if info.compress_type != zipfile.ZIP_STORED:
                raise bad(path, name, "expected arrays without compression, as numpy.savez "
                          "writes them, got a compressed one")  # fmt: skip
            file.seek(info.header_offset)
            header = file.read(_LOCAL_HEADER)
            behind = int.from_bytes(header[26:28], "little")
            behind += int.from_bytes(header[28:30], "little")
            offset = info.header_offset + _LOCAL_HEADER + behind
            found[name] = _mapped(path, name, offset)
    return found


def _of_arrays(path: Any, arrays: Mapping[str, np.ndarray]) -> Ranges:
    """Rows of those arrays that have one for each particle, and all of the others."""
    arrays = in_rows(arrays)
    ends = {name: a[:1] if a.ndim else a for name, a in arrays.items()}
    positions = find_positions(with_places(ends))
    if positions is None:
        found = ", ".join(arrays)
        raise bad(path, "archive", f"expected positions (N, 3), or x, y and z (N,), got {found}")
    n = max((len(a) for a in arrays.values() if a.ndim), default=0)
    for name in ("positions", "position", "pos", "points", "coordinates", "coords", "xyz", "xy", "x"):
        if name in arrays and arrays[name].ndim:
            n = len(arrays[name])
            break

    def read(first: int, last: int) -> Particles:
        some = {}
        for name, array in arrays.items():
            of_each = array.ndim > 0 and len(array) == n
            here = (first, last) if of_each else (0, len(array) if array.ndim else 0)
            some[name] = _rows(array, *here) if array.ndim else np.array(array)
        placed = with_places(some)
        found = find_positions(placed)
        rows = {k: a.reshape(len(a), -1) if a.ndim > 2 else a
                for k, a in placed.items() if a.ndim == 0 or len(a) == last - first}  # fmt: skip
        return particles_from(path, found, rows)

    return Ranges(n, read)
