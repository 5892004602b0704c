"""Volume files: `read_volume` chooses the format by content, `write_volume` by the name's ending.

    .mha .mhd            MetaImage, LPS
    .nrrd .nhdr          NRRD, LPS or RAS
    .nii .nii.gz         NIfTI (nibabel), RAS, geometry in float32
    .vti                 VTK XML image data, with all maps
    .vtk                 legacy VTK, STRUCTURED_POINTS, read only
    .npz                 NumPy, with all maps
    .sparse.npz          NumPy, occupied blocks only, with all maps
    .dcm                 DICOM: multi-frame secondary capture (written by pydicom), LPS
    DICOM                also other files, and a folder with a series (SimpleITK), read only

Volumes from files are in LPS, for any frame of the file. A volume's place survives exactly in .mha,
.nrrd, .vti (if its axes are the world's) and .npz.
"""

from __future__ import annotations

import os
from collections.abc import Callable

import numpy as np

from ..formats import volumes as formats
from ..formats.errors import bad
from ..formats.volumes.geometry import VolumeData
from .volume import FAR, MAPS, Volume


def read_volume(
    path: str | os.PathLike[str], space: str = "LPS", progress: Callable[[int, int], None] | None = None
) -> Volume:
    """Read a volume; values become uint8, uint16 or float32, the first type that holds them.

    Formats without maps do not store the origin of values. For these formats, NaN counts as empty,
    0 counts as empty unless the volume has negative values, and `info["origin"]` is "assumed".

    Args:
        path: of a file with any extension, or of a folder with a DICOM series (of several series,
            the series with the most slices).
        space: "LPS" or "RAS": the meaning of the returned volume's world axes, for any frame of the
            file.
        progress: called as progress(done, total): bytes of MetaImage and NRRD, 1 of 1 at the end of
            other formats.

    Returns:
        Volume; values (Z, Y, X), world_from_voxel in mm.

    Raises FormatError (a ValueError) naming the place, or the function that reads a file of another
    kind; MissingPackageError for NIfTI without nibabel and DICOM without SimpleITK;
    FileNotFoundError and other OSErrors pass unchanged.
    """
    data = formats.read(path, space, progress)
    radius = data.maps.get("radius")
    if radius is None:
        return volume_of(data)
    if radius.dtype != np.uint8:
        raise bad(path, "radius", f"expected uint8, got {radius.dtype}")
    held = {name: data.maps[name] for name in MAPS if name in data.maps}

    def one_map(name: str) -> np.ndarray:
        if name not in held:
            raise ValueError(f"{name}: {path} does not hold this map")
        return held[name]

    values, _ = _plain(data.values)
    return Volume(values, data.world_from_voxel, radius, data.space, {"origin": "stored"}, one_map)


def volume_of(data: VolumeData) -> Volume:
    """The volume of values of any type, where nothing says which of them were measured."""
    values, missing = _plain(data.values)
    background = values == 0 if values.min() >= 0 else False
    radius = np.where(background | missing, FAR, 0).astype(np.uint8)
    radius = np.broadcast_to(radius, values.shape).copy()
    return Volume(values, data.world_from_voxel, radius, data.space, {"origin": "assumed"})


def write_volume(
    path: str | os.PathLike[str], volume: Volume, maps: bool = False, progress: Callable[[int, int], None] | None = None
) -> None:
    """Write a volume in the format of the path's extension, whole or not at all.

    The same as `volume.save(path, maps, progress)`. Raises FormatError for an unknown extension,
    TypeError for anything but a Volume, ValueError for values that the format cannot hold,
    MissingPackageError for NIfTI without nibabel; OSErrors pass unchanged.
    """
    if not isinstance(volume, Volume):
        raise TypeError(f"volume: expected Volume, got {type(volume).__name__}")
    volume.save(path, maps, progress)


def _plain(values: np.ndarray) -> tuple[np.ndarray, np.ndarray | bool]:
    """Values in a type of ours, and where they were NaN (which becomes 0)."""
    if values.dtype in (np.uint8, np.uint16):
        return values, False
    if values.dtype.kind in "biu":
        low, high = values.min(), values.max()
        for kind, most in ((np.uint8, 255), (np.uint16, 65535)):
            if low >= 0 and high <= most:
                return values.astype(kind), False
    with np.errstate(over="ignore"):
        values = values.astype(np.float32, copy=False)
    missing = ~np.isfinite(values)
    return (np.where(missing, np.float32(0), values), missing) if missing.any() else (values, False)
