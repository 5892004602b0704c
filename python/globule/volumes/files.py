"""Volume files: `read_volume` and `write_volume` choose the format by the name's extension.

    .mha .mhd            MetaImage, LPS
    .nrrd .nhdr          NRRD, LPS or RAS
    .nii .nii.gz         NIfTI-1, RAS, geometry in float32
    .vti                 VTK XML image data, with all maps
    .npz                 NumPy, with all maps
    .sparse.npz          NumPy, occupied blocks only, with all maps

A volume's place survives exactly in .mha, .nrrd, .vti (if its axes are the world's) and .npz.
"""

from __future__ import annotations

import os

import numpy as np

from ..formats import volumes as formats
from ..formats.errors import bad
from .volume import MAPS, Volume

_FAR = 255  # of radius: empty


def read_volume(path: str | os.PathLike) -> Volume:
    """Read a volume; values become uint8, uint16 or float32, whichever holds them.

    Formats without maps do not say what was measured: there, 0 and NaN count as empty, everything
    else as measured, and `info["origin"]` is "assumed". Raises FormatError (a ValueError) naming
    the place; FileNotFoundError and other OSErrors pass unchanged.
    """
    data = formats.read(path)
    values, missing = _plain(data.values)
    radius = data.maps.get("radius")
    if radius is not None and radius.dtype != np.uint8:
        raise bad(path, "radius", f"expected uint8, got {radius.dtype}")
    info = {"origin": "assumed" if radius is None else "stored"}
    if radius is None:
        radius = np.where((values == 0) | missing, _FAR, 0).astype(np.uint8)
    held = {name: data.maps[name] for name in MAPS if name in data.maps}

    def one_map(name: str) -> np.ndarray:
        if name not in held:
            raise ValueError(f"{name}: {path} does not hold this map")
        return held[name]

    return Volume(values, data.world_from_voxel, radius, data.space, info, one_map)


def write_volume(path: str | os.PathLike, volume: Volume, maps: bool = False) -> None:
    """Write a volume, whole or not at all, its maps included: `volume.save(path, maps)`."""
    if not isinstance(volume, Volume):
        raise TypeError(f"volume: expected Volume, got {type(volume).__name__}")
    volume.save(path, maps)


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
