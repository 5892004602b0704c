"""Reconstruction exactly as the PLUS toolkit (IGSIO) does it, voxel for voxel.

A configuration that PLUS reads gives the volume that one thread of PLUS writes: its 14-bit fixed
point (Optimization FULL), its truncating running mean, its hole fillers. Use it to compare with
PLUS; `globule.ultrasound.reconstruct` is better and faster.
Lasso et al., PLUS, IEEE Trans. Biomed. Eng. 61 (2014); source: github.com/IGSIO/IGSIO.
"""

from __future__ import annotations

import math
import os
from typing import TYPE_CHECKING, Any

import numpy as np

from ... import _core
from ..._base.arrays import located
from ..._base.checks import thread_count
from ..._base.device import choose
from ..._base.memory import free_bytes as free_host_bytes
from ...volumes.volume import Volume
from ..grid import VoxelGrid, check_memory
from ..region import read_mask
from .config import COMPOUNDINGS, FILLERS, INTERPOLATIONS, OPTIMIZATIONS, PlusConfig, read_plus_config
from .fan import detect_fan
from .region import pixel_sources

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from ..sweep import Sweep

_TYPES = {np.dtype(np.uint8): 0, np.dtype(np.uint16): 1, np.dtype(np.float32): 2}
MOST_VOXELS = 1e9  # along an axis


def reconstruct_plus(
    sweep: Sweep,
    config: PlusConfig | str | os.PathLike[str],
    importance_mask: ArrayLike | None = None,
    device: str = "auto",
    threads: int = 0,
    extent: str = "round",
) -> Volume:
    """Reconstruct a sweep as PLUS does.

    Args:
        sweep: `Sweep`, whose world is the configuration's reference frame.
        config: path of a PLUS XML, or a result of `read_plus_config`.
        importance_mask: (H, W) uint8, row 0 at the top; default: the configuration's file.
        device, threads: as for `globule.Scene`; neither changes a voxel.
        extent: rounding of the voxels per axis: "round", or "floor" as in older versions of PLUS.

    Returns:
        Volume of the frames' type; `measured` are voxels with a non-zero accumulator, which is
        `info["accumulator"]`, (Z, Y, X) uint16.

    Raises FormatError for a configuration that cannot be read, TypeError and ValueError naming the
    argument, MemoryError for a volume that does not fit.
    """
    if not isinstance(config, PlusConfig):
        config = read_plus_config(config)
    if extent not in ("round", "floor"):
        raise ValueError(f"extent: expected round or floor, got {extent!r}")
    frames = np.asarray(sweep.frames)
    h, w = frames.shape[1:]
    if frames.dtype not in _TYPES:
        raise TypeError(f"sweep: expected frames uint8, uint16 or float32, got {frames.dtype}")
    valid = np.flatnonzero(sweep.valid)
    if len(valid) == 0:
        raise ValueError("sweep: expected at least one valid frame, got none")
    poses = [sweep.world_from_image[f].tolist() for f in valid]
    origin, spacing, size = _box(config, poses, (h, w), extent)
    mask = _importance(config, importance_mask, (h, w))
    chosen = choose(device)
    core = _core.SweepGrid(chosen.name, thread_count(threads))
    grid = VoxelGrid(np.array(origin), min(spacing), tuple(size))
    bytes_each = 2 * (2 * frames.itemsize + 3)  # values, filled, accumulator, origin; here and there
    needed = check_memory(
        lambda times: grid.coarser(times).n_voxels * bytes_each, core.free_bytes() or free_host_bytes(), grid
    )

    kept = [f for f in range(0, len(frames), config.skip) if sweep.valid[f]]
    found = [detect_fan(config, frames[f]) if config.detect_fan else config.fan_angles for f in kept]
    kept = [f for f, a in zip(kept, found, strict=True) if a is not None]
    angles = [a for a in found if a is not None]
    distinct = sorted(set(angles)) or [config.fan_angles]
    sources = np.stack([pixel_sources(config, (h, w), a, mask) for a in distinct])
    mask_of_frame = np.array([distinct.index(a) for a in angles], np.uint32)
    matrices = _voxel_from_image([sweep.world_from_image[f].tolist() for f in kept], origin, spacing)

    if not np.isfinite(matrices).all():
        raise ValueError("poses: expected places that float64 holds in voxels, got others")
    picked = np.ascontiguousarray(frames if len(kept) == len(frames) else frames[kept])
    values = np.empty(size[::-1], frames.dtype)
    accumulator = np.empty(size[::-1], np.uint16)
    radius = np.empty(size[::-1], np.uint8)
    seconds = core.plus(
        {
            "frames": located(picked),
            "type": _TYPES[frames.dtype],
            "shape": picked.shape,
            "voxel_from_image": matrices,
            "sources": sources,
            "source_of_frame": mask_of_frame,
            "importance": mask,
            "size": list(size),
            "interpolation": INTERPOLATIONS.index(config.interpolation),
            "optimization": OPTIMIZATIONS.index(config.optimization),
            "compounding": COMPOUNDINGS.index(config.compounding),
            "rejection": config.rejection,
            "fill_holes": config.fill_holes,
            "fillers": [
                (FILLERS.index(f.type), f.size, f.n_sticks, f.least_ratio, f.weights().ravel().tolist())
                for f in config.fillers
            ],
            "values": values,
            "accumulator": accumulator,
            "origin": radius,
        }
    )
    world_from_voxel = np.diag([*spacing, 1.0])
    world_from_voxel[:3, 3] = origin
    info = {
        "insert_seconds": seconds[0],
        "fill_seconds": seconds[1],
        "estimated_bytes": needed,
        "frames": len(kept),
        "accumulator": accumulator,
    }
    return Volume(values, world_from_voxel, radius, getattr(sweep, "space", "LPS"), info)


