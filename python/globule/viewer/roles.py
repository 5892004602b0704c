"""What each browser may do: steer, or look with a camera of its own.

A browser that steers changes the settings that all share. A browser that looks has its own camera,
reads values, measures and saves images. The token in the address decides (`guard.py`). At most
`Viewer.most_clients` browsers are shown images; the others are refused until a place is free.
"""

from __future__ import annotations

import time

STEER, LOOK = "steer", "look"
MOST_CLIENTS = 16
LOOKING = "You are looking; only a browser that steers changes the settings."
AT_ONCE = 2  # actions of a browser that looks: an image, and the button that cancels it
# Actions of the toolbar that change nothing for others.
PRIVATE_ACTIONS = {"look", "size", "tool", "click", "drag", "fit", "picture", "state", "series", "section", "room",
                   "dark"}  # fmt: skip


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


def may_ask(role: str, action: str, own: bool = False) -> bool:
    """Whether a role may do an action of the page; own: it changes the browser's own view only."""
    return role == STEER or (role == LOOK and (own or action in PRIVATE_ACTIONS))
