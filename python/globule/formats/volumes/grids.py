"""Volumes as evenly spaced grids of VTK: .vts, .vtr and legacy .vtk, of STRUCTURED_POINTS too; read only."""

from __future__ import annotations

import os

import numpy as np

from .. import vtk_grids
from ..errors import bad
from ..vtk_xml_grids import read_volume
from .geometry import VolumeData, place


def read(path: str | os.PathLike[str]) -> VolumeData:
    """Read the first array, or the one for colors, as the values, and the others of one component as
    maps. Raises FormatError."""
    found = read_volume(path)
    if found is None:
        raise bad(path, "", "expected evenly spaced points with an array of one component, got others")
    return _volume(*found)


def read_image(path: str | os.PathLike[str]) -> VolumeData:
    """As `read`, of STRUCTURED_POINTS."""
    return _volume(*vtk_grids.read_image(path))


def _volume(arrays: dict[str, np.ndarray], spacing: np.ndarray, origin: np.ndarray) -> VolumeData:
    values = arrays.pop(next(iter(arrays)))
    return VolumeData(values, place(np.diag(spacing), origin), "LPS", arrays)
