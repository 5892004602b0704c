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
from collections.abc import Callable
from typing import Any

import numpy as np

from .._base.files import all_or_none
from ..formats.errors import FormatError, bad
from ..formats.volumes import medical, npz, vti
from ..formats.volumes.geometry import VolumeData, checked
from .volume import Volume

MAPS = ("count", "variance", "source")  # besides `radius`, which says measured, filled or empty
_FAR = 255  # of radius: empty
_READERS: dict[str, Callable[[Any], VolumeData]] = {
    ".mha": medical.read_metaimage,
    ".mhd": medical.read_metaimage,
    ".nrrd": medical.read_nrrd,
    ".nhdr": medical.read_nrrd,
    ".nii": medical.read_nifti,
    ".nii.gz": medical.read_nifti,
    ".vti": vti.read,
    ".npz": npz.read,
}
_WRITERS: dict[str, Callable[[Any, VolumeData], None]] = {
    ".mha": medical.write_metaimage,
    ".nrrd": medical.write_nrrd,
    ".nii": medical.write_nifti,
    ".nii.gz": medical.write_nifti,
    ".vti": vti.write,
    ".npz": npz.write,
}
READABLE, WRITABLE = tuple(_READERS), (*_WRITERS, ".sparse.npz")
_HOLD_MAPS = (".vti", ".npz")


def read_volume(path: str | os.PathLike) -> Volume:
    """Read a volume; values become uint8, uint16 or float32, whichever holds them.

    Formats without maps do not say what was measured: there, 0 and NaN count as empty, everything
    else as measured, and `info["origin"]` is "assumed". Raises FormatError (a ValueError) naming
    the place; FileNotFoundError and other OSErrors pass unchanged.
    """
    extension = _extension(path, READABLE)
    data = checked(path, _READERS[extension](path))
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
    """Write a volume, whole or not at all, its maps included.

    .npz, .sparse.npz and .vti hold where values came from (`radius`), and with `maps` also count,
    variance and source. For other formats `maps` writes each as a file beside: NAME.count.nrrd.
    """
    extension = _extension(path, tuple(_WRITERS))
    if not isinstance(volume, Volume):
        raise TypeError(f"volume: expected Volume, got {type(volume).__name__}")
    data = VolumeData(volume.values, volume.world_from_voxel, volume.space)
    found = {"radius": volume.radius, **(_maps(volume) if maps else {})}
    if extension in _HOLD_MAPS:
        _WRITERS[extension](path, data._replace(maps=found))
        return
    with all_or_none():
        _WRITERS[extension](path, data)
        if maps:
            for name, array in found.items():
                _WRITERS[extension](map_path(path, name), data._replace(values=array))


def map_path(path: str | os.PathLike, name: str) -> str:
    """Where the map of a volume's file lies, for formats that hold values only."""
    text = os.fspath(path)
    extension = _extension(path, tuple(_WRITERS))
    return f"{text[: -len(extension)]}.{name}{text[-len(extension) :]}"


def _maps(volume: Volume) -> dict[str, np.ndarray]:
    found = {}
    for name in MAPS:
        try:
            found[name] = getattr(volume, name)
        except ValueError:  # a volume from a file or another program has none
            continue
    return found


def _extension(path: str | os.PathLike, known: tuple[str, ...]) -> str:
    name = os.path.basename(os.fspath(path)).lower()
    # The longest first, for .nii.gz.
    for extension in sorted(known, key=len, reverse=True):
        if name.endswith(extension):
            return extension
    raise FormatError(f"{path}: expected one of the extensions {' '.join(known)}")


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
