"""The panel Save and record: images, movies and settings as downloads.

A browser's request never becomes a path on this machine. A recording that the end of the viewer
interrupts is kept in the working folder.
"""

from __future__ import annotations

import contextlib
import functools
import io
import os
import re
import shutil
import tempfile
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from ..first_view import FIRST_SIZE
from ..log import log
from ..markdown import code
from ..recording import LEAST_SIDE, Recorder, Shot, checked_size, keep, turntable
from ..roles import STEER
from .jobs import Cancelled, Job
from .panel import Panel
from .widgets import bounded

AS_SHOWN = "as shown"
FORMATS = ("PNG", "EXR")
SLOW = "finishing the recording; press Ctrl-C again to discard it"
MOST_KEPT = 16  # recordings of closed tabs that a viewer keeps; they fill the disk
MOST_CANCELLING = 1.0  # s that the end of the viewer waits for cancelled jobs


class Save(Panel):
    """Downloads of images, movies, settings and commands."""

    title = "Save"

    def build(self) -> None:
        """Make the widgets."""
        gui = self.gui
        self._recorders: dict[int, tuple[Recorder, str, Any]] = {}  # with path and note
        self._jobs: dict[int, list[Job]] = {}  # by browser
        self._lock = threading.Lock()
        self._n_kept = 0
        self.size = gui.add_text("Size", AS_SHOWN, hint="Of images and movies: as shown, or WIDTHxHEIGHT in pixels")
        hint = "Rays per pixel of a saved image"
        self.samples = gui.add_slider("Samples", 1, 256, 1, 16, hint=hint)
        hint = "EXR: linear light, distance and normals"
        self.format = gui.add_dropdown("Image format", FORMATS, hint=hint)
        self.command("Save image", "P", self.picture, True)
        hint = "Of movies, frames per second"
        self.fps = gui.add_slider("Movie frame rate", 5, 60, 1, 30, hint=hint)
        self.command("Record", "R", self.record)
        self.seconds = gui.add_slider("Turntable", 1, 60, 1, 8, hint="Length of the movie", unit="s")
        self.button("Turntable movie", self.turntable, "One turn around the scene")
        hint = "Stop the image or turntable in progress"
        self.cancel_button = self.button("Cancel", self.cancel, hint, True)
        self.cancel_button.visible = False
        with gui.add_folder("The same without the viewer"):
            hint = "Both make the same image"
            self.button("As command and Python", self.show_equivalent, hint, True)
            hint = "A Jupyter notebook that makes this image"
            self.button("As a notebook", self.save_notebook, hint, True)

    @property
    def is_as_shown(self) -> bool:
        """Whether images have the size of the view."""
        return str(self.size.value).strip() in (AS_SHOWN, "")

    def chosen_size(self, browser: Any = None) -> tuple[int, int]:
        """(width, height), pixels; as shown: of the browser's view. Raises ValueError."""
        words = str(self.size.value).strip()
        if self.is_as_shown:
            client = None if browser is None else self.viewer.clients.get(browser.client_id)
            return FIRST_SIZE if client is None else checked_size(np.maximum(client.pacer.full, LEAST_SIDE))
        match = re.fullmatch(r"(\d{1,5})\s*[x×,]\s*(\d{1,5})", words)
        if not match:
            raise ValueError(f"Size: expected {AS_SHOWN}, or WIDTHxHEIGHT such as 1280x720, got {self.size.value!r}")
        return checked_size((match[1], match[2]))

    def name(self, ending: str) -> str:
        """The name of a download: that of the data."""
        stem = re.sub(r"[^A-Za-z0-9_-]+", "_", self.viewer.title.partition(".")[0].partition(", ")[0]).strip("_")
        return f"{stem or 'globule'}{ending}"

    def chosen_extension(self) -> str:
        """The extension, .png or .exr. Raises ValueError, since a browser may send anything."""
        if self.format.value not in FORMATS:
            expected = " or ".join(FORMATS)
            raise ValueError(f"Image format: expected {expected}, got {self.format.value!r}")
        return "." + self.format.value.lower()

    def records(self, browser: Any) -> bool:
        """Whether a browser records a movie."""
        return browser.client_id in self._recorders

    def _client(self, browser: Any) -> Any:
        return self.viewer.clients[browser.client_id]

    def picture(self, browser: Any) -> None:
        """Give the browser an image of its view."""
        extension, client = self.chosen_extension(), self._client(browser)
        size, samples = self.chosen_size(browser), int(bounded(self.samples))
        seen = client.sharp() if self.is_as_shown and extension == ".png" else None
        if seen is not None and seen.shape[1::-1] == tuple(size):
            data = io.BytesIO()
            Image.fromarray(seen).save(data, "PNG")
            self.page.desk.give(browser, self.name(extension), data.getvalue())
            return

        def made(progress: Callable[[float], None]) -> bytes:
            shot = Shot(self.viewer.engine, client.camera, size, samples, client.marks, progress, client.dark)
            return shot.encoded(extension)

        self._make(browser, "Image", self.name(extension), made)

    def turntable(self, browser: Any) -> None:
        """Give the browser a movie of one turn around its view."""
        camera, size = self._client(browser).camera, even(self.chosen_size(browser))
        seconds, fps = bounded(self.seconds), bounded(self.fps)

        def made(progress: Callable[[float], None]) -> bytes:
            with tempfile.TemporaryDirectory(prefix="globule-") as folder:
                path = os.path.join(folder, "turntable.mp4")
                turntable(self.viewer.engine, camera, path, size, seconds, fps, progress=progress)
                return Path(path).read_bytes()

        self._make(browser, "Turntable", self.name("-turntable.mp4"), made)

    def _make(self, browser: Any, title: str, name: str, made: Callable[[Callable[[float], None]], bytes]) -> None:
        """Make the bytes of a file with a note about the progress; give them to the browser."""
        key = browser.client_id
        with self._lock:
            if any(job.title == title for job in self._jobs.get(key, ())):
                raise ValueError(f"{title.lower()}: one is in progress. Press Cancel to stop it.")
            job = Job(functools.partial(self.page.desk.note, browser), title)
            self._jobs.setdefault(key, []).append(job)
            self.cancel_button.visible = True
        threading.Thread(target=self._work, args=(browser, job, name, made), name="globule save", daemon=True).start()

    def _work(self, browser: Any, job: Job, name: str, made: Callable[[Callable[[float], None]], bytes]) -> None:
        key, data, wrong = browser.client_id, None, None
        try:
            data = made(job.progress)
        except Cancelled:
            pass
        except Exception as error:
            wrong = str(error) or type(error).__name__
        with self._lock:
            self._jobs[key].remove(job)
            if not self._jobs[key]:
                del self._jobs[key]
            self.cancel_button.visible = bool(self._jobs)
        job.end()
        if wrong is not None:
            self.page.complain(browser, wrong)
        elif data is not None:
            self.page.desk.give(browser, name, data)

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
                client, size, fps = self._client(browser), even(self.chosen_size(browser)), bounded(self.fps)
                path = os.path.join(tempfile.mkdtemp(prefix="globule-"), "movie.mp4")
                recorder = Recorder(self.viewer.engine, lambda: client.camera, path, size, fps)
                note = self.page.desk.note(browser, "Recording", "Press R or the button to stop", loading=True)
                self._recorders[browser.client_id] = recorder, path, note
                return
        recorder, path, note = running
        note.remove()
        try:
            recorder.stop()
            self.page.desk.give(browser, self.name(".mp4"), Path(path).read_bytes())
        finally:
            _remove(path)

    # Settings

    def save_state(self, browser: Any) -> None:
        """Give the browser all settings as TOML."""
        text = self.state.to_toml(self._client(browser).camera)
        self.page.desk.give(browser, self.name("-view.toml"), text.encode())

    def load(self, browser: Any, value: Any) -> None:
        """Take the settings of a file of the browser: [its name, its text]. Raises ValueError."""
        if not (isinstance(value, list) and len(value) == 2 and all(isinstance(v, str) for v in value)):
            raise ValueError("settings: expected the name and the text of a file")
        name, text = value[0][-60:], value[1]
        try:
            camera = self.state.load_toml(text, lambda key, value: self.page.binder.nearest(browser, key, value))
        except ValueError as error:
            raise ValueError(f"{name}: {error}") from None
        if camera is not None:
            self.viewer.move(browser, camera)

    def save_notebook(self, browser: Any) -> None:
        """Give the browser a notebook that makes the image."""
        text = self.viewer.notebook(self._client(browser).camera, self.chosen_size(browser))
        self.page.desk.give(browser, self.name(".ipynb"), text.encode())

    def show_equivalent(self, browser: Any) -> None:
        """Show a command and a program that make the image; of who steers, log them, too."""
        client = self._client(browser)
        command, program = self.viewer.equivalent(client.camera, self.chosen_size(browser))
        if client.role == STEER:
            log.info("the same image:\n%s\n\n%s", command, program)
        text = f"{code(command, 'sh')}\n\n{code(program, 'python')}"
        self.page.desk.dialog(browser, "The same image", text)

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
            recorder.stop()
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
            for other in list(self.page.desk.browsers.values()):
                with contextlib.suppress(Exception):  # it has left, too
                    self.page.desk.note(other, "Recording", words)
            return
        with contextlib.suppress(Exception):  # the browser may have left
            note.loading, note.body = False, words
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
            recorder.stop()
        finally:
            _remove(path)


def even(size: tuple[int, int]) -> tuple[int, int]:
    """A size for movies, whose sides are even."""
    return size[0] // 2 * 2, size[1] // 2 * 2


def _remove(path: str) -> None:
    """A recording's file with its folder."""
    shutil.rmtree(os.path.dirname(path), ignore_errors=True)
