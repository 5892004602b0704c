"""What lies where in the HDF5 files of simulation programs.

Each layout is a function of the file's tree that returns a Layout, or None for another program's
file.
"""

from __future__ import annotations

import contextlib
import math
import re
import warnings
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from .contents import Box
from .errors import FormatError, shown
from .hdf5_tree import NAMES, Layout, Source, Tree

PickFrame = Callable[[int], int]  # number of frames -> index of the one wanted

# Words in the names of groups that are frames, beside their number.
_STEPS = {"frame", "frames", "step", "steps", "timestep", "t", "time", "it", "iter", "iteration", "snapshot", "snap",
          "state", "dump", "output", "cycle"}  # fmt: skip
_H5MD_NAMES = {"position": "positions", "species": "type"}
# Smoothing lengths by SWIFT are those of Dehnen & Aly 2012; the kernel ends at this many of them.
_SWIFT_GAMMA = 1.825742  # cubic spline, the default of SWIFT
_MOST_COLUMNS = 1000
_VTKHDF = ("PolyData", "UnstructuredGrid")  # types of its data sets that are read


def gadget(tree: Tree, species: str | None, _: PickFrame) -> Layout | None:
    """Gadget-2/3/4, AREPO, GIZMO and SWIFT: /Header and /PartType0 … /PartType9.

    Gadget's, AREPO's and GIZMO's smoothing length is where the kernel ends (Springel 2005, eq. 4);
    SWIFT's times "Kernel gamma" is.
    """
    groups = [k for k in tree.children("") if k.startswith("PartType")]
    if "/Header" not in tree or not groups:
        return None
    filled = [k for k in groups if tree.rows(f"/{k}/Coordinates") > 0]
    chosen = _one_of(tree, species, groups, filled or groups)
    header = tree.attributes("/Header")
    arrays = tree.arrays(f"/{chosen}")
    if not arrays:
        raise tree.bad(f"/{chosen}", "expected a data set Coordinates (N, 3), got none")
    swift = tree.attributes("/HydroScheme")
    is_swift = bool(swift) or "SWIFT" in str(tree.attributes("/Code").get("Code", ""))
    gamma = _number(swift.get("Kernel gamma"), _SWIFT_GAMMA) if is_swift else 1.0
    sizes = header.get("BoxSize", 0.0)
    periodic = (
        _number(header.get("Periodic", tree.attributes("/Parameters").get("PeriodicBoundariesOn")))
        if not is_swift
        else _number(tree.attributes("/Parameters").get("InitialConditions:periodic"), 1.0)
    )
    units = {}
    for name, sources in arrays.items():
        about = tree.attributes(sources[0].place)
        unit = about.get("Expression for physical CGS units", about.get("Description", ""))
        units[name] = unit if isinstance(unit, str) and "Expression for" in str(about) else ""
    box = _box(np.zeros(3), sizes, [periodic != 0] * 3)
    time = _time(header.get("Time"))
    kind = chosen.removeprefix("PartType")
    table = header.get("MassTable")
    constants = {}
    if "mass" not in arrays and isinstance(table, list) and kind.isdigit():
        mass = _number(table[int(kind)]) if int(kind) < len(table) else 0.0
        constants = {"mass": mass} if mass > 0 else {}  # 0: the masses differ
    n_files = _number(header.get("NumFilesPerSnapshot"), 1.0)
    if n_files > 1:
        message = f"{tree.path}: one of {n_files:.0f} files of this snapshot; it is read alone"
        warnings.warn(message, stacklevel=2)
    return Layout(arrays, box, units, time, species=tuple(groups), support_per_h=gamma,
                  constants=constants)  # fmt: skip


def h5part(tree: Tree, _: str | None, pick: PickFrame) -> Layout | None:
    """H5Part: /Step#0 … with x, y, z, one value a particle."""
    steps = [k for k in tree.children("") if k.startswith("Step#") and k[5:].isdigit()]
    if not steps:
        return None
    steps.sort(key=lambda k: int(k[5:]))
    group = "/" + steps[pick(len(steps))]
    arrays = tree.arrays(group)
    if not arrays:
        raise tree.bad(group, "expected data sets x, y and z, got none")
    about = tree.attributes(group)
    time = next((about[k] for k in ("TimeValue", "Time", "time") if k in about), None)
    return Layout(arrays, time=_time(time), n_frames=len(steps))


