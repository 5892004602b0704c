"""XDMF 2 and 3: XML that says which arrays of HDF5 files beside it are positions and attributes.

Numbers may be in the XML itself, or in HDF5 files below the XDMF file's folder. A temporal
collection of grids has one frame a grid.
"""

from __future__ import annotations

import math
import os
from typing import Any

import numpy as np

from .asciinum import parse_numbers
from .contents import Contents, frame_index
from .errors import bad, shown
from .fields import particles_from
from .hdf5 import read_arrays
from .size import check_size, whole_file
from .vtk_parts import below
from .xml import parse_xml

_MOST_ARRAYS = 1000


def read(path: str | os.PathLike[str], frame: int = 0) -> Contents:
    """Read the points and node-centered attributes of a grid. Raises FormatError."""
    data = whole_file(path, 20.0)
    root = parse_xml(path, data)
    if root.tag != "Xdmf":
        raise bad(path, f"<{root.tag[:40]}>", "expected <Xdmf>")
    temporal = [g for g in root.iter("Grid") if g.get("CollectionType", "").lower() == "temporal"]
    if temporal:
        grids = temporal[0].findall("Grid")
    else:
        grids = [g for g in root.iter("Grid") if g.find("Geometry") is not None][:1]
    if not grids:
        raise bad(path, "<Xdmf>", "expected a <Grid> with a <Geometry>, got none")
    grid = grids[frame_index(path, frame, len(grids))]
    geometry = grid.find("Geometry")
    if geometry is None:
        raise bad(path, "<Grid>", "expected <Geometry>, got none")
    kind = geometry.get("GeometryType", geometry.get("Type", "XYZ")).upper()
    if kind not in ("XYZ", "XY", "X_Y_Z", "X_Y"):
        raise bad(path, "<Geometry>", f"expected GeometryType XYZ or X_Y_Z, got {shown(kind)}")
    items = {"positions": geometry.findall("DataItem")}
    for element in grid.findall("Attribute")[:_MOST_ARRAYS]:
        name = element.get("Name", "")
        if element.get("Center", "Node").lower() == "node" and name and name not in items:
            items[name] = element.findall("DataItem")[:1]
    found = _arrays(path, items, len(data))
    parts = found.pop("positions")
    if "_" in kind:
        if len(parts) != len(kind) // 2 + 1 or len({p.size for p in parts}) != 1:
            raise bad(path, "<Geometry>", f"expected {kind} arrays of one length")
        positions = np.stack([p.reshape(-1) for p in parts], axis=1)
    else:
        positions = parts[0].reshape(-1, len(kind)) if parts[0].size % len(kind) == 0 else parts[0]
    if positions.ndim != 2 or positions.shape[1] not in (2, 3):
        raise bad(path, "<Geometry>", f"expected shape (N, 3), got {positions.shape}")
    positions = np.pad(positions, ((0, 0), (0, 3 - positions.shape[1])))
    arrays = {name: parts[0] for name, parts in found.items() if len(parts[0]) == len(positions)}
    arrays = {k: a.reshape(len(a), -1) if a.ndim > 2 and a.size else a for k, a in arrays.items()}
    time = grid.find("Time")
    particles = particles_from(path, positions, arrays)
    return Contents(particles, time=_time(time), n_frames=len(grids))


def _time(element: Any) -> float | None:
    try:
        value = float(element.get("Value", ""))
    except (AttributeError, ValueError):
        return None
    return value if math.isfinite(value) else None


def _arrays(path: Any, items: dict[str, list[Any]], held: int) -> dict[str, list[np.ndarray]]:
    """The arrays of <DataItem> elements: those of each HDF5 file are read together."""
    found: dict[str, list[Any]] = {}
    files: dict[str, dict[str, str]] = {}
    for name, elements in items.items():
        if not elements:
            raise bad(path, name[:40], "expected a <DataItem>, got none")
        found[name] = [None] * len(elements)
        for i, element in enumerate(elements):
            text, how = (element.text or "").strip(), element.get("Format", "XML").upper()
            if how == "XML":
                found[name][i] = _numbers(path, name, element, text, held)
            elif how == "HDF" and ":" in text:
                file, _, place = text.rpartition(":")
                files.setdefault(below(path, file), {})[f"{name}\n{i}"] = place
            else:
                raise bad(path, name[:40], f"expected a DataItem with HDF or XML, got {shown(how)}")
    for file, places in files.items():
        for key, array in read_arrays(file, places).items():
            name, _, number = key.rpartition("\n")
            found[name][int(number)] = array if array.ndim else array.reshape(1)
    return found


def _numbers(path: Any, name: str, element: Any, text: str, held: int) -> np.ndarray:
    words = element.get("Dimensions", "").split()
    if not words or not all(w.isascii() and w.isdigit() and len(w) < 16 for w in words):
        raise bad(path, name[:40], f"expected Dimensions, got {shown(' '.join(words))}")
    shape = tuple(map(int, words))
    check_size(path, name[:40], 8.0 * math.prod(shape), held)
    try:
        values = parse_numbers(text.encode(), np.dtype(np.float64))
    except ValueError:
        values = np.empty(0)
    if len(values) != math.prod(shape):
        problem = f"expected {math.prod(shape)} numbers, got {len(values)}"
        raise bad(path, name[:40], problem)
    return values.reshape(shape)
