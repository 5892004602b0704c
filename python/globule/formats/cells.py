"""Cells of VTK's files: the triangles that show faces and volumes.

Numbers of cell types, orders of nodes and ghost flags follow vtkCellType.h, "VTK File Formats"
(Kitware) and vtkDataSetAttributes.h. A face with nodes on its edges is cut at these nodes; cells of
an order above two are drawn by their corners.
"""

from __future__ import annotations

import functools
from collections.abc import Iterable
from itertools import pairwise
from typing import NamedTuple

import numpy as np

VERTICES, LINES, STRIPS, POLYGONS = 2, 4, 6, 7  # the types of all cells of these lists of PolyData
POLYHEDRON = 42
VERTEX, _PIXEL, _QUADRATIC_POLYGON = 1, 8, 36
GHOSTS = ("vtkGhostType", "vtkGhostLevels")
_HIDDEN_POINT, GHOST_POINT = 2, 1 | 2  # the second: or another piece has it
GHOST_CELL, HIDDEN_CELL = 1, 8 | 32  # another piece has it; refined by others, or hidden
_MOST_CORNERS = 4096  # of a polygon that is cut ear by ear

# Faces of volumes, seen from outside counterclockwise, as indices of a cell's corners.
_TETRA = ((0, 1, 3), (1, 2, 3), (2, 0, 3), (0, 2, 1))
_VOXEL = ((0, 4, 6, 2), (1, 3, 7, 5), (0, 1, 5, 4), (2, 6, 7, 3), (0, 2, 3, 1), (4, 5, 7, 6))
_HEXAHEDRON = ((0, 4, 7, 3), (1, 2, 6, 5), (0, 1, 5, 4), (3, 7, 6, 2), (0, 3, 2, 1), (4, 5, 6, 7))
_WEDGE = ((0, 1, 2), (3, 5, 4), (0, 3, 4, 1), (1, 4, 5, 2), (2, 5, 3, 0))
_PYRAMID = ((0, 3, 2, 1), (0, 1, 4), (1, 2, 4), (2, 3, 4), (3, 0, 4))


def _prism(n: int) -> tuple[tuple[int, ...], ...]:
    sides = ((i, (i + 1) % n, (i + 1) % n + n, i + n) for i in range(n))
    return (tuple(reversed(range(n))), tuple(range(n, 2 * n)), *sides)


# Edges of quadratic cells, in the order of their middle nodes.
_OF_TETRA = ((0, 1), (1, 2), (2, 0), (0, 3), (1, 3), (2, 3))
_OF_HEXAHEDRON = ((0, 1), (1, 2), (2, 3), (3, 0), (4, 5), (5, 6), (6, 7), (7, 4),
                  (0, 4), (1, 5), (2, 6), (3, 7))  # fmt: skip
_OF_WEDGE = ((0, 1), (1, 2), (2, 0), (3, 4), (4, 5), (5, 3), (0, 3), (1, 4), (2, 5))
_OF_PYRAMID = ((0, 1), (1, 2), (2, 3), (3, 0), (0, 4), (1, 4), (2, 4), (3, 4))
_OF_TRIANGLE = ((0, 1), (1, 2), (2, 0))
_OF_QUAD = ((0, 1), (1, 2), (2, 3), (3, 0))


class _Shape(NamedTuple):
    """How cells of one type are drawn.

    dimension  2 or 3
    corners    of the cell
    faces      corners of each face
    edges      that have a middle node, in the order of these nodes
    middles    faces that have a middle node, in the order of these nodes
    """

    dimension: int
    corners: int
    faces: tuple[tuple[int, ...], ...]
    edges: tuple[tuple[int, int], ...] = ()
    middles: tuple[int, ...] = ()


