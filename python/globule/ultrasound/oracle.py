"""The float64 reference for volumes from sweeps, by brute force; for small sweeps only."""

from __future__ import annotations

from typing import Any

import numpy as np

from .. import _core
from .._base.arrays import address
from .grid import VoxelGrid
from .reconstruct import COMPOUNDINGS, HOLE_WEIGHTS, check_mask


def reconstruct(
    sweep: Any,
    grid: VoxelGrid,
    method: str = "pvn-om",
    max_kernel: int = 9,
    compounding: str = "mean",
    hole_weights: str = "normalized",
) -> tuple[np.ndarray, np.ndarray]:
    """Values (Z, Y, X) float64, rounded where the frames are integers, and kernel radii (Z, Y, X)
    uint8: 0 measured, 255 empty. Arguments as for `globule.reconstruct`."""
    valid = np.flatnonzero(sweep.valid)
    frames = np.ascontiguousarray(sweep.frames[valid], np.float64)
    poses = grid.poses(np.asarray(sweep.world_from_image, np.float64)[valid])
    mask = check_mask(getattr(sweep, "mask", None), frames.shape[1:])
    whole = sweep.frames.dtype.kind == "u"
    values = np.empty(grid.size[::-1])
    radius = np.empty(grid.size[::-1], np.uint8)
    _core.oracle_sweep(
        method,
        address(frames),
        address(poses),
        0 if mask is None else address(mask),
        list(frames.shape),
        list(grid.size),
        whole,
        COMPOUNDINGS.index(compounding),
        (max_kernel - 1) // 2,
        HOLE_WEIGHTS.index(hole_weights) == 1,
        address(values),
        address(radius),
    )
    return values, radius
