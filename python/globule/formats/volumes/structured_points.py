"""Volumes as legacy VTK files (.vtk) of STRUCTURED_POINTS: read only."""

from __future__ import annotations

import os

import numpy as np

from ..vtk_grids import read_image
from .geometry import VolumeData, place


def read(path: str | os.PathLike[str]) -> VolumeData:
    """Read the first array of point data as the values, and the others of one component as maps.
    Raises FormatError."""
    arrays, spacing, origin = read_image(path)
    values = arrays.pop(next(iter(arrays)))
    return VolumeData(values, place(np.diag(spacing), origin), "LPS", arrays)
