"""Questions about a scene: the field and its gradient at points, what rays meet first."""

from __future__ import annotations

from typing import Any

import numpy as np

from .._base.arrays import address, unit_vectors, view
from .scene import Scene
from .thesis import Thesis, check_tracing


def field(scene: Scene, points: Any) -> np.ndarray:
    """The field at points: sum of weight * b(r).

    Args:
        points: (M, 3) world; NumPy or on the scene's device.

    Returns:
        (M,) float32.
    """
    p = view("points", points, 3)
    out = np.empty(p.shape[0], np.float32)
    scene._scene.evaluate(scene._kernel, p.shape[0], p.place, address(out), 0)
    return out


def gradient(scene: Scene, points: Any) -> np.ndarray:
    """The field's gradient at points, (M, 3) float32, per world unit; it points inwards."""
    p = view("points", points, 3)
    out = np.empty((p.shape[0], 3), np.float32)
    scene._scene.evaluate(scene._kernel, p.shape[0], p.place, 0, address(out))
    return out


def intersect(
    scene: Scene, origins: Any, directions: Any, thesis: Thesis | None = None
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """First intersection of arbitrary rays with the surface.

    Args:
        origins: (M, 3) world.
        directions: (M, 3) unit vectors.
        thesis: trace the source thesis's way, with these choices; default: exactly.

    Returns:
        depth (M,) along the ray, infinite where missed; normal (M, 3); colour (M, 3), blended.
    """
    o, d = view("origins", origins, 3), view("directions", directions, 3)
    if o.shape != d.shape:
        raise ValueError(f"directions: expected {o.shape[0]} rows, got {d.shape[0]}")
    d = unit_vectors(d)
    n = o.shape[0]
    depth = np.empty(n, np.float32)
    normal, color = np.empty((n, 3), np.float32), np.empty((n, 3), np.float32)
    check_tracing(scene, thesis)
    scene._scene.intersect(
        scene._kernel,
        scene.threshold,
        None if thesis is None else thesis._packed,
        n,
        o.place,
        d.place,
        address(depth),
        address(normal),
        address(color),
    )
    return depth, normal, color
