"""Ready-made looks: material, light and surroundings that go together, scaled to a scene."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from .._base.arrays import ColorLike, VectorLike, to_host
from .._base.checks import choice, named
from ..pieces.scene import Scene
from ..scene.mesh import Mesh
from ..scene.scene import REACH
from .camera import view_axes
from .fit import corners_of
from .layers import beside
from .lights import DirectionalLight, Ground, Headlight, Sky
from .materials import Material
from .settings import RenderSettings, extent_of

if TYPE_CHECKING:
    pass

GROUNDS = {"plain": 0.0, "checker": 1 / 4}  # edges of their squares, of the scene's extent
PRESETS = ("blood", "water", "glass", "tissue", "clay", "flat")


@named
def load_preset(name: str, scene: Scene | Mesh, up: VectorLike | None = None) -> RenderSettings:
    """Settings that show a scene as blood, water, glass, tissue or clay, or flat.

    Blood, water and glass have colors of their own; tissue and clay show the particles'. Flat is no
    light: each pixel has the particles' color, for colors that stand for values. The other presets
    scale absorption to the scene's extent (blood: to the supports): a model of a river and a model
    of a drop look alike. `dataclasses.replace` changes a part of the settings.

    Args:
        name: blood, water, glass, tissue, clay or flat.
        scene: a `Scene` or a `Mesh`; the preset uses its size and lowest point. The image may show
            other scenes, too.
        up: (3,) direction to the sky, away from the ground; default: that of the particles.

    Returns:
        `RenderSettings`.
    """
    if not isinstance(scene, (Scene, Mesh)):
        raise TypeError(f"scene: expected a Scene or a Mesh, got {type(scene).__name__}; make one: globule.Scene(...)")
    choice("name", name, PRESETS)
    extent = extent_of(scene) or 1.0
    support = 0.0 if isinstance(scene, Mesh) else float(np.max(to_host(scene.support), initial=0.0))
    support = support or extent
    return _MAKE[name](_Stage(scene, scene.up if up is None else up), extent, support)


LOWEST = 256  # particles below which the surface is looked for


def ground_height(scene: Scene | Mesh, up: VectorLike | None = None) -> float:
    """Height along `up`, world units, of a ground that touches the scene's surface from below."""
    _, up, _ = view_axes(scene.up if up is None else up)
    if isinstance(scene, Mesh):
        return float((corners_of(scene) @ up).min())
    positions = scene.particles.finite_positions()
    support = float(np.max(to_host(scene.support), initial=0.0))
    heights = positions @ up
    lowest = float(heights.min()) if len(positions) else 0.0
    one = scene.surface == "smooth" and not beside(scene)
    if one and len(positions):  # where the lowest particles' surface ends
        near = positions[np.argsort(heights)[:LOWEST]]
        below = (near - 2 * support * up).astype(np.float32)
        upwards = np.tile(up.astype(np.float32), (len(below), 1))
        distance = scene.intersect(below, upwards).distance
        seen = np.isfinite(distance)
        if seen.any():
            return float((below[seen] @ up + distance[seen]).min())
    return lowest - REACH[scene.kernel] * support


def _per(length: float, *values: float) -> tuple[float, ...]:
    return tuple(value / length for value in values)


class _Stage:
    """The directions and the ground of a scene."""

    def __init__(self, scene: Scene | Mesh, up: VectorLike):
        self.right, self.up, self.front = view_axes(up)
        self.height = ground_height(scene, self.up)
        if isinstance(scene, Mesh):
            self.colored = scene.colored
        else:
            self.colored = scene.particles.color is not None

    def sun(self, radiance: ColorLike, angle: float, right: float = -0.5) -> DirectionalLight:
        """A light from above, a little in front, and `right` to the right, along `view_axes`."""
        towards = right * self.right + 1.0 * self.up + 0.45 * self.front
        return DirectionalLight(towards, radiance, angle)

    def own_color(self, color: ColorLike) -> Any:
        """None where the particles have colors, for a material to show them."""
        return None if self.colored else color

    def ground(self, color: ColorLike, other: ColorLike | None = None, check: float = 0.0) -> Ground:
        return Ground(self.height, self.up, color, color if other is None else other, check)

    def sky(self, zenith: ColorLike, horizon: ColorLike, ground: ColorLike) -> Sky:
        return Sky(zenith, horizon, ground, self.up)


