"""Legacy VTK files, versions up to 5.1, section by section."""

from __future__ import annotations

import re
from typing import Any, NoReturn

import numpy as np

from ..data.particles import Particles
from . import cells
from .asciinum import end_of_tokens, parse_numbers
from .cell_data import at_points, point_arrays
from .cells import Cells
from .errors import bad, faults, shown
from .fields import particles_from
from .size import check_memory

# vtkIdType is written as 32 bits and long as 64 in binary files.
_TYPES = {
    "bit": "u1",
    "char": "i1",
    "signed_char": "i1",
    "unsigned_char": "u1",
    "short": "i2",
    "unsigned_short": "u2",
    "int": "i4",
    "unsigned_int": "u4",
    "vtkidtype": "i4",
    "long": "i8",
    "unsigned_long": "u8",
    "vtktypeint64": "i8",
    "vtktypeuint64": "u8",
    "float": "f4",
    "double": "f8",
}
_CELLS = {
    "CELLS": 0,
    "VERTICES": cells.VERTICES,
    "LINES": cells.LINES,
    "POLYGONS": cells.POLYGONS,
    "TRIANGLE_STRIPS": cells.STRIPS,
}
_COMPONENTS = {"VECTORS": 3, "NORMALS": 3, "TENSORS": 9, "TENSORS6": 6}
_ONE_COMPONENT = ("GLOBAL_IDS", "PEDIGREE_IDS", "EDGE_FLAGS")


def _decoded(word: bytes) -> str:
    plain = re.sub(rb"%([0-9A-Fa-f]{2})", lambda m: bytes([int(m[1], 16)]), word)
    return plain.decode("utf-8", errors="replace")


