"""The one rule for how much a file may unpack to, which every reader asks before it unpacks.

A header can claim any size. Its claim is compared with the file's own length and with the memory
that is free (`gb.set_limits`), so that a small file cannot take all memory, nor all time.
"""

from __future__ import annotations

import os
from typing import Any

import numpy as np

from .._base.memory import largest_ratio, room
from .errors import bad

ALWAYS = 64 * 2**20  # bytes that a file may unpack to, whatever its length


def check_size(path: Any, where: str, size: float, held: int, peak: float = 1.0) -> None:
    """Refuse what is too large for its file, or for memory.

    Args:
        path: of the file.
        where: the place in the file that claims the size.
        size: bytes that the file claims to unpack to.
        held: bytes that hold them.
        peak: bytes of memory that the reader takes at its peak, for each of `size`.

    Raises FormatError.
    """
    most = max(largest_ratio() * held, ALWAYS)
    if size > most:
        expected = f"expected at most {largest_ratio():g} times the {held:,} bytes of the file"
        advice = "if the file is sound, raise --max-ratio or gb.set_limits(ratio=…)"
        raise bad(path, where, f"{expected}, got a claim of {size:,.0f} bytes; {advice}")
    check_memory(path, where, peak * size)


def bytes_of(array: np.ndarray) -> memoryview:
    """The memory of a contiguous array, to fill."""
    flat: Any = array.reshape(-1).view(np.uint8)
    return memoryview(flat)


def whole_file(path: Any, peak: float = 1.0) -> bytes:
    """All bytes of a file, if memory has `peak` times as many. Raises FormatError, OSError."""
    with open(path, "rb") as file:
        size = os.fstat(file.fileno()).st_size
        check_memory(path, "", peak * size)
        return file.read(size)


def whole_text(path: Any) -> str:
    """The text of a table in UTF-8, if memory has room for it as rows of numbers. Raises
    FormatError, UnicodeDecodeError, OSError."""
    data = whole_file(path, 7.0)
    check_text(path, data)
    return data.decode("utf-8-sig")


def check_memory(path: Any, where: str, needed: float) -> None:
    """Refuse what needs more memory than may be taken. Raises FormatError."""
    free = room()
    if needed > free:
        expected = f"expected data that fit in {_gigabytes(free)} of memory"
        got = f"data that need {_gigabytes(needed)}"
        raise bad(path, where, f"{expected} (--max-memory, gb.set_limits), got {got}")


def check_text(path: Any, data: bytes) -> None:
    """Refuse a text that takes more memory, as lines and numbers, than there is.

    Measured: a line is an object of some 60 bytes beside its letters, and a number is 8 bytes
    where its text may be two letters. Raises FormatError.
    """
    if 137.0 * len(data) > room():  # with lines of nothing; to count them takes a while
        check_memory(path, "", 7.0 * len(data) + 130.0 * data.count(b"\n"))


def _gigabytes(size: float) -> str:
    return f"{size / 1e9:.3g} GB"
