"""The command line, as `globule` and as `python -m globule`."""

import contextlib
import os
import signal
import sys


def main() -> int:
    """Run one command and return its exit status."""
    try:
        from .cli import main as run  # takes a while, in which one may press Ctrl-C

        status = run()
    except KeyboardInterrupt:
        print("globule: interrupted", file=sys.stderr)
        status = 130
    if status == 130:
        leave(status)
    return status


def leave(status: int) -> None:
    """End now. Python's own way waits for threads, and crashes where one is inside a kernel."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(AttributeError, OSError, ValueError):
            stream.flush()
    os._exit(status)


if __name__ == "__main__":
    sys.exit(main())
