"""How hits become light: the settings of an image."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any

import numpy as np

from .. import _core
from .._base.checks import flag, number, shown, three, whole
from .._base.fixed import Fixed, read_only
from ..scene.mesh import Mesh
from ..scene.scene import Scene
from .lights import (
    MAX_LIGHTS,
    DirectionalLight,
    Environment,
    Ground,
    Headlight,
    PointLight,
    Sky,
    uniform_sky,
)
from .materials import Material

MAX_SAMPLES = 65536
SMOOTH_EDGES = 3  # more samples at edges, by default, where a surface is smooth or of spheres


def items(name: str, value: Any, expected: str) -> tuple:
    """The items of anything that can be iterated."""
    try:
        return tuple(value)
    except (TypeError, NotImplementedError):  # the latter: a memoryview
        raise TypeError(f"{name}: expected {expected}, got {shown(value)}") from None


@read_only
@dataclass(frozen=True)
class RenderSettings(Fixed):
    """How a hit becomes light. Colors and radiances are linear RGB; 1 is white. One number
    stands for all three channels.

    Args:
        lights: up to 8.
        ambient: light from everywhere: (3,) radiance, or "sky" for the sky's own.
        background: (3,) radiance behind the scene, where `sky` is None.
        material: of every scene that has none of its own.
        specular, shininess: highlight of the lights, for materials without their own values.
        exposure: factor of the image's light.
        shadows: whether directional and point lights cast shadows.
        ambient_rays: rays per sample that test how open a place is (ambient occlusion), 0 to 256.
        ambient_distance: length of these rays, world units; None: a tenth of the scene's extent.
        sky: `Sky` or `Environment`; also visible behind the scene. None: the background everywhere.
        ground: a plane under the scene.
        bounces: number of reflections and refractions along a ray, 0 to 32.
        cutoff: a ray that carries less than this share of a pixel's light ends in the sky, 0 to 1.
        samples: rays per pixel, 1 to 65536; the first goes through the pixel's center, the others
            anywhere in it.
        tone: whether `Frame.image` compresses light above 0.8. False: `Frame.image` is
            `Frame.color` in sRGB, clipped at 1, without `exposure`.
        transparent: whether `Frame.image` is RGBA. A pixel's alpha is the share of its rays that
            hit a surface or the ground; an image of several samples has smooth edges.
        edge_samples: more rays, 0 to 64, for pixels beside a jump of distance, normal or layer
            (silhouettes, creases, cuts) in images of one sample a pixel. In images with shadows,
            reflection, transmission, clips, sky, ground or several layers, pixels beside a jump of
            color (a tenth of white as displayed, in any channel) have them too, unless the image is
            `transparent` or has ambient rays. Images of more samples have no edge samples. None: 3
            where a layer has a smooth surface or shows 2-D data, else 0.

    Raises TypeError and ValueError naming the field, the expected and the given value.
    """

    lights: Sequence[Headlight | DirectionalLight | PointLight] = (Headlight(), DirectionalLight())
    ambient: Any = (0.16, 0.18, 0.21)
    background: Any = (0.93, 0.94, 0.96)
    material: Material = Material()
    specular: float = 0.22
    shininess: float = 60.0
    exposure: float = 1.0
    shadows: bool = False
    ambient_rays: int = 0
    ambient_distance: float | None = None
    sky: Sky | Environment | None = None
    ground: Ground | None = None
    bounces: int = 4
    cutoff: float = 1 / 32
    samples: int = 1
    tone: bool = True
    transparent: bool = False
    edge_samples: int | None = None

    def _check(self) -> None:
        if not isinstance(self.material, Material):
            raise TypeError(f"material: expected Material, got {shown(self.material)}")
        whole("samples", self.samples, 1, MAX_SAMPLES)
        flag("tone", self.tone)
        flag("transparent", self.transparent)
        self._packed  # noqa: B018  making it checks the other fields

    @cached_property
    def _packed(self) -> Any:
        """What the core takes; how far ambient rays look in no scene in particular: 0."""
        return self._pack(0.0 if self.transparent else None)

    def _pack(self, behind: float | None) -> Any:
        """What the core takes, with a background of `behind` in place of background and sky."""
        lights = items("lights", self.lights, "a list of lights")
        if len(lights) > MAX_LIGHTS:
            raise ValueError(f"lights: expected at most {MAX_LIGHTS}, got {len(lights)}")
        for light in lights:
            if not isinstance(light, (Headlight, DirectionalLight, PointLight)):
                expected = "expected Headlight, DirectionalLight or PointLight"
                raise TypeError(f"lights: {expected}, got {shown(light)}")
        if not isinstance(self.sky, (Sky, Environment, type(None))):
            raise TypeError(f"sky: expected Sky or Environment, got {shown(self.sky)}")
        if not isinstance(self.ground, (Ground, type(None))):
            raise TypeError(f"ground: expected Ground, got {shown(self.ground)}")
        sky_light = isinstance(self.ambient, str)
        if sky_light and self.ambient != "sky":
            raise ValueError(f'ambient: expected a color or "sky", got {shown(self.ambient)}')
        rays = whole("ambient_rays", self.ambient_rays, 0, 256)
        far = 0.0 if self.ambient_distance is None else self.ambient_distance
        distance = number("ambient_distance", far, 0.0)
        background = three("background", self.background, 0.0)
        return _core.Look(
            {
                "lights": [light._pack() for light in lights],
                "ambient": [0.0, 0.0, 0.0] if sky_light else three("ambient", self.ambient, 0.0),
                "sky_light": sky_light,
                "background": background if behind is None else [behind] * 3,
                "exposure": number("exposure", self.exposure, 0.0),
                "shadows": flag("shadows", self.shadows),
                "ambient_rays": rays,
                "ambient_distance": distance,
                "sky": (self.sky or uniform_sky(background))._pack(),
                "show_sky": self.sky is not None and behind is None,
                "ground": self.ground._pack() if self.ground else None,
                "depth": whole("bounces", self.bounces, 0, 32),
                "edge_samples": whole("edge_samples", self.edge_samples or 0, 0, 64),
                "edge_contrast": behind is None,
                "cutoff": number("cutoff", self.cutoff, 0.0, 1.0),
                "specular": number("specular", self.specular, 0.0),
                "shininess": number("shininess", self.shininess, 0.0),
            }
        )

    @property
    def is_flat(self) -> bool:
        """Whether every surface shows its own color, without light."""
        return not (self.lights or self.ambient_rays or self.tone) and _light(self) == _light(
            _WHITE
        )

    def _look(self, scenes: Sequence[Scene | Mesh], behind: float | None = None) -> Any:
        """What the core takes for an image of `scenes`; behind: as for `_pack`."""
        look = self._packed if behind is None else self._pack(behind)
        if self.ambient_distance is None and self.ambient_rays:
            look = look.reaching(0.1 * extent_of(scenes[0]))
        if self.edge_samples is None and _has_edges(scenes):
            look = look.with_edges(SMOOTH_EDGES)
        return look

    def _mixes(self, scenes: Sequence[Scene | Mesh]) -> bool:
        """Whether pixels at edges may be mixtures in an image of one sample."""
        own = self.edge_samples
        return _has_edges(scenes) if own is None else own > 0


def _has_edges(scenes: Sequence[Scene | Mesh]) -> bool:
    """Whether edges have more samples by default."""
    return any(isinstance(s, Scene) and s.surface != "balls" for s in scenes)


def extent_of(scene: Scene | Mesh) -> float:
    """The longest edge of the scene's box, world units."""
    if isinstance(scene, Mesh):
        return float(np.ptp(scene.bounds(), axis=0).max())
    return scene.octree.extent


