"""Pose tables (.csv, .json) and poses between their times.

A row of a table is a time in seconds and a pose, and may have a status:

    time  x y z  qx qy qz qw            position in mm and quaternion
    time  m00 m01 … m23 [m30 … m33]     the rows of a 4x4 matrix
    status                              OK or 1; anything else is a pose that is missing

JSON is a list of objects with `time`, and `matrix` or `position` and `quaternion` [x, y, z, w], or
an object with that list under `poses`. A table without times has one row per frame. Times since
1970 may be in ms, µs or ns; a column `time_ms`, `time_us` or `time_ns` states its unit.

Tables of trackers' own programs are read by `tracker_tables`, buffers of PLUS by `igs`.
"""

from __future__ import annotations

import csv
import json
import math
import os
from typing import Any, NamedTuple

import numpy as np

from ..errors import bad, faults, shown
from ..size import whole_text
from . import tracker_tables

_TIME = ("time", "timestamp", "t")
_UNITS = {"_s": 1.0, "_ms": 1e-3, "_us": 1e-6, "_ns": 1e-9}
_POSITION = ("x", "y", "z")
_QUATERNION = ("qx", "qy", "qz", "qw")
MATRIX = tuple(f"m{row}{column}" for row in range(4) for column in range(4))
_MOST_GAP = 5.0  # median intervals between poses; a longer silence of the tracker is a gap


class PoseTable(NamedTuple):
    """times (N,) s or None; matrices (N, 4, 4) float64, NaN where missing; ok (N,) bool. In the
    order of the file, which need not be that of the times."""

    times: np.ndarray | None
    matrices: np.ndarray
    ok: np.ndarray


def read_poses(path: str | os.PathLike[str]) -> PoseTable:
    """Read a pose table. Raises FormatError naming the row."""
    name = os.fspath(path).lower()
    if name.endswith((".mha", ".mhd", ".nrrd", ".nhdr")):
        return _of_buffer(path)
    rows = _json_rows(path) if name.endswith(".json") else _text_rows(path)
    if not rows:
        raise bad(path, "", "expected poses, got none")
    times, matrices, ok = [], [], []
    for where, time, matrix, status in rows:
        if time is not None and not math.isfinite(time):
            raise bad(path, where, f"expected a finite time, got {time}")
        good = status and bool(np.isfinite(matrix).all())
        if good and not np.array_equal(matrix[3], (0, 0, 0, 1)):
            raise bad(path, where, f"expected 0 0 0 1 as the last row, got {matrix[3].tolist()}")
        if good and abs(np.linalg.det(matrix[:3, :3])) < 1e-12:
            raise bad(path, where, "expected a pose that can be inverted, got a singular matrix")
        times.append(time)
        matrices.append(matrix)
        ok.append(good)
    timed = [time is not None for time in times]
    if any(timed) and not all(timed):
        raise bad(path, rows[timed.index(False)][0], "expected a time in every row, got none")
    if not any(timed):
        return PoseTable(None, np.array(matrices), np.array(ok))
    when = tracker_tables.seconds(np.array(times, np.float64))
    return PoseTable(when, np.array(matrices), np.array(ok))


def _of_buffer(path: Any) -> PoseTable:
    """The transform of a tracker's buffer of PLUS: the only one, or Probe to Reference or
    Tracker."""
    from . import igs
    from .transforms import WORLDS, chain, find_path

    recording = igs.read(path)
    edges = recording.edges
    way = next((way for world in WORLDS if (way := find_path(edges, "Probe", world))), None)
    if way is None and len(edges) == 1:
        way = list(edges)
    if way is None:
        got = " ".join(f"{a}To{b}" for a, b in edges) or "none"
        raise bad(path, "", f"expected a transform from Probe to {' or '.join(WORLDS)}, got {got}")
    placed = chain(edges, way, len(recording.frames))
    matrices = np.where(placed.ok[:, None, None], placed.matrices, np.nan)
    return PoseTable(recording.times, matrices, placed.ok)


