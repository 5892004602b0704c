"""Reconstruct a volume from a tracked ultrasound sweep.

SWEEP is a PLUS/IGSIO recording (.igs.mha, .igs.nrrd), an .npz, or a stack of images with --poses.
The volume is .nrrd, .mha, .nii, .nii.gz, .dcm, .vti, .npz, or .sparse.npz (the occupied blocks
only).
.vti and .npz also store the origin of each value.

With --plus, the volume equals, voxel for voxel, the volume that PLUS reconstructs from the same
configuration. With --plus and --method, calibration and image region come from the
configuration, and the method is globule's."""

from __future__ import annotations

import argparse
import functools
import hashlib
import logging
import os
import time
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from typing import Any

import numpy as np

from ..formats.volumes import WRITABLE, check_name
from ..ultrasound.options import Options
from ..ultrasound.sweep import Sweep
from ..volumes.files import write_volume
from ..volumes.volume import Volume
from . import flags, live
from .parser import Parser
from .pictures import draw
from .shared import (
    Progress,
    UserError,
    check_device,
    check_output,
    check_voxel_size,
    count,
    mistakes,
    number,
    positive,
    print_json,
    read_sweep_file,
    readable,
    say,
    warn,
)

SUMMARY = "tracked ultrasound sweeps to volumes"
USAGE = "SWEEP -o PATH"
EXAMPLES = """\
  globule reconstruct sweep.igs.mha --calibration probe.toml -o volume.nrrd
  globule reconstruct sweep.igs.mha --plus config.xml -o volume.mha
  globule reconstruct sweep.igs.mha --calibration probe.toml -o fine.nrrd --voxel-size 0.5
  globule reconstruct sweep.igs.mha --plus config.xml -o volume.mha --three-view volume.png
  globule reconstruct frames/ --poses poses.csv --frame-times 25 --calibration probe.toml -o v.npz
  globule reconstruct sweep.igs.mha --calibration probe.toml --method frames --cross-validate 3"""
ESSENTIAL = ("--output", "--calibration", "--plus", "--poses", "--voxel-size", "--voxels",
             "--method", "--three-view", "--surface-image", "--live", "--device")  # fmt: skip

COMPARED = ("frames", "pvn-om", "vvn-om", "bezier")  # pvn and vvn give the same volumes, slower
DEFAULT_SIZE = 256
LARGE = 2048  # MiB; above, the command prints the size before it takes the memory


def numbers(text: str) -> tuple[float, ...]:
    """A,B,C …"""
    return tuple(number(word) for word in text.split(","))


