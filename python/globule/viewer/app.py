"""The viewer: a server that shows a source to browsers."""

from __future__ import annotations

import contextlib
import io
import secrets
import signal
import socket
import threading
import time
import webbrowser
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from .._base.arrays import on_gpu
from .._base.checks import how_to_install, missing
from ..render.camera import Camera
from ..render.frame import fit_camera
from ..scene.mesh import Mesh
from .engine import Client, Engine
from .equivalent import command_line, python_code
from .guard import Guard, limit_messages, quiet_tasks
from .log import log
from .pacer import Plan
from .placement import Placement
from .recording import Shot
from .source import Source, box_corners
from .state import MOST_BYTES, State

LOCAL = ("127.0.0.1", "localhost", "::1")
FIRST_SIZE = (1280, 720)
MOST_CLIENTS = 16
PAGE_EYE = (3.0, 3.0, 3.0)  # of viser's page before it gets a camera, page units
MOST_WINDOW = 7680  # pixels of a side of a browser's window
AT_INTERRUPT = 1.0  # s that Ctrl-C waits for an image in progress
MOST_POINTS, N_DIRECTIONS = 200_000, 96  # that the first camera is fitted to


class Viewer:
    """A running viewer; `gb.view` makes it.

    Args:
        source: to show.
        state: first settings.
        host: the address to listen on; any but a loopback address demands a token.
        port: the first port to try; 0 takes any free one.
        up: (3,) upward direction, world; default: y, for volumes and sweeps z.
        camera: with which every browser starts; default: everything is visible.
        title: of the page.
        token: that a host other than a loopback address demands; default: a new one.

    Attributes:
        state: the settings; `viewer.state.set(surface__threshold=0.5)`.
        source: what the viewer shows.
        port: that the server listens on.

    Raises:
        MissingPackageError: the extra `view` is not installed.
        ValueError: host or up are not usable.
    """

    def __init__(
        self,
        source: Source,
        state: State | None = None,
        host: str = "127.0.0.1",
        port: int = 8080,
        up: Any = None,
        camera: Camera | None = None,
        title: str | None = None,
        token: str | None = None,
    ):
        viser = need_viser()
        self.source, self.state = source, state or State()
        self.up = tuple(float(v) for v in (source.up if up is None else up))
        if not any(self.up):
            raise ValueError(f"up: expected a direction, got {up!r}")
        check_host(host)
        self.title = title or source.name
        with source.lock:
            self.placement = Placement(*source.bounds())
            scene = source.layers(self.state.snapshot())[0].scene
            self.warnings = left_out(scene)
            around = source.outline()
            self._outline = outermost(source) if around is None else around
        self._camera_given = camera is not None
        self.first_camera = camera or first_camera(scene, self.up, around, source.camera)
        self._asked_port = port
        self.token = None if host in LOCAL else token or secrets.token_urlsafe(24)
        self._guard = Guard(self.token, f"{self.title} · globule")
        self._frame_callbacks: list[Callable[[Any], Any]] = []
        self._closed = threading.Event()
        self._met = False  # a browser has connected
        self.clients: dict[int, Client] = {}
        self.engine = Engine(source, self.state, self.up)
        self.engine.on_picture = self._on_picture
        self.engine.on_error = self._on_error
        self.engine.on_step = self._keep_in_sight
        with contextlib.redirect_stdout(io.StringIO()):
            self.server = self._guard.server(host, port)
        if not self._guard.started:
            self.close()
            raise RuntimeError(
                f"viewer: viser {viser.__version__} opens its server in an unknown way. Install "
                f"the version that globule needs: {how_to_install('view')}"
            )
        limit_messages(self.server, MOST_BYTES)
        quiet_tasks(self.server)
        self.host, self.port = host, self.server.get_port()
        from .page import Page

        self.page = Page(self)
        self._guard.desk = self.page.desk
        self.server.on_client_connect(self._connected)
        self.server.on_client_disconnect(self._disconnected)

    @property
    def gui(self) -> Any:
        """The panel of the page (`viser.GuiApi`), for sliders and buttons of the program."""
        return self.server.gui

    @property
    def address(self) -> str:
        """The address to open in a browser, with the token if the server demands a token."""
        host = "127.0.0.1" if self.host in LOCAL else socket.gethostname()
        return f"http://{host}:{self.port}/" + (f"?token={self.token}" if self.token else "")

    def greeting(self) -> list[str]:
        """Lines for a person in the terminal: the address, and how to reach it from elsewhere."""
        lines = [*self.warnings, f"{self.source.name} at {self.address}"]
        if self._asked_port and self.port != self._asked_port:
            lines.append(f"port {self._asked_port} is in use; the viewer uses {self.port}")
        if self.token is None:
            lines.append(
                f"from another machine: run ssh -L {self.port}:localhost:{self.port} "
                f"{socket.gethostname()} there, then open the same address"
            )
        else:
            lines.append(
                "everyone who has this address can see and control the page; the connection is "
                "not encrypted, so use ssh on networks that you do not trust"
            )
        return lines

    def open_browser(self) -> None:
        """Open the page in a browser of this machine."""
        threading.Thread(target=webbrowser.open, args=(self.address,), daemon=True).start()

    # Clients

    async def _connected(self, browser: Any) -> None:
        try:
            await self._welcome(browser)
        except Exception as error:  # viser would print a traceback
            self.page.complain(browser, str(error) or type(error).__name__)

    async def _welcome(self, browser: Any) -> None:
        from .viser_sink import ViserSink

        if len(self.clients) >= MOST_CLIENTS:
            browser.add_notification(
                "Not possible", f"At most {MOST_CLIENTS} browsers can be open", color="red"
            )
            return
        if not self._met:  # what a person can undo begins here
            self._met = True
            self.state.history.clear()
        sink = ViserSink(browser, lambda number: client.acknowledge(number))
        client = self.engine.add(sink, self.first_camera)
        self.clients[browser.client_id] = client

        first: dict[str, Any] = {} if self._camera_given else {"aspect": 1e-9}

        async def moved(camera: Any) -> None:
            try:
                size = (
                    min(int(camera.image_width), MOST_WINDOW),
                    min(int(camera.image_height), MOST_WINDOW),
                )
                if first and min(size) > 0:
                    self._fit_window(browser, first, size[0] / size[1])
                client.look(self.camera_of(camera), size)
            except (OverflowError, ValueError) as error:  # a value that the page never sends
                self.page.complain(browser, str(error))

        await moved(browser.camera)
        browser.camera.on_update(moved)
        self.page.connected(browser, client)

    def _fit_window(self, browser: Any, first: dict[str, Any], aspect: float) -> None:
        """Fit the first view to the shape of the window, unless the person has moved the camera.

        The panel takes its part of the window after the start, which changes the shape. Meanwhile
        the browser may report its own first camera, or go back to the page's start camera.
        """
        eye, start = self.camera_of(browser.camera).eye, self.first_camera.eye
        known = first.setdefault("eyes", [eye, self.placement.to_world(PAGE_EYE), start])
        near = 1e-3 * self.placement.extent
        if np.linalg.norm(np.subtract(known, eye), axis=1).min() > near:
            first.clear()
            return
        to_start, to_last = (np.linalg.norm(np.subtract(eye, v)) for v in (start, known[-1]))
        back = to_start <= near < to_last
        if not back and abs(aspect / first["aspect"] - 1) <= 0.01:
            return
        camera = for_window(self.first_camera, aspect, self._outline)
        # The next message of the browser may be older than this move.
        first.update(aspect=aspect, eyes=[*known, camera.eye])
        self.move(browser, camera)

    async def _disconnected(self, browser: Any) -> None:
        client = self.clients.pop(browser.client_id, None)
        self.page.disconnected(browser)
        if client is not None:
            threading.Thread(target=self.engine.remove, args=(client,), daemon=True).start()

    def camera_of(self, camera: Any) -> Camera:
        """The camera, world, of a browser's camera."""
        return self.placement.camera(
            camera.position, camera.look_at, camera.up_direction, camera.fov
        )

    def move(self, browser: Any, camera: Camera) -> None:
        """Move a browser's camera; `camera`: world."""
        position, look_at, fov = self.placement.of_page(camera)
        with browser.atomic():
            browser.camera.up_direction = camera.up
            browser.camera.position, browser.camera.look_at = position, look_at
            browser.camera.fov = fov

    # The user's program

    def on_frame(self, called: Callable[[Any], Any]) -> Callable[[Any], Any]:
        """Call a function with each image before it is shown; usable as a decorator.

        Args:
            called: gets a `ShownFrame`; returns the image to show instead, (H, W, 3) uint8, or
                None.
        """
        self._frame_callbacks.append(called)
        return called

    def _on_picture(
        self, client: Client, number: int, picture: np.ndarray, plan: Plan
    ) -> np.ndarray:
        for called in self._frame_callbacks:
            changed = called(ShownFrame(number, picture, client.camera, plan.still, self))
            if changed is not None:
                picture = np.asarray(changed, np.uint8)
        return picture

    def _on_error(self, message: str) -> None:
        log.warning("%s", message)
        for client in list(self.clients.values()):
            client.sink.error(message)

    def _keep_in_sight(self) -> None:
        """Follow a source whose place and size become known only while it grows."""
        if not self.source.grows:
            return
        with self.source.lock:
            lo, hi = self.source.bounds()
        moved = self.placement.left_by(lo, hi)
        if moved:
            self.placement.put(lo, hi)
        for panel in self.page.panels:
            panel.grew(moved)

    def cut_along(self, points: list, camera: Camera) -> str:
        """Cut along a stroke of the tool Cut; returns a sentence for the page.

        The stroke cuts tissue. Without tissue it sets a cutting plane through the stroke and the
        eye, which removes the side above or right of the stroke.

        Args:
            points: (x, y, z) each, world, on the surface.
            camera: through which the stroke was drawn.

        Raises:
            ValueError: the stroke is a single point.
        """
        if self.source.has_tissue:
            return self.source.cut_along(points, camera)
        first, last = (np.asarray(p, float) for p in (points[0], points[-1]))
        normal = np.cross(last - first, camera.towards([first])[0])
        if not np.linalg.norm(normal) > 0:
            raise ValueError("cut: expected a stroke between two points, got one point")
        _, _, right, up = camera.frame((1, 1))
        normal = normal / np.linalg.norm(normal)
        normal = normal if normal @ (right + up) > 0 else -normal
        self.state.set(
            cuts__plane=True,
            cuts__normal=tuple(normal.tolist()),
            cuts__point=tuple(((first + last) / 2).tolist()),
        )
        return "Added a cutting plane along the stroke. *Remove all cuts* in *Cut* removes it."

    def screenshot(
        self,
        path: Any,
        size: tuple[int, int] = FIRST_SIZE,
        samples: int | None = None,
        camera: Camera | None = None,
    ) -> Shot:
        """Write the image to a file (.png, .exr).

        Args:
            path: of the file.
            size: (width, height), pixels.
            samples: per pixel; default: the setting for still images.
            camera: world; default: the first camera of a browser.

        Returns:
            The image with its traced frame.
        """
        shot = Shot(
            self.engine, camera or self.first_camera, size, samples or self.state.quality.samples
        )
        shot.save(path)
        return shot

    def equivalent(
        self, camera: Camera | None = None, size: tuple[int, int] = FIRST_SIZE
    ) -> tuple[str, str]:
        """A command and a Python program that make the same image.

        Args:
            camera: world; default: the one with which browsers start.
            size: (width, height), pixels.
        """
        state, camera = self.state.snapshot(), camera or self.first_camera
        with self.source.lock:
            return (
                command_line(self.source, state, camera, size, self.up),
                python_code(self.source, state, camera, size, self.up),
            )

    def save_state(self, path: Any) -> None:
        """Write all settings and the first camera to a TOML file."""
        self.state.save(path, self.first_camera)

    def load_state(self, path: Any) -> None:
        """Take all settings and the first camera from a TOML file.

        Raises:
            ValueError: the message names the key; nothing is changed.
        """
        camera = self.state.load(path)
        if camera is not None:
            self.first_camera = camera

    def refresh(self) -> None:
        """Show the source again after the program has changed it."""
        self.source.version += 1
        self.engine.notify()

    def wait(self) -> None:
        """Wait until Ctrl-C or `close`; a second Ctrl-C does not wait for threads to end."""
        with first_interrupt() as asked:
            try:
                while not asked and not self._closed.wait(0.2):
                    pass
            finally:
                self.close(AT_INTERRUPT)
            if asked:
                raise KeyboardInterrupt

    def close(self, seconds: float = 10.0) -> None:
        """Keep recordings in progress, stop the threads, tell the browsers, free the port.

        Args:
            seconds: that an image or a step in progress may still take.
        """
        if self._closed.is_set():
            return
        self._closed.set()
        if hasattr(self, "page"):
            for panel in self.page.panels:
                panel.close()
            self.page.desk.close()
        self.engine.close(seconds)
        if hasattr(self, "server"):
            with contextlib.redirect_stdout(io.StringIO()):
                self.server.stop()
                self.server._thread_executor.shutdown(wait=False)

    def __enter__(self) -> Viewer:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


