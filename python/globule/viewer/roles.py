"""What each browser may do: steer, or look with a camera of its own.

A browser that steers changes the settings that all share. A browser that looks has its own camera,
reads values, measures and saves images. The token in the address decides (`guard.py`). At most
`Viewer.most_clients` browsers are shown images; the others are refused until a place is free.
"""

from __future__ import annotations

import contextlib
import math
import numbers
import time
from collections.abc import Iterator
from contextvars import ContextVar
from dataclasses import dataclass, field
from typing import Any

import numpy as np

STEER, LOOK, REFUSED = "steer", "look", "refused"
MOST_CLIENTS = 16
LOOKING = "You are looking; only a browser that steers changes the settings."
REPEAT = 3.0  # s before a browser is told again that it looks
MOST_TEXT = 10_000  # characters in a field
AT_ONCE = 2  # actions of a browser that looks: an image, and the button that cancels it
# Actions of the toolbar that change nothing for others.
PRIVATE_ACTIONS = {"tool", "fit", "picture", "state", "dark", "wide", "series"}


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


def may_ask(role: str, action: str) -> bool:
    """Whether a role may do an action of the toolbar."""
    return role == STEER or (role == LOOK and action in PRIVATE_ACTIONS)


class Roles:
    """Which of the shared widgets, by their identifiers, may be used by a browser that looks."""

    def __init__(self, viewer: Any):
        self.viewer = viewer
        self._private: set[str] = set()

    def private(self, handle: Any) -> Any:
        """Note a widget or command that only changes the browser's own view; returns it."""
        impl = getattr(handle, "_impl", handle)
        self._private.add(impl.uuid)
        return handle

    def may(self, who: Visitor, message: Any) -> bool:
        """Whether a browser may send a message to what all browsers share."""
        updates = getattr(message, "updates", None)
        if updates is not None and not self._holds(message):
            return False
        places = [(getattr(message, name, None), n) for name, n in (("position", 3), ("wxyz", 4))]
        if not all(place is None or _is_like((0.0,) * n, place) for place, n in places):
            return False  # viser would send it to all browsers
        if who.role != LOOK:
            return who.role == STEER
        uuid = getattr(message, "uuid", None)
        return uuid in self._private and (updates is None or self._pressed(uuid, updates["value"]))

    def _holds(self, message: Any) -> bool:
        """Whether a message sets a control to a value that it can hold: viser would set any other
        attribute, and send any value to all browsers, some of which end their connections."""
        if set(message.updates) != {"value"}:
            return False
        handle = self.viewer.server.gui._gui_input_handle_from_uuid.get(message.uuid)
        options, value = getattr(handle, "options", None), message.updates["value"]
        return handle is None or (_is_like(handle._impl.value, value) if options is None else value in options)

    @contextlib.contextmanager
    def turn(self, browser: Any) -> Iterator[None]:
        """An action of a browser (None: the program's) in viser's few threads, which all share.

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

    def _pressed(self, uuid: str, value: Any) -> bool:
        """Whether a value is what pressing a button, or one of a group, sends."""
        handle = self.viewer.server.gui._gui_input_handle_from_uuid.get(uuid)
        options = getattr(handle, "options", None)
        return value is True if options is None else value in options

    def shared(self, message: Any) -> bool:
        """Whether a message is about something that all browsers share."""
        server = self.viewer.server
        uuid, name = getattr(message, "uuid", None), getattr(message, "name", None)
        known = server.gui._gui_input_handle_from_uuid, server.gui._command_handle_from_uuid
        return any(uuid in table for table in known) or name in server.scene._handle_from_node_name

    def refuse(self, who: Visitor, client_id: int, message: Any) -> None:
        """Give the browser back what it tried to change, and say why."""
        browser = self.viewer.server.get_clients().get(client_id)
        if who.role == REFUSED or browser is None or not self.shared(message):
            return
        self._restore(browser, message)
        if who.role == STEER:
            self.viewer.page.complain(browser, "page: expected a value that the control can hold")
        elif who.tellings.take():
            client = self.viewer.clients.get(client_id)
            if client is not None:
                client.sink.error(LOOKING)

    def _restore(self, browser: Any, message: Any) -> None:
        from viser import _messages

        server = self.viewer.server
        answers: list[Any] = []
        if isinstance(message, _messages.GuiUpdateMessage):
            handle = server.gui._gui_input_handle_from_uuid.get(message.uuid)
            if handle is not None and not handle._impl.is_button:
                value = {"value": handle._impl.value}
                answers.append(_messages.GuiUpdateMessage(message.uuid, value))
        elif isinstance(message, _messages.TransformControlsUpdateMessage):
            handle = server.scene._handle_from_node_name.get(message.name)
            if handle is not None:
                x, y, z = (float(v) for v in handle.position)
                turn = tuple(float(v) for v in handle.wxyz)
                answers.append(_messages.SetPositionMessage(message.name, (x, y, z)))
                answers.append(_messages.SetOrientationMessage(message.name, turn))  # type: ignore[arg-type]
        for answer in answers:
            browser._websock_connection.queue_message(answer)


def _is_like(known: Any, value: Any) -> bool:
    """Whether a value that came can stand in the place of a known one."""
    if isinstance(known, (bool, np.bool_)) or isinstance(value, bool):
        return isinstance(known, (bool, np.bool_)) and isinstance(value, bool)
    if isinstance(known, numbers.Real):
        most = 2.0**63 if isinstance(known, numbers.Integral) else math.inf  # of whole numbers in messages
        return isinstance(value, (int, float)) and abs(value) < most
    if isinstance(known, tuple):
        return isinstance(value, (list, tuple)) and len(value) == len(known) and all(map(_is_like, known, value))
    return isinstance(known, str) and isinstance(value, str) and len(value) <= MOST_TEXT
