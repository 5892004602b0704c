"""The scene of a simulation: the memory that is simulated, ready to be traced."""

from __future__ import annotations

from typing import Any

from .._base.checks import choice, positive
from .._base.device import Device
from ..data.particles import HERE, UP, Particles
from ..pieces.scene import Scene
from ..scene.scene import DEFAULTS, KERNELS, SMOOTH_SUPPORT, SMOOTH_THRESHOLD
from .arrays import Arrays
from .solver import Solver

BALLS, SMOOTH, TISSUE = 0, 1, 2  # what the scene draws: `Drawn` in src/sim/state.hpp
FLUIDS, THINGS = 0, 1


class SimulationScene(Scene):
    """The particles of a simulation as they are now; the octree is brought up to date when it is
    traced.

    Where images show tissue, the scene has the smooth surface of the tissue, and what else is shown
    has scenes `beside`. Where images show a fluid and no tissue, the scene has the smooth surface
    around all that is shown; else each particle's ball. Smooth surfaces have the spacing of their
    particles. The threshold follows the surface until a program assigns one. `surface = "balls"`
    draws balls of all that is shown, which takes a tenth of the time where there is tissue.
    """

    def __init__(self, solver: Solver, arrays: Arrays, own: Any, device: Device):
        self._solver, self._arrays = solver, arrays
        self._own, self.device = own, device
        self.kernel = "murakami"
        self._kernel = KERNELS.index(self.kernel)
        self._chosen: float | None = None  # threshold
        self._balls = False  # a program wants them
        self._beside = (SceneBeside(self, FLUIDS), SceneBeside(self, THINGS))

    @property
    def _drawn(self) -> int:
        shown = self._smooth_kinds
        return TISSUE if "tissue" in shown else SMOOTH if "fluid" in shown else BALLS

    @property
    def _scene(self) -> Any:
        self._solver.core.draw(self._drawn)
        return self._own

    @property
    def _shown_kinds(self) -> set[str]:
        return {phase.kind for phase in self._solver.phases.values() if phase.shown}

    @property
    def _smooth_kinds(self) -> set[str]:
        return set() if self._balls else self._shown_kinds

    @property
    def surface(self) -> str:
        """ "smooth" or "balls"; "smooth" where there is a fluid or tissue and no program chose
        "balls"."""
        return "smooth" if self._smooth_kinds & {"fluid", "tissue"} else "balls"

    @surface.setter
    def surface(self, value: str) -> None:
        choice("surface", value, ("smooth", "balls"))
        self._balls = value == "balls"

    @property
    def beside(self) -> tuple[Scene, ...]:
        """What images show beside tissue, as layers of their own: the smooth surface of the fluids,
        which is wet, and balls of boundaries and rigid bodies."""
        kinds = self._smooth_kinds
        if "tissue" not in kinds:
            return ()
        fluids, things = self._beside
        return (fluids,) * ("fluid" in kinds) + (things,) * bool(kinds - {"tissue", "fluid"})

    @property
    def support(self) -> float:  # read-only here
        """Of each particle inside the matter, m."""
        spacings = SMOOTH_SUPPORT if self.surface == "smooth" else DEFAULTS[self.kernel][0]
        return spacings * self.spacing

    @property
    def threshold(self) -> float:
        """Iso-value of the surface, > 0. A new value applies from the next image on."""
        if self._chosen is not None:
            return self._chosen
        return SMOOTH_THRESHOLD if self.surface == "smooth" else DEFAULTS[self.kernel][1]

    @threshold.setter
    def threshold(self, value: float) -> None:
        self._chosen = positive("threshold", value)

    @property
    def particles(self) -> Particles:  # type: ignore[override]  # read-only here
        """As `Simulation.particles`."""
        return self._arrays.particles()

    @property
    def origin(self) -> tuple[float, float, float]:
        """Positions are the simulation's: no image asks all particles for this."""
        return HERE

    @property
    def up(self) -> tuple[float, float, float]:
        """Upwards in images, as of particles that say nothing."""
        return UP

    def __len__(self) -> int:
        return len(self._solver)

    @property
    def builds(self) -> int:  # type: ignore[override]  # read-only here
        """Steps so far."""
        return self._solver.core.n_steps()

    @property
    def spacing(self) -> float:
        """Of the particles of its surface, m."""
        settings, kinds = self._solver.settings, self._smooth_kinds
        of_fluids = "fluid" in kinds and "tissue" not in kinds
        return settings.fluid_spacing if of_fluids else settings.spacing

    def update(self, *_: Any, **__: Any) -> None:
        """Refused: raises TypeError."""
        raise TypeError("update: the scene of a simulation follows its particles")


