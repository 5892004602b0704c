"""The viewer: a server that shows a source to browsers."""

from __future__ import annotations

import contextlib
import html
import secrets
import signal
import socket
import threading
import time
import webbrowser
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from .._base.checks import missing
from .._base.terminal import escaped
from ..render.camera import Camera
from .desk import PATH, DeskSink
from .engine import Client, Engine
from .equivalent import command_line, python_code
from .export import notebook
from .first_view import FIRST_SIZE, first_camera, for_window, left_out, outermost
from .guard import LOCAL, LOOK_PATH, Guard
from .log import log
from .pacer import Plan
from .recording import Shot
from .roles import LOOK, MOST_CLIENTS, STEER
from .room import Room
from .source import Source
from .state import GROUPS, State

GROWTH = 0.25  # of the scene's longest side; beyond it the cameras are fitted again
ANSWERS = 5.0  # s in which a browser that is there answers
AT_INTERRUPT = 1.0  # s that Ctrl-C waits for an image in progress


class Viewer:
    """A running viewer; `gb.view` makes it.

    Args:
        source: to show.
        state: first settings.
        host: the address to listen on; any but a loopback address demands a token.
        port: the first port to try; 0 takes any free one.
        up: (3,) upward direction, world; default: the particles', for volumes and sweeps z.
        camera: with which every browser starts; default: everything is visible.
        title: of the page.
        token: with which browsers steer, where a token is demanded; default: a new one.
        demand_token: demand tokens on a loopback address, too, as behind a reverse proxy.
        most_clients: number of browsers that are shown images at a time.

    Attributes:
        state: the settings; `viewer.surface.threshold = 0.5` is short for
            `viewer.state.surface.threshold = 0.5`.
        source: what the viewer shows.
        port: that the server listens on.
        most_clients: number of browsers that are shown images at a time.

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
        demand_token: bool = False,
        most_clients: int = MOST_CLIENTS,
    ):
        need_websockets()
        if most_clients < 1:
            raise ValueError(f"most_clients: expected 1 or more, got {most_clients}")
        self.source, self.state = source, state or State()
        self.up = tuple(float(v) for v in (source.up if up is None else up))
        if not any(self.up):
            raise ValueError(f"up: expected a direction, got {up!r}")
        check_host(host)
        self.title = title or source.name
        with source.lock:
            self._box = source.bounds()
            scene = source.scene(self.state.snapshot())
            self.warnings = left_out(scene)
            around = source.outline()
            self._outline = outermost(source, scene) if around is None else around
        self._camera_given = camera is not None
        self.first_camera = camera or first_camera(scene, self.up, around, source.camera, source.fov)
        self._asked_port = port
        self.token = self.look_token = None
        if host not in LOCAL or demand_token:
            self.token = token or secrets.token_urlsafe(24)
            self.look_token = secrets.token_urlsafe(24)
        self.most_clients = most_clients
        self._frame_callbacks: list[Callable[[Any], Any]] = []
        self._closed = threading.Event()
        self._met = False  # a browser has connected
        self.on_open: Callable[[], Any] | None = None  # shows the start page instead
        self.clients: dict[int, Client] = {}
        self.engine = Engine(source, self.state, self.up)
        self.engine.on_picture = self._on_picture
        self.engine.on_error = self._on_error
        self.engine.on_step = self._keep_in_sight
        from .page import Page
        from .server import Server, page_file

        self.page = Page(self)
        name = html.escape(f"{self.title} · globule").encode()
        shown, guard = page_file("viewer.html").replace(b"TITLE", name), Guard(self.token, self.look_token)
        try:
            self.server = Server(guard, shown, PATH, self.page.desk.serve, host, port)
        except OSError:
            self.close()
            raise
        self.host, self.port = host, self.server.port

    def __getattr__(self, name: str) -> Any:
        """The groups of settings: `viewer.surface.threshold = 0.5`."""
        if name in GROUPS:
            return getattr(self.state, name)
        raise AttributeError(f"{type(self).__name__!r} object has no attribute {name!r}")

    @property
    def gui(self) -> Any:
        """The inspector (`globule.viewer.gui.Gui`), for sliders and buttons of the program."""
        return self.page.gui

    @property
    def address(self) -> str:
        """The address to open in a browser, with the token if the server demands a token."""
        return self._address(self.token)

    @property
    def look_address(self) -> str | None:
        """The address for people who look with cameras of their own; None without tokens."""
        return self._address(self.look_token, LOOK_PATH) if self.look_token else None

    def _address(self, token: str | None, path: str = "") -> str:
        host = "127.0.0.1" if self.host in LOCAL else socket.gethostname()
        return f"http://{host}:{self.port}{path}/" + (f"?token={token}" if token else "")

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
            lines.append(f"to look without steering: {self.look_address}")
            lines.append(
                "everyone who has an address can open the page; the connection is not encrypted, "
                "so use ssh or a reverse proxy with TLS on networks that you do not trust"
            )
        return lines

    def open_browser(self) -> None:
        """Open the page in a browser of this machine."""
        threading.Thread(target=webbrowser.open, args=(self.address,), daemon=True).start()

    # Clients

    async def welcome(self, browser: Any, size: tuple[int, int], dark: bool, camera: Camera | None, tool: str) -> bool:
        """Show the viewer to a browser, if there is a place for it.

        Args:
            browser: `globule.viewer.desk.Browser`.
            size: of its window, pixels.
            dark: whether its page is.
            camera, tool: that it had before a reload; None and "" for a new one.
        """
        if self._is_full(browser.role):
            from .server import silent

            known = {number: one.connection for number, one in self.page.desk.browsers.items()}
            for number in await silent(known, ANSWERS):
                self.left(self.page.desk.browsers[number])
        if self._is_full(browser.role):
            words = f"This viewer serves at most {self.most_clients} browsers, and all places are taken."
            browser.box.append({"full": f"{words} Reload this page when another one is closed."})
            return False
        if not self._met:  # what a person can undo begins here
            self._met = True
            self.state.history.clear()
        client = self.engine.add(DeskSink(self.page.desk, browser), camera or self.first_camera, size)
        client.role, client.dark, client.first = browser.role, dark, camera is None and not self._camera_given
        self.clients[browser.client_id] = client
        self.page.connected(browser, client, tool)
        self.resize(browser, size)
        return True

    def _is_full(self, role: str) -> bool:
        """Whether there is no place for one more; the last one is kept for a person who steers."""
        steered = any(client.role == STEER for client in self.clients.values())
        kept = role == LOOK and not steered and self.most_clients > 1
        return len(self.clients) + kept >= self.most_clients

    def look(self, browser: Any, camera: Camera) -> None:
        """A person has moved a browser's camera."""
        client = self.clients[browser.client_id]
        client.first = False
        client.look(self._in_front(camera), client.pacer.full)

    def move(self, browser: Any, camera: Camera, first: bool = False) -> None:
        """Move a browser's camera; first: it is still the first view, which follows the window."""
        client, camera = self.clients[browser.client_id], self._in_front(camera)
        client.first = first
        self.page.desk.move(browser, camera)
        client.look(camera, client.pacer.full)

    def _in_front(self, camera: Camera) -> Camera:
        """An orthographic camera with its eye in front of everything; another one as it is."""
        if camera.height is None:
            return camera
        away = np.subtract(camera.eye, camera.look_at)
        far = 1.5 * self.extent + float(np.linalg.norm(camera.look_at - self.middle))
        eye = camera.look_at + away * (far / np.linalg.norm(away))
        return Camera(eye, camera.look_at, camera.up, camera.fov, camera.height)

    @property
    def middle(self) -> np.ndarray:
        """The middle (3,) of the scene's box, world."""
        return np.add(*self._box) / 2

    @property
    def extent(self) -> float:
        """The longest side of the scene's box, world units."""
        return float(np.max(np.subtract(self._box[1], self._box[0]))) or 1.0

    def resize(self, browser: Any, size: tuple[int, int]) -> None:
        """A browser's window has another size, pixels; its first view is fitted to it."""
        client = self.clients[browser.client_id]
        client.look(client.camera, size)
        if client.first:
            self.reset(browser)
        elif not browser.moves:
            self.move(browser, client.camera)

    def reset(self, browser: Any) -> None:
        """Show a browser the first view again, which follows its window."""
        client = self.clients[browser.client_id]
        width, height = client.pacer.full
        self.move(browser, self._fitted(client, width / height), first=True)

    def _fitted(self, client: Client, aspect: float) -> Camera:
        """The first camera for a window with bars."""
        size = (round(1000 * aspect), 1000)
        width, height = client.room.free(size)
        return client.room.seated(for_window(self.first_camera, width / height, self._outline), size)

    def give_room(self, browser: Any, value: Any) -> None:
        """A browser says which shares of its window bars cover: left, top, right, bottom."""
        if not (isinstance(value, list) and len(value) == 4 and all(type(v) in (int, float) for v in value)):
            raise ValueError(f"page: expected four shares, got {str(value)[:40]}")
        client = self.clients[browser.client_id]
        room = Room(*(float(np.clip(np.nan_to_num(v), 0, 1)) for v in value))
        if room != client.room:
            client.room = room
            self.resize(browser, client.pacer.full)

    def begin_plane(self, browser: Any) -> None:
        """Put a cutting plane that nobody has set yet where something of what is seen stays."""
        for panel in self.page.panels:
            if hasattr(panel, "begin_plane"):
                panel.begin_plane(browser)

    def open_another(self) -> None:
        """Show the start page instead, where a person chooses what to open."""
        assert self.on_open is not None  # as the page offers it
        self.on_open()

    def left(self, browser: Any) -> None:
        """Free the place of a browser that has left."""
        client = self.clients.pop(browser.client_id, None)
        if client is not None:
            threading.Thread(target=self.engine.remove, args=(client,), daemon=True).start()
            self.page.disconnected(browser, client)

    # The user's program

    def on_frame(self, called: Callable[[Any], Any]) -> Callable[[Any], Any]:
        """Call a function with each image before it is shown; usable as a decorator.

        Args:
            called: gets a `ShownFrame`; returns the image to show instead, (H, W, 3) uint8, or
                None.
        """
        self._frame_callbacks.append(called)
        return called

    def _on_picture(self, client: Client, number: int, picture: np.ndarray, plan: Plan) -> np.ndarray:
        for called in self._frame_callbacks:
            changed = called(ShownFrame(number, picture, client.camera, plan.still, self))
            if changed is not None:
                picture = np.asarray(changed, np.uint8)
        return picture

    def _on_error(self, message: str) -> None:
        log.warning("%s", escaped(message))
        for client in list(self.clients.values()):
            client.sink.error(message)

    def _keep_in_sight(self) -> None:
        """Follow a source whose place and size become known only while it grows."""
        if not self.source.grows:
            return
        with self.source.lock:
            lo, hi = self.source.bounds()
        moved = bool(np.max([self._box[0] - lo, hi - self._box[1]]) > GROWTH * self.extent)
        if moved:
            self._box = lo, hi
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
            said = self.source.cut_along(points, camera)
            self.source.note_settings(self.state.history.lengths[0])
            return said
        first, last = (np.asarray(p, float) for p in (points[0], points[-1]))
        normal = np.cross(last - first, camera.towards([first])[0])
        if not np.linalg.norm(normal) > 0:
            raise ValueError("cut: expected a stroke between two points, got one point")
        _, _, right, up = camera.frame((1, 1))
        normal = normal / np.linalg.norm(normal)
        normal = normal if normal @ (right + up) > 0 else -normal
        self.state.set(
            cuts__plane=True, cuts__normal=tuple(normal.tolist()), cuts__point=tuple(((first + last) / 2).tolist())
        )
        return "Added a cutting plane along the stroke. *Plane* in the toolbar removes it."

    def screenshot(
        self, path: Any, size: tuple[int, int] = FIRST_SIZE, samples: int | None = None, camera: Camera | None = None
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
        shot = Shot(self.engine, camera or self.first_camera, size, samples or self.state.quality.samples)
        shot.save(path)
        return shot

    def equivalent(self, camera: Camera | None = None, size: tuple[int, int] = FIRST_SIZE) -> tuple[str, str]:
        """A command and a Python program that make the same image.

        Args:
            camera: world; default: the one with which browsers start.
            size: (width, height), pixels.
        """
        state, camera = self.state.snapshot(), camera or self.first_camera
        with self.source.lock:
            self.source.scene(state)
            if self.source.maker.beyond and state.color.by and state.color.automatic:
                low, high = self.source.maker.range
                state.color = replace(state.color, automatic=False, low=low, high=high)
            return (
                command_line(self.source, state, camera, size, self.up),
                python_code(self.source, state, camera, size, self.up),
            )

    def notebook(self, camera: Camera | None = None, size: tuple[int, int] = FIRST_SIZE) -> str:
        """The text of a Jupyter notebook that makes the same image; arguments: `equivalent`."""
        return notebook(self.title, *self.equivalent(camera, size))

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
            self.server.close()

    def __enter__(self) -> Viewer:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


@dataclass
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

    number: int
    picture: np.ndarray
    camera: Camera
    still: bool
    viewer: Viewer
    time: float = field(default_factory=time.time)


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
    """Raise ValueError for an address of another machine, so that the message names it."""
    try:
        family, kind, *_, address = socket.getaddrinfo(host, 0, type=socket.SOCK_STREAM)[0]
        with socket.socket(family, kind) as tried:
            tried.bind(address)
    except OSError as error:
        raise ValueError(f"host: expected an address of this machine, got {host!r}: {error.strerror}") from None


def need_websockets() -> None:
    """Raise MissingPackageError where the viewer's packages are not installed."""
    try:
        import websockets  # noqa: F401
    except ImportError as error:
        raise missing("websockets", "view") from error
