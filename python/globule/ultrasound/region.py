"""Which pixels of a frame show tissue: clip rectangle, fan and mask image."""

from __future__ import annotations

import math
import os
from typing import Any, NamedTuple

import numpy as np

from ..formats.errors import bad
from ..formats.size import check_size


class Clip(NamedTuple):
    """A rectangle: the first column and row in it, and its width and height in pixels."""

    column: float
    row: float
    width: float
    height: float


class Fan(NamedTuple):
    """A curved probe's sector.

    column, row          its apex, pixels; may lie outside of the image
    first, last          angles in degrees from the row axis (away from the probe) to +column
    start, stop          radii, pixels
    """

    column: float
    row: float
    first: float
    last: float
    start: float
    stop: float


def checked_clip(value: Any) -> Clip:
    """A Clip of four numbers, column, row, width, height. Raises ValueError."""
    clip = Clip(*_numbers("clip", value, Clip._fields))
    if clip.width <= 0 or clip.height <= 0:
        raise ValueError(f"clip: expected a width and height above 0, got {tuple(clip)}")
    return clip


def checked_fan(value: Any) -> Fan:
    """A Fan of six numbers, in the order of its fields. Raises ValueError."""
    fan = Fan(*_numbers("fan", value, Fan._fields))
    if not -90 < fan.first < fan.last < 90:
        expected = "-90 < first < last < 90 degrees"
        raise ValueError(f"fan: expected {expected}, got {fan.first:g} and {fan.last:g}")
    if not 0 <= fan.start < fan.stop:
        got = f"{fan.start:g} and {fan.stop:g}"
        raise ValueError(f"fan: expected radii 0 <= start < stop, got {got}")
    return fan


def region_mask(
    shape: tuple[int, int], clip: Clip | None = None, fan: Fan | None = None, mask: Any = None
) -> np.ndarray | None:
    """The pixels inside of everything given, (H, W) bool, or None where that is all of them.

    mask    (H, W) array, not 0 inside, or the path of an image. Raises ValueError if it has
            another size, or if nothing remains.
    """
    if clip is None and fan is None and mask is None:
        return None
    height, width = shape
    inside = np.ones(shape, bool)
    columns, rows = np.arange(width)[None, :], np.arange(height)[:, None]
    if clip is not None:
        inside &= (columns >= clip.column) & (columns < clip.column + clip.width)
        inside &= (rows >= clip.row) & (rows < clip.row + clip.height)
    if fan is not None:
        x, y = columns - fan.column, rows - fan.row
        radius = np.hypot(x, y)
        angle = np.degrees(np.arctan2(x, y))
        inside &= (radius >= fan.start) & (radius <= fan.stop)
        inside &= (angle >= fan.first) & (angle <= fan.last)
    if mask is not None:
        if isinstance(mask, (str, os.PathLike)):
            mask = read_mask(mask)
        mask = np.asarray(mask)
        if mask.shape != shape:
            raise ValueError(f"mask: expected shape {shape} as the frames, got {mask.shape}")
        inside &= mask != 0
    if not inside.any():
        raise ValueError(f"region: expected pixels inside clip, fan and mask of {width}x{height} frames, got none")
    return None if inside.all() else inside


def _numbers(name: str, value: Any, fields: tuple[str, ...]) -> list[float]:
    try:
        numbers = [float(v) for v in value]
    except (TypeError, ValueError, OverflowError):
        numbers = []
    if len(numbers) != len(fields) or not all(map(math.isfinite, numbers)):
        raise ValueError(f"{name}: expected {len(fields)} numbers ({', '.join(fields)}), got {value!r}")
    return numbers


def read_mask(path: str | os.PathLike[str]) -> np.ndarray:
    """A picture as gray values (H, W) uint8. Raises FormatError, OSError."""
    from PIL import Image, UnidentifiedImageError

    try:
        with Image.open(os.fspath(path)) as image:
            check_size(path, "mask", 4 * image.width * image.height, os.path.getsize(path))
            return np.asarray(image.convert("L"))
    except (UnidentifiedImageError, Image.DecompressionBombError, SyntaxError) as error:
        raise bad(path, "mask", f"expected an image, got {error}") from None
    except OSError as error:
        if error.errno is not None:
            raise
        raise bad(path, "mask", f"expected a whole image, got {error}") from None
