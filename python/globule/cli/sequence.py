"""Flags and work of `render` that several images of one run share."""

from __future__ import annotations

import argparse
import itertools
import os
import re
import zipfile
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from .._base.arrays import box_corners
from .._base.ranks import dealt
from .._base.settings import Whole
from ..data.particles import Particles
from ..formats.frames import FrameOf, said
from ..formats.pictures.video import need_av
from ..pieces.scene import Scene
from ..render.camera import Camera
from ..render.camera_path import CameraPath, orbit
from ..render.image_sequence import KeptScene, MovieFrames, is_whole
from ..render.sequence import find_files, frames_of, leader, natural, read_ahead, with_frames
from ..scene.mesh import Mesh
from . import flags, look
from .measuring import led_by
from .meshes import is_mesh, read_mesh
from .shared import (
    Progress,
    UserError,
    check_output,
    count,
    first_of,
    lies_across,
    mistakes,
    need_chosen,
    need_particles,
    print_json,
    read_file,
    reading,
    say,
    settle_origin,
    settle_up,
    warn,
)
from .volumes import is_surface, read_surface


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The flags of sequences and movies."""
    group = parser.add_argument_group("sequence")
    flags.own(group, "--camera-path FILE", "key frames of the camera, .toml or .json; a single "
        "input file is shown along the whole path")  # fmt: skip
    flags.own(group, "--turntable N", "number of images of one turn around --up; a single input "
        "file is shown in all of them", Whole(2, 100_000).parse)  # fmt: skip
    flags.add(group, "--fps", "also of --camera-path; default: 30", default=30.0)
    flags.add(group, "--resume", "finished images are kept")


class Series:
    """The images of one run: files read ahead, and one scene, camera and color range for all.

    `options.particles` becomes the list of files, one per image. On the ranks of `comm` the images
    are dealt one by one. files: to show, instead of `options.particles`.
    """

    def __init__(self, options: argparse.Namespace, comm: Any = None, files: list[str] | None = None):
        self.options, self.comm = options, comm
        self._looking = False  # at a file that another rank may draw
        self.path: CameraPath | None = None
        self.movie: MovieFrames | None = None
        self._cameras: list[Camera] = []
        self.box: np.ndarray | None = None  # corners (8, 3) of the box of all files
        self._shown: set[str] = set()
        self._ahead: Iterator[tuple[Particles | Mesh, list[str]]] = iter(())
        with mistakes():
            files = find_files(options.particles) if files is None else files
            if options.frame is None and shows_all(options.output):
                files = with_frames(files, **reading(options))
            if options.camera_path and options.turntable:
                raise UserError("--turntable: expected no --camera-path beside --turntable")
            if options.camera_path:
                self.path = _camera_path(options)
                if len(files) == 1:
                    files = files * self.path.n_frames
            elif options.turntable and len(files) == 1:
                files = files * options.turntable
        options.particles = files
        settle_up(options, files[0], comm)
        self._at = 0  # of the file that leads
        if not any(is_mesh(path, options) for path in dict.fromkeys(files)):
            self._at = leader(files, **reading(options))
        if len({*files}) > 1:
            settle_origin(options, files[self._at], comm)
        self._kept = KeptScene(self._leading if self._at else None)
        if options.output.lower().endswith(".mp4"):
            check_output("-o", options.output, [".mp4"])
            try:
                need_av()
            except ImportError as error:
                raise UserError(f"-o: {error}") from error
            self.movie = MovieFrames(options.output, options.resume)

    def images(self) -> list[str] | None:
        """The images of a movie, kept beside the movie until it is whole; None without a movie."""
        return [self.movie.path(i) for i in range(len(self))] if self.movie else None

    def __len__(self) -> int:
        return len(self.options.particles)

    def survey(self, progress: Progress) -> None:
        """Read all files once for what must not change between the images.

        A file that cannot be read is skipped: the error shows later, when the images before are
        done.
        """
        options = self.options
        fit = not options.eye and not self.path
        span = bool(options.color_by) and not options.range
        files = list(dict.fromkeys(options.particles))
        if len(files) == 1 or not (fit or span):
            return
        lows, highs, values, broken = [], [], [np.inf, -np.inf], False
        if self.comm is not None:
            files = files[self.comm.rank :: self.comm.size]
        found = read_ahead(_try_to_read(path, options) for path in files)
        for path, particles in zip(files, found, strict=True):
            progress.show(f"looking at {path}")
            if particles is None:
                broken = True
                continue
            if isinstance(particles, Mesh) or len(particles.finite_positions()):
                lo, hi = particles.bounds()
                lows.append(lo)
                highs.append(hi)
            if span:
                points = particles.points if isinstance(particles, Mesh) else particles
                try:
                    known = look.values_of(path, points, options.color_by)
                except UserError:
                    continue
                known = known[np.isfinite(known) & _finite(points)]
                values = [known.min(initial=values[0]), known.max(initial=values[1])]
        if self.comm is not None:
            everyone = self.comm.allgather((lows, highs, values, broken))
            lows, highs = ([one for part in everyone for one in part[k]] for k in (0, 1))
            values = [min(v[2][0] for v in everyone), max(v[2][1] for v in everyone)]
            broken = any(v[3] for v in everyone)
        if fit and not (lows or broken):
            name = f"{said(options.particles[0])} to {said(options.particles[-1])}"
            need_chosen(name, reading(options))
            need_particles(name, 0)
        if fit and lows:
            self.box = box_corners(np.min(lows, axis=0), np.max(highs, axis=0))
        if span and values[0] <= values[1]:
            options.range = (float(values[0]), float(values[1]))

    def pictures(self, images: list[str], arrays: list[str | None]) -> Iterator[tuple[int, str, str, str | None]]:
        """Number, file and outputs of all images to make; `read` then has the particles.

        The first file always comes first: the camera comes from this file.
        """
        files = self.options.particles
        todo = [i for i in range(len(files)) if not self.finished(images[i], arrays[i])]
        if not todo:
            return
        if self.comm is not None and len(files) > 1:
            yield from self._dealt(todo, images, arrays)
            return
        todo = sorted({0, *todo})
        if len(set(files)) == 1:
            self._ahead = itertools.repeat(_read(files[0], self.options))
        else:
            self._ahead = read_ahead(_read(files[i], self.options) for i in todo)
        for i in todo:
            yield i, files[i], images[i], arrays[i]

    def _dealt(
        self, todo: list[int], images: list[str], arrays: list[str | None]
    ) -> Iterator[tuple[int, str, str, str | None]]:
        """This rank's images, of those to do."""
        files = self.options.particles

        def one(i: int) -> tuple[int, str, str, str | None]:
            self._ahead = (_read(path, self.options) for path in files[i : i + 1])
            return i, files[i], images[i], arrays[i]

        # The camera comes from the first file that has particles, on every rank.
        self._looking = True
        for i in range(len(files)):
            yield one(i)
            if self._kept.scene is None or self._kept.settled:
                break
        self._looking = False
        if self.comm.rank == 0:
            self.prepare()
        self.comm.Barrier()
        if self.movie:
            self.movie.keep()
        for k in dealt(self.comm, len(todo)):
            yield one(todo[k])

    def read(self) -> tuple[Particles | Mesh, list[str]]:
        """The particles or the mesh of the current image, and messages about them."""
        return next(self._ahead)

    def finished(self, image: str, aov: str | None) -> bool:
        """Whether this run need not make the image: --resume is given and an earlier one has."""
        if self._looking:
            return True
        if not self.options.resume or not is_whole(image, self.options.size):
            return False
        return aov is None or zipfile.is_zipfile(aov)

    def scene(self, particles: Particles, make: Callable[[Particles], Scene], made: Callable[[Scene], object]) -> Scene:
        """The scene of all images, with the particles of this image."""
        return self._kept.show(particles, make, made)

    def _leading(self) -> Particles:
        """The particles that lead."""
        particles = _read(self.options.particles[self._at], self.options)[0]
        assert isinstance(particles, Particles)
        if self.comm is None or self.comm.rank == 0:
            say(led_by(self.options.particles, self._at))
        particles = particles[_finite(particles)]
        return look.stretched(self.options, particles) if self.options.anisotropic else particles

    def look(self, scene: Any, find: Callable[[Any, Any], list[Camera]]) -> None:
        """Find the cameras of all images by the scene of the frame that leads."""
        if not self.path:
            self._cameras = find(scene, self.box)

    def cameras(self, i: int) -> list[Camera]:
        """The cameras of the views of image i: the path's, or those found, turned where a turntable
        is asked for."""
        if self.path:
            return [self.path(i)]
        n = self.options.turntable
        return [orbit(one, n=n)[i % n] for one in self._cameras] if n else self._cameras

    def warn(self, messages: list[str], progress: Progress) -> None:
        """Show the messages that no earlier image has had, whatever the frame that they name."""
        kinds = {re.sub(r"^frame \d+ of", "frame of", message): message for message in messages}
        new = [message for what, message in kinds.items() if what not in self._shown]
        self._shown.update(kinds)
        if new:
            progress.clear()
        for message in new:
            warn(message)

    def finish(self, progress: Progress) -> None:
        """Encode the movie from its images."""
        if self.movie:
            progress.show(f"writing {self.options.output}")
            self.movie.encode(len(self), self.options.fps)

    def prepare(self) -> None:
        """Make the movie's folder, just before the first image is written."""
        if self.movie:
            self.movie.open()

    def report(self, images: list[str], reports: list[dict[str, Any]], seconds: float) -> None:
        """Report a movie, or images that were all finished before."""
        options, n = self.options, len(images)
        n_kept = n - len(reports)
        made = [options.output] if self.movie else images
        if self.movie:  # the images are gone
            reports = [report | {"images": []} for report in reports]
        if options.json:
            device = reports[0]["device"] if reports else None
            counts = {"pictures": n, "kept": n_kept}
            facts = {
                "images": made,
                "device": device,
                "size": options.size,
                "counts": counts,
                "times": {"total": seconds},
                "frames": reports,
            }
            print_json(facts | {"fps": options.fps} if self.movie else facts)
            return
        kept = f", {n_kept} of them finished before" if n_kept else ""
        what = f"{options.output}: {n} frames" if self.movie else f"{count(n, 'image')}"
        print(f"{what}{kept}, {seconds:.2f} s in all")

    def __enter__(self) -> Series:
        return self

    def __exit__(self, kind: Any, error: BaseException | None, _: object) -> None:
        if error is None or not self.movie:
            return
        if self.comm is None:
            if note := self._note():
                say(note)
        else:  # of all ranks, one says it
            error.note = self._note  # type: ignore[attr-defined]

    def _note(self) -> str:
        """What an interrupted run has finished."""
        if not self.movie or not (n := len(self.movie.finished())):
            return ""
        are = "image is" if n == 1 else "images are"
        return f"note: {n:,} finished {are} in {self.movie.folder}; --resume continues"


