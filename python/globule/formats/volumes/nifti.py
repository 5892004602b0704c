"""NIfTI-1 and NIfTI-2 (.nii, .nii.gz) through nibabel; the format's own frame is RAS."""

from __future__ import annotations

import gzip
import io
import math
import os
import zlib
from typing import Any

import numpy as np

from ..._base.checks import missing
from ..._base.files import atomic_write
from ..errors import bad
from .geometry import VolumeData, in_space, plain
from .raw import MOST_DEFLATE_CAN_EXPAND

_MILLIMETRES = {"meter": 1000.0, "mm": 1.0, "micron": 0.001, "unknown": 1.0}
_LONGEST_HEADER = 540  # bytes, of NIfTI-2
_LARGEST_SIDE = 32767  # voxels, of NIfTI-1


def read(path: str | os.PathLike[str]) -> VolumeData:
    """Read a NIfTI file of three axes: values (Z, Y, X), RAS, mm.

    Scaled values (scl_slope, scl_inter) become float64. The place is the sform's if the file has
    one, else the qform's. Raises MissingPackageError without nibabel, FormatError for bad files.
    """
    nibabel = _nibabel()
    with open(path, "rb") as file:
        packed = file.read(2) == b"\x1f\x8b"
        file.seek(0)
        held = os.fstat(file.fileno()).st_size
        try:
            data = gzip.GzipFile(fileobj=file) if packed else file
            header = _header(path, nibabel, data.read(_LONGEST_HEADER))
            shape, dtype = header.get_data_shape(), header.get_data_dtype()
            if len(shape) < 3 or any(n != 1 for n in shape[3:]) or min(shape[:3]) < 1:
                sizes = list(map(int, shape))
                raise bad(path, "dim", f"expected a volume of 3 axes, got sizes {sizes}")
            if dtype.kind not in "iuf":
                raise bad(path, "datatype", f"expected one real number per voxel, got {dtype}")
            offset, size = float(header["vox_offset"]), math.prod(shape) * dtype.itemsize
            most = MOST_DEFLATE_CAN_EXPAND * held if packed else held
            if not header.sizeof_hdr <= offset <= most - size:
                got = f"{held} bytes in the file and vox_offset {offset:g}"
                raise bad(path, "data", f"expected {size} bytes of voxels, got {got}")
            data.seek(int(offset))
            raw = data.read(size)
            if len(raw) < size:
                raise bad(path, "data", f"expected {size} bytes of voxels, got {len(raw)}")
            while packed and data.read(1 << 20):  # to the end, where the checksum is
                pass
            values = np.frombuffer(raw, dtype).reshape(shape[2::-1])
            slope, intercept = header.get_slope_inter()
            affine = header.get_best_affine()
            unit = header.get_xyzt_units()[0]
        except (EOFError, zlib.error, gzip.BadGzipFile) as error:
            raise bad(path, "data", f"expected whole gzip data, got {error}") from None
        except (nibabel.spatialimages.HeaderDataError, KeyError, OverflowError) as error:
            raise bad(path, "header", f"expected NIfTI, got {error}") from None
    values = values.astype(dtype.newbyteorder("="))
    if slope is not None and (slope, intercept) != (1, 0):
        values = values * np.float64(slope) + intercept
    affine = np.array(affine, np.float64)
    affine[:3] *= _MILLIMETRES[unit]
    return VolumeData(values, affine, "RAS")


def write(path: str | os.PathLike[str], data: VolumeData) -> None:
    """Write a NIfTI-1 file in RAS, mm. The format's geometry is float32: the only one that rounds.

    Raises MissingPackageError without nibabel, ValueError for values that NIfTI cannot hold.
    """
    nibabel = _nibabel()
    values = plain(data.values)
    if max(values.shape) > _LARGEST_SIDE:
        most = f"at most {_LARGEST_SIDE} voxels a side for .nii"
        raise ValueError(f"values: expected {most}, got {values.shape}")
    affine = in_space(data, "RAS").world_from_voxel
    try:
        image = nibabel.Nifti1Image(values.T, affine, dtype=values.dtype)
    except nibabel.spatialimages.HeaderDataError:
        got = values.dtype
        raise ValueError(f"values: expected a type that .nii can hold, got {got}") from None
    image.header.set_xyzt_units("mm")
    image.set_sform(affine, "scanner")
    image.set_qform(None, 0)
    content = image.to_bytes()
    with atomic_write(path) as file:
        packed = os.fspath(path).lower().endswith(".gz")
        file.write(gzip.compress(content, 6, mtime=0) if packed else content)


def _header(path: Any, nibabel: Any, head: bytes) -> Any:
    for kind, magic in ((nibabel.Nifti2Header, head[4:8]), (nibabel.Nifti1Header, head[344:348])):
        if len(head) >= kind.sizeof_hdr and magic[:2] == b"n+" and magic[3:] == b"\0":
            return kind.from_fileobj(io.BytesIO(head), check=False)
    raise bad(path, "header", "expected a NIfTI file (magic n+1 or n+2), got other data")


def _nibabel() -> Any:
    try:
        import nibabel
    except ImportError:
        raise missing("nibabel", "medical") from None
    return nibabel