def _box(config: PlusConfig, poses: list, shape: tuple[int, int], extent: str) -> tuple:
    """Origin and spacing, mm, and voxels along x, y, z: corners of clip and image, all frames."""
    x0, x1, y0, y1 = 0, shape[1] - 1, 0, shape[0] - 1
    if min(config.clip_size) > 0:
        (cx, cy), (dx, dy) = config.clip_origin, config.clip_size
        x0, x1, y0, y1 = max(x0, cx), min(x1, cx + dx), max(y0, cy), min(y1, cy + dy)
    places = [
        [m[k][0] * x + m[k][1] * y + m[k][3] for k in range(3)] for m in poses for x in (x0, x1) for y in (y0, y1)
    ]
    lo, hi = np.min(places, axis=0).tolist(), np.max(places, axis=0).tolist()
    spacing = list(config.spacing)
    if config.recompute_spacing and spacing[2] <= hi[2] - lo[2] < MOST_VOXELS * spacing[2]:
        spacing[2] = (hi[2] - lo[2]) / math.floor((hi[2] - lo[2]) / spacing[2])
    steps = [(b - a) / s for a, b, s in zip(lo, hi, spacing, strict=True)]
    if not all(0 <= s < MOST_VOXELS for s in steps):  # NaN, too
        lengths = " ".join(f"{b - a:g}" for a, b in zip(lo, hi, strict=True))
        raise ValueError(f"OutputSpacing: expected one that divides {lengths} mm, got {spacing}")
    size = [math.floor(s + 0.5 if extent == "round" else s) + 1 for s in steps]
    return lo, spacing, size


def _importance(config: PlusConfig, mask: Any, shape: tuple[int, int]) -> np.ndarray | None:
    if config.compounding != "IMPORTANCE_MASK":
        return None
    if mask is None:
        if config.importance_file is None:
            raise ValueError("importance_mask: CompoundingMode is IMPORTANCE_MASK, expected a mask, got none")
        mask = read_mask(config.importance_file)
    mask = np.ascontiguousarray(mask, np.uint8)
    if mask.shape != shape:
        raise ValueError(f"importance_mask: expected shape {shape} as the frames, got {mask.shape}")
    return mask


# Matrices as VTK computes them, so that even the last bits agree.


def _voxel_from_image(poses: list, origin: list, spacing: list) -> np.ndarray:
    """(F, 3, 4) float64, voxels per pixel."""
    world_from_voxel = [
        [spacing[0], 0.0, 0.0, origin[0]],
        [0.0, spacing[1], 0.0, origin[1]],
        [0.0, 0.0, spacing[2], origin[2]],
        [0.0, 0.0, 0.0, 1.0],
    ]
    inverse = _inverse(world_from_voxel)
    return np.array([_product(inverse, pose)[:3] for pose in poses], np.float64).reshape(-1, 3, 4)


def _product(a: list, b: list) -> list:
    return [
        [a[i][0] * b[0][k] + a[i][1] * b[1][k] + a[i][2] * b[2][k] + a[i][3] * b[3][k] for k in range(4)]
        for i in range(4)
    ]


def _minor(m: list, row: int, column: int) -> float:
    (a1, b1, c1), (a2, b2, c2), (a3, b3, c3) = (
        [m[i][k] for k in range(4) if k != column] for i in range(4) if i != row
    )
    return a1 * (b2 * c3 - b3 * c2) - b1 * (a2 * c3 - a3 * c2) + c1 * (a2 * b3 - a3 * b2)


def _inverse(m: list) -> list:
    """Adjugate over determinant."""
    determinant = sum((-1) ** k * m[0][k] * _minor(m, 0, k) for k in range(4))
    return [[(-1) ** (i + k) * _minor(m, k, i) / determinant for k in range(4)] for i in range(4)]
