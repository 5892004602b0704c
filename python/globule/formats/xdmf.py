"""XDMF 2 and 3: XML that says which arrays of HDF5 files beside it are positions and attributes.

Numbers may be in the XML itself, or in HDF5 files below the XDMF file's folder. A temporal
collection of grids has one frame a grid. DataItems may be HyperSlabs, JOINs and references;
XInclude takes elements of this document, and of others below its folder. Cells with faces make a
mesh.
"""

from __future__ import annotations

import itertools
import math
import os
import re
from collections.abc import Callable
from typing import Any

import numpy as np

from ..data.particles import Particles
from . import cells
from .asciinum import parse_numbers
from .cell_data import at_points
from .contents import Contents, frame_index
from .errors import bad, faults, shown
from .fields import particles_from
from .hdf5 import read_arrays
from .size import check_size, whole_file
from .vtk_parts import below
from .xinclude import find_all, include
from .xml import parse_xml

_MOST_ARRAYS, _MOST_NESTED = 1000, 8
# Cells by their names (XdmfTopologyType): points of one, VTK's number, and as many points of it as
# are drawn; those of an order above two, and of volumes of order two but tetrahedra, are corners.
_CELLS = {
    "triangle": (3, 5, 3), "quadrilateral": (4, 9, 4), "tetrahedron": (4, 10, 4),
    "pyramid": (5, 14, 5), "wedge": (6, 13, 6), "hexahedron": (8, 12, 8),
    "triangle_6": (6, 22, 6), "quadrilateral_8": (8, 23, 8), "quadrilateral_9": (9, 28, 9),
    "tetrahedron_10": (10, 24, 10), "pyramid_13": (13, 14, 5), "wedge_15": (15, 13, 6),
    "wedge_18": (18, 13, 6), "hexahedron_20": (20, 12, 8), "hexahedron_24": (24, 12, 8),
    "hexahedron_27": (27, 12, 8),
}  # fmt: skip
_CELLS |= {"tri_6": _CELLS["triangle_6"], "quad_8": _CELLS["quadrilateral_8"],
           "quad_9": _CELLS["quadrilateral_9"], "tet_10": _CELLS["tetrahedron_10"],
           "hex_20": _CELLS["hexahedron_20"], "hex_27": _CELLS["hexahedron_27"]}  # fmt: skip
_COUNTED = {1: cells.VERTICES, 2: cells.LINES, 3: cells.POLYGONS}  # a mixed cell says its points
_NUMBERED = {
    4: "triangle", 5: "quadrilateral", 6: "tetrahedron", 7: "pyramid", 8: "wedge",
    9: "hexahedron", 35: "quadrilateral_9", 36: "triangle_6", 37: "quadrilateral_8",
    38: "tetrahedron_10", 39: "pyramid_13", 40: "wedge_15", 41: "wedge_18", 48: "hexahedron_20",
    49: "hexahedron_24", 50: "hexahedron_27",
}  # fmt: skip


def read(path: str | os.PathLike[str], frame: int = 0) -> Contents:
    """Read the points of the grids of a frame, and attributes of nodes and cells. Raises FormatError."""
    grids = _grids(path, frame)
    parts = [grid.arrays() for grid in grids]
    shapes = [{name: array.shape[1:] for name, array in arrays.items()} for _, arrays in parts]
    shared = [k for k in shapes[0] if all(k in one and one[k] == shapes[0][k] for one in shapes)]
    arrays = {k: np.concatenate([one[k] for _, one in parts]) for k in shared}
    particles = particles_from(path, np.concatenate([x for x, _ in parts]), arrays)
    return Contents(particles, time=grids[0].time, n_frames=grids[0].n_frames)


def read_triangles(path: str | os.PathLike[str]) -> tuple[Particles, np.ndarray]:
    """Read the points of a grid, of several frames the first or that of a `FrameOf`, and the faces
    of its cells as triangles (F, 3). Raises FormatError."""
    grids = _grids(path, getattr(path, "frame", 0))
    faces, first = [], 0
    for grid in grids:
        positions = grid.arrays()[0]
        with faults(path, "<Topology>"):
            faces.append(cells.triangles(positions, grid.find_cells(), {}, {}) + first)
        first += len(positions)
    return read(path, grids[0].frame).particles, np.concatenate(faces)


