"""Sweep: tracked 2D frames, each with its place in the world."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from .._base.arrays import DeviceArray, device_array, on_gpu
from .._base.checks import choice

DTYPES = ("uint8", "uint16", "float32")
SPACES = ("LPS", "RAS")
_FARTHEST = 1e9  # mm; farther poses count as missing


@dataclass(eq=False, repr=False)
class Sweep:
    """F tracked frames of H rows and W columns.

    frames             (F, H, W) uint8, uint16 or float32, C-contiguous; row 0 next to the probe.
                       uint8 and uint16 may lie on a GPU (CuPy, PyTorch …): `reconstruct` uses them
                       in place, all other functions copy them
    world_from_image   (F, 4, 4) float64, mm: pixel center (column, row, 0, 1) to the world
    timestamps         (F,) float64, s, or None if unknown
    valid              (F,) bool: frames whose image and pose count; default: frames with a finite
                       pose. A frame without a finite pose is never valid
    mask               (H, W) bool: pixels that show tissue, or None for all
    world              name of the world's frame, as "Reference" or "Tracker"
    space              meaning of the world's axes: "LPS" (x to the patient's left, y to the back,
                       z to the head; PLUS, DICOM and ITK) or "RAS". A sweep over a phantom has no
                       patient; files then state LPS
    metadata           other fields of the file, which the writer stores again
    """

    frames: Any
    world_from_image: Any
    timestamps: Any = None
    valid: Any = None
    mask: Any = None
    world: str = "Reference"
    space: str = "LPS"
    metadata: dict[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.frames = checked_frames(self.frames)
        n = len(self.frames)
        self.world_from_image, posed = _poses(self.world_from_image, n)
        if self.timestamps is not None:
            self.timestamps = _array("timestamps", self.timestamps, np.float64, (n,))
            if not np.isfinite(self.timestamps).all():
                i = int(np.argmin(np.isfinite(self.timestamps)))
                got = self.timestamps[i]
                raise ValueError(f"timestamps: expected finite numbers, got {got} (frame {i})")
        valid = np.ones(n, bool) if self.valid is None else self.valid
        self.valid = _array("valid", valid, bool, (n,)) & posed
        if self.mask is not None:
            self.mask = _array("mask", self.mask, bool, self.frames.shape[1:])
        choice("space", self.space, SPACES)

    def __len__(self) -> int:
        return len(self.frames)

    def __repr__(self) -> str:
        n, height, width = self.frames.shape
        spacing = "no spacing"
        if self.n_valid:
            spacing = " x ".join(f"{step:.4g}" for step in self.spacing) + " mm"
        return (
            f"Sweep({n} frames, {width} x {height} {self.frames.dtype}, {spacing}, "
            f"{self.n_valid} valid, {self.world}, {self.space})"
        )

    def __getitem__(self, index: Any) -> Sweep:
        """The frames selected by a slice, integer array or boolean mask, with their metadata."""
        picked = np.arange(len(self))[index]
        if picked.ndim != 1:
            picked = picked.reshape(-1)
        metadata = dict(self.metadata)
        if "frame_fields" in metadata:
            metadata["frame_fields"] = [metadata["frame_fields"][i] for i in picked]
        times = None if self.timestamps is None else self.timestamps[picked]
        return Sweep(
            self.frames[picked], self.world_from_image[picked], times, self.valid[picked],
            self.mask, self.world, self.space, metadata,
        )  # fmt: skip

    @property
    def n_valid(self) -> int:
        """Number of valid frames."""
        return int(self.valid.sum())

    @property
    def spacing(self) -> tuple[float, float]:
        """mm per pixel along a row and along a column, the median over the valid frames."""
        if not self.n_valid:
            raise ValueError("spacing: expected a valid frame, got none")
        lengths = np.linalg.norm(self.world_from_image[self.valid, :3, :2], axis=1)
        return tuple(np.median(lengths, axis=0).tolist())

    def corners(self) -> np.ndarray:
        """The outermost pixel centers inside the mask's bounding rectangle: (F, 4, 3) mm, world."""
        height, width = self.frames.shape[1:]
        left, top, right, bottom = 0, 0, width - 1, height - 1
        if self.mask is not None and self.mask.any():
            columns, rows = (np.flatnonzero(self.mask.any(axis=axis)) for axis in (0, 1))
            left, top, right, bottom = columns[0], rows[0], columns[-1], rows[-1]
        pixels = np.array([[left, top], [right, top], [left, bottom], [right, bottom]], np.float64)
        steps = self.world_from_image[:, :3, :2]
        return np.einsum("fik,pk->fpi", steps, pixels) + self.world_from_image[:, None, :3, 3]

    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """(lowest, highest) corner of the valid frames: two (3,) float64, mm, world."""
        if not self.n_valid:
            raise ValueError("bounds: expected a valid frame, got none")
        corners = self.corners()[self.valid].reshape(-1, 3)
        return corners.min(axis=0), corners.max(axis=0)


