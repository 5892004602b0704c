"""How hits become light: the settings of an image."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any

import numpy as np

from .. import _core
from .._base.arrays import ColorLike
from .._base.checks import shown, three
from .._base.fixed import Fixed, read_only
from .._base.settings import RADIANCE, SHARE, Color, Each, Made, Number, Switch, Whole, check_all, setting
from ..scene.mesh import Mesh
from ..scene.scene import SceneBase
from .lights import LIGHTS, MAX_LIGHTS, DirectionalLight, Environment, Ground, Headlight, Light, Sky, uniform_sky
from .materials import Material

MAX_SAMPLES: int = _core.limits["samples"]
SMOOTH_EDGES = 3  # more samples at edges, by default, where a surface is smooth or of spheres


class Ambient(Color):
    """A radiance, or "sky"."""

    def __init__(self) -> None:
        super().__init__(RADIANCE.each.most, gray=True)
        self.expected = 'a color or "sky"'

    def _take(self, value: Any) -> Any:
        return value if isinstance(value, str) and value == "sky" else super()._take(value)


@read_only
@dataclass(frozen=True)
class RenderSettings(Fixed):
    """How a hit becomes light. Colors and radiances are linear RGB; 1 is white. One number
    stands for all three channels.
    """

    lights: Sequence[Light] = setting(
        Each(Made(*LIGHTS), most=MAX_LIGHTS),
        (Headlight(), DirectionalLight()),
        f"lights, up to {MAX_LIGHTS}, or a single one",
    )
    ambient: ColorLike | str = setting(
        Ambient(),
        (0.16, 0.18, 0.21),
        "radiance of the ambient light, which comes from everywhere, or `sky` for the sky's own",
    )
    background: ColorLike = setting(
        RADIANCE, (0.93, 0.94, 0.96), "radiance of the background, where there is no sky", step=0.05
    )
    material: Material = setting(Made(Material), Material(), "material of every scene that has none of its own")
    specular: float = setting(Number(0.0), 0.22, "highlight of the lights, for materials without a value of their own")
    shininess: float = setting(Number(0.0), 60.0, "exponent of the highlight, as `specular`")
    exposure: float = setting(
        Number(0.0), 1.0, "factor of the image's radiance", "no unit", slider=(0.1, 4.0), step=0.05
    )
    shadows: bool = setting(Switch(), False, "lights cast shadows. Headlights cast none")
    ambient_rays: int = setting(
        Whole(0, 256),
        0,
        "ambient occlusion: number of rays per sample that test how open a place is",
        label="Ambient occlusion",
        slider=(0, 32),
    )
    ambient_distance: float | None = setting(
        Number(0.0),
        None,
        "length of the rays of ambient occlusion",
        "world units",
        usual="a tenth of the scene's extent",
    )
    sky: Sky | Environment | None = setting(
        Made(Sky, Environment),
        None,
        "light from all around, also visible behind the scene",
        usual="none, the background everywhere",
    )
    ground: Ground | None = setting(Made(Ground), None, "a plane under the scene")
    bounces: int = setting(Whole(0, 32), 4, "number of reflections and refractions that a ray follows", slider=(0, 16))
    cutoff: float = setting(SHARE, 1 / 32, "a ray that carries less than this share of a pixel's light ends in the sky")
    samples: int = setting(
        Whole(1, MAX_SAMPLES),
        1,
        "number of rays per pixel. The first goes through the pixel's center, the others anywhere in it",
        label="Samples when still",
        slider=(1, 64),
    )
    tone: bool = setting(
        Switch(),
        True,
        "whether `Frame.image` compresses light above 0.8. False: "
        "`Frame.image` is `Frame.color` in sRGB, clipped at 1, without `exposure`",
    )
    transparent: bool = setting(
        Switch(),
        False,
        "whether `Frame.image` is RGBA. A pixel's alpha "
        "is the share of its rays that hit a surface or the ground; an image of several samples "
        "has smooth edges",
    )
    edge_samples: int | None = setting(
        Whole(0, 64),
        None,
        "more rays for pixels beside a jump of "
        "distance, normal or layer (silhouettes, creases, cuts) in images of one sample a pixel. "
        "In images with shadows, reflection, transmission, clips, sky, ground or several layers, "
        "pixels beside a jump of color (a tenth of white as displayed, in any channel) have them "
        "too, unless the image is `transparent` or has ambient rays. Images of more samples have "
        "no edge samples",
        usual="3 where a layer has a smooth surface or shows 2-D data, else 0",
    )

    def _check(self) -> None:
        if isinstance(self.lights, LIGHTS):
            object.__setattr__(self, "lights", (self.lights,))
        self._packed  # noqa: B018  making it checks the fields

    @cached_property
    def _packed(self) -> Any:
        """What the core takes; how far ambient rays look in no scene in particular: 0."""
        return self._pack(0.0 if self.transparent else None)

    def _pack(self, behind: float | None) -> Any:
        """What the core takes, with a background of `behind` in place of background and sky."""
        v = check_all(self)
        sky_light = v["ambient"] == "sky"
        direct = ("exposure", "shadows", "ambient_rays", "cutoff", "specular", "shininess")
        return _core.Look(
            {name: v[name] for name in direct}
            | {
                "lights": [light._pack() for light in v["lights"]],
                "ambient": [0.0] * 3 if sky_light else list(v["ambient"]),
                "sky_light": sky_light,
                "background": list(v["background"]) if behind is None else [behind] * 3,
                "ambient_distance": v["ambient_distance"] or 0.0,
                "sky": (self.sky or uniform_sky(v["background"]))._pack(),
                "show_sky": self.sky is not None and behind is None,
                "ground": self.ground._pack() if self.ground else None,
                "depth": v["bounces"],
                "edge_samples": v["edge_samples"] or 0,
                "edge_contrast": behind is None,
            }
        )

    @property
    def is_flat(self) -> bool:
        """Whether every surface shows its own color, without light."""
        return not (self.lights or self.ambient_rays or self.tone) and _light(self) == _light(_WHITE)

    def _look(self, scenes: Sequence[SceneBase | Mesh], behind: float | None = None) -> Any:
        """What the core takes for an image of `scenes`; behind: as for `_pack`."""
        look = self._packed if behind is None else self._pack(behind)
        if self.ambient_distance is None and self.ambient_rays:
            look = look.reaching(0.1 * extent_of(scenes[0]))
        if self.edge_samples is None and _has_edges(scenes):
            look = look.with_edges(SMOOTH_EDGES)
        return look

    def _mixes(self, scenes: Sequence[SceneBase | Mesh]) -> bool:
        """Whether pixels at edges may be mixtures in an image of one sample."""
        own = self.edge_samples
        return _has_edges(scenes) if own is None else own > 0


def _has_edges(scenes: Sequence[SceneBase | Mesh]) -> bool:
    """Whether edges have more samples by default."""
    return any(isinstance(s, SceneBase) and s.surface != "balls" for s in scenes)


def extent_of(scene: SceneBase | Mesh) -> float:
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
    """Settings of a dict of their fields; the default ones of None."""
    if value is None:
        return _DEFAULT
    if isinstance(value, RenderSettings):
        return value
    if isinstance(value, str):
        raise TypeError(
            f"settings: expected RenderSettings or a dict of its fields, got {shown(value)}; "
            f"globule.load_preset({value!r}, scene) makes a preset's"
        )
    if not isinstance(value, Mapping):
        raise TypeError(f"settings: expected RenderSettings or a dict of its fields, got {shown(value)}")
    for name in value:
        if name not in NAMES:
            raise TypeError(f"settings: expected some of {', '.join(NAMES)}, got {name!r}")
    return RenderSettings(**value)
