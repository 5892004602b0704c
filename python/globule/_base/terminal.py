"""What goes to a terminal, which must not obey what stands in files and names."""

from __future__ import annotations

from collections.abc import Iterable
from numbers import Integral
from typing import Any


def escaped(text: str, but: str = "") -> str:
    """A text with its control characters as Python writes them; but: characters that stay."""
    return "".join(c if c.isprintable() or c in but else repr(c)[1:-1] for c in text)


def plain_number(value: Any, digits: int = 6) -> str:
    """A number for people: a whole one with all of its digits, as ids need them."""
    return f"{value}" if isinstance(value, Integral) else f"{value:.{digits}g}"


def place_text(place: Iterable[float]) -> str:
    """X,Y,Z as flags take it, with the digits of float64."""
    return ",".join(f"{x + 0.0:.15g}" for x in place)


class Plain:
    """A text stream that escapes control characters, but for line ends and tabs.

    Args:
        stream: that it writes to; all else is this stream's.
    """

    def __init__(self, stream: Any):
        self._stream = stream

    def write(self, text: str) -> int:
        """Write a text."""
        self._stream.write(escaped(text, "\n\t"))
        return len(text)

    def writelines(self, lines: Any) -> None:
        """Write several texts."""
        for line in lines:
            self.write(line)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)