class VtkReader:
    """A legacy VTK file: its points, its arrays and its cells.

    Raises FormatError.
    """

    data_sets: tuple[str, ...] = ("POLYDATA", "UNSTRUCTURED_GRID", "STRUCTURED_GRID", "RECTILINEAR_GRID")

    def __init__(self, path: Any, data: bytes) -> None:
        self.path = path
        self.data = data
        self.position = 0
        self.claimed = 0  # bytes of all arrays
        self.line_start = 0
        self.binary = False
        self.version = 0
        self.points: np.ndarray | None = None
        self.arrays: dict[str, np.ndarray] = {}
        self.cell_arrays: dict[str, np.ndarray] = {}
        self.lists: dict[str, tuple[int, int, int]] = {}  # of cells: place, and both numbers
        self.n_cells = 0
        self.time: float | None = None

    def particles(self) -> Particles:
        """The points that are no ghosts, with their data and that of vertex cells."""
        points = self.read()
        with faults(self.path, "cells"):
            arrays, kept = point_arrays(len(points), self.arrays, self.cell_arrays, self.n_cells, self.cells)
        if kept is not None:
            points, arrays = points[kept], {name: a[kept] for name, a in arrays.items()}
        return particles_from(self.path, points, arrays)

    def triangles(self) -> tuple[Particles, np.ndarray]:
        """All points with their data, and triangles (F, 3)."""
        points = self.read()
        with faults(self.path, "cells"):
            found = self.cells()
            faces = cells.triangles(points, found, self.arrays, self.cell_arrays)
        return particles_from(self.path, points, at_points(len(points), found, self.cell_arrays) | self.arrays), faces

    def read(self) -> np.ndarray:
        """The points (N, 3), and all arrays."""
        self.sections()
        if self.points is None:
            self.fail("expected POINTS, got the end of the file")
        return self.points

    def sections(self) -> None:
        """Read all sections."""
        self.header()
        section, n_section = "", 0
        while (words := self.words()) is not None:
            keyword = words[0].upper().decode("latin-1")
            if self.geometry(keyword, words):
                continue
            if keyword in ("POINT_DATA", "CELL_DATA"):
                section, n_section = keyword, self.count(words, 1)
                if section == "POINT_DATA" and n_section != self.n_points():
                    self.fail(f"expected POINT_DATA {self.n_points()}, got {n_section}")
                if section == "CELL_DATA" and n_section != self.n_cells:
                    self.fail(f"expected CELL_DATA {self.n_cells}, got {n_section}")
            elif keyword == "METADATA":
                self.skip_metadata()
            elif keyword == "FIELD":
                self.field(words, section, n_section)
            elif section:
                self.attribute(keyword, words, section, n_section)
            else:
                self.fail(f"expected a section of the data set, got {shown(words[0])}")

    def geometry(self, keyword: str, words: list[bytes]) -> bool:
        """Read a section that says where points and cells are; False for any other."""
        if keyword == "POINTS":
            n = self.count(words, 1)
            self.points = self.numbers(3 * n, self.type_of(words, 2)).reshape(n, 3)
        elif keyword in _CELLS:
            self.skip_cells(keyword, words)
        elif keyword == "CELL_TYPES":
            self.n_cells = self.count(words, 1)
            self.lists[keyword] = self.position, self.n_cells, 0
            self.skip(self.n_cells, "int")
        else:
            return False
        return True

    def n_points(self) -> int:
        """How many points were read."""
        return 0 if self.points is None else len(self.points)

    def fail(self, problem: str) -> NoReturn:
        """Raise for the line read last; binary files have no useful line numbers."""
        where = f"byte {self.line_start}" if self.binary else f"line {self.data.count(10, 0, self.line_start) + 1}"
        raise bad(self.path, where, problem)

    def header(self) -> None:
        """Read the first lines."""
        match = re.match(rb"# vtk DataFile Version (\d+)\.\d+[^\n]*\n", self.data[:256])
        if match is None:
            self.fail(f"expected '# vtk DataFile Version', got {shown(self.data[:40])}")
        self.version = int(match[1])
        if self.version > 5:
            self.fail(f"expected a version up to 5.1, got {shown(match[0].strip())}")
        title_end = self.data.find(b"\n", match.end())
        self.position = len(self.data) if title_end < 0 else title_end + 1
        words = self.words() or [b"the end of the file"]
        if words[0].upper() not in (b"ASCII", b"BINARY"):
            self.fail(f"expected ASCII or BINARY, got {shown(words[0])}")
        binary = words[0].upper() == b"BINARY"
        words = self.words() or []
        if [word.upper() for word in words] not in [[b"DATASET", k.encode()] for k in self.data_sets]:
            got = shown(b" ".join(words))
            self.fail(f"expected DATASET {' or '.join(self.data_sets)}, got {got}")
        self.binary = binary

    def words(self) -> list[bytes] | None:
        """The next line that is not blank, split; None at the end of the file."""
        while self.position < len(self.data):
            self.line_start = self.position
            end = self.data.find(b"\n", self.position, self.position + 4096)
            if end < 0:
                end = min(len(self.data), self.position + 4096)
            words = self.data[self.position : end].split()
            self.position = end + 1
            if words:
                return words
        self.line_start = len(self.data)
        return None

    def peek(self, keyword: bytes) -> bool:
        """Whether the next word is a keyword."""
        pattern = re.compile(rb"\s*" + keyword + rb"\b", re.IGNORECASE)
        return pattern.match(self.data, self.position) is not None

    def count(self, words: list[bytes], i: int) -> int:
        """The count that is a line's i-th word."""
        word = words[i] if i < len(words) else b"the end of the line"
        if not word.isdigit() or len(word) > 18:
            self.fail(f"expected a count after {shown(words[0])}, got {shown(word)}")
        return int(word)

    def components(self, words: list[bytes], i: int) -> int:
        """The number of components that is a line's i-th word."""
        k = self.count(words, i)
        if k == 0:
            self.fail("expected at least one component, got 0")
        return k

    def type_of(self, words: list[bytes], i: int) -> str:
        """The type of numbers that is a line's i-th word."""
        word = words[i] if i < len(words) else b"the end of the line"
        kind = word.decode("latin-1").lower().removesuffix("s")  # floats, by ESPResSo
        if kind not in _TYPES:
            self.fail(f"expected a numeric type after {shown(words[0])}, got {shown(word)}")
        return kind

    def name_of(self, words: list[bytes], i: int) -> str:
        """The name that is a line's i-th word."""
        if i >= len(words):
            self.fail(f"expected a name after {shown(words[0])}, got the end of the line")
        return _decoded(words[i])

    def numbers(self, n: int, kind: str) -> np.ndarray:
        """The next n numbers, in native byte order and memory of their own."""
        dtype = np.dtype(_TYPES[kind])
        start = self.position
        self.skip(n, kind)
        self.claimed += n * dtype.itemsize
        check_memory(self.path, "", 2.0 * len(self.data) + 3.0 * self.claimed)
        raw = self.data[start : self.position]
        if self.binary and kind == "bit":
            return np.unpackbits(np.frombuffer(raw, np.uint8), count=n)
        if self.binary:
            return np.frombuffer(raw, dtype.newbyteorder(">")).astype(dtype)
        try:
            values, got = parse_numbers(raw, dtype), "got other text"
        except ValueError as error:
            values, got = np.empty(0), str(error)
        if len(values) != n:
            self.fail(f"expected {n} numbers of type {kind} after this line, {got}")
        return values

    def skip(self, n: int, kind: str) -> None:
        """Pass over n numbers, checking the size before anything is allocated for them."""
        left = max(0, len(self.data) - self.position)
        if not self.binary:
            end = end_of_tokens(self.data, self.position, n) if 2 * n - 1 <= left else -1
            if end < 0:
                self.fail(f"expected {n} numbers after this line, got the end of the file")
            self.position = end
            return
        size = (n + 7) // 8 if kind == "bit" else n * np.dtype(_TYPES[kind]).itemsize
        if size > left:
            self.fail(f"expected {size} bytes of data after this line, got {left}")
        self.position += size

    def skip_cells(self, keyword: str, words: list[bytes]) -> None:
        """Pass over a list of cells, which `cells` reads where they matter."""
        n, size = self.count(words, 1), self.count(words, 2)
        self.lists[keyword] = self.position, n, size
        if self.version < 5:
            self.skip(size, "int")
        else:
            # From 5.0 on: n offsets (one more than there are cells), then the connectivity.
            for name, length in ((b"OFFSETS", n), (b"CONNECTIVITY", size)):
                self.skip(length, self.type_below(name))
        if keyword != "CELLS":
            self.n_cells += n if self.version < 5 else max(n - 1, 0)

    def type_below(self, name: bytes) -> str:
        """The type in the next line, which begins with a name."""
        line = self.words() or [b"the end of the file"]
        if line[0].upper() != name:
            self.fail(f"expected {name.decode()}, got {shown(line[0])}")
        return self.type_of(line, 1)

    def cells(self) -> Cells:
        """All cells; those of PolyData in the order of their data."""
        found, unknown = [], np.empty(0, np.uint8)
        if "CELL_TYPES" in self.lists:
            self.position, n, _ = self.lists["CELL_TYPES"]
            unknown = self.numbers(n, "int").astype(np.uint8)
        for keyword, kind in _CELLS.items():
            if keyword not in self.lists:
                continue
            self.position, n, size = self.lists[keyword]
            if self.version < 5:
                connectivity, offsets = self.old_cells(n, self.numbers(size, "int"))
            else:
                offsets = self.numbers(n, self.type_below(b"OFFSETS")).astype(np.int64)
                kind_below = self.type_below(b"CONNECTIVITY")
                connectivity = self.numbers(size, kind_below).astype(np.int64)
            if not len(offsets):
                continue
            types = np.full(len(offsets) - 1, kind, np.uint8) if kind else unknown
            if len(types) != len(offsets) - 1:
                raise ValueError(f"expected CELL_TYPES {len(offsets) - 1}, got {len(types)}")
            part = Cells(types, connectivity, offsets)
            found.append(cells.without_streams(part) if not kind else part)
        return found[0] if len(found) == 1 else cells.joined(found)

    def old_cells(self, n: int, numbers: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Connectivity and n + 1 offsets of cells that are each written behind its length."""
        lengths, at = np.zeros(n, np.int64), 0
        k = int(numbers[0]) if n and len(numbers) else 0
        if k > 0 and len(numbers) == n * (k + 1) and (numbers[:: k + 1] == k).all():
            lengths[:] = k
        else:
            for i in range(n):
                lengths[i] = numbers[at] if at < len(numbers) else -1
                at += 1 + int(lengths[i])
                if lengths[i] < 0:
                    break
            if at != len(numbers):
                self.fail(f"expected {n} cells in {len(numbers)} numbers, got another number")
        offsets = np.concatenate([[0], np.cumsum(lengths)])
        heads = offsets[:-1] + np.arange(n)
        return np.delete(numbers, heads).astype(np.int64), offsets

    def skip_metadata(self) -> None:
        """A block of text lines up to a blank one."""
        end = re.compile(rb"\n[ \t\r]*(\n|$)").search(self.data, self.position - 1)
        self.position = len(self.data) if end is None else end.end()

    def field(self, words: list[bytes], section: str, n_section: int) -> None:
        """Read the arrays of a FIELD."""
        for _ in range(self.count(words, 2)):
            line = self.words()
            if line is not None and line[0].upper() == b"METADATA":
                self.skip_metadata()
                line = self.words()
            if line is None:
                self.fail(f"expected {shown(words[2])} arrays in FIELD, got the end of the file")
            k, n = self.count(line, 1), self.count(line, 2)
            values = self.numbers(k * n, self.type_of(line, 3))
            if section and n != n_section:
                self.fail(f"expected {n_section} tuples in {section}, got {n}")
            if k:  # VTK writes arrays without components for empty pieces
                self.keep(section, _decoded(line[0]), values, k)

    def attribute(self, keyword: str, words: list[bytes], section: str, n: int) -> None:
        """Read one array of a section."""
        if keyword == "LOOKUP_TABLE":
            entries = 4 * self.count(words, 2)
            self.skip(entries, "unsigned_char" if self.binary else "float")
            return
        name = self.name_of(words, 1)
        if keyword == "COLOR_SCALARS":
            k = self.components(words, 2)
            values = self.numbers(k * n, "unsigned_char" if self.binary else "float")
            # Whatever its name, this section says that the numbers are colors.
            name = name if k not in (3, 4) or "rgba" in self.arrays else "rgba"
        elif keyword == "SCALARS":
            kind = self.type_of(words, 2)
            k = self.components(words, 3) if len(words) > 3 else 1
            if self.peek(b"LOOKUP_TABLE"):
                self.words()
            values = self.numbers(k * n, kind)
        elif keyword == "TEXTURE_COORDINATES":
            k = self.components(words, 2)
            values = self.numbers(k * n, self.type_of(words, 3))
        elif keyword in _COMPONENTS or keyword in _ONE_COMPONENT:
            k = _COMPONENTS.get(keyword, 1)
            values = self.numbers(k * n, self.type_of(words, 2))
        else:
            self.fail(f"expected an attribute of {section}, got {shown(words[0])}")
        self.keep(section, name, values, k)

    def keep(self, section: str, name: str, values: np.ndarray, k: int) -> None:
        """Keep an array of a section, and a time beside them."""
        if not section and name in ("TimeValue", "TIME") and values.size == 1 and np.isfinite(values[0]):
            self.time = float(values[0])  # of ParaView and VisIt
        if section == "POINT_DATA":
            self.arrays[name] = values if k == 1 else values.reshape(-1, k)
        elif section == "CELL_DATA":
            self.cell_arrays[name] = values if k == 1 else values.reshape(-1, k)
