"""A colour bar with its range and name, drawn into a finished picture."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from .._base.colormaps import NAMES, map_colors

if TYPE_CHECKING:
    from PIL.ImageDraw import ImageDraw

LEAST_SIDE = 64  # pixels; in a smaller picture no number can be read
# Lengths as shares of the picture's shorter side.
_MARGIN, _BAR_WIDTH, _BAR_HEIGHT, _TEXT = 0.035, 0.024, 0.42, 0.026
_LEAST_TEXT = 9  # pixels


def add_legend(
    picture: Any, colormap: str, lo: float, hi: float, label: str = "", scale: float = 1.0
) -> np.ndarray:
    """The picture with a vertical colour bar, ticks and label in its lower right corner.

    Sizes follow the picture's. Text is dark with a light rim or the reverse, as the picture below
    it needs, and the bar has a thin frame, so that both can be read on any background.

    Args:
        picture: (H, W, 3) uint8, sRGB, both sides at least 64 pixels.
        colormap: one of `colormaps.NAMES`.
        lo, hi: values of the map's first and last colour.
        label: what the values are; shortened to fit.
        scale: of all its sizes.

    Returns:
        (H, W, 3) uint8, a new array.
    """
    from PIL import Image, ImageDraw, ImageFont

    picture = np.asarray(picture)
    if picture.dtype != np.uint8 or picture.ndim != 3 or picture.shape[2] != 3:
        got = f"{picture.dtype} {picture.shape}"
        raise ValueError(f"picture: expected (H, W, 3) uint8, got {got}")
    if min(picture.shape[:2]) < LEAST_SIDE:
        got = f"{picture.shape[1]}x{picture.shape[0]}"
        raise ValueError(f"picture: expected at least {LEAST_SIDE} pixels a side, got {got}")
    if colormap not in NAMES:
        raise ValueError(f"colormap: expected one of {', '.join(NAMES)}, got {colormap!r}")
    if not (math.isfinite(lo) and math.isfinite(hi)):
        raise ValueError(f"range: expected two finite numbers, got {lo!r} and {hi!r}")

    image = Image.fromarray(np.ascontiguousarray(picture))
    width, height = image.size
    side = scale * min(width, height)
    font = ImageFont.load_default(size=max(_LEAST_TEXT, round(_TEXT * side)))
    draw = ImageDraw.Draw(image)
    line = max(1, round(side / 500))
    margin, bar = round(_MARGIN * side), max(4, round(_BAR_WIDTH * side))
    text_height = sum(font.getmetrics())

    texts = tick_labels(lo, hi, max(2, round(_BAR_HEIGHT * side / (2.2 * text_height))))
    widest = max(draw.textlength(text, font=font) for _, text in texts)
    gap = max(5, bar // 2)
    right = width - margin - math.ceil(widest) - gap - line
    bottom = height - margin - text_height // 2
    top = bottom - round(_BAR_HEIGHT * side)
    box = (right - bar, top, right, bottom)  # right and bottom not included

    ink, rim = _ink(picture[top:bottom, right:])
    colors = map_colors(colormap, bottom - top)[::-1]
    image.paste(Image.fromarray(np.repeat(colors[:, None], bar, axis=1)), box[:2])
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
        ink, rim = _ink(picture[y : place[1] + text_height // 2, x:end])
        draw.text(place, label, ink, font, anchor="rm", stroke_width=line, stroke_fill=rim)
    return np.asarray(image)


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