_DEFAULT = RenderSettings()
NAMES = tuple(field.name for field in fields(RenderSettings))
# Light for colors of values: white, so that a color keeps its hue, and at most 1 in all, so that no
# channel is clipped. A surface has 0.55 to 1 of its color; one that faces eye and sun has all.
_WHITE = RenderSettings(lights=(), ambient=1.0)
_EVEN = {"lights": (Headlight(0.25), DirectionalLight(radiance=0.20)), "ambient": 0.55}


def _light(settings: RenderSettings) -> tuple[Any, ...]:
    """Lights and ambient light as plain numbers, which can be compared."""
    sky = isinstance(settings.ambient, str)
    ambient = settings.ambient if sky else list(three("ambient", settings.ambient, 0.0))
    return [light._pack() for light in settings.lights], ambient


def for_values(settings: RenderSettings) -> RenderSettings:
    """The settings for colors that stand for values: colors of the particles, diffuse shading.

    Where lights and ambient light are the defaults, white light of at most 1 takes their place,
    and the tone curve is off. Highlight, reflection and transmission become 0 where neither the
    settings nor their material set them.
    """
    changes: dict[str, Any] = {}
    if _light(settings) == _light(_DEFAULT):
        changes |= _EVEN | {"tone": settings.tone and settings.exposure != 1}
    material = replace(settings.material, color=None)
    for name in ("reflection", "transmission"):
        if getattr(material, name) is None and material.index is None:
            material = replace(material, **{name: 0.0})
    if settings.specular == _DEFAULT.specular:
        changes["specular"] = 0.0
    return replace(settings, material=material, **changes)


def for_flat_data(settings: RenderSettings) -> RenderSettings:
    """The settings for 2-D data: flat colors, where lights and ambient light are the defaults."""
    if _light(settings) != _light(_DEFAULT):
        return settings
    return replace(settings, lights=(), ambient=1.0, tone=False)


def as_settings(value: RenderSettings | Mapping[str, Any] | None) -> RenderSettings:
    """Settings of a dict of their fields; the default ones of None.

    Raises TypeError and ValueError naming the field, the expected and the given value.
    """
    if value is None:
        return _DEFAULT
    if isinstance(value, RenderSettings):
        return value
    if isinstance(value, str):
        raise TypeError(
            f"settings: expected RenderSettings or a dict of its fields, got {shown(value)}; "
            f"globule.preset({value!r}, scene) makes a preset's"
        )
    if not isinstance(value, Mapping):
        raise TypeError(
            f"settings: expected RenderSettings or a dict of its fields, got {shown(value)}"
        )
    for name in value:
        if name not in (*NAMES, "depth"):
            raise TypeError(f"settings: expected some of {', '.join(NAMES)}, got {name!r}")
    return RenderSettings(**value)