def pysph(tree: Tree, species: str | None, _: PickFrame) -> Layout | None:
    """PySPH: /particles/NAME/arrays and /solver_data; the support is 2 h."""
    groups = [k for k in tree.children("/particles") if f"/particles/{k}/arrays" in tree]
    if not groups:
        return None
    chosen = _one_of(tree, species, groups, sorted(groups, key=lambda k: k != "fluid"))
    arrays = tree.arrays(f"/particles/{chosen}/arrays")
    if not arrays:
        raise tree.bad(f"/particles/{chosen}/arrays", "expected data sets x, y and z, got none")
    time = _time(tree.attributes("/solver_data").get("t"))
    return Layout(arrays, time=time, species=tuple(groups))


def openpmd(tree: Tree, species: str | None, pick: PickFrame) -> Layout | None:
    """openPMD 1: /data/N/particles/SPECIES with records of components; all become SI units."""
    if "openPMD" not in tree.attributes(""):
        return None
    iterations = [k for k in tree.children("/data") if k.isdigit()]
    if not iterations:
        raise tree.bad("/data", "expected iterations, got none")
    iterations.sort(key=int)
    base = "/data/" + iterations[pick(len(iterations))]
    folder = base + "/" + str(tree.attributes("").get("particlesPath", "particles/")).strip("/")
    groups = [k for k in tree.children(folder) if f"{folder}/{k}/position" in tree]
    if not groups:
        raise tree.bad(folder, "expected particles with a position, got none")
    group = f"{folder}/{_one_of(tree, species, groups, groups)}"
    found: dict[str, list[Source]] = {}
    first = next((p for p in tree.children(f"{group}/position")), "")
    n = _openpmd_rows(tree, f"{group}/position/{first}")
    for record in tree.children(group):
        place = f"{group}/{record}"
        names = [f"{place}/{c}" for c in sorted(tree.children(place))]  # as made: in any order
        parts = [place] if tree.is_data(place) else names
        if all(tree.rows(p) == n for p in parts) and parts:
            found[record] = [Source(p, 0, n, _number(tree.attributes(p).get("unitSI"), 1.0)) for p in parts]
    arrays: dict[str, list[Source]] = {"positions": []}
    found.pop("position", None)
    found.pop("positionOffset", None)
    constants, axes, moving = [0.0, 0.0, 0.0], [], []
    for axis, name in enumerate("xyz"):
        place, offset = f"{group}/position/{name}", f"{group}/positionOffset/{name}"
        if place not in tree:  # of a plane
            continue
        if _openpmd_rows(tree, place) != n:
            raise tree.bad(f"{group}/position", "expected components x, y and z of one length")
        constants[axis] = _openpmd_constant(tree, offset) or 0.0
        if tree.is_data(place):
            unit = _number(tree.attributes(place).get("unitSI"), 1.0)
            arrays["positions"].append(Source(place, 0, n, unit))
            axes.append(axis)
        else:
            constants[axis] += _openpmd_constant(tree, place) or 0.0
        if tree.rows(offset) == n:
            unit = _number(tree.attributes(offset).get("unitSI"), 1.0)
            arrays.setdefault("offset", []).append(Source(offset, 0, n, unit))
            moving.append(axis)
    if len(axes) < 1 or n < 0:
        raise tree.bad(f"{group}/position", "expected components x, y and z of one length")
    arrays |= _lower(found)
    about = tree.attributes(base)
    time = _number(about.get("time"), math.nan) * _number(about.get("timeUnitSI"), 1.0)
    units = {"positions": "m"} | {name: "SI" for name in arrays if name not in ("positions", "id")}
    return Layout(arrays, None, units, _time(time), len(iterations), tuple(groups),
                  axes=(tuple(axes), tuple(moving)), shift=tuple(constants))  # fmt: skip


