"""Colour maps: values to colours.

Each map is a handful of sRGB anchors, equally spaced, with straight lines between them: viridis and
magma after Smith and van der Walt (matplotlib), coolwarm after Moreland 2009, "Diverging Color Maps
for Scientific Visualization".
"""

from __future__ import annotations

from typing import Any

import numpy as np

_ANCHORS = {
    "viridis": "440154 482878 3e4989 31688e 26828e 1f9e89 35b779 6ece58 b5de2b fde725",
    "magma": "000004 180f3d 440f76 721f81 9e2f7f cd4071 f1605d fd9668 feca8d fcfdbf",
    "coolwarm": "3b4cc0 6282ea 8db0fe b8d0f9 dddddd f5c4ad f49a7b de604d b40426",
    "gray": "000000 ffffff",
}
NAMES = tuple(_ANCHORS)
NO_VALUE = (0.5, 0.5, 0.5)  # sRGB; the colour of NaN


def colorize(values: Any, name: str, lo: float, hi: float) -> np.ndarray:
    """Linear RGB (N, 3) float32 of values (N,): `lo` has the map's first colour, `hi` the last.

    Values beyond the two have the end's colour, NaN is gray. Where lo equals hi, everything has
    the middle colour.
    """
    if name not in _ANCHORS:
        raise ValueError(f"colormap: expected one of {', '.join(NAMES)}, got {name!r}")
    anchors = np.array([hex_color(word) for word in _ANCHORS[name].split()])
    v = np.asarray(values, dtype=np.float64)
    # Halved, so that the difference of the ends cannot overflow.
    place = (v / 2 - lo / 2) / (hi / 2 - lo / 2) if hi != lo else np.where(np.isnan(v), v, 0.5)
    steps = np.linspace(0, 1, len(anchors))
    color = np.stack([np.interp(place, steps, anchors[:, c]) for c in range(3)], axis=1)
    color[np.isnan(place)] = NO_VALUE
    return to_linear(color).astype(np.float32)


def hex_color(text: str) -> tuple[float, float, float]:
    """sRGB in [0, 1] of six hexadecimal digits."""
    red, green, blue = bytes.fromhex(text)
    return red / 255, green / 255, blue / 255


def to_linear(srgb: Any) -> np.ndarray:
    """Linear light of sRGB values in [0, 1] (IEC 61966-2-1)."""
    v = np.asarray(srgb, dtype=np.float64)
    return np.where(v <= 0.04045, v / 12.92, ((v + 0.055) / 1.055) ** 2.4)