def of_all_ranks(comm: Any, reports: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """The reports of all ranks' images, on rank 0, in the images' order."""
    found = [one for part in comm.gather(reports) or [] for one in part]
    return sorted(found, key=lambda report: natural(report["images"][0]))


def shows_all(output: str) -> bool:
    """Whether the name of what is written has a place for several images."""
    name = os.path.basename(output)
    if output.lower().endswith(".mp4") or output.endswith("/") or os.path.isdir(output):
        return True
    return re.search(r"%0?\d?d", name) is not None


def _camera_path(options: argparse.Namespace) -> CameraPath:
    if options.eye or options.look_at or options.fit or options.ortho:
        raise UserError("--camera-path: expected no --fit, --eye, --look-at or --ortho beside --camera-path")
    try:
        return CameraPath.load(options.camera_path, options.fps)
    except OSError as error:
        raise UserError(f"--camera-path: {options.camera_path}: {error.strerror}") from error


def _read(path: str, options: argparse.Namespace) -> tuple[Particles | Mesh, list[str]]:
    if is_mesh(path, options):
        if options.frame is not None and not isinstance(path, FrameOf):
            return read_mesh(FrameOf(path, options.frame), options), []
        n_frames = 1 if isinstance(path, FrameOf) else frames_of(path)
        message = first_of(path, n_frames, "an output with %d or .mp4 shows all")
        return read_mesh(path, options), [message] if n_frames > 1 else []
    if is_surface(path, options):
        return read_surface(path, options)
    contents = read_file(path, len(set(options.particles)) > 1, **reading(options))
    options.origin = contents.particles.origin
    if (facts := vars(options).get("facts")) is not None:
        facts[path] = contents.time, contents.units
    messages = lies_across(path, contents, options)
    if contents.n_frames > 1 and not isinstance(path, FrameOf) and options.frame is None:
        messages.append(first_of(path, contents.n_frames, "an output with %d or .mp4 shows all"))
    return contents.particles, messages


def _try_to_read(path: str, options: argparse.Namespace) -> Particles | Mesh | None:
    try:
        return _read(path, options)[0]
    except UserError:
        return None


def _finite(particles: Particles) -> np.ndarray:
    return np.isfinite(particles.positions).all(axis=1)
