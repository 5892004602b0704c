"""Pictures, movies and the whole state, as downloads: what a browser asks for never becomes a path
on this machine."""

from __future__ import annotations

import os
import re
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from ..recording import Recorder, Shot, checked_size, turntable
from ..state import MOST_BYTES
from .panel import Panel
from .widgets import bounded

FIRST_SIZE = "1280x720"
FORMATS = ("PNG", "EXR")


class Save(Panel):
    title = "Save and record"

    def build(self) -> None:
        gui = self.gui
        self._recorders: dict[int, tuple[Recorder, str, Any]] = {}  # and what says so
        self._lock = threading.Lock()
        self.size = gui.add_text("Size", FIRST_SIZE, hint="Width x height in pixels; any")
        self.samples = gui.add_slider("Samples", 1, 256, 1, 16, hint="Rays per pixel of a picture")
        self.format = gui.add_dropdown("Picture as", FORMATS)
        self.button("Save a picture", self.picture, "Key P")
        self.fps = gui.add_slider("Movie's pictures / s", 5, 60, 1, 30)
        self.record_button = self.button("Record", self.record, "Starts and stops; key R")
        self.seconds = gui.add_slider("Turntable, seconds", 1, 60, 1, 8)
        self.button("Turntable movie", self.turntable, "Once around what is seen")
        with gui.add_folder("All settings", expand_by_default=False):
            self.button("Save settings", self.save_state, "As a TOML file")
            self.upload = gui.add_upload_button("Load settings", mime_type=".toml,text/plain")
            self.upload.on_upload(self.safe(self._load))
            self.button("As a command, and as Python", self.show_equivalent)
        for key, label, called in (("P", "Save a picture", self.picture),
                                   ("R", "Record", self.record)):
            gui.add_command(label, hotkey=key).on_trigger(
                self.safe(lambda event, called=called: called(event.client)))

    def chosen_size(self) -> tuple[int, int]:
        match = re.fullmatch(r"\s*(\d{1,5})\s*[x×,]\s*(\d{1,5})\s*", self.size.value)
        if not match:
            raise ValueError(f"Size: expected WIDTHxHEIGHT, got {self.size.value!r}")
        return checked_size((match[1], match[2]))

    def chosen_extension(self) -> str:
        """A browser may send anything, and it becomes part of a path."""
        if self.format.value not in FORMATS:
            expected = " or ".join(FORMATS)
            raise ValueError(f"Picture as: expected {expected}, got {self.format.value!r}")
        return "." + self.format.value.lower()

    def _client(self, browser: Any) -> Any:
        return self.viewer.clients[browser.client_id]

    def picture(self, browser: Any) -> None:
        extension, client = self.chosen_extension(), self._client(browser)
        samples = int(bounded(self.samples))
        with self._progress(browser, "Picture") as progress:
            shot = Shot(self.viewer.engine, client.camera, self.chosen_size(), samples,
                        client.marks, progress)
            data = shot.encoded(extension)
        browser.send_file_download(f"globule{extension}", data, save_immediately=True)

    @contextmanager
    def _progress(self, browser: Any, title: str) -> Iterator[Callable[[float], None]]:
        """A note in the browser of how far something is."""
        note = browser.add_notification(title, "0 %", loading=True, with_close_button=False)
        last = [0.0]

        def progress(share: float) -> None:
            if browser.client_id not in self.viewer.clients:
                raise ValueError(f"{title.lower()}: the browser has left")
            if time.monotonic() - last[0] > 0.3:
                last[0] = time.monotonic()
                note.body = f"{100 * share:.0f} %"

        try:
            yield progress
        finally:
            note.remove()

    def record(self, browser: Any) -> None:
        """Start, or stop and download; each browser its own."""
        with self._lock:
            running = self._recorders.pop(browser.client_id, None)
            if running is None:
                client = self._client(browser)
                path = os.path.join(tempfile.mkdtemp(prefix="globule-"), "movie.mp4")
                recorder = Recorder(self.viewer.engine, lambda: client.camera, path,
                                    self.chosen_size(), bounded(self.fps))
                note = browser.add_notification("Recording", "R, or the button, stops it",
                                                loading=True, with_close_button=False)
                self._recorders[browser.client_id] = recorder, path, note
                self.record_button.label, self.record_button.color = "Stop recording", "red"
                return
        running[-1].remove()
        self._finish(*running[:2], browser)

    def _finish(self, recorder: Recorder, path: str, browser: Any) -> None:
        if not self._recorders:
            self.record_button.label, self.record_button.color = "Record", None
        try:
            recorder.stop()
            if browser is not None:
                with open(path, "rb") as file:
                    browser.send_file_download("globule.mp4", file.read(), save_immediately=True)
        finally:
            _remove(path)

    def turntable(self, browser: Any) -> None:
        client = self._client(browser)
        path = os.path.join(tempfile.mkdtemp(prefix="globule-"), "turntable.mp4")
        try:
            with self._progress(browser, "Turntable") as progress:
                turntable(self.viewer.engine, client.camera, path, self.chosen_size(),
                          bounded(self.seconds), bounded(self.fps), progress=progress)
            with open(path, "rb") as file:
                browser.send_file_download("turntable.mp4", file.read(), save_immediately=True)
        finally:
            _remove(path)

    # Settings

    def save_state(self, browser: Any) -> None:
        text = self.state.to_toml(self._client(browser).camera)
        browser.send_file_download("globule-view.toml", text.encode(), save_immediately=True)

    def _load(self, event: Any) -> None:
        content = self.upload.value.content
        if len(content) > MOST_BYTES:
            raise ValueError(f"settings: expected at most {MOST_BYTES} bytes, got {len(content)}")
        camera = self.state.load_toml(content.decode("utf-8"))
        if camera is not None:
            self.viewer.move(event.client, camera)

    def show_equivalent(self, browser: Any) -> None:
        command, code = self.viewer.equivalent(self._client(browser).camera, self.chosen_size())
        print(f"{command}\n\n{code}")
        gui = browser.gui
        with gui.add_modal("The same picture") as modal:
            gui.add_markdown(f"```sh\n{command}\n```\n\n```python\n{code}```")
            gui.add_button("Close").on_click(lambda _: modal.close())

    def close(self) -> None:
        """Nobody is there to take what is recorded."""
        while self._recorders:
            self._finish(*self._recorders.popitem()[1][:2], None)

    def disconnected(self, browser: Any) -> None:
        with self._lock:
            running = self._recorders.pop(browser.client_id, None)
        if running is not None:
            threading.Thread(target=self._finish, args=(*running[:2], None), daemon=True).start()


def _remove(path: str) -> None:
    if os.path.exists(path):
        os.unlink(path)
    os.rmdir(os.path.dirname(path))
