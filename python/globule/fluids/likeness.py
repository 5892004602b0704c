"""Which surface shows particles best, where nobody says which one:

- "spheres" for particles that have radii and do not overlap as those of a fluid (`are_spheres`).
- "spheres" of half a spacing for particles in a plane, which images show in flat colors along its
  normal; for those in a line; and for scattered ones, which are no medium.
- "smooth" for particles that look like those of one fluid (`assess_fluid`).
- "balls" for all others, and where a kernel, support, threshold or dense octree is asked for.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from .._base.arrays import on_gpu, to_host
from ..data.attributes import ELEMENT_NAMES
from ..data.particles import Particles
from ..data.radii import find_radii
from ..data.spacing import axes_of, normal_of
from ..scene.scene import SceneBase

FEWEST = 8
MANY = 100  # of fewer, distances tell less
# Distances to the nearest particle: the one that 90 % reach over the one that 10 % reach. 1.3 in a
# splash of SPH particles, 2.1 where its sheets tear, 2.8 of points that know nothing of each other.
MOST_UNEVEN = 2.4
MOST_UNEVEN_OF_FEW = 1.7
# The median of these distances over the spacing: 0.55 of points that know nothing of each other,
# 0.9 and more in a fluid.
LEAST_CLOSE = 0.72
SAMPLES = 512
# The distance to the nearest particle over the sum of both radii, at half of the particles: grains
# press into each other by a few hundredths, particles of a fluid overlap.
LEAST_APART = 0.9
BONDED = 0.25  # of the sum of two van der Waals radii: 0.31 in hydrogen, 0.35 in water
DENSER = 0.1  # of a weight: densities of SPH differ by a few hundredths
RADII = "radii of the file, of atoms or without a fluid's overlap"
SCATTERED = "scattered particles"


class Likeness(NamedTuple):
    """What `assess_fluid` found: yes or no, and why in a few words."""

    yes: bool
    why: str


def alike(value: Any, share: float = 1e-3) -> bool:
    """Whether a field has one value for all particles, up to a share of it (or none at all)."""
    if value is None or np.ndim(value) == 0:
        return True
    if on_gpu(value):
        return False
    array = np.asarray(value)
    return len(array) == 0 or bool(np.ptp(array) <= share * abs(float(array[0])))


def assess_fluid(particles: Particles, scene: SceneBase | None = None) -> Likeness:
    """Whether particles are those of one fluid.

    They are where there are at least 8, with equal supports and similar weights, of one phase, not in one
    plane, and with similar distances to the nearest particle: the distance that 90 % of the
    particles reach is at most 2.4 times the one that 10 % reach. Fewer than 100 are only where it
    is at most 1.7 times, and half are at least 0.72 spacings from the nearest one.

    Args:
        particles: N particles.
        scene: one of these particles, whose octree serves the search; default: a new one.
    """
    if particles.anisotropy is not None:
        return Likeness(False, "kernels of their own")
    for name, share in (("support", 1e-3), ("weight", DENSER)):
        if not alike(getattr(particles, name), share):
            return Likeness(False, f"different {name}s")
    for name in ("phase", "phases"):
        if name in particles.attributes and len(np.unique(particles.attributes[name])) > 1:
            return Likeness(False, "several phases")
    inside = particles.finite_positions()
    n = len(axes_of(inside))
    if n == 0:
        return Likeness(False, "all at one place")
    if n < 3:
        return Likeness(False, f"particles in a {'line' if n == 1 else 'plane'}")
    if len(inside) < FEWEST:
        return Likeness(False, f"fewer than {FEWEST} particles")
    scene = scene or SceneBase(Particles(inside), device="cpu")
    spacing = scene.spacing
    if not spacing > 0:
        return Likeness(False, "no spacing")
    some = inside[:: max(1, len(inside) // SAMPLES)][:SAMPLES]
    nearest = _nearest(scene, some, 3 * spacing)
    low, middle, high = np.percentile(nearest, (10, 50, 90))
    many, close = len(inside) >= MANY, middle >= LEAST_CLOSE * spacing
    if high <= (MOST_UNEVEN if many else MOST_UNEVEN_OF_FEW) * low and (many or close):
        return Likeness(True, "even spacing, one fluid")
    return Likeness(False, "uneven spacing" if many and close else SCATTERED)


def are_spheres(particles: Particles, scene: SceneBase | None = None) -> bool:
    """Whether particles have radii, in an attribute `radius`, `pscale` or `diameter`, and do not
    overlap as those of a fluid: half of them are farther from the nearest one than 0.9 times the
    sum of both radii; 0.25 times that of atoms, with an attribute `atomic_number` or `element`,
    since bonds are a third of it.

    Args:
        particles: N particles.
        scene: one of these particles, whose octree serves the search; default: a new one.
    """
    radii = find_radii(particles)
    if radii is None or particles.anisotropy is not None:
        return False
    positions = to_host(particles.positions)
    inside = np.flatnonzero(np.isfinite(positions).all(axis=1) & (radii > 0))  # 0: a particle that is taken out
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
    atoms = any(name.lower() in ELEMENT_NAMES for name in particles.attributes)
    return bool(np.median(nearest) >= (BONDED if atoms else LEAST_APART))


def choose_surface(particles: Particles, **options: Any) -> str:
    """ "smooth", "spheres" or "balls": the surface that `render` draws of particles.

    Args:
        particles: N particles.
        options: further arguments of `Scene`; a kernel, support, threshold or dense octree that is
            asked for makes it "balls".
    """
    return suitable_surface(particles)[0] if is_plain(options) else "balls"


def suitable_surface(particles: Particles, scene: SceneBase | None = None) -> tuple[str, str]:
    """The surface of `choose_surface`, and why. scene: as for `assess_fluid`."""
    if are_spheres(particles, scene):
        return "spheres", RADII
    own = particles.support is not None or particles.weight is not None
    flat = particles.anisotropy is None and (len(particles) >= MANY or not own)
    if flat and normal_of(particles.finite_positions()) is not None:
        return "spheres", "2-D: one plane"
    yes, why = assess_fluid(particles, scene)
    if yes:
        return "smooth", why
    apart = why in (SCATTERED, "particles in a line", f"fewer than {FEWEST} particles")
    return "balls" if own or not apart else "spheres", why


def shows_flat(scene: object) -> bool:
    """Whether a scene shows 2-D data as `render` does: along the plane's normal, in flat colors."""
    return isinstance(scene, SceneBase) and scene.surface == "spheres" and scene.normal is not None


def is_plain(options: dict[str, Any]) -> bool:
    """Whether arguments of `Scene` leave the surface open."""
    others = {"kernel": "murakami", "threshold": None, "support": None}
    plain = all(options.get(name, usual) == usual for name, usual in others.items())
    return plain and options.get("octree") in (None, "sparse")


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
