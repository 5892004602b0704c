"""Environment images: Radiance .hdr, OpenEXR .exr, and 8-bit pictures, as linear radiance."""

from __future__ import annotations

import io
import os
import re
import warnings
from typing import Any

import numpy as np

from ..._base.colormaps import to_linear
from ..errors import FormatError, bad, shown
from ..kind import kind_of
from ..size import check_memory, check_size, whole_file
from .exr import read_exr

MOST_PIXELS = 2**27  # 16384 x 8192
_LONGEST_HEADER = 1 << 16
_ROWS = 64  # that are converted at once


def read_environment(path: str | os.PathLike[str]) -> np.ndarray:
    """Read an environment image: (H, W, 3) float32, linear, >= 0, row 0 at the top.

    The reader divides .hdr (Radiance's RGBE) by the file's exposure, takes R G B (or Y) of .exr
    with negative values as 0, and converts .png, .jpg and .jpeg from sRGB to linear, where 1 is
    white.

    The content of the file decides the format, not the extension. Raises FormatError for a file of
    another format, for more than 134 million pixels, and for values that are not finite;
    MissingPackageError for .exr without OpenEXR; OSErrors pass unchanged.
    """
    form = kind_of(path, "picture").format
    if form == "hdr":
        image = _read_hdr(path)
    elif form == "exr":
        image = np.maximum(read_exr(path, MOST_PIXELS), 0)
    elif form in ("png", "jpeg"):
        return _read_picture(path)
    else:
        raise bad(path, "", f"expected an environment image (hdr, exr, png or jpeg), got {form}")
    if not np.isfinite(image).all():
        row, column = np.argwhere(~np.isfinite(image).all(axis=2))[0]
        got = image[row, column]
        raise bad(path, f"row {row}, column {column}", f"expected finite radiance, got {got}")
    return image


def _read_picture(path: Any) -> np.ndarray:
    from PIL import Image, UnidentifiedImageError

    data = whole_file(path)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of sizes, which are checked here
        try:
            picture = Image.open(io.BytesIO(data), formats=("PNG", "JPEG"))
            width, height = picture.size
            _check_pixels(path, width, height, 20.0)
            pixels = np.asarray(picture.convert("RGB"))
        except FormatError:
            raise
        except UnidentifiedImageError:
            raise bad(path, "", "expected a PNG or JPEG picture, got other data") from None
        except (OSError, SyntaxError, ValueError, Image.DecompressionBombError) as error:
            raise bad(path, "", f"expected a PNG or JPEG picture, got {error}") from None
    return to_linear(np.arange(256) / 255).astype(np.float32)[pixels]


