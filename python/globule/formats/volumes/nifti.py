"""NIfTI-1 and NIfTI-2 (.nii, .nii.gz) through nibabel; the format's own frame is RAS."""

from __future__ import annotations

import gzip
import io
import math
import os
import zlib
from typing import Any

import numpy as np

from ..._base.checks import optional
from ..._base.files import atomic_write
from ..errors import bad
from ..inflate import GZIP, Inflated
from ..size import bytes_of, check_size
from .geometry import VolumeData, in_space, plain
from .raw import LONGEST_HEADER

_MILLIMETERS = {"meter": 1000.0, "mm": 1.0, "micron": 0.001, "unknown": 1.0}
_HEADER_1, _HEADER_2 = 348, 540  # bytes, of NIfTI-1 and NIfTI-2
_LARGEST_SIDE = 32767  # voxels, of NIfTI-1


def read(path: str | os.PathLike[str]) -> VolumeData:
    """Read a NIfTI file of three axes: values (Z, Y, X), RAS, mm.

    Scaled values (scl_slope, scl_inter) become float64. The place is the sform's if the file has
    one, else the qform's. Raises MissingPackageError without nibabel, FormatError for bad files.
    """
    nibabel = optional("nibabel", "medical")
    with open(path, "rb") as file:
        packed = file.read(2) == b"\x1f\x8b"
        file.seek(0)
        held = os.fstat(file.fileno()).st_size
        try:
            data = Inflated(file, GZIP) if packed else None
            source: Any = data or file
            head = source.read(_HEADER_1)
            if _HEADER_2 in (int.from_bytes(head[:4], "little"), int.from_bytes(head[:4], "big")):
                head += source.read(_HEADER_2 - _HEADER_1)
            header = _header(path, nibabel, head)
            shape, dtype = header.get_data_shape(), header.get_data_dtype()
            if len(shape) < 3 or any(n != 1 for n in shape[3:]) or min(shape[:3]) < 1:
                sizes = list(map(int, shape))
                raise bad(path, "dim", f"expected a volume of 3 axes, got sizes {sizes}")
            if dtype.kind not in "iuf":
                raise bad(path, "datatype", f"expected one real number per voxel, got {dtype}")
            offset, size = float(header["vox_offset"]), math.prod(shape) * dtype.itemsize
            if not header.sizeof_hdr <= offset <= max(held, LONGEST_HEADER):
                got = f"vox_offset {offset:g} in a file of {held}"
                raise bad(path, "data", f"expected {size} bytes of voxels, got {got}")
            peak = 1.0 if _is_plain(header) else 1.0 + 16 / dtype.itemsize
            check_size(path, "data", offset + size, held, peak)
            values = np.empty(shape[2::-1], dtype)
            view = bytes_of(values)
            if data:
                data.skip(int(offset) - len(head))
                n = data.fill(view)
                data.finish()
            else:
                file.seek(int(offset))
                n = file.readinto(view)
            if n < size:
                raise bad(path, "data", f"expected {size} bytes of voxels, got {n}")
            slope, intercept = header.get_slope_inter()
            affine = header.get_best_affine()
            unit = header.get_xyzt_units()[0]
        except (EOFError, zlib.error) as error:
            raise bad(path, "data", f"expected whole gzip data, got {error}") from None
        except (nibabel.spatialimages.HeaderDataError, KeyError, OverflowError) as error:
            raise bad(path, "header", f"expected NIfTI, got {error}") from None
    if not dtype.isnative:
        values = values.byteswap(inplace=True).view(dtype.newbyteorder("="))
    if slope is not None and (slope, intercept) != (1, 0):
        values = values * np.float64(slope) + intercept
    affine = np.array(affine, np.float64)
    affine[:3] *= _MILLIMETERS[unit]
    return VolumeData(values, affine, "RAS")


def write(path: str | os.PathLike[str], data: VolumeData) -> None:
    """Write a NIfTI-1 file in RAS, mm. The format's geometry is float32: the only one that rounds.

    Raises MissingPackageError without nibabel, ValueError for values that NIfTI cannot hold.
    """
    nibabel = optional("nibabel", "medical")
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


def _is_plain(header: Any) -> bool:
    """Whether the numbers are the values, without a scale."""
    slope, intercept = header.get_slope_inter()
    return slope is None or (slope, intercept) == (1, 0)
