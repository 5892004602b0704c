"""Marked pixels of a calibration target, and where the probe was when each was seen.

A table (.csv) of `column` and `row`, in pixels, and of each mark either its pose (the columns of a
pose table, see sweeps/poses.py) or the number of its `frame` in a tracked recording, from 0.
"""

from __future__ import annotations

import csv
import os
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

from ..formats.errors import bad, faults, shown
from ..formats.size import whole_text
from ..formats.sweeps.poses import csv_rows, interpolate, read_poses
from ..formats.sweeps.stack import check_numbers
from ..formats.sweeps.tracker_tables import number_of
from ..formats.sweeps.transforms import WORLDS, chain, find_path
from .files import checked_frame_times, recording_of
from .plausible import check_seconds


class Tracked(NamedTuple):
    """A recording of which no calibration is needed.

    frames (F, H, W), times (F,) s or None; poses (N, 4, 4) world_from_probe, mm, with ok (N,) and
    their times (N,) s or None; by_frame (F, 4, 4) and by_frame_ok (F,): the poses of the frames.
    """

    frames: np.ndarray
    times: np.ndarray | None
    poses: np.ndarray
    ok: np.ndarray
    pose_times: np.ndarray | None
    by_frame: np.ndarray
    by_frame_ok: np.ndarray


def read_tracked(path: Any, poses: Any = None, frame_times: Any = None, tool: str = "Probe") -> Tracked:
    """Frames and poses of the probe, or of another tool: of a PLUS file, or of a stack of images
    and a table."""
    recording, _ = recording_of(path)
    n = len(recording.frames)
    times = recording.times if frame_times is None else checked_frame_times(frame_times, n)
    if poses is None:
        ways = [find_path(recording.edges, tool, world) for world in WORLDS]
        way = next((way for way in ways if way), None)
        if way is None:
            got = " ".join(f"{a}To{b}" for a, b in recording.edges) or "no transform; give a table of poses"
            raise bad(path, "", f"expected a way from {tool} to {' or '.join(WORLDS)}, got {got}")
        placed = chain(recording.edges, way, n)
        ok = placed.ok & recording.ok
        return Tracked(recording.frames, times, placed.matrices, ok, times, placed.matrices, ok)
    if frame_times is not None and np.ndim(frame_times) == 0:
        check_numbers(path)
    table = read_poses(poses)
    if table.times is None:
        if len(table.matrices) != n:
            expected = f"a time in each row, or {n} rows as there are frames"
            raise bad(poses, "", f"expected {expected}, got {len(table.matrices)} rows")
        return Tracked(recording.frames, times, *table[1:], times, *table[1:])
    if times is None:
        raise bad(path, "", "expected frames that know their times; give them (frame_times)")
    check_seconds(poses, table.times, times)
    by_frame = interpolate(table, times)
    return Tracked(recording.frames, times, *table[1:], table.times, *by_frame)


def read_marks(path: str | os.PathLike[str], recording: Tracked | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Pixels (N, 2) and world_from_probe (N, 4, 4) of a table. Raises FormatError with the row."""
    if not os.fspath(path).lower().endswith(".csv"):
        raise bad(path, "", "expected a table of marks, .csv")
    wanted = ["column", "row", *(["frame"] if recording else [])]
    marks = [[number_of(path, where, word) for word in words] for where, words in _rows(path, wanted)]
    table = np.array(marks, np.float64).reshape(-1, len(wanted))
    if not np.isfinite(table).all():
        where = f"row {int(np.argmin(np.isfinite(table).all(axis=1))) + 2}"
        raise bad(path, where, "expected numbers, got an empty or infinite one")
    if recording is None:
        rows = csv_rows(path, whole_text(path))
        poses, ok = np.array([row[2] for row in rows]), np.array([row[3] for row in rows])
    else:
        frames = table[:, 2].astype(int)
        n = len(recording.frames)
        strange = (frames != table[:, 2]) | (frames < 0) | (frames >= n)
        if strange.any():
            i = int(np.argmax(strange))
            expected = f"expected a frame of 0 to {n - 1}"
            raise bad(path, f"row {i + 2}", f"{expected}, got {table[i, 2]:g}")
        poses, ok = recording.by_frame[frames], recording.by_frame_ok[frames]
    ok = ok & np.isfinite(poses).all(axis=(1, 2)) if len(ok) else ok
    if not ok.all():
        where = f"row {int(np.argmin(ok)) + 2}"
        raise bad(path, where, "expected a mark with a valid pose, got one without")
    return table[:, :2], poses


def read_landmarks(path: str | os.PathLike[str]) -> tuple[list[str], np.ndarray]:
    """Names and points (N, 3) of a table (.csv) of name, x, y, z, mm. A landmark may be touched
    several times. Raises FormatError with the row."""
    names, points = [], []
    for where, (name, *place) in _rows(path, ["name", "x", "y", "z"]):
        names.append(name.strip())
        points.append([number_of(path, where, word) for word in place])
        if not np.isfinite(points[-1]).all():
            raise bad(path, where, "expected numbers, got an empty or infinite one")
    return names, np.array(points, np.float64).reshape(-1, 3)


def _rows(path: Any, wanted: list[str]) -> Iterator[tuple[str, list[str]]]:
    """Where each row of a table (.csv) is, and its words in the columns wanted. Raises FormatError."""
    with faults(path, expected="a text table", refused=(UnicodeError, csv.Error)):
        lines = list(csv.reader(whole_text(path).lstrip("\ufeff").splitlines()))
    columns = [name.strip().lower() for name in lines[0]] if lines else []
    if not set(wanted) <= set(columns):
        raise bad(path, "line 1", f"expected columns {' '.join(wanted)}, got {shown(','.join(columns))}")
    for number, line in enumerate(filter(None, lines[1:]), 2):
        if len(line) != len(columns):
            raise bad(path, f"row {number}", f"expected {len(columns)} values, got {len(line)}")
        yield f"row {number}", [line[columns.index(name)] for name in wanted]