def add_arguments(parser: Parser) -> None:
    """The arguments of `globule reconstruct`."""
    add = parser.add_argument
    add("sweep", nargs="?", metavar="SWEEP", help="file or folder of tracked frames")
    flags.add(parser, "--output", "volume; default: none")
    flags.own(parser, "--maps", "also write pixel count, variance and latest frame")
    flags.own(parser, "--three-view IMAGE.png", "also write an image of three planes, and of the "
        "origin of the values")  # fmt: skip
    flags.own(parser, "--surface-image IMAGE.png", "also write an image of the iso-surface, as "
        "`globule render` does")  # fmt: skip
    flags.own(parser, "--projections", "also draw maximum-intensity projections into the image of "
        "--three-view")  # fmt: skip
    flags.add(parser, "--json")
    flags.own(parser, "--cross-validate K", "leave out every K-th frame, predict the frame from "
        "the others, and print the error of each method in gray levels", int,
        usual="off")  # fmt: skip
    method = parser.add_argument_group("method")
    given = functools.partial(flags.add_settings, method, Options)
    given("method")
    grid = method.add_mutually_exclusive_group()
    flags.own(grid, "--voxel-size MM", "edge of a voxel, mm", positive, usual="from --voxels",
        dest="spacing")  # fmt: skip
    flags.own(grid, "--voxels N", "number of voxels along the longest axis", int,
        usual=str(DEFAULT_SIZE), dest="size")  # fmt: skip
    flags.own(method, "--bounds X0,Y0,Z0,X1,Y1,Z1", "lowest and highest corner of the volume, mm, "
        "world", numbers, usual="around all pixels", dest="region")  # fmt: skip
    flags.own(method, "--volume-axes NAME", "axes of the volume: world; sweep: along the sweep, "
        "which needs fewer voxels", ("world", "sweep"), "world", dest="axes")  # fmt: skip
    given("max_distance")
    given("extrapolate", action="store_true")
    for name in ("max_kernel", "compounding", "hole_weights"):
        given(name, default=getattr(Options, name))
    place = parser.add_argument_group("position of the pixels")
    flags.add(place, "--calibration", "default: the recording's own transforms")
    flags.add(place, "--plus", "default: none")
    flags.add(place, "--poses", "default: none")
    flags.add(place, "--frame-times", "default: none")
    flags.own(place, "--temporal-offset S", "seconds added to the time of a frame to find its pose",
        number, usual="the calibration's")  # fmt: skip
    flags.own(place, "--image-region COLUMN,ROW,WIDTH,HEIGHT", "rectangle of the image to use, "
        "pixels", numbers, usual="the calibration's, else all", dest="clip")  # fmt: skip
    flags.own(place, "--fan COLUMN,ROW,FIRST,LAST,START,STOP", "fan of the image to use: apex in "
        "pixels, first and last angle in degrees, first and last radius in pixels", numbers,
        usual="the calibration's, else all")  # fmt: skip
    flags.own(place, "--mask IMAGE", "image with nonzero pixels where the sweep shows tissue",
        usual="all pixels")  # fmt: skip
    flags.own(place, "--keep-outliers", "also use frames whose pose jumps (default: omit these "
        "frames with a warning)")  # fmt: skip
    live.add_arguments(parser)
    flags.add_device(parser.add_argument_group("machine"))


def run(options: argparse.Namespace) -> None:
    """Run `globule reconstruct`."""
    _check(options)
    check_device(options)
    start = time.perf_counter()
    messages: list[str] = []
    once = live.pressed_once() if options.live else nullcontext()
    with once, Progress(3 + bool(options.cross_validate)) as progress:
        progress.step(f"reading {options.sweep or options.live}")
        stream = live.Live(options, progress, _growing(options)) if options.live else None
        sweep, *others = stream.sweeps() if stream else [_sweep(options)]
        check_voxel_size(None if options.region else options.spacing, sweep)
        read_seconds = time.perf_counter() - start
        if not stream and not sweep.n_valid:
            raise UserError(
                f"{options.sweep}: expected at least one frame with a valid pose, got none among "
                f"{len(sweep):,}; the calibration may be what places them nowhere"
            )
        outliers, findings = _without_outliers(sweep, options, messages)
        n_lost = len(sweep) - sweep.n_valid - len(outliers)
        if n_lost:
            messages.append(f"{n_lost:,} of {count(len(sweep), 'frame')} left out: no valid pose or image")
        validations = {}
        if options.cross_validate:
            progress.step("predicting frames from the others")
            validations = _cross_validate(sweep, options, messages)
        report: dict[str, Any] = {"input": options.sweep or options.live, "output": options.output}
        times = {"read": read_seconds}
        if options.output:
            progress.step("reconstructing")
            begun = time.perf_counter()
            with _stating(progress):
                volume = _of_stream(stream, sweep, outliers, options, messages) if stream else _volume(sweep, options)
            times["reconstruct"] = time.perf_counter() - begun
            progress.step(f"writing {options.output}")
            begun = time.perf_counter()
            with mistakes():
                write_volume(options.output, volume, options.maps)
                draw(volume, options, messages)
            times["write"] = time.perf_counter() - begun
            report |= _facts(volume, options)
            report["others"] = [_write_other(i, other, options, messages) for i, other in enumerate(others, start=2)]
    times["total"] = time.perf_counter() - start
    if stream:
        messages += stream.warnings()
    for message in messages:
        warn(message)
    if stream:
        report["live"] = stream.figures()
    report |= {
        "device": _device(options),
        "method": _method(options),
        "frames": {"total": len(sweep), "used": report.get("figures", {}).get("frames", sweep.n_valid),
                   "outliers": outliers, "size": sweep.frames.shape[:0:-1], "dtype": str(sweep.frames.dtype)},
        "poses": findings,
        "world": sweep.world,
        "space": sweep.space,
        "cross_validation": {name: v._asdict() for name, v in validations.items()},
        "times": times,
        "warnings": messages,
    }  # fmt: skip
    if options.json:
        print_json(report)
    else:
        print("\n".join(_lines(report)))


