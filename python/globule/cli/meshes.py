"""Triangle meshes of `render`: files with faces among the inputs, and --mesh."""

from __future__ import annotations

import argparse
import dataclasses

import numpy as np

from ..formats import FormatError
from ..formats.triangles import has_faces
from ..render.clips import ClipBox, ClipPlane, ClipSphere
from ..render.frame import Layer
from ..render.materials import Material
from ..render.presets import PRESETS, preset
from ..scene.mesh import Mesh
from ..scene.particles import Particles
from . import look
from .shared import UserError, check_input, mistakes

_SAMPLES = 1000  # particles at which a mesh is tested for whether it surrounds them
# What only particles have.
_OF_PARTICLES = {
    "support": "--support",
    "threshold": "--threshold",
    "anisotropic": "--anisotropic",
    "color_by": "--color-by",
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The flags of meshes."""
    add = parser.add_argument_group("triangle meshes").add_argument
    add(
        "--mesh",
        dest="meshes",
        type=mesh,
        action="append",
        default=[],
        metavar="FILE[:MATERIAL]",
        help="triangles of a second file (.stl .obj .ply .glb .vtk .vtp), world units; "
        f"MATERIAL is {', '.join(PRESETS)}; --clip cuts them too; may be repeated up to 3 times "
        "(default: none)",
    )
    add(
        "--mesh-color",
        type=look.color,
        metavar="COLOR",
        help="color of all meshes of --mesh: R,G,B or V (linear), or #rrggbb (sRGB) (default: the "
        "file's, the material's, or gray)",
    )
    add(
        "--as-particles",
        action="store_true",
        help="draw one metaball at each vertex of a mesh instead of its triangles; --resample "
        "draws metaballs, too",
    )


def mesh(text: str) -> tuple[str, str | None]:
    """FILE or FILE:MATERIAL."""
    path, _, word = text.rpartition(":")
    return (path, word) if path and word in PRESETS else (text, None)


def is_mesh(path: str, options: argparse.Namespace) -> bool:
    """Whether an input is drawn as triangles."""
    return not (options.as_particles or options.resample) and has_faces(path)


def check_mesh(path: str, options: argparse.Namespace) -> None:
    """Refuse the flags that a mesh does not have, before any work."""
    thesis = options.root != "exact"
    for name, flag in (*_OF_PARTICLES.items(), *([("root", "--root")] if thesis else [])):
        if getattr(options, name):
            raise UserError(
                f"{flag}: expected particles beside {flag}, got the mesh {path}; --as-particles "
                "draws its vertices as metaballs"
            )


def read_mesh(path: str, options: argparse.Namespace, solid: bool | None = None) -> Mesh:
    """The mesh of a file. Raises UserError if it cannot be read."""
    try:
        with mistakes():
            return Mesh(path, solid=solid, device=options.device, threads=options.threads)
    except FormatError as error:
        raise UserError(str(error)) from error
    except OSError as error:
        raise UserError(f"{path}: cannot be read: {error.strerror or error}") from error


def check_meshes(options: argparse.Namespace) -> None:
    """Refuse files of --mesh that are no meshes, before any work."""
    for path, word in options.meshes:
        try:
            check_input(path)
        except UserError as error:
            name, _, last = path.rpartition(":")
            if name and word is None and has_faces(name):
                known = ", ".join(PRESETS)
                raise UserError(f"--mesh: expected a material, {known}, got {last!r}") from error
            raise


def layers(
    options: argparse.Namespace,
    clips: list[ClipPlane | ClipBox | ClipSphere],
    particles: Particles | None,
) -> tuple[list[Layer], list[str]]:
    """The layers of --mesh, and messages about them."""
    found, messages = [], []
    for path, word in options.meshes:
        shape = read_mesh(path, options)
        if shape.solid and particles is not None and surrounds(shape, particles):
            shape = read_mesh(path, options, solid=False)
            messages.append(f"{path} surrounds the particles: drawn as a thin wall, not as a body")
        with mistakes():
            material = preset(word, shape, options.up).material if word else Material()
            if options.mesh_color is not None:
                material = dataclasses.replace(material, color=options.mesh_color)
            found.append(Layer(shape, material, clips))
    return found, messages


def surrounds(shape: Mesh, particles: Particles) -> bool:
    """Whether most of the particles lie inside the mesh."""
    points = particles.finite_positions()
    points = points[:: 1 + len(points) // _SAMPLES]
    return len(points) > 0 and float(np.mean(shape.contains(points))) > 0.5
