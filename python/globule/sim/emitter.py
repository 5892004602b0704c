"""Fluid that comes in through a disc, at an exact rate."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from ..arrays import address

if TYPE_CHECKING:
    from ..simulate import Simulation


class Emitter:
    """A disc that fluid comes out of: `rate` m^3/s through `radius` m at `center`, along `direction`.

    The k-th particle leaves when rate * time reaches k times a particle's volume, spacing cubed: after t
    seconds there are rate * t / spacing^3 of them, to within one. `on` and `rate` may be changed at
    any time; `emitted` counts.
    """

    def __init__(
        self, center: Any, direction: Any, radius: float, rate: float, phase: str | None = None
    ):
        self.center = np.asarray(center, float)
        direction = np.asarray(direction, float)
        self.direction = direction / np.linalg.norm(direction)
        self.radius = float(radius)
        self.rate = float(rate)
        self.phase = phase
        self.on = True
        self.emitted = 0
        self._volume = 0.0
        self._places: np.ndarray | None = None

    def _emit(self, simulation: Simulation, dt: float) -> None:
        """What leaves during the next step, placed where it will be at its end."""
        if not self.on or self.rate <= 0:
            return
        d = simulation.settings.spacing
        if self._places is None:
            self._places = self._disc(d)
        before, each = self._volume, d**3
        self._volume += self.rate * dt
        first = int(np.floor(before / each + 1e-9)) + 1
        last = int(np.floor(self._volume / each + 1e-9))
        k = np.arange(first, last + 1)
        if len(k) == 0:
            return
        n = len(self._places)
        speed = self.rate / (n * d * d)
        age = (self._volume - k * each) / self.rate
        positions = self._places[k % n] + self.direction * (speed * age)[:, None]
        positions = np.ascontiguousarray(positions, np.float32)
        velocities = np.tile(np.asarray(speed * self.direction, np.float32), (len(k), 1))
        which = simulation._phase(self.phase)
        simulation._core.emit(len(k), address(positions), address(velocities), which)
        self.emitted += len(k)

    def _disc(self, d: float) -> np.ndarray:
        """A square lattice in the disc, row by row there and back, so that those that leave one after
        the other are neighbours."""
        helper = np.eye(3)[np.argmin(np.abs(self.direction))]
        u = np.cross(self.direction, helper)
        u /= np.linalg.norm(u)
        v = np.cross(self.direction, u)
        m = int(self.radius / d) + 1
        rows = []
        for row, j in enumerate(range(-m, m + 1)):
            i = np.arange(-m, m + 1)[:: 1 if row % 2 == 0 else -1]
            inside = (i * d) ** 2 + (j * d) ** 2 <= max(self.radius - d / 2, 0.0) ** 2 + 1e-12
            rows.append(i[inside, None] * d * u + j * d * v)
        return self.center + np.concatenate(rows)
