"""Gray values along a line, fitted by two edges of an object or by two bright echoes."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

_STEPS = 200
_SHARPEST = 0.5  # voxels: the least width of an edge or an echo


class Fit(NamedTuple):
    """between: "edges" or "echoes"; places (2,), mm along the line; levels (3,) gray levels, see
    `MeasuredDistance`; width, mm; values (N,): the fitted profile; slopes (N, 6): its derivatives
    by the parameters, those by the places in columns 3 and 4."""

    between: str
    places: np.ndarray
    levels: np.ndarray
    width: float
    values: np.ndarray
    slopes: np.ndarray


class _Edges:
    """Three levels q0, q1, q2 with edges at q3 and q4, as wide as q5."""

    name = "edges"

    @staticmethod
    def values(q: np.ndarray, t: np.ndarray) -> np.ndarray:
        first, second = ((1 + np.tanh((t - place) / q[5])) / 2 for place in q[3:5])
        return q[0] + (q[1] - q[0]) * first + (q[2] - q[1]) * second

    @staticmethod
    def slopes(q: np.ndarray, t: np.ndarray) -> np.ndarray:
        s1, s2 = (np.tanh((t - place) / q[5]) for place in q[3:5])
        steep = [(1 - s**2) / (2 * q[5]) for s in (s1, s2)]
        first, second = -(q[1] - q[0]) * steep[0], -(q[2] - q[1]) * steep[1]
        wide = (first * (t - q[3]) + second * (t - q[4])) / q[5]
        return np.column_stack(
            [1 - (1 + s1) / 2, (1 + s1) / 2 - (1 + s2) / 2, (1 + s2) / 2, first, second, wide]
        )

    @staticmethod
    def start(t: np.ndarray, profile: np.ndarray, edge: float) -> np.ndarray:
        """The best three constant pieces."""
        n = len(t)
        sums = np.r_[0, np.cumsum(profile)]
        i, j = np.triu_indices(n, 2)
        keep = (i >= 2) & (j <= n - 2)
        i, j = i[keep], j[keep]
        gain = (
            sums[i] ** 2 / i
            + (sums[j] - sums[i]) ** 2 / (j - i)
            + (sums[n] - sums[j]) ** 2 / (n - j)
        )
        k = int(np.argmax(gain))
        a, b = int(i[k]), int(j[k])
        levels = [profile[:a].mean(), profile[a:b].mean(), profile[b:].mean()]
        return np.array([*levels, t[a] - t[1] / 2, t[b] - t[1] / 2, edge])


class _Echoes:
    """Peaks of q0 and q2 over a ground of q1, at q3 and q4: Gaussians of the deviation q5."""

    name = "echoes"

    @staticmethod
    def values(q: np.ndarray, t: np.ndarray) -> np.ndarray:
        first, second = (np.exp(-0.5 * ((t - place) / q[5]) ** 2) for place in q[3:5])
        return q[1] + (q[0] - q[1]) * first + (q[2] - q[1]) * second

    @staticmethod
    def slopes(q: np.ndarray, t: np.ndarray) -> np.ndarray:
        z1, z2 = ((t - place) / q[5] for place in q[3:5])
        g1, g2 = np.exp(-0.5 * z1**2), np.exp(-0.5 * z2**2)
        first, second = (q[0] - q[1]) * g1 * z1 / q[5], (q[2] - q[1]) * g2 * z2 / q[5]
        return np.column_stack([g1, 1 - g1 - g2, g2, first, second, first * z1 + second * z2])

    @staticmethod
    def start(t: np.ndarray, profile: np.ndarray, edge: float) -> np.ndarray:
        """The highest peak, and the highest one behind a valley of half its height."""
        ground, a = float(np.median(profile)), int(np.argmax(profile))
        half = profile < (profile[a] + ground) / 2
        left = np.flatnonzero(half[:a])
        right = np.flatnonzero(half[a:])
        low = int(left[-1]) if len(left) else -1
        high = a + int(right[0]) if len(right) else len(t)
        outside = np.where(
            (np.arange(len(t)) <= low) | (np.arange(len(t)) >= high), profile, -np.inf
        )
        b = int(np.argmax(outside))
        a, b = min(a, b), max(a, b)
        width = max((high - low) * t[1] / 2.4, edge)
        return np.array([profile[a], ground, profile[b], t[a], t[b], width])


def fit_profile(t: np.ndarray, profile: np.ndarray, edge: float) -> Fit:
    """Fit a profile (N,) at t (N,), mm, from 0 in equal steps, by edges and by echoes, and take the
    one with the smaller residual. edge: mm, of a voxel.

    Echoes must be brighter than the ground between them, farther apart than two deviations, and as
    far from both ends.
    """
    fits = []
    for model in (_Edges, _Echoes):
        q, error = _least_squares(model, t, profile, edge)
        apart = np.diff([0, q[3], q[4], t[-1]]).min()
        if model is _Echoes and not (q[[0, 2]].min() > q[1] and apart > 2 * q[5]):
            continue
        fits.append((error, model, q))
    _, model, q = min(fits, key=lambda one: one[0])
    return Fit(model.name, q[3:5], q[:3], float(q[5]), model.values(q, t), model.slopes(q, t))


def _least_squares(
    model: Any, t: np.ndarray, profile: np.ndarray, edge: float
) -> tuple[np.ndarray, float]:
    """The parameters of a model by Levenberg and Marquardt, and the sum of squares."""
    q = model.start(t, profile, edge)
    damping, best = 1e-3, float(((profile - model.values(q, t)) ** 2).sum())
    for _ in range(_STEPS):
        slopes = model.slopes(q, t)
        normal = slopes.T @ slopes
        normal += np.diag(damping * np.diag(normal) + 1e-12)
        tried = q + np.linalg.solve(normal, slopes.T @ (profile - model.values(q, t)))
        tried[5] = np.clip(tried[5], _SHARPEST * edge, t[-1])
        error = float(((profile - model.values(tried, t)) ** 2).sum())
        if error < best:
            done = best - error < 1e-9 * best
            q, best, damping = tried, error, damping / 5
            if done:
                break
        else:
            damping *= 5
            if damping > 1e9:
                break
    return q, best
