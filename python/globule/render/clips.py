"""Cuts through the medium. What they take away is gone for every ray; where they pass through the
medium the cut face shows the blended colours inside."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from .. import _core
from .._base.checks import number, three
from .._base.fixed import Fixed


@dataclass(frozen=True)
class ClipPlane(Fixed):
    """Takes away what lies on the normal's side: points x with normal · x > offset."""

    normal: Any
    offset: float = 0.0

    def takes(self, points: np.ndarray) -> np.ndarray:
        """Which of the points (N, 3) it takes away."""
        return points @ np.asarray(self.normal, np.float64) > self.offset

    @cached_property
    def _packed(self) -> Any:
        normal = np.asarray(three("normal", self.normal), np.float64)
        length = float(np.linalg.norm(normal))
        if length == 0:
            raise ValueError(f"normal: expected a direction, got {self.normal!r}")
        offset = number("offset", self.offset) / length
        return _core.Clip(0, False, (normal / length).tolist(), [offset, 0.0, 0.0])


@dataclass(frozen=True)
class ClipBox(Fixed):
    """Takes away what lies inside the box [lo, hi], or with keep=True what lies outside: a crop."""

    lo: Any
    hi: Any
    keep: bool = False

    def takes(self, points: np.ndarray) -> np.ndarray:
        """Which of the points (N, 3) it takes away."""
        inside = (points > np.asarray(self.lo)) & (points < np.asarray(self.hi))
        return inside.all(axis=1) != self.keep

    @cached_property
    def _packed(self) -> Any:
        lo, hi = three("lo", self.lo), three("hi", self.hi)
        if not all(a < b for a, b in zip(lo, hi, strict=True)):
            raise ValueError(f"hi: expected above lo in each axis, got {self.hi!r}")
        return _core.Clip(1, bool(self.keep), lo, hi)


@dataclass(frozen=True)
class ClipSphere(Fixed):
    """Takes away what lies inside the ball, or with keep=True what lies outside."""

    center: Any
    radius: float
    keep: bool = False

    def takes(self, points: np.ndarray) -> np.ndarray:
        """Which of the points (N, 3) it takes away."""
        away = np.linalg.norm(points - np.asarray(self.center), axis=1)
        return (away < self.radius) != self.keep

    @cached_property
    def _packed(self) -> Any:
        radius = number("radius", self.radius, 0.0)
        if radius == 0:
            raise ValueError("radius: expected a positive number, got 0")
        return _core.Clip(2, bool(self.keep), three("center", self.center), [radius, 0.0, 0.0])
