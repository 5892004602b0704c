"""Particles of the objects of other packages, which are known by what they can do: none of them is
imported.

    VTK and PyVista     point sets: points and point data
    ASE                 Atoms: positions, arrays; covalent radii
    MDAnalysis          AtomGroup or Universe: positions, masses, radii of the current frame
    yt                  data set or container: gas ("PartType0"), else all particles; code_length
    pynbody             snapshot or family: gas where there is some
    pandas, polars, pyarrow, xarray   tables with columns x, y and z

Positions are taken as they are: none is wrapped into a box.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterable
from typing import Any

import numpy as np

from ..data.particles import Particles
from .elements import of_elements
from .fields import find_positions, join_columns, particles_from

_YT_NAMES = {"particle_mass": "mass", "density": "density", "smoothing_length": "smoothing_length",
             "particle_velocity": "velocity", "particle_index": "id"}  # fmt: skip
_PYNBODY_NAMES = {"vel": "velocity", "mass": "mass", "rho": "density", "smooth": "smoothing_length",
                  "iord": "id", "temp": "temperature"}  # fmt: skip


def particles_of(value: Any) -> Particles | None:
    """The particles of an object of another package, or None for an object of no known kind.

    Raises ValueError for an object without positions (N, 3).
    """
    for has, convert in _KINDS:
        if all(hasattr(value, name) for name in has):
            return convert(value)
    return None


def _from(value: Any, positions: Any, arrays: dict[str, Any]) -> Particles:
    name = f"{type(value).__module__.partition('.')[0]} {type(value).__name__}"
    positions = np.asarray(positions)
    if positions.ndim != 2 or positions.shape[1] not in (2, 3):
        raise ValueError(f"{name}: expected positions (N, 3), got shape {positions.shape}")
    if positions.shape[1] == 2:
        positions = np.pad(positions, ((0, 0), (0, 1)))
    return particles_from(name, positions, {k: np.asarray(a) for k, a in arrays.items()})


def _of_vtk(value: Any) -> Particles:
    points = value.GetPoints()
    if points is None:
        return _from(value, np.empty((0, 3)), {})
    data = value.GetPointData()
    found = [data.GetAbstractArray(i) for i in range(data.GetNumberOfArrays())]
    arrays = {a.GetName(): _vtk_array(a) for a in found if a.GetName()}
    known = {name: a for name, a in arrays.items() if a is not None}
    return _from(value, _vtk_array(points.GetData()), known)


def _vtk_array(array: Any) -> np.ndarray | None:
    """A copy of a VTK array by its buffer; None for one of texts."""
    n, k = array.GetNumberOfTuples(), array.GetNumberOfComponents()
    try:
        raw = memoryview(array)
    except (TypeError, ValueError, BufferError):
        return None
    values = np.array(raw).reshape(n, k)
    return values[:, 0] if k == 1 else values


def _of_ase(value: Any) -> Particles:
    arrays = {k: a for k, a in value.arrays.items() if k not in ("positions", "numbers")}
    arrays["atomic_number"] = value.get_atomic_numbers()
    arrays["mass"] = value.get_masses()
    if not {"radius", "radii"} & arrays.keys():
        arrays = of_elements(value.get_chemical_symbols()) | arrays
    if "radii" in arrays:
        arrays["radius"] = arrays.pop("radii")
    return _from(value, value.get_positions(), arrays)


def _of_mdanalysis(value: Any) -> Particles:
    atoms = value.atoms
    arrays = {}
    for theirs, ours in (("radii", "radius"), ("masses", "mass"), ("charges", "charge"),
                         ("ids", "id"), ("resids", "resid")):  # fmt: skip
        try:
            arrays[ours] = np.asarray(getattr(atoms, theirs))
        except Exception:  # its NoDataError: the topology does not say
            continue
    if "radius" not in arrays:
        with contextlib.suppress(Exception):
            arrays = of_elements([str(e) for e in atoms.elements]) | arrays
    return _from(value, atoms.positions, arrays)


def _of_yt(value: Any) -> Particles:
    data = value.all_data() if hasattr(value, "all_data") else value
    kinds = list(data.ds.particle_types_raw)
    kind = next((k for k in ("PartType0", "Gas", "gas") if k in kinds), (kinds or ["all"])[0])
    positions = np.asarray(data[kind, "particle_position"].to("code_length"))
    held = {name for k, name in data.ds.derived_field_list if k == kind}
    arrays = {}
    for theirs, ours in _YT_NAMES.items():
        if theirs not in held:
            continue
        values = data[kind, theirs]
        arrays[ours] = values.to("code_length") if ours == "smoothing_length" else values
        if ours in ("mass", "density"):
            unit = "code_mass" if ours == "mass" else "code_mass/code_length**3"
            arrays[ours] = values.to(unit)
    return _from(value, positions, {k: np.asarray(a) for k, a in arrays.items()})


def _of_pynbody(value: Any) -> Particles:
    gas = getattr(value, "gas", ())
    part: Any = gas if len(gas) else value
    arrays = {}
    known = {*part.keys(), *part.loadable_keys()}
    for theirs, ours in _PYNBODY_NAMES.items():
        if theirs in known:  # others would be computed
            arrays[ours] = np.asarray(part[theirs])
    return _from(value, np.asarray(part["pos"]), arrays)


def _of_xarray(value: Any) -> Particles:
    axes = [a for name, a in value.variables.items() if str(name).lower() in ("x", "y", "z")]
    if len({a.dims for a in axes}) > 1:
        raise ValueError("Dataset: expected x, y and z along one dimension of particles, got the "
                         "axes of a grid; gb.volumes.Volume takes a grid")  # fmt: skip
    return _of_columns(value, {str(name): value[name] for name in value.variables})


def _of_frame(value: Any) -> Particles:
    return _of_columns(value, {str(name): value[name] for name in value.columns})


def _of_arrow(value: Any) -> Particles:
    return _of_columns(value, {name: _of_list(value.column(name)) for name in value.column_names})


def _of_list(column: Any) -> Any:
    """A column of lists of k numbers as (N, k); any other as it is."""
    k = getattr(column.type, "list_size", None)
    if k is None or column.null_count:
        return column
    return np.asarray(column.combine_chunks().flatten()).reshape(-1, k)


def _of_columns(value: Any, columns: dict[str, Any]) -> Particles:
    found = {name: np.asarray(column) for name, column in columns.items()}
    found = {name: a for name, a in found.items() if a.dtype.kind in "biuf" and a.ndim}
    lower = {name.lower(): name for name in found}
    if "x" in lower and "y" in lower and "z" not in lower:
        found["z"] = np.zeros(len(found[lower["x"]]))
    arrays = join_columns({k: a for k, a in found.items() if a.ndim == 1 and len(a) == _rows(found)})
    arrays |= {k: a for k, a in found.items() if a.ndim > 1}
    positions = find_positions(arrays)
    if positions is None:
        kind = type(value).__name__
        names = ", ".join(name if name in found else f"{name} (no numbers)" for name in list(columns)[:20])
        raise ValueError(f"{kind}: expected columns x, y and z, got {names or 'none'}; "
                         "gb.Particles(table[[…]].to_numpy()) takes others")  # fmt: skip
    return _from(value, positions, arrays)


def _rows(found: dict[str, np.ndarray]) -> int:
    """The length of x, or else of the first column."""
    lower = {name.lower(): a for name, a in found.items()}
    columns: Iterable[np.ndarray] = [lower["x"]] if "x" in lower else found.values()
    return next((len(a) for a in columns), 0)


_KINDS = (
    (("GetPoints", "SetPoints", "GetPointData"), _of_vtk),
    (("get_positions", "get_chemical_symbols", "arrays"), _of_ase),
    (("atoms", "universe"), _of_mdanalysis),
    (("all_data", "domain_left_edge"), _of_yt),
    (("ds", "field_data", "get_field_parameter"), _of_yt),
    (("families", "loadable_keys", "keys"), _of_pynbody),
    (("data_vars", "coords", "variables"), _of_xarray),
    (("column_names", "column", "schema"), _of_arrow),
    (("columns", "dtypes"), _of_frame),
)
