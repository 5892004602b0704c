"""VTK XML files: .vtp (PolyData) and .vtu (UnstructuredGrid).

Points and point data of all pieces are read, cell data of vertices as theirs, and faces as
triangles. Data arrays may be ascii, binary (base64), or appended (raw or base64), plain or
compressed with zlib, lz4 or lzma. Follows "VTK File Formats" (Kitware), "XML File Formats".
"""

from __future__ import annotations

import mmap
import os
import re
from typing import Any

import numpy as np

from ..data.particles import Particles
from . import cells
from .asciinum import parse_numbers
from .cell_data import at_points, point_arrays
from .cells import Cells
from .contents import Contents
from .errors import FormatError, bad, faults, shown
from .fields import particles_from, per_particle
from .size import check_memory, check_size, whole_file
from .vtk_xml_data import TYPES, Appended, Stream, unpack
from .xml import parse_xml

TIMES = ("TimeValue", "TIME")  # of ParaView and VisIt
_LISTS = {  # of PolyData, in the order of the cells' data
    "Verts": cells.VERTICES,
    "Lines": cells.LINES,
    "Polys": cells.POLYGONS,
    "Strips": cells.STRIPS,
}
_APPENDED = re.compile(rb"<AppendedData\b([^>]*)>\s*")


def read(path: str | os.PathLike[str]) -> Contents:
    """Read the points and point data of a .vtp or .vtu file, without ghosts."""
    file = VtkXml(path, whole_file(path, 2.0))
    return Contents(file.particles(), time=file.time())


def read_triangles(path: str | os.PathLike[str]) -> tuple[Particles, np.ndarray]:
    """Read all points with their data, and the faces of the cells as triangles (F, 3)."""
    return VtkXml(path, whole_file(path, 4.0)).triangles()


def has_faces(path: str | os.PathLike[str]) -> bool:
    """Whether a file has cells with faces. Raises FormatError for a damaged file."""
    data = whole_file(path, 4.0)
    if re.search(rb"NumberOf(Polys|Strips)\s*=\s*[\"']0*[1-9]", data):
        return True
    if not re.search(rb"NumberOfCells\s*=\s*[\"']0*[1-9]", data):
        return False
    file = VtkXml(path, data)
    return any(cells.have_faces(file.types(piece)) for piece in file.pieces())


def write(path: str | os.PathLike[str], particles: Particles) -> None:
    """Write one piece with a vertex at each point, as appended raw little-endian data."""
    n = len(particles)
    index = np.int32 if n < 2**31 - 1 else np.int64
    connectivity = np.arange(n, dtype=index)
    offsets = np.arange(1, n + 1, dtype=index)
    poly = os.fspath(path).lower().endswith(".vtp")
    kind, cells = ("PolyData", "Verts") if poly else ("UnstructuredGrid", "Cells")
    data = Appended()
    data.write(
        path,
        kind,
        f'<{kind}>\n<Piece NumberOfPoints="{n}" Number{"OfVerts" if poly else "OfCells"}="{n}">\n'
        f"<Points>\n{data.add('Points', particles.world_positions())}</Points>\n<PointData>\n"
        f"{data.add_all(per_particle(particles))}</PointData>\n<{cells}>\n"
        + data.add("connectivity", connectivity)
        + data.add("offsets", offsets)
        + ("" if poly else data.add("types", np.ones(n, np.uint8)))
        + f"</{cells}>\n</Piece>\n</{kind}>\n",
    )


