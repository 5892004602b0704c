"""Kinds of settings: how a value from a page or a file is checked, and how its widget looks."""

from __future__ import annotations

import dataclasses
from typing import Any

from .._base.checks import shown


def real(default: float | None, least: float, most: float, label: str, hint: str = "") -> Any:
    """A number in [least, most]; where the default is None, None means "automatic"."""
    return _field(default, kind="real", least=least, most=most, label=label, hint=hint)


def whole(default: int, least: int, most: int, label: str, hint: str = "") -> Any:
    """A whole number in [least, most]."""
    return _field(default, kind="whole", least=least, most=most, label=label, hint=hint)


def switch(default: bool, label: str, hint: str = "") -> Any:
    """On or off."""
    return _field(default, kind="switch", label=label, hint=hint)


def choice(default: str, options: tuple[str, ...], label: str, hint: str = "") -> Any:
    """One of several names; without options any text."""
    return _field(default, kind="choice", options=options, label=label, hint=hint)


def triple(default: Any, least: float, most: float, label: str, hint: str = "") -> Any:
    """Three numbers in [least, most]."""
    return _field(default, kind="triple", least=least, most=most, label=label, hint=hint)


def _field(default: Any, **facts: Any) -> Any:
    return dataclasses.field(default=default, metadata=facts)


def checked(field: dataclasses.Field, value: Any) -> Any:
    """The value in the type of its field. Raises ValueError for any other value."""
    facts, name = field.metadata, field.name
    kind = facts["kind"]
    if value is None and field.default is None:
        return None
    if kind == "switch":
        if isinstance(value, bool):
            return value
        raise ValueError(f"{name}: expected true or false, got {shown(value)}")
    if kind == "choice":
        options = facts["options"]
        if isinstance(value, str) and len(value) <= 200 and (not options or value in options):
            return value
        expected = f"one of {', '.join(options)}" if options else "a name"
        raise ValueError(f"{name}: expected {expected}, got {shown(value)}")
    if kind == "triple":
        try:
            x, y, z = value
        except (TypeError, ValueError):
            raise ValueError(f"{name}: expected three numbers, got {shown(value)}") from None
        return tuple(_number(name, v, facts) for v in (x, y, z))
    number = _number(name, value, facts)
    if kind == "whole":
        if number != int(number):
            raise ValueError(f"{name}: expected a whole number, got {shown(value)}")
        return int(number)
    return number


def _number(name: str, value: Any, facts: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise ValueError(f"{name}: expected a number, got {shown(value)}")
    if not facts["least"] <= value <= facts["most"]:  # a whole number may be beyond all floats
        raise ValueError(
            f"{name}: expected {facts['least']:g} to {facts['most']:g}, got {shown(value)}"
        )
    return float(value)
