"""What each browser may do: steer, or look with a camera of its own.

A browser that steers changes the settings that all share. A browser that looks has its own camera,
reads values, measures and saves images. The token in the address decides (`guard.py`). At most
`Viewer.most_clients` browsers are shown images; the others are refused until a place is free.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Iterator
from contextvars import ContextVar
from dataclasses import dataclass, field
from typing import Any

from .gui import is_like

STEER, LOOK, REFUSED = "steer", "look", "refused"
MOST_CLIENTS = 16
LOOKING = "You are looking; only a browser that steers changes the settings."
REPEAT = 3.0  # s before a browser is told again that it looks
AT_ONCE = 2  # actions of a browser that looks: an image, and the button that cancels it
# Actions of the toolbar that change nothing for others.
PRIVATE_ACTIONS = {"tool", "click", "drag", "fit", "picture", "state", "series", "section", "room", "tab", "dark"}
# Messages of viser's page about handles
HANDLES = {"TransformControlsUpdateMessage", "TransformControlsDragStartMessage", "TransformControlsDragEndMessage"}


class Allowance:
    """So many at once, and one more each time a while has passed.

    Args:
        most: at once.
        seconds: until one more.
    """

    def __init__(self, most: int, seconds: float):
        self._most, self._seconds = most, seconds
        self._left, self._since = float(most), time.monotonic()

    def take(self) -> bool:
        """Whether there was one left, which is taken."""
        now = time.monotonic()
        self._left = min(self._most, self._left + (now - self._since) / self._seconds)
        self._since = now
        if self._left < 1:
            return False
        self._left -= 1
        return True


@dataclass
class Visitor:
    """One connection of a browser.

    Attributes:
        role: STEER, LOOK or REFUSED.
        tellings: how often it is told that it may not steer.
    """

    role: str
    tellings: Allowance = field(default_factory=lambda: Allowance(1, REPEAT))


# The visitor whose message is handled; a task for a message inherits that of its connection.
VISITOR: ContextVar[Visitor | None] = ContextVar("visitor", default=None)


def visitor() -> Visitor:
    """The visitor of this task; without a connection, one who may do nothing."""
    return VISITOR.get() or Visitor(REFUSED)


def may_ask(role: str, action: str, own: bool = False) -> bool:
    """Whether a role may do an action of the page; own: it changes the browser's own view only."""
    return role == STEER or (role == LOOK and (own or action in PRIVATE_ACTIONS))


class Roles:
    """What a browser may send to viser beside our own controls: its camera, and, if it steers, the
    handles of instruments, which all browsers share."""

    def __init__(self, viewer: Any):
        self.viewer = viewer

    def may(self, who: Visitor, message: Any) -> bool:
        """Whether a browser may send a message to what all browsers share."""
        if type(message).__name__ not in HANDLES:
            return False
        places = [(getattr(message, name, None), n) for name, n in (("position", 3), ("wxyz", 4))]
        good = all(place is None or is_like((0.0,) * n, place) for place, n in places)
        return good and who.role == STEER  # viser would send anything to all browsers

    @contextlib.contextmanager
    def turn(self, browser: Any) -> Iterator[None]:
        """An action of a browser (None: the program's).

        Raises ValueError if a browser that looks does `AT_ONCE` others already.
        """
        client = None if browser is None else self.viewer.clients.get(browser.client_id)
        if client is None or client.role != LOOK:
            yield
            return
        if not client.turns.acquire(blocking=False):
            raise ValueError(f"page: {AT_ONCE} actions are in progress; wait until one has ended")
        try:
            yield
        finally:
            client.turns.release()

    def refuse(self, who: Visitor, client_id: int, message: Any) -> None:
        """Give a browser that looks the place of a handle back, and say why."""
        client = self.viewer.clients.get(client_id)
        if who.role != LOOK or client is None or type(message).__name__ not in HANDLES:
            return
        for panel in self.viewer.page.panels:
            panel.put_back(getattr(message, "name", ""))
        if who.tellings.take():
            client.sink.error(LOOKING)