class ShownFrame:
    """An image on its way to a browser.

    Attributes:
        number: counts a browser's images from 1.
        picture: (H, W, 3) uint8 sRGB.
        camera: world.
        still: nothing has changed for a moment.
        viewer: that made it.
        time: s, of the system's clock.
    """

    def __init__(
        self, number: int, picture: np.ndarray, camera: Camera, still: bool, viewer: Viewer
    ):
        self.number, self.picture, self.camera, self.still = number, picture, camera, still
        self.viewer, self.time = viewer, time.time()


@contextlib.contextmanager
def first_interrupt() -> Iterator[list[int]]:
    """A block in which the first Ctrl-C is only noted in the list it yields; the second raises."""
    asked: list[int] = []

    def note(number: int, _: Any) -> None:
        if asked:
            raise KeyboardInterrupt
        asked.append(number)

    before = signal.getsignal(signal.SIGINT)
    usual = before is signal.default_int_handler  # no handler of the program
    if not usual or threading.current_thread() is not threading.main_thread():
        yield asked
        return
    signal.signal(signal.SIGINT, note)
    try:
        yield asked
    finally:
        signal.signal(signal.SIGINT, before)


def check_host(host: str) -> None:
    """Raise ValueError for an address of another machine, where viser would wait forever."""
    try:
        family, kind, *_, address = socket.getaddrinfo(host, 0, type=socket.SOCK_STREAM)[0]
        with socket.socket(family, kind) as tried:
            tried.bind(address)
    except OSError as error:
        raise ValueError(
            f"host: expected an address of this machine, got {host!r}: {error.strerror}"
        ) from None


