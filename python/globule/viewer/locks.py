"""A lock that is granted in the order of the requests."""

from __future__ import annotations

import threading


class FairLock:
    """A context manager that excludes other threads and lets none of them starve.

    A simulation that steps without a pause must not keep the tracing thread out, nor the other way
    round. `threading.Lock` may let the same thread in again and again.
    """

    def __init__(self) -> None:
        self._next = threading.Lock()
        self._held = threading.Lock()

    def __enter__(self) -> None:
        with self._next:
            self._held.acquire()

    def __exit__(self, *_: object) -> None:
        self._held.release()
