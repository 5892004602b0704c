"""Volumes as MetaImage (.mha), NRRD (.nrrd) and NIfTI (.nii, .nii.gz): values only, no maps."""

from __future__ import annotations

import gzip
import math
import os
import struct
import zlib
from typing import Any

import numpy as np

from ..._base.files import atomic_write
from ..errors import bad, shown
from . import metaimage, nrrd
from .geometry import LPS_FROM_RAS, VolumeData, place, spacing_and_directions
from .raw import MOST_DEFLATE_CAN_EXPAND

_NRRD_SPACES = {
    "left-posterior-superior": "LPS", "lps": "LPS",
    "right-anterior-superior": "RAS", "ras": "RAS",
}  # fmt: skip


def read_metaimage(path: str | os.PathLike) -> VolumeData:
    """Read a .mha or .mhd; ITK's world is LPS (MetaImage calls that RAI)."""
    image = metaimage.read(path)
    array = image.array[0] if image.array.ndim == 4 and len(image.array) == 1 else image.array
    fields = image.fields
    n = len(fields["DimSize"].split())
    spacing = metaimage.numbers(path, fields, "ElementSpacing", n, [1.0] * n)[:3]
    if "ElementSpacing" not in fields:
        spacing = metaimage.numbers(path, fields, "ElementSize", n, [1.0] * n)[:3]
    for name in ("Offset", "Position", "Origin"):
        if name in fields:
            break
    origin = metaimage.numbers(path, fields, name, n, [0.0] * n)[:3]
    for name in ("TransformMatrix", "Rotation", "Orientation"):
        if name in fields:
            break
    matrix = metaimage.numbers(path, fields, name, n * n, np.eye(n).ravel().tolist())
    # A row of MetaImage's matrix is the direction of one axis.
    directions = matrix.reshape(n, n)[:3, :3].T
    if n == 2:
        raise bad(path, "DimSize", "expected three sizes, got two")
    return VolumeData(array, place(directions * spacing, origin))


def write_metaimage(path: str | os.PathLike, data: VolumeData) -> None:
    """Write a .mha in LPS."""
    spacing, directions = spacing_and_directions(_lps(data))
    fields = {
        "BinaryData": "True",
        "TransformMatrix": _text(directions.T.ravel()),
        "Offset": _text(_lps(data)[:3, 3]),
        "CenterOfRotation": "0 0 0",
        "AnatomicalOrientation": "RAI",
        "ElementSpacing": _text(spacing),
    }
    metaimage.write(path, _plain(data.values), fields)


def read_nrrd(path: str | os.PathLike) -> VolumeData:
    """Read a .nrrd or .nhdr of three axes; its space may be LPS or RAS."""
    image = nrrd.read(path)
    fields = image.fields
    named = fields.get("space", "left-posterior-superior").lower()
    if named not in _NRRD_SPACES:
        expected = "left-posterior-superior or right-anterior-superior"
        raise bad(path, "space", f"expected {expected}, got {shown(named)}")
    n = image.array.ndim
    if n != 3:
        raise bad(path, "dimension", f"expected 3, got {n}")
    if "space directions" in fields:
        steps = np.array([_vector(path, "space directions", text)
                          for text in _vectors(path, fields["space directions"], 3)]).T  # fmt: skip
    else:
        words = fields.get("spacings", "1 1 1").split()
        steps = np.diag(_vector(path, "spacings", "(" + ",".join(words) + ")"))
    origin = _vector(path, "space origin", fields.get("space origin", "(0,0,0)"))
    return VolumeData(image.array, place(steps, origin), _NRRD_SPACES[named])


def write_nrrd(path: str | os.PathLike, data: VolumeData) -> None:
    """Write a .nrrd in the volume's own space."""
    names = {short: long for long, short in _NRRD_SPACES.items() if "-" in long}
    matrix = data.world_from_voxel
    steps = " ".join(_bracketed(matrix[:3, axis]) for axis in range(3))
    fields = {
        "space": names[data.space],
        "space directions": steps,
        "kinds": "domain domain domain",
        "space origin": _bracketed(matrix[:3, 3]),
    }
    nrrd.write(path, _plain(data.values), fields)


