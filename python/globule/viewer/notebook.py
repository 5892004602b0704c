"""The viewer inside a notebook: a widget that needs no port. Needs the extra `notebook`."""

from __future__ import annotations

import base64
from pathlib import Path
from typing import Any

import numpy as np

from .._base.checks import missing
from .._base.terminal import plain_number
from ..render.camera import Camera
from .engine import Engine
from .first_view import first_camera
from .open import open_source
from .overlay import Mark
from .pacer import Plan
from .recording import Shot
from .source import Source
from .state import State

MOST_PIXELS = 8192  # of a side
MOST_SAID = 6  # values of a click
KEPT_WIDTH, KEPT_SAMPLES = 640, 2  # of the image in a saved notebook


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
    """A notebook widget; drag rotates, the wheel zooms, a right drag pans.

        w = widget("splash.vtk")
        w                                             # in a cell
        w.state.set(cuts__plane=True)

    Args:
        what, up, camera, state, device, threads, reading: as for `globule.view`.
        height: pixels; the width is that of the cell.

    Raises:
        MissingPackageError: the extra `notebook` is not installed.
        TypeError, ValueError, FormatError, OSError: the message names what cannot be shown.
    """
    base: Any = need_anywidget().AnyWidget
    import traitlets

    class GlobuleWidget(base):
        _esm = script()
        height = traitlets.Int(480).tag(sync=True)
        view = traitlets.Dict().tag(sync=True)
        names: Any = traitlets.List().tag(sync=True)

        def _repr_mimebundle_(self, **options: Any) -> Any:
            """The widget, and its image, which a saved notebook holds."""
            made = super()._repr_mimebundle_(**options)
            data = made[0] if isinstance(made, tuple) else made
            if data is not None:
                size = (KEPT_WIDTH, max(16, min(KEPT_WIDTH, round(0.75 * self.height))))
                shot = Shot(self.engine, self.client.camera, size, KEPT_SAMPLES)
                data["image/png"] = base64.b64encode(shot.encoded(".png")).decode()
            return made

        def screenshot(self, path: Any, size: tuple[int, int] = (1280, 720), samples: int = 16) -> None:
            """Write the image of the current view (.png, .exr); size: (width, height)."""
            Shot(self.engine, self.client.camera, size, samples).save(path)

        def close(self) -> None:
            """Stop the threads and remove the widget."""
            self.engine.close()
            super().close()

    source = what if isinstance(what, Source) else open_source(what, device, threads, **reading)
    made = GlobuleWidget(height=int(height), names=source.color_names())
    made.source, made.state = source, state or State()
    up = source.up if up is None else tuple(float(v) for v in up)
    with source.lock:
        scene = source.scene(made.state.snapshot())
        first = camera or source.camera
        camera = first or first_camera(scene, up, source.outline(), fov=source.fov)
    made.view = {name: getattr(camera, name) for name in ("eye", "look_at", "up", "fov")}
    made.engine = Engine(source, made.state, up)
    made.client = made.engine.add(_Sink(made), camera)
    made.client.pacer.full = (0, 0)
    made.on_msg(lambda _, content, buffers: _heard(made, content))
    return made


def script() -> str:
    """The JavaScript of the cell."""
    here = Path(__file__).parent
    return "".join(path.read_text("utf-8") for path in (here / "page/camera.js", here / "notebook.js"))


class _Sink:
    """Images as messages of the widget."""

    def __init__(self, made: Any):
        self.made = made

    def send(self, number: int, data: bytes, plan: Plan) -> None:
        self.made.send({"type": "picture", "number": number, "still": plan.still}, [data])

    def error(self, message: str) -> None:
        self.made.send({"type": "error", "message": message})


def _heard(made: Any, content: Any) -> None:
    """A message of the cell: an image has arrived, the camera has changed, a click, a setting."""
    if content.get("type") == "ack":
        made.client.acknowledge(int(content["number"]))
    elif content.get("type") in ("click", "set"):
        try:
            _done(made, content)
        except (TypeError, ValueError) as error:
            made.client.sink.error(str(error))
    elif content.get("type") == "camera":
        size = tuple(int(np.clip(v, 1, MOST_PIXELS)) for v in content["size"])
        try:
            camera = Camera(content["eye"], content["look_at"], content["up"], content["fov"])
        except (TypeError, ValueError) as error:
            made.client.sink.error(str(error))
            return
        made.client.look(camera, size)


def _done(made: Any, content: dict[str, Any]) -> None:
    """What the bar of the cell or a click asks for. Raises ValueError, TypeError."""
    if content["type"] == "set":
        changes: dict[str, Any] = {name: content[name] for name in ("color__by", "cuts__plane") if name in content}
        if changes.get("color__by", "") not in ("", *made.names):
            raise ValueError(f"color: expected one of {', '.join(made.names)}")
        if changes.get("cuts__plane") and made.state.cuts == type(made.state.cuts)():
            with made.source.lock:
                lo, hi = made.source.bounds()
            changes["cuts__point"] = tuple(((lo + hi) / 2).tolist())
        made.state.set(**changes)
        return
    x, y = (float(v) for v in content["place"])
    frame = made.client.frame
    if frame is None or not (0 <= x <= 1 and 0 <= y <= 1):
        return
    column, row = (min(int(share * n), n - 1) for share, n in zip((x, y), frame.size, strict=True))
    with made.source.lock:
        found = frame.pick(column, row)
    if found is None:
        made.client.mark([])
        made.send({"type": "said", "text": "There is no surface here."})
        return
    values = {"position": found.position, **found.attributes}
    by = made.state.color.by
    first = {by: values[by]} if by in values else {}
    words = [
        f"{name} {', '.join(plain_number(v, 5) for v in np.ravel(value))}" for name, value in (first | values).items()
    ]
    px, py, pz = (float(v) for v in found.position)
    made.client.mark([Mark(((px, py, pz),), words[0])])
    made.send({"type": "said", "text": " · ".join(words[:MOST_SAID])})
