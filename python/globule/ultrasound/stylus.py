"""A stylus and what it touches: its tip by pivoting, a phantom's place by landmarks."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from .._base.checks import numeric
from .._base.files import atomic_write
from .calibration import turn_by
from .fitting import Fit, robust_fit
from .plus_setup import write_plus

if TYPE_CHECKING:
    from numpy.typing import ArrayLike


class Pivot(NamedTuple):
    """The result of a pivot calibration.

    tip         (3,) mm, in the stylus's frame
    pivot       (3,) mm, in the reference's frame: the point around which the stylus turned
    rms         mm, of the residuals, without outliers
    error       mm, expected (1 sigma) of the tip
    residuals   (N, 3) mm
    weights     (N,) from 0, an outlier, to 1
    turn        degrees: the largest angle between two poses
    """

    tip: np.ndarray
    pivot: np.ndarray
    rms: float
    error: float
    residuals: np.ndarray
    weights: np.ndarray
    turn: float


class Registration(NamedTuple):
    """The result of a landmark registration.

    matrix      (4, 4) reference from phantom, mm
    rms         mm, of the residuals (fiducial registration error), without outliers
    error       mm, expected (1 sigma) at the worst of the targets (target registration error)
    bound       mm, that the error at the worst of the targets stays below in 95 % of such registrations
    residuals   (N,) mm
    weights     (N,) from 0, an outlier, to 1
    """

    matrix: np.ndarray
    rms: float
    error: float
    bound: float
    residuals: np.ndarray
    weights: np.ndarray


def calibrate_stylus(reference_from_stylus: ArrayLike, most_error: float | None = 1.0) -> Pivot:
    """Find a stylus's tip from poses (N, 4, 4), N >= 10, while it turns about its resting tip.

    Every pose maps the tip to one point: R tip + t = pivot. Linear least squares start a robust
    fit (Yaniv 2015, algebraic one step). Raises ValueError if the stylus does not turn about two
    axes, or if the expected error is above most_error, mm (None: any).
    """
    poses = _rows("reference_from_stylus", reference_from_stylus, (4, 4), 10)
    rotations, offsets = poses[:, :3, :3], poses[:, :3, 3]
    design = np.concatenate([rotations, np.tile(-np.eye(3), (len(poses), 1, 1))], axis=2)
    start, _, _, sizes = np.linalg.lstsq(design.reshape(-1, 6), -offsets.ravel(), rcond=None)
    turn = _largest_turn(rotations)
    advice = f"turn the stylus to all sides about its resting tip (it turned by {turn:.1f} degrees)"
    if sizes[-1] < 1e-6 * sizes[0]:
        raise ValueError(f"poses: expected rotations about two axes or more; {advice}")

    def residuals(parameters: np.ndarray) -> np.ndarray:
        return rotations @ parameters[:3] + offsets - parameters[3:]

    n = len(poses)
    groups = np.arange(n) * min(n, 12) // n  # neighbors in time share the tracker's errors
    fit = robust_fit(residuals, start, groups=groups if n >= 60 else None)
    error = float(np.sqrt(np.trace(fit.covariance[:3, :3])))
    if most_error is not None and error > most_error:
        raise ValueError(
            f"poses: expected an error of the tip of at most {most_error:g} mm, got {error:.2g} mm (1 sigma); {advice}"
        )
    return Pivot(fit.parameters[:3], fit.parameters[3:], _rms(fit), error, fit.residuals, fit.weights, turn)


def register_landmarks(
    phantom_points: ArrayLike, reference_points: ArrayLike, targets: ArrayLike | None = None
) -> Registration:
    """Find where a phantom is from N >= 3 of its landmarks, touched with a calibrated stylus.

    Args:
        phantom_points: (N, 3) mm, in the phantom's frame.
        reference_points: (N, 3) mm, of the tip, in the reference's frame.
        targets: (M, 3) mm, phantom: where the expected error counts, for example the wires' ends;
            default: the landmarks.

    A rotation and a translation (Arun et al. 1987) start a robust fit, which finds wrong landmarks; the others
    count alike. Raises ValueError for landmarks on a line.
    """
    phantom = _rows("phantom_points", phantom_points, (3,), 3)
    reference = _rows("reference_points", reference_points, (3,), 3)
    if len(phantom) != len(reference):
        raise ValueError(f"reference_points: expected {len(phantom)}, got {len(reference)}")
    from scipy.spatial.transform import Rotation

    middle, center = phantom.mean(axis=0), reference.mean(axis=0)
    spreads = [np.linalg.svd(p - p.mean(axis=0), compute_uv=False) for p in (phantom, reference)]
    if spreads[0][1] < 0.02 * spreads[0][0] or spreads[1][1] <= 0:
        raise ValueError("phantom_points: expected landmarks in a plane or in space, got a line")
    turned = Rotation.align_vectors(reference - center, phantom - middle)[0].as_matrix()

    def places(parameters: np.ndarray, points: np.ndarray) -> np.ndarray:
        about = turn_by(parameters[:3]) @ turned
        return (points - middle) @ about.T + center + parameters[3:]

    fit = robust_fit(lambda p: places(p, phantom) - reference, np.zeros(6))
    kept = fit.weights > 0
    if kept.sum() < 3:
        raise ValueError("reference_points: expected landmarks that fit together, got none")
    exact = robust_fit(lambda p: places(p, phantom[kept]) - reference[kept], fit.parameters, robust=False)
    # Few residuals tell their noise badly: Student's t. A landmark that was left out took a residual with it.
    squares = float((exact.residuals**2).sum())
    free = max(3 * int(kept.sum()) - 6 - int((~kept).sum()), 1)
    unit = np.linalg.pinv(np.einsum("nkp,nkq->pq", exact.jacobian, exact.jacobian), rcond=1e-14)
    covariance = squares / free * unit
    where = phantom if targets is None else _rows("targets", targets, (3,), 1)
    slopes = []
    for i in range(6):
        step = np.zeros(6)
        step[i] = 1e-5
        ahead, behind = places(exact.parameters + step, where), places(exact.parameters - step, where)
        slopes.append((ahead - behind) / 2e-5)
    slope = np.array(slopes)
    spread = np.einsum("pkx,pq,qky->kxy", slope, covariance, slope)
    variance = np.einsum("kxx->k", spread)
    matrix = np.eye(4)
    matrix[:3, :3] = turn_by(exact.parameters[:3]) @ turned
    matrix[:3, 3] = places(exact.parameters, np.zeros((1, 3)))[0]
    residuals = np.linalg.norm(places(exact.parameters, phantom) - reference, axis=1)
    return Registration(
        matrix, float(np.sqrt(squares / kept.sum())), float(np.sqrt(variance.max())),
        float(np.sqrt((variance * _quantile(spread, free)).max())), residuals, fit.weights,
    )  # fmt: skip


def _quantile(spread: np.ndarray, free: int) -> np.ndarray:
    """Of the squared length of errors with covariances (K, 3, 3), in units of their traces, what 95 % stay below:
    of F, with as many directions as count (Satterthwaite). 97 % of one target are 95 % of the worst of all."""
    from scipy.special import fdtri

    squares = np.einsum("kxy,kyx->k", spread, spread)
    n = np.einsum("kxx->k", spread) ** 2 / np.maximum(squares, 1e-300)
    return fdtri(np.clip(n, 1, 3), free, 0.97)


def write_stylus(path: str | os.PathLike[str], pivot: Pivot) -> None:
    """Write a tip as TOML, or as the transform from StylusTip to Stylus of a PLUS configuration
    (.xml); every number survives exactly."""
    if os.fspath(path).lower().endswith(".xml"):
        matrix = np.eye(4)
        matrix[:3, 3] = pivot.tip
        key = ("StylusTip", "Stylus")
        write_plus(path, {key: matrix}, errors={key: pivot.error})
        return
    with atomic_write(path, "w") as file:
        file.write(
            f"stylus_tip = {pivot.tip.tolist()!r}  # mm, in the stylus's frame\n"
            f"rms = {pivot.rms!r}  # mm, of the residuals\n"
            f"error = {pivot.error!r}  # mm, expected, 1 sigma\n"
        )


def _rms(fit: Fit) -> float:
    used = fit.weights > 0
    return float(np.sqrt((fit.residuals[used] ** 2).sum(axis=1).mean()))


def _largest_turn(rotations: np.ndarray) -> float:
    from scipy.spatial.transform import Rotation

    thin = rotations[np.unique(np.linspace(0, len(rotations) - 1, 60).astype(int))]
    between = np.einsum("aji,bjk->abik", thin, thin).reshape(-1, 3, 3)
    return float(np.degrees(Rotation.from_matrix(between).magnitude().max()))


def _rows(name: str, value: Any, shape: tuple[int, ...], fewest: int) -> np.ndarray:
    """Finite numbers (N, *shape)."""
    rows = numeric(name, value)
    if rows.ndim == 0 or rows.shape[1:] != shape or len(rows) < fewest:
        expected = ", ".join(map(str, shape))
        raise ValueError(f"{name}: expected shape (N, {expected}), N >= {fewest}, got {rows.shape}")
    if not np.isfinite(rows).all():
        raise ValueError(f"{name}: expected finite numbers, got NaN or inf")
    return rows
