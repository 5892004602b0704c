"""Methods that Ctrl-C and other threads find done or not begun, never half done."""

from __future__ import annotations

import functools
import signal
import threading
from collections.abc import Callable
from typing import Any, TypeVar

_Method = TypeVar("_Method", bound=Callable[..., Any])
_SIGNALS = tuple(
    getattr(signal, name)
    for name in ("SIGINT", "SIGTERM", "SIGALRM", "SIGHUP", "SIGUSR1", "SIGUSR2", "SIGVTALRM")
    if hasattr(signal, name)
)


def whole(method: _Method) -> _Method:
    """Serialize a method with others of its object, whose `_lock` is an RLock, and let Python's
    signal handlers (Ctrl-C) wait until it has returned."""

    @functools.wraps(method)
    def call(self: Any, *args: Any, **kwargs: Any) -> Any:
        with Later(), self._lock:
            return method(self, *args, **kwargs)

    return call  # type: ignore[return-value]  # `wraps` keeps the signature


class Later:
    """Signals that come meanwhile are handled at the end. Only the main thread handles any."""

    _inside = False

    def __init__(self) -> None:
        self._handlers: list[tuple[int, Any]] = []
        self._came: list[tuple[int, Any]] = []

    def __enter__(self) -> None:
        if Later._inside or threading.current_thread() is not threading.main_thread():
            return
        try:
            for number in _SIGNALS:
                handler = signal.getsignal(number)
                if callable(handler):
                    self._handlers.append((number, handler))
                    signal.signal(number, self._note)
            Later._inside = bool(self._handlers)  # __exit__ has nothing to restore without any
        except BaseException:  # a handler ran before it was replaced
            self._restore()
            raise

    def __exit__(self, *_: Any) -> None:
        if not self._handlers:
            return
        Later._inside = False
        self._restore()
        for number, frame in self._came:
            handler: Any = signal.getsignal(number)  # can be called, as `__enter__` saw
            handler(number, frame)

    def _note(self, number: int, frame: Any) -> None:
        self._came.append((number, frame))

    def _restore(self) -> None:
        try:
            while self._handlers:
                signal.signal(*self._handlers[-1])
                self._handlers.pop()
        except BaseException:  # what a handler raised that is in place again
            self._restore()
            raise
