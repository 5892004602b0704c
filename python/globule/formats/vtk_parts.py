"""The files that collections of VTK XML files name: .pvd (time), .pvtp, .pvtu, .pvts and .pvtr
(pieces), .vtm, .vtpc and .vtpd (blocks), and .series (time) in JSON.

Only files below the collection's own folder are opened.
"""

from __future__ import annotations

import json
import math
import os
import warnings
from typing import Any, NamedTuple

import numpy as np

from ..data.particles import FIELDS, Particles
from .contents import frame_index
from .errors import bad, shown
from .fields import per_particle
from .kind import kind_or_none
from .packed import ENDINGS
from .size import check_size, whole_file
from .xml import parse_xml

_MOST_FILES = 100_000
# Each holds lower ones alone.
_RANKS = {"pvd": 4, "series": 4, "vtm": 3, "vtpc": 3, "vtpd": 2, "pvtp": 1, "pvtu": 1, "pvts": 1, "pvtr": 1}
_PIECES = ("PPolyData", "PUnstructuredGrid", "PStructuredGrid", "PRectilinearGrid")
_BLOCKS = ("vtkMultiBlockDataSet", "vtkPartitionedDataSet", "vtkPartitionedDataSetCollection")
FORMATS = tuple(_RANKS)


class Parts(NamedTuple):
    """The files of one frame, from the names in a collection."""

    names: list[str]
    time: float | None = None
    n_frames: int = 1


def places(path: str | os.PathLike[str], form: str) -> list[str]:
    """The files of a collection of a format; of several frames, the first one or that of a
    `FrameOf`. Raises FormatError."""
    frame = getattr(path, "frame", 0)
    return checked_places(path, parts_of(path, form, frame).names, form)


def parts_of(path: Any, form: str, frame: int) -> Parts:
    """The names of one frame's files in a collection of a format. Raises FormatError."""
    if _RANKS[form] == 1:
        root = _root(path, *_PIECES)
        return Parts([e.get("Source", "") for e in root.iter("Piece")])
    if form in ("vtm", "vtpc", "vtpd"):
        root = _root(path, *_BLOCKS)
        files = [e.get("file") for e in root.iter("DataSet")]  # an empty block has none
        return Parts([name for name in files if name is not None])
    steps = _STEPS[form](path)
    if not steps:
        raise bad(path, "", "expected the name of a file, got none")
    time, names = steps[frame_index(path, frame, len(steps))]
    return Parts(names, time, len(steps))


def sizes_of(path: str, below_rank: int = 9) -> list[int]:
    """Bytes of the files that a collection names for each frame, and of those that these name; of any
    other file its own. The ending tells collections. Raises FormatError, OSError."""
    form = os.path.splitext(path)[1][1:].lower()
    rank = _RANKS.get(form, below_rank)
    if rank >= below_rank:
        return [os.path.getsize(path)]
    frames = [names for _, names in _STEPS[form](path)] if form in _STEPS else [parts_of(path, form, 0).names]
    return [sum(sum(sizes_of(below(path, name), rank)) for name in names) for names in frames]


def _of_pvd(path: Any) -> list[tuple[float | None, list[str]]]:
    steps: dict[Any, dict[str, None]] = {}  # a file once, also where a run that went on names it again
    for element in _root(path, "Collection").iter("DataSet"):
        steps.setdefault(_time(element.get("timestep", "")), {})[element.get("file", "")] = None
    return [(t, list(steps[t])) for t in sorted(steps, key=lambda t: -math.inf if t is None else t)]


def _of_series(path: Any) -> list[tuple[float | None, list[str]]]:
    data = whole_file(path, 20.0)
    try:
        files = json.loads(data)["files"]
        return [(_time(f.get("time", "")), [str(f["name"])]) for f in files]
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError):
        raise bad(path, "", 'expected {"files": [{"name": …, "time": …}]}, got other JSON') from None


_STEPS = {"pvd": _of_pvd, "series": _of_series}


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


def checked_places(path: Any, names: list[str], form: str, warn: bool = False) -> list[str]:
    """The files of names in a collection, without volumes beside others, of which is warned if `warn`.
    Raises FormatError."""
    found, held = [], 0
    volumes: list[str] = []
    if not names:
        raise bad(path, "", "expected the name of a file, got none")
    if len(names) > _MOST_FILES:
        raise bad(path, "", f"expected at most {_MOST_FILES:,} files, got {len(names):,}")
    for name in names:
        place = below(path, name)
        held += os.path.getsize(place)
        if len(names) > 1:  # all of them together, and once more when they are joined
            check_size(path, name, held, held, 2.0)
        kind = kind_or_none(place, "particles")
        known = kind is not None and kind.kind in ("particles", "mesh")
        if kind is None or not known or _RANKS.get(kind.format, 0) >= _RANKS[form]:
            if kind is None or kind.kind != "volume":
                raise bad(path, name, "expected a file of particles, got another one")
            volumes.append(name)
            continue
        found.append(place)
    if not found:
        raise bad(path, volumes[0], "expected a file of particles, got a volume")
    if volumes and warn:
        names_of_them = ", ".join(volumes)[:200]
        warnings.warn(f"{os.fspath(path)}: volumes are left out beside the particles: {names_of_them}", stacklevel=2)
    return found


def below(path: Any, name: str) -> str:
    """The place of a file that a collection names, or of it packed; it lies below the collection's
    folder.

    Raises FormatError.
    """
    own = os.path.realpath(str(path))
    folder = os.path.realpath(os.path.dirname(str(path)))
    beside = os.path.join(folder, name) if "\0" not in name else ""
    if "\\" in name and beside and not os.path.exists(beside):  # as Windows has them
        beside = os.path.join(folder, name.replace("\\", "/"))
    packed = (beside + ending for ending in ("", *ENDINGS))
    place = os.path.realpath(next((found for found in packed if os.path.isfile(found)), beside))
    if not name or not place.startswith(os.path.join(folder, "")) or place == own:
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
    origin = filled[0].origin
    positions = np.concatenate([np.asarray(part.at(origin).positions) for part in filled])
    fields: dict[str, Any] = {name: joined.pop(name) for name in FIELDS if name in joined}
    if "anisotropy" in fields:
        fields["anisotropy"] = fields["anisotropy"].reshape(-1, 3, 3)
    return Particles(positions, **fields, attributes=joined, origin=origin)
