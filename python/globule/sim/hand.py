"""A hand at a haptic device, without a device."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from .._base.checks import number, positive
from .arrays import vector


class Hand:
    """A test client of `HapticLoop`: a mass that a spring and a damper pull along a path.

    The mass is that of device and hand. Between two calls of `read` the force is constant and the
    motion exact.

    Args:
        path: where the hand wants to be after t seconds: path(t) gives (3,) m from the start, or
            None once the hand lets go.
        mass: kg.
        stiffness: of the hand, N/m.
        damping: of the hand, N s/m.
        friction: viscous damping of the device itself, N s/m, which stays when the hand lets go.
        rate: of the loop, Hz.

    Attributes:
        position: (3,) m from the start.
        velocity: (3,) m/s.
        force: (3,) N, the last that the loop gave.
        time: s.

    Raises:
        ValueError: numbers that are not above 0; damping or friction below 0.
    """

    def __init__(
        self, path: Callable[[float], Any], mass: float = 0.1, stiffness: float = 500.0,
        damping: float = 10.0, friction: float = 1.0, rate: float = 1000.0,
    ):  # fmt: skip
        self._path = path
        mass, self._stiffness = positive("mass", mass), positive("stiffness", stiffness)
        damping, friction = number("damping", damping, 0.0), number("friction", friction, 0.0)
        self._period = 1 / positive("rate", rate)
        self._held = _motion(mass, self._stiffness, damping + friction, self._period)
        self._left = _motion(mass, 0.0, friction, self._period)
        self.position, self.velocity, self.force = np.zeros(3), np.zeros(3), np.zeros(3)
        self.time = 0.0

    def read(self) -> np.ndarray:
        """The position after one more period, (3,) m."""
        goal = self._path(self.time)
        held = goal is not None
        pull = self._stiffness * np.asarray(vector("path", goal)) if held else 0.0
        motion = self._held if held else self._left
        self.position, self.velocity = motion[:, :2] @ [self.position, self.velocity] + motion[
            :, 2:
        ] * (self.force + pull)
        self.time += self._period
        return self.position

    def write(self, force: np.ndarray, torque: np.ndarray) -> None:
        """Take the force of the next period, (3,) N. Hands have no rotation."""
        self.force = force


def _motion(mass: float, stiffness: float, damping: float, period: float) -> np.ndarray:
    """(2, 3): position and velocity after a period, of position, velocity and a constant force."""
    rates = np.array([[0, 1, 0], [-stiffness / mass, -damping / mass, 1 / mass], [0, 0, 0]])
    n = 12  # halvings: the series then needs few terms
    small, out, term = rates * period / 2**n, np.eye(3), np.eye(3)
    for k in range(1, 8):
        term = term @ small / k
        out = out + term
    for _ in range(n):
        out = out @ out
    return out[:2]
