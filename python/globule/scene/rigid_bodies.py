"""Rigid bodies of a SPlisHSPlasH run: meshes, and where they are in each frame.

SPlisHSPlasH writes a folder `rigid_bodies` with copies of the meshes and one file a frame,
`rb_data_1.bin` and so on (its RigidBodyExporter_BIN). Little-endian, without padding:

    in the first file alone   uint32 number of bodies; for each: uint32 length and name of the mesh
                              file, float32 scale (3,), int8 wall, float32 color (4,)
    in each file, each body   float32 position (3,), float32 rotation (3, 3), column by column

A vertex v of the mesh is at rotation (scale v) + position. A run whose bodies all stay at rest has
the first file alone.
"""

from __future__ import annotations

import os
import re
from typing import Any, NamedTuple

import numpy as np

from ..data.particles import HERE
from ..data.triangles import Triangles
from ..formats import triangles
from ..formats.errors import bad, faults
from ..formats.size import whole_file
from .mesh import Mesh

_NAME = re.compile(r"rb_data_(\d+)\.bin")
_POSE = np.dtype([("position", "<f4", 3), ("columns", "<f4", (3, 3))])
_MOST = 10_000  # bodies


class _Body(NamedTuple):
    mesh: str
    scale: np.ndarray
    wall: bool


class RigidBodies:
    """The rigid bodies of a SPlisHSPlasH run, as meshes that move from frame to frame.

        bodies = RigidBodies("output/rigid_bodies")
        for frame in bodies.frames:
            bodies.place(frame)
            render([Layer(f"output/partio/ParticleData_Fluid_{frame}.bgeo"), *bodies.meshes])

    Args:
        folder: with `rb_data_*.bin` and the meshes beside them.
        walls: whether to read bodies that the scene marks as walls, too.
        device, threads: as for `Mesh`.

    Attributes:
        meshes: a `Mesh` for each body.
        together: one `Mesh` of all bodies, which is one layer; `place` moves it, too.
        names: the file of each mesh.
        frames: the numbers of all frames that are there, ascending.

    Raises:
        FormatError: a file is damaged, or the folder has none.
        OSError: a file cannot be read.
    """

    def __init__(self, folder: str | os.PathLike[str], *, walls: bool = False, device: str = "auto", threads: int = 0):
        self.folder = os.fspath(folder)
        found = (_NAME.fullmatch(name) for name in os.listdir(self.folder))
        self.frames = sorted(int(match[1]) for match in found if match)
        if not self.frames:
            raise bad(self.folder, "", "expected files rb_data_1.bin and so on, got none")
        bodies, self._start = _header(self._path(self.frames[0]))
        self._n = len(bodies)
        self._shown = [i for i, body in enumerate(bodies) if walls or not body.wall]
        self.names = [bodies[i].mesh for i in self._shown]
        machine: dict[str, Any] = {"device": device, "threads": threads}
        self.meshes = []
        for i in self._shown:
            read = triangles.read(os.path.join(self.folder, bodies[i].mesh), HERE)
            scaled = Triangles(np.asarray(read.vertices) * bodies[i].scale, *read[1:])
            self.meshes.append(Mesh(scaled, **machine))
        self._ends = np.cumsum([0, *(len(mesh.vertices) for mesh in self.meshes)])
        faces = [mesh.faces + end for mesh, end in zip(self.meshes, self._ends, strict=False)]
        empty = np.empty((0, 3), np.uint32)
        self.together = Mesh(np.zeros((self._ends[-1], 3), np.float32), np.concatenate([empty, *faces]), **machine)
        self.place(self.frames[0])

    def place(self, frame: int) -> None:
        """Move the meshes to where the bodies are in a frame; frames without a file have the
        places of the last file before."""
        before = [number for number in self.frames if number <= frame]
        number = before[-1] if before else self.frames[0]
        path = self._path(number)
        data = whole_file(path)
        start = self._start if number == self.frames[0] else 0
        want = start + self._n * _POSE.itemsize
        if len(data) != want:
            raise bad(path, "", f"expected {want} bytes for {self._n} bodies, got {len(data)}")
        rows = np.frombuffer(data, _POSE, offset=start)
        for mesh, i in zip(self.meshes, self._shown, strict=True):
            pose = np.eye(4)
            pose[:3, :3], pose[:3, 3] = rows["columns"][i].T, rows["position"][i]
            with faults(path, f"body {i}"):
                mesh.pose = pose
        world = [m.vertices @ m.pose[:3, :3].T + m.pose[:3, 3] for m in self.meshes]
        self.together.update(np.concatenate([np.empty((0, 3)), *world]))

    def __len__(self) -> int:
        return len(self.meshes)

    def __repr__(self) -> str:
        return f"RigidBodies({len(self)} bodies, {len(self.frames)} frames)"

    def _path(self, frame: int) -> str:
        return os.path.join(self.folder, f"rb_data_{frame}.bin")


def _header(path: str) -> tuple[list[_Body], int]:
    """The bodies of the first file, and where their places begin."""
    data, at = whole_file(path), 0

    def take(dtype: str, n: int = 1) -> np.ndarray:
        nonlocal at
        size = np.dtype(dtype).itemsize * n
        if at + size > len(data):
            raise bad(path, f"byte {at}", f"expected {size} more bytes, got {len(data) - at}")
        values = np.frombuffer(data, dtype, n, at)
        at += size
        return values

    n, bodies = int(take("<u4")[0]), []
    if n > _MOST:
        raise bad(path, "", f"expected at most {_MOST} bodies, got {n}")
    for i in range(n):
        length = int(take("<u4")[0])
        if not 0 < length <= 4096:
            raise bad(path, f"body {i}", f"expected a name of 1 to 4096 bytes, got {length}")
        name = os.path.basename(bytes(take("u1", length)).decode("utf-8", "replace"))
        scale, wall = take("<f4", 3), bool(take("i1")[0])
        take("<f4", 4)  # color of SPlisHSPlasH's own window
        if not np.isfinite(scale).all():
            raise bad(path, f"body {i}", f"expected a finite scale, got {scale.tolist()}")
        bodies.append(_Body(name, scale, wall))
    return bodies, at
