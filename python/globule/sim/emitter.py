"""Fluid that comes in through a disc, at an exact rate."""

from __future__ import annotations

from typing import Any

import numpy as np

from .._base.arrays import VectorLike
from .._base.checks import shown
from .._base.settings import Number, Setting, Switch, settings_of
from .scene_file import Emitter as Table
from .scene_file import check_end
from .steered import Steered

CHECKS = {"rate": Setting(Number(least=0.0)), "on": Setting(Switch())}
LED = 2.0  # spacings, which a particle's neighbors reach
_GIVEN = ("center", "direction", "radius", "rate", "fluid", "start", "end")


class Emitter(Steered):
    """A disc that emits fluid, with the names and limits of a scene's `[[emitters]]`.

    The k-th particle leaves when rate * time reaches k times a particle's volume, spacing cubed:
    after t seconds, the emitter has emitted rate * t / spacing^3 particles, to within 1. Over the
    first two spacings they keep their velocity, whatever is before them: they push it, as a piston
    does. A program may change `on` and `rate` at any time.

    Args:
        center: (3,) m.
        direction: (3,), direction of the flow.
        radius: m.
        rate: m³/s.
        fluid: name of the fluid's phase; None: the first fluid.
        start, end: s, when the emitter runs; None: without end.

    Raises:
        ValueError: a value that the scene's check refuses.
    """

    def __init__(
        self,
        center: VectorLike,
        direction: VectorLike,
        radius: float,
        rate: float,
        fluid: str | None = None,
        start: float = 0.0,
        end: float | None = None,
    ):
        checks = settings_of(Table) | CHECKS

        def checked(name: str, value: Any) -> Any:
            return checks[name].check(value, ("emitter", name))

        checked("direction", direction)
        direction = np.asarray(direction, float)
        self.direction = direction / np.linalg.norm(direction)
        self.center = np.array(checked("center", center))
        self.radius, self.rate = checked("radius", radius), checked("rate", rate)
        self.fluid = fluid
        self.start, self.end = checked("start", start), checked("end", end)
        try:
            check_end(self.start, self.end)
        except ValueError as error:
            raise ValueError(f"emitter.{error}") from None
        self.on = True
        self._emitted = 0
        self._volume = 0.0
        self._places: np.ndarray | None = None
        self._begun = True

    @property
    def emitted(self) -> int:
        """Number of emitted particles."""
        return self._emitted

    def _checks(self) -> dict[str, Any]:
        return CHECKS

    def _at_start(self) -> set[str]:
        return set(settings_of(Table))

    def _state(self) -> dict[str, Any]:
        """All of it, as JSON holds it."""
        facts = {k: v for k, v in vars(self).items() if k not in ("_places", "_begun", "_label")}
        return {k: v.tolist() if isinstance(v, np.ndarray) else v for k, v in facts.items()}

    def _go_on(self, state: dict[str, Any]) -> None:
        """From what `_state` gave. Raises ValueError for anything else, KeyError for a part."""
        good = Emitter(*(state[name] for name in _GIVEN))
        if not isinstance(good.fluid, (str, type(None))):
            raise ValueError(f"fluid: expected a name, got {shown(good.fluid)}")
        emitted, volume = state["_emitted"], state["_volume"]
        Number(0.0, 2.0**31)(emitted)
        Number(0.0)(volume)
        vars(self).update({name: vars(good)[name] for name in _GIVEN}, on=Switch()(state["on"]),
                          direction=np.array(state["direction"], float), _emitted=int(emitted),
                          _volume=float(volume), _places=None)  # fmt: skip

    def _runs(self, time: float) -> bool:
        ended = self.end is not None and time >= self.end
        return self.on and self.rate > 0 and time >= self.start and not ended

    def _inlet(self, spacing: float) -> list[float]:
        """Where its fluid keeps its velocity and pushes what is before it, as the core takes it:
        center, direction, radius and length."""
        return [*self.center, *self.direction, self.radius + spacing, LED * spacing]

    def emit(self, spacing: float, time: float, dt: float) -> tuple[np.ndarray, np.ndarray]:
        """The particles emitted during a step, at their positions at the end of the step.

        Args:
            spacing: of particles, m.
            time: s, when the step begins.
            dt: its length, s.

        Returns:
            positions (M, 3) float32 m and velocities (M, 3) float32 m/s.
        """
        none = np.empty((0, 3), np.float32)
        if not self._runs(time):
            return none, none
        if self._places is None:
            self._places = self._disc(spacing)
        before, each = self._volume, spacing**3
        self._volume += self.rate * dt
        first = int(np.floor(before / each + 1e-9)) + 1
        last = int(np.floor(self._volume / each + 1e-9))
        k = np.arange(first, last + 1)
        n = len(self._places)
        speed = self.rate / (n * spacing * spacing)
        age = (self._volume - k * each) / self.rate
        positions = self._places[k % n] + self.direction * (speed * age)[:, None]
        velocities = np.tile(np.asarray(speed * self.direction, np.float32), (len(k), 1))
        self._emitted += len(k)
        return np.ascontiguousarray(positions, np.float32), velocities

    def _disc(self, d: float) -> np.ndarray:
        """A square lattice in the disc, row by row there and back, so that those that leave one
        after the other are neighbors."""
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
