"""The height of the free surface: wave gauges and height maps."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from .._base.arrays import VectorLike, to_host
from .._base.checks import array_of_numbers, shown, three
from ..pieces.scene import Scene
from .places import SamplePlane
from .samples import Samples
from .surface import BLOCK, box_of, surface_scene

if TYPE_CHECKING:
    from numpy.typing import ArrayLike


def gauge(
    scene: Any, at: ArrayLike, up: VectorLike | None = None, device: str = "auto", threads: int = 0
) -> np.ndarray:
    """The height of the surface at wave gauges: where a ray from above first meets the surface.

    Spray above the surface is met first.

    Args:
        scene: a Scene; or Particles, positions (N, 3), or the name of a file, of which a Scene
            with all defaults is made.
        at: (M, 2) world: the two horizontal coordinates of each gauge, in the order x, y, z; for
            `up` along y they are x and z. One gauge may be (2,).
        up: (3,) along x, y or z: away from gravity; default: that of the particles.
        device, threads: as for `Scene`, if a scene must be made.

    Returns:
        (M,) float64, or a float for one gauge: world units along `up`, from the particles' origin;
        NaN where the ray meets no surface.
    """
    places = _places(at)
    scene, axis, sign = _upright(scene, up, device=device, threads=threads)
    heights = heights_at(scene, places.reshape(-1, 2), axis, sign)
    return heights if places.ndim == 2 else heights[0]


def map_heights(
    scene: Any,
    spacing: float | None = None,
    up: VectorLike | None = None,
    box: Any = None,
    device: str = "auto",
    threads: int = 0,
) -> Samples:
    """The heights of the surface all over the ground, as `gauge` measures them.

    Args:
        scene, up, device, threads: as for `gauge`.
        spacing, box: as for `SamplePlane`, whose normal is `up`.

    Returns:
        `Samples` of a plane with the value "height": (V, U) float32, world units along `up`; NaN
        where there is no surface. The points are those of the surface, with the lowest height of
        the map where there is none.
    """
    scene, axis, sign = _upright(scene, up, device=device, threads=threads)
    lattice = SamplePlane(np.eye(3)[axis], 0.0, spacing, box).lattice(scene)
    points = lattice.points()
    flat = points.reshape(-1, 3)
    heights = heights_at(scene, np.delete(flat, axis, axis=1).astype(np.float64), axis, sign)
    known = np.isfinite(heights)
    lowest = float(heights[known].min()) if known.any() else 0.0
    flat[:, axis] = sign * np.where(known, heights, lowest)
    values = {"height": heights.astype(np.float32).reshape(lattice.shape)}
    coords = dict(zip(lattice.dims, lattice.coords, strict=True))
    origin = scene.origin
    return Samples(points, values, lattice.dims, coords, lattice.steps, origin)


def _upright(scene: Any, up: VectorLike | None, **options: Any) -> tuple[Scene, int, float]:
    """The scene to measure, and axis and sign of its upward direction."""
    if up is not None:
        up_axis(up)  # checked before any work
    scene = surface_scene(scene, **options)
    return scene, *up_axis(scene.up if up is None else up)


def heights_at(scene: Scene, places: np.ndarray, axis: int, sign: float) -> np.ndarray:
    """Heights (M,) float64 at horizontal coordinates (M, 2); NaN where there is no surface."""
    if not len(scene.particles.finite_positions()):
        return np.full(len(places), np.nan)
    lo, hi = box_of(scene)
    top = float(np.float32((hi if sign > 0 else lo)[axis]))
    across = [i for i in range(3) if i != axis]
    heights = np.empty(len(places))
    for begin in range(0, len(places), BLOCK):
        part = places[begin : begin + BLOCK]
        origins = np.empty((len(part), 3), np.float32)
        origins[:, axis], origins[:, across] = top, part
        down = np.zeros_like(origins)
        down[:, axis] = -sign
        distance = scene.intersect(origins, down).distance.astype(np.float64)
        hit = np.flatnonzero(np.isfinite(distance))
        points = origins[hit].astype(np.float64)
        points[:, axis] -= sign * distance[hit]
        heights[begin : begin + BLOCK] = np.nan
        heights[begin + hit] = sign * _polished(scene, points, axis)
    return heights


def _polished(scene: Scene, points: np.ndarray, axis: int) -> np.ndarray:
    """Coordinates (M,) along an axis of hits (M, 3), closer to the surface: a ray's distance is as
    exact as an image needs. Newton's steps, where they are small."""
    value = points[:, axis].copy()
    support = np.asarray(to_host(scene.support))
    reach = 1e-3 * float(np.min(support, initial=np.inf, where=support > 0))
    for _ in range(2 if len(points) else 0):
        at = points.astype(np.float32)
        miss = scene.threshold - scene.field(at).astype(np.float64)
        with np.errstate(all="ignore"):
            step = miss / scene.gradient(at)[:, axis]
        near = np.abs(step) < reach
        value[near] = at[near, axis] + step[near]
        points[:, axis] = value
    return value


def up_axis(up: VectorLike) -> tuple[int, float]:
    """The axis that `up` is along, and its sign."""
    direction = np.asarray(three("up", up))
    axis = int(np.argmax(np.abs(direction)))
    if np.count_nonzero(direction) != 1:
        raise ValueError(f"up: expected a direction along x, y or z, got {shown(up)}")
    return axis, float(np.sign(direction[axis]))


def _places(at: Any) -> np.ndarray:
    places = array_of_numbers(at)
    if places.ndim not in (1, 2) or places.shape[-1] != 2:
        raise TypeError(f"at: expected two horizontal coordinates (M, 2), got {shown(at)}")
    if not np.isfinite(places).all():
        raise ValueError(f"at: expected finite coordinates, got {shown(at)}")
    return places
