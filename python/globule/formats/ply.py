"""Stanford PLY files (.ply): the properties of the element `vertex`, ASCII and binary.

The vertices of a file with faces, a mesh, get supports from their edges. Other elements are passed
over, and so are list properties.
"""

from __future__ import annotations

import os
from typing import Any

import numpy as np

from .._base.colormaps import to_linear
from .._base.files import atomic_write
from ..data.particles import Particles
from ..data.surface import vertex_particles
from .errors import bad, shown
from .fields import find_positions, join_columns, particles_from, split_columns
from .mesh import sample_mesh
from .ply_data import Element, read_columns, read_faces, read_strips
from .size import whole_file

_TYPES = {
    "char": "i1",
    "uchar": "u1",
    "short": "i2",
    "ushort": "u2",
    "int": "i4",
    "uint": "u4",
    "float": "f4",
    "double": "f8",
    "int8": "i1",
    "uint8": "u1",
    "int16": "i2",
    "uint16": "u2",
    "int32": "i4",
    "uint32": "u4",
    "float32": "f4",
    "float64": "f8",
}
_WRITTEN = {
    "b1": "uchar",
    "i1": "char",
    "u1": "uchar",
    "i2": "short",
    "u2": "ushort",
    "i4": "int",
    "u4": "uint",
    "f4": "float",
    "f8": "double",
}
_ORDERS = {b"ascii": "", b"binary_little_endian": "<", b"binary_big_endian": ">"}
_FACES = ("face", "tristrips")  # elements
_LONGEST_HEADER = 1 << 20


def read(path: str | os.PathLike[str], spacing: float | None = None) -> Particles:
    """Read the vertices with all their scalar properties; with a spacing see `globule.sample_mesh`.

    Where there are faces, vertices at one place become one, those of no face are dropped, the
    support is the longest edge if the file gives none, and 8-bit colors are taken as sRGB.
    """
    if spacing is not None:
        return sample_mesh(path, spacing)
    particles, faces = read_triangles(path)
    return vertex_particles(particles, faces) if len(faces) else particles


def read_triangles(path: str | os.PathLike[str]) -> tuple[Particles, np.ndarray]:
    """Read the vertices with all their scalar properties, and the faces as triangles (F, 3). Where
    there are faces, 8-bit colors are taken as sRGB."""
    data = whole_file(path, 12.0)
    elements, order, position = _header(path, data)
    faces_of = next((e for e in elements if e.name in _FACES and e.count and e.has_lists), None)
    columns, faces = None, None
    for element in elements:
        if element is faces_of:
            read_them = read_strips if element.name == "tristrips" else read_faces
            faces, position = read_them(path, data, position, element, order)
        else:
            found, position = read_columns(path, data, position, element, order)
            columns = found if element.name == "vertex" else columns
        if columns is not None and (faces_of is None or faces is not None):
            break
    if columns is None:
        raise bad(path, "header", "expected an element vertex, got none")
    if element is elements[-1] and data[position:].strip() != b"":
        raise bad(path, f"byte {position}", "expected the end of the file, got more data")
    arrays = join_columns(columns)
    positions = find_positions(arrays)
    if positions is None:
        raise bad(path, "header", "expected the properties x, y and z of vertex")
    bytes_of_color = "color" in arrays and arrays["color"].dtype == np.uint8
    particles = particles_from(path, positions, arrays)
    if faces is None or not len(faces):
        return particles, np.empty((0, 3), np.int64)
    if not 0 <= faces.min() <= faces.max() < len(particles):
        got = f"{faces.min()} to {faces.max()}"
        raise bad(
            path, f"element {faces_of.name}" if faces_of else "", f"expected indices below {len(particles)}, got {got}"
        )
    if bytes_of_color and particles.color is not None:
        particles.color = to_linear(particles.color).astype(np.float32)
    return particles, faces


