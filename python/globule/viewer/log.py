"""The log of the viewer, `globule.viewer`: addresses, refused messages, errors."""

from __future__ import annotations

import logging
import sys

from .._base.terminal import escaped

LINE_END = "\n"
log = logging.getLogger("globule.viewer")


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
