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


def origin(text: str) -> tuple[float, float, float] | None:
    """X,Y,Z; None for auto."""
    return None if text == "auto" else vector(text)


def columns(text: str) -> dict[str, str]:
    """FIELD=NAME,… of a table's columns."""
    pairs = [part.partition("=") for part in text.split(",")]
    found = {field.strip(): name.strip() for field, _, name in pairs}
    if not all(found) or not all(found.values()) or len(found) < len(pairs):
        raise argparse.ArgumentTypeError(f"expected x=NAME,y=NAME,z=NAME, got {text!r}")
    return found


def row(metavar: str, help: str, kind: Any = None, **more: Any) -> dict[str, Any]:
    """A flag as `add_argument` takes it: a switch without a metavar. kind: parser of the value, or
    names to choose from."""
    if not metavar:
        return {"action": "store_true", "help": help, **more}
    how = {"choices": kind} if isinstance(kind, (tuple, list)) else {"type": kind}
    return {"metavar": metavar, "help": help, **how, **more}


def of(table: type, name: str, **changes: Any) -> dict[str, Any]:
    """A flag of a setting, without its default, as `add_argument` takes it."""
    one, kind = settings_of(table)[name], settings_of(table)[name].kind
    help, names = one.brief, kind.choices or ()
    if isinstance(kind, Color):
        help += f": {kind.word}"
    elif "action" not in changes and not all(word in help for word in names):
        help += f": {', '.join(names)}"
    if "action" in changes or isinstance(kind, Switch):
        return {"action": "store_true", "help": help, **changes}
    how = names or (None if isinstance(kind, Text) else kind.parse)
    return row(kind.metavar, help, how) | changes


# The help is the sentence; a command adds what is special to it, and the default, in parentheses.
FLAGS: dict[str, dict[str, Any]] = {
    "--output": row("PATH", "file or folder to write"),
    "--json": row("", "print one JSON object instead of text"),
    "--list": row("", "list the names and exit"),
    "--quick": row("", "run only the small sizes, for a minute or more"),
    "--resume": row("", "continue an interrupted run"),
    "--state": row("FILE.toml", "settings saved by `globule view`"),
    "--size": row("WxH", "size of the image, pixels", size),
    "--fps": row("N", "frame rate of movies and sequences, frames per second", Number(*FPS).parse),
    # Camera
    "--eye": row("X,Y,Z", "camera position, world units", vector),
    "--look-at": row("X,Y,Z", "point in the middle of the image, world units", vector),
    "--up": row("X,Y,Z", "upward direction in the image", direction),
    "--fov": row("DEG", "vertical field of view, degrees", positive),
    "--ortho": row("HEIGHT", "orthographic camera whose image has this height, world units",
        positive),
    # Surface
    "--kernel": of(Surface, "kernel"),
    "--surface": row("NAME", "smooth: one surface that encloses the fluid's volume; balls: a ball "
        "around each particle; spheres: of the file's radii or half a spacing; auto: smooth for "
        "one fluid, spheres for grains, 2-D and sprays",
        ("auto", "smooth", "balls", "spheres")),
    "--particle-spacing": row("LENGTH", "spacing of a fluid's particles, the cube root of a "
        "particle's volume, world units", positive),
    "--support": of(Surface, "support", metavar="LENGTH"),
    "--threshold": of(Surface, "threshold", metavar="T"),
    "--level": row("V", "iso-value of a volume's surface, in the file's unit", number),
    "--label": row("N", "value of the voxels to take from a volume, in the file's unit", int,
        action="append"),
    "--resample": row("LENGTH", "edge of a volume's resampled voxels, or distance of the points on "
        "a mesh, in the file's unit", positive),
    "--radius-is": row("NAME", "what a file's array radius holds: radius or diameter",
        ("radius", "diameter")),
    "--frame": row("N", "number of a frame in a file with several, from 0; -1: the last", int),
    "--scale": row("FACTOR", "factor of all lengths of the particles, such as 0.001 for a file in "
        "mm", positive),
    "--origin": row("X,Y,Z", "place, world units, from which positions are given, and places of "
        "flags and results too; auto: near particles whose coordinates float32 would not keep",
        origin),
    "--center": row("", "move particles by whole periods, so that what lies across periodic faces "
        "of the file's box is whole, in its middle"),
    "--min-component": row("N", "least number of particles of a connected component that stays",
        Whole(1, 2**31).parse),
    "--where": row("CONDITION", "only the particles for which it holds, such as 'type == 1 and "
        "speed > 0.2': attributes, numbers, comparisons, in, and, or, not, + - * / **, abs, "
        "sqrt, isfinite; after --scale, before --center and --min-component"),
    "--species": row("NAME", "group of particles in a file with several, by its name there"),
    "--columns": row("FIELD=NAME,…", "names of a table's columns, or an HDF5 file's data sets, for "
        "x, y, z and fields", columns),
    "--atom-style": row("STYLE", "atom style of a LAMMPS data file that does not name its own"),
    "--clip": row("NX,NY,NZ,D", "cut away the side of a plane where nx x + ny y + nz z > d, world "
        "units", plane),
    # Look
    "--preset": row("NAME", f"material, light and sky: {', '.join(PRESETS)}"),
    "--color-by": of(Coloring, "by", metavar="NAME"),
    "--colormap": of(Coloring, "colormap"),
    "--range": row("LO,HI", "values at the ends of the color map, in the field's unit",
        look.interval),
    # Sweeps
    "--calibration": row("FILE.toml", "probe calibration to read, made by `globule calibrate`"),
    "--plus": row("CONFIG.xml", "PLUS configuration to read"),
    "--poses": row("TABLE", "probe poses of an image stack, .csv or .json"),
    "--frame-times": row("FPS", "frame rate of an image stack that stores no times, frames per "
        "second", positive),
    # Machine
    "--device": row("NAME", "processor: auto, cpu, cuda or cuda:N"),
    "--threads": row("N", "number of CPU threads", int),
    # Limits of files
    "--max-memory": row("GB", "most memory that a file or scene may need, gigabytes",
        Number(1e-6, 1e9).parse),
    "--max-ratio": row("N", "largest number of bytes that a compressed file may unpack to, for "
        "each of its own", Number(1.0).parse),
    # Page of the viewer
    "--host": row("HOST", "address to listen on; any address but the default makes the page ask "
        "for a secret token"),
    "--port": row("N", "number of the port; if the port is taken, the next free port",
        Whole(0, 65535).parse),
    "--no-browser": row("", "do not open a browser"),
    "--demand-token": row("", "demand a token on this machine, too, as behind a reverse proxy"),
    "--max-clients": row("N", "number of browsers that are shown images at a time",
        Number(1.0).parse),
}  # fmt: skip


