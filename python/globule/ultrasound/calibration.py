"""Calibration of a tracked probe: where a pixel lies on it, and how late its poses are.

    world_from_image = world_from_probe · probe_from_image

probe_from_image maps (column, row, 0, 1) to mm on the probe; a pose for the frame at time t is the
tracker's at t + temporal_offset.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from .._base.checks import number
from .._base.files import atomic_write
from .._base.structured import parse_toml, read_text
from ..formats.errors import bad
from ..formats.sweeps.transforms import check_pixel_matrix
from .region import Clip, Fan, checked_clip, checked_fan
from .temporal import TemporalOffset, temporal_offset

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

__all__ = [
    "Calibration",
    "PointTarget",
    "TemporalOffset",
    "calibrate_point_target",
    "read_calibration",
    "temporal_offset",
    "write_calibration",
]

_KEYS = ("probe_from_image", "temporal_offset", "clip", "fan", "rms", "target")


@dataclass(frozen=True)
class Calibration:
    """The calibration of a probe, which a sweep needs.

    probe_from_image   (4, 4) float64: pixel (column, row, 0, 1) to mm in the probe's frame
    temporal_offset    s, added to a frame's time to find its pose
    clip, fan          the pixels that show tissue
    rms                root mean square of the calibration's residuals, mm, if it is known
    """

    probe_from_image: Any
    temporal_offset: float = 0.0
    clip: Clip | None = None
    fan: Fan | None = None
    rms: float | None = None

    def __post_init__(self) -> None:
        matrix = check_pixel_matrix("probe_from_image", self.probe_from_image)
        object.__setattr__(self, "probe_from_image", matrix)
        offset = number("temporal_offset", self.temporal_offset)
        object.__setattr__(self, "temporal_offset", offset)
        if self.clip is not None:
            object.__setattr__(self, "clip", checked_clip(self.clip))
        if self.fan is not None:
            object.__setattr__(self, "fan", checked_fan(self.fan))
        if self.rms is not None:
            object.__setattr__(self, "rms", number("rms", self.rms))

    @property
    def spacing(self) -> tuple[float, float]:
        """mm per pixel along a row and along a column."""
        return tuple(np.linalg.norm(self.probe_from_image[:3, :2], axis=0).tolist())


def read_calibration(path: str | os.PathLike[str]) -> Calibration:
    """Read a calibration (.toml). Raises FormatError naming the key."""
    try:
        content = parse_toml(read_text(path))
    except ValueError as error:
        raise bad(path, "", f"expected TOML, got {error}") from None
    unknown = sorted(set(content) - set(_KEYS))
    if unknown:
        raise bad(path, unknown[0], f"expected one of {', '.join(_KEYS)}")
    if "probe_from_image" not in content:
        raise bad(path, "probe_from_image", "expected a 4x4 matrix, got none")
    try:
        return Calibration(**{key: content[key] for key in content if key != "target"})
    except (TypeError, ValueError) as error:
        raise bad(path, "", str(error)) from None


def write_calibration(path: str | os.PathLike[str], calibration: Calibration) -> None:
    """Write a calibration (.toml); every number survives exactly."""
    lines = ["# pixel (column, row, 0, 1) to mm in the probe's frame", "probe_from_image = ["]
    lines += [f"  {row.tolist()!r}," for row in calibration.probe_from_image]
    lines += ["]", f"temporal_offset = {calibration.temporal_offset!r}  # s, added to frame times"]
    if calibration.clip is not None:
        lines.append(f"clip = {list(calibration.clip)!r}  # column, row, width, height")
    if calibration.fan is not None:
        names = "column, row, first, last (degrees), start, stop (pixels)"
        lines.append(f"fan = {list(calibration.fan)!r}  # {names}")
    if calibration.rms is not None:
        lines.append(f"rms = {calibration.rms!r}  # mm, of the residuals")
    with atomic_write(path, "w") as file:
        file.write("\n".join(lines) + "\n")


class PointTarget(NamedTuple):
    """The result of a point-target calibration.

    calibration   with probe_from_image and rms
    target        (3,) mm, world: where the point is
    residuals     (N, 3) mm, world: each marked pixel's place minus the target
    """

    calibration: Calibration
    target: np.ndarray
    residuals: np.ndarray


def calibrate_point_target(pixels: ArrayLike, world_from_probe: ArrayLike) -> PointTarget:
    """Calibrate from one fixed point in images of many poses, for example a crossing of two wires
    or a bead.

    Args:
        pixels: (N, 2) column and row of the point in each image, N >= 6.
        world_from_probe: (N, 4, 4) poses, mm.

    Every pixel must map to one unknown point: world_from_probe · probe_from_image ·
    (column, row, 0, 1) = target. Linear in the columns of probe_from_image and in the target, which
    starts Gauss-Newton over two scales, a rotation and a translation (Prager et al. 1998, with the
    scales of rows and columns free). Raises ValueError if the poses do not determine all unknowns.
    """
    pixels, poses = _observations(pixels, world_from_probe)
    rotations, offsets = poses[:, :3, :3], poses[:, :3, 3]
    n = len(pixels)
    # Unknowns: u, v (pixel steps in mm), t (pixel 0, 0), target. R (u c + v r + t) - target = -o.
    design = np.concatenate(
        [
            rotations * pixels[:, 0, None, None],
            rotations * pixels[:, 1, None, None],
            rotations,
            np.tile(-np.eye(3), (n, 1, 1)),
        ],
        axis=2,
    ).reshape(3 * n, 12)
    lengths = np.linalg.norm(design, axis=0)  # one size of columns, so that ranks mean something
    if not lengths.all():
        raise ValueError("pixels: expected marks in different rows and columns, got all at 0")
    solution, _, _, sizes = np.linalg.lstsq(design / lengths, -offsets.ravel(), rcond=None)
    if sizes[-1] < 1e-6 * sizes[0]:
        raise ValueError(
            "poses: expected the point seen under rotations about two axes or more and in "
            "different places of the image, got poses that leave the calibration undetermined"
        )
    u, v, t, target = (solution / lengths).reshape(4, 3)
    parameters = _Parameters.nearest(u, v, t, target)
    for _ in range(50):
        residuals, jacobian = parameters.linearize(pixels, rotations, offsets)
        step = np.linalg.lstsq(jacobian, -residuals.ravel(), rcond=None)[0]
        parameters = parameters.moved(step)
        if np.abs(step).max() < 1e-12 * (1 + np.abs(parameters.t).max()):
            break
    residuals = parameters.linearize(pixels, rotations, offsets)[0]
    rms = float(np.sqrt((residuals**2).sum(axis=1).mean()))
    return PointTarget(Calibration(parameters.matrix(), rms=rms), parameters.target, residuals)


class _Parameters(NamedTuple):
    scales: np.ndarray  # (2,) mm per pixel
    axes: np.ndarray  # (3, 3) rotation, probe from image
    t: np.ndarray  # (3,) mm
    target: np.ndarray  # (3,) mm

    @staticmethod
    def nearest(u: np.ndarray, v: np.ndarray, t: np.ndarray, target: np.ndarray) -> _Parameters:
        scales = np.array([np.linalg.norm(u), np.linalg.norm(v)])
        normal = np.cross(u, v)
        if not scales.all() or not normal.any():
            raise ValueError("pixels: expected marks that span the image, got all on one line")
        left, _, right = np.linalg.svd(
            np.stack([u / scales[0], v / scales[1], normal / np.linalg.norm(normal)], axis=1)
        )
        return _Parameters(scales, left @ right, t, target)

    def linearize(
        self, pixels: np.ndarray, rotations: np.ndarray, offsets: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Residuals (N, 3) and their slopes (3N, 11): scales, small rotation, t, target."""
        flat = np.column_stack([pixels * self.scales, np.zeros(len(pixels))])
        on_probe = flat @ self.axes.T
        residuals = np.einsum("nij,nj->ni", rotations, on_probe + self.t) + offsets - self.target
        slopes = np.empty((len(pixels), 3, 11))
        for axis in range(2):
            slopes[:, :, axis] = rotations @ self.axes[:, axis] * pixels[:, axis, None]
        for axis in range(3):  # axes <- (I + [w]x) axes
            turned = np.cross(np.eye(3)[axis], on_probe)
            slopes[:, :, 2 + axis] = np.einsum("nij,nj->ni", rotations, turned)
        slopes[:, :, 5:8] = rotations
        slopes[:, :, 8:] = -np.eye(3)
        return residuals, slopes.reshape(-1, 11)

    def moved(self, step: np.ndarray) -> _Parameters:
        return _Parameters(
            self.scales + step[:2], _rotation(step[2:5]) @ self.axes,
            self.t + step[5:8], self.target + step[8:],
        )  # fmt: skip

    def matrix(self) -> np.ndarray:
        result = np.eye(4)
        # The third column has no pixels; the mean scale keeps the matrix invertible and its size.
        scales = np.append(self.scales, np.sqrt(self.scales.prod()))
        result[:3, :3] = self.axes * scales
        result[:3, 3] = self.t
        return result


