"""Volume formats: `read` chooses the format by the file's content, `write` by the name's ending."""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import Any

import numpy as np

from ..._base.files import all_or_none
from ..errors import FormatError
from ..guarded import need
from ..kind import kind_of, wrong_kind
from ..packed import unpacked
from . import dicom, dicom_write, grids, medical, nifti, npz, vti
from .geometry import VolumeData, checked, in_space
from .raw import Progress

_READERS: dict[str, Callable[..., VolumeData]] = {
    "metaimage": medical.read_metaimage,
    "nrrd": medical.read_nrrd,
    "nifti": nifti.read,
    "vti": vti.read,
    "structured points": grids.read_image,
    **dict.fromkeys(("vtk", "vts", "vtr"), grids.read),
    "npz": npz.read,
    "dicom": dicom.read,
}
_WRITERS: dict[str, Callable[..., None]] = {
    ".mha": medical.write_metaimage,
    ".nrrd": medical.write_nrrd,
    ".nii": nifti.write,
    ".nii.gz": nifti.write,
    ".vti": vti.write,
    ".npz": npz.write,
    ".sparse.npz": npz.write,
    ".dcm": dicom_write.write,
}
READABLE = (".mha", ".mhd", ".nrrd", ".nhdr", ".nii", ".nii.gz", ".vti", ".npz")
WRITABLE = tuple(_WRITERS)
_IN_PIECES = (".mha", ".nrrd", "metaimage", "nrrd")  # what reports its progress in bytes
HOLD_MAPS = (".vti", ".npz", ".sparse.npz")
WITHOUT_MAPS = (".dcm",)  # whose types of numbers cannot be those of maps


def read(path: str | os.PathLike[str], space: str = "LPS", progress: Progress = None) -> VolumeData:
    """The volume in a file of any ending, or in a folder with a DICOM series, checked.

    Args:
        path: of the file or folder.
        space: "LPS" or "RAS": what the axes of the result's world mean, whatever the file's do.
        progress: called as progress(done, total), with bytes for MetaImage and NRRD; with 1, 1 at
            the end for other formats.

    Raises FormatError naming the place; its message names the function that reads a file of
    another kind. FileNotFoundError and other OSErrors pass unchanged.
    """
    kind = kind_of(path, "volume")
    if kind.format not in _READERS or (kind.kind != "volume" and kind.format != "dicom"):
        raise wrong_kind(path, "a volume", kind)
    with unpacked(path, kind.format == "nifti") as plain:
        data = _done(kind.format, _READERS[kind.format], progress, plain)
    return in_space(checked(path, data), space)


def write(
    path: str | os.PathLike[str],
    data: VolumeData,
    radius: np.ndarray,
    maps: dict[str, np.ndarray] | None,
    progress: Progress = None,
) -> None:
    """Write a volume and its maps, all or nothing: in one file where the format holds maps, else
    `maps`, if not None, as files beside it, with `radius`. Progress as for `read`."""
    ending = extension(path, WRITABLE)
    writer = _WRITERS[ending]
    if ending in HOLD_MAPS:
        whole = data._replace(maps={"radius": radius, **(maps or {})})
        _done(ending, writer, progress, path, whole)
        return
    with all_or_none():
        _done(ending, writer, progress, path, data)
        for name, array in ({} if maps is None else {"radius": radius, **maps}).items():
            writer(map_path(path, name), data._replace(values=array))


def check_name(path: str | os.PathLike[str], maps: bool) -> None:
    """Whether a volume can be written under this name, with maps or without. Raises FormatError,
    MissingPackageError."""
    ending = extension(path, WRITABLE)
    if ending in WITHOUT_MAPS and maps:
        raise FormatError(f"{path}: expected {' '.join(HOLD_MAPS)} for maps, got {ending}")
    if ending == ".dcm":
        need("pydicom", "pydicom", "medical")


def _done(form: str, work: Callable[..., Any], progress: Progress, *arguments: Any) -> Any:
    """What reads or writes, called with the progress that its format reports."""
    if form in _IN_PIECES:
        return work(*arguments, progress)
    result = work(*arguments)
    if progress:
        progress(1, 1)
    return result


def map_path(path: str | os.PathLike[str], name: str) -> str:
    """Where the map of a volume's file lies, for formats that hold values only."""
    text = os.fspath(path)
    ending = extension(path, WRITABLE)
    return f"{text[: -len(ending)]}.{name}{text[-len(ending) :]}"


def extension(path: str | os.PathLike[str], known: tuple[str, ...]) -> str:
    """The longest of the known endings that a path has. Raises FormatError if it has none."""
    name = os.path.basename(os.fspath(path)).lower()
    for ending in sorted(known, key=len, reverse=True):
        if name.endswith(ending):
            return ending
    raise FormatError(f"{path}: expected one of the extensions {' '.join(known)}")
