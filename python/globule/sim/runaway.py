"""A stop where matter runs away: speeds, energies and steps that nothing in the scene can give."""

from __future__ import annotations

import math

import numpy as np

from .limits import steps_of_material
from .part import Part
from .settings import StepReport
from .solver import Solver
from .steer import Steer

MOST = 10.0  # times the given speed: a jet's, or a splash's
LEAST = 1e-3  # of the step in which the given speed goes as far as a step may


class Runaway(Part):
    """The speeds that a simulation's causes can give without tissue, and a stop beyond.

    Each cause gives a speed, the largest so far; their energies add up. A particle may be `MOST`
    times as fast, all of the fluid on average no faster, and a step no shorter than `LEAST` of what
    that speed needs.
    """

    def __init__(self, solver: Solver, steer: Steer):
        super().__init__(solver)
        self._steer = steer
        self._given: dict[str, float] = {}

    def _give(self, cause: str, speed: float) -> None:
        """A speed, m/s, that a cause can give."""
        self._given[cause] = max(self._given.get(cause, 0.0), speed)

    def _add(self, cause: str, speed: float) -> None:
        """A speed, m/s, that a cause gives beside what it gave before."""
        self._given[cause] = self._given.get(cause, 0.0) + speed

    @property
    def _watches(self) -> bool:
        return all(phase.kind != "tissue" for phase in self._solver.phases.values())

    @property
    def _far(self) -> float:
        """m that a step may lead a particle."""
        settings = self._solver.settings
        return 0.4 * settings.cfl * settings.fluid_spacing

    @property
    def _speed(self) -> float:
        """m/s that all causes can give together; at least what does not shorten the steps."""
        return math.hypot(self._far / self._solver.settings.max_dt, *self._given.values())

    def _note(self) -> None:
        """Note what the scene can give, whatever the step."""
        solver, settings = self._solver, self._solver.settings
        if solver.pushed:  # by others than steps
            solver.pushed = False
            velocity = solver.read("velocity")[:, :3].astype(float)
            self._give("the speeds given", float(np.linalg.norm(velocity, axis=1).max(initial=0.0)))
        if not solver.changed:
            return
        solver.changed = False
        self._give("gravity", math.sqrt(2 * math.hypot(*settings.gravity) * self._across))
        for phase in solver.phases.values():
            if tension := max(phase.surface_tension or 0.0, phase.adhesion or 0.0):
                speed = math.sqrt(12 * tension / (self._lightest * settings.fluid_spacing))
                self._give(f"surface tension of {phase.name}", speed)
        if settings.method == "wcsph":
            self._give("sound", settings._pack()["sound_speed"])

    @property
    def _across(self) -> float:
        """m, of the domain."""
        lo, hi = self._solver.settings.domain.bounds()
        return float(np.linalg.norm(hi - lo))

    @property
    def _lightest(self) -> float:
        """kg/m³ of what moves."""
        moving = [p for p in self._solver.phases.values() if p.kind != "boundary"]
        return min((phase.density or 1000.0 for phase in moving), default=1000.0)

    def _before(self, dt: float) -> None:
        """Note what a step of dt seconds can give; inside of the step, which holds the lock."""
        if not self._watches:
            return
        self._note()
        settings = self._solver.settings
        if around := [settings.gravity["xyz".index(axis)] for axis in settings.domain.periodic]:
            self._add("a fall through periodic sides", math.hypot(*around) * dt)
        for name, way in self._steer._ways.items():
            # Out of a gap, fluid is faster by as much as the gap is narrower.
            self._give(f"boundary {name}", self._across / settings.fluid_spacing * way / dt)
        if len(self._steer._forces[0]):
            force = float(np.linalg.norm(self._steer._forces[1], axis=1).max())
            self._add("forces", force * dt / (self._lightest * settings.fluid_spacing**3))
        self._give("rigid bodies", self._steer._fastest_body)

    def _check_step(self, dt: float) -> None:
        """Refuse a step that the core wants so short. Raises ArithmeticError."""
        if not self._watches:
            return
        self._note()
        least = LEAST * min(self._far / self._speed, self._shortest_of_materials())
        if dt < least:
            self._refuse(f"and the steps come to {dt:.3g} s (at least {least:.3g} s)")

    def _shortest_of_materials(self) -> float:
        solver = self._solver
        return min(
            (
                step
                for phase in solver.phases.values()
                if phase.kind == "fluid"
                for _, step in steps_of_material(phase, solver.spacing_of(phase))
            ),
            default=math.inf,
        )

    def _check(self, report: StepReport) -> None:
        """Refuse what a step led to. Raises ArithmeticError."""
        if not self._watches or report.most_speed <= (speed := self._speed):
            return
        if report.most_speed > MOST * speed:
            self._refuse("")
        totals = self._solver.core.totals()
        if (kinetic := totals["kinetic"]) > 0.5 * totals["mass"] * speed**2:
            self._refuse(f"and the kinetic energy is {kinetic:.3g} J")

    def _refuse(self, more: str) -> None:
        solver = self._solver
        velocity = solver.read("velocity")[:, :3].astype(float)
        place = solver.read("place")[:, :3]
        lo, hi = solver.file.domain.bounds()
        outside = ((place < lo) | (place > hi)).any(axis=1)
        speeds = np.linalg.norm(velocity, axis=1) * ~outside
        i = int(np.argmax(speeds))
        where = ", ".join(f"{x:g}" for x in place[i])
        phase = list(solver.phases)[solver.read("phase")[i]]
        given = ", ".join(f"{cause} {speed:.3g} m/s" for cause, speed in self._given.items() if speed > 0)
        raise ArithmeticError(
            f"particle {solver.read('id')[i]} ({phase}) at ({where}) moves at {speeds[i]:.3g} m/s at "
            f"{solver.time:g} s{more and ' ' + more}: energy came from nowhere; expected what "
            f"{given or 'matter at rest'} can give, {self._speed:.3g} m/s in all; lower solver.cfl or solver.max_dt"
        )
