"""Volume formats: which reader and writer belongs to which extension."""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import Any

import numpy as np

from ..._base.files import all_or_none
from ..errors import FormatError
from . import medical, npz, vti
from .geometry import VolumeData, checked

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
HOLD_MAPS = (".vti", ".npz")


def read(path: str | os.PathLike) -> VolumeData:
    """The volume in a file, by the path's extension, checked."""
    return checked(path, _READERS[extension(path, READABLE)](path))


def write(
    path: str | os.PathLike,
    data: VolumeData,
    radius: np.ndarray,
    maps: dict[str, np.ndarray] | None,
) -> None:
    """Write a volume and its maps, all or nothing: in one file where the format holds maps, else
    `maps`, if not None, as files beside it, with `radius`."""
    writer = _WRITERS[extension(path, WRITABLE)]
    if extension(path, WRITABLE) in HOLD_MAPS:
        writer(path, data._replace(maps={"radius": radius, **(maps or {})}))
        return
    with all_or_none():
        writer(path, data)
        for name, array in ({} if maps is None else {"radius": radius, **maps}).items():
            writer(map_path(path, name), data._replace(values=array))


def map_path(path: str | os.PathLike, name: str) -> str:
    """Where the map of a volume's file lies, for formats that hold values only."""
    text = os.fspath(path)
    ending = extension(path, WRITABLE)
    return f"{text[: -len(ending)]}.{name}{text[-len(ending) :]}"


def extension(path: str | os.PathLike, known: tuple[str, ...]) -> str:
    name = os.path.basename(os.fspath(path)).lower()
    # The longest first, for .nii.gz.
    for extension in sorted(known, key=len, reverse=True):
        if name.endswith(extension):
            return extension
    raise FormatError(f"{path}: expected one of the extensions {' '.join(known)}")
