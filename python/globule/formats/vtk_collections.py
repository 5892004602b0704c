"""Collections of VTK XML files: .pvd (time), .pvtp and .pvtu (pieces), .vtm (blocks), and .series
(time) in JSON.

Only files below the collection's own folder are opened.
"""

from __future__ import annotations

import json
import math
import os
from collections.abc import Iterable
from typing import Any

import numpy as np

from ..data.particles import FIELDS, Particles
from .contents import Contents, frame_index
from .errors import FormatError, bad, shown
from .fields import per_particle
from .size import check_size, whole_file
from .xml import parse_xml

_MOST_FILES = 100_000
_RANKS = {"pvd": 3, "series": 3, "vtm": 2, "pvtp": 1, "pvtu": 1}  # each holds lower ones alone


def read_pvd(path: str | os.PathLike[str], frame: int = 0) -> Contents:
    """Read all parts of one time step of a ParaView collection. Raises FormatError."""
    sets = list(_root(path, "Collection").iter("DataSet"))
    times = [_time(s.get("timestep", "")) for s in sets]
    steps: dict[Any, list[str]] = {}
    for time, element in zip(times, sets, strict=True):
        steps.setdefault(time, []).append(element.get("file", ""))
    order = sorted(steps, key=lambda t: -math.inf if t is None else t)
    return _frame(path, [(t, steps[t]) for t in order], frame)


def read_series(path: str | os.PathLike[str], frame: int = 0) -> Contents:
    """Read one time step of a .vtp.series, .vtu.series and the like. Raises FormatError."""
    data = whole_file(path, 20.0)
    try:
        files = json.loads(data)["files"]
        steps = [(_time(f.get("time", "")), [str(f["name"])]) for f in files]
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError):
        raise bad(
            path, "", 'expected {"files": [{"name": …, "time": …}]}, got other JSON'
        ) from None
    return _frame(path, steps, frame)


def read_pieces(path: str | os.PathLike[str]) -> Contents:
    """Read all pieces of a .pvtp or .pvtu. Raises FormatError."""
    root = _root(path, "PPolyData", "PUnstructuredGrid")
    names = [e.get("Source", "") for e in root.iter("Piece")]
    return Contents(_joined(path, names, 1))


def read_blocks(path: str | os.PathLike[str]) -> Contents:
    """Read all blocks of a .vtm. Raises FormatError."""
    root = _root(path, "vtkMultiBlockDataSet")
    files = [e.get("file") for e in root.iter("DataSet")]  # an empty block has none
    return Contents(_joined(path, [name for name in files if name is not None], 2))


def _root(path: Any, *kinds: str) -> Any:
    root = parse_xml(path, whole_file(path, 20.0))
    kind = root.get("type", "")
    if root.tag != "VTKFile" or kind not in kinds:
        raise bad(path, "<VTKFile>", f"expected type {' or '.join(kinds)}, got {shown(kind)}")
    return root


def _time(value: Any) -> float | None:
    try:
        time = float(value)
    except (TypeError, ValueError, OverflowError):
        return None
    return time if math.isfinite(time) else None


def _frame(path: Any, steps: list[tuple[float | None, list[str]]], frame: int) -> Contents:
    if not steps:
        raise bad(path, "", "expected the name of a file, got none")
    time, names = steps[frame_index(path, frame, len(steps))]
    return Contents(_joined(path, names, 3), time=time, n_frames=len(steps))


def _joined(path: Any, names: Iterable[str], rank: int) -> Particles:
    from . import read
    from .kind import kind_or_none

    parts, held = [], 0
    names = list(names)
    if not names:
        raise bad(path, "", "expected the name of a file, got none")
    if len(names) > _MOST_FILES:
        raise bad(path, "", f"expected at most {_MOST_FILES:,} files, got {len(names):,}")
    for name in names:
        place = below(path, name)
        held += os.path.getsize(place)
        if len(names) > 1:  # all of them together, and once more when they are joined
            check_size(path, name, held, held, 2.0)
        kind = kind_or_none(place)
        if kind is None or kind.kind != "particles" or _RANKS.get(kind.format, 0) >= rank:
            raise bad(path, name, "expected a file of particles, got another one")
        try:
            parts.append(read(place))
        except FormatError as error:
            raise bad(path, "", str(error)) from None
    return join(parts)


def below(path: Any, name: str) -> str:
    """The place of a file that a collection names; it lies below the collection's folder.

    Raises FormatError.
    """
    folder = os.path.realpath(os.path.dirname(os.fspath(path)))
    place = os.path.realpath(os.path.join(folder, name)) if "\0" not in name else ""
    inside = place.startswith(os.path.join(folder, ""))
    if not name or not inside or place == os.path.realpath(path):
        raise bad(path, "", f"expected a file below the same folder, got {shown(name)}")
    if not os.path.isfile(place):
        raise bad(path, "", f"expected the file {shown(name)} beside it, got none")
    return place


def join(parts: list[Particles]) -> Particles:
    """All particles one after another, with the fields and attributes that all parts have.

    Parts without particles do not count.
    """
    filled = [part for part in parts if len(part)] or parts[:1]
    if len(filled) == 1:
        return filled[0]
    arrays = [per_particle(part) for part in filled]
    joined = {}
    for name, first in arrays[0].items():
        if all(name in a and a[name].shape[1:] == first.shape[1:] for a in arrays):
            joined[name] = np.concatenate([a[name] for a in arrays])
    positions = np.concatenate([np.asarray(part.positions) for part in filled])
    fields = {name: joined.pop(name) for name in FIELDS if name in joined}
    if "anisotropy" in fields:
        fields["anisotropy"] = fields["anisotropy"].reshape(-1, 3, 3)
    return Particles(positions, **fields, attributes=joined)