_LINEAR_TRIANGLE, _LINEAR_QUAD = _Shape(2, 3, ((0, 1, 2),)), _Shape(2, 4, ((0, 1, 2, 3),))
_LINEAR = {
    5: _LINEAR_TRIANGLE,
    _PIXEL: _Shape(2, 4, ((0, 1, 3, 2),)),
    9: _LINEAR_QUAD,
    10: _Shape(3, 4, _TETRA),
    11: _Shape(3, 8, _VOXEL),
    12: _Shape(3, 8, _HEXAHEDRON),
    13: _Shape(3, 6, _WEDGE),
    14: _Shape(3, 5, _PYRAMID),
    15: _Shape(3, 10, _prism(5)),
    16: _Shape(3, 12, _prism(6)),
}
_QUADRATIC = {
    22: _LINEAR_TRIANGLE._replace(edges=_OF_TRIANGLE),
    23: _LINEAR_QUAD._replace(edges=_OF_QUAD),
    24: _LINEAR[10]._replace(edges=_OF_TETRA),
    25: _LINEAR[12]._replace(edges=_OF_HEXAHEDRON),
    26: _LINEAR[13]._replace(edges=_OF_WEDGE),
    27: _LINEAR[14]._replace(edges=_OF_PYRAMID),
    28: _LINEAR_QUAD._replace(edges=_OF_QUAD, middles=(0,)),
    29: _LINEAR[12]._replace(edges=_OF_HEXAHEDRON, middles=(0, 1, 2, 3, 4, 5)),
    30: _LINEAR_QUAD._replace(edges=((0, 1), (2, 3))),
    31: _LINEAR[13]._replace(edges=_OF_WEDGE[:6]),
    32: _LINEAR[13]._replace(edges=_OF_WEDGE, middles=(2, 3, 4)),
    33: _LINEAR[12]._replace(edges=_OF_HEXAHEDRON, middles=(0, 1, 2, 3)),
    34: _LINEAR_TRIANGLE._replace(edges=_OF_TRIANGLE, middles=(0,)),
    37: _LINEAR[14]._replace(edges=_OF_PYRAMID, middles=(0,)),
}
# Lagrange's cells of order one and two, by their number of nodes; Bézier's have the same corners.
_LAGRANGE = {
    69: {3: 5, 6: 22, 7: 34},
    70: {4: 9, 9: 28},
    71: {4: 10, 10: 24},
    72: {8: 12, 27: 29},
    73: {6: 13, 15: 26, 18: 32},
    74: {5: 14, 13: 27},
}
_BEZIER = {76: 5, 77: 9, 78: 10, 79: 12, 80: 13, 81: 14}
_FACES = np.zeros(256, bool)
_FACES[[STRIPS, POLYGONS, _QUADRATIC_POLYGON, POLYHEDRON]] = True
_FACES[[*_LINEAR, *_QUADRATIC, *_LAGRANGE, *_BEZIER]] = True


class Cells(NamedTuple):
    """The cells of a file.

    types         (C,) uint8, numbers of VTK
    connectivity  (K,) int64, points of all cells
    offsets       (C + 1,) int64, where each cell begins in `connectivity`, and the end
    faces         of polyhedra: points (L,), offsets (P + 1,), and the cell of each face (P,)
    """

    types: np.ndarray
    connectivity: np.ndarray
    offsets: np.ndarray
    faces: tuple[np.ndarray, np.ndarray, np.ndarray] | None = None

    def problem(self, n_points: int) -> str:
        """What is wrong with the cells of so many points, or ""."""
        for corners, offsets in ((self.connectivity, self.offsets), *([self.faces[:2]] if self.faces
                                                                      else [])):  # fmt: skip
            grows = offsets[0] >= 0 and not (np.diff(offsets) < 0).any()
            if not grows or offsets[-1] > len(corners):
                return "expected offsets from 0 up to the length of the connectivity"
            used = corners[offsets[0] : offsets[-1]]
            if len(used) and not 0 <= used.min() <= used.max() < n_points:
                return f"expected indices from 0 to {n_points - 1}, got {used.min()} to {used.max()}"
        return ""


def have_faces(types: np.ndarray) -> bool:
    """Whether there is a face or a volume among cells of these types."""
    return bool(_FACES[np.asarray(types).astype(np.uint8)].any())


def joined(parts: Iterable[Cells]) -> Cells:
    """The cells of several lists of one set of points."""
    types, corners, offsets = [np.empty(0, np.uint8)], [np.empty(0, np.int64)], [np.zeros(1, int)]
    for part in parts:
        types.append(part.types)
        used = part.connectivity[part.offsets[0] : part.offsets[-1]]
        offsets.append(part.offsets[1:] - part.offsets[0] + sum(map(len, corners)))
        corners.append(used)
    return Cells(np.concatenate(types), np.concatenate(corners), np.concatenate(offsets))


def with_streams(cells: Cells, stream: np.ndarray, begins: np.ndarray) -> Cells:
    """The cells with the faces of polyhedra, which a stream holds as their number, and of each its
    length and points. begins: (C,) where a polyhedron begins in the stream.

    Raises ValueError for a stream that ends too early.
    """
    corners: list[int] = []
    ends, owner = [0], []
    numbers = stream.tolist()
    for cell in np.flatnonzero(cells.types == POLYHEDRON).tolist():
        at = int(begins[cell])
        if not 0 <= at < len(numbers):
            raise ValueError("expected the faces of polyhedra, got too few numbers")
        n_faces, at = numbers[at], at + 1
        for _ in range(n_faces):
            size = numbers[at] if at < len(numbers) else -1
            if not 0 <= size < len(numbers) - at:
                raise ValueError("expected the faces of polyhedra, got too few numbers")
            corners += numbers[at + 1 : at + 1 + size]
            at += 1 + size
            ends.append(len(corners))
            owner.append(cell)
    found = (np.array(corners, np.int64), np.array(ends, np.int64), np.array(owner, np.int64))
    return cells._replace(faces=found)


