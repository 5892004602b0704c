"""Triangle meshes (.obj, .stl, .glb) through trimesh: vertices, with colors, as metaballs.

.ply files are read by `globule.formats.ply`, which needs no other package.
"""

from __future__ import annotations

import json
import logging
import os
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import IO, Any

import numpy as np

from .._base.checks import optional, positive
from .._base.colormaps import to_linear
from ..data.particles import Particles, relative
from ..data.surface import MOST_SAMPLES, sampled_particles, vertex_particles
from .errors import FormatError, bad
from .kind import kind_of, wrong_kind
from .packed import opens_packed
from .size import check_memory, check_size

FORMATS = ("obj", "stl", "glb", "ply")
# Bytes of memory at trimesh's peak, measured: for each byte of a file, and for each triangle.
_PEAKS = {"obj": 50, "stl": 14, "glb": 25, "ply": 16}
_BYTES_OF_A_TRIANGLE = 600
_LARGEST_ELEMENT = 64  # bytes, of a glTF accessor: a 4x4


def read(path: str | os.PathLike[str], spacing: float | None = None) -> Particles:
    """Read a mesh's vertices as metaballs; see `globule.sample_mesh`."""
    return sample_mesh(path, spacing)


def sample_mesh(mesh: Any, spacing: float | None = None) -> Particles:
    """A triangle mesh as metaballs.

    Without `spacing`, there is one metaball at each vertex, and vertices at the same position
    become one vertex. The support is the longest edge at the vertex (two local spacings for points
    without triangles). With `spacing`, points `spacing` apart on all triangles replace the
    vertices: the surface is thin and even for triangles of any size.

    Colors come from the vertices, the faces or the texture. The reader converts colors from sRGB to
    linear, except a .glb's vertex colors, which are linear by glTF's definition.

    Args:
        mesh: path of an .obj, .stl, .glb or .ply file, or a trimesh.Trimesh or trimesh.Scene.
        spacing: world units, > 0.

    Raises FormatError for a file that holds no mesh; ValueError for a spacing that would make more
    than 50 million points; MissingPackageError without trimesh.
    """
    if spacing is not None:
        spacing = positive("spacing", spacing)
    found = _parts(mesh)
    if isinstance(found, Particles):
        return found
    corners, colors = found
    if spacing is not None:
        places, origin = relative(corners.reshape(-1, 3))
        found = sampled_particles(places.reshape(corners.shape), spacing, colors)
        return replace(found, origin=origin)
    vertices = _vertices(corners, colors)
    return vertex_particles(vertices, np.arange(len(vertices)).reshape(-1, 3))


def read_triangles(path: str | os.PathLike[str]) -> tuple[Particles, np.ndarray]:
    """The corners of a file's triangles as vertices, three a triangle, with colors, and the
    triangles (F, 3); no triangles where the file has none."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of points: they are not what is asked for
        found = _parts(path)
    if isinstance(found, Particles):
        return found, np.empty((0, 3), np.int64)
    corners, colors = found
    vertices = _vertices(corners, colors)
    return vertices, np.arange(len(vertices)).reshape(-1, 3)


def _vertices(corners: np.ndarray, colors: _Colors) -> Particles:
    positions, origin = relative(corners.reshape(-1, 3))
    return Particles(positions, color=_at_corners(corners, colors), origin=origin)


def _at_corners(corners: np.ndarray, colors: _Colors) -> np.ndarray | None:
    """Colors (3 F, 3) at the corners of triangles."""
    return colors(np.repeat(np.arange(len(corners)), 3), np.tile(np.eye(3), (len(corners), 1)))


def _parts(mesh: Any) -> Particles | tuple[np.ndarray, _Colors]:
    """Corners (F, 3, 3) of a mesh's triangles and their colors; points where it has none."""
    trimesh = _trimesh()
    name, linear = "mesh", False
    if isinstance(mesh, (str, os.PathLike)):
        name = os.fspath(mesh)
        linear = kind_of(name, "mesh").format == "glb"
        mesh = _load(name, trimesh)
    scene = trimesh.Scene(mesh) if isinstance(mesh, trimesh.Trimesh) else mesh
    if not isinstance(scene, trimesh.Scene):
        raise TypeError(f"mesh: expected a path, Trimesh or Scene, got {type(mesh).__name__}")
    with _errors_of(name):
        _check_instances(name, scene)
        parts = scene.dump()  # each part where the scene has it
        meshes = [part for part in parts if isinstance(part, trimesh.Trimesh) and len(part.faces)]
        if not meshes:
            return _points(name, parts, linear)
        corners = np.concatenate([part.vertices[part.faces] for part in meshes])
        if corners.shape[1:] != (3, 3):
            raise bad(name, "", "expected vertices of three numbers, got others")
        return corners, _Colors(name, meshes, linear)


