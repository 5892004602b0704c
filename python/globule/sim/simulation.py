"""Simulations: particles that flow, on the octree that is also traced."""

from __future__ import annotations

import json
import math
import threading
from dataclasses import asdict
from typing import Any

import numpy as np

from .. import _core
from .._base.arrays import address, to_host
from .._base.checks import thread_count
from .._base.device import choose
from .._base.interrupts import whole
from ..scene.particles import Particles
from ..scene.scene import DEFAULTS, KERNELS, Scene
from .arrays import Arrays, check_finite, numbers
from .bodies import bodies
from .emitter import Emitter
from .limits import check_emitter, check_material
from .moving import Moving
from .operate import Operable
from .run import Run, description, is_scene
from .scene_file import read_scene
from .settings import MAX_PHASES, Phase, Settings, StepReport
from .steered import Named, made
from .tools import Tool
from .walls import box_walls, of_particles


class _SimulationScene(Scene):
    """The scene of a simulation: the same octree, brought up to date when it is looked at."""

    def __init__(self, simulation: Simulation, device: Any, threads: int, support: float):
        self._simulation = simulation
        self._own = _core.Scene(device.backend, device.index, threads)
        self.device = device
        self.kernel = "murakami"
        self.threshold = DEFAULTS[self.kernel][1]
        self._kernel = KERNELS.index(self.kernel)
        self._support = self.support = support

    @property
    def _scene(self) -> Any:
        return self._own

    @property
    def particles(self) -> Particles:  # type: ignore[override]
        return self._simulation.particles

    def __len__(self) -> int:
        return len(self._simulation)

    @property
    def builds(self) -> int:  # type: ignore[override]
        return self._simulation.n_steps

    @property
    def spacing(self) -> float:
        return self._simulation.settings.spacing

    def update(self, *_: Any, **__: Any) -> None:
        raise TypeError("update: the scene of a simulation follows its particles")


def settings_of(scene: Any) -> dict[str, Any]:
    """A dict of `Settings`, `phases` and `walls`."""
    if not isinstance(scene, dict):
        raise TypeError(f"scene: expected a name, a path, a dict or Particles, got {scene!r}")
    return dict(scene)


def phases_of(values: Any) -> list[Phase]:
    """The `phases` of such a dict."""
    if not isinstance(values, (list, tuple)):
        raise ValueError(f"phases: expected a list of dicts, got {values!r}")
    return [made(Phase, of_one, f"phases[{i}]") for i, of_one in enumerate(values)]


