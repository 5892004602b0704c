"""What `Simulation` has beside the solver: scenes from files, checkpoints, a record of the run."""

from __future__ import annotations

import math
import os
from collections.abc import Callable
from typing import Any

import numpy as np

from .._base.interrupts import whole
from ..scene.particles import Particles
from . import checkpoint
from .bodies import Body
from .emitter import Emitter
from .operate import Vessel
from .scene_file import LISTS, SceneFile, as_dict
from .settings import SETTINGS, Phase
from .tools import Tool

# Mean compression that tells that there is no room: in so many steps, and at once.
CROWDED, CROWDED_STEPS, OVERFULL = 0.03, 10, 0.1
MOST_ROWS = 20_000  # of diagnostics; of more, every second one goes


def is_scene(scene: Any) -> bool:
    """Whether this is a scene as files have it: a name, a path, or a dict with a domain table or
    bodies."""
    return isinstance(scene, (str, os.PathLike, SceneFile)) or (
        isinstance(scene, dict)
        and (isinstance(scene.get("domain"), dict) or any(name in scene for name in LISTS))
    )


def description(scene: SceneFile, found: list[Body]) -> dict[str, Any]:
    """Settings and phases of a scene, in the words of `Settings` and `Phase`."""
    solver = scene.solver
    phases: dict[str, dict[str, Any]] = {}
    for body in found:
        phases.setdefault(body.name, _phase(body))
    return {
        "spacing": scene.spacing,
        "domain": (scene.domain.lo, scene.domain.hi),
        "periodic": ["xyz"[k] in scene.domain.periodic for k in range(3)],
        "gravity": scene.gravity,
        "cfl": solver.cfl,
        "longest_step": solver.max_dt,
        "density_error": solver.max_error,
        "divergence_error": solver.max_error,
        "weakly_compressible": solver.method == "wcsph",
        "walls": False,  # among the bodies, where a scene has them
        "phases": list(phases.values()),
    }


def _phase(body: Body) -> dict[str, Any]:
    table = body.table
    phase = {"name": body.name, "kind": body.kind, "color": table.color}
    if body.kind == "boundary":
        return phase | {"shown": table.shown, "adhesion": table.adhesion}
    phase |= {"density": table.density}
    if body.kind == "rigid":
        phase |= {"adhesion": table.adhesion}
    if body.kind in ("fluid", "tissue"):
        phase |= {"reflection": table.reflection, "refraction": table.refraction}
    if body.kind == "tissue":
        phase |= {
            "damping": table.damping,
            "tear": table.tear,
            "plastic": table.plastic,
            "creep": table.creep,
        }
    if body.kind == "fluid":
        phase |= {
            "viscosity": table.viscosity,
            "implicit": table.implicit,
            "surface_tension": table.surface_tension,
        }
    return phase


