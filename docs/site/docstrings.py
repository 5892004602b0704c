"""Lists of fields in docstrings, one `name: text` or `name  text` a line, become Markdown lists."""

from __future__ import annotations

import re

import griffe

FIELD = re.compile(r"(\w+(?:, \w+)*)(?:: | {2,})(\S.*)")


def listed(text: str) -> str:
    """A docstring in which every paragraph that is such a list is one for Markdown, too."""
    paragraphs = re.split(r"\n[ \t]*\n", text)
    return "\n\n".join(_listed(paragraph) for paragraph in paragraphs)


def _listed(paragraph: str) -> str:
    items: list[list[str]] = []
    for line in paragraph.splitlines():
        field = FIELD.fullmatch(line)
        if field:
            names = ", ".join(f"`{name}`" for name in field[1].split(", "))
            items.append([f"- {names}: {field[2]}"])
        elif items and line.startswith("  "):
            items[-1].append("  " + line.strip())
        else:
            return paragraph
    return "\n".join(line for item in items for line in item)


class FieldLists(griffe.Extension):
    """Applied to every docstring that is read."""

    def on_instance(self, *, obj: griffe.Object, **_: object) -> None:
        """One class, function or module."""
        if obj.docstring:
            obj.docstring.value = listed(obj.docstring.value)
