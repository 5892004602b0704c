"""The surface as triangles, its vertices on the exact surface; enclosed volume and area."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from .._base.arrays import to_host
from .._base.checks import a_path, missing, positive, shown
from ..data.particles import FARTHEST, HERE
from ..formats.fields import say_origin
from ..formats.mesh_files import EXTENSIONS, write_mesh
from ..pieces.scene import Scene
from .sample import names_of, values_at
from .spheres import sampled_union, union_of_spheres
from .surface import BLOCK, MOST_PLACES, box_of, default_spacing, in_blocks, spheres_of, surface_scene

TOLERANCE = 1e-5  # |field - threshold| / |gradient| at a vertex, in edges of the grid
CELLS = 24  # along the edge of a block
_COARSE = 0.75  # of a support: the largest cell that tells where the surface is not
_FAR_INSIDE, _FAR_OUTSIDE = 1.4, 0.05  # of the threshold, at all corners of such a cell
_SIDE = 2**19  # blocks along an axis
_NEWTON_STEPS = 12
_BISECTIONS = 40


class SurfaceMeasure(NamedTuple):
    """The volume that a surface encloses and its area, with estimates of their errors.

    volume, volume_error  world units cubed
    area, area_error      world units squared
    """

    volume: float
    volume_error: float
    area: float
    area_error: float


@dataclass(frozen=True, eq=False)
class SurfaceMesh:
    """The triangles of a surface.

    vertices  (V, 3) float32, world
    faces     (F, 3) int32 into the vertices, counterclockwise seen from outside
    normals   (V, 3) float32, unit length, outwards: against the field's gradient
    values    name -> (V,) or (V, k) float32, blended attributes at the vertices
    spacing   edge of the grid's cells, world units
    origin    (x, y, z) float64, world, from which the vertices are given
    """

    vertices: np.ndarray
    faces: np.ndarray
    normals: np.ndarray
    values: dict[str, np.ndarray]
    spacing: float
    origin: tuple[float, float, float] = HERE

    @property
    def volume(self) -> float:
        """The volume that the triangles enclose, world units cubed."""
        a, b, c = self._corners()
        return float(np.einsum("ij,ij->", a, np.cross(b, c))) / 6

    @property
    def area(self) -> float:
        """The area of the triangles, world units squared."""
        a, b, c = self._corners()
        return float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum()) / 2

    def _corners(self) -> list[np.ndarray]:
        """The corners' places from the middle: products of large coordinates cancel."""
        if not len(self.vertices):
            return [np.empty((0, 3))] * 3
        middle = self.vertices.mean(axis=0, dtype=np.float64)
        return [self.vertices[self.faces[:, i]] - middle for i in range(3)]

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the mesh; the file appears whole or not at all.

        Args:
            path: the extension gives the format. .ply and .vtp hold vertices, normals and values,
                .obj vertices and normals, .stl triangles alone. Vertices become world coordinates,
                float64 where there is an origin; .stl, which has no such type, keeps the origin.

        Raises ValueError for another extension.
        """
        name = a_path(path)
        if not name.lower().endswith(EXTENSIONS):
            raise ValueError(f"path: expected a name ending in {' '.join(EXTENSIONS)}, got {name}")
        vertices = self.vertices
        if self.origin != HERE:
            if name.lower().endswith(".stl"):
                say_origin(name, self.origin)
            else:
                vertices = vertices + np.asarray(self.origin)
        write_mesh(name, vertices, self.faces, self.normals, self.values)


def mesh_surface(
    scene: Any,
    spacing: float | None = None,
    values: Sequence[str] | str = (),
    device: str = "auto",
    threads: int = 0,
    *,
    part: tuple[int, int] = (0, 1),
) -> SurfaceMesh:
    """The surface as triangles, by marching cubes (Lewiner et al. 2003, scikit-image).

    Each vertex is then moved along the field's gradient onto the exact surface, to
    |field - threshold| / |gradient| <= 1e-5 spacings or to the precision of float32 coordinates.
    Parts of the surface that are smaller than a cell may be missing.

    Args:
        scene: a Scene; or Particles, positions (N, 3), or the name of a file, of which a Scene
            with all defaults is made.
        spacing: edge of the cubic cells, world units; default: half the particles' spacing.
        values: names of attributes, or a single one, to blend at the vertices; see `sample`.
        device, threads: as for `Scene`, if a scene must be made.
        part: (i, n): the i-th of n parts, from 0, which have about as much work. Together they are
            the whole; vertices between two parts are in both, with the same coordinates.

    Raises ValueError for a spacing that makes too many cells, TypeError and ValueError naming the
    argument; MissingPackageError without scikit-image.
    """
    if not isinstance(scene, Scene):
        scene = surface_scene(scene, device=device, threads=threads)
    spacing = default_spacing(scene) if spacing is None else positive("spacing", spacing)
    names = names_of(scene, values)
    vertices, faces, gradient = _triangles(scene, spacing, *_checked_part(part))
    normals = -gradient
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    normals = np.divide(normals, length, out=np.zeros_like(normals), where=length > 0)
    found = values_at(scene, vertices, names)
    return SurfaceMesh(vertices, faces, normals, found, spacing, scene.origin)


def measure_surface(scene: Any, spacing: float | None = None, device: str = "auto", threads: int = 0) -> SurfaceMeasure:
    """The volume that the surface encloses, and its area.

    The mesh of `mesh_surface`, and the mesh of its triangles cut into four with the new vertices
    moved onto the surface, are wrong by a multiple of their edges' square; Richardson's
    extrapolation (1911) takes it away. The error is the sum of the magnitudes of this correction
    over all triangles, plus that of float32 coordinates. It does not cover parts of the surface
    that are smaller than a cell. Spheres of which no three have a common point are measured in
    closed form, others by points on and in each of them.

    Args:
        scene, spacing, device, threads: as for `mesh_surface`.

    Returns:
        `SurfaceMeasure`; all 0 where no field reaches the threshold.

    Raises as `mesh_surface` does.
    """
    if not isinstance(scene, Scene):
        scene = surface_scene(scene, device=device, threads=threads)
    if spacing is not None:
        spacing = positive("spacing", spacing)
    return in_closed_form(scene) or measured(scene, mesh_surface(scene, spacing))


def in_closed_form(scene: Scene) -> SurfaceMeasure | None:
    """Volume and area of spheres, in closed form where no three have a common point; None of other
    surfaces."""
    spheres = spheres_of(scene)
    if spheres is None:
        return None
    exact = union_of_spheres(*spheres)
    if exact is None:
        found = sampled_union(*spheres)
        return None if found is None else SurfaceMeasure(*found)
    rounding = float(np.finfo(np.float32).eps)
    return SurfaceMeasure(exact[0], 3 * rounding * exact[0], exact[1], 2 * rounding * exact[1])


def measured(scene: Scene, mesh: SurfaceMesh) -> SurfaceMeasure:
    """Volume and area by the mesh of a scene's surface."""
    if not len(mesh.faces):
        return SurfaceMeasure(0.0, 0.0, 0.0, 0.0)
    n = len(mesh.vertices)
    a, b, c = mesh.faces.T.astype(np.int64)
    ends = np.sort(np.stack([np.stack([a, b], 1), np.stack([b, c], 1), np.stack([c, a], 1)]), 2)
    edges, which = np.unique(ends[..., 0] * n + ends[..., 1], return_inverse=True)
    flat = (mesh.vertices[edges // n].astype(np.float64) + mesh.vertices[edges % n]) / 2
    middle, _ = _onto_surface(scene, flat.copy(), mesh.spacing, 1e-3)
    p, q, r = which.reshape(3, -1) + n  # on the edges ab, bc, ca
    finer = np.concatenate([np.stack(f, 1) for f in ((a, p, r), (p, b, q), (r, q, c), (p, q, r))])
    vertices = np.concatenate([mesh.vertices.astype(np.float64), middle])
    fine = SurfaceMesh(vertices, finer, mesh.normals, {}, mesh.spacing / 2)
    more_volume, more_area = (fine.volume - mesh.volume) / 3, (fine.area - mesh.area) / 3
    # What the pieces of each triangle add to it, in magnitude: what is round and what is hollow
    # must not cancel in the estimates.
    across = np.cross(mesh.vertices[b] - mesh.vertices[a], mesh.vertices[c] - mesh.vertices[a])
    across = across.astype(np.float64) / 2  # the triangles' areas times their normals
    risen = np.einsum("ij,ij->i", across, (middle - flat)[which.reshape(3, -1)].sum(axis=0)) / 4
    pieces = np.linalg.norm(
        np.cross(vertices[finer[:, 1]] - vertices[finer[:, 0]],
                 vertices[finer[:, 2]] - vertices[finer[:, 0]]), axis=1,
    ).reshape(4, -1).sum(axis=0) / 2  # fmt: skip
    grown = pieces - np.linalg.norm(across, axis=1)
    rounding = float(np.finfo(np.float32).eps * np.abs(mesh.vertices).max())
    return SurfaceMeasure(
        fine.volume + more_volume,
        float(np.abs(risen).sum()) / 3 + rounding * fine.area,
        fine.area + more_area,
        float(np.abs(grown).sum()) / 3 + rounding * (fine.area / mesh.spacing),
    )


def _checked_part(part: Any) -> tuple[int, int]:
    """The number of a part, and how many there are. Raises ValueError."""
    try:
        i, n = part
        if 0 <= int(i) < int(n) and (int(i), int(n)) == (i, n):
            return int(i), int(n)
    except (TypeError, ValueError):
        pass
    raise ValueError(f"part: expected (i, n) with 0 <= i < n, got {shown(part)}")


def _triangles(scene: Scene, spacing: float, part: int, n_parts: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of a part: vertices (V, 3) float32 on the surface, faces (F, 3) int32, the field's gradient
    (V, 3)."""
    try:
        from skimage.measure import marching_cubes
    except ImportError:
        raise missing("scikit-image", "measure") from None
    if not len(scene.particles.finite_positions()):
        return np.empty((0, 3), np.float32), np.empty((0, 3), np.int32), np.empty((0, 3), np.float32)
    # One cell more on each side: a surface never reaches the end of the grid.
    lo = box_of(scene)[0] - spacing
    edge = CELLS * max(1, int(np.ceil(float(np.max(to_host(scene.support))) / spacing / CELLS)))
    blocks = _blocks(scene, lo, edge * spacing)
    n_places = len(blocks) * float(edge + 1) ** 3
    if n_places > MOST_PLACES:
        enough = 1.1 * spacing * (n_places / MOST_PLACES) ** (1 / 3)
        raise ValueError(
            f"spacing: expected one that makes at most {MOST_PLACES:,} places, got {spacing:g} "
            f"for {n_places:,.0f}; try {enough:.3g}"
        )
    blocks = blocks[len(blocks) * part // n_parts : len(blocks) * (part + 1) // n_parts]
    level = np.float32(scene.threshold)
    least = np.float32(1e-3) * level
    places, faces, n = [np.empty((0, 3))], [np.empty((0, 3), np.int64)], 0
    for block, field in _fields(scene, blocks, lo, edge, spacing):
        if not (field.min() < level < field.max()):
            continue
        # No vertex at a node: each one then has an edge of the grid of its own.
        field[np.abs(field - level) < least] = level + least
        at, corners, _, _ = marching_cubes(field, level, gradient_direction="descent")
        places.append(at[:, ::-1] + (edge * block).astype(np.float64))
        faces.append(corners + n)
        n += len(at)
    at, corners = _welded(np.concatenate(places), np.concatenate(faces), edge)
    vertices, gradient = _onto_surface(scene, lo + spacing * at, spacing)
    return vertices.astype(np.float32), corners.astype(np.int32), gradient


def _blocks(scene: Scene, lo: np.ndarray, edge: float) -> np.ndarray:
    """Blocks (B, 3) int64 of a grid from `lo`, of this edge, that a support touches, sorted."""
    positions = scene.particles.positions
    positions = np.asarray(to_host(positions), np.float64)
    known = (np.abs(positions) <= FARTHEST).all(axis=1)
    reach = np.broadcast_to(np.asarray(to_host(scene.support), np.float64), len(positions))
    positions, reach = positions[known], reach[known][:, None]
    if float((positions.max(axis=0) - lo).max()) > edge * (_SIDE - 32):
        raise ValueError(
            f"spacing: expected less than {_SIDE:,} blocks along each axis, got more; "
            "try a larger one, or leave out particles that are far away"
        )
    first = np.floor((positions - reach - lo) / edge).astype(np.int64)
    last = np.floor((positions + reach - lo) / edge).astype(np.int64)
    # An edge is at least a support: at most three blocks along each axis.
    packed = np.unique(_packed(first) * 27 + (last - first) @ (9, 3, 1))
    first, span = _unpacked(packed // 27), packed % 27
    span = np.stack([span // 9, span // 3 % 3, span % 3], axis=1)
    found = [_packed(first[(step <= span).all(axis=1)] + step) for step in np.array(list(np.ndindex(3, 3, 3)))]
    return _unpacked(np.unique(np.concatenate(found)))


def _packed(places: np.ndarray) -> np.ndarray:
    """Places (M, 3), -8 to _SIDE - 16, as whole numbers (M,)."""
    x, y, z = (places + 8).T
    return (z * _SIDE + y) * _SIDE + x


def _unpacked(keys: np.ndarray) -> np.ndarray:
    return np.stack([keys % _SIDE, keys // _SIDE % _SIDE, keys // _SIDE**2], axis=1) - 8


def _fields(
    scene: Scene, blocks: np.ndarray, lo: np.ndarray, edge: int, spacing: float
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Each block with the field (edge + 1,) * 3 at its nodes, z slowest."""
    n = edge + 1
    z, y, x = np.meshgrid(*3 * [np.arange(n)], indexing="ij")
    nodes = np.stack([x, y, z], axis=-1).reshape(-1, 3)
    many = max(1, BLOCK // n**3)
    coarse = _may_skip(scene, edge, spacing)
    for begin in range(0, len(blocks), many):
        part = blocks[begin : begin + many]
        if coarse:
            fields = _near_the_surface(scene, part, lo, edge, spacing)
        else:
            places = lo + spacing * (edge * part[:, None] + nodes)
            fields = in_blocks(scene.field, places.reshape(-1, 3).astype(np.float32)).reshape(-1, n, n, n)
        yield from zip(part, fields, strict=True)


def _may_skip(scene: Scene, edge: int, spacing: float) -> bool:
    """Whether cells of twice the edge tell where the surface is not: those of a smooth surface, whose
    kernels reach farther than such a cell."""
    if scene.surface != "smooth" or edge % 2:
        return False
    return 2 * spacing <= _COARSE * float(np.min(to_host(scene.support)))


def _near_the_surface(scene: Scene, blocks: np.ndarray, lo: np.ndarray, edge: int, spacing: float) -> np.ndarray:
    """The field (B, n, n, n) of blocks, as `_fields` has it; in cells of twice the edge that are far
    inside or outside of the surface, 0 or twice the threshold."""
    level, n = np.float32(scene.threshold), edge + 1
    # Places along each axis, of each block.
    x, y, z = (lo + spacing * (edge * blocks[:, None] + np.arange(n)[:, None])).astype(np.float32).transpose(2, 0, 1)

    def ask(at: tuple[np.ndarray, ...]) -> np.ndarray:
        b, k, j, i = at
        return in_blocks(scene.field, np.stack([x[b, i], y[b, j], z[b, k]], axis=-1))

    half = edge // 2 + 1
    at = np.indices((len(blocks), half, half, half), np.int32).reshape(4, -1)
    known = ask((at[0], *(2 * at[1:]))).reshape(-1, half, half, half)
    least, most = known, known
    for axis in (1, 2, 3):
        a, b = [slice(None)] * 4, [slice(None)] * 4
        a[axis], b[axis] = slice(None, -1), slice(1, None)
        least = np.minimum(least[tuple(a)], least[tuple(b)])
        most = np.maximum(most[tuple(a)], most[tuple(b)])
    inside, outside = least >= _FAR_INSIDE * level, most <= _FAR_OUTSIDE * level
    near = ~(inside | outside)
    wanted = np.zeros((len(blocks), n, n, n), bool)
    fields = np.zeros(wanted.shape, np.float32)
    for step in np.ndindex(3, 3, 3):  # the nodes of a cell
        those = (slice(None), *(slice(k, k + edge - 1, 2) for k in step))
        wanted[those] |= near
        fields[those][inside] = 2 * level
    wanted[:, ::2, ::2, ::2] = False
    fields[:, ::2, ::2, ::2] = known
    fields[wanted] = ask(np.nonzero(wanted))
    return fields


def _welded(places: np.ndarray, faces: np.ndarray, edge: int) -> tuple[np.ndarray, np.ndarray]:
    """The vertices (V, 3), in cells, and faces without the second copies that neighboring blocks
    have of vertices on their common sides. Such a vertex lies on an edge of the grid, which has no
    other one."""
    cell = np.floor(places)
    between = places != cell
    on_side = (~between & (cell % edge == 0)).any(axis=1) & (between.sum(axis=1) == 1)
    rows = np.flatnonzero(on_side)
    axis = np.argmax(between[rows], axis=1)
    _, first, which = np.unique(np.column_stack([cell[rows], axis]), axis=0, return_index=True, return_inverse=True)
    same = np.arange(len(places))
    same[rows] = rows[first[which.reshape(-1)]]
    kept = same == np.arange(len(places))
    number = np.cumsum(kept) - 1
    return places[kept], number[same[faces]]


def _onto_surface(
    scene: Scene, points: np.ndarray, spacing: float, tolerance: float = TOLERANCE
) -> tuple[np.ndarray, np.ndarray]:
    """Points (V, 3) float64 near the surface, moved onto it along the gradient, and the gradient
    (V, 3) float32 there; the tolerance is in spacings."""
    start, level = points.copy(), scene.threshold
    left = np.arange(len(points))  # those that are not there yet
    best = np.full(len(points), np.inf)
    result, slope = points.copy(), np.zeros(points.shape, np.float32)
    for _ in range(_NEWTON_STEPS):
        if not len(left):
            break
        at = points[left].astype(np.float32)
        both = in_blocks(scene._field_and_gradient, at)
        miss, gradient = level - both[:, 0].astype(np.float64), both[:, 1:].astype(np.float64)
        steep = np.linalg.norm(gradient, axis=1)
        with np.errstate(all="ignore"):
            distance = np.abs(miss) / steep
            better = distance < best[left]
            result[left[better]], best[left[better]] = at[better], distance[better]
            slope[left[better]] = both[better, 1:]
            step = np.clip(miss / steep, -spacing / 4, spacing / 4)
            move = gradient * (step / steep)[:, None]
        move[~np.isfinite(move)] = 0.0
        points[left] += move
        strayed = np.linalg.norm(points[left] - start[left], axis=1) > spacing
        left = left[(distance > tolerance * spacing) & (steep > 0) & ~strayed]
    bad = np.flatnonzero(~(best <= 10 * tolerance * spacing))
    if len(bad):
        result[bad] = _bisected(scene, start[bad], spacing)
        slope[bad] = in_blocks(scene.gradient, result[bad].astype(np.float32))
    return result, slope


def _bisected(scene: Scene, points: np.ndarray, spacing: float) -> np.ndarray:
    """Points (V, 3) near the surface, moved onto it along the axis on which it is nearest."""
    if not len(points):
        return points
    found, nearest = points.copy(), np.full(len(points), np.inf)
    for direction in np.eye(3):
        for reach in (spacing, -spacing):
            low, high = np.zeros(len(points)), np.full(len(points), reach)
            starts_inside = _inside(scene, points)
            crosses = starts_inside != _inside(scene, points + reach * direction)
            for _ in range(_BISECTIONS):
                middle = (low + high) / 2
                same = _inside(scene, points + middle[:, None] * direction) == starts_inside
                low, high = np.where(same, middle, low), np.where(same, high, middle)
            closer = crosses & (np.abs(high) < nearest)
            nearest[closer] = np.abs(high)[closer]
            found[closer] = points[closer] + high[closer, None] * direction
    return found


def _inside(scene: Scene, points: np.ndarray) -> np.ndarray:
    return in_blocks(scene.field, points.astype(np.float32)) > scene.threshold
