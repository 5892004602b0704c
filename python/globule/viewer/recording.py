"""Images and movies as files, of any size, from frames that the server traces for them."""

from __future__ import annotations

import itertools
import os
import shutil
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import nullcontext
from typing import Any

import numpy as np

from .._base.checks import MAX_PIXELS
from .._base.files import atomic_write
from .._base.memory import free_bytes
from ..formats.pictures.exr import frame_channels, write_exr
from ..formats.pictures.video import need_av, write_movie
from ..render.camera import Camera
from ..render.camera_path import orbit
from ..render.frame import save_png
from .engine import Engine
from .overlay import Mark, finish
from .picture import in_the_dark, trace
from .plots import drawn_over

MOST_SIDE = 16384
MOST_SECONDS = 3600.0  # of a recording
LEAST_SIDE = 16
BYTES_PER_PIXEL = 200  # of memory, for tracing and saving an image


def checked_size(size: Any) -> tuple[int, int]:
    """(width, height), pixels. Raises ValueError for sides or a memory need out of range."""
    width, height = (int(v) for v in size)
    if not (min(width, height) >= LEAST_SIDE and max(width, height) <= MOST_SIDE):
        raise ValueError(f"size: expected sides of {LEAST_SIDE} to {MOST_SIDE} pixels, got {width}x{height}")
    if width * height > MAX_PIXELS:
        raise ValueError(f"size: expected at most {MAX_PIXELS:,} pixels, got {width}x{height}")
    free = free_bytes()
    if free and width * height * BYTES_PER_PIXEL > free:
        most = f"{free // BYTES_PER_PIXEL:,} pixels, which fit into the free memory"
        raise ValueError(f"size: expected at most {most}, got {width}x{height}")
    return width, height


