"""The facts of every volume format: values, where they lie, and maps of the same shape."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from ..._base.checks import choice
from ..errors import bad

SPACES = ("LPS", "RAS")
LPS_FROM_RAS = np.diag([-1.0, -1.0, 1.0, 1.0])  # its own inverse
_FARTHEST = 1e12  # largest number of a place: more is damage, and overflows


class VolumeData(NamedTuple):
    """The contents of a volume file.

    values             (Z, Y, X)
    world_from_voxel   (4, 4) float64, mm: voxel index (x, y, z, 1) of a voxel's center to the world
    space              "LPS" or "RAS": what the world's axes mean
    maps               arrays (Z, Y, X) by name
    """

    values: np.ndarray
    world_from_voxel: np.ndarray
    space: str = "LPS"
    maps: Mapping[str, np.ndarray] = MappingProxyType({})


def in_space(data: VolumeData, space: str) -> VolumeData:
    """The same volume with the world's axes in `space`, "LPS" or "RAS"; the voxels keep their
    order. Raises ValueError for another space."""
    choice("space", space, SPACES)
    if data.space == space:
        return data
    return data._replace(world_from_voxel=LPS_FROM_RAS @ data.world_from_voxel, space=space)


def spacing_and_directions(world_from_voxel: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Steps of x, y and z in mm, (3,), and their unit directions as columns, (3, 3)."""
    steps = world_from_voxel[:3, :3]
    spacing = np.linalg.norm(steps, axis=0)
    return spacing, steps / spacing


def plain(values: np.ndarray) -> np.ndarray:
    """Types that medical formats know: bool becomes uint8, half becomes float32."""
    if values.dtype == bool:
        return values.astype(np.uint8)
    return values.astype(np.float32) if values.dtype == np.float16 else values


def place(steps: np.ndarray, origin: np.ndarray) -> np.ndarray:
    """The 4x4 of three steps (columns) and an origin."""
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = steps, origin
    return matrix


def checked(path: Any, data: VolumeData) -> VolumeData:
    """`data`, if it is a volume of numbers at a place that can be inverted; else FormatError."""
    values, matrix = data.values, data.world_from_voxel
    if values.ndim != 3 or 0 in values.shape or values.dtype.kind not in "biuf":
        got = f"{values.dtype} {values.shape}"
        raise bad(path, "values", f"expected numbers of shape (Z, Y, X), got {got}")
    matrix = np.asarray(matrix)
    if matrix.shape != (4, 4) or matrix.dtype.kind not in "biuf" or not np.isfinite(matrix).all():
        raise bad(path, "geometry", "expected 4x4 finite numbers")
    matrix = matrix.astype(np.float64)
    if abs(np.linalg.det(matrix[:3, :3])) < 1e-30:
        raise bad(path, "geometry", "expected axes that span space, got a singular matrix")
    farthest = float(np.abs(matrix).max())
    if farthest > _FARTHEST:
        expected = f"voxels and places up to {_FARTHEST:g}"
        raise bad(path, "geometry", f"expected {expected}, got {farthest:g}")
    for name, array in data.maps.items():
        if array.shape != values.shape:
            expected = f"shape {values.shape} as the values"
            raise bad(path, name, f"expected {expected}, got {array.shape}")
    return data._replace(world_from_voxel=matrix)
