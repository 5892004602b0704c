"""What takes a while in a page: pictures and turntables that are being made."""

from __future__ import annotations

import contextlib
import time
from typing import Any


class Cancelled(Exception):
    """Nobody wants any more what is being made."""


class Job:
    """Something that takes a while, and the note in the browser of how far it is."""

    def __init__(self, browser: Any, title: str):
        self.title, self.cancelled = title, False
        self._note = browser.add_notification(title, "0 %", loading=True, with_close_button=False)
        self._started = self._said = time.monotonic()

    def progress(self, share: float) -> None:
        """So much is done. Raises Cancelled."""
        if self.cancelled:
            raise Cancelled
        now = time.monotonic()
        if now - self._said > 0.3:
            self._said = now
            left = (now - self._started) * (1 - share) / share if share > 0 else 0
            rest = f", {left:.0f} s left; Cancel is in Save and record" if left > 2 else ""
            self._note.body = f"{100 * share:.0f} %{rest}"

    def end(self) -> None:
        with contextlib.suppress(Exception):  # the browser may have left
            self._note.remove()
