"""Pose tables as trackers and their programs write them, in millimeters and seconds.

    TUM         `timestamp tx ty tz qx qy qz qw`, blanks between, `#` before comments; s and m
    ROS         .csv of a topic of stamped poses or transforms; ns, or columns of s and ns; m
    OptiTrack   .csv of Motive with one rigid body as a quaternion; s, and the header's unit
    NDI         .csv or .tsv of NDI's programs with one tool as a quaternion or angles; mm; a frame
                number counts sixtieths of a second
    PLUS        .mha or .nrrd of a tracker's buffer: transforms, and images that hold nothing

The content tells the format.
"""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from ..errors import bad, shown

_NDI_RATE = 60.0  # frame numbers a second, whatever the tool's own rate (Polaris API)
_MM = {"millimeters": 1.0, "centimeters": 10.0, "meters": 1000.0, "inches": 25.4, "feet": 304.8}


class Row(NamedTuple):
    """A line of a table: its place, time in s or None, pose (4, 4) in mm, and whether it counts."""

    where: str
    time: float | None
    matrix: np.ndarray
    ok: bool


def reader_of(text: str) -> Callable[[Any, str], list[Row]] | None:
    """What reads a table of a tracker; None for other text."""
    lines = [line for line in text.splitlines()[:20] if line.strip()]
    if not lines:
        return None
    first = lines[0].lower()
    if first.startswith("format version") or '"format version"' in first:
        return _optitrack
    if "state" in first and ("q0" in first or "rz" in first) and "tx" in first:
        return _ndi
    if re.search(r"(position|translation)\.x", first):
        return _ros
    data = [line for line in lines if not line.lstrip().startswith("#")]
    if data and "," not in data[0] and len(data[0].split()) == 8 and _numbers(data[0].split()):
        return _tum
    return None


def seconds(values: np.ndarray) -> np.ndarray:
    """Times in s of absolute times (since 1970) in s, ms, µs or ns; smaller numbers are s.

    The year 2001 is 1e9 s, 1e12 ms, 1e15 µs and 1e18 ns after 1970; a time of these sizes in
    another unit would be thousands of years away.
    """
    most = float(np.nanmax(np.abs(values), initial=0.0))
    for least, unit in ((1e17, 1e-9), (1e14, 1e-6), (1e11, 1e-3)):
        if most > least:
            return values * unit
    return values


def _tum(path: Any, text: str) -> list[Row]:
    rows = []
    for number, line in enumerate(text.splitlines(), 1):
        words = line.split("#")[0].split()
        if not words:
            continue
        where = f"line {number}"
        if len(words) != 8:
            raise bad(path, where, f"expected 8 numbers (TUM), got {len(words)}")
        time, *values = (number_of(path, where, word) for word in words)
        rows.append(Row(where, time, pose(path, where, np.array(values), 1000.0), True))
    return rows


def _ros(path: Any, text: str) -> list[Row]:
    names, lines = _table(text, ",")
    names = [name.lstrip("%").strip("/ ") for name in names]
    place = "position" if any(name.endswith("position.x") for name in names) else "translation"
    turn = "orientation" if place == "position" else "rotation"
    columns = [_column(path, names, f"{place}.{axis}") for axis in "xyz"]
    columns += [_column(path, names, f"{turn}.{axis}") for axis in "xyzw"]
    whole, part = _ros_clock(path, names)
    rows = []
    for where, line in _checked(path, names, lines):
        time = number_of(path, where, line[whole])
        if part is not None:
            time += number_of(path, where, line[part]) * 1e-9
        values = np.array([number_of(path, where, line[column]) for column in columns])
        rows.append(Row(where, time, pose(path, where, values, 1000.0), True))
    return rows


def _ros_clock(path: Any, names: list[str]) -> tuple[int, int | None]:
    """Columns of the stamp, and of its ns if they stand apart."""
    for whole, part in (("secs", "nsecs"), ("sec", "nanosec"), ("sec", "nsec")):
        found = [i for i, name in enumerate(names) if name.endswith(f"stamp.{whole}")]
        if found:
            return found[0], _column(path, names, f"stamp.{part}")
    for ending in ("header.stamp", "stamp", "time", "timestamp"):
        found = [i for i, name in enumerate(names) if name.lower().endswith(ending)]
        if found:
            return found[0], None
    raise bad(path, "line 1", f"expected a column of times, got {shown(','.join(names))}")


