"""Sequences: many files, or a simulation's frames, as images or as a movie.

One frame hands the scene, the camera and the range of the colors to the next: nothing is
reallocated, and nothing jumps. The frame that leads, the first or one with many more particles (an
emitter starts with few), decides for all which surface they have, and measures its support.
"""

from __future__ import annotations

import contextlib
import glob
import itertools
import os
import queue
import re
import threading
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence, Sized
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np

from .._base.checks import named
from .._base.files import atomic_write
from ..data.attributes import attribute_values, checked_range
from ..data.attributes import color_by as colored
from ..data.particles import Particles
from ..formats import read, read_contents
from ..formats.frames import FrameOf, bytes_of_frame, said
from ..formats.kind import kind_or_none
from ..formats.pictures.video import movie_facts, need_av, read_movie, write_movie
from ..formats.registry import format_named
from ..formats.table import may_have_frames
from ..formats.vtk_parts import parts_of
from ..pieces.scene import Scene
from ..pieces.shown import shown_scene
from .annotate import Annotation, bounds_of, drawing, traced_size
from .camera import Camera
from .camera_path import CameraPath
from .clips import Clip
from .fit import fitted
from .frame import save_png
from .render import camera_and_size, render
from .settings import RenderSettings, as_settings, for_values
from .trace import values_of

