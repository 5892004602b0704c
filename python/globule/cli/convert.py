"""Convert particles, tracked sweeps or volumes to another file format.

The extensions of the names give the formats. Meshes become particles, and so do volumes with
--level or --label. A volume as .png becomes an image of three planes. An OUT with %d, such as
step_%04d.vtk, takes all frames of a file with several, and several files; so does a .pvd, which
names .vtp files that are written beside it."""

from __future__ import annotations

import argparse
import os
import re
from collections.abc import Mapping

import numpy as np

from ..data.particles import SCALAR_FIELDS, UP, Particles
from ..formats import READABLE, WRITABLE, write
from ..formats.vtk_collections import write_pvd
from ..render.sequence import find_files, leader, with_frames
from . import flags, medical
from . import medical as medical_files
from .parser import Parser
from .shared import (
    UserError,
    check_input,
    check_output,
    count,
    first_of,
    frame_number,
    mistakes,
    read_file,
    reading,
    say,
    settle_origin,
)

SUMMARY = "files from one format to another"
USAGE = "IN [IN ...] OUT"
EXAMPLES = """\
  globule convert splash.npz splash.vtk
  globule convert frame_*.ply step_%04d.vtp
  globule convert volume.npz volume.nii.gz
  globule convert volume.npz three-view.png
  globule convert head.nii.gz head.npz --level 90"""

# Formats that keep only some of the fields; all other formats keep all fields.
_KEPT = {
    ".txt": ("color", "reflection", "refraction", "rigidity"),
    ".dat": ("color", "reflection", "refraction", "rigidity"),
    ".npy": (),
}
_IN_METERS = (".usd", ".usda", ".usdc")
_WITH_UP = (".npz", *_IN_METERS)
_FLOAT32_ONLY = (".bgeo", ".bgeo.gz")


def add_arguments(parser: Parser) -> None:
    """The arguments of `globule convert`."""
    formats = " ".join(dict.fromkeys((*READABLE, *medical_files.EXTENSIONS)))
    parser.add_argument("input", nargs="+", metavar="IN", help=f"file to read: {formats}")
    formats = " ".join(dict.fromkeys((*WRITABLE, ".pvd", *medical.WRITABLE)))
    parser.add_argument("output", metavar="OUT", help=f"file to write: {formats}")
    flags.add_reading(parser)


def run(options: argparse.Namespace) -> None:
    """Run `globule convert`."""
    given = reading(options)
    with mistakes():
        inputs = find_files(options.input)
    kind = medical.kind_of(inputs[0]) if len(inputs) == 1 else None
    if kind and not given:
        _check_other([inputs[0], options.output])
        print(medical.convert(inputs[0], options.output, kind))
        return
    for path in inputs:
        check_input(path, list(given))
    check_output("OUT", options.output, (*WRITABLE, ".pvd"))
    folder, name = os.path.split(options.output)
    of_all = options.output.lower().endswith(".pvd")
    name = f"{name[:-4].replace('%', '_')}_%04d.vtp" if of_all else name
    number = re.search(r"%0?\d?d", name)
    files, outputs = inputs, [os.path.join(folder, name)]
    if of_all and options.frame is not None and len(inputs) == 1:
        outputs = [outputs[0] % 0]
    elif number and options.frame is not None and len(inputs) == 1:
        at = frame_number(inputs[0], options.frame)
        outputs = [os.path.join(folder, name.replace(number[0], number[0] % at))]
    elif number:
        files = with_frames(inputs, **given) if options.frame is None else inputs
        names = [name.replace(number[0], number[0] % k) for k in range(len(files))]
        outputs = [os.path.join(folder, one) for one in names]
    elif len(inputs) > 1:
        raise UserError(f"OUT: expected a name with %d for {len(inputs)} files, got {options.output}")
    _check_other([*inputs, *outputs], len(inputs))
    if len(files) > 1:
        settle_origin(options, files[leader(files, **given)])
        given = reading(options)
    said: set[str] = set()
    times: list[float] = []
    for k, (file, output) in enumerate(zip(files, outputs, strict=True)):
        contents = read_file(file, len(files) > 1, **given)
        particles = contents.particles
        times.append(float(k) if contents.time is None else contents.time)
        with mistakes():
            write(output, particles)
        notes = losses(particles, output) + _units_lost(contents.units, output, options.scale)
        if contents.n_frames > 1 and len(files) == 1 and options.frame is None:
            notes.append(first_of(file, contents.n_frames, "an OUT with %d takes all"))
        for note in notes:
            if note not in said:
                say(f"note: {note}")
        said.update(notes)
        print(f"{output}: {count(len(particles))}")
    if of_all:
        with mistakes():
            write_pvd(options.output, outputs, times)
        print(f"{options.output}: {count(len(files), 'frame')}")


def _check_other(paths: list[str], n: int = 1) -> None:
    """Refuse to write on one of the first n files."""
    read = [path for path in paths[:n] if os.path.exists(path)]
    for output in paths[n:]:
        if os.path.exists(output) and any(os.path.samefile(path, output) for path in read):
            raise UserError(f"OUT: expected another file than IN, got {output}")


def _units_lost(units: Mapping[str, str], output: str, scale: float | None) -> list[str]:
    """USD says the unit of its lengths, and particles have none: m is written."""
    unit = units.get("positions", "")
    factor = unit.removesuffix(" m")
    if scale is not None or factor == unit or not output.lower().endswith(_IN_METERS):
        return []
    return [f"lengths in a unit of {unit} become m: --scale {factor} keeps them"]


def losses(particles: Particles, output: str) -> list[str]:
    """The losses of the output's format, one line per field."""
    extension = next(e for e in WRITABLE if output.lower().endswith(e))
    lost = []
    if particles.up != UP and extension not in _WITH_UP:
        up = ",".join(f"{v:g}" for v in particles.up)
        lost.append(f"up, {up}, is dropped: {extension} cannot store it; --up {up} draws the new file as the old one")
    lost += [f"{name} is dropped: a column of words" for name, kinds in particles.names.items() if not kinds]
    if extension != ".npz":
        named = [name for name, kinds in particles.names.items() if kinds]
        lost += [f"the names of {name} are dropped: only .npz stores them" for name in named]
    if extension in _KEPT:
        given = [n for n in (*SCALAR_FIELDS, "color") if getattr(particles, n) is not None]
        for name in [*given, *particles.attributes]:
            if name not in _KEPT[extension]:
                lost.append(f"{name} is dropped: {extension} cannot store {name}")
    elif extension in _FLOAT32_ONLY:
        for name, array in particles.attributes.items():
            dtype = np.dtype(array.dtype)
            if dtype.kind == "f" and dtype.itemsize > 4:
                lost.append(f"{name} is rounded from {dtype} to float32, the longest type of {extension}")
    return lost
