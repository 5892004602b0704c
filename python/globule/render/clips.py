"""Cuts through the medium. No ray meets what a cut takes away; where a cut passes through the
medium, its face shows the blended colors inside."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, TypeAlias

import numpy as np

from .. import _core
from .._base.arrays import VectorLike
from .._base.checks import flag, number, positive, three
from .._base.fixed import Fixed, read_only


@read_only
@dataclass(frozen=True)
class ClipPlane(Fixed):
    """Removes the side to which the normal points: points x with normal · x > offset.

    Args:
        normal: (3,) world, of any length above 0.
        offset: normal · x at the plane.
    """

    normal: VectorLike
    offset: float = 0.0

    def takes(self, points: np.ndarray) -> np.ndarray:
        """Which of the points (N, 3) it takes away."""
        return points @ np.asarray(self.normal, np.float64) > self.offset

    def _check(self) -> None:
        self._packed  # noqa: B018  making it checks the fields

    @cached_property
    def _packed(self) -> Any:
        normal = np.asarray(three("normal", self.normal), np.float64)
        length = float(np.linalg.norm(normal))
        if length == 0:
            raise ValueError(f"normal: expected a direction, got {self.normal!r}")
        offset = number("offset", self.offset) / length
        return _core.Clip(0, False, (normal / length).tolist(), [offset, 0.0, 0.0])


@read_only
@dataclass(frozen=True)
class ClipBox(Fixed):
    """Removes the inside of a box, or with keep=True the outside (a crop).

    Args:
        lo, hi: (3,) lowest and highest corner, world.
        keep: keep the inside instead.
    """

    lo: VectorLike
    hi: VectorLike
    keep: bool = False

    def takes(self, points: np.ndarray) -> np.ndarray:
        """Which of the points (N, 3) it takes away."""
        inside = (points > np.asarray(self.lo)) & (points < np.asarray(self.hi))
        return inside.all(axis=1) != self.keep

    def _check(self) -> None:
        self._packed  # noqa: B018  making it checks the fields

    @cached_property
    def _packed(self) -> Any:
        lo, hi = three("lo", self.lo), three("hi", self.hi)
        if not all(a < b for a, b in zip(lo, hi, strict=True)):
            raise ValueError(f"hi: expected above lo in each axis, got {self.hi!r}")
        return _core.Clip(1, flag("keep", self.keep), lo, hi)


@read_only
@dataclass(frozen=True)
class ClipSphere(Fixed):
    """Removes the inside of a ball, or with keep=True the outside.

    Args:
        center: (3,) world.
        radius: world units, > 0.
        keep: keep the inside instead.
    """

    center: VectorLike
    radius: float
    keep: bool = False

    def takes(self, points: np.ndarray) -> np.ndarray:
        """Which of the points (N, 3) it takes away."""
        away = np.linalg.norm(points - np.asarray(self.center), axis=1)
        return (away < self.radius) != self.keep

    def _check(self) -> None:
        self._packed  # noqa: B018  making it checks the fields

    @cached_property
    def _packed(self) -> Any:
        center, radius = three("center", self.center), positive("radius", self.radius)
        return _core.Clip(2, flag("keep", self.keep), center, [radius, 0.0, 0.0])


Clip: TypeAlias = "ClipPlane | ClipBox | ClipSphere"
CLIPS = (ClipPlane, ClipBox, ClipSphere)
