"""Images and turntable movies in progress, with a note in the browser."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable
from typing import Any


class Cancelled(Exception):
    """The person has cancelled the job."""


class Job:
    """A job and its note in the browser.

    Args:
        note: makes a note: called with title, text and more.
        title: of the note.
        clock: gives the time, s.
    """

    def __init__(self, note: Callable[..., Any], title: str, clock: Callable[[], float] = time.monotonic):
        self.title, self.cancelled, self._clock = title, False, clock
        self._note = note(title, "0 %", loading=True)
        self._started = self._said = clock()

    def progress(self, share: float) -> None:
        """Show the finished share, 0 to 1. Raises Cancelled."""
        if self.cancelled:
            raise Cancelled
        now = self._clock()
        if now - self._said > 0.3:
            self._said = now
            left = (now - self._started) * (1 - share) / share if share > 0 else 0
            rest = f", {left:.0f} s left. To stop: Cancel in Save" if left > 2 else ""
            self._note.body = f"{100 * share:.0f} %{rest}"

    def end(self) -> None:
        """Remove the note."""
        with contextlib.suppress(Exception):  # the browser may have left
            self._note.remove()