def has_faces(path: str | os.PathLike[str]) -> bool:
    """Whether a grid of the frame has cells with faces. Raises FormatError."""
    return any(_has_faces(path, grid) for grid in _grids(path, getattr(path, "frame", 0)))


def _has_faces(path: Any, grid: _Grid) -> bool:
    if grid.topology != "mixed":
        return grid.topology in ("polygon", *_CELLS)
    with faults(path, "<Topology>"):
        return cells.have_faces(grid.find_cells().types)


def _grids(path: Any, frame: int) -> list[_Grid]:
    """The grids of a frame: several of a spatial collection, else one. Raises FormatError."""
    data = whole_file(path, 20.0)
    root = parse_xml(path, data)
    if root.tag != "Xdmf":
        raise bad(path, f"<{root.tag[:40]}>", "expected <Xdmf>")
    include(path, root)
    temporal = [g for g in root.iter("Grid") if g.get("CollectionType", "").lower() == "temporal"]
    drawn = (g for g in root.iter("Grid") if _is_collection(g) or g.find("Geometry") is not None)
    frames = temporal[0].findall("Grid") if temporal else list(itertools.islice(drawn, 1))
    if not frames:
        raise bad(path, "<Xdmf>", "expected a <Grid> with a <Geometry>, got none")
    at = frame_index(path, frame, len(frames))
    one = _meant(path, root, frames[at])
    parts = [one]
    if _is_collection(one):
        parts = [g for g in one.iter("Grid") if g is not one and not _is_collection(g)][:_MOST_ARRAYS] or [one]
    time = next((t for t in (_time(g.find("Time")) for g in (one, *parts)) if t is not None), None)
    if time is None and temporal:
        time = _time_of_frame(temporal[0].find("Time"), at)
    return [_Grid(path, root, len(data), _meant(path, root, part), at, len(frames), time) for part in parts]


def _is_collection(grid: Any) -> bool:
    return grid.get("GridType", "").lower() in ("collection", "tree")


class _Grid:
    """A grid of one frame."""

    def __init__(
        self, path: Any, root: Any, size: int, grid: Any, frame: int, n_frames: int, time: float | None
    ) -> None:
        self.path, self.root, self.size, self.grid = path, root, size, grid
        self.frame, self.n_frames, self.time = frame, n_frames, time
        self.element = _meant(path, root, grid.find("Topology"))
        about = {} if self.element is None else self.element.attrib
        self.topology = about.get("TopologyType", about.get("Type", "")).lower()

    def find_cells(self) -> cells.Cells:
        """The cells of a topology with faces; else none. Raises ValueError."""
        stream = np.empty(0, np.int64)
        if self.topology in ("mixed", "polygon", *_CELLS):
            items = {"<Topology>": self.element.findall("DataItem")[:1]}
            stream = _arrays(self.path, self.root, items, self.size)["<Topology>"][0].ravel()
            with np.errstate(invalid="ignore"):  # no number is no point
                stream = stream.astype(np.int64)
        if self.topology == "mixed":
            return _mixed(stream.tolist())
        nodes, kind, corners = _CELLS.get(self.topology, (1, cells.POLYGONS, 1))
        if self.topology == "polygon":
            words = self.element.get("NodesPerElement", "")
            if not (words.isdigit() and 2 < int(words) < 1000):
                raise ValueError(f"expected NodesPerElement from 3, got {shown(words)}")
            nodes = corners = int(words)
        if len(stream) % nodes:
            raise ValueError(f"expected {nodes} points a cell, got {len(stream)} in all")
        stream = stream.reshape(-1, nodes)[:, :corners]
        offsets = corners * np.arange(len(stream) + 1)
        return cells.Cells(np.full(len(stream), kind, np.uint8), stream.ravel(), offsets)

    def arrays(self) -> tuple[np.ndarray, dict[str, np.ndarray]]:
        """The points (N, 3), and the arrays of their data."""
        path, root, grid = self.path, self.root, self.grid
        geometry = _meant(path, root, grid.find("Geometry"))
        if geometry is None:
            raise bad(path, "<Grid>", "expected <Geometry>, got none")
        kind = geometry.get("GeometryType", geometry.get("Type", "XYZ")).upper()
        if kind not in ("XYZ", "XY", "X_Y_Z", "X_Y"):
            raise bad(path, "<Geometry>", f"expected GeometryType XYZ or X_Y_Z, got {shown(kind)}")
        items = {"positions": geometry.findall("DataItem")}
        of_cells: set[str] = set()
        for element in grid.findall("Attribute")[:_MOST_ARRAYS]:
            element = _meant(path, root, element)
            name = element.get("Name", "")
            center = element.get("Center", "Node").lower()
            if center in ("node", "cell") and name and (name not in items or (center == "node" and name in of_cells)):
                items[name] = element.findall("DataItem")[:1]
                (of_cells.add if center == "cell" else of_cells.discard)(name)
        found = _arrays(path, root, items, self.size)
        parts = found.pop("positions")
        if "_" in kind:
            if len(parts) != len(kind) // 2 + 1 or len({p.size for p in parts}) != 1:
                raise bad(path, "<Geometry>", f"expected {kind} arrays of one length")
            positions = np.stack([p.reshape(-1) for p in parts], axis=1)
        else:
            whole = parts[0].size % len(kind) == 0
            positions = parts[0].reshape(-1, len(kind)) if whole else parts[0]
        if positions.ndim != 2 or positions.shape[1] not in (2, 3):
            raise bad(path, "<Geometry>", f"expected shape (N, 3), got {positions.shape}")
        positions = np.pad(positions, ((0, 0), (0, 3 - positions.shape[1])))
        of_points = {k: a[0] for k, a in found.items() if len(a[0]) == len(positions)}
        if of_cells and self.topology in ("mixed", "polygon", *_CELLS):
            with faults(path, "<Topology>"):
                own = self.find_cells()
                if problem := own.problem(len(positions)):
                    raise ValueError(problem)
            values = {k: found[k][0] for k in of_cells if len(found[k][0]) == len(own.types)}
            of_points = {k: a for k, a in of_points.items() if k not in of_cells}
            of_points |= at_points(len(positions), own, values)
        arrays = {k: a.reshape(len(a), -1) if a.ndim > 2 and a.size else a for k, a in of_points.items()}
        return positions, arrays


