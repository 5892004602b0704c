"""Register sweeps of one anatomy to the first of them, and reconstruct one volume of all.

The command moves and turns each sweep, as a rigid body, until its images match the first sweep. It
prints the motions with their expected errors, and refuses a result that cannot be trusted: sweeps
that overlap by less than a tenth, images that correlate below 0.3, other starts that end elsewhere,
or an error above --max-registration-error. Use it when the patient, or the tracked reference, moved
between the sweeps, or when each sweep has a world of its own.

The volume lies in the world of the first sweep; voxels that several sweeps cover take the mean, as
in `globule reconstruct`. --sweep-output writes the joined sweep for other methods and commands."""

from __future__ import annotations

import argparse
import contextlib
import os
from collections.abc import Iterator
from typing import Any

from ..formats.volumes import WRITABLE, check_name
from ..ultrasound.sweep_writing import WRITABLE as SWEEPS
from . import flags
from .parser import Parser
from .shared import (
    Progress,
    UserError,
    check_device,
    check_output,
    check_voxel_size,
    count,
    mistakes,
    positive,
    print_json,
    read_sweep_file,
)

SUMMARY = "sweeps of one anatomy, registered and compounded"
USAGE = "SWEEP SWEEP [SWEEP ...] [-o VOLUME]"
EXAMPLES = """\
  globule register first.npz second.npz --voxel-size 0.5 -o both.nrrd
  globule register first.npz second.npz --sweep-output both.npz --json"""
_SIZE = 256  # voxels along the longest axis


def add_arguments(parser: Parser) -> None:
    """The arguments of `globule register`."""
    parser.add_argument("sweeps", nargs="+", metavar="SWEEP", help="tracked frames, two or more")
    flags.add(parser, "--output", "volume of all sweeps; default: none")
    flags.own(parser, "--sweep-output PATH", "also write the joined sweep")
    flags.own(parser, "--voxel-size MM", "edge of a voxel, mm", positive,
        usual=f"{_SIZE} along the longest axis", dest="spacing")  # fmt: skip
    flags.own(parser, "--max-registration-error MM", "largest expected error of a registration "
        "that is accepted, mm", positive, usual="two voxels of the registration",
        dest="max_error")  # fmt: skip
    flags.add(parser, "--calibration", "of all sweeps; default: the recordings' own transforms")
    flags.add(parser, "--plus", "of all sweeps; default: none")
    flags.add(parser, "--json")
    flags.add_device(parser.add_argument_group("machine"))


def run(options: argparse.Namespace) -> None:
    """Run `globule register`."""
    from ..ultrasound.reconstruct import reconstruct
    from ..ultrasound.registration import join_sweeps, register_sweeps
    from ..volumes.files import write_volume

    names = options.sweeps
    _check(options)
    found = []
    with Progress(2 * len(names)) as progress:
        sweeps = []
        for name in names:
            progress.step(f"reading {name}")
            sweeps.append(read_sweep_file(name, calibration=options.calibration, plus=options.plus))
            check_voxel_size(options.spacing, sweeps[-1])
        with _naming(names), mistakes():
            join_sweeps(sweeps, [None] * len(sweeps))  # whether they can be joined
        for name, sweep in zip(names[1:], sweeps[1:], strict=True):
            progress.step(f"registering {name}")
            try:
                with mistakes():
                    found.append(register_sweeps(sweeps[0], sweep, max_error=options.max_error))
            except UserError as error:
                text = str(error).removeprefix("moving: ")
                text = text.replace("; max_error)", "; --max-registration-error)")
                if not text.startswith("fixed"):
                    text = f"{name}: {text}"
                raise UserError(text.replace("fixed:", f"{names[0]}:", 1)) from error
        joined = join_sweeps(sweeps, [None, *found])
        volume = None
        if options.output:
            progress.step("reconstructing")
            grid: dict[str, Any] = {"size": _SIZE} if options.spacing is None else {"spacing": options.spacing}
            with mistakes("", MemoryError):
                volume = reconstruct(joined, device=options.device, threads=options.threads, **grid)
            with mistakes():
                write_volume(options.output, volume)
        if options.sweep_output:
            from ..ultrasound.sweep_writing import write_sweep

            with mistakes():
                write_sweep(options.sweep_output, joined)
    report: dict[str, Any] = {
        "fixed": names[0],
        "registrations": [{"sweep": name, **one._asdict()} for name, one in zip(names[1:], found, strict=True)],
        "frames": len(joined),
        "output": options.output,
        "sweep_output": options.sweep_output,
    }
    if volume is not None:
        report["volume"] = {"size": volume.values.shape[::-1], "spacing": volume.spacing}
    if options.json:
        print_json(report)
        return
    for one in report["registrations"]:
        print(
            f"{one['sweep']}: turned {one['rotation']:.2f} degrees and moved "
            f"{one['translation']:.2f} mm, expected error {one['error']:.2f} mm (other direction "
            f"{one['inverse_error']:.2f} mm)\n  correlation {one['correlation']:.2f}, "
            f"{100 * one['overlap']:.0f} % overlap, {round(6 * one['agreeing'])} of 6 other "
            "starts agree"
        )
    if volume is not None:
        size = "x".join(map(str, report["volume"]["size"]))
        edge = volume.spacing[0]
        print(f"{options.output}: {size} voxels of {edge:.4g} mm, {count(joined.n_valid, 'frame')}")


@contextlib.contextmanager
def _naming(names: list[str]) -> Iterator[None]:
    """Messages about `sweeps[i]` name the file."""
    try:
        yield
    except UserError as error:
        text = str(error)
        for i, name in enumerate(names):
            text = text.replace(f"sweeps[{i}]", name)
        raise UserError(text) from error


def _check(options: argparse.Namespace) -> None:
    """Refuse what cannot work, before any work."""
    names = options.sweeps
    if len(names) < 2:
        raise UserError(f"SWEEP: expected two sweeps or more, got {len(names)}")
    if options.calibration and options.plus:
        raise UserError("--plus: expected no --calibration beside --plus, got both")
    check_device(options)
    if options.output:
        check_output("-o", options.output, WRITABLE)
        with mistakes():
            check_name(options.output, False)
    elif options.spacing is not None:
        raise UserError("--voxel-size: expected -o beside --voxel-size, got none")
    if options.sweep_output:
        check_output("--sweep-output", options.sweep_output, SWEEPS)
    taken = {os.path.realpath(name): name for name in names}
    outputs = {"-o": options.output, "--sweep-output": options.sweep_output}
    for option, name in outputs.items():
        if name and os.path.realpath(name) in taken:
            raise UserError(f"{option}: expected a name of its own, got {name} again")
        if name:
            taken[os.path.realpath(name)] = name
