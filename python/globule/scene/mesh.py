"""Triangle meshes that images show as their triangles, beside particles."""

from __future__ import annotations

import math
import os
import threading
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from .. import _core
from .._base.arrays import ABSENT, HOST, View, address, rays, to_host, view
from .._base.checks import named, number, shown, thread_count
from .._base.device import Device, choose
from .._base.owner import Owner
from ..data.attributes import attribute_colors
from ..data.particles import HERE, UP, Particles, as_origin
from ..data.spacing import merge_coincident
from ..data.triangles import Triangles

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

DEFAULT_COLOR = (0.62, 0.62, 0.62)
MAX_FACES = 2**29 - 1
MISSED = 2**32 - 1  # the core's number of no face
_RIGID = 1e-3  # largest deviation of a pose's axes from unit vectors at right angles


class MeshIntersections(NamedTuple):
    """The first intersections of rays with a mesh.

    distance  (M,) float32 along the ray, world units; infinite where missed
    normal    (M, 3) float32, unit length, world; 0 where missed
    face      (M,) int64, index of the triangle; -1 where missed
    """

    distance: np.ndarray
    normal: np.ndarray
    face: np.ndarray


@named
class Mesh(Owner):
    """Triangles for an image, alone or in a `Layer` beside particles.

        render([Layer(particles), Layer(Mesh("tank.stl"), glass)])

    A *solid* mesh is the border of a body: it refracts, absorbs and shows a cut face where a clip
    opens it, and it displaces the fluid where both overlap. Any other mesh is a thin sheet with two
    sides: it reflects and transmits light but does not bend it.

    Args:
        vertices: (N, 3) world; the name of a file with faces (.stl, .obj, .ply, .glb, .vtk, .vtp);
            or an object with triangles: a trimesh.Trimesh or Scene, a pyvista.PolyData, a
            meshio.Mesh.
        faces: (M, 3) integers into the vertices; only with arrays of vertices.
        color: (3,) linear RGB for all, or (N, 3) per vertex; default: those of the file, else gray.
        face_color: (M, 3) linear RGB per triangle, instead of `color`.
        solid: whether the mesh is a solid. Default: if it is closed, i.e. every edge joins
            triangles of opposite direction. A closed container around a fluid is no solid: pass
            False, unless its walls have two sides.
        smooth: images blend the normals of triangles that meet at less than this angle, degrees; 0:
            flat triangles.
        origin: (x, y, z) float64, world, from which the vertices are given; "auto": of a file, as
            `globule.read` has it; of others, not known.
        pose: (4, 4) matrix world_from_mesh of a rotation and a translation; default: identity.
        device: "auto", "cpu", "cuda" or "cuda:N", for images of meshes alone; beside particles a
            mesh is on the device of the particles.
        threads: CPU threads, for images of meshes alone; 0 takes all.

    Raises:
        FormatError, OSError: the file cannot be read.
    """

    vertices: Any  # (N, 3) float32, coordinates of the mesh
    faces: np.ndarray  # (M, 3) uint32
    attributes: dict[str, np.ndarray]  # values per vertex of a file, (N,) or (N, k)
    device: Device  # for images of meshes alone
    closed: bool  # every edge joins triangles of opposite direction
    solid: bool
    smooth: float  # degrees
    origin: tuple[float, float, float] | None  # of the vertices, world; None: not known
    up = UP  # in images, as of particles

    def __init__(
        self,
        vertices: Any,
        faces: ArrayLike | None = None,
        *,
        color: ArrayLike | None = None,
        face_color: ArrayLike | None = None,
        solid: bool | None = None,
        smooth: float = 30.0,
        origin: Any = "auto",
        pose: ArrayLike | None = None,
        device: str = "auto",
        threads: int = 0,
    ):
        if color is not None and face_color is not None:
            raise ValueError("face_color: expected no color beside face_color, got both")
        found = _triangles(vertices, faces, origin)
        file = f"{os.fspath(vertices)}: " if isinstance(vertices, (str, os.PathLike)) else ""
        self._vertices = _checked_vertices(found.vertices, file)
        n = self._vertices.shape[0]
        self.vertices = self._vertices.owner
        self.faces = _checked_faces(found.faces, n)
        self.attributes = dict(found.attributes or {})
        self.origin = found.origin if isinstance(origin, str) else as_origin(origin)
        if color is None and face_color is None:
            color, face_color = found.color, found.face_color
        self._one_color, self._color = _colors(color, face_color, n, len(self.faces))
        self._given_color = color is not None or face_color is not None
        self.smooth = number("smooth", smooth, 0.0, 180.0)
        _, which = merge_coincident(to_host(self.vertices))
        self.closed, inside_out = _closed(to_host(self.vertices), self.faces, which[self.faces])
        if not isinstance(solid, (bool, np.bool_, type(None))):
            raise TypeError(f"solid: expected True, False or None, got {shown(solid)}")
        if solid and not self.closed:
            raise ValueError("solid: expected a closed mesh, got one with open edges")
        self.solid = self.closed if solid is None else bool(solid)
        if self.closed and inside_out:
            self.faces = np.ascontiguousarray(self.faces[:, ::-1])
        self.device = choose(device)
        self._threads = thread_count(threads)
        self._lock = threading.RLock()
        self._version = 0
        self._around = _around_corners(which, self.faces) if self.smooth else None
        self._on: dict[tuple, tuple[Any, int]] = {}  # the core's scene by device, and its version
        self._pose = _checked_pose(pose)

    @property
    def pose(self) -> np.ndarray:
        """world_from_mesh, (4, 4) float64: a rotation and a translation. A new pose takes effect in
        the next image; the hierarchy over the triangles stays."""
        return self._pose.copy()

    @pose.setter
    def pose(self, matrix: ArrayLike) -> None:
        pose = _checked_pose(matrix)
        with self._lock:
            self._pose = pose
            for core, _ in self._on.values():
                core.place_mesh(_rows(pose))

    def update(self, vertices: Any) -> None:
        """New positions of the vertices, (N, 3), as many as before; NumPy or on the device. The
        faces, colors, the pose and `solid` stay."""
        found = _checked_vertices(vertices)
        if found.shape != self._vertices.shape:
            raise ValueError(f"vertices: expected {self._vertices.shape[0]:,}, got {found.shape[0]:,}")
        with self._lock:
            self._vertices, self.vertices = found, found.owner
            self._version += 1

    @property
    def colored(self) -> bool:
        """Whether the mesh has colors of its own."""
        return self._given_color

    @property
    def points(self) -> Particles:
        """The vertices, in the coordinates of the mesh, with the attributes."""
        origin = self.origin or HERE
        return Particles(to_host(self.vertices), attributes=self.attributes, origin=origin)

    def color_by(
        self, name: str, colormap: str = "auto", range: tuple[float, float] | None = None
    ) -> tuple[float, float]:
        """Color the vertices by x, y or z, an attribute (a vector's length), or NAME:0 … for a
        component; triangles blend the colors of their corners.

        Returns the values of the map's ends, `range` or the lowest and highest finite value.
        Raises as `globule.color_by`.
        """
        found = attribute_colors(self.points, name, colormap, range)
        with self._lock:
            self._color = (view("color", found.color, 3), False)
            self._given_color = True
            self._version += 1
        return found.range

    def bounds(self) -> np.ndarray:
        """(2, 3) float64, lowest and highest corner of the vertices of all faces, world."""
        used = to_host(self.vertices)[np.unique(self.faces)]
        if len(used) == 0:
            return np.zeros((2, 3))
        world = used @ self._pose[:3, :3].T + self._pose[:3, 3]
        return np.array([world.min(axis=0), world.max(axis=0)])

    def intersect(self, origins: ArrayLike, directions: ArrayLike) -> MeshIntersections:
        """First intersection of arbitrary rays with the triangles, from both sides.

        The test has no gaps between neighboring triangles (Woop, Benthin and Wald 2013).

        Args:
            origins: (M, 3) world.
            directions: (M, 3) unit vectors. A ray whose direction is zero or not finite meets
                nothing.
        """
        o, d = rays(origins, directions)
        n = o.shape[0]
        distance, normal = np.empty(n, np.float32), np.empty((n, 3), np.float32)
        face = np.empty(n, np.uint32)
        self.build(self.device).intersect_mesh(n, o.place, d.place, address(distance), address(normal), address(face))
        return MeshIntersections(distance, normal, np.where(face == MISSED, -1, face.astype(np.int64)))

    def contains(self, points: ArrayLike) -> np.ndarray:
        """Whether points (M, 3), world, lie inside; (M,) bool. An open mesh contains nothing."""
        p = view("points", points, 3)
        if not self.closed or p.shape[0] == 0:
            return np.zeros(p.shape[0], bool)
        # No axis of a grid, and no plane of a box.
        direction = np.array([0.5257, 0.6179, 0.5846], np.float32)
        direction /= np.linalg.norm(direction)
        found = self.intersect(to_host(p.owner), np.broadcast_to(direction, p.shape))
        a, b, c = (to_host(self.vertices)[self.faces[np.maximum(found.face, 0), k]] for k in range(3))
        outward = np.cross(b - a, c - a) @ self._pose[:3, :3].T @ direction
        return (found.face >= 0) & (outward > 0)

    def build(self, device: Device) -> Any:
        """The core's scene on a device, with the hierarchy over the triangles up to date."""
        with self._lock:
            key = (device.backend, device.index)
            core, version = self._on.get(key, (None, -1))
            if core is None:
                core = _core.Scene(device.backend, device.index, self._threads)
            if version != self._version:
                self._on.pop(key, None)
                core.build_mesh(
                    self._vertices.shape[0],
                    self._vertices.place,
                    len(self.faces),
                    (address(self.faces), HOST, 0),
                    *self._corners,
                    math.cos(math.radians(self.smooth)),
                    self._color[0].place,
                    self._color[1],
                    self._one_color,
                    self.solid,
                    *self._radii,
                )
                core.place_mesh(_rows(self._pose))
                self._on[key] = (core, self._version)
            return core

    @property
    def _radii(self) -> tuple[Any, ...]:
        """For the core: whether faces are capsules, their radii or none, and one for all."""
        return False, ABSENT.place, 0.0

    @property
    def _corners(self) -> tuple[Any, ...]:
        """What the core takes for smooth normals."""
        if self._around is None or len(self.faces) == 0:
            return (*[ABSENT.place] * 3, 0)
        return (*((address(a), HOST, 0) for a in self._around), len(self._around[2]) - 1)

    def __len__(self) -> int:
        return len(self.faces)

    def __repr__(self) -> str:
        kind = "solid" if self.solid else "sheet"
        return f"Mesh({self._vertices.shape[0]} vertices, {len(self)} triangles, {kind})"


