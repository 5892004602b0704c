"""A volume that grows while frames come in, and can be read at any time."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from .. import _core
from .._base.arrays import to_host
from .._base.checks import thread_count
from .._base.device import choose
from .._base.interrupts import whole
from .._base.memory import free_bytes as free_host_bytes
from .._base.owner import Owner
from ..volumes.volume import Volume
from .grid import MAX_AXIS, VoxelGrid, bounds, check_memory, estimate_bytes, make_grid, on_lattice
from .options import Options
from .reconstruct import (
    FrameMaps,
    check_frames,
    check_mask,
    check_poses,
    located_frames,
    read_kept,
    start,
    update,
    value_scale,
)

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

_BLOCK = 4  # voxels; the grid grows by whole blocks
_TILE = 16  # blocks of x; along x the grid grows by whole tiles


class _Added(NamedTuple):
    """Frames of one call to `add`, the box of their pixels, and the volume's before them, mm."""

    frames: np.ndarray
    world_from_image: np.ndarray
    low: np.ndarray
    high: np.ndarray
    before: tuple[np.ndarray, np.ndarray] | None


class Reconstructor(Owner):
    """Bins frames as they arrive (PVN-OM). The volume equals the volume of all frames at once.

    Voxels lie on a lattice fixed by the first frame, or by `region`; without a region the volume
    grows with the frames. One thread may add frames while others read the volume.

    Args:
        spacing: edge of a voxel, mm.
        mask: (H, W) bool: pixels to use; default: all.
        history: number of frames that the reconstructor keeps for `undo` of a mean; None keeps all
            frames, like other compoundings. The volume has the maps of count, variance and latest
            frame while the reconstructor keeps all its frames.
        max_kernel, compounding (not median), hole_weights, max_distance, region, device, threads,
        extrapolate: as for `globule.ultrasound.reconstruct`.
    """

    def __init__(
        self,
        spacing: float,
        max_kernel: int = 9,
        compounding: str = "mean",
        hole_weights: str = "normalized",
        max_distance: float | None = None,
        region: ArrayLike | None = None,
        mask: ArrayLike | None = None,
        history: int | None = 64,
        device: str = "auto",
        threads: int = 0,
        space: str = "LPS",
        extrapolate: bool = False,
    ):
        self._options = Options("pvn-om", max_kernel, compounding, hole_weights, max_distance, extrapolate)
        if compounding == "median":
            raise ValueError("compounding: a median needs all frames at once, use globule.ultrasound.reconstruct")
        self._lock = threading.RLock()
        self._region = region
        self._mask = mask
        self._history = history if compounding == "mean" else None
        self._space = space
        self._chosen, self._threads = choose(device), thread_count(threads)
        self._core = _core.SweepGrid(self._chosen.name, self._threads)
        self._grid: VoxelGrid | None = None
        self._face = np.zeros(3)  # a corner of the lattice of voxels
        self._first = np.zeros(3, int)  # the grid's first voxel on the lattice
        self._low, self._high = np.zeros(3), np.zeros(3)  # of the volume, once there are frames
        self._added: list[_Added] = []
        self._type: Any = None
        self._shape: tuple[int, int] = (0, 0)
        self._scale = 1.0
        self._order = 0
        self.n_frames = 0
        self.spacing = make_grid(np.zeros(3), np.zeros(3), spacing, None, None).spacing
        # Blocks around all pixels: what the grid grows by lies beyond the reach of what is in it.
        self._margin = -(-self._options.reach(self.spacing) // _BLOCK)

    def __repr__(self) -> str:
        with self._lock:
            if self._grid is None:
                what = "no frames yet"
            else:
                x, y, z = (round(n) for n in (self._high - self._low) / self.spacing)
                what = f"{self.n_frames} frames, {x} x {y} x {z} {self._type}"
        return f"Reconstructor({what}, {self.spacing:.4g} mm, {self._space}, {self._chosen.name})"

    @whole
    def add(self, frames: ArrayLike, poses: ArrayLike) -> None:
        """Add a frame, or several.

        Args:
            frames: (H, W) or (F, H, W), of the same type and size as the previous frames.
            poses: (4, 4) or (F, 4, 4) world_from_image, mm.
        """
        frames = to_host(frames)
        frames = np.asarray(check_frames(frames[None] if frames.ndim == 2 else frames))
        world_from_image = np.array(poses, np.float64)
        if world_from_image.ndim == 2:
            world_from_image = world_from_image[None]
        check_poses(world_from_image)
        if len(world_from_image) != len(frames):
            raise ValueError(f"poses: expected {len(frames)}, one a frame, got {len(world_from_image)}")
        if self._type is None:
            self._begin(frames)
        self._check_alike(frames)
        box = bounds(world_from_image, self._used, self._shape)
        before = None if self._grid is None else (self._low, self._high)
        added = _Added(frames.copy(), world_from_image, *box, before)
        self._make_room(added)
        self._bin(added, 1)
        self._added.append(added)
        self.n_frames += len(frames)
        self._forget()

    @whole
    def undo(self) -> None:
        """Remove the frames of the last call to `add`."""
        if not self._added:
            raise ValueError("undo: expected frames that are still remembered, got none")
        last = self._added.pop()
        self.n_frames -= len(last.frames)
        self._low, self._high = last.before or (self._low, self._high)
        if self._options.compounding == "mean":
            self._bin(last, -1)
            self._order -= last.frames.size
            return
        self._order = 0
        self._start()
        for added in self._added:
            self._bin(added, 1)

    @whole
    def remove(self, frame: ArrayLike, pose: ArrayLike, rest: ArrayLike) -> None:
        """Remove one frame from a mean, whenever it was added; rest: (F, 4, 4) poses of the frames that
        stay, which tell the volume's box. What came before can then not be undone."""
        if self._options.compounding != "mean" or self._grid is None:
            raise ValueError("remove: expected a mean of frames")
        frames, poses = np.asarray(check_frames(np.asarray(frame)[None])), np.array(pose, np.float64)[None]
        self._check_alike(frames)
        self._bin(_Added(frames, poses, self._low, self._high, None), -1)
        self._added, self.n_frames = [], self.n_frames - 1
        if self._region is None and len(np.asarray(rest)):
            box = _Added(frames, poses, *bounds(np.asarray(rest, np.float64), self._used, self._shape), None)
            self._low, self._high = (self._place(voxel) for voxel in self._lattice(box))

    def volume(self) -> Volume:
        """A copy of the volume of all frames so far. Later frames do not change the copy."""
        with self._lock:
            if self._grid is None:
                raise ValueError("volume: expected frames to be added first, got none")
            update(self._core, self._grid, self._options)
            first = np.rint((self._low - self._grid.low) / self.spacing).astype(int)
            size = np.rint((self._high - self._low) / self.spacing).astype(int)
            grid = VoxelGrid(self._low, self.spacing, tuple(int(v) for v in size))
            values, radius = read_kept(self._core, first.tolist(), grid.size, self._type)
            return Volume(
                values, grid.world_from_voxel, radius, self._space, self._core.facts(),
                self._maps(grid),
            )  # fmt: skip

    def _maps(self, grid: VoxelGrid) -> Callable[[str], np.ndarray] | None:
        """Maps of the frames as they are now, if all of them are kept."""
        added = tuple(self._added)
        if sum(len(a.frames) for a in added) < self.n_frames:
            return None

        def make(name: str) -> np.ndarray:
            frames = np.concatenate([a.frames for a in added])
            poses = grid.poses(np.concatenate([a.world_from_image for a in added]))
            index = np.arange(len(frames))
            return FrameMaps(self._chosen, self._threads, grid, frames, poses, self._used, index, self._options).make(
                name
            )

        return make

    def _begin(self, frames: np.ndarray) -> None:
        self._type, self._shape = frames.dtype, frames.shape[1:]
        self._used = check_mask(self._mask, self._shape)
        self._scale = value_scale(frames)

    def _check_alike(self, frames: np.ndarray) -> None:
        if frames.dtype != self._type or frames.shape[1:] != self._shape:
            h, w = self._shape
            raise ValueError(
                f"frames: expected {h} x {w} {self._type} as before, "
                f"got {frames.shape[1]} x {frames.shape[2]} {frames.dtype}"
            )
        if self._type == np.float32 and np.abs(frames).max(initial=0.0) * self._scale > 2.0**38:
            raise ValueError("frames: values are more than 256 times those of the first frames")
        if self._order + frames.size >= 2**32 and self._options.compounding in ("latest", "first"):
            raise ValueError("frames: expected fewer than 2^32 pixels in all")

    def _make_room(self, added: _Added) -> None:
        """Let the grid hold the frames' box; what is stored moves with it. Nothing changes if it
        cannot."""
        if self._grid is None:
            anchor, _ = bounds(added.world_from_image[:1], self._used, self._shape)
            self._face = anchor - 0.5 * self.spacing
            if self._region is not None:
                grid = make_grid(added.low, added.high, self.spacing, None, self._region, anchor)
                box = grid.low, grid.low + self.spacing * np.array(grid.size)
            else:
                low, high = self._lattice(added)
                margin = self._margin * _BLOCK
                self._first = low - margin
                n = -(-(high - self._first) // _BLOCK) * _BLOCK + margin
                grid = self._grid_of(self._first, n)
                box = self._place(low), self._place(high)
            self._reserve(grid, added)
            self._grid, (self._low, self._high) = grid, box
            self._start()
            return
        if self._region is not None:
            return
        low, high = self._lattice(added)
        now = (np.rint((p - self._face) / self.spacing) for p in (self._low, self._high))
        old_low, old_high = (v.astype(int) for v in now)
        low, high = np.minimum(old_low, low), np.maximum(old_high, high)
        size = np.array(self._grid.size)
        before = np.maximum(-((low - self._first) // _BLOCK) + self._margin, 0)
        after = -(-(high - self._first - size) // _BLOCK) + self._margin
        after = np.maximum(after, 0)
        if before.any() or after.any():
            # An eighth more than needed on each side that grows, so that few calls grow.
            slack = np.ceil(size / _BLOCK / 8)
            before = np.where(before > 0, before + slack, 0).astype(int)
            before[0] = -(-before[0] // _TILE) * _TILE
            after = np.where(after > 0, after + slack, 0).astype(int)
            first = self._first - before * _BLOCK
            grid = self._grid_of(first, size + _BLOCK * (before + after))
            self._reserve(grid, added)
            self._core.grow(grid.size, before.tolist())
            self._grid, self._first = grid, first
        self._low, self._high = self._place(low), self._place(high)

    def _place(self, voxel: np.ndarray) -> np.ndarray:
        """The lowest corner of a voxel of the lattice, mm."""
        return self._face + voxel * self.spacing

    def _grid_of(self, first: np.ndarray, n: np.ndarray) -> VoxelGrid:
        return VoxelGrid(self._place(first), self.spacing, tuple(int(v) for v in n))

    def _lattice(self, added: _Added) -> tuple[np.ndarray, np.ndarray]:
        """The frames' first voxels on the lattice, and the voxels past their last."""
        low, high = (on_lattice(p, self._face, self.spacing).astype(int) for p in (added.low, added.high))
        return low, high + 1

    def _reserve(self, grid: VoxelGrid, added: _Added) -> None:
        if max(grid.size) > MAX_AXIS:
            raise ValueError(f"poses: expected at most {MAX_AXIS} voxels along an axis, got {max(grid.size)}")
        shape, itemsize = self._shape, self._type.itemsize
        poses = grid.poses(added.world_from_image)
        check_memory(
            lambda times: estimate_bytes(grid.coarser(times), poses / times, shape, itemsize, "pvn-om"),
            self._core.free_bytes() or free_host_bytes(),
            grid,
        )

    def _start(self) -> None:
        assert self._grid is not None
        start(self._core, self._grid, np.empty(0, self._type), self._options, wide=True, scale=self._scale)

    def _bin(self, added: _Added, sign: int) -> None:
        assert self._grid is not None
        poses = self._grid.poses(added.world_from_image)
        self._core.add(located_frames(added.frames, poses, self._used, order=self._order % 2**32), sign)
        if sign > 0:
            self._order += added.frames.size

    def _forget(self) -> None:
        """Drop frames beyond the history."""
        if self._history is None:
            return
        kept = sum(len(a.frames) for a in self._added)
        while kept - len(self._added[0].frames) >= self._history:
            kept -= len(self._added.pop(0).frames)
