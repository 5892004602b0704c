"""The grid that a sweep is reconstructed on: where its voxels lie, whether they fit in memory."""

from __future__ import annotations

import logging
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from .._base.checks import positive

log = logging.getLogger("globule")
MAX_AXIS = 2**20
_MOST_TIMES = 1e5  # larger voxels than asked for: then it is not the voxels that need memory


@dataclass
class VoxelGrid:
    """Cubic voxels: `low` is the outer corner of voxel (0, 0, 0), mm, world; `size` is x, y, z."""

    low: np.ndarray
    spacing: float
    size: tuple[int, ...]

    @property
    def n_voxels(self) -> int:
        """How many voxels the box has."""
        return math.prod(self.size)

    @property
    def world_from_voxel(self) -> np.ndarray:
        """(4, 4): voxel index (x, y, z, 1) to its center, mm."""
        matrix = np.diag([self.spacing] * 3 + [1.0])
        matrix[:3, 3] = self.low + 0.5 * self.spacing
        return matrix

    def coarser(self, times: float) -> VoxelGrid:
        """The same box in voxels so many times larger."""
        size = tuple(max(1, math.ceil(n / times)) for n in self.size)
        return VoxelGrid(self.low, self.spacing * times, size)

    def poses(self, world_from_image: np.ndarray) -> np.ndarray:
        """(F, 9) int64: origin, column step, row step, in voxels with 32 fractional bits."""
        m = world_from_image[:, :3, :]
        origin = (m[:, :, 3] - self.low) / self.spacing
        voxels = np.concatenate([origin, m[:, :, 0] / self.spacing, m[:, :, 1] / self.spacing], axis=1)
        if not (np.abs(voxels) < 2.0**28).all():
            raise ValueError("sweep: a pose lies too far from the volume for this spacing")
        return np.ascontiguousarray(np.rint(voxels * 2.0**32), np.int64)


def bounds(
    world_from_image: np.ndarray, mask: np.ndarray | None, shape: tuple[int, int]
) -> tuple[np.ndarray, np.ndarray]:
    """Lowest and highest corner of the used pixels' centers over all frames, mm."""
    rows, columns = np.arange(shape[0]), np.arange(shape[1])
    if mask is not None:
        rows, columns = np.flatnonzero(mask.any(1)), np.flatnonzero(mask.any(0))
        if len(rows) == 0:
            raise ValueError("sweep: expected a mask with pixels in it, got none")
    corners = np.array([[x, y, 0, 1] for x in columns[[0, -1]] for y in rows[[0, -1]]], np.float64)
    places = np.einsum("fij,cj->fci", world_from_image[:, :3, :], corners).reshape(-1, 3)
    return places.min(0), places.max(0)


