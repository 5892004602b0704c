"""Memory of this process and this machine, and the limits of what a file may ask for."""

from __future__ import annotations

import ctypes
import math
import os
from dataclasses import dataclass
from typing import Any

from .checks import number

RATIO = 200.0  # default: bytes that a file may unpack to, for each of its own
GIGABYTE = 1e9
SMALL = 1 << 26  # bytes that there always are, where nobody has set a limit


@dataclass
class _Limits:
    memory: float | None = None  # bytes
    ratio: float = RATIO


_limits = _Limits()


def set_limits(memory: float | None = None, ratio: float = RATIO) -> dict[str, Any]:
    """Set what a file may ask for, in the whole program; readers check it before they unpack.

    A reader compares the size that the header of a file claims with both limits, and raises
    FormatError if the size is above one of them. A simulation compares the memory that its
    particles need with `memory`.

    Args:
        memory: most memory that one file or scene may need, bytes; None: the memory that is free.
        ratio: most bytes that a compressed file may unpack to, for each byte of the file. Every
            file may unpack to 64 MiB.

    Returns:
        The limits before, as `set_limits` takes them: `gb.set_limits(**before)`.

    Raises:
        TypeError, ValueError: anything but numbers above 0, or a ratio below 1.
    """
    before = limits()
    if memory is not None:
        memory = number("memory", memory, 1.0)
    _limits.memory, _limits.ratio = memory, number("ratio", ratio, 1.0)
    return before


def limits() -> dict[str, Any]:
    """The limits, as `set_limits` takes them."""
    return {"memory": _limits.memory, "ratio": _limits.ratio}


def largest_ratio() -> float:
    """The `ratio` of `set_limits`."""
    return _limits.ratio


def room() -> float:
    """Bytes that a file or scene may need: those that are free, and at most the limit that was
    set; infinite where neither is known."""
    free = free_bytes() or math.inf
    return free if _limits.memory is None else min(free, _limits.memory)


def resident_bytes() -> int:
    """Bytes of main memory in use; 0 where the system does not say."""
    try:
        with open("/proc/self/statm", encoding="utf-8") as file:
            return int(file.read().split()[1]) * os.sysconf("SC_PAGE_SIZE")
    except (OSError, ValueError, IndexError):
        return 0


def free_bytes() -> int:
    """Bytes of main memory that programs can still take; 0 where the system does not say. In a
    container, its own limit counts as well."""
    try:
        with open("/proc/meminfo", encoding="utf-8") as file:
            found = dict(line.split(":") for line in file)
        free = 1024 * int(found["MemAvailable"].split()[0])
    except (OSError, ValueError, KeyError, IndexError):
        return 0
    return max(1, int(min(free, _free_in_container(), _free_addresses())))


def _free_in_container() -> float:
    """What the control group (version 2) of this process has left, its caches included."""
    try:
        with open("/sys/fs/cgroup/memory.max", encoding="utf-8") as file:
            most = int(file.read())
        with open("/sys/fs/cgroup/memory.current", encoding="utf-8") as file:
            taken = int(file.read())
        with open("/sys/fs/cgroup/memory.stat", encoding="utf-8") as file:
            cached = dict(line.split() for line in file)
        return most - taken + int(cached["inactive_file"])
    except (OSError, ValueError, KeyError):  # no such group, or one without a limit: "max"
        return math.inf


def _free_addresses() -> float:
    """What `ulimit -v` leaves."""
    try:
        import resource

        most = resource.getrlimit(resource.RLIMIT_AS)[0]
        if most == resource.RLIM_INFINITY:
            return math.inf
        with open("/proc/self/statm", encoding="utf-8") as file:
            return most - int(file.read().split()[0]) * os.sysconf("SC_PAGE_SIZE")
    except (ImportError, OSError, ValueError, IndexError):
        return math.inf


def trim() -> None:
    """Give freed memory back to the system, where the C library keeps it for later."""
    own = getattr(ctypes.CDLL(None), "malloc_trim", None)  # of glibc alone
    if own is not None:
        own(0)


def always_fits(size: float) -> bool:
    """Whether so few bytes are there without asking."""
    return size <= SMALL and limits()["memory"] is None
