"""The tree of an HDF5 file, and what of it is read."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from .contents import Box
from .errors import FormatError, bad

# The names that `fields` knows, by those of the programs.
NAMES = {
    "coordinates": "positions", "velocities": "velocity", "masses": "mass", "densities": "density",
    "density": "density", "smoothinglength": "smoothing_length",
    "smoothinglengths": "smoothing_length", "particleids": "id", "rho": "density", "m": "mass",
}  # fmt: skip
_PLACES = {name: None for name in ("positions", "position", "pos", "points", "coords", "xyz")}  # in this order


class Source(NamedTuple):
    """Rows [first, first + n) of a data set, or of its entry `frame`, times scale."""

    place: str
    first: int
    n: int
    scale: float = 1.0
    frame: int | None = None


@dataclass
class Layout:
    """What to read: name -> sources, whose columns are put side by side if there are several."""

    arrays: dict[str, list[Source]]
    box: Box | None = None
    units: dict[str, str] = field(default_factory=dict)
    time: float | None = None
    n_frames: int = 1
    species: tuple[str, ...] = ()
    support_per_h: float = 2.0
    axes: tuple[tuple[int, ...], tuple[int, ...]] = ((), ())  # of positions and offsets; (): all
    shift: tuple[float, ...] = (0.0, 0.0, 0.0)  # of all positions
    constants: dict[str, float] = field(default_factory=dict)  # one value for all particles
    blocks: tuple[dict[str, list[Source]], ...] = ()  # arrays of more particles, behind these
    tree: Any = None

    def sources(self) -> Iterator[Source]:
        """All sources, in the order of reading."""
        return (source for arrays in (self.arrays, *self.blocks) for sources in arrays.values() for source in sources)


class Tree(dict[str, dict[str, Any]]):
    """Groups and data sets by their place, "/a/b"; the root is ""."""

    def __init__(self, path: Any, items: dict[str, dict[str, Any]]):
        super().__init__(items)
        self.path = path

    def attributes(self, place: str) -> dict[str, Any]:
        """The attributes of a group or data set; none where it is absent."""
        return self.get(place, {}).get("attributes", {})

    def children(self, place: str) -> list[str]:
        """Names directly below a group."""
        start = place + "/"
        return [p[len(start) :] for p in self if p.startswith(start) and "/" not in p[len(start) :]]

    def is_data(self, place: str) -> bool:
        """Whether a place is a data set."""
        return "shape" in self.get(place, {})

    def rows(self, place: str) -> int:
        """Rows of a data set; -1 for a single number or a group."""
        shape = self.get(place, {}).get("shape", [])
        return shape[0] if shape else -1

    def source(self, place: str) -> Source:
        """All rows of a data set. Raises FormatError where there is none."""
        if not self.is_data(place) or not self[place]["shape"]:
            raise self.bad(place, "expected a data set with one row a particle, got none")
        return Source(place, 0, self[place]["shape"][0])

    def bad(self, place: str, problem: str) -> FormatError:
        """A FormatError at a place."""
        return bad(self.path, place, problem)

    def arrays(self, group: str) -> dict[str, list[Source]]:
        """The data sets of a group that have the rows of its positions, x y z joined."""
        names = {k: f"{group}/{k}" for k in self.children(group) if self.is_data(f"{group}/{k}")}
        known = {NAMES.get(name.lower(), name): place for name, place in names.items()}
        found: dict[str, list[Source]] = {}
        for parts, vector in (("xyz", "positions"), ("XYZ", "positions"),
                              (("vx", "vy", "vz"), "velocity"), ("uvw", "velocity")):  # fmt: skip
            if vector not in found and vector not in known and {*parts} <= known.keys():
                found[vector] = [self.source(known.pop(part)) for part in parts]
        flat = [parts for parts in ("xy", "XY") if {*parts} <= known.keys()]
        if "positions" not in found and not known.keys() & _PLACES and flat:  # in the plane z = 0
            x, y = (self.source(known[part]) for part in flat[0])
            if x.n == y.n:
                found["positions"] = [x, y]
                known = {name: place for name, place in known.items() if name not in flat[0]}
        for name, place in known.items():
            if self.rows(place) >= 0 and len(self[place]["shape"]) < 4:
                found.setdefault(name, [self.source(place)])
        lower = {name.lower(): name for name in reversed(list(found))}
        for name in _PLACES:
            if "positions" not in found and name in lower:
                found["positions"] = found.pop(lower[name])
        if "positions" not in found:
            return {}
        n = found["positions"][0].n
        if any(source.n != n for source in found["positions"]):
            raise self.bad(group, "expected x, y and z of one length")
        return {k: s for k, s in found.items() if all(source.n == n for source in s)}
