"""From a tracked sweep to a volume: between frames, pixel-based, voxel-based and Bezier methods."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from .. import _core
from .._base.arrays import DeviceArray, located
from .._base.checks import thread_count
from .._base.device import choose
from .._base.memory import free_bytes as free_host_bytes
from ..volumes.volume import Volume
from .grid import VoxelGrid, areas, bounds, check_memory, estimate_bytes, make_grid
from .lattice import lattice_frame
from .neighbors import FramePath, PathError, path_error
from .options import COMPOUNDINGS, HOLE_WEIGHTS, Options

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from .sweep import Sweep

_TYPES = {np.dtype(np.uint8): 0, np.dtype(np.uint16): 1, np.dtype(np.float32): 2}
_FILL = {"pvn-om": 0, "bezier": 0, "vvn-om": 1, "pvn": 2, "vvn": 3, "frames": 4}
_PIECES = 32  # in which frames are binned where progress is reported
_LARGEST_TABLE = 31  # radius up to which hole weights come from a table


def reconstruct(
    sweep: Sweep,
    method: str | None = None,
    spacing: ArrayLike | None = None,
    size: ArrayLike | None = None,
    max_kernel: int = 9,
    compounding: str = "mean",
    hole_weights: str = "normalized",
    region: ArrayLike | None = None,
    max_distance: float | None = None,
    device: str = "auto",
    threads: int = 0,
    progress: Callable[[int, int], None] | None = None,
    extrapolate: bool = False,
    axes: ArrayLike | str = "world",
) -> Volume:
    """Reconstruct a volume from all valid frames of a sweep.

    Args:
        sweep: `Sweep`: frames (F, H, W) uint8, uint16 or float32, and their poses, mm. If the
            frames lie on the GPU that reconstructs, the volume stays there, too, until the program
            reads its values.
        method: "frames" interpolates between neighboring frames along the probe's path, as below;
            "pvn-om" bins pixels into voxels and fills holes from a growing kernel; "vvn-om"
            averages, for every voxel, the pixels in a growing sphere; "pvn" and "vvn" give the same
            volumes without an octree, for comparison; "bezier" lays curves through pixels of four
            frames. Default: "frames"; with another compounding than the mean, "pvn-om".
        spacing: edge of a voxel, mm, or its three edges x, y, z. Or
        size: voxels along the longest axis, or three numbers x, y, z.
        max_kernel: edge of the largest kernel, odd, voxels; 1 leaves all holes. Not for "frames".
        compounding: how the pixels of a voxel combine (pvn-om): mean, maximum, latest, first,
            median.
        hole_weights: "normalized", or "printed": the formula (4.3) as printed in the thesis, which
            is too dark.
        region: ((x, y, z), (x, y, z)) lowest and highest corner, mm, world; default: all pixels.
            With `spacing`, the volume has the voxels whose centers lie in the region: voxels lie on
            one lattice, with a center at the lowest corner of the first frame's pixel centers.
        max_distance: holes farther than this along an axis from any pixel stay empty, mm. "frames"
            leaves the space between two frames empty whose corners are more than twice this apart,
            by default more than five times the usual step of the sweep.
        device: "auto", "cpu", "cuda" or "cuda:N". threads: of the CPU; 0 takes all.
        progress: called as progress(done, total) in frames, while they are binned, and at the end.
        extrapolate: also fill holes that do not lie between data; the volume labels them.
        axes: of the volume: "world"; "sweep", along the sweep, which needs fewer voxels; or (3, 3)
            with the directions of x, y, z as columns. With three edges, kernels are as many voxels
            wide along each axis, and `max_distance` counts in the shortest edge.

    A voxel between two consecutive frames, at the distances a and b from their planes, takes
    (b I0(u, v) + a I1(u, v)) / (a + b) with "frames". The images are bilinear, and
    averaged over s / sqrt(3) pixels before, s the pixels of a voxel along an axis. The column u and
    the row v move linearly from the voxel's projection onto one plane to the other (after Coupe et
    al., MICCAI 2005). If several passes of the probe enclose a voxel, their values are averaged
    with weights 1 / (a b / (a + b) + 1), lengths in voxels. Voxels with pixels but not between
    frames take the mean of their pixels. A frame without a pose is skipped; its neighbors become
    consecutive.

    Returns:
        Volume of the frames' type. Values are rounded to the nearest; every device and any number
        of threads gives the same bits. With "frames", `volume.uncertainty` is the expected error of
        each voxel, and `volume.info["left_out_rms"]` the error of up to 12 frames, each predicted
        from its neighbors, gray levels.

    Raises:
        MemoryError: the volume cannot fit; the message names a spacing that fits.
    """
    if method is None:
        method = "frames" if compounding == "mean" else "pvn-om"
    options = Options(method, max_kernel, compounding, hole_weights, max_distance, extrapolate)
    chosen = choose(device)
    frames = sweep.frames
    if isinstance(frames, DeviceArray) and chosen.name == "cpu":
        frames = np.asarray(frames)
    frames = check_frames(frames)
    valid = np.flatnonzero(sweep.valid)
    if len(valid) == 0:
        raise ValueError("sweep: expected at least one valid frame, got none")
    world_from_image = np.asarray(sweep.world_from_image, np.float64)[valid]
    check_poses(world_from_image)
    frame, spacing = lattice_frame(sweep, axes, spacing, region)
    if frame is not None:
        world_from_image = np.linalg.solve(frame, world_from_image)
    if len(valid) < len(frames):
        frames = np.ascontiguousarray(frames[valid])  # also of device frames: on the host from here
    mask = check_mask(getattr(sweep, "mask", None), frames.shape[1:])
    low, high = bounds(world_from_image, mask, frames.shape[1:])
    anchor, _ = bounds(world_from_image[:1], mask, frames.shape[1:])
    grid = make_grid(low, high, spacing, size, region, anchor)
    if (grid.low > high).any() or (grid.low + grid.spacing * np.array(grid.size) < low).any():
        corners = (", ".join(f"{v:.6g}" for v in corner) for corner in (low, high))
        box = " to ".join(f"({corner})" for corner in corners)
        raise ValueError(f"region: expected a box that meets the frames', {box} mm, got {region!r}")
    poses = grid.poses(world_from_image)

    core = _core.SweepGrid(chosen.name, thread_count(threads))
    needed = check_memory(
        lambda times: estimate_bytes(
            grid.coarser(times), poses / times, frames.shape[1:], frames.itemsize, options.method
        ),
        core.free_bytes() or free_host_bytes(),
        grid,
    )
    whole = located_frames(frames, poses, mask)
    start(core, grid, frames, options, crowded(poses, frames.shape[1:]))
    if options.method == "bezier":
        core.bezier(whole)
    elif options.method in ("frames", "pvn-om"):
        if options.compounding == "median":
            core.median(whole)
        else:
            _add(core, frames, poses, mask, progress)
    values: Any
    radius: Any
    if isinstance(frames, DeviceArray):
        values, radius = filled_on_device(core, grid, frames.dtype, options, whole, chosen.index)
    else:
        values, radius = fill(core, grid, frames.dtype, options, whole)
    info = {**core.facts(), "estimated_bytes": needed, "device": chosen.name, "method": options.method}
    source = FrameMaps(chosen, threads, grid, frames, poses, mask, valid, options)
    if options.method == "frames":
        error = source.error()
        if error is not None:
            info["left_out_rms"] = error.rms
    if progress:
        progress(len(frames), len(frames))
    place = grid.world_from_voxel if frame is None else frame @ grid.world_from_voxel
    return Volume(values, place, radius, getattr(sweep, "space", "LPS"), info, source.make)


def located_frames(
    frames: np.ndarray | DeviceArray, poses: np.ndarray, mask: np.ndarray | None, first: int = 0,
    n: int | None = None, order: int = 0,
) -> _core.SweepFrames:  # fmt: skip
    """Where `n` frames from `first` on and what belongs to them are, for a grid; the frames must stay alive.
    order: of the first one's first pixel."""
    last = len(frames) if n is None else first + n
    _, h, w = frames.shape
    address, device, stream = located(frames)
    at = (address + first * h * w * frames.itemsize, device, stream)
    return _core.SweepFrames(at, _TYPES[frames.dtype], (last - first, h, w), poses[first:last], mask, order)


