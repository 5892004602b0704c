"""Questions about a scene, as functions: each is the scene's method of the same name."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from .scene import Intersections, SceneBase
    from .thesis import Thesis


def field(scene: SceneBase, points: ArrayLike) -> np.ndarray:
    """The field (M,) float32 at points (M, 3), world: sum of weight * b(r). See `Scene.field`."""
    return _method(scene, "field")(points)


def gradient(scene: SceneBase, points: ArrayLike) -> np.ndarray:
    """The gradient of the field, (M, 3) float32 per world unit, at points (M, 3), world. The
    gradient points inwards. See `Scene.gradient`."""
    return _method(scene, "gradient")(points)


def intersect(
    scene: SceneBase, origins: ArrayLike, directions: ArrayLike, thesis: Thesis | None = None
) -> Intersections:
    """First intersections of rays with the surface: distance (M,), normal and color (M, 3).

    origins are (M, 3) world, directions (M, 3) unit vectors. See `Scene.intersect`.
    """
    return _method(scene, "intersect")(origins, directions, thesis)


def neighbors(scene: SceneBase, points: ArrayLike, radius: float) -> tuple[np.ndarray, np.ndarray]:
    """Particles within a radius of points (M, 3), world: offsets (M + 1,) and indices, as
    compressed rows. See `Scene.neighbors`."""
    return _method(scene, "neighbors")(points, radius)


def blend(scene: SceneBase, points: ArrayLike, values: ArrayLike) -> np.ndarray:
    """Particles' values (N,) or (N, K), blended at points (M, 3), world: (M,) or (M, K) float32.
    See `Scene.blend`."""
    return _method(scene, "blend")(points, values)


def _method(scene: Any, name: str) -> Any:
    if not hasattr(scene, name):
        raise TypeError(
            f"scene: expected a Scene, got {type(scene).__name__}; make one: globule.Scene(...)"
        )
    return getattr(scene, name)