class VtkXml:
    """A VTK XML file: its tree, and the data arrays in it, whatever their encoding.

    Raises FormatError for another root, byte order, header type or compressor.
    """

    data_sets: tuple[str, ...] = ("PolyData", "UnstructuredGrid")

    def __init__(self, path: Any, data: bytes) -> None:
        self.path = path
        self.appended = memoryview(b"")
        self.appended_is_base64 = False
        self.held, self.claimed = len(data), 0  # bytes of the file, and what its arrays unpack to
        text = self.cut_appended(data)
        check_memory(path, "", 2.0 * len(data) + 4.0 * len(text))
        self.root = parse_xml(path, text)
        root = self.root
        if root.tag != "VTKFile":
            raise self.bad("VTKFile", f"expected <VTKFile>, got <{root.tag[:40]}>")
        self.order = self.choice("byte_order", {"LittleEndian": "<", "BigEndian": ">"})
        header = self.choice("header_type", {"UInt32": "u4", "UInt64": "u8"})
        self.header_dtype = np.dtype(header).newbyteorder(self.order)
        compressors = {"": "", "vtkZLibDataCompressor": "zlib", "vtkLZ4DataCompressor": "lz4",
                       "vtkLZMADataCompressor": "lzma"}  # fmt: skip
        self.compressed = self.choice("compressor", compressors)

    def choice(self, attribute: str, choices: dict[str, Any]) -> Any:
        """The value that an attribute of <VTKFile> stands for; the first if it is absent."""
        value = self.root.get(attribute, next(iter(choices)))
        if value not in choices:
            expected = " or ".join(filter(None, choices))
            raise self.bad("VTKFile", f"expected {attribute} {expected}, got {shown(value)}")
        return choices[value]

    def bad(self, element: str, problem: str) -> FormatError:
        """A FormatError at an element."""
        return bad(self.path, f"<{element}>", problem)

    def cut_appended(self, data: bytes) -> bytes:
        """Set the appended data aside: raw bytes are no XML. Returns the rest."""
        tag = _APPENDED.search(data)
        if tag is None:
            return data
        end = data.rfind(b"</AppendedData")
        if end < tag.end():
            raise self.bad("AppendedData", "expected its end </AppendedData>, got the end of the file: cut off?")
        if data[tag.end() : tag.end() + 1] != b"_":
            raise self.bad("AppendedData", "expected _ before the data, got no such thing")
        self.appended = memoryview(data)[tag.end() + 1 : end]
        self.appended_is_base64 = b"raw" not in tag[1]
        return data[: tag.end()] + data[end:]

    def pieces(self) -> list[Any]:
        """The pieces of the data set, at least one."""
        kind = self.root.get("type", "")
        grid = self.root.find(kind) if kind in self.data_sets else None
        if grid is None:
            problem = f"expected {' or '.join(self.data_sets)}, got {shown(kind)}"
            raise self.bad("VTKFile", problem)
        found = grid.findall("Piece")
        if not found:
            raise self.bad(kind, "expected a <Piece>, got none")
        return found

    def time(self) -> float | None:
        """The time that ParaView writes among the data of the file; None without it."""
        for array in self.root.iterfind("*/FieldData/DataArray"):
            if array.get("Name") in TIMES and array.get("type") in TYPES and array.get("NumberOfTuples", "1") == "1":
                values = self.array(array, 1).ravel()
                return float(values[0]) if len(values) == 1 and np.isfinite(values[0]) else None
        return None

    def particles(self) -> Particles:
        """The points of all pieces that are no ghosts, with their data and that of vertex cells."""
        return self.together([self.own_points(element) for element in self.pieces()])

    def triangles(self) -> tuple[Particles, np.ndarray]:
        """All points of all pieces with their data, and the faces of the cells (F, 3)."""
        pieces, found, first = [], [np.empty((0, 3), np.int64)], 0
        for element in self.pieces():
            arrays = self.piece(element)
            points = arrays["", 3]
            of_cells = self.cell_arrays(element)
            with faults(self.path, "cells"):
                own = self.cells(element)
                faces = cells.triangles(points, own, named(arrays), of_cells)
            pieces.append(_keyed(at_points(len(points), own, of_cells) | named(arrays)) | {("", 3): points})
            found.append(faces + first)
            first += len(points)
        return self.together(pieces), np.concatenate(found)

    def together(self, pieces: list[dict[tuple[str, int], np.ndarray]]) -> Particles:
        """The particles of all pieces, with the arrays that all with points have."""
        filled = [piece for piece in pieces if len(piece["", 3])] or pieces[:1]
        arrays = {}
        for key in filled[0]:
            if all(key in piece for piece in filled):
                arrays[key] = np.concatenate([piece[key] for piece in filled])
        positions = arrays.pop(("", 3))
        return particles_from(self.path, positions, named(arrays))

    def own_points(self, element: Any) -> dict[tuple[str, int], np.ndarray]:
        """As `piece`, without ghosts, and with the data of vertex cells."""
        arrays = self.piece(element)
        points = arrays.pop(("", 3))
        with faults(self.path, "cells"):
            found, kept = point_arrays(
                len(points), named(arrays), self.cell_arrays(element), self.n_cells(element),
                lambda: self.cells(element),
            )  # fmt: skip
        keyed = _keyed(found) | {("", 3): points}
        return keyed if kept is None else {key: a[kept] for key, a in keyed.items()}

    def n_cells(self, element: Any) -> int:
        """How many cells a piece has."""
        return sum(self.count(element, name, "0") for name in _counts(element))

    def cell_arrays(self, element: Any) -> dict[str, np.ndarray]:
        """The arrays of a piece's cells by name."""
        n = self.n_cells(element)
        return {
            a.get("Name", ""): self.array(a, n)
            for a in element.iterfind("CellData/DataArray")
            if n and a.get("type") in TYPES and a.get("Name")
        }

    def types(self, element: Any) -> np.ndarray:
        """The types of a piece's cells in UnstructuredGrid."""
        n = self.count(element, "NumberOfCells", "0")
        named = self.cell_lists(element, "Cells", ("types",)) if n else {}
        return self.array(named["types"], n).astype(np.uint8) if n else np.empty(0, np.uint8)

    def cell_lists(self, element: Any, name: str, needed: tuple[str, ...]) -> dict[str, Any]:
        """The elements of a list of cells by name. Raises FormatError without those needed."""
        arrays = {a.get("Name", ""): a for a in element.iterfind(f"{name}/DataArray")}
        if not arrays.keys() >= set(needed):
            raise self.bad(name, f"expected the arrays {' and '.join(needed)}")
        return arrays

    def cells(self, element: Any) -> Cells:
        """The cells of a piece; those of PolyData in the order of their data."""
        found = []
        for name in _counts(element):
            n = self.count(element, name, "0")
            if not n:
                continue
            name = name.removeprefix("NumberOf")
            arrays = self.cell_lists(element, name, ("connectivity", "offsets"))
            ends = self.array(arrays["offsets"], n).astype(np.int64)
            offsets = np.concatenate([[0], ends])
            corners = self.array(arrays["connectivity"], max(int(ends[-1]), 0)).astype(np.int64)
            types = np.full(n, _LISTS[name], np.uint8) if name in _LISTS else self.types(element)
            part = Cells(types, corners, offsets)
            found.append(part if name in _LISTS else self.with_polyhedra(part, arrays))
        return found[0] if len(found) == 1 else cells.joined(found)

    def with_polyhedra(self, part: Cells, arrays: dict[str, Any]) -> Cells:
        """The cells with the faces of polyhedra, as streams, or as VTK 9.4 and later write them."""
        n = len(part.types)
        if not (part.types == cells.POLYHEDRON).any():
            return part
        if {"faces", "faceoffsets"} <= arrays.keys():
            ends = self.array(arrays["faceoffsets"], n).astype(np.int64)
            stream = self.array(arrays["faces"], max(int(ends.max()), 0)).astype(np.int64)
            solid = ends >= 0
            begins = np.full(n, -1)
            begins[solid] = np.concatenate([[0], ends[solid][:-1]])
            return cells.with_streams(part, stream, begins)
        names = ("polyhedron_to_faces", "polyhedron_offsets", "face_connectivity", "face_offsets")
        if not arrays.keys() >= set(names):
            raise self.bad("Cells", "expected the arrays faces and faceoffsets of polyhedra")
        ends = self.array(arrays["polyhedron_offsets"], n).astype(np.int64)
        of_cell = self.array(arrays["polyhedron_to_faces"], max(int(ends[-1]), 0)).astype(np.int64)
        n_faces = int(of_cell.max(initial=-1)) + 1
        offsets = self.array(arrays["face_offsets"], n_faces).astype(np.int64)
        corners = self.array(arrays["face_connectivity"], int(offsets.max(initial=0)))
        return cells.with_faces(part, corners.astype(np.int64), offsets, of_cell, ends)

    def piece(self, element: Any) -> dict[tuple[str, int], np.ndarray]:
        """Arrays by name and number of components; the points have the name ""."""
        n = self.n_points(element)
        places = self.places(element, n) if n else np.empty((0, 3), np.float32)
        arrays: dict[tuple[str, int], np.ndarray] = {("", 3): places}
        for data_array in element.iterfind("PointData/DataArray"):
            name = data_array.get("Name", "")
            if data_array.get("type") in TYPES and name:
                values = self.array(data_array, n)
                arrays[name, 1 if values.ndim == 1 else values.shape[1]] = values
        return arrays

    def n_points(self, element: Any) -> int:
        """How many points a piece has."""
        return self.count(element, "NumberOfPoints")

    def places(self, element: Any, n: int) -> np.ndarray:
        """The points (n, 3) of a piece that has some."""
        points = element.find("Points/DataArray")
        if points is None:
            raise self.bad("Piece", "expected <Points> with a <DataArray>, got none")
        found = self.array(points, n)
        if found.shape != (n, 3):
            raise self.bad("Points", f"expected 3 components, got {found.shape[1:]}")
        return found

    def count(self, element: Any, attribute: str, default: str = "") -> int:
        """A count, >= 0, in an attribute."""
        text = element.get(attribute, default).strip()
        if not (text.isascii() and text.isdigit() and len(text) <= 18):
            raise self.bad(element.tag, f"expected {attribute} as a count, got {shown(text)}")
        return int(text)

    def array(self, element: Any, n: int) -> np.ndarray:
        """A data array, (n,) or (n, k), in native byte order and memory of its own."""
        name, k, dtype = self.numbers(element)
        self.claimed += n * k * dtype.itemsize  # all together: arrays may share their bytes
        check_size(self.path, f"<{name}>", self.claimed, self.held, 3.0)
        encoding = element.get("format", "ascii")
        if n == 0:
            values = np.empty(0, dtype)
        elif encoding == "ascii":
            values = self._ascii(element, name, n * k, dtype)
        elif encoding in ("binary", "appended"):
            is_base64, start = True, 0
            if encoding == "binary":
                source = memoryview("".join(_text(element).split()).encode())
            else:
                source, is_base64 = self.appended, self.appended_is_base64
                start = self.count(element, "offset")
            stream = Stream(source, start, is_base64, lambda problem: self.bad(name, problem))
            raw = self.payload(stream, n * k * dtype.itemsize)
            values = np.frombuffer(raw, dtype.newbyteorder(self.order)).astype(dtype)
        else:
            raise self.bad(name, f"expected format ascii, binary or appended, got {encoding!r}")
        return values if k == 1 else values.reshape(n, k)

    def numbers(self, element: Any) -> tuple[str, int, np.dtype]:
        """A data array's name in messages, components and type."""
        name = f"DataArray {element.get('Name', '')}"
        k = self.count(element, "NumberOfComponents", "1")
        kind = element.get("type", "")
        if k == 0 or kind not in TYPES:
            raise self.bad(name, f"expected numbers, got {k} components of type {shown(kind)}")
        return name, k, np.dtype(TYPES[kind])

    def _ascii(self, element: Any, name: str, n: int, dtype: np.dtype) -> np.ndarray:
        try:
            values = parse_numbers(_text(element).encode(), dtype)
        except ValueError as error:
            kind = element.get("type", "")
            raise self.bad(name, f"expected {n} numbers of type {kind}, {error}") from None
        if len(values) != n:
            raise self.bad(name, f"expected {n} numbers, got {len(values)}")
        return values

    def payload(self, stream: Stream, expected: int) -> bytes:
        """The `expected` bytes of an array, behind a header with sizes."""
        width = self.header_dtype.itemsize
        if not self.compressed:
            (n_bytes,) = np.frombuffer(stream.header(width), self.header_dtype).tolist()
            if n_bytes != expected:
                raise stream.bad(f"expected {expected} bytes, got {n_bytes}")
            return stream.rest(n_bytes)
        start = np.frombuffer(stream.header(3 * width), self.header_dtype).tolist()
        n_blocks, block_size, last_size = start
        if (3 + n_blocks) * width > len(stream.source):
            raise stream.bad(f"expected compressed blocks, got {n_blocks} of them")
        header = stream.header((3 + n_blocks) * width)
        stream.end_header()
        packed_sizes = np.frombuffer(header, self.header_dtype).tolist()[3:]
        sizes = [block_size] * n_blocks
        if last_size and n_blocks:
            sizes[-1] = last_size
        if sum(sizes) != expected:
            raise stream.bad(f"expected {expected} bytes, got blocks of {sum(sizes)}")
        packed = stream.rest(sum(packed_sizes))
        return unpack(self.compressed, packed, packed_sizes, sizes, stream)


