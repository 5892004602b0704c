"""Pictures of a scene."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from .arrays import address
from .camera import Camera
from .files import atomic_write
from .particles import to_host
from .scene import Scene
from .thesis import Thesis, choose_tracing

MAX_PIXELS = 2**28
# How far from a particle, in supports, the surface may lie: where b = 0.6 / 8, so that it takes
# eight particles at one place to reach the default threshold.
REACH = {
    "murakami": 0.85,
    "nishimura": 0.78,
    "wyvill": 0.82,
    "blinn": 0.47,
    "cubic_spline": 0.67,
    "wendland_c2": 0.62,
}
MAX_LIGHTS = 8


@dataclass(frozen=True)
class Headlight:
    """Light from the eye."""

    radiance: Any = (0.35, 0.35, 0.35)


@dataclass(frozen=True)
class DirectionalLight:
    """Light from far away. direction: (3,) world, towards the light."""

    direction: Any = (-0.4, 1.0, 0.6)
    radiance: Any = (0.75, 0.73, 0.70)


@dataclass(frozen=True)
class PointLight:
    """Light from a point, without fall-off. position: (3,) world."""

    position: Any
    radiance: Any = (0.75, 0.75, 0.75)


@dataclass(frozen=True)
class RenderSettings:
    """How hits are turned into light. Colours and radiances are linear, [0, 1] for white."""

    lights: Sequence[Headlight | DirectionalLight | PointLight] = (Headlight(), DirectionalLight())
    ambient: Any = (0.16, 0.18, 0.21)
    background: Any = (0.93, 0.94, 0.96)
    specular: float = 0.22
    shininess: float = 60.0
    exposure: float = 1.0

    def _pack(self) -> dict:
        if len(self.lights) > MAX_LIGHTS:
            raise ValueError(f"lights: expected at most {MAX_LIGHTS}, got {len(self.lights)}")
        lights = []
        for light in self.lights:
            kind = {Headlight: 0, DirectionalLight: 1, PointLight: 2}.get(type(light))
            if kind is None:
                raise TypeError(
                    f"lights: expected Headlight, DirectionalLight or PointLight, got {light!r}"
                )
            place = (0, 0, 1) if kind == 0 else light.direction if kind == 1 else light.position
            lights.append((kind, _three("light", place), _three("radiance", light.radiance)))
        return {
            "lights": lights,
            "ambient": _three("ambient", self.ambient),
            "background": _three("background", self.background),
            "specular": float(self.specular),
            "shininess": float(self.shininess),
            "exposure": float(self.exposure),
        }


@dataclass
class Frame:
    """A finished picture. Its images stay on the device until asked for, then are NumPy arrays.

    `color` (H, W, 3) float32 linear, `picture` (H, W, 3) uint8 sRGB, `depth` (H, W) float32 along
    the ray, infinite where missed, `position` and `normal` (H, W, 3) float32 world (position NaN
    and normal 0 where missed), `albedo` (H, W, 3) blended colour, `mask` (H, W) bool.
    """

    size: tuple[int, int]
    _frame: Any = field(repr=False)
    _scene: Scene = field(repr=False)

    def _take(self, name: str, channels: int, dtype: Any = np.float32) -> np.ndarray:
        shape = (self.size[1], self.size[0]) + ((channels,) if channels > 1 else ())
        out = np.empty(shape, dtype)
        getattr(self._frame, name)(address(out))
        return out

    @property
    def color(self) -> np.ndarray:
        return self._take("color", 3)

    @property
    def picture(self) -> np.ndarray:
        return self._take("picture", 3, np.uint8)

    @property
    def depth(self) -> np.ndarray:
        return self._take("depth", 1)

    @property
    def position(self) -> np.ndarray:
        return self._take("position", 3)

    @property
    def normal(self) -> np.ndarray:
        return self._take("normal", 3)

    @property
    def albedo(self) -> np.ndarray:
        return self._take("albedo", 3)

    @property
    def mask(self) -> np.ndarray:
        return np.isfinite(self.depth)

    @property
    def trace_seconds(self) -> float:
        """Device time from the first ray to the shaded picture."""
        return self._frame.trace_seconds()

    def attribute(self, values: Any) -> np.ndarray:
        """Per-particle values (N,) or (N, K) blended at every hit: (H, W[, K]), else NaN."""
        points = self.position.reshape(-1, 3)
        hit = np.isfinite(points[:, 0])
        blended = self._scene.blend(points[hit], values)
        out = np.full((len(points),) + blended.shape[1:], np.nan, np.float32)
        out[hit] = blended
        return out.reshape((self.size[1], self.size[0]) + blended.shape[1:])

    def save(self, path: Any) -> None:
        """Write the picture (.png) or every image (.npz); whole or not at all."""
        name = str(path).lower()
        if name.endswith(".png"):
            from PIL import Image

            with atomic_write(path) as file:
                Image.fromarray(self.picture).save(file, format="PNG", compress_level=4)
        elif name.endswith(".npz"):
            images = {
                k: getattr(self, k)
                for k in ("color", "depth", "position", "normal", "albedo", "mask")
            }
            with atomic_write(path) as file:
                np.savez_compressed(file, **images)
        else:
            raise ValueError(f"{path}: expected a name ending in .png or .npz")


def render(
    scene: Scene,
    camera: Camera | None = None,
    size: tuple[int, int] = (1024, 782),
    settings: RenderSettings | None = None,
    thesis: Thesis | None = None,
) -> Frame:
    """Trace a ray through each pixel's centre to the first point where the field is the threshold.

    Args:
        scene: what to see.
        camera: default: `Camera.fit(scene)`.
        size: (width, height) pixels.
        thesis: trace the source thesis's way, with these choices; default: exactly.
    """
    try:
        width, height = (int(v) for v in size)
    except (TypeError, ValueError):
        raise TypeError(f"size: expected (width, height), got {size!r}") from None
    if width < 1 or height < 1 or width * height > MAX_PIXELS:
        raise ValueError(f"size: expected 1 to {MAX_PIXELS:,} pixels, got {width}x{height}")
    if camera is None:
        camera = fit_camera(scene, (width, height))
    view = [float(v) for v in camera.frame((width, height)).ravel()]
    look = (settings or RenderSettings())._pack()
    choose_tracing(scene, thesis)
    frame = scene._scene.render(
        scene._kernel, scene.threshold, view, width, height, camera.height is not None, look
    )
    return Frame((width, height), frame, scene)


def fit_camera(scene: Scene, size: tuple[int, int], **options: Any) -> Camera:
    """`Camera.fit` with room for the surface around the particles."""
    support = scene.support
    largest = support if np.isscalar(support) else np.max(to_host(support), initial=0.0)
    margin = REACH[scene.kernel] * float(largest)
    return Camera.fit(
        scene.particles, size=size, margin=margin if np.isfinite(margin) else 0.0, **options
    )


def _three(name: str, value: Any) -> list[float]:
    array = np.asarray(value, dtype=np.float32)
    if array.shape == ():
        array = np.repeat(array, 3)
    if array.shape != (3,) or not np.isfinite(array).all():
        raise ValueError(f"{name}: expected three finite numbers, got {value!r}")
    return [float(v) for v in array]
