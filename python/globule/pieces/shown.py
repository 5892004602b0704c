"""The scene that images show of particles, where nobody says which surface."""

from __future__ import annotations

from typing import Any

from .._base.device import choose
from ..fluids.likeness import RADII, is_plain, suitable_surface
from ..scene.fitting import counted, lacking
from ..scene.sources import as_particles
from .scene import Scene, SceneInPieces


def shown_scene(value: Any, **options: Any) -> Scene:
    """The scene, with the surface of `choose_surface`, of particles or what stands for them; its
    own octree tells which one that is."""
    if "surface" in options or not is_plain(options):
        return Scene(as_particles("scene", value), **options)
    value, divided = unless_divided(value, **options)
    if divided is not None:
        return divided
    particles = as_particles("scene", value)
    scene = Scene(particles, **options)
    surface, why = suitable_surface(particles, scene)
    if why == RADII:
        scene.become_spheres()
    elif surface != "balls":
        scene.become(surface)
    return scene


def unless_divided(value: Any, color: tuple[Any, Any, Any] | None = None, **options: Any) -> tuple[Any, Scene | None]:
    """What stands for particles, read where only that tells how many there are, and their scene in
    pieces if they do not fit into the memory as one.

    color: the arguments of `color_by`.
    """
    value, n, to_read = counted("scene", value)
    device = choose(options.pop("device", "auto"))
    if all(options.pop(name, None) is None for name in ("level", "bounds")):
        options.pop("octree", None)
        lack = lacking(n, to_read, "smooth", options.get("key_bits", 32), device)
        if lack is not None:
            return value, SceneInPieces.made(value, lack, device, color, surface="auto", **options)
    return value, None
