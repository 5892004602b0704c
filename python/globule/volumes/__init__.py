"""Volumes of voxels: their files, slices and iso-surfaces."""

from .files import read_volume, write_volume
from .iso_surface import IsoSurface, extract_iso_surface
from .slices import Slice, render_three_view, reslice, reslice_frame, save_three_view
from .tomography import sample_tomography
from .volume import Volume

__all__ = [
    "IsoSurface",
    "Slice",
    "Volume",
    "extract_iso_surface",
    "read_volume",
    "render_three_view",
    "reslice",
    "reslice_frame",
    "sample_tomography",
    "save_three_view",
    "write_volume",
]