class MappedVtk(VtkXml):
    """A file whose arrays are appended raw, mapped into memory: rows are read when they are used.

    Raises FormatError for another file.
    """

    def __init__(self, path: Any) -> None:
        with open(path, "rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
            tag, self.end = _APPENDED.search(data), data.rfind(b"</AppendedData")
            if tag is None or self.end <= tag.end():
                raise bad(path, "<AppendedData>", "expected it, got none")
            self.begin = tag.end() + 1
            super().__init__(path, data[: self.begin] + data[self.end :])

    def array(self, element: Any, n: int) -> np.ndarray:
        """A data array, (n,) or (n, k), in the file's byte order."""
        name, k, dtype = self.numbers(element)
        shape = n if k == 1 else (n, k)
        if n == 0:
            return np.empty(shape, dtype)
        start, width = self.begin + self.count(element, "offset"), self.header_dtype.itemsize
        size = n * k * dtype.itemsize
        if element.get("format") != "appended" or start + width + size > self.end:
            raise self.bad(name, f"expected {size} bytes of appended data, got fewer")
        (held,) = np.fromfile(self.path, self.header_dtype, 1, offset=start).tolist()
        if held != size:
            raise self.bad(name, f"expected {size} bytes, got {held}")
        own = dtype.newbyteorder(self.order)
        return np.memmap(self.path, own, "r", start + width, shape)


def is_mappable(path: str | os.PathLike[str]) -> bool:
    """Whether a file has one piece, no ghosts and no cell data, and all its arrays appended raw,
    without compression."""
    if not os.path.getsize(path):
        return False
    with open(path, "rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
        tag = _APPENDED.search(data)
        if tag is None or b"raw" not in tag[1]:
            return False
        head = data[: tag.end()]
    elsewhere = re.search(rb"""\bcompressor\s*=|format\s*=\s*["'](ascii|binary)|vtkGhost|<CellData[^>]*>\s*<""", head)
    return elsewhere is None and head.count(b"<Piece") == 1


def named(arrays: dict[tuple[str, int], np.ndarray]) -> dict[str, np.ndarray]:
    """The arrays by their names, without the points."""
    return {name: a for (name, _), a in arrays.items() if name}


def _keyed(arrays: dict[str, np.ndarray]) -> dict[tuple[str, int], np.ndarray]:
    return {(name, 1 if a.ndim == 1 else a.shape[1]): a for name, a in arrays.items()}


def _counts(element: Any) -> tuple[str, ...]:
    """The attributes of a piece that count its cells."""
    if element.get("NumberOfCells") is not None:
        return ("NumberOfCells",)
    return tuple(f"NumberOf{name}" for name in _LISTS)


def _text(element: Any) -> str:
    """The text of an element without that of its children (VTK's information keys)."""
    return (element.text or "") + "".join(child.tail or "" for child in element)
