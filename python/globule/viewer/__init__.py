"""A live viewer in the browser: sources of frames, a pacer for each client, and sinks."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .app import Viewer


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
    **reading: Any,
) -> Viewer:
    """Show something live in the browser.

        gb.view("splash.vtk")
        gb.view(gb.Simulation("dam-break"))
        viewer = gb.view(scene, block=False)        # and go on, e.g. with viewer.on_frame

    Args:
        what: a file or several, `Particles`, positions, a `Scene`, layers, a list of `Particles`,
            a `Volume` (or (volume, sweep)), a `Sweep`, a simulation, its scene's name or .toml.
        host: another than this machine's own demands a token, which is in `viewer.address`.
        port: the first free one from here on.
        up: (3,) direction to the sky; default: y, for volumes and sweeps z.
        camera: where browsers begin.
        state: settings as a TOML file, or a `globule.viewer.state.State`.
        preset: one of `globule.presets.PRESETS`.
        browser: open one.
        block: until Ctrl-C; default: yes in a program, no in an interactive session.
        device, threads: as for `Scene`; reading: as for `read`, or of sweeps `read_sweep`.

    Raises:
        ImportError: without the extra `view`.
        TypeError, ValueError, FormatError, OSError: naming what cannot be shown.
    """
    from .app import need_viser
    from .open import open_source

    need_viser()
    source = open_source(what, device, threads, **reading)
    return show(source, host, port, up, camera, state, preset, browser, block)


def widget(what: Any, **options: Any) -> Any:
    """The viewer as a notebook's widget; see `globule.viewer.notebook.widget`."""
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
    block: bool | None = None,
) -> Viewer:
    """A viewer of a source; see `view`."""
    from .app import Viewer
    from .page.look import use_preset
    from .state import MOST_BYTES, State

    settings = state if isinstance(state, State) else State()
    if state is None:
        settings.set(**source.settings)
    elif settings is not state:
        with Path(state).open(encoding="utf-8") as file:  # `open` is this package's module
            camera = settings.load_toml(file.read(MOST_BYTES + 1)) or camera
    viewer = Viewer(source, settings, host, port, up, camera)
    preset = preset or (source.preset if state is None else None)
    if preset is not None:
        use_preset(viewer, preset)
    for line in viewer.greeting():
        print(line, flush=True)
    if browser:
        viewer.open_browser()
    if block if block is not None else not hasattr(sys, "ps1") and "ipykernel" not in sys.modules:
        viewer.wait()
    return viewer
