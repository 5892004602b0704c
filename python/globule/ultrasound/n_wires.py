"""Calibration from images of an N-wire phantom that is registered to the tracked reference."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from .calibration import Calibration, Start
from .wire_fit import Poses, WireFit, cuts, fit_wires, free, misplaced
from .wires import NWirePhantom, WirePoints, find_wires

_FEWEST = 10  # images
_SEARCH = 0.02  # s between offsets that are tried
_CLEARLY = 0.8  # of the error at the given offset: that at another one where the fit then begins
_DISTINCT = 1.6  # times the error at the best offset: that at others (median); noise reaches 1.4
_BETWEEN = 0.1  # of the poses' interval: error of an offset by interpolation, and by a recorder's beat
_UNCERTAIN = 0.05  # s, of a temporal offset
_APART = 4.0  # deviations between the offsets of the recording's halves
_LEAST_TURN = 0.2  # degrees (deviation), about two axes


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
    weights              (F'', 3K) of the dots of images with poses, 0 for those left out
    corners              (4,) mm: what the error at the image's corners stays below in 95 % of such
                         calibrations
    center               mm: the same in the middle of the dots
    offset_uncertainty   s, of a temporal offset that was fitted, inf if the probe does not move
                         enough to tell; else None
    offset_doubt         why an offset that was fitted is not certain, or ""
    slip                 where and how far the reference has moved on the phantom during the
                         recording, in words, or ""
    misplaced            how far the phantom lies from its registration, where the images tell that
                         the registration's stated error is too small, in words, or ""
    by_offset            errors of the calibration images at the given offset, and at the fitted one
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
    offset_doubt: str
    slip: str
    misplaced: str
    by_offset: tuple[WireErrors, WireErrors]
    better_offset: tuple[float, float, float, float] | None


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

    The diagonals' points give a linear start (Chen et al. 2009, as PLUS), for every offset up to
    `most` in steps of 0.02 s. From there, `fit_wires` finds two scales, a rotation and a
    translation that explain the dots, with noise of dots, errors of poses, an error of the
    phantom's registration (phantom.error) and the delay of the poses. The delay is fitted also if
    fit_offset is false, and then only reported. Its uncertainty is the largest of that of the fit,
    that of fits to 12 parts of the recording, drawn with repetition, and half the difference of its
    halves. `offset_doubt` is set by
    an uncertainty above 0.05 s, halves of the recording that differ, or larger 3-D errors. Raises
    ValueError if too few images show all wires, or if the probe hardly turns: such poses tell
    the calibration no better than the registration and one pose are known.
    """
    if phantom.reference_from_phantom is None:
        raise ValueError("phantom: expected reference_from_phantom, got none; register its landmarks first")
    frames = np.asarray(frames)
    frame_times, tracked = np.asarray(frame_times, np.float64), tracked_poses(poses, pose_times)
    if len(tracked.times) < 2:
        raise ValueError(f"poses: expected two or more, at different times, got {len(tracked.times)}")
    best: tuple[float, float, _Wires, np.ndarray] | None = None
    scan = np.append(0.0, np.arange(-most, most + 1e-9, _SEARCH))
    answers = find_wires(frames, phantom)
    for points in answers:
        if points.found.sum() < max(_FEWEST, 0.6 * answers[0].found.sum()):
            continue
        wires = _Wires.made(points, frame_times, tracked, phantom, temporal_offset)
        if wires is None:
            continue
        errors = np.array([wires.linear(temporal_offset + change)[1] for change in scan])
        at = int(errors.argmin())
        at = at if errors[at] < _CLEARLY * errors[0] else 0
        if np.isfinite(errors[at]) and (best is None or errors[at] < best[0]):
            best = float(errors[at]), float(scan[at]), wires, errors
    if best is None:
        got = f"{int(answers[0].found.sum())} of {len(frames)}"
        raise ValueError(
            f"frames: expected {_FEWEST} or more that show all {len(phantom.wires)} wires and have poses, got {got}"
        )
    _, change, wires, errors = best
    fit = wires.fit(change)
    given, found = (wires.errors(fit.matrix, temporal_offset + c) for c in (0.0, fit.change))
    between = _BETWEEN * float(np.median(np.diff(tracked.times)))
    halves = abs(fit.halves[0][0] - fit.halves[1][0]) / 2
    apart = float(np.hypot(max(fit.delays.std(), halves, np.sqrt(fit.covariance[8, 8])), between))
    moves = _moves(scan, errors, fit.change)
    slip = _slipped(fit)
    doubt = "" if slip else _doubt(fit, apart, moves, given, found)
    better = None
    if not fit_offset and not doubt and not slip and abs(fit.change) > 4 * apart:
        before, after = (of.summary()["rms_pixels"] for of in (given, found))
        if after < 0.85 * before:
            better = (temporal_offset + fit.change, apart, before, after)
    height, width = frames.shape[1:]
    corners = [(x, y) for y in (0, height - 1) for x in (0, width - 1)]
    within = fit.within(np.array([*corners, np.nanmean(wires.points.reshape(-1, 2), axis=0)]))
    of = found if fit_offset else given
    calibration = Calibration(
        fit.matrix, temporal_offset + (fit.change if fit_offset else 0.0),
        rms=float(np.sqrt((of.three_d**2).mean())), error=float(fit.expected(np.array(corners)).max()),
    )  # fmt: skip
    return NWireCalibration(
        calibration, wires.source, of, fit.weights, within[:4], float(within[4]),
        (apart if moves else np.inf) if fit_offset else None, doubt if fit_offset else "", slip,
        "" if slip else wires.misplaced(fit), (given, found), better,
    )  # fmt: skip


