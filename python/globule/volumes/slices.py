"""Slices of volumes: along any plane, in the planes of the frames, and three-view images.

Slices also hold the origin of each value: measured, filled between data, extrapolated, or
empty.
"""

from __future__ import annotations

import io
import os
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from .._base.arrays import VectorLike
from .._base.files import atomic_write
from .plane_axes import with_axes
from .volume import EMPTY, EXTRAPOLATED, FAR, FILLED, MEASURED, Volume, origin_of

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

AXES = [("x", "y"), ("x", "z"), ("y", "z")]  # of the three planes, to the right and down
_ROWS = 64  # of a slice at once: bounds the memory


class Slice(NamedTuple):
    """values (H, W) float32; origin (H, W) uint8: 0 empty or outside, 1 measured, 2 filled,
    3 extrapolated."""

    values: np.ndarray
    origin: np.ndarray


def reslice(volume: Volume, world_from_plane: ArrayLike, size: tuple[int, int], linear: bool = True) -> Slice:
    """A volume's values on a plane.

    Args:
        volume: the volume to slice.
        world_from_plane: (4, 4), maps (column, row, 0, 1) to mm in the world.
        size: columns and rows.
        linear: interpolate between the eight voxels around a point, without empty voxels. False:
            the value of the nearest voxel.

    Returns:
        Slice; `origin` is the origin of the nearest voxel's value.

    Raises ValueError for a matrix that is not finite or a size below 1x1.
    """
    matrix = np.asarray(world_from_plane, np.float64)
    if matrix.shape != (4, 4) or not np.isfinite(matrix).all():
        raise ValueError(f"world_from_plane: expected 4x4 finite numbers, got shape {matrix.shape}")
    width, height = (int(n) for n in size)
    if width < 1 or height < 1:
        raise ValueError(f"size: expected at least 1x1, got {width}x{height}")
    voxel_from_plane = np.linalg.inv(volume.world_from_voxel) @ matrix
    values = np.zeros((height, width), np.float32)
    origin = np.zeros((height, width), np.uint8)
    columns = np.arange(width, dtype=np.float64)
    for start in range(0, height, _ROWS):
        rows = np.arange(start, min(height, start + _ROWS), dtype=np.float64)
        points = (
            voxel_from_plane[:3, 0] * columns[None, :, None]
            + voxel_from_plane[:3, 1] * rows[:, None, None]
            + voxel_from_plane[:3, 3]
        )
        part = slice(start, start + len(rows))
        values[part], origin[part] = sample(volume.values, volume.radius, points, linear)
    return Slice(values, origin)


def reslice_frame(volume: Volume, sweep: Any, i: int, linear: bool = True) -> Slice:
    """The volume's values in the plane of frame `i` of a sweep: a Slice (H, W) like the frame.

    Raises ValueError for a frame without a pose.
    """
    height, width = sweep.frames.shape[1:]
    if not sweep.valid[i]:
        raise ValueError(f"i: expected a valid frame, got {i}, which has no pose")
    return reslice(volume, sweep.world_from_image[i], (width, height), linear)


