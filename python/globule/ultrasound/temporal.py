"""How late a tracker's poses are: cross-correlation of the image's and the probe's motion."""

from __future__ import annotations

import itertools
from typing import Any, NamedTuple

import numpy as np

_SURROGATES = 400  # random motions that the one seen is compared with


class TemporalOffset(NamedTuple):
    """When the probe was where a frame shows it.

    offset        s, to be added to frame times
    correlation   of image and probe motion at it, up to 1
    uncertainty   s, standard deviation of the offset, if it is right at all
    chance        share of random motions with the image motion's spectrum that correlate as well
                  at some offset; above 0.05 or so the recording does not tell the offset
    """

    offset: float
    correlation: float
    uncertainty: float
    chance: float


def temporal_offset(
    frames: Any, frame_times: Any, poses: Any, pose_times: Any, most: float = 0.5
) -> TemporalOffset:
    """Find the temporal offset between the images and the tracker's poses.

    Args:
        frames: (F, H, W) images.
        frame_times: (F,) s.
        poses: (N, 4, 4) world_from_probe, mm.
        pose_times: (N,) s.
        most: s, the largest offset of either sign in the search.

    Motion of the image (mean absolute difference of neighboring frames, per second) and of the
    probe (mm per second) are brought to one time axis; the offset is where their normalized
    cross-correlation peaks, refined by a parabola. The probe must change its speed during the
    recording, and move less between two frames than speckle is wide: frames without common speckle
    differ by the same amount at any speed. Raises ValueError if image or probe never moves, or if
    the recording is shorter than 2 · most.
    """
    frames = np.asarray(frames)
    frame_times, pose_times = (np.asarray(t, np.float64) for t in (frame_times, pose_times))
    places = np.asarray(poses, np.float64)[:, :3, 3]
    if len(frames) != len(frame_times) or len(places) != len(pose_times):
        raise ValueError("times: expected one per frame and one per pose")
    image = _speed(
        frame_times,
        [
            float(np.abs(np.subtract(b, a, dtype=np.float32)).mean())
            for a, b in itertools.pairwise(frames)
        ],
    )
    probe = _speed(pose_times, np.linalg.norm(np.diff(places, axis=0), axis=1))
    step = min(np.median(np.diff(image[0])), np.median(np.diff(probe[0]))) / 4
    first, last = image[0][0] + most, image[0][-1] - most
    if last - first < 8 * step:
        raise ValueError(
            f"frame_times: expected more than {2 * most:g} s, got {np.ptp(frame_times):g} s"
        )
    grid = np.arange(first, last, step)
    seen = _normal("frames", np.interp(grid, *image))
    n_lags = int(most / step)
    lags = np.arange(-n_lags, n_lags + 1) * step
    moved = np.array([_centred(np.interp(grid + lag, *probe)) for lag in lags])
    scores = moved @ seen / len(grid)
    best = int(np.argmax(scores))
    if scores[best] <= 0:
        raise ValueError("poses: expected a probe that changes its speed, got no correlation")
    shift, spread = 0.0, np.inf
    if 0 < best < len(lags) - 1:
        before, here, after = scores[best - 1 : best + 2]
        bend = before - 2 * here + after
        shift = 0.5 * (before - after) / bend if bend < 0 else 0.0
        spread = _uncertainty(here, bend, n=len(grid) * step / np.median(np.diff(image[0])))
    surrogates = _surrogates(seen)
    chance = float(((surrogates @ moved.T).max(axis=1) / len(grid) >= scores[best]).mean())
    return TemporalOffset(
        float(lags[best] + shift * step), float(scores[best]), float(spread * step), chance
    )


def _uncertainty(correlation: float, bend: float, n: float) -> float:
    """Standard deviation of a peak's place, in steps: n independent samples, noise of 1 - c^2."""
    return np.sqrt(max(1 - correlation**2, 0.0) / (n * correlation * -bend)) if bend < 0 else np.inf


def _surrogates(signal: np.ndarray) -> np.ndarray:
    """Signals with the spectrum of this one and random phases; the same at each call."""
    rng = np.random.default_rng(0)
    spectrum = np.abs(np.fft.rfft(signal))
    phases = rng.uniform(0, 2 * np.pi, (_SURROGATES, len(spectrum)))
    made = np.fft.irfft(spectrum * np.exp(1j * phases), len(signal), axis=1)
    return np.array([_centred(one) for one in made])


def _speed(times: np.ndarray, distances: Any) -> tuple[np.ndarray, np.ndarray]:
    """Speed at the middle of each interval; intervals without length are left out."""
    spans = np.diff(times)
    keep = spans > 0
    if keep.sum() < 4:
        raise ValueError(f"times: expected 5 or more that increase, got {keep.sum() + 1}")
    return ((times[:-1] + times[1:]) / 2)[keep], (np.asarray(distances)[keep] / spans[keep])


def _normal(name: str, signal: np.ndarray) -> np.ndarray:
    spread = signal.std()
    if not np.isfinite(spread) or spread == 0:
        raise ValueError(f"{name}: expected motion that changes, got none")
    return (signal - signal.mean()) / spread


def _centred(signal: np.ndarray) -> np.ndarray:
    """Mean 0 and deviation 1; all 0 if the signal never changes."""
    spread = signal.std()
    return (signal - signal.mean()) / spread if spread > 0 else np.zeros(len(signal))
