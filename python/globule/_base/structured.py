"""TOML and JSON texts whose every mistake is a ValueError, also nesting without end."""

from __future__ import annotations

import ast
import json
import os
import sys
from collections.abc import Callable
from typing import Any

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

from .checks import shown

MOST_BYTES = 16 * 2**20  # of a text whose tables are parsed
MOST_OF_ARGUMENTS = 10_000  # letters
_TOO_DEEP = "expected fewer tables and lists inside each other, got too many"
_TOO_LONG = "expected numbers of at most 4,300 digits, got one with more"


def read_text(path: str | os.PathLike[str], most: int = MOST_BYTES) -> str:
    """A text file in UTF-8, of at most `most` bytes. Raises ValueError, whose message lacks the
    path; OSErrors pass unchanged."""
    with open(path, "rb") as file:
        data = file.read(most + 1)
    if len(data) > most:  # a device may never end
        raise ValueError(f"expected at most {most:,} bytes, got more")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        problem = f"expected text in UTF-8, got data that is no text at byte {error.start}"
        raise ValueError(problem) from None


def parse_arguments(what: str, text: str) -> dict[str, Any]:
    """The arguments that a text such as "where='type == 1', scale=0.001" gives to a function; what:
    its name for the message. Raises ValueError."""
    expected = f"{what}: expected arguments such as where='type == 1', scale=0.001, got {shown(text)}"
    if len(text) > MOST_OF_ARGUMENTS:
        raise ValueError(expected)
    try:
        call = ast.parse(f"_({text.strip()}\n)", mode="eval").body
        if not isinstance(call, ast.Call) or not isinstance(call.func, ast.Name) or call.args:
            raise ValueError(expected)
        found = {word.arg: ast.literal_eval(word.value) for word in call.keywords if word.arg}
    except (SyntaxError, ValueError, TypeError, RecursionError, MemoryError):
        raise ValueError(expected) from None
    if len(found) < len(call.keywords):  # **more
        raise ValueError(expected)
    return found


def parse_toml(text: str) -> dict[str, Any]:
    """The tables of a TOML text. Raises ValueError that names the line."""
    return _parsed(tomllib.loads, text)


def parse_json(text: str | bytes) -> Any:
    """What a JSON text holds. Raises ValueError that names the line."""
    return _parsed(json.loads, text)


def _parsed(parse: Callable[[Any], Any], text: str | bytes) -> Any:
    try:
        return parse(text)
    except RecursionError:
        raise ValueError(_TOO_DEEP) from None
    except ValueError as error:
        if type(error) is ValueError and "integer string conversion" in str(error):  # Python's own
            raise ValueError(_TOO_LONG) from None
        raise
