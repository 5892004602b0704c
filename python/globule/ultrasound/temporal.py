"""How late a tracker's poses are: the motion of the image compared with that of the probe."""

from __future__ import annotations

import itertools
from typing import Any, NamedTuple

import numpy as np

from .._base.checks import choice
from .beat import find_beat, surrogates
from .lines import find_lines

METHODS = ("auto", "line", "speckle")
_SURROGATES = 400  # random motions that the one seen is compared with
_BLOCKS = 12  # parts of the recording, each left out once
_FOUND = 0.8  # share of the frames that must show a line
_CHANCE, _CORRELATION, _UNCERTAINTY = 0.05, 0.5, 0.02  # limits of a certain offset


class Curves(NamedTuple):
    """The two motions that were compared, (K,) each, of mean 0 and deviation 1.

    times   s, of the frames; image, and probe at times + offset
    lags    (L,) s, and scores (L,), the correlation at each
    """

    times: np.ndarray
    image: np.ndarray
    probe: np.ndarray
    lags: np.ndarray
    scores: np.ndarray


class TemporalOffset(NamedTuple):
    """When the probe was where a frame shows it.

    offset        s, to be added to frame times
    correlation   of image and probe motion at it, up to 1
    uncertainty   s, standard deviation of the offset, if it is right at all
    chance        share of random motions with the image motion's spectrum that correlate as well
                  at some offset; above 0.05 or so the recording does not tell the offset
    method        "line" or "speckle": what the image's motion was taken from
    skew          s, how much later the offset is at the last than at the first lit column, for a
                  scanner that needs this long for an image; None for speckle
    doubt         why the offset is not certain, or ""
    curves        the two motions
    beat_extent   s, from the least to the greatest offset, if it is a sawtooth of the time; or None
    beat_period   s, of this sawtooth, or None
    """

    offset: float
    correlation: float
    uncertainty: float
    chance: float
    method: str = "speckle"
    skew: float | None = None
    doubt: str = ""
    curves: Curves | None = None
    beat_extent: float | None = None
    beat_period: float | None = None


def temporal_offset(
    frames: Any, frame_times: Any, poses: Any, pose_times: Any, most: float = 0.5,
    method: str = "auto",
) -> TemporalOffset:  # fmt: skip
    """Find the temporal offset between the images and the tracker's poses.

    Args:
        frames: (F, H, W) images.
        frame_times: (F,) s.
        poses: (N, 4, 4) world_from_probe, mm.
        pose_times: (N,) s.
        most: s, the largest offset of either sign in the search.
        method: "line": the probe moves up and down over a plane, as the bottom of a water tank,
            and the image's motion is the depth of its echo. "speckle": the probe moves over tissue,
            and the motion is the mean absolute difference of neighboring frames, per second.
            "auto": the line if most frames show one and its offset is certain, else speckle.

    The depth of the line is fitted by the probe's position, the speckle's motion by the probe's
    speed; the offset is where the correlation of both peaks, refined by a parabola. Its deviation
    is that of offsets from the recording without each of 12 parts (jackknife). An offset is certain
    if chance is at most 0.05, the correlation at least 0.5 and the deviation at most 0.02 s;
    otherwise `doubt` says what is not so. The depth is taken at the middle of the echo's columns,
    because a scanner acquires columns one after the other. If the offset of the line is a sawtooth
    of the time (`find_beat`: the recorder takes images at another rate than the scanner makes
    them), `offset` is its mean over a period, and `beat_extent` and `beat_period` describe it.

    The probe must change its speed during the recording. For speckle, the probe must move less
    between two frames than speckle is wide. Raises ValueError if image or probe never moves, if no
    line is found with method "line", or if the recording is shorter than 2 · most.
    """
    choice("method", method, METHODS)
    frames = np.asarray(frames)
    frame_times, pose_times = (np.asarray(t, np.float64) for t in (frame_times, pose_times))
    places = np.asarray(poses, np.float64)[:, :3, 3]
    if len(frames) != len(frame_times) or len(places) != len(pose_times):
        raise ValueError("times: expected one per frame and one per pose")
    if np.ptp(frame_times) <= 2 * most:
        got = f"{np.ptp(frame_times):g} s"
        raise ValueError(f"frame_times: expected more than {2 * most:g} s, got {got}")
    probe = _speed(pose_times, np.linalg.norm(np.diff(places, axis=0), axis=1))
    if not probe[1].any():
        raise ValueError("poses: expected a probe that changes its speed, got one that rests")
    by_line = None
    if method != "speckle":
        by_line = _by_line(frames, frame_times, places, pose_times, most, method == "line")
        if by_line is not None and (method == "line" or not by_line.doubt):
            return by_line
    differences = [float(np.abs(np.subtract(b, a, dtype=np.float32)).mean()) for a, b in itertools.pairwise(frames)]
    times, motion = _speed(frame_times, differences)
    by_speckle = _compared(times, motion, probe[0], probe[1][:, None], most, "speckle")
    return by_speckle if by_line is None or not by_speckle.doubt else by_line


