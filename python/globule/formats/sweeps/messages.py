"""OpenIGTLink messages (protocol 1, header version 1) of images, transforms, triangles and text.

Numbers of headers are big endian; pixels are little endian. The matrix of an IMAGE has the image's
center as its last column. Matrices and points of the messages are in RAS: the receivers of 3D
Slicer ignore the axes that an IMAGE states and take RAS, and POLYDATA states none.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ... import _core
from ..._base.arrays import address
from ..size import bytes_of

RAS_FROM_LPS = np.diag([-1.0, -1.0, 1.0, 1.0])
_SCALARS = {"int8": 2, "uint8": 3, "int16": 4, "uint16": 5, "int32": 6, "uint32": 7,
            "float32": 10, "float64": 11}  # fmt: skip
_RAS, _LITTLE = 1, 2
_LONGEST_NAME = 20
_ASCII = 3  # in IANA's list of character sets


class Packed(NamedTuple):
    """A message as it is sent: name of the device, and parts whose bytes follow each other."""

    name: str
    parts: tuple[bytes | memoryview, ...]

    @property
    def n_bytes(self) -> int:
        """Length of the whole message."""
        return sum(len(part) for part in self.parts)


def image(name: str, values: np.ndarray, world_from_voxel: np.ndarray, time: float) -> Packed:
    """An IMAGE.

    Args:
        name: of the device, at most 20 letters.
        values: (Z, Y, X), kept until the message is sent.
        world_from_voxel: (4, 4) of the voxel (x, y, z, 1), mm, LPS.
        time: s.

    Raises ValueError for more than 65535 voxels along an axis, TypeError for other numbers.
    """
    if values.dtype.name not in _SCALARS:
        raise TypeError(f"values: expected one of {', '.join(_SCALARS)}, got {values.dtype}")
    if values.ndim != 3 or max(values.shape) > 65535:
        raise ValueError(f"values: expected (Z, Y, X) with at most 65535 an axis, got {values.shape}")
    size = values.shape[::-1]
    matrix = RAS_FROM_LPS @ np.asarray(world_from_voxel, np.float64)
    center = matrix[:3, :3] @ ((np.array(size) - 1) / 2) + matrix[:3, 3]
    head = struct.pack(
        ">HBBBB3H12f6H", 1, 1, _SCALARS[values.dtype.name], _LITTLE, _RAS, *size,
        *matrix[:3, :3].T.ravel(), *center, 0, 0, 0, *size,
    )  # fmt: skip
    pixels = np.ascontiguousarray(values, values.dtype.newbyteorder("<"))
    return _packed("IMAGE", name, time, head, pixels)


def transform(name: str, world_from_other: np.ndarray, time: float) -> Packed:
    """A TRANSFORM: (4, 4) to the world, mm, LPS."""
    matrix = RAS_FROM_LPS @ np.asarray(world_from_other, np.float64)
    return _packed("TRANSFORM", name, time, struct.pack(">12f", *matrix[:3].T.ravel()))


def triangles(name: str, vertices: np.ndarray, faces: np.ndarray, time: float) -> Packed:
    """A POLYDATA: vertices (V, 3) mm, LPS; faces (F, 3) indices of vertices."""
    points = (np.asarray(vertices, np.float64) @ RAS_FROM_LPS[:3, :3]).astype(">f4")
    cells = np.full((len(faces), 4), 3, ">u4")
    cells[:, 1:] = faces
    head = struct.pack(">10I", len(points), 0, 0, 0, 0, len(cells), cells.nbytes, 0, 0, 0)
    return _packed("POLYDATA", name, time, head, points, cells)


def text(name: str, words: str, time: float) -> Packed:
    """A STRING of ASCII letters."""
    letters = words.encode("ascii", "replace")[:65535]
    return _packed("STRING", name, time, struct.pack(">HH", _ASCII, len(letters)) + letters)


def _packed(kind: str, name: str, time: float, head: bytes, *arrays: np.ndarray) -> Packed:
    letters = name.encode("ascii", "replace")
    if not 0 < len(letters) <= _LONGEST_NAME:
        raise ValueError(f"name: expected 1 to {_LONGEST_NAME} letters, got {name!r}")
    bodies: Sequence[np.ndarray] = (np.frombuffer(head, np.uint8), *arrays)
    check = 0
    for array in bodies:
        check = _core.crc64(address(array), array.nbytes, check) if array.nbytes else check
    seconds = int(time)
    header = struct.pack(
        ">H12s20sIIQQ", 1, kind.encode(), letters, seconds, int((time - seconds) * 2**32),
        sum(array.nbytes for array in bodies), check,
    )  # fmt: skip
    views = (bytes_of(array) for array in arrays if array.nbytes)
    return Packed(name, (header + head, *views))
