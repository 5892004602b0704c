"""Lines, areas and text drawn with smooth edges into a finished image, opaque or RGBA."""

from __future__ import annotations

import functools
import importlib.util
import math
import os
import warnings
from collections.abc import Sequence
from typing import Any

import numpy as np

from .._base.checks import as_image

LEAST_SIDE = 64  # pixels; in a smaller image no text can be read
Color = tuple[int, int, int]
DARK, LIGHT = (28, 32, 38), (240, 242, 245)
_FINER = 4  # pixels of the mask of a line per pixel of the image
_TEXT, _LEAST_TEXT, _MARGIN = 0.026, 9, 0.035  # shares of the shorter side; pixels


class Canvas:
    """An image to draw on. Places are (x, y) in pixels from the top left corner.

    Args:
        image: (H, W, 3) or (H, W, 4) uint8, sRGB, the latter with straight alpha; not changed.
        scale: factor of the sizes of text, lines and margins.

    Attributes:
        pixels: the image so far, of the same shape.
        font: size of the text, pixels.
        line: width of a line, pixels.
        margin: distance of text from the image's edges, pixels.

    Raises ValueError for an image of another kind or with a side below 64 pixels.
    """

    def __init__(self, image: Any, scale: float = 1.0):
        image = as_image(image)
        if min(image.shape[:2]) < LEAST_SIDE:
            got = f"{image.shape[1]}x{image.shape[0]}"
            raise ValueError(f"image: expected at least {LEAST_SIDE} pixels a side, got {got}")
        self.pixels = np.array(image)
        self.height, self.width = image.shape[:2]
        self.side = scale * min(self.width, self.height)
        self.font, self.line, self.margin = sizes(self.side)

    def ink(self, left: float, top: float, right: float, bottom: float) -> tuple[Color, Color]:
        """The color of text in this part of the image, and that of its rim: dark and light in the
        order in which they stand out. Transparent pixels count as white."""
        x, y = max(0, int(left)), max(0, int(top))
        below = self.pixels[y : max(y + 1, int(bottom)), x : max(x + 1, int(right))]
        if not below.size:
            return DARK, LIGHT
        gray = below[..., :3] @ np.array((0.2126, 0.7152, 0.0722))
        if below.shape[2] == 4:
            gray = 255 - (255 - gray) * (below[..., 3] / 255)
        return (DARK, LIGHT) if gray.mean() > 118 else (LIGHT, DARK)

    def paste(self, colors: np.ndarray, left: int, top: int) -> None:
        """Put opaque colors (h, w, 3) uint8 at a place inside the image."""
        height, width = colors.shape[:2]
        part = self.pixels[top : top + height, left : left + width]
        part[..., :3] = colors
        part[..., 3:] = 255

    def widen(self, by: int, color: Color) -> None:
        """Add columns of an opaque color at the right; sizes stay."""
        self.pixels = np.pad(self.pixels, ((0, 0), (0, by), (0, 0)), constant_values=255)
        self.pixels[:, self.width :, :3] = color
        self.width += by

    def raise_by(self, by: int, color: Color) -> None:
        """Add rows of an opaque color at the top; sizes stay."""
        self.pixels = np.pad(self.pixels, ((by, 0), (0, 0), (0, 0)), constant_values=255)
        self.pixels[:by, :, :3] = color
        self.height += by

    def fill(self, left: int, top: int, right: int, bottom: int, color: Color) -> None:
        """Put one opaque color into whole pixels; right and bottom are not included."""
        top, left = max(0, top), max(0, left)
        height, width = (max(0, min(bottom, self.height) - top), max(0, min(right, self.width) - left))
        self.paste(np.full((height, width, 3), color, np.uint8), left, top)

    def lines(
        self, paths: Sequence[Any], color: Color, width: float | None = None, opacity: float = 1.0, filled: bool = False
    ) -> None:
        """Draw paths, (n, 2) each, as lines of one width, pixels, or as filled polygons."""
        from PIL import Image, ImageDraw

        width = self.line if width is None else width
        paths = [np.asarray(path, np.float64) for path in paths]
        paths = [path for path in paths if len(path) > 1]
        if not paths:
            return
        corners = np.concatenate(paths)
        x, y = (max(0, math.floor(v)) for v in corners.min(axis=0) - width - 1)
        right, bottom = (math.ceil(v) for v in corners.max(axis=0) + width + 1)
        right, bottom = min(right, self.width), min(bottom, self.height)
        if right <= x or bottom <= y:
            return
        mask = Image.new("L", (_FINER * (right - x), _FINER * (bottom - y)))
        draw = ImageDraw.Draw(mask)
        thick = max(1, round(_FINER * width))
        for path in paths:
            places = [tuple(place) for place in (_FINER * (path - (x, y)) - 0.5).tolist()]
            if filled:
                draw.polygon(places, fill=255)
            else:
                draw.line(places, fill=255, width=thick, joint="curve")
        share = np.asarray(mask.reduce(_FINER), np.float32) * (opacity / 255)
        self._over(share, color, x, y)

    def text(
        self,
        place: tuple[float, float],
        text: str,
        anchor: str = "ls",
        size: int | None = None,
        inks: tuple[Color, Color] | None = None,
        inside: bool = False,
    ) -> None:
        """Draw one line of text with a rim. anchor: as Pillow names them: l m r, then a m s d.
        inside: moves what would stand out of the image into it."""
        from PIL import Image, ImageDraw

        font = self._font(size, text)
        place = round(place[0]), round(place[1])  # whole: text is crisp
        probe = ImageDraw.Draw(Image.new("L", (1, 1)))
        box = probe.textbbox(place, text, font, anchor=anchor, stroke_width=self.line)
        if inside and np.isfinite(box).all():
            moved = [
                max(0, -math.floor(box[i])) or min(0, most - math.ceil(box[i + 2]))
                for i, most in enumerate((self.width, self.height))
            ]
            place = place[0] + moved[0], place[1] + moved[1]
            box = probe.textbbox(place, text, font, anchor=anchor, stroke_width=self.line)
        x, y = max(0, math.floor(box[0])), max(0, math.floor(box[1]))
        right, bottom = min(self.width, math.ceil(box[2])), min(self.height, math.ceil(box[3]))
        if not text or right <= x or bottom <= y:
            return
        ink, rim = inks or self.ink(x, y, right, bottom)
        for color, stroke in ((rim, self.line), (ink, 0)):
            mask = Image.new("L", (right - x, bottom - y))
            start = place[0] - x, place[1] - y
            ImageDraw.Draw(mask).text(start, text, 255, font, anchor=anchor, stroke_width=stroke)
            self._over(np.asarray(mask, np.float32) / 255, color, x, y)

    def text_width(self, text: str, size: int | None = None) -> float:
        """Width of one line of text, pixels."""
        return self._font(size, text).getlength(text)

    def text_height(self, size: int | None = None) -> int:
        """Height of one line of text, pixels."""
        return sum(self._font(size).getmetrics())

    def shortened(self, text: str, width: float, size: int | None = None) -> str:
        """The text as one line, or as much of its beginning as fits with an ellipsis."""
        text = " ".join(text.split())[:200]
        if self.text_width(text, size) <= width:
            return text
        while text and self.text_width(text + "…", size) > width:
            text = text[:-1]
        return text + "…" if text else ""

    def _font(self, size: int | None, text: str = "") -> Any:
        from PIL import ImageFont

        file = _font_file(text)
        size = size or self.font
        return ImageFont.truetype(file, size) if file else ImageFont.load_default(size=size)

    def _over(self, share: np.ndarray, color: Color, x: int, y: int) -> None:
        """Cover the share (h, w), 0 to 1, of the pixels from (x, y) on with a color."""
        part = self.pixels[y : y + share.shape[0], x : x + share.shape[1]]
        share = share[..., None]
        if part.shape[2] == 3:
            part[:] = np.rint(part + share * (np.array(color, np.float32) - part))
            return
        below = part[..., 3:] * (1 - share) / 255
        alpha = share + below
        mixed = share * np.array(color, np.float32) + below * part[..., :3]
        mixed /= np.maximum(alpha, 1e-6)
        part[..., :3] = np.where(alpha > 0, np.rint(mixed), part[..., :3])
        part[..., 3:] = np.rint(255 * alpha)


