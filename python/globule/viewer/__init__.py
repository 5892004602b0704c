"""The interactive viewer: sources of frames, a pacer for each client, and sinks for images."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, Any

from .._base.checks import named

if TYPE_CHECKING:
    from .app import Viewer


@named
def view(
    what: Any,
    *,
    host: str = "127.0.0.1",
    port: int = 8080,
    up: Any = None,
    camera: Any = None,
    state: Any = None,
    preset: str | None = None,
    browser: bool = True,
    block: bool | None = None,
    device: str = "auto",
    threads: int = 0,
    compare: Any = None,
    demand_token: bool = False,
    most_clients: int = 16,
    **reading: Any,
) -> Viewer:
    """Show a scene in the browser, with controls to rotate, cut, measure and record.

        gb.view("splash.vtk")
        gb.view(gb.Simulation("dam-break"))
        viewer = gb.view(scene, block=False)        # the program goes on

    `viewer.address` is the address of the page. The log `globule.viewer` contains the address, too.

    Args:
        what: a file or several, `Particles`, positions (N, 3), a `Scene`, layers, a list of
            `Particles` (a sequence), a `Volume` or (volume, sweep), a `Sweep`, a simulation, the
            name of a shipped scene, or a scene's .toml.
        host: the address to listen on. Any address other than a loopback address demands a token,
            which is part of `viewer.address`. Who opens `viewer.look_address` looks with a camera
            of their own and changes no setting.
        port: the first port to try; 0 takes any free one.
        up: (3,) upward direction, world; default: the particles', for volumes and sweeps z.
        camera: the `Camera` with which every browser starts; default: everything is visible.
        state: settings: the path of a TOML file, or a `globule.viewer.state.State`.
        preset: a name in `globule.render.presets.PRESETS`.
        browser: open the page in a browser of this machine.
        block: wait until Ctrl-C; default: yes in a program, no in an interactive session.
        device, threads: as for `Scene`.
        compare: particles, a mesh or a file to show beside `what`: the left part of the image shows
            `what`, the right part `compare`, with a divider to drag and with one camera.
        demand_token: demand a token on a loopback address, too, as behind a reverse proxy.
        most_clients: number of browsers that are shown images at a time.
        reading: keywords of `read`; for sweeps of `read_sweep`.

    Raises:
        MissingPackageError: the extra `view` is not installed.
        TypeError, ValueError, FormatError, OSError: the message names the data that the viewer
            cannot show.
    """
    from .app import need_websockets
    from .log import log
    from .open import open_source

    need_websockets()
    source = open_source(what, device, threads, **reading)
    if compare is not None:
        from .compare_source import CompareSource

        source = CompareSource(source, open_source(compare, device, threads, **reading))
    more = {"demand_token": demand_token, "most_clients": most_clients}
    viewer = show(source, host, port, up, camera, state, preset, browser, **more)
    for line in viewer.greeting():
        log.info("%s", line)
    if block if block is not None else not hasattr(sys, "ps1") and "ipykernel" not in sys.modules:
        log.info("press Ctrl-C to stop the viewer")
        viewer.wait()
    return viewer


def widget(what: Any, **options: Any) -> Any:
    """The viewer as a notebook widget; see `globule.viewer.notebook.widget`."""
    from .notebook import widget as make

    return make(what, **options)


def show(
    source: Any,
    host: str,
    port: int,
    up: Any,
    camera: Any = None,
    state: Any = None,
    preset: str | None = None,
    browser: bool = True,
    **options: Any,
) -> Viewer:
    """A viewer of a `globule.viewer.source.Source`; arguments as for `view` and `Viewer`."""
    from .app import Viewer
    from .log import show_log
    from .page.look import use_preset
    from .state import State

    show_log()
    settings = state if isinstance(state, State) else State()
    if state is None:
        settings.set(**source.settings)
    elif settings is not state:
        camera = settings.load(state) or camera
    viewer = Viewer(source, settings, host, port, up, camera, **options)
    preset = preset or (source.preset if state is None else None)
    if preset is not None:
        use_preset(viewer, preset)
    if browser:
        viewer.open_browser()
    return viewer