def sample(values: np.ndarray, radius: np.ndarray, points: np.ndarray, linear: bool) -> tuple[np.ndarray, np.ndarray]:
    """Values (...) float32 and origins (...) uint8 at voxel coordinates (..., 3), x first.

    values, radius (Z, Y, X): those of a Volume.
    """
    sizes = np.array(values.shape[::-1])
    nearest = np.floor(points + 0.5).astype(np.int64)
    inside = ((nearest >= 0) & (nearest < sizes)).all(axis=-1)
    steps = np.array([1, sizes[0], sizes[0] * sizes[1]])
    values, radius = values.reshape(-1), radius.reshape(-1)
    at = nearest[inside] @ steps
    origin = np.full(inside.shape, EMPTY, np.uint8)
    origin[inside] = origin_of(radius[at])
    out = np.zeros(inside.shape, np.float32)
    if not linear:
        out[inside] = np.where(radius[at] != FAR, values[at], 0)
        return out, origin
    low = np.clip(np.floor(points[inside]).astype(np.int64), 0, np.maximum(sizes - 2, 0))
    share = np.clip(points[inside] - low, 0, 1).astype(np.float32)
    far = np.where(sizes > 1, steps, 0)  # to the next voxel, where there is one
    low = low @ steps
    total, weights = np.zeros(len(low), np.float32), np.zeros(len(low), np.float32)
    for corner in np.ndindex(2, 2, 2):
        index = low + far @ corner
        weight = (radius[index] != FAR).astype(np.float32)
        for axis in range(3):
            weight *= share[:, axis] if corner[axis] else 1 - share[:, axis]
        total += weight * values[index]
        weights += weight
    known = (origin[inside] != EMPTY) & (weights > 0)
    out[inside] = np.where(known, total / np.where(known, weights, 1), 0)
    return out, origin


def render_three_view(volume: Volume, center: VectorLike | None = None, overlay: bool = False) -> np.ndarray:
    """The three planes along the volume's axes, side by side: (H, W, 3) uint8.

    Args:
        volume: the volume to slice.
        center: (x, y, z) mm, world, where the planes meet; default: the middle of the voxels with
            values.
        overlay: tint filled voxels (orange), extrapolated voxels (purple) and empty voxels (blue)
            over the gray of measured voxels.

    From left to right the planes of x and y, of x and z, of y and z, in the volume's own axes and
    with square pixels; each plane's row 0 is the axis' beginning.
    """
    pictures, _ = _planes(volume, center, overlay)
    return _beside(pictures)


def max_projections(volume: Volume) -> np.ndarray:
    """Maximum-intensity projections along z, y and x, beside each other: (H, W, 3) uint8, like
    `render_three_view`. Empty voxels do not count; a line without values is dark blue."""
    return _beside(_projections(volume)[0])


def save_three_view(
    path: str | os.PathLike[str], volume: Volume, center: VectorLike | None = None, projections: bool = False
) -> None:
    """Write a three-view image (.png): the values above, the same with the overlay below; with
    `projections`, maximum-intensity projections in a third row. Arrows beside the planes name the
    volume's axes and have a labeled length in mm."""
    from PIL import Image

    shown = [_planes(volume, center, overlay) for overlay in (False, True)]
    if projections:
        shown.append(_projections(volume))
    rows = [with_axes(pictures, AXES, step) for pictures, step in shown]
    packed = io.BytesIO()
    Image.fromarray(np.concatenate(rows)).save(packed, "PNG")
    with atomic_write(path) as file:
        file.write(packed.getvalue())


def _planes(volume: Volume, center: Any, overlay: bool) -> tuple[list[np.ndarray], float]:
    """The three planes' pictures and the side of their pixels, mm."""
    values, radius = volume.values, volume.radius
    sizes = np.array(values.shape[::-1])
    if center is None:
        middle = _middle(radius != FAR)
    else:
        place = np.append(np.asarray(center, np.float64), 1.0)
        middle = np.floor(np.linalg.solve(volume.world_from_voxel, place)[:3] + 0.5).astype(int)
        if place.shape != (4,) or (middle < 0).any() or (middle >= sizes).any():
            raise ValueError(f"center: expected a place inside of the volume, got {center!r}")
    x, y, z = middle
    spacing = np.linalg.norm(volume.world_from_voxel[:3, :3], axis=0)
    planes = [
        (values[z], origin_of(radius[z]), spacing[1], spacing[0]),
        (values[:, y], origin_of(radius[:, y]), spacing[2], spacing[0]),
        (values[:, :, x], origin_of(radius[:, :, x]), spacing[2], spacing[1]),
    ]
    return _drawn(planes, values.dtype, overlay), float(spacing.min())