def h5md(tree: Tree, species: str | None, pick: PickFrame) -> Layout | None:
    """H5MD 1: /particles/GROUP with elements, of frames (T, N, …) in `value`, or fixed (N, …)."""
    groups = [k for k in tree.children("/particles") if "/h5md" in tree]
    groups = [k for k in groups if f"/particles/{k}/position" in tree]
    if not groups:
        return None
    group = f"/particles/{_one_of(tree, species, groups, groups)}"
    moving = tree.is_data(f"{group}/position/value")
    place = f"{group}/position" + "/value" * moving
    shape = tree.get(place, {}).get("shape", [])
    if len(shape) != 2 + moving:
        expected = "(T, N, D)" if moving else "(N, D)"
        raise tree.bad(place, f"expected shape {expected}, got {tuple(shape)}")
    n_frames = shape[0] if moving else 1
    frame, n = pick(n_frames), shape[moving]
    arrays = {}
    for name in tree.children(group):
        fixed, values = f"{group}/{name}", f"{group}/{name}/value"
        key = _H5MD_NAMES.get(name, name)
        if tree.rows(fixed) == n:
            arrays[key] = [Source(fixed, 0, n)]
        elif tree.is_data(values) and tree[values]["shape"][:2] == [n_frames, n]:
            arrays[key] = [Source(values, 0, n, frame=frame)]
    times = tree.get(f"{group}/position/time", {}).get("values")
    time = _time(times[frame]) if isinstance(times, list) and len(times) == n_frames else None
    about = {"positions": tree.attributes(place).get("unit", "")}
    return Layout(arrays, _h5md_box(tree, f"{group}/box", frame, n_frames), about, time, n_frames,
                  tuple(groups))  # fmt: skip


def _h5md_box(tree: Tree, place: str, frame: int, n_frames: int) -> Box | None:
    boundary = tree.attributes(place).get("boundary", [])
    boundary = [boundary] if isinstance(boundary, str) else boundary
    edges = tree.get(f"{place}/edges", {}).get("values")
    moving = tree.get(f"{place}/edges/value", {}).get("values")
    if isinstance(moving, list) and len(moving) == n_frames:
        edges = moving[frame]
    sizes = np.asarray(edges if edges is not None else np.nan, np.float64)
    sizes = sizes * np.eye(3) if sizes.shape == (3,) else sizes
    if sizes.shape != (3, 3) or not np.isfinite(sizes).all() or len(boundary) != 3:
        return None
    x, y, z = (word == "periodic" for word in boundary)
    offset = tree.get(f"{place}/offset", {}).get("values", [0.0, 0.0, 0.0])
    origin = np.asarray(offset, np.float64)
    return Box(origin if origin.shape == (3,) else np.zeros(3), sizes, (x, y, z))


def vtkhdf(tree: Tree, _: str | None, pick: PickFrame) -> Layout | None:
    """VTKHDF: PolyData or UnstructuredGrid, in pieces, over time, and collections of such ("VTKHDF
    File Format")."""
    if "/VTKHDF" not in tree:
        return None
    roots = vtkhdf_roots(tree, True)
    times = [_values({k: tree[f"{r}/Steps/{k}"] for k in tree.children(f"{r}/Steps")}, "Values") for r in roots]
    n_frames = max(max(len(values or [0.0]) for values in times), 1)
    i = pick(n_frames)
    time = next((values[i] for values in times if values and len(values) == n_frames), None)
    first, *others = (
        vtkhdf_block(tree, root, min(i, len(v or [0.0]) - 1)) for root, v in zip(roots, times, strict=True)
    )
    return Layout(first, time=_time(time), n_frames=n_frames, blocks=tuple(others))


def vtkhdf_block(tree: Tree, root: str, frame: int) -> dict[str, list[Source]]:
    """What to read of the data set of VTKHDF in a group."""
    points = tree.source(f"{root}/Points")
    counts = tree.get(f"{root}/NumberOfPoints", {}).get("values", [points.n])
    data = {
        name: tree.source(f"{root}/PointData/{name}")
        for name in tree.children(f"{root}/PointData")
        if tree.rows(f"{root}/PointData/{name}") >= 0
    }
    if lost := [name for name in tree.children(f"{root}/CellData") if name not in (*data, "vtkGhostType")]:
        warnings.warn(f"{tree.path}: values of cells are left out: {', '.join(lost)[:200]}", stacklevel=2)
    first, n = 0, sum(counts)
    begins = dict.fromkeys(data, 0)
    if f"{root}/Steps" in tree:
        steps = {k: tree[f"{root}/Steps/{k}"] for k in tree.children(f"{root}/Steps")}
        part, end = vtkhdf_parts(tree, frame, len(counts), root)
        first = frame_entry(tree, _values(steps, "PointOffsets"), frame, sum(counts[:part]))
        n = sum(counts[part:end])
        for name in data:
            offsets = tree.get(f"{root}/Steps/PointDataOffsets/{name}", {}).get("values")
            begins[name] = frame_entry(tree, offsets, frame, first)
    for name, begin in (("Points", first), *begins.items()):
        rows = points.n if name == "Points" else data[name].n
        if begin < 0 or n < 0 or begin + n > rows:
            problem = f"expected at least {begin + n} rows, got {rows}"
            raise tree.bad(f"{root}/{name}", problem)
    arrays = {"positions": [Source(points.place, first, n)]}
    return arrays | {k: [Source(s.place, begins[k], n)] for k, s in data.items() if k != "positions"}


