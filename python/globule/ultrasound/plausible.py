"""Whether the transforms of a sweep can be in millimeters and lead from the image to the world."""

from __future__ import annotations

import warnings

import numpy as np

from ..formats.errors import FormatError

_SMALLEST, _LARGEST = 0.003, 3.0  # mm per pixel, beyond which no scanner is
_WIDEST = 500.0  # mm, of an image; a small one may have larger pixels
_USUAL = (0.01, 2.0)  # mm per pixel
_LONGER, _SLOWEST = 300.0, 1.0  # times the frames' span; s between poses
_FRACTIONS = {"ms": 1e-3, "us": 1e-6, "ns": 1e-9}
_UNITS = (("meters", 1000.0), ("centimeters", 10.0), ("micrometers", 0.001))


def check_pixels(matrices: np.ndarray, shape: tuple[int, int]) -> None:
    """Refuse pixels of a size that no ultrasound image has.

    matrices   (F, 4, 4) world_from_image of the valid frames, mm
    shape      rows and columns of an image

    Raises ValueError naming the unit or direction that is probably meant.
    """
    size = np.median(np.linalg.norm(matrices[:, :3, :2], axis=1), axis=0)
    wide = float((size * shape[::-1]).max())
    if size.min() >= _SMALLEST and (size.max() <= _LARGEST or wide <= _WIDEST):
        return
    inverse = np.median(np.linalg.norm(np.linalg.pinv(matrices)[:, :2, :3], axis=2), axis=0)
    advice = "check its transforms and their unit"
    if size.min() > _LARGEST and _usual(inverse):
        advice = "the transforms are probably inverted: invert them (ImageTo… maps pixels to mm)"
    else:
        for unit, factor in _UNITS:
            if _usual(size * factor):
                advice = f"they are probably in {unit}: multiply their positions by {factor:g}"
                advice += " and the pixel size with them"
                break
    got = " x ".join(f"{step:.3g}" for step in size)
    raise ValueError(f"world_from_image: expected pixels of {_SMALLEST:g} to {_LARGEST:g} mm, got {got} mm; {advice}")


def check_hand(path: object, world_from_image: np.ndarray) -> None:
    """Warn of poses (F, 4, 4) that mirror the image: rotations have no left-handed axes."""
    left = np.linalg.det(world_from_image[:, :3, :3]) < 0
    if left.any():
        warnings.warn(
            f"{path}: {int(left.sum())} of {len(left)} poses mirror the image (left-handed axes): "
            "columns, rows or axes of the world are probably swapped",
            stacklevel=3,
        )


def check_order(path: object, times: np.ndarray) -> None:
    """Warn of time stamps (F,) that go back: the order of the frames is the probe's path."""
    back = np.flatnonzero(np.diff(times) < 0)
    if len(back):
        warnings.warn(
            f"{path}: time stamps go back at frame {back[0] + 1}"
            + (f" and {len(back) - 1} others" if len(back) > 1 else "")
            + "; the frames count in the order of the file: sort these by their stamps, or store passes in files of "
            "their own",
            stacklevel=3,
        )


def check_seconds(path: object, pose_times: np.ndarray | None, times: np.ndarray | None) -> None:
    """Refuse times of poses (N,) in another unit than those of the frames (F,), s: hundreds of times as
    long, and further from each other than any tracker's."""
    if pose_times is None or times is None or len(pose_times) < 2 or len(times) < 2:
        return
    poses, frames = float(np.ptp(pose_times)), float(np.ptp(times))
    step = float(np.median(np.diff(np.sort(pose_times))))
    if not frames or poses < _LONGER * frames or step < _SLOWEST:
        return
    unit = min(_FRACTIONS, key=lambda name: abs(np.log(poses / frames * _FRACTIONS[name])))
    raise FormatError(
        f"{path}: expected times in seconds, got poses over {poses:,.6g} s beside frames over {frames:,.4g} s; they "
        f"are probably in {unit}: call the column time_{unit}, or multiply the times by {_FRACTIONS[unit]:g}"
    )


def check_travel(path: object, world_from_probe: np.ndarray) -> None:
    """Warn of poses (F, 4, 4) that are probably in meters beside a calibration in millimeters."""
    places = world_from_probe[:, :3, 3]
    if len(places) < 10:
        return
    travel, distance = float(np.ptp(places, axis=0).max()), float(np.abs(places).max())
    if 0 < travel < 1 and distance < 3:
        warnings.warn(
            f"{path}: the probe moves by {travel:.2g} mm in all, and never farther than "
            f"{distance:.2g} mm from the origin; the poses are probably in meters, expected mm",
            stacklevel=3,
        )


def _usual(size: np.ndarray) -> bool:
    return bool((size >= _USUAL[0]).all() and (size <= _USUAL[1]).all())
