"""Solid things of `render`: files with faces among the inputs, --mesh, --spheres and --lines."""

from __future__ import annotations

import argparse
import dataclasses
import functools
import os
import re
from typing import Any

import numpy as np

from ..data.particles import HERE, Particles
from ..data.radii import find_radii
from ..formats import FormatError
from ..formats.triangles import has_faces
from ..pieces.scene import Scene
from ..render.clips import ClipBox, ClipPlane, ClipSphere
from ..render.layers import Layer
from ..render.materials import Material
from ..render.presets import PRESETS, load_preset
from ..scene.capsules import Lines, Spheres
from ..scene.mesh import Mesh
from ..scene.rigid_bodies import RigidBodies
from . import flags, look
from .shared import UserError, check_input, count, mistakes, read_particles, readable, stem, warn

_THIN = 1 / 400  # default radius of lines, of their box's diagonal
_SAMPLES = 1000  # particles at which a mesh is tested for whether it surrounds them
# What only particles have.
_OF_PARTICLES = {
    "support": "--support",
    "threshold": "--threshold",
    "anisotropic": "--anisotropic",
    "where": "--where",
    "scale": "--scale",
    "center": "--center",
    "min_component": "--min-component",
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The flags of meshes."""
    group = parser.add_argument_group("triangle meshes")
    flags.own(group, "--mesh FILE[:MATERIAL]", "triangles of a second file (.stl .obj .ply .glb .vtk "
        ".vtp), world units, or a folder rigid_bodies of SPlisHSPlasH, whose bodies follow the number "
        f"in the input's name; MATERIAL is {', '.join(PRESETS)}; --clip cuts them too; may be "
        "repeated up to 3 times", mesh, [], dest="meshes", action="append")  # fmt: skip
    flags.own(group, "--spheres FILE[:RADIUS]", "plain spheres at the particles of a second file, "
        "world units", functools.partial(_with_radius, "spheres"), [],
        usual="the file's radii, else half a spacing", action="append")  # fmt: skip
    flags.own(group, "--lines FILE[:RADIUS]", "a line through the points of a second file, in "
        "their order, world units", functools.partial(_with_radius, "lines"), [],
        usual="a radius of a 400th of the line's extent", action="append")  # fmt: skip
    flags.own(group, "--mesh-color COLOR", "color of all of --mesh, --spheres and --lines: R,G,B "
        "or V (linear), or #rrggbb (sRGB)", look.color,
        usual="the file's, the material's, or gray")  # fmt: skip
    flags.own(group, "--as-particles", "draw one metaball at each vertex of a mesh instead of its "
        "triangles; --resample draws metaballs, too")  # fmt: skip


def mesh(text: str) -> tuple[str, str | None]:
    """FILE or FILE:MATERIAL."""
    path, _, word = text.rpartition(":")
    return (path, word) if path and word in PRESETS else (text, None)


def _with_radius(kind: str, text: str) -> tuple[str, str, float | None]:
    """FILE or FILE:RADIUS, with the kind in front."""
    path, _, word = text.rpartition(":")
    try:
        radius = float(word) if path else None
    except ValueError:
        radius = None
    if radius is None:
        return kind, text, None
    if not 0 < radius < np.inf:
        raise argparse.ArgumentTypeError(f"expected a radius above 0, got {text!r}")
    return kind, path, radius


def is_mesh(path: str, options: argparse.Namespace) -> bool:
    """Whether an input is drawn as triangles."""
    return not (options.as_particles or options.resample) and has_faces(path)


def check_mesh(path: str, options: argparse.Namespace) -> None:
    """Refuse the flags that a mesh does not have, before any work."""
    thesis = options.root != "exact"
    if options.surface != "auto":
        raise UserError(
            f"--surface: expected particles beside --surface {options.surface}, got the mesh "
            f"{path}; --as-particles draws its vertices as metaballs"
        )
    for name, flag in (*_OF_PARTICLES.items(), *([("root", "--root")] if thesis else [])):
        if getattr(options, name):
            raise UserError(
                f"{flag}: expected particles beside {flag}, got the mesh {path}; --as-particles "
                "draws its vertices as metaballs"
            )


def read_mesh(path: str, options: argparse.Namespace, solid: bool | None = None) -> Mesh:
    """The mesh of a file. Raises UserError if it cannot be read."""
    with readable(path):
        origin = "auto" if options.origin is None else options.origin
        mesh = Mesh(path, solid=solid, origin=origin, device=options.device, threads=options.threads)
        options.origin = mesh.origin  # all others stand where this one does
        return mesh


def read_bodies(path: str, options: argparse.Namespace) -> RigidBodies:
    """The rigid bodies of a folder. Raises UserError if it cannot be read."""
    with readable(path):
        bodies = RigidBodies(path, device=options.device, threads=options.threads)
        if options.origin:
            pose = np.eye(4)
            pose[:3, 3] -= options.origin
            bodies.together.pose = pose
        return bodies


def place(moving: list[RigidBodies], path: str, i: int) -> None:
    """Move bodies to the frame with the number of a file's name; without one, to the i-th."""
    numbers = re.findall(r"\d+", stem(path))
    try:
        for bodies in moving:
            bodies.place(int(numbers[-1]) if numbers else bodies.frames[0] + i)
    except (FormatError, OSError) as error:
        raise UserError(str(error)) from error


def check_meshes(options: argparse.Namespace) -> None:
    """Refuse files of --mesh that are no meshes, before any work."""
    for path, word in options.meshes:
        if os.path.isdir(path):
            continue
        try:
            check_input(path)
        except UserError as error:
            name, _, last = path.rpartition(":")
            if name and word is None and has_faces(name):
                known = ", ".join(PRESETS)
                raise UserError(f"--mesh: expected a material, {known}, got {last!r}") from error
            raise
    for _, path, _ in (*options.spheres, *options.lines):
        check_input(path)


def files(options: argparse.Namespace) -> list[str]:
    """The files of all layers that `layers` makes."""
    plain = (path for _, path, _ in (*options.spheres, *options.lines))
    return [*(path for path, _ in options.meshes), *plain]


def _capsules(options: argparse.Namespace, kind: str, path: str, radius: float | None) -> Mesh:
    """The spheres or the line of a file."""
    origin = options.origin or HERE
    particles = read_particles(path, radius_is=options.radius_is, origin=origin)
    finite = np.isfinite(particles.positions).all(axis=1)
    if n_lost := int((~finite).sum()):
        have = "have" if n_lost > 1 else "has"
        warn(f"{n_lost:,} of {count(len(finite))} of {path} {have} no finite position, left out")
        particles = particles[finite]
    machine: dict[str, Any] = {"device": options.device, "threads": options.threads}
    positions, color = particles.positions, particles.color
    if kind == "lines":
        if radius is None:
            radius = _THIN * float(np.linalg.norm(np.ptp(positions, axis=0))) if len(particles) else 1
        return Lines(positions, radius or 1.0, color, **machine)
    radii = find_radii(particles) if kind == "spheres" and radius is None else None
    if radii is not None:
        shown = particles[radii > 0]
        return Spheres(shown.positions, radii[radii > 0], shown.color, **machine)
    if radius is None:
        radius = 0.5 * (Scene(positions, device="cpu").spacing or 1.0)
    return Spheres(positions, radius, color, **machine)


def layers(
    options: argparse.Namespace, clips: list[ClipPlane | ClipBox | ClipSphere], particles: Particles | None
) -> tuple[list[Layer], list[str], list[RigidBodies]]:
    """The layers of --mesh, --spheres and --lines, messages about them, and what moves."""
    found, messages, moving = [], [], []
    for path, word in options.meshes:
        if os.path.isdir(path):
            bodies = read_bodies(path, options)
            moving.append(bodies)
            shape: Mesh = bodies.together
        else:
            shape = read_mesh(path, options)
        if shape.solid and particles is not None and surrounds(shape, particles):
            shape = read_mesh(path, options, solid=False)
            messages.append(f"{path} surrounds the particles: drawn as a thin wall, not as a body")
        with mistakes():
            material = load_preset(word, shape, options.up).material if word else Material()
            if options.mesh_color is not None:
                material = dataclasses.replace(material, color=options.mesh_color)
            found.append(Layer(shape, material, clips))
    for kind, path, radius in (*options.spheres, *options.lines):
        with mistakes():
            shape = _capsules(options, kind, path, radius)
            found.append(Layer(shape, Material(color=options.mesh_color), clips))
    return found, messages, moving


def why_empty(shape: Mesh) -> str:
    """Why an image does not show a mesh."""
    corners = np.asarray(shape.vertices, np.float64)[shape.faces]
    sides = corners[:, 1:] - corners[:, :1]
    if not np.cross(sides[:, 0], sides[:, 1]).any():
        n = count(len(shape), "triangle")
        return f"no pixel hits the mesh: it has no area, {n} of points or lines alone"
    return "no pixel hits the mesh: the camera looks past it, try --fit"


def surrounds(shape: Mesh, particles: Particles) -> bool:
    """Whether most of the particles lie inside the mesh."""
    points = particles.finite_positions()
    points = points[:: 1 + len(points) // _SAMPLES]
    return len(points) > 0 and float(np.mean(shape.contains(points))) > 0.5
