"""Undo and redo of settings."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import AbstractContextManager
from typing import Any

TOGETHER = 1.0  # s within which changes of the same settings count as one
MOST = 200  # changes that can be undone
PLAYED = {"time__frame", "time__playing"}  # change on their own during playback


class History:
    """The changes of settings, newest last.

    Args:
        get: the value of a setting, by the names of `State.set`.
        set: changes settings; it calls `note` while it holds the lock.
        lock: of the settings.
    """

    def __init__(self, get: Callable[[str], Any], set: Callable[..., Any], lock: AbstractContextManager):
        self._get, self._set, self._lock = get, set, lock
        self.clock = time.monotonic
        self._done: list[dict[str, Any]] = []  # values before each change
        self._undone: list[dict[str, Any]] = []
        self._last = -TOGETHER
        self._moving = False  # `undo` or `redo` sets values

    def note(self, before: dict[str, Any]) -> None:
        """Note a change; `before`: the old values by the names of `State.set`."""
        before = {key: value for key, value in before.items() if key not in PLAYED}
        if self._moving or not before:
            return
        now = self.clock()
        same = bool(self._done) and self._done[-1].keys() == before.keys()
        same = same and not any(isinstance(value, (bool, str)) for value in before.values())
        if not (same and now - self._last < TOGETHER):  # a slider sends many values
            self._done = [*self._done, before][-MOST:]
        self._undone, self._last = [], now

    def undo(self) -> bool:
        """Take back the last change; False if there is none."""
        return self._move(self._done, self._undone)

    def redo(self) -> bool:
        """Make the change again that was taken back last; False if there is none."""
        return self._move(self._undone, self._done)

    @property
    def lengths(self) -> tuple[int, int]:
        """How many changes can be undone and redone."""
        return len(self._done), len(self._undone)

    def clear(self) -> None:
        """Forget all changes."""
        self._done, self._undone = [], []

    def _move(self, source: list[dict[str, Any]], target: list[dict[str, Any]]) -> bool:
        with self._lock:
            if not source:
                return False
            values = source.pop()
            target.append({key: self._get(key) for key in values})
            self._moving, self._last = True, -TOGETHER
            try:
                self._set(**values)
            finally:
                self._moving = False
        return True
