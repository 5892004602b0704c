"""Values for the plots beside the image: along a measured line, and over a simulation's time."""

from __future__ import annotations

from typing import Any

import numpy as np

from .._base.arrays import box_corners, to_host
from ..data.attributes import attribute_values
from ..scene.mesh import Mesh
from .forces import by_name
from .overlay import AMBER, STEEL, Mark, box_of, origin_seen
from .state import State

N_ALONG = 160  # points along a line
MOST_POINTS = 240  # of a curve over time
FIELD = "field"
# What a simulation's record has: name, column, factor, unit.
OVER_TIME = (
    ("largest speed", "max_speed", 1.0, "m/s"),
    ("compression", "compression", 100.0, "%"),
    ("largest compression", "max_compression", 100.0, "%"),
    ("time step", "dt", 1000.0, "ms"),
    ("pressure iterations", "iterations", 1.0, ""),
    ("particles", "n", 1.0, ""),
    ("cut bonds", "n_cut", 1.0, ""),
)


def measured_line(state: State) -> np.ndarray | None:
    """The two ends (2, 3) of the measurement of the settings, world; None: there is none."""
    if not state.measure.shown:
        return None
    return np.array([state.measure.start, state.measure.end], float)


def line_mark(line: np.ndarray, unit: str = "") -> Mark:
    """A measured line (2, 3) with its length; unit: of lengths, with a blank before it."""
    length = float(np.linalg.norm(line[1] - line[0]))
    return Mark(tuple(map(tuple, line.tolist())), f"{length:.4g}{unit}", AMBER)


def drawn_over(source: Any, frame: Any, state: State, marks: list[Mark]) -> dict[str, Any]:
    """What `finish` draws over a frame, but for depth and room. The caller holds the source's lock."""
    return {
        "marks": marks + marks_of(source, state),
        "plates": source.plates(state),
        "flats": source.flats(state),
        "ends": source.maker.range,
        "kinds": source.maker.kinds,
        "origin": origin_seen(frame),
        **box_of(frame, state),
    }


def marks_of(source: Any, state: State) -> list[Mark]:
    """The marks that all browsers share. The caller holds the source's lock."""
    line = measured_line(state)
    unit = f" {source.unit}".rstrip()
    return source.marks() + ([] if line is None else [line_mark(line, unit)])


def outline_of_plane(state: State, lo: Any, hi: Any) -> list[Mark]:
    """The edge of the cutting plane in the box of the scene (corners (3,), world), if it cuts it."""
    cuts, middle = state.cuts, (np.add(lo, hi)) / 2
    normal = np.asarray(cuts.normal, float)
    if not cuts.plane or not normal.any():
        return []
    half = 1.04 * (np.subtract(hi, lo)) / 2
    corners = box_corners(middle - half, middle + half)
    far = (corners - np.asarray(cuts.point, float)) @ normal
    ends = []
    for a in range(8):
        for b in range(a):
            edge = np.count_nonzero(corners[a] != corners[b]) == 1
            if edge and far[a] * far[b] < 0:
                ends.append(corners[a] + far[a] / (far[a] - far[b]) * (corners[b] - corners[a]))
    if len(ends) < 3:
        return []
    points = np.array(ends) - np.mean(ends, axis=0)
    first = points[0] / np.linalg.norm(points[0])
    second = np.cross(normal / np.linalg.norm(normal), first)
    order = np.argsort(np.arctan2(points @ second, points @ first))
    around = np.array(ends)[[*order, order[0]]]
    return [Mark(tuple(map(tuple, around.tolist())), color=STEEL, thin=True)]


def along_line(scene: Any, line: np.ndarray, name: str) -> dict[str, Any] | None:
    """Values along a line through particles; the caller holds the source's lock.

    Args:
        scene: a `Scene`; a mesh has no values.
        line: (2, 3) ends, world.
        name: by which the particles are colored; "": the field.

    Returns:
        name, x (distances from the first end, world units) and y (values; None where no particle
        reaches), for JSON; None for a mesh.
    """
    if scene is None or isinstance(scene, Mesh):
        return None
    from ..measure.sample import values_at

    shares = np.linspace(0.0, 1.0, N_ALONG)
    points = (line[0] + shares[:, None] * (line[1] - line[0])).astype(np.float32)
    name = name or FIELD
    vector = np.ndim(scene.particles.attributes.get(name)) == 2
    if vector:  # colored by its length
        lengths = attribute_values(scene.particles, name)
        values = np.asarray(to_host(scene.blend(points, lengths)), float)
    else:
        values = np.asarray(values_at(scene, points, [name])[name], float)
    known = [float(f"{v:.6g}") if np.isfinite(v) else None for v in values]
    x = shares * float(np.linalg.norm(line[1] - line[0]))
    return {"name": name, "x": [float(f"{v:.6g}") for v in x], "y": known}


def over_time(source: Any, chosen: str = "") -> dict[str, Any] | None:
    """A quantity of a simulation's record over its time; never waits for the source's lock.

    Args:
        source: of the viewer.
        chosen: one of `names`; any other: the first.

    Returns:
        name, unit, names (to choose from), x (time, s) and y, for JSON; None: there is no record.
    """
    record = getattr(getattr(source, "simulation", None), "record", None)
    rows = list(getattr(record, "diagnostics", ()))
    if len(rows) < 2:
        return None
    known = {name: tuple(rest) for name, *rest in OVER_TIME if rest[0] in rows[-1]}
    known |= {f"force of {name}": (column, 1.0, "N") for name, column in by_name(rows[-1]).items()}
    name = chosen if chosen in known else next(iter(known))
    column, factor, unit = known[name]
    last, step = rows[-1], 1 + len(rows) // MOST_POINTS
    rows = [row for row in (*rows[:-1:step], last) if column in row]
    return {
        "name": name,
        "unit": unit,
        "names": list(known),
        "x": [float(f"{row['time']:.6g}") for row in rows],
        "y": [float(f"{factor * row[column]:.6g}") for row in rows],
    }
