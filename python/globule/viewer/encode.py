"""Pictures as JPEG, by the fastest encoder that is installed."""

from __future__ import annotations

import io

import numpy as np


def jpeg(picture: np.ndarray, quality: int, sharp: bool = False) -> bytes:
    """A picture (H, W, 3) uint8 sRGB; sharp: colours of every pixel, not of each four."""
    picture = np.ascontiguousarray(picture)
    try:
        import simplejpeg
    except ImportError:
        return _pillow(picture, quality, sharp)
    sampling = "444" if sharp else "420"
    return simplejpeg.encode_jpeg(picture, quality, "RGB", sampling, fastdct=True)


def _pillow(picture: np.ndarray, quality: int, sharp: bool) -> bytes:
    from PIL import Image

    data = io.BytesIO()
    Image.fromarray(picture).save(data, "JPEG", quality=quality, subsampling=0 if sharp else 2)
    return data.getvalue()
