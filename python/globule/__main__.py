"""The command line, as `globule` and as `python -m globule`."""

import contextlib
import os
import signal
import sys
from typing import Any

from ._base.starting import usual_interrupts


def main() -> int:
    """Run one command of `sys.argv` and return its exit status."""
    stopped = 130
    sys.excepthook = _quiet

    def terminate(*_: Any) -> None:  # like Ctrl-C: commands write their checkpoints
        nonlocal stopped
        stopped = 128 + signal.SIGTERM
        raise KeyboardInterrupt

    try:
        signal.signal(signal.SIGTERM, terminate)
        usual_interrupts()
        from .formats.workers import prepare

        prepare(sys.argv[1:])  # while the commands are loaded
        from .cli import main as run  # slow enough for a Ctrl-C

        status = run()
    except KeyboardInterrupt:
        print("globule: interrupted", file=sys.stderr)
        status = 130
    if status == 130:
        leave(stopped)
    return status


def _quiet(kind: Any, error: Any, trace: Any) -> None:
    """Without a traceback where one more Ctrl-C came while the last one was answered."""
    if issubclass(kind, KeyboardInterrupt):
        leave(130)
    sys.__excepthook__(kind, error, trace)


def leave(status: int) -> None:
    """Exit now. Python's own exit waits for threads, and crashes if a thread runs a kernel."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(AttributeError, OSError, ValueError):
            stream.flush()
    os._exit(status)


if __name__ == "__main__":
    sys.exit(main())
