"""The image of pieces that are shaded each by its own device: the nearest of each pixel."""

from __future__ import annotations

import numpy as np

from ... import _core
from ..._base.ranks import Alone


def nearest_image(ranks: Alone, depth: np.ndarray, picture: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
    """The image of all ranks' pieces, on rank 0; elsewhere None.

    For eyes outside, weights of at least 0, no cuts, one sample a pixel and light that makes no
    turns (docs/design/pieces.md): a piece then shades its hits as one scene would.

    Each rank gets a stripe of all images, keeps what is nearest, and sends it on (direct-send).

    Args:
        depth: (H, W) float32, infinite where missed.
        picture: (H, W, 3) uint8.
    """
    if ranks.size == 1:
        return depth, picture
    n = depth.size
    bounds = n * np.arange(ranks.size + 1) // ranks.size
    t = ranks.swap(_bytes(depth), 4 * bounds)
    light = ranks.swap(_bytes(picture), 3 * bounds)
    pixels = np.diff(bounds)
    best = np.empty(pixels[ranks.rank], np.float32)
    shown = np.empty(3 * len(best), np.uint8)
    _core.nearest_pixels([part.view(np.float32) for part in t], light, best, shown)
    t_whole = ranks.gather(_bytes(best), (4 * pixels).tolist())
    light_whole = ranks.gather(shown, (3 * pixels).tolist())
    if t_whole is None or light_whole is None:
        return None
    return t_whole.view(np.float32).reshape(depth.shape), light_whole.reshape(picture.shape)


def _bytes(image: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(image).reshape(-1).view(np.uint8)
