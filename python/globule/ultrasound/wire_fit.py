"""The fit of an N-wire calibration: errors of dots, of poses and of the phantom's registration.

A dot is off by noise of its own; the pose of an image moves all its dots together; and an error of
the phantom's registration moves those of all images. Distances in the image alone let the pose's
error count nine times as nine errors of dots. Here each image has an unknown turn and shift, whose
variances are estimated with the calibration (a mixed model, fitted by expectation and maximization:
Laird and Ware 1982), and the registration may move as far as its stated error allows. A delay of
the poses is always fitted beside, because it would otherwise pull the matrix.

Errors of poses change slowly, so that neighboring images have nearly the same one: beside the
registration, a recording counts as the few images that are independent. Dots that lie off their
wires in the same way in all images, as where a wire is not at its stated place, pull every image
alike; no number of images averages that out, and the stated error contains it.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from .calibration import Start, turn_by
from .wires import NWirePhantom

_MOST_GAP = 5.0  # median intervals between poses
_AROUND = 9  # poses that tell the motion at a time
_WIDTH = 1.5  # intervals: deviation of their weights
_TAILS = 30.0  # degrees of freedom of Student's t, of dots and poses: gross errors count less
_ROUNDS, _INNER = 8, 8  # linearizations, and estimates of the covariances in each
_DELAY = 1.0  # s: deviation of a delay that nothing is known of
_BLOCKS = 12  # parts of the recording whose errors are taken as independent
_FEWEST_PARTS = 5  # independent images of a recording, at least
_FITTED = 8  # of the mean residuals of an image, what its pose and the scales take away
_SLIP, _LEAST_SLIP = 200.0, 0.5  # chi-squared of a step in the errors of poses; mm (slow drifts reach 180)
_FEWEST_BESIDE = 5  # images before and after a slip
_FREE, _UNTOLD = 30.0, 1.0  # mm: error of a free registration; deviation above which its fit does not tell
_MISPLACED = 30.0  # chi-squared (6) of the registration: by its stated error, one in 25,000
_REACH = 20.0  # mm from the middle of the wires, where a turn counts as a shift
_DRAWS = 400  # of these parts, for the uncertainty of the delay
_N = 9  # parameters: eight of `Start.matrix`, and the change of the offset
_STEPS = np.array([1e-5] * 5 + [1e-3] * 3 + [5e-3])  # for slopes


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
        gap = span > _MOST_GAP * np.median(np.diff(self.times))
        return _rigid(mixed), (times >= self.times[0]) & (times <= self.times[-1]) & ~gap

    def smooth(self, times: np.ndarray) -> np.ndarray:
        """Poses (M, 4, 4) by a parabola through the nine around each time. Poses between two noisy
        ones have less noise than these, so that a fit of the delay would stop at such places."""
        n = min(_AROUND, len(self.times))
        first = np.clip(np.searchsorted(self.times, times) - n // 2, 0, len(self.times) - n)
        near = first[:, None] + np.arange(n)
        x = (self.times[near] - times[:, None]) / np.median(np.diff(self.times))
        weight = np.exp(-0.5 * (x / _WIDTH) ** 2) + 1e-9
        powers = x[..., None] ** np.arange(min(3, n))
        normal = np.einsum("mi,mia,mib->mab", weight, powers, powers)
        share = np.linalg.solve(normal, (weight[..., None] * powers).transpose(0, 2, 1))[:, 0]
        return _rigid(np.einsum("mn,mnij->mij", share, self.matrices[near]))


def _rigid(mixed: np.ndarray) -> np.ndarray:
    """With the nearest rotations."""
    left, _, right = np.linalg.svd(mixed[:, :3, :3])
    mixed[:, :3, :3] = left @ right
    return mixed


class WireFit(NamedTuple):
    """matrix (4, 4) probe_from_image; change: of the offset, s; weights (F, 3K) of the dots, from
    0; parameters (9,): eight of `matrix_of`, and the change; covariance (9, 9) of these; delays
    (D,) s: the change by draws of parts of the recording; slip: the first image after which the
    phantom lies elsewhere, mm, degrees, or None; halves: change and deviation, s, of the
    recording's halves, and of_halves their parameters; registered (6,): how far the fit moves the
    phantom, mm and radians about the middle of its wires, and registered_covariance (6, 6) of these."""

    matrix: np.ndarray
    change: float
    weights: np.ndarray
    parameters: np.ndarray
    covariance: np.ndarray
    delays: np.ndarray
    slip: tuple[int, float, float] | None
    halves: tuple[tuple[float, float], ...]
    of_halves: tuple[np.ndarray, ...]
    registered: np.ndarray
    registered_covariance: np.ndarray
    matrix_of: Callable[[np.ndarray], np.ndarray]

    def expected(self, pixels: np.ndarray) -> np.ndarray:
        """(K,) mm: expected error (1 sigma) of pixels (K, 2)."""
        return np.maximum(np.sqrt(self._sizes(pixels).sum(axis=1)), self.apart(pixels) / 2)

    def apart(self, pixels: np.ndarray) -> np.ndarray:
        """(K,) mm: how far the recording's halves place pixels (K, 2) from each other."""
        first, second = (self.matrix_of(p) for p in self.of_halves)
        seen = np.column_stack([pixels, np.zeros(len(pixels)), np.ones(len(pixels))])
        return np.linalg.norm(seen @ (first - second)[:3].T, axis=1)

    def _sizes(self, pixels: np.ndarray) -> np.ndarray:
        """(K, 3) mm²: variances along the main axes."""
        seen = np.column_stack([pixels, np.zeros(len(pixels)), np.ones(len(pixels))])
        slope = _slopes(lambda p: seen @ self.matrix_of(p)[:3].T, self.parameters[:8], _STEPS[:8])
        return np.linalg.eigvalsh(slope @ self.covariance[:8, :8] @ slope.transpose(0, 2, 1)).clip(1e-12)

    def within(self, pixels: np.ndarray) -> np.ndarray:
        """(K,) mm: how far pixels (K, 2) are off at most, in 95 % of such calibrations. Halves have
        twice the variance, and their difference twice the deviation, of the whole; where a reference
        or a tracker drifts, they differ more than the model knows."""
        from scipy.special import fdtri

        size = self._sizes(pixels)
        total, squares = size.sum(axis=1), (size**2).sum(axis=1)
        # A sum of squares of normal numbers as a scaled chi-squared one (Satterthwaite 1946), of a
        # covariance that the parts of the recording tell.
        model = np.sqrt(total * fdtri(total**2 / squares, _BLOCKS - 1, 0.95))
        return np.maximum(model, self.apart(pixels))


