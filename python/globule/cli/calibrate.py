"""Calibrate a tracked probe: where the pixels of its image lie, and the delay of its poses.

MARKS is a table (.csv) with the positions `column` and `row` of a fixed point in images. A bead or
a crossing of two wires is such a point. Each row also has the pose of the probe: x y z qx qy qz qw,
or m00 to m23. With --sweep, the number of the `frame` in the sweep, from 0, replaces the pose.

--n-wire finds the wires of an N-wire phantom in the images of a --sweep and calibrates from these.
--delay finds the temporal offset between image and tracker from a --sweep in which the probe
changes its speed. --stylus finds the tip of a stylus, --landmarks the place of a phantom. The
result is a calibration (.toml, or .xml for PLUS) for `globule reconstruct --calibration`."""

from __future__ import annotations

import argparse
import dataclasses
from typing import Any
from zlib import crc32

import numpy as np

from ..ultrasound.calibration import (
    Calibration,
    calibrate_point_target,
    read_calibration,
    temporal_offset,
    write_calibration,
)
from ..ultrasound.calibration_report import WORSE, WRONG
from ..ultrasound.marks import Tracked, read_landmarks, read_marks, read_tracked
from ..ultrasound.n_wires import NWireCalibration, WireErrors, calibrate_n_wires, tracked_poses, validate_n_wires
from ..ultrasound.plus_setup import write_plus
from ..ultrasound.stylus import calibrate_stylus, register_landmarks, write_stylus
from ..ultrasound.temporal import METHODS
from ..ultrasound.wires import NWirePhantom, WirePoints, read_phantom, write_phantom
from . import flags
from .calibration_lines import lines_of
from .parser import Parser
from .shared import UserError, check_output, mistakes, positive, print_json, readable, warn

SUMMARY = "marked pixels, wires or motion to the calibration of a probe"
USAGE = "[MARKS]"
EXAMPLES = """\
  globule calibrate marks.csv -o probe.toml
  globule calibrate marks.csv --sweep wires.igs.mha -o probe.toml
  globule calibrate --delay --sweep wires.igs.mha"""

_STRIKING = 3.0  # times the rms
_UNLIKELY = 20.0  # pixels; larger residuals are no inaccuracy of marking
_LARGE_ERROR = 1.0  # mm, in the middle of the wires
_MOST_AGAIN = 0.5  # of a validation's images: those of the calibration's recording


def add_arguments(parser: Parser) -> None:
    """The arguments of `globule calibrate`."""
    add = parser.add_argument
    add("marks", nargs="?", metavar="MARKS", help="table of marked pixels, .csv")
    flags.add(parser, "--output", "calibration .toml or PLUS configuration .xml; default: none, only print the result")
    flags.own(parser, "--sweep SWEEP", "recording of the marked frames, the wires, the motion or "
        "the stylus: PLUS file, or stack of images with --poses")  # fmt: skip
    flags.add(parser, "--poses", "default: none")
    flags.add(parser, "--frame-times", "default: none")
    flags.own(parser, "--n-wire PHANTOM", "calibrate from this N-wire phantom: PLUS configuration "
        ".xml, or .toml", dest="phantom")  # fmt: skip
    flags.own(parser, "--validate SWEEP", "another recording of the --n-wire phantom, whose errors "
        "are reported")  # fmt: skip
    flags.own(parser, "--delay", "find the temporal offset of the --sweep")
    flags.own(parser, "--max-delay S", "largest temporal offset that --delay considers, seconds",
        positive, usual="0.5, with --n-wire 1", dest="most")  # fmt: skip
    flags.own(parser, "--motion NAME", "image motion that --delay uses: line (a straight echo, as "
        "the bottom of a water tank), speckle (tissue), auto", METHODS, "auto",
        usual="auto, the line where images show one")  # fmt: skip
    flags.own(parser, "--stylus", "find the tip of the Stylus in a pivoting --sweep")
    flags.own(parser, "--landmarks TABLE", "table .csv of name, x, y, z: landmarks of the --n-wire "
        "phantom, touched, mm in the reference's frame",
        usual="none, the phantom's own registration")  # fmt: skip
    flags.own(parser, "--max-error MM", "refuse marks or a stylus whose expected error, at a "
        "corner of the image or at the tip, is larger, mm", positive, 2.0,
        dest="most_error")  # fmt: skip
    flags.own(parser, "--picture FILE.png", "picture of points, motions and residuals; needs "
        "matplotlib")  # fmt: skip
    flags.own(parser, "--report FILE.html", "page with verdict, numbers and pictures of an --n-wire "
        "session: --sweep, --validate and --delay in one run; status 1 unless the verdict is to use it; needs "
        "matplotlib")  # fmt: skip
    flags.add(parser, "--calibration", "the result keeps its other values; default: none")
    flags.add(parser, "--json")


