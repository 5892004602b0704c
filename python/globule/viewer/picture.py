"""The picture of a source as the page's settings want it."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from ..render.camera import Camera, view_axes
from ..render.clips import ClipBox, ClipPlane, ClipSphere
from ..render.frame import Frame, RenderSettings, render
from ..render.lights import DirectionalLight, Ground, Headlight, Sky
from ..render.presets import GROUNDS, ground_height
from ..scene.scene import Scene
from .scenes import thesis_of
from .source import Source
from .state import Cuts, Look, State

MOST_MOVING_AMBIENT = 2  # rays that look for openness while something moves


def trace(
    source: Source,
    state: State,
    camera: Camera,
    size: tuple[int, int],
    up: Any,
    moving: bool = False,
) -> Frame:
    """One sample per pixel; with the source's lock held. Refine it for more.

    Raises ValueError where settings do not go together.
    """
    layers = source.layers(state)
    settings = dataclasses.replace(seen_settings(source, state, layers[0].scene, up), samples=1)
    if moving and settings.ambient_rays > MOST_MOVING_AMBIENT:
        settings = dataclasses.replace(settings, ambient_rays=MOST_MOVING_AMBIENT)
    return render(layers, camera, size, settings, clips_of(state.cuts), thesis_of(state))


def seen_settings(source: Source, state: State, scene: Scene, up: Any) -> RenderSettings:
    """Light and matter, which lets colours of values be seen."""
    settings = settings_of(state.look, source, scene, up)
    if not state.color.by:
        return settings
    return dataclasses.replace(
        settings, material=dataclasses.replace(settings.material, color=None)
    )


def settings_of(look: Look, source: Source, scene: Scene, up: Any) -> RenderSettings:
    """The preset's light and matter, with what the page sets in their place."""
    base = RenderSettings()
    if look.preset != "plain":
        base = source.preset_settings(look.preset, scene, up)
    changes: dict[str, Any] = {
        "exposure": look.exposure,
        "shadows": look.shadows,
        "ambient_rays": look.ambient_rays,
        "bounces": look.depth,
    }
    if look.matter == "own":
        changes["material"] = dataclasses.replace(
            base.material,
            reflection=look.reflection,
            transmission=look.transmission,
            index=look.index,
            roughness=look.roughness,
        )
    if look.lights == "own":
        changes["lights"] = own_lights(look, up)
    if look.sky != "preset":
        changes["sky"] = Sky(up=up) if look.sky == "gradient" else None
    if look.sky == "none" or base.sky is None:
        changes["background"] = background(look, base)
    if look.ground != "preset":
        changes["ground"] = _ground(look, base, scene, up)
    return dataclasses.replace(base, **changes)


def preset_look(source: Source, state: State, name: str, up: Any) -> Look:
    """What a preset sets, and the defaults elsewhere; with the source's lock held."""
    settings = RenderSettings()
    if name != "plain":
        settings = source.preset_settings(name, source.layers(state)[0].scene, up)
    return Look(
        preset=name,
        shadows=settings.shadows,
        depth=settings.bounces,
        ambient_rays=settings.ambient_rays,
        exposure=settings.exposure,
    )


def background(look: Look, base: RenderSettings) -> Any:
    """The preset's, unless another than the plain one was chosen."""
    return base.background if look.background == Look().background else look.background


def own_lights(look: Look, up: Any) -> tuple:
    """The sun, and the lamp at the eye; together of radiance 1, as on the command line."""
    n = 2 if look.headlight else 1
    sun = DirectionalLight(sun_direction(look, up), (1 / n,) * 3, look.angle)
    return (Headlight((1 / n,) * 3), sun) if look.headlight else (sun,)


def sun_direction(look: Look, up: Any) -> tuple[float, float, float]:
    """Towards the sun, world."""
    right, above, front = view_axes(up)
    azimuth, elevation = np.radians(look.azimuth), np.radians(look.elevation)
    across = np.sin(azimuth) * right + np.cos(azimuth) * front
    x, y, z = np.cos(elevation) * across + np.sin(elevation) * above
    return round(float(x), 6), round(float(y), 6), round(float(z), 6)


def _ground(look: Look, base: RenderSettings, scene: Scene, up: Any) -> Ground | None:
    if look.ground == "none":
        return None
    plain = base.ground or Ground(0.0, up)
    check = GROUNDS[look.ground] * float(scene.octree.extent)
    return dataclasses.replace(plain, height=ground_height(scene, up), check=check)


def clips_of(cuts: Cuts) -> list[ClipPlane | ClipBox | ClipSphere]:
    """The cuts that are on."""
    clips: list[ClipPlane | ClipBox | ClipSphere] = []
    if cuts.plane and any(cuts.normal):
        normal = np.asarray(cuts.normal) / np.linalg.norm(cuts.normal)
        clips.append(ClipPlane(tuple(normal.tolist()), float(normal @ cuts.point)))
    if cuts.box:
        lo, hi = np.minimum(cuts.lo, cuts.hi), np.maximum(cuts.lo, cuts.hi)
        if (lo < hi).all():
            clips.append(ClipBox(tuple(lo.tolist()), tuple(hi.tolist()), cuts.keep_box))
    if cuts.sphere:
        clips.append(ClipSphere(cuts.center, cuts.radius, cuts.keep_sphere))
    return clips