MORE = 1.1  # times the first frame: a larger one leads
MANY_MORE = 2  # times those of the frame that leads, where the frames to come are not known
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
    if isinstance(frames, Particles):
        frames = [frames]
    elif isinstance(frames, (str, os.PathLike)):
        frames = with_frames(find_files([os.fspath(frames)]))
    elif are_files(frames):
        frames = with_frames([os.fspath(one) for one in frames])  # type: ignore[arg-type]
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
    the first is about as large; of the frames of one file that is no text, the larger one of the
    first, middle and last. options: as for `read`."""
    n = len(frames)
    if n > 1 and any(isinstance(one, FrameOf) for one in frames):
        longest = [bytes_of_frame(one) if isinstance(one, FrameOf) else _size(one) for one in frames]
        tried = (0, n // 2, longest.index(max(longest)), n - 1)
        counts = {0: 0}
        for k in (*tried, n - 2):  # whoever reads a broken one in its turn says why
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
    """Bytes of a file, or the number of particles; 0 where it is not known."""
    if isinstance(frame, (str, os.PathLike)):
        return os.path.getsize(frame) if os.path.isfile(frame) else 0
    return len(frame) if isinstance(frame, Sized) else 0


class OneOrigin:
    """The frames of a sequence, given from the origin of the first that has particles."""

    def __init__(self) -> None:
        self.origin: tuple[float, float, float] | None = None

    def __call__(self, particles: Particles) -> Particles:
        """The next frame."""
        if self.origin is None and len(particles):
            self.origin = particles.origin
        return particles if self.origin is None else particles.at(self.origin)


class KeptScene:
    """One scene for all frames of a sequence.

    lead: gives the particles that lead; None, or where it fails (whoever reads that frame in its
        turn says why): the first that there are.
    grows: whether nobody knows the frames to come: one with many more particles makes a new scene.
    """

    def __init__(self, lead: Callable[[], Particles] | None = None, grows: bool = False) -> None:
        self._lead = lead
        self._grows, self._n = grows, 0
        self.scene: Scene | None = None
        self.first = True  # whether the scene was made for the frame that it shows now
        self.settled = False  # whether a frame with particles has made it

    def show(
        self,
        particles: Particles,
        make: Callable[[Particles], Scene],
        made: Callable[[Scene], object] = lambda scene: None,
    ) -> Scene:
        """The scene with these particles: made at the first frame that has any, or from those that
        lead, and updated after. made: called with a new scene, of those that it was made from."""
        # Without particles no support could be measured, and no camera found.
        scene = self.scene
        self.first = not self.settled or (self._grows and len(particles) > MANY_MORE * self._n)
        if scene is None or self.first:
            lead, self._lead = self._lead, None
            leading = None
            if lead:
                with contextlib.suppress(Exception):
                    leading = lead()
            self.scene = scene = make(particles if leading is None else leading)
            self.settled, self._n = scene.octree.n_inside > 0, len(particles)
            made(scene)
            if leading is not None:
                scene.update(particles)
        else:
            scene.update(particles)
        return scene


def is_whole(path: str, size: tuple[int, int]) -> bool:
    """Whether a file is a PNG of this size, (width, height), that can be decoded to its end."""
    from PIL import Image

    try:
        with Image.open(path) as image:
            image.load()
            return image.format == "PNG" and image.size == tuple(size)
    except (OSError, SyntaxError, ValueError):
        return False


class MovieFrames:
    """The finished images of a movie in the making, in a folder beside it.

    The images stay when the run is interrupted, so that another run goes on from there. They are
    deleted when the movie is whole.
    """

    def __init__(self, movie: str, resume: bool):
        self.movie, self.folder = movie, f"{movie}.frames"
        self._stale = not resume
        self._whole = False

    def path(self, i: int) -> str:
        """The file of frame i, counted from 0."""
        return os.path.join(self.folder, f"{i:06d}.png")

    def finished(self) -> list[str]:
        """The images that are there."""
        return sorted(glob.glob(os.path.join(glob.escape(self.folder), "[0-9]" * 6 + ".png")))

    def remove(self) -> None:
        """Delete the images, and the folder unless somebody keeps other files there."""
        for file in self.finished():
            os.unlink(file)
        if os.path.isdir(self.folder) and not os.listdir(self.folder):
            os.rmdir(self.folder)

    def keep(self) -> None:
        """Keep the images that are there: another process has opened the folder."""
        self._stale = False

    def open(self) -> None:
        """Make the folder; late, so that a mistake in the first file changes nothing."""
        if self._stale:
            self.remove()
            self._stale = False
        os.makedirs(self.folder, exist_ok=True)

    def restore(self, n_done: int, n: int, size: tuple[int, int], kept: Callable[[int], str] | None = None) -> None:
        """Make sure that images 0 to n_done - 1 of n are there. Where the movie was whole before,
        they come from the PNGs that `kept` names, or are decoded from the movie.

        Raises ValueError where an image is in none of these; nothing is written then.
        """
        missing = [i for i in range(n_done) if not is_whole(self.path(i), size)]
        sources = {i: kept(i) for i in missing if kept and is_whole(kept(i), size)}
        decoded = sorted(set(missing) - set(sources))
        if decoded:
            n_had, had = movie_facts(self.movie)
            if n_had <= decoded[-1] or had != (size[0] + size[0] % 2, size[1] + size[1] % 2):
                raise ValueError(
                    f"expected the run's first {n_done} images of {size[0]}x{size[1]} in "
                    f"{self.movie} or {self.folder}, got none of number {decoded[0]}"
                )
            self._whole = n_had == n_done == n
        if self._whole or not missing:
            return
        self.open()
        for i, source in sources.items():
            with open(source, "rb") as old, atomic_write(self.path(i)) as new:
                new.write(old.read())
        for i, picture in enumerate(read_movie(self.movie)) if decoded else ():
            if i in decoded:
                save_png(self.path(i), picture[: size[1], : size[0]])

    def encode(self, n: int, fps: float) -> None:
        """Write the movie of images 0 to n - 1 with fps frames a second, then delete them."""
        from PIL import Image

        if self._whole:
            return

        def pictures() -> Iterator[np.ndarray]:
            for i in range(n):
                with Image.open(self.path(i)) as image:
                    yield np.asarray(image.convert("RGB"))

        write_movie(self.movie, pictures(), fps)
        self.remove()


@named
def render_sequence(
    source: Any,
    output: str | os.PathLike[str],
    camera: Camera | CameraPath | Sequence[Any] | None = None,
    size: tuple[int, int] = (1024, 782),
    settings: RenderSettings | Mapping[str, Any] | None = None,
    fps: float = 30.0,
    n_frames: int | None = None,
    resume: bool = False,
    *,
    clips: Clip | Sequence[Clip] = (),
    color_by: str | None = None,
    colormap: str = "auto",
    range: tuple[float, float] | None = None,
    annotate: Annotation | None = None,
    progress: Callable[[int, int], object] | None = None,
    **scene_options: Any,
) -> list[str]:
    """Render a sequence to PNG files or to one MP4 file.

    Args:
        source: a file pattern ("frame_*.vtk", "frame_%04d.vtk"), a file with several frames, or a
            list of files, which another thread reads ahead; an iterable of `Particles`; an object
            with `.particles` and `.step()`, called between two frames; or one `Particles` for all.
        output: "movie.mp4", or a name with %d (%04d) for the frame's number, from 0, ending in
            .png. Each file appears whole or not at all.
        camera: one camera for all frames, a `CameraPath`, a list of key frames, or one `Camera` per
            frame. Default: a fixed camera that sees all particles of the frame that leads: of files
            or a list, the largest one, unless the first is about as large; else the first. Its
            particles also decide which surface all have, and its support.
        size: (width, height) pixels.
        settings: `RenderSettings`, or a dict of its fields.
        fps: frames per second of a movie, and of key frames that have a time.
        n_frames: largest number of frames. An endless source needs this number, unless a path or
            list of cameras ends.
        resume: keep the images of an earlier, interrupted run with the same arguments.
        clips: cuts through the scene, as for `render`.
        color_by, colormap, range: as for `render`. Without a range, a first pass over all files
            finds the lowest and the highest value; other sources need a range.
        annotate: `Annotation`, with the time and the step of each frame.
        progress: called as progress(done, total) after each frame; total is 0 if the source has no
            length. May raise to stop.
        scene_options: as for `Scene`.

    Returns:
        The files: images, or the one movie.

    Raises:
        MissingPackageError: a movie without PyAV.
        FormatError, OSError: a file cannot be read; finished images stay.
    """
    settings = as_settings(settings)
    if isinstance(camera, (Camera, type(None))) or _is_size(camera):
        camera, size = camera_and_size(camera, size)
    else:
        _, size = camera_and_size(None, size)
    output = os.fspath(output)
    as_movie = output.lower().endswith(".mp4")
    if as_movie:
        need_av()
    elif not (output.lower().endswith(".png") and re.search(r"%0?\d?d", output)):
        raise ValueError(f"output: expected a name ending in .mp4, or with %d and .png: {output}")
    view, n_views = _views(camera, fps)
    if n_frames is None and (isinstance(source, Particles) or hasattr(source, "step")):
        if n_views is None:
            raise ValueError("n_frames: expected a number for an endless source, got None")
        n_frames = n_views
    if isinstance(source, (str, os.PathLike)):
        source = with_frames(find_files([os.fspath(source)]))
    elif are_files(source):
        source = with_frames(list(map(os.fspath, source))[:n_frames])
    if color_by is not None:
        settings = for_values(settings)
        range = _range_of(source, color_by) if range is None else checked_range(range)
    if as_movie and settings.transparent:
        raise ValueError("settings: expected no transparent background for a movie, got one")
    notes = annotate or Annotation()
    if notes.legend and color_by is None:
        raise ValueError("annotate: expected color_by beside a legend, got none")
    traced = traced_size(annotate, size)
    total = n_frames or 0
    if isinstance(source, Sequence):
        total = len(source[:n_frames])
    movie = MovieFrames(output, resume) if as_movie else None
    listed = isinstance(source, Sequence) and not isinstance(source, Particles)
    at = leader(source[:n_frames]) if listed else 0
    kept = KeptScene((lambda: _particles_of(source[at])) if at else None, grows=not listed)
    names: list[str] = []
    together = OneOrigin()

    def name(i: int) -> str:
        return movie.path(i) if movie else output % i

    def finished(i: int) -> bool:
        return resume and is_whole(name(i), size)

    # The first frame is always read: the scene is made there.
    for i, particles in _frames(source, n_frames, lambda i: i == 0 or not finished(i)):
        names.append(name(i))
        if particles is None:
            if progress:
                progress(i + 1, total)
            continue
        values = None
        particles = together(particles)
        if color_by is not None:
            values = values_of(particles, color_by, colormap, range)
            particles = colored(particles, color_by, colormap, range)

        def made(scene: Scene) -> None:
            nonlocal view, notes
            if camera is None:
                view, _ = _views(fitted(scene, traced, notes), fps)
            if notes.box is True:  # so that it stays
                notes = replace(notes, box=bounds_of([scene]) or True)

        scene = kept.show(particles, lambda p: shown_scene(p, **scene_options), made)
        if not finished(i):
            frame = render(scene, view(i), traced, settings, clips)
            frame._values = values and values[:4]
            if notes.draws:
                frame._finish = drawing(notes.at(i), view(i), [scene], values, size)
            if movie:
                movie.open()
            frame.save(name(i))
        if progress:
            progress(i + 1, total)
    if movie and names:
        movie.encode(len(names), fps)
        return [output]
    return names


def are_files(source: Any) -> bool:
    """Whether a source is a list of files' names."""
    listed = isinstance(source, Sequence) and len(source) > 0
    return listed and all(isinstance(one, (str, os.PathLike)) for one in source)