def run(options: argparse.Namespace) -> None:
    """Run `globule calibrate`."""
    _check(options)
    with readable(options.marks or options.sweep):
        report = _report(options)
    for message in report["warnings"]:
        warn(message)
    if options.json:
        print_json(report)
    else:
        print("\n".join(lines_of(report)))
    if not report.get("usable", True) or not report.get("verdict", {"passed": True})["passed"]:
        raise SystemExit(1)


def _check(options: argparse.Namespace) -> None:
    ways = {"MARKS": options.marks, "--n-wire": options.phantom, "--stylus": options.stylus}
    given = [name for name, value in ways.items() if value]
    if len(given) > 1:
        raise UserError(f"{given[1]}: expected only one of {', '.join(ways)}, got {given[0]}, too")
    if not given and not options.delay:
        got = "MARKS: expected a table of marks, --n-wire, --stylus or --delay, got none"
        raise UserError(got)
    there = {"--n-wire": options.phantom, "--sweep": options.sweep, "--delay": options.delay,
             "--sweep or --landmarks": options.sweep or options.landmarks}  # fmt: skip
    needs = {
        "--delay": (options.delay, "--sweep"), "--stylus": (options.stylus, "--sweep"),
        "--n-wire": (options.phantom, "--sweep or --landmarks"), "--landmarks": (options.landmarks, "--n-wire"),
        "--report": (options.report, "--n-wire", "--sweep", "--delay"),
        "--validate": (options.validate, "--n-wire", "--sweep"),
        "--poses": (options.poses, "--sweep"), "--frame-times": (options.frame_times, "--sweep"),
    }  # fmt: skip
    for option, (value, *wanted) in needs.items():
        missing = [name for name in wanted if not there[name]]
        if value and missing:
            raise UserError(f"{option}: expected {' and '.join(missing)} beside {option}, got none")
    if options.output:
        check_output("-o", options.output, [".toml", ".xml"])
        if not given and not options.calibration:
            raise UserError(
                "-o: expected MARKS or --calibration for the matrix, got neither; without -o, the offset is printed"
            )
    for option, path, ending in (("--picture", options.picture, ".png"), ("--report", options.report, ".html")):
        if not path:
            continue
        check_output(option, path, [ending])
        try:
            import matplotlib  # noqa: F401
        except ImportError as error:
            message = f'{option} needs matplotlib: pip install "globule[figures]"'
            raise UserError(message) from error


def _report(options: argparse.Namespace) -> dict[str, Any]:
    """Calibrate, write what was asked for, and return the report."""
    report: dict[str, Any] = {"output": options.output, "warnings": []}
    if options.stylus:
        return report | _stylus(options)
    if options.phantom:
        return _n_wires(options, report)
    earlier = read_calibration(options.calibration) if options.calibration else None
    tracked = _tracked(options, options.sweep) if options.sweep else None
    return _calibrated(options, earlier, tracked, report)


def _tracked(options: argparse.Namespace, path: str, tool: str = "Probe") -> Tracked:
    own = path == options.sweep  # the table of poses and the rate are those of --sweep
    return read_tracked(path, options.poses if own else None, options.frame_times if own else None, tool)


def _calibrated(
    options: argparse.Namespace, earlier: Calibration | None, tracked: Tracked | None,
    report: dict[str, Any],
) -> dict[str, Any]:  # fmt: skip
    """Of marks, and of the temporal offset."""
    messages = report["warnings"]
    calibration = earlier
    if options.marks:
        size = None if tracked is None else tracked.frames.shape[:0:-1]
        marks = read_marks(options.marks, tracked)
        try:
            found = calibrate_point_target(*marks, size, options.most_error)
        except ValueError as error:
            raise ValueError(f"{options.marks}: {error}") from error
        calibration = _kept(found.calibration, earlier)
        lengths = np.linalg.norm(found.residuals, axis=1)
        report |= {
            "probe_from_image": calibration.probe_from_image, "spacing": calibration.spacing,
            "target": found.target, "rms": calibration.rms, "residuals": lengths,
            "weights": found.weights, "held_out": found.held_out, "corner_errors": found.errors,
            "turns": found.turns,
        }  # fmt: skip
        wild = np.flatnonzero(lengths > _STRIKING * np.median(lengths) + 1e-9)
        if len(wild):
            which = ", ".join(f"{i + 1} ({lengths[i]:.2f} mm)" for i in wild[:5])
            messages.append(
                f"{options.marks}: far from the other marks: mark {which}; these marks count "
                "little or not at all, check them"
            )
        assert calibration.rms is not None  # calibrate_point_target gives it
        pixels = calibration.rms / max(calibration.spacing[:2])
        if pixels > _UNLIKELY:
            messages.append(f"{options.marks}: residuals of {pixels:.0f} pixels; expected marks of "
                            "one point, and the poses of this sweep")  # fmt: skip
        if options.picture and not options.delay:
            from ..ultrasound.calibration_plots import draw_residuals

            draw_residuals(options.picture, lengths, found.weights, "mark", found.held_out)
    if options.delay:
        assert tracked is not None  # --delay needs --sweep
        calibration = _with_delay(options, tracked, calibration, report)
    if options.output:
        assert calibration is not None  # -o needs MARKS or --calibration
        _write(options, calibration, messages)
    return report