def outermost(source: Source) -> np.ndarray:
    """The outermost particles (M, 3) in many directions, with some room for the surface.

    For particles on a GPU: the corners of their box.
    """
    lo, hi = source.bounds()
    particles = source.particles()
    if on_gpu(particles.positions) or not len(particles.finite_positions()):
        return box_corners(lo, hi)
    points = particles.finite_positions()
    points = points[:: 1 + len(points) // MOST_POINTS] - (lo + hi) / 2
    i = np.arange(N_DIRECTIONS) + 0.5
    height, turn = 1 - 2 * i / N_DIRECTIONS, np.pi * (1 + 5**0.5) * i  # evenly over a sphere
    flat = np.sqrt(1 - height**2)
    directions = np.stack([flat * np.cos(turn), flat * np.sin(turn), height], axis=1)
    far = [int(np.argmax(points @ towards)) for towards in directions]
    return 1.06 * points[np.unique(far)] + (lo + hi) / 2


def left_out(scene: Any) -> list[str]:
    """Warnings about particles that cannot be shown."""
    if isinstance(scene, Mesh):
        return []
    n_lost = len(scene) - scene.octree.n_inside
    if not n_lost:
        return []
    return [
        f"{n_lost:,} of {len(scene):,} particles {'is' if n_lost == 1 else 'are'} not shown: "
        "expected finite positions below 1e18, got others"
    ]


def first_camera(scene: Any, up: Any, around: Any, like: Camera | None = None) -> Camera:
    """A camera that shows everything.

    Args:
        scene: to show.
        up: (3,) upward direction, world.
        around: (M, 3) points to show; None: the particles with their surface.
        like: a camera that gives direction and field of view; default: from the front, a little
            right and above.
    """
    from ..render.camera import view_axes

    if around is None and scene.octree.n_inside == 0:
        return Camera((1.2, 0.9, 2.0), (0, 0, 0), up)
    right, above, front = view_axes(up)
    towards, fov = 0.6 * right + 0.45 * above + front, 40.0
    if like is not None:
        towards, fov = np.subtract(like.eye, like.look_at), like.fov
    return fit_camera(scene, FIRST_SIZE, around, direction=towards, up=up, fov=fov)


def for_window(camera: Camera, aspect: float, around: np.ndarray | None = None) -> Camera:
    """The first camera for a window of another shape.

    Args:
        camera: for a window of `FIRST_SIZE`.
        aspect: width / height of the window.
        around: (M, 3) points to show.

    Returns:
        The nearer of two cameras: fitted to the points, or moved away for a narrow window.
    """
    aside = narrower(camera, aspect)
    if around is None or camera.height is not None:
        return aside
    towards, size = np.subtract(camera.eye, camera.look_at), (round(1000 * max(aspect, 0.1)), 1000)
    fitted = Camera.fit(around, towards, camera.up, camera.fov, size)
    distances = [np.linalg.norm(np.subtract(c.eye, c.look_at)) for c in (aside, fitted)]
    return aside if distances[0] < distances[1] else fitted


def narrower(camera: Camera, aspect: float) -> Camera:
    """A camera, moved away as far as a window narrower than FIRST_SIZE needs."""
    back = max(1.0, FIRST_SIZE[0] / FIRST_SIZE[1] / max(aspect, 0.1))
    away = np.subtract(camera.eye, camera.look_at) * back
    eye = tuple((np.asarray(camera.look_at) + away).tolist())
    height = None if camera.height is None else camera.height * back
    return Camera(eye, camera.look_at, camera.up, camera.fov, height)


def need_viser() -> Any:
    """The module viser. Raises MissingPackageError."""
    try:
        import viser
    except ImportError as error:
        raise missing("viser", "view") from error
    return viser
