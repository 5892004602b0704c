"""Memory of this process and this machine."""

from __future__ import annotations

import os


def resident_bytes() -> int:
    """Bytes of main memory in use; 0 where the system does not say."""
    try:
        with open("/proc/self/statm") as file:
            return int(file.read().split()[1]) * os.sysconf("SC_PAGE_SIZE")
    except (OSError, ValueError, IndexError):
        return 0


def free_bytes() -> int:
    """Bytes of main memory that programs can still take; 0 where the system does not say."""
    try:
        with open("/proc/meminfo") as file:
            found = dict(line.split(":") for line in file)
        return 1024 * int(found["MemAvailable"].split()[0])
    except (OSError, ValueError, KeyError, IndexError):
        return 0