def _mixed(stream: list[int]) -> cells.Cells:
    """Cells of several kinds, each behind its number. Raises ValueError."""
    types: list[int] = []
    corners: list[int] = []
    offsets, at = [0], 0
    while at < len(stream):
        number, at = stream[at], at + 1
        if number in _COUNTED:
            nodes, at = (stream[at] if at < len(stream) else -1), at + 1
            kind, drawn = _COUNTED[number], nodes
        elif number in _NUMBERED:
            nodes, kind, drawn = _CELLS[_NUMBERED[number]]
        else:
            raise ValueError(f"expected the number of a kind of cell, got {number}")
        if not 0 <= nodes <= len(stream) - at:
            raise ValueError("expected the points of mixed cells, got too few numbers")
        types.append(kind)
        corners += stream[at : at + drawn]
        at += nodes
        offsets.append(len(corners))
    return cells.Cells(np.array(types, np.uint8), np.array(corners, np.int64), np.array(offsets))


def _meant(path: Any, root: Any, element: Any) -> Any:
    """The element that a Grid, Geometry or Attribute refers to; itself where it does not."""
    reference = "" if element is None else element.get("Reference", "")
    if not reference:
        return element
    text = (element.text or "").strip()
    found = find_all(path, root, text if reference.upper() == "XML" else reference)
    if len(found) != 1 or found[0].tag != element.tag or found[0].get("Reference"):
        got = f"{len(found)} at {shown(text or reference)}"
        raise bad(path, f"line {element.line}", f"expected one {element.tag}, got {got}")
    return found[0]


def _time(element: Any) -> float | None:
    try:
        value = float(element.get("Value", ""))
    except (AttributeError, ValueError):
        return None
    return value if math.isfinite(value) else None


def _time_of_frame(element: Any, frame: int) -> float | None:
    """Of a collection's list of times, or of its first time, step and count, in the XML."""
    item = None if element is None else element.find("DataItem")
    if item is None or item.get("Format", "XML").upper() != "XML":
        return None
    kind = element.get("TimeType", element.get("Type", "")).lower()
    try:
        values = [float(word) for word in (item.text or "").split()]
        time = values[0] + values[1] * frame if kind == "hyperslab" else values[frame] if kind == "list" else math.nan
    except (ValueError, IndexError):
        return None
    return time if math.isfinite(time) else None