_NIFTI_TYPES = {2: "u1", 4: "i2", 8: "i4", 16: "f4", 64: "f8", 256: "i1", 512: "u2", 768: "u4",
                1024: "i8", 1280: "u8"}  # fmt: skip
_NIFTI_CODES = {kind: code for code, kind in _NIFTI_TYPES.items()}
_NIFTI_HEADER = 348


def read_nifti(path: str | os.PathLike) -> VolumeData:
    """Read a NIfTI-1 (.nii, .nii.gz); its world is RAS. Scaled values become float64."""
    raw = _unpacked(path)
    if len(raw) < _NIFTI_HEADER or raw[344:347] != b"n+1":
        raise bad(path, "", "expected a NIfTI-1 file (magic n+1), got something else")
    order = "<" if struct.unpack_from("<i", raw, 0)[0] == _NIFTI_HEADER else ">"
    dim = struct.unpack_from(order + "8h", raw, 40)
    sizes = dim[1 : 1 + dim[0]] if 1 <= dim[0] <= 7 else ()
    if len(sizes) < 3 or any(s != 1 for s in sizes[3:]) or min(sizes[:3]) < 1:
        raise bad(path, "dim", f"expected three sizes from 1, got {list(sizes)}")
    code = struct.unpack_from(order + "h", raw, 70)[0]
    if code not in _NIFTI_TYPES:
        raise bad(path, "datatype", f"expected a real number type, got {code}")
    dtype = np.dtype(_NIFTI_TYPES[code]).newbyteorder(order)
    offset, slope, intercept = struct.unpack_from(order + "3f", raw, 108)
    if not math.isfinite(offset) or not _NIFTI_HEADER <= offset <= len(raw):
        raise bad(path, "vox_offset", f"expected 352 to {len(raw)}, got {offset:g}")
    count = math.prod(sizes[:3])
    left = len(raw) - int(offset)
    if count * dtype.itemsize > left:
        raise bad(path, "data", f"expected {count * dtype.itemsize} bytes, got {left}")
    values = np.frombuffer(raw, dtype, count, int(offset)).reshape(sizes[2::-1])
    values = values.astype(dtype.newbyteorder("="))
    if slope not in (0.0, 1.0) or (slope and intercept):
        if not (math.isfinite(slope) and math.isfinite(intercept)):
            raise bad(path, "scl_slope", f"expected finite numbers, got {slope} and {intercept}")
        values = values * np.float64(slope) + intercept
    return VolumeData(values, _nifti_place(path, raw, order), "RAS")


def write_nifti(path: str | os.PathLike, data: VolumeData) -> None:
    """Write a NIfTI-1 in RAS. The format's geometry is float32: the only one that rounds."""
    values = _plain(data.values)
    kind = f"{values.dtype.kind}{values.dtype.itemsize}"
    if kind not in _NIFTI_CODES:
        raise ValueError(f"values: expected a type that .nii can hold, got {values.dtype}")
    if max(values.shape) > 32767:
        raise ValueError(
            f"values: expected at most 32767 voxels a side for .nii, got {values.shape}"
        )
    matrix = data.world_from_voxel if data.space == "RAS" else LPS_FROM_RAS @ data.world_from_voxel
    spacing, _ = spacing_and_directions(matrix)
    header = bytearray(_NIFTI_HEADER + 4)
    struct.pack_into("<i", header, 0, _NIFTI_HEADER)
    struct.pack_into("<8h", header, 40, 3, *values.shape[::-1], 1, 1, 1, 1)
    struct.pack_into("<2h", header, 70, _NIFTI_CODES[kind], 8 * values.dtype.itemsize)
    struct.pack_into("<8f", header, 76, 1.0, *spacing, 0, 0, 0, 0)
    struct.pack_into("<3f", header, 108, _NIFTI_HEADER + 4, 1.0, 0.0)
    header[123] = 2  # mm
    struct.pack_into("<2h", header, 252, 0, 1)  # no quaternion; the affine is the scanner's
    struct.pack_into("<12f", header, 280, *matrix[:3].ravel())
    header[344:348] = b"n+1\0"
    content = bytes(header) + np.ascontiguousarray(values, values.dtype.newbyteorder("<")).tobytes()
    with atomic_write(path) as file:
        packed = os.fspath(path).lower().endswith(".gz")
        file.write(gzip.compress(content, 6, mtime=0) if packed else content)


