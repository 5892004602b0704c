"""Shapes to particles: volumes to a cubic lattice, surfaces to one layer of boundary particles.

A particle represents the cube of the spacing around it. The outermost particles of a box are half a
spacing inside it, and the particles of two blocks that touch are one lattice. A wall's layer is
BEHIND spacings behind its face: the solver's walls push a little harder than fluid does (kWallShare
in boundary.hpp), and at this distance a lattice that touches the face is at rest.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ..data.particles import Particles
from ..data.surface import sample_triangles
from ..scene.scene import SceneBase
from .shapes import Box, Cylinder, Grid, Mesh, Plane, Sphere, gradient, joined

MOST_PARTICLES = 50_000_000
BEHIND = 0.555
FACES = ("-x", "+x", "-y", "+y", "-z", "+z")
ENDS = ("start", "end")


def fill(shape: Any, spacing: float) -> np.ndarray:
    """Lattice points (N, 3) float64 that fill a shape.

    A box that is a whole number of spacings wide is filled exactly. In any other shape the lattice
    is the largest that fits, centered.

    Args:
        shape: one of shapes.py, m.
        spacing: m.

    Raises:
        ValueError: a plane, or more than MOST_PARTICLES particles.
    """
    lo, hi = shape.bounds()
    if not np.isfinite([lo, hi]).all():
        raise ValueError("expected a shape with a volume, got a plane")
    n = np.maximum(1, np.floor((hi - lo) / spacing + 1e-3)).astype(np.int64)
    count = np.prod(n.astype(float))
    if count > MOST_PARTICLES:
        fits = 1.01 * spacing * (count / MOST_PARTICLES) ** (1 / 3)
        raise ValueError(
            f"expected at most {MOST_PARTICLES:,} particles, got {count:,.0f}; a spacing of {fits:.3g} m would fit"
        )
    if isinstance(shape, Mesh):
        return shape.inside_lattice(spacing)
    points = lattice(n, (lo + hi) / 2, spacing)
    return points if isinstance(shape, Box) else points[shape.distance(points) < 0]


def lattice(n: Any, middle: Any, spacing: float) -> np.ndarray:
    """(N, 3) m: n[0] x n[1] x n[2] points around a middle (3,), x slowest."""
    axes = [m + spacing * (np.arange(k) - (k - 1) / 2) for m, k in zip(middle, n, strict=True)]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)


def surface(
    shape: Any,
    spacing: float,
    hollow: bool = False,
    open_faces: Any = (),
    domain: tuple[np.ndarray, np.ndarray] | None = None,
) -> np.ndarray:
    """One layer of points (N, 3) m along a shape's surface, about `spacing` apart.

    Args:
        shape: one of shapes.py, m.
        spacing: m.
        hollow: whether things move inside the shape: the layer is outside of its surface, not
            inside.
        open_faces: of a box ("+z") or a cylinder ("end"), which have no points.
        domain: corners, m, which a plane spans.

    Raises:
        ValueError: open faces of another shape, unknown faces, or a plane without a domain.
    """
    offset = BEHIND * spacing if hollow else -BEHIND * spacing
    if isinstance(shape, Box):
        return _box_surface(shape, spacing, offset, open_faces)
    if isinstance(shape, Cylinder):
        return _cylinder_surface(shape, spacing, offset, open_faces)
    if len(open_faces):
        raise ValueError("open: expected a box or cylinder, got another shape")
    if isinstance(shape, Sphere):
        return _sphere_surface(np.asarray(shape.center), shape.radius + offset, spacing)
    if isinstance(shape, Plane):
        if domain is None:
            raise ValueError("expected a domain, which a plane spans, got none")
        return _plane_surface(shape, spacing, -BEHIND * spacing, domain)
    if isinstance(shape, Mesh):
        return _mesh_surface(shape, spacing, offset)
    return _grid_surface(shape, spacing, offset)


def _box_surface(box: Box, d: float, offset: float, open_faces: Any) -> np.ndarray:
    _check_open(open_faces, FACES)
    opened = np.array([face in open_faces for face in FACES]).reshape(3, 2)
    # Where both faces of an axis are open, the walls beside them go on as a lattice would.
    away = np.where(opened.all(1), -d / 2, offset)
    lo, hi = np.asarray(box.lo) - away, np.asarray(box.hi) + away
    n = np.maximum(2, np.round((hi - lo) / d).astype(int) + 1)
    index = shell(n, [face for face in FACES if face not in open_faces])
    keep = np.ones(len(index), bool)
    for axis, end in np.argwhere(opened & ~opened.all(1, keepdims=True)):
        if offset > 0:  # the walls beside an open face end with the box
            keep &= index[:, axis] != (n[axis] - 1 if end else 0)
    return lo + index[keep] * ((hi - lo) / (n - 1))


def shell(n: Any, faces: Any) -> np.ndarray:
    """Indices (M, 3) of the lattice points on some faces of a block of n points, x slowest."""
    numbers = []
    for face in faces:
        ranges = [np.arange(k) for k in n]
        axis = "xyz".index(face[1])
        ranges[axis] = ranges[axis][-1:] if face[0] == "+" else ranges[axis][:1]
        numbers.append(np.ravel_multi_index(np.ix_(*ranges), n).ravel())
    return np.stack(np.unravel_index(np.unique(joined(numbers, int)), n), axis=1)


def _sphere_surface(center: np.ndarray, radius: float, d: float) -> np.ndarray:
    """A spiral of equal areas (Fibonacci)."""
    if radius <= 0:
        return center[None].copy()
    n = max(4, round(4 * np.pi * (radius / d) ** 2))
    return center + radius * even_directions(n)


def even_directions(n: int, turned: float = 0.0) -> np.ndarray:
    """Unit vectors (n, 3) along a spiral around z, as many everywhere; turned: radians, about z."""
    z = 1 - (2 * np.arange(n) + 1) / n
    turn = np.arange(n) * (np.pi * (3 - np.sqrt(5))) + turned
    flat = np.sqrt(1 - z * z)
    return np.stack([flat * np.cos(turn), flat * np.sin(turn), z], axis=1)


def _check_open(open_faces: Any, known: tuple[str, ...]) -> None:
    for face in open_faces:
        if face not in known:
            raise ValueError(f"open: expected some of {', '.join(known)}, got {face!r}")


def _cylinder_surface(cylinder: Cylinder, d: float, offset: float, open_ends: Any) -> np.ndarray:
    _check_open(open_ends, ENDS)
    axis, length = cylinder.axis()
    radius = max(cylinder.radius + offset, 0.0)
    rows = max(2, round((length + 2 * offset) / d) + 1)
    heights = np.linspace(-offset, length + offset, rows)
    closed = [name not in open_ends for name in ENDS]
    caps = heights[[0, -1]][closed]
    if offset > 0:  # the wall ends with the cylinder where it is open
        heights = heights[0 if closed[0] else 1 : None if closed[1] else -1]
    rings = [(radius, heights)]
    n_rings = max(1, round(radius / d))
    for k in range(1, n_rings):
        rings.append((radius * k / n_rings, caps))
    points = [(np.zeros(len(caps)), np.zeros(len(caps)), caps)]
    for r, along in rings:
        n = max(3, round(2 * np.pi * r / d))
        angle, z = np.meshgrid(np.arange(n) / n * 2 * np.pi, along, indexing="ij")
        points.append(((r * np.cos(angle)).ravel(), (r * np.sin(angle)).ravel(), z.ravel()))
    u, v, w = (np.concatenate(parts) for parts in zip(*points, strict=True))
    return np.asarray(cylinder.start) + np.stack([u, v, w], axis=1) @ np.stack([*_across(axis), axis])


def _across(axis: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Two unit vectors at right angles to a unit vector (3,), and to each other."""
    side = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
    side /= np.linalg.norm(side)
    return side, np.cross(axis, side)