def registration_information(phantom: NWirePhantom) -> np.ndarray:
    """(6, 6) inverse covariance of the registration's error: a shift, mm, and a turn, radians,
    about the middle of the wires. If the error of each landmark is known, it follows from these;
    else the wires' middle and what lies 20 mm away are known to the phantom's error."""
    of_marks = phantom.landmark_error is not None
    marks = np.array(list(phantom.landmarks.values()) if of_marks else []).reshape(-1, 3)
    off = marks - phantom.wires.reshape(-1, 3).mean(axis=0)
    turned = np.cross(np.eye(3), off[:, None]).transpose(0, 2, 1).reshape(-1, 3)
    moved = np.column_stack([np.tile(np.eye(3), (len(off), 1)), turned])
    if len(marks) < 3 or np.linalg.matrix_rank(moved, tol=1.0) < 6:
        moved, of_marks = np.diag([1, 1, 1, 20.0, 20, 20]), False
    size = phantom.landmark_error if of_marks and phantom.landmark_error else phantom.error
    deviation = max(size, 1e-3) / np.sqrt(3)
    return moved.T @ moved / deviation**2


def misplaced(fit: WireFit, phantom: NWirePhantom) -> tuple[float, float] | None:
    """How far the phantom lies from its registration, mm and degrees, by a fit in which it is free
    to move (`free`); None where that fit does not tell, or where the stated error explains it."""
    moved, own = fit.registered, fit.registered_covariance
    size = np.array([1, 1, 1, _REACH, _REACH, _REACH])
    if (np.sqrt(np.diag(own)) * size).max() > _UNTOLD:
        return None
    stated = np.linalg.inv(registration_information(phantom))
    if moved @ np.linalg.solve(stated + own, moved) < _MISPLACED:
        return None
    return float(np.linalg.norm(moved[:3])), float(np.degrees(np.linalg.norm(moved[3:])))


def free(phantom: NWirePhantom) -> NWirePhantom:
    """The phantom with a registration of which hardly anything is known."""
    return dataclasses.replace(phantom, error=_FREE, landmark_error=None)


