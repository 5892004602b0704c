"""Which surface --surface and --particle-spacing ask for; `render` and what measures agree."""

from __future__ import annotations

import argparse
from typing import Any

import numpy as np

from ..data.particles import Particles
from ..pieces.scene import Scene
from ..pieces.shown import shown_scene
from . import flags
from .shared import say

OF_RADII = (
    "note: the particles are spheres of the file's radii (atoms, or no overlap as a fluid's); "
    "--surface smooth or balls draws another surface"
)


def add_arguments(parser: Any) -> None:
    """The flags that say which surface the particles have."""
    group = parser.add_argument_group("surface")
    flags.add(group, "--kernel", "default: murakami", default="murakami")
    flags.add(group, "--support", "default: the file's, else two spacings")
    flags.add(group, "--threshold", "default: by kernel")
    flags.add(group, "--surface", "default: auto", default="auto")
    flags.add(group, "--particle-spacing", "default: measured")
    flags.own(group, "--anisotropic", "smooth the particles and stretch their kernels along the "
        "surface (Yu and Turk 2013)")  # fmt: skip


def scene_of(options: argparse.Namespace, particles: Particles, as_balls: bool, **asked: Any) -> Scene:
    """The scene of the particles. as_balls: auto is balls, as for voxels; asked: for `Scene`."""
    surface, spacing = options.surface, options.particle_spacing
    if surface == "auto" and as_balls:
        surface = "balls"
    elif surface == "auto" and spacing:
        surface = "smooth"
    if surface == "auto":
        scene = shown_scene(particles, **asked)
        if scene.surface == "spheres" and np.ndim(scene.support):
            say(OF_RADII)
        return scene
    return Scene(particles, surface=surface, spacing=spacing, **asked)