def write(path: str | os.PathLike[str], particles: Particles) -> None:
    """Write binary little-endian vertices.

    Colors are written as uchar where that loses nothing, else as float. PLY has no 64-bit
    integers: they become 32-bit ones, ValueError is raised for values that do not fit.
    """
    columns = {name: _storable(name, array) for name, array in split_columns(particles).items()}
    colors = [name for name in ("red", "green", "blue") if name in columns]
    as_bytes = [np.rint(np.nan_to_num(columns[name]) * 255).astype(np.uint8) for name in colors]
    if all(
        (whole.astype(np.float32) / np.float32(255) == columns[name]).all()
        for name, whole in zip(colors, as_bytes, strict=True)
    ):
        columns.update(zip(colors, as_bytes, strict=True))
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {len(particles)}"]
    for name, array in columns.items():
        if name.split() != [name]:
            raise ValueError(f"attributes[{name!r}]: expected a name without blanks for .ply")
        header.append(f"property {_WRITTEN[array.dtype.str[1:]]} {name}")
    names = [f"f{i}" for i in range(len(columns))]
    formats = [array.dtype.newbyteorder("<") for array in columns.values()]
    rows = np.empty(len(particles), np.dtype(list(zip(names, formats, strict=True))))
    for name, array in zip(names, columns.values(), strict=True):
        rows[name] = array
    with atomic_write(path) as file:
        file.write("\n".join([*header, "end_header\n"]).encode())
        file.write(rows.tobytes())


def _storable(name: str, array: np.ndarray) -> np.ndarray:
    """The array in a type that PLY has."""
    if array.dtype.kind == "f" and array.itemsize not in (4, 8):
        return array.astype(np.float32 if array.itemsize == 2 else np.float64)
    if array.dtype.kind not in "iu" or array.itemsize < 8:
        return array
    low, high = (int(array.min()), int(array.max())) if array.size else (0, 0)
    for dtype in (np.int32, np.uint32):
        if np.iinfo(dtype).min <= low and high <= np.iinfo(dtype).max:
            return array.astype(dtype)
    got = f"{low} to {high}"
    raise ValueError(f"attributes[{name!r}]: expected 32-bit integers for .ply, got {got}")


def _header(path: Any, data: bytes) -> tuple[list[Element], str, int]:
    """Elements, byte order ("" for ASCII), and where the data begin."""
    if data[:3] != b"ply" or data[3:4] not in (b"\n", b"\r"):
        raise bad(path, "line 1", f"expected 'ply', got {shown(data[:20])}")
    elements: list[Element] = []
    order: str | None = None
    newline = b"\r\n" if data[3:5] == b"\r\n" else data[3:4]
    position, number = 3 + len(newline), 1
    while True:
        number += 1
        where = f"line {number}"
        end = data.find(newline, position, _LONGEST_HEADER)
        if end < 0:
            raise bad(path, where, "expected end_header, got the end of the header")
        words = data[position:end].split()
        position = end + len(newline)
        match words:
            case [] | [b"comment" | b"obj_info", *_]:
                pass
            case [b"end_header"]:
                break
            case [b"format", kind, _] if kind in _ORDERS:
                order = _ORDERS[kind]
            case [b"element", name, count] if count.isdigit() and len(count) <= 18:
                elements.append(Element(name.decode("latin-1"), int(count)))
            case [b"property", b"list", length, kind, name] if elements:
                types = (_type(path, where, kind), _type(path, where, length))
                elements[-1].properties.append((_name(name), *types))
            case [b"property", kind, name] if elements:
                elements[-1].properties.append((_name(name), _type(path, where, kind), ""))
            case _:
                got = shown(b" ".join(words))
                raise bad(path, where, f"expected a line of a PLY header, got {got}")
    if order is None:
        raise bad(path, "header", "expected a format line, got none")
    return elements, order, position


def _name(word: bytes) -> str:
    return word.decode("utf-8", errors="replace")


def _type(path: Any, where: str, word: bytes) -> str:
    code = _TYPES.get(word.decode("latin-1"))
    if code is None:
        raise bad(path, where, f"expected a PLY type, got {shown(word)}")
    return code
