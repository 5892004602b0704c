"""TOML and JSON texts whose every mistake is a ValueError, also nesting without end."""

from __future__ import annotations

import json
import sys
from typing import Any

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

_TOO_DEEP = "expected fewer tables and lists inside each other, got too many"


def parse_toml(text: str) -> dict[str, Any]:
    """The tables of a TOML text. Raises ValueError that names the line."""
    try:
        return tomllib.loads(text)
    except RecursionError:
        raise ValueError(_TOO_DEEP) from None


def parse_json(text: str | bytes) -> Any:
    """What a JSON text holds. Raises ValueError that names the line."""
    try:
        return json.loads(text)
    except RecursionError:
        raise ValueError(_TOO_DEEP) from None