def _optitrack(path: Any, text: str) -> list[Row]:
    lines = list(csv.reader(text.splitlines()))
    about = dict(zip(lines[0][::2], lines[0][1::2], strict=False))
    unit = about.get("Length Units", "").lower()
    if unit not in _MM:
        raise bad(path, "Length Units", f"expected {', '.join(_MM)}, got {shown(unit)}")
    turn = about.get("Rotation Type", "")
    if turn.lower() != "quaternion":
        raise bad(path, "Rotation Type", f"expected Quaternion, got {shown(turn)}")
    start = next((i for i, line in enumerate(lines) if line and line[0] == "Frame"), None)
    if start is None or start < 3:
        raise bad(path, "", "expected a line that begins with Frame, got none")
    head = lines[:start]
    types = next((line for line in head if "Rigid Body" in line), [])
    bodies = [i for i, word in enumerate(types) if word == "Rigid Body"]
    named = next((line for line in head if "Name" in line[:2]), types)
    found = sorted({named[i] for i in bodies if i < len(named)})
    if len(found) != 1:
        got = ", ".join(found) or "none"
        raise bad(path, "", f"expected one rigid body, got {got}: export the probe's alone")
    what = head[-1]  # Rotation or Position
    axes = {
        (what[i], lines[start][i]): i
        for i in reversed(bodies) if i < min(len(what), len(lines[start]))
    }  # fmt: skip
    wanted = [("Position", axis) for axis in "XYZ"] + [("Rotation", axis) for axis in "XYZW"]
    missing = [f"{kind} {axis}" for kind, axis in wanted if (kind, axis) not in axes]
    if missing:
        raise bad(path, f"line {start + 1}", f"expected columns {', '.join(missing)}, got none")
    clock = next((i for i, name in enumerate(lines[start]) if name.startswith("Time")), None)
    if clock is None:
        raise bad(path, f"line {start + 1}", "expected a column Time (Seconds), got none")
    rows = []
    for number, line in enumerate(lines[start + 1 :], start + 2):
        if not line:
            continue
        where = f"line {number}"
        line = line + [""] * (len(lines[start]) - len(line))
        values = np.array([number_of(path, where, line[axes[key]]) for key in wanted])
        seen = bool(np.isfinite(values).all())
        time = number_of(path, where, line[clock])
        rows.append(Row(where, time, pose(path, where, values, _MM[unit]), seen))
    return rows


def _ndi(path: Any, text: str) -> list[Row]:
    from scipy.spatial.transform import Rotation

    names, lines = _table(text, "\t" if "\t" in text.splitlines()[0] else ",")
    lower = [name.lower() for name in names]
    if lower.count("state") > 1:
        n = lower.count("state")
        raise bad(path, "line 1", f"expected one tool, got {n}: export the probe's alone")
    quaternion = "q0" in lower
    turn = ("qx", "qy", "qz", "q0") if quaternion else ("rz", "ry", "rx")
    columns = [_column(path, lower, name) for name in ("tx", "ty", "tz", *turn)]
    state, frame = lower.index("state"), _column(path, lower, "frame")
    clock = next((i for i, name in enumerate(lower) if name.startswith("time")), None)
    rows = []
    for where, line in _checked(path, names, lines):
        ok = line[state].strip().upper() in ("OK", "ENABLED", "VISIBLE", "1")
        words = [line[column] if ok else "" for column in columns]
        values = np.array([number_of(path, where, word) for word in words])
        time = number_of(path, where, line[frame]) / _NDI_RATE if clock is None else number_of(path, where, line[clock])
        seen = ok and bool(np.isfinite(values).all())
        if seen and not quaternion:
            turned = Rotation.from_euler("ZYX", values[3:], degrees=True)
            values = np.append(values[:3], turned.as_quat())
        rows.append(Row(where, time, pose(path, where, values), seen))
    return rows


def pose(path: Any, where: str, values: np.ndarray, mm: float = 1.0) -> np.ndarray:
    """(4, 4) in mm of a position and a quaternion x, y, z, w; NaN where a number is missing."""
    from scipy.spatial.transform import Rotation

    result = np.eye(4)
    if not np.isfinite(values).all():
        result[:3] = np.nan
        return result
    length = np.linalg.norm(values[3:])
    if abs(length - 1) > 0.01:
        raise bad(path, where, f"expected a quaternion of length 1, got {length:g}")
    result[:3, :3], result[:3, 3] = Rotation.from_quat(values[3:]).as_matrix(), values[:3] * mm
    return result


def _table(text: str, separator: str) -> tuple[list[str], list[list[str]]]:
    lines = list(csv.reader(text.splitlines(), delimiter=separator))
    return [name.strip() for name in lines[0]], lines[1:]


def _checked(path: Any, names: list[str], lines: list[list[str]]) -> list[tuple[str, list[str]]]:
    rows = []
    for number, line in enumerate(lines, 2):
        if not line:
            continue
        if len(line) < len(names):
            raise bad(path, f"line {number}", f"expected {len(names)} values, got {len(line)}")
        rows.append((f"line {number}", line))
    return rows


def _column(path: Any, names: list[str], ending: str) -> int:
    found = [i for i, name in enumerate(names) if name == ending or name.endswith("." + ending)]
    found = found or [i for i, name in enumerate(names) if name.endswith(ending)]
    if not found:
        raise bad(path, "line 1", f"expected a column {ending}, got {shown(','.join(names))}")
    return found[0]


def number_of(path: Any, where: str, text: str) -> float:
    """The number of a cell; NaN for an empty one. Raises FormatError that names file and place."""
    if not text.strip():
        return math.nan
    try:
        return float(text)
    except ValueError:
        raise bad(path, where, f"expected a number, got {shown(text)}") from None


def _numbers(words: list[str]) -> bool:
    try:
        return all(math.isfinite(float(word)) for word in words)
    except ValueError:
        return False
