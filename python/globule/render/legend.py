"""A color bar with its range and name, drawn into a finished image."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from .._base.colormaps import NAMES, map_colors
from .._base.old_names import renamed

if TYPE_CHECKING:
    from numpy.typing import ArrayLike
    from PIL.ImageDraw import ImageDraw

LEAST_SIDE = 64  # pixels; in a smaller image no number can be read
# Lengths as shares of the image's shorter side.
_MARGIN, _BAR_WIDTH, _BAR_HEIGHT, _TEXT = 0.035, 0.024, 0.42, 0.026
_LEAST_TEXT = 9  # pixels


@renamed(picture="image")
def add_legend(
    image: ArrayLike, colormap: str, lo: float, hi: float, label: str = "", scale: float = 1.0
) -> np.ndarray:
    """The image with a vertical color bar, ticks and label in its lower right corner.

    All sizes follow the size of the image. Text is dark with a light rim, or light with a dark rim,
    and the bar has a thin frame: text and bar are legible on any background.

    Args:
        image: (H, W, 3) uint8, sRGB, both sides at least 64 pixels.
        colormap: viridis, magma, inferno, plasma, cividis, turbo, coolwarm or gray.
        lo, hi: values of the map's first and last color.
        label: name of the values; shortened to fit.
        scale: factor of all sizes.

    Returns:
        (H, W, 3) uint8, a new array.

    Raises ValueError naming the argument, the expected and the given value.
    """
    from PIL import Image, ImageDraw, ImageFont

    image = np.asarray(image)
    if image.dtype != np.uint8 or image.ndim != 3 or image.shape[2] != 3:
        got = f"{image.dtype} {image.shape}"
        raise ValueError(f"image: expected (H, W, 3) uint8, got {got}")
    if min(image.shape[:2]) < LEAST_SIDE:
        got = f"{image.shape[1]}x{image.shape[0]}"
        raise ValueError(f"image: expected at least {LEAST_SIDE} pixels a side, got {got}")
    if colormap not in NAMES:
        raise ValueError(f"colormap: expected one of {', '.join(NAMES)}, got {colormap!r}")
    if not (math.isfinite(lo) and math.isfinite(hi)):
        raise ValueError(f"range: expected two finite numbers, got {lo!r} and {hi!r}")

    canvas = Image.fromarray(np.ascontiguousarray(image))
    width, height = canvas.size
    side = scale * min(width, height)
    font = ImageFont.load_default(size=max(_LEAST_TEXT, round(_TEXT * side)))
    draw = ImageDraw.Draw(canvas)
    line = max(1, round(side / 500))
    margin, bar = round(_MARGIN * side), max(4, round(_BAR_WIDTH * side))
    assert isinstance(font, ImageFont.FreeTypeFont)  # as a size is given
    text_height = sum(font.getmetrics())

    texts = tick_labels(lo, hi, max(2, round(_BAR_HEIGHT * side / (2.2 * text_height))))
    widest = max(draw.textlength(text, font=font) for _, text in texts)
    gap = max(5, bar // 2)
    right = width - margin - math.ceil(widest) - gap - line
    bottom = height - margin - text_height // 2
    top = bottom - round(_BAR_HEIGHT * side)
    box = (right - bar, top, right, bottom)  # right and bottom not included

    ink, rim = _ink(image[top:bottom, right:])
    colors = map_colors(colormap, bottom - top)[::-1]
    canvas.paste(Image.fromarray(np.repeat(colors[:, None], bar, axis=1)), box[:2])
    frame = (box[0] - line, top - line, right + line - 1, bottom + line - 1)
    draw.rectangle(frame, outline=ink, width=line)
    for share, text in texts:
        y = bottom - 1 - share * (bottom - 1 - top)
        draw.line((right + line, y, right + line + gap // 2, y), fill=ink, width=line)
        place = (right + line + gap, y)
        draw.text(place, text, ink, font, anchor="lm", stroke_width=line, stroke_fill=rim)
    label = _shortened(draw, " ".join(label.split()), font, width - 2 * margin)
    if label:
        end = width - margin
        place = (end, top - line - text_height)
        y, x = max(0, place[1] - text_height), int(max(0, end - draw.textlength(label, font=font)))
        ink, rim = _ink(image[y : place[1] + text_height // 2, x:end])
        draw.text(place, label, ink, font, anchor="rm", stroke_width=line, stroke_fill=rim)
    return np.asarray(canvas)


def tick_labels(lo: float, hi: float, most: int) -> list[tuple[float, str]]:
    """Both ends and round values between them: (share of the way from lo to hi, text).

    About `most` of them, at least the two ends; one where lo equals hi.
    """
    if lo == hi:
        return [(0.5, f"{lo:.6g}")]
    span = hi / most - lo / most  # divided first, so that the difference cannot overflow
    step = 10.0 ** math.floor(math.log10(abs(span)))
    step *= next((factor for factor in (1, 2, 5) if factor * step >= abs(span)), 10)
    largest = max(abs(lo), abs(hi))
    whole = math.floor(math.log10(largest)) + 1  # digits before the point
    digits = min(9, max(3, math.ceil(math.log10(largest / step)) + 1, whole if whole <= 6 else 0))
    ticks = [(0.0, lo), (1.0, hi)]
    first = math.ceil(min(lo, hi) / step)
    for i in range(first, first + most + 2):
        share = (i * step / 2 - lo / 2) / (hi / 2 - lo / 2)
        if 0.6 / most < share < 1 - 0.6 / most:  # room for the ends' own text
            ticks.append((share, i * step))
    return [(share, f"{value:.{digits}g}") for share, value in sorted(ticks)]


def _ink(below: np.ndarray) -> tuple[tuple[int, int, int], tuple[int, int, int]]:
    """Dark and light in the order in which they stand out from the pixels (…, 3) below."""
    dark, light = (28, 32, 38), (240, 242, 245)
    bright = not below.size or np.mean(below.reshape(-1, 3) @ (0.2126, 0.7152, 0.0722)) > 118
    return (dark, light) if bright else (light, dark)


def _shortened(draw: ImageDraw, text: str, font: Any, width: int) -> str:
    """The text, or as much of its beginning as fits with an ellipsis."""
    text = text[:200]
    if draw.textlength(text, font=font) <= width:
        return text
    while text and draw.textlength(text + "…", font=font) > width:
        text = text[:-1]
    return text + "…" if text else ""
