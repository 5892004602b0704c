"""Where a scene is sampled: planes, lines, grids and points."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from .._base.arrays import VectorLike, box_corners
from .._base.checks import corners, number, positive, shown, three, unit, whole
from .._base.fixed import Fixed, read_only
from ..pieces.scene import Scene
from .surface import MOST_PLACES, box_of, counts, default_spacing


class Lattice(NamedTuple):
    """Regular places.

    origin  (3,) float64, world
    steps   (d, 3) float64, world: from one place to the next along each dimension, slowest first
    shape   number of places along each dimension
    dims    names of the dimensions
    coords  coordinates along each dimension, world units
    """

    origin: np.ndarray
    steps: np.ndarray
    shape: tuple[int, ...]
    dims: tuple[str, ...]
    coords: tuple[np.ndarray, ...]

    def points(self) -> np.ndarray:
        """All places, (*shape, 3) float32."""
        points = np.broadcast_to(self.origin, (*self.shape, 3)).copy()
        for axis, (n, step) in enumerate(zip(self.shape, self.steps, strict=True)):
            along = [1] * len(self.shape) + [3]
            along[axis] = n
            points += (np.arange(n)[:, None] * step).reshape(along)
        return points.astype(np.float32)


@read_only
@dataclass(frozen=True)
class SamplePlane(Fixed):
    """Places all over a plane, in square cells.

    For a normal along an axis, the dimensions v (down the rows) and u (along a row) are the two
    other axes: u is x and v is y for (0, 0, 1), x and z for (0, 1, 0), y and z for (1, 0, 0).

    Args:
        normal: (3,) world, of any length above 0.
        offset: normal · x at the plane.
        spacing: distance of neighboring places, world units; default: half the spacing of the
            scene's particles.
        box: ((x, y, z), (x, y, z)), world: the places cover the part of the plane that this box
            projects to along the normal. Default: the box of the particles and their supports.
    """

    normal: VectorLike
    offset: float = 0.0
    spacing: float | None = None
    box: Any = None

    def _check(self) -> None:
        unit("normal", self.normal)
        number("offset", self.offset)
        _check_extent(self)

    def lattice(self, scene: Scene) -> Lattice:
        """The places, for this scene."""
        normal = np.asarray(unit("normal", self.normal))
        offset = self.offset / float(np.linalg.norm(np.asarray(self.normal, np.float64)))
        u, v = plane_axes(normal)
        lo, hi = box_of(scene) if self.box is None else corners("box", self.box)
        ends = box_corners(lo, hi)
        spacing = self.spacing or default_spacing(scene)
        low = np.array([(ends @ axis).min() for axis in (v, u)])
        high = np.array([(ends @ axis).max() for axis in (v, u)])
        shape = counts(high - low, spacing)
        origin = low[0] * v + low[1] * u + offset * normal
        coords = tuple(low[i] + spacing * np.arange(shape[i]) for i in (0, 1))
        return Lattice(origin, spacing * np.stack([v, u]), tuple(shape), ("v", "u"), coords)


@read_only
@dataclass(frozen=True)
class SampleLine(Fixed):
    """Places along a straight line, its ends included.

    Args:
        start, end: (3,) world, two different points.
        n: number of places, at least 2.
    """

    start: VectorLike
    end: VectorLike
    n: int = 256

    def _check(self) -> None:
        if three("start", self.start) == three("end", self.end):
            raise ValueError(f"end: expected another point than start, got {shown(self.end)}")
        whole("n", self.n, 2, MOST_PLACES)

    def lattice(self, scene: Scene) -> Lattice:
        """The places, for this scene."""
        start, end = np.array(self.start, np.float64), np.array(self.end, np.float64)
        way = np.linspace(0.0, float(np.linalg.norm(end - start)), self.n)
        step = (end - start) / (self.n - 1)
        return Lattice(start, step[None], (self.n,), ("s",), (way,))


@read_only
@dataclass(frozen=True)
class SampleGrid(Fixed):
    """Places at the nodes of a box's cubic cells.

    Args:
        spacing: edge of a cell, world units; default: half the spacing of the scene's particles.
        box: ((x, y, z), (x, y, z)), world; the first node is its lowest corner. Default: the box
            of the particles and their supports.
    """

    spacing: float | None = None
    box: Any = None

    def _check(self) -> None:
        _check_extent(self)

    def lattice(self, scene: Scene) -> Lattice:
        """The places, for this scene."""
        lo, hi = box_of(scene) if self.box is None else corners("box", self.box)
        spacing = self.spacing or default_spacing(scene)
        shape = counts(hi - lo, spacing)[::-1]
        steps = spacing * np.eye(3)[::-1]
        coords = tuple(lo[2 - i] + spacing * np.arange(shape[i]) for i in range(3))
        return Lattice(lo, steps, tuple(shape), ("z", "y", "x"), coords)


def _check_extent(places: SamplePlane | SampleGrid) -> None:
    if places.spacing is not None:
        positive("spacing", places.spacing)
    if places.box is not None:
        corners("box", places.box)


def plane_axes(normal: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Unit vectors u and v in the plane across a unit normal: along the axes where they can be."""
    main = int(np.argmax(np.abs(normal)))
    first, second = (axis for axis in range(3) if axis != main)
    u = np.eye(3)[first] - normal[first] * normal
    u /= np.linalg.norm(u)
    v = np.cross(normal, u)
    return u, v * (1.0 if v[second] > 0 else -1.0)