class Snapshot(SimulationScene):
    """The particles of a simulation as they were at the last `update()`, in memory of their own on
    this or another GPU: an image may be made while the simulation goes on.

        snapshot = sim.snapshot("cuda:1")
        with ThreadPoolExecutor() as pool:
            for _ in range(600):
                snapshot.update()
                steps = pool.submit(sim.run, 1 / 60)
                image = gb.render(snapshot, camera).image  # of the time before these steps
                steps.result()

    It shows what `Simulation.scene` shows, and answers the same questions, but for `particles`.
    """

    def __init__(self, scene: SimulationScene, device: Device, lock: Any):
        solver = scene._solver
        super().__init__(solver, scene._arrays, solver.core.snapshot(device.name), device)
        self._of, self._lock = scene, lock
        self.update()

    def update(self, *given: Any, **named: Any) -> None:
        """Show the particles as they are now, between two steps."""
        if given or named:
            raise TypeError("update: expected nothing, since a snapshot follows its simulation")
        with self._lock:
            self._kinds, self._balls = self._of._shown_kinds, self._of._balls
            for own, theirs in zip((self, *self._beside), (self._of, *self._of._beside), strict=True):
                own._chosen = theirs._chosen
            self._solver.core.take(self._own, self._drawn)
            self._n, self._steps = len(self._solver), self._solver.core.n_steps()

    @property
    def _scene(self) -> Any:
        return self._own

    @property
    def _shown_kinds(self) -> set[str]:
        return self._kinds

    @property
    def surface(self) -> str:
        """ "smooth" or "balls", as of `Simulation.scene` at the last update."""
        return super().surface

    @surface.setter
    def surface(self, value: str) -> None:
        raise AttributeError("surface: a snapshot's is that of its simulation's scene")

    @property
    def threshold(self) -> float:
        """Iso-value of the surface, as of `Simulation.scene` at the last update."""
        return super().threshold

    @threshold.setter
    def threshold(self, value: float) -> None:
        raise AttributeError("threshold: a snapshot's is that of its simulation's scene")

    @property
    def particles(self) -> Particles:  # type: ignore[override]
        """Refused: raises TypeError."""
        raise TypeError(
            "particles: expected a simulation's, got those of a snapshot, which is for images alone; "
            "these need a camera, such as gb.Camera.fit(sim.particles)"
        )

    def __len__(self) -> int:
        return self._n

    @property
    def builds(self) -> int:  # type: ignore[override]
        """Steps before the last update."""
        return self._steps


class SceneBeside(SimulationScene):
    """A part of what a simulation's images show beside its tissue: FLUIDS or THINGS."""

    def __init__(self, tissue: SimulationScene, which: int):
        self._solver, self._arrays = tissue._solver, tissue._arrays
        self.device = tissue.device
        self.kernel, self._kernel, self._chosen = tissue.kernel, tissue._kernel, None
        self._tissue, self._which = tissue, which
        self._own = tissue._own.beside(which)

    @property
    def _scene(self) -> Any:
        self._tissue._scene  # noqa: B018  says what is drawn
        return self._own

    @property  # type: ignore[misc]
    def surface(self) -> str:  # type: ignore[override]  # read-only here
        """ "smooth" or "balls"."""
        return "smooth" if self._which == FLUIDS else "balls"

    @property
    def spacing(self) -> float:
        """Of its particles, m."""
        settings = self._solver.settings
        return settings.fluid_spacing if self._which == FLUIDS else settings.spacing

    @property
    def beside(self) -> tuple[Scene, ...]:
        """None."""
        return ()
