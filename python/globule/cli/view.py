"""Show particles, volumes, sweeps and simulations live in the browser.

`globule view` traces the image on this machine and sends the image to the browser. The browser may
run on another machine: `globule view` prints the ssh command for that. Ctrl-C ends the command.

--eye and --look-at go together. Flags win over the settings of --state."""

from __future__ import annotations

import argparse
import socket
import threading
import webbrowser
from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from ..data.particles import UP
from ..formats import up_of
from ..render.camera import Camera
from ..render.presets import PRESETS
from . import flags
from .parser import Parser
from .shared import UserError, check_device, readable, say, up_said
from .shared import reading as reading_of
from .state import read_state

if TYPE_CHECKING:
    from ..viewer.app import Viewer
    from ..viewer.source import Source
    from ..viewer.start import Start
    from ..viewer.state import State

SUMMARY = "particles, volumes, sweeps and simulations, live in the browser"
USAGE = "[FILE ...]"
EXAMPLES = """\
  globule view
  globule view splash.npz
  globule view dam-break
  globule view frame_*.ply --preset water --no-browser
  globule view head.nii.gz --up 0,0,1
  globule view splash.npz --state view.toml --host 0.0.0.0
  globule view splash.npz --demand-token --max-clients 4
  globule view before.vtk --compare after.vtk"""
ESSENTIAL = ("--state", "--eye", "--look-at", "--up", "--preset", "--color-by", 
             "--calibration", "--host", "--port", "--no-browser", "--device")  # fmt: skip


def add_arguments(parser: Parser) -> None:
    """The arguments of `globule view`."""
    parser.add_argument(
        "what",
        nargs="*",
        metavar="FILE",
        help="particles, mesh, volume or sweep (several: a sequence), a simulation's name or "
        ".toml, or igtl://host:port; default: a page to choose from",
    )
    flags.add(parser, "--state", "default: none")
    flags.own(parser, "--compare FILE", "particles or mesh for the right part of the image, beside "
        "a divider to drag")  # fmt: skip
    flags.add_page(parser)
    first = parser.add_argument_group("start values; the page can change all of them")
    flags.add(first, "--eye", "default: all is visible")
    flags.add(first, "--look-at", "default: the middle of the particles")
    flags.add(first, "--up", "default: by format")
    flags.add(first, "--fov", "default: 40", default=40.0)
    flags.add(first, "--ortho", "needs --eye; default: none, a perspective camera")
    flags.add(first, "--preset", "default: the simulation's, else none", choices=PRESETS)
    flags.add(first, "--kernel", "default: murakami")
    flags.add(first, "--support", "default: the file's, else two spacings")
    flags.add(first, "--threshold", "default: by kernel")
    flags.add(first, "--color-by", "default: the particles' color")
    flags.add(first, "--colormap", "default: auto")
    flags.add(first, "--range", "default: the lowest and the highest value")
    flags.add(first, "--clip", "default: none")
    flags.add_reading(parser)
    sweep = parser.add_argument_group("sweeps")
    flags.add(sweep, "--calibration", "default: the recording's own transforms")
    flags.add(sweep, "--plus", "default: none")
    flags.add_device(parser.add_argument_group("machine"))


