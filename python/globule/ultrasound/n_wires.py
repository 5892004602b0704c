"""Calibration from images of an N-wire phantom that is registered to the tracked reference."""

from __future__ import annotations

import functools
from typing import Any, NamedTuple

import numpy as np

from .calibration import Calibration, Start, corner_errors, turn_by
from .fitting import Fit, numerical_jacobian, robust_fit
from .wires import NWirePhantom, WirePoints, find_wires

_FEWEST = 10  # images
_BLOCKS = 12  # parts of the recording whose errors are taken as independent
_TUNING = 15.0  # errors of poses are no normal noise, and gross errors only are left out
_MOST_GAP = 5.0  # median intervals between poses
_DISTINCT = 1.6  # times the error at the best offset: that at others (median); noise reaches 1.4
_BETWEEN = 0.05  # of this interval: error of an offset by interpolation between noisy poses


class WireErrors(NamedTuple):
    """How far dots are from the wires.

    frames    (F',) numbers of the images in which all wires were found
    three_d   (F', K) mm: a diagonal's dot, by the calibration, from its place on the wire, which
              follows from the dots of its N (PLUS's 3-D reprojection error)
    two_d     (F', 3K, 2) pixels: each dot minus the place where the wire should be
    """

    frames: np.ndarray
    three_d: np.ndarray
    two_d: np.ndarray

    def summary(self) -> dict[str, float]:
        """mean, deviation, median and mean of the best 95 % of three_d, mm; rms of two_d, pixels.
        PLUS's mean and deviation are those of the best 95 %."""
        all_, best = self.three_d.ravel(), np.sort(self.three_d.ravel())
        best = best[: max(1, int(np.ceil(0.95 * len(best))))]
        return {
            "mean": float(all_.mean()), "deviation": float(all_.std()),
            "median": float(np.median(all_)), "mean_of_95": float(best.mean()),
            "deviation_of_95": float(best.std()),
            "rms_pixels": float(np.sqrt((self.two_d**2).sum(axis=2).mean())),
        }  # fmt: skip


class NWireCalibration(NamedTuple):
    """The result of an N-wire calibration.

    calibration          with probe_from_image, temporal_offset, rms (of three_d) and error
    points               the dots found
    errors               of the calibration images
    weights              (F' · 3K,) of the dots, 0 for those left out
    corners              (4,) mm, expected error (1 sigma) at the image's corners
    center               mm, expected error in the middle of the dots
    offset_uncertainty   s, of a temporal offset that was fitted, inf if the probe does not move
                         enough to tell; else None
    better_offset        (offset, uncertainty, rms in pixels before and after) that fits better than
                         the given one, else None
    """

    calibration: Calibration
    points: WirePoints
    errors: WireErrors
    weights: np.ndarray
    corners: np.ndarray
    center: float
    offset_uncertainty: float | None
    better_offset: tuple[float, float, float, float] | None