def _arrays(path: Any, root: Any, items: dict[str, list[Any]], held: int) -> dict[str, list[np.ndarray]]:
    """The arrays of <DataItem> elements: those of each HDF5 file are read together."""
    reader = _Items(path, root, held)
    plans = {}
    for name, elements in items.items():
        if not elements:
            raise bad(path, name[:40], "expected a <DataItem>, got none")
        plans[name] = [reader.plan(name[:40], element) for element in elements]
    reader.read()
    return {name: [plan() for plan in some] for name, some in plans.items()}


class _Items:
    """DataItems: `plan` says which data sets they need, and returns what makes the array after
    `read` has read them."""

    def __init__(self, path: Any, root: Any, held: int) -> None:
        self.path, self.root, self.held = path, root, held
        self.files: dict[str, tuple[dict[str, str], dict[str, tuple[int, int]]]] = {}
        self.arrays: dict[str, np.ndarray] = {}
        self.n = 0

    def read(self) -> None:
        """Read all data sets that the plans need."""
        for file, (places, rows) in self.files.items():
            self.arrays |= read_arrays(file, places, rows)

    def plan(self, name: str, element: Any, depth: int = 0, rows: Any = None) -> Callable[[], Any]:
        """What makes the array of an element; of its `rows` [first, last) alone, if it can."""
        self.n += 1
        if depth > _MOST_NESTED or self.n > _MOST_ARRAYS:
            raise bad(self.path, name, "expected fewer nested DataItems, got one in itself")
        text, reference = (element.text or "").strip(), element.get("Reference", "")
        if reference:
            xpath = text if reference.upper() == "XML" else reference
            found = find_all(self.path, self.root, xpath)
            if len(found) != 1 or found[0].tag != "DataItem":
                got = f"{len(found)} elements at {shown(text or reference)}"
                raise bad(self.path, name, f"expected one DataItem, got {got}")
            return self.plan(name, found[0], depth + 1, rows)
        kind = element.get("ItemType", element.get("Type", "Uniform")).lower()
        children = element.findall("DataItem")
        if kind in ("hyperslab", "function"):
            make = self._slab if kind == "hyperslab" else self._joined
            whole = make(name, element, children, depth)
            return lambda: whole()[slice(*rows)] if rows else whole()
        if kind != "uniform":
            problem = f"expected ItemType Uniform, HyperSlab or Function, got {shown(kind)}"
            raise bad(self.path, name, problem)
        how = element.get("Format", "XML").upper()
        if how == "XML":
            values = _numbers(self.path, name, element, text, self.held)
            return lambda: values[slice(*rows)] if rows else values
        if how == "BINARY":
            data = _binary(self.path, name, element, text)
            return lambda: data[slice(*rows)] if rows else data
        if how != "HDF" or ":" not in text:
            expected = "expected a DataItem with HDF, Binary or XML"
            raise bad(self.path, name, f"{expected}, got {shown(how)}")
        file, _, place = text.rpartition(":")
        places, ranges = self.files.setdefault(below(element.file or self.path, file), ({}, {}))
        key = f"{name}\n{self.n}"
        places[key] = place
        if rows:
            ranges[key] = rows

        def held() -> np.ndarray:
            array = np.atleast_1d(self.arrays[key])
            return _as_said(element, array) if array.ndim == 1 else array

        return held

    def _slab(self, name: str, element: Any, children: list[Any], depth: int) -> Callable[[], Any]:
        if len(children) != 2:
            problem = f"expected a HyperSlab of two DataItems, got {len(children)}"
            raise bad(self.path, name, problem)
        about = self.plan(name, children[0], depth + 1)()
        if about.size % 3 or not about.size or not (about == np.rint(about)).all():
            raise bad(self.path, name, "expected starts, strides and counts of a HyperSlab")
        start, stride, count = about.reshape(3, -1).clip(-1, 2.0**53).astype(np.int64).tolist()
        ends = [a + s * (n - 1) + 1 for a, s, n in zip(start, stride, count, strict=True)]
        if min(start) < 0 or min(stride) < 1 or min(count) < 1:
            raise bad(self.path, name, f"expected a HyperSlab with counts from 1, got {count}")
        whole = self.plan(name, children[1], depth + 1, (start[0], ends[0]))

        def cut() -> np.ndarray:
            array = whole()
            begins, lasts = [0, *start[1:]], [ends[0] - start[0], *ends[1:]]
            if array.ndim != len(count) or any(e > n for e, n in zip(lasts, array.shape, strict=True)):
                got = f"a HyperSlab up to {ends}"
                raise bad(self.path, name, f"expected one within {list(array.shape)}, got {got}")
            steps = zip(begins, lasts, stride, strict=True)
            array = _as_said(element, array[tuple(slice(*step) for step in steps)])
            one_step = len(array) == 1 and (array.ndim == 3 or array.shape[1:] > (3,))
            return array[0] if one_step else array

        return cut

    def _joined(self, name: str, element: Any, children: list[Any], depth: int) -> Callable[[], Any]:
        function = re.sub(r"\s", "", element.get("Function", ""))
        known = r"(?:JOIN)?\(?(\$\d{1,3}(?:[,;]\$\d{1,3})*)\)?"
        match = re.fullmatch(known, function, re.IGNORECASE)
        places = [int(word) for word in re.findall(r"\$(\d+)", function)] if match else []
        if not places or max(places) >= len(children):
            raise bad(self.path, name, f"expected JOIN($0, $1, …), got {shown(function)}")
        plans = [self.plan(name, children[place], depth + 1) for place in places]

        def join() -> np.ndarray:
            parts = [plan() for plan in plans]
            parts = [p[:, None] if p.ndim == 1 else p for p in parts]
            if len({part.shape[:-1] for part in parts}) > 1:
                raise bad(self.path, name, "expected arrays of one length to join, got several")
            return np.concatenate(parts, axis=-1) if len(parts) > 1 else parts[0]

        return join