def _plane_surface(plane: Plane, d: float, offset: float, domain: Any) -> np.ndarray:
    normal = np.asarray(plane.normal)
    lo, hi = (np.asarray(corner, float) for corner in domain)
    middle = (lo + hi) / 2
    middle = middle - plane.distance(middle[None])[0] * normal + offset * normal
    side, other = _across(normal)
    reach = int(np.ceil(np.linalg.norm(hi - lo) / 2 / d))
    steps = np.arange(-reach, reach + 1) * d
    u, v = (grid.reshape(-1, 1) for grid in np.meshgrid(steps, steps, indexing="ij"))
    points = middle + u * side + v * other
    return points[((points >= lo - d) & (points <= hi + d)).all(axis=1)]


def _mesh_surface(mesh: Mesh, d: float, offset: float) -> np.ndarray:
    corners = mesh.triangles
    triangle, barycentric, _ = sample_triangles(corners, d / 3)
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1), 1e-30)[:, None]
    points = np.einsum("mk,mkc->mc", barycentric, corners[triangle])
    return thinned(points + offset * normals[triangle], 0.8 * d)


def _grid_surface(shape: Grid, d: float, offset: float) -> np.ndarray:
    """The level `offset` of a signed distance: lattice points nearby, moved onto it."""
    lo, hi = shape.bounds()
    coarse = lattice(np.ceil((hi - lo) / (2 * d)).astype(int) + 1, (lo + hi) / 2, 2 * d)
    near = coarse[np.abs(shape.distance(coarse) - offset) < 2.5 * d]
    within = lattice((4, 4, 4), (0, 0, 0), d / 2)
    points = (near[:, None] + within).reshape(-1, 3)
    points = points[np.abs(shape.distance(points) - offset) < 0.6 * d]
    step = min(d, np.linalg.norm(shape.world_from_voxel[:3, :3], axis=0).min()) / 2
    for _ in range(4):
        slope = gradient(shape, points, step)
        squared = np.square(slope).sum(axis=1)
        good = np.isfinite(squared) & (squared > 1e-12)
        points, slope, squared = points[good], slope[good], squared[good]
        points = points - ((shape.distance(points) - offset) / squared)[:, None] * slope
    return thinned(points[np.abs(shape.distance(points) - offset) < 0.1 * d], 0.8 * d)


def thinned(points: np.ndarray, distance: float) -> np.ndarray:
    """The points (M, 3) that are farther than `distance` from every earlier point that is kept."""
    if not len(points):
        return points
    scene = SceneBase(Particles(points, support=distance), device="cpu")
    offsets, near = scene.neighbors(points, distance)
    own = np.repeat(np.arange(len(points)), np.diff(offsets).astype(np.int64))
    earlier = near < own
    own, near = own[earlier], near[earlier]
    undecided, kept = 0, 1
    state = np.zeros(len(points), np.int8)
    while (state == undecided).any():
        dropped = np.zeros(len(points), bool)
        dropped[own[state[near] == kept]] = True
        waits = np.zeros(len(points), bool)
        waits[own[state[near] == undecided]] = True
        state[(state == undecided) & dropped] = 2
        state[(state == undecided) & ~waits] = kept
    return points[state == kept]
