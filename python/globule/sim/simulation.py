"""Simulations: particles that flow, on the octree that is also traced."""

from __future__ import annotations

import json
import logging
import math
import os
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from .._base.checks import named, number, shown, thread_count
from .._base.device import choose
from .._base.interrupts import whole
from .._base.owner import Owner
from ..data.attributes import velocity_name
from ..data.particles import Particles
from . import checkpoint
from .arrays import Arrays, check_finite, ids_of, real
from .bodies import Body, bodies, scene_of_particles
from .emitter import Emitter
from .foam import Foam
from .limits import check_emitter
from .operate import BondedTissue
from .record import Record
from .runaway import Runaway
from .scene_file import SceneFile
from .scene_read import as_dict, errors_of, read_scene
from .settings import MAX_PHASES, SETTINGS, Phase, StepReport
from .simulation_scene import SimulationScene, Snapshot
from .solver import Solver
from .steer import Steer
from .steered import Named, Steered
from .tools import Tool, Tools

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

PARTS = 1000  # of a run, that progress counts
SHORTEST, LONGEST = 1e-15, 1e3  # s, of a step
MOST_TIMES = 4.0  # the longest step that the speeds allow: beyond, a warning
_PARTS = ("file", "settings", "phases", "emitters", "scene", "arrays", "tissue", "tools", "steer",
          "foam", "record")  # fmt: skip
_log = logging.getLogger(__name__)


