"""Images to a browser through viser."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from viser import _messages

from .pacer import Plan

ACKNOWLEDGED = "globule-picture"


class ViserSink:
    """The sink of one browser.

    A question follows each image. The browser answers in order, so the answer tells that the image
    has arrived.

    Args:
        client: `viser.ClientHandle`.
        acknowledge: called with the number of each image that has arrived.
    """

    def __init__(self, client: Any, acknowledge: Callable[[int], None]):
        self.client = client
        self._connection = client._websock_connection
        self._acknowledge = acknowledge
        self._connection.register_handler(_messages.LocalStorageGetItemResponseMessage, self._answered)

    def send(self, number: int, data: bytes, plan: Plan) -> None:
        """Send one JPEG; nothing happens after the browser has left."""
        if self._connection.get_message_buffer().done:
            return  # the browser has left
        self._connection.queue_message(_messages.BackgroundImageMessage("jpeg", data, None))
        self._connection.queue_message(_messages.LocalStorageGetItemRequestMessage(ACKNOWLEDGED, f"globule-{number}"))
        self.client.flush()

    def error(self, message: str) -> None:
        """Show a message as a notification of the page."""
        if self._connection.get_message_buffer().done:
            return
        self.client.add_notification("Not possible", message, color="red", auto_close_seconds=12.0)

    def _answered(self, client_id: int, message: Any) -> None:
        name, _, number = message.request_uuid.partition("-")
        if name == "globule" and number.isdecimal():
            self._acknowledge(int(number))
