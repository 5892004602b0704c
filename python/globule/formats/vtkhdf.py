"""The cells of VTKHDF files as triangles: PolyData and UnstructuredGrid, in parts, over time, and
collections of such ("VTKHDF File Format", Kitware)."""

from __future__ import annotations

import os
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

from ..data.particles import Particles
from . import cells, hdf5
from .contents import frame_index
from .errors import faults
from .hdf5_layouts import frame_entry, vtkhdf_block, vtkhdf_parts, vtkhdf_roots
from .hdf5_tree import Layout, Source, Tree

_GLANCE = 1 << 20  # bytes in which the group's name stands
_LISTS = {"Vertices": cells.VERTICES, "Lines": cells.LINES, "Polygons": cells.POLYGONS, "Strips": cells.STRIPS}


class _Part(NamedTuple):
    """Cells of a part of a frame: their type, None where each has its own; what to read; the part's points."""

    kind: int | None
    sources: dict[str, Source]
    first_point: int
    n_points: int


def has_faces(path: str | os.PathLike[str]) -> bool:
    """Whether a frame has cells with faces. Raises FormatError."""
    with open(path, "rb") as file:
        if b"VTKHDF" not in file.read(_GLANCE):
            return False
    parts, arrays = _read(path, ("Types",))
    return any(
        cells.have_faces(arrays[f"{k}Types"] if part.kind is None else np.array([part.kind]))
        for k, part in enumerate(parts)
        if part.sources["Connectivity"].n
    )


def read_triangles(path: str | os.PathLike[str]) -> tuple[Particles, np.ndarray]:
    """Read the points of a frame, and the faces of its cells as triangles (F, 3). Raises FormatError."""
    particles = hdf5.read(path, getattr(path, "frame", 0)).particles
    parts, arrays = _read(path, ("Types", "Offsets", "Connectivity"))
    with faults(path, "/VTKHDF"):
        whole = cells.joined(_cells(part, arrays, str(k)) for k, part in enumerate(parts))
        return particles, cells.triangles(np.asarray(particles.positions), whole, {}, {})


def _cells(part: _Part, arrays: dict[str, np.ndarray], k: str) -> cells.Cells:
    """The cells of part k, of the frame's points. Raises ValueError for those that are damaged."""
    offsets, corners = (arrays[k + name].astype(np.int64) for name in ("Offsets", "Connectivity"))
    types = arrays[f"{k}Types"] if part.kind is None else np.full(len(offsets) - 1, part.kind)
    if (types == cells.POLYHEDRON).any():
        raise ValueError("expected cells other than polyhedra")
    own = cells.Cells(types.astype(np.uint8), corners, offsets)
    if problem := own.problem(part.n_points):
        raise ValueError(problem)
    return own._replace(connectivity=corners + part.first_point)


def _read(path: Any, names: tuple[str, ...]) -> tuple[list[_Part], dict[str, np.ndarray]]:
    """The parts of a frame, and of part k the arrays `k` + name."""
    parts: list[_Part] = []

    def layout(tree: Tree) -> Layout:
        parts.extend(_parts(tree, getattr(path, "frame", 0)) if "/VTKHDF" in tree else ())
        wanted = {f"{k}{n}": [s] for k, part in enumerate(parts) for n, s in part.sources.items() if n in names}
        return Layout(wanted)

    return parts, hdf5.read_layout(path, layout)[1]


def _parts(tree: Tree, frame: int) -> Iterator[_Part]:
    """The parts of a frame, of one data set or of all blocks."""
    point = 0
    roots = vtkhdf_roots(tree)
    n_frames = [max(tree.rows(f"{root}/Steps/Values"), 1) for root in roots]
    i = frame_index(tree.path, frame, max(n_frames))
    for root, n in zip(roots, n_frames, strict=True):
        for part in _parts_of_block(tree, root, min(i, n - 1)):
            yield part._replace(first_point=part.first_point + point)
        point += vtkhdf_block(tree, root, min(i, n - 1))["positions"][0].n


def _parts_of_block(tree: Tree, root: str, i: int) -> Iterator[_Part]:
    def table(place: str, default: list | None = None) -> list | None:
        values = tree.get(f"{root}/{place}", {}).get("values", default)
        return values if values is None or isinstance(values, list) else [values]

    counts = table("NumberOfPoints") or [tree.rows(f"{root}/Points")]
    first, last = vtkhdf_parts(tree, i, len(counts), root)
    solid = tree.attributes(root).get("Type") == "UnstructuredGrid"
    for column, (name, kind) in enumerate({"": None}.items() if solid else _LISTS.items()):
        group = f"{root}/{name}".rstrip("/")
        if not tree.is_data(f"{group}/Connectivity"):
            continue
        n_cells, n_ids = (table(f"{name}/{n}".lstrip("/"), []) for n in ("NumberOfCells", "NumberOfConnectivityIds"))
        begins = []
        for steps, sizes in (("CellOffsets", n_cells), ("ConnectivityIdOffsets", n_ids)):
            before = sum(frame_entry(tree, sizes, p, 0) for p in range(first))
            begins.append(frame_entry(tree, table(f"Steps/{steps}"), i, before, column))
        cell, corner = begins
        point = 0
        for p in range(first, last):
            n, k = frame_entry(tree, n_cells, p, 0), frame_entry(tree, n_ids, p, 0)
            rows = {"Types": (cell, n), "Offsets": (cell + p, n + 1), "Connectivity": (corner, k)}
            if kind is not None:
                del rows["Types"]
            sources = {}
            for array, (begin, size) in rows.items():
                place = f"{group}/{array}"
                if begin < 0 or size < 0 or begin + size > tree.rows(place):
                    raise tree.bad(place, f"expected at least {begin + size} rows, got {tree.rows(place)}")
                sources[array] = Source(place, begin, size)
            own = frame_entry(tree, counts, p, 0)
            yield _Part(kind, sources, point, own)
            cell, corner, point = cell + n, corner + k, point + own
