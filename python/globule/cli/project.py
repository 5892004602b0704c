"""Project particles along lines of sight: column density, or the integral of any attribute.

Each pixel is the integral along its line, exact for the kernel, of the attribute as SPH
interpolates it. --value density is the column density (mass by area), --value thickness the length
within the matter. A particle's volume is its mass over its density where the file has both, else
the spacing cubed. -o names a .csv (one row a pixel), a .npz, a .vti, a .vtp, or a .png of the first
--value."""

from __future__ import annotations

import argparse

import numpy as np

from ..measure.places import SamplePlane
from ..measure.project import has_volumes, project
from ..measure.samples import EXTENSIONS
from . import flags, measuring, slice
from .parser import Parser
from .shared import (
    Progress,
    check_device,
    check_input,
    direction,
    doubled,
    first_of,
    left_out,
    mistakes,
    need_particles,
    positive,
    print_json,
    read_file,
    reading,
    warn,
)

SUMMARY = "column density along lines of sight"
USAGE = "FILE -o PATH"
EXAMPLES = """\
  globule project splash.npz -o columns.png --log
  globule project splash.npz --axis 0,1,0 --value thickness -o depth.vti"""


def add_arguments(parser: Parser) -> None:
    """The arguments of `globule project`."""
    parser.add_argument("file", metavar="FILE", help="particles, mesh or volume")
    flags.add(parser, "--output", f"{' '.join((*EXTENSIONS, '.png'))}", required=True)
    flags.own(parser, "--axis X,Y,Z", "direction of the lines of sight", direction, (0, 0, 1))
    measuring.add_values(parser, "density if the file has one, else thickness")
    measuring.add_sample_spacing(parser)
    volume = parser.add_mutually_exclusive_group()
    flags.own(volume, "--particle-volume V", "volume of every particle, world units cubed",
        positive, usual="mass over density, else the spacing cubed", dest="volume")  # fmt: skip
    flags.add(volume, "--particle-spacing", "default: measured")
    measuring.add_image(parser, "--log", "color by the decimal logarithm")
    flags.add(parser, "--json")
    surface = parser.add_argument_group("kernel")
    flags.add(surface, "--kernel", "default: cubic_spline", default="cubic_spline")
    flags.add(surface, "--support", "default: the file's, else by kernel")
    flags.add_reading(parser)
    flags.add_device(parser.add_argument_group("machine"))


def run(options: argparse.Namespace) -> None:
    """Run `globule project`."""
    image = measuring.check_image(options, "log", "range")
    check_device(options)
    measuring.need_no_faces(options.file, options)
    check_input(options.file, list(reading(options)))
    with Progress(1) as progress:
        progress.step(options.file)
        contents = read_file(options.file, **reading(options))
        particles = contents.particles
        if contents.n_frames > 1 and options.frame is None:
            warn(first_of(options.file, contents.n_frames, "globule track measures all"))
        finite = np.isfinite(particles.positions).all(axis=1)
        messages = left_out(options.file, particles) + doubled(options.file, particles)
        for message in messages:
            warn(message)
        need_particles(options.file, int(finite.sum()))
        names = options.values
        if not names:
            known = {"density", "densities", "rho", "mass", "masses"} & {*particles.attributes}
            names = ["density" if known else "thickness"]
        with mistakes():
            plane = SamplePlane(options.axis, 0.0, options.spacing)
            spacing = options.particle_spacing
            volume = spacing**3 if spacing else options.volume
            if options.scale not in (None, 1) and volume is None and has_volumes(particles):
                what = "volumes are the file's masses over densities, which --scale leaves"
                warn(f"{options.file}: {what}; --particle-volume or --particle-spacing gives others")
            found = project(
                particles, plane, names[:1] if image else names, volume=volume,
                kernel=options.kernel, support=options.support, device=options.device,
                threads=options.threads,
            )  # fmt: skip
            if image:
                slice.draw(options, found[names[0]], names[0], options.log)
            else:
                found.save(options.output)
    area = float(np.prod(np.linalg.norm(found.steps, axis=1)))
    totals = {n: area * a.sum(axis=(0, 1), dtype=np.float64) for n, a in found.values.items()}
    v, u = found.shape
    if options.json:
        largest = {name: float(array.max()) for name, array in found.values.items()}
        places = {"v": v, "u": u}
        facts = {"file": options.output, "places": places, "total": totals, "largest": largest}
        print_json(facts)
        return
    text = ", ".join(f"{name} {np.linalg.norm(total):.6g}" for name, total in totals.items())
    print(f"{options.output}: {u}x{v} lines of sight; over the image: {text}")