def _unpacked(path: str | os.PathLike) -> bytes:
    with open(path, "rb") as file:
        if file.read(2) != b"\x1f\x8b":
            file.seek(0)
            return file.read()
        file.seek(0)
        left = os.fstat(file.fileno()).st_size
        try:
            with gzip.GzipFile(fileobj=file) as unpacked:
                head = unpacked.read(_NIFTI_HEADER)
                size = _announced(head)
                if size > MOST_DEFLATE_CAN_EXPAND * left:
                    raise bad(path, "data", f"expected {size} bytes, got {left} compressed ones")
                return head + unpacked.read(size)
        except (EOFError, OSError, zlib.error) as error:
            raise bad(path, "data", f"expected whole gzip data, got {error}") from None


def _announced(head: bytes) -> int:
    """At most how many bytes a NIfTI file has, by its header."""
    if len(head) < _NIFTI_HEADER:
        return 0
    order = "<" if struct.unpack_from("<i", head, 0)[0] == _NIFTI_HEADER else ">"
    dim = struct.unpack_from(order + "8h", head, 40)
    return math.prod(max(1, s) for s in dim[1:4]) * 8 + 65536


def _nifti_place(path: Any, raw: bytes, order: str) -> np.ndarray:
    qform, sform = struct.unpack_from(order + "2h", raw, 252)
    pixdim = np.array(struct.unpack_from(order + "8f", raw, 76), np.float64)
    if sform > 0:
        rows = np.array(struct.unpack_from(order + "12f", raw, 280), np.float64).reshape(3, 4)
        return np.vstack([rows, (0, 0, 0, 1)])
    if qform <= 0:
        return place(np.diag(pixdim[1:4]), np.zeros(3))
    b, c, d, *origin = struct.unpack_from(order + "6f", raw, 256)
    rest = 1 - b * b - c * c - d * d
    if not rest > -1e-5:
        raise bad(path, "quatern", f"expected a length up to 1, got {b:g} {c:g} {d:g}")
    a = math.sqrt(max(rest, 0.0))
    rotation = np.array(
        [
            [a * a + b * b - c * c - d * d, 2 * (b * c - a * d), 2 * (b * d + a * c)],
            [2 * (b * c + a * d), a * a + c * c - b * b - d * d, 2 * (c * d - a * b)],
            [2 * (b * d - a * c), 2 * (c * d + a * b), a * a + d * d - c * c - b * b],
        ]
    )
    handed = -1.0 if pixdim[0] < 0 else 1.0
    return place(rotation * pixdim[1:4] * (1, 1, handed), np.array(origin))


def _lps(data: VolumeData) -> np.ndarray:
    return data.world_from_voxel if data.space == "LPS" else LPS_FROM_RAS @ data.world_from_voxel


def _plain(values: np.ndarray) -> np.ndarray:
    """Types that medical formats know: bool becomes uint8, half becomes float32."""
    if values.dtype == bool:
        return values.astype(np.uint8)
    return values.astype(np.float32) if values.dtype == np.float16 else values


def _text(values: Any) -> str:
    return " ".join(repr(value) for value in np.asarray(values, np.float64).tolist())


def _bracketed(values: Any) -> str:
    return "(" + ",".join(repr(value) for value in np.asarray(values, np.float64).tolist()) + ")"


def _vectors(path: Any, text: str, n: int) -> list[str]:
    words = text.replace(", ", ",").split()
    if len(words) != n:
        raise bad(path, "space directions", f"expected {n} vectors, got {shown(text)}")
    return words


def _vector(path: Any, name: str, text: str) -> np.ndarray:
    try:
        values = np.array([float(word) for word in text.strip("() ").split(",")])
    except ValueError:
        values = np.empty(0)
    if len(values) != 3 or not np.isfinite(values).all():
        raise bad(path, name, f"expected (x,y,z), got {shown(text)}")
    return values
