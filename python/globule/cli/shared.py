"""What the commands share: errors, messages, words of arguments, input and output files."""

from __future__ import annotations

import argparse
import contextlib
import errno
import json
import math
import os
import re
import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from .._base.checks import MissingPackageError
from .._base.settings import Number, Vector
from .._base.terminal import escaped, place_text
from ..data.particles import FARTHEST, HERE, UP, Particles
from ..data.spacing import n_coincident
from ..formats import FormatError, read_contents, up_of
from ..formats.contents import Contents
from ..formats.frames import FrameOf, said
from ..formats.kind import kind_of
from ..formats.packed import plain_name
from ..formats.registry import format_named, formats
from ..volumes.tomography import sample_tomography


class UserError(Exception):
    """The user's mistake: one line that says where, what was expected, and what came."""


@contextlib.contextmanager
def mistakes(path: str = "", *others: type[Exception]) -> Iterator[None]:
    """Turn what the library refuses in this block into a UserError, which names the file. others:
    further errors that are the user's here."""
    refused: tuple[type[Exception], ...] = (TypeError, ValueError, MissingPackageError, *others)
    try:
        yield
    except refused as error:
        raise UserError(f"{path}: {error}" if path else str(error)) from error


@contextlib.contextmanager
def readable(path: str, what: str = "cannot be read") -> Iterator[None]:
    """`mistakes`, and a file that cannot be read: the one that the error names, or this one."""
    try:
        with mistakes():
            yield
    except OSError as error:
        raise UserError(f"{error.filename or path}: {what}: {error.strerror or error}") from error


def left_out(path: str, particles: Particles, far: bool = True) -> list[str]:
    """Messages about particles without a finite position, and with far about those that lie so
    far that no surface has them.

    Raises UserError where most lie farther than float32 can square.
    """
    n = len(particles)
    n_finite = n - particles.n_missing()
    n_far = n_finite - len(particles.finite_positions())
    if n_far > n_finite / 2:
        what = f"got farther ones of {n_far:,} of {count(n)}; scale the positions"
        raise UserError(f"{path}: expected coordinates up to {FARTHEST:g}, {what}")
    found = [(n - n_finite, "no finite position")]
    if far:
        found.append((n_far, f"a coordinate beyond {FARTHEST:g}"))
    return [f"{path}: {k:,} of {count(n)} {'have' if k > 1 else 'has'} {what}, left out" for k, what in found if k]