def checked_frames(value: Any) -> np.ndarray | DeviceArray:
    """Images as (F, H, W) uint8, uint16 or float32; other numbers become what holds them. Raises
    TypeError, ValueError."""
    if on_gpu(value):
        if not isinstance(value, DeviceArray):
            value = device_array("frames", value, ("uint8", "uint16"))
        if value.ndim != 3 or 0 in value.shape[1:]:
            raise ValueError(f"frames: expected shape (F, H, W), got {value.shape}")
        return value
    array = np.asarray(value)
    if array.ndim != 3 or 0 in array.shape[1:]:
        raise ValueError(f"frames: expected shape (F, H, W), got {array.shape}")
    if array.dtype.kind not in "biuf":
        raise TypeError(f"frames: expected numbers, got dtype {array.dtype}")
    if array.dtype.name not in DTYPES:
        low, high = (array.min(), array.max()) if array.size else (0, 0)
        whole = array.dtype.kind in "biu"
        fits = [kind for kind, most in (("uint8", 255), ("uint16", 65535)) if high <= most]
        with np.errstate(over="ignore"):  # too large becomes inf, checked below
            array = array.astype(fits[0] if whole and low >= 0 and fits else np.float32)
    array = np.ascontiguousarray(array, array.dtype.newbyteorder("="))
    if array.dtype == np.float32:
        good = np.isfinite(array).reshape(len(array), -1).all(axis=1)
        if not good.all():
            i = int(np.argmin(good))
            raise ValueError(f"frames: expected finite numbers, got NaN or inf (frame {i})")
    return array


def usable(matrix: np.ndarray) -> bool:
    """Whether a world_from_image (4, 4) can be a valid frame's."""
    try:
        return bool(_poses(matrix[None], 1)[1][0])
    except ValueError:
        return False


def _poses(value: Any, n: int) -> tuple[np.ndarray, np.ndarray]:
    matrices = _array("world_from_image", value, np.float64, (n, 4, 4))
    finite = (np.abs(matrices) <= _FARTHEST).all(axis=(1, 2))  # NaN is not
    wrong = finite & ~(matrices[:, 3] == (0, 0, 0, 1)).all(axis=1)
    if wrong.any():
        i = int(np.argmax(wrong))
        row = matrices[i, 3].tolist()
        hint = ""
        if (matrices[finite][:, :, 3] == (0, 0, 0, 1)).all():
            hint = "; the matrices are probably transposed"
        raise ValueError(f"world_from_image: expected last row 0 0 0 1, got {row} (frame {i}){hint}")
    safe = np.where(finite[:, None, None], matrices, np.eye(4))
    u, v = safe[:, :3, 0], safe[:, :3, 1]
    area = np.linalg.norm(np.cross(u, v), axis=1)
    flat = area <= 1e-9 * ((u * u).sum(axis=1) + (v * v).sum(axis=1))
    if flat.any():
        got = f"a singular matrix (frame {int(np.argmax(flat))})"
        expected = "columns 0 and 1 that span a plane"
        raise ValueError(f"world_from_image: expected {expected}, got {got}")
    return matrices, finite


def _array(name: str, value: Any, dtype: Any, shape: tuple[int, ...]) -> np.ndarray:
    try:
        array = np.array(value, dtype)
    except (TypeError, ValueError):
        raise TypeError(f"{name}: expected numbers of shape {shape}") from None
    if array.shape != shape:
        raise ValueError(f"{name}: expected shape {shape}, got {array.shape}")
    return array