def _kept(calibration: Calibration, earlier: Calibration | None) -> Calibration:
    """With what the earlier one says beside the matrix."""
    if earlier is None:
        return calibration
    names = ("temporal_offset", "clip", "fan")
    return dataclasses.replace(calibration, **{name: getattr(earlier, name) for name in names})


def _write(options: argparse.Namespace, calibration: Calibration, messages: list[str]) -> None:
    base = next((p for p in (options.phantom, options.calibration) if p and p.lower().endswith(".xml")), None)
    write_calibration(options.output, calibration, base)
    if options.output.lower().endswith(".xml") and calibration.temporal_offset:
        messages.append(
            f"{options.output}: holds the transform alone; add {calibration.temporal_offset:+.4f} to "
            "LocalTimeOffsetSec of the images' Device in the configuration"
        )


def _with_delay(
    options: argparse.Namespace, tracked: Tracked, calibration: Calibration | None,
    report: dict[str, Any],
) -> Calibration | None:  # fmt: skip
    delay = _delay(options, tracked)
    report["temporal_offset"] = delay._asdict()
    del report["temporal_offset"]["curves"]
    if options.picture:
        from ..ultrasound.calibration_plots import draw_offset

        draw_offset(options.picture, delay)
    if delay.doubt:
        problem = f"{options.sweep}: the temporal offset is uncertain: {delay.doubt}"
        if options.output:
            found = f"{delay.offset:+.4f} s by {delay.method}"
            raise UserError(f"{problem} (found {found}); {options.output} was not written")
        report["warnings"].append(problem)
    elif calibration is not None:
        return dataclasses.replace(calibration, temporal_offset=delay.offset)
    return calibration