def fit_wires(
    points: np.ndarray, times: np.ndarray, tracked: Poses, phantom: NWirePhantom, start: Start,
    offset: float, change: float = 0.0,
) -> WireFit:  # fmt: skip
    """Fit the calibration and the delay to dots (F, 3K, 2) of images at times (F,), from a start
    and a change of the offset near the right ones."""
    n_images, n_wires = points.shape[:2]
    ends = phantom.wires.reshape(-1, 3)
    middle = ends.mean(axis=0)
    raw = tracked.at(times + offset)[0]
    own = np.linalg.inv(tracked.smooth(times + offset)) @ raw  # the part that is noise, or a jerk

    def residuals(p: np.ndarray) -> np.ndarray:
        """(F, 6K) pixels, of nine parameters and the registration's six."""
        poses = tracked.smooth(times + offset + p[8]) @ own if p[8] else raw
        seen = np.linalg.inv(start.matrix(p)) @ np.linalg.inv(poses) @ phantom.reference_from_phantom
        moved = (ends - middle) @ turn_by(p[12:]).T + middle + p[9:12]
        return (cuts(seen, moved) - points).reshape(n_images, -1)

    prior = np.zeros((_N + 6, _N + 6))
    prior[8, 8], prior[_N:, _N:] = _DELAY**-2, registration_information(phantom)
    p = np.zeros(_N + 6)
    p[8] = change
    spread, noise = np.diag([0.3] * 3 + [0.005] * 3) ** 2, np.ones(2)  # of poses, mm and radians; of dots, pixels
    of_pose, of_dot, alike = np.ones(n_images), np.ones((n_images, n_wires)), 1.0
    for _ in range(_ROUNDS):
        before = p.copy()
        x = _slopes(residuals, p, np.append(_STEPS, [1e-4] * 6))
        j, r = x[:, :, _N:], residuals(p)
        for _ in range(_INNER):
            d = (of_dot[:, :, None] / noise**2).reshape(n_images, -1, 1)
            dx, dj = d * x, (d * j).transpose(0, 2, 1)
            inner = np.linalg.inv(of_pose[:, None, None] * np.linalg.inv(spread) + dj @ j)
            across = dj @ x
            share = across.transpose(0, 2, 1) @ inner
            information = (dx.transpose(0, 2, 1) @ x - share @ across) / alike
            slope = (np.einsum("fap,fa->fp", dx, r) - np.einsum("fpi,fia,fa->fp", share, dj, r)) / alike
            total = information.sum(axis=0) + prior
            step = -np.linalg.solve(total, slope.sum(axis=0) + prior @ p)
            p = p + step
            r = r + x @ step
            shift = -np.einsum("fij,fja,fa->fi", inner, dj, r)
            left = r + np.einsum("fai,fi->fa", j, shift)
            unsure = np.einsum("fai,fij,faj->fa", j, inner, j)
            size = (left**2 + unsure).reshape(n_images, n_wires, 2)
            far = np.einsum("fi,ij,fj->f", shift, np.linalg.inv(spread), shift)
            far += np.einsum("ij,fij->f", np.linalg.inv(spread), inner)
            of_dot = (_TAILS + 2) / (_TAILS + (size / noise**2).sum(axis=2))
            of_pose = (_TAILS + 6) / (_TAILS + far)
            # Six variances: the few independent errors of poses do not tell how these correlate.
            size_of_pose = shift**2 + inner.diagonal(axis1=1, axis2=2)
            spread = np.diag((of_pose[:, None] * size_of_pose).mean(axis=0))
            noise = np.sqrt((of_dot[:, :, None] * size).mean(axis=(0, 1))) + 1e-6
        alike = _alike(shift)
        if (np.abs(p - before) <= 0.02 * np.sqrt(np.diag(np.linalg.inv(total))) + 1e-9).all():
            break
    slope = slope + np.einsum("fpq,q->fp", information, step)
    block = np.arange(n_images) * _BLOCKS // n_images
    parts = [(information[block == b].sum(axis=0), slope[block == b].sum(axis=0)) for b in range(_BLOCKS)]
    steady = (dx.transpose(0, 2, 1) - share @ dj).sum(axis=0) / alike  # (P, 6K): what moves all dots of a wire does
    covariance = _covariance(parts, total, prior, p) + _of_wires(left, noise, steady, total)
    halves = [parts[: _BLOCKS // 2], parts[_BLOCKS // 2 :]]
    delays = [_drawn(half, prior, p) for half in halves]
    of_halves = tuple(p - _solved(half, prior, p) for half in halves)
    of_delays = tuple((float(np.median(one)), float(one.std())) for one in delays)
    return WireFit(
        start.matrix(p), float(p[8]), np.where(of_dot < 0.1, 0, of_dot), p[:_N], covariance[:_N, :_N],
        _drawn(parts, prior, p), _slip(shift), of_delays, of_halves, p[_N:], covariance[_N:, _N:], start.matrix,
    )  # fmt: skip


def _alike(shift: np.ndarray) -> float:
    """How many images in a row count as one: 1 + 2 times the sum of the autocorrelations of the
    errors of poses (F, 6), up to the first that is noise."""
    n = len(shift)
    z = (shift - shift.mean(axis=0)) / np.maximum(shift.std(axis=0), 1e-12)
    found = 1.0
    for lag in range(1, n // 2):
        correlation = float((z[:-lag] * z[lag:]).sum() / (n * z.shape[1]))
        if correlation < n**-0.5:
            break
        found += 2 * correlation
    return min(found, max(n / _FEWEST_PARTS, 1.0))


def _slip(shift: np.ndarray) -> tuple[int, float, float] | None:
    """Where errors of poses (F, 6) have a step: the first image after it, mm and degrees. Noise, drift
    and a delay that changes have none."""
    n, best = len(shift), (_SLIP, 0)
    for k in range(_FEWEST_BESIDE, n - _FEWEST_BESIDE + 1):
        means = shift[:k].mean(axis=0), shift[k:].mean(axis=0)
        rest = np.concatenate([shift[:k] - means[0], shift[k:] - means[1]])
        of_step = (rest**2).sum(axis=0) / (n - 2) * (1 / k + 1 / (n - k))
        best = max(best, (float(((means[1] - means[0]) ** 2 / of_step).sum()) / _alike(rest), k))
    k = best[1]
    step = shift[k:].mean(axis=0) - shift[:k].mean(axis=0) if k else np.zeros(6)
    moved, turned = (float(np.linalg.norm(part)) for part in (step[:3], step[3:]))
    return (k, moved, float(np.degrees(turned))) if moved + _REACH * turned > _LEAST_SLIP else None


def _of_wires(left: np.ndarray, noise: np.ndarray, steady: np.ndarray, total: np.ndarray) -> np.ndarray:
    """(P, P) covariance by dots that lie off their wires in the same way in all images: as far as
    residuals (F, 6K), pixels, do on average (a consider covariance, Schmidt 1966)."""
    off = left.mean(axis=0)
    free = max(len(off) - _FITTED, 1)
    size = np.sqrt(max((off**2).sum() / free - (noise**2).mean() / len(left), 0.0))
    effect = np.linalg.solve(total, steady) * size
    return effect @ effect.T


def _covariance(parts: list, total: np.ndarray, prior: np.ndarray, p: np.ndarray) -> np.ndarray:
    """That of the model, or where larger, that of parts taken as independent (White 1980)."""
    inverse = np.linalg.inv(total)
    mean = prior @ p / len(parts)
    scores = np.array([slope + mean for _, slope in parts])
    found = inverse @ (scores.T @ scores + prior) @ inverse
    grow = np.sqrt(np.maximum(np.diag(found) / np.diag(inverse), 1))
    return inverse * grow[:, None] * grow


def _drawn(parts: list, prior: np.ndarray, p: np.ndarray) -> np.ndarray:
    """Changes of the offset by parts drawn with repetition (bootstrap, Efron 1979), each by one
    step from the fit of all."""
    rng = np.random.default_rng(0)
    found = []
    for _ in range(_DRAWS):
        drawn = [parts[k] for k in rng.integers(0, len(parts), len(parts))]
        found.append(p[8] - _solved(drawn, prior, p)[8])
    return np.array(found)


def _solved(parts: list, prior: np.ndarray, p: np.ndarray) -> np.ndarray:
    """The step from the fit of all to that of these parts, with its sign turned."""
    total, slope = (sum(part[k] for part in parts) for k in (0, 1))
    return np.linalg.solve(total + prior, slope + prior @ p)


def cuts(seen: np.ndarray, ends: np.ndarray) -> np.ndarray:
    """(F, 3K, 2) pixels where wires of these ends (6K, 3), mm, cut the images; seen (F, 4, 4):
    image from phantom."""
    places = np.einsum("fij,kj->fki", seen[:, :3, :3], ends) + seen[:, None, :3, 3]
    front, back = places[:, ::2], places[:, 1::2]
    share = front[..., 2] / (front[..., 2] - back[..., 2])
    return (front + share[..., None] * (back - front))[..., :2]


def _slopes(function: Callable[[np.ndarray], np.ndarray], p: np.ndarray, steps: np.ndarray) -> np.ndarray:
    found = []
    for i in range(len(p)):
        change = np.zeros(len(p))
        change[i] = steps[i]
        found.append((function(p + change) - function(p - change)) / (2 * steps[i]))
    return np.stack(found, axis=-1)
