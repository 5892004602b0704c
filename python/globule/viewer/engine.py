"""The threads of a viewer.

One thread traces for all clients in turn. One thread per client encodes and sends. One thread
advances the source in time. No client delays another client or the time.
"""

from __future__ import annotations

import atexit
import threading
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any, Protocol

import numpy as np

from ..render.camera import Camera
from ..render.frame import Frame
from .compare_source import Split
from .encode import jpeg
from .log import Repeats
from .overlay import Mark, finish
from .pacer import Pacer, Plan, limited
from .picture import in_the_dark, trace
from .plots import along_line, drawn_over, measured_line, outline_of_plane
from .roles import AT_ONCE, STEER, Allowance
from .room import Room
from .source import Source
from .state import State

REPEAT = 5.0  # s before the same error is reported again
AGAIN = 0.005  # s between two requests to stop an image
RESTART = 0.5  # s before a thread that failed begins again


class Sink(Protocol):
    """The receiver of a client's images; calls `Client.acknowledge` when an image has arrived."""

    def send(self, number: int, data: bytes, plan: Plan) -> None:
        """Send one JPEG. Raises ConnectionError if the receiver has left."""

    def error(self, message: str) -> None:
        """Show an error to the person."""


class Client:
    """A person who looks at the source, with a separate camera; `Engine.add` makes it."""

    def __init__(self, engine: Engine, sink: Sink, camera: Camera):
        self.engine, self.sink, self.camera = engine, sink, camera
        self.pacer = Pacer()
        self.room = Room()  # of its window that no bar covers
        self.first = False  # its camera is still the first one, which follows the window
        self.since: float | None = None  # when the image began that is made now
        self.frame: Frame | Split | None = None  # the last traced; only the tracing thread changes it
        self.frame_version: Any = None
        self.number = 0
        self.dark = False  # its page is dark
        self.shown: tuple[tuple, np.ndarray] | None = None  # the sharp image on its page, and of what
        self.role = STEER
        self.complaints = Allowance(10, 2.0)  # of its own mistakes
        self.turns = threading.Semaphore(AT_ONCE)  # if it looks
        self.marks: list[Mark] = []  # drawn over this client's images only
        self.line: np.ndarray | None = None  # (2, 3) ends of its own measurement, world
        self.profile: dict[str, Any] | None = None  # values along the measured line
        self._job: tuple | None = None
        self._ready = threading.Condition()
        self._gone = False
        self._thread = threading.Thread(target=self._deliver, name="globule encode", daemon=True)
        self._thread.start()

    def look(self, camera: Camera, size: tuple[int, int]) -> None:
        """Use another camera and window size (width, height) from now on."""
        with self.engine.wake:
            before, self.camera = self.camera, camera
            self.pacer.full = (max(1, int(size[0])), max(1, int(size[1])))
            if camera != before:
                self.engine.interrupt(self)
            self.engine.wake.notify_all()

    def mark(self, marks: list[Mark]) -> None:
        """Draw these marks over the client's images from now on."""
        with self.engine.wake:
            self.marks = marks
            self.engine.wake.notify_all()

    def acknowledge(self, number: int) -> None:
        """Note that an image has arrived."""
        with self.engine.wake:
            self.pacer.acknowledge(self.engine.clock(), number)
            self.engine.wake.notify_all()

    def sharp(self) -> np.ndarray | None:
        """The image (H, W, 3) uint8 sRGB on the client's page, if it is sharp and of what is set."""
        shown, key = self.shown, (self.engine._what(self), self.engine._over(self))
        return shown[1] if shown is not None and shown[0] == key else None

    def darken(self, dark: bool) -> None:
        """Show the scene on a dark background, or on the usual one."""
        with self.engine.wake:
            self.dark = dark
            self.engine.interrupt(self)
            self.engine.wake.notify_all()

    def hand(self, job: tuple) -> None:
        """Give a traced image to the encoding thread."""
        with self._ready:
            self._job = job
            self._ready.notify()

    def close(self, seconds: float = 5.0) -> None:
        """Stop the encoding thread; wait for it at most so long."""
        with self._ready:
            self._gone = True
            self._ready.notify()
        if threading.current_thread() is not self._thread:
            self._thread.join(timeout=seconds)
        self.frame = None

    def _deliver(self) -> None:
        while True:
            with self._ready:
                while self._job is None and not self._gone:
                    self._ready.wait()
                if self._gone:
                    return
                job, self._job = self._job, None
                assert job is not None  # as the loop has ended
            try:
                self._send(*job)
            except ConnectionError:  # the owner of the sink removes the client
                return
            except Exception as error:  # a later image may succeed
                with self.engine.wake:
                    self.pacer.given_up()
                self.engine.report(error)

    def _send(self, plan: Plan, seen: float, picture: np.ndarray, more: dict[str, Any], key: tuple) -> None:
        started = self.engine.clock()
        seen_at = limited(self.pacer.full, more["state"].quality.width)
        picture = finish(picture, size=seen_at, **more)
        with self.engine.wake:
            self.number += 1
            number = self.number
        if self.engine.on_picture is not None:
            picture = self.engine.on_picture(self, number, picture, plan)
        self.shown = (key, picture) if plan.still else None
        data = jpeg(picture, plan.quality, sharp=plan.still)
        with self.engine.wake:
            now = self.engine.clock()
            self.engine.encode_seconds = now - started
            self.pacer.sent(now, number, seen, len(data), plan.still)
            self.engine.wake.notify_all()
        self.sink.send(number, data, plan)


