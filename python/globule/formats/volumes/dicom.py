"""DICOM through SimpleITK: a folder's series, or one file with several slices; LPS."""

from __future__ import annotations

import math
import os
import re
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

from ..._base.checks import missing
from ..errors import bad
from .geometry import VolumeData, place

MOST_VOXELS = 2**31
MOST_CODECS_CAN_EXPAND = 10_000  # times; all pixels equal


def read(path: str | os.PathLike[str]) -> VolumeData:
    """The volume of a DICOM file, or of the series in a folder that has most slices.

    Returns values (Z, Y, X), rescaled as the file says; LPS, mm. Raises FormatError for anything
    but a volume of three axes and one real number per voxel; MissingPackageError without SimpleITK.
    """
    sitk = simpleitk()
    with itk_errors(sitk, path):
        image = _series(sitk, path) if os.path.isdir(path) else _file(sitk, path)
    return from_itk(path, image)


def from_itk(name: Any, image: Any) -> VolumeData:
    """A SimpleITK.Image of three axes and one real number per voxel. Raises FormatError for
    others; `name` is what the message begins with."""
    sitk = simpleitk()
    if image.GetDimension() == 4 and image.GetSize()[3] == 1:
        image = image[:, :, :, 0]
    if image.GetDimension() != 3:
        raise bad(name, "", f"expected a volume of 3 axes, got {image.GetDimension()}")
    n, kind = image.GetNumberOfComponentsPerPixel(), image.GetPixelIDTypeAsString()
    if n != 1 or "complex" in kind:
        raise bad(name, "", f"expected one number per voxel, got {n} ({kind})")
    directions = np.reshape(image.GetDirection(), (3, 3))
    steps = directions * np.array(image.GetSpacing())
    values = sitk.GetArrayFromImage(image)
    return VolumeData(values, place(steps, np.array(image.GetOrigin())))


def _file(sitk: Any, path: str | os.PathLike[str]) -> Any:
    reader = sitk.ImageFileReader()
    reader.SetFileName(os.fspath(path))
    reader.SetImageIO("GDCMImageIO")
    check_size(reader, path)
    return reader.Execute()


def check_size(reader: Any, path: str | os.PathLike[str]) -> None:
    """Refuse a file that says of itself to hold more than its bytes can unpack to."""
    reader.ReadImageInformation()
    size = [int(n) for n in reader.GetSize()]
    most = min(MOST_VOXELS, MOST_CODECS_CAN_EXPAND * os.path.getsize(path))
    if math.prod(size) > most:
        raise bad(path, "", f"expected at most {most:,} pixels for its length, got sizes {size}")


def _series(sitk: Any, folder: str | os.PathLike[str]) -> Any:
    reader = sitk.ImageSeriesReader()
    name = os.fspath(folder)
    series = [reader.GetGDCMSeriesFileNames(name, i) for i in reader.GetGDCMSeriesIDs(name)]
    if not series:
        raise bad(folder, "", "expected a DICOM series in this folder, got none")
    names = max(series, key=len)
    first = sitk.ImageFileReader()
    first.SetFileName(names[0])
    first.ReadImageInformation()
    if math.prod(first.GetSize()) * len(names) > MOST_VOXELS:
        raise bad(folder, "", f"expected at most {MOST_VOXELS:,} voxels, got more")
    reader.SetFileNames(names)
    return reader.Execute()


@contextmanager
def itk_errors(sitk: Any, path: str | os.PathLike[str]) -> Iterator[None]:
    """ITK's errors as FormatError, and none of its warnings, which it prints."""
    shown = sitk.ProcessObject.GetGlobalWarningDisplay()
    sitk.ProcessObject.SetGlobalWarningDisplay(False)
    try:
        yield
    except RuntimeError as error:
        lines = [line.strip() for line in str(error).splitlines()]
        # ITK's "Reason" is the system's last error, which may have nothing to do with it.
        lines = [line for line in lines if line and not line.startswith("Reason:")]
        reason = re.sub(r"^ITK ERROR: \w+\(\w+\): ", "", lines[-1]) if lines else "an unknown error"
        raise bad(path, "", f"expected DICOM, got {reason}") from None
    finally:
        sitk.ProcessObject.SetGlobalWarningDisplay(shown)


def simpleitk() -> Any:
    """SimpleITK. Raises MissingPackageError without it."""
    try:
        import SimpleITK
    except ImportError:
        raise missing("SimpleITK", "medical") from None
    return SimpleITK
