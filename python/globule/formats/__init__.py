"""Particle files, one module per format.

`read` and `write` choose the format by the file name's extension, whatever its case:

    .txt .dat         nine columns: x y z  r g b  reflection refraction rigidity
    .vtk              legacy VTK (POLYDATA, UNSTRUCTURED_GRID), ASCII and binary
    .vtp .vtu         VTK XML
    .bgeo .bgeo.gz    Houdini classic (version 5)
    .ply              Stanford PLY, ASCII and binary
    .xyz .csv         tables with named or unnamed columns
    .npz .npy         NumPy

Which array of a file becomes which field of Particles is the same for all of them; see
`globule.formats.fields`.
"""

from __future__ import annotations

import os
from types import ModuleType

from ..particles import Particles
from . import bgeo, numpy_format, ply, table, text, vtk_legacy, vtk_xml
from .errors import FormatError

__all__ = ["EXTENSIONS", "FormatError", "read", "write"]

_FORMATS: dict[str, ModuleType] = {
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
EXTENSIONS = tuple(_FORMATS)


def read(path: str | os.PathLike) -> Particles:
    """Read particles from a file.

    Raises FormatError (a ValueError) if the extension is unknown or the file cannot be read as
    what its extension says; FileNotFoundError and other OSErrors pass unchanged.
    """
    return _format_of(path).read(path)


def write(path: str | os.PathLike, particles: Particles) -> None:
    """Write particles to a file, which appears whole or not at all.

    Numbers that hold for all particles are repeated per particle, except in .npz. Raises
    FormatError if the extension is unknown, ValueError if the format cannot hold an attribute.
    """
    module = _format_of(path)
    if not isinstance(particles, Particles):
        raise TypeError(f"particles: expected Particles, got {type(particles).__name__}")
    module.write(path, particles)


def _format_of(path: str | os.PathLike) -> ModuleType:
    name = os.path.basename(os.fspath(path)).lower()
    for extension, module in _FORMATS.items():
        if name.endswith(extension):
            return module
    raise FormatError(f"{path}: expected one of the extensions {' '.join(EXTENSIONS)}")
