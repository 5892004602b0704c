"""The PLUS toolkit's detection of the fan's angles from a frame's brightness."""

from __future__ import annotations

import math

import numpy as np

from .config import PlusConfig

_DEPTHS = (15, 30, 50, 70)  # percent of the way from the inner to the outer radius
_MARGIN = -3.0  # degrees


def detect_fan(config: PlusConfig, frame: np.ndarray) -> tuple[float, float] | None:
    """Angles of the widest bright sector on four arcs, degrees; None where the frame is dark."""
    if not 0 <= config.fan_start < config.fan_stop:
        got = f"{config.fan_start:g} and {config.fan_stop:g}"
        raise ValueError(f"fan: expected radii 0 <= start < stop to detect it, got {got}")
    low, high = (math.radians(v) for v in config.fan_angles)
    best = (0.0, 0.0)
    for k, percent in enumerate(_DEPTHS):
        radius = config.fan_start + (config.fan_stop - config.fan_start) * percent / 100
        sector = _widest(*_arc(config, frame, radius, low, high), config, high)
        if k == 0 or sector[1] - sector[0] > best[1] - best[0]:
            best = sector
    if best == (0.0, 0.0):
        return None
    first = max(math.degrees(best[0]) - _MARGIN, config.fan_angles[0])
    last = min(math.degrees(best[1]) + _MARGIN, config.fan_angles[1])
    return first, last


def _arc(
    config: PlusConfig, frame: np.ndarray, radius: float, low: float, high: float
) -> tuple[list[float], np.ndarray]:
    """Angles and values of the pixels on an arc, one sample a pixel's length."""
    h, w = frame.shape
    step = 1 / radius
    angles, values = [], []
    for i in range(int((high - low) / step)):
        angle = low + i * step
        x = _round(int(config.fan_origin[0]) + radius * math.sin(angle))
        y = _round(int(config.fan_origin[1]) + radius * math.cos(angle))
        if 0 <= x < w and 0 <= y < h:
            angles.append(angle)
            values.append(float(frame[y, x]))
    return angles, np.array(values)


def _round(x: float) -> int:
    return int(x + (0.5 if x >= 0 else -0.5))


def _widest(angles: list[float], values: np.ndarray, config: PlusConfig, high: float) -> tuple[float, float]:
    """The widest run in which at least half of a moving window is bright."""
    n = 2 * config.detect_radius
    bright = np.concatenate(([0], np.cumsum(values >= config.detect_brightness)))
    left, right, inside = [], [], False
    for j in range(n, len(angles)):
        count = bright[j] - bright[j - n]
        if not inside and count >= n / 2:
            left.append(angles[j - n])
            inside = True
        elif inside and count <= n / 2:
            right.append(angles[j - 1])
            inside = False
    if len(left) > len(right):
        right.append(high)
    best = (0.0, 0.0)
    for a, b in zip(left, right, strict=True):
        if b - a > best[1] - best[0]:
            best = (a, b)
    return best