@named
class Simulation(Owner):
    """A simulation of fluids, tissue and rigid bodies.

    A file, a dict and keywords in Python describe a scene with the same keys and defaults
    (docs/reference/scene-keys.md):

        gb.Simulation("scene.toml")
        gb.Simulation({"spacing": 0.02, "domain": {...}, "fluids": [{"name": "water", ...}]})
        gb.Simulation(spacing=0.02, domain=Domain(...), fluids=[Fluid(name="water", ...)])

    Args:
        scene: the name of a shipped scene, the path of a .toml file, or a dict with the keys of a
            scene file; or `Particles`, a fluid in its box. None: `keys` describe the whole scene.
        device: "auto", "cpu", "cuda" or "cuda:N".
        threads: CPU threads; 0 takes all.
        spacing: of particles, m, instead of the scene's own.
        keys: other keys of a scene, instead of the scene's own: dicts and lists, or the tables of
            `globule.sim`.

    Attributes:
        scene: a `gb.Scene` of the same memory, with the current particles: one smooth surface where
            a fluid is shown and no tissue; the smooth surface of tissue, with fluids and what else
            is shown as scenes `beside`, which images show as further layers.
        settings: `Settings`: gravity, and the steps of the solver.
        phases: the materials, `Phase`s by name.
        emitters: `Emitter`s by name.
        arrays: ids, positions, velocities, pressure, phase, neighbors; the whole state.
        tissue: bonds, cuts, pieces and vessels.
        tools: the scene's instruments by name; grasps and pushers.
        steer: forces, moved boundaries, rigid bodies, sinks.
        foam: spray, foam and bubbles of a scene with a table `foam`.
        record: diagnostics, counts, energies and times.
        file: the scene with all its values, a `SceneFile`.

    Raises:
        SceneError: a mistake in the scene; one line names the mistake, and the file and line if
            the scene is a file. SceneError is a ValueError.
        TypeError: `scene` has another type.
        OSError: a file that cannot be read.
    """

    def __init__(
        self,
        scene: str | os.PathLike[str] | dict[str, Any] | SceneFile | Particles | None = None,
        device: str = "auto",
        threads: int = 0,
        spacing: float | None = None,
        **keys: Any,
    ):
        fluid = scene if isinstance(scene, Particles) else None
        if fluid is not None:
            scene = scene_of_particles(fluid)
        scene = {} if scene is None else scene
        if not isinstance(scene, (str, os.PathLike, dict, SceneFile)):
            expected = "expected a name, a path, a dict or Particles"
            raise TypeError(f"scene: {expected}, got {shown(scene)}")
        file = read_scene(scene, spacing, **keys)
        with errors_of(scene):
            self._begin(file, fluid, device, threads)
        _log.info("%r", self)

    def _begin(self, file: SceneFile, fluid: Particles | None, device: str, threads: int) -> None:
        """Make everything of the scene."""
        found = bodies(file)
        solver = self._solver = Solver(file, choose(device), thread_count(threads))
        self._core, self._lock = solver.core, solver.lock
        self._had_sinks = self._warned = False
        self._sent = object()  # `Steered.last_change` when values were handed to the core
        self._inlets: list[list[float]] = []  # that the core knows
        self.file, self.settings, self.phases = file, solver.settings, solver.phases
        self.emitters: dict[str, Emitter] = Named("emitters", Emitter)
        self.tissue: BondedTissue = BondedTissue(solver)
        self.tools: Tools = Tools(solver)
        self.steer: Steer = Steer(solver)
        self._runaway = Runaway(solver, self.steer)
        self.arrays: Arrays = Arrays(solver, (self.steer, self.tissue))
        self.scene = SimulationScene(solver, self.arrays, solver.traced, solver.device)
        self.foam: Foam = Foam(solver)
        self.record: Record = Record(solver, self.tissue, self.tools)
        for body in found:
            for phase, _ in body.phases():
                if phase.name not in self.phases:
                    self.add_phase(phase)
        self._send()
        added = [(body, self._add_body(body)) for body in found]
        if fluid is not None:
            name = velocity_name(fluid.attributes)
            self.add(fluid.positions, "fluid", 0.0 if name is None else fluid.attributes[name])
        self._set_up(added)

    def _add_body(self, body: Body) -> np.ndarray:
        """Add a body's particles; returns their ids."""
        return np.concatenate([
            self.add(body.positions[rows], phase.name, body.velocities[rows])
            for phase, rows in body.phases()
        ])  # fmt: skip

    def _set_up(self, added: list[tuple[Body, np.ndarray]]) -> None:
        """Everything of the scene but its particles, which are added already, with these ids."""
        scene = self.file
        for body, ids in added:
            if body.kind == "tissue":
                table = body.table
                self.tissue.bond(ids, body.young, body.fixed, table.model, table.poisson, table.pairs)
        for vessel in scene.vessels:
            self.tissue.add_vessel(vessel)
        empty = {body.name for body, ids in added if not len(ids)}
        for table in scene.rigids:
            if table.name not in empty:
                self.steer.make_rigid(table.name, table.density, table.velocity, table.spin)
        for table in scene.emitters:
            self.emitters[table.name] = Emitter(
                table.center, table.direction, table.radius, table.rate, table.fluid, table.start,
                table.end,
            )  # fmt: skip
        for i, table in enumerate(scene.instruments):
            self.tools[table.name] = Tool(table, i, 0.0)
        self._prepare(0.0)
        self._first = self.arrays.state(), self._by_hand()

    @whole
    def __repr__(self) -> str:
        """Particles of each phase, the time and the device, in one line."""
        counts = np.bincount(self.arrays.phase, minlength=len(self.phases))
        listed = ", ".join(f"{n:,} {name}" for name, n in zip(self.phases, counts, strict=True))
        steps = f"{self.n_steps:,} step{'' if self.n_steps == 1 else 's'}"
        where = self.scene.device.name
        return f"Simulation({listed or 'no phases'}; {self.time:.4g} s in {steps}; {where})"

    def __setattr__(self, name: str, value: Any) -> None:
        if name in _PARTS and name in vars(self):
            raise AttributeError(f"Simulation.{name} cannot be replaced; assign to what it has")
        if name not in _PARTS and not name.startswith("_") and not hasattr(type(self), name):
            raise AttributeError(
                f"Simulation: expected one of {', '.join(_PARTS)}, got {name}; "
                "what may change between steps is in settings, phases, emitters and tools"
            )
        super().__setattr__(name, value)

    @whole
    def add_phase(self, phase: Phase) -> None:
        """Add a material; `add` adds its particles.

        Raises:
            TypeError: anything but a `Phase`.
            ValueError: the name exists already, or the phase is the 33rd.
        """
        if not isinstance(phase, Phase):
            raise TypeError(f"phase: expected a gb.sim.Phase, got {shown(phase)}")
        if len(self.phases) == MAX_PHASES:
            n = MAX_PHASES + 1
            raise ValueError(f"phases: expected at most {MAX_PHASES}, got {n} with {phase.name!r}")
        if phase.name in self.phases:
            raise ValueError(f"phases: expected different names, got {phase.name!r} twice")
        self.phases[phase.name] = phase

    @whole
    def add(self, positions: ArrayLike, phase: str | None = None, velocities: ArrayLike = 0.0) -> np.ndarray:
        """Add particles.

        Args:
            positions: (M, 3) m.
            phase: name of the particles' material; None: the first phase that is not a boundary.
            velocities: (M, 3), (3,) or a number, m/s.

        Returns:
            ids (M,) uint32, ascending; every id is unique.

        Raises:
            ValueError: a wrong shape, values that are not finite, or an unknown phase.
        """
        which = self._solver.number_of(phase)
        self._send()
        p = np.ascontiguousarray(real("positions", positions))
        if p.ndim != 2 or p.shape[1] != 3:
            raise ValueError(f"positions: expected shape (M, 3), got {p.shape}")
        v = real("velocities", velocities)
        if v.shape not in ((), (3,), p.shape):
            raise ValueError(f"velocities: expected a number, (3,) or {p.shape}, got {v.shape}")
        if len(p) == 0:
            return np.empty(0, np.uint32)
        check_finite("positions", p)
        check_finite("velocities", v)
        each = np.ascontiguousarray(v) if v.shape == p.shape else None
        one = [0.0, 0.0, 0.0] if each is not None else np.broadcast_to(v, 3).tolist()
        self._solver.pushed = True
        first = self._core.add(p, which, each, one)
        return np.arange(first, first + len(p), dtype=np.uint32)

    @whole
    def remove(self, ids: ArrayLike) -> None:
        """Remove particles by their ids (M,), which `add` returned. Ids of particles that the
        simulation already removed have no effect.

        Raises:
            ValueError: an id that `add` never returned, or that of a rigid body's particle: its
                mass would stay.
        """
        given = ids_of(ids)
        unknown = given[(given < 0) | (given >= self._core.next_id())]
        if len(unknown):
            raise ValueError(f"ids: expected numbers that add() gave, got {unknown[0]}")
        gone = np.ascontiguousarray(given, np.uint32)
        rigid = [name for name, phase in self.phases.items() if phase.kind == "rigid"]
        theirs = self._solver.phase()[np.isin(self._solver.read("id"), gone)] if rigid else gone[:0]
        for name in rigid:
            if n := int((theirs == self._solver.number_of(name)).sum()):
                raise ValueError(f"ids: expected no particles of a rigid body, got {n} of {name!r}")
        self._solver.remove(gone)

    def step(self, dt: float | None = None) -> StepReport:
        """Make one step of dt seconds; by default, the longest step that the speeds allow.

        A longer step is made as well, but particles may go through each other and through walls:
        beyond four times `dt`, a simulation logs a warning, once.

        Raises:
            ValueError: a dt that is not above 0, or a material that needs too many steps.
            ArithmeticError: a velocity that is not a number, speeds, energies or steps that nothing
                in the scene can give, or fluid without room.
        """
        if dt is not None:
            dt = number("dt", dt)
            if not SHORTEST <= dt <= LONGEST:
                raise ValueError(f"dt: expected {SHORTEST:g} to {LONGEST:g} s, got {dt:g}")
        return self._step(dt)

    def _warn_of(self, dt: float) -> None:
        """Say once that a step is much longer than the speeds allow."""
        if not self._warned and dt > MOST_TIMES * (longest := self._core.next_dt()):
            self._warned = True
            _log.warning(
                "dt: expected at most about %.3g s, as Simulation.dt says, got %g s: particles may "
                "go through each other and leave the domain", longest, dt,
            )  # fmt: skip

    @whole
    def _step(self, dt: float | None, rest: float = math.inf) -> StepReport:
        """A step of dt seconds, or one of those that make up the rest of a run."""
        self._send()
        if dt is None:
            dt = self._next_dt()
            dt = rest if rest <= dt else rest / 2 if rest < 2 * dt else dt
        else:
            self._warn_of(dt)
        self._prepare(dt)
        spacing = self.settings.fluid_spacing
        inlets = [e._inlet(spacing) for e in self.emitters.values() if e._runs(self.time)]
        if inlets != self._inlets:
            self._core.set_inlets(inlets)
            self._inlets = inlets
        for emitter in self.emitters.values():
            positions, velocities = emitter.emit(spacing, self.time, dt)
            if len(positions):
                which = self._solver.number_of(emitter.fluid)
                self._runaway._give("emitters", float(np.linalg.norm(velocities[0])))
                self._core.emit(positions, which, velocities)
        self._runaway._before(dt)
        self.steer._send_forces()
        report = StepReport(**self._core.step(dt))
        self.tools._move_pushers(dt)
        for tool in self.tools.values():
            self.record.n_cut += tool.operate(self.tissue, self.time)
        self.foam._advance(report.dt)
        self.record._note(report)
        self._runaway._check(report)
        return report

    def _prepare(self, dt: float) -> None:
        """Move boundaries, instruments and sinks to where they are in a step of dt seconds."""
        time = self.time
        for table in self.file.boundaries:
            if table.motion is not None:
                self.steer.move_boundary(table.name, table.motion.pose(time + dt))
        sinks = [table.region for table in self.file.sinks]
        for tool in self.tools.values():
            tool.prepare(self.tools, time, dt)
            if (sink := tool.sink(time)) is not None:
                sinks.append(sink)
        if sinks or self._had_sinks:
            self.steer.set_sinks(sinks)
        self._had_sinks = bool(sinks)

    def run(
        self,
        seconds: float | None = None,
        stop: Callable[[], bool] | None = None,
        progress: Callable[[int, int], Any] | None = None,
    ) -> StepReport | None:
        """Simulate some seconds. The last two steps have similar lengths.

        Args:
            seconds: s from now; None: up to the scene's `seconds`.
            stop: a function that `run` calls after every step; True ends the run.
            progress: a function that `run` calls after every step as progress(done, total), in
                thousandths of the run.

        Returns:
            the report of the last step; None if the run has no step.

        Raises:
            ValueError: seconds below 0.
            ArithmeticError: as of `step`.
        """
        if seconds is None:
            return self.run_to(self.file.seconds, stop, progress)
        seconds = number("seconds", seconds, 0.0)
        return self.run_to(self.time + seconds, stop, progress)

    def run_to(
        self, end: float, stop: Callable[[], bool] | None = None, progress: Callable[[int, int], Any] | None = None
    ) -> StepReport | None:
        """Simulate up to a time, s since the start. A time in the past needs no step.

        Raises:
            ValueError: a time that is not finite.
            ArithmeticError: as of `step`.
        """
        if not math.isfinite(end):
            raise ValueError(f"end: expected a finite number of seconds, got {end}")
        for name, value in (("stop", stop), ("progress", progress)):
            if value is not None and not callable(value):
                raise TypeError(f"{name}: expected a function, got {shown(value)}")
        report, begin = None, self.time
        while (rest := end - self.time) > 1e-9 * max(end, 1e-3):
            report = self._step(None, rest)
            if progress is not None:
                share = (self.time - begin) / (end - begin)
                progress(min(PARTS, int(PARTS * share + 1e-6)), PARTS)
            if stop is not None and stop():
                break
        return report

    def snapshot(self, device: str | None = None) -> Snapshot:
        """The particles as they are now, as a scene in memory of its own: images of it may be made
        in one thread while another one runs the simulation; on two GPUs, neither waits.

        Args:
            device: "cuda", "cuda:1": another GPU; None: the simulation's own.

        Raises:
            ValueError: a device of another kind than the simulation's.
        """
        chosen = self.scene.device if device is None else choose(device)
        return Snapshot(self.scene, chosen, self._lock)

    @property
    def time(self) -> float:
        """Seconds since the start."""
        return self._core.time()

    @property
    def n_steps(self) -> int:
        """Steps since the start."""
        return self._core.n_steps()

    @property
    def dt(self) -> float:
        """Length of the next step, s.

        Raises:
            ArithmeticError: steps that come to nothing.
        """
        self._send()
        return self._next_dt()

    def _next_dt(self) -> float:
        allowed = self._core.next_dt()
        dt = self._within_reach(allowed)
        if not self.time + dt > self.time:
            gravity = math.hypot(*self.settings.gravity)
            speed = np.linalg.norm(self.velocities.astype(float), axis=1).max(initial=0)
            raise ArithmeticError(
                f"the steps come to {dt:g} s at {self.time:g} s: expected less gravity "
                f"(it is {gravity:g} m/s²), lower speeds (up to {speed:g} m/s), or other materials"
            )
        self._runaway._check_step(allowed)
        return dt

    def _within_reach(self, dt: float) -> float:
        """A step of at most dt seconds in which nothing moves farther along its key frames than the
        fluid may: the core knows how fast particles are, not how fast a boundary or the tissue in a
        grasper will be. What goes through others in one step leaves them with any speed."""
        time, far = self.time, 0.4 * self.settings.cfl * self.settings.fluid_spacing
        ways = [
            partial(table.motion.way, reach=self.steer._reach[table.name])
            for table in self.file.boundaries
            if table.motion
        ]
        ways += [tool.way for tool in self.tools.values() if tool.grasps_by_keys(time)]
        for way_between in ways:
            while (way := way_between(time, time + dt)) > far * (1 + 1e-6):
                dt *= max(far / way, 0.5)  # half: what begins late in the step may be fast
        return dt

    def __len__(self) -> int:
        return self._core.size()

    @property
    def ids(self) -> np.ndarray:
        """(N,) uint32, ascending: the order of all arrays of particles."""
        return self.arrays.ids

    @property
    def positions(self) -> np.ndarray:
        """(N, 3) float32 m, in id order; may be assigned, as `Arrays` says."""
        return self.arrays.positions

    @positions.setter
    def positions(self, value: Any) -> None:
        self.arrays.positions = value

    @property
    def velocities(self) -> np.ndarray:
        """(N, 3) float32 m/s, in id order; may be assigned, as `Arrays` says."""
        return self.arrays.velocities

    @velocities.setter
    def velocities(self, value: Any) -> None:
        self.arrays.velocities = value

    @property
    def particles(self) -> Particles:
        """All particles in id order, with colors and attributes, as `Arrays.particles` says."""
        return self.arrays.particles()

    @property
    def shown_particles(self) -> Particles:
        """The particles that images show."""
        particles = self.particles
        return particles[np.asarray(particles.weight) > 0]

    def hash(self) -> str:
        """16 hexadecimal digits of the state's bits: equal for equal runs."""
        return self.arrays.hash()

    def _send(self) -> None:
        """Hand what changed to the core."""
        last_change = Steered.last_change
        if self._sent is last_change:
            return
        self._solver.send()
        frame = 1 / self.file.output.fps
        for name, emitter in self.emitters.items():
            check_emitter(name, emitter, self.settings.fluid_spacing, frame)
        self.tissue._send()
        self._sent = last_change

    @whole
    def save(self, name: str | os.PathLike[str]) -> None:
        """Write the whole state to NAME.npz, for `load`; the file appears whole or not at all.

        Raises:
            ValueError: `load` could not read the state; an existing file stays.
            OSError: a file that cannot be written.
        """
        self._send()
        facts = {"scene": as_dict(self.file), "record": self.record._facts(), "by_hand": self._by_hand()}
        state = self.arrays.state()
        try:
            self.arrays._check_state(state)
        except ValueError as error:
            expected = f"{checkpoint.path_of(name)}: expected a state that can be loaded again"
            raise ValueError(f"{expected}, {error}") from None
        checkpoint.save(name, state | self.foam._state(), facts)
        _log.info("%s: checkpoint at %g s", checkpoint.path_of(name), self.time)

    @classmethod
    def load(cls, name: str | os.PathLike[str], device: str = "auto", threads: int = 0) -> Simulation:
        """A simulation that continues from a file of `save`, on the CPU with the same bits.

        Raises:
            OSError: a file that cannot be read.
            ValueError: the file is not a checkpoint.
        """
        arrays, facts = checkpoint.load(name)
        try:
            sim = cls(facts["scene"], device=device, threads=threads)
            sim._take_up(facts["by_hand"])
            sim.arrays.set_state(arrays)
            sim.foam._take_up(arrays)
            sim.record._take_up(facts["record"])
            return sim
        except (
            ValueError, KeyError, TypeError, AttributeError, IndexError, OverflowError,
            ArithmeticError, MemoryError,
        ) as error:  # fmt: skip
            what = f"{error} is missing" if isinstance(error, KeyError) else error
            raise ValueError(f"{checkpoint.path_of(name)}: expected a checkpoint of a simulation, {what}") from error

    @whole
    def reset(self) -> None:
        """Go back to the start, with its materials, emitters and instruments.

        Raises:
            ValueError: the scene has no tissue at its start, but the simulation has bonds.
        """
        state, by_hand = self._first
        if self._core.tissue().n() and "tissue_at" not in state:
            raise ValueError("reset: expected a scene's own tissue, got tissue bonded in Python")
        self.record._clear()
        self.foam._clear()
        self._take_up(by_hand)
        self.arrays.set_state(state)

    def _by_hand(self) -> dict[str, Any]:
        """All that may change between steps but the state's arrays, as JSON holds it."""
        kept = {
            "settings": {name: getattr(self.settings, name) for name in SETTINGS},
            "phases": [_values(phase) for phase in self.phases.values()],
            "emitters": {name: emitter._state() for name, emitter in self.emitters.items()},
            **self.steer._by_hand(),
            "had_sinks": self._had_sinks,
            **self.tissue._by_hand(),
            **self.tools._by_hand(),
        }
        return json.loads(json.dumps(kept))

    def _take_up(self, by_hand: dict[str, Any]) -> None:
        """Restore what `_by_hand` returned."""
        for name, value in by_hand["settings"].items():
            setattr(self.settings, name, value)
        for values in by_hand["phases"]:
            if values["name"] not in self.phases:
                self.add_phase(Phase(**values))
            self.phases[values["name"]]._begin(values)
        for name, state in by_hand["emitters"].items():
            if name not in self.emitters:
                keys = ("center", "direction", "radius", "rate", "fluid", "start", "end")
                self.emitters[name] = Emitter(*(state[key] for key in keys))
            self.emitters[name]._go_on(state)
            if self.emitters[name].radius > math.dist(*self.settings.domain.bounds()):
                raise ValueError(f"emitters[{name!r}].radius: expected less than the domain's size")
        self.steer._take_up(by_hand)
        self._had_sinks = bool(by_hand["had_sinks"])
        self.tissue._take_up(by_hand)
        self.tools._take_up(by_hand)
        self._send()


def _values(phase: Phase) -> dict[str, Any]:
    return {name: getattr(phase, name) for name in Phase.__dataclass_fields__}
