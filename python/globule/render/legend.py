"""A color bar with its range, name and unit, drawn into a finished image or beside it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from .._base.checks import choice, named
from .._base.colormaps import CATEGORICAL, NAMES, colorize, map_colors
from .canvas import DARK, Canvas, sizes
from .display import displayed

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

POSITIONS = ("lower-right", "lower-left", "upper-right", "upper-left", "outside")
# Lengths as shares of the image's shorter side.
_BAR_WIDTH, _BAR_HEIGHT = 0.024, 0.42
_ROW, _HIGHEST = 1.2, 0.8  # of a kind, in heights of text; of the bar, of the image's height
_LONGEST_TICK = 9  # digits for which a legend outside of the image has room
_PAPER, _INK = (255, 255, 255), (DARK, (255, 255, 255))  # of a legend outside of the image


@named
def add_legend(
    image: ArrayLike,
    colormap: str,
    lo: float,
    hi: float,
    label: str = "",
    scale: float = 1.0,
    *,
    unit: str = "",
    position: str = "lower-right",
) -> np.ndarray:
    """The image with a vertical color bar, ticks and label.

    All sizes follow the size of the image. Text is dark with a light rim, or light with a dark rim,
    and the bar has a thin frame: text and bar are legible on any background.

    Args:
        image: (H, W, 3) uint8, sRGB, or (H, W, 4) with straight alpha; both sides at least 64
            pixels.
        colormap: a name as for `colorize`; types and elements list whole numbers from lo to hi.
        lo, hi: values of the map's first and last color.
        label: name of the values; shortened to fit.
        scale: factor of all sizes.
        unit: of the values, written behind the label.
        position: a corner of the image, lower-right, lower-left, upper-right or upper-left; or
            outside, on a white strip to the right, which makes the image wider.

    Returns:
        (H, W, 3) or (H, W, 4) uint8, a new array.
    """
    size = np.shape(image)[1::-1]
    strip = strip_width(size, scale) if len(size) == 2 else 0
    return draw_legend(image, colormap, lo, hi, label, unit, position, scale, strip)


def draw_legend(
    image: ArrayLike,
    colormap: str,
    lo: float,
    hi: float,
    label: str,
    unit: str,
    position: str,
    scale: float,
    strip: int,
    kinds: Sequence[tuple[float, str]] = (),
    below: int = 0,
) -> np.ndarray:
    """As `add_legend`; `strip`: by how many pixels a legend outside makes the image wider; `kinds`:
    values and names that a legend of types or elements lists; default: whole numbers from lo to hi;
    `below`: how much lower an upper one is, pixels.
    """
    canvas = Canvas(image, scale)
    choice("colormap", colormap, NAMES)
    if not (math.isfinite(lo) and math.isfinite(hi)):
        raise ValueError(f"range: expected two finite numbers, got {lo!r} and {hi!r}")
    choice("position", position, POSITIONS)
    label = ", ".join(word for word in (" ".join(label.split()), unit) if word)
    most = int((_HIGHEST * canvas.height - below) / (_ROW * canvas.text_height()))
    if colormap in CATEGORICAL and not kinds and hi - lo < most:
        kinds = [(float(k), str(k)) for k in range(math.ceil(lo), math.floor(hi) + 1)]
    shown = _Shown(colormap, lo, hi, tuple(kinds[:most]))
    if position == "outside":
        start = canvas.width
        canvas.widen(strip, _PAPER)
        _draw(canvas, shown, label, "middle-left", start)
    else:
        _draw(canvas, shown, label, position, 0, below)
    return canvas.pixels


class _Shown(NamedTuple):
    """What a bar shows; kinds as for `draw_legend`, which are listed from the top."""

    colormap: str
    lo: float
    hi: float
    kinds: tuple[tuple[float, str], ...]

    def ticks(self, most: int) -> list[tuple[float, str]]:
        """Shares of the bar's length, from below, and texts; about `most` of a range."""
        n = len(self.kinds)
        if n:
            return [(1 - (i + 0.5) / n, name) for i, (_, name) in enumerate(self.kinds)]
        return tick_labels(self.lo, self.hi, most)

    def colors(self, length: int) -> np.ndarray:
        """(length, 3) uint8, from above."""
        if self.colormap not in CATEGORICAL:
            return map_colors(self.colormap, length)[::-1]
        values = np.linspace(self.hi, self.lo, length)
        if n := len(self.kinds):
            values = np.array([value for value, _ in self.kinds])[np.arange(length) * n // length]
        return displayed(colorize(values, self.colormap, self.lo, self.hi))


def strip_width(size: tuple[int, int], scale: float = 1.0) -> int:
    """Width of the strip that a legend outside of an image of this (width, height) takes, pixels.
    It depends on the height alone where the image is at least as wide as high."""
    side = scale * min(size)
    font, _, margin = sizes(side)
    return round(2 * margin + 1.5 * max(4, round(_BAR_WIDTH * side)) + 0.6 * _LONGEST_TICK * font)


def _draw(canvas: Canvas, shown: _Shown, label: str, position: str, start: int, below: int = 0) -> None:
    """Draw bar, ticks and label at a position of the image that begins with column `start`; below:
    as for `draw_legend`."""
    margin, line, text_height = canvas.margin, canvas.line, canvas.text_height()
    bar = max(4, round(_BAR_WIDTH * canvas.side))
    length = max(round(_BAR_HEIGHT * canvas.side), round(_ROW * text_height * len(shown.kinds)))
    texts = shown.ticks(max(2, round(length / (2.2 * text_height))))
    widest = math.ceil(max(canvas.text_width(text) for _, text in texts))
    gap = max(5, bar // 2)
    vertical, horizontal = position.split("-")
    # Right and bottom are not included.
    right = canvas.width - margin - widest - gap - line if horizontal == "right" else start + margin + line + bar
    if vertical == "lower":
        bottom = canvas.height - margin - text_height // 2
    elif vertical == "upper":
        bottom = below + margin + 2 * text_height + line + length
    else:
        bottom = (canvas.height + length + 2 * text_height) // 2
    top = bottom - length
    inks = _INK if start else canvas.ink(right - bar, top, right + gap + widest, bottom)
    canvas.fill(right - bar - line, top - line, right + line, bottom + line, inks[0])
    colors = shown.colors(length)
    canvas.paste(np.repeat(colors[:, None], bar, axis=1), right - bar, top)
    for share, text in texts:
        at = bottom - 0.5 - share * (length - 1)
        row = round(at - line / 2)
        canvas.fill(right + line, row, right + line + gap // 2, row + line, inks[0])
        canvas.text((right + line + gap, at), text, "lm", inks=inks)
    room = canvas.width - start - 2 * margin if start else canvas.width - 2 * margin
    label = canvas.shortened(label, room)
    above = max(text_height / 2, top - line - text_height)
    if horizontal == "right":
        canvas.text((canvas.width - margin, above), label, "rm")
    else:
        canvas.text((start + margin, above), label, "lm", inks=inks if start else None)


def tick_labels(lo: float, hi: float, most: int) -> list[tuple[float, str]]:
    """Both ends and round values between them: (share of the way from lo to hi, text).

    About `most` of them, at least the two ends; one where lo equals hi.
    """
    if lo == hi:
        return [(0.5, f"{lo + 0.0:.6g}")]
    span = hi / most - lo / most  # divided first, so that the difference cannot overflow
    step = 10.0 ** math.floor(math.log10(abs(span)))
    step *= next((factor for factor in (1, 2, 5) if factor * step >= abs(span)), 10)
    largest = max(abs(lo), abs(hi))
    whole = math.floor(math.log10(largest)) + 1  # digits before the point
    digits = min(17, max(3, math.ceil(math.log10(largest / step)) + 1, whole if whole <= 6 else 0))
    ticks = [(0.0, lo), (1.0, hi)]
    first = math.ceil(min(lo, hi) / step)
    for i in range(first, first + most + 2):
        share = (i * step / 2 - lo / 2) / (hi / 2 - lo / 2)
        if 0.6 / most < share < 1 - 0.6 / most:  # room for the ends' own text
            ticks.append((share, i * step))
    return [(share, f"{value + 0.0:.{digits}g}") for share, value in sorted(ticks)]  # 0.0: no "-0"
