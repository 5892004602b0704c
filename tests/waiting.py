"""Waits for conditions, with a time limit; tests never sleep for a fixed time."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from typing import Any

PATIENCE = float(os.environ.get("GLOBULE_TEST_PATIENCE", 300))  # s; it only ends what hangs


def until(true: Callable[[], Any], what: str = "") -> Any:
    """Wait for something to become true, and give it."""
    deadline = time.monotonic() + PATIENCE
    while time.monotonic() < deadline:
        found = true()
        if found:
            return found
        time.sleep(0.02)  # between two looks
    raise AssertionError(f"waited {PATIENCE:g} s in vain {what}")
