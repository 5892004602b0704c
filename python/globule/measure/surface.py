"""The scene whose surface is measured, and its box."""

from __future__ import annotations

import math
import os
from typing import Any

import numpy as np

from .._base.arrays import to_host
from ..data.particles import Particles
from ..pieces.scene import Scene
from ..pieces.shown import shown_scene
from ..render.layers import in_pieces
from ..scene.scene import SPHERE_RADIUS, SPHERE_THRESHOLD
from ..scene.sources import as_particles

MOST_PLACES = 2**27  # of a grid; their field takes 0.5 GiB
BLOCK = 2**21  # places that are asked at once: bounds the memory


def surface_scene(source: Any, **options: Any) -> Scene:
    """The scene to measure: `source` itself, or a new one of its particles.

    Every function and command that measures makes its scene here, with the surface that `render`
    draws.

    Args:
        source: a Scene, or what `Scene` takes as particles.
        options: keyword arguments of `Scene`, for particles only.
    """
    if not isinstance(source, Scene):
        return shown_scene(measured_particles("particles", source), **options)
    return source


def measured_particles(name: str, source: Any) -> Particles:
    """Particles, as `as_particles` makes them, but not of the vertices of a mesh's file."""
    if isinstance(source, str | os.PathLike):
        from ..formats.triangles import part_has_faces  # formats are loaded when they are needed

        if part_has_faces(source):
            raise ValueError(
                f"{name}: expected particles or a volume, got the mesh {os.fspath(source)}; "
                "globule.read(path, spacing=...) makes particles all over it"
            )
    return as_particles(name, source)


def box_of(scene: Scene, margin: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
    """Lowest and highest corner (3,) float64 around all particles and `margin` of their supports.

    Raises ValueError if no particle has a finite position.
    """
    lo, hi = scene.particles.bounds()
    reach = margin * float(np.max(to_host(scene.support), initial=0.0))
    return lo.astype(np.float64) - reach, hi.astype(np.float64) + reach


def spheres_of(scene: Scene) -> tuple[np.ndarray, np.ndarray] | None:
    """Centers (N, 3) and radii (N,), world, of a scene of spheres; None for another surface."""
    if scene.surface != "spheres" or scene.threshold != SPHERE_THRESHOLD or in_pieces(scene):
        return None
    positions = to_host(scene.particles.positions)
    radii = np.broadcast_to(SPHERE_RADIUS * to_host(scene.support), len(positions))
    there = np.isfinite(positions).all(axis=1) & (radii > 0)
    return positions[there], radii[there]


def default_spacing(scene: Scene) -> float:
    """Half the particles' spacing, at most a quarter of the largest support; an eighth of a support
    where all are at one place; of spheres of different radii, half the median radius."""
    spheres = spheres_of(scene)
    if spheres is not None and np.ndim(scene.support) and len(spheres[1]):
        return float(np.median(spheres[1])) / 2
    support = float(np.max(to_host(scene.support), initial=0))
    return min(scene.spacing / 2, support / 4) or support / 8


def counts(lengths: np.ndarray, spacing: float) -> list[int]:
    """How many nodes, `spacing` apart, lie along each of the lengths.

    Raises ValueError for more than MOST_PLACES in all, naming a spacing that would do.
    """
    lengths = np.maximum(lengths, 0)
    n = np.floor(lengths / spacing + 1e-6) + 1
    if float(np.prod(n)) > MOST_PLACES:
        d = int((lengths > 0).sum())
        enough = 1.05 * spacing * float(np.prod(n) / MOST_PLACES) ** (1 / max(d, 1))
        raise ValueError(
            f"spacing: expected one that makes at most {MOST_PLACES:,} places, got {spacing:g} "
            f"for {math.prod(map(float, n)):,.0f}; try {enough:.3g}"
        )
    return [int(v) for v in n]


def in_blocks(ask: Any, points: np.ndarray) -> np.ndarray:
    """The answers of `ask` to points (M, 3) float32, asked block by block."""
    if len(points) <= BLOCK:
        return ask(points)
    return np.concatenate([ask(points[i : i + BLOCK]) for i in range(0, len(points), BLOCK)])