def _of_stream(
    stream: live.Live, sweep: Sweep, outliers: list[int], options: argparse.Namespace, messages: list[str]
) -> Volume:
    """The volume of a stream: as it has grown, or made anew; if that fails, what has grown."""
    with _fitting():
        volume = stream.volume(sweep, outliers, messages)
    if volume is not None:
        return volume
    try:
        return _volume(sweep, options)
    except UserError as error:
        if not stream.grew(sweep):
            raise
        messages.append(f"the volume is as it has grown, with all its frames: {error}")
        with _fitting():
            volume = stream.reconstructor.volume()
        return volume


def _write_other(i: int, sweep: Sweep, options: argparse.Namespace, messages: list[str]) -> dict[str, Any]:
    """The volume of a stream's images of another size, in a file beside the first."""
    path, (rows, columns) = live.numbered(options.output, i), sweep.frames.shape[1:]
    try:
        _without_outliers(sweep, options, messages)
        with mistakes():
            write_volume(path, _volume(sweep, options), options.maps)
        words = f"{count(len(sweep), 'image')} of {columns} x {rows} {sweep.frames.dtype} pixels in {path}; is the "
        messages.append(words + "calibration theirs, too?")
    except UserError as error:
        messages.append(f"{count(len(sweep), 'image')} of {columns} x {rows} pixels in no volume: {error}")
        path = ""
    return {"output": path, "frames": len(sweep), "size": (columns, rows)}


def _check_apart(options: argparse.Namespace) -> None:
    """Refuse an output that would replace an input or another output."""
    names = {"-o": options.output, "--three-view": options.three_view, "--surface-image": options.surface_image}
    taken = {"SWEEP": options.sweep, "--mask": options.mask, "--poses": options.poses,
             "--plus": options.plus, "--calibration": options.calibration}  # fmt: skip
    for option, name in names.items():
        if not name:
            continue
        for other, path in taken.items():
            if path and os.path.realpath(path) == os.path.realpath(name):
                raise UserError(f"{option}: expected a name of its own, got that of {other}, {name}")
        taken[option] = name


def _check(options: argparse.Namespace) -> None:
    """Refuse options that contradict each other, before any work."""
    if bool(options.sweep) == bool(options.live):
        got = "both" if options.sweep else "neither"
        raise UserError(f"SWEEP: expected a sweep or --live, got {got}")
    if options.output:
        check_output("-o", options.output, WRITABLE)
        with mistakes():
            check_name(options.output, options.maps)
    elif not options.cross_validate:
        raise UserError("-o: expected a volume to write, got none")
    for option in ("--three-view", "--surface-image"):
        picture = getattr(options, option[2:].replace("-", "_"))
        if picture and not options.output:
            raise UserError(f"{option}: expected -o beside {option}, got none")
        if picture:
            check_output(option, picture, [".png"])
    if options.projections and not options.three_view:
        raise UserError("--projections: expected --three-view beside --projections, got none")
    if options.axes != "world":
        if options.region is not None or options.live:
            other = "--live" if options.live else "--bounds"
            raise UserError(f"--volume-axes: expected no {other} beside --volume-axes, got both")
        if _exact(options):
            raise UserError("--volume-axes: expected --method beside --plus, as PLUS's axes are the world's")
    _check_apart(options)
    if options.calibration and options.plus:
        raise UserError("--plus: expected no --calibration beside --plus, got both")
    live.check(options)
    if options.cross_validate is not None and options.cross_validate < 2:
        raise UserError(f"--cross-validate: expected 2 or more, got {options.cross_validate}")
    if options.size is not None and not 1 <= options.size <= 65536:
        raise UserError(f"--voxels: expected 1 to 65536, got {options.size}")
    if options.region is not None and len(options.region) != 6:
        raise UserError(f"--bounds: expected six numbers, got {len(options.region)}")
    if _exact(options):
        names = {"spacing": "voxel-size", "size": "voxels", "region": "bounds",
                 "max_distance": "max-distance"}  # fmt: skip
        for name, option in names.items():
            if getattr(options, name) is not None:
                raise UserError(
                    f"--{option}: expected --method beside --plus, as the configuration gives the "
                    "grid of PLUS's own method"
                )


