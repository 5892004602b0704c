"""Files with several frames: each frame of one is a file's name that knows which it stands for.
Where the frames of a text begin is found once."""

from __future__ import annotations

import os
import re
from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from ..data.particles import Particles
from .asciinum import lines_of, text_data
from .contents import Contents, frame_index
from .size import check_text

_MOST_KNOWN = 64  # files whose frames are kept in mind
# Names of a column that tells the frame of each row, by their letters; alone, without ids; and of ids.
_FRAME_NAMES = {"frame", "frames", "frameid", "frameno", "framenumber", "frameindex", "timestep", "step", "snapshot"}
_TIME_NAMES = {"time", "simulationtime", "timevalue"}
_ID_NAMES = {"id", "ids", "pid", "idp", "particle", "particleid", "particleindex", "particles", "track", "trackid",
             "tag", "atomid", "agent", "agentid"}  # fmt: skip


class FrameOf(str):
    """The name of a file, for one of its frames; `read` takes it. Equal to the same frame's only.

    Attributes:
        frame: its number, from 0.
    """

    frame: int

    def __new__(cls, path: str, frame: int) -> FrameOf:
        """The name of a file, and the number of one of its frames."""
        one = super().__new__(cls, path)
        one.frame = frame
        return one

    def __getnewargs__(self) -> tuple[str, int]:  # type: ignore[override]
        return str(self), self.frame  # for pickle and copy

    def __eq__(self, other: object) -> bool:
        return isinstance(other, FrameOf) and self.frame == other.frame and str.__eq__(self, other)

    def __ne__(self, other: object) -> bool:
        return not self == other

    def __hash__(self) -> int:
        return hash((str.__hash__(self), self.frame))


def said(path: str | os.PathLike[str]) -> str:
    """What a message calls a file, or a frame of one."""
    return f"frame {path.frame} of {path}" if isinstance(path, FrameOf) else os.fspath(path)


def tells_frames(name: str) -> bool:
    """Whether a column of this name may tell the frame of each row."""
    return _letters(name) in {*_FRAME_NAMES, *_TIME_NAMES, "t"}


def frames_by_column(particles: Particles) -> str | None:
    """The attribute that tells the frame of each particle of a table with one row a particle and
    frame; None where the particles are those of one frame.

    Ids are in each frame once, and some are in several. Without ids, the rows of a frame follow each
    other, several a frame; as many in each, where the column is called a time.
    """
    flat = {name: a for name, a in particles.attributes.items() if a.ndim == 1 and a.dtype.kind in "iuf"}
    name = next((name for name in flat if tells_frames(name)), None)
    if name is None or not np.isfinite(flat[name]).all():
        return None
    _, of_frame, sizes = np.unique(flat[name], return_inverse=True, return_counts=True)
    if len(sizes) < 2:
        return None
    ids = next((flat[one] for one in flat if _letters(one) in _ID_NAMES), None)
    if ids is not None:
        order = np.lexsort((of_frame, ids))
        same = np.diff(ids[order]) == 0
        return name if same.any() and np.diff(of_frame[order])[same].all() else None
    if sizes.min() < 2 or (np.diff(of_frame) < 0).any():
        return None
    alone = _letters(name) in _FRAME_NAMES or (_letters(name) in _TIME_NAMES and (sizes == sizes[0]).all())
    return name if alone else None


def frame_by_column(path: Any, contents: Contents, frame: int) -> Contents:
    """One frame of a table whose particles are those of all frames; the table as it is where they are
    of one. Raises ValueError for a frame that it does not have."""
    particles = contents.particles
    name = frames_by_column(particles)
    if name is None:
        frame_index(path, frame, 1)
        return contents
    times, of_frame = np.unique(particles.attributes[name], return_inverse=True)
    k = frame_index(path, frame, len(times))
    return replace(contents, particles=particles[of_frame == k], time=float(times[k]), n_frames=len(times))


def _letters(name: str) -> str:
    return re.sub("[^a-z]", "", name.lower())


class TextFrame(NamedTuple):
    """One frame of a text file.

    lines     of the frame
    before    how many lines of the file come before it
    head      the first two lines of the file
    n_frames  of the file
    """

    lines: list[str]
    before: int
    head: list[str]
    n_frames: int


class _Known(NamedTuple):
    """Where the frames of a file begin: their lines, and their bytes with the file's end."""

    starts: list[int]
    places: list[int]
    head: list[str]


_known: dict[tuple, _Known] = {}


def text_frame(path: Any, frame: int, starts_of: Callable[[Any, list[str]], list[int]]) -> TextFrame:
    """The lines of one frame of a text. The first call for a state of the file reads all of it, a
    later one only its frame.

    starts_of: of a path and all lines, the line at which each frame begins.

    Raises FormatError, and ValueError for a frame that the file does not have.
    """
    name = str(path)  # also of a packed one, which has another copy each time
    state = os.stat(name)
    key = (starts_of, os.path.abspath(name), state.st_mtime_ns, state.st_size)
    if (known := _known.get(key)) is not None:
        k = frame_index(path, frame, len(known.starts))
        begin, end = known.places[k : k + 2]
        with open(path, "rb") as file:
            file.seek(begin)
            data = file.read(end - begin)
        check_text(path, data)
        lines = lines_of(path, data)
        if k + 1 < len(known.starts):
            lines.pop()  # nothing, behind the last line's end
        return TextFrame(lines, known.starts[k], known.head, len(known.starts))
    data = text_data(path)
    lines = lines_of(path, data)
    starts = starts_of(path, lines)
    k = frame_index(path, frame, len(starts))
    if len(starts) > 1 and b"\0" not in data and data.count(b"\r") == data.count(b"\r\n"):
        ends = np.flatnonzero(np.frombuffer(data, np.uint8) == ord("\n")) + 1
        places = [int(ends[line - 1]) if line else 0 for line in starts]
        if len(_known) >= _MOST_KNOWN:
            _known.clear()
        _known[key] = _Known(starts, [*places, len(data)], lines[:2])
    end = starts[k + 1] if k + 1 < len(starts) else len(lines)
    return TextFrame(lines[starts[k] : end], starts[k], lines[:2], len(starts))


def bytes_of_frame(frame: FrameOf) -> int:
    """How long a frame of a text is, if `text_frame` has read its file as it is; else 0."""
    name = os.path.abspath(str(frame))
    try:
        state = os.stat(name)
    except OSError:
        return 0
    for (_, *key), known in _known.items():
        if key == [name, state.st_mtime_ns, state.st_size] and frame.frame + 1 < len(known.places):
            return known.places[frame.frame + 1] - known.places[frame.frame]
    return 0