def _moves(scan: np.ndarray, errors: np.ndarray, change: float) -> bool:
    """Whether offsets elsewhere fit worse: otherwise a probe at rest, whose poses are noise, would
    have an offset that looks exact."""
    others = errors[(np.abs(scan - change) >= 0.15) & np.isfinite(errors)]
    here = errors[np.abs(scan - change).argmin()]
    return len(others) > 0 and float(np.median(others)) > _DISTINCT * here


def _slipped(fit: WireFit) -> str:
    if fit.slip is None:
        return ""
    image, moved, turned = fit.slip
    return (f"from image {image} on, the phantom lies {moved:.1f} mm and {turned:.1f} degrees beside its "
            "place before: the reference has slipped on it")  # fmt: skip


def _doubt(fit: WireFit, apart: float, moves: bool, given: WireErrors, found: WireErrors) -> str:
    if not moves:
        return "the probe must move during the recording"
    if apart > _UNCERTAIN:
        return f"parts of the recording differ by {apart:.2f} s (1 sigma); the probe must move more"
    (first, of_first), (second, of_second) = fit.halves
    if abs(first - second) > max(_APART * np.hypot(of_first, of_second), _UNCERTAIN):
        return (f"the recording's halves give {first:+.3f} ± {of_first:.3f} and {second:+.3f} ± "
                f"{of_second:.3f} s beside the given one")  # fmt: skip
    before, after = (of.summary()["mean_of_95"] for of in (given, found))
    if after > before and abs(fit.change) > 2 * apart:  # else the offset is the given one
        return f"it makes the 3-D error larger, {after:.3f} instead of {before:.3f} mm"
    return ""


def tracked_poses(poses: Any, pose_times: Any) -> Poses:
    """In the order of time, each time once."""
    times, first = np.unique(np.asarray(pose_times, np.float64), return_index=True)
    return Poses(np.asarray(poses, np.float64)[first], times)


def validate_n_wires(
    calibration: Calibration, frames: Any, frame_times: Any, poses: Any, pose_times: Any,
    phantom: NWirePhantom,
) -> tuple[WireErrors, WirePoints]:  # fmt: skip
    """The errors of a calibration in other images of the phantom, and the dots found there.

    Arguments as of `calibrate_n_wires`. Raises ValueError if no image shows all wires.
    """
    frame_times, tracked = np.asarray(frame_times, np.float64), tracked_poses(poses, pose_times)
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
        got = f"none of {len(frames)}"
        raise ValueError(f"frames: expected some that show all {len(phantom.wires)} wires and have poses, got {got}")
    return best[1], best[2]


