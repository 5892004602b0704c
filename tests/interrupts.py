"""Calls that are interrupted at some moment, as by Ctrl-C."""

from __future__ import annotations

import contextlib
import signal
import threading


class _Came(KeyboardInterrupt):
    pass


def interrupted(call, delay: float) -> bool:
    """Run `call` with a signal whose handler raises after `delay` s; whether it came."""
    armed = [True]

    def handler(*_):
        if armed[0]:
            armed[0] = False
            raise _Came

    before = signal.signal(signal.SIGALRM, handler)
    came = False
    try:
        signal.setitimer(signal.ITIMER_REAL, max(delay, 1e-6))
        call()
        armed[0] = False
    except KeyboardInterrupt:
        came = True
    armed[0] = False
    signal.setitimer(signal.ITIMER_REAL, 0)
    signal.signal(signal.SIGALRM, before)
    return came


@contextlib.contextmanager
def running(*calls):
    """Threads that run `calls` until the end; what one of them raised is raised there."""
    raised: list[BaseException] = []

    def guarded(call):
        try:
            call()
        except BaseException as error:
            raised.append(error)

    threads = [threading.Thread(target=guarded, args=(call,), daemon=True) for call in calls]
    for thread in threads:
        thread.start()
    try:
        yield
    finally:
        for thread in threads:
            thread.join()
    if raised:
        raise raised[0]