class Shot:
    """One image of what the viewer shows.

    Args:
        engine: of the viewer.
        camera: world.
        size: (width, height), pixels.
        samples: per pixel.
        marks: to draw over the image.
        progress: called with the finished share, 0 to 1.
        dark: on the background of a dark page.

    Attributes:
        picture: (H, W, 3) uint8 sRGB, with slices, marks and annotations.
        frame: the traced `Frame` without them.

    Raises:
        ValueError: a size out of range, or settings that exclude each other.
    """

    def __init__(
        self,
        engine: Engine,
        camera: Camera,
        size: tuple[int, int],
        samples: int,
        marks: list[Mark] | None = None,
        progress: Callable[[float], Any] = lambda share: None,
        dark: bool = False,
    ):
        self._dark = dark
        self._engine, self._camera, self._size = engine, camera, checked_size(size)
        self._marks, self._samples, self._progress = marks or [], samples, progress
        lock = engine.source.lock
        # Other threads may trace and step between two samples, unless that changes the image.
        if not self._made(lock):
            with lock:
                self._made(nullcontext())

    def _made(self, lock: Any) -> bool:
        """Trace and finish it with `lock` held for one sample at a time.

        Returns False if the scene or the settings changed between two samples.
        """
        engine, source, camera = self._engine, self._engine.source, self._camera
        state = in_the_dark(engine.state.snapshot()) if self._dark else engine.state.snapshot()
        with lock:
            frame = trace(source, state, camera, self._size, engine.up)
            before = state.version, source.version
            over = drawn_over(source, frame, state, self._marks)
        while frame.samples < self._samples:
            self._progress(frame.samples / self._samples)
            with lock:
                if (engine.state.version, source.version) != before:
                    return False
                frame.refine()
        depth = frame.distance if over["plates"] or state.notes.box else None
        self.frame = frame
        self.picture = finish(frame.picture, state, camera, depth=depth, **over)
        return True

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write a .png, or an .exr with linear light and the channels of the frame."""
        name = os.fspath(path).lower()
        if name.endswith(".exr"):
            write_exr(path, frame_channels(self.frame))
        elif name.endswith(".png"):
            save_png(path, self.picture)
        else:
            raise ValueError(f"{path}: expected a name that ends in .png or .exr")

    def encoded(self, extension: str) -> bytes:
        """The bytes of such a file; extension: ".png" or ".exr"."""
        with tempfile.TemporaryDirectory() as folder:
            path = os.path.join(folder, f"picture{extension}")
            self.save(path)
            with open(path, "rb") as file:
                return file.read()


class Recorder:
    """Records a movie in real time until `stop`: an image that took longer is shown longer.

    Args:
        engine: of the viewer.
        camera: gives the camera of the moment.
        path: of the .mp4.
        size: (width, height), pixels.
        fps: frames per second of the movie.
        samples: per pixel.
        clock: gives the time, s.

    Attributes:
        n_pictures: images written so far.
        error: an exception that ended the recording, or None.

    Raises:
        MissingPackageError: the extra `video` is not installed.
    """

    def __init__(
        self,
        engine: Engine,
        camera: Callable[[], Camera],
        path: str | os.PathLike[str],
        size: tuple[int, int] = (1280, 720),
        fps: float = 30.0,
        samples: int = 1,
        clock: Callable[[], float] = time.monotonic,
    ):
        need_av()
        self.engine, self.camera, self.path = engine, camera, path
        self.size, self.fps, self.samples = checked_size(size), float(fps), samples
        self.n_pictures = 0
        self._clock = clock
        self.error: Exception | None = None
        self._stopped = threading.Event()
        self._thread = threading.Thread(target=self._run, name="globule record", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """Finish the file. Raises the error that ended the recording, if any."""
        self._stopped.set()
        self._thread.join()
        if self.error is not None:
            raise self.error

    def _run(self) -> None:
        try:
            write_movie(self.path, self._pictures(), self.fps)
        except Exception as error:
            self.error = error

    def _pictures(self) -> Iterator[np.ndarray]:
        started = self._clock()
        before, picture = None, None
        while True:
            camera, engine = self.camera(), self.engine
            what = (camera, engine.state.version, engine.source.version)
            if what != before or picture is None:
                picture, before = Shot(engine, camera, self.size, self.samples).picture, what
            due = int((self._clock() - started) * self.fps) + 1
            while self.n_pictures < due:
                self.n_pictures += 1
                yield picture
            past = self._clock() - started
            if self._stopped.is_set() or past > MOST_SECONDS:
                return
            self._stopped.wait(max(0.0, self.n_pictures / self.fps - past))


def turntable(
    engine: Engine,
    camera: Camera,
    path: str | os.PathLike[str],
    size: tuple[int, int] = (1280, 720),
    seconds: float = 8.0,
    fps: float = 30.0,
    samples: int = 4,
    progress: Callable[[float], Any] = lambda share: None,
) -> None:
    """Write a movie of one turn around the scene.

    Args:
        engine, camera, path, size, fps, samples: as for `Recorder`; the first camera.
        seconds: length of the movie.
        progress: called with the finished share, 0 to 1.
    """
    need_av()
    cameras = orbit(camera, n=max(2, round(seconds * fps)))

    def part(i: int) -> Callable[[float], None]:
        return lambda share: progress((i + share) / len(cameras))

    def pictures() -> Iterator[np.ndarray]:
        for i, one in enumerate(cameras):
            progress(i / len(cameras))
            yield Shot(engine, one, size, samples, progress=part(i)).picture

    write_movie(path, pictures(), fps)
    progress(1.0)


def keep(path: str, name: str) -> str:
    """Copy a movie to `name`.mp4, or `name`-2.mp4 … if that exists; returns the path."""
    for number in itertools.count(1):
        kept = os.path.abspath(f"{name}{f'-{number}' if number > 1 else ''}.mp4")
        if not os.path.exists(kept):
            break
    with open(path, "rb") as movie, atomic_write(kept) as file:
        shutil.copyfileobj(movie, file)
    return kept
