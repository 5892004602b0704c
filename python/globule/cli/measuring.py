"""Flags and work of the commands that measure a surface: slice, gauge, mesh, track, project."""

from __future__ import annotations

import argparse
import functools
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np

from .._base.checks import optional
from ..data.particles import Particles
from ..formats.frames import FrameOf
from ..formats.kind import kind_of
from ..formats.triangles import has_faces
from ..measure.samples import EXTENSIONS
from ..measure.surface import default_spacing
from ..pieces.scene import Scene
from ..render.image_sequence import KeptScene
from ..render.sequence import find_files, leader, read_ahead, with_frames
from . import flags, look, surfaces
from .parser import Parser
from .shared import (
    Progress,
    UserError,
    check_device,
    check_input,
    check_output,
    doubled,
    first_of,
    frame_number,
    left_out,
    lies_across,
    mistakes,
    none_of,
    positive,
    read_file,
    reading,
    say,
    settle_origin,
    warn,
)
from .volumes import check_surface, is_surface, read_surface


def add_surface(parser: Parser) -> None:
    """The flags that say which surface is measured, and where it is computed."""
    surfaces.add_arguments(parser)
    flags.add_reading(parser)
    flags.add_device(parser.add_argument_group("machine"))


def add_sample_spacing(group: Any) -> None:
    """The flag of the distance of samples, or of a mesh's cells."""
    flags.own(group, "--sample-spacing LENGTH", "distance of neighboring samples, or edge of a "
        "mesh's cells, world units", positive, usual="half the particles' spacing",
        dest="spacing")  # fmt: skip


def add_values(group: Any, default: str) -> None:
    """The flag of the values to sample."""
    flags.own(group, "--value NAME", "value to sample: field, inside, gradient, or a field or "
        "attribute of the particles; may be repeated", usual=default, dest="values", action="append")  # fmt: skip


def add_image(parser: Any, *switch: str) -> None:
    """The flags of the image of a plane. switch: a flag of the command alone, and its help."""
    image = parser.add_argument_group("image")
    flags.own(image, *switch)
    flags.add(image, "--colormap", "default: auto, which is viridis", default="auto")
    flags.add(image, "--range", "default: the lowest and the highest value")


def check_image(options: argparse.Namespace, *names: str) -> bool:
    """Whether -o names an image of a plane; refuses what cannot be written, and flags of images
    beside other files."""
    check_output("-o", options.output, (*EXTENSIONS, ".png"))
    image = options.output.lower().endswith(".png")
    for name in names:
        if getattr(options, name) and not image:
            raise UserError(f"--{name}: expected a .png beside --{name}, got {options.output}")
    return image


def scenes(
    options: argparse.Namespace,
    names: Sequence[str],
    progress: Progress,
    one: bool = False,
    made: Callable[[Scene], object] = lambda scene: None,
    clock: list[float | None] | None = None,
) -> Iterator[tuple[int, str, Scene]]:
    """Number, file and scene of each file; one scene serves all, with the support of the one that
    leads. one: of a file with several frames, only one is meant. made: as for `KeptScene.show`.
    clock: takes the time of each file or frame, as the file says it."""
    check_device(options)
    with mistakes():
        files = find_files(names)
    for path in dict.fromkeys(files):
        need_no_faces(path, options)
        if is_surface(path, options):
            check_surface(path, options)
        else:
            check_input(path, list(reading(options)))
    if not one and options.frame is None:
        files = with_frames(files, **reading(options))
    elif options.frame is not None:
        files = [FrameOf(f, frame_number(f, options.frame)) for f in files]
    at = leader(files, **reading(options))
    if len({*files}) > 1:
        settle_origin(options, files[at])

    def lead() -> Particles:
        particles = _read(files[at], options, [], True)[0]
        progress.clear()
        say(led_by(files, at))
        return particles

    kept = KeptScene(lead if at else None)
    clock = [] if clock is None else clock
    several = not one or len(files) > 1  # a frame of several may be empty
    ahead = read_ahead(_read(path, options, clock, several) for path in files)
    progress.n_steps = len(files)
    for i, path in enumerate(files):
        progress.step(path)
        particles, messages = next(ahead)
        if several and not len(particles):
            messages = [*messages, none_of(path, options)]
        for message in messages:
            progress.clear()
            warn(message)
        with mistakes(path):
            scene = kept.show(particles, functools.partial(_scene, options, path), made)
        yield i, path, scene


class Broken:
    """A file or frame that cannot be read ends a sequence. Of those before it the results are
    written: its error is raised behind them, at the end of the `with`."""

    def __init__(self) -> None:
        self._error: UserError | None = None

    def before(self, scenes: Iterator[tuple[int, str, Scene]]) -> Iterator[tuple[int, str, Scene]]:
        """The scenes before the error, which is raised where there are none."""
        n = 0
        try:
            for one in scenes:
                n += 1
                yield one
        except UserError as error:
            if not n:
                raise
            self._error = error

    def __enter__(self) -> Broken:
        return self

    def __exit__(self, kind: object, *_: object) -> None:
        if kind is None and self._error is not None:
            raise self._error


