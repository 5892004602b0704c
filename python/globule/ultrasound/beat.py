"""The beat between a scanner's image rate and the rate at which a recorder takes images.

A recorder that takes the scanner's newest image at its own rate finds it between 0 and one image
period old. With constant rates, the age falls or rises evenly until an image is skipped or taken
twice: the offset between image and tracker is a sawtooth, as large as the scanner's image period.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

_SHORTEST = 12  # frames in one period of the sawtooth
_FEWEST = 1.5  # periods in the recording
_PHASES = 24
_SURROGATES = 199  # random residuals that the sawtooth must explain worse, all of them
_EXPLAINED = 0.3  # of the residual's variance, at least
_LARGEST = 1.5  # of the frames' interval: extent of the sawtooth
_ROUNDS = 4  # of linearization


class Beat(NamedTuple):
    """offset: mean over a period, s; extent: from the least to the greatest offset, s; period, s;
    uncertainty: standard deviation of the offset, s; probe (K,): the motion that it explains."""

    offset: float
    extent: float
    period: float
    uncertainty: float
    probe: np.ndarray


class _Fit(NamedTuple):
    offset: float
    extent: float
    period: float
    probe: np.ndarray
    residual: np.ndarray  # (K,) without the sawtooth
    columns: np.ndarray  # (C, K) unit vectors: each sawtooth that was tried, of the residual's space
    best: int


def find_beat(
    times: np.ndarray, motion: np.ndarray, pose_times: np.ndarray, moved: np.ndarray,
    offset: float, n_parts: int,
) -> Beat | None:  # fmt: skip
    """Fit an offset that is a sawtooth of the time.

    times (K,), s, and motion (K,) of the images; moved (N, k) at pose_times (N,), s, explains the
    motion; offset: the constant one, s, where the fit begins; n_parts: of the recording, each left
    out once for the uncertainty (jackknife).

    Least squares, linearized about the last offsets, over every period from 12 frames to two thirds
    of the recording, and every phase. None if a random residual with the same spectrum (1 of 199)
    is explained as well, less than 30 % of its variance is explained, or the extent exceeds 1.5
    intervals of the frames.
    """
    interval, span = float(np.median(np.diff(times))), float(np.ptp(times))
    cycles = np.arange(_FEWEST, span / (_SHORTEST * interval), 0.2)
    if len(cycles) == 0:
        return None
    phase = np.arange(_PHASES) / _PHASES
    turns = (times - times[0])[None, None] / span * cycles[:, None, None] - phase[:, None]
    waves = (np.mod(turns, 1) - 0.5).reshape(-1, len(times))
    periods = np.repeat(span / cycles, _PHASES)
    weight = np.ones(len(times))
    found = _fit(times, motion, pose_times, moved, offset, waves, periods, weight)
    if found is None or not _holds(found, interval):
        return None
    without = []
    for part in np.array_split(np.arange(len(times)), n_parts):
        kept = weight.copy()
        kept[part] = 0
        one = _fit(times, motion, pose_times, moved, offset, waves, periods, kept)
        if one is None:
            return None
        without.append(one.offset)
    spread = float(np.sqrt((n_parts - 1) * np.var(without)))
    return Beat(found.offset, abs(found.extent), found.period, spread, found.probe)


def _fit(
    times: np.ndarray, motion: np.ndarray, pose_times: np.ndarray, moved: np.ndarray,
    offset: float, waves: np.ndarray, periods: np.ndarray, weight: np.ndarray,
) -> _Fit | None:  # fmt: skip
    half = 0.5 * float(np.median(np.diff(times)))
    lags = np.full(len(times), offset)

    def at(shift: float) -> np.ndarray:
        return np.stack([np.interp(times + lags + shift, pose_times, c) for c in moved.T], axis=1)

    constant, kept = np.ones(len(times)), weight > 0
    place = at(0.0)
    # Directions in which the probe hardly moves are the tracker's noise.
    _, size, axes = np.linalg.svd((place - place[kept].mean(axis=0))[kept], full_matrices=False)
    axes = axes[size > 0.05 * size[0]].T
    rows = np.column_stack([constant, place @ axes])[kept]
    share = np.linalg.lstsq(rows, motion[kept], rcond=None)[0][1:]
    found = None
    for _ in range(_ROUNDS):
        place = at(0.0) @ axes
        speed = (at(half) - at(-half)) @ axes @ share / (2 * half)
        common = np.column_stack([constant, place, speed])
        target = motion + speed * lags
        basis = np.linalg.qr(common * weight[:, None])[0]
        columns = waves * (speed * weight)
        columns -= (columns @ basis) @ basis.T
        length = np.linalg.norm(columns, axis=1)
        columns /= np.maximum(length, 1e-9 * length.max() + 1e-300)[:, None]
        residual = target * weight
        residual -= basis @ (basis.T @ residual)
        best = int(np.argmax(np.abs(columns @ residual)))
        design = np.column_stack([common, speed * waves[best]])
        answer = np.linalg.lstsq(design[kept], target[kept], rcond=None)[0]
        share, mean, extent = answer[1:-2], float(answer[-2]), float(answer[-1])
        limit = 4 * half
        if not (abs(mean - offset) <= limit and abs(extent) <= 2 * limit):
            return None
        lags = mean + extent * waves[best]
        probe = answer[0] + at(0.0) @ axes @ share
        found = _Fit(mean, extent, float(periods[best]), probe, residual, columns, best)
    return found


def _holds(found: _Fit, interval: float) -> bool:
    residual = found.residual
    explained = (found.columns[found.best] @ residual) ** 2
    if explained < _EXPLAINED * (residual @ residual):
        return False
    if abs(found.extent) > _LARGEST * interval:
        return False
    random = surrogates(residual, _SURROGATES)
    return bool(((found.columns @ random.T) ** 2).max() < explained)


def surrogates(signal: np.ndarray, n: int) -> np.ndarray:
    """n signals with the spectrum of this one and random phases; the same at each call."""
    spectrum = np.abs(np.fft.rfft(signal))
    phases = np.random.default_rng(0).uniform(0, 2 * np.pi, (n, len(spectrum)))
    return np.fft.irfft(spectrum * np.exp(1j * phases), len(signal), axis=1)