def _by_line(
    frames: np.ndarray, frame_times: np.ndarray, places: np.ndarray, pose_times: np.ndarray,
    most: float, needed: bool,
) -> TemporalOffset | None:  # fmt: skip
    lines = find_lines(frames)
    found = lines.found
    if found.mean() < _FOUND or found.sum() < 2 * _BLOCKS:
        if not needed:
            return None
        got = f"{int(found.sum())} of {len(found)}"
        raise ValueError(f"frames: expected a straight echo in most images, got one in {got}")
    times = frame_times[found]
    at = [(1 - s) * lines.span[0] + s * lines.span[1] for s in (0.25, 0.5, 0.75)]
    left, middle, right = (
        _compared(times, lines.at(c)[found], pose_times, places, most, "line", c == at[1]) for c in at
    )
    skew = 2 * (right.offset - left.offset)
    return _with_beat(middle, pose_times, places)._replace(skew=skew)


def _with_beat(found: TemporalOffset, pose_times: np.ndarray, places: np.ndarray) -> TemporalOffset:
    """The offset with its sawtooth, if it has one."""
    curves = found.curves
    if curves is None or not np.isfinite(found.uncertainty):
        return found
    times, motion = curves.times, curves.image
    order = np.argsort(pose_times, kind="stable")
    beat = find_beat(times, motion, pose_times[order], places[order], found.offset, _BLOCKS)
    if beat is None:
        return found
    probe = _centered(beat.probe)
    correlation = float(np.mean(motion * probe))
    return found._replace(
        offset=beat.offset, uncertainty=beat.uncertainty, correlation=correlation,
        curves=curves._replace(probe=probe), beat_extent=beat.extent, beat_period=beat.period,
        doubt=_doubt(found.chance, correlation, beat.uncertainty),
    )  # fmt: skip