def _blood(stage: _Stage, extent: float, support: float) -> RenderSettings:
    return RenderSettings(
        lights=(Headlight((0.12,) * 3), stage.sun((0.78, 0.75, 0.72), 6.0)),
        ambient="sky",
        material=Material(
            reflection=0.0, transmission=0.75, index=1.36, color=(0.30, 0.004, 0.005),
            absorption=_per(support, 0.5, 4.5, 5.0), specular=1.0, shininess=250.0,
        ),
        shadows=True,
        sky=stage.sky((0.50, 0.52, 0.55), (0.90, 0.90, 0.89), (0.45, 0.45, 0.45)),
        ground=stage.ground(0.68),
        bounces=5,
        samples=4,
    )  # fmt: skip


def _water(stage: _Stage, extent: float, support: float) -> RenderSettings:
    return RenderSettings(
        lights=(stage.sun((0.58, 0.54, 0.46), 3.0),),
        ambient="sky",
        material=Material(
            reflection=0.0, transmission=1.0, index=1.33,
            absorption=_per(extent, 5.5, 1.3, 0.55), specular=0.8, shininess=250.0,
        ),
        shadows=True,
        sky=stage.sky((0.28, 0.46, 0.72), (0.90, 0.93, 0.96), (0.36, 0.34, 0.30)),
        ground=stage.ground((0.56, 0.53, 0.47), (0.46, 0.43, 0.38), extent / 4),
        bounces=6,
        samples=4,
    )  # fmt: skip


def _glass(stage: _Stage, extent: float, support: float) -> RenderSettings:
    return RenderSettings(
        lights=(stage.sun((0.70,) * 3, 4.0),),
        ambient="sky",
        material=Material(
            reflection=0.0, transmission=1.0, index=1.5,
            absorption=_per(extent, 0.45, 0.16, 0.24), specular=1.0, shininess=400.0,
        ),
        shadows=True,
        sky=stage.sky((0.16, 0.20, 0.28), (0.88, 0.90, 0.92), (0.12, 0.12, 0.14)),
        ground=stage.ground((0.40, 0.41, 0.43), (0.24, 0.25, 0.28), extent / 3),
        bounces=8,
        samples=4,
    )  # fmt: skip


def _tissue(stage: _Stage, extent: float, support: float) -> RenderSettings:
    # Warm light makes flesh of gray intensities, and keeps the differences between them.
    return RenderSettings(
        lights=(Headlight((0.38, 0.27, 0.24)), stage.sun((0.74, 0.51, 0.44), 10.0, 0.5)),
        ambient=(0.38, 0.25, 0.23),
        background=(0.012, 0.016, 0.024),
        material=Material(
            reflection=0.0, transmission=0.0, color=stage.own_color((0.62, 0.38, 0.35)),
            specular=0.35, shininess=35.0,
        ),
        shadows=True,
        ambient_rays=6,
        ambient_distance=0.12 * extent,
        samples=4,
    )  # fmt: skip


def _clay(stage: _Stage, extent: float, support: float) -> RenderSettings:
    return RenderSettings(
        lights=(stage.sun((0.58, 0.55, 0.50), 12.0),),
        ambient="sky",
        material=Material(
            reflection=0.0, transmission=0.0, color=stage.own_color((0.50, 0.25, 0.14)),
            specular=0.0,
        ),
        shadows=True,
        ambient_rays=8,
        ambient_distance=0.25 * extent,
        sky=stage.sky((0.60, 0.64, 0.70), (0.80, 0.80, 0.79), (0.5, 0.5, 0.5)),
        ground=stage.ground(0.66),
        samples=4,
    )  # fmt: skip


def _flat(stage: _Stage, extent: float, support: float) -> RenderSettings:
    material = Material(reflection=0.0, transmission=0.0, specular=0.0)
    return RenderSettings(lights=(), ambient=1.0, material=material, tone=False)


_MAKE = {"blood": _blood, "water": _water, "glass": _glass, "tissue": _tissue, "clay": _clay, "flat": _flat}
