"""Straight echoes in images: the bottom of a water tank, a membrane, a plane reflector."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

_COLUMNS = 64  # columns of an image that are searched
_LIT = 0.25  # a column counts from this share of the image's brightest echo
_TOLERANCE = 0.01  # of the image's height: distance from the line up to which an echo is on it
_AGREEING = 0.6  # share of the lit columns that must be on the line
_SHORTEST = 0.15  # of the image's width
_STATIC = 32  # images whose median is what does not move


class Lines(NamedTuple):
    """A line in each of F images: row = row[i] + slope[i] · (column - middle).

    found (F,) bool; row, slope (F,), NaN where not found; residual (F,) rms distance of the echoes
    from it, pixels; middle: column half way across the echoes; span: their columns, from and to.
    """

    found: np.ndarray
    row: np.ndarray
    slope: np.ndarray
    residual: np.ndarray
    middle: float
    span: tuple[float, float]

    def at(self, column: float) -> np.ndarray:
        """(F,) rows at a column, NaN where no line was found."""
        return self.row + self.slope * (column - self.middle)


def find_lines(frames: Any) -> Lines:
    """Find the straight echo that moves from image to image.

    frames   (F, H, W). What is in most of the images at the same place (the probe's face, text) is
             subtracted first.

    In each of 64 columns the brightest echo is a candidate. The line through two candidates that
    has the most others within 1 % of the height is fitted to these by least squares (exhaustive
    RANSAC, Fischler and Bolles 1981). A line counts if 60 % of the lit columns agree.
    """
    frames = np.asarray(frames)
    n, _, width = frames.shape
    columns = np.unique(np.linspace(0, width - 1, min(_COLUMNS, width)).round().astype(int))
    seen = frames[:, :, columns].astype(np.float32)
    static = np.median(seen[np.unique(np.linspace(0, n - 1, _STATIC).astype(int))], axis=0)
    row, slope, residual = np.full((3, n), np.nan)
    on_lines = []
    for i, image in enumerate(seen):
        line = _line(np.maximum(image - static, 0), columns.astype(float), width)
        if line is not None:
            row[i], slope[i], residual[i], used = line
            on_lines.append(used)
    found = np.isfinite(row)
    if not on_lines:
        return Lines(found, row, slope, residual, (width - 1) / 2, (0.0, width - 1.0))
    first, last = np.percentile(np.concatenate(on_lines), [1, 99])
    middle = float(first + last) / 2
    return Lines(found, row + slope * middle, slope, residual, middle, (float(first), float(last)))


def _line(image: np.ndarray, columns: np.ndarray, width: int) -> Any:
    """Row at column 0, slope, rms residual and the columns used; None without a line."""
    height = len(image)
    smooth = np.zeros_like(image)
    smooth[2:-2] = sum(image[2 + d : height - 2 + d] for d in (-2, -1, 0, 1, 2))
    peak = smooth.max(axis=0)
    lit = peak > _LIT * peak.max(initial=0)
    if lit.sum() < 8:
        return None
    c, top = columns[lit], smooth[:, lit].argmax(axis=0)
    around = np.clip(top + np.arange(-4, 5)[:, None], 0, height - 1)
    weight = image[around, np.flatnonzero(lit)] + 1e-9
    r = (weight * around).sum(axis=0) / weight.sum(axis=0)
    i, j = np.triu_indices(len(c), 1)
    far = c[j] - c[i] >= _SHORTEST * width / 2
    i, j = i[far], j[far]
    if not len(i):
        return None
    slopes = (r[j] - r[i]) / (c[j] - c[i])
    off = np.abs(r - (r[i] - slopes * c[i])[:, None] - slopes[:, None] * c)
    tolerance = max(_TOLERANCE * height, 1.5)
    on = off[(off < tolerance).sum(axis=1).argmax()] < tolerance
    if on.sum() < max(8, _AGREEING * len(c)) or np.ptp(c[on]) < _SHORTEST * width:
        return None
    slope, start = np.polyfit(c[on], r[on], 1)
    rms = float(np.sqrt(np.mean((r[on] - start - slope * c[on]) ** 2)))
    return start, slope, rms, c[on]
