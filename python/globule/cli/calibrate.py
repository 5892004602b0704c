"""Calibrate a tracked probe: where the pixels of its image lie, and the delay of its poses.

MARKS is a table (.csv) with the positions `column` and `row` of a fixed point in images. A bead or
a crossing of two wires is such a point. Each row also has the pose of the probe: x y z qx qy qz qw,
or m00 to m23. With --sweep, the number of the `frame` in the sweep, from 0, replaces the pose.

--delay finds the temporal
offset between image and tracker from a --sweep in which the probe changes its speed. The result is
a calibration (.toml) for `globule reconstruct --calibration`."""

from __future__ import annotations

import argparse
import dataclasses
from typing import Any

import numpy as np

from ..ultrasound.calibration import (
    Calibration,
    calibrate_point_target,
    read_calibration,
    temporal_offset,
    write_calibration,
)
from ..ultrasound.marks import Tracked, read_marks, read_tracked
from . import flags
from .parser import Parser
from .shared import UserError, check_output, count, mistakes, positive, print_json, warn

SUMMARY = "marked pixels and poses to the calibration of a probe"
USAGE = "[MARKS]"
EXAMPLES = """\
  globule calibrate marks.csv -o probe.toml
  globule calibrate marks.csv --sweep wires.igs.mha -o probe.toml
  globule calibrate --delay --sweep wires.igs.mha --calibration probe.toml -o timed.toml"""

CERTAIN = 0.05  # largest chance of a fit by random motion for the offset to be written
_STRIKING = 3.0  # times the rms
_UNLIKELY = 20.0  # pixels; larger residuals are no inaccuracy of marking


def add_arguments(parser: Parser) -> None:
    """The arguments of `globule calibrate`."""
    add = parser.add_argument
    add("marks", nargs="?", metavar="MARKS", help="table of marked pixels, .csv")
    flags.add(parser, "--output", "calibration .toml; default: none, only print the result")
    add(
        "--sweep",
        metavar="SWEEP",
        help="recording of the marked frames: PLUS file, or stack of images with --poses "
        "(default: none)",
    )
    flags.add(parser, "--poses", "default: none")
    flags.add(parser, "--frame-times", "default: none")
    add("--delay", action="store_true", help="find the temporal offset of the --sweep")
    add(
        "--max-delay",
        dest="most",
        type=positive,
        default=0.5,
        metavar="S",
        help="largest temporal offset that --delay considers, seconds (default: 0.5)",
    )
    parser.renamed(parser, "--most", "--max-delay")
    flags.add(parser, "--calibration", "the result keeps its other values; default: none")
    flags.add(parser, "--json")


def run(options: argparse.Namespace) -> None:
    """Run `globule calibrate`."""
    _check(options)
    try:
        with mistakes():
            earlier = read_calibration(options.calibration) if options.calibration else None
            tracked = None
            if options.sweep:
                tracked = read_tracked(options.sweep, options.poses, options.frame_times)
            report = _calibrated(options, earlier, tracked)
    except OSError as error:
        name = error.filename or options.marks or options.sweep
        raise UserError(f"{name}: cannot be read: {error.strerror or error}") from error
    for message in report["warnings"]:
        warn(message)
    if options.json:
        print_json(report)
    else:
        print("\n".join(_lines(report)))


def _check(options: argparse.Namespace) -> None:
    if not options.marks and not options.delay:
        raise UserError("MARKS: expected a table of marks or --delay, got neither")
    if options.delay and not options.sweep:
        raise UserError("--delay: expected --sweep beside --delay, got none")
    for name in ("poses", "frame_times"):
        if getattr(options, name) is not None and not options.sweep:
            option = f"--{name.replace('_', '-')}"
            raise UserError(f"{option}: expected --sweep beside {option}, got none")
    if options.output:
        check_output("-o", options.output, [".toml"])
        if not options.marks and not options.calibration:
            raise UserError("-o: expected MARKS or --calibration for the matrix, got neither")


