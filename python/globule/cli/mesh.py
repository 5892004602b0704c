"""Write the surface as a triangle mesh, whose vertices lie on the exact surface.

The mesh comes from marching cubes; each vertex is then moved along the field's gradient until it
is on the surface. The command prints the enclosed volume and the area with estimates of their
errors. .ply and .vtp hold normals and each --value, .obj normals, .stl triangles alone."""

from __future__ import annotations

import argparse

from ..formats.mesh_files import EXTENSIONS
from ..measure.mesh import in_closed_form, measured, mesh_surface
from ..pieces.scene import Scene
from . import flags, measuring
from .parser import Parser
from .shared import Progress, UserError, check_output, count, mistakes, need_particles, print_json

SUMMARY = "the surface as triangles, with its volume and area"
USAGE = "FILE -o PATH"
EXAMPLES = """\
  globule mesh splash.npz -o splash.ply
  globule mesh splash.npz -o splash.vtp --value speed --json"""


def add_arguments(parser: Parser) -> None:
    """The arguments of `globule mesh`."""
    parser.add_argument("file", metavar="FILE", help="particles, mesh or volume")
    flags.add(parser, "--output", " ".join(EXTENSIONS), required=True)
    measuring.add_sample_spacing(parser)
    measuring.add_values(parser, "none")
    flags.add(parser, "--json")
    measuring.add_surface(parser)


def run(options: argparse.Namespace) -> None:
    """Run `globule mesh`."""
    check_output("-o", options.output, EXTENSIONS)
    with Progress(1) as progress:
        for _, path, scene in measuring.scenes(options, [options.file], progress, one=True):
            need_particles(path, scene.octree.n_inside)
            with mistakes():
                mesh = mesh_surface(scene, options.spacing, options.values or ())
                if not len(mesh.faces):
                    raise UserError(_why_empty(options, path, scene))
                found = in_closed_form(scene) or measured(scene, mesh)
                mesh.save(options.output)
    if options.json:
        counts = {"vertices": len(mesh.vertices), "triangles": len(mesh.faces)}
        facts = {"file": options.output, "sample_spacing": mesh.spacing, **counts}
        print_json({**facts, **found._asdict()})
        return
    print(
        f"{options.output}: {count(len(mesh.faces), 'triangle')}, "
        f"volume {found.volume:.6g} ± {found.volume_error:.2g}, "
        f"area {found.area:.6g} ± {found.area_error:.2g}"
    )


def _why_empty(options: argparse.Namespace, path: str, scene: Scene) -> str:
    """Why a mesh has no triangles, and what to take instead."""
    return measuring.too_coarse(options, scene) or (
        f"{path}: expected a surface, got none: no field reaches the threshold "
        f"{scene.threshold:g}; try a lower --threshold or a larger --support"
    )
