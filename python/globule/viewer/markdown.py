"""Text as Markdown, in which names out of files must not mean anything."""

from __future__ import annotations

import re

from .._base.terminal import escaped


def plain(text: object) -> str:
    """A text that shows as it is: each sign but letters, digits and blanks as its number."""
    return "".join(c if c.isalnum() or c == " " else f"&#{ord(c)};" for c in escaped(str(text)))


def table(rows: dict[str, str]) -> str:
    """Names and values as a table."""
    lines = (f"| {plain(name)} | {plain(value)} |" for name, value in rows.items())
    return "\n".join(["| | |", "|---|---|", *lines])


def code(text: str, language: str) -> str:
    """A block of code, whose end is longer than any that stands in it."""
    fence = max(["``", *re.findall("`+", text)], key=len) + "`"
    return f"{fence}{language}\n{text}\n{fence}"
