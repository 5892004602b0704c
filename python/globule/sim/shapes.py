"""Shapes by signed distance, which scenes fill with particles, wall in or hold fixed.

`distance` is negative inside, in m; near the surface it is exact or close to it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from .._base.settings import Direction, Table, setting
from .schema import PLACE, POSITIVE


@dataclass(frozen=True)
class Box(Table):
    """The box between two corners."""

    lo: tuple = setting(PLACE, help="corner where x, y and z are least", unit="m")
    hi: tuple = setting(PLACE, help="corner where x, y and z are largest", unit="m")

    def __post_init__(self) -> None:
        super().__post_init__()
        if not all(a < b for a, b in zip(self.lo, self.hi, strict=True)):
            raise ValueError(f"expected lo below hi in each axis, got {self.lo} and {self.hi}")

    def distance(self, points: np.ndarray) -> np.ndarray:
        """(N,) m, negative inside, of points (N, 3) m."""
        lo, hi = np.asarray(self.lo), np.asarray(self.hi)
        away = np.maximum(lo - points, points - hi)
        outside = np.linalg.norm(np.maximum(away, 0), axis=1)
        return outside + np.minimum(away.max(axis=1), 0)

    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Corners (3,) m of the box around it."""
        return np.asarray(self.lo), np.asarray(self.hi)

    def volume(self) -> float:
        """m³."""
        return float(np.prod(np.subtract(self.hi, self.lo)))

    def area(self) -> float:
        """m², of the surface."""
        a, b, c = np.subtract(self.hi, self.lo)
        return 2 * float(a * b + b * c + c * a)


@dataclass(frozen=True)
class Sphere(Table):
    """A ball."""

    center: tuple = setting(PLACE, help="center", unit="m")
    radius: float = setting(POSITIVE, help="radius", unit="m")

    def distance(self, points: np.ndarray) -> np.ndarray:
        """(N,) m, negative inside, of points (N, 3) m."""
        return np.linalg.norm(points - np.asarray(self.center), axis=1) - self.radius

    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Corners (3,) m of the box around it."""
        center = np.asarray(self.center)
        return center - self.radius, center + self.radius

    def volume(self) -> float:
        """m³."""
        return 4 / 3 * np.pi * self.radius**3

    def area(self) -> float:
        """m², of the surface."""
        return 4 * np.pi * self.radius**2


@dataclass(frozen=True)
class Cylinder(Table):
    """A round cylinder with flat ends at `start` and `end`."""

    start: tuple = setting(PLACE, help="middle of one end", unit="m")
    end: tuple = setting(PLACE, help="middle of the other end", unit="m")
    radius: float = setting(POSITIVE, help="radius", unit="m")

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.start == self.end:
            raise ValueError(f"expected start and end apart, got {self.start} twice")

    def axis(self) -> tuple[np.ndarray, float]:
        """Unit direction (3,) and length, m."""
        along = np.subtract(self.end, self.start)
        length = float(np.linalg.norm(along))
        return along / length, length

    def distance(self, points: np.ndarray) -> np.ndarray:
        """(N,) m, negative inside, of points (N, 3) m."""
        axis, length = self.axis()
        offset = points - np.asarray(self.start)
        along = offset @ axis
        across = np.linalg.norm(offset - along[:, None] * axis, axis=1)
        beside, beyond = across - self.radius, np.abs(along - length / 2) - length / 2
        outside = np.hypot(np.maximum(beside, 0), np.maximum(beyond, 0))
        return outside + np.minimum(np.maximum(beside, beyond), 0)

    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Corners (3,) m of the box around it."""
        axis, _ = self.axis()
        reach = self.radius * np.sqrt(np.maximum(0, 1 - axis * axis))
        ends = np.array([self.start, self.end])
        return ends.min(axis=0) - reach, ends.max(axis=0) + reach

    def volume(self) -> float:
        """m³."""
        return np.pi * self.radius**2 * self.axis()[1]

    def area(self) -> float:
        """m², of the surface."""
        return 2 * np.pi * self.radius * (self.radius + self.axis()[1])


