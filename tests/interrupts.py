"""Calls that are interrupted at a chosen place, as by Ctrl-C, and threads beside each other."""

import contextlib
import linecache
import os
import signal
import sys
import threading
from pathlib import Path

import globule as gb
from globule import _core

ALL = os.environ.get("GLOBULE_INTERRUPTS") == "all"
FEW = 16  # places of a call, unless all
PACKAGE = str(Path(gb.__file__).parent)


class _Came(KeyboardInterrupt):
    pass


@contextlib.contextmanager
def polls(stop: int = 0):
    """Ctrl-C at a poll of the core, counted from 1 on; what it gives tells how many there were."""
    _core.stop_at_poll(stop)
    try:
        yield _core.n_polls
    finally:
        _core.stop_at_poll(None)


@contextlib.contextmanager
def lines(stop: int = 0, number: int = signal.SIGINT):
    """Ctrl-C, or another signal, before a line of globule's Python, as `polls`. Lines with `with`
    do not count: Python lets no handler in between a block and the `__exit__` that belongs to it,
    a trace does."""
    n = 0

    def trace(frame, event, _):
        nonlocal n
        code = frame.f_code
        if not code.co_filename.startswith(PACKAGE):
            return None
        line = linecache.getline(code.co_filename, frame.f_lineno)
        if event == "line" and not line.lstrip().startswith("with "):
            n += 1
            if n == stop:
                signal.raise_signal(number)
        return trace

    before = sys.gettrace()
    sys.settrace(trace)
    try:
        yield lambda: n
    finally:
        sys.settrace(before)


def interrupted(call, places=polls, stop: int = 1, number: int = signal.SIGINT) -> bool:
    """Run `call` with Ctrl-C at one of its places, and tell whether that ended it."""

    def handler(*_):
        raise _Came

    before = signal.signal(number, handler)
    try:
        with places(stop):
            call()
    except _Came:
        return True
    finally:
        signal.signal(number, before)
    return False


def count(call, places=polls) -> int:
    """How many places a call has where Ctrl-C may come."""
    with places() as n:
        call()
        return n()


def spread(n: int, few: int = FEW) -> list[int]:
    """Of the numbers from 1 to n all, or a few from the first to the last."""
    if ALL or n <= few:
        return list(range(1, n + 1))
    return sorted({1 + round(i * (n - 1) / (few - 1)) for i in range(few)})


def interrupts(prepare, call, sure: bool = True, few: int = FEW):
    """Interrupt `call(prepare())` at place after place, and give what was prepared each time. Not
    sure: the number of places varies from call to call, and the last may never come."""
    call(prepare())  # loads what it needs
    for places in (polls, lines):
        n_came = 0
        made = prepare()
        n = count(lambda made=made: call(made), places)
        for stop in spread(n, few):
            made = prepare()
            came = interrupted(lambda made=made: call(made), places, stop)
            assert came or not sure, f"{stop} of {n} {places.__name__}"
            n_came += came
            yield made
        assert n_came or not n


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