def _timed(path: str, tracked: Tracked) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Frames, their times, valid poses and their times, in the order of time."""
    if not tracked.frames.size:
        raise UserError(f"{path}: expected images, got poses alone")
    if tracked.times is None or tracked.pose_times is None:
        raise UserError(f"{path}: expected times of frames and poses, got none")
    ok = np.flatnonzero(tracked.ok)
    if not len(ok):
        raise UserError(f"{path}: expected valid poses, got none")
    ok = ok[np.argsort(tracked.pose_times[ok], kind="stable")]
    return tracked.frames, tracked.times, tracked.poses[ok], tracked.pose_times[ok]


def _delay(options: argparse.Namespace, tracked: Tracked) -> Any:
    frames, times, poses, pose_times = _timed(options.sweep, tracked)
    order = np.argsort(times, kind="stable")
    most = 0.5 if options.most is None else options.most
    return temporal_offset(frames[order], times[order], poses, pose_times, most, options.motion)


# N-wires


def _n_wires(options: argparse.Namespace, report: dict[str, Any]) -> dict[str, Any]:
    phantom = read_phantom(options.phantom)
    if options.landmarks:
        phantom = _registered(options, phantom, report)
        if not options.sweep:
            _write_registration(options, phantom, report)
            return report
    earlier = read_calibration(options.calibration) if options.calibration else None
    data = _timed(options.sweep, _tracked(options, options.sweep))
    with mistakes(options.sweep):
        found = calibrate_n_wires(
            *data, phantom, earlier.temporal_offset if earlier else 0.0, options.delay,
            1.0 if options.most is None else options.most,
        )  # fmt: skip
    calibration = found.calibration
    validation, validated = None, options.validate
    if validated:
        more = _timed(validated, _tracked(options, validated))
        with mistakes(validated):
            validation, dots = validate_n_wires(calibration, *more, phantom)
        report["validation"] = _wire_report(validation, dots, phantom)
        n_again = _n_again(data, more)
        if n_again > _MOST_AGAIN * len(more[0]):
            which = "the images" if n_again == len(more[0]) else f"{n_again:,} of {len(more[0]):,} images are those"
            report["warnings"].append(f"{validated}: {which} of --sweep again, which validate nothing")
            validated = None
        else:
            found = _by_validation(found, validation, earlier, more, phantom)
    report |= {
        "probe_from_image": calibration.probe_from_image, "spacing": calibration.spacing,
        "calibration": _wire_report(found.errors, found.points, phantom),
        "corner_errors": found.corners, "center_error": found.center,
        "temporal_offset": {
            "offset": calibration.temporal_offset, "uncertainty": found.offset_uncertainty,
            "method": "wires" if options.delay else "given", "skew": None,
        },
        "left_out": int((found.weights == 0).sum()),
    }  # fmt: skip
    if options.report:
        from ..ultrasound.calibration_report import Session, write_report

        own = _own_calibration(options, more, phantom, earlier) if validated else None
        session = Session(options.phantom, options.sweep, validated, found, validation if validated else None, own)
        report["verdict"] = write_report(options.report, session, data[0], phantom)
        report["report"] = options.report
    problem = found.slip or (found.offset_doubt and f"the temporal offset is uncertain: {found.offset_doubt}")
    if problem:
        problem = f"{options.sweep}: {problem}" + (f"; {options.output} was not written" if options.output else "")
        if options.output and not options.report:
            raise UserError(problem)
        report["warnings"].append(problem)
        report["output"] = None
    wrong = _why_unusable(options, found, validation if validated else None)
    report["usable"] = not wrong
    report["warnings"] += [f"do not use this calibration: {message}" for message in wrong]
    report["warnings"] += _wire_warnings(options, found)
    if options.picture:
        from ..ultrasound.calibration_plots import draw_wires

        draw_wires(options.picture, data[0], found, phantom, validation)
    if options.output and not problem:
        if earlier is not None:
            calibration = dataclasses.replace(calibration, clip=earlier.clip, fan=earlier.fan)
        _write(options, calibration, report["warnings"])
    return report


def _n_again(data: tuple[np.ndarray, ...], more: tuple[np.ndarray, ...]) -> int:
    """How many images of a recording have the pixels, or the pose, of an image of another one."""

    def marks(frames: np.ndarray, times: np.ndarray, poses: np.ndarray, pose_times: np.ndarray) -> list[tuple]:
        at, ok = tracked_poses(poses, pose_times).at(times)
        words = np.round(at[:, :3].reshape(len(at), -1), 6) + 0.0
        return [(crc32(frame.tobytes()), pose.tobytes() if known else None)
                for frame, pose, known in zip(frames, words, ok, strict=True)]  # fmt: skip

    pixels, places = (set(one) for one in zip(*marks(*data), strict=True))
    return sum(a in pixels or (b is not None and b in places) for a, b in marks(*more))


def _own_calibration(
    options: argparse.Namespace, data: tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray],
    phantom: NWirePhantom, earlier: Calibration | None,
) -> NWireCalibration | None:  # fmt: skip
    """That of the validation's recording; None if it gives none."""
    try:
        return calibrate_n_wires(
            *data, phantom, earlier.temporal_offset if earlier else 0.0, True,
            1.0 if options.most is None else options.most,
        )  # fmt: skip
    except ValueError:
        return None


def _by_validation(
    found: NWireCalibration, validation: WireErrors, earlier: Calibration | None,
    more: tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray], phantom: NWirePhantom,
) -> NWireCalibration:  # fmt: skip
    """With a doubt where a fitted offset makes the errors of the other recording larger."""
    before = earlier.temporal_offset if earlier else 0.0
    apart = found.offset_uncertainty
    if apart is None or found.offset_doubt or abs(found.calibration.temporal_offset - before) <= 2 * apart:
        return found
    given = dataclasses.replace(found.calibration, temporal_offset=before)
    without = validate_n_wires(given, *more, phantom)[0].summary()["mean_of_95"]
    size = validation.summary()["mean_of_95"]
    if size <= without:
        return found
    doubt = f"it makes the validation's 3-D error larger, {size:.3f} instead of {without:.3f} mm"
    return found._replace(offset_doubt=doubt)


def _wire_warnings(options: argparse.Namespace, found: NWireCalibration) -> list[str]:
    messages = []
    if found.better_offset is not None:
        offset, spread, before, after = found.better_offset
        messages.append(
            f"{options.sweep}: a temporal offset of {offset:+.3f} ± {spread:.3f} s fits better "
            f"({after:.1f} instead of {before:.1f} pixels); add --delay to find it with the matrix"
        )
    if found.center > _LARGE_ERROR:
        messages.append(
            f"{options.sweep}: expected errors below {_LARGE_ERROR:g} mm in the middle of the "
            f"wires (95 %), got {found.center:.1f} mm; turn and tilt the probe more"
        )
    return messages


