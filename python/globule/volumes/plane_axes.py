"""Pictures of planes side by side, with arrows that name their axes and have a length in mm."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from PIL.ImageDraw import ImageDraw

_INK, _PAPER, _GAP = (60, 66, 74), (255, 255, 255), 8
_TEXT, _LEAST_TEXT, _MOST_TEXT = 0.035, 10, 40  # a share of the longest side, pixels


def with_axes(pictures: list[np.ndarray], names: list[tuple[str, str]], step: float) -> np.ndarray:
    """The pictures (H, W, 3) uint8 from left to right, in margins that hold the arrows.

    Args:
        names: of each picture's axes, to the right and down.
        step: side of a pixel, mm.
    """
    from PIL import Image, ImageDraw, ImageFont

    sides = [side for picture in pictures for side in picture.shape[:2]]
    size = int(min(max(_TEXT * max(sides), _LEAST_TEXT), _MOST_TEXT))
    font = ImageFont.load_default(size=size)
    margin = size + _GAP
    height = margin + max(picture.shape[0] for picture in pictures)
    width = sum(margin + picture.shape[1] for picture in pictures)
    image = Image.new("RGB", (width + _GAP, height + _GAP), _PAPER)
    draw = ImageDraw.Draw(image)
    millimeters = _round_length(0.25 * max(sides) * step)
    whole = millimeters / step
    left, middle = 0, margin // 2
    for picture, (right, down) in zip(pictures, names, strict=True):
        left += margin
        image.paste(Image.fromarray(np.ascontiguousarray(picture)), (left, margin))
        x, y = left - margin + middle, middle
        # An axis that is shorter than the arrows has none, only its name.
        along, across = (whole if whole <= side else 0 for side in picture.shape[1::-1])
        _arrow(draw, (left, y), (left + along, y), size)
        _arrow(draw, (x, margin), (x, margin + across), size)
        place, text = left + along + size / 2, f"{right}  {millimeters:g} mm"
        fits = along and place + draw.textlength(text, font=font) <= left + picture.shape[1]
        draw.text((place, y), text if fits else right, _INK, font, anchor="lm")
        draw.text((x, margin + across + size / 4), down, _INK, font, anchor="ma")
        left += picture.shape[1]
    return np.asarray(image)


def _arrow(draw: ImageDraw, start: tuple, end: tuple, size: int) -> None:
    if start == end:
        return
    line, head = max(1, size // 10), size / 4
    draw.line((*start, *end), _INK, line)
    along = np.sign(np.subtract(end, start))
    across = along[::-1]
    for side in (-1, 1):
        draw.line((*(end - head * along + side * head * across), *end), _INK, line)


def _round_length(most: float) -> float:
    """The longest of 1, 2 and 5 times a power of ten that is at most this."""
    power = 10.0 ** math.floor(math.log10(most))
    return next(factor * power for factor in (5, 2, 1) if factor * power <= most * (1 + 1e-9))