def run(options: argparse.Namespace) -> None:
    """Run `globule view`."""
    if (options.eye is None) != (options.look_at is None):
        raise UserError("--eye: expected --eye and --look-at together, got one of the two")
    if options.ortho and not options.eye:
        raise UserError("--ortho: expected --eye and --look-at beside --ortho, got none")
    check_device(options)
    check_viewer()
    from ..viewer.open import open_source

    given = reading_of(options)
    for name in ("calibration", "plus"):
        if getattr(options, name):
            given[name] = getattr(options, name)
    with readable((options.what or [""])[0]):
        state, camera = _settings(options)
        start, token = None, None
        if options.what:
            source = open_source(options.what, options.device, options.threads, **given)
            remember(options.what)
        else:
            start, source = start_page(options, given)
            token = start.token
        if options.compare:
            from ..viewer.compare_source import CompareSource

            other = open_source(options.compare, options.device, options.threads, **given)
            source = CompareSource(source, other)
        if state.color.by and state.color.by not in source.color_names():
            known = ", ".join(source.color_names())
            raise UserError(f"--color-by: expected one of {known}, got {state.color.by}")
        if not options.state and not options.preset:
            options.preset = source.preset
        if not options.state and not options.color_by:
            state.set(**source.settings)
        if options.up is None and camera is not None and not options.state:
            camera = replace(camera, up=source.up)
        of_file = options.up is None and source.kind in ("scene", "sequence")
        if of_file and source.files and source.up != UP:
            say(up_said(source.up, up_of(source.files[0])[1]))
        viewer = serve(source, options, options.up, camera, state, options.preset, token)
    while True:
        ends: list[threading.Thread] = []
        viewer.on_open = _ending(viewer, ends)
        try:
            viewer.wait()
        finally:
            if start is not None:
                start.close()
        if not ends:
            return
        ends[0].join()  # and the port is free
        token, options.port, options.no_browser = viewer.token, viewer.port, True
        start, source = start_page(options, given, token)
        viewer = serve(source, options, preset=source.preset, token=token)


def _ending(viewer: Viewer, ends: list[threading.Thread]) -> Callable[[], None]:
    """A function that ends a viewer in a thread, which it adds to a list."""

    def end() -> None:
        ends.append(threading.Thread(target=viewer.close, args=(1.0,), name="globule open"))
        ends[0].start()

    return end


def start_page(options: argparse.Namespace, given: dict[str, Any], token: str | None = None) -> tuple[Start, Source]:
    """Wait until a person has chosen on the start page what to show."""
    from .._demo.data import dam_break_particles
    from ..viewer.guard import LOCAL
    from ..viewer.open import open_source
    from ..viewer.source import SceneSource
    from ..viewer.start import SPLASH, Start

    def chosen(name: Any) -> Source:
        if name == SPLASH:
            return SceneSource(SPLASH, dam_break_particles()[0])
        return open_source(name, options.device, options.threads, **given)

    start = Start(chosen, options.host, options.port, options.demand_token, token)
    address = start.address("127.0.0.1" if start.host in LOCAL else socket.gethostname())
    print(f"globule: choose what to show at {address}", flush=True)
    print("globule: press Ctrl-C to stop", flush=True)
    if not options.no_browser:
        webbrowser.open(address)
    try:
        source = start.wait()
    except BaseException:
        start.close()
        raise
    options.port, options.no_browser = start.port, True
    return start, source


def remember(what: list[str]) -> None:
    """Note a single file for the start page's list of recent files."""
    from ..viewer.start import remember as note

    if len(what) == 1:
        note(what[0])


def check_viewer() -> None:
    """Refuse to start without the viewer's packages; name the command that installs them."""
    from ..viewer.app import need_websockets

    try:
        need_websockets()
    except ImportError as error:
        raise UserError(str(error)) from error


def serve(
    source: Source,
    options: argparse.Namespace,
    up: Any = None,
    camera: Camera | None = None,
    state: State | None = None,
    preset: str | None = None,
    token: str | None = None,
) -> Viewer:
    """The viewer of a source, at the address of the flags of `flags.add_page`."""
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
        token=token,
        demand_token=options.demand_token,
        most_clients=options.max_clients,
    )
    for line in [*viewer.greeting(), "press Ctrl-C to stop the viewer"]:
        print(f"globule: {line}", flush=True)
    return viewer


def _settings(options: argparse.Namespace) -> tuple:
    """The state, and the camera if there is one."""
    from ..viewer.state import State

    state, camera = read_state(options.state) if options.state else (State(), None)
    if options.eye:
        camera = Camera(options.eye, options.look_at, options.up or UP, options.fov, options.ortho)
    changes = {
        "surface__kernel": options.kernel,
        "surface__support": options.support,
        "surface__threshold": options.threshold,
        "color__by": options.color_by,
        "color__colormap": options.colormap,
    }
    if options.range:
        changes |= {"color__automatic": False, "color__low": options.range[0], "color__high": options.range[1]}
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
