"""Images as JPEG, by the fastest encoder that is installed.

Large images are encoded in strips, on several cores. Restart markers (ITU-T T.81, B.2.1) join the
strips to one file of the same pixels as from one piece, whatever the number of cores.
"""

from __future__ import annotations

import functools
import io
import os
from concurrent.futures import ThreadPoolExecutor

import numpy as np

STRIP = 128  # rows; a multiple of the rows of a block, 8 or 16
LARGE = 1 << 19  # pixels, from which strips save time
MOST_THREADS = 8


def jpeg(picture: np.ndarray, quality: int, sharp: bool = False) -> bytes:
    """The bytes of a JPEG file.

    Args:
        picture: (H, W, 3) uint8 sRGB.
        quality: 1 to 100.
        sharp: store a color for each pixel (4:4:4) instead of for every four (4:2:0).
    """
    picture = np.ascontiguousarray(picture)
    try:
        import simplejpeg
    except ImportError:
        return _pillow(picture, quality, sharp)
    encode = functools.partial(
        simplejpeg.encode_jpeg,
        quality=quality,
        colorspace="RGB",
        colorsubsampling="444" if sharp else "420",
        fastdct=True,
    )
    height, width = picture.shape[:2]
    if height * width < LARGE or height <= STRIP:
        return encode(picture)
    strips = [picture[row : row + STRIP] for row in range(0, height, STRIP)]
    side = 8 if sharp else 16
    return joined(list(_threads().map(encode, strips)), height, STRIP // side * -(-width // side))


def joined(strips: list[bytes], height: int, interval: int) -> bytes:
    """One JPEG file of files that show its strips from above, with the same tables.

    Args:
        strips: baseline JPEG files of one width, without restart markers.
        height: of the image, pixels.
        interval: number of coded blocks (MCUs) of each strip but the last.
    """
    first = strips[0]
    size, scan = _segment(first, 0xC0), _segment(first, 0xDA)
    head = bytearray(first[:scan])
    head[size + 5 : size + 7] = height.to_bytes(2, "big")
    parts = [bytes(head), b"\xff\xdd\x00\x04", interval.to_bytes(2, "big")]
    for i, strip in enumerate(strips):
        at = _segment(strip, 0xDA)
        if i == 0:
            parts.append(strip[at:-2])
            continue
        data = at + 2 + int.from_bytes(strip[at + 2 : at + 4], "big")
        parts += [bytes((0xFF, 0xD0 + (i - 1) % 8)), strip[data:-2]]
    return b"".join([*parts, b"\xff\xd9"])


def _segment(file: bytes, marker: int) -> int:
    """Where a segment of a JPEG file begins. Raises ValueError."""
    at = 2
    while at + 4 <= len(file) and file[at] == 0xFF:
        if file[at + 1] == marker:
            return at
        at += 2 + int.from_bytes(file[at + 2 : at + 4], "big")
    raise ValueError(f"JPEG: expected a segment {marker:#x}, got none")


@functools.cache
def _threads() -> ThreadPoolExecutor:
    n = min(MOST_THREADS, os.cpu_count() or 1)
    return ThreadPoolExecutor(n, thread_name_prefix="jpeg strips")


def _pillow(picture: np.ndarray, quality: int, sharp: bool) -> bytes:
    from PIL import Image

    data = io.BytesIO()
    Image.fromarray(picture).save(data, "JPEG", quality=quality, subsampling=0 if sharp else 2)
    return data.getvalue()
