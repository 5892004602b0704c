"""Gray values along a line, fitted by two edges of an object or by two bright echoes."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

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
    def start(t: np.ndarray, profile: np.ndarray, edge: float) -> np.ndarray:
        """The best three constant pieces."""
        n = len(t)
        sums = np.r_[0, np.cumsum(profile)]
        i, j = np.triu_indices(n, 2)
        keep = (i >= 2) & (j <= n - 2)
        i, j = i[keep], j[keep]
        gain = sums[i] ** 2 / i + (sums[j] - sums[i]) ** 2 / (j - i) + (sums[n] - sums[j]) ** 2 / (n - j)
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
    def start(t: np.ndarray, profile: np.ndarray, edge: float) -> np.ndarray:
        """The highest peak, and the highest one behind a valley of half its height."""
        ground, a = float(np.median(profile)), int(np.argmax(profile))
        half = profile < (profile[a] + ground) / 2
        left = np.flatnonzero(half[:a])
        right = np.flatnonzero(half[a:])
        low = int(left[-1]) if len(left) else -1
        high = a + int(right[0]) if len(right) else len(t)
        outside = np.where((np.arange(len(t)) <= low) | (np.arange(len(t)) >= high), profile, -np.inf)
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
    from scipy.optimize import least_squares

    sharpest = _SHARPEST * edge

    def parameters(q: np.ndarray) -> np.ndarray:
        return np.append(q[:5], np.hypot(q[5], sharpest))

    fits = []
    for model in (_Edges, _Echoes):
        start = model.start(t, profile, edge)
        start[5] = np.sqrt(max(start[5] ** 2 - sharpest**2, sharpest**2))
        found = least_squares(
            lambda q: model.values(parameters(q), t) - profile,  # noqa: B023  # called here only
            start, method="lm", x_scale="jac", ftol=1e-9,
        )  # fmt: skip
        q = parameters(found.x)
        apart = np.diff([0, q[3], q[4], t[-1]]).min()
        if model is _Echoes and not (q[[0, 2]].min() > q[1] and apart > 2 * q[5]):
            continue
        values = profile + found.fun
        fits.append((found.cost, Fit(model.name, q[3:5], q[:3], float(q[5]), values, found.jac)))
    return min(fits, key=lambda one: one[0])[1]