def add(group: Any, name: str, note: str = "", **changes: Any) -> None:
    """Add a flag of `FLAGS`. note: what is special to the command, and the default, such as
    "folder, made if missing; default: demo"."""
    named = {**FLAGS[name], **changes}
    if note:
        named["help"] += f" ({note})"
    names = ("-o", name) if name == "--output" else (name,)
    group.add_argument(*names, **named)


def own(
    group: Any, words: str, help: str, kind: Any = None, default: Any = None, usual: str = "",
    **more: Any,
) -> None:  # fmt: skip
    """Add a flag of one command.

    Args:
        group: of the parser.
        words: the flag and what its value is called, "--idle S"; without a value, a switch.
        help: what it is for, with the unit.
        kind: parser of the value, or names to choose from; None: any text.
        default: the value without the flag.
        usual: the default in words, where its value does not say it.
        more: for `add_argument`.
    """
    flag, _, metavar = words.partition(" ")
    if metavar:
        more["default"] = default
        help += f" (default: {usual or shown_default(default)})"
    group.add_argument(flag, **row(metavar, help, kind, **more))


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


def add_reading(parser: argparse.ArgumentParser, of_frames: bool = True) -> None:
    """The flags that say what to take from volumes, meshes and simulation files. of_frames: with
    --frame."""
    group = parser.add_argument_group("volumes and meshes")
    add(group, "--level", "default: Otsu's threshold")
    add(group, "--label", "may be repeated; default: all above --level")
    add(group, "--resample", "default: the file's own voxels and vertices")
    group = parser.add_argument_group("files of particles")
    add(group, "--where", "default: all")
    add(group, "--scale", "default: 1")
    add(group, "--origin", "default: auto")
    add(group, "--center")
    add(group, "--min-component", "default: 1")
    if of_frames:
        add(group, "--frame", "default: 0")
    add(group, "--radius-is", "default: radius", default="radius")
    add(group, "--species", "default: gas, else the first or all")
    group = parser.add_argument_group("tables and LAMMPS data")
    add(group, "--columns", "default: by their names")
    add(group, "--atom-style", "default: by the number of columns")


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