def _triangles(vertices: Any, faces: Any, origin: Any) -> Triangles:
    """The triangles that the arguments of `Mesh` stand for."""
    if isinstance(vertices, Triangles):
        return vertices
    if faces is not None:
        return Triangles(vertices, np.asarray(faces))
    if isinstance(vertices, (str, os.PathLike)):
        from ..formats.triangles import read  # formats are loaded when they are needed

        return read(os.fspath(vertices), origin)
    if hasattr(vertices, "dump") and hasattr(vertices, "geometry"):  # trimesh.Scene
        vertices = vertices.to_mesh() if hasattr(vertices, "to_mesh") else vertices.dump(True)
    if hasattr(vertices, "vertices") and hasattr(vertices, "faces"):  # trimesh.Trimesh
        return Triangles(np.asarray(vertices.vertices), np.asarray(vertices.faces))
    if hasattr(vertices, "cells_dict") and hasattr(vertices, "points"):  # meshio.Mesh
        cells = vertices.cells_dict
        parts = [cells[name] for name in ("triangle",) if name in cells]
        parts += [cells["quad"][:, [0, 1, 2, 0, 2, 3]].reshape(-1, 3)] if "quad" in cells else []
        if parts:
            return Triangles(np.asarray(vertices.points), np.concatenate(parts))
        got = ", ".join(cells) or "no cells"
        raise ValueError(f"vertices: expected a mesh with triangles or quads, got {got}")
    if hasattr(vertices, "triangulate") and hasattr(vertices, "points"):  # pyvista
        surface = vertices.extract_surface() if not hasattr(vertices, "regular_faces") else vertices
        surface = surface.triangulate()
        return Triangles(np.asarray(surface.points), np.asarray(surface.faces).reshape(-1, 4)[:, 1:])
    raise TypeError(
        "vertices: expected (N, 3) numbers with faces (M, 3), a file's name, or an object with "
        f"vertices and faces, got {shown(vertices)}"
    )