def vtkhdf_roots(tree: Tree, warn: bool = False) -> list[str]:
    """The groups of a VTKHDF file that are data sets with points: its own, or the blocks of a
    collection in their order. Where some blocks are meshes and others particles, the meshes are left
    out, and so are grids; with a warning if `warn`. Raises FormatError for others.
    """
    kind = tree.attributes("/VTKHDF").get("Type", "")
    if kind in _VTKHDF:
        return ["/VTKHDF"]
    if kind not in ("PartitionedDataSetCollection", "MultiBlockDataSet"):
        problem = f"expected Type {' or '.join(_VTKHDF)} or a collection, got {shown(str(kind))}"
        raise tree.bad("/VTKHDF", problem)
    places = [f"/VTKHDF/{name}" for name in tree.children("/VTKHDF") if name != "Assembly"]
    blocks = {place: tree.attributes(place).get("Type") for place in places if not tree.is_data(place)}
    found = [place for place, kind in blocks.items() if kind in _VTKHDF and tree.is_data(f"{place}/Points")]
    if not found:
        raise tree.bad("/VTKHDF", f"expected a block of Type {' or '.join(_VTKHDF)}, got none")
    found.sort(key=lambda place: _number(tree.attributes(place).get("Index")))
    filled = [place for place in found if tree.rows(f"{place}/Points") > 0]
    meshes = [place for place in filled if _is_vtkhdf_mesh(tree, place)]
    if len(meshes) == len(filled):
        meshes = []  # all of them: they are drawn
    lost = [*meshes, *(place for place, kind in blocks.items() if kind and kind not in _VTKHDF)]
    if lost and warn:
        names = ", ".join(place.removeprefix("/VTKHDF/") for place in lost)
        warnings.warn(f"{tree.path}: blocks that are no particles are left out: {names[:200]}", stacklevel=2)
    return [place for place in found if place not in meshes]


def _is_vtkhdf_mesh(tree: Tree, place: str) -> bool:
    """Whether a data set of VTKHDF has cells of more than one point."""
    if tree.attributes(place).get("Type") == "PolyData":
        return any(tree.rows(f"{place}/{name}/Connectivity") > 0 for name in ("Polygons", "Strips"))
    return tree.rows(f"{place}/Connectivity") > max(tree.rows(f"{place}/Types"), 0)


def vtkhdf_parts(tree: Tree, frame: int, n_parts: int, root: str = "/VTKHDF") -> tuple[int, int]:
    """The first part of a frame and the one behind its last; all where there are no frames."""
    if f"{root}/Steps" not in tree:
        return 0, n_parts
    steps = {name: tree.get(f"{root}/Steps/{name}", {}) for name in ("PartOffsets", "NumberOfParts")}
    first = frame_entry(tree, _values(steps, "PartOffsets"), frame, frame)
    return first, first + frame_entry(tree, _values(steps, "NumberOfParts"), frame, 1)


def plain(tree: Tree, species: str | None, pick: PickFrame) -> Layout | None:
    """Data sets named positions, Coordinates or x, y, z, at the root or in a group. Groups such as
    frame_0, frame_1 are frames, and so are positions (F, N, 3); others are species."""
    groups = [g for g in tree if not tree.is_data(g)]
    if species is not None:
        groups = ["/" + species.strip("/")]
    found: dict[str, dict[str, list[Source]]] = {}
    for group in groups:
        try:
            if arrays := tree.arrays(group):
                found[group] = arrays
        except FormatError:
            if not found:
                raise
    if not found:
        return None
    filled = [g for g, arrays in found.items() if tree.rows(arrays["positions"][0].place) > 0]
    stems = {re.sub(r"\d+", "0", g) for g in found}
    numbered = [part for part in next(iter(stems)).lower().split("/") if "0" in part]
    if len(found) > 1 and len(stems) == 1 and {*re.findall("[a-z]+", " ".join(numbered))} <= _STEPS:
        frames = sorted(found, key=lambda g: [int(k) for k in re.findall(r"\d+", g)])
        chosen = frames[pick(len(frames))]
        about = [tree.attributes(place).get("time") for place in (chosen, "")]
        return Layout(found[chosen], time=_time(next((t for t in about if t is not None), None)), n_frames=len(frames))
    chosen = (filled or list(found))[0]  # a run may begin without particles
    names = tuple(g.strip("/") for g in found) if len(found) > 1 and "" not in found else ()
    arrays, n_frames, time = _of_frame(tree, chosen, found[chosen], pick)
    return Layout(arrays, time=_time(tree.attributes("").get("time", time)), n_frames=n_frames, species=names)


