"""Houdini's classic geometry files (.bgeo, .bgeo.gz), version 5: big-endian, maybe gzipped.

The points and their attributes are read; what follows them (primitives, groups, details) is
passed over. After the layout used by Partio and SPlisHSPlasH.
"""

from __future__ import annotations

import os
import struct
from typing import IO, Any

import numpy as np

from .._base.files import atomic_write
from .._base.memory import largest_ratio
from ..data.particles import Particles
from .errors import FormatError, bad, shown
from .fields import kept_positions, particles_from, per_particle
from .inflate import GZIP, Inflated
from .size import ALWAYS, check_size

_FLOAT, _INT, _INDEXED_STRING, _VECTOR = 0, 1, 4, 5
_MOST_WORDS = 1 << 20  # of one point, far above any use
_LONGEST_HEADER = 1 << 22  # bytes
_HEADER = struct.Struct(">4s c 9i")


def read(path: str | os.PathLike[str]) -> Particles:
    """Read points and attributes. Indexed strings come as their int32 indices. Raises FormatError
    naming the byte."""
    import zlib

    with open(path, "rb") as file:
        size = os.fstat(file.fileno()).st_size
        packed = file.read(2) == b"\x1f\x8b"
        file.seek(0)
        if not packed:
            return _read(_Stream(path, file, size, size))
        try:
            most = int(max(largest_ratio() * size, ALWAYS))
            return _read(_Stream(path, Inflated(file, GZIP), size, most))
        except (EOFError, zlib.error) as error:
            raise bad(path, f"byte {file.tell()}", f"expected gzip data, got {error}") from None


def write(path: str | os.PathLike[str], particles: Particles) -> None:
    """Write points and attributes; gzipped if the name ends in .gz.

    The format knows float32 and int32 only: other floats are rounded to float32, ValueError is
    raised for integers that do not fit.
    """
    import gzip

    n = len(particles)
    homogeneous = np.ones((n, 1), np.float32)
    positions = kept_positions(particles, path)
    words = [np.hstack([positions, homogeneous]).view(np.uint32)]
    definitions = []
    for name, array in per_particle(particles).items():
        values = _float32_or_int32(name, array)
        values = values[:, None] if values.ndim == 1 else values
        k = values.shape[1]
        encoded = name.encode()
        if k > 0xFFFF or len(encoded) > 0xFFFF:
            got = f"{k} with a name of {len(encoded)}"
            raise ValueError(f"attributes[{shown(name)}]: expected at most 65535 words, got {got}")
        integer = values.dtype == np.int32
        kind = _INT if integer else _VECTOR if k == 3 else _FLOAT
        definitions.append(struct.pack(">H", len(encoded)) + encoded)
        definitions.append(struct.pack(">Hi", k, kind) + bytes(4 * k))
        words.append(values.view(np.uint32))
    header = _HEADER.pack(b"Bgeo", b"V", 5, n, 0, 0, 0, len(words) - 1, 0, 0, 0)
    content = header + b"".join(definitions) + np.hstack(words).astype(">u4").tobytes()
    content += b"\x00\xff"  # no further sections
    if os.fspath(path).lower().endswith(".gz"):
        content = gzip.compress(content, compresslevel=6, mtime=0)
    with atomic_write(path) as file:
        file.write(content)


def _float32_or_int32(name: str, array: np.ndarray) -> np.ndarray:
    if array.dtype.kind == "f":
        with np.errstate(over="ignore"):
            return np.ascontiguousarray(array, np.float32)
    limits = np.iinfo(np.int32)
    if array.size and array.dtype.kind != "b":
        low, high = int(array.min()), int(array.max())
        if low < limits.min or high > limits.max:
            got = low if low < limits.min else high
            raise ValueError(f"attributes[{name!r}]: expected int32 values for .bgeo, got {got}")
    return np.ascontiguousarray(array, np.int32)


class _Stream:
    """Bytes from a file that may be compressed, never more than it can hold."""

    def __init__(self, path: Any, file: IO[bytes] | Inflated, held: int, limit: int) -> None:
        self.path = path
        self.file = file
        self.held = held  # bytes of the file
        self.limit = limit  # bytes that it may unpack to
        self.position = 0

    def bad(self, problem: str) -> FormatError:
        return bad(self.path, f"byte {self.position}", problem)

    def take(self, size: int) -> bytes:
        left = self.limit - self.position
        if size > left:
            raise self.bad(f"expected {size} bytes, got a file of at most {left} more")
        data = self.file.read(size)
        if len(data) < size:
            raise self.bad(f"expected {size} bytes, got {len(data)}")
        self.position += size
        return data

    def unpack(self, form: str) -> tuple[Any, ...]:
        return struct.unpack(form, self.take(struct.calcsize(form)))


