"""Volumes as evenly spaced grids of VTK: .vts, .vtr and legacy .vtk, read only."""

from __future__ import annotations

import os

import numpy as np

from ..errors import bad
from ..vtk_xml_grids import read_volume
from .geometry import VolumeData, place


def read(path: str | os.PathLike[str]) -> VolumeData:
    """Read the first array, or the one for colors, as the values, and the others of one component as
    maps. Raises FormatError."""
    found = read_volume(path)
    if found is None:
        raise bad(path, "", "expected evenly spaced points with an array of one component, got others")
    arrays, spacing, origin = found
    values = arrays.pop(next(iter(arrays)))
    return VolumeData(values, place(np.diag(spacing), origin), "LPS", arrays)