class Simulation(Run, Operable, Moving, Arrays):
    """A simulation of fluids.

    Args:
        scene: the name of a scene that ships, the path of a .toml file, or a dict as TOML has it
            (docs/reference/scene-keys.md); or a dict with `spacing`, `domain` and what else `Settings` has,
            `phases` (a list of dicts, see `Phase`) and `walls` (True: the domain's box is a
            boundary); or `Particles`, a fluid in its box.
        device: "auto", "cpu", "cuda" or "cuda:N".
        threads: CPU threads; 0 takes all.
        spacing: of particles, m, instead of a scene file's own.
    """

    def __init__(
        self,
        scene: Any,
        device: str = "auto",
        threads: int = 0,
        spacing: float | None = None,
    ):
        self._lock = threading.RLock()
        file = read_scene(scene, spacing) if is_scene(scene) else None
        found = bodies(file) if file else []
        if file:
            facts = description(file, found)
        else:
            facts = of_particles(scene) if isinstance(scene, Particles) else settings_of(scene)
        phases = phases_of(facts.pop("phases", [{"name": "fluid"}]))
        walls = facts.pop("walls", True)
        self.settings = made(Settings, facts, others=("phases", "walls"))
        self._begin(file)
        self.instruments: dict[str, Tool] = Named("instruments", Tool)
        self._sinks: list[list[float]] = []
        self.phases: dict[str, Phase] = Named("phases", Phase)
        self._names: list[str] = []
        self._sent: list[dict[str, Any]] = []
        chosen = choose(device)
        d = float(self.settings.spacing)
        self.scene = _SimulationScene(self, chosen, thread_count(threads), 2.0 * d)
        self._core = _core.Simulation(self.scene._own)
        self._forces = np.empty(0, np.uint32), np.empty((0, 3), np.float32)  # of these ids
        self._moving: set[int] = set()
        self.emitters: dict[str, Emitter] = Named("emitters", Emitter)
        for phase in phases:
            self.add_phase(phase)
        self._send()
        if walls:
            if "walls" not in self.phases:
                self.add_phase(Phase("walls", kind="boundary"))
            lo, hi = np.asarray(self.settings.domain, float)
            self.add(box_walls(lo, hi, d, self.settings.periodic), phase="walls")
        if isinstance(scene, Particles):
            self.add(scene.positions, self._names[0], scene.attributes.get("velocity", 0.0))
        added = [(body, self.add(body.positions, body.name, body.velocities)) for body in found]
        if file:
            self._set_up(file, added)

    @whole
    def add_phase(self, phase: Phase) -> None:
        """One more material."""
        if not isinstance(phase, Phase):
            raise TypeError(f"phase: expected a gb.Phase, got {phase!r}")
        if len(self._names) == MAX_PHASES:
            raise ValueError(f"phases: expected at most {MAX_PHASES}")
        if phase.name in self.phases:
            raise ValueError(f"phases: expected different names, got {phase.name!r} twice")
        self.phases[phase.name] = phase
        self._names.append(phase.name)

    @whole
    def add(self, positions: Any, phase: str | None = None, velocities: Any = 0.0) -> np.ndarray:
        """New particles: positions (M, 3) m, velocities (M, 3), (3,) or 0, m/s. Returns ids."""
        which = self._phase(phase)
        self._send()
        p = np.ascontiguousarray(to_host(positions), np.float32)
        if p.ndim != 2 or p.shape[1] != 3:
            raise ValueError(f"positions: expected shape (M, 3), got {p.shape}")
        v = np.asarray(to_host(velocities), np.float32)
        if v.shape not in ((), (3,), p.shape):
            raise ValueError(f"velocities: expected a number, (3,) or {p.shape}, got {v.shape}")
        if len(p) == 0:
            return np.empty(0, np.uint32)
        check_finite("positions", p)
        check_finite("velocities", v)
        each = np.ascontiguousarray(v) if v.shape == p.shape else None
        one = [0.0, 0.0, 0.0] if each is not None else np.broadcast_to(v, 3).tolist()
        first = self._core.add(len(p), address(p), 0 if each is None else address(each), one, which)
        return np.arange(first, first + len(p), dtype=np.uint32)

    @whole
    def remove(self, ids: Any) -> None:
        """Take particles out, by id."""
        given = np.asarray(ids).reshape(-1)
        unknown = given[(given < 0) | (given >= self._core.next_id())]
        if len(unknown):
            raise ValueError(f"ids: expected numbers that add() gave, got {unknown[0]}")
        gone = np.ascontiguousarray(given, np.uint32)
        if len(gone):
            n_before = len(self)
            self._core.remove(len(gone), address(gone))
            self.n_removed += n_before - len(self)

    @whole
    def apply_force(self, force: Any, ids: Any = None) -> None:
        """A force on each particle (or those of `ids`) during the next step: (3,) or (M, 3), N."""
        known = self.ids
        chosen = known if ids is None else np.asarray(ids).reshape(-1)
        unknown = np.setdiff1d(chosen, known)
        if len(unknown):
            raise ValueError(f"ids: expected particles of this simulation, got {unknown[0]}")
        total = self._forces_of(known)
        more = np.zeros_like(total)
        more[np.searchsorted(known, chosen)] = numbers("force", force, (3,), (len(chosen), 3))
        self._forces = known, total + more

    def _forces_of(self, ids: np.ndarray) -> np.ndarray:
        """What acts on each during the next step."""
        found = np.zeros((len(ids), 3), np.float32)
        _, here, there = np.intersect1d(ids, self._forces[0], return_indices=True)
        found[here] = self._forces[1][there]
        return found

    def step(self, dt: float | None = None) -> StepReport:
        """One step of dt seconds; by default of what the speeds allow."""
        if dt is not None and not 0 < dt < math.inf:
            raise ValueError(f"dt: expected a finite number above 0, got {dt}")
        return self._step(dt)

    @whole
    def _step(self, dt: float | None) -> StepReport:
        self._send()
        dt = self._next_dt() if dt is None else float(dt)
        self._prepare(dt)
        for emitter in self.emitters.values():
            emitter._emit(self, dt)
        if len(self._forces[0]):
            forces = self._forces_of(self._read("id"))
            self._core.set_forces(address(forces))
            self._forces = self._forces[0][:0], self._forces[1][:0]
        done = self._core.step(dt)
        if "lost" in done:
            id_, phase, position = done["lost"]
            time, step = done["time"], done["step"]
            where = ", ".join(f"{x:g}" for x in position)
            raise ArithmeticError(
                f"particle {id_} ({self._names[phase]}) at ({where}) got a velocity that is not a "
                f"number in step {step} at {time:g} s"
            )
        report = StepReport(**done)
        self._move_pushers(dt)
        self._operate()
        self._note(report)
        return report

    @property
    def time(self) -> float:
        return self._core.time()

    @property
    def n_steps(self) -> int:
        return self._core.n_steps()

    @property
    def dt(self) -> float:
        """The step that comes next, s."""
        self._send()
        return self._next_dt()

    def _next_dt(self) -> float:
        dt = self._core.next_dt()
        if not self.time + dt > self.time:
            gravity = math.hypot(*self.settings.gravity)
            speed = np.linalg.norm(self.velocities, axis=1).max(initial=0)
            raise ArithmeticError(
                f"the steps come to {dt:g} s at {self.time:g} s: expected less gravity "
                f"(it is {gravity:g} m/s²), lower speeds (up to {speed:g} m/s), or other materials"
            )
        return dt

    def __len__(self) -> int:
        return self._core.size()

    def _phase(self, name: str | None) -> int:
        if name is None:
            return 0
        if name not in self.phases:
            raise ValueError(f"phase: expected one of {', '.join(self._names)}, got {name!r}")
        return self._names.index(name)

    def _send(self) -> None:
        """Settings and materials that were changed."""
        settings = self.settings._pack()
        if getattr(self, "_settings_sent", None) != settings:
            self._core.configure(settings)
            self._settings_sent = settings
        for i, name in enumerate(self._names):
            packed = self.phases[name]._pack()
            if i >= len(self._sent):
                self._sent.append({})
            if packed != self._sent[i]:
                check_material(self.phases[name], self.settings.spacing, self._frame)
                self._core.set_phase(i, packed)
                self._sent[i] = packed
        for name, emitter in self.emitters.items():
            check_emitter(name, emitter, self.settings.spacing, self._frame)
        self._send_tissue()

    @property
    def _frame(self) -> float:
        """Seconds between two pictures, as far as anything says."""
        return 1 / self.file.output.fps if self.file else 1 / 30

    def _describe(self) -> dict[str, Any]:
        phases = [asdict(self.phases[name]) for name in self._names]
        described = {**asdict(self.settings), "phases": phases, "walls": False}
        return json.loads(json.dumps(described, default=lambda v: np.asarray(v).tolist()))
