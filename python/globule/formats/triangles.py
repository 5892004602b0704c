"""The triangles of mesh files (.stl, .obj, .glb, .ply, VTK's and their collections), for
`globule.Mesh`."""

from __future__ import annotations

import functools
import os
import re
from typing import Any

import numpy as np

from .._base.colormaps import to_linear
from ..data.particles import Particles
from ..data.triangles import Triangles
from . import mesh, ply, vtk_legacy, vtk_parts, vtk_xml, vtk_xml_grids, vtkhdf, xdmf
from .errors import FormatError, bad
from .fields import given_from
from .kind import Kind, kind_of, kind_or_none, wrong_kind
from .packed import opens_packed
from .size import whole_file

_OF_CELLS: dict[str, Any] = {  # the modules that read the faces of cells, and say whether there are any
    "vtk": vtk_legacy, "vtp": vtk_xml, "vtu": vtk_xml, "vts": vtk_xml_grids, "vtr": vtk_xml_grids,
    "xdmf": xdmf, "hdf5": vtkhdf,
}  # fmt: skip
_FORMATS = ("stl", "obj", "glb", "ply", *_OF_CELLS, *vtk_parts.FORMATS)


def read(path: str | os.PathLike[str], origin: Any = "auto") -> Triangles:
    """Read vertices, triangles, colors and attributes of vertices; polygons become triangles.
    origin: as for `globule.read`.

    Raises FormatError for a file without faces, of another kind, or damaged; MissingPackageError
    for .stl, .obj and .glb without trimesh.
    """
    kind = kind_of(path, "mesh")
    if kind.format not in _FORMATS:
        raise wrong_kind(path, f"a mesh ({', '.join(_FORMATS)})", kind)
    particles, faces = _read(path, kind)
    n = len(particles)
    if not len(faces):
        raise bad(path, "", "expected a mesh with faces, got none: read it with globule.read")
    if not 0 <= faces.min() <= faces.max() < n:
        got = f"{faces.min()} to {faces.max()}"
        raise bad(path, "faces", f"expected indices from 0 to {n - 1}, got {got}")
    particles = given_from(particles, origin, path)
    color = particles.color
    if color is not None and color.ndim == 1:
        color = np.broadcast_to(color, (n, 3))
    return Triangles(np.asarray(particles.positions), faces, color, None, particles.attributes, particles.origin)


@opens_packed
def _read(path: str | os.PathLike[str], kind: Kind) -> tuple[Particles, np.ndarray]:
    if kind.format not in vtk_parts.FORMATS:
        reader = ply if kind.format == "ply" else _OF_CELLS.get(kind.format, mesh)
        particles, found = reader.read_triangles(path)
        if kind.format in _OF_CELLS and particles.color is not None:
            particles.color = to_linear(particles.color)  # as of other meshes
        return particles, found
    parts, faces, first = [], [np.empty((0, 3), np.int64)], 0
    for place in vtk_parts.places(path, kind.format):
        if not part_has_faces(place):
            continue  # particles beside the mesh, or nothing
        part, found = _read(place, kind_of(place, "mesh"))
        parts.append(part)
        faces.append(found + first)
        first += len(part)
    return vtk_parts.join(parts or [Particles(np.empty((0, 3)))]), np.concatenate(faces)


def has_faces(path: str | os.PathLike[str]) -> bool:
    """Whether a file holds a triangle mesh and no particles beside, as far as its header or a
    glance tells; of several frames, the first one or that of a `FrameOf`. False for what cannot be
    read: its reader says why."""
    return _some_have_faces(path, None)


def part_has_faces(path: str | os.PathLike[str]) -> bool:
    """As `has_faces`, where evenly spaced grids are no volumes: of a part of a collection, by name in a program."""
    return _some_have_faces(path, "mesh")


@opens_packed
def _some_have_faces(path: str | os.PathLike[str], wanted: str | None) -> bool:
    try:
        kind = kind_or_none(path, wanted)
        if kind is None:
            return False
        if kind.format in vtk_parts.FORMATS:
            return _all_have_faces(vtk_parts.places(path, kind.format))
        state = os.stat(path)
        return _has_faces(os.path.abspath(path), kind, state.st_mtime_ns, state.st_size)
    except (OSError, FormatError):
        return False


@functools.lru_cache(1024)
def _has_faces(path: str, kind: Kind, changed: int, size: int) -> bool:
    """As `has_faces`, once for each state of a file. Raises FormatError and OSError."""
    if kind.kind == "volume":
        return False
    if kind.format == "obj":
        return re.search(rb"(^|\n)f[ \t]", whole_file(path, 4.0)) is not None
    if kind.format in _OF_CELLS:
        return _OF_CELLS[kind.format].has_faces(path)
    return kind.kind == "mesh"


def _all_have_faces(places: list[str]) -> bool:
    """Whether the parts of a collection have faces, but for those without points. Raises
    FormatError."""
    from . import read as read_particles

    found = False
    for place in places:
        if part_has_faces(place):
            found = True
        elif len(read_particles(place)):
            return False
    return found
