"""Whether particles look like those of one fluid, so that one smooth surface shows them best."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from .._base.arrays import on_gpu, to_host
from .particles import FARTHEST, Particles
from .scene import Scene

FEWEST = 100
# Distances to the nearest particle: the one that 90 % reach over the one that 10 % reach. 1.3 in a
# splash of SPH particles, 2.1 where its sheets tear, 2.8 of points that know nothing of each other.
MOST_UNEVEN = 2.4
SAMPLES = 512
FLAT = 1e-6  # thickness over extent


class Likeness(NamedTuple):
    """What `fluid_like` found: yes or no, and why in a few words."""

    yes: bool
    why: str


def alike(value: Any) -> bool:
    """Whether a field has one value for all particles (or none at all)."""
    if value is None or np.ndim(value) == 0:
        return True
    if on_gpu(value):
        return False
    array = np.asarray(value)
    return len(array) == 0 or bool(np.ptp(array) <= 1e-3 * abs(float(array[0])))


def fluid_like(particles: Particles, scene: Scene | None = None) -> Likeness:
    """Whether particles are those of one fluid.

    They are where there are at least 100, with supports and weights alike, of one phase, not in one
    plane, and with similar distances to the nearest particle: the distance that 90 % of the
    particles reach is at most 2.4 times the one that 10 % reach.

    Args:
        particles: N particles.
        scene: one of these particles, whose octree serves the search; default: a new one.
    """
    if len(particles) < FEWEST:
        return Likeness(False, f"fewer than {FEWEST} particles")
    if particles.anisotropy is not None:
        return Likeness(False, "kernels of their own")
    for name in ("support", "weight"):
        if not alike(getattr(particles, name)):
            return Likeness(False, f"different {name}s")
    for name in ("phase", "phases"):
        if name in particles.attributes and len(np.unique(particles.attributes[name])) > 1:
            return Likeness(False, "several phases")
    positions = to_host(particles.positions)
    inside = positions[(np.abs(positions) <= FARTHEST).all(axis=1)]
    if len(inside) < FEWEST:
        return Likeness(False, f"fewer than {FEWEST} finite positions")
    size = np.ptp(inside, axis=0)
    if size.min() <= FLAT * size.max():
        return Likeness(False, "particles in a plane")
    scene = scene or Scene(Particles(inside), device="cpu")
    spacing = scene.spacing
    if not spacing > 0:
        return Likeness(False, "no spacing")
    some = inside[:: max(1, len(inside) // SAMPLES)][:SAMPLES]
    nearest = _nearest(scene, some, 3 * spacing)
    low, high = np.percentile(nearest, (10, 90))
    if not high <= MOST_UNEVEN * low:
        return Likeness(False, "uneven spacing")
    return Likeness(True, "even spacing, one fluid")


def surface_of(particles: Particles, **options: object) -> str:
    """ "smooth" or "balls": the surface that `render` draws of particles.

    Args:
        particles: N particles.
        options: further arguments of `Scene`; a kernel, support, threshold or dense octree that is
            asked for makes it "balls".
    """
    others = {"kernel": "murakami", "threshold": None, "support": None, "octree": "sparse"}
    plain = all(options.get(name, usual) == usual for name, usual in others.items())
    return "smooth" if plain and fluid_like(particles).yes else "balls"


def _nearest(scene: Scene, points: np.ndarray, radius: float) -> np.ndarray:
    """Distance of each point to the nearest other particle; the radius where there is none."""
    positions = to_host(scene.particles.positions)
    offsets, index = scene.neighbors(points, radius)
    counts: np.ndarray = np.diff(offsets).astype(np.int64)
    row = np.repeat(np.arange(len(points)), counts)
    apart = np.linalg.norm(positions[index].astype(np.float64) - points[row], axis=1)
    nearest = np.full(len(points), radius)
    others = apart > 0
    np.minimum.at(nearest, row[others], apart[others])
    return nearest
