"""The image of pieces that are shaded each by its own device: the nearest of each pixel."""

from __future__ import annotations

import numpy as np

from .._base.ranks import Alone


def nearest_image(
    ranks: Alone, depth: np.ndarray, picture: np.ndarray
) -> tuple[np.ndarray, np.ndarray] | None:
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
    best, winner = t[0].view(np.float32).copy(), np.zeros(len(t[0]) // 4, np.intp)
    for k, part in enumerate(t[1:], 1):
        other = part.view(np.float32)
        np.copyto(winner, k, where=other < best)
        np.minimum(best, other, out=best)
    pixel = np.dtype("V3")
    winner *= len(best)
    winner += np.arange(len(best))
    shown = np.concatenate([part.view(pixel) for part in light]).take(winner)
    pixels = np.diff(bounds)
    found = [
        ranks.gather(_bytes(a), (pixels * size).tolist()) for a, size in ((best, 4), (shown, 3))
    ]
    if ranks.rank:
        return None
    whole = [np.concatenate(parts) for parts in found]
    return whole[0].view(np.float32).reshape(depth.shape), whole[1].reshape(picture.shape)


def _bytes(image: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(image).reshape(-1).view(np.uint8)
