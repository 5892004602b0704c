"""Sample the field and the particles' attributes on a plane, along a line or on a grid.

Attributes are blended with the weights of the field; they are nan where no particle reaches.
-o names a .csv (one row a place), a .npz, a .vti (a plane or grid), a .vtp (a plane or line), or a
.png of a plane's first --value, 800 pixels long unless --sample-spacing says otherwise. In a .png,
places without a value are white; --inside also makes white what is outside of the surface."""

from __future__ import annotations

import argparse
from typing import Any

import numpy as np

from .._base.colormaps import colorize
from ..data.attributes import colormap_of
from ..measure.places import SampleGrid, SampleLine, SamplePlane
from ..measure.sample import sample
from ..measure.samples import EXTENSIONS
from ..measure.surface import counts, default_spacing
from ..render.canvas import LEAST_SIDE
from ..render.frame import save_png
from ..render.legend import add_legend
from . import flags, measuring
from .parser import Parser
from .shared import Progress, UserError, count, mistakes, need_particles, numbers, print_json

SUMMARY = "values on planes, lines and grids"
USAGE = "FILE -o PATH"
EXAMPLES = """\
  globule slice splash.npz --plane 0,0,1,0 -o slice.csv
  globule slice splash.npz --plane 0,0,1,0 --value speed -o slice.png
  globule slice splash.npz --line -1,0.1,0,0.4,0.1,0 --value inside -o line.csv
  globule slice splash.npz --grid --value field -o field.vti"""


PIXELS = 800  # along the longer side of an image


def plane(text: str) -> SamplePlane:
    """NX,NY,NZ,D."""
    *normal, offset = numbers(text, "NX,NY,NZ,D")
    return _checked(SamplePlane, normal, offset)


def line(text: str) -> SampleLine:
    """X,Y,Z,X,Y,Z."""
    values = numbers(text, "X0,Y0,Z0,X1,Y1,Z1")
    return _checked(SampleLine, values[:3], values[3:])


def _checked(kind: Any, *values: Any) -> Any:
    try:
        return kind(*values)
    except (TypeError, ValueError) as error:
        raise argparse.ArgumentTypeError(str(error)) from None


def add_arguments(parser: Parser) -> None:
    """The arguments of `globule slice`."""
    parser.add_argument("file", metavar="FILE", help="particles, mesh or volume")
    flags.add(parser, "--output", f"{' '.join((*EXTENSIONS, '.png'))}", required=True)
    where = parser.add_argument_group("where")
    one = where.add_mutually_exclusive_group(required=True)
    flags.own(one, "--plane NX,NY,NZ,D", "plane where nx x + ny y + nz z = d, world units", plane)
    flags.own(one, "--line X0,Y0,Z0,X1,Y1,Z1", "line between two points, world units", line)
    flags.own(one, "--grid", "grid around all particles")
    measuring.add_sample_spacing(where)
    measuring.add_values(where, "field, inside and all attributes")
    measuring.add_image(parser, "--inside", "draw only what is inside of the surface")
    flags.add(parser, "--json")
    measuring.add_surface(parser)


def run(options: argparse.Namespace) -> None:
    """Run `globule slice`."""
    image = measuring.check_image(options, "inside", "range")
    if image and not options.plane:
        raise UserError("--plane: expected --plane beside a .png, got none")
    with Progress(1) as progress:
        for _, path, scene in measuring.scenes(options, [options.file], progress, one=True):
            need_particles(path, scene.octree.n_inside)
            with mistakes():
                names = options.values
                if image:
                    names = [(names or [*scene.particles.attributes, "field"])[0], "inside"]
                found = sample(scene, _where(options, scene), names)
                if image:
                    draw(options, found[names[0]], names[0], False, found["inside"])
                else:
                    found.save(options.output)
    facts = {name: _range(_length(array, found.dims)) for name, array in found.values.items()}
    inside = {"inside": float(found["inside"].mean())} if "inside" in found.values else {}
    if options.json:
        shape = dict(zip(found.dims, found.shape, strict=True))
        print_json({"file": options.output, "places": shape, "values": facts, "share": inside})
        return
    text = f"{options.output}: {count(int(np.prod(found.shape)), 'place')}"
    for name, (low, high) in facts.items():
        ends = f"{low:.4g} to {high:.4g}" if np.isfinite(low) else "nowhere"
        text += f", {name} {ends}" if name != "inside" else ""
    print(text + "".join(f", {100 * share:.1f} % {name}" for name, share in inside.items()))


def _where(options: argparse.Namespace, scene: Any) -> SamplePlane | SampleLine | SampleGrid:
    """The places, given from the scene's origin; --plane and --line are in the file's coordinates."""
    spacing = options.spacing
    if options.grid:
        return SampleGrid(spacing)
    if options.plane:
        normal = options.plane.normal
        plane = SamplePlane(normal, options.plane.offset - float(np.dot(normal, scene.origin)), spacing)
        if spacing is None and options.output.lower().endswith(".png"):
            lattice = plane.lattice(scene)  # small ones are drawn larger
            finer = default_spacing(scene) * min(1.0, max(lattice.shape) / PIXELS)
            plane = SamplePlane(plane.normal, plane.offset, finer)
        return plane
    start, end = (np.subtract(place, scene.origin) for place in (options.line.start, options.line.end))
    n = counts(np.array([np.linalg.norm(end - start)]), spacing or default_spacing(scene))[0]
    return SampleLine(start, end, max(2, n))


def _length(array: np.ndarray, dims: tuple[str, ...]) -> np.ndarray:
    """Vectors' lengths."""
    return np.linalg.norm(array, axis=-1) if array.ndim > len(dims) else array


def _range(array: np.ndarray) -> list[float]:
    known = array[np.isfinite(array)]
    return [float(known.min()), float(known.max())] if known.size else [np.nan, np.nan]


def draw(
    options: argparse.Namespace, values: np.ndarray, name: str, log: bool, inside: np.ndarray | None = None
) -> None:
    """Write the values (V, U) or (V, U, k) of a plane as a .png, v upwards, at least 480 pixels a
    side; white where they are not finite, and outside where --inside is given."""
    values = values.astype(np.float64)
    if values.ndim > 2:
        values = np.linalg.norm(values, axis=2)
    if log:
        with np.errstate(all="ignore"):
            values, name = np.log10(np.maximum(values, 0)), f"log10 {name}"
    hidden = ~np.isfinite(values)
    if inside is not None and options.inside:
        hidden |= ~inside
    if log:
        hidden &= np.isnan(values)  # nothing at all has the color of little
    if hidden.all():
        raise ValueError(f"plane: expected one that meets {name}, got none in the slice")
    low, high = options.range or _range(values[~hidden & np.isfinite(values)])
    colormap = colormap_of("", options.colormap)  # blended values, of no type
    linear = colorize(values.ravel(), colormap, low, high).reshape(*values.shape, 3)
    srgb = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    image = np.rint(255 * srgb).astype(np.uint8)
    image[hidden] = 255
    larger = max(1, -(-480 // min(image.shape[:2])))
    image = np.repeat(np.repeat(image[::-1], larger, axis=0), larger, axis=1)
    room = np.full((len(image), max(150, LEAST_SIDE), 3), 255, np.uint8)
    legend = np.concatenate([image, room], axis=1)
    save_png(options.output, add_legend(legend, colormap, low, high, name))