def _rotation(w: np.ndarray) -> np.ndarray:
    """The rotation by |w| radians about w (Rodrigues)."""
    angle = np.linalg.norm(w)
    cross = np.array([[0, -w[2], w[1]], [w[2], 0, -w[0]], [-w[1], w[0], 0]])
    if angle < 1e-12:
        return np.eye(3) + cross
    cross /= angle
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross


def _observations(pixels: Any, world_from_probe: Any) -> tuple[np.ndarray, np.ndarray]:
    try:
        pixels = np.asarray(pixels, np.float64)
        poses = np.asarray(world_from_probe, np.float64)
    except (TypeError, ValueError):
        raise TypeError("pixels, world_from_probe: expected arrays of numbers") from None
    if pixels.ndim != 2 or pixels.shape[1] != 2 or len(pixels) < 6:
        raise ValueError(f"pixels: expected shape (N, 2), N >= 6, got {pixels.shape}")
    if poses.shape != (len(pixels), 4, 4):
        expected = f"({len(pixels)}, 4, 4)"
        raise ValueError(f"world_from_probe: expected shape {expected}, got {poses.shape}")
    for name, array in (("pixels", pixels), ("world_from_probe", poses)):
        good = np.isfinite(array).reshape(len(array), -1).all(axis=1)
        if not good.all():
            raise ValueError(
                f"{name}: expected finite numbers, got NaN or inf (observation {np.argmin(good)})"
            )
    return pixels, poses
