"""Materials and settings of a simulation, and the report of a step.

Their names, limits and defaults are those of a scene's tables (scene_file.py).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from .._base.arrays import VectorLike
from .._base.settings import Choice, Setting, check_all, documented, same, setting, settings_of
from .scene_bodies import IMPLICIT_FROM, Boundary, Fluid, Rigid, Solid
from .scene_file import Domain, SceneFile, Solver
from .schema import NAME
from .steered import Steered

KINDS = ("fluid", "tissue", "boundary", "rigid")
MAX_PHASES = 32
TABLES = dict(zip(KINDS, (Fluid, Solid, Boundary, Rigid), strict=True))
MATERIAL = {k: one for table in TABLES.values() for k, one in settings_of(table).items()}
PICTURE = ("color", "reflection", "refraction", "shown")
CHANGEABLE = {
    "fluid": ("density", "viscosity", "implicit", "surface_tension", *PICTURE),
    "tissue": ("damping", "tear", "plastic", "creep", "friction", "viscosity", "implicit",
               "surface_tension", *PICTURE),
    "boundary": ("adhesion", "friction", *PICTURE),
    "rigid": ("adhesion", "friction", *PICTURE),
}  # fmt: skip


@documented
@dataclass
class Phase(Steered):
    """A material of a simulation, with the names, limits and defaults of a scene's table.

    An omitted value has the default of the kind's table: `[[fluids]]`, `[[solids]]` for
    tissue, `[[boundaries]]` or `[[rigids]]`. `CHANGEABLE` lists what may change between steps.

    Raises:
        ValueError: a value that the table's check refuses.
        AttributeError: an assignment to a name that cannot be changed.
    """

    name: str = setting(NAME, help="name of the phase; each has its own")
    kind: str = setting(Choice("fluid", "tissue", "boundary", "rigid"), "fluid",
        '"fluid", "tissue", "boundary" (at rest, or moving along key frames) or "rigid" (a '
        "floating body)")  # fmt: skip
    density: float | None = same(Fluid, "density", default=None)
    viscosity: float | None = same(Fluid, "viscosity", default=None)
    implicit: bool | None = same(Fluid, "implicit")
    surface_tension: float | None = same(Fluid, "surface_tension", default=None)
    adhesion: float | None = same(Rigid, "adhesion", default=None)
    color: Any = same(Fluid, "color", default=None)
    reflection: float | None = same(Fluid, "reflection", default=None)
    refraction: float | None = same(Fluid, "refraction", default=None)
    shown: bool | None = same(Fluid, "shown", default=None)
    damping: float | None = same(Solid, "damping", default=None)
    tear: float | None = same(Solid, "tear", default=None)
    plastic: float | None = same(Solid, "plastic", default=None)
    creep: float | None = same(Solid, "creep", default=None)
    friction: float | None = same(Solid, "friction", default=None)

    def __post_init__(self) -> None:
        settings_of(Phase)["kind"].check(self.kind)
        self._label = f"phases[{self.name!r}]"
        defaults = _BARE | {k: one.default for k, one in settings_of(TABLES[self.kind]).items()}
        self._begin({k: defaults.get(k) if v is None else v for k, v in vars(self).items()})

    def _begin(self, values: dict[str, Any]) -> None:
        """Set the values that it starts with."""
        for name in self.__dataclass_fields__:
            if name == "implicit" and values[name] is None:
                vars(self)[name] = vars(self)["viscosity"] >= IMPLICIT_FROM
            elif name != "kind":
                vars(self)[name] = MATERIAL[name].check(values[name], (self._label, name))
        self._begun = True

    def _checks(self) -> dict[str, Setting]:
        return {name: MATERIAL[name] for name in CHANGEABLE[self.kind]}

    def _at_start(self) -> set[str]:
        return {"kind", *settings_of(TABLES[self.kind])}

    def _pack(self) -> dict[str, Any]:
        packed = dict(vars(self))
        packed["kind"] = KINDS.index(self.kind)
        packed["tension"], packed["implicit_viscosity"] = self.surface_tension, self.implicit
        packed["color"] = list(self.color)
        return packed


# Of kinds whose tables do not have these keys.
_BARE = {"density": 1000.0, "viscosity": 0.0, "surface_tension": 0.0, "adhesion": 0.0,
         "damping": 0.0, "tear": 0.0, "plastic": 0.0, "creep": 1.0, "friction": 0.0}  # fmt: skip


def phase_of(kind: str, table: Any) -> Phase:
    """The material of a scene's table."""
    known = set(settings_of(Phase)) & set(settings_of(type(table)))
    return Phase(kind=kind, **{name: getattr(table, name) for name in known})