@functools.lru_cache(256)
def _font_file(text: str) -> str | None:
    """A font that has all letters of the text; None for Pillow's own, which has few but ASCII.

    Warns where no font has them.
    """
    from PIL import ImageFont

    text = "".join(text.split())
    if text.isascii() or not (lost := _missing(ImageFont.load_default(size=16), text)):
        return None
    best, found = lost, None
    for file in _font_files():
        try:
            left = _missing(ImageFont.truetype(file, 16), text)
        except OSError:  # not on this machine
            continue
        if len(left) < len(best):
            best, found = left, file
        if not best:
            return found
    letters = ", ".join(dict.fromkeys(best))
    warnings.warn(
        f"{text[:40]}: expected letters of a font of this machine, got {letters}: drawn as boxes; "
        "install DejaVu or Noto fonts, or write it with other letters",
        stacklevel=2,
    )
    return found


def _font_files() -> list[str]:
    """Fonts of many letters, by name where the system finds them; Matplotlib brings one."""
    names = ["DejaVuSans.ttf", "NotoSans-Regular.ttf", "NotoSansCJK-Regular.ttc"]
    names += ["Arial Unicode.ttf", "arial.ttf", "Arial.ttf", "LiberationSans-Regular.ttf"]
    matplotlib = importlib.util.find_spec("matplotlib")
    if matplotlib and matplotlib.origin:
        folder = os.path.join(os.path.dirname(matplotlib.origin), "mpl-data", "fonts", "ttf")
        names.insert(1, os.path.join(folder, "DejaVuSans.ttf"))
    return names


def _missing(font: Any, text: str) -> str:
    """The letters of a text for which a font draws its box."""

    def drawn(letter: str) -> tuple[Any, bytes]:
        mask = font.getmask(letter)
        return mask.size, bytes(mask)

    box = drawn("\uffff")
    return "".join(letter for letter in text if drawn(letter) == box)


def sizes(side: float) -> tuple[int, int, int]:
    """Size of the text, width of lines and margin, pixels, for an image's shorter side."""
    return max(_LEAST_TEXT, round(_TEXT * side)), max(1, round(side / 500)), round(_MARGIN * side)
