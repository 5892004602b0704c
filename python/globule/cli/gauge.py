"""Measure the height of the free surface at wave gauges, in one file or a sequence.

A gauge is a ray from above; its height is where the ray first meets the surface, in world units
along --up, and nan where there is no surface. Spray above the surface is met first. The two
coordinates of --at are the horizontal ones in the order x, y, z: x,z where y is upwards.
Several files, or a quoted pattern ('frame_*.vtk'), are one sequence with one support.
--map writes the heights all over the ground of one file instead."""

from __future__ import annotations

import argparse
from typing import Any

import numpy as np

from ..measure.gauge import gauge, map_heights, up_axis
from ..measure.samples import EXTENSIONS, write_table
from . import flags, measuring
from .parser import Parser
from .shared import (
    Progress,
    UserError,
    check_output,
    count,
    mistakes,
    need_particles,
    number,
    print_json,
    say,
    settle_up,
)

SUMMARY = "height of the free surface"
USAGE = "FILE [FILE ...] --at A,B [-o PATH]"
EXAMPLES = """\
  globule gauge splash.npz --at 0.2,0
  globule gauge splash.npz --at 0.2,0 -o gauge.csv
  globule gauge frame_0.ply frame_1.ply --at 0.2,0 --fps 50 -o gauges.csv --plot gauges.png
  globule gauge splash.npz --map -o heights.vti"""


def place(text: str) -> tuple[float, float]:
    """A,B."""
    words = text.split(",")
    if len(words) != 2:
        raise argparse.ArgumentTypeError(f"expected two horizontal coordinates A,B, got {text!r}")
    return number(words[0]), number(words[1])


def add_arguments(parser: Parser) -> None:
    """The arguments of `globule gauge`."""
    parser.add_argument("files", nargs="+", metavar="FILE", help="particles, mesh or volume")
    flags.add(parser, "--output", "heights.csv; a --map also .npz .vti .vtp; default: printed")
    one = parser.add_mutually_exclusive_group(required=True)
    flags.own(one, "--at A,B", "horizontal coordinates of a gauge, those of the file also far from the "
        "origin; may be repeated", place, action="append")  # fmt: skip
    flags.own(one, "--map", "heights all over the ground of one file")
    flags.add(parser, "--up", "along x, y or z; default: by format")
    flags.add(parser, "--fps", "for the column of times; default: the times of the files")
    flags.own(parser, "--plot FILE.png", "also draw the columns as curves")
    measuring.add_sample_spacing(parser)
    flags.add(parser, "--json")
    measuring.add_surface(parser)


def _local(options: argparse.Namespace, scene: Any) -> np.ndarray:
    """The places of --at (K, 2), given from the scene's origin."""
    axis, _ = up_axis(scene.up if options.up is None else options.up)
    return np.array(options.at) - np.delete(scene.origin, axis)


def run(options: argparse.Namespace) -> None:
    """Run `globule gauge`."""
    with measuring.Broken() as broken:
        _run(options, broken)


def _run(options: argparse.Namespace, broken: measuring.Broken) -> None:
    if options.output:
        check_output("-o", options.output, EXTENSIONS if options.map else (".csv",))
    elif options.map:
        raise UserError("-o: expected a file beside --map, got none")
    if options.up:
        with mistakes():
            up_axis(options.up)
    if options.spacing and not options.map:
        raise UserError("--sample-spacing: expected --map beside --sample-spacing, got none")
    if options.plot:
        if options.map:
            raise UserError("--plot: expected --at beside --plot, got --map")
        check_output("--plot", options.plot, (".png",))
        measuring.need_matplotlib()
    names, rows = [], []
    clock: list[float | None] = []
    with Progress(len(options.files)) as progress:
        scenes = measuring.scenes(options, options.files, progress, one=options.map, clock=clock)
        for i, path, scene in broken.before(scenes):
            if not i:
                settle_up(options, path)
                if options.said_up:
                    say(options.said_up)
            if options.map:
                if i:
                    raise UserError("--map: expected one file, got several")
                need_particles(path, scene.octree.n_inside)
                with mistakes():
                    found = map_heights(scene, options.spacing, options.up)
                rows.append(found["height"].ravel())
            else:
                with mistakes():
                    rows.append(gauge(scene, _local(options, scene), options.up))
            names.append(path)
    if options.map:
        with mistakes():
            found.save(options.output)
    heights = np.stack(rows)
    columns = {f"height_{k}": heights[:, k] for k in range(len(options.at or ()))}
    table = measuring.numbered(options, names, clock, columns)
    if not options.map and (options.output or not options.json):
        axis, sign = up_axis(scene.up if options.up is None else options.up)
        above = sign * scene.origin[axis]  # files have world coordinates
        write_table(options.output, table | {name: column + above for name, column in columns.items()})
    if options.plot:
        measuring.plot(options, table, list(columns), "height, world units")
    if options.json:
        whole = {"map": heights[0].reshape(found.shape)} if options.map else table
        print_json({"file": options.output, "origin": options.origin, **whole})
        return
    if not options.output:
        return
    known = heights[np.isfinite(heights)]
    ends = f"{known.min():.6g} to {known.max():.6g}" if known.size else "no surface there"
    what = "place" if options.map else "gauge"
    n = heights.shape[1]
    print(f"{options.output}: {count(n, what)}, {count(len(rows), 'frame')}, height {ends}")
