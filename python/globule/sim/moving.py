"""Boundaries that follow poses, rigid bodies, and regions that take fluid out."""

from __future__ import annotations

from typing import Any

import numpy as np

from .._base.interrupts import whole


class Moving:
    """The part of `Simulation` that is about what moves as a whole, and about sinks."""

    @whole
    def move_boundary(self, phase: str, pose: Any) -> None:
        """Where a boundary's phase will be at the end of the next step: (4, 4) world_from_body.

        The first call says where it is now.
        """
        which = self._phase(phase)
        numbers = np.asarray(pose, float).reshape(16).tolist()
        if which in self._moving:
            self._core.move_to(which, numbers)
        else:
            self._core.capture(which, numbers)
            self._moving.add(which)

    @whole
    def make_rigid(
        self, phase: str, density: float, velocity: Any = (0, 0, 0), spin: Any = (0, 0, 0)
    ) -> None:
        """The particles of a phase of kind "rigid" become one body, which they fill."""
        which = self._phase(phase)
        if self.phases[phase].kind != "rigid":
            raise ValueError(f"phase: expected one of kind rigid, got {phase!r}")
        at = self.positions[self.phase == which].astype(float)
        if len(at) == 0:
            raise ValueError(f"phase: expected particles of {phase!r} to be added first")
        each = density * self.settings.spacing**3
        center = at.mean(0)
        x = at - center
        # A particle's own cube keeps the inertia of a few from being singular.
        own = each * self.settings.spacing**2 / 6
        inertia = np.eye(3) * (each * (x**2).sum() + own * len(x)) - each * x.T @ x
        numbers = np.concatenate([center, inertia.ravel(), velocity, spin]).astype(float)
        self._core.make_body(which, each * len(at), numbers.tolist())

    @whole
    def body(self, phase: str) -> dict[str, np.ndarray]:
        """A rigid body's center, velocity, spin (3,) and rotation (3, 3), world."""
        v = np.array(self._core.body(self._phase(phase)))
        return {
            "center": v[:3],
            "velocity": v[3:6],
            "spin": v[6:9],
            "rotation": v[9:].reshape(3, 3),
        }

    @whole
    def set_sinks(self, sinks: Any) -> None:
        """Regions that take fluid out: (lo, hi) corners of a box, (center, radius) of a ball, …"""
        packed = []
        for a, b in sinks:
            ball = np.ndim(b) == 0
            lo, hi, center = (np.zeros(3), np.zeros(3), a) if ball else (a, b, np.zeros(3))
            packed.append([*map(float, (*lo, *hi, *center)), float(b) if ball else 0.0])
        if len(packed) > 32:
            raise ValueError(f"sinks: expected at most 32, got {len(packed)}")
        self._sinks = packed
        self._core.set_sinks(packed)
