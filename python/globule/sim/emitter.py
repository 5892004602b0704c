"""Fluid that comes in through a disc, at an exact rate."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from .._base.arrays import address
from .scene_file import Emitter as Table
from .schema import number, switch
from .steered import Steered, checked, checks_of

if TYPE_CHECKING:
    from .simulation import Simulation


CHECKS = {"rate": number(least=0.0), "on": switch}


class Emitter(Steered):
    """A disc that fluid comes out of: `rate` m^3/s, `radius` m, at `center`, along `direction`.

    The k-th particle leaves when rate * time reaches k times a particle's volume, spacing cubed:
    after t seconds there are rate * t / spacing^3 of them, to within one. `on` and `rate` may be
    changed at any time; `emitted` counts.
    """

    def __init__(
        self, center: Any, direction: Any, radius: float, rate: float, phase: str | None = None
    ):
        checks = checks_of(Table) | CHECKS
        checked("emitter", "direction", checks["direction"], direction)
        direction = np.asarray(direction, float)
        self.direction = direction / np.linalg.norm(direction)
        self.center = np.array(checked("emitter", "center", checks["center"], center))
        self.radius = checked("emitter", "radius", checks["radius"], radius)
        self.rate = checked("emitter", "rate", checks["rate"], rate)
        self.phase = phase
        self.on = True
        self._emitted = 0
        self._volume = 0.0
        self._places: np.ndarray | None = None
        self._begun = True

    @property
    def emitted(self) -> int:
        """Particles that came out of it."""
        return self._emitted

    def _checks(self) -> dict[str, Any]:
        return CHECKS

    def _at_start(self) -> set[str]:
        return {"phase", *checks_of(Table)}

    def _state(self) -> dict[str, Any]:
        """All of it, as JSON holds it."""
        facts = {k: v for k, v in vars(self).items() if k not in ("_places", "_begun", "_label")}
        return {k: v.tolist() if isinstance(v, np.ndarray) else v for k, v in facts.items()}

    def _go_on(self, state: dict[str, Any]) -> None:
        """From what `_state` gave."""
        vars(self).update(state, _places=None)
        for name in ("center", "direction"):
            vars(self)[name] = np.array(state[name])

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
        self._emitted += len(k)

    def _disc(self, d: float) -> np.ndarray:
        """A square lattice in the disc, row by row there and back, so that those that leave one
        after the other are neighbours."""
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