def _projections(volume: Volume) -> tuple[list[np.ndarray], float]:
    """The largest value along each axis, as `_planes` has slices."""
    values, known = volume.values, volume.radius != FAR
    if values.dtype.kind == "u":  # empty voxels are 0
        shown = [values.max(axis=axis) for axis in range(3)]
    else:
        lowest = np.where(known, values, -np.inf)
        shown = [lowest.max(axis=axis) for axis in range(3)]
    spacing = np.linalg.norm(volume.world_from_voxel[:3, :3], axis=0)
    steps = ((spacing[1], spacing[0]), (spacing[2], spacing[0]), (spacing[2], spacing[1]))
    planes = []
    for axis, (plane, step) in enumerate(zip(shown, steps, strict=True)):
        seen = known.any(axis=axis)
        origin = np.where(seen, np.uint8(MEASURED), np.uint8(EMPTY))
        planes.append((np.where(seen, plane, 0), origin, *step))
    return _drawn(planes, values.dtype, True), float(spacing.min())


def _drawn(planes: list[tuple[Any, ...]], dtype: Any, overlay: bool) -> list[np.ndarray]:
    """Pictures of planes: values, origin, and mm down and to the right."""
    finest = min(min(down, right) for *_, down, right in planes)
    shown = [plane for plane, *_ in planes]
    measured = np.concatenate([plane[origin > 0] for plane, origin, *_ in planes])
    low, high = (0.0, 1.0) if measured.size == 0 else (
        min(0.0, float(measured.min())), float(np.percentile(measured, 99.9)))  # fmt: skip
    if dtype == np.uint8:
        low, high = 0.0, max(high, 1.0)
    pictures = []
    for plane, (_, origin, down, right) in zip(shown, planes, strict=True):
        gray = np.clip((plane - low) / max(high - low, 1e-12), 0, 1)
        color = tinted(255 * gray, origin if overlay else None)
        pictures.append(_square(color, down, right, finest))
    return pictures


def tinted(gray: np.ndarray, origin: np.ndarray | None) -> np.ndarray:
    """An image (H, W, 3) uint8 of gray values (H, W), 0 to 255: filled pixels orange, extrapolated
    ones purple and empty ones blue.

    origin: (H, W), as in `Slice`; None: all stay gray.
    """
    color = np.repeat(gray[..., None], 3, axis=2)
    if origin is not None:
        color[origin == FILLED] = 0.6 * color[origin == FILLED] + (102, 51, 0)
        color[origin == EXTRAPOLATED] = 0.6 * color[origin == EXTRAPOLATED] + (102, 0, 90)
        color[origin == EMPTY] = (24, 40, 72)
    return color.astype(np.uint8)


def _middle(known: np.ndarray) -> np.ndarray:
    """The middle, x first, of the box around everything that is known, (Z, Y, X) bool."""
    middle = []
    for axis in (2, 1, 0):
        others = tuple(a for a in range(3) if a != axis)
        found = np.flatnonzero(known.any(axis=others))
        middle.append((found[0] + found[-1]) // 2 if len(found) else known.shape[axis] // 2)
    return np.array(middle)


def _square(color: np.ndarray, down: float, right: float, step: float) -> np.ndarray:
    """The picture with square pixels of `step` mm."""
    height, width = color.shape[:2]
    rows = np.arange(max(1, round(height * down / step))) * step / down
    columns = np.arange(max(1, round(width * right / step))) * step / right
    rows, columns = (np.minimum(a.astype(int), n - 1)
                     for a, n in ((rows, height), (columns, width)))  # fmt: skip
    return color[rows][:, columns]


def _beside(pictures: list[np.ndarray]) -> np.ndarray:
    height = max(picture.shape[0] for picture in pictures)
    width = sum(picture.shape[1] for picture in pictures) + 8 * (len(pictures) - 1)
    sheet = np.full((height, width, 3), 255, np.uint8)
    left = 0
    for picture in pictures:
        sheet[: picture.shape[0], left : left + picture.shape[1]] = picture
        left += picture.shape[1] + 8
    return sheet
