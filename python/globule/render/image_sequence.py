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
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from .._base.checks import named
from .._base.files import atomic_write
from ..data.attributes import checked_range
from ..data.attributes import color_by as colored
from ..data.particles import Particles
from ..formats import read
from ..formats.pictures.video import movie_facts, need_av, read_movie, write_movie
from ..pieces.scene import Scene
from ..pieces.shown import shown_scene
from .annotate import Annotation, bounds_of, drawing, traced_size
from .camera import Camera
from .camera_path import CameraPath
from .clips import Clip
from .fit import fitted
from .frame import save_png
from .render import camera_and_size, render
from .sequence import OneOrigin, all_frames, are_files, find_value_range, leader, read_ahead
from .settings import RenderSettings, as_settings, for_values
from .trace import values_of

MANY_MORE = 2  # times those of the frame that leads, where the frames to come are not known


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
    source = all_frames(source, n_frames)
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
