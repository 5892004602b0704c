"""How the light of a frame becomes its 8-bit image, where the core's own does not serve."""

from __future__ import annotations

from functools import cache

import numpy as np

from .._base.colormaps import colorize

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


def straight(image: np.ndarray, color: np.ndarray, alpha: np.ndarray, exposure: float, tone: bool) -> np.ndarray:
    """An image (H, W, 4) uint8 with straight alpha (H, W), of the image (H, W, 3) in front of black
    and its linear light (H, W, 3)."""
    mixed = (alpha > 0) & (alpha < 1)
    light = color[mixed] / alpha[mixed][:, None]
    image = np.array(image)
    image[mixed] = displayed(shoulder(light * np.float32(exposure)) if tone else light)
    return np.concatenate([image, np.rint(255 * alpha)[..., None].astype(np.uint8)], axis=2)


def with_values(color: np.ndarray, blended: np.ndarray, mixed: bool, colormap: str, lo: float, hi: float) -> np.ndarray:
    """The colors (H, W, 3) of a flat image, with the color of the blended value in each pixel in
    place of the blend of the particles' colors.

    Two neighbors of different values blend to a color beside the map; the color of their blended
    value is on it. Pixels at the edge of the surface keep their mixture with what is behind.

    Args:
        blended: (H, W), the value that each pixel shows; NaN where none.
        mixed: whether pixels at edges are mixtures.
        colormap, lo, hi: color map, and values of the map's ends.
    """
    inside = np.isfinite(blended)
    if mixed:
        wide = np.pad(inside, 1, constant_values=True)
        rows, columns = inside.shape
        for y in (0, 1, 2):
            for x in (0, 1, 2):
                inside = inside & wide[y : y + rows, x : x + columns]
    color = np.array(color)
    color[inside] = colorize(blended[inside], colormap, lo, hi)
    return color