class Run:
    """The part of `Simulation` that is about a run as a whole; the solver is in the subclass."""

    def _begin(self, scene: SceneFile | None) -> None:
        self.file = scene
        self.diagnostics: list[dict[str, Any]] = []
        self.seconds: dict[str, float] = {}
        self.n_removed = self.n_cut = 0
        self._had_sinks = False
        self._n_crowded = 0

    def _set_up(self, scene: SceneFile, added: list[tuple[Body, np.ndarray]]) -> None:
        """What a scene has beside its particles, which are added already, with these ids."""
        for body, ids in added:
            if body.kind == "tissue":
                self.bond(ids, body.young, body.fixed)
        for table in scene.vessels:
            self.add_vessel(
                Vessel(np.array(table.path), table.radius, table.pressure, table.pool, table.fluid)
            )
        for table in scene.rigids:
            self.make_rigid(table.name, table.density, table.velocity, table.spin)
        for table in scene.emitters:
            self.emitters[table.name] = Emitter(
                table.center, table.direction, table.radius, table.rate, table.fluid
            )
        for number, table in enumerate(scene.instruments):
            self.instruments[table.name] = Tool(table, number, 0.0)
        self._prepare(0.0)
        self._first = self.state(), self._by_hand()

    def _prepare(self, dt: float) -> None:
        """What a step of dt needs to know of the scene's moving parts."""
        scene = self.file
        if scene is None:
            return
        time = self.time
        for table in scene.boundaries:
            if table.motion is not None:
                self.move_boundary(table.name, table.motion.pose(time + dt))
        for table in scene.emitters:
            if table.start > 0 or table.end is not None:
                ended = table.end is not None and time >= table.end
                self.emitters[table.name].on = table.start <= time and not ended
        sinks = [table.region for table in scene.sinks]
        for tool in self.instruments.values():
            tool.prepare(self, dt)
            if (sink := tool.sink(time)) is not None:
                sinks.append(sink)
        if sinks or self._had_sinks:
            self.set_sinks(sinks)
        self._had_sinks = bool(sinks)

    def _operate(self) -> None:
        """What instruments do after a step."""
        for tool in self.instruments.values():
            self.n_cut += tool.operate(self)

    def _note(self, report: Any) -> None:
        """One step more in the record."""
        for stage, seconds in report.seconds.items():
            self.seconds[stage] = self.seconds.get(stage, 0.0) + seconds
        self.n_removed += report.n_removed
        self.diagnostics.append({
            "time": report.time, "step": report.step, "dt": report.dt,
            "iterations": report.iterations,
            "divergence_iterations": report.divergence_iterations,
            "error": report.error, "compression": report.compression,
            "max_compression": report.most_compression, "max_speed": report.most_speed,
            "n": report.n, "n_escaped": report.n_escaped, "n_removed": self.n_removed,
            "n_cut": self.n_cut,
        })  # fmt: skip

        if len(self.diagnostics) > MOST_ROWS:
            del self.diagnostics[1::2]
        self._refuse_crowds(report)

    def _refuse_crowds(self, report: Any) -> None:
        """Fluid without room: its density cannot be what the solver asks for, which throws it
        about faster and faster. A start that settles within a few steps may pass."""
        tissue = any(phase.kind == "tissue" for phase in self.phases.values())
        if tissue or self.settings.weakly_compressible:  # bonds may hold what is compressed
            return
        solved = report.divergence_iterations > 0  # for density, and by walls or a free surface
        limit = 10 * self.settings.density_error
        crowded = solved and report.compression > max(CROWDED, limit)
        self._n_crowded = self._n_crowded + 1 if crowded else 0
        if self._n_crowded == CROWDED_STEPS or report.compression > max(OVERFULL, limit):
            raise ArithmeticError(
                f"fluid is compressed by {100 * report.compression:.1f} % on average in step "
                f"{report.step}: expected room for it (in a box with walls a free surface or a "
                "gap) and particles that do not overlap"
            )

    @whole
    def measure(self) -> dict[str, float]:
        """Energies (J), momentum (kg m/s) and counts of what moves, now; also added to the last row
        of the diagnostics."""
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
            found |= {"n_bonds": self.n_bonds, "n_pieces": self.n_pieces}
        if self.diagnostics:
            self.diagnostics[-1].update(found)
        return found

    @property
    def counts(self) -> dict[str, int]:
        """Particles of each kind; those outside of the domain ("escaped"); and those removed since
        the start."""
        kinds = [phase.kind for phase in self.phases.values()]
        per_phase = np.bincount(self.phase, minlength=len(kinds))
        found = {kind: 0 for kind in ("fluid", "tissue", "rigid", "boundary")}
        for kind, n in zip(kinds, per_phase, strict=True):
            found[kind] += int(n)
        n_escaped = self.diagnostics[-1]["n_escaped"] if self.diagnostics else 0
        return {**found, "escaped": n_escaped, "removed": self.n_removed}

    @property
    def n_born(self) -> int:
        """Particles that ever were: those there are and those removed."""
        return self._core.next_id()

    @property
    @whole
    def shown_particles(self) -> Particles:
        """The particles that pictures show, in id order."""
        particles = self.particles
        return particles[np.asarray(particles.weight) > 0]

    @whole
    def save(self, name: str | os.PathLike) -> None:
        """Write the whole state to NAME.npz, for `load`; the file appears whole or not at all."""
        facts = {
            "scene": self._describe() if self.file is None else as_dict(self.file),
            "diagnostics": self.diagnostics,
            "seconds": self.seconds,
            "n_removed": self.n_removed,
            "n_cut": self.n_cut,
            "by_hand": self._by_hand(),
        }
        state = self.state()
        try:
            self._check(state)
        except ValueError as error:
            expected = f"{checkpoint.path_of(name)}: expected a state that can be loaded again"
            raise ValueError(f"{expected}, {error}") from None
        checkpoint.save(name, state, facts)

    def _by_hand(self) -> dict[str, Any]:
        """What may be changed between steps beside the state's arrays, as JSON holds it."""
        return {
            "described": self._describe(),
            "emitters": {name: emitter._state() for name, emitter in self.emitters.items()},
            "instruments": {name: tool._state() for name, tool in self.instruments.items()},
            "sinks": self._sinks,
            "had_sinks": self._had_sinks,
            **self._tissue_by_hand(),
        }

    def _take_up(self, by_hand: dict[str, Any]) -> None:
        """What `_by_hand` gave."""
        self._describe_again(by_hand["described"])
        for name, state in by_hand["emitters"].items():
            if name not in self.emitters:
                values = [state[key] for key in ("center", "direction", "radius", "rate", "phase")]
                self.emitters[name] = Emitter(*values)
            self.emitters[name]._go_on(state)
        for name, state in by_hand["instruments"].items():
            self.instruments[name]._go_on(state)
        self._sinks, self._had_sinks = by_hand["sinks"], by_hand["had_sinks"]
        self._core.set_sinks(self._sinks)
        self._take_up_tissue(by_hand)

    @classmethod
    def load(cls, name: str | os.PathLike, device: str = "auto", threads: int = 0) -> Any:
        """A simulation that goes on where `save` left it: on the CPU with the same bits.

        Raises OSError for a file that cannot be read, ValueError for one that is no checkpoint.
        """
        arrays, facts = checkpoint.load(name)
        try:
            return cls._of_checkpoint(arrays, facts, device, threads)
        except (ValueError, KeyError, TypeError, AttributeError, IndexError) as error:
            what = f"{error} is missing" if isinstance(error, KeyError) else error
            raise ValueError(
                f"{checkpoint.path_of(name)}: expected a checkpoint of a simulation, {what}"
            ) from error

    @classmethod
    def _of_checkpoint(cls, arrays: dict, facts: dict, device: str, threads: int) -> Any:
        sim = cls(facts["scene"], device=device, threads=threads)
        sim._take_up(facts["by_hand"])
        sim.set_state(arrays)
        sim.diagnostics, sim.seconds = facts["diagnostics"], facts["seconds"]
        sim.n_removed, sim.n_cut = facts["n_removed"], facts["n_cut"]
        return sim

    def _describe_again(self, described: dict[str, Any]) -> None:
        """Settings and materials as they were when saved: they may have been changed."""
        for name in SETTINGS:
            setattr(self.settings, name, described[name])
        for values in described["phases"]:
            if values["name"] not in self.phases:
                self.add_phase(Phase(**values))
            self.phases[values["name"]]._begin(values)

    @whole
    def reset(self) -> None:
        """Back to the start."""
        if self.file is None:
            raise ValueError("reset: expected a simulation of a scene, got another")
        state, by_hand = self._first
        self._begin(self.file)
        self._take_up(by_hand)
        self.set_state(state)

    def advance(self, seconds: float, stop: Callable[[], bool] | None = None) -> Any:
        """Whole steps until `seconds` have passed, the last two alike rather than one a sliver.

        `stop` is asked after every step; True ends the run there. Returns the last report.
        """
        if not seconds >= 0:
            raise ValueError(f"seconds: expected a number >= 0, got {seconds}")
        end = self.time + seconds
        return self.advance_to(end, stop)

    def advance_to(self, end: float, stop: Callable[[], bool] | None = None) -> Any:
        """`advance` up to a time, seconds since the start."""
        if not math.isfinite(end):
            raise ValueError(f"end: expected a finite number of seconds, got {end}")
        report = None
        while (rest := end - self.time) > 1e-9 * max(end, 1e-3):
            dt = self.dt
            report = self._step(rest if rest <= dt else rest / 2 if rest < 2 * dt else dt)
            if stop is not None and stop():
                break
        return report