class _Colors:
    """Linear colors of points on the triangles of several meshes."""

    def __init__(self, name: str, meshes: list[Any], linear: bool):
        self.name, self.meshes, self.linear = name, meshes, linear
        self.first = np.cumsum([0, *(len(mesh.faces) for mesh in meshes)])
        self.given = any(mesh.visual.defined for mesh in meshes)

    def __call__(self, triangle: np.ndarray, barycentric: np.ndarray) -> np.ndarray | None:
        """Colors (M, 3) of points given as triangle (M,) and barycentric (M, 3)."""
        if not self.given:
            return None
        color = np.empty((len(triangle), 3), np.float32)
        owner = np.searchsorted(self.first, triangle, "right") - 1
        for i, mesh in enumerate(self.meshes):
            mine = owner == i
            with _errors_of(self.name):
                color[mine] = self._of(mesh, triangle[mine] - self.first[i], barycentric[mine])
        return color

    def _of(self, mesh: Any, face: np.ndarray, barycentric: np.ndarray) -> np.ndarray:
        visual = mesh.visual
        if visual.kind == "texture":
            found = None
            if visual.uv is not None and len(visual.uv):
                uv = np.einsum("mk,mkc->mc", barycentric, np.asarray(visual.uv)[mesh.faces[face]])
                found = visual.material.to_color(uv)
            if found is None:  # a material without a picture
                found = visual.material.main_color
            return to_linear(np.broadcast_to(found[..., :3], (len(face), 3)) / 255)
        if visual.kind == "face":
            return to_linear(visual.face_colors[face, :3] / 255)
        corner = visual.vertex_colors[mesh.faces[face], :3] / 255
        return np.einsum("mk,mkc->mc", barycentric, corner if self.linear else to_linear(corner))


def _check_instances(name: str, scene: Any) -> None:
    """Refuse a scene that shows its meshes so often that memory would run out."""
    shown = (scene.graph[node][1] for node in scene.graph.nodes_geometry)
    n_faces = sum(len(getattr(scene.geometry[geometry], "faces", ())) for geometry in shown)
    if n_faces > MOST_SAMPLES:
        raise bad(name, "", f"expected at most {MOST_SAMPLES:,} triangles, got {n_faces:,}")
    check_memory(name, "", _BYTES_OF_A_TRIANGLE * n_faces)


def _points(name: str, parts: list[Any], linear: bool) -> Particles:
    """What a file without triangles has: points."""
    found = [np.asarray(part.vertices) for part in parts if len(part.vertices)]
    if not found:
        raise bad(name, "", "expected a mesh with vertices, got none")
    positions, origin = relative(np.concatenate(found))
    positions = positions.astype(np.float32)
    shown = f"its {len(positions):,} vertices are shown as points"
    warnings.warn(f"{name}: expected a mesh with faces, got none: {shown}", stacklevel=2)
    colors = [p.colors[:, :3] / 255 for p in parts if len(p.vertices) and len(getattr(p, "colors", ()))]
    color = np.concatenate(colors) if sum(map(len, colors)) == len(positions) else None
    return Particles(positions, origin=origin, color=color if color is None or linear else to_linear(color))


@opens_packed
def _load(path: str, trimesh: Any) -> Any:
    kind = kind_of(path, "mesh")
    if kind.format not in FORMATS:
        raise wrong_kind(path, f"a mesh ({', '.join(FORMATS)})", kind)
    form = kind.format
    check_memory(path, "", _PEAKS[form] * os.path.getsize(path))
    with open(path, "rb") as file:  # what is no readable file is an OSError like everywhere
        if form == "glb":
            _check_glb(path, file)
        elif form == "obj":
            _check_obj(path, file)
        elif form == "stl":
            _check_stl(path, file)
    with _errors_of(path), open(path, "rb") as file:
        beside = _beside(trimesh, path)
        return trimesh.load_scene(file, file_type=form, process=False, resolver=beside)


