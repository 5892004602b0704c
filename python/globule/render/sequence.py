"""Files of frames: which there are, which of them leads, and their particles one after the other."""

from __future__ import annotations

import contextlib
import glob
import os
import queue
import re
import threading
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence, Sized
from itertools import pairwise
from typing import Any

import numpy as np

from ..data.attributes import attribute_values
from ..data.particles import Particles
from ..formats import read, read_contents
from ..formats.frames import FrameOf, bytes_of_frame, said
from ..formats.kind import kind_or_none
from ..formats.registry import format_named
from ..formats.table import may_have_frames
from ..formats.vtk_parts import parts_of, sizes_of

MORE = 1.1  # times the first frame: a larger one leads
MOST_NAMED = 100_000  # numbers between two files: more are no frames that are missing


def natural(name: str) -> list[Any]:
    """Key that sorts numbers inside names by value: frame_2 before frame_10."""
    return [int(part) if part.isdecimal() else part for part in re.split(r"(\d+)", name)]


def find_files(names: Sequence[str]) -> list[str]:
    """The files that names and patterns stand for: `frame_*.vtk`, `frame_%04d.vtk`.

    A pattern's files come in natural order. Names given one by one keep their order, unless they
    are sorted by characters, as a shell does it: then they come in natural order too.

    Warns of numbers that are missing in between. Raises ValueError for a pattern without files.
    """
    found = _found(names)
    missing = missing_numbers(found)
    if missing:
        several = "frames" if len(missing) > 1 else "frame"
        said = ", ".join(map(str, missing[:5])) + (", …" if len(missing) > 5 else "")
        place = f"{os.path.basename(found[0])} to {os.path.basename(found[-1])}"
        warnings.warn(f"{place}: {several} {said} missing ({len(missing):,} in all)", stacklevel=2)
    return found


