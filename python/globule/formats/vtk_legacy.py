"""Legacy VTK files (.vtk), versions up to 5.1: POLYDATA, UNSTRUCTURED_GRID; the grids of
`vtk_grids`.

Points and point data are read, cell data of vertices as theirs, and faces as triangles. Follows
"VTK File Formats" (Kitware), "Simple Legacy Formats", and vtkDataReader where the text leaves a
choice.
"""

from __future__ import annotations

import os
import re
from typing import Any

import numpy as np

from .._base.files import atomic_write
from ..data.particles import Particles
from . import cells
from .asciinum import end_of_tokens, parse_numbers
from .contents import Contents
from .fields import per_particle
from .size import whole_file
from .vtk_grids import VtkGrid
from .vtk_reader import VtkReader

_WRITTEN = {
    "b1": "unsigned_char",
    "i1": "char",
    "u1": "unsigned_char",
    "i2": "short",
    "u2": "unsigned_short",
    "i4": "int",
    "u4": "unsigned_int",
    "i8": "vtktypeint64",
    "u8": "vtktypeuint64",
    "f4": "float",
    "f8": "double",
}


def read(path: str | os.PathLike[str]) -> Contents:
    """Read the points and point data of a legacy VTK file, without ghosts."""
    file = _reader_of(path, whole_file(path, 4.0))
    return Contents(file.particles(), time=file.time)


def read_triangles(path: str | os.PathLike[str]) -> tuple[Particles, np.ndarray]:
    """Read all points with their data, and the faces of the cells as triangles (F, 3)."""
    return _reader_of(path, whole_file(path, 4.0)).triangles()


def has_faces(path: str | os.PathLike[str]) -> bool:
    """Whether a file has cells with faces, as far as its words tell."""
    data = whole_file(path, 4.0)
    grid = _grid_of(data)
    if grid and (size := re.search(rb"\nDIMENSIONS[ \t]+(\d+)[ \t]+(\d+)[ \t]+(\d+)", data[:4096], re.IGNORECASE)):
        return sum(int(n) > 1 for n in size.groups()) > 1
    if re.search(rb"\n(POLYGONS|TRIANGLE_STRIPS)[ \t]+0*[1-9]", data, re.IGNORECASE):
        return True
    found = re.search(rb"\nCELL_TYPES[ \t]+(\d{1,18})[^\n]*\n", data, re.IGNORECASE)
    if found is None:
        return False
    n, start = int(found[1]), found.end()
    if b"BINARY" in data[: data.find(b"DATASET")].upper():
        return cells.have_faces(np.frombuffer(data[start : start + 4 * n], ">u1")[3::4])
    try:
        types = parse_numbers(data[start : end_of_tokens(data, start, n)], np.dtype("i4"))
    except ValueError:
        return False  # its reader says what is wrong
    return cells.have_faces(types)


def read_volume(path: Any, data: bytes) -> tuple[dict[str, np.ndarray], np.ndarray, np.ndarray] | None:
    """What `volume_of` finds in the data of a file; None for one that is no grid."""
    return VtkGrid(path, data).volume() if _grid_of(data) else None


def _grid_of(data: bytes) -> bool:
    """Whether the file's data set is a grid."""
    kind = re.search(rb"\nDATASET[ \t]+(\w+)", data[:4096], re.IGNORECASE)
    return kind is not None and kind[1].upper().decode() in VtkGrid.data_sets


def _reader_of(path: Any, data: bytes) -> VtkReader:
    """The reader of the file's data set."""
    return (VtkGrid if _grid_of(data) else VtkReader)(path, data)


def write(path: str | os.PathLike[str], particles: Particles) -> None:
    """Write binary POLYDATA with a vertex at each point, so that viewers show the points.

    The version is 3.0, which every reader knows. float16 is written as float, wider than double
    as double.
    """
    n = len(particles)
    with atomic_write(path) as file:
        file.write(b"# vtk DataFile Version 3.0\nparticles\nBINARY\nDATASET POLYDATA\n")
        points = particles.world_positions()
        file.write(b"POINTS %d %s\n" % (n, b"float" if points.itemsize == 4 else b"double"))
        file.write(points.astype(points.dtype.newbyteorder(">")).data)
        if n:
            vertices = np.ones((n, 2), ">i4")  # each vertex: a list of one point
            vertices[:, 1] = np.arange(n)
            file.write(b"\nVERTICES %d %d\n" % (n, 2 * n))
            file.write(vertices.data)
        arrays = per_particle(particles)
        file.write(b"\nPOINT_DATA %d\nFIELD FieldData %d\n" % (n, len(arrays)))
        for name, array in arrays.items():
            if array.dtype.kind == "f" and array.itemsize not in (4, 8):
                array = array.astype(np.float32 if array.itemsize == 2 else np.float64)
            k = 1 if array.ndim == 1 else array.shape[1]
            kind = _WRITTEN[array.dtype.str[1:]]
            file.write(f"{_encoded(name)} {k} {n} {kind}\n".encode())
            file.write(np.ascontiguousarray(array, array.dtype.newbyteorder(">")).tobytes() + b"\n")


def _encoded(name: str) -> str:
    """A name as one word, the way VTK does it: %20 for a blank."""
    return "".join(chr(byte) if 33 <= byte < 127 and byte not in b'"%' else f"%{byte:02X}" for byte in name.encode())