def _is_size(camera: Any) -> bool:
    """Whether a size stands in the camera's place."""
    pair = isinstance(camera, (tuple, list)) and len(camera) == 2
    return pair and all(isinstance(v, (int, np.integer)) for v in camera)


def _range_of(source: Any, name: str) -> tuple[float, float]:
    """The values of `name` in all frames."""
    if not isinstance(source, (Particles, Sequence)):
        raise ValueError("range: expected (lo, hi) for frames that are not there yet, got None")
    return find_value_range(source, name)


def _views(camera: Any, fps: float) -> tuple[Callable[[int], Camera], int | None]:
    """The camera of each frame, and how many frames there are if it says so."""
    if camera is None or isinstance(camera, Camera):
        return lambda i: camera, None
    if not isinstance(camera, CameraPath):
        cameras = list(camera)
        if cameras and all(isinstance(c, Camera) for c in cameras):
            return lambda i: cameras[min(i, len(cameras) - 1)], len(cameras)
        camera = CameraPath(cameras, fps)
    return camera, camera.n_frames


def _frames(source: Any, n_frames: int | None, wanted: Callable[[int], bool]) -> Iterator[tuple[int, Particles | None]]:
    """The frames of any source; files that are not wanted are not read, and give None."""
    if isinstance(source, Particles):
        source = itertools.repeat(source)
    elif hasattr(source, "step"):
        source = _steps(source)
    if are_files(source):
        files = list(source)[:n_frames]
        yield from read_ahead((i, read(f) if wanted(i) else None) for i, f in enumerate(files))
        return
    for i, particles in enumerate(itertools.islice(source, n_frames)):
        yield i, _particles_of(particles) if wanted(i) else None


def _particles_of(frame: Any) -> Particles:
    if isinstance(frame, Particles):
        return frame
    return read(frame) if isinstance(frame, (str, os.PathLike)) else Particles(frame)


def _steps(simulation: Any) -> Iterator[Particles]:
    """Its state now, and after each step; not ahead of time: it may overwrite its arrays."""
    while True:
        yield simulation.particles
        simulation.step()
