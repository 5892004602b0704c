"""Blades: the surface that an edge sweeps between two poses, and faces that cut in place."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cache
from typing import Any

import numpy as np


@dataclass(frozen=True)
class Blade:
    """Triangles that cut every bond whose segment crosses them.

    Attributes:
        vertices: (V, 3) float64, m, world.
        triangles: (T, 3) uint32 into the vertices.
        n_moving: number of the first vertices that belong to the earlier pose. An instrument that
            moves together with tissue counts them relative to where each bond was then.
    """

    vertices: np.ndarray
    triangles: np.ndarray
    n_moving: int = 0


@dataclass
class Knife:
    """An instrument that cuts: bonds that its edge sweeps over, and bonds that cross its faces.

    Attributes:
        edge: (K, 3) m, in the knife's own frame; a polyline.
        faces: (F, 3, 3) m, in the knife's own frame; triangles.
    """

    edge: np.ndarray
    faces: np.ndarray = field(default_factory=lambda: np.empty((0, 3, 3)))

    def at(self, pose: Any) -> np.ndarray:
        """The edge in the world, (K, 3)."""
        return _moved(self.edge, check_pose("pose", pose))

    def sweep(self, before: Any, now: Any) -> Blade:
        """The blade between two poses, (4, 4) world_from_knife or (3,), m.

        Raises:
            ValueError: a pose of another shape or with values that are not finite.
        """
        now = check_pose("now", now)
        swept = sweep(_moved(self.edge, check_pose("before", before)), _moved(self.edge, now))
        if not len(self.faces):
            return swept
        faces = _moved(self.faces.reshape(-1, 3), now)
        corners = len(swept.vertices) + np.arange(len(faces), dtype=np.uint32).reshape(-1, 3)
        return Blade(
            np.concatenate([swept.vertices, faces]), np.concatenate([swept.triangles, corners]), swept.n_moving
        )


def sweep(before: Any, now: Any) -> Blade:
    """The surface that an edge sweeps between two polylines (K, 3) m, world, vertex by vertex.

    Each piece of the edge makes two triangles. Successive sweeps share an edge, so that no bond
    slips through between them.

    Raises:
        ValueError: polylines of different lengths, or with values that are not finite.
    """
    a, b = _points("before", before, 2), _points("now", now, 2)
    if a.shape != b.shape:
        raise ValueError(f"now: expected {len(a)} points as in before, got {len(b)}")
    return Blade(np.concatenate([a, b]), _strip(len(a)), len(a))


@cache
def _strip(k: int) -> np.ndarray:
    """Triangles between two polylines of k points."""
    i = np.arange(k - 1, dtype=np.uint32)
    first, second = np.stack([i, i + 1, i + 1 + k], 1), np.stack([i, i + 1 + k, i + k], 1)
    corners = np.concatenate([first, second]).astype(np.uint32)
    corners.flags.writeable = False
    return corners


def triangles(corners: Any) -> Blade:
    """A blade of triangles (M, 3, 3) m, world, that stand still.

    Raises:
        ValueError: another shape, or values that are not finite.
    """
    corners = np.asarray(corners, np.float64)
    if corners.ndim != 3 or corners.shape[1:] != (3, 3):
        raise ValueError(f"blade: expected shape (M, 3, 3), got {corners.shape}")
    if not np.isfinite(corners).all():
        raise ValueError("blade: expected finite corners, got a NaN or an infinity")
    # Corners of one place become one vertex.
    vertices, index = np.unique(corners.reshape(-1, 3), axis=0, return_inverse=True)
    return Blade(vertices, index.reshape(-1, 3).astype(np.uint32))


def as_blade(blade: Any) -> Blade:
    """A `Blade` of a `Blade`, triangles (M, 3, 3) m, or a pair of polylines (before, now)."""
    if isinstance(blade, Blade):
        return blade
    if isinstance(blade, (tuple, list)) and len(blade) == 2:
        return sweep(*blade)
    return triangles(blade)


def straight(a: Any, b: Any) -> Knife:
    """A straight edge from a to b, (3,) m."""
    return Knife(_points("edge", [a, b], 2))


def curved(points: Any) -> Knife:
    """An edge through points (K, 3) m."""
    return Knife(_points("points", points, 2))


def scalpel(length: float = 0.03, height: float = 0.008, n: int = 12) -> Knife:
    """A scalpel: a belly that curves up to the tip, and the flat of the blade behind it.

    The tip is the origin, the handle is along +x, and the sharp side is -z. The flat is a fan of
    triangles in the plane y = 0.

    Args:
        length: m, of the edge along x.
        height: m, from the lowest point of the edge to the back of the blade.
        n: pieces of the edge.

    Raises:
        ValueError: a length or height that is not positive, or n below 1.
    """
    for name, value in (("length", length), ("height", height)):
        if not (np.isfinite(value) and value > 0):
            raise ValueError(f"{name}: expected a positive number, got {value!r}")
    if n < 1:
        raise ValueError(f"n: expected at least 1, got {n!r}")
    # A quarter of an ellipse over the first third, then straight.
    angle = np.linspace(0, np.pi / 2, n)
    belly = np.stack([length / 3 * (1 - np.cos(angle)), 0 * angle, -height * np.sin(angle)], 1)
    edge = np.concatenate([belly, [[length, 0, -height]]])
    back = np.array([length, 0.0, 0.0])
    faces = np.stack([np.broadcast_to(back, (len(edge) - 1, 3)), edge[:-1], edge[1:]], 1)
    return Knife(edge, faces)


def check_pose(name: str, pose: Any) -> np.ndarray:
    """A pose as (4, 4) float64; a position (3,) has no rotation.

    Raises:
        ValueError: another shape, or values that are not finite; `name` begins the message.
    """
    pose = np.asarray(pose, np.float64)
    if pose.shape == (3,):
        whole = np.eye(4)
        whole[:3, 3] = pose
        pose = whole
    if pose.shape != (4, 4):
        raise ValueError(f"{name}: expected shape (4, 4) or (3,), got {pose.shape}")
    if not np.isfinite(pose).all():
        raise ValueError(f"{name}: expected finite numbers, got a NaN or an infinity")
    return pose


def check_rigid(name: str, pose: Any) -> np.ndarray:
    """`check_pose`, which also refuses a pose that does more than rotate and translate."""
    try:
        pose = np.asarray(pose, np.float64)
    except (TypeError, ValueError):
        raise ValueError(f"{name}: expected numbers (4, 4) or (3,), got {pose!r}") from None
    pose = check_pose(name, pose)
    turn = pose[:3, :3]
    turned = np.abs(turn @ turn.T - np.eye(3)).max() < 1e-3 and np.linalg.det(turn) > 0
    if not (turned and np.array_equal(pose[3], (0, 0, 0, 1))):
        raise ValueError(f"{name}: expected a rotation and a place, got {pose.tolist()}")
    return pose


def _moved(points: np.ndarray, pose: np.ndarray) -> np.ndarray:
    return points @ pose[:3, :3].T + pose[:3, 3]


def _points(name: str, points: Any, least: int) -> np.ndarray:
    points = np.asarray(points, np.float64)
    if points.ndim != 2 or points.shape[1] != 3 or len(points) < least:
        raise ValueError(f"{name}: expected at least {least} points (K, 3), got {points.shape}")
    if not np.isfinite(points).all():
        raise ValueError(f"{name}: expected finite points, got a NaN or an infinity")
    return points
