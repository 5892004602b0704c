"""Follow the surface over a sequence: volume, area and extent of each frame as a table.

The columns x_min to z_max hold the surface's extent, spray included: x_max is the place of a front
that moves along x, y_max the greatest height where y points up. Volume and area have columns with
estimates of their errors. The surface rounds sharp edges; particle_volume knows nothing of it: the
number of particles times the cube of their spacing, or the sum of the spheres. Several files, or a
quoted pattern ('frame_*.vtk'), are one sequence with one support and one --sample-spacing. The
column time holds what --fps says, else what the files say (of a LAMMPS dump without times, its steps)."""

from __future__ import annotations

import argparse
from typing import Any

import numpy as np

from ..measure.samples import write_table
from ..measure.surface import default_spacing
from ..measure.track import facts
from . import flags, measuring
from .parser import Parser
from .shared import Progress, UserError, check_output, count, mistakes, print_json

SUMMARY = "front, height, volume and area over a sequence"
USAGE = "FILE [FILE ...] [-o PATH]"
EXAMPLES = """\
  globule track frame_0.ply frame_1.ply --fps 50 -o track.csv
  globule track frame_0.ply frame_1.ply -o track.csv --plot front.png --plot-column x_max"""
COLUMNS = ("volume", "area", "x_min", "x_max", "y_min", "y_max", "z_min", "z_max", "particle_volume")


def add_arguments(parser: Parser) -> None:
    """The arguments of `globule track`."""
    parser.add_argument("files", nargs="+", metavar="FILE", help="particles, mesh or volume")
    flags.add(parser, "--output", "track.csv; default: printed")
    flags.add(parser, "--fps", "for the column of times; default: the times of the files")
    flags.own(parser, "--plot FILE.png", "also draw the columns as curves")
    flags.own(parser, "--plot-column NAME", f"column to draw: {', '.join(COLUMNS)}", COLUMNS, "volume")
    measuring.add_sample_spacing(parser)
    flags.add(parser, "--json")
    measuring.add_surface(parser)


def run(options: argparse.Namespace) -> None:
    """Run `globule track`."""
    with measuring.Broken() as broken:
        _run(options, broken)


def _run(options: argparse.Namespace, broken: measuring.Broken) -> None:
    if options.output:
        check_output("-o", options.output, (".csv",))
    if options.plot:
        check_output("--plot", options.plot, (".png",))
        measuring.need_matplotlib()
    names: list[str] = []
    clock: list[float | None] = []
    rows: list[dict[str, float]] = []
    spacing = options.spacing
    with Progress(len(options.files)) as progress:

        def made(scene: Any) -> None:
            nonlocal spacing
            if spacing is None and scene.octree.n_inside:
                spacing = default_spacing(scene)

        scenes = measuring.scenes(options, options.files, progress, made=made, clock=clock)
        for _, path, scene in broken.before(scenes):
            with mistakes():
                found = facts(scene, spacing)
                wrong = scene.octree.n_inside and not found["area"]
                if wrong and (why := measuring.too_coarse(options, scene)):
                    raise UserError(f"{path}: {why}")
                rows.append(found)
            names.append(path)
    columns = {name: np.array([row[name] for row in rows]) for name in rows[0]}
    table = measuring.numbered(options, names, clock, columns)
    at = dict(zip("xyz", scene.origin, strict=True))  # files have world coordinates
    if options.output or not options.json:
        write_table(options.output, table | {name: table[name] + at[name[0]] for name in COLUMNS[2:-1]})
    if options.plot:
        name = options.plot_column
        unit = {"volume": " cubed", "particle_volume": " cubed", "area": " squared"}.get(name, "")
        measuring.plot(options, table, [name], f"{name}, world units{unit}")
    if options.json:
        print_json({"file": options.output, "origin": options.origin, **table})
        return
    if not options.output:
        return
    first, last = rows[0], rows[-1]
    print(
        f"{options.output}: {count(len(rows), 'frame')}, "
        f"volume {first['volume']:.6g} to {last['volume']:.6g}, "
        f"area {first['area']:.6g} to {last['area']:.6g}"
    )
