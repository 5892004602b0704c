"""The surface that a blade sweeps along a stroke in the image."""

from __future__ import annotations

import numpy as np

from ..render.camera import Camera


def ribbon(points: list, camera: Camera, depth: float, above: float) -> np.ndarray:
    """The swept surface of a blade as triangles (M, 3, 3), world.

    Args:
        points: (x, y, z) each, world: the stroke on the surface.
        camera: along whose rays the stroke is swept.
        depth: below the stroke, world units.
        above: above the stroke, world units.

    Raises:
        ValueError: the stroke is a single point.
    """
    line = np.asarray(points, np.float64)
    keep = np.append(True, np.linalg.norm(np.diff(line, axis=0), axis=1) > 0)
    line = line[keep]
    if len(line) < 2:
        raise ValueError("cut: expected a stroke between two points, got one point")
    away = camera.towards(line)
    top, bottom = line - above * away, line + depth * away
    a, b, c, d = top[:-1], top[1:], bottom[:-1], bottom[1:]
    return np.concatenate([np.stack([a, b, c], 1), np.stack([b, d, c], 1)]).astype(np.float32)
