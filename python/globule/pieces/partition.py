"""Pieces of a data set: ranges of coarse cells along the Morton curve.

A piece owns the points in its cells. It holds every particle that may change the field there, so
that its own octree knows the whole field in its cells and `margin` around them
(docs/design/pieces.md).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

FINEST = 7  # level of the coarse cells: at most 128 along each axis


class Space(NamedTuple):
    """The cube that the coarse cells divide.

    low     (3,) float64, world
    extent  its edge, world
    level   number of halvings: 2^level cells along each axis
    margin  world units; a piece knows the whole field so far around its cells
    """

    low: np.ndarray
    extent: float
    level: int
    margin: float


def space_around(low: np.ndarray, high: np.ndarray, typical: float, largest: float) -> Space:
    """The space of particles whose kernels reach `typical`, and at most `largest`, world units.

    The field vanishes outside of the space. Cells are no smaller than `typical`.
    """
    low, high = np.asarray(low, np.float64), np.asarray(high, np.float64)
    size = max(float(np.abs(low).max()), float(np.abs(high).max()))
    margin = max(1e-3 * typical, 16 * float(np.finfo(np.float32).eps) * size)
    room = largest + 2 * margin
    extent = float((high - low).max()) + 2 * room
    cells = extent / (typical + 2 * margin) if typical > 0 else 1.0
    level = int(np.clip(np.floor(np.log2(max(cells, 1.0))), 0, FINEST))
    # The low corner, not the middle: a long, thin body is then cut across, not along.
    return Space(low - room, extent, level, margin)


def cells_of(space: Space, points: np.ndarray) -> np.ndarray:
    """The cells (N, 3) int64 that points (N, 3) lie in; outside of the space, the nearest ones."""
    n = 1 << space.level
    at = (np.asarray(points, np.float64) - space.low) * (n / space.extent)
    return np.clip(np.nan_to_num(at, nan=0.0), 0, n - 1).astype(np.int64)


def codes_of(cells: np.ndarray) -> np.ndarray:
    """Morton codes (...,) int64 of cells (..., 3): bits of z y x in turn, x least significant."""
    code = np.zeros(cells.shape[:-1], np.int64)
    for axis in range(3):
        v = cells[..., axis]
        v = (v | v << 8) & 0x00F00F
        v = (v | v << 4) & 0x0C30C3
        v = (v | v << 2) & 0x249249
        code |= v << axis
    return code


def histogram(space: Space, points: np.ndarray) -> np.ndarray:
    """Points in each cell, in Morton order: (8^level,) int64."""
    return np.bincount(codes_of(cells_of(space, points)), minlength=8**space.level)


class Partition:
    """Which piece owns which cell.

    Args:
        space: the cells.
        counts: (8^level,) particles in each cell, in Morton order.
        n: number of pieces; some may be empty.
    """

    def __init__(self, space: Space, counts: np.ndarray, n: int):
        self.space, self.n = space, n
        before = np.cumsum(counts) - counts
        middle = (before + counts / 2) / max(int(counts.sum()), 1)
        self.owners = np.minimum((n * middle).astype(np.int32), n - 1)  # by Morton code
        # Cells whose neighbors all belong to the same piece: most of them.
        side = 1 << space.level
        grid = self.owners[codes_of(np.moveaxis(np.indices((side,) * 3), 0, -1))]
        least = most = grid
        for axis in range(3):
            pad = [(1, 1) if k == axis else (0, 0) for k in range(3)]
            parts = [np.pad(v, pad, mode="edge") for v in (least, most)]
            some = [[np.take(v, range(i, i + side), axis) for i in range(3)] for v in parts]
            least, most = np.minimum.reduce(some[0]), np.maximum.reduce(some[1])
        self._lonely = least == most

    def owner(self, points: np.ndarray) -> np.ndarray:
        """The piece (N,) int32 that owns each point (N, 3)."""
        return self.owners[codes_of(cells_of(self.space, points))]

    def knows(self, piece: int, points: np.ndarray) -> np.ndarray:
        """Whether each point (N, 3) lies in the piece's cells or so near that the piece knows the
        whole field there."""
        found = self.owner(points) == piece
        rest = np.flatnonzero(~found)
        for corner in _CORNERS:
            if len(rest):
                at = points[rest].astype(np.float64) + corner * (0.5 * self.space.margin)
                near = self.owner(at) == piece
                found[rest[near]] = True
                rest = rest[~near]
        return found

    def needed(
        self, points: np.ndarray, reach: np.ndarray | float
    ) -> tuple[np.ndarray, np.ndarray]:
        """Which pieces hold which particles: rows and pieces, (M,) each, M >= N, ordered by piece.

        Args:
            points: (N, 3) positions.
            reach: how far each particle changes the field, world units: one number or (N,).
        """
        wide = (np.asarray(reach, np.float64) + 2 * self.space.margin)[..., None]
        points = np.asarray(points, np.float64)
        low, high = cells_of(self.space, points - wide), cells_of(self.space, points + wide)
        cell = cells_of(self.space, points)
        home = self.owners[codes_of(cell)]
        rows, pieces = [np.arange(len(points))], [home.astype(np.int64)]
        wide_ones = ((low < cell - 1) | (high > cell + 1)).any(axis=1)
        near = np.flatnonzero(~self._lonely[tuple(cell.T)] & ~wide_ones)
        if len(near):
            ends = np.stack([low[near], cell[near], high[near]], axis=1)  # (K, 3, 3)
            cells = np.stack([ends[:, which, range(3)] for which in np.ndindex(3, 3, 3)], axis=1)
            owners = np.sort(self.owners[codes_of(cells)], axis=1)
            first = np.ones(owners.shape, bool)
            first[:, 1:] = owners[:, 1:] != owners[:, :-1]
            k, corner = np.nonzero(first & (owners != home[near, None]))
            rows.append(near[k])
            pieces.append(owners[k, corner].astype(np.int64))
        for i in np.flatnonzero(wide_ones):  # kernels wider than a cell
            box = np.stack(
                np.meshgrid(*(np.arange(low[i, k], high[i, k] + 1) for k in range(3))), axis=-1
            )
            others = np.unique(self.owners[codes_of(box)])
            others = others[others != home[i]]
            rows.append(np.full(len(others), i))
            pieces.append(others.astype(np.int64))
        row, piece = np.concatenate(rows), np.concatenate(pieces)
        order = np.lexsort((row, piece))
        return row[order], piece[order]

    def leave(self, origins: np.ndarray, directions: np.ndarray, start: np.ndarray) -> np.ndarray:
        """Where rays leave the cells of the piece that owns them at `start`: distances (M,)
        float64 along the rays; infinite past the space."""
        o, d = np.asarray(origins, np.float64), np.asarray(directions, np.float64)
        space, n = self.space, 1 << self.space.level
        edge = space.extent / n
        t = np.array(start, np.float64)
        found = np.full(len(t), np.inf)
        cell = cells_of(space, o + t[:, None] * d)
        owner = self.owners[codes_of(cell)]
        step = np.where(d > 0, 1, -1)
        going = np.arange(len(t))
        with np.errstate(divide="ignore", invalid="ignore"):
            while len(going):
                c, s = cell[going], step[going]
                face = space.low + (c + (s > 0)) * edge
                way = np.where(d[going] == 0, np.inf, (face - o[going]) / d[going])
                axis = np.argmin(way, axis=1)
                t[going] = np.maximum(t[going], way[np.arange(len(going)), axis])
                c[np.arange(len(going)), axis] += s[np.arange(len(going)), axis]
                cell[going] = c
                inside = ((c >= 0) & (c < n)).all(axis=1)
                left = np.zeros(len(going), bool)
                left[inside] = self.owners[codes_of(c[inside])] != owner[going[inside]]
                found[going[left]] = t[going[left]]
                going = going[inside & ~left]
        return found

    def enter(self, origins: np.ndarray, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Where rays enter and leave the space: distances (M,) float64 each, the first at least 0;
        first > last for rays that miss the space."""
        o, d = np.asarray(origins, np.float64), np.asarray(directions, np.float64)
        with np.errstate(divide="ignore", invalid="ignore"):
            a = (self.space.low - o) / d
            b = (self.space.low + self.space.extent - o) / d
        parallel = d == 0
        within = (o >= self.space.low) & (o <= self.space.low + self.space.extent)
        a = np.where(parallel, np.where(within, -np.inf, np.inf), a)
        b = np.where(parallel, np.where(within, np.inf, -np.inf), b)
        return np.maximum(np.minimum(a, b).max(axis=1), 0.0), np.maximum(a, b).min(axis=1)


_CORNERS = np.array(list(np.ndindex(2, 2, 2)), np.float64) * 2 - 1
