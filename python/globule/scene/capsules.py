"""Plain spheres and lines that images show beside particles and triangle meshes."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from .._base.arrays import ABSENT, View, to_host, view
from .._base.checks import named, positive, shown
from ..data.triangles import Triangles
from .mesh import Mesh

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

MAX_RADIUS = 1e18
_AT_ONCE = 2**22  # pairs of a point and a capsule


class Capsules(Mesh):
    """Spheres and lines: all points within a radius of segments, which may be single points.

    A ray meets them exactly, in closed form, in the hierarchy that triangles have. Each one is a
    solid: it refracts, absorbs, has a cut face and displaces a fluid as a solid `Mesh`. Where two
    overlap, opaque ones are right; of transparent ones images show the border between the two.
    """

    def __init__(self, points: Any, ends: np.ndarray, radius: Any, color: Any, device: str, threads: int):
        places = view("positions", points, 3)
        nothing = np.empty((0, 3), np.int64)
        super().__init__(Triangles(points, nothing), color=color, smooth=0, device=device, threads=threads)
        self.faces = ends
        self.closed = self.solid = True
        self._radius, self._one_radius = _checked_radius(radius, places.shape[0])

    @property
    def radius(self) -> Any:
        """World units: a float for all, or (N,) float32."""
        return self._one_radius if self._radius is ABSENT else self._radius.owner

    def bounds(self) -> np.ndarray:
        """(2, 3) float64, lowest and highest corner of their box, world."""
        if len(self.faces) == 0:
            return np.zeros((2, 3))
        used = np.unique(self.faces)
        world = to_host(self.vertices)[used] @ self._pose[:3, :3].T + self._pose[:3, 3]
        r = np.broadcast_to(to_host(self.radius), len(self.vertices))[used, None]
        return np.array([(world - r).min(axis=0), (world + r).max(axis=0)])

    def contains(self, points: ArrayLike) -> np.ndarray:
        """Whether points (M, 3), world, lie inside of any of them; (M,) bool."""
        p = to_host(view("points", points, 3).owner).astype(np.float64)
        local = (p - self._pose[:3, 3]) @ self._pose[:3, :3]
        places = to_host(self.vertices).astype(np.float64)
        a, axis = places[self.faces[:, 0]], places[self.faces[:, 1]] - places[self.faces[:, 0]]
        square = np.maximum(np.einsum("ni,ni->n", axis, axis), 1e-300)
        radius = np.broadcast_to(to_host(self.radius), len(self))
        inside = np.zeros(len(p), bool)
        for some in np.array_split(np.arange(len(p)), 1 + len(p) * len(self) // _AT_ONCE):
            away = local[some, None] - a
            along = np.clip(np.einsum("mni,ni->mn", away, axis) / square, 0, 1)
            off = away - along[..., None] * axis
            inside[some] = (np.einsum("mni,mni->mn", off, off) <= radius**2).any(axis=1)
        return inside

    @property
    def _radii(self) -> tuple[Any, ...]:
        return True, self._radius.place, self._one_radius


@named
class Spheres(Capsules):
    """Plain spheres for an image: boundary particles, tracers, markers.

        render([Layer(fluid), Layer(Spheres(boundary, 0.5 * spacing), Material(color=0.5))])

    Args:
        positions: (N, 3) world.
        radius: world units, for all or (N,), each > 0.
        color: (3,) linear RGB for all, or (N, 3); default: gray, or the material's.
        device, threads: as for `Mesh`.
    """

    def __init__(
        self,
        positions: Any,
        radius: ArrayLike,
        color: ArrayLike | None = None,
        *,
        device: str = "auto",
        threads: int = 0,
    ):
        n = view("positions", positions, 3).shape[0]
        ends = np.repeat(np.arange(n, dtype=np.uint32)[:, None], 2, axis=1)
        super().__init__(positions, ends, radius, color, device, threads)

    def __repr__(self) -> str:
        return f"Spheres({len(self):,})"


@named
class Lines(Capsules):
    """Lines with a round cross-section for an image: trajectories, streamlines, axes, edges.

        render([Layer(fluid), Layer(Lines(path, 0.002), Material(color=(0.8, 0.1, 0.1)))])

    Args:
        points: (N, 3) world, one line through all points; or a list of such arrays, one a line. A
            line of one point is a sphere.
        radius: of all lines, world units, > 0.
        color: (3,) linear RGB for all, or (N, 3) per point, blended between; for several lines, N
            counts the points of all. Default: gray, or the material's.
        device, threads: as for `Mesh`.
    """

    def __init__(
        self, points: Any, radius: float, color: ArrayLike | None = None, *, device: str = "auto", threads: int = 0
    ):
        single = hasattr(points, "__array_interface__") or hasattr(points, "shape")
        lines = [points] if single else list(points)
        if lines and np.ndim(lines[0]) == 1:  # one line, as a list of points
            lines = [points]
        views = [view("points", line, 3) for line in lines]
        places = np.concatenate([to_host(v.owner) for v in views] or [np.empty((0, 3), np.float32)])
        starts, ends = [], 0
        for v in views:
            n = v.shape[0]
            first = np.arange(ends, ends + max(n - 1, min(n, 1)), dtype=np.uint32)
            starts.append(np.stack([first, np.minimum(first + 1, ends + n - 1)], axis=1))
            ends += n
        joined = np.concatenate(starts or [np.empty((0, 2))]).astype(np.uint32)
        if np.ndim(radius) != 0:
            raise ValueError(f"radius: expected one number, got {shown(radius)}")
        super().__init__(places, joined, radius, color, device, threads)

    def __repr__(self) -> str:
        return f"Lines({len(self):,} segments)"


def _checked_radius(radius: Any, n: int) -> tuple[View, float]:
    """Radii or ABSENT, and one for all."""
    if np.ndim(radius) == 0:
        one = positive("radius", radius)
        if one > MAX_RADIUS:
            raise ValueError(f"radius: expected at most {MAX_RADIUS:g}, got {one:g}")
        return ABSENT, one
    found = view("radius", radius, None)
    if found.shape[0] != n:
        raise ValueError(f"radius: expected {n} numbers, got {found.shape[0]}")
    host = to_host(found.owner)
    wrong = ~((host > 0) & (host <= MAX_RADIUS))
    if wrong.any():
        i = int(np.argmax(wrong))
        raise ValueError(f"radius: expected numbers above 0, got {host[i]:g} (sphere {i})")
    return view("radius", host.copy(), None), 0.0
