"""Ctrl-C while a command is still being loaded: it ends without a traceback."""

import os
import signal
import sys


def quiet_interrupts() -> None:
    """End at once at Ctrl-C, until `usual_interrupts`, where this process is the command."""
    if _is_command() and signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, _end)


def usual_interrupts() -> None:
    """KeyboardInterrupt at Ctrl-C again."""
    if signal.getsignal(signal.SIGINT) is _end:
        signal.signal(signal.SIGINT, signal.default_int_handler)


def _is_command() -> bool:
    """Whether this is `globule` or `python -m globule`, rather than a program that imports it."""
    program = (getattr(sys, "argv", None) or [""])[0]
    if program == "-m":  # as it is while the package is being loaded
        words = sys.orig_argv
        return words[words.index("-m") + 1] == "globule" if "-m" in words else False
    return os.path.splitext(os.path.basename(program))[0] == "globule"


def _end(*_: object) -> None:
    os.write(2, b"globule: interrupted\n")
    os._exit(130)
