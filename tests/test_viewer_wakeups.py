"""Messages to a browser wake the one who sends them, whatever comes between."""

import asyncio
import collections
import threading

import pytest
from waiting import PATIENCE

pytest.importorskip("viser")

from globule.viewer.wakeups import wake_always
from viser import _messages
from viser.infra._async_message_buffer import AsyncMessageBuffer


class Late(collections.deque):
    """Of those who wait for an event: one comes while another thread sets it."""

    between = None

    def append(self, waiter):
        between, self.between = self.between, None
        if between:
            thread = threading.Thread(target=between)
            thread.start()
            thread.join()
        super().append(waiter)


@pytest.mark.parametrize("persistent", [False, True])
def test_a_message_that_comes_between_looking_and_waiting(persistent):
    async def first_window():
        buffer = AsyncMessageBuffer(asyncio.get_running_loop(), persistent)
        wake_always(buffer)
        message = _messages.RunJavascriptMessage("")
        buffer.message_event._waiters = waiters = Late()
        waiters.between = lambda: buffer.push(message)
        windows = buffer.window_generator(0)
        try:
            return await asyncio.wait_for(anext(windows), PATIENCE), message
        finally:
            await windows.aclose()

    window, message = asyncio.run(first_window())
    assert window == [message]