def _checked_vertices(vertices: Any, file: str = "") -> View:
    found = view("vertices", vertices, 3)
    if isinstance(found.owner, np.ndarray):
        if found.owner.base is not None or found.owner is vertices:
            found = view("vertices", found.owner.copy(), 3)  # the caller may change its own
        wrong = ~(np.abs(found.owner) <= 1e18).all(axis=1)  # NaN too
        if wrong.any():
            i = int(np.argmax(wrong))
            got = f"{found.owner[i].tolist()} (vertex {i})"
            raise ValueError(f"{file}vertices: expected finite coordinates up to 1e18, got {got}")
    return found


def _checked_faces(faces: Any, n: int) -> np.ndarray:
    array = np.asarray(faces)
    if array.size == 0:
        return np.empty((0, 3), np.uint32)
    if array.ndim != 2 or array.shape[1] != 3 or array.dtype.kind not in "iu":
        raise ValueError(f"faces: expected integers of shape (M, 3), got {array.dtype} {array.shape}")
    if len(array) > MAX_FACES:
        raise ValueError(f"faces: expected at most {MAX_FACES:,}, got {len(array):,}")
    if int(array.min()) < 0 or int(array.max()) >= n:
        got = f"{array.min()} to {array.max()}"
        raise ValueError(f"faces: expected indices from 0 to {n - 1}, got {got}")
    return np.ascontiguousarray(array, np.uint32)


