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
    extent = float((high - low).max()) + 2 * room or 1.0  # 0: all at the origin
    cells = extent / (typical + 2 * margin) if typical > 0 else 1.0
    level = int(np.clip(np.floor(np.log2(max(cells, 1.0))), 0, FINEST))
    # The low corner, not the middle: a long, thin body is then cut across, not along.
    return Space(low - room, extent, level, margin)


def box_of(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(lowest, highest) corner (3,) of points (N, 3), N > 0."""
    many = len(points) // 64 * 64  # rows of 64 points: NumPy is slow along short ones
    parts = [points[many:]]
    if many:
        rows = np.ascontiguousarray(points[:many]).reshape(-1, 192)
        parts += [rows.min(0).reshape(64, 3), rows.max(0).reshape(64, 3)]
    few = np.concatenate(parts)
    return few.min(0), few.max(0)


def cells_of(space: Space, points: np.ndarray) -> np.ndarray:
    """The cells (N, 3) int64 that points (N, 3) lie in; outside of the space, the nearest ones."""
    n = 1 << space.level
    at = np.array(points, np.float64)
    at -= space.low
    at *= n / space.extent
    np.fmax(at, 0, out=at)  # NaN, too
    np.minimum(at, n - 1, out=at)
    return at.astype(np.int64)


def codes_of(cells: np.ndarray) -> np.ndarray:
    """Morton codes (...,) int64 of cells (..., 3): bits of z y x in turn, x least significant."""
    code = _SPREAD.take(cells[..., 0])
    code |= _SPREAD.take(cells[..., 1]) << 1
    code |= _SPREAD.take(cells[..., 2]) << 2
    return code


def _spread(v: np.ndarray) -> np.ndarray:
    """The bits of cell numbers, each with two zeros behind it."""
    v = (v | v << 8) & 0x00F00F
    v = (v | v << 4) & 0x0C30C3
    return (v | v << 2) & 0x249249


_SPREAD = _spread(np.arange(1 << FINEST))


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
        # By Morton code; 16 bits are sorted in one pass.
        kind = np.int16 if n <= 1 << 15 else np.int32
        self.owners = np.minimum((n * middle).astype(np.int64), n - 1).astype(kind)
        # Cells whose neighbors all belong to the same piece: most of them.
        side = 1 << space.level
        codes = codes_of(np.moveaxis(np.indices((side,) * 3), 0, -1))
        grid = self.owners[codes]
        least = most = grid
        for axis in range(3):
            pad = [(1, 1) if k == axis else (0, 0) for k in range(3)]
            parts = [np.pad(v, pad, mode="edge") for v in (least, most)]
            some = [[np.take(v, range(i, i + side), axis) for i in range(3)] for v in parts]
            least, most = np.minimum.reduce(some[0]), np.maximum.reduce(some[1])
        self._lonely = np.empty(len(self.owners), bool)
        self._lonely[codes] = least == most

    def owner(self, points: np.ndarray) -> np.ndarray:
        """The piece (N,) integers that owns each point (N, 3)."""
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

    def needed(self, points: np.ndarray, reach: np.ndarray | float) -> tuple[np.ndarray, np.ndarray]:
        """Which pieces hold which particles: rows and pieces, (M,) each, M >= N, ordered by piece.

        Args:
            points: (N, 3) positions.
            reach: how far each particle changes the field, world units: one number or (N,).
        """
        wide = np.asarray(reach, np.float64) + 2 * self.space.margin
        edge = self.space.extent / (1 << self.space.level)
        cell = cells_of(self.space, points)
        code = codes_of(cell)
        home = self.owners[code]
        rows, pieces = [np.arange(len(points))], [home]
        # Kernels no wider than a cell stay in the cells around; most have those to themselves.
        far = np.flatnonzero(~self._lonely[code] | (wide > edge))
        wide = np.broadcast_to(wide, (len(points),))[far, None]
        at = np.asarray(points, np.float64)[far]
        low, high = cells_of(self.space, at - wide), cells_of(self.space, at + wide)
        cell, home = cell[far], home[far]
        wide_ones = ((low < cell - 1) | (high > cell + 1)).any(axis=1)
        near = np.flatnonzero(~wide_ones)
        if len(near):
            ends = [_SPREAD.take(v[near]) << np.arange(3) for v in (low, cell, high)]
            owners = np.empty((27, len(near)), self.owners.dtype)
            for which, (x, y, z) in enumerate(np.ndindex(3, 3, 3)):
                owners[which] = self.owners[ends[x][:, 0] | ends[y][:, 1] | ends[z][:, 2]]
            mixed = np.flatnonzero((owners != owners[0]).any(axis=0))
            owners = np.sort(owners[:, mixed], axis=0)
            first = np.ones(owners.shape, bool)
            first[1:] = owners[1:] != owners[:-1]
            near = near[mixed]
            corner, k = np.nonzero(first & (owners != home[near]))
            rows.append(far[near[k]])
            pieces.append(owners[corner, k])
        for i in np.flatnonzero(wide_ones):  # kernels wider than a cell
            box = np.stack(np.meshgrid(*(np.arange(low[i, k], high[i, k] + 1) for k in range(3))), axis=-1)
            others = np.unique(self.owners[codes_of(box)])
            others = others[others != home[i]]
            rows.append(np.full(len(others), far[i]))
            pieces.append(others)
        row, piece = np.concatenate(rows), np.concatenate(pieces)
        order = np.argsort(piece, kind="stable")
        return row[order], piece[order].astype(np.int64)

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
