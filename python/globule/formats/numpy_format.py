"""NumPy files: .npz with arrays named like the fields of Particles, .npy with positions only; and
MATLAB 5's matrices, which are read as an .npz is.

Pickled objects are never loaded; those of PySPH are read by `pysph_npz`.
"""

from __future__ import annotations

import json
import math
import os
import warnings
import zipfile
import zlib
from collections.abc import Mapping, Sequence
from typing import IO, Any

import numpy as np

from .._base.arrays import to_host
from .._base.checks import unit
from .._base.files import atomic_write
from ..data.particles import SCALAR_FIELDS, UP, Particles
from . import pysph_npz
from .contents import Contents, frame_index
from .errors import bad, shown
from .fields import (
    MOST_LOOKED_AT,
    POSITION_NAMES,
    check_lengths,
    find_positions,
    names_with_id,
    particles_from,
    place_names,
)
from .guarded import decode
from .size import bytes_of, check_size

_PIECE = 1 << 22  # bytes that are read at once
_MOST_COLUMNS = 32  # of two or three rows; wider ones are x, y and z of as many particles
DAMAGED = (  # what a damaged archive raises
    zipfile.BadZipFile,
    zlib.error,
    EOFError,
    NotImplementedError,  # an unknown compression method
    RuntimeError,  # encrypted
    OSError,  # seeks to nonsense offsets
    OverflowError,
    UnicodeError,
)


def read_npy(path: str | os.PathLike[str], frame: int = 0) -> Contents:
    """Read .npy, (N, 2), (N, 3) or wider: the first columns are the positions, the others become
    attributes `column4` and so on; (F, N, 3) has frames. Of a structured array, fields are as arrays
    of an .npz."""
    with open(path, "rb") as file:
        size = os.fstat(file.fileno()).st_size
        check_size(path, "array", size, size, 3.0)
        array = read_array(path, "array", file, size, records=True)
    if array.ndim == 3:
        return _of_frame(path, {"positions": array}, frame)
    frame_index(path, frame, 1)
    if array.dtype.names is None:
        return Contents(from_columns(path, array))
    return Contents(_from_arrays(path, _fields({"array": array})))


def read_npz(
    path: str | os.PathLike[str], columns: Mapping[str, str] | None = None, species: str | None = None, frame: int = 0
) -> Contents:
    """Read .npz: positions (N, 3) or (N, 2), or x, y, z; fields per particle or as scalars;
    attributes (N, ...). With positions (F, N, 3), arrays (F, N, ...) have frames. Of PySPH's: the
    group `species`, or "fluid".

    Other arrays that do not belong to N particles are left out. `columns` is field or attribute ->
    name of an array. Raises FormatError.
    """
    if (contents := _read_pysph(path, species)) is not None:
        frame_index(path, frame, 1)
        return contents
    if species is not None:
        raise ValueError(f"species: expected none for {path}, which has no groups")
    arrays = _fields(read_archive(path, records=True))
    if columns is not None:
        arrays = {name: _named(path, arrays, column) for name, column in columns.items()}
    elif is_table(arrays):
        frame_index(path, frame, 1)
        return Contents(from_columns(path, next(iter(arrays.values()))))  # of np.savez without a name
    contents = _of_frame(path, arrays, frame)
    particles = contents.particles
    particles.up, names = _facts(path)
    particles.names = {name: kinds for name, kinds in names.items() if name in particles.attributes}
    return contents


def _of_frame(path: Any, arrays: dict[str, np.ndarray], frame: int) -> Contents:
    """One frame of arrays (F, N, ...) beside positions (F, N, 3); the particles of all arrays where
    positions have no frames."""
    lower = {name.lower(): name for name in reversed(list(arrays))}
    names = (lower[name] for name in POSITION_NAMES if name in lower)
    placed = next((arrays[name] for name in names if arrays[name].ndim == 3), None)
    if placed is None or placed.shape[2] not in (2, 3):
        frame_index(path, frame, 1)
        return Contents(_from_arrays(path, arrays))
    n_frames, n = placed.shape[:2]
    k = frame_index(path, frame, n_frames)
    times = next((arrays[lower[name]] for name in ("time", "times", "t") if name in lower), np.empty(0))
    time = float(times[k]) if times.shape == (n_frames,) and times.dtype.kind in "iuf" else None
    shown = {name: array[k] if array.shape[:2] == (n_frames, n) else array for name, array in arrays.items()}
    of_frame = {name: array for name, array in shown.items() if array is not times}
    return Contents(_from_arrays(path, of_frame), time=time, n_frames=n_frames)


