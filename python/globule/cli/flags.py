"""Flags that several commands have: one metavar, one unit and one sentence for all of them."""

from __future__ import annotations

import argparse
import re
from typing import Any

from .._base.checks import MAX_PIXELS
from .._base.colormaps import NAMES as COLORMAPS
from ..formats.pictures.video import FPS
from ..render.presets import PRESETS
from ..scene.scene import KERNELS
from . import look
from .arguments import between, plane
from .shared import direction, number, positive, vector


def size(text: str) -> tuple[int, int]:
    """WIDTHxHEIGHT."""
    match = re.fullmatch(r"(\d{1,9})x(\d{1,9})", text)
    width, height = (int(match[1]), int(match[2])) if match else (0, 0)
    if width < 1 or height < 1 or width * height > MAX_PIXELS:
        expected = f"WIDTHxHEIGHT of 1 to {MAX_PIXELS:,} pixels"
        raise argparse.ArgumentTypeError(f"expected {expected}, got {text!r}")
    return width, height


def port(text: str) -> int:
    """The number of a TCP port; 0 takes any."""
    if not text.isdecimal() or not int(text[:6]) < 65536:
        raise argparse.ArgumentTypeError(f"expected a port, 0 to 65535, got {text!r}")
    return int(text)


def at_least_one(text: str) -> float:
    """A number from 1."""
    value = number(text)
    if value < 1:
        raise argparse.ArgumentTypeError(f"expected a number of at least 1, got {text!r}")
    return value


# `help` is the sentence; a command adds what is special to it, and the default, in parentheses.
FLAGS: dict[str, dict[str, Any]] = {
    "--output": {"metavar": "PATH", "help": "file or folder to write"},
    "--json": {"action": "store_true", "help": "print one JSON object instead of text"},
    "--list": {"action": "store_true", "help": "list the names and exit"},
    "--quick": {"action": "store_true", "help": "run only the small sizes, for a minute or more"},
    "--resume": {"action": "store_true", "help": "continue an interrupted run"},
    "--state": {"metavar": "FILE.toml", "help": "settings saved by `globule view`"},
    "--size": {
        "type": size,
        "metavar": "WxH",
        "help": "size of the image, pixels",
    },
    "--fps": {
        "type": between(*FPS),
        "metavar": "N",
        "help": "frame rate of movies and sequences, frames per second",
    },
    # Camera
    "--eye": {"type": vector, "metavar": "X,Y,Z", "help": "camera position, world units"},
    "--look-at": {
        "type": vector,
        "metavar": "X,Y,Z",
        "help": "point in the middle of the image, world units",
    },
    "--up": {
        "type": direction,
        "metavar": "X,Y,Z",
        "help": "direction that points up in the image",
    },
    "--fov": {
        "type": positive,
        "metavar": "DEG",
        "help": "vertical field of view, degrees",
    },
    "--ortho": {
        "type": positive,
        "metavar": "HEIGHT",
        "help": "orthographic camera whose image has this height, world units",
    },
    # Surface
    "--kernel": {
        "choices": KERNELS,
        "metavar": "NAME",
        "help": f"kernel of the particles: {', '.join(KERNELS)}",
    },
    "--surface": {
        "choices": ("auto", "smooth", "balls", "spheres"),
        "metavar": "NAME",
        "help": "smooth: one surface that encloses the fluid's volume; balls: a ball around each "
        "particle; spheres: spheres of half a spacing; auto: smooth for particles of one fluid, "
        "spheres for 2-D data (all z equal)",
    },
    "--particle-spacing": {
        "type": positive,
        "metavar": "LENGTH",
        "help": "spacing of a fluid's particles, the cube root of a particle's volume, world units",
    },
    "--support": {
        "type": positive,
        "metavar": "LENGTH",
        "help": "support radius of every particle's kernel, world units",
    },
    "--threshold": {
        "type": positive,
        "metavar": "T",
        "help": "iso-value of the particles' summed field, without unit",
    },
    "--level": {
        "type": number,
        "metavar": "V",
        "help": "iso-value of a volume's surface, in the file's unit",
    },
    "--label": {
        "type": int,
        "action": "append",
        "metavar": "N",
        "help": "value of the voxels to take from a volume, in the file's unit",
    },
    "--resample": {
        "type": positive,
        "metavar": "LENGTH",
        "help": "edge of a volume's resampled voxels, or distance of the points on a mesh, "
        "in the file's unit",
    },
    "--frame": {
        "type": int,
        "metavar": "N",
        "help": "number of a frame in a file with several, from 0; -1: the last",
    },
    "--species": {
        "metavar": "NAME",
        "help": "group of particles in a file with several, by its name there",
    },
    "--clip": {
        "type": plane,
        "metavar": "NX,NY,NZ,D",
        "help": "cut away the side of a plane where nx x + ny y + nz z > d, world units",
    },
    # Look
    "--preset": {"metavar": "NAME", "help": f"material, light and sky: {', '.join(PRESETS)}"},
    "--color-by": {"metavar": "NAME", "help": "field or attribute that gives the color"},
    "--colormap": {
        "choices": COLORMAPS,
        "metavar": "NAME",
        "help": f"color map of --color-by: {', '.join(COLORMAPS)}",
    },
    "--range": {
        "type": look.interval,
        "metavar": "LO,HI",
        "help": "values at the ends of the color map, in the field's unit",
    },
    # Sweeps
    "--calibration": {
        "metavar": "FILE.toml",
        "help": "probe calibration to read, as `globule calibrate` writes it",
    },
    "--plus": {"metavar": "CONFIG.xml", "help": "PLUS configuration to read"},
    "--poses": {
        "metavar": "TABLE",
        "help": "probe poses of an image stack, .csv or .json",
    },
    "--frame-times": {
        "type": positive,
        "metavar": "FPS",
        "help": "frame rate of an image stack that stores no times, frames per second",
    },
    # Machine
    "--device": {"metavar": "NAME", "help": "processor: auto, cpu, cuda or cuda:N"},
    "--threads": {"type": int, "metavar": "N", "help": "number of CPU threads"},
    # Limits of files
    "--max-memory": {
        "type": between(1e-6, 1e9),
        "metavar": "GB",
        "help": "most memory that a file or scene may need, gigabytes",
    },
    "--max-ratio": {
        "type": at_least_one,
        "metavar": "N",
        "help": "largest number of bytes that a compressed file may unpack to, for each of its own",
    },
    # Page of the viewer
    "--host": {
        "metavar": "HOST",
        "help": "address to listen on; any address but the default makes the page ask for a "
        "secret token",
    },
    "--port": {
        "type": port,
        "metavar": "N",
        "help": "number of the port; if the port is taken, the next free port",
    },
    "--no-browser": {"action": "store_true", "help": "do not open a browser"},
    "--demand-token": {
        "action": "store_true",
        "help": "demand a token on this machine, too, as behind a reverse proxy",
    },
    "--max-clients": {
        "type": at_least_one,
        "metavar": "N",
        "help": "number of browsers that are shown images at a time",
    },
}


