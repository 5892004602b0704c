"""The float64 reference for volumes from sweeps, by brute force; for small sweeps only."""

from typing import Any

import numpy as np
from globule.ultrasound.grid import VoxelGrid
from globule.ultrasound.neighbors import FramePath, interpolate
from globule.ultrasound.options import COMPOUNDINGS, HOLE_WEIGHTS
from globule.ultrasound.reconstruct import check_mask
from globule.volumes.volume import BEYOND, FAR
from oracle.library import call


def reconstruct(
    sweep: Any,
    grid: VoxelGrid,
    method: str = "pvn-om",
    max_kernel: int = 9,
    compounding: str = "mean",
    hole_weights: str = "normalized",
    extrapolate: bool = False,
    max_distance: float | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Values (Z, Y, X) float64, rounded where the frames are integers, and kernel radii (Z, Y, X)
    uint8, as `Volume` has them. Arguments as for `globule.ultrasound.reconstruct`; max_distance for
    method
    frames only."""
    valid = np.flatnonzero(sweep.valid)
    frames = np.ascontiguousarray(sweep.frames[valid], np.float64)
    poses = grid.poses(np.asarray(sweep.world_from_image, np.float64)[valid])
    mask = check_mask(getattr(sweep, "mask", None), frames.shape[1:])
    whole, values = sweep.frames.dtype.kind == "u", np.empty(grid.size[::-1])
    radius, reach = np.empty(grid.size[::-1], np.uint8), (max_kernel - 1) // 2
    distance = np.zeros(grid.size[::-1])
    sizes = np.array(frames.shape, np.int32), np.array(grid.size, np.int32)
    call(
        "oracle_sweep", {"bezier": 1, "vvn": 2, "vvn-om": 2}.get(method, 0), frames, poses, mask, *sizes, whole,
        COMPOUNDINGS.index(compounding), 0 if method == "frames" else reach, HOLE_WEIGHTS.index(hole_weights) == 1,
        values, radius, distance,
    )  # fmt: skip
    if method == "frames":
        gap = None if max_distance is None else 2 * max_distance / grid.spacing
        return _between_frames(FramePath(frames, poses / 2.0**32, mask, gap), values, radius, whole)
    _keep_between(values, radius, reach, extrapolate)
    if method == "bezier":
        curve = (radius == 0) & (distance > 0)
        radius[curve] = np.clip(np.ceil(distance[curve]), 1, BEYOND - 2)
    return values, radius


def _between_frames(
    path: FramePath, values: np.ndarray, radius: np.ndarray, whole: bool
) -> tuple[np.ndarray, np.ndarray]:
    """Values between frames over those of bins, and the radii of both."""
    z, y, x = np.indices(values.shape)
    centers = np.stack([x, y, z], axis=-1).reshape(-1, 3) + 0.5
    found, weights, nearest = (a.reshape(values.shape) for a in interpolate(path, centers))
    known = weights > 0
    values[known] = np.floor(found[known] + 0.5) if whole else found[known]
    filled = known & (radius != 0)
    radius[filled] = np.minimum(nearest[filled].astype(int) + 1, BEYOND - 2)
    return values, radius


def _keep_between(values: np.ndarray, radius: np.ndarray, reach: int, extrapolate: bool) -> None:
    """Empty or label filled voxels without measured ones on both sides, on any of 13 lines."""
    measured, size = np.pad(radius == 0, max(reach, 1)), radius.shape
    between = np.zeros(size, bool)

    def shifted(step: np.ndarray) -> np.ndarray:
        first = step + max(reach, 1)
        return measured[tuple(slice(a, a + n) for a, n in zip(first, size, strict=True))]

    for line in list(np.ndindex(3, 3, 3))[14:]:
        step, sides = np.array(line) - 1, [np.zeros(size, bool), np.zeros(size, bool)]
        for distance in range(1, reach + 1):
            for side, sign in zip(sides, (1, -1), strict=True):
                side |= shifted(sign * distance * step)
        between |= sides[0] & sides[1]
    beyond = (radius > 0) & (radius != FAR) & ~between
    if extrapolate:
        radius[beyond] += BEYOND
    else:
        radius[beyond] = FAR
        values[beyond] = 0
