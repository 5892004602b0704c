"""GSD, of HOOMD-blue and others: chunks of arrays by frame and name ("GSD file layer", versions 1
and 2; "HOOMD schema").

A frame leaves out what is as in frame 0. The support of a sphere follows from its diameter.
"""

from __future__ import annotations

import json
import os
import struct
import warnings
from typing import Any

import numpy as np

from .contents import Box, Contents, frame_index
from .errors import bad, shown
from .fields import particles_from
from .size import check_size

_MAGIC = 0x65DF65DF65DF65DF
_HEADER = struct.Struct("<QQQQQII64s64s")
_INDEX = np.dtype([("frame", "<u8"), ("n", "<u8"), ("location", "<i8"), ("m", "<u4"), ("id", "<u2"),
                   ("type", "u1"), ("flags", "u1")])  # fmt: skip
_TYPES = {1: "u1", 2: "<u2", 3: "<u4", 4: "<u8", 5: "i1", 6: "<i2", 7: "<i4", 8: "<i8", 9: "<f4",
          10: "<f8"}  # fmt: skip
_NAMES = {"typeid": "type", "body": "body"}


def read(path: str | os.PathLike[str], frame: int = 0) -> Contents:
    """Read a frame of a .gsd file with its box, which is periodic. Raises FormatError."""
    with open(path, "rb") as file:
        found = _Gsd(path, file)
        return found.contents(frame_index(path, frame, found.n_frames))


def _diameter(words: bytes) -> float:
    """The diameter of a type whose shape is a sphere; else NaN."""
    try:
        shape = json.loads(words.split(b"\0")[0])
        return float(shape["diameter"]) if shape["type"] == "Sphere" else np.nan
    except (ValueError, TypeError, KeyError, OverflowError, RecursionError):
        return np.nan