def _beside(trimesh: Any, path: str) -> Any:
    """Gives trimesh the materials and pictures in a mesh's folder that the mesh names, and no other
    file of this machine."""

    class Beside(trimesh.resolvers.Resolver):
        def __init__(self, folder: str):
            self.folder = folder

        def get(self, name: str) -> bytes:
            found = os.path.realpath(os.path.join(self.folder, name.strip()))
            if not found.startswith(os.path.join(root, "")) or not os.path.isfile(found):
                raise FileNotFoundError(name)
            check_memory(found, "", 2.0 * os.path.getsize(found))
            with open(found, "rb") as file:
                return file.read()

        def namespaced(self, namespace: str) -> Any:
            return Beside(os.path.join(self.folder, namespace))

        def keys(self) -> list[str]:
            return []

        def write(self, name: str, data: Any) -> None:
            raise PermissionError(name)

    root = os.path.dirname(os.path.realpath(str(path)))
    return Beside(root)


def _check_obj(path: str, file: IO[bytes]) -> None:
    """Refuse a last line that breaks off: trimesh leaves the face out, or every vertex's color."""
    words = 0  # of the first vertex
    last: list[bytes] = []
    for line in file:
        if line.startswith((b"v ", b"f ")):
            last = line.split(b"#")[0].split()
            if not words and last[0] == b"v":
                words = len(last)
    if last[:1] == [b"v"] and len(last) != words:
        raise bad(path, "last vertex", f"expected {words - 1} numbers, got {len(last) - 1}")
    if last[:1] == [b"f"] and len(last) < 4:
        raise bad(path, "last face", f"expected at least 3 corners, got {len(last) - 1}")


def _check_stl(path: str, file: IO[bytes]) -> None:
    """Refuse a binary file that is shorter than its number of triangles: trimesh reads none."""
    size, head = os.fstat(file.fileno()).st_size, file.read(84)
    if len(head) < 84 or (head.startswith(b"solid") and 0 not in head):  # text
        return
    n = int.from_bytes(head[80:], "little")
    if size < 84 + 50 * n:
        expected = f"expected {84 + 50 * n:,} bytes for the {n:,} triangles of its header"
        raise bad(path, "", f"{expected}, got {size:,}: the file is cut off")


def _check_glb(path: str, file: IO[bytes]) -> None:
    """Refuse an accessor without data that is longer than the file: trimesh makes zeros of it."""
    size = os.fstat(file.fileno()).st_size
    head = file.read(20)
    if len(head) < 20:
        raise bad(path, "header", "expected a binary glTF file, got a shorter one")
    text = file.read(min(size, int.from_bytes(head[12:16], "little")))
    with _errors_of(path):
        content = json.loads(text)
        accessors = content.get("accessors", [])
        for accessor in accessors:
            if "bufferView" not in accessor and int(accessor["count"]) > size:
                got = f"{accessor['count']} without data"
                raise bad(path, "accessors", f"expected at most {size} elements, got {got}")
        used = [
            accessors[i]
            for mesh in content.get("meshes", [])
            for part in mesh["primitives"]
            for i in (*part["attributes"].values(), *filter(None, [part.get("indices")]))
        ]
        claim = sum(_LARGEST_ELEMENT * abs(int(accessor["count"])) for accessor in used)
        check_size(path, "meshes", claim, size, 2.0)  # all together: they may share their bytes


@contextmanager
def _errors_of(name: str) -> Iterator[None]:
    """trimesh fails in many ways on what it does not expect: all of them as FormatError."""
    try:
        yield
    except FormatError:
        raise
    except Exception as error:
        reason = str(error) or type(error).__name__
        raise bad(name, "", f"expected a triangle mesh, got {reason}") from None


def _trimesh() -> Any:
    trimesh = optional("trimesh", "formats")
    logging.getLogger("trimesh").addHandler(logging.NullHandler())  # else Python prints its errors
    return trimesh
