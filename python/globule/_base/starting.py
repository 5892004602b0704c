"""Ctrl-C and SIGTERM while a command is still being loaded: it ends without a traceback."""

import os
import signal
import sys

_USUAL = {signal.SIGINT: signal.default_int_handler, signal.SIGTERM: signal.SIG_DFL}


def quiet_interrupts() -> None:
    """End at once at Ctrl-C and SIGTERM, until `usual_interrupts`, where this process is the
    command."""
    if _is_command():
        for number, usual in _USUAL.items():
            if signal.getsignal(number) is usual:
                signal.signal(number, _end)


def usual_interrupts() -> None:
    """KeyboardInterrupt at Ctrl-C again."""
    for number, usual in _USUAL.items():
        if signal.getsignal(number) is _end:
            signal.signal(number, usual)  # type: ignore[arg-type]


def _is_command() -> bool:
    """Whether this is `globule` or `python -m globule`, rather than a program that imports it."""
    program = (getattr(sys, "argv", None) or [""])[0]
    if program == "-m":  # as it is while the package is being loaded
        words = sys.orig_argv
        return words[words.index("-m") + 1] == "globule" if "-m" in words else False
    return os.path.splitext(os.path.basename(program))[0] == "globule"


def _end(number: int, _: object) -> None:
    os.write(2, b"globule: interrupted\n")
    os._exit(128 + number)
