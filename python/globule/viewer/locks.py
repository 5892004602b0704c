"""A lock that whoever waits longest gets next."""

from __future__ import annotations

import threading


class FairLock:
    """A simulation that steps without a pause must not keep a picture from being traced, nor the
    other way round; Python's own lock lets the same thread in again and again."""

    def __init__(self) -> None:
        self._next = threading.Lock()
        self._held = threading.Lock()

    def __enter__(self) -> None:
        with self._next:
            self._held.acquire()

    def __exit__(self, *_: object) -> None:
        self._held.release()