class Poses(NamedTuple):
    """Poses of the probe at their times: matrices (N, 4, 4) world_from_probe, mm; times (N,) s."""

    matrices: np.ndarray
    times: np.ndarray

    def at(self, times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Poses (M, 4, 4) between the known ones, and which of these have some on both sides."""
        after = np.clip(np.searchsorted(self.times, times, side="right"), 1, len(self.times) - 1)
        span = self.times[after] - self.times[after - 1]
        share = np.clip((times - self.times[after - 1]) / span, 0, 1)[:, None, None]
        mixed = (1 - share) * self.matrices[after - 1] + share * self.matrices[after]
        left, _, right = np.linalg.svd(mixed[:, :3, :3])
        mixed[:, :3, :3] = left @ right  # the nearest rotations
        gap = span > _MOST_GAP * np.median(np.diff(self.times))
        return mixed, (times >= self.times[0]) & (times <= self.times[-1]) & ~gap


def calibrate_n_wires(
    frames: Any,
    frame_times: Any,
    poses: Any,
    pose_times: Any,
    phantom: NWirePhantom,
    temporal_offset: float = 0.0,
    fit_offset: bool = False,
    most: float = 1.0,
) -> NWireCalibration:
    """Calibrate from images of an N-wire phantom.

    Args:
        frames: (F, H, W).
        frame_times: (F,) s.
        poses: (N, 4, 4) reference_from_probe, mm; without poses that are not valid.
        pose_times: (N,) s.
        phantom: with reference_from_phantom.
        temporal_offset: s, an image at t takes the pose at t + offset.
        fit_offset: fit the temporal offset, too; the probe must then move during the recording.
        most: s, the largest offset of either sign that is tried.

    The diagonals' points give a linear start (Chen et al. 2009, as PLUS); then two scales, a
    rotation and a translation, and the temporal offset if asked for, minimize the distances in the
    image between each dot and its wire, robustly. The covariance takes errors of 12 parts of the
    recording as independent of each other, and adds what an error of the phantom's registration
    (phantom.error, and that over 20 mm in radians) does. Raises ValueError if too few images show
    all wires, or if they do not determine the calibration.
    """
    if phantom.reference_from_phantom is None:
        raise ValueError("phantom: expected reference_from_phantom, got none; register its landmarks first")
    frames = np.asarray(frames)
    frame_times, pose_times = (np.asarray(t, np.float64) for t in (frame_times, pose_times))
    order = np.argsort(pose_times, kind="stable")
    times, first = np.unique(pose_times[order], return_index=True)
    tracked = Poses(np.asarray(poses, np.float64)[order][first], times)
    if len(times) < 2:
        raise ValueError(f"poses: expected two or more, at different times, got {len(times)}")
    best: tuple[float, _Wires] | None = None
    answers = find_wires(frames, phantom)
    for points in answers:
        if points.found.sum() < max(_FEWEST, 0.6 * answers[0].found.sum()):
            continue
        wires = _Wires.made(points, frame_times, tracked, phantom, temporal_offset)
        if wires is None:
            continue
        scan = np.arange(-most, most + 1e-9, 0.1) if fit_offset else np.array([0.0])
        for change in scan:
            trial = wires.moved(temporal_offset + change)
            if trial is not None and (best is None or trial.linear_error < best[0]):
                best = trial.linear_error, trial
    if best is None:
        got = f"{int(answers[0].found.sum())} of {len(frames)}"
        raise ValueError(
            f"frames: expected {_FEWEST} or more that show all {len(phantom.wires)} wires and have poses, got {got}"
        )
    wires = best[1]
    better = None
    between = _BETWEEN * float(np.median(np.diff(times)))
    if not fit_offset:
        fit = wires.fit(False)
        freed = wires.fit(True)
        off, apart = freed.parameters[8], float(np.hypot(np.sqrt(freed.covariance[8, 8]), between))
        moves = wires.moves(wires.offset + off, most)
        if moves and abs(off) > 4 * apart and freed.sigma < 0.85 * fit.sigma:
            scale = np.sqrt(2)
            better = (wires.offset + off, apart, fit.sigma * scale, freed.sigma * scale)
    else:
        fit = wires.fit(True)
    offset = wires.offset + (fit.parameters[8] if fit_offset else 0.0)
    uncertainty = None
    if fit_offset:
        uncertainty = float(np.hypot(np.sqrt(fit.covariance[8, 8]), between))
        uncertainty = uncertainty if wires.moves(offset, most) else np.inf
    fit = wires.considered(fit)
    height, width = frames.shape[1:]
    corners = [(x, y) for y in (0, height - 1) for x in (0, width - 1)]
    middle = np.nanmean(wires.points.reshape(-1, 2), axis=0)
    expected = corner_errors(fit, wires.start.matrix, corners)
    errors = wires.errors(wires.start.matrix(fit.parameters), offset)
    matrix = wires.start.matrix(fit.parameters)
    calibration = Calibration(
        matrix, offset, rms=float(np.sqrt((errors.three_d**2).mean())), error=float(expected.max())
    )
    return NWireCalibration(
        calibration, wires.source, errors, fit.weights, expected,
        float(corner_errors(fit, wires.start.matrix, [middle])[0]), uncertainty, better,
    )  # fmt: skip


def validate_n_wires(
    calibration: Calibration, frames: Any, frame_times: Any, poses: Any, pose_times: Any,
    phantom: NWirePhantom,
) -> tuple[WireErrors, WirePoints]:  # fmt: skip
    """The errors of a calibration in other images of the phantom, and the dots found there.

    Arguments as of `calibrate_n_wires`. Raises ValueError if no image shows all wires.
    """
    frame_times, pose_times = (np.asarray(t, np.float64) for t in (frame_times, pose_times))
    times, first = np.unique(pose_times, return_index=True)
    tracked = Poses(np.asarray(poses, np.float64)[first], times)
    matrix, offset = calibration.probe_from_image, calibration.temporal_offset
    best: tuple[float, WireErrors, WirePoints] | None = None
    for points in find_wires(frames, phantom):
        wires = _Wires.made(points, frame_times, tracked, phantom, offset, 1)
        if wires is None:
            continue
        errors = wires.errors(matrix, offset)
        if best is None or np.median(errors.three_d) < best[0]:
            best = float(np.median(errors.three_d)), errors, points
    if best is None:
        raise ValueError("frames: expected some that show all wires and have poses, got none")
    return best[1], best[2]


class _Wires(NamedTuple):
    """Dots (F', 3K, 2) of images at times (F',), and the poses at times + offset."""

    source: WirePoints
    frames: np.ndarray
    points: np.ndarray
    times: np.ndarray
    tracked: Poses
    phantom: NWirePhantom
    offset: float
    start: Any
    linear_error: float

    @staticmethod
    def made(
        source: WirePoints, frame_times: np.ndarray, tracked: Poses, phantom: NWirePhantom,
        offset: float, fewest: int = _FEWEST,
    ) -> _Wires | None:  # fmt: skip
        frames = np.flatnonzero(source.found)
        frames = frames[tracked.at(frame_times[frames] + offset)[1]]
        if len(frames) < fewest:
            return None
        points, times = source.points[frames], frame_times[frames]
        made = _Wires(source, frames, points, times, tracked, phantom, offset, None, np.inf)
        return made if fewest < _FEWEST else made.moved(offset)

    def moved(self, offset: float) -> _Wires | None:
        """With the poses of another offset, and the linear solution for these."""
        poses, ok = self.tracked.at(self.times + offset)
        if ok.sum() < max(_FEWEST, 0.5 * len(ok)):
            return None
        places = self._on_probe(poses[ok], self.phantom.middles(self.points[ok]))
        pixels = self.points[ok, 1::3].reshape(-1, 2)
        design = np.column_stack([pixels, np.ones(len(pixels))])
        solution, _, rank, sizes = np.linalg.lstsq(design, places.reshape(-1, 3), rcond=None)
        if rank < 3 or sizes[-1] < 1e-6 * sizes[0]:
            return None
        u, v, t = solution
        start = Start.nearest(u, v, t, np.zeros(3))
        off = np.linalg.norm(design @ solution - places.reshape(-1, 3), axis=1)
        return self._replace(offset=offset, start=start, linear_error=float(np.median(off)))

    def moves(self, offset: float, most: float) -> bool:
        """Whether offsets elsewhere fit worse: otherwise a probe at rest, whose poses are noise,
        would have an offset that looks exact."""
        others = offset + np.arange(-most, most + 1e-9, 0.1)
        trials = [self.moved(other) for other in others[np.abs(others - offset) >= 0.15]]
        here, errors = self.moved(offset), [t.linear_error for t in trials if t is not None]
        return here is not None and bool(errors) and (
            float(np.median(errors)) > _DISTINCT * here.linear_error
        )  # fmt: skip

    def _on_probe(self, poses: np.ndarray, places: np.ndarray) -> np.ndarray:
        """(F', k, 3) mm of places (F', k, 3) or (k, 3) in the phantom."""
        matrix = np.linalg.inv(poses) @ self.phantom.reference_from_phantom
        turned = np.broadcast_to(places, (len(poses), *places.shape[-2:]))
        return np.einsum("fij,fkj->fki", matrix[:, :3, :3], turned) + matrix[:, None, :3, 3]

    def expected(self, matrix: np.ndarray, poses: np.ndarray, moved: Any = None) -> np.ndarray:
        """(F', 3K, 2) pixels where the wires cut the images."""
        ends = self.phantom.wires.reshape(-1, 3)
        if moved is not None:  # the phantom, by mm and radians about its middle
            middle = ends.mean(axis=0)
            ends = (ends - middle) @ turn_by(moved[3:]).T + middle + moved[:3]
        image_from_probe = np.linalg.inv(matrix)
        seen = self._on_probe(poses, ends) @ image_from_probe[:3, :3].T + image_from_probe[:3, 3]
        front, back = seen[:, ::2], seen[:, 1::2]
        share = front[..., 2] / (front[..., 2] - back[..., 2])
        return (front + share[..., None] * (back - front))[..., :2]

    def fit(self, free: bool) -> Fit:
        """Eight parameters of `Start.matrix`, and the change of the offset."""
        ok = self.tracked.at(self.times + self.offset)[1]

        @functools.lru_cache(maxsize=4)
        def poses(change: float) -> np.ndarray:
            return self.tracked.at(self.times + self.offset + change)[0]

        def residuals(parameters: np.ndarray) -> np.ndarray:
            at = poses(float(parameters[8]) if free else 0.0)
            seen = self.expected(self.start.matrix(parameters), at) - self.points
            return np.where(ok[:, None, None], seen, 0.0).reshape(-1, 2)

        blocks = np.arange(len(self.times)) * _BLOCKS // len(self.times)
        groups = np.repeat(blocks, len(self.phantom.wires))
        return robust_fit(residuals, np.zeros(9 if free else 8), groups=groups, floor=0.01, tuning=_TUNING)

    def considered(self, fit: Fit) -> Fit:
        """The fit with the covariance that the phantom's registration adds (a consider covariance,
        Schmidt 1966)."""
        change = fit.parameters[8] if len(fit.parameters) > 8 else 0.0
        poses = self.tracked.at(self.times + self.offset + change)[0]
        matrix = self.start.matrix(fit.parameters)
        slopes = numerical_jacobian(lambda moved: self.expected(matrix, poses, moved).reshape(-1, 2), np.zeros(6))
        root = np.sqrt(fit.weights)[:, None, None]
        jacobian = (root * fit.jacobian).reshape(-1, len(fit.parameters))
        effect = np.linalg.lstsq(jacobian, (root * slopes).reshape(-1, 6), rcond=None)[0]
        deviations = self.phantom.error * np.array([1, 1, 1, 0.05, 0.05, 0.05]) / np.sqrt(3)
        effect = effect * deviations
        return fit._replace(covariance=fit.covariance + effect @ effect.T)

    def errors(self, matrix: np.ndarray, offset: float) -> WireErrors:
        poses, ok = self.tracked.at(self.times + offset)
        points = self.points[ok]
        places = self._on_probe(poses[ok], self.phantom.middles(points))
        seen = points[:, 1::3] @ matrix[:3, :2].T + matrix[:3, 3]
        return WireErrors(
            self.frames[ok], np.linalg.norm(seen - places, axis=2),
            points - self.expected(matrix, poses[ok]),
        )  # fmt: skip
