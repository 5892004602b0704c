"""Memory of this process."""

from __future__ import annotations

import os


def resident_bytes() -> int:
    """Bytes of main memory in use; 0 where the system does not say."""
    try:
        with open("/proc/self/statm") as file:
            return int(file.read().split()[1]) * os.sysconf("SC_PAGE_SIZE")
    except (OSError, ValueError, IndexError):
        return 0