SETTINGS = {"gravity": settings_of(SceneFile)["gravity"], **settings_of(Solver)}


@documented
@dataclass(kw_only=True)
class Settings(Steered, Solver):
    """How a simulation runs: a scene's spacing, domain and gravity, and the keys of its [solver].

    Every value but spacing, fine_fluids and domain may be changed between steps.

    Raises:
        ValueError: a value that the scene's check refuses.
        AttributeError: an assignment to a name that cannot be changed.
    """

    spacing: float = same(SceneFile, "spacing")
    fine_fluids: bool = same(SceneFile, "fine_fluids")
    domain: Domain = same(SceneFile, "domain")
    gravity: VectorLike = same(SceneFile, "gravity")

    def __post_init__(self) -> None:
        super().__post_init__()
        self._label = "settings"
        self._begun = True

    @property
    def fluid_spacing(self) -> float:
        """Of the particles of fluids, m."""
        return self.spacing / 2 if self.fine_fluids else self.spacing

    def _checks(self) -> dict[str, Setting]:
        return SETTINGS

    def _at_start(self) -> set[str]:
        return {"spacing", "fine_fluids", "domain"}

    def _pack(self) -> dict[str, Any]:
        lo, hi = self.domain.bounds()
        periodic = ["xyz"[k] in self.domain.periodic for k in range(3)]
        least = 8 * self.spacing
        for k, length in enumerate(np.subtract(hi, lo)):
            if periodic[k] and length < least:
                expected = f"expected an axis at least 8 spacings long, {least:.3g} m"
                raise ValueError(f"domain.periodic: {expected}, got {'xyz'[k]} of {length:.3g} m")
        sound_speed, wcsph = self.sound_speed, self.method == "wcsph"
        if sound_speed is None:
            sound_speed = 10.0 * float(np.sqrt(2.0 * abs(np.dot(self.gravity, hi - lo))))
        return {
            "spacing": self.spacing, "fine_fluids": self.fine_fluids,
            "lo": lo.tolist(), "hi": hi.tolist(), "periodic": periodic,
            "gravity": list(self.gravity), "cfl": self.cfl, "longest_step": self.max_dt,
            "density_error": self.max_error,
            "divergence_error": self.divergence_error or self.max_error,
            "least_iterations": self.min_iterations, "most_iterations": self.max_iterations or 0,
            "viscosity_error": self.viscosity_error, "weakly_compressible": wcsph,
            "sound_speed": sound_speed if wcsph else 0.0, "extra_viscosity": self.extra_viscosity,
        }  # fmt: skip


def settings_in(scene: SceneFile) -> Settings:
    """The settings of a scene."""
    own = {name: getattr(scene, name) for name in ("spacing", "fine_fluids", "domain", "gravity")}
    return Settings(**own, **check_all(scene.solver))


@dataclass
class StepReport:
    """The results of a step.

    Attributes:
        time: s since the start, after the step.
        step: number of the step, from 1.
        dt: length of the step, s.
        iterations, divergence_iterations, viscosity_iterations: of the solvers.
        error: predicted mean compression after the density solver, a share.
        divergence_error: error after the divergence solver, a share.
        most_error, most_divergence_error: the largest error that each solver left, a share.
        compression: mean of max(density / rest density - 1, 0) at the start of the step.
        high_compression: compression that 0.1 % of the particles exceed (99.9th percentile, within
            the accuracy of a histogram whose bins double).
        most_compression: the largest compression of a particle.
        n_halved: how often the solver repeated the step at half its length because the pressure
            solve had added kinetic energy; `dt` is the length that remained.
        n: number of particles.
        n_solved: fluid particles that the pressure solve moved.
        n_escaped: particles outside the domain.
        n_removed: particles that sinks removed in this step.
        most_speed: speed of the fastest particle, m/s.
        seconds: wall time of each stage of the solver.
    """

    time: float
    step: int
    dt: float
    iterations: int
    divergence_iterations: int
    viscosity_iterations: int
    error: float
    divergence_error: float
    compression: float
    most_compression: float
    high_compression: float
    most_error: float
    most_divergence_error: float
    n_halved: int
    n: int
    n_solved: int
    n_escaped: int
    n_removed: int
    most_speed: float
    seconds: dict[str, float] = field(default_factory=dict)

    def __repr__(self) -> str:
        escaped = f", {self.n_escaped:,} escaped" if self.n_escaped else ""
        return (
            f"StepReport(step {self.step:,}: {self.time:.4g} s, dt {self.dt:.3g} s; {self.n:,} "
            f"particles{escaped}; {self.iterations} + {self.divergence_iterations} iterations, "
            f"compression {100 * self.compression:.2g} %, fastest {self.most_speed:.3g} m/s)"
        )
