"""Particle files, one module per format.

`read` and `write` choose the format by the file name's extension, whatever its case:

    .txt .dat         nine columns: x y z  r g b  reflection refraction rigidity
    .vtk              legacy VTK (POLYDATA, UNSTRUCTURED_GRID), ASCII and binary
    .vtp .vtu         VTK XML
    .bgeo .bgeo.gz    Houdini classic (version 5)
    .ply              Stanford PLY, ASCII and binary
    .xyz .csv         tables with named or unnamed columns
    .npz .npy         NumPy
    .obj .stl .glb    triangle meshes, read only; so is a .ply with faces
    .nii .nii.gz .nrrd .nhdr .mha .mhd, or a folder with a DICOM series
                      tomographies, read only

Which array of a file becomes which field of Particles is the same for all of them; see
`globule.formats.fields`.
"""

from __future__ import annotations

import os
from types import ModuleType
from typing import Any

from ..scene import sources
from ..scene.particles import Particles
from . import bgeo, mesh, numpy_format, ply, table, text, tomography, vtk_legacy, vtk_xml
from .errors import FormatError
from .mesh import mesh_particles
from .tomography import tomography_particles

__all__ = [
    "EXTENSIONS",
    "READABLE",
    "FormatError",
    "mesh_particles",
    "read",
    "tomography_particles",
    "write",
]

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
EXTENSIONS = tuple(_FORMATS)  # read and written
_READ_ONLY: dict[str, ModuleType] = {
    ".obj": mesh,
    ".stl": mesh,
    ".glb": mesh,
    ".nii": tomography,
    ".nii.gz": tomography,
    ".nrrd": tomography,
    ".nhdr": tomography,
    ".mha": tomography,
    ".mhd": tomography,
}
READABLE = (*EXTENSIONS, *_READ_ONLY)


def read(path: str | os.PathLike, **options: Any) -> Particles:
    """Read particles from a file.

    Options are for meshes (`spacing`, see mesh_particles) and tomographies (`level`, `labels`,
    `spacing`, see tomography_particles).

    Raises FormatError (a ValueError) if the extension is unknown or the file cannot be read as
    what its extension says, ValueError for an option that the format does not have or a package
    that is missing; FileNotFoundError and other OSErrors pass unchanged.
    """
    module = _format_of(path)
    for name in options:
        if name not in getattr(module, "OPTIONS", ()):
            raise ValueError(f"{name}: expected none for {os.fspath(path)}, whose format has none")
    return module.read(path, **options)


def write(path: str | os.PathLike, particles: Particles) -> None:
    """Write particles to a file, which appears whole or not at all.

    Numbers that hold for all particles are repeated per particle, except in .npz. Raises
    FormatError if the extension is unknown, ValueError if the format cannot hold an attribute.
    """
    module = _format_of(path, writing=True)
    if not isinstance(particles, Particles):
        raise TypeError(f"particles: expected Particles, got {type(particles).__name__}")
    module.write(path, particles)


def _format_of(path: str | os.PathLike, writing: bool = False) -> ModuleType:
    name = os.path.basename(os.fspath(path)).lower()
    formats = _FORMATS if writing else {**_FORMATS, **_READ_ONLY}
    for extension, module in formats.items():
        if name.endswith(extension):
            return module
    if os.path.isdir(path) and not writing:
        return tomography
    raise FormatError(f"{path}: expected one of the extensions {' '.join(formats)}")


sources.readers.insert(0, read)
