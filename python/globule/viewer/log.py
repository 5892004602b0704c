"""The log of the viewer, `globule.viewer`: addresses, refused messages, errors."""

from __future__ import annotations

import logging
import sys
import time
from collections.abc import Callable

from .._base.terminal import escaped

LINE_END = "\n"
log = logging.getLogger("globule.viewer")


class Repeats:
    """Lets the same words through once in so many seconds."""

    def __init__(self, seconds: float, clock: Callable[[], float] = time.monotonic):
        self._seconds, self._clock = seconds, clock
        self._said: tuple[str, float] = "", -seconds

    def new(self, words: str) -> bool:
        """Whether to say these words now."""
        now, (last, at) = self._clock(), self._said
        if words == last and now - at < self._seconds:
            return False
        self._said = words, now
        return True


class Terminal(logging.Handler):
    """Prints each record on standard error as `globule: message`."""

    def emit(self, record: logging.LogRecord) -> None:
        """Print one record."""
        if sys.stderr:
            print(f"globule: {escaped(record.getMessage(), LINE_END)}", file=sys.stderr)


def show_log() -> None:
    """Print the log in the terminal, unless the program has configured logging itself.

    A person who starts a viewer has to read its address and its errors somewhere.
    """
    if log.level == logging.NOTSET:
        log.setLevel(logging.INFO)
    if not log.hasHandlers():
        log.addHandler(Terminal())
