"""Which surface shows particles best, where nobody says which one:

- "spheres" for particles that have radii and do not overlap as those of a fluid (`are_spheres`).
- "spheres" of half a spacing for 2-D data, i.e. at least 100 particles of equal z. Images show them
  in flat colors, from above.
- "smooth" for particles that look like those of one fluid (`assess_fluid`).
- "balls" for all others, and where a kernel, support, threshold or dense octree is asked for.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from .._base.arrays import extent, on_gpu, to_host
from ..data.particles import Particles
from ..data.radii import find_radii
from ..scene.scene import SceneBase

FEWEST = 100
# Distances to the nearest particle: the one that 90 % reach over the one that 10 % reach. 1.3 in a
# splash of SPH particles, 2.1 where its sheets tear, 2.8 of points that know nothing of each other.
MOST_UNEVEN = 2.4
SAMPLES = 512
# The distance to the nearest particle over the sum of both radii, at half of the particles: grains
# press into each other by a few hundredths, particles of a fluid overlap.
LEAST_APART = 0.9
FLAT = 1e-6  # thickness over extent


class Likeness(NamedTuple):
    """What `assess_fluid` found: yes or no, and why in a few words."""

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


def assess_fluid(particles: Particles, scene: SceneBase | None = None) -> Likeness:
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
    inside = particles.finite_positions()
    if len(inside) < FEWEST:
        return Likeness(False, f"fewer than {FEWEST} finite positions")
    size = _size(inside)
    if size.max() == 0:
        return Likeness(False, "all at one place")
    if _is_thin(inside, int(np.argmin(size))):
        return Likeness(False, "particles in a plane")
    scene = scene or SceneBase(Particles(inside), device="cpu")
    spacing = scene.spacing
    if not spacing > 0:
        return Likeness(False, "no spacing")
    some = inside[:: max(1, len(inside) // SAMPLES)][:SAMPLES]
    nearest = _nearest(scene, some, 3 * spacing)
    low, high = np.percentile(nearest, (10, 90))
    if not high <= MOST_UNEVEN * low:
        return Likeness(False, "uneven spacing")
    return Likeness(True, "even spacing, one fluid")


def are_spheres(particles: Particles, scene: SceneBase | None = None) -> bool:
    """Whether particles have radii, in an attribute `radius`, `pscale` or `diameter`, and do not
    overlap as those of a fluid: half of them are farther from the nearest one than 0.9 times the
    sum of both radii.

    Args:
        particles: N particles.
        scene: one of these particles, whose octree serves the search; default: a new one.
    """
    radii = find_radii(particles)
    if radii is None or particles.anisotropy is not None:
        return False
    positions = to_host(particles.positions)
    inside = np.flatnonzero(np.isfinite(positions).all(axis=1))
    if not len(inside):
        return False
    some = inside[:: max(1, len(inside) // SAMPLES)][:SAMPLES]
    scene = scene or SceneBase(Particles(positions), device="cpu")
    offsets, index = scene.neighbors(positions[some], 2 * float(np.median(radii[some])))
    row = np.repeat(np.arange(len(some)), np.diff(offsets).astype(np.int64))
    apart = np.linalg.norm(positions[index].astype(np.float64) - positions[some][row], axis=1)
    nearest = np.ones(len(some))
    others = index != some[row]
    np.minimum.at(nearest, row[others], (apart / (radii[index] + radii[some][row]))[others])
    return bool(np.median(nearest) >= LEAST_APART)


def is_flat(particles: Particles) -> bool:
    """Whether particles are 2-D data: at least 100, all finite ones at the same z, not in a line
    along an axis."""
    if len(particles) < FEWEST or particles.anisotropy is not None:
        return False
    inside = particles.finite_positions()
    if len(inside) < FEWEST:
        return False
    if not _size(inside).max() > 0 or not _is_thin(inside, 2):
        return False
    return not (_is_thin(inside, 0) or _is_thin(inside, 1))


def _is_thin(positions: np.ndarray, axis: int) -> bool:
    """Whether positions (N, 3) lie in a plane across an axis. One particle far away does not make
    the others flat: their distance from the middle counts."""
    size = _size(positions)
    if size[axis] > FLAT * size.max():
        return False
    if size[axis] == 0:
        return True
    away = np.median(np.abs(positions - np.median(positions, axis=0)), axis=0)
    return bool(size[axis] <= FLAT * 4 * away.max())


def flat_spacing(particles: Particles) -> float | None:
    """The spacing of 2-D data, world units: `Scene.fluid_spacing`, which is the square root of the
    area of a particle; None where that is nothing."""
    scene = SceneBase(Particles(particles.finite_positions()), device="cpu")
    return scene.fluid_spacing() or None


def choose_surface(particles: Particles, **options: Any) -> str:
    """ "smooth", "spheres" or "balls": the surface that `render` draws of particles.

    Args:
        particles: N particles.
        options: further arguments of `Scene`; a kernel, support, threshold or dense octree that is
            asked for makes it "balls".
    """
    if not is_plain(options):
        return "balls"
    if are_spheres(particles) or is_flat(particles):
        return "spheres"
    return "smooth" if assess_fluid(particles).yes else "balls"


def shows_flat(scene: object) -> bool:
    """Whether a scene shows 2-D data as `render` does: seen from above, in flat colors."""
    return isinstance(scene, SceneBase) and scene.surface == "spheres" and is_flat(scene.particles)


def is_plain(options: dict[str, Any]) -> bool:
    """Whether arguments of `Scene` leave the surface open."""
    others = {"kernel": "murakami", "threshold": None, "support": None}
    plain = all(options.get(name, usual) == usual for name, usual in others.items())
    return plain and options.get("octree") in (None, "sparse")


def _size(positions: np.ndarray) -> np.ndarray:
    lo, hi = extent(positions)
    return hi - lo


def _nearest(scene: SceneBase, points: np.ndarray, radius: float) -> np.ndarray:
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