def _exact(options: argparse.Namespace) -> bool:
    """Whether the volume must equal the volume of PLUS."""
    return options.plus is not None and options.method is None


def _method(options: argparse.Namespace) -> str:
    if _exact(options):
        return "plus"
    grows = options.live and options.spacing is not None
    mean = options.compounding == "mean"
    return options.method or ("frames" if mean and not grows else "pvn-om")


def _sweep(options: argparse.Namespace) -> Sweep:
    return read_sweep_file(
        options.sweep, calibration=options.calibration, plus=options.plus, poses=options.poses,
        temporal_offset=options.temporal_offset, clip=options.clip, fan=options.fan,
        mask=options.mask, frame_times=options.frame_times,
    )  # fmt: skip


def _without_outliers(sweep: Sweep, options: argparse.Namespace, messages: list[str]) -> tuple[list[int], list[str]]:
    """Mark frames whose pose is wrong as invalid; return their numbers, and all findings."""
    from ..ultrasound.trust import check_poses

    if _exact(options):
        return [], []
    check = check_poses(sweep)
    found = [] if options.keep_outliers else np.flatnonzero(check.outliers).tolist()
    sweep.valid[found] = False
    if found:
        wrong = [str(f) for f in check.findings if f.kind not in ("step", "identical")]
        which = "; ".join(wrong[:8]) + ("; …" if len(wrong) > 8 else "")
        messages.append(f"{count(len(found), 'frame')} left out (--keep-outliers keeps these frames): {which}")
    for finding in check.findings:
        if finding.kind == "step":
            messages.append(f"{finding}; if the tracked reference has moved, the volume shows the anatomy twice")
        elif finding.kind == "identical" and finding.last - finding.first >= len(sweep) - 1:
            messages.append(f"{finding}; the tracker has not followed the probe")
    return found, [str(finding) for finding in check.findings]


def _growing(options: argparse.Namespace) -> dict[str, Any] | None:
    """The arguments of `Reconstructor`, which adds frame after frame.

    None if the volume cannot grow: --voxels needs the bounds of all frames, a median all values,
    and other methods than pvn-om all frames.
    """
    if options.spacing is None or _method(options) != "pvn-om" or options.compounding == "median":
        return None
    return _options_of(options) | ({"history": None} if options.maps else {})


def _options_of(options: argparse.Namespace) -> dict[str, Any]:
    given = {
        "max_kernel": options.max_kernel,
        "compounding": options.compounding,
        "hole_weights": options.hole_weights,
        "device": options.device,
        "threads": options.threads,
        "extrapolate": options.extrapolate,
    }
    for name in ("spacing", "size", "max_distance"):
        if getattr(options, name) is not None:
            given[name] = getattr(options, name)
    if options.spacing is None and options.size is None:
        given["size"] = DEFAULT_SIZE
    if options.axes != "world":
        given["axes"] = options.axes
    if options.region is not None:
        given["region"] = (options.region[:3], options.region[3:])
    return given


@contextmanager
def _stating(progress: Progress) -> Iterator[None]:
    """Show the voxels and memory of the volume, which the library logs before the work."""

    class Shown(logging.Handler):
        def emit(self, record: logging.LogRecord) -> None:
            facts: Any = record.args
            if facts and facts[-1] >= LARGE:
                progress.clear()
                say(f"note: {record.getMessage()}")
            progress.show(f"reconstructing {record.getMessage()}")

    handler = Shown(logging.INFO)
    log = logging.getLogger("globule")
    level = log.level
    log.addHandler(handler)
    log.setLevel(logging.INFO)
    try:
        yield
    finally:
        log.setLevel(level)
        log.removeHandler(handler)