def with_faces(
    cells: Cells, corners: np.ndarray, ends: np.ndarray, of_cell: np.ndarray, cell_ends: np.ndarray
) -> Cells:
    """The cells with the faces of polyhedra.

    Args:
        corners: (L,) points of all faces.
        ends: (F,) where each face ends in them.
        of_cell: faces of all polyhedra.
        cell_ends: (C,) where those of each cell end in `of_cell`.

    Raises ValueError for a face that does not exist.
    """
    sizes = np.diff(cell_ends, prepend=0)
    begins = np.concatenate([[0], ends[:-1]])
    lengths = (ends - begins)[of_cell]
    if (sizes < 0).any() or (lengths < 0).any() or sizes.sum() != len(of_cell):
        raise ValueError("expected offsets of faces that grow")
    starts = np.concatenate([[0], np.cumsum(lengths)])
    at = np.arange(starts[-1]) + np.repeat(begins[of_cell] - starts[:-1], lengths)
    owner = np.repeat(np.arange(len(cells.types)), sizes)
    return cells._replace(faces=(corners[at], starts, owner))


def without_streams(cells: Cells) -> Cells:
    """The cells, polyhedra with their points where a legacy file has streams of faces.

    Raises ValueError for a stream that ends too early.
    """
    solid = cells.types == POLYHEDRON
    if not solid.any():
        return cells
    found = with_streams(cells, cells.connectivity, cells.offsets)
    assert found.faces is not None
    corners, ends, owner = found.faces
    parts = [cells.connectivity[a:b] for a, b in pairwise(cells.offsets.tolist())]
    for i in np.flatnonzero(solid).tolist():
        mine = np.flatnonzero(owner == i)
        parts[i] = np.unique(corners[ends[mine[0]] : ends[mine[-1] + 1]]) if len(mine) else mine
    offsets = np.concatenate([[0], np.cumsum([len(part) for part in parts])])
    return found._replace(connectivity=np.concatenate(parts), offsets=offsets)


def triangles(
    points: np.ndarray, cells: Cells, arrays: dict[str, np.ndarray], cell_arrays: dict[str, np.ndarray]
) -> np.ndarray:
    """Triangles (F, 3) int64 of all faces, and of those faces of volumes that no two of them share.

    A volume that another piece has (vtkGhostType) covers faces, and none of its own are drawn. A
    hidden cell, and one with a hidden point, counts as none.

    Args:
        points: (N, 3) world.
        cells: of these points.
        arrays, cell_arrays: values of points and cells by name.

    Raises ValueError for cells whose offsets or points do not exist.
    """
    if problem := cells.problem(len(points)):
        raise ValueError(problem)
    flags = ghost_flags(dict(cell_arrays), len(cells.types))
    flags = np.zeros(len(cells.types), np.uint8) if flags is None else flags
    there = (flags & HIDDEN_CELL) == 0
    hidden = ghost_flags(dict(arrays), len(points))
    if hidden is not None:
        owner = np.repeat(np.arange(len(there)), np.diff(cells.offsets))
        used = cells.connectivity[cells.offsets[0] : cells.offsets[-1]]
        there[owner[(hidden[used] & _HIDDEN_POINT) != 0]] = False
    elsewhere = (flags & GHOST_CELL) != 0
    faces = _Faces(np.asarray(points, np.float64))
    sizes = np.diff(cells.offsets)
    for kind in np.unique(cells.types[there]).tolist():
        if not _FACES[kind] or kind == POLYHEDRON:
            continue
        of_kind = there & (cells.types == kind)
        for size in np.unique(sizes[of_kind]).tolist():
            these = np.flatnonzero(of_kind & (sizes == size))
            nodes = cells.connectivity[cells.offsets[these, None] + np.arange(size)]
            if kind in (STRIPS, POLYGONS, _QUADRATIC_POLYGON):
                flat = nodes[~elsewhere[these]]
                if size > 2:
                    faces.add_flat(kind, flat)
                continue
            shape = _shape(kind, size)
            if shape is not None:
                for corners, template in _drawn(shape):
                    faces.add(shape.dimension, nodes, corners, template, elsewhere[these])
    if cells.faces is not None:
        listed, offsets, owner = cells.faces
        sizes = np.diff(offsets)
        for size in np.unique(sizes[sizes > 2]).tolist():
            of_size = np.flatnonzero((sizes == size) & there[owner])
            nodes = listed[offsets[of_size, None] + np.arange(size)]
            faces.add(3, nodes, tuple(range(size)), None, elsewhere[owner[of_size]])
    return faces.triangles()


