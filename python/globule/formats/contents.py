"""What a file of particles holds beside its particles: the box, units, time and frames."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ..data.particles import Particles

_LEAST_RESULTANT = 0.1  # of a middle: a slab that fills nine tenths of a period has 0.11
_FEWEST_CUT, _SLICES, _EMPTY_SLICES = 200, 64, 4  # fewer particles leave slices empty by chance


@dataclass(frozen=True, eq=False)
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
        edges, axes = self._periods()
        if not len(axes):
            return positions
        with np.errstate(invalid="ignore", over="ignore"):
            cells = np.floor(self._shares(positions, edges))
        moved = np.zeros_like(cells)
        moved[:, axes] = cells[:, axes]
        moved[~np.isfinite(moved).all(axis=1)] = 0
        outside = moved.any(axis=1)
        if not outside.any():
            return positions
        positions = positions.copy()
        positions[outside] -= moved[outside] @ edges
        return positions

    def center(self, positions: np.ndarray) -> np.ndarray:
        """Positions (N, 3) float64 moved together along the periodic axes so that their middle is
        that of the box, and then into the box: what lay across a face is whole.

        The middle is the mean on a circle (Bai and Breen 2008). Along an axis that the positions
        fill, with a resultant length below 0.1, they have none, and stay.
        """
        edges, axes = self._periods()
        x = self.wrap(positions)
        shift = np.zeros(3)
        for axis in axes:
            share = self._shares(x, edges)[:, axis]
            mean = np.exp(2j * np.pi * share[np.isfinite(share)]).sum() / max(len(share), 1)
            if abs(mean) > _LEAST_RESULTANT:
                shift[axis] = 0.5 - np.angle(mean) / (2 * np.pi)
        return self.wrap(x + shift @ edges)

    def cut_axes(self, positions: np.ndarray) -> list[str]:
        """The periodic axes, "x", "y" and "z", at both of whose faces there are positions (N, 3),
        while they leave a slice of the box empty."""
        edges, axes = self._periods()
        if not len(axes) or len(positions) < _FEWEST_CUT:
            return []
        shares, found = self._shares(self.wrap(positions), edges), []
        for axis in axes:
            share = shares[:, axis]
            filled = np.unique((share[(share >= 0) & (share < 1)] * _SLICES).astype(int))
            if len(filled) < 3:
                continue
            steps = np.diff(filled)
            usual, face = float(np.median(steps)), filled[0] + _SLICES - filled[-1]
            if face <= 2 * usual < steps.max() - _EMPTY_SLICES:
                found.append("xyz"[axis])
        return found

    def _shares(self, positions: np.ndarray, edges: np.ndarray) -> np.ndarray:
        """(N, 3), of the edges: 0 and 1 are faces."""
        with np.errstate(invalid="ignore", over="ignore"):
            return (positions - self.origin) @ np.linalg.inv(edges)

    def _periods(self) -> tuple[np.ndarray, np.ndarray]:
        """The edges (3, 3), and the axes along which particles may be moved by them: none where
        they span no volume."""
        axes = np.flatnonzero(self.periodic)
        edges = self.edges.copy()
        for axis in np.flatnonzero(np.abs(edges).max(axis=1) == 0):  # 2-D boxes have no depth
            edges[axis, axis] = 1.0
            axes = axes[axes != axis]
        usable = np.isfinite(edges).all() and abs(np.linalg.det(edges)) >= 1e-300
        return edges, axes if usable else axes[:0]


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