@contextmanager
def _fitting(name: str | None = None) -> Iterator[None]:
    """Turn what the library refuses, and a volume larger than the memory, into a UserError; name:
    of the file that says the volume's size."""
    with readable(name or ""):  # the name, or a picture that the configuration names
        try:
            yield
        except MemoryError as error:
            raise UserError(f"{name}: {error}" if name else str(error)) from error


def _cross_validate(sweep: Sweep, options: argparse.Namespace, messages: list[str]) -> dict[str, Any]:
    from ..ultrasound.trust import compare_methods

    if sweep.n_valid < 2 * options.cross_validate:
        most = f"expected at most half of the {sweep.n_valid} valid frames"
        raise UserError(f"--cross-validate: {most}, got {options.cross_validate}")
    methods = (options.method,) if options.method else COMPARED
    failures: dict[str, str] = {}
    with _fitting():
        found = compare_methods(sweep, options.cross_validate, methods, failures, **_options_of(options))
    messages += [f"{method} predicts no frame: {error}" for method, error in failures.items()]
    return found


def _volume(sweep: Sweep, options: argparse.Namespace) -> Volume:
    with _fitting(options.plus if _exact(options) else None):
        if _exact(options):
            from ..ultrasound.plus.reconstruct import reconstruct_plus

            return reconstruct_plus(sweep, options.plus, device=options.device, threads=options.threads)
        from ..ultrasound.reconstruct import reconstruct

        return reconstruct(sweep, method=_method(options), **_options_of(options))


def _facts(volume: Volume, options: argparse.Namespace) -> dict[str, Any]:
    facts: dict[str, Any] = {
        "volume": {
            "size": volume.values.shape[::-1],
            "spacing": volume.spacing,
            "origin": volume.world_from_voxel[:3, 3],
            "dtype": str(volume.values.dtype),
        },
        "counts": {
            "voxels": volume.values.size,
            "measured": volume.n_measured,
            "filled": volume.n_filled,
            "extrapolated": volume.n_extrapolated,
            "empty": volume.n_empty,
        },
        "memory": {"volume": volume.values.nbytes + volume.radius.nbytes},
        "figures": {name: v for name, v in volume.info.items() if not isinstance(v, np.ndarray)},
        "three_view": options.three_view,
        "surface": options.surface_image,
    }
    if options.json:
        facts["hashes"] = {
            name: hashlib.sha256(np.ascontiguousarray(array).data).hexdigest()
            for name, array in (("values", volume.values), ("radius", volume.radius))
        }
    return facts


def _device(options: argparse.Namespace) -> str:
    from .._base.device import choose

    return choose(options.device).description


def _lines(report: dict[str, Any]) -> list[str]:
    lines = []
    frames, times = report["frames"], report["times"]
    if report["output"]:
        size = "x".join(map(str, report["volume"]["size"]))
        spacing = " x ".join(f"{s:.4g}" for s in report["volume"]["spacing"])
        counts = report["counts"]
        lines.append(
            f"{report['output']}: {size} voxels of {spacing} mm from "
            f"{count(frames['used'], 'frame')}, {report['method']}, {times['reconstruct']:.3f} s "
            f"({times['total']:.2f} s in all) on {report['device']}"
        )
        shares = ", ".join(
            f"{100 * counts[name] / counts['voxels']:.1f} % {name}"
            for name in ("measured", "filled", "extrapolated", "empty")
            if counts[name] or name != "extrapolated"
        )
        if "estimated_bytes" in report["figures"]:
            shares += f"; up to {report['figures']['estimated_bytes'] / 2**20:,.0f} MiB of memory"
        lines.append(f"  {shares}")
        if "left_out_rms" in report["figures"]:
            rms = report["figures"]["left_out_rms"]
            lines.append(f"  frames left out are predicted to {rms:.1f} gray levels (rms)")
    for name, result in report["cross_validation"].items():
        lines.append(
            f"  {name:<7} predicts {count(result['n_frames'], 'frame')} left out: mean error "
            f"{result['mean_error']:.2f}, rms {result['rms_error']:.2f}, "
            f"bias {result['bias']:+.2f} gray levels, {100 * result['coverage']:.1f} % of pixels"
        )
    return lines