def doubled(path: str, particles: Particles) -> list[str]:
    """A message about particles that lie exactly where others do, from 1 % on."""
    positions = particles.finite_positions()
    n = len(positions)
    # A few places tell whether there are any: 3 ms per million instead of 55.
    if n < 2 or not n_coincident(positions, every=1 + n // 10_000):
        return []
    k = n_coincident(positions)
    if k == n - 1:
        return [f"{path}: all {n:,} particles lie at one place"]
    if k < 0.01 * n:
        return []
    return [f"{path}: {k:,} of {count(n)} lie exactly where others do: are they there twice?"]


def need_particles(path: str, n: int) -> None:
    """Refuse a file without particles that have a place."""
    if not n:
        from ..render.sequence import frames_of

        n_frames = 1 if isinstance(path, FrameOf) else frames_of(path)
        advice = f"; it has {n_frames:,} frames: --frame takes another" if n_frames > 1 else ""
        raise UserError(f"{path}: expected particles, got none with a finite position{advice}")


def say(message: str) -> None:
    """One line on stderr."""
    if sys.stderr:
        print("globule:", escaped(" ".join(message.split("\n"))), file=sys.stderr)


def text_of(error: BaseException) -> str:
    """What an error says; the system's without its number, and with the file first."""
    if isinstance(error, OSError) and error.strerror and error.filename:
        return f"{error.filename}: {error.strerror}"
    return str(error) or type(error).__name__


def warn(message: str) -> None:
    """One line on stderr that begins with "warning"."""
    say(f"warning: {message}")


# Arguments


def join_negative(argv: Sequence[str]) -> list[str]:
    """`--eye -1,2,3` as `--eye=-1,2,3`: argparse would take `-1,2,3` for an option."""
    joined: list[str] = []
    for word in argv:
        option = bool(joined) and re.fullmatch(r"--[a-z][a-z-]*", joined[-1])
        if option and re.match(r"-\.?[0-9]", word):
            joined[-1] += f"={word}"
        else:
            joined.append(word)
    return joined


number = Number().parse
vector = Vector().parse


def numbers(text: str, like: str) -> tuple[float, ...]:
    """Numbers with commas between them, as many as in "X,Y,Z"."""
    words = text.split(",")
    if len(words) != len(like.split(",")):
        raise argparse.ArgumentTypeError(f"expected {like}, got {text!r}")
    return tuple(map(number, words))


def positive(text: str) -> float:
    """A number above zero whose square and inverse a float32 holds."""
    value = number(text)
    if value <= 0:
        raise argparse.ArgumentTypeError(f"expected a number above 0, got {text!r}")
    if not 1e-18 <= value <= 1e18:
        raise argparse.ArgumentTypeError(f"expected 1e-18 to 1e+18, got {text!r}")
    return value


def direction(text: str) -> tuple[float, float, float]:
    """X,Y,Z, not all 0."""
    found = vector(text)
    if not any(found):
        raise argparse.ArgumentTypeError(f"expected a direction other than 0,0,0, got {text!r}")
    return found


def check_device(options: argparse.Namespace) -> None:
    """Refuse a device that cannot be used, before any work."""
    from .._base.device import choose

    if not 0 <= options.threads <= 4096:
        raise UserError(f"--threads: expected 0 to 4096, got {options.threads}")
    try:
        choose(options.device)
    except ValueError as error:
        raise UserError(f"--{error}") from error
    except RuntimeError as error:
        if options.device == "auto":
            raise
        message = f"--device: expected a device that works here, got {options.device}: {error}"
        raise UserError(message) from error


def reading(options: argparse.Namespace) -> dict[str, Any]:
    """The arguments of `formats.read` that the flags of `flags.add_reading` give."""
    if options.level is not None and options.label:
        raise UserError("--level: expected no --label beside --level, got both")
    given = {"level": options.level, "labels": options.label, "spacing": options.resample}
    given |= {"frame": options.frame, "species": options.species, "where": options.where}
    given |= {"origin": options.origin, "scale": options.scale}
    given["radius_is"] = options.radius_is if options.radius_is != "radius" else None
    given |= {"center": options.center or None, "min_component": options.min_component}
    given |= {"columns": options.columns, "atom_style": options.atom_style}
    return {name: value for name, value in given.items() if value is not None}


def settle_origin(options: argparse.Namespace, path: str, comm: Any = None) -> None:
    """One origin for all files and ranks: that which this file has for itself."""
    if options.origin is not None:
        return
    found = None
    if comm is None or comm.rank == 0:
        with contextlib.suppress(Exception):  # whoever reads it in its turn says why
            found = read_file(path, True, **reading(options)).particles.origin
    options.origin = comm.bcast(found) if comm is not None else found


def settle_up(options: argparse.Namespace, path: str, comm: Any = None) -> None:
    """The direction of --up, or that of the file, which becomes `options.said_up` to be said."""
    options.said_up = ""
    if options.up is not None:
        return
    options.up, why = UP, ""
    with contextlib.suppress(ValueError, OSError, ImportError):  # whoever reads it says why
        options.up, why = up_of(path)
    if comm is None or comm.rank == 0:
        options.said_up = up_said(options.up, why)


def up_said(up: Any, why: str) -> str:
    """What to say of a direction that is not the default; "" of that."""
    if tuple(up) == UP:
        return ""
    return f"note: up is {place_text(up)}, {why}; --up chooses another direction"


def lies_across(path: str, contents: Contents, options: argparse.Namespace) -> list[str]:
    """A message about particles that periodic faces of their box cut in two; once a run."""
    if options.center or contents.box is None or vars(options).get("said_across"):
        return []
    some = contents.particles[:: 1 + len(contents.particles) // 100_000]
    axes = contents.box.cut_axes(some.world_positions())
    if not axes:
        return []
    options.said_across = True
    faces = f"the periodic faces along {' and '.join(axes)}"
    return [f"{path}: the particles lie across {faces}; --center shows them whole"]


# Files


_OF_PARTICLES = ("radius_is", "where", "scale", "center", "min_component")  # of any format


def check_input(path: str, given: Sequence[str] = ()) -> None:
    """Refuse a file that is not readable, has no known format, or has a format without the options
    `given`, before any work."""
    with readable(path, "expected a file to read, got"):
        found = kind_of(path)
    if found.kind in ("particles", "mesh"):
        known = (*format_named(found.format).options, *_OF_PARTICLES)
    else:
        known = ("level", "labels", "spacing") if found.kind == "volume" else ()
    known = (*known, "origin")
    for name in given:
        if name not in known:
            if name in ("frame", "species", "columns", "atom_style"):
                have = ", ".join(f.about for f in formats() if name in f.options)
                option = f"--{name.replace('_', '-')}"
                raise UserError(f"{option}: expected a file of {have}; got {path}")
            flags = {"labels": "--label", "spacing": "--resample"}
            option = flags.get(name, f"--{name.replace('_', '-')}")
            kind = "volume or mesh" if name == "spacing" else "volume"
            kind = "file of particles" if name in _OF_PARTICLES else kind
            raise UserError(f"{option}: expected a {kind} to read, got {path}")


def read_particles(path: str, may_be_empty: bool = False, **given: Any) -> Particles:
    """The particles of a file; `read_file` without the rest."""
    return read_file(path, may_be_empty, **given).particles


def read_file(path: str, may_be_empty: bool = False, **given: Any) -> Contents:
    """The particles of a file, with its box, units, time, frames and species.

    Raises UserError for a file that cannot be read, and for a level or label that no voxel has,
    unless the file may be empty.
    """
    try:
        volume = kind_of(path).kind == "volume"
        if volume:
            origin = given.pop("origin", HERE)
            contents = Contents(sample_tomography(path, **given).at(origin))
        else:
            contents = read_contents(path, **given)
    except (FormatError, MissingPackageError) as error:
        raise UserError(str(error)) from error
    except ValueError as error:
        raise UserError(f"{path}: {error}") from error
    except OSError as error:
        raise UserError(f"{path}: cannot be read: {error.strerror or error}") from error
    if not len(contents.particles) and not may_be_empty:
        if "level" in given:
            raise UserError(f"{path}: --level: expected an iso-value that voxels reach, got {given['level']:g}")
        need_chosen(said(path), given)
        if "labels" in given:
            labels = ", ".join(map(str, given["labels"]))
            raise UserError(f"{path}: --label: expected a value that voxels have, got {labels}")
    return contents


def need_chosen(name: str, given: Mapping[str, Any]) -> None:
    """Refuse options that leave no particle of a file, or of several, of this name."""
    if given.get("min_component", 1) > 1:
        expected = "expected a component of so many particles"
        raise UserError(f"{name}: --min-component: {expected}, got {given['min_component']}")
    if "where" in given:
        expected = "expected a condition that some particle meets"
        raise UserError(f"{name}: --where: {expected}, got {given['where']!r}")


def none_of(path: str, options: argparse.Namespace) -> str:
    """What to say of a frame without particles."""
    if options.where is not None:
        return f"{said(path)}: no particle meets --where {options.where!r}"
    return f"{said(path)} holds no particles"


def first_of(path: str, n_frames: int, all_of_them: str) -> str:
    """What to say where only the first of a file's frames is taken."""
    which = f"{path} has {n_frames:,} frames, and this is the first"
    return f"{which}: --frame takes another, {all_of_them}"


def frame_number(path: str, frame: int | None) -> int:
    """The number of the frame that --frame chooses of a file; 0 without it."""
    from ..render.sequence import frames_of

    if isinstance(path, FrameOf):
        return path.frame
    return frames_of(path) + frame if frame is not None and frame < 0 else frame or 0


def stem(path: str) -> str:
    """A file's name without folder and extension."""
    from ..formats import READABLE
    from ..formats.volumes import WRITABLE

    name = os.path.basename(os.path.normpath(path))
    if not name.lower().endswith((*READABLE, *WRITABLE)):
        name = plain_name(name)
    endings = [end for end in (*READABLE, *WRITABLE) if name.lower().endswith(end)]
    return name[: -len(max(endings, key=len))] if endings else name


def read_sweep_file(path: str, **options: Any) -> Any:
    """The tracked frames of a file or folder. Raises UserError if they cannot be read."""
    from ..ultrasound.files import read_sweep

    with readable(path):
        return read_sweep(path, **options)


def check_voxel_size(spacing: float | None, sweep: Any) -> None:
    """Refuse voxels larger than the whole sweep: of another unit, or a mistyped number."""
    if spacing is None or not sweep.n_valid:
        return
    low, high = sweep.bounds()
    if spacing > (high - low).max():
        box = " x ".join(f"{v:.3g}" for v in high - low)
        raise UserError(f"--voxel-size: expected voxels smaller than the sweep of {box} mm, got {spacing:g} mm")


def read_volume_file(path: str) -> Any:
    """The volume of a file. Raises UserError if the volume cannot be read."""
    from ..volumes.files import read_volume

    with readable(path):
        return read_volume(path)


def check_output(option: str, path: str, extensions: Sequence[str], made: str = "") -> None:
    """Refuse a file that could not be written, before any work. made: a folder that has its own
    check, and that the command makes."""
    if os.path.isdir(path):
        raise UserError(f"{option}: expected a file name, got the folder {path}")
    if not path.lower().endswith(tuple(extensions)):
        raise UserError(f"{option}: expected a name ending in {' '.join(extensions)}, got {path}")
    folder = os.path.dirname(path) or "."
    if made and not os.path.exists(folder) and os.path.abspath(folder) == os.path.abspath(made):
        return
    if not os.path.isdir(folder):
        raise UserError(f"{option}: expected an existing folder, got {folder} (mkdir -p makes it)")
    try:
        os.lstat(path)
    except OSError as error:
        if error.errno == errno.ENAMETOOLONG:
            name = os.path.basename(path)
            raise UserError(f"{option}: expected a shorter name, got {len(name)} letters: {name[:40]} …") from None
    if os.path.exists(path) and not os.access(path, os.W_OK):
        raise UserError(f"{option}: expected a place that may be written, got {path}")
    if os.path.isfile(path) or not os.path.exists(path):  # else a pipe or a device
        _check_place(option, path, os.path.dirname(os.path.realpath(path)))


def check_folder(option: str, path: str) -> None:
    """Refuse a folder that could not be made or written to, before any work."""
    there = os.path.realpath(path)
    while not os.path.lexists(there):
        there = os.path.dirname(there)
    if not os.path.isdir(there):
        raise UserError(f"{option}: expected a folder, got {path}: {there} is a file")
    _check_place(option, path, there)


def make_folder(option: str, path: str) -> None:
    """Make a folder to write to, if it is not there."""
    check_folder(option, path)
    try:
        os.makedirs(path, exist_ok=True)
    except OSError as error:
        raise UserError(f"{option}: expected a folder, got {path}: {error.strerror}") from error


def _check_place(option: str, path: str, folder: str) -> None:
    """Refuse a path that cannot be written to this folder. Only trying tells: root has the
    permission to write to /proc, where no file can be made."""
    try:
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        expected = "expected a place that may be written"
        raise UserError(f"{option}: {expected}, got {path}: {error.strerror}") from error


def said_threads(device: str, threads: int) -> str:
    """A CPU's description with the number of threads that --threads gives."""
    return re.sub(r"\d+ threads?", count(threads, "thread"), device) if threads else device


def count(n: int, noun: str = "particle") -> str:
    """ "1 particle", "1,000 particles"."""
    return f"{n:,} {noun}{'' if n == 1 else 's'}"


def print_json(value: Any) -> None:
    """One JSON object on stdout; numbers that JSON cannot hold become null."""
    print(json.dumps(_plain(value), indent=2, allow_nan=False))


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple, np.ndarray)):
        return [_plain(item) for item in value]
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


class Progress:
    """A bar on stderr if stderr is a terminal; silent in a pipe. A context manager: the bar
    disappears when the block ends, so that messages stand alone."""

    def __init__(self, n_steps: int):
        self.n_steps, self.done = n_steps, 0
        self.shown = bool(sys.stderr) and sys.stderr.isatty()

    def step(self, what: str) -> None:
        """The next step starts."""
        self.show(what)
        self.done += 1

    def show(self, what: str) -> None:
        """Show what happens within a step."""
        if self.shown:
            filled = 24 * self.done // max(1, self.n_steps)
            bar = "█" * filled + "░" * (24 - filled)
            width = os.get_terminal_size(sys.stderr.fileno()).columns or 80  # 0: not known
            line = f"{bar} {self.done}/{self.n_steps} {what}"[: max(10, width - 1)]
            print(f"\r\033[K{line}", end="", file=sys.stderr, flush=True)

    def clear(self) -> None:
        """Remove the bar, for a message in its place."""
        if self.shown:
            print("\r\033[K", end="", file=sys.stderr, flush=True)

    def __enter__(self) -> Progress:
        return self

    def __exit__(self, *_: object) -> None:
        self.clear()