class _Gsd:
    def __init__(self, path: Any, file: Any):
        self.path, self.file = path, file
        self.held = os.fstat(file.fileno()).st_size
        self.claimed = 0
        head = file.read(_HEADER.size)
        if len(head) < _HEADER.size:
            raise bad(path, "header", f"expected {_HEADER.size} bytes, got {len(head)}")
        magic, index_at, n_index, names_at, n_names, _, version, _, schema = _HEADER.unpack(head)
        if magic != _MAGIC:
            raise bad(path, "header", f"expected the mark of a GSD file, got {magic:#x}")
        if version >> 16 not in (1, 2):
            raise bad(path, "header", f"expected version 1 or 2, got {version >> 16}")
        if not schema.startswith(b"hoomd\0"):
            expected = "expected the schema hoomd"
            raise bad(path, "header", f"{expected}, got {shown(schema.split(bytes(1))[0])}")
        names = self.bytes_at("names", names_at, 64 * n_names)
        if version >> 16 == 1:
            words = [names[i : i + 64].split(b"\0")[0] for i in range(0, len(names), 64)]
        else:
            words = names.split(b"\0")
        self.names = {word.decode("utf-8", "replace"): i for i, word in enumerate(words) if word}
        raw = self.bytes_at("index", index_at, _INDEX.itemsize * n_index)
        index = np.frombuffer(raw, _INDEX)
        unused = np.flatnonzero(index["location"] == 0)
        self.index = index[: unused[0]] if len(unused) else index
        if not len(self.index):
            raise bad(path, "index", "expected a frame, got none")
        last = int(self.index["frame"][-1])
        if last >= len(self.index):
            # Every frame writes a chunk at least: its step.
            raise bad(path, "index", f"expected at most {len(self.index)} frames, got {last + 1}")
        self.n_frames = last + 1

    def bytes_at(self, what: str, place: int, size: int) -> bytes:
        if place + size > self.held or place < 0:
            left = max(self.held - place, 0)
            raise bad(self.path, what, f"expected {size} bytes at offset {place}, got {left}")
        self.claimed += size
        check_size(self.path, what, self.claimed, self.held, 2.0)
        self.file.seek(place)
        return self.file.read(size)

    def chunk(self, frame: int, name: str) -> np.ndarray | None:
        """The array of a name in a frame, or else in frame 0."""
        number = self.names.get(name, -1)
        for wanted in dict.fromkeys((frame, 0)):
            at = np.flatnonzero((self.index["frame"] == wanted) & (self.index["id"] == number))
            if not len(at):
                continue
            entry = self.index[at[-1]]
            if int(entry["type"]) not in _TYPES:
                return None
            dtype = np.dtype(_TYPES[int(entry["type"])])
            n, m = int(entry["n"]), int(entry["m"])
            raw = self.bytes_at(name, int(entry["location"]), n * m * dtype.itemsize)
            values = np.frombuffer(raw, dtype).astype(dtype.newbyteorder("="))
            return values if m == 1 else values.reshape(n, m)
        return None

    def contents(self, frame: int) -> Contents:
        n_given = self.chunk(frame, "particles/N")
        n = int(n_given[0]) if n_given is not None and n_given.size == 1 else 0
        positions = self.chunk(frame, "particles/position")
        if positions is None:
            positions = np.zeros((n if n <= self.held else 0, 3), np.float32)
        if positions.ndim != 2 or positions.shape[1] != 3:
            problem = f"expected shape (N, 3), got {positions.shape}"
            raise bad(self.path, "particles/position", problem)
        if len(positions) != n:
            raise bad(self.path, "particles/position", f"expected {n} rows, got {len(positions)}")
        arrays = {}
        for name in self.names:
            group, _, field = name.partition("/")
            if group == "log" and field.startswith("particles/"):
                field = field.rpartition("/")[2]
            elif group != "particles" or field in ("N", "position", "types", "image"):
                continue
            values = self.chunk(frame, name)
            if values is not None and len(values) == n:
                arrays[_NAMES.get(field, field)] = values
        if "diameter" not in arrays and (known := self.diameters(frame, n, arrays.get("type"))) is not None:
            arrays["diameter"] = known
        diameter = arrays.get("diameter")
        if diameter is not None and diameter.ndim == 1:
            arrays.setdefault("radius", diameter / 2)
        box = self.box(frame)
        wrapped = positions if box is None else box.wrap(positions)
        step = self.chunk(frame, "configuration/step")
        time = float(step[0]) if step is not None and step.shape == (1,) else None
        particles = particles_from(self.path, wrapped, arrays)
        if (words := self.chunk(frame, "particles/types")) is not None and words.ndim == 2:
            rows = enumerate(words.astype(np.uint8))
            kinds = {k: row.tobytes().split(b"\0")[0].decode("utf-8", "replace") for k, row in rows}
            particles.names = {"type": kinds}
        return Contents(particles, box, {}, time, self.n_frames)

    def diameters(self, frame: int, n: int, types: np.ndarray | None) -> np.ndarray | None:
        """Diameters (N,) of particles for which a frame has none: those of their types where the file
        says that these are spheres, else 1, the schema's default, where another frame has some."""
        shapes = self.chunk(frame, "particles/type_shapes")
        if shapes is not None and shapes.ndim == 2 and n:
            kinds = np.zeros(n, np.int64) if types is None else types.astype(np.int64)
            sizes = np.array([_diameter(row.astype(np.uint8).tobytes()) for row in shapes])
            if kinds.max() < len(sizes) and np.isfinite(sizes[kinds]).all():
                return sizes[kinds].astype(np.float32)
        if "particles/diameter" in self.names:
            return np.ones(n, np.float32)
        if n:
            missing = "no diameters: GSD leaves them out where all are 1"
            options = "--surface spheres --particle-spacing 1"
            warnings.warn(f"{self.path}: {missing}; if they are, {options} draws such spheres", stacklevel=2)
        return None

    def box(self, frame: int) -> Box | None:
        """The box [Lx, Ly, Lz, xy, xz, yz], around the origin; Lz = 0 stands for two dimensions."""
        values = self.chunk(frame, "configuration/box")
        if values is None:  # the schema's default
            values = np.array([1.0, 1, 1, 0, 0, 0])
        if values.shape != (6,) or not np.isfinite(values).all():
            return None
        x, y, z, xy, xz, yz = map(float, values)
        edges = np.array([[x, 0, 0], [xy * y, y, 0], [xz * z, yz * z, z]])
        return Box(-edges.sum(axis=0) / 2, edges, (x > 0, y > 0, z > 0))
