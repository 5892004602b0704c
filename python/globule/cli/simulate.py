"""Simulate fluids, tissue and instruments, from a scene file or a shipped scene.

`globule simulate` writes frames of particles, diagnostics.csv and .png, and checkpoint.npz into a
folder, and a movie on request. Ctrl-C or SIGTERM ends the current step and writes the checkpoint.
--resume continues from the checkpoint, with the same bits as an uninterrupted run."""

from __future__ import annotations

import argparse
import glob
import os
import signal
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from ..render.camera_path import MOST_FRAMES
from . import flags, view
from .parser import Parser
from .shared import (
    Progress,
    UserError,
    check_device,
    check_folder,
    check_output,
    count,
    make_folder,
    mistakes,
    positive,
    print_json,
    said_threads,
    say,
    warn,
)
from .time_left import TimeLeft

if TYPE_CHECKING:
    from ..sim.scene_file import Output, SceneFile
    from ..sim.simulation import Simulation

SUMMARY = "fluids, tissue and instruments, from a scene file"
USAGE = "SCENE"
EXAMPLES = """\
  globule simulate dam-break -o dam --spacing 0.04 --seconds 0.2
  globule simulate dam-break --view
  globule simulate dam-break -o dam --spacing 0.04 --seconds 0.3 --resume --json
  globule simulate dam-break -o dry --spacing 0.05 --seconds 0.1 --no-frames --images dry"""
ESSENTIAL = ("--output", "--seconds", "--spacing", "--video", "--size", "--format", "--resume",
             "--view", "--device")  # fmt: skip
CHECKPOINT = "checkpoint.npz"


def add_arguments(parser: Parser) -> None:
    """The arguments of `globule simulate`."""
    from ..formats import EXTENSIONS
    from ..sim.scene_read import SHIPPED

    formats = [extension[1:] for extension in EXTENSIONS]
    parser.add_argument("scene", metavar="SCENE", help=f"scene file .toml, or one of {', '.join(SHIPPED)}")
    flags.add(parser, "--output", "folder; default: frames", default="frames")
    flags.own(parser, "--seconds S", "simulated time, seconds, in whole frames", positive,
        usual="the scene's")  # fmt: skip
    flags.add(parser, "--fps", "default: the scene's, else 30")
    flags.own(parser, "--format NAME", f"file format of the frames: {', '.join(formats)}", formats,
        usual="the scene's, else vtp")  # fmt: skip
    flags.own(parser, "--no-frames", "write no frames of particles")
    flags.own(parser, "--video FILE.mp4", "also write a movie, with the camera and look of the "
        "scene's view")  # fmt: skip
    flags.own(parser, "--images FOLDER", "also keep the image of every frame in this folder, .png")
    flags.add(parser, "--size", "of --video and --images; default: the scene's")
    flags.own(parser, "--spacing M", "distance between neighboring particles, meters", positive,
        usual="the scene's")  # fmt: skip
    flags.own(parser, "--checkpoint S", "also write a checkpoint every S simulated seconds",
        positive, usual="only at the end and at Ctrl-C")  # fmt: skip
    flags.add(parser, "--resume", "from the checkpoint in the folder of -o")
    flags.add(parser, "--json")
    flags.own(parser, "--view", "run live in the browser and write nothing; with --resume from the "
        "checkpoint")  # fmt: skip
    flags.add_page(parser)
    flags.add_device(parser.add_argument_group("machine"))


def run(options: argparse.Namespace) -> None:
    """Run `globule simulate`."""
    start = time.perf_counter()
    check_device(options)
    if options.view:
        _view(options)
        return
    with ExitStack() as held:
        with mistakes():
            job = _Job(options, held)
        with job.progress, _interrupts() as interrupted:
            try:
                whole = job.run(interrupted)
            except BaseException as error:
                with suppress(Exception):  # the first error is said
                    job.write_diagnostics()  # which show why a run stopped
                job.note_kept_images()
                if isinstance(error, ArithmeticError):  # of the scene, as `Simulation.step` says
                    raise UserError(str(error)) from error
                raise
            job.write_diagnostics()
        job.report(whole, time.perf_counter() - start)
    if not whole:
        signal.raise_signal(interrupted())  # the command's own handler knows the exit status
        raise KeyboardInterrupt


