"""Render an embedded data set: no file and no download needed.

The data set is a frame of the scene dam-break. `globule demo` writes splash.png, and the particles
as splash.npz, into a folder."""

from __future__ import annotations

import argparse
import os
import shlex
import shutil
import sys
import time

from . import flags
from .parser import Parser
from .shared import Progress, check_device, count, make_folder, mistakes

SUMMARY = "an image of an embedded data set"
USAGE = ""
EXAMPLES = "  globule demo"

SIZE = (1024, 782)
EYE, LOOK_AT = (-1.0, 1.15, 2.3), (-0.13, 0.40, 0.0)  # closer than --fit


def add_arguments(parser: Parser) -> None:
    """The arguments of `globule demo`."""
    flags.add(parser, "--output", "folder; default: demo", default="demo")
    flags.add_device(parser)


def run(options: argparse.Namespace) -> None:
    """Run `globule demo`."""
    from .._demo.data import dam_break_particles
    from ..formats import write
    from ..pieces.scene import Scene
    from ..render.camera import Camera
    from ..render.render import render

    check_device(options)
    make_folder("-o", options.output)
    image = os.path.join(options.output, "splash.png")
    data = os.path.join(options.output, "splash.npz")
    start = time.perf_counter()
    with Progress(4) as progress:
        progress.step("unpacking particles")
        particles, spacing = dam_break_particles()
        progress.step("building the octree")
        with mistakes():
            scene = Scene(particles, device=options.device, threads=options.threads, surface="smooth", spacing=spacing)
        progress.step("tracing")
        frame = render(scene, Camera(EYE, LOOK_AT), SIZE)
        trace_seconds = frame.trace_seconds
        progress.step("writing")
        write(data, particles)
        frame.save(image)
    total = time.perf_counter() - start
    print(f"{image}: {SIZE[0]}x{SIZE[1]} pixels, {count(len(particles))} ({data})")
    print(
        f"octree {1e3 * scene.octree.build_seconds:.1f} ms, rays {1e3 * trace_seconds:.1f} ms, "
        f"{total:.2f} s in all on {scene.device.description}"
    )
    program = _program()
    near = os.path.join(options.output, "near.png")
    print("next, try:")
    print(f"  {program} render {shlex.quote(data)} -o {shlex.quote(near)} --eye 0.1,0.7,0.9 --look-at 0.5,0.25,0")
    water = shlex.quote(os.path.join(options.output, "water.png"))
    print(f"  {program} render {shlex.quote(data)} -o {water} --preset water --size 512x391")
    print(f"  {program} info {shlex.quote(data)}")
    print(f"  {program} render --help")


def _program() -> str:
    """The words that start this program."""
    name = sys.argv[0]
    if os.path.basename(name) != "globule":
        return f"{shlex.quote(sys.executable)} -m globule"
    found = shutil.which("globule")
    if found and os.path.exists(name) and os.path.samefile(found, name):
        return "globule"
    return shlex.quote(os.path.relpath(name))
