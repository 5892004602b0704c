"""Color maps: values to colors.

Each map is a handful of sRGB anchors, equally spaced, with straight lines between them, nowhere
more than 6 of 255 from the table of 256 colors that matplotlib has under the same name. viridis,
magma, inferno and plasma are by Smith and van der Walt; cividis by Nunez, Anderton and Renslow;
turbo by Mikhailov; coolwarm by Moreland (2009, "Diverging Color Maps for Scientific
Visualization").
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from .checks import shown

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

_ANCHORS = {
    "viridis": (
        "440154 48186a 472d7b 424086 3b528b 33638d 2c728e 26818e 21908c 1f9f88 28ae80 3ebc74 "
        "5dc963 82d34c abdc32 d5e21a fde725"
    ),
    "magma": "000004 150e37 3b0f70 641a80 8c2981 b63779 de4968 f66f5c fe9f6d fece91 fcfdbf",
    "inferno": (
        "000004 08061e 190c3e 2f0a5b 460b69 5c126e 711a6e 87216b 9c2964 b1325b c53c4e d64a40 "
        "e55c30 f0701f f8870e fc9f07 fbb91e f7d440 f1ed6f fcffa4"
    ),
    "plasma": "0d0887 4c02a1 7e03a8 a92396 cb4778 e66c5c f89441 fdc328 f0f921",
    "cividis": (
        "00224e 00285c 002e6b 073370 1c396f 293f6e 33446c 3d4a6c 45506c 4d556c 555b6d 5c616e "
        "636770 6b6d72 727274 797877 807e78 888578 908b78 989177 a09775 a89e73 b0a471 b9ab6d "
        "c1b26a cab965 d3c060 dcc859 e5cf52 eed748 f8df3c fee838"
    ),
    "turbo": (
        "30123b 3e3994 455ed2 4680f7 3aa2fc 23c3e4 18dec1 2cf09e 5bfb72 8eff4a b4f836 d6e635 "
        "f0cd3a fdb035 fd8a26 f36215 e14109 c72803 a51301 7a0403"
    ),
    "coolwarm": (
        "3b4cc0 4a63d4 5b7ae5 6d8ff1 7fa2fa 92b4fe a4c2fe b6cefa c7d7f1 d6dce4 e4d9d3 eecfbf "
        "f5c2aa f7b295 f59f80 ef896c e67158 d85646 c73735 b40426"
    ),
    "gray": "000000 ffffff",
}
NAMES = tuple(_ANCHORS)
NO_VALUE = (0.5, 0.5, 0.5)  # sRGB; the color of NaN
# sRGB, for labels 1, 2, 3 …; the first seven are Okabe and Ito's, told apart by every eye.
_PALETTE = "e69f00 56b4e9 009e73 d55e00 cc79a7 f0e442 0072b2 8c6bb1 b2df8a 999999 a6761d f4a6a6"


def colorize(values: ArrayLike, name: str, lo: float, hi: float) -> np.ndarray:
    """Colors of values by a color map.

    Args:
        values: (N,) numbers.
        name: viridis, magma, inferno, plasma, cividis, turbo, coolwarm or gray.
        lo, hi: values of the map's first and last color. Values outside have the color of the
            nearest end; NaN is gray. If lo equals hi, every value has the middle color.

    Returns:
        (N, 3) float32, linear RGB.

    Raises ValueError for an unknown map.
    """
    if not isinstance(name, str) or name not in _ANCHORS:
        raise ValueError(f"colormap: expected one of {', '.join(NAMES)}, got {shown(name)}")
    anchors = np.array([hex_color(word) for word in _ANCHORS[name].split()])
    v = np.asarray(values, dtype=np.float64)
    # Halved, so that the difference of the ends cannot overflow.
    place = (v / 2 - lo / 2) / (hi / 2 - lo / 2) if hi != lo else np.where(np.isnan(v), v, 0.5)
    steps = np.linspace(0, 1, len(anchors))
    color = np.stack([np.interp(place, steps, anchors[:, c]) for c in range(3)], axis=1)
    color[np.isnan(place)] = NO_VALUE
    return to_linear(color).astype(np.float32)


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
    anchors = np.array([hex_color(word) for word in _ANCHORS[name].split()])
    place, steps = np.linspace(0, 1, n), np.linspace(0, 1, len(anchors))
    color = np.stack([np.interp(place, steps, anchors[:, c]) for c in range(3)], axis=1)
    return np.rint(255 * color).astype(np.uint8)


def to_linear(srgb: Any) -> np.ndarray:
    """Linear light of sRGB values in [0, 1] (IEC 61966-2-1)."""
    v = np.asarray(srgb, dtype=np.float64)
    return np.where(v <= 0.04045, v / 12.92, ((v + 0.055) / 1.055) ** 2.4)
