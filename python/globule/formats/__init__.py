"""Particle files, one module per format.

`read` chooses the format by the file's content, `write` by the name's ending, whatever its case:

    .txt .dat         nine columns: x y z  r g b  reflection refraction rigidity
    .vtk              legacy VTK (POLYDATA, UNSTRUCTURED_GRID), ASCII and binary
    .vtp .vtu         VTK XML
    .bgeo .bgeo.gz    Houdini classic (version 5)
    .ply              Stanford PLY, ASCII and binary
    .xyz .csv         tables with named or unnamed columns
    .npz .npy         NumPy
    .obj .stl .glb    triangle meshes, read only; so is a .ply with faces

Which array of a file becomes which field of Particles is the same for all of them; see
`globule.formats.fields`.
"""

from __future__ import annotations

import importlib
import os
import warnings
from collections.abc import Callable
from types import ModuleType
from typing import Any

from ..scene import sources
from ..scene.particles import Particles
from . import bgeo, mesh, numpy_format, ply, table, text, vtk_legacy, vtk_xml
from .errors import FormatError
from .kind import Kind, kind_of, wrong_kind
from .mesh import mesh_particles

__all__ = ["EXTENSIONS", "READABLE", "FormatError", "Kind", "kind_of", "mesh_particles", "read",
           "write"]  # fmt: skip

_READERS: dict[str, Callable[..., Particles]] = {
    "text": text.read,
    "vtk": vtk_legacy.read,
    "vtp": vtk_xml.read,
    "vtu": vtk_xml.read,
    "bgeo": bgeo.read,
    "ply": ply.read,
    "xyz": table.read_xyz,
    "csv": table.read_csv,
    "npz": numpy_format.read_npz,
    "npy": numpy_format.read_npy,
    "obj": mesh.read,
    "stl": mesh.read,
    "glb": mesh.read,
}
_WRITERS: dict[str, ModuleType] = {
    ".txt": text,
    ".dat": text,
    ".vtk": vtk_legacy,
    ".vtp": vtk_xml,
    ".vtu": vtk_xml,
    ".bgeo": bgeo,
    ".bgeo.gz": bgeo,
    ".ply": ply,
    ".xyz": table,
    ".csv": table,
    ".npz": numpy_format,
    ".npy": numpy_format,
}
EXTENSIONS = tuple(_WRITERS)  # read and written
READABLE = (*EXTENSIONS, ".obj", ".stl", ".glb")
_WITH_SPACING = ("ply", "obj", "stl", "glb")
_VOLUME_OPTIONS = ("level", "labels", "spacing")


def read(path: str | os.PathLike[str], **options: Any) -> Particles:
    """Read particles, or a mesh as particles, from a file with any extension.

    Args:
        path: of the file.
        spacing: world units, for meshes only; see mesh_particles.

    Returns:
        Particles; positions (N, 3) float32 in the file's units.

    Raises FormatError (a ValueError) if the file has an unknown format, holds another kind of data
    (the message names the function that reads the file) or is damaged; ValueError for an option
    that the format does not have; MissingPackageError for a mesh without trimesh; FileNotFoundError
    and other OSErrors pass unchanged.
    """
    kind = kind_of(path, "particles")
    if kind.kind == "volume" and options and options.keys() <= set(_VOLUME_OPTIONS):
        message = "globule.read of a volume goes with the next version; use "
        return _moved(message + "globule.tomography_particles")(path, **options)
    if kind.kind not in ("particles", "mesh"):
        raise wrong_kind(path, "particles or a mesh", kind)
    for name in options:
        if name != "spacing" or kind.format not in _WITH_SPACING:
            raise ValueError(f"{name}: expected no such option for {os.fspath(path)}, "
                             f"which holds {kind.kind} ({kind.format}), got one")  # fmt: skip
    return _READERS[kind.format](path, **options)


def write(path: str | os.PathLike[str], particles: Particles) -> None:
    """Write particles to a file, which appears whole or not at all.

    The writer repeats a number that applies to all particles for each particle, except in .npz.
    Raises FormatError if the extension is unknown, ValueError if the format cannot hold an
    attribute.
    """
    module = _writer(path)
    if not isinstance(particles, Particles):
        raise TypeError(f"particles: expected Particles, got {type(particles).__name__}")
    module.write(path, particles)


def _writer(path: str | os.PathLike[str]) -> ModuleType:
    name = os.path.basename(os.fspath(path)).lower()
    for extension, module in _WRITERS.items():
        if name.endswith(extension):
            return module
    raise FormatError(f"{path}: expected one of the extensions {' '.join(_WRITERS)}")


def _moved(message: str) -> Callable[..., Particles]:
    """tomography_particles under its old names; it belongs to a later room."""
    warnings.warn(message, DeprecationWarning, stacklevel=3)
    return importlib.import_module("globule.volumes.tomography").tomography_particles


def __getattr__(name: str) -> Any:
    if name == "tomography_particles":
        return _moved("globule.formats.tomography_particles has moved to globule")
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


sources.readers.insert(0, read)