class _Wires(NamedTuple):
    """Dots (F', 3K, 2) of images at times (F',), whose poses are those at times + offset."""

    source: WirePoints
    frames: np.ndarray
    points: np.ndarray
    times: np.ndarray
    tracked: Poses
    phantom: NWirePhantom
    offset: float

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
        return _Wires(source, frames, points, times, tracked, phantom, offset)

    def linear(self, offset: float) -> tuple[Start | None, float]:
        """The linear solution for the poses at an offset, and its median 3-D error, mm."""
        ok = self.tracked.at(self.times + offset)[1]
        if ok.sum() < max(_FEWEST, 0.5 * len(ok)):
            return None, np.inf
        poses = self.tracked.smooth(self.times[ok] + offset) if offset != self.offset else (
            self.tracked.at(self.times[ok] + offset)[0]
        )  # fmt: skip
        places = self._on_probe(poses, self.phantom.middles(self.points[ok]))
        pixels = self.points[ok, 1::3].reshape(-1, 2)
        design = np.column_stack([pixels, np.ones(len(pixels))])
        solution, _, rank, sizes = np.linalg.lstsq(design, places.reshape(-1, 3), rcond=None)
        if rank < 3 or sizes[-1] < 1e-6 * sizes[0]:
            return None, np.inf
        off = np.linalg.norm(design @ solution - places.reshape(-1, 3), axis=1)
        u, v, t = solution
        return Start.nearest(u, v, t, np.zeros(3)), float(np.median(off))

    def fit(self, change: float) -> WireFit:
        """The calibration, from the linear solution at offset + change."""
        ok = self.tracked.at(self.times + self.offset + change)[1]
        start, _ = self.linear(self.offset + change)
        assert start is not None  # its error was finite
        turns = _turns(self.tracked.at(self.times[ok] + self.offset)[0])
        if turns[1] < _LEAST_TURN:
            raise ValueError(
                f"poses: expected a probe that turns about two axes by {_LEAST_TURN:g} degrees or more "
                f"(standard deviation), got {turns[0]:.2f} and {turns[1]:.2f}; tilt and turn the probe"
            )
        fit = fit_wires(self.points[ok], self.times[ok], self.tracked, self.phantom, start, self.offset, change)
        return fit if fit.slip is None else fit._replace(slip=(int(self.frames[ok][fit.slip[0]]), *fit.slip[1:]))

    def misplaced(self, fit: WireFit) -> str:
        """How far the phantom lies from its registration, in words, or ""."""
        ok = self.tracked.at(self.times + self.offset + fit.change)[1]
        start = self.linear(self.offset + fit.change)[0]
        if start is None:
            return ""
        loose = fit_wires(
            self.points[ok], self.times[ok], self.tracked, free(self.phantom), start, self.offset, fit.change
        )
        found = misplaced(loose, self.phantom)
        if found is None:
            return ""
        return (f"the phantom lies {found[0]:.1f} mm and {found[1]:.1f} degrees beside its registration, whose "
                f"stated error is {self.phantom.error:.2g} mm")  # fmt: skip

    def _on_probe(self, poses: np.ndarray, places: np.ndarray) -> np.ndarray:
        """(F', k, 3) mm of places (F', k, 3) in the phantom."""
        matrix = np.linalg.inv(poses) @ self.phantom.reference_from_phantom
        return np.einsum("fij,fkj->fki", matrix[:, :3, :3], places) + matrix[:, None, :3, 3]

    def errors(self, matrix: np.ndarray, offset: float) -> WireErrors:
        poses, ok = self.tracked.at(self.times + offset)
        points, poses = self.points[ok], poses[ok]
        places = self._on_probe(poses, self.phantom.middles(points))
        seen = points[:, 1::3] @ matrix[:3, :2].T + matrix[:3, 3]
        from_phantom = np.linalg.inv(poses @ matrix) @ self.phantom.reference_from_phantom
        return WireErrors(
            self.frames[ok], np.linalg.norm(seen - places, axis=2),
            points - cuts(from_phantom, self.phantom.wires.reshape(-1, 3)),
        )  # fmt: skip


def _turns(poses: np.ndarray) -> np.ndarray:
    """Degrees (3,), standard deviation of the probe's rotations about the axes of most to least."""
    from scipy.spatial.transform import Rotation

    found = Rotation.from_matrix(poses[:, :3, :3])
    vectors = (found.mean().inv() * found).as_rotvec()
    return np.degrees(np.sqrt(np.linalg.eigvalsh(np.cov(vectors.T))[::-1].clip(0)))
