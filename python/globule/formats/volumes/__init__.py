"""Volume formats: `read` chooses the format by the file's content, `write` by the name's ending."""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import Any

import numpy as np

from ..._base.files import all_or_none
from ..errors import FormatError
from ..kind import kind_of, wrong_kind
from . import dicom, medical, nifti, npz, vti
from .geometry import VolumeData, checked, in_space

_READERS: dict[str, Callable[[Any], VolumeData]] = {
    "metaimage": medical.read_metaimage,
    "nrrd": medical.read_nrrd,
    "nifti": nifti.read,
    "vti": vti.read,
    "npz": npz.read,
    "dicom": dicom.read,
}
_WRITERS: dict[str, Callable[[Any, VolumeData], None]] = {
    ".mha": medical.write_metaimage,
    ".nrrd": medical.write_nrrd,
    ".nii": nifti.write,
    ".nii.gz": nifti.write,
    ".vti": vti.write,
    ".npz": npz.write,
    ".sparse.npz": npz.write,
}
READABLE = (".mha", ".mhd", ".nrrd", ".nhdr", ".nii", ".nii.gz", ".vti", ".npz")
WRITABLE = tuple(_WRITERS)
HOLD_MAPS = (".vti", ".npz", ".sparse.npz")


def read(path: str | os.PathLike, space: str = "LPS") -> VolumeData:
    """The volume in a file of any ending, or in a folder with a DICOM series, checked.

    Args:
        path: of the file or folder.
        space: "LPS" or "RAS": what the axes of the result's world mean, whatever the file's do.

    Raises FormatError naming the place; its message names the function that reads a file of
    another kind. FileNotFoundError and other OSErrors pass unchanged.
    """
    kind = kind_of(path, "volume")
    if kind.format not in _READERS or (kind.kind != "volume" and kind.format != "dicom"):
        raise wrong_kind(path, "a volume", kind)
    return in_space(checked(path, _READERS[kind.format](path)), space)


def write(
    path: str | os.PathLike,
    data: VolumeData,
    radius: np.ndarray,
    maps: dict[str, np.ndarray] | None,
) -> None:
    """Write a volume and its maps, all or nothing: in one file where the format holds maps, else
    `maps`, if not None, as files beside it, with `radius`."""
    ending = extension(path, WRITABLE)
    writer = _WRITERS[ending]
    if ending in HOLD_MAPS:
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
    """The longest of the known endings that a path has. Raises FormatError if it has none."""
    name = os.path.basename(os.fspath(path)).lower()
    for ending in sorted(known, key=len, reverse=True):
        if name.endswith(ending):
            return ending
    raise FormatError(f"{path}: expected one of the extensions {' '.join(known)}")
