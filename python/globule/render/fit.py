"""Cameras that show a whole scene."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from .._base.arrays import box_corners, to_host
from ..data.spacing import upwards
from ..fluids.likeness import shows_flat
from ..scene.mesh import Mesh
from ..scene.scene import REACH, SceneBase
from .annotate import Annotation, corners_to_fit, room
from .camera import Camera
from .legend import strip_width

if TYPE_CHECKING:
    from numpy.typing import ArrayLike


def along_normal(normal: np.ndarray) -> dict[str, Any]:
    """How a camera looks at 2-D data."""
    return {"direction": normal, "up": upwards(normal), "orthographic": True}


def fit_camera(
    scene: SceneBase | Mesh, size: tuple[int, int], around: ArrayLike | None = None, **options: Any
) -> Camera:
    """`Camera.fit` with room for the surface around the particles, or around the points (M, 3)."""
    if isinstance(scene, Mesh):
        return Camera.fit(corners_of(scene) if around is None else around, size=size, **options)
    if shows_flat(scene):
        assert scene.normal is not None
        options = along_normal(scene.normal) | options
    options = {"up": scene.up} | options
    seen = scene.particles if around is None else around
    return Camera.fit(seen, size=size, margin=surface_reach(scene), **options)


def surface_reach(scene: SceneBase) -> float:
    """How far the surface may be from the outermost particles, world units."""
    reach = REACH[scene.kernel] * float(np.max(to_host(scene.support), initial=0.0))
    return reach if np.isfinite(reach) else 0.0


def corners_of(mesh: Mesh) -> np.ndarray:
    """(8, 3), the corners of the mesh's box, world."""
    return box_corners(*mesh.bounds())


def fitted(
    scene: SceneBase | Mesh,
    size: tuple[int, int],
    annotation: Annotation | None,
    around: ArrayLike | None = None,
    **options: Any,
) -> Camera:
    """`fit_camera` with room for an annotation and its box."""
    around = corners_to_fit(annotation, scene, around)
    return with_room(size, annotation, shows_flat(scene), lambda size: fit_camera(scene, size, around, **options))


def with_room(
    size: tuple[int, int], annotation: Annotation | None, flat: bool, fit: Callable[[tuple[int, int]], Camera]
) -> Camera:
    """The camera that `fit` makes for a size (width, height), with room for an annotation. flat:
    whether the scene is 2-D data, which fill the image."""
    legend, more = annotation and annotation.legend, room(annotation)
    strip = strip_width(size) if legend and legend != "outside" and flat else 0
    camera = fit((max(1, size[0] - strip), size[1]))
    if strip and camera.height is not None:  # 2-D data fill the image: a legend stands beside them
        aside = -1 if str(legend).endswith("left") else 1
        right = camera.frame((1, 1))[2] * aside * strip / size[1]
        eye, middle = (tuple((v + right).tolist()) for v in (camera.eye, camera.look_at))
        camera = replace(camera, eye=eye, look_at=middle)
    if camera.height is not None:
        return replace(camera, height=more * camera.height)
    away = more * np.subtract(camera.eye, camera.look_at)
    return replace(camera, eye=tuple((camera.look_at + away).tolist()))