def read_mat(path: str | os.PathLike[str], columns: Mapping[str, str] | None = None) -> Particles:
    """Read MATLAB 5's .mat (of -v4 to -v7): its real matrices, vectors with one axis, as arrays of an
    .npz. Raises FormatError."""
    facts, matrices = decode("matlab", path, "matrices of MATLAB")
    arrays = dict(zip(facts["names"], matrices, strict=True))
    if columns is not None:
        arrays = {name: _named(path, arrays, column) for name, column in columns.items()}
    return _from_arrays(path, arrays, facts["structs"])


def read_up(path: str | os.PathLike[str]) -> tuple[float, float, float]:
    """The direction that `write` has kept, or y."""
    return _facts(path)[0]


def _facts(path: Any) -> tuple[tuple[float, float, float], dict[str, dict[int, str]]]:
    """`up` and `names` of the archive's comment; those of particles that say nothing where it is not
    the one that `write` makes."""
    try:
        with zipfile.ZipFile(path) as archive:
            facts = json.loads(archive.comment)
        names = {
            str(name): {int(value): str(word) for value, word in kinds.items()}
            for name, kinds in facts["names"].items()
        }
        x, y, z = unit("up", facts["up"])
        return (x, y, z), names
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError, *DAMAGED):
        return UP, {}


def is_mappable(path: str | os.PathLike[str]) -> bool:
    """Whether an .npz has arrays without compression, and is not PySPH's; true of a damaged one."""
    try:
        with zipfile.ZipFile(path) as archive:
            members = archive.infolist()
    except DAMAGED:
        return True
    stored = all(one.compress_type == zipfile.ZIP_STORED for one in members)
    return stored and not {*pysph_npz.MEMBERS} <= {one.filename for one in members}


