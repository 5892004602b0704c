"""Particles of collections of VTK XML files: the parts of one frame, pieces or blocks together."""

from __future__ import annotations

import os
import warnings
from collections.abc import Sequence
from itertools import pairwise
from typing import Any
from xml.sax.saxutils import quoteattr

from .._base.files import atomic_write
from .contents import Contents
from .errors import FormatError, faults
from .triangles import part_has_faces
from .vtk_parts import checked_places, join, parts_of


def read_pvd(path: str | os.PathLike[str], frame: int = 0) -> Contents:
    """Read all parts of one time step of a ParaView collection. Raises FormatError."""
    return _contents(path, "pvd", frame)


def write_pvd(path: str | os.PathLike[str], files: Sequence[str], times: Sequence[float]) -> None:
    """Write a ParaView collection of files beside it, one a time step; numbers take the place of times
    that do not rise."""
    if any(b <= a for a, b in pairwise(times)):
        times = range(len(files))
    folder = os.path.dirname(os.path.abspath(path))
    lines = [
        f'<DataSet timestep="{time!r}" group="" part="0" file={quoteattr(os.path.relpath(file, folder))}/>\n'
        for file, time in zip(files, times, strict=True)
    ]
    head = '<?xml version="1.0"?>\n<VTKFile type="Collection" version="0.1" byte_order="LittleEndian">\n<Collection>\n'
    with atomic_write(path) as file:
        file.write(f"{head}{''.join(lines)}</Collection>\n</VTKFile>\n".encode())


def read_series(path: str | os.PathLike[str], frame: int = 0) -> Contents:
    """Read one time step of a .vtp.series, .vtu.series and the like. Raises FormatError."""
    return _contents(path, "series", frame)


def read_pieces(path: str | os.PathLike[str]) -> Contents:
    """Read all pieces of a .pvtp, .pvtu, .pvts or .pvtr. Raises FormatError."""
    return _contents(path, "pvtu", 0)


def read_blocks(path: str | os.PathLike[str]) -> Contents:
    """Read all blocks of a .vtm, .vtpc or .vtpd. Raises FormatError."""
    return _contents(path, "vtm", 0)


def _contents(path: Any, form: str, frame: int) -> Contents:
    """The particles of one frame. Where some parts are meshes and others particles, the meshes are
    left out, with a warning."""
    from . import read_contents

    found = parts_of(path, form, frame)
    files = checked_places(path, found.names, form, warn=True)
    with faults(path, refused=FormatError):
        contents = [read_contents(file) for file in files]
    parts = [one.particles for one in contents]
    time = found.time if found.time is not None or found.n_frames > 1 else contents[0].time
    filled = [(part, file) for part, file in zip(parts, files, strict=True) if len(part)]
    meshes = [part_has_faces(file) for _, file in filled]
    if any(meshes) and not all(meshes):
        n = sum(meshes)
        parts = [part for (part, _), mesh in zip(filled, meshes, strict=True) if not mesh]
        left_out = "a mesh is" if n == 1 else f"{n} meshes are"
        warnings.warn(f"{os.fspath(path)}: {left_out} left out beside the particles; --mesh draws meshes", stacklevel=2)
    return Contents(join(parts), time=time, n_frames=found.n_frames)
