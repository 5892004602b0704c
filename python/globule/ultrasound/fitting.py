"""Robust least squares with the covariance of what is fitted."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

_TUKEY = 4.685  # 95 % efficiency for normal noise
_STEPS = 100
_FAR = 1e100


class Fit(NamedTuple):
    """The result of `robust_fit`.

    parameters   (P,)
    residuals    (N, k)
    weights      (N,) from 0, an outlier, to 1
    sigma        standard deviation of a residual, without outliers
    covariance   (P, P) of the parameters
    jacobian     (N, k, P) of the residuals
    """

    parameters: np.ndarray
    residuals: np.ndarray
    weights: np.ndarray
    sigma: float
    covariance: np.ndarray
    jacobian: np.ndarray


def robust_fit(
    function: Callable[[np.ndarray], np.ndarray], start: np.ndarray, robust: bool = True,
    groups: np.ndarray | None = None, floor: float = 1e-9, tuning: float = _TUKEY,
) -> Fit:  # fmt: skip
    """Fit parameters so that `function` of them, residuals (N, k), gets small.

    Least squares with numerical derivatives are reweighted iteratively: an observation's weight is
    Tukey's biweight of the length of its residual, in units of a scale from the median (Holland and
    Welsch 1977). The covariance is the sandwich estimator (White 1980), so that observations need
    not have the same noise; those of one group (N,) may be correlated.

    floor    smallest scale of residuals
    tuning   of the biweight, in scales; larger for residuals that are not normal
    """
    parameters = np.array(start, np.float64)
    residuals = function(parameters)
    n, k = residuals.shape
    p = len(parameters)
    weights = np.ones(n)
    if robust:  # from absolute values, which large outliers pull less
        for _ in range(10):
            length = np.linalg.norm(residuals, axis=1)
            size = max(float(np.median(length)), floor)
            new = size / np.maximum(length, 0.1 * size)
            done = np.abs(new - weights).max() < 0.01
            weights = new
            parameters, residuals = _minimized(function, parameters, weights, 2)
            if done:
                break
        for _ in range(30):
            length = np.linalg.norm(residuals, axis=1)
            scale = max(float(np.median(length)) / _MEDIAN[k] / np.sqrt(1 - p / (n * k)), floor)
            ratio = length / (tuning * np.sqrt(k) * scale)
            new = np.where(ratio < 1, (1 - ratio**2) ** 2, 0.0)
            if new.sum() * k <= p:
                break
            done = np.abs(new - weights).max() < 1e-3
            weights = new
            parameters, residuals = _minimized(function, parameters, weights, 2)
            if done:
                break
    parameters, residuals = _minimized(function, parameters, weights, _STEPS)
    jacobian = numerical_jacobian(function, parameters)
    free = max(k * weights.sum() - p, 1.0)
    sigma = float(np.sqrt((weights * (residuals**2).sum(axis=1)).sum() / free))
    inner = np.linalg.pinv(np.einsum("n,nkp,nkq->pq", weights, jacobian, jacobian), rcond=1e-14)
    # HC3 (MacKinnon and White 1985): each residual as if its observation had been left out.
    hat = weights[:, None, None] * (jacobian @ inner @ jacobian.transpose(0, 2, 1))
    without = np.linalg.solve(np.eye(k) * (1 + 1e-9) - hat, residuals[:, :, None])[:, :, 0]
    scores = weights[:, None] * np.einsum("nk,nkp->np", without, jacobian)
    if groups is not None:
        scores = np.stack([scores[groups == g].sum(axis=0) for g in np.unique(groups)])
    covariance = inner @ (scores.T @ scores) @ inner
    plain = sigma**2 * inner
    # The sandwich is noisy where there are few observations; never say less than the plain one.
    grow = np.sqrt(np.maximum(np.diag(plain) / np.maximum(np.diag(covariance), 1e-300), 1))
    covariance = covariance * grow[:, None] * grow
    return Fit(parameters, residuals, weights, sigma, covariance, jacobian)


_MEDIAN = {1: 0.6745, 2: 1.1774, 3: 1.5382}  # median length of k standard normal numbers


def _minimized(
    function: Callable[[np.ndarray], np.ndarray], parameters: np.ndarray, weights: np.ndarray,
    most: int,
) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    from scipy.optimize import least_squares

    root = np.sqrt(weights)[:, None]

    def weighted(p: np.ndarray) -> np.ndarray:
        # A step to where residuals are not finite is taken back.
        return np.nan_to_num(root * function(p), nan=_FAR, posinf=_FAR, neginf=-_FAR).ravel()

    enough = len(weighted(parameters)) >= len(parameters)
    found = least_squares(
        weighted, parameters, method="lm" if enough else "trf", x_scale="jac",
        ftol=1e-10, xtol=1e-12, gtol=1e-14, max_nfev=(most + 1) * (len(parameters) + 1),
    ).x  # fmt: skip
    return found, function(found)


def numerical_jacobian(function: Callable[[np.ndarray], np.ndarray], parameters: np.ndarray) -> np.ndarray:
    """(N, k, P): slopes of residuals (N, k), by central differences."""
    slopes = []
    for i, value in enumerate(parameters):
        step = 1e-6 * max(abs(value), 1.0)
        ahead, behind = parameters.copy(), parameters.copy()
        ahead[i], behind[i] = value + step, value - step
        slopes.append((function(ahead) - function(behind)) / (2 * step))
    return np.stack(slopes, axis=-1)