def _view(options: argparse.Namespace) -> None:
    """Run live in the browser."""
    from ..sim.scene_read import errors_of
    from ..sim.simulation import Simulation
    from ..viewer.simulation_source import SimulationSource

    for name in ("seconds", "fps", "format", "no_frames", "video", "images", "size", "checkpoint", "json"):
        if getattr(options, name):
            option = name.replace("_", "-")
            raise UserError(f"--view: expected no --{option} beside --view, which writes nothing")
    view.check_viewer()
    with mistakes():
        scene = _read(options)
        where = {"device": options.device, "threads": options.threads}
        if options.resume:
            simulation = _resumed(Simulation, options.output, scene, options.scene, where)
        else:
            with errors_of(options.scene):
                simulation = Simulation(scene, **where)
        title = os.path.basename(options.scene)
        source = SimulationSource(title, simulation, **where)
        source.files = [options.scene]
        viewer = view.serve(source, options, preset=source.preset)
    viewer.wait()


def _read(options: argparse.Namespace) -> SceneFile:
    """The scene of the options."""
    from ..sim.scene_read import read_scene

    try:
        return read_scene(options.scene, options.spacing)
    except OSError as error:
        raise UserError(str(error)) from error


class _Job:
    """One run: the simulation, and the files that it writes. `held` keeps its folder to it."""

    def __init__(self, options: argparse.Namespace, held: ExitStack):
        from ..sim.pictures import Pictures
        from ..sim.scene_read import errors_of
        from ..sim.simulation import Simulation

        self.options, self.folder = options, options.output
        if options.video:
            check_output("--video", options.video, [".mp4"], made=self.folder)
        check_folder("-o", self.folder)
        if options.images is not None:
            check_folder("--images", options.images)
        scene = _read(options)
        self.fps = options.fps or scene.output.fps
        self.format = options.format or scene.output.format
        seconds = options.seconds or scene.seconds
        if seconds * self.fps > MOST_FRAMES:
            own = not (options.seconds or options.fps)
            key = f"{options.scene}: seconds" if own else "--seconds"
            raise UserError(
                f"{key}: expected at most {MOST_FRAMES:,} frames, got {seconds:g} s at {self.fps:g} frames per second"
            )
        output = replace(scene.output, fps=self.fps, format=self.format)
        self.scene = replace(scene, seconds=seconds, output=output)
        self.n_frames = int(seconds * self.fps + 1e-6) + 1
        self.checkpoint = os.path.join(self.folder, CHECKPOINT)
        try:
            self.pictures = Pictures(self.scene, options.images, options.video, options.size, options.resume)
        except ImportError as error:
            raise UserError(f"--video: {error}") from error
        where = {"device": options.device, "threads": options.threads}
        if options.resume:
            self.sim = _resumed(Simulation, self.folder, self.scene, options.scene, where)
            held.enter_context(_alone_in(self.folder))
            self._check_output(self.sim.file.output)
            self.start_time = self.sim.time
            self._check_frames()
            self._restore_pictures()
            if self.pictures.wanted:
                with errors_of(options.scene):
                    first = Simulation(self.scene, **where)
                self.pictures.begin_again(first, self.fps, self.sim.time)
        else:
            with errors_of(options.scene):
                self.sim = Simulation(self.scene, **where)
        self.first_step, self.start_time = self.sim.n_steps, self.sim.time
        make_folder("-o", self.folder)
        if not options.resume:
            held.enter_context(_alone_in(self.folder))
        self._note_old_frames()
        self.progress = Progress(self.n_frames)
        self.files: list[str] = []
        self.saved = self.sim.time
        self.seconds = {"simulation": 0.0, "frames": 0.0, "pictures": 0.0}

    def _note_old_frames(self) -> None:
        """Say which frames of an earlier run in the folder this run does not replace."""
        found = glob.glob(os.path.join(glob.escape(self.folder), f"frame_*.{self.format}"))
        numbers = [os.path.basename(path)[6:].partition(".")[0] for path in found]
        left = sum(n.isdecimal() and int(n) >= self.n_frames for n in numbers)
        if left and not self.options.no_frames:
            last = f"frame_{self.n_frames - 1:05d}.{self.format}"
            warn(f"{self.folder} keeps {count(left, 'frame')} of an earlier run after {last}")

    def _check_output(self, before: Output) -> None:
        """Refuse frames that --resume would number or write otherwise than before."""
        for name in ("fps", "format"):
            had, asked = getattr(before, name), getattr(self, name)
            if had != asked:
                raise UserError(f"--resume: expected --{name} {had}, as before the interruption, got {asked}")

    def _check_frames(self) -> None:
        """Warn of frames from before the interruption that cannot be read: this run does not make them again."""
        from ..formats import read

        damaged = []
        for k in range(0 if self.options.no_frames else self.n_frames):
            path = os.path.join(self.folder, f"frame_{k:05d}.{self.format}")
            if not self._is_before(k):
                break
            try:
                read(path)
            except (OSError, ValueError):
                damaged.append(os.path.basename(path))
        if damaged:
            names = ", ".join(damaged[:3]) + (f" and {len(damaged) - 3} more" if len(damaged) > 3 else "")
            warn(f"{self.folder}: {names} missing or damaged; --resume does not make frames again: run without it")

    def _is_before(self, k: int) -> bool:
        """Whether the time of frame k is not after the time of the checkpoint."""
        return k / self.fps < self.start_time + 1e-9

    def _restore_pictures(self) -> None:
        """Begin a continued movie with the images from before the interruption."""
        if not self.pictures.movie:
            return
        folder = self.options.images
        kept = (lambda k: os.path.join(folder, f"{k:05d}.png")) if folder else None
        n_done = sum(map(self._is_before, range(self.n_frames)))
        try:
            self.pictures.movie.restore(n_done, self.n_frames, self.pictures.eye.size, kept)
        except ValueError as error:
            frames = os.path.join(self.folder, f"frame_*.{self.format}")
            raise UserError(
                f"--video: {error}; resume without --video, then: globule render '{frames}' -o {self.options.video}"
            ) from error

    def run(self, interrupted: Callable[[], int]) -> bool:
        """Make all frames; False if a signal stopped the run before the end."""
        written = [self.options.resume and self._is_before(k) for k in range(self.n_frames)]
        left = TimeLeft(self.sim.time, (self.n_frames - 1) / self.fps, written.count(False))
        whole = True

        def state() -> str:
            now = self.sim.time
            return f"{now:.3f} s, {count(len(self.sim))}{left.words(now)}"

        def stop() -> bool:
            if said := left.step(self.sim.time):
                self.progress.clear()
                say(f"note: {said}")
            if left.is_due():
                self.progress.show(state())
            return interrupted() != 0

        for k in range(self.n_frames):
            self.progress.step(state())
            if written[k]:
                continue  # written before the checkpoint
            left.frame(self.sim.time)
            with self._timed("simulation"):
                self.sim.run_to(k / self.fps, stop=stop)
            reached = self.sim.time > k / self.fps - 1e-9
            if reached:  # also after a signal: --resume relies on this frame
                self._write(k)
            if interrupted():
                whole = reached and k == self.n_frames - 1
                break
            if self.options.checkpoint and self.sim.time - self.saved >= self.options.checkpoint:
                self._save()
        self._save()
        if whole:
            self.files += self.pictures.finish(self.n_frames, self.fps)
        return whole

    def _write(self, k: int) -> None:
        from ..formats import write

        self.sim.record.measure()
        if not self.options.no_frames:
            with self._timed("frames"):
                path = os.path.join(self.folder, f"frame_{k:05d}.{self.format}")
                write(path, self.sim.shown_particles)
                self.files.append(path)
                if self.sim.foam.on:
                    path = os.path.join(self.folder, f"foam_{k:05d}.{self.format}")
                    write(path, self.sim.foam.particles())
                    self.files.append(path)
        with self._timed("pictures"):
            self.files += self.pictures.add(k, self.sim)

    def _save(self) -> None:
        self.sim.save(self.checkpoint)
        self.saved = self.sim.time

    @contextmanager
    def _timed(self, what: str) -> Iterator[None]:
        start = time.perf_counter()
        try:
            yield
        finally:
            self.seconds[what] += time.perf_counter() - start

    def write_diagnostics(self) -> None:
        """Write diagnostics.csv, and .png if matplotlib is installed."""
        from ..sim import diagnostics

        rows = self.sim.record.diagnostics
        if rows:
            diagnostics.write_csv(os.path.join(self.folder, "diagnostics.csv"), rows)
            title = self.scene.title or self.options.scene
            diagnostics.plot(os.path.join(self.folder, "diagnostics.png"), rows, title)

    def note_kept_images(self) -> None:
        """After an error: say which images of an unfinished movie stay."""
        movie = self.pictures.movie
        n = len(movie.finished()) if movie else 0
        if not movie or not n:
            return
        if self.options.resume or self.saved > self.start_time:
            what = f"--resume continues from {self.checkpoint}"
        else:
            what = "without a checkpoint --resume cannot use them; delete the folder or run again"
        say(f"note: {movie.folder} keeps {count(n, 'image')} of the movie: {what}")

    def report(self, whole: bool, total: float) -> None:
        """Print the results, in words or as JSON."""
        sim = self.sim
        n_steps = sim.n_steps - self.first_step
        if self.options.json:
            print_json({
                "scene": self.options.scene, "whole": whole, "device": sim.scene.device.name,
                "time": sim.time, "steps": sim.n_steps, "new_steps": n_steps,
                "hash": sim.hash(), "counts": sim.record.counts,
                "times": {**self.seconds, "total": total}, "stages": sim.record.seconds,
                "files": self.files, "checkpoint": self.checkpoint,
            })  # fmt: skip
            return
        per_step = 1e3 * self.seconds["simulation"] / max(1, n_steps)
        counts = ", ".join(f"{n:,} {name}" for name, n in sim.record.counts.items() if n)
        title = self.scene.title or self.options.scene
        print(f"{title}: {sim.time:.4g} s in {n_steps:,} steps of {per_step:.1f} ms, "
              f"{counts}")  # fmt: skip
        written = {name: s for name, s in self.seconds.items() if s}
        spent = ", ".join(f"{name} {s:.1f} s" for name, s in written.items()) or "nothing to do"
        where = said_threads(sim.scene.device.description, self.options.threads)
        print(f"{spent}, {total:.1f} s in all on {where}")
        if self.files:
            last = f" … {self.files[-1]}" if len(self.files) > 1 else ""
            print(f"{count(len(self.files), 'file')}: {self.files[0] + last}")
        if not whole:
            say(f"note: stopped at {sim.time:.4g} s; --resume continues from {self.checkpoint}")