def add(group: Any, name: str, note: str = "", **changes: Any) -> None:
    """Add a flag of `FLAGS`. note: what is special to the command, and the default, such as
    "folder, made if missing; default: demo"."""
    named = {**FLAGS[name], **changes}
    if note:
        named["help"] += f" ({note})"
    names = ("-o", name) if name == "--output" else (name,)
    group.add_argument(*names, **named)


def add_device(group: Any) -> None:
    """The flags that say where to compute."""
    add(group, "--device", "default: auto", default="auto")
    add(group, "--threads", "default: all cores", default=0)


def add_reading(parser: argparse.ArgumentParser) -> None:
    """The flags that say what to take from volumes, meshes and simulation files."""
    group = parser.add_argument_group("volumes and meshes")
    add(group, "--level", "default: Otsu's threshold")
    add(group, "--label", "may be repeated; default: all above --level")
    add(group, "--resample", "default: the file's own voxels and vertices")
    group = parser.add_argument_group("files of several frames or species")
    add(group, "--frame", "default: 0")
    add(group, "--species", "default: gas, else the first or all")


def add_limits(parser: argparse.ArgumentParser) -> None:
    """The flags that say what a file may ask for."""
    group = parser.add_argument_group("limits of files")
    add(group, "--max-memory", "default: the memory that is free")
    add(group, "--max-ratio", "default: 200")


def add_page(parser: argparse.ArgumentParser) -> None:
    """The flags that say where the viewer's page is."""
    page = parser.add_argument_group("page")
    add(page, "--host", "default: 127.0.0.1", default="127.0.0.1")
    add(page, "--port", "default: 8080", default=8080)
    add(page, "--no-browser")
    add(page, "--demand-token")
    add(page, "--max-clients", "default: 16", default=16)