class _Faces:
    """Faces by their number of corners, until all are there."""

    def __init__(self, points: np.ndarray) -> None:
        self.points = points
        self.found = [np.empty((0, 3), np.int64)]
        self.of_volumes: dict[int, list[tuple[np.ndarray, np.ndarray, np.ndarray | None]]] = {}
        self.elsewhere: dict[int, list[np.ndarray]] = {}

    def add_flat(self, kind: int, nodes: np.ndarray) -> None:
        size = nodes.shape[1]
        if kind == STRIPS:
            for i in range(1, size - 1):
                three = [i - 1, i, i + 1] if i % 2 else [i, i - 1, i + 1]
                self.found.append(nodes[:, three])
        elif kind == POLYGONS:
            self.found.append(cut(self.points, nodes))
        elif size % 2 == 0:  # corners, then the middles of the edges
            order = np.arange(size).reshape(2, -1).T.ravel()
            self.found.append(cut(self.points, nodes[:, order]))

    def add(
        self,
        dimension: int,
        nodes: np.ndarray,
        corners: tuple[int, ...],
        template: np.ndarray | None,
        elsewhere: np.ndarray,
    ) -> None:
        """One face of each cell (n, nodes); template: triangles of nodes, None: of the corners."""
        if dimension == 2:
            here = nodes[~elsewhere]
            flat = cut(self.points, here[:, corners]) if template is None else _of(here, template)
            self.found.append(flat)
            return
        k = len(corners)
        self.of_volumes.setdefault(k, []).append((nodes[:, corners], nodes, template))
        self.elsewhere.setdefault(k, []).append(elsewhere)

    def triangles(self) -> np.ndarray:
        for k, parts in self.of_volumes.items():
            outer = _single(np.concatenate([corners for corners, _, _ in parts]))
            outer &= ~np.concatenate(self.elsewhere[k])
            begin = 0
            for corners, nodes, template in parts:
                mine = outer[begin : begin + len(corners)]
                begin += len(corners)
                if template is None:
                    self.found.append(cut(self.points, corners[mine]))
                else:
                    self.found.append(_of(nodes[mine], template))
        return np.concatenate(self.found)


def _of(nodes: np.ndarray, template: np.ndarray) -> np.ndarray:
    return nodes[:, template].reshape(-1, 3)


def _single(corners: np.ndarray) -> np.ndarray:
    """Which faces (M, k) have corners that no other face has, in whatever order."""
    keys = np.sort(corners, axis=1)
    order = np.lexsort(keys.T)
    new = np.ones(len(keys) + 1, bool)
    new[1:-1] = (keys[order][1:] != keys[order][:-1]).any(axis=1)
    single = np.empty(len(keys), bool)
    single[order] = new[1:] & new[:-1]
    return single


def _shape(kind: int, size: int) -> _Shape | None:
    """The shape of a cell of so many nodes; None for one that has too few."""
    if kind in _LAGRANGE:
        orders = _LAGRANGE[kind]
        kind = orders.get(size, min(orders.values()))
    shape = _QUADRATIC.get(kind) or _LINEAR[_BEZIER.get(kind, kind)]
    least = shape.corners + len(shape.edges) + len(shape.middles)
    return shape if size >= least else None


@functools.cache
def _drawn(shape: _Shape) -> list[tuple[tuple[int, ...], np.ndarray | None]]:
    """The corners of each face, and triangles (T, 3) of the cell's nodes; None: of corners."""
    middle_of = {frozenset(edge): shape.corners + i for i, edge in enumerate(shape.edges)}
    inner = {face: shape.corners + len(shape.edges) + i for i, face in enumerate(shape.middles)}
    found: list[tuple[tuple[int, ...], np.ndarray | None]] = []
    for i, corners in enumerate(shape.faces):
        n = len(corners)
        edges = [middle_of.get(frozenset((corners[j], corners[(j + 1) % n]))) for j in range(n)]
        around = [k for j in range(n) for k in (corners[j], edges[j]) if k is not None]
        m = len(around)
        if i in inner:
            three = [(around[j], around[(j + 1) % m], inner[i]) for j in range(m)]
        elif m == n:
            found.append((corners, None))
            continue
        elif m == 2 * n:  # at each corner a triangle, and the middles among themselves
            three = [(around[j - 1], around[j], around[j + 1]) for j in range(0, m, 2)]
            three += [(around[1], around[j], around[j + 2]) for j in range(3, m - 2, 2)]
        else:
            start = around.index(next(edge for edge in edges if edge is not None))
            turned = around[start:] + around[:start]
            three = [(turned[0], turned[j], turned[j + 1]) for j in range(1, m - 1)]
        found.append((corners, np.array(three)))
    return found


