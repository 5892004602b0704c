"""What a simulation is told before it runs, materials and settings, and what a step tells."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

KINDS = ("fluid", "tissue", "boundary", "rigid")
MAX_PHASES = 32


@dataclass
class Phase:
    """A material of a simulation; any value may be changed between steps. SI units.

    kind: fluid, tissue, boundary (fixed or moved by key frames) or rigid (a floating body).
    tension: of a fluid's surface, N/m; adhesion: of a boundary or rigid body, N/m: a fluid sticks
    to it with the geometric mean of both. Of tissue: damping, 1/s; tear_strain beyond which bonds
    break, 0: never; yield_strain beyond which the share creep_rate, 1/s, of the strain becomes
    permanent, 0: never.
    """

    name: str
    kind: str = "fluid"
    density: float = 1000.0
    viscosity: float = 0.0
    implicit_viscosity: bool = False
    tension: float = 0.0
    adhesion: float = 0.0
    color: Any = (0.28, 0.52, 0.80)
    reflection: float = 0.0
    refraction: float = 0.0
    shown: bool | None = None
    damping: float = 0.0
    tear_strain: float = 0.0
    yield_strain: float = 0.0
    creep_rate: float = 0.0

    def __post_init__(self) -> None:
        if self.kind not in KINDS:
            raise ValueError(f"kind: expected one of {', '.join(KINDS)}, got {self.kind!r}")
        if self.shown is None:
            self.shown = self.kind != "boundary"

    def _pack(self) -> dict[str, Any]:
        packed = dict(vars(self))
        packed["kind"] = KINDS.index(self.kind)
        packed["color"] = [float(c) for c in self.color]
        if not self.density > 0:
            raise ValueError(f"density: expected a positive number, got {self.density!r}")
        return packed


@dataclass
class Settings:
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
