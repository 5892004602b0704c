"""Images as JPEG."""

from __future__ import annotations

import io

import numpy as np
from PIL import Image


def jpeg(picture: np.ndarray, quality: int, sharp: bool = False) -> bytes:
    """The bytes of a JPEG file.

    Args:
        picture: (H, W, 3) uint8 sRGB.
        quality: 1 to 100.
        sharp: store a color for each pixel (4:4:4) instead of for every four (4:2:0).
    """
    data = io.BytesIO()
    Image.fromarray(picture).save(data, "JPEG", quality=quality, subsampling=0 if sharp else 2)
    return data.getvalue()
