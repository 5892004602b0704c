"""Which pixels the PLUS toolkit inserts: clip rectangle, fan, and its own slips."""

from __future__ import annotations

import math

import numpy as np

from .config import PlusConfig

TWICE = 1 << 30


def pixel_sources(
    config: PlusConfig, shape: tuple[int, int], angles: tuple[float, float], importance: np.ndarray | None
) -> np.ndarray:
    """For each image position the pixel that PLUS inserts there.

    Args:
        shape: (H, W) of a frame.
        angles: the fan's, degrees; both 0: no fan.
        importance: (H, W) uint8 where importance masks are compounded.

    Returns:
        (H, W) int32: flat pixel index; -1 where the pixel is left out; TWICE added where it is
        inserted twice.
    """
    if config.optimization == "NONE":
        inside = _unoptimized(config, shape, angles)
        index = np.arange(inside.size, dtype=np.int32).reshape(shape)
        return np.where(inside, index, np.int32(-1))
    sources = np.full(shape, -1, np.int32)
    runs = [_row_runs(config, shape, angles, y) for y in range(shape[0])]
    if config.compounding == "IMPORTANCE_MASK" and config.interpolation == "NEAREST_NEIGHBOR":
        assert importance is not None
        _slipping(sources, runs, importance)
        return sources
    width = shape[1]
    for y, (segments, _) in enumerate(runs):
        for start, end in segments:
            here = slice(max(start, 0), max(end + 1, 0))
            row = np.arange(width, dtype=np.int32)[here] + y * width
            sources[y, here] = np.where(sources[y, here] >= 0, row | TWICE, row)
    return sources


def _clip(config: PlusConfig, shape: tuple[int, int]) -> tuple[int, int, int, int]:
    """First and last column and row inside the clip rectangle; PLUS counts its far edge in."""
    h, w = shape
    (x, y), (dx, dy) = config.clip_origin, config.clip_size
    if dx <= 0 or dy <= 0:
        return 0, w - 1, 0, h - 1
    return max(x, 0), min(x + dx, w - 1), max(y, 0), min(y + dy, h - 1)


def _ratios(angles: tuple[float, float]) -> tuple[float, float]:
    """Columns a row that the fan's sides move, left one first."""
    a, b = (math.tan(v * 0.017453292519943295) for v in angles)
    return min(a, b), max(a, b)


def _floor(x: float) -> int:
    """PLUS' floor: of x rounded to a multiple of 2^-16."""
    return int(x + 103079215104.0) - 103079215104


def _ceil(x: float) -> int:
    return -_floor(-x)


def _unoptimized(config: PlusConfig, shape: tuple[int, int], angles: tuple[float, float]) -> np.ndarray:
    """(H, W) bool, the test per pixel of optimisation NONE."""
    x0, x1, y0, y1 = _clip(config, shape)
    j, i = np.indices(shape)
    inside = (i >= x0) & (i <= x1) & (j >= y0) & (j <= y1)
    left, right = _ratios(angles)
    if left == 0 and right == 0:
        return inside
    x, y = i - config.fan_origin[0], j - config.fan_origin[1]
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = x / y
    outside = (y < 0) | (ratio < left) | (ratio > right)
    d2 = x * x + y * y
    outside |= (d2 < config.fan_start**2) | (d2 > config.fan_stop**2)
    return inside & ~outside


def _row_runs(
    config: PlusConfig, shape: tuple[int, int], angles: tuple[float, float], row: int
) -> tuple[list[tuple[int, int]], tuple[int, int]]:
    """Columns that optimisations PARTIAL and FULL insert in a row: one or two runs (first, last),
    and the run that both lie in."""
    w = shape[1]
    x0, x1, y0, y1 = _clip(config, shape)
    start, end = 0, w - 1
    gap = None
    left, right = _ratios(angles)
    if left != 0 or right != 0:
        cx, y = config.fan_origin[0], row - config.fan_origin[1]
        start = max(start, _ceil(left * y + cx + 1))
        end = min(end, _floor(right * y + cx - 1))
        stop2 = config.fan_stop**2 - y * y
        if stop2 < 0:
            start, end = 0, -1
        else:
            d = math.sqrt(stop2)
            start = max(start, _ceil(cx - d + 1))
            end = min(end, _floor(cx + d - 1))
            start2 = config.fan_start**2 - y * y
            if start2 > 0:
                d = math.sqrt(start2)
                gap = _ceil(cx - d + 1), _floor(cx + d - 1)
    start, end = max(start, x0), min(end, x1)
    if start > end or row < y0 or row > y1:
        start, end = 0, -1
    if gap is not None:
        first, last = gap
        if first < start:
            if start < last + 1:
                start, end = last + 1, max(end, last)
            gap = None
        elif last > end:
            if end > first - 1:
                end = max(first, start) - 1
            gap = None
    if gap is not None:
        return [(start, gap[0] - 1), (gap[1] + 1, end)], (start, end)
    return [(start, end)], (start, end)


def _slipping(sources: np.ndarray, runs: list, importance: np.ndarray) -> None:
    """Nearest neighbor with an importance mask, optimised: PLUS leaves a run at the first pixel of
    importance 0 without moving its read position to the run's end, so that all later pixels of
    the frame are read too early."""
    width = sources.shape[1]
    flat = importance.ravel()
    position = 0
    for y, (segments, (start, end)) in enumerate(runs):
        position += max(start, 0)
        for k, (first, last) in enumerate(segments):
            if k:
                position += first - segments[0][1] - 1
            for x in range(first, last + 1):
                if position >= flat.size or flat[position] == 0:
                    break
                sources[y, x] = position
                position += 1
        position += max(width - 1 - end, 0)