def _of_frame(
    tree: Tree, group: str, arrays: dict[str, list[Source]], pick: PickFrame
) -> tuple[dict[str, list[Source]], int, float | None]:
    """One frame of positions (F, N, 3) and of what has such axes, with what has one axis of N, the
    number of frames, and its time; the arrays as they are where positions have no frames."""
    first = arrays["positions"][0]
    shape = tree[first.place]["shape"]
    if len(arrays["positions"]) > 1 or len(shape) != 3 or shape[2] not in (2, 3) or shape[1] < 4:  # or (N, 3, F)
        return arrays, 1, None
    (n_frames, n), k = shape[:2], pick(shape[0])
    found = {"positions": [Source(first.place, 0, n, frame=k)]}
    time = None
    for name in tree.children(group):
        place = f"{group}/{name}"
        one = tree.get(place, {}).get("shape", [])
        key = NAMES.get(name.lower(), name)
        if place == first.place or not one or len(one) > 3:
            continue
        if one[:2] == [n_frames, n]:
            found[key] = [Source(place, 0, n, frame=k)]
        elif one == [n_frames] and name.lower() in ("t", "time", "times"):
            values = tree[place].get("values")
            time = _time(values[k]) if isinstance(values, list) and len(values) == n_frames else None
        elif one[0] == n and n != n_frames:
            found[key] = [Source(place, 0, n)]
    return found, n_frames, time


def named(tree: Tree, columns: Mapping[str, str]) -> Layout:
    """The data sets that a caller names: field -> place."""
    places = {name: "/" + str(place).strip("/") for name, place in columns.items()}
    found = {name: [tree.source(place)] for name, place in places.items()}
    if {"x", "y"} <= found.keys():
        found["positions"] = [found.pop(c)[0] for c in "xyz" if c in found]
    if "positions" not in found:
        raise ValueError("columns: expected positions, or x, y and z; "
                         f"got {', '.join(map(repr, columns))}")  # fmt: skip
    return Layout(found)


LAYOUTS = (gadget, vtkhdf, openpmd, h5md, pysph, h5part, plain)


def _one_of(tree: Tree, wanted: str | None, groups: list[str], default: list[str]) -> str:
    if wanted is None:
        return default[0]
    if wanted not in groups:
        names = ", ".join(groups)
        raise ValueError(f"species: expected one of {names} for {tree.path}, got {wanted!r}")
    return wanted


def _number(value: Any, default: float = 0.0) -> float:
    try:
        return float(value)
    except (TypeError, ValueError, OverflowError):
        return default


def _time(value: Any) -> float | None:
    time = _number(value, math.nan)
    return time if math.isfinite(time) else None


def _box(origin: Any, sizes: Any, periodic: Any) -> Box | None:
    with contextlib.suppress(TypeError, ValueError):  # a box that is none is left out
        box = Box.of_sizes(origin, sizes, periodic)
        return box if (np.diag(box.edges) > 0).all() else None
    return None


def _values(steps: dict[str, dict], name: str) -> list | None:
    return steps.get(name, {}).get("values")


def frame_entry(tree: Tree, values: Any, i: int, default: int, column: int = 0) -> int:
    """Entry i of a table of frames or parts; a column of it where there are several. Raises FormatError."""
    if values is None:
        return default
    if i >= len(values):
        raise tree.bad("/VTKHDF/Steps", f"expected {i + 1} entries, got {len(values)}")
    value = values[i]
    while isinstance(value, list) and value:
        value = value[min(column, len(value) - 1)]
    return int(_number(value, -1))


def _openpmd_rows(tree: Tree, place: str) -> int:
    if tree.is_data(place):
        return tree.rows(place)
    shape = tree.attributes(place).get("shape")
    return int(_number(shape[0] if isinstance(shape, list) and shape else shape, -1))


def _openpmd_constant(tree: Tree, place: str) -> float | None:
    about = tree.attributes(place)
    if tree.is_data(place) or "value" not in about:
        return None
    return _number(about["value"]) * _number(about.get("unitSI"), 1.0)


def _lower(found: dict[str, list[Source]]) -> dict[str, list[Source]]:
    return {NAMES.get(k.lower(), k): s for k, s in found.items() if len(s) < _MOST_COLUMNS}
