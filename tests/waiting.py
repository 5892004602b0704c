"""Waits for conditions, with a time limit; tests never sleep for a fixed time."""

import os
import time
from collections.abc import Callable
from typing import Any

PATIENCE = float(os.environ.get("GLOBULE_TEST_PATIENCE", 300))  # s; it only ends what hangs


def until(true: Callable[[], Any], what: str = "", pause: float = 0.02) -> Any:
    """Wait for something to become true, and give it. pause: s between two looks."""
    deadline = time.monotonic() + PATIENCE
    while time.monotonic() < deadline:
        found = true()
        if found:
            return found
        time.sleep(pause)
    raise AssertionError(f"waited {PATIENCE:g} s in vain {what}")


class Waits:
    """The clock of a client of OpenIGTLink, in the place of its module `time`. It passes only while
    no server answers: a stream ends after its last message, on a machine of any speed."""

    def __init__(self) -> None:
        self.now = 0.0

    def monotonic(self) -> float:
        return self.now

    def sleep(self, seconds: float) -> None:
        self.now += seconds