def _add(
    core: Any, frames: np.ndarray | DeviceArray, poses: np.ndarray, mask: np.ndarray | None,
    progress: Callable[[int, int], None] | None,
) -> None:  # fmt: skip
    """Bin all frames, in pieces if somebody wants to hear of them; the bits are the same."""
    n, h, w = frames.shape
    step = n if progress is None else -(-n // _PIECES)
    for first in range(0, n, step):
        part = min(step, n - first)
        core.add(located_frames(frames, poses, mask, first, part, first * h * w), 1)
        if progress and first + part < n:  # the last ones count when holes are filled
            progress(first + part, n)


def start(
    core: Any, grid: VoxelGrid, frames: np.ndarray, options: Options, wide: bool = True, scale: float | None = None
) -> None:
    """An empty grid in `core`; not `wide`: no voxel may hold 2^24 pixels or more."""
    compounding = COMPOUNDINGS.index(options.compounding)
    wide = wide or frames.dtype == np.float32 or options.method == "bezier"
    if scale is None:
        scale = value_scale(frames, options.method)
    core.start(_TYPES[frames.dtype], compounding, wide, scale, grid.size)


def crowded(poses: np.ndarray, shape: tuple[int, int]) -> bool:
    """Whether a voxel may hold 2^24 pixels or more. A plane meets it in a disc of diameter sqrt 3
    at most; rows and columns of pixels fit into that as their distances allow."""
    x, y = (poses[:, k : k + 3] / 2.0**32 for k in (3, 6))
    column = np.linalg.norm(x, axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        row = areas(x, y) / column
        bound = (np.sqrt(3) / column + 1) * (np.sqrt(3) / row + 1)
    most = np.where(np.isfinite(bound), np.minimum(bound, math.prod(shape)), math.prod(shape))
    return bool(most.sum() >= 2**24)


def value_scale(frames: np.ndarray, method: str = "pvn-om") -> float:
    """What values are multiplied with before they are summed as integers."""
    if frames.dtype != np.float32:
        return 65536.0 if method == "bezier" else 1.0
    largest = float(np.abs(frames).max(initial=0.0))
    return 2.0 ** (30 - math.frexp(largest)[1]) if largest > 0 else 1.0


def fill(
    core: Any, grid: VoxelGrid, dtype: Any, options: Options, whole: Any, last: tuple | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Dense values and kernel radii (Z, Y, X), in the arrays `last` of a call before if given."""
    values, radius = last if last is not None else empty_volume(grid.size, dtype)
    _fill(core, grid, options, whole, values, radius)
    return values, radius


def update(core: Any, grid: VoxelGrid, options: Options) -> None:
    """Fill the volume that `core` keeps, where binned frames have changed it."""
    _fill(core, grid, options, None)


def read_kept(core: Any, first: Sequence[int], size: Sequence[int], dtype: Any) -> tuple[np.ndarray, np.ndarray]:
    """Values and radii of a box of the volume that `core` keeps; voxels x, y, z."""
    values, radius = empty_volume(size, dtype)
    core.read_filled(first, size, values, radius)
    return values, radius


def filled_on_device(
    core: Any, grid: VoxelGrid, dtype: Any, options: Options, whole: Any, device: int
) -> tuple[DeviceArray, DeviceArray]:
    """The same, left in the GPU's memory."""
    _fill(core, grid, options, whole)
    arrays = []
    for k, (place, kind) in enumerate(zip(core.filled(), (dtype, np.uint8), strict=True)):

        def fetch(k: int = k, kind: Any = kind) -> np.ndarray:
            out = np.empty(grid.size[::-1], kind)
            core.read_filled((0, 0, 0), grid.size, *(out if k == i else None for i in (0, 1)))
            return out

        arrays.append(DeviceArray(place, grid.size[::-1], kind, core, fetch, device))
    return arrays[0], arrays[1]


def _fill(core: Any, grid: VoxelGrid, options: Options, whole: Any, *out: np.ndarray) -> None:
    """out: values, radius, spread, contrast; without, the grid keeps the volume."""
    reach = options.reach(grid.spacing)
    weights = hole_weight_table(reach) if reach <= _LARGEST_TABLE else None
    max_gap = options.max_gap(grid.spacing)
    core.fill(
        method=_FILL[options.method], frames=whole, reach=reach, weights=weights,
        kind=HOLE_WEIGHTS.index(options.hole_weights), extrapolate=options.extrapolate,
        max_gap=-1.0 if max_gap is None else max_gap,
        **dict(zip(("values", "radius", "spread", "contrast"), out, strict=False)),
    )  # fmt: skip


def empty_volume(size: Sequence[int], dtype: Any) -> tuple[np.ndarray, np.ndarray]:
    """Room for dense values and kernel radii (Z, Y, X) of so many voxels x, y, z."""
    return np.empty(size[::-1], dtype), np.empty(size[::-1], np.uint8)


@functools.lru_cache(maxsize=8)
def hole_weight_table(reach: int) -> np.ndarray:
    """exp(-d2 / sigma2) as integers of 24 bits: [sigma2, d2], both up to 3 reach^2, voxels^2."""
    n = 3 * reach * reach + 1
    d2 = np.arange(n, dtype=np.float64)
    return np.rint(np.exp(-d2[None, :] / np.maximum(d2, 1)[:, None]) * 2**24).astype(np.uint32)


class FrameMaps:
    """Maps of a volume, made from its frames when they are asked for."""

    def __init__(
        self,
        chosen: Any,
        threads: int,
        grid: VoxelGrid,
        frames: np.ndarray,
        poses: np.ndarray,
        mask: np.ndarray | None,
        index: np.ndarray,
        options: Options,
    ):
        self.chosen, self.threads, self.grid = chosen, threads, grid
        self.frames, self.poses, self.mask, self.index = frames, poses, mask, index
        self.options = options

    def error(self) -> PathError | None:
        """The error of the method on frames left out, if the frames lie on the host."""
        if isinstance(self.frames, DeviceArray):
            return None
        max_gap = self.options.max_gap(self.grid.spacing)
        return path_error(FramePath(self.frames, self.poses / 2.0**32, self.mask, max_gap))

    def uncertainty(self) -> np.ndarray:
        """Expected error of each voxel, (Z, Y, X) float32, gray levels; infinite where
        empty."""
        self.frames = np.asarray(self.frames)
        error = self.error() if self.options.method == "frames" else None
        if error is None:
            raise ValueError("uncertainty: expected a volume of method frames with three frames side by side")
        core = _core.SweepGrid(self.chosen.name, self.threads)
        whole = located_frames(self.frames, self.poses, self.mask)
        start(core, self.grid, self.frames, self.options, crowded(self.poses, self.frames.shape[1:]))
        core.add(whole, 1)
        values, radius = empty_volume(self.grid.size, self.frames.dtype)
        spread, contrast = (np.empty(radius.shape, np.float32) for _ in range(2))
        _fill(core, self.grid, self.options, whole, values, radius, spread, contrast)
        return error.at(spread, contrast)

    def make(self, name: str) -> np.ndarray:
        """ "count" uint32, "variance" float32, "source" int32 or "uncertainty" float32,
        (Z, Y, X)."""
        if name == "uncertainty":
            return self.uncertainty()
        core = _core.SweepGrid(self.chosen.name, self.threads)
        whole = located_frames(self.frames, self.poses, self.mask)
        kind = {"count": np.uint32, "variance": np.float32, "source": np.int32}[name]
        out = np.empty(self.grid.size[::-1], kind)
        if name == "source":
            start(core, self.grid, self.frames, Options(compounding="latest"))
            core.add(whole, 1)
            core.source_map(math.prod(self.frames.shape[1:]), out)
            return np.where(out >= 0, self.index[out].astype(np.int32), -1)
        scale = value_scale(self.frames)
        if self.frames.dtype == np.float32:
            scale /= 2.0**15  # so that squares fit
        core.start(_TYPES[self.frames.dtype], 0, True, scale, self.grid.size)
        core.add(whole, 1)
        if name == "count":
            core.count_map(out)
        else:
            core.variance_map(whole, out)
        return out


def check_frames(frames: Any) -> np.ndarray | DeviceArray:
    """Frames (F, H, W), C-contiguous. Raises TypeError, ValueError."""
    if not isinstance(frames, DeviceArray):
        frames = np.ascontiguousarray(frames)
    if frames.ndim != 3 or 0 in frames.shape:
        raise ValueError(f"frames: expected shape (F, H, W), got {frames.shape}")
    if frames.dtype not in _TYPES:
        raise TypeError(f"frames: expected uint8, uint16 or float32, got {frames.dtype}")
    if frames.size >= 2**32:
        raise ValueError(f"frames: expected fewer than 2^32 pixels in all, got {frames.size:,}")
    if frames.dtype == np.float32 and not np.isfinite(frames).all():
        raise ValueError("frames: expected finite values, got NaN or infinity")
    return frames


def check_poses(world_from_image: np.ndarray) -> None:
    """ValueError for poses that are no finite, regular affine maps."""
    if world_from_image.ndim != 3 or world_from_image.shape[1:] != (4, 4):
        raise ValueError(f"world_from_image: expected shape (F, 4, 4), got {world_from_image.shape}")
    if not np.isfinite(world_from_image).all():
        raise ValueError("world_from_image: expected finite numbers, got NaN or infinity")
    x, y = world_from_image[:, :3, 0], world_from_image[:, :3, 1]
    if not (areas(x, y) > 1e-12 * np.linalg.norm(x, axis=1) * np.linalg.norm(y, axis=1)).all():
        raise ValueError("world_from_image: expected axes that span a plane, got a singular calibration")


def check_mask(mask: Any, shape: tuple[int, int]) -> np.ndarray | None:
    """The mask as (H, W) uint8, or None. Raises ValueError for another shape."""
    if mask is None:
        return None
    mask = np.ascontiguousarray(np.asarray(mask) != 0, np.uint8)
    if mask.shape != shape:
        raise ValueError(f"mask: expected shape {shape} as the frames, got {mask.shape}")
    return mask
