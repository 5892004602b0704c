"""Measure distances and volumes in a sweep's reconstruction, with their uncertainty.

The command reconstructs the sweep with the method frames. The expected error of each voxel, from
frames left out, gives the standard deviation of each result. It does not contain errors of the
calibration or of the tracker's scale.

--distance takes two points outside of an object, on both sides: the command fits the two edges
between them. Points outside of two bright echoes, as of wires or walls, give the distance of their
peaks; what fits better decides. --above and --below count the voxels on one side of a gray level;
--within limits them to a ball, which should leave room around the object and not much more."""

from __future__ import annotations

import argparse
import contextlib
from collections.abc import Iterator
from functools import partial
from typing import Any

from ..volumes.volume import FAR
from . import flags
from .parser import Parser
from .shared import (
    Progress,
    UserError,
    check_device,
    check_voxel_size,
    mistakes,
    number,
    numbers,
    positive,
    print_json,
    read_sweep_file,
    warn,
)

SUMMARY = "distances and volumes in a sweep, with their uncertainty"
USAGE = "SWEEP [--distance X0,Y0,Z0,X1,Y1,Z1] [--below V]"
EXAMPLES = """\
  globule measure lesion.npz --voxel-size 1 --distance 0,5,0,0,23,0 --width 2
  globule measure lesion.npz --voxel-size 1 --below 100 --within 0,14,0,8.5 --json"""


def add_arguments(parser: Parser) -> None:
    """The arguments of `globule measure`."""
    add = parser.add_argument
    add("sweep", metavar="SWEEP", help="file or folder of tracked frames")
    flags.own(parser, "--distance X0,Y0,Z0,X1,Y1,Z1", "distance of the two edges or bright echoes "
        "on the line between these points, mm, world; may be repeated", partial(numbers, like="X0,Y0,Z0,X1,Y1,Z1"), [],
        action="append")  # fmt: skip
    flags.own(parser, "--width MM", "diameter of the disc over which the values along a line are "
        "averaged, mm", positive, usual="one voxel")  # fmt: skip
    side = parser.add_mutually_exclusive_group()
    for name, word in (("--above", "brighter"), ("--below", "darker")):
        flags.own(side, f"{name} V", f"volume of what is {word} than this value, gray levels", number)
    flags.own(parser, "--within X,Y,Z,R", "ball whose voxels count for --above and --below: center "
        "and radius, mm, world", partial(numbers, like="X,Y,Z,R"), usual="all voxels")  # fmt: skip
    add("--voxel-size", dest="spacing", type=positive, required=True, metavar="MM", help="edge of a voxel, mm")
    flags.add(parser, "--calibration", "default: the recording's own transforms")
    flags.add(parser, "--plus", "default: none")
    flags.add(parser, "--json")
    flags.add_device(parser.add_argument_group("machine"))


@contextlib.contextmanager
def _mistakes(flag: str) -> Iterator[None]:
    """`mistakes`, with the name of the flag instead of the argument's."""
    try:
        yield
    except ValueError as error:
        raise UserError(f"{flag}: {str(error).partition(': ')[2]}") from error


def _warnings(volume: Any, level: float, found: float, silent: bool) -> list[str]:
    """What is unusual about a volume of voxels on one side of a level."""
    values = volume.values[volume.radius != FAR]
    low, high = float(values.min()), float(values.max())
    if found and low <= level <= high:
        return []
    message = f"the level {level:g} separates no voxels; the values are {low:g} to {high:g}"
    if not silent:
        warn(message)
    return [message]


def run(options: argparse.Namespace) -> None:
    """Run `globule measure`."""
    from ..ultrasound.measuring import find_error_length, measure_distance, measure_volume
    from ..ultrasound.reconstruct import reconstruct

    level = options.above if options.above is not None else options.below
    if options.within and options.within[3] <= 0:
        raise UserError(f"--within: expected a radius above 0, got {options.within[3]:g}")
    if not options.distance and level is None and not options.within:
        raise UserError("--distance: expected --distance, --above or --below, got none")
    if options.within and level is None:
        raise UserError("--within: expected --above or --below beside --within, got none")
    if options.calibration and options.plus:
        raise UserError("--plus: expected no --calibration beside --plus, got both")
    check_device(options)
    with Progress(3) as progress:
        progress.step(f"reading {options.sweep}")
        sweep = read_sweep_file(options.sweep, calibration=options.calibration, plus=options.plus)
        check_voxel_size(options.spacing, sweep)
        progress.step("reconstructing")
        with mistakes("", MemoryError):
            volume = reconstruct(sweep, spacing=options.spacing, device=options.device, threads=options.threads)
            length = find_error_length(sweep, options.spacing)
        progress.step("measuring")
        report: dict[str, Any] = {"input": options.sweep, "error_length": length, "distances": []}
        for line in options.distance:
            with _mistakes("--distance"):
                found = measure_distance(volume, line[:3], line[3:], length, options.width or 0.0)
            report["distances"].append(found._asdict())
        if level is not None:
            ball = options.within or (None,) * 4
            center = ball[:3] if options.within else None
            with _mistakes("--within"):
                counted = measure_volume(volume, length, options.above, options.below, center, ball[3])
            report["volume"] = counted._asdict()
            report["warnings"] = _warnings(volume, level, counted.volume, options.json)
    if options.json:
        print_json(report)
        return
    for one in report["distances"]:
        size = f"distance {one['distance']:.2f} mm, standard deviation {one['std']:.2f} mm"
        print(f"{size}, between two {one['between']}")
        word = {"edges": "edge", "echoes": "echo"}[one["between"]]
        for edge, std in zip(one["edges"], one["edge_std"], strict=True):
            print(f"  {word} at {edge[0]:.2f}, {edge[1]:.2f}, {edge[2]:.2f} ± {std:.2f} mm")
    if level is not None:
        one = report["volume"]
        print(
            f"volume {one['volume']:.4g} mm^3, standard deviation {one['std']:.2g} mm^3; "
            f"{one['unknown']:.3g} mm^3 of the region without data"
        )
