"""DICOM output (.dcm) through pydicom: one multi-frame secondary capture, a frame for each plane.

Secondary Capture (PS3.3 A.8) says what is true of a reconstructed volume and no more. An Enhanced
US Volume would have to state the transducer, its output and the anatomy, which are not known here.
"""

from __future__ import annotations

import datetime
import functools
import os
from typing import Any

import numpy as np

from ..._base.checks import optional
from ..._base.files import atomic_write
from .geometry import VolumeData, in_space, spacing_and_directions

_CLASSES = {  # Multi-frame Grayscale Byte and Word Secondary Capture Image Storage
    1: "1.2.840.10008.5.1.4.1.1.7.2",
    2: "1.2.840.10008.5.1.4.1.1.7.3",
}
_MOST_BYTES = 2**32 - 2  # of one element
_MOST_SIDE = 65535
_STRAIGHT = 1e-6  # cosine between axes that count as perpendicular


def write(path: str | os.PathLike[str], data: VolumeData) -> None:
    """Write a volume as one DICOM file, LPS, mm.

    Numbers of the place have 16 characters, as DICOM requires: at least ten digits. A left-handed
    volume is stored with its planes in reverse, so that each voxel keeps its place. Every file is
    an instance of its own: identifiers and dates differ from one call to the next. The patient's
    name and number stay empty.

    Raises MissingPackageError without pydicom, ValueError for values that are not uint8 or uint16,
    for axes that are not perpendicular, and for 4 GiB or more.
    """
    pydicom = optional("pydicom", "medical")
    new_uid = functools.partial(pydicom.uid.generate_uid, None)
    values, matrix = _right_handed(in_space(data, "LPS"))
    spacing, axes = spacing_and_directions(matrix)
    _check(values, axes)
    depth, height, width = values.shape
    size = values.dtype.itemsize
    now = datetime.datetime.now()
    date, clock = now.strftime("%Y%m%d"), now.strftime("%H%M%S.%f")
    meta = pydicom.dataset.FileMetaDataset()
    meta.MediaStorageSOPClassUID = _CLASSES[size]
    meta.MediaStorageSOPInstanceUID = new_uid()
    meta.TransferSyntaxUID = pydicom.uid.ExplicitVRLittleEndian
    file = pydicom.Dataset()
    file.file_meta = meta
    elements: dict[str, Any] = {
        "SOPClassUID": _CLASSES[size], "SOPInstanceUID": meta.MediaStorageSOPInstanceUID,
        "PatientName": "", "PatientID": "", "PatientBirthDate": "", "PatientSex": "",
        "StudyInstanceUID": new_uid(), "StudyDate": date, "StudyTime": clock,
        "StudyID": "", "AccessionNumber": "", "ReferringPhysicianName": "",
        "SeriesInstanceUID": new_uid(), "SeriesNumber": 1, "Modality": "US",
        "SeriesDescription": "Volume of tracked ultrasound",
        "Laterality": "",
        "FrameOfReferenceUID": new_uid(), "PositionReferenceIndicator": "",
        "ConversionType": "WSD", "Manufacturer": "globule", "SoftwareVersions": _version(),
        "InstanceNumber": 1, "ContentDate": date, "ContentTime": clock, "PatientOrientation": "",
        "ImageType": ["DERIVED", "SECONDARY"], "BurnedInAnnotation": "NO",
        "DerivationDescription": "Reconstructed from tracked ultrasound images",
        "NumberOfFrames": depth, "Rows": height, "Columns": width, "SamplesPerPixel": 1,
        "PhotometricInterpretation": "MONOCHROME2", "PresentationLUTShape": "IDENTITY",
        "BitsAllocated": 8 * size, "BitsStored": 8 * size, "HighBit": 8 * size - 1,
        "PixelRepresentation": 0, "RescaleIntercept": 0, "RescaleSlope": 1, "RescaleType": "US",
    }  # fmt: skip
    for name, value in elements.items():
        setattr(file, name, value)
    _frames(pydicom, file, matrix, spacing, axes, depth)
    little = np.ascontiguousarray(values, values.dtype.newbyteorder("<"))
    file.PixelData = little.tobytes() + bytes(little.nbytes % 2)
    file["PixelData"].VR = "OB" if size == 1 else "OW"
    with atomic_write(path) as out:
        file.save_as(out, enforce_file_format=True)


def _frames(pydicom: Any, file: Any, matrix: np.ndarray, spacing: np.ndarray, axes: np.ndarray, depth: int) -> None:
    """The functional groups: what all frames share, and where each lies."""

    def item(**elements: Any) -> Any:
        data = pydicom.Dataset()
        for name, value in elements.items():
            setattr(data, name, [value] if isinstance(value, pydicom.Dataset) else value)
        return data

    def texts(numbers: np.ndarray) -> list[str]:
        return [pydicom.valuerep.format_number_as_ds(float(number)) for number in numbers]

    x, y, z = texts(spacing)
    file.FrameIncrementPointer = 0x52009230  # Per-frame Functional Groups Sequence
    file.SharedFunctionalGroupsSequence = [
        item(
            PixelMeasuresSequence=item(PixelSpacing=[y, x], SliceThickness=z, SpacingBetweenSlices=z),
            PlaneOrientationSequence=item(ImageOrientationPatient=texts(axes[:, :2].T.ravel())),
        )
    ]
    file.PerFrameFunctionalGroupsSequence = [
        item(PlanePositionSequence=item(ImagePositionPatient=texts(matrix[:3, 3] + i * matrix[:3, 2])))
        for i in range(depth)
    ]


def _right_handed(data: VolumeData) -> tuple[np.ndarray, np.ndarray]:
    """Values and place, with the planes in reverse if the axes are left-handed."""
    values, matrix = data.values, np.array(data.world_from_voxel)
    if np.linalg.det(matrix[:3, :3]) < 0:
        matrix[:3, 3] += (len(values) - 1) * matrix[:3, 2]
        matrix[:3, 2] *= -1
        values = values[::-1]
    return values, matrix


def _check(values: np.ndarray, axes: np.ndarray) -> None:
    if values.dtype not in (np.uint8, np.uint16):
        expected = "expected uint8 or uint16 for .dcm"
        raise ValueError(f"values: {expected}, got {values.dtype}; write .nrrd or .nii")
    if max(values.shape) > _MOST_SIDE or values.nbytes > _MOST_BYTES:
        size = "x".join(map(str, values.shape[::-1]))
        raise ValueError(f"values: expected less than 4 GiB for .dcm, got {size} {values.dtype}")
    if np.abs(axes.T @ axes - np.eye(3)).max() > _STRAIGHT:
        raise ValueError("world_from_voxel: expected perpendicular axes for .dcm, got skewed ones")


def _version() -> str:
    from ... import __version__

    return str(__version__)
