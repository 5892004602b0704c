"""DICOM through SimpleITK: a folder's series, or one file with several slices; LPS."""

from __future__ import annotations

import os
from typing import Any

import numpy as np

from ..._base.checks import optional
from ..errors import bad
from ..guarded import decode, need
from .geometry import VolumeData, place


def read(path: str | os.PathLike[str]) -> VolumeData:
    """The volume of a DICOM file, or of the series in a folder that has most slices.

    Returns values (Z, Y, X), rescaled as the file says; LPS, mm. Raises FormatError for anything
    but a volume of three axes and one real number per voxel; MissingPackageError without SimpleITK.
    """
    need("SimpleITK", "SimpleITK", "medical")
    facts, arrays = decode("series" if os.path.isdir(path) else "dicom", path, "DICOM")
    return _volume(path, facts, arrays)


def read_frames(path: str | os.PathLike[str]) -> tuple[np.ndarray, dict[str, str]]:
    """The pixels of a DICOM file, (…, H, W) or (…, H, W, channels), and the texts of its tags Frame
    Time and Frame Time Vector. Errors as of `read`."""
    need("SimpleITK", "SimpleITK", "medical")
    with open(path, "rb"):  # the usual OSErrors
        pass
    facts, arrays = decode("dicom", path, "DICOM")
    if not arrays:
        raise bad(path, "", f"expected real numbers, got {facts['kind']}")
    return arrays[0], facts["tags"]


def read_regions(path: str | os.PathLike[str]) -> list[dict[str, Any]]:
    """Numbers of each item of the Sequence of Ultrasound Regions (DICOM PS3.3 C.8.5.5); none if
    pydicom is not installed. Raises FormatError."""
    try:
        need("pydicom", "pydicom", "medical")
    except ImportError:
        return []
    facts, _ = decode("regions", path, "DICOM")
    return list(facts["regions"])


def from_itk(name: Any, image: Any) -> VolumeData:
    """A SimpleITK.Image of three axes and one real number per voxel. Raises FormatError for
    others; `name` is what the message begins with."""
    if image.GetDimension() == 4 and image.GetSize()[3] == 1:
        image = image[:, :, :, 0]
    facts = {
        "dimension": image.GetDimension(), "components": image.GetNumberOfComponentsPerPixel(),
        "kind": image.GetPixelIDTypeAsString(), "direction": image.GetDirection(),
        "spacing": image.GetSpacing(), "origin": image.GetOrigin(),
    }  # fmt: skip
    _check(name, facts)
    return _volume(name, facts, [optional("SimpleITK", "medical").GetArrayFromImage(image)])


def _check(name: Any, facts: dict[str, Any]) -> None:
    if facts["dimension"] != 3:
        raise bad(name, "", f"expected a volume of 3 axes, got {facts['dimension']}")
    n, kind = facts["components"], facts["kind"]
    if n != 1 or "complex" in kind:
        raise bad(name, "", f"expected one number per voxel, got {n} ({kind})")


def _volume(name: Any, facts: dict[str, Any], arrays: list[np.ndarray]) -> VolumeData:
    _check(name, facts)
    directions = np.reshape(facts["direction"], (3, 3))
    return VolumeData(arrays[0], place(directions * facts["spacing"], np.array(facts["origin"])))
