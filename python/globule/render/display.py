"""How the light of a frame becomes its 8-bit image, where the core's own does not serve."""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np

from .._base.colormaps import colorize

if TYPE_CHECKING:
    from .frame import Frame

_STEPS = 65535  # of linear light; the narrowest of 256 sRGB values is 19 of them wide


def displayed(color: np.ndarray) -> np.ndarray:
    """sRGB (…) uint8 of linear light (…) float32, clipped at 1 (IEC 61966-2-1)."""
    at = np.fmin(color, np.float32(1)) * np.float32(_STEPS) + np.float32(0.5)
    return _table()[at.astype(np.uint16)]


@cache
def _table() -> np.ndarray:
    light = np.arange(_STEPS + 1) / _STEPS
    srgb = np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)
    return np.rint(255 * srgb).astype(np.uint8)


def shoulder(light: np.ndarray) -> np.ndarray:
    """The tone curve of the core (src/trace/light.hpp): linear up to 0.8, below 1 everywhere."""
    over = np.maximum(light - 0.8, 0)
    return np.minimum(light, 0.8) + 0.2 * (1 - 1 / (1 + 5 * over))


def straight(frame: Frame, image: np.ndarray, exposure: float, tone: bool) -> np.ndarray:
    """The frame's image (H, W, 4) uint8 with straight alpha, of its image (H, W, 3) in front of
    black."""
    alpha = frame.alpha
    mixed = (alpha > 0) & (alpha < 1)
    light = frame.color[mixed] / alpha[mixed][:, None]
    image = np.array(image)
    image[mixed] = displayed(shoulder(light * np.float32(exposure)) if tone else light)
    return np.concatenate([image, np.rint(255 * alpha)[..., None].astype(np.uint8)], axis=2)


def with_values(frame: Frame, color: np.ndarray, values: tuple[Any, str, float, float]) -> Any:
    """The colors (H, W, 3) of a flat frame, with the color of the blended value in each pixel in
    place of the blend of the particles' colors.

    Two neighbors of different values blend to a color beside the map; the color of their blended
    value is on it. Pixels at the edge of the surface keep their mixture with what is behind.

    Args:
        values: of the first scene's particles (N,), color map, and values of the map's ends.
    """
    own, colormap, lo, hi = values
    blended = frame.attribute(own)
    inside = np.isfinite(blended)
    if frame._mixed:
        wide = np.pad(inside, 1, constant_values=True)
        rows, columns = inside.shape
        for y in (0, 1, 2):
            for x in (0, 1, 2):
                inside = inside & wide[y : y + rows, x : x + columns]
    color = np.array(color)
    color[inside] = colorize(blended[inside], colormap, lo, hi)
    return color