class MappedBgeo:
    """A file without compression, mapped into memory: rows are read when they are used.

    Raises FormatError for a damaged file and for another one.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path = path
        with open(path, "rb") as file:
            held = os.fstat(file.fileno()).st_size
            stream = _Stream(path, file, held, held)
            n, width, self._columns = _head(stream)
            if 4 * n * width > held - stream.position:
                raise stream.bad(f"expected {4 * n * width} bytes, got {held - stream.position} more")
            self.words = np.empty((0, width), ">u4")
            if n:
                self.words = np.memmap(path, ">u4", "r", stream.position, (n, width))

    def particles(self, rows: np.ndarray) -> Particles:
        """The particles of some rows of `words`, copied."""
        return _particles(self.path, rows.astype(np.uint32), self._columns)


def is_mappable(path: str | os.PathLike[str]) -> bool:
    """Whether a file is one of version 5 without compression."""
    with open(path, "rb") as file:
        return file.read(4) == b"Bgeo"


_Columns = list[tuple[str, int, int, int]]  # name, type, first and last word


def _read(stream: _Stream) -> Particles:
    n_points, n_words, columns = _head(stream)
    check_size(stream.path, f"byte {stream.position}", 4 * n_words * n_points, stream.held, 4.0)
    raw = stream.take(4 * n_words * n_points)
    words = np.frombuffer(raw, ">u4").astype(np.uint32).reshape(n_points, n_words)
    del raw
    if isinstance(stream.file, Inflated):
        stream.file.finish()
    return _particles(stream.path, words, columns)


def _head(stream: _Stream) -> tuple[int, int, _Columns]:
    """Points, words of each, and its attributes; the points follow."""
    magic = stream.take(4)
    if magic == b"\x7fNSJ":
        raise stream.bad("expected classic .bgeo (version 5), got Houdini's newer JSON format")
    if magic != b"Bgeo":
        raise stream.bad(f"expected 'Bgeo', got {shown(magic)}")
    letter, version, n_points, _, _, _, n_attributes, _, _, _ = stream.unpack(">c 9i")
    if letter != b"V" or version != 5:
        raise stream.bad(f"expected version V5, got {shown(letter)} {version}")
    if n_points < 0 or n_attributes < 0:
        raise stream.bad(f"expected counts, got {n_points} points, {n_attributes} attributes")
    columns: _Columns = []
    n_words = 4
    for _ in range(n_attributes):
        name, kind, size = _attribute(stream)
        columns.append((name, kind, n_words, n_words + size))
        n_words += size
        if n_words > _MOST_WORDS:
            raise stream.bad(f"expected at most {_MOST_WORDS} words a point, got {n_words}")
        if stream.position > _LONGEST_HEADER:
            raise stream.bad(f"expected attributes within {_LONGEST_HEADER} bytes, got more")
    return n_points, n_words, columns


def _particles(path: Any, words: np.ndarray, columns: _Columns) -> Particles:
    """The particles of points (N, n_words) uint32."""
    arrays = {}
    for name, kind, begin, end in columns:
        integer = kind in (_INT, _INDEXED_STRING)
        values = np.ascontiguousarray(words[:, begin:end]).view(np.int32 if integer else np.float32)
        arrays[name] = values[:, 0] if end - begin == 1 else values
    positions = np.ascontiguousarray(words[:, :3]).view(np.float32)
    return particles_from(path, positions, arrays)


def _attribute(stream: _Stream) -> tuple[str, int, int]:
    """A definition: name, type, number of 32-bit words."""
    (length,) = stream.unpack(">H")
    name = stream.take(length).decode("utf-8", errors="replace")
    size, kind = stream.unpack(">Hi")
    if kind in (_FLOAT, _INT, _VECTOR):
        stream.take(4 * size)  # default values
    elif kind == _INDEXED_STRING:
        (n_strings,) = stream.unpack(">i")
        if 2 * n_strings > _LONGEST_HEADER:
            raise stream.bad(f"expected at most {_LONGEST_HEADER // 2} strings, got {n_strings}")
        for _ in range(n_strings):
            (length,) = stream.unpack(">H")
            stream.take(length)
    else:
        raise stream.bad(f"expected an attribute type 0, 1, 4 or 5 for {shown(name)}, got {kind}")
    if size == 0:
        raise stream.bad(f"expected at least one component for {shown(name)}, got 0")
    return name, kind, size
