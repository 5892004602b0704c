"""The triangles of mesh files (.stl, .obj, .glb, .ply, .vtk, .vtp), for `globule.Mesh`."""

from __future__ import annotations

import os
import re

import numpy as np

from ..data.particles import Particles
from ..data.triangles import Triangles
from . import mesh, ply, vtk_legacy
from .errors import bad
from .kind import Kind, kind_of, kind_or_none, wrong_kind
from .size import whole_file
from .vtk_xml import VtkXml

_FORMATS = ("stl", "obj", "glb", "ply", "vtk", "vtp")


def read(path: str | os.PathLike[str]) -> Triangles:
    """Read vertices, triangles, colors and attributes of vertices; polygons become triangles.

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
    color = particles.color
    if color is not None and color.ndim == 1:
        color = np.broadcast_to(color, (n, 3))
    return Triangles(np.asarray(particles.positions), faces, color, attributes=particles.attributes)


def _read(path: str | os.PathLike[str], kind: Kind) -> tuple[Particles, np.ndarray]:
    if kind.format == "ply":
        return ply.read_triangles(path)
    if kind.format == "vtk":
        return vtk_legacy.read_triangles(path)
    if kind.format == "vtp":
        file = VtkXml(path, whole_file(path, 4.0))
        return file.particles(), file.triangles()
    return mesh.read_triangles(path)


def has_faces(path: str | os.PathLike[str]) -> bool:
    """Whether a file holds a triangle mesh, as far as its header or a glance tells. False for what
    cannot be read: its reader says why."""
    try:
        kind = kind_or_none(path)
        if kind is None:
            return False
        if kind.format == "obj":
            pattern = rb"(^|\n)f[ \t]"
        elif kind.kind == "mesh":
            return True
        elif kind.format == "vtk":
            pattern = rb"\n(POLYGONS|TRIANGLE_STRIPS)[ \t]+0*[1-9]"
        elif kind.format == "vtp":
            pattern = rb"NumberOf(Polys|Strips)[ \t]*=[ \t]*[\"']0*[1-9]"
        else:
            return False
        return re.search(pattern, whole_file(path, 4.0), re.IGNORECASE) is not None
    except OSError:
        return False