def _fields(arrays: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """With the fields of structured arrays in their place."""
    found: dict[str, np.ndarray] = {}
    for name, array in arrays.items():
        fields = array.dtype.names
        found |= {name: array} if fields is None else {k: array[k] for k in fields}
    return found


def _from_arrays(path: Any, arrays: dict[str, np.ndarray], structs: Sequence[str] = ()) -> Particles:
    placed = with_places(arrays)
    positions = find_positions(placed)
    if positions is None:
        found = shown(", ".join(arrays)) if arrays else "no array of numbers"
        problem = f"expected positions (N, 3), or x, y and z (N,), got {found}"
        remedy = 'name them: --columns positions=…,radius=… or gb.read(path, columns={"positions": …})'
        if not arrays or os.fspath(path).lower().endswith(".npy"):
            remedy = "load it and pass gb.Particles(positions)"
        if structs:
            remedy = f"structs are not read: save('NAME.mat', '-struct', {shown(structs[0])}) writes the fields of one"
        if "_facts" in arrays and "place" in arrays:
            remedy = "it is a checkpoint: gb.Simulation.load(path).particles"
        raise bad(path, "archive", f"{problem}; {remedy}")
    arrays = placed
    n = len(positions)
    check_lengths(path, arrays, n)
    for name, array in arrays.items():
        if array.ndim > 2 and len(array) == n and array.size:
            arrays[name] = array.reshape(n, -1)
    return particles_from(path, positions, arrays)


def _read_pysph(path: str | os.PathLike[str], species: str | None) -> Contents | None:
    """What PySPH wrote; None for other archives, also for damaged ones."""
    try:
        with open(path, "rb") as file, zipfile.ZipFile(file) as archive:
            if not {*pysph_npz.MEMBERS} <= {*archive.namelist()}:
                return None
            sizes = [archive.getinfo(name).file_size for name in pysph_npz.MEMBERS]
            check_size(path, "archive", sum(sizes), os.fstat(file.fileno()).st_size, 3.0)
            return pysph_npz.read(path, archive, species)
    except (zipfile.BadZipFile, NotImplementedError, RuntimeError, OSError, UnicodeError):
        return None


def _named(path: Any, arrays: dict[str, np.ndarray], column: str) -> np.ndarray:
    if column not in arrays:
        found = shown(", ".join(arrays))
        raise bad(path, "archive", f"expected an array {shown(column)}, got {found}")
    return arrays[column]


def in_rows(arrays: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """With a row for each particle where positions have one for each axis."""
    return {
        name: a.T if name in POSITION_NAMES and a.ndim == 2 and len(a) in (2, 3) and a.shape[1] > 3 else a
        for name, a in arrays.items()
    }


def with_places(arrays: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """With x, y and z joined to positions, and z = 0 for data in a plane."""
    found = in_rows(arrays)
    for name in ("positions", "position", "pos", "points", "coordinates", "coords", "xy"):
        array = found.get(name)
        if array is not None and array.ndim == 2 and array.shape[1] == 2:
            found["positions" if name == "xy" else name] = np.pad(array, ((0, 0), (0, 1)))
            found.pop("xy", None)
            return found
    if not {name.lower() for name in found} & {*POSITION_NAMES}:  # pos_x, pos_y, pos_z
        axes = place_names(name for name, array in found.items() if array.ndim == 1 and array.dtype.kind in "biuf")
        if "-z" not in axes.values():
            found = {axes.get(name, name): array for name, array in found.items()}
    lower = {name.lower(): name for name in reversed(list(found))}
    parts = [lower[axis] for axis in "xyz" if axis in lower]
    shapes = {found[name].shape for name in parts}
    plain = all(found[name].ndim == 1 and found[name].dtype.kind in "biuf" for name in parts)
    if {"x", "y"} <= lower.keys() and len(shapes) == 1 and plain:
        columns = [found.pop(name) for name in parts]
        columns += [np.zeros(len(columns[0]))] * (3 - len(columns))
        found["positions"] = np.stack(columns, axis=1)
    return found


def write(path: str | os.PathLike[str], particles: Particles) -> None:
    """Write .npz with everything, or .npy with the positions alone."""
    positions = particles.world_positions()
    if not _is_npz(path):
        with atomic_write(path) as file:
            header = np.lib.format.header_data_from_array_1_0(np.ascontiguousarray(positions))
            np.lib.format.write_array_header_1_0(file, header)
            file.write(np.ascontiguousarray(positions).data)  # NumPy's own writing hides why it fails
        return
    arrays = {"positions": positions}
    for name in (*SCALAR_FIELDS, "color", "anisotropy"):
        value = getattr(particles, name)
        if value is not None:
            arrays[name] = np.asarray(value) if isinstance(value, float) else to_host(value)
    arrays.update({name: to_host(array) for name, array in particles.attributes.items()})
    facts = {"up": particles.up, "names": particles.names}
    write_arrays(path, arrays, comment=json.dumps(facts).encode())


def write_arrays(
    path: str | os.PathLike[str], arrays: Mapping[str, np.ndarray], packed: bool = False, comment: bytes = b""
) -> None:
    """Write an .npz, which appears whole or not at all. packed: deflate the arrays. comment: of the
    archive, left out where it is longer than an archive's may be.

    numpy.savez cannot hold an array named "file", and makes a ValueError of Ctrl-C.
    """
    how = zipfile.ZIP_DEFLATED if packed else zipfile.ZIP_STORED
    with atomic_write(path) as file:
        archive = zipfile.ZipFile(file, "w", how)
        try:
            for name, array in arrays.items():
                with archive.open(f"{name}.npy", "w", force_zip64=True) as member:
                    np.lib.format.write_array(member, np.asarray(array), allow_pickle=False)
            archive.comment = comment if len(comment) < 1 << 16 else b""
            archive.close()
        except BaseException:
            archive.fp = None  # closing would complain of the half member; the file is thrown away
            raise


def _is_npz(path: str | os.PathLike[str]) -> bool:
    return os.fspath(path).lower().endswith(".npz")


def read_archive(path: str | os.PathLike[str], records: bool = False) -> dict[str, np.ndarray]:
    """The numeric arrays of an .npz by name; records: structured ones, too. Raises FormatError
    naming the array."""
    arrays = {}
    name = "archive"
    try:
        with open(path, "rb") as file, zipfile.ZipFile(file) as archive:
            members = [info for info in archive.infolist() if info.filename.endswith(".npy")]
            sizes = [info.file_size for info in members]
            # All together: members may share their bytes.
            held = os.fstat(file.fileno()).st_size
            check_size(path, "archive", sum(sizes) + max(sizes, default=0), held)
            for info in members:
                name = info.filename.removesuffix(".npy")
                with archive.open(info) as member:
                    arrays[name] = read_array(path, name, member, info.file_size, records)
                    member.read(1)  # the end, where the checksum is
    except DAMAGED as error:
        raise bad(path, name, f"expected an .npz archive, got {error}") from None
    return arrays


def read_header(
    path: Any, name: str, file: IO[bytes], file_size: int, records: bool = False
) -> tuple[tuple[int, ...], bool, np.dtype]:
    """Shape, Fortran's order and type of an .npy stream of `file_size` bytes, which holds all
    numbers of that shape; records: or structures of numbers. Raises FormatError."""
    begin = file.tell()
    try:
        version = np.lib.format.read_magic(file)
        if version == (1, 0):
            shape, fortran, dtype = np.lib.format.read_array_header_1_0(file)
        elif version == (2, 0):
            shape, fortran, dtype = np.lib.format.read_array_header_2_0(file)
        else:
            raise ValueError(f"version {version}")
        header_size = file.tell() - begin
    except Exception as error:  # the header is parsed as Python text, which fails in many ways
        raise bad(path, name, f"expected an .npy header, got {error}") from None
    if dtype.hasobject or (dtype.fields is not None and not records):
        raise bad(path, name, f"expected plain numbers, got dtype {shown(str(dtype))}")
    shape = tuple(map(int, shape))  # True is an int to NumPy's parser
    count = math.prod(shape)
    size = count * dtype.itemsize
    # An empty array may announce any length beside its zero; no honest one exceeds the file.
    lengths_fit = min(shape, default=0) >= 0 and max(shape, default=0) <= file_size
    if not lengths_fit or size > file_size - header_size:
        problem = f"expected {dtype} {shape} in {file_size - header_size} bytes"
        raise bad(path, name, f"{problem}, got a header that announces {size}")
    return shape, fortran, dtype


def read_array(path: Any, name: str, file: IO[bytes], file_size: int, records: bool = False) -> np.ndarray:
    """One .npy stream of `file_size` bytes, checked before memory is taken; records: as for
    `read_header`. Raises FormatError."""
    shape, fortran, dtype = read_header(path, name, file, file_size, records)
    count = math.prod(shape)
    size = count * dtype.itemsize
    array = np.empty(count, dtype)
    if size:
        view, n = bytes_of(array), 0
        while n < size and (piece := file.read(min(_PIECE, size - n))):
            view[n : n + len(piece)] = piece
            n += len(piece)
        if n < size:
            raise bad(path, name, f"expected {size} bytes, got {n}")
    array = array.reshape(shape, order="F" if fortran else "C")
    return np.ascontiguousarray(array, dtype.newbyteorder("=")).reshape(shape)


def from_columns(path: Any, array: np.ndarray, names: list[str] | None = None) -> Particles:
    """Particles of columns x, y and perhaps z and others; names: those of `names_of_columns`. Raises
    FormatError."""
    if array.ndim != 2 or array.shape[1] < 2 or array.dtype.kind not in "biuf":
        got = f"{array.dtype} {array.shape}"
        raise bad(path, "array", f"expected numbers of shape (N, 3) or wider, got {got}")
    if names is None:
        array = np.ascontiguousarray(rows_of(path, array))
    if array.shape[1] == 2:  # in the plane z = 0
        array = np.pad(array, ((0, 0), (0, 1)))
    names = names or names_of_columns(path, array)
    first = names.index("x")
    columns = {name: array[:, i] for i, name in enumerate(names) if not first <= i < first + 3}
    if "id" in columns:
        columns["id"] = columns["id"].astype(np.int64)
    return particles_from(path, array[:, first : first + 3], columns)


def is_table(arrays: Mapping[str, np.ndarray]) -> bool:
    """Whether one array holds all columns, as of np.savez without a name."""
    return len(arrays) == 1 and next(iter(arrays.values())).ndim == 2 and "positions" not in arrays


def rows_of(path: Any, array: np.ndarray) -> np.ndarray:
    """An array with a row for each particle, of one that may have a row for each axis, with a warning."""
    if len(array) not in (2, 3) or array.shape[1] <= _MOST_COLUMNS:
        return array
    got = f"{len(array)} rows of {array.shape[1]:,}"
    warnings.warn(f"{path}: expected a row for each particle, got {got}: taken as columns", stacklevel=2)
    return array.T


def names_of_columns(path: Any, array: np.ndarray) -> list[str]:
    """x, y, z, column4 … of an array (N, k), behind an id and a type where it has them."""
    names = ["x", "y", "z", *(f"column{i}" for i in range(4, array.shape[1] + 1))]
    if len(names) < 4 or len(array) < 3 or array.dtype.kind not in "iuf":
        return names
    return names_with_id(path, names, array[:MOST_LOOKED_AT], float(array[-1, 0]), len(array))