def _why_unusable(options: argparse.Namespace, found: NWireCalibration, validation: WireErrors | None) -> list[str]:
    """What makes a calibration wrong, and not only inaccurate."""
    messages = []
    if found.misplaced:
        messages.append(f"{options.sweep}: {found.misplaced}; register the phantom again")
    size = found.errors.summary()["median"]
    if size > WRONG:
        messages.append(
            f"{options.sweep}: 3-D errors of {size:.1f} mm; expected the registration of this "
            "phantom, and poses of the probe in mm in the frame of its reference"
        )
    if validation is not None:
        other, own = (of.summary()["mean_of_95"] for of in (validation, found.errors))
        if other > WORSE * own:
            messages.append(f"{options.validate}: 3-D errors of {other:.2f} mm, in {options.sweep} {own:.2f} mm")
    return messages


def _wire_report(errors: WireErrors, dots: WirePoints, phantom: NWirePhantom) -> dict[str, Any]:
    n_found = int(dots.found.sum())
    return {
        "images": len(dots.found), "found": n_found, "used": len(errors.frames),
        "without_pose": n_found - len(errors.frames),
        **errors.summary(),
        "wires": {
            name: {"mean_pixels": errors.two_d[:, i].mean(axis=0),
                   "deviation_pixels": errors.two_d[:, i].std(axis=0)}
            for i, name in enumerate(phantom.names)
        },
        "frames": errors.frames, "three_d": errors.three_d,
        "points": dots.points[errors.frames],
    }  # fmt: skip


def _registered(options: argparse.Namespace, phantom: NWirePhantom, report: dict[str, Any]) -> NWirePhantom:
    names, touched = read_landmarks(options.landmarks)
    unknown = [name for name in names if name not in phantom.landmarks]
    if unknown:
        known = ", ".join(phantom.landmarks) or "none"
        raise UserError(f"{options.landmarks}: expected landmarks of the phantom ({known}), got {unknown[0]}")
    own = np.array([phantom.landmarks[name] for name in names])
    found = register_landmarks(own, touched, phantom.wires.reshape(-1, 3))
    report["registration"] = {
        "reference_from_phantom": found.matrix, "rms": found.rms, "error": found.error,
        "bound": found.bound, "names": names, "residuals": found.residuals, "weights": found.weights,
    }  # fmt: skip
    wrong = [
        f"{name} ({size:.1f} mm)"
        for name, size, weight in zip(names, found.residuals, found.weights, strict=True)
        if weight == 0
    ]
    if wrong:
        report["warnings"].append(f"{options.landmarks}: left out: {', '.join(wrong)}")
    if options.picture and not options.sweep:
        from ..ultrasound.calibration_plots import draw_residuals

        draw_residuals(options.picture, found.residuals, found.weights, "landmark")
    return dataclasses.replace(
        phantom, reference_from_phantom=found.matrix, error=max(found.error, 0.05), landmark_error=None
    )


def _write_registration(options: argparse.Namespace, phantom: NWirePhantom, report: dict[str, Any]) -> None:
    if not options.output:
        return
    if options.output.lower().endswith(".toml"):
        write_phantom(options.output, phantom)
        return
    assert phantom.reference_from_phantom is not None  # just registered
    key = ("Phantom", "Reference")
    base = options.phantom if options.phantom.lower().endswith(".xml") else None
    rms = max(report["registration"]["rms"], 0.05)  # PLUS states the error of a landmark
    write_plus(options.output, {key: phantom.reference_from_phantom}, base, {key: rms})


def _stylus(options: argparse.Namespace) -> dict[str, Any]:
    tracked = _tracked(options, options.sweep, "Stylus")
    found = calibrate_stylus(tracked.poses[tracked.ok], options.most_error)
    lengths = np.linalg.norm(found.residuals, axis=1)
    if options.picture:
        from ..ultrasound.calibration_plots import draw_residuals

        draw_residuals(options.picture, lengths, found.weights, "pose")
    if options.output:
        write_stylus(options.output, found)
    return {
        "stylus": {
            "tip": found.tip, "pivot": found.pivot, "rms": found.rms, "error": found.error,
            "turn": found.turn, "poses": len(lengths), "left_out": int((found.weights == 0).sum()),
        },
    }  # fmt: skip
