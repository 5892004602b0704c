"""Look at particles, sequences, simulations, volumes and sweeps live in the browser.

The picture is ray-traced here and sent to the browser as it changes; the browser may be far away
(the line with ssh says how). Ctrl-C ends it."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Any

import numpy as np

from .._base.colormaps import NAMES as COLORMAPS
from ..formats import FormatError
from ..render.camera import Camera
from ..render.presets import PRESETS
from ..scene.scene import KERNELS
from . import look
from .arguments import plane
from .shared import UserError, add_device, add_reading, check_device, mistakes, positive, vector
from .shared import reading as reading_of

if TYPE_CHECKING:
    from ..viewer.app import Viewer
    from ..viewer.source import Source
    from ..viewer.state import State

SUMMARY = "live in the browser"
EXAMPLES = """\
  globule view splash.npz
  globule view frame_*.ply --preset water --no-browser
  globule view dam-break
  globule view head.nii.gz --up 0,0,1
  globule view splash.npz --state view.toml --host 0.0.0.0"""


def port(text: str) -> int:
    """A port's number; 0 takes any."""
    if not text.isdecimal() or not int(text[:6]) < 65536:
        raise argparse.ArgumentTypeError(f"expected a port, 0 to 65535, got {text!r}")
    return int(text)


def add_page(parser: argparse.ArgumentParser) -> None:
    """Options that say where the page is."""
    page = parser.add_argument_group("page")
    page.add_argument(
        "--host",
        default="127.0.0.1",
        metavar="HOST",
        help="where to listen; another than this machine's own (0.0.0.0) puts a "
        "token into the address, without which nobody gets in (default: 127.0.0.1)",
    )
    page.add_argument(
        "--port",
        type=port,
        default=8080,
        metavar="N",
        help="the first free one from here on (default: 8080)",
    )
    page.add_argument("--no-browser", action="store_true", help="do not open one")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    add(
        "what",
        nargs="+",
        metavar="WHAT",
        help="files of particles, meshes, volumes or sweeps (several: a sequence), a simulation's "
        "name or .toml, or igtl://host:port",
    )
    add("--state", metavar="FILE.toml", help="settings saved from the page")
    add_page(parser)
    first = parser.add_argument_group("to begin with; the page can change all of it")
    first.add_argument("--eye", type=vector, metavar="X,Y,Z", help="where the camera is")
    first.add_argument("--look-at", type=vector, metavar="X,Y,Z", help="middle of the picture")
    first.add_argument(
        "--fov",
        type=positive,
        default=40.0,
        metavar="DEG",
        help="vertical field of view (default: 40)",
    )
    first.add_argument(
        "--ortho",
        type=positive,
        metavar="HEIGHT",
        help="orthographic, HEIGHT world units from bottom to top, with --eye",
    )
    first.add_argument(
        "--up",
        type=vector,
        metavar="X,Y,Z",
        help="direction to the sky (default: 0,1,0; for volumes and sweeps 0,0,1)",
    )
    first.add_argument("--preset", choices=PRESETS, metavar="NAME", help=", ".join(PRESETS))
    first.add_argument("--kernel", choices=KERNELS, metavar="NAME", help=", ".join(KERNELS))
    first.add_argument("--support", type=positive, metavar="A")
    first.add_argument("--threshold", type=positive, metavar="T")
    first.add_argument("--color-by", metavar="NAME", help="colour by a field or attribute")
    first.add_argument("--colormap", choices=COLORMAPS, metavar="MAP", help=", ".join(COLORMAPS))
    first.add_argument(
        "--range", type=look.interval, metavar="LO,HI", help="values of the map's ends"
    )
    first.add_argument("--clip", type=plane, metavar="NX,NY,NZ,D", help="a cutting plane")
    add_reading(parser)
    sweep = parser.add_argument_group("sweeps")
    sweep.add_argument("--calibration", metavar="FILE.toml", help="of the probe")
    sweep.add_argument("--plus", metavar="CONFIG.xml", help="configuration of PLUS")
    add_device(parser.add_argument_group("machine"))


def run(options: argparse.Namespace) -> None:
    if (options.eye is None) != (options.look_at is None):
        raise UserError("--eye: expected --look-at beside it, or neither")
    if options.ortho and not options.eye:
        raise UserError("--ortho: expected --eye and --look-at beside it, got none")
    check_device(options)
    check_viewer()
    from ..viewer.open import open_source

    given = reading_of(options)
    for name in ("calibration", "plus"):
        if getattr(options, name):
            given[name] = getattr(options, name)
    try:
        with mistakes():
            state, camera = _settings(options)
            source = open_source(options.what, options.device, options.threads, **given)
            if state.color.by and state.color.by not in source.color_names():
                known = ", ".join(source.color_names())
                raise UserError(f"--color-by: expected one of {known}, got {state.color.by}")
            if not options.state and not options.preset:
                options.preset = source.preset
            if not options.state and not options.color_by:
                state.set(**source.settings)
            viewer = serve(source, options, options.up, camera, state, options.preset)
    except FormatError as error:
        raise UserError(str(error)) from error
    except OSError as error:
        name = error.filename or options.what[0]
        raise UserError(f"{name}: cannot be read: {error.strerror or error}") from error
    viewer.wait()


def check_viewer() -> None:
    """Say what to install where the viewer's libraries are not."""
    from ..viewer.app import need_viser

    try:
        need_viser()
    except ImportError as error:
        raise UserError(str(error)) from error


def serve(
    source: Source,
    options: argparse.Namespace,
    up: Any = None,
    camera: Camera | None = None,
    state: State | None = None,
    preset: str | None = None,
) -> Viewer:
    """The viewer of a source, where the options of `add_page` say."""
    from ..viewer import show

    viewer = show(
        source,
        options.host,
        options.port,
        up,
        camera,
        state,
        preset,
        not options.no_browser,
    )
    for line in [*viewer.greeting(), "press Ctrl-C to stop the viewer"]:
        print(f"globule: {line}", flush=True)
    return viewer


def _settings(options: argparse.Namespace) -> tuple:
    """The state, and the camera where one is given."""
    from ..viewer.state import MOST_BYTES, State

    state, camera = State(), None
    if options.state:
        with open(options.state, encoding="utf-8") as file:
            try:
                camera = state.load_toml(file.read(MOST_BYTES + 1))
            except ValueError as error:
                raise UserError(f"{options.state}: {error}") from error
    if options.eye:
        camera = Camera(
            options.eye, options.look_at, options.up or (0, 1, 0), options.fov, options.ortho
        )
    changes = {
        "surface__kernel": options.kernel,
        "surface__support": options.support,
        "surface__threshold": options.threshold,
        "color__by": options.color_by,
        "color__colormap": options.colormap,
    }
    if options.range:
        changes |= {
            "color__automatic": False,
            "color__low": options.range[0],
            "color__high": options.range[1],
        }
    if options.clip:
        length = np.linalg.norm(options.clip.normal)
        normal, offset = np.asarray(options.clip.normal) / length, options.clip.offset / length
        changes |= {
            "cuts__plane": True,
            "cuts__normal": tuple(normal.tolist()),
            "cuts__point": tuple((normal * offset).tolist()),
        }
    state.set(**{name: value for name, value in changes.items() if value is not None})
    return state, camera