def _resumed(kind: type[Simulation], folder: str, scene: SceneFile, name: str, where: dict[str, Any]) -> Simulation:
    """The simulation of the folder's checkpoint. Only duration, view and output of the scene may
    differ from those of the checkpoint."""
    from ..sim.scene_read import as_dict, read_scene

    checkpoint = os.path.join(folder, CHECKPOINT)
    try:
        simulation = kind.load(checkpoint, **where)
    except OSError as error:
        raise UserError(f"--resume: expected {checkpoint}, got: {error.strerror}") from error
    free = ("title", "seconds", "view", "output")
    now = as_dict(read_scene(as_dict(scene)))  # read back, as the saved scene was
    before = as_dict(simulation.file)
    for key in (*now, *before):
        if key not in free and now.get(key) != before.get(key):
            raise UserError(
                f"--resume: expected {checkpoint} of the present {name}, got a checkpoint with another {key}"
            )
    return simulation


@contextmanager
def _alone_in(folder: str) -> Iterator[None]:
    """Refuse a folder that another run writes to; where there are no locks, do nothing."""
    try:
        import fcntl
    except ImportError:  # Windows
        yield
        return
    number = os.open(folder, os.O_RDONLY)
    try:
        with suppress(OSError):  # a file system without locks
            try:
                fcntl.flock(number, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError as error:
                raise UserError(
                    f"-o: expected a folder of one run, got {folder}, to which another run writes "
                    "now; wait, or choose another folder"
                ) from error
        yield
    finally:
        os.close(number)


@contextmanager
def _interrupts() -> Iterator[Callable[[], int]]:
    """A function that gives the signal that came, SIGINT or SIGTERM, or 0. The first signal lets
    the current step end; the second signal breaks it off."""
    signals = (signal.SIGINT, signal.SIGTERM)
    came = 0

    def note(signum: int, frame: Any) -> None:
        nonlocal came
        if came:
            raise KeyboardInterrupt
        came = signum

    before = [signal.signal(number, note) for number in signals]
    try:
        yield lambda: came
    finally:
        for number, handler in zip(signals, before, strict=True):
            signal.signal(number, handler)