def _read_hdr(path: Any) -> np.ndarray:
    """Radiance's picture format, flat or with either of its two run-length codings."""
    data = whole_file(path)
    exposure, width, height, flip_y, flip_x, position = _hdr_header(path, data)
    _check_pixels(path, width, height, 28.0)
    start = data[position : position + 4]
    if 8 <= width < 32768 and start[:2] == b"\x02\x02" and len(start) == 4 and start[2] < 128:
        # A run is 2 bytes and at most 127 long, so a size that the data cannot hold shows here.
        least = height * (4 + 4 * 2 * -(-width // 127))
        if least > len(data) - position:
            raise bad(path, "data", f"expected at least {least} bytes, got {len(data) - position}")
        pixels = _scan_lines(path, data, position, width, height)
    else:
        check_memory(path, "header", 60.0 * width * height)
        pixels = _flat(path, data, position, width, height)
    image = np.empty((height, width, 3), np.float32)
    for row in range(0, height, _ROWS):  # the rest of the memory stays small
        part = pixels[row : row + _ROWS]
        # A mantissa stands for the middle of what is rounded to it; exponent 0 is black.
        scale = np.where(part[..., 3:] > 0, np.exp2(part[..., 3:].astype(np.float64) - 136), 0)
        image[row : row + _ROWS] = (part[..., :3] + 0.5) * scale / exposure
    image = image[::-1] if flip_y else image
    return np.ascontiguousarray(image[:, ::-1] if flip_x else image)


def _hdr_header(path: Any, data: bytes) -> tuple[float, int, int, bool, bool, int]:
    """Exposure, width, height, whether rows and columns are reversed, where the pixels begin."""
    if not data.startswith(b"#?"):
        raise bad(path, "line 1", f"expected '#?RADIANCE', got {shown(data[:20])}")
    head, blank, _ = data[:_LONGEST_HEADER].partition(b"\n\n")
    position = len(head) + 2
    end = data.find(b"\n", position, position + 200)
    if not blank or end < 0:
        raise bad(path, "header", "expected an empty line and the size, got the end of the header")
    exposure = 1.0
    for line in head.split(b"\n")[1:]:
        name, _, value = line.partition(b"=")
        if name == b"FORMAT" and value.strip() != b"32-bit_rle_rgbe":
            raise bad(path, "header", f"expected 32-bit_rle_rgbe, got {shown(value.strip())}")
        if name == b"EXPOSURE":
            try:
                exposure *= float(value)
            except ValueError:
                exposure = np.nan
    if not (exposure > 0 and np.isfinite(exposure)):
        raise bad(path, "header", "expected an exposure above 0, got another")
    size = re.fullmatch(rb"([-+])Y (\d{1,9}) ([-+])X (\d{1,9})", data[position:end].strip())
    if not size or not int(size[2]) or not int(size[4]):
        got = shown(data[position:end])
        raise bad(path, "header", f"expected a size like '-Y 512 +X 1024', got {got}")
    return exposure, int(size[4]), int(size[2]), size[1] == b"+", size[3] == b"-", end + 1


def _scan_lines(path: Any, data: bytes, position: int, width: int, height: int) -> np.ndarray:
    """Rows of four planes, each in runs (n > 128: one byte n - 128 times) and dumps (n bytes)."""
    start = bytes((2, 2, width >> 8, width & 255))
    planes = bytearray()
    for row in range(height):
        if data[position : position + 4] != start:
            raise bad(path, f"row {row}", "expected the start of a row, got other data")
        position += 4
        end = len(planes) + 4 * width
        while len(planes) < end and position + 1 < len(data):
            n = data[position]
            if n > 128:
                planes += data[position + 1 : position + 2] * (n - 128)
                position += 2
            else:
                planes += data[position + 1 : position + 1 + n]
                position += 1 + n
            if n == 0:
                break
        if len(planes) != end:
            raise bad(path, f"row {row}", f"expected {width} pixels, got another number")
    return np.frombuffer(planes, np.uint8).reshape(height, 4, width).transpose(0, 2, 1)


def _flat(path: Any, data: bytes, position: int, width: int, height: int) -> np.ndarray:
    """Pixels one after the other; (1, 1, 1, n) repeats the one before n times, and several of these
    in a row are the digits of n to the base 256, lowest first."""
    n_held = (len(data) - position) // 4
    pixels = np.frombuffer(data, np.uint8, 4 * n_held, position).reshape(-1, 4)
    run = (pixels[:, :3] == 1).all(axis=1)
    index = np.arange(n_held)
    pixel = np.maximum.accumulate(np.where(run, -1, index)) if n_held else index
    digit = np.minimum(index - pixel - 1, 4)  # of a run; more digits than 4 are too many anyway
    count = np.where(run, pixels[:, 3].astype(np.int64) << np.where(run, 8 * digit, 0), 1)
    total = int(count.sum())
    if total != width * height or (n_held and run[0]):
        raise bad(path, "data", f"expected {width * height} pixels, got {total}")
    return pixels[np.repeat(pixel, count)].reshape(height, width, 4)


def _check_pixels(path: Any, width: int, height: int, bytes_each: float) -> None:
    """Refuse a size that is too large for its file or memory; bytes_each: of a pixel, at the
    peak."""
    if width * height > MOST_PIXELS:
        got = f"{width}x{height}"
        raise bad(path, "header", f"expected at most {MOST_PIXELS:,} pixels, got {got}")
    check_size(path, "header", 12 * width * height, os.path.getsize(path), bytes_each / 12)
