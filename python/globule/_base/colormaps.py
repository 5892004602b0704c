"""Color maps: values to colors, by the tables of the package cmap, which are matplotlib's."""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np

from .checks import choice
from .elements import ELEMENTS

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

_SOURCES = {
    "viridis": "bids", "magma": "bids", "inferno": "bids", "plasma": "bids", "cividis": "cividis",
    "turbo": "google", "coolwarm": "matplotlib", "gray": "matlab",
}  # fmt: skip
CATEGORICAL = ("types", "elements")  # whole numbers, each with a color of its own
NAMES = (*_SOURCES, *CATEGORICAL)
NO_VALUE = (0.5, 0.5, 0.5)  # sRGB; the color of NaN
# sRGB, for labels 1, 2, 3 …; the first seven are Okabe and Ito's, told apart by every eye.
_PALETTE = "e69f00 56b4e9 009e73 d55e00 cc79a7 f0e442 0072b2 8c6bb1 b2df8a 999999 a6761d f4a6a6"


def colorize(values: ArrayLike, name: str, lo: float, hi: float) -> np.ndarray:
    """Colors of values by a color map.

    Args:
        values: (N,) numbers.
        name: viridis, magma, inferno, plasma, cividis, turbo, coolwarm or gray; for whole numbers
            types (twelve colors, which repeat) or elements (Jmol's, by the atomic number).
        lo, hi: values of the map's first and last color. Values outside have the color of the
            nearest end; NaN is gray. If lo equals hi, every value has the middle color.

    Returns:
        (N, 3) float32, linear RGB.

    Raises ValueError for an unknown map.
    """
    choice("colormap", name, NAMES)
    v = np.asarray(values, dtype=np.float64)
    if name in CATEGORICAL:
        return _of_kinds(v, name)
    # Halved, so that the difference of the ends cannot overflow.
    with np.errstate(over="ignore"):  # far beyond the ends
        place = (v / 2 - lo / 2) / (hi / 2 - lo / 2) if hi != lo else np.where(np.isnan(v), v, 0.5)
    color = _at(name, place)
    color[np.isnan(place)] = NO_VALUE
    return to_linear(color).astype(np.float32)


def _of_kinds(values: np.ndarray, name: str) -> np.ndarray:
    gray = to_linear(NO_VALUE).astype(np.float32)
    known = np.abs(values) < 2**53
    kinds = np.rint(np.where(known, values, 0)).astype(np.int64)
    if name == "types":
        return np.where(known[:, None], categorical(kinds), gray)
    words = {number: color for number, _, color in ELEMENTS.values()}
    colors = to_linear([hex_color(words[k]) for k in sorted(words)]).astype(np.float32)
    known &= (kinds >= 1) & (kinds <= len(colors))
    return np.where(known[:, None], colors[np.clip(kinds, 1, len(colors)) - 1], gray)


def categorical(labels: Any) -> np.ndarray:
    """Linear RGB (N, 3) float32 of whole numbers (N,): twelve colors, which repeat."""
    palette = to_linear([hex_color(word) for word in _PALETTE.split()]).astype(np.float32)
    return palette[(np.asarray(labels, np.int64) - 1) % len(palette)]


def hex_color(text: str) -> tuple[float, float, float]:
    """sRGB in [0, 1] of six hexadecimal digits."""
    red, green, blue = bytes.fromhex(text)
    return red / 255, green / 255, blue / 255


def map_colors(name: str, n: int) -> np.ndarray:
    """A map's colors from its first to its last, sRGB (n, 3) uint8."""
    return np.rint(255 * _at(name, np.linspace(0, 1, n))).astype(np.uint8)


def _at(name: str, place: np.ndarray) -> np.ndarray:
    """sRGB (N, 3) at places (N,) of a map, 0 to 1; straight lines between 256 colors."""
    table = _table(name)
    steps = np.linspace(0, 1, len(table))
    return np.stack([np.interp(place, steps, channel) for channel in table.T], axis=1)


@cache
def _table(name: str) -> np.ndarray:
    from cmap import Colormap  # 0.1 s, which only images with a map need

    return Colormap(f"{_SOURCES[name]}:{name}").lut(256)[:, :3]


def to_linear(srgb: Any) -> np.ndarray:
    """Linear light of sRGB values in [0, 1] (IEC 61966-2-1)."""
    v = np.asarray(srgb, dtype=np.float64)
    return np.where(v <= 0.04045, v / 12.92, ((v + 0.055) / 1.055) ** 2.4)