def _colors(color: Any, face_color: Any, n: int, m: int) -> tuple[list[float], tuple[View, bool]]:
    """One color, and (colors or ABSENT, whether there is one a face)."""
    name, value, rows = ("color", color, n) if face_color is None else ("face_color", face_color, m)
    one = list(DEFAULT_COLOR)
    if value is None:
        return one, (ABSENT, False)
    array = np.asarray(value, np.float32)
    if not ((array >= 0) & (array <= 1)).all():
        raise ValueError(f"{name}: expected linear RGB from 0 to 1, got {shown(value)}")
    if array.shape == (3,) and face_color is None:
        return array.tolist(), (ABSENT, False)
    if array.shape != (rows, 3):
        raise ValueError(f"{name}: expected shape ({rows}, 3), got {array.shape}")
    return one, (view(name, array.copy(), 3), face_color is not None)


def _around_corners(which: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, ...]:
    """The place of each corner, corners by place, and where each place's begin; all uint32."""
    place = which[faces].ravel().astype(np.uint32)
    order = np.argsort(place, kind="stable").astype(np.uint32)
    counts = np.bincount(place, minlength=1)
    return place, order, np.concatenate([[0], np.cumsum(counts)]).astype(np.uint32)


def _closed(vertices: np.ndarray, faces: np.ndarray, f: np.ndarray) -> tuple[bool, bool]:
    """Whether every edge joins triangles of opposite direction, and whether their normals point
    inwards. f: the faces where vertices at one place count as one."""
    f = f[(f[:, 0] != f[:, 1]) & (f[:, 1] != f[:, 2]) & (f[:, 2] != f[:, 0])]
    if len(f) == 0:
        return False, False
    a, b = f.ravel(), f[:, [1, 2, 0]].ravel()
    low, high = np.minimum(a, b), np.maximum(a, b)
    edge = low * len(vertices) + high
    order = np.argsort(edge, kind="stable")
    starts = np.flatnonzero(np.diff(edge[order], prepend=-1))
    balance = np.add.reduceat(np.where(a < b, 1, -1)[order], starts)
    if balance.any():
        return False, False
    corners = vertices[faces].astype(np.float64) - vertices.mean(axis=0, dtype=np.float64)
    volume = np.einsum("ij,ij->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) / 6
    return True, bool(volume < 0)


def _checked_pose(pose: Any) -> np.ndarray:
    if pose is None:
        return np.eye(4)
    try:
        matrix = np.array(pose, np.float64)
    except (TypeError, ValueError):
        matrix = np.empty(0)
    if matrix.shape != (4, 4) or not np.isfinite(matrix).all():
        raise ValueError(f"pose: expected a (4, 4) matrix of finite numbers, got {shown(pose)}")
    turn = matrix[:3, :3]
    rigid = np.abs(turn @ turn.T - np.eye(3)).max() <= _RIGID and np.linalg.det(turn) > 0
    if not rigid or not np.allclose(matrix[3], (0, 0, 0, 1)):
        raise ValueError("pose: expected a rotation and a translation; transform the vertices for any other map")
    return matrix


def _rows(pose: np.ndarray) -> list[float]:
    """The first three rows, the axes made exactly unit vectors at right angles."""
    u, _, v = np.linalg.svd(pose[:3, :3])
    return np.concatenate([u @ v, pose[:3, 3:]], axis=1).ravel().tolist()
