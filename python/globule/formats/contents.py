"""What a file of particles holds beside its particles: the box, units, time and frames."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ..data.particles import Particles


@dataclass(frozen=True)
class Box:
    """The box of a simulation, a parallelepiped.

    origin    (3,) float64, world: its corner
    edges     (3, 3) float64, world: row i is the edge along axis i
    periodic  whether opposite faces are joined, for each axis
    """

    origin: np.ndarray
    edges: np.ndarray
    periodic: tuple[bool, bool, bool] = (False, False, False)

    @classmethod
    def of_sizes(cls, origin: Any, sizes: Any, periodic: Any = (False, False, False)) -> Box:
        """A box with edges along the axes. Raises ValueError for sizes that are not finite."""
        origin = np.broadcast_to(np.asarray(origin, np.float64), (3,))
        edges = np.diag(np.broadcast_to(np.asarray(sizes, np.float64), (3,)))
        if not (np.isfinite(origin).all() and np.isfinite(edges).all()):
            raise ValueError("expected a finite box")
        return cls(origin.copy(), edges, _flags(periodic))

    def scaled(self, factor: float) -> Box:
        """The box with all lengths times a factor."""
        return Box(self.origin * factor, self.edges * factor, self.periodic)

    def wrap(self, positions: np.ndarray) -> np.ndarray:
        """Positions (N, 3) float64 moved into the box along its periodic axes.

        A position that lies inside keeps its bits. Axes whose edges span no volume are left alone.
        """
        positions = np.asarray(positions, np.float64)
        axes = np.flatnonzero(self.periodic)
        sizes = np.abs(self.edges).max(axis=1)
        if not len(axes) or not np.isfinite(self.edges).all():
            return positions
        edges = self.edges.copy()
        for axis in np.flatnonzero(sizes == 0):  # 2-D boxes have no depth
            edges[axis, axis] = 1.0
            axes = axes[axes != axis]
        if abs(np.linalg.det(edges)) < 1e-300:
            return positions
        with np.errstate(invalid="ignore", over="ignore"):
            cells = np.floor((positions - self.origin) @ np.linalg.inv(edges))
        moved = np.zeros_like(cells)
        moved[:, axes] = cells[:, axes]
        moved[~np.isfinite(moved).all(axis=1)] = 0
        outside = moved.any(axis=1)
        if not outside.any():
            return positions
        positions = positions.copy()
        positions[outside] -= moved[outside] @ edges
        return positions


@dataclass(frozen=True)
class Contents:
    """A frame of a file.

    particles  Particles, positions in the file's units
    box        Box, or None where the file has none
    units      name of a field or attribute -> unit as the file writes it; "positions" is a name
    time       in the file's unit of time, or None
    n_frames   how many frames the file holds; `read_contents(path, frame=i)` reads each of them
    species    names of its groups of particles, of which `read_contents(path, species=…)` reads
               one; empty if the format has no groups
    """

    particles: Particles
    box: Box | None = None
    units: Mapping[str, str] = field(default_factory=dict)
    time: float | None = None
    n_frames: int = 1
    species: tuple[str, ...] = ()


def frame_index(path: Any, frame: Any, n: int) -> int:
    """The index 0 ... n - 1 of a frame; negative ones count from the end. Raises ValueError."""
    if isinstance(frame, bool) or not isinstance(frame, (int, np.integer)):
        raise TypeError(f"frame: expected a whole number, got {frame!r}")
    if not -n <= frame < n:
        raise ValueError(f"frame: expected {-n} to {n - 1} for {path}, got {frame}")
    return int(frame) % n


def _flags(values: Any) -> tuple[bool, bool, bool]:
    x, y, z = (bool(v) for v in np.broadcast_to(np.asarray(values), (3,)))
    return x, y, z