@dataclass(frozen=True)
class Plane(Table):
    """The half space behind a plane; the normal points to its free side."""

    point: tuple = setting(PLACE, help="point on the plane", unit="m")
    normal: tuple = setting(Direction(), help="direction of the free side")

    def distance(self, points: np.ndarray) -> np.ndarray:
        """(N,) m, negative inside, of points (N, 3) m."""
        return (points - np.asarray(self.point)) @ np.asarray(self.normal)

    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Corners (3,) m of the box around it."""
        return np.full(3, -np.inf), np.full(3, np.inf)


OPEN = 0.01  # share of lines: fewer run along an edge


class Mesh:
    """A closed triangle mesh: triangles (F, 3, 3), m. A point is inside where a line upwards from
    it crosses the surface an odd number of times."""

    def __init__(self, triangles: np.ndarray):
        self.triangles = np.asarray(triangles, np.float64)

    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Corners (3,) m of the box around it."""
        corners = self.triangles.reshape(-1, 3)
        return corners.min(axis=0), corners.max(axis=0)

    def volume(self) -> float:
        """m³."""
        a, b, c = np.moveaxis(self.triangles, 1, 0)
        return abs(float(np.einsum("ik,ik", a, np.cross(b, c)))) / 6

    def area(self) -> float:
        """m², of the surface."""
        a, b, c = np.moveaxis(self.triangles, 1, 0)
        return float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum()) / 2

    def crossings(self, columns: np.ndarray) -> list[np.ndarray]:
        """Sorted heights z at which vertical lines at columns (C, 2) cross the surface."""
        order = np.argsort(columns[:, 0], kind="stable")
        x, y = columns[order].T
        column_of, heights = [], []
        for corners in self.triangles:
            flat, z = corners[:, :2], corners[:, 2]
            first, last = np.searchsorted(x, (flat[:, 0].min(), flat[:, 0].max()))
            a, b, c = flat
            area = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
            if first == last or area == 0:
                continue
            px, py = x[first:last], y[first:last]
            v = ((px - a[0]) * (c[1] - a[1]) - (py - a[1]) * (c[0] - a[0])) / area
            w = ((b[0] - a[0]) * (py - a[1]) - (b[1] - a[1]) * (px - a[0])) / area
            hit = np.flatnonzero((v >= 0) & (w >= 0) & (v + w <= 1))
            column_of.append(order[first + hit])
            heights.append(z[0] + v[hit] * (z[1] - z[0]) + w[hit] * (z[2] - z[0]))
        found: list[list[float]] = [[] for _ in columns]
        for column, height in zip(joined(column_of, int), joined(heights, float), strict=True):
            found[column].append(height)
        return [np.sort(h) for h in found]

    def inside_lattice(self, spacing: float) -> np.ndarray:
        """Points (N, 3) of the cubic lattice `spacing` apart that are inside.

        Raises:
            ValueError: lines that enter and do not leave.
        """
        lo, hi = self.bounds()
        n = np.maximum(1, np.round((hi - lo) / spacing).astype(int))
        start = (lo + hi) / 2 - (n - 1) / 2 * spacing
        axes = [start[k] + spacing * np.arange(n[k]) for k in range(3)]
        columns = np.stack(np.meshgrid(axes[0], axes[1], indexing="ij"), axis=-1).reshape(-1, 2)
        # Off the lattice by a little, so that no line runs exactly along an edge of a regular mesh.
        crossings = self.crossings(columns + spacing * np.array([1.7e-5, 2.9e-5]))
        met, one_sided = sum(len(h) > 0 for h in crossings), sum(len(h) % 2 for h in crossings)
        if one_sided > OPEN * met:
            raise ValueError(f"expected a closed mesh, got holes that {one_sided} of {met} lines pass")
        points = []
        for column, heights in zip(columns, crossings, strict=True):
            z = axes[2][np.searchsorted(heights, axes[2]) % 2 == 1]
            points.append(np.column_stack([np.tile(column, (len(z), 1)), z]))
        return np.concatenate(points)


def joined(parts: list[np.ndarray], kind: Any) -> np.ndarray:
    """Arrays one after the other; of none, an empty array of that kind."""
    return np.concatenate(parts) if parts else np.empty(0, kind)


class Grid:
    """A signed distance on voxels: values (X, Y, Z) m, linear between their centers."""

    def __init__(self, values: np.ndarray, world_from_voxel: np.ndarray):
        self.values = np.asarray(values, np.float64)
        self.world_from_voxel = np.asarray(world_from_voxel, np.float64)
        self.voxel_from_world = np.linalg.inv(self.world_from_voxel)

    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Corners (3,) m of the box around it."""
        top = np.array(self.values.shape) - 1
        corners = np.array(np.meshgrid(*[(0, t) for t in top])).reshape(3, -1).T
        world = corners @ self.world_from_voxel[:3, :3].T + self.world_from_voxel[:3, 3]
        return world.min(axis=0), world.max(axis=0)

    def area(self) -> float:
        """Of its box, which is more than that of most surfaces in it."""
        lo, hi = self.bounds()
        return Box(tuple(lo), tuple(hi)).area()

    def distance(self, points: np.ndarray) -> np.ndarray:
        """(N,) m, negative inside, of points (N, 3) m."""
        from scipy.ndimage import map_coordinates

        at = points @ self.voxel_from_world[:3, :3].T + self.voxel_from_world[:3, 3]
        top = np.array(self.values.shape) - 1
        inside = ((at >= -1e-9) & (at <= top + 1e-9)).all(axis=1)
        linear = map_coordinates(self.values, at.T, order=1, mode="nearest")
        return np.where(inside, linear, np.inf)


def gradient(shape: Any, points: np.ndarray, step: float) -> np.ndarray:
    """Gradient (N, 3) of a shape's distance, by central differences."""
    columns = []
    for axis in np.eye(3) * step:
        with np.errstate(invalid="ignore"):
            columns.append(shape.distance(points + axis) - shape.distance(points - axis))
    return np.stack(columns, axis=1) / (2 * step)
