"""Parsers of the words after a flag; argparse puts the flag's name before their errors."""

from __future__ import annotations

import argparse
import os
from collections.abc import Callable
from typing import Any

from ..render.clips import ClipBox, ClipPlane, ClipSphere
from ..render.presets import GROUNDS
from . import look
from .shared import number, numbers


def pixel(text: str) -> tuple[int, int]:
    """COLUMN,ROW."""
    words = text.split(",")
    if len(words) != 2 or not all(word.isdecimal() and len(word) < 10 for word in words):
        raise argparse.ArgumentTypeError(f"expected COLUMN,ROW, got {text!r}")
    return int(words[0]), int(words[1])


def plane(text: str) -> ClipPlane:
    """NX,NY,NZ,D."""
    *normal, offset = numbers(text, "NX,NY,NZ,D")
    return _checked(ClipPlane, normal, offset)


def box(text: str, keep: bool = False) -> ClipBox:
    """X0,Y0,Z0,X1,Y1,Z1."""
    values = numbers(text, "X0,Y0,Z0,X1,Y1,Z1")
    return _checked(ClipBox, values[:3], values[3:], keep)


def ball(text: str, keep: bool = False) -> ClipSphere:
    """X,Y,Z,R."""
    *center, radius = numbers(text, "X,Y,Z,R")
    return _checked(ClipSphere, center, radius, keep)


def ground(text: str) -> float | str:
    """A height, or the name of a ground."""
    return text if text in ("none", *GROUNDS) else number(text)


def beside(text: str) -> tuple[str, look.Color | None]:
    """FILE or FILE:COLOR."""
    path, _, word = text.rpartition(":")
    try:
        return path or text, look.color(word) if path else None
    except argparse.ArgumentTypeError:
        if os.path.exists(path) and not os.path.exists(text):
            expected = "FILE or FILE:COLOR, COLOR being R,G,B or V or #rrggbb"
            raise argparse.ArgumentTypeError(f"expected {expected}, got {text!r}") from None
        return text, None


def _checked(clip: Callable[..., Any], *values: Any) -> Any:
    try:
        return clip(*values)
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error)) from None
