"""Undo and redo of settings."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .state import State

TOGETHER = 1.0  # s within which changes of the same settings count as one
MOST = 200  # changes that can be undone
PLAYED = {"time__frame", "time__playing"}  # change on their own during playback


class History:
    """The changes of a `State`, newest last. `State.set` calls `note` while it holds its lock."""

    def __init__(self, state: State):
        self._state = state
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
        state = self._state
        with state._lock:
            if not source:
                return False
            values = source.pop()
            now = {}
            for key in values:
                group, _, name = key.partition("__")
                now[key] = getattr(getattr(state, group), name)
            target.append(now)
            self._moving, self._last = True, -TOGETHER
            try:
                state.set(**values)
            finally:
                self._moving = False
        return True
