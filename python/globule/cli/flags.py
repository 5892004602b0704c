"""Flags that several commands have: one metavar, one unit and one sentence for all of them."""

from __future__ import annotations

import argparse
import re
from typing import Any

from .._base.checks import MAX_PIXELS
from .._base.settings import Color, Number, Switch, Text, Whole, settings_of
from ..formats.pictures.video import FPS
from ..render.presets import PRESETS
from ..viewer.state import Coloring, Surface
from . import look
from .arguments import plane
from .shared import direction, number, positive, vector


def size(text: str) -> tuple[int, int]:
    """WIDTHxHEIGHT."""
    match = re.fullmatch(r"(\d{1,9})x(\d{1,9})", text)
    width, height = (int(match[1]), int(match[2])) if match else (0, 0)
    if width < 1 or height < 1 or width * height > MAX_PIXELS:
        expected = f"WIDTHxHEIGHT of 1 to {MAX_PIXELS:,} pixels"
        raise argparse.ArgumentTypeError(f"expected {expected}, got {text!r}")
    return width, height


def of(table: type, name: str, **changes: Any) -> dict[str, Any]:
    """A flag of a setting, without its default, as `add_argument` takes it."""
    one = settings_of(table)[name]
    found: dict[str, Any] = {"help": one.brief, **changes}
    if isinstance(one.kind, Color):
        found["help"] += f": {one.kind.word}"
    if "action" in changes or isinstance(one.kind, Switch):
        return {"action": "store_true", **found}
    if one.kind.choices:
        if not all(word in found["help"] for word in one.kind.choices):
            found["help"] += f": {', '.join(one.kind.choices)}"
        return {"choices": one.kind.choices, "metavar": one.kind.metavar, **found}
    parse = None if isinstance(one.kind, Text) else one.kind.parse
    return {"type": parse, "metavar": one.kind.metavar, **found}


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
        "type": Number(*FPS).parse,
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
    "--kernel": of(Surface, "kernel"),
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
    "--support": of(Surface, "support", metavar="LENGTH"),
    "--threshold": of(Surface, "threshold", metavar="T"),
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
    "--color-by": of(Coloring, "by", metavar="NAME"),
    "--colormap": of(Coloring, "colormap"),
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
        "type": Number(1e-6, 1e9).parse,
        "metavar": "GB",
        "help": "most memory that a file or scene may need, gigabytes",
    },
    "--max-ratio": {
        "type": Number(1.0).parse,
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
        "type": Whole(0, 65535).parse,
        "metavar": "N",
        "help": "number of the port; if the port is taken, the next free port",
    },
    "--no-browser": {"action": "store_true", "help": "do not open a browser"},
    "--demand-token": {
        "action": "store_true",
        "help": "demand a token on this machine, too, as behind a reverse proxy",
    },
    "--max-clients": {
        "type": Number(1.0).parse,
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


def add_settings(group: Any, table: type, *names: str, note: str = "", **changes: Any) -> None:
    """Add the flags of settings. note: what follows the default, such as ", or the preset's"."""
    for name in names:
        flag, one = "--" + name.replace("_", "-"), settings_of(table)[name]
        words = of(table, name, **changes)
        if words.get("action") != "store_true":
            words["help"] += f" (default: {one.usual or shown_default(one.default)}{note})"
        group.add_argument(flag, **words)


def shown_default(value: Any) -> str:
    """A default in the words of a command."""
    if isinstance(value, tuple):
        return ",".join(f"{v:g}" for v in value)
    if isinstance(value, bool):
        return "on" if value else "off"
    return f"{value:g}" if isinstance(value, float) else str(value or "none" if value != 0 else 0)


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