def _compared(
    times: np.ndarray, motion: np.ndarray, pose_times: np.ndarray, moved: np.ndarray, most: float,
    method: str, chance: bool = True,
) -> TemporalOffset:  # fmt: skip
    """The lag at which `moved` (N, k) at pose_times explains `motion` (K,) at times best."""
    inside = (times >= times[0] + most) & (times <= times[-1] - most)
    n_parts = min(_BLOCKS, int(inside.sum()) // 2)
    if n_parts < 4:
        problem = f"expected 8 images or more without the first and the last {most:g} s"
        raise ValueError(f"frame_times: {problem}, got {int(inside.sum())}")
    times, motion = times[inside], _normal("frames", motion[inside])
    step = min(np.median(np.diff(times)), np.median(np.diff(np.unique(pose_times)))) / 4
    n_lags = int(most / step)
    lags = np.arange(-n_lags, n_lags + 1) * step
    order = np.argsort(pose_times, kind="stable")
    pose_times, moved = pose_times[order], moved[order]
    shifted = np.stack(
        [[np.interp(times + lag, pose_times, column) for column in moved.T] for lag in lags]
    )  # (lags, k, times)
    every = np.ones(len(times))
    scores = _scores(shifted, motion[None], every)[0]
    best = int(np.argmax(scores))
    if scores[best] <= 0:
        raise ValueError("poses: expected a probe that changes its speed, got no correlation")
    offset = _peak(lags, scores)
    parts = np.array_split(np.arange(len(times)), n_parts)
    without = []
    for part in parts:
        kept = every.copy()
        kept[part] = 0
        without.append(_peak(lags, _scores(shifted, motion[None], kept)[0]))
    spread = np.sqrt((n_parts - 1) * np.var(without))
    at_limit = best in (0, len(lags) - 1)
    uncertainty = np.inf if at_limit else float(spread)
    by_chance = np.nan
    if chance:
        random = np.array([_centered(one) for one in surrogates(motion, _SURROGATES)])
        scored = _scores(shifted, random, every).max(axis=1)
        by_chance = float((scored >= scores[best]).mean())
    basis = _basis(shifted[best : best + 1], every)[0]
    fitted = _centered(basis @ (basis.T @ motion))
    return TemporalOffset(
        offset, float(scores[best]), uncertainty, by_chance, method, None,
        _doubt(by_chance, scores[best], uncertainty), Curves(times, motion, fitted, lags, scores),
    )  # fmt: skip


def _doubt(chance: float, correlation: float, uncertainty: float) -> str:
    if not np.isfinite(uncertainty):
        return "the best fit is at the limit of the search"
    if chance > _CHANCE:
        return f"{100 * chance:.0f} % of random motions fit as well"
    if correlation < _CORRELATION:
        return f"image and probe correlate by {correlation:.2f} only, expected {_CORRELATION:g}"
    if uncertainty > _UNCERTAINTY:
        expected = f"expected {_UNCERTAINTY:g} s at most"
        return f"parts of the recording differ by {uncertainty:.3f} s (1 sigma), {expected}"
    return ""


def _basis(shifted: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Orthonormal columns (lags, times, k) that span what the probe did, without its mean."""
    n = weight.sum()
    moved = shifted * weight
    moved = (moved - weight * (moved.sum(axis=2, keepdims=True) / n)).transpose(0, 2, 1)
    # Components far below the largest are the tracker's noise.
    u, s, _ = np.linalg.svd(moved, full_matrices=False)
    return u * (s > np.maximum(0.05 * s[:, :1], 1e-12))[:, None, :]


def _scores(shifted: np.ndarray, motions: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Correlation (signals, lags) of each motion (signals, times) with its fit at each lag."""
    n = weight.sum()
    motions = motions * weight
    motions = motions - weight * (motions.sum(axis=1, keepdims=True) / n)
    motions = motions / np.maximum(np.linalg.norm(motions, axis=1, keepdims=True), 1e-300)
    if shifted.shape[1] > 1:
        basis = _basis(shifted, weight)
        return np.stack([np.linalg.norm(motions @ one, axis=1) for one in basis], axis=1)
    moved = shifted[:, 0] * weight  # one signal of known sign: both are speeds
    moved = moved - weight * (moved.sum(axis=1, keepdims=True) / n)
    length = np.linalg.norm(moved, axis=1, keepdims=True)
    return motions @ (moved / np.maximum(length, 1e-12)).T


def _peak(lags: np.ndarray, scores: np.ndarray) -> float:
    """The place of the highest score, between lags by a parabola."""
    best = int(np.argmax(scores))
    if not 0 < best < len(lags) - 1:
        return float(lags[best])
    before, here, after = scores[best - 1 : best + 2]
    bend = before - 2 * here + after
    shift = 0.5 * (before - after) / bend if bend < 0 else 0.0
    return float(lags[best] + shift * (lags[1] - lags[0]))


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


def _centered(signal: np.ndarray) -> np.ndarray:
    """Mean 0 and deviation 1; all 0 if the signal never changes."""
    spread = signal.std()
    return (signal - signal.mean()) / spread if spread > 0 else np.zeros(len(signal))
