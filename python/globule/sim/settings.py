"""What a simulation is told before it runs, materials and settings, and what a step tells."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from .scene_file import Boundary, Fluid, Rigid, Solid
from .schema import number, positive, shown, switch, vector, whole
from .steered import Steered, checked, checks_of

KINDS = ("fluid", "tissue", "boundary", "rigid")
MAX_PHASES = 32
TABLES = dict(zip(KINDS, (Fluid, Solid, Boundary, Rigid), strict=True))
CHECKS = {"shown": switch}
for _table in TABLES.values():
    CHECKS |= checks_of(_table)
PICTURE = ("color", "reflection", "refraction", "shown")
CHANGEABLE = {
    "fluid": ("density", "viscosity", "implicit", "surface_tension", *PICTURE),
    "tissue": ("damping", "tear", "plastic", "creep", "viscosity", "implicit", "surface_tension",
               *PICTURE),
    "boundary": ("adhesion", *PICTURE),
    "rigid": ("adhesion", *PICTURE),
}  # fmt: skip


@dataclass
class Phase(Steered):
    """A material of a simulation, with the names and limits of a scene file; SI units. What
    CHANGEABLE has of its kind may be changed between steps.

    kind: fluid, tissue, boundary (fixed or moved by key frames) or rigid (a floating body).
    surface_tension: of a fluid, N/m; adhesion: of a boundary or rigid body, N/m: a fluid sticks
    to it with the geometric mean of both, as it does to tissue with a surface_tension. implicit:
    viscosity that does not shorten the steps. Of tissue: damping, 1/s; tear: strain beyond which
    bonds break, 0: never; plastic: strain beyond which the share creep, 1/s, of the strain becomes
    permanent, 0: never.
    """

    name: str
    kind: str = "fluid"
    density: float = 1000.0
    viscosity: float = 0.0
    implicit: bool = False
    surface_tension: float = 0.0
    adhesion: float = 0.0
    color: Any = (0.28, 0.52, 0.80)
    reflection: float = 0.0
    refraction: float = 0.0
    shown: bool | None = None
    damping: float = 0.0
    tear: float = 0.0
    plastic: float = 0.0
    creep: float = 1.0

    def __post_init__(self) -> None:
        if self.kind not in KINDS:
            raise ValueError(f"kind: expected one of {', '.join(KINDS)}, got {self.kind!r}")
        if self.shown is None:
            self.shown = self.kind != "boundary"
        self._label = f"phases[{self.name!r}]"
        self._begin(vars(self))

    def _begin(self, values: dict[str, Any]) -> None:
        """Values that it has from the start."""
        for name in self.__dataclass_fields__:
            if name in CHECKS:
                vars(self)[name] = checked(self._label, name, CHECKS[name], values[name])
        self._begun = True

    def _checks(self) -> dict[str, Any]:
        return {name: CHECKS[name] for name in CHANGEABLE[self.kind]}

    def _at_start(self) -> set[str]:
        return {"kind", *checks_of(TABLES[self.kind])}

    def _pack(self) -> dict[str, Any]:
        packed = dict(vars(self))
        packed["kind"] = KINDS.index(self.kind)
        packed["tension"], packed["implicit_viscosity"] = self.surface_tension, self.implicit
        packed["color"] = list(self.color)
        return packed


def _corners(value: Any) -> Any:
    try:
        lo, hi = np.asarray(value, float).reshape(2, 3)
    except (TypeError, ValueError):
        raise ValueError(f"expected two corners, (lo, hi), got {shown(value)}") from None
    if not (np.isfinite([lo, hi]).all() and (lo < hi).all()):
        raise ValueError(f"expected finite corners, lo below hi in each axis, got {shown(value)}")
    return value


def _axes(value: Any) -> tuple[bool, ...]:
    if not isinstance(value, (list, tuple)) or len(value) != 3:
        raise ValueError(f"expected three of true or false, got {shown(value)}")
    return tuple(bool(v) for v in value)


SETTINGS = {
    "periodic": _axes,
    "gravity": vector(),
    "cfl": positive,
    "longest_step": positive,
    "density_error": positive,
    "divergence_error": positive,
    "least_iterations": whole(0, 1_000_000),
    "most_iterations": whole(1, 1_000_000),
    "viscosity_error": positive,
    "weakly_compressible": switch,
    "sound_speed": lambda value: None if value is None else positive(value),
    "extra_viscosity": number(least=0.0),
}


@dataclass
class Settings(Steered):
    """How a simulation is run; any value but spacing and domain may be changed between steps.

    spacing: of particles, m. domain: two corners, m; who leaves it is no longer simulated.
    gravity: m/s^2. cfl: dt = 0.4 cfl spacing / v_max, at most longest_step (s). density_error,
    divergence_error: mean and relative, what the solvers reach. viscosity_error: relative residual
    of implicit viscosity. weakly_compressible: Tait's equation instead of a pressure solve, with a
    sound_speed (m/s; default 10 times that of a fall through the domain) and, to stay calm, an
    extra_viscosity (Pa s).
    """

    spacing: float
    domain: Any
    periodic: Any = (False, False, False)
    gravity: Any = (0.0, -9.81, 0.0)
    cfl: float = 1.0
    longest_step: float = 0.005
    density_error: float = 0.001
    divergence_error: float = 0.001
    least_iterations: int = 2
    most_iterations: int = 100
    viscosity_error: float = 1e-4
    weakly_compressible: bool = False
    sound_speed: float | None = None
    extra_viscosity: float = 0.0

    def __post_init__(self) -> None:
        self._label = "settings"
        for name, check in {"spacing": positive, "domain": _corners, **SETTINGS}.items():
            setattr(self, name, checked(self._label, name, check, getattr(self, name)))
        self._begun = True

    def _checks(self) -> dict[str, Any]:
        return SETTINGS

    def _at_start(self) -> set[str]:
        return {"spacing", "domain"}

    def _pack(self) -> dict[str, Any]:
        packed = dict(vars(self))
        lo, hi = np.asarray(packed.pop("domain"), float)
        packed["lo"], packed["hi"] = lo.tolist(), hi.tolist()
        packed["periodic"] = [bool(p) for p in self.periodic]
        short = [hi[k] - lo[k] < 8 * self.spacing and packed["periodic"][k] for k in range(3)]
        if any(short):
            raise ValueError("periodic: expected an axis at least 8 spacings long")
        if not self.weakly_compressible:
            packed["sound_speed"] = 0.0
        elif self.sound_speed is None:
            fall = abs(np.dot(self.gravity, hi - lo))
            packed["sound_speed"] = 10.0 * float(np.sqrt(2.0 * fall))
        packed["gravity"] = [float(g) for g in self.gravity]
        return packed


@dataclass
class StepReport:
    """What a step did. `error`: mean compression that the density solver left, predicted;
    `compression`: mean of max(density / rest density - 1, 0) of the positions it began with.
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
    n: int
    n_solved: int
    n_escaped: int
    n_removed: int
    most_speed: float
    seconds: dict[str, float] = field(default_factory=dict)
