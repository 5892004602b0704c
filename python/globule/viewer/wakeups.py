"""Messages that no browser was told of.

viser 1.1 sets the event that its senders wait for from any thread, and then once more in the event
loop; the second time does nothing where the event is set already. A sender that looks at the event
just before the first time, and begins to wait just after, is woken by neither: the browser gets
nothing more (`AsyncMessageBuffer.push`). So each message wakes whoever waits.
"""

from __future__ import annotations

import contextlib
from typing import Any


def wake_always(buffer: Any) -> None:
    """Have each message of a buffer (`viser.infra.AsyncMessageBuffer`) wake those who wait."""
    push = buffer.push

    def wake() -> None:
        for waiter in buffer.message_event._waiters:
            if not waiter.done():
                waiter.set_result(True)

    def push_and_wake(message: Any) -> None:
        push(message)
        with contextlib.suppress(RuntimeError):  # the loop has ended
            buffer.event_loop.call_soon_threadsafe(wake)

    buffer.push = push_and_wake