def led_by(files: Sequence[str], at: int) -> str:
    """What to say where not the first file leads."""
    leading = files[at]
    which = f"{leading}, the largest of {len(files):,} files"
    if isinstance(leading, FrameOf):
        frame = "the last frame" if at == len(files) - 1 else f"frame {leading.frame}"
        which = f"{frame} of {leading}, which is larger than the first"
    return f"note: surface and support are those of {which}"


def _read(
    path: str, options: argparse.Namespace, clock: list[float | None], may_be_empty: bool
) -> tuple[Particles, list[str]]:
    time = None
    if is_surface(path, options):
        particles, messages = read_surface(path, options)
    else:
        contents = read_file(path, may_be_empty, **reading(options))
        particles, messages = contents.particles, lies_across(path, contents, options)
        options.origin, time = particles.origin, contents.time
        if contents.n_frames > 1 and not isinstance(path, FrameOf) and options.frame is None:
            messages = [*messages, first_of(path, contents.n_frames, "globule track measures all")]
    clock.append(time)
    messages = [*messages, *left_out(path, particles), *doubled(path, particles)]
    if options.anisotropic:
        with mistakes():
            particles = look.stretched(options, particles)
    return particles, messages


def _scene(options: argparse.Namespace, path: str, particles: Particles) -> Scene:
    return surfaces.scene_of(
        options,
        particles,
        kind_of(path).kind == "volume",
        kernel=options.kernel,
        threshold=options.threshold,
        support=None if options.anisotropic else options.support,
        device=options.device,
        threads=options.threads,
    )


def need_no_faces(path: str, options: argparse.Namespace) -> None:
    """Refuse a mesh of triangles: balls around its vertices are not what its file says."""
    if not options.resample and has_faces(path):
        raise UserError(
            f"{path}: expected particles or a volume, got a mesh, which is triangles already; "
            "--resample LENGTH makes metaballs all over it"
        )


def too_coarse(options: argparse.Namespace, scene: Scene) -> str:
    """What is wrong with --sample-spacing if a mesh has no triangles, or ""."""
    usual = default_spacing(scene)
    if not options.spacing or options.spacing <= usual:
        return ""
    return (
        f"--sample-spacing: expected one that meets the surface, got {options.spacing:g}, whose "
        f"cells miss it all; try {usual:.3g}, half the particles' spacing"
    )


def numbered(
    options: argparse.Namespace, names: Sequence[str], clock: Sequence[float | None], columns: dict[str, Any]
) -> dict[str, Any]:
    """The table of a sequence: the numbers of the frames, those of one file as the file has them, and
    the times by --fps, before the names and columns; behind them the times of the files."""
    numbers = np.array([one.frame if isinstance(one, FrameOf) else i for i, one in enumerate(names)])
    if len({str(name) for name in names}) > 1:
        numbers = np.arange(len(names))
    before = {"frame": numbers} | ({"time": numbers / options.fps} if options.fps else {})
    known = None not in clock and len(clock) == len(names)
    if known and len({*clock}) < len(clock):
        i = next(i for i, time in enumerate(clock) if time in clock[:i])
        which = f"rows {clock.index(clock[i])} and {i} have one time, {clock[i]:g}"
        warn(f"{which}: a frame in several files is several rows here (a .pvd joins those of one time), and so is "
             "one that a continued run wrote again")  # fmt: skip
    behind = {"time": np.array(clock, np.float64)} if known and not options.fps else {}
    return before | {"file": np.array(names)} | columns | behind


def need_matplotlib() -> None:
    """Refuse to plot without matplotlib, before any work."""
    with mistakes():
        optional("matplotlib.figure", "figures", "matplotlib")


def plot(options: argparse.Namespace, table: dict[str, Any], names: Sequence[str], ylabel: str) -> None:
    """Columns of a table over time, or over the frames' numbers, as a .png."""
    from matplotlib.figure import Figure

    from .._base.files import atomic_write

    along = "time" if "time" in table else "frame"
    figure = Figure(figsize=(8, 4), dpi=100, layout="constrained")
    axes = figure.add_subplot()
    for name in names:
        axes.plot(table[along], table[name], ".-", label=name)
    axes.set_xlabel("time, seconds" if options.fps else along)
    axes.set_ylabel(ylabel)
    axes.grid(alpha=0.3)
    if len(names) > 1:
        axes.legend()
    with atomic_write(options.plot) as file:
        figure.savefig(file, format="png")
