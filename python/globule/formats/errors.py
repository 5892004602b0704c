"""The error of every reader."""

from __future__ import annotations

import contextlib
from collections.abc import Iterable, Iterator, Sequence
from typing import Any

_MOST_ODD = 3  # letters of a text that cannot be printed


class FormatError(ValueError):
    """A file cannot be read: one line names the file, the place, the expected and the given
    content."""


def bad(path: Any, where: str, problem: str) -> FormatError:
    """A FormatError `path: where: problem`; `where` may be empty."""
    # Either may quote the file: one line, of bounded length, whatever is in it.
    parts = [" ".join(str(path).splitlines()), *(" ".join(part.split())[:200] for part in (where, problem))]
    return FormatError(": ".join(part for part in parts if part))


@contextlib.contextmanager
def faults(path: Any, where: str = "", expected: str = "", refused: Any = ValueError) -> Iterator[None]:
    """Errors in this block, which say what is wrong with a file, become a FormatError at the place.
    expected: what its message begins with; refused: their classes. A FormatError among others says
    the place itself."""
    try:
        yield
    except refused as error:
        if isinstance(error, FormatError) and refused is not FormatError:
            raise
        raise bad(path, where, f"expected {expected}, got {error}" if expected else str(error)) from None


def require_different(path: Any, where: str, names: Sequence[str]) -> None:
    """Raises a FormatError where a name stands twice."""
    if twice := [name for k, name in enumerate(names) if name in names[:k]]:
        raise bad(path, where, f"expected different names, got {shown(twice[0])} twice")


def shown(text: str | bytes, most: int = 40) -> str:
    """A piece of a file, safe and short enough for an error message."""
    if isinstance(text, bytes):
        text = text.decode("latin-1")
    if sum(map(_is_odd, text[:40])) > _MOST_ODD:
        return "binary data"
    return repr(text if len(text) <= most else text[: most - 3] + "...")


def names_of(names: Iterable[str]) -> str:
    """The names of a file's columns, as many as have room in an error message."""
    return shown(", ".join(names), 140)


def _is_odd(letter: str) -> bool:
    return letter == "\ufffd" or not (letter.isprintable() or letter.isspace())
