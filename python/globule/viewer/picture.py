"""The image of a source with the settings of the page."""

from __future__ import annotations

import contextlib
import dataclasses
from typing import Any

import numpy as np

from ..pieces.scene import Scene
from ..render.camera import Camera, view_axes
from ..render.clips import ClipBox, ClipPlane, ClipSphere
from ..render.frame import Frame
from ..render.lights import DirectionalLight, Ground, Headlight, Sky
from ..render.presets import GROUNDS, ground_height
from ..render.render import render
from ..render.settings import RenderSettings, extent_of, for_values
from ..render.trace import values_of
from ..scene.mesh import Mesh
from .compare_source import CompareSource, Split
from .layers import visible
from .scenes import thesis_of
from .source import Source
from .state import Cuts, Look, State

NIGHT = (0.012, 0.014, 0.018)  # linear; the background of a dark page
MOST_MOVING_AMBIENT = 2  # rays per sample for ambient occlusion while something moves


def trace(
    source: Source, state: State, camera: Camera, size: tuple[int, int], up: Any, moving: bool = False
) -> Frame | Split:
    """A frame with one sample per pixel; `Frame.refine` adds more.

    The caller holds the source's lock.

    Args:
        camera: world.
        size: (width, height), pixels.
        up: (3,) upward direction, world, for lights and ground.
        moving: use fewer rays for ambient occlusion, and none for edges.

    Raises:
        ValueError: settings that exclude each other.
    """
    if isinstance(source, CompareSource):
        state = source.shared(state)

    def one(part: Source) -> Frame:  # with the light of the whole
        layers = part.layers(state)
        settings = dataclasses.replace(seen_settings(source, state, layers[0].scene, up), samples=1)
        if moving:
            most = min(settings.ambient_rays, MOST_MOVING_AMBIENT)
            settings = dataclasses.replace(settings, ambient_rays=most, edge_samples=0)
        drawn = visible(layers, state)
        frame = render(drawn, camera, size, settings, clips_of(state.cuts), thesis_of(state))
        first = drawn[0].scene
        colored = first is layers[0].scene and isinstance(first, Scene)
        if settings.is_flat and state.color.by and not moving and colored:
            with contextlib.suppress(ValueError):  # layers may be shown without these values
                particles, color = first.particles, state.color
                shown = values_of(particles, color.by, color.colormap, part.maker.range)
                frame._values = shown[:4]
        return frame

    if isinstance(source, CompareSource):
        return Split(one(source.first), one(source.second), state.compare.at)
    return one(source)


def seen_settings(source: Source, state: State, scene: Scene | Mesh, up: Any) -> RenderSettings:
    """Light and material of the page; colors of values replace the color of the material."""
    settings = settings_of(state.look, source, scene, up)
    if not state.color.by:
        return settings
    return for_values(settings)


def settings_of(look: Look, source: Source, scene: Scene | Mesh, up: Any) -> RenderSettings:
    """The preset's light and material, with the changes of the page."""
    base = RenderSettings()
    if look.preset != "plain":
        base = source.preset_settings(look.preset, scene, up)
    changes: dict[str, Any] = {
        "exposure": look.exposure,
        "shadows": look.shadows,
        "ambient_rays": look.ambient_rays,
        "bounces": look.bounces,
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
    """The settings of a preset, with defaults elsewhere. The caller holds the source's lock."""
    settings = RenderSettings()
    if name != "plain":
        settings = source.preset_settings(name, source.scene(state), up)
    return Look(
        preset=name,
        shadows=settings.shadows,
        bounces=settings.bounces,
        ambient_rays=settings.ambient_rays,
        exposure=settings.exposure,
    )


def in_the_dark(state: State) -> State:
    """The settings with a dark background, where neither a person nor a preset has chosen one."""
    look = state.look
    if (look.preset, look.background) != ("plain", Look().background):
        return state
    dark = state.snapshot()
    dark.look = dataclasses.replace(look, background=NIGHT)
    return dark


def background(look: Look, base: RenderSettings) -> Any:
    """The background of the page if it is not the default, otherwise that of the preset."""
    return base.background if look.background == Look().background else look.background


def own_lights(look: Look, up: Any) -> tuple:
    """The sun and, if on, the headlight; their radiances add up to 1, as on the command line."""
    n = 2 if look.headlight else 1
    sun = DirectionalLight(sun_direction(look, up), (1 / n,) * 3, look.angle)
    return (Headlight((1 / n,) * 3), sun) if look.headlight else (sun,)


def sun_direction(look: Look, up: Any) -> tuple[float, float, float]:
    """The unit direction to the sun, world; `up`: (3,)."""
    right, above, front = view_axes(up)
    azimuth, elevation = np.radians(look.azimuth), np.radians(look.elevation)
    across = np.sin(azimuth) * right + np.cos(azimuth) * front
    x, y, z = np.cos(elevation) * across + np.sin(elevation) * above
    return round(float(x), 6), round(float(y), 6), round(float(z), 6)


def _ground(look: Look, base: RenderSettings, scene: Scene | Mesh, up: Any) -> Ground | None:
    if look.ground == "none":
        return None
    plain = base.ground or Ground(0.0, up)
    check = GROUNDS[look.ground] * float(extent_of(scene))
    return dataclasses.replace(plain, height=ground_height(scene, up), check=check)


def clips_of(cuts: Cuts) -> list[ClipPlane | ClipBox | ClipSphere]:
    """The clips of the cuts that are switched on."""
    clips: list[ClipPlane | ClipBox | ClipSphere] = []
    length = np.linalg.norm(cuts.normal)
    if cuts.plane and length > 1e-150:  # whose square is not 0
        normal = np.asarray(cuts.normal) / length
        clips.append(ClipPlane(tuple(normal.tolist()), float(normal @ cuts.point)))
    if cuts.box:
        lo, hi = np.minimum(cuts.lo, cuts.hi), np.maximum(cuts.lo, cuts.hi)
        if (lo < hi).all():
            clips.append(ClipBox(tuple(lo.tolist()), tuple(hi.tolist()), cuts.keep_box))
    if cuts.sphere:
        clips.append(ClipSphere(cuts.center, cuts.radius, cuts.keep_sphere))
    return clips
