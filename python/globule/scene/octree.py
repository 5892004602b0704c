"""Facts about a scene's octree, and the Morton keys themselves."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from typing import Any

import numpy as np

from .. import _core
from .._base.arrays import address
from .._base.owner import Owner

_morton: Callable[..., Any] = _core.morton  # what it gives depends on the operation


class Octree(Owner):
    """Facts about a scene's octree at the moment of asking.

    level          deepest level that has nodes; the root is level 0
    n_nodes        nodes of all levels
    n_leaves       nodes without children that hold particles
    n_inside       particles in the octree; the others have no finite position or are out of bounds
    bytes          device memory, with all buffers of the build
    build_seconds  device time of the last build; 0 where the solver of a simulation built it
    lo, extent     lowest corner (3,) and edge length of the octree's cube, world
    """

    def __init__(self, scene: Any):
        self._scene = scene
        self._facts = scene.facts(False)
        self.level: int = self._facts["deepest"]
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
        """Hash of the sorted keys and the order of the particles; the same on every backend."""
        return f"{self._hashes['key_hash']:016x}"

    @property
    def node_hash(self) -> str:
        """Hash of all nodes with their boxes; the same on every backend."""
        return f"{self._hashes['node_hash']:016x}"

    def sorted_keys(self, n: int) -> tuple[np.ndarray, np.ndarray]:
        """Keys (n,) uint64 in ascending order and the particle (n,) uint32 that each belongs to."""
        keys, index = np.empty(n, np.uint64), np.empty(n, np.uint32)
        self._scene.sorted(address(keys), address(index))
        return keys, index

    def __repr__(self) -> str:
        return (
            f"Octree({self.n_nodes} nodes, {self.n_leaves} leaves, level {self.level}, "
            f"{self.n_inside} particles inside, {self.bytes / 2**20:.1f} MiB)"
        )


class morton:
    """Morton keys (thesis §3.1-3.3, §5.3), as the octree computes them; 32 or 64 bits."""

    @staticmethod
    def encode(x: int, y: int, z: int, bits: int = 32) -> int:
        """Interleave octree coordinates, x least significant; without the descriptor."""
        return _morton(bits, "encode", [x, y, z])

    @staticmethod
    def decode(code: int, bits: int = 32) -> tuple[int, int, int]:
        """Octree coordinates x, y, z of a code without descriptor; the inverse of `encode`."""
        return _morton(bits, "decode", [code])

    @staticmethod
    def parent(key: int, level: int, bits: int = 32) -> int:
        """Key of the level - 1 cell that holds the level cell `key`."""
        return _morton(bits, "parent", [key, level])

    @staticmethod
    def child(key: int, level: int, octant: int, bits: int = 32) -> int:
        """Key of the level + 1 cell in one octant, 0 to 7, of the level cell `key`."""
        return _morton(bits, "child", [key, level, octant])

    @staticmethod
    def neighbor(key: int, level: int, dx: int, dy: int, dz: int, bits: int = 32) -> int | None:
        """Key of the cell a step of -1, 0 or 1 along each axis away; None outside the octree."""
        return _morton(bits, "neighbor", [key, level, dx + 1, dy + 1, dz + 1])

    @staticmethod
    def dense_index(key: int, level: int, bits: int = 32) -> int:
        """Place in the array L of a level's cell."""
        return _morton(bits, "dense_index", [key, level])

    @staticmethod
    def dense_key(index: int, bits: int = 32) -> int:
        """Key, descriptor included, of the cell at a place in L."""
        return _morton(bits, "dense_key", [index])