def cut(points: np.ndarray, polygons: np.ndarray) -> np.ndarray:
    """Triangles (F, 3) of polygons (P, k) of points (N, 3), also of those with inward corners.

    A quad is cut along its shorter diagonal inside; a larger polygon from its first corner, or ear
    by ear where that leaves it.
    """
    k = polygons.shape[1]
    if k == 3 or not len(polygons):
        return polygons.reshape(-1, 3)
    places = points[polygons]
    if k > 4:
        fan = np.array([(0, i, i + 1) for i in range(1, k - 1)])
        normals = np.cross(places[:, fan[:, 1]] - places[:, :1], places[:, fan[:, 2]] - places[:, :1])
        inside = (np.einsum("pfc,pc->pf", normals, normals.sum(axis=1)) >= 0).all(axis=1)
        hard = [_ears(p)[None] for p in places[~inside]] if k <= _MOST_CORNERS else []
        if not hard:
            return _of(polygons, fan)
        bent = polygons[~inside]
        parts = [b[ears[0]] for b, ears in zip(bent, hard, strict=True)]
        return np.concatenate([_of(polygons[inside], fan), *parts])
    halves = np.array([[(0, 1, 2), (0, 2, 3)], [(0, 1, 3), (1, 2, 3)]])
    good, length = [], []
    for half, (a, b) in zip(halves, ((0, 2), (1, 3)), strict=True):
        three = places[:, half]
        normal = np.cross(three[:, :, 1] - three[:, :, 0], three[:, :, 2] - three[:, :, 0])
        good.append(np.einsum("pc,pc->p", normal[:, 0], normal[:, 1]) > 0)
        length.append(np.square(places[:, a] - places[:, b]).sum(axis=1))
    second = good[1] & (~good[0] | (length[1] < length[0]))
    return np.concatenate([_of(polygons[~second], halves[0]), _of(polygons[second], halves[1])])


def _ears(places: np.ndarray) -> np.ndarray:
    """Triangles (k - 2, 3) of one polygon's corners (k, 3), cut off one by one: a corner that turns
    as the polygon does, and has no other corner in its triangle."""
    ahead = np.roll(places, -1, axis=0)
    normal = np.cross(places - places[0], ahead - places[0]).sum(axis=0)
    axis = int(np.abs(normal).argmax())
    flat = np.delete(places, axis, axis=1)
    turn = 1.0 if (normal[axis] > 0) == (axis != 1) else -1.0
    left, found, i, tried = list(range(len(flat))), [], 0, 0
    while len(left) > 3:
        a, b, c = (left[(i + j) % len(left)] for j in (-1, 0, 1))
        others = flat[[k for k in left if k not in (a, b, c)]]
        sides = [_side(flat[p], flat[q], others) * turn for p, q in ((a, b), (b, c), (c, a))]
        apart = (others[:, None] != flat[[a, b, c]]).any(axis=2).all(axis=1)
        covered = (np.min(sides, axis=0) >= 0) & apart
        ear = _side(flat[a], flat[b], flat[c]) * turn > 0 and not covered.any()
        if ear or tried >= len(left):  # a polygon that crosses itself has none
            found.append((a, b, c))
            del left[i % len(left)]
            tried = 0
        else:
            i, tried = i + 1, tried + 1
        i %= len(left)
    return np.array([*found, tuple(left)])


def _side(a: np.ndarray, b: np.ndarray, p: np.ndarray) -> np.ndarray:
    """Twice the area of the triangle of a, b and each p, > 0 counterclockwise."""
    return (b[0] - a[0]) * (p[..., 1] - a[1]) - (b[1] - a[1]) * (p[..., 0] - a[0])


def ghost_flags(arrays: dict[str, np.ndarray], n: int) -> np.ndarray | None:
    """Take the ghost flags (n,) uint8 out of the arrays; None if none is set."""
    flags = np.zeros(n, np.uint8)
    for name in GHOSTS:
        found = arrays.pop(name, None)
        if found is not None and found.shape == (n,):
            levels = found > 0  # of older files: levels of pieces around, not flags
            flags |= found.astype(np.uint8) if name == GHOSTS[0] else levels.astype(np.uint8)
    return flags if flags.any() else None
