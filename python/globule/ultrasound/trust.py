"""How far a sweep and its volume can be trusted: its poses, and frames predicted from others."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from ..volumes.slices import reslice_frame
from ..volumes.volume import EMPTY, MEASURED
from .pose_check import PoseCheck, PoseFinding, check_poses
from .sweep import Sweep

log = logging.getLogger("globule")

__all__ = ["PoseCheck", "PoseFinding", "Validation", "check_poses", "compare_methods", "cross_validate"]


class Validation(NamedTuple):
    """The errors of a volume that predicts omitted frames from the other frames, in gray levels.

    mean_error       mean of |predicted - seen|
    rms_error        root of the mean square
    bias             mean of predicted - seen
    coverage         share of the frames' pixels that the volume predicts at all
    measured         share of the predicted pixels whose voxel was measured, the rest was filled
    n_frames         frames left out and predicted
    n_pixels         pixels predicted
    """

    mean_error: float
    rms_error: float
    bias: float
    coverage: float
    measured: float
    n_frames: int
    n_pixels: int


def cross_validate(
    sweep: Sweep, k: int, method: str = "pvn-om", reconstruct: Callable[..., Any] | None = None, **options: Any
) -> Validation:
    """Omit frames, reconstruct from the other frames, predict the omitted frames, and compare.

    Args:
        sweep: at least 2 k valid frames.
        k: folds: the valid frames are dealt out in turn, so that every k-th is left out at a time
            and each is predicted once, but for the first and the last, which nothing encloses.
        method, options: those of `globule.ultrasound.reconstruct`.
        reconstruct: another function of that form.

    Raises ValueError if there are too few frames for k folds.
    """
    from .reconstruct import reconstruct as default

    make = reconstruct or default
    indices = np.flatnonzero(sweep.valid)
    if not isinstance(k, (int, np.integer)) or k < 2:
        raise ValueError(f"k: expected 2 folds or more, got {k!r}")
    if len(indices) < 2 * k:
        raise ValueError(f"k: expected at most half of the {len(indices)} valid frames, got {k}")
    inside = np.ones(sweep.frames.shape[1:], bool) if sweep.mask is None else sweep.mask
    sums = np.zeros(3)
    n_pixels = n_measured = n_frames = 0
    for fold in range(k):
        left_out = [i for rank, i in enumerate(indices[1:-1]) if rank % k == fold]
        rest = Sweep(
            sweep.frames, sweep.world_from_image, sweep.timestamps,
            sweep.valid & ~np.isin(np.arange(len(sweep)), left_out), sweep.mask, sweep.world,
            sweep.space,
        )  # fmt: skip
        volume = make(rest, method=method, **options)
        for i in left_out:
            predicted = reslice_frame(volume, sweep, i)
            known = inside & (predicted.origin != EMPTY)
            error = predicted.values[known].astype(np.float64) - sweep.frames[i][known]
            sums += np.abs(error).sum(), (error**2).sum(), error.sum()
            n_pixels += error.size
            n_measured += int((predicted.origin[known] == MEASURED).sum())
            n_frames += 1
    if n_pixels == 0:
        raise ValueError("sweep: expected frames that overlap those left out, got no common voxel")
    return Validation(
        float(sums[0] / n_pixels), float(np.sqrt(sums[1] / n_pixels)), float(sums[2] / n_pixels),
        n_pixels / (n_frames * int(inside.sum())), n_measured / n_pixels, n_frames, n_pixels,
    )  # fmt: skip


def compare_methods(
    sweep: Sweep, k: int, methods: Sequence[str], failures: dict[str, str] | None = None, **options: Any
) -> dict[str, Validation]:
    """`cross_validate` for each method.

    A method that cannot reconstruct this sweep is left out. Its error goes to `failures`, by
    method, or is a warning in the log. If no method can, the first one's error is raised.
    """
    found: dict[str, Validation] = {}
    failed: list[Exception] = []
    for method in methods:
        try:
            found[method] = cross_validate(sweep, k, method, **options)
        except (ValueError, MemoryError) as error:
            failed.append(error)
            if failures is None:
                log.warning("cross-validation without %s: %s", method, error)
            else:
                failures[method] = str(error)
    if not found and failed:
        raise failed[0]
    return found
