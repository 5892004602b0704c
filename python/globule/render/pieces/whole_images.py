"""One image of the finished frames of several ranks."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ... import _core
from ..._base.ranks import Alone


def take_all(
    ranks: Alone, own: Any, images: Sequence[str], size: tuple[int, int], fact: Any = None, dealt: Any = None
) -> tuple[bool, list[Any]]:
    """Make rank 0's frame that of all ranks of one host, on its device: images never pass the host. All ranks call it.

    Of each pixel the nearest rank's is taken, or that of the rank to which the view `dealt` deals it.

    Args:
        own: the core's frame that this rank has made.
        images: names of the core's images; "depth" among them where the nearest is taken.
        size: of the frame; ValueError where the ranks have others.
        fact: of this rank, for all.

    Returns:
        Whether it was done: rank 0's device may not reach the others. All ranks' facts.
    """
    if ranks.size == 1:
        return True, [fact]
    lent, taken, error = None, False, None
    try:
        lent = own.lend(images) if ranks.one_host else None
    except Exception as own_error:
        error = own_error
    places, sizes, facts = zip(*ranks.agreed(error, (lent, tuple(size), fact)), strict=True)
    ranks.check_same(size=sizes)
    if None in places:
        return False, list(facts)
    try:
        taken = ranks.rank == 0 and own.take(images, places, dealt)
    except Exception as own_error:
        error = own_error
    return bool(ranks.agreed(error, taken)[0]), list(facts)


def nearest_frame(ranks: Alone, frame: Any) -> tuple[np.ndarray, np.ndarray] | None:
    """`nearest_image` of finished frames, on the devices where rank 0's reaches them."""
    if take_all(ranks, frame._frame, ("depth", "picture"), frame.size)[0]:
        return (frame.distance, frame.image) if ranks.rank == 0 else None
    return nearest_image(ranks, frame.distance, frame.image)


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
