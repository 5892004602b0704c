"""Questions to a scene's octree and field, and the Morton keys themselves."""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from . import _core
from .arrays import address, unit_vectors, view
from .thesis import Thesis, check_tracing

if TYPE_CHECKING:
    from .scene import Scene


class Octree:
    """Facts about a scene's octree at the moment of asking."""

    def __init__(self, scene: Any):
        self._scene = scene
        self._facts = scene.facts(False)
        self.depth: int = self._facts["deepest"]
        self.n_nodes: int = self._facts["n_nodes"]
        self.n_leaves: int = self._facts["n_leaves"]
        self.n_inside: int = self._facts["n_inside"]
        self.bytes: int = self._facts["bytes"]
        self.build_seconds: float = self._facts["build_seconds"]
        self.lo = np.array(self._facts["lo"], np.float32)
        self.extent: float = self._facts["extent"]

    @cached_property
    def _hashes(self) -> dict:
        return self._scene.facts(True)

    @property
    def key_hash(self) -> str:
        """Of the sorted keys and the order of the particles; the same on every backend."""
        return f"{self._hashes['key_hash']:016x}"

    @property
    def node_hash(self) -> str:
        """Of all nodes with their boxes; the same on every backend."""
        return f"{self._hashes['node_hash']:016x}"

    def sorted_keys(self, n: int) -> tuple[np.ndarray, np.ndarray]:
        """Keys (n,) uint64 in ascending order and the particle (n,) uint32 that each belongs to."""
        keys, index = np.empty(n, np.uint64), np.empty(n, np.uint32)
        self._scene.sorted(address(keys), address(index))
        return keys, index

    def __repr__(self) -> str:
        return (
            f"Octree({self.n_nodes} nodes, {self.n_leaves} leaves, depth {self.depth}, "
            f"{self.n_inside} particles inside, {self.bytes / 2**20:.1f} MiB)"
        )


def field(scene: Scene, points: Any) -> np.ndarray:
    """The field at points: sum of weight * b(r).

    Args:
        points: (M, 3) world; NumPy or on the scene's device.

    Returns:
        (M,) float32.
    """
    p = view("points", points, 3)
    out = np.empty(p.shape[0], np.float32)
    scene._scene.evaluate(scene._kernel, p.shape[0], p.place, address(out), 0)
    return out


def gradient(scene: Scene, points: Any) -> np.ndarray:
    """The field's gradient at points, (M, 3) float32, per world unit; it points inwards."""
    p = view("points", points, 3)
    out = np.empty((p.shape[0], 3), np.float32)
    scene._scene.evaluate(scene._kernel, p.shape[0], p.place, 0, address(out))
    return out


def intersect(
    scene: Scene, origins: Any, directions: Any, thesis: Thesis | None = None
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """First intersection of arbitrary rays with the surface.

    Args:
        origins: (M, 3) world.
        directions: (M, 3) unit vectors.
        thesis: trace the source thesis's way, with these choices; default: exactly.

    Returns:
        depth (M,) along the ray, infinite where missed; normal (M, 3); colour (M, 3), blended.
    """
    o, d = view("origins", origins, 3), view("directions", directions, 3)
    if o.shape != d.shape:
        raise ValueError(f"directions: expected {o.shape[0]} rows, got {d.shape[0]}")
    d = unit_vectors(d)
    n = o.shape[0]
    depth = np.empty(n, np.float32)
    normal, color = np.empty((n, 3), np.float32), np.empty((n, 3), np.float32)
    check_tracing(scene, thesis)
    scene._scene.intersect(
        scene._kernel,
        scene.threshold,
        None if thesis is None else thesis._packed,
        n,
        o.place,
        d.place,
        address(depth),
        address(normal),
        address(color),
    )
    return depth, normal, color


class morton:
    """Morton keys (thesis §3.1-3.3, §5.3), as the octree computes them; 32 or 64 bits."""

    @staticmethod
    def encode(x: int, y: int, z: int, bits: int = 32) -> int:
        """Interleave octree coordinates, x least significant; without the descriptor."""
        return _core.morton(bits, "encode", [x, y, z])

    @staticmethod
    def decode(code: int, bits: int = 32) -> tuple[int, int, int]:
        return _core.morton(bits, "decode", [code])

    @staticmethod
    def parent(key: int, level: int, bits: int = 32) -> int:
        """Key of the level - 1 cell that holds the level cell `key`."""
        return _core.morton(bits, "parent", [key, level])

    @staticmethod
    def child(key: int, level: int, octant: int, bits: int = 32) -> int:
        return _core.morton(bits, "child", [key, level, octant])

    @staticmethod
    def neighbor(key: int, level: int, dx: int, dy: int, dz: int, bits: int = 32) -> int | None:
        """Key of the cell a step of -1, 0 or 1 along each axis away; None outside the octree."""
        return _core.morton(bits, "neighbor", [key, level, dx + 1, dy + 1, dz + 1])

    @staticmethod
    def dense_index(key: int, level: int, bits: int = 32) -> int:
        """Place in the array L of a level's cell."""
        return _core.morton(bits, "dense_index", [key, level])

    @staticmethod
    def dense_key(index: int, bits: int = 32) -> int:
        """Key, descriptor included, of the cell at a place in L."""
        return _core.morton(bits, "dense_key", [index])