def areas(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Of the parallelograms between vectors (F, 3); a tenth of the time of numpy.cross for few."""
    (a, b, c), (d, e, f) = u.T, v.T
    return np.sqrt((b * f - c * e) ** 2 + (c * d - a * f) ** 2 + (a * e - b * d) ** 2)


def make_grid(
    low: np.ndarray, high: np.ndarray, spacing: float | None, size: Any, region: Any, anchor: np.ndarray | None = None
) -> VoxelGrid:
    """A grid over the box of all pixels, or over `region`.

    With `spacing`, voxels lie on the one lattice of a sweep: the center of a voxel lies at
    `anchor`, the lowest corner of the first frame's pixel centers (default: low). A region takes
    the voxels whose centers it holds. With `size`, the voxels divide the box, or the region,
    evenly.
    """
    if (spacing is None) == (size is None):
        raise ValueError("spacing, size: expected one of them, got " + ("both" if size is not None else "neither"))
    anchor = low if anchor is None else anchor
    if region is not None:
        low, high = _region(region)
    extent = high - low
    if size is not None:
        wanted = _sizes(size)
        # A little more than the extent, so that the last pixels lie inside.
        slack = 1.0 if region is not None else 1 + 1e-6
        spacing = float((extent * slack / wanted).max())
        if spacing <= 0:
            raise ValueError("size: all pixels lie at one place, give a spacing")
        n = wanted if np.ndim(size) else np.maximum(np.ceil(extent / spacing - 1e-9), 1)
        corner = low if region is not None else 0.5 * (low + high) - 0.5 * n * spacing
    else:
        spacing = positive("spacing", spacing)
        face = anchor - 0.5 * spacing
        if region is not None:
            first, last = (np.ceil((p - anchor) / spacing - 1e-6) for p in (low, high))
            n = np.maximum(last - first, 1)
        else:
            first, last = (on_lattice(p, face, spacing) for p in (low, high))
            n = last - first + 1
        corner = face + first * spacing
    if (n > MAX_AXIS).any():
        raise ValueError(f"spacing: expected at most {MAX_AXIS} voxels along an axis, got {int(n.max())}")
    return VoxelGrid(corner, spacing, tuple(int(v) for v in n))


def on_lattice(point: np.ndarray, face: np.ndarray, spacing: float) -> np.ndarray:
    """Which voxel (3,) of a lattice a point lies in, counted from the corner `face`."""
    return np.floor((point - face) / spacing + 1e-9)


def _region(region: Any) -> tuple[np.ndarray, np.ndarray]:
    box = np.asarray(region, np.float64)
    if box.shape != (2, 3) or not np.isfinite(box).all() or (box[0] >= box[1]).any():
        raise ValueError(f"region: expected two corners ((x, y, z), (x, y, z)), low and high, got {region!r}")
    return box[0], box[1]


def _sizes(size: Any) -> np.ndarray:
    n = np.asarray(size)
    if n.dtype.kind not in "iu" or n.shape not in ((), (3,)) or (n < 1).any():
        raise ValueError(f"size: expected voxels along the longest axis, or three numbers x, y, z, got {size!r}")
    return n.astype(np.float64)


def estimate_bytes(grid: VoxelGrid, poses: np.ndarray, shape: tuple[int, int], itemsize: int, method: str) -> int:
    """Memory that a reconstruction takes besides the frames, at most, bytes."""
    n, blocks = grid.n_voxels, math.prod(-(-s // 4) for s in grid.size)
    h, w = shape
    pixels = len(poses) * h * w
    dense = n * (itemsize + 1) + blocks * 24
    if method == "pvn":
        return dense + n * (17 + itemsize)
    points = pixels * (36 + itemsize) if method in ("vvn", "vvn-om") else 0
    if method == "frames" and len(poses):  # averaged images, if a voxel holds several pixels
        steps = np.linalg.norm(poses[0, 3:].reshape(2, 3), axis=1) / 2.0**32
        averaged = math.prod(int(v) for v in np.clip(np.floor(1 / np.sqrt(3) / steps + 1e-6), 1, 64))
        points = 4 * pixels // averaged if averaged > 1 else 0
    if method == "vvn":
        return dense + points + 8 * n
    # A frame's plane crosses at most about three blocks for each block that its face covers.
    steps = np.abs(poses[:, 3:].reshape(-1, 2, 3)).max(2) / 2.0**34 if len(poses) else np.zeros((0, 2))
    touched = 3 * ((steps[:, 0] * w + 2) * (steps[:, 1] * h + 2)).sum()
    return dense + points + int(min(blocks, touched, pixels)) * 64 * (16 + itemsize + 8)


def check_memory(needed: Callable[[float], int], available: int, grid: VoxelGrid) -> int:
    """Say what will be taken, bytes, and return it; refuse what does not fit, naming the spacing
    that would. `needed` are the bytes for voxels so many times larger."""
    x, y, z = grid.size
    taken = needed(1.0)
    if not available or taken <= available:
        log.info("%d x %d x %d voxels, up to %.0f MiB", x, y, z, taken / 2**20)
        return taken
    times = (taken / available) ** (1 / 3)
    while needed(times) > 0.95 * available and times < _MOST_TIMES:
        times *= 1.05
    advice = f"{grid.spacing * times * 1.005:.3g} mm would fit"
    if times >= _MOST_TIMES:
        advice = "no spacing would fit, take fewer frames"
    raise MemoryError(
        f"spacing: {x} x {y} x {z} voxels at {grid.spacing:.4g} mm "
        f"need up to {taken / 2**30:.1f} GiB, {available / 2**30:.1f} GiB are free; {advice}"
    )
