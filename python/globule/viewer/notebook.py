"""The viewer inside of a notebook: a widget that shows the server's pictures, without a port of its
own. Needs the extra `notebook`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from .._base.checks import missing
from ..render.camera import Camera
from .app import first_camera
from .engine import Engine
from .open import open_source
from .pacer import Plan
from .recording import Shot
from .source import Source
from .state import State

MOST_PIXELS = 8192  # of a side


def need_anywidget() -> Any:
    """The module anywidget. Raises MissingPackageError."""
    try:
        import anywidget
    except ImportError as error:
        raise missing("anywidget", "notebook") from error
    return anywidget


def widget(
    what: Any,
    height: int = 480,
    up: Any = None,
    camera: Camera | None = None,
    state: State | None = None,
    device: str = "auto",
    threads: int = 0,
    **reading: Any,
) -> Any:
    """A widget that shows something; drag rotates, the wheel zooms, a right drag moves.

        w = widget("splash.vtk")
        w                                             # in a cell
        w.state.set(cuts__plane=True)

    Args:
        what, up, camera, state, device, threads, reading: as for `globule.view`.
        height: pixels; the width is the cell's.
    """
    anywidget = need_anywidget()
    import traitlets

    class GlobuleWidget(anywidget.AnyWidget):
        _esm = Path(__file__).with_name("notebook.js")
        height = traitlets.Int(480).tag(sync=True)
        view = traitlets.Dict().tag(sync=True)

        def screenshot(
            self, path: Any, size: tuple[int, int] = (1280, 720), samples: int = 16
        ) -> None:
            """Write what is seen (.png, .exr)."""
            Shot(self.engine, self.client.camera, size, samples).save(path)

        def close(self) -> None:
            self.engine.close()
            super().close()

    source = what if isinstance(what, Source) else open_source(what, device, threads, **reading)
    made = GlobuleWidget(height=int(height))
    made.source, made.state = source, state or State()
    up = source.up if up is None else tuple(float(v) for v in up)
    with source.lock:
        scene = source.layers(made.state.snapshot())[0].scene
        camera = camera or source.camera or first_camera(scene, up, source.outline())
    made.view = {name: getattr(camera, name) for name in ("eye", "look_at", "up", "fov")}
    made.engine = Engine(source, made.state, up)
    made.client = made.engine.add(_Sink(made), camera)
    made.client.pacer.full = (0, 0)
    made.on_msg(lambda _, content, buffers: _heard(made, content))
    return made


class _Sink:
    """Pictures as messages of the widget."""

    def __init__(self, made: Any):
        self.made = made

    def send(self, number: int, data: bytes, plan: Plan) -> None:
        self.made.send({"type": "picture", "number": number, "still": plan.still}, [data])

    def error(self, message: str) -> None:
        self.made.send({"type": "error", "message": message})


def _heard(made: Any, content: Any) -> None:
    """What the cell says: a picture was taken in, or the camera is another."""
    if content.get("type") == "ack":
        made.client.acknowledge(int(content["number"]))
    elif content.get("type") == "camera":
        size = tuple(int(np.clip(v, 1, MOST_PIXELS)) for v in content["size"])
        try:
            camera = Camera(content["eye"], content["look_at"], content["up"], content["fov"])
        except (TypeError, ValueError) as error:
            made.client.sink.error(str(error))
            return
        made.client.look(camera, size)