def _as_said(element: Any, array: np.ndarray) -> np.ndarray:
    """An array in the Dimensions of its item, where they have as many numbers."""
    words = element.get("Dimensions", "").split()
    shape = tuple(map(int, words)) if all(w.isdigit() and len(w) < 16 for w in words) else ()
    return array.reshape(shape) if words and math.prod(shape) == array.size else array


def _shape(path: Any, name: str, element: Any) -> tuple[int, ...]:
    words = element.get("Dimensions", "").split()
    if not words or not all(w.isascii() and w.isdigit() and len(w) < 16 for w in words):
        raise bad(path, name[:40], f"expected Dimensions, got {shown(' '.join(words))}")
    return tuple(map(int, words))


def _binary(path: Any, name: str, element: Any, text: str) -> np.ndarray:
    """The numbers of a file that has nothing else from a byte on, by default 4 bytes each."""
    shape = _shape(path, name, element)
    kind = element.get("NumberType", element.get("DataType", "Float")).lower()
    code = {"float": "f", "int": "i", "uint": "u", "char": "i", "uchar": "u"}.get(kind, "")
    width = element.get("Precision", "1" if "char" in kind else "4").strip()
    packed = element.get("Compression", "Raw").lower()
    if not code or width not in ("1", "2", "4", "8") or code + width == "f1" or packed != "raw":
        got = f"{shown(kind)} of {shown(width)} bytes, {shown(packed)}"
        raise bad(path, name[:40], f"expected plain numbers in a Binary DataItem, got {got}")
    order = {"big": ">", "little": "<"}.get(element.get("Endian", "Native").lower(), "=")
    dtype = np.dtype(code + width).newbyteorder(order)
    seek = element.get("Seek", "0").strip()
    begin = int(seek) if seek.isascii() and seek.isdigit() and len(seek) < 18 else -1
    place = below(element.file or path, text)
    size, held = math.prod(shape) * dtype.itemsize, os.path.getsize(place)
    if begin < 0 or begin + size > held:
        raise bad(path, name[:40], f"expected {size:,} bytes from {shown(seek)} in {shown(text)}, got {held:,} in all")
    check_size(path, name[:40], 2.0 * size, held)
    values = np.fromfile(place, dtype, math.prod(shape), offset=begin)
    if len(values) != math.prod(shape):
        raise bad(path, name[:40], f"expected {math.prod(shape)} numbers, got {len(values)}")
    return values.astype(dtype.newbyteorder("="), copy=False).reshape(shape)


def _numbers(path: Any, name: str, element: Any, text: str, held: int) -> np.ndarray:
    shape = _shape(path, name, element)
    check_size(path, name[:40], 8.0 * math.prod(shape), held)
    try:
        values = parse_numbers(text.encode(), np.dtype(np.float64))
    except ValueError:
        values = np.empty(0)
    if len(values) != math.prod(shape):
        problem = f"expected {math.prod(shape)} numbers, got {len(values)}"
        raise bad(path, name[:40], problem)
    return values.reshape(shape)
