"""The record of a run: a row a step, counts, energies; and a stop where fluid has no room."""

from __future__ import annotations

from typing import Any

import numpy as np

from .._base.arrays import VectorLike
from .._base.interrupts import whole
from .arrays import vector
from .limits import OVERFULL
from .operate import BondedTissue
from .part import Part
from .settings import StepReport
from .solver import Solver
from .tools import Tools

# Mean compression that tells that there is no room: in so many steps.
CROWDED, CROWDED_STEPS = 0.03, 10
MOST_ROWS = 20_000  # of diagnostics; of more, every second one goes


class Record(Part):
    """The record of a simulation's run: diagnostics, counts, times and energies.

    Attributes:
        diagnostics: one dict per step: time, dt, iterations, errors, compression, counts, and
            the force on each grasper and pusher, N (`force_` and its name).
        seconds: wall time of each stage of the solver.
        n_cut: bonds that the scene's instruments cut.
    """

    def __init__(self, solver: Solver, tissue: BondedTissue, tools: Tools):
        super().__init__(solver)
        self._tissue, self._tools = tissue, tools
        self._clear()

    def _clear(self) -> None:
        """Forget all rows and counts."""
        self.diagnostics: list[dict[str, Any]] = []
        self.seconds: dict[str, float] = {}
        self.n_removed = self.n_cut = 0
        self._n_crowded = 0

    @property
    def n_removed(self) -> int:
        """Particles that sinks, suction, ablation or `remove` removed."""
        return self._solver.n_removed

    @n_removed.setter
    def n_removed(self, value: int) -> None:
        self._solver.n_removed = value

    def _note(self, report: StepReport) -> None:
        """One step more in the record."""
        for stage, seconds in report.seconds.items():
            self.seconds[stage] = self.seconds.get(stage, 0.0) + seconds
        self.n_removed += report.n_removed
        self.diagnostics.append({
            "time": report.time, "step": report.step, "dt": report.dt,
            "iterations": report.iterations,
            "divergence_iterations": report.divergence_iterations,
            "error": report.error, "compression": report.compression,
            "high_compression": report.high_compression,
            "max_compression": report.most_compression, "n_halved": report.n_halved,
            "max_speed": report.most_speed,
            "n": report.n, "n_escaped": report.n_escaped, "n_removed": self.n_removed,
            "n_cut": self.n_cut,
            **{f"force_{name}": force for name, force in self._tools._forces().items()},
        })  # fmt: skip
        if len(self.diagnostics) > MOST_ROWS:
            del self.diagnostics[1::2]
        self._refuse_crowds(report)

    def _refuse_crowds(self, report: StepReport) -> None:
        """Fluid without room: its density cannot be what the solver asks for, which throws it
        about faster and faster. A start that settles within a few steps may pass."""
        settings = self._solver.settings
        tissue = any(phase.kind == "tissue" for phase in self._solver.phases.values())
        if tissue or settings.method == "wcsph":  # bonds may hold what is compressed
            return
        solved = report.divergence_iterations > 0  # for density, and by walls or a free surface
        limit = 10 * settings.max_error
        crowded = solved and report.compression > max(CROWDED, limit)
        self._n_crowded = self._n_crowded + 1 if crowded else 0
        if self._n_crowded == CROWDED_STEPS or report.compression > max(OVERFULL, limit):
            raise ArithmeticError(
                f"fluid is compressed by {100 * report.compression:.1f} % on average in step "
                f"{report.step}: expected room for it (in a box with walls a free surface or a "
                "gap) and particles that do not overlap"
            )

    @whole
    def totals(self) -> dict[str, Any]:
        """Totals of fluid and tissue: mass kg, kinetic and potential energy J, momentum kg m/s,
        angular_momentum kg m²/s about the origin, center of mass m."""
        return self._solver.core.totals()

    @whole
    def force(self, name: str, about: VectorLike = (0.0, 0.0, 0.0)) -> tuple[np.ndarray, np.ndarray]:
        """What fluids and tissue do to a boundary or a rigid body: (3,) force, N, and (3,) moment
        about a point, N m, float64.

        By the pressures of the last step, none before the first, and by the viscosity of the
        present velocities. Blows that stop single particles at a wall and surface tension are not
        in it.

        Args:
            name: of a boundary or a rigid body; "walls": those of the domain.
            about: (3,) point, m.

        Raises:
            KeyError: a name that there is not.
            ValueError: a fluid or tissue, or a point that is not three finite numbers.
        """
        kind = self._solver.phases[name].kind
        if kind not in ("boundary", "rigid"):
            raise ValueError(f"force: expected a boundary or a rigid body, got {name!r}, of kind {kind}")
        felt = self._solver.core.force_on(self._solver.number_of(name), vector("about", about))
        return np.array(felt[:3]), np.array(felt[3:])

    @whole
    def measure(self) -> dict[str, float]:
        """Current energies (J), momentum (kg m/s) and counts of the moving particles. `measure`
        also adds the values to the last row of the diagnostics."""
        totals = self.totals()
        momentum = totals["momentum"]
        found = {
            "kinetic": totals["kinetic"],
            "potential": totals["potential"],
            "momentum_x": momentum[0],
            "momentum_y": momentum[1],
            "momentum_z": momentum[2],
            **{f"n_{kind}": n for kind, n in self.counts.items()},
        }
        if found["n_tissue"]:
            found |= {"n_bonds": self._tissue.n_bonds, "n_pieces": self._tissue.n_pieces}
        if self.diagnostics:
            self.diagnostics[-1].update(found)
        return found

    @property
    def counts(self) -> dict[str, int]:
        """Number of particles of each kind; "escaped": how many of them are outside the domain;
        "removed": particles removed after the start."""
        kinds = [phase.kind for phase in self._solver.phases.values()]
        per_phase = np.bincount(self._solver.phase(), minlength=len(kinds))
        found = {kind: 0 for kind in ("fluid", "tissue", "rigid", "boundary")}
        for kind, n in zip(kinds, per_phase, strict=True):
            found[kind] += int(n)
        n_escaped = self.diagnostics[-1]["n_escaped"] if self.diagnostics else 0
        return {**found, "escaped": n_escaped, "removed": self.n_removed}

    @property
    def n_born(self) -> int:
        """Number of all particles of the run: current and removed particles."""
        return self._solver.core.next_id()

    def _facts(self) -> dict[str, Any]:
        """What a checkpoint keeps of it."""
        names = ("diagnostics", "seconds", "n_removed", "n_cut")
        return {name: getattr(self, name) for name in names}

    def _take_up(self, facts: dict[str, Any]) -> None:
        """From what `_facts` gave. Raises ValueError for anything else."""
        rows, seconds = facts["diagnostics"], facts["seconds"]
        counts = facts["n_removed"], facts["n_cut"]
        good = isinstance(rows, list) and all(
            isinstance(row, dict) and all(isinstance(v, (int, float)) for v in row.values()) and "n_escaped" in row
            for row in rows
        )
        good = good and isinstance(seconds, dict)
        if not good or not all(isinstance(v, (int, float)) for v in seconds.values()):
            raise ValueError("record: expected rows of numbers, and seconds of stages, got others")
        if not all(isinstance(count, int) and count >= 0 for count in counts):
            raise ValueError("record: expected counts of particles and bonds, got others")
        self.diagnostics, self.seconds = rows, seconds
        self.n_removed, self.n_cut = counts