def _calibrated(
    options: argparse.Namespace, earlier: Calibration | None, tracked: Tracked | None
) -> dict[str, Any]:
    """Calibrate, write the calibration, and return the report."""
    messages: list[str] = []
    report: dict[str, Any] = {"output": options.output, "warnings": messages}
    calibration = earlier
    if options.marks:
        marks = read_marks(options.marks, tracked)
        try:
            found = calibrate_point_target(*marks)
        except ValueError as error:
            raise ValueError(f"{options.marks}: {error}") from error
        kept = {} if earlier is None else {
            name: getattr(earlier, name) for name in ("temporal_offset", "clip", "fan")
        }  # fmt: skip
        calibration = dataclasses.replace(found.calibration, **kept)
        lengths = np.linalg.norm(found.residuals, axis=1)
        report |= {
            "probe_from_image": calibration.probe_from_image, "spacing": calibration.spacing,
            "target": found.target, "rms": calibration.rms, "residuals": lengths,
        }  # fmt: skip
        wild = np.flatnonzero(lengths > _STRIKING * np.median(lengths) + 1e-9)
        if len(wild):
            which = ", ".join(f"{i + 1} ({lengths[i]:.2f} mm)" for i in wild[:5])
            messages.append(
                f"{options.marks}: far from the other marks: mark {which}; check these marks"
            )
        assert calibration.rms is not None  # calibrate_point_target gives it
        pixels = calibration.rms / max(calibration.spacing[:2])
        if pixels > _UNLIKELY:
            messages.append(f"{options.marks}: residuals of {pixels:.0f} pixels; expected marks of "
                            "one point, and the poses of this sweep")  # fmt: skip
    if options.delay:
        assert tracked is not None  # --delay needs --sweep
        delay = _delay(options, tracked)
        report["temporal_offset"] = delay._asdict()
        if delay.chance > CERTAIN or not np.isfinite(delay.uncertainty):
            why = f"{100 * delay.chance:.0f} % of random motions fit as well"
            if not np.isfinite(delay.uncertainty):
                why = f"the best fit is at the limit of --max-delay, and {why}"
            messages.append(
                f"{options.sweep}: the temporal offset is uncertain and was not written: {why}"
            )
        elif calibration is not None:
            calibration = dataclasses.replace(calibration, temporal_offset=delay.offset)
    if options.output:
        assert calibration is not None  # -o needs MARKS or --calibration
        write_calibration(options.output, calibration)
    return report


def _delay(options: argparse.Namespace, tracked: Tracked) -> Any:
    if tracked.times is None or tracked.pose_times is None:
        raise UserError(f"{options.sweep}: expected times of frames and poses, got none")
    ok = np.flatnonzero(tracked.ok)
    if not len(ok):
        raise UserError(f"{options.sweep}: expected valid poses, got none")
    order = np.argsort(tracked.times, kind="stable")
    ok = ok[np.argsort(tracked.pose_times[ok], kind="stable")]
    return temporal_offset(
        tracked.frames[order], tracked.times[order],
        tracked.poses[ok], tracked.pose_times[ok], options.most,
    )  # fmt: skip


def _lines(report: dict[str, Any]) -> list[str]:
    lines = []
    if "rms" in report:
        lengths = report["residuals"]
        u, v = report["spacing"]
        target = " ".join(f"{x:.2f}" for x in report["target"])
        lines += [
            f"{count(len(lengths), 'mark')}: rms {report['rms']:.3f} mm, median "
            f"{np.median(lengths):.3f}, largest {lengths.max():.3f} mm (mark "
            f"{int(lengths.argmax()) + 1})",
            f"  pixels of {u:.5f} x {v:.5f} mm, target at {target} mm",
            "  residuals: " + " ".join(f"{x:.2f}" for x in lengths),
        ]
    if "temporal_offset" in report:
        found = report["temporal_offset"]
        apart = found["uncertainty"]
        within = f"± {apart:.4f}" if np.isfinite(apart) else "(of unknown accuracy)"
        lines.append(
            f"temporal offset {found['offset']:+.4f} s {within}, correlation "
            f"{found['correlation']:.2f}, reached by chance in {100 * found['chance']:.0f} %"
        )
    if report["output"]:
        lines.append(f"{report['output']}: written")
    return lines