class Engine:
    """Everything between a source with its settings and the sinks of the clients.

    Args:
        source: traced and advanced.
        state: settings.
        up: (3,) upward direction, world.
        clock: gives the time, s.
        sleep: waits for some seconds.

    Attributes:
        on_picture: called in a client's encoding thread with each finished image; returns the image
            to show.
        on_step: called after each step in time.
        on_error: called with each error message.
        trace_seconds, encode_seconds, step_seconds: the latest durations.
    """

    def __init__(
        self,
        source: Source,
        state: State,
        up: Any = (0.0, 1.0, 0.0),
        clock: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], None] = time.sleep,
    ):
        self.source, self.state, self.up = source, state, up
        self.clock, self.sleep = clock, sleep
        self.clients: list[Client] = []
        self.on_picture: Callable[[Client, int, np.ndarray, Plan], np.ndarray] | None = None
        self.on_step: Callable[[], None] | None = None
        self.on_error: Callable[[str], None] = lambda message: None
        self.wake = threading.Condition()
        self.trace_seconds = self.encode_seconds = self.step_seconds = 0.0
        self._repeats = Repeats(REPEAT, clock)
        self._turn = 0
        self._running = True
        self._still: tuple[Client, Any] | None = None  # whose still image; its scene
        self._gains = False  # it only adds samples
        self._stopping: tuple[Client, Any] | None = None  # the still image that is to stop
        self._threads = [
            threading.Thread(target=self._keep_up, args=(work,), name=f"globule {name}", daemon=True)
            for name, work in (("trace", self._trace), ("time", self._time))
        ]
        state.listen(lambda changed: self.interrupt())
        for thread in self._threads:
            thread.start()
        atexit.register(self.close)  # threads must not be inside a kernel when Python ends

    def notify(self) -> None:
        """Wake the threads: the settings or the source have changed."""
        with self.wake:
            self.wake.notify_all()

    def interrupt(self, client: Client | None = None) -> None:
        """Stop a still image in progress, since something has changed or a person waits.

        The image begins again where it is still wanted. Images of a moving view are never stopped.

        Args:
            client: whose image to stop; None: anyone's. One that only adds samples stops for all.
        """
        with self.wake:
            still = self._still
            meant = still is not None and (self._gains or client in (None, still[0]))
            if still is not None and meant and still is not self._stopping:
                self._stopping = still
                threading.Thread(target=self._stop, args=(still,), daemon=True).start()
            self.wake.notify_all()

    def _stop(self, still: tuple[Client, Any]) -> None:
        """Stop a still image. A scene forgets a request that comes between two of its calls."""
        while True:
            with self.wake:
                if self._still is not still:
                    return
                still[1].cancel()
            time.sleep(AGAIN)

    def add(self, sink: Sink, camera: Camera, size: tuple[int, int] | None = None) -> Client:
        """A new client with a first camera; size: of its window, pixels."""
        client = Client(self, sink, camera)
        client.pacer.full = size or client.pacer.full
        with self.wake:
            self.clients.append(client)
            self.wake.notify_all()
        return client

    def remove(self, client: Client, seconds: float = 5.0) -> None:
        """Remove a client; wait for its thread at most so long."""
        with self.wake:
            if client in self.clients:
                self.clients.remove(client)
            self.wake.notify_all()
        client.close(seconds)

    def close(self, seconds: float = 10.0) -> None:
        """Stop the threads and close the source; wait for each thread at most so long."""
        with self.wake:
            if not self._running and not self._threads:
                return
            self._running = False
            self.wake.notify_all()
        for thread in self._threads:
            if thread is not threading.current_thread():
                thread.join(timeout=seconds)
        for client in list(self.clients):
            self.remove(client, seconds)
        self.source.close()
        self._threads = [thread for thread in self._threads if thread.is_alive()]
        if not self._threads:
            atexit.unregister(self.close)

    def report(self, error: BaseException) -> None:
        """Report an error on all pages, at most every `REPEAT` seconds."""
        message = str(error) or type(error).__name__
        if self._repeats.new(message):
            self.on_error(message)

    def _keep_up(self, work: Callable[[], None]) -> None:
        """Run the work of a thread; begin again, and say so, if it fails as nothing expects."""
        while True:
            try:
                return work()
            except BaseException as error:
                with self.wake:
                    for client in self.clients:
                        if client.pacer.making:
                            client.pacer.interrupted(self.clock())
                why = f"{type(error).__name__}: {error}".rstrip(": ")
                self.report(RuntimeError(f"the viewer restarted a thread that had failed: {why}"))
                time.sleep(RESTART)

    # Tracing

    def _what(self, client: Client) -> tuple:
        return (client.camera, self.state.traced, self.source.version, client.dark)

    def _over(self, client: Client) -> tuple:
        """What is drawn over a client's trace."""
        return (self.state.version, tuple(client.marks))

    def _next(self) -> tuple[Client, Plan, float, tuple] | None:
        """The next client and its plan; waits for one. The caller holds `wake`."""
        while self._running:
            now, due = self.clock(), []
            quality = self.state.quality
            found: tuple[bool, int, Client, Plan, tuple] | None = None
            for i in range(len(self.clients)):
                client = self.clients[(self._turn + i) % len(self.clients)]
                what, over = self._what(client), self._over(client)
                plan = client.pacer.plan(now, what, quality.samples, quality.sharpness, quality.width, over)
                if plan is None:
                    due.append(client.pacer.wake_at(now))
                elif found is None or (found[0] and not client.pacer.gains(plan)):
                    found = client.pacer.gains(plan), i, client, plan, what
            if found is not None:  # who waits for an image comes before who waits for samples
                self._gains, i, client, plan, what = found
                client.since = None if plan.refine else now
                self._turn = (self._turn + i + 1) % len(self.clients)
                return client, plan, client.pacer.started(), what
            waits = [at - now for at in due if at is not None]
            self.wake.wait(max(0.001, min(waits)) if waits else None)
        return None

    def _trace(self) -> None:
        while True:
            with self.wake:
                found = self._next()
            if found is None:
                return
            client, plan, seen, what = found
            gains = self._gains
            try:
                self._make(client, plan, seen, what)
                client.since = None
            except KeyboardInterrupt:  # `interrupt`
                with self.wake:
                    client.pacer.interrupted(None if gains else seen)
            except Exception as error:
                with self.wake:
                    client.pacer.given_up()
                self.report(error)

    def _make(self, client: Client, plan: Plan, seen: float, what: tuple) -> None:
        over = self._over(client)
        state = in_the_dark(self.state.snapshot()) if client.dark else self.state.snapshot()
        camera, source = client.camera, self.source
        with source.lock:
            started = self.clock()
            core = getattr(source.maker.last_scene, "_raw", None)  # a simulation's own has none
            with self.wake:
                self._still = (client, core) if plan.still and core is not None else None
            try:
                frame = self._traced(client, plan, what, state, camera)
                marks = client.marks + (outline_of_plane(state, *source.bounds()) if state.cuts.plane else [])
                more = {"state": state, "camera": camera, "room": client.room}
                more |= drawn_over(source, frame, state, marks)
                more["depth"] = frame.distance if more["plates"] or state.notes.box else None
                picture = frame.picture
                client.profile = self._profile(client, state)
            finally:
                with self.wake:
                    self._still, self._gains = None, False
        with self.wake:
            if client not in self.clients:  # it has left
                return
            client.frame, client.frame_version = frame, what
        seconds = self.clock() - started
        with self.wake:
            self.trace_seconds = seconds
            done = replace(plan, samples=min(plan.samples, frame.samples)) if plan.refine else plan
            client.pacer.traced(done, seconds, state.quality.rate)
        client.hand((plan, seen, picture, more, (what, over)))

    def _profile(self, client: Client, state: State) -> dict[str, Any] | None:
        """Values along the measured line. The caller holds the source's lock."""
        line = measured_line(state) if client.line is None else client.line
        scene = self.source.maker.last_scene
        return None if line is None else along_line(scene, line, state.color.by)

    def _traced(self, client: Client, plan: Plan, what: tuple, state: State, camera: Camera) -> Frame | Split:
        """The next frame of a client. The caller holds the source's lock."""
        frame, over = client.frame, self._over(client)
        if not (plan.refine and frame is not None and client.frame_version == what):
            return trace(self.source, state, camera, plan.size, self.up, moving=not plan.still)
        while frame.samples < plan.samples and (self._what(client), self._over(client)) == (what, over):
            frame.refine()
        return frame

    # Time

    def _time(self) -> None:
        """Advance the source at its own speed."""
        due = self.clock()
        while True:
            with self.wake:
                if not self._running:
                    return
            try:
                started = self.clock()
                pause = self.source.advance(self.state)
                while self.source.troubles:
                    self.report(self.source.troubles.pop(0))
            except Exception as error:
                self.report(error)
                self.source.stand_still()
                self.state.set(time__playing=False)
                pause = None
            if pause is None:
                with self.wake:
                    if self._running:
                        self.wake.wait(0.1)
                due = self.clock()
                continue
            now = self.clock()
            self.step_seconds = now - started
            if self.on_step is not None:
                self.on_step()
            self.notify()
            due = max(due + pause, now - 0.25)
            if due > now:
                self.sleep(min(due - now, 0.5))