def write_csv(path: str | os.PathLike[str], table: PoseTable) -> None:
    """Write times, 4x4 matrices and statuses; every number survives exactly."""
    with open(path, "w", encoding="utf-8", newline="\n") as file:
        times, timed = table.times, table.times is not None
        file.write(",".join((*(["time"] if timed else []), *MATRIX, "status")) + "\n")
        for i, (matrix, ok) in enumerate(zip(table.matrices, table.ok, strict=True)):
            numbers = [] if times is None else [float(times[i])]
            numbers += matrix.ravel().tolist()
            file.write(",".join(map(repr, numbers)) + (",OK\n" if ok else ",INVALID\n"))


def interpolate(table: PoseTable, times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Poses at other times: translation (and scale) linear, rotation slerp.

    times   (M,) s; the table must have times. Returns matrices (M, 4, 4) float64 and ok (M,): False
    outside of the table's times and where the tracker was silent for longer than 5 median
    intervals. A time that the table has gives exactly the table's pose, missing ones included.
    Raises ValueError for a table without times and for a mirrored pose.
    """
    n = len(times)
    matrices, ok = np.tile(np.full((4, 4), np.nan), (n, 1, 1)), np.zeros(n, bool)
    if table.times is None:
        raise ValueError("poses: expected times in the table, got none")
    known, poses = table.times[table.ok], table.matrices[table.ok]
    known, first = np.unique(known, return_index=True)
    poses = poses[first]
    if len(known) == 0:
        return matrices, ok
    after = np.clip(np.searchsorted(known, times), 1, max(1, len(known) - 1))
    before = after - 1
    after = np.minimum(after, len(known) - 1)
    longest = _MOST_GAP * np.median(np.diff(known)) if len(known) > 1 else 0.0
    span = known[after] - known[before]
    inside = (times >= known[0]) & (times <= known[-1]) & (span <= longest * (1 + 1e-9))
    share = np.divide(times - known[before], span, out=np.zeros(n), where=span > 0)
    if inside.any():
        first, last = poses[before[inside]], poses[after[inside]]
        matrices[inside] = _between(first, last, share[inside])
    for source in (before, after):  # exactly, whatever became of a long gap beside it
        same = np.isfinite(times) & (known[source] == times)
        matrices[same] = poses[source[same]]
        inside |= same
    lost = table.times[~table.ok]
    inside &= ~np.isin(times, lost[~np.isin(lost, known)])
    return matrices, inside


def _between(a: np.ndarray, b: np.ndarray, share: np.ndarray) -> np.ndarray:
    """Poses (M, 4, 4) between poses a and b (M, 4, 4), at shares (M,) of the way."""
    from scipy.spatial.transform import Rotation

    scale_a, scale_b = (np.linalg.norm(m[:, :3, :3], axis=1) for m in (a, b))
    try:
        first = Rotation.from_matrix(a[:, :3, :3] / scale_a[:, None])
        last = Rotation.from_matrix(b[:, :3, :3] / scale_b[:, None])
    except ValueError:
        problem = "pose: expected a right-handed rotation, got a mirrored one"
        raise ValueError(problem) from None
    share = share[:, None]
    turned = first * Rotation.from_rotvec(share * (first.inv() * last).as_rotvec())
    result = np.tile(np.eye(4), (len(a), 1, 1))
    scale = (1 - share) * scale_a + share * scale_b
    result[:, :3, :3] = turned.as_matrix() * scale[:, None]
    result[:, :3, 3] = (1 - share) * a[:, :3, 3] + share * b[:, :3, 3]
    return result


_Row = tuple[str, "float | None", np.ndarray, bool]


def _text_rows(path: Any) -> list[_Row]:
    with faults(path, expected="a text table", refused=UnicodeError):
        text = whole_text(path)
    reader = tracker_tables.reader_of(text)
    if reader:
        with faults(path, expected="a text table", refused=csv.Error):
            return [(r.where, r.time, r.matrix, r.ok) for r in reader(path, text)]
    if not os.fspath(path).lower().endswith(".csv"):
        known = "a .csv, .json, .mha or .nrrd, or a table of TUM, ROS, OptiTrack or NDI"
        raise bad(path, "", f"expected a pose table: {known}")
    return csv_rows(path, text)


def csv_rows(path: Any, text: str) -> list[_Row]:
    """The poses of a table of comma-separated values, row by row. Raises FormatError."""
    with faults(path, expected="a text table", refused=csv.Error):
        lines = [line for line in csv.reader(text.splitlines()) if line]
    if not lines:
        raise bad(path, "", "expected a line of column names, got an empty file")
    names = [name.strip().lower() for name in lines[0]]
    clocks = {name + unit: scale for name in _TIME for unit, scale in _UNITS.items()}
    clocks |= dict.fromkeys(_TIME, 1.0)
    clock = next((name for name in (*_TIME, *clocks) if name in names), None)
    time_column = None if clock is None else names.index(clock)
    status_column = names.index("status") if "status" in names else None
    if set(MATRIX[:12]) <= set(names):
        wanted = MATRIX if set(MATRIX) <= set(names) else MATRIX[:12]
    else:
        wanted = (*_POSITION, *_QUATERNION)
    missing = [name for name in wanted if name not in names]
    if missing:
        expected = "columns x y z qx qy qz qw, or m00 to m23"
        raise bad(path, "line 1", f"expected {expected}, got {shown(','.join(names))}")
    columns = [names.index(name) for name in wanted]
    rows = []
    for number, line in enumerate(lines[1:], 2):
        where = f"row {number}"
        if len(line) != len(names):
            raise bad(path, where, f"expected {len(names)} values, got {len(line)}")
        values = np.array([tracker_tables.number_of(path, where, line[column]) for column in columns])
        matrix = _matrix(path, where, values)
        time = None
        if clock is not None and time_column is not None:
            time = tracker_tables.number_of(path, where, line[time_column]) * clocks[clock]
        status = status_column is None or line[status_column].strip().upper() in ("OK", "1", "TRUE")
        rows.append((where, time, matrix, status))
    return rows


def _json_rows(path: Any) -> list[_Row]:
    with faults(path, expected="JSON", refused=(ValueError, RecursionError)):
        content = json.loads(whole_text(path))
    entries = content.get("poses") if isinstance(content, dict) else content
    if not isinstance(entries, list):
        raise bad(path, "", "expected a list of poses, or an object with one under `poses`")
    rows = []
    for i, entry in enumerate(entries):
        where = f"pose {i}"
        if not isinstance(entry, dict):
            raise bad(path, where, f"expected an object, got {shown(str(entry))}")
        time = next((entry[name] for name in _TIME if name in entry), None)
        status = entry.get("status", "OK") in ("OK", 1, True)
        try:
            if "matrix" in entry:
                values = np.array(entry["matrix"], np.float64).ravel()
            else:
                values = np.array([*entry["position"], *entry["quaternion"]], np.float64)
            time = None if time is None else float(time)
        except KeyError as error:
            problem = f"expected matrix, or position and quaternion, got no {error}"
            raise bad(path, where, problem) from None
        except (TypeError, ValueError, OverflowError):
            raise bad(path, where, f"expected numbers, got {shown(str(entry))}") from None
        rows.append((where, time, _matrix(path, where, values), status))
    return rows


def _matrix(path: Any, where: str, values: np.ndarray) -> np.ndarray:
    """A 4x4 of 16 or 12 entries, or of position and quaternion."""
    if len(values) == 7:
        return tracker_tables.pose(path, where, values)
    if len(values) not in (12, 16):
        raise bad(path, where, f"expected 7, 12 or 16 numbers, got {len(values)}")
    result = np.eye(4)
    result.ravel()[: len(values)] = values
    return result
