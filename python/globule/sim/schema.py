"""Kinds of quantities in a scene, in SI units. Their limits are some orders of magnitude beyond
what occurs: they show slips and keep values within single precision."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from .._base.checks import shown
from .._base.settings import Each, Number, Problem, Text, Vector


class SceneError(ValueError):
    """A mistake in a scene. The message names the file and the line where there is a file, the
    key, what was expected and what came."""


NAME = Text()
POSITIVE = Number(above=0.0, most=1e30)
SHARE = Number(0.0, 1.0)
PLACE = Vector(least=-1e6, most=1e6)
VELOCITY = Vector(least=-1e5, most=1e5)
DENSITY = Number(1e-3, 1e6)
VISCOSITY = Number(0.0, 1e9)
TENSION = Number(0.0, 1e3)
FRICTION = Number(0.0, 100.0)
POINTS = Each(PLACE, least=2)


class Rising(Vector):
    """Two numbers of at least 0, the lower one first."""

    def __init__(self) -> None:
        super().__init__(2, least=0.0)

    def _take(self, value: Any) -> Any:
        lo, hi = super()._take(value)
        if lo >= hi:
            raise Problem((), f"expected the lower one first, got {shown(value)}")
        return lo, hi


def exactly_one(table: Any, names: Sequence[str], least: int = 1) -> str:
    """The one of these keys that is given, or "" where none may be; else a ValueError."""
    given = [name for name in names if getattr(table, name) is not None]
    if not least <= len(given) <= 1:
        raise ValueError(f"expected one of {', '.join(names)}, got {' and '.join(given) or 'none'}")
    return "".join(given)