@contextlib.contextmanager
def _quietly() -> Iterator[None]:
    """Without warnings about a file that is read again later."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield


def frames_of(path: str, **options: Any) -> int:
    """How many frames a file holds; 1 where its format knows none, or where it cannot be read:
    whoever reads it says why. options: as for `read`."""
    try:
        found = kind_or_none(path)
        if found is None or found.kind not in ("particles", "mesh"):
            return 1
        known = format_named(found.format).options
        if "frame" not in known:
            return 1
        given = {name: value for name, value in options.items() if name in known}
        if found.format in ("csv", "tsv") and options.get("columns") is None and not may_have_frames(path):
            return 1
        if found.format in ("csv", "tsv", "xyz") and options.get("where") is not None:
            given["where"] = options["where"]  # one of a column that tells frames leaves none
        with _quietly():
            return read_contents(path, **given).n_frames
    except (ValueError, OSError, ImportError):
        return 1


def with_frames(files: Sequence[str], **options: Any) -> list[str]:
    """The files, each frame of those with several in the place of the file. Where the first and the
    largest of one ending have one frame, the others are taken to have one too. options: as for
    `read`; with a frame, the files as they are."""
    if any(isinstance(f, FrameOf) for f in files) or options.get("frame") is not None:
        return list(files)
    found: list[str] = []
    alike: dict[str, list[str]] = {}
    for f in files:
        alike.setdefault(os.path.splitext(f)[1].lower(), []).append(f)
    ones = {end for end, some in alike.items()
            if all(frames_of(f, **options) == 1 for f in {some[0], max(some, key=_size)})}  # fmt: skip
    for f in files:
        n = 1 if os.path.splitext(f)[1].lower() in ones else frames_of(f, **options)
        found += [f] if n == 1 else [FrameOf(f, k) for k in range(n)]
    return found


def sequence(frames: str | os.PathLike[str] | Sequence[str], **options: Any) -> Iterator[Particles]:
    """The particles of each frame of files, one after the other, and of files that hold several.

    Args:
        frames: a file, a pattern such as `run_*.vtk`, or names.
        options: as for `read`.

    Positions are given from the origin of the first frame that has particles. Raises ValueError for
    a pattern without files; each frame raises what `read` does.
    """
    names = [os.fspath(frames)] if isinstance(frames, (str, os.PathLike)) else list(map(os.fspath, frames))
    for name in with_frames(find_files(names), **options):
        found = read(name, **options)
        if len(found):
            options["origin"] = found.origin
        yield found


def time_of(path: str, **options: Any) -> float | None:
    """The time that a file says of itself, or of the frame that its name stands for; None where it
    says none. Collections of files say it without reading them. Raises what `read` does."""
    found = kind_or_none(path)
    if found is not None and found.kind not in ("particles", "mesh"):
        return None
    if found is not None and found.format in ("pvd", "series"):
        return parts_of(path, found.format, path.frame if isinstance(path, FrameOf) else 0).time
    return read_contents(path, **options).time


def missing_numbers(files: Sequence[str]) -> list[int]:
    """The numbers that are left out in files whose names differ by one number, which rises by
    multiples of its least step."""
    parts = [re.split(r"(\d+)", os.path.basename(file)) for file in files]
    columns = list(zip(*parts, strict=False))
    varying = [column for column in columns if len({*column}) > 1]
    if len({*map(len, parts)}) != 1 or len(varying) != 1 or not varying[0][0].isdecimal():
        return []
    numbers = list(map(int, varying[0]))
    steps = [b - a for a, b in pairwise(numbers)]
    least = min(steps)
    n_missing = (numbers[-1] - numbers[0]) // least + 1 - len(numbers) if least > 0 else 0
    if not 0 < n_missing <= MOST_NAMED or any(step % least for step in steps):
        return []
    held = {*numbers}
    return [number for number in range(numbers[0], numbers[-1], least) if number not in held]


def _found(names: Sequence[str]) -> list[str]:
    plain = all(os.path.exists(name) for name in names)
    if plain and list(names) == sorted(names):
        return sorted(names, key=natural)
    found: list[str] = []
    for name in names:
        number = re.search(r"%0?(\d*)d", os.path.basename(name))
        if os.path.exists(name) or not (number or glob.has_magic(name)):
            found.append(name)
            continue
        if number:
            start, end = name[: -len(os.path.basename(name))], os.path.basename(name)
            before, after = end[: number.start()], end[number.end() :]
            digits = f"\\d{{{int(number[1] or 1)},}}"
            wanted = re.compile(re.escape(before) + digits + re.escape(after))
            folder = os.listdir(start or ".") if os.path.isdir(start or ".") else []
            matches = [start + file for file in folder if wanted.fullmatch(file)]
        else:
            matches = glob.glob(name)
        if not matches:
            raise ValueError(f"{name}: expected a pattern that matches files, got none")
        found += sorted(matches, key=natural)
    return found


def read_ahead(items: Iterable[Any], n_ahead: int = 1) -> Iterator[Any]:
    """The same items, which another thread fetches while the caller works on the previous item.

    At most `n_ahead` finished items wait. An error appears at the position of its item. Use
    `read_ahead` for a generator that reads files; each item must have arrays of its own.
    """
    ready: queue.Queue = queue.Queue(n_ahead)
    stopped = threading.Event()

    def put(item: Any) -> bool:
        while not stopped.is_set():
            try:
                ready.put(item, timeout=0.1)
                return True
            except queue.Full:
                pass
        return False

    def fetch() -> None:
        try:
            for item in items:
                if not put((item, None)):
                    return
            put((None, StopIteration()))
        except BaseException as error:
            put((None, error))

    threading.Thread(target=fetch, name="read ahead", daemon=True).start()
    try:
        while True:
            item, error = ready.get()
            if isinstance(error, StopIteration):
                return
            if error is not None:
                raise error
            yield item
    finally:
        stopped.set()


def find_value_range(
    frames: Particles | str | os.PathLike[str] | Iterable[Particles | str | os.PathLike[str]],
    name: str,
    progress: Callable[[int, int], object] | None = None,
) -> tuple[float, float]:
    """Lowest and highest finite value over all frames; (0, 1) if no value is finite. Places are
    given from the origin of the first frame that has particles.

    Args:
        frames: `Particles`, or files' names; or a single one, a pattern such as "frame_*.vtk"; each
            frame of files with several.
        name: as for `color_by`: an axis, a field, an attribute (a vector's length), or NAME:0 …
        progress: called as progress(done, total) after each frame; total is 0 if `frames` has no
            length. May raise to stop.

    Raises ValueError if a frame has no values of this name; FormatError, OSError for a file that
    cannot be read.
    """
    frames = [frames] if isinstance(frames, Particles) else all_frames(frames)
    lo, hi = np.inf, -np.inf
    together = OneOrigin()
    n = len(frames) if isinstance(frames, Sized) else 0
    for i, frame in enumerate(frames):
        particles = frame if isinstance(frame, Particles) else read(frame)
        particles = together(particles)
        try:
            values = attribute_values(particles, name)
        except ValueError as error:
            of = said(frame) if isinstance(frame, (str, os.PathLike)) else f"frame {i}"
            raise ValueError(f"name: {error} ({of})") from None
        values = values[np.isfinite(values)]
        lo, hi = min(lo, values.min(initial=np.inf)), max(hi, values.max(initial=-np.inf))
        if progress:
            progress(i + 1, n)
    return (float(lo), float(hi)) if lo <= hi else (0.0, 1.0)


def leader(frames: Sequence[Any], **options: Any) -> int:
    """The number of the frame that leads, of files' names or `Particles`: the largest one, unless
    the first is about as large; of the frames of one file that is no text and no collection, the
    largest of nine. options: as for `read`."""
    n = len(frames)
    if n > 1 and any(isinstance(one, FrameOf) for one in frames):
        held = {path: _sizes_of(path) for path in {*map(str, frames)}}
        longest = [_size_of_frame(one, held[str(one)]) for one in frames]
        some = () if all(longest) else (k * (n - 1) // 8 for k in range(8))
        tried = {0, *some, n // 2, longest.index(max(longest)), n - 1}
        counts = {0: 0}
        for k in (*sorted(tried), n - 2):  # whoever reads a broken one in its turn says why
            if k == n - 2 and n - 1 in counts:
                break
            with _quietly(), contextlib.suppress(ValueError, OSError, ImportError):
                counts[k] = len(read(frames[k], **options))
        largest = max(counts, key=lambda k: (counts[k], k))
        return largest if counts[largest] > MORE * counts[0] else 0
    sizes = [_size(frame) for frame in frames]
    most = max(sizes, default=0)
    return sizes.index(most) if sizes and most > MORE * sizes[0] else 0


def _size(frame: Any) -> int:
    """Bytes of a file and of those that it names, or the number of particles; 0 where it is not known."""
    if isinstance(frame, (str, os.PathLike)):
        return sum(_sizes_of(frame))
    return len(frame) if isinstance(frame, Sized) else 0


def _sizes_of(path: str | os.PathLike[str]) -> list[int]:
    """Bytes of a file, or of the files of each frame of a collection; none where they are not known."""
    with contextlib.suppress(ValueError, OSError):
        return sizes_of(os.fspath(path))
    return []


def _size_of_frame(one: str, held: list[int]) -> int:
    """Bytes of a file whose frames have so many, or of one of these frames; 0 where it is not known."""
    if not isinstance(one, FrameOf):
        return sum(held)
    return bytes_of_frame(one) or (held[one.frame] if 0 <= one.frame < len(held) > 1 else 0)


class OneOrigin:
    """The frames of a sequence, given from the origin of the first that has particles."""

    def __init__(self) -> None:
        self.origin: tuple[float, float, float] | None = None

    def __call__(self, particles: Particles) -> Particles:
        """The next frame."""
        if self.origin is None and len(particles):
            self.origin = particles.origin
        return particles if self.origin is None else particles.at(self.origin)


def all_frames(frames: Any, most: int | None = None) -> Any:
    """The frames of files that names or a pattern stand for, of at most so many names; what is none
    of these as it is."""
    if isinstance(frames, (str, os.PathLike)):
        return with_frames(find_files([os.fspath(frames)]))
    return with_frames(list(map(os.fspath, frames))[:most]) if are_files(frames) else frames


def are_files(source: Any) -> bool:
    """Whether a source is a list of files' names."""
    listed = isinstance(source, Sequence) and len(source) > 0
    return listed and all(isinstance(one, (str, os.PathLike)) for one in source)
