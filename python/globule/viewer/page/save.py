"""The panel Save and record: images, movies and settings as downloads.

A browser's request never becomes a path on this machine. A recording that the end of the viewer
interrupts is kept in the working folder.
"""

from __future__ import annotations

import contextlib
import os
import re
import shutil
import tempfile
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from ..log import log
from ..markdown import code
from ..recording import Recorder, Shot, checked_size, keep, turntable
from ..roles import STEER
from ..state import MOST_BYTES
from .jobs import Cancelled, Job
from .panel import Panel
from .widgets import bounded

FIRST_SIZE = "1280x720"
LOAD = "A TOML file of Save settings; at most 256 KiB"
FORMATS = ("PNG", "EXR")
SLOW = "finishing the recording; press Ctrl-C again to discard it"
MOST_KEPT = 16  # recordings of closed tabs that a viewer keeps; they fill the disk
MOST_CANCELLING = 1.0  # s that the end of the viewer waits for cancelled jobs


class Save(Panel):
    """Downloads of images, movies, settings and commands."""

    title = "Save and record"

    def build(self) -> None:
        """Make the widgets."""
        gui = self.gui
        self._recorders: dict[int, tuple[Recorder, str, Any]] = {}  # with path and note
        self._jobs: dict[int, list[Job]] = {}  # by browser
        self._lock = threading.Lock()
        self._n_kept = 0
        self.size = gui.add_text("Size", FIRST_SIZE, hint="Width x height in pixels")
        hint = "Rays per pixel of a saved image"
        self.samples = gui.add_slider("Samples", 1, 256, 1, 16, hint=hint)
        hint = "EXR: linear light, distance and normals"
        self.format = gui.add_dropdown("Image format", FORMATS, hint=hint)
        hint = "Download an image of this view (key P)"
        self.button("Save image", self.picture, hint, True, "P")
        hint = "Of movies, frames per second"
        self.fps = gui.add_slider("Movie frame rate", 5, 60, 1, 30, hint=hint)
        hint = "Start or stop a movie of this view (key R)"
        self.record_button = self.button("Record", self.record, hint, key="R")
        self.seconds = gui.add_slider("Turntable, s", 1, 60, 1, 8, hint="Length of the movie, s")
        self.button("Turntable movie", self.turntable, "One turn around the scene")
        hint = "Stop the image or turntable in progress"
        self.cancel_button = self.button("Cancel", self.cancel, hint, True)
        self.cancel_button.visible = False
        with gui.add_folder("All settings", expand_by_default=False):
            self.button("Save settings", self.save_state, "As a TOML file", True)
            self.upload = gui.add_upload_button("Load settings", mime_type=".toml,text/plain", hint=LOAD)
            self.upload.on_upload(self.safe(self._load))
            hint = "Both make the same image"
            self.button("As command and Python", self.show_equivalent, hint, True)
            hint = "A Jupyter notebook that makes this image"
            self.button("As a notebook", self.save_notebook, hint, True)

    def chosen_size(self) -> tuple[int, int]:
        """(width, height), pixels. Raises ValueError."""
        match = re.fullmatch(r"\s*(\d{1,5})\s*[x×,]\s*(\d{1,5})\s*", self.size.value)
        if not match:
            raise ValueError(f"Size: expected WIDTHxHEIGHT such as {FIRST_SIZE}, got {self.size.value!r}")
        return checked_size((match[1], match[2]))

    def chosen_extension(self) -> str:
        """The extension, .png or .exr. Raises ValueError, since a browser may send anything."""
        if self.format.value not in FORMATS:
            expected = " or ".join(FORMATS)
            raise ValueError(f"Image format: expected {expected}, got {self.format.value!r}")
        return "." + self.format.value.lower()

    def _client(self, browser: Any) -> Any:
        return self.viewer.clients[browser.client_id]

    def picture(self, browser: Any) -> None:
        """Give the browser an image of its view."""
        extension, client = self.chosen_extension(), self._client(browser)
        size, samples = self.chosen_size(), int(bounded(self.samples))
        self._make(
            browser,
            "Image",
            f"globule{extension}",
            lambda progress: Shot(self.viewer.engine, client.camera, size, samples, client.marks, progress).encoded(
                extension
            ),
        )

    def turntable(self, browser: Any) -> None:
        """Give the browser a movie of one turn around its view."""
        camera, size = self._client(browser).camera, self.chosen_size()
        seconds, fps = bounded(self.seconds), bounded(self.fps)

        def made(progress: Callable[[float], None]) -> bytes:
            with tempfile.TemporaryDirectory(prefix="globule-") as folder:
                path = os.path.join(folder, "turntable.mp4")
                turntable(self.viewer.engine, camera, path, size, seconds, fps, progress=progress)
                return Path(path).read_bytes()

        self._make(browser, "Turntable", "turntable.mp4", made)

    def _make(self, browser: Any, title: str, name: str, made: Callable[[Callable[[float], None]], bytes]) -> None:
        """Make the bytes of a file with a note about the progress; give them to the browser."""
        key = browser.client_id
        with self._lock:
            if any(job.title == title for job in self._jobs.get(key, ())):
                raise ValueError(f"{title.lower()}: one is in progress. Press Cancel to stop it.")
            job = Job(browser, title)
            self._jobs.setdefault(key, []).append(job)
            self.cancel_button.visible = True
        try:
            data = made(job.progress)
        except Cancelled:
            return
        finally:
            with self._lock:
                self._jobs[key].remove(job)
                if not self._jobs[key]:
                    del self._jobs[key]
                self.cancel_button.visible = bool(self._jobs)
            job.end()
        give(browser, name, data)

    def cancel(self, browser: Any) -> None:
        """Cancel the jobs of a browser."""
        with self._lock:
            jobs = list(self._jobs.get(browser.client_id, ()))
        if not jobs:
            raise ValueError("cancel: expected an image or turntable in progress, got none")
        for job in jobs:
            job.cancelled = True

    def record(self, browser: Any) -> None:
        """Start the browser's recording, or stop it and give it to the browser."""
        with self._lock:
            running = self._recorders.pop(browser.client_id, None)
            if running is None:
                client, size, fps = self._client(browser), self.chosen_size(), bounded(self.fps)
                path = os.path.join(tempfile.mkdtemp(prefix="globule-"), "movie.mp4")
                recorder = Recorder(self.viewer.engine, lambda: client.camera, path, size, fps)
                hint, usual = "Press R or the button to stop", {"with_close_button": False}
                note = browser.add_notification("Recording", hint, loading=True, **usual)
                self._recorders[browser.client_id] = recorder, path, note
                self.record_button.label, self.record_button.color = "Stop recording", "red"
                return
        recorder, path, note = running
        note.remove()
        try:
            self._stop(recorder)
            give(browser, "globule.mp4", Path(path).read_bytes())
        finally:
            _remove(path)

    def _stop(self, recorder: Recorder) -> None:
        """Finish the file."""
        if not self._recorders:
            self.record_button.label, self.record_button.color = "Record", None
        recorder.stop()

    # Settings

    def save_state(self, browser: Any) -> None:
        """Give the browser all settings as TOML."""
        text = self.state.to_toml(self._client(browser).camera)
        give(browser, "globule-view.toml", text.encode())

    def _load(self, event: Any) -> None:
        content = self.upload.value.content
        if len(content) > MOST_BYTES:
            raise ValueError(f"settings: expected at most {MOST_BYTES} bytes, got {len(content)}")
        camera = self.state.load_toml(
            content.decode("utf-8"), lambda key, value: self.page.binder.nearest(event.client, key, value)
        )
        if camera is not None:
            self.viewer.move(event.client, camera)

    def save_notebook(self, browser: Any) -> None:
        """Give the browser a notebook that makes the image."""
        text = self.viewer.notebook(self._client(browser).camera, self.chosen_size())
        give(browser, "globule.ipynb", text.encode())

    def show_equivalent(self, browser: Any) -> None:
        """Show a command and a program that make the image; of who steers, log them, too."""
        client = self._client(browser)
        command, program = self.viewer.equivalent(client.camera, self.chosen_size())
        if client.role == STEER:
            log.info("the same image:\n%s\n\n%s", command, program)
        text = f"{code(command, 'sh')}\n\n{code(program, 'python')}"
        self.dialog(browser, "The same image", text)

    def close(self) -> None:
        """Cancel images and turntables, and keep recordings."""
        with self._lock:
            running, self._recorders = self._recorders, {}
            jobs = [job for several in self._jobs.values() for job in several]
        for job in jobs:
            job.cancelled = True
        for recorder, path, note in running.values():
            self._keep(recorder, path, note)
        until = time.monotonic() + MOST_CANCELLING
        while self._jobs and time.monotonic() < until:
            time.sleep(0.02)

    def _keep(self, recorder: Recorder, path: str, note: Any) -> None:
        """Keep a recording in the working folder, since no browser can take it any more."""
        slow = threading.Timer(1.0, log.info, [SLOW])
        slow.start()
        try:
            self._stop(recorder)
            name = f"movie-{time.strftime('%Y%m%d-%H%M%S')}"
            try:
                kept = keep(path, name)
            except OSError:  # the working folder is read-only
                kept = keep(path, os.path.join(tempfile.gettempdir(), name))
            said = f"the recording is in {kept}"
            why = "The viewer has stopped" if self.viewer._closed.is_set() else "A tab was closed"
            place = f"{os.path.basename(kept)} in the folder in which the viewer was started"
            words = f"{why}. The recording is {place}."
        except Exception as error:
            said = words = f"the recording is lost: {error}"
        finally:
            slow.cancel()
            _remove(path)
        log.info("%s", said)
        if not self.viewer._closed.is_set():
            for other in list(self.page.server.get_clients().values()):
                with contextlib.suppress(Exception):  # it has left, too
                    other.add_notification("Recording", words)
            return
        with contextlib.suppress(Exception):  # the browser may have left
            note.title, note.body, note.loading = "Recording", words, False
            note.with_close_button = True
            self.viewer.server.flush()
            time.sleep(0.2)  # until it is there

    def disconnected(self, browser: Any) -> None:
        """Cancel the jobs of a browser that has left, and keep its recording."""
        with self._lock:
            running = self._recorders.pop(browser.client_id, None)
            for job in self._jobs.get(browser.client_id, ()):
                job.cancelled = True
        if running is not None:
            self._n_kept += 1
            work = self._keep if self._n_kept <= MOST_KEPT else self._drop
            threading.Thread(target=work, args=running, daemon=True).start()

    def _drop(self, recorder: Recorder, path: str, note: Any) -> None:
        log.info("a closed tab's recording is lost: %s have been kept already", MOST_KEPT)
        try:
            self._stop(recorder)
        finally:
            _remove(path)


def give(browser: Any, name: str, data: bytes) -> None:
    """Let a browser (`viser.ClientHandle`) save a file."""
    browser.send_file_download(name, data, save_immediately=True)


def _remove(path: str) -> None:
    """A recording's file with its folder."""
    shutil.rmtree(os.path.dirname(path), ignore_errors=True)
