"""Simulations: particles that flow, on the octree that is also traced."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields
from typing import Any

import numpy as np

from . import _core
from .arrays import address
from .device import choose
from .particles import Particles, to_host
from .scene import DEFAULTS, KERNELS, Scene, _count
from .sim.bodies import bodies
from .sim.emitter import Emitter
from .sim.operate import Operable
from .sim.run import Run, description, is_scene
from .sim.scene_file import read_scene

KINDS = ("fluid", "tissue", "boundary", "rigid")
MAX_PHASES = 32
_ARRAYS = {
    "place": (np.float32, 4),
    "velocity": (np.float32, 4),
    "id": (np.uint32, 1),
    "phase": (np.uint8, 1),
    "pressure": (np.float32, 1),
    "impulse": (np.float32, 1),
    "divergence_impulse": (np.float32, 1),
}


@dataclass
class Phase:
    """A material of a simulation; any value may be changed between steps. SI units.

    kind: fluid, tissue, boundary (fixed or moved by key frames) or rigid (a floating body).
    Of tissue: damping, 1/s; tear_strain beyond which bonds break, 0: never; yield_strain beyond
    which the share creep_rate, 1/s, of the strain becomes permanent, 0: never.
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
        packed = {f.name: getattr(self, f.name) for f in fields(self)}
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
        packed = {f.name: getattr(self, f.name) for f in fields(self) if f.name != "domain"}
        lo, hi = np.asarray(self.domain, float)
        packed["lo"], packed["hi"] = lo.tolist(), hi.tolist()
        packed["periodic"] = [bool(p) for p in self.periodic]
        short = [hi[k] - lo[k] < 8 * self.spacing and packed["periodic"][k] for k in range(3)]
        if any(short):
            raise ValueError("periodic: expected an axis at least 8 spacings long")
        if self.sound_speed is None:
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
        self._simulation._core.show()
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


class Simulation(Run, Operable):
    """A simulation of fluids.

    Args:
        scene: the name of a scene that ships, the path of a .toml file, or a dict as TOML has it
            (docs/simulation.md); or a dict with `spacing`, `domain` and what else `Settings` has,
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
        file = read_scene(scene, spacing) if is_scene(scene) else None
        found = bodies(file) if file else []
        if file:
            facts = description(file, found)
        else:
            facts = _of_particles(scene) if isinstance(scene, Particles) else dict(scene)
        phases = [Phase(**p) for p in facts.pop("phases", [{"name": "fluid"}])]
        walls = facts.pop("walls", True)
        self.settings = Settings(**facts)
        self._begin(file)
        self.phases: dict[str, Phase] = {}
        self._names: list[str] = []
        self._sent: list[dict[str, Any]] = []
        chosen = choose(device)
        d = float(self.settings.spacing)
        self.scene = _SimulationScene(self, chosen, _count("threads", threads), 2.0 * d)
        self._core = _core.Simulation(chosen.backend, self.scene._own)
        self._forces: np.ndarray | None = None
        self._moving: set[int] = set()
        self.emitters: dict[str, Emitter] = {}
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

    def add_phase(self, phase: Phase) -> None:
        """One more material."""
        if len(self._names) == MAX_PHASES:
            raise ValueError(f"phases: expected at most {MAX_PHASES}")
        if phase.name in self.phases:
            raise ValueError(f"phases: expected different names, got {phase.name!r} twice")
        self.phases[phase.name] = phase
        self._names.append(phase.name)

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
        _check_finite("positions", p)
        _check_finite("velocities", v)
        each = np.ascontiguousarray(v) if v.shape == p.shape else None
        one = [0.0, 0.0, 0.0] if each is not None else np.broadcast_to(v, 3).tolist()
        first = self._core.add(len(p), address(p), 0 if each is None else address(each), one, which)
        return np.arange(first, first + len(p), dtype=np.uint32)

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

    def apply_force(self, force: Any, ids: Any = None) -> None:
        """A force on each particle (or those of `ids`) during the next step: (3,) or (M, 3), N."""
        order, n = self._order(), len(self)
        if self._forces is None:
            self._forces = np.zeros((n, 3), np.float32)
        chosen = slice(None)
        if ids is not None:
            unknown = np.setdiff1d(ids, self.ids)
            if len(unknown):
                raise ValueError(f"ids: expected particles of this simulation, got {unknown[0]}")
            chosen = np.searchsorted(self.ids, ids)
        by_id = np.zeros((n, 3), np.float32)
        by_id[chosen] = force
        self._forces[order] += by_id

    def move_boundary(self, phase: str, pose: Any) -> None:
        """Where a boundary's phase will be at the end of the next step: (4, 4) world_from_body.

        The first call says where it is now.
        """
        which = self._phase(phase)
        numbers = np.asarray(pose, float).reshape(16).tolist()
        if which in self._moving:
            self._core.move_to(which, numbers)
        else:
            self._core.capture(which, numbers)
            self._moving.add(which)

    def make_rigid(
        self, phase: str, density: float, velocity: Any = (0, 0, 0), spin: Any = (0, 0, 0)
    ) -> None:
        """The particles of a phase of kind "rigid" become one body, which they fill."""
        which = self._phase(phase)
        if self.phases[phase].kind != "rigid":
            raise ValueError(f"phase: expected one of kind rigid, got {phase!r}")
        at = self.positions[self.phase == which].astype(float)
        if len(at) == 0:
            raise ValueError(f"phase: expected particles of {phase!r} to be added first")
        each = density * self.settings.spacing**3
        center = at.mean(0)
        x = at - center
        # A particle's own cube keeps the inertia of a few from being singular.
        own = each * self.settings.spacing**2 / 6
        inertia = np.eye(3) * (each * (x**2).sum() + own * len(x)) - each * x.T @ x
        numbers = np.concatenate([center, inertia.ravel(), velocity, spin]).astype(float)
        self._core.make_body(which, each * len(at), numbers.tolist())

    def body(self, phase: str) -> dict[str, np.ndarray]:
        """A rigid body's center, velocity, spin (3,) and rotation (3, 3), world."""
        v = np.array(self._core.body(self._phase(phase)))
        return {
            "center": v[:3],
            "velocity": v[3:6],
            "spin": v[6:9],
            "rotation": v[9:].reshape(3, 3),
        }

    def set_sinks(self, sinks: Any) -> None:
        """Regions that take fluid out: (lo, hi) corners of a box, (center, radius) of a ball, …"""
        packed = []
        for a, b in sinks:
            ball = np.ndim(b) == 0
            lo, hi, center = (np.zeros(3), np.zeros(3), a) if ball else (a, b, np.zeros(3))
            packed.append([*map(float, (*lo, *hi, *center)), float(b) if ball else 0.0])
        if len(packed) > 32:
            raise ValueError(f"sinks: expected at most 32, got {len(packed)}")
        self._core.set_sinks(packed)

    def step(self, dt: float | None = None) -> StepReport:
        """One step of dt seconds; by default of what the speeds allow."""
        if dt is not None and not 0 < dt < math.inf:
            raise ValueError(f"dt: expected a finite number above 0, got {dt}")
        self._send()
        dt = self._core.next_dt() if dt is None else float(dt)
        self._prepare(dt)
        for emitter in self.emitters.values():
            emitter._emit(self, dt)
        if self._forces is not None:
            self._core.set_forces(address(self._forces))
            self._forces = None
        done = self._core.step(dt)
        if "lost" in done:
            id_, phase, position, time, step = done["lost"]
            where = ", ".join(f"{x:g}" for x in position)
            raise ArithmeticError(
                f"particle {id_} ({self._names[phase]}) at ({where}) got a velocity that is not a "
                f"number in step {step} at {time:g} s"
            )
        report = StepReport(**done)
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
        return self._core.next_dt()

    def __len__(self) -> int:
        return self._core.size()

    @property
    def ids(self) -> np.ndarray:
        """(N,) uint32, ascending; the order of all arrays here."""
        return np.sort(self._read("id"))

    @property
    def positions(self) -> np.ndarray:
        """(N, 3) float32, m."""
        return np.ascontiguousarray(self._read("place")[self._order(), :3])

    @positions.setter
    def positions(self, value: Any) -> None:
        place = self._read("place")
        place[self._order(), :3] = value
        _check_finite("positions", place[:, :3])
        self._write("place", place)
        self._core.settle()

    @property
    def velocities(self) -> np.ndarray:
        """(N, 3) float32, m/s."""
        return np.ascontiguousarray(self._read("velocity")[self._order(), :3])

    @velocities.setter
    def velocities(self, value: Any) -> None:
        velocity = self._read("velocity")
        velocity[self._order(), :3] = value
        self._write("velocity", velocity)
        self._core.settle()

    @property
    def pressure(self) -> np.ndarray:
        """(N,) float32, Pa, of the last step."""
        return self._read("pressure")[self._order()]

    @property
    def phase(self) -> np.ndarray:
        """(N,) uint8: which of `phases`, by their order."""
        return self._read("phase")[self._order()]

    @property
    def particles(self) -> Particles:
        """All particles in id order, as they are rendered."""
        order = self._order()
        phase = self._read("phase")[order]
        colors = np.array([self.phases[n].color for n in self._names], np.float32)
        shown = np.array([bool(self.phases[n].shown) for n in self._names], np.float32)
        return Particles(
            self._read("place")[order, :3],
            support=2.0 * self.settings.spacing,
            color=colors[phase],
            weight=shown[phase],
            attributes={
                "velocity": self._read("velocity")[order, :3],
                "phase": phase,
                "id": self._read("id")[order],
            },
        )

    def neighbors(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The solver's lists: ids of the moved particles, and as compressed rows (offsets, ids)
        their neighbours within two spacings."""
        ids = self._read("id")
        rows, offsets, indices = self._core.neighbors()
        return ids[rows], offsets, ids[indices]

    def totals(self) -> dict[str, Any]:
        """Of fluid and tissue: mass, kinetic and potential energy, momentum, angular_momentum
        (about the origin), center; SI."""
        t = self._core.totals()
        mass = t["mass"] or 1.0
        return {**t, "center": tuple(c / mass for c in t["center"])}

    def hash(self) -> str:
        """Of the state's bits; equal for equal runs."""
        h = hashlib.sha256()
        for name in ("id", "place", "velocity"):
            h.update(self._read(name).tobytes())
        return h.hexdigest()[:16]

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
                self._core.set_phase(i, packed)
                self._sent[i] = packed
        self._send_tissue()

    def _read(self, name: str) -> np.ndarray:
        dtype, columns = _ARRAYS[name]
        out = np.empty((len(self), columns) if columns > 1 else len(self), dtype)
        if len(self):
            self._core.read(name, address(out))
        return out

    def _write(self, name: str, values: np.ndarray) -> None:
        if len(self):
            self._core.write(name, address(np.ascontiguousarray(values, _ARRAYS[name][0])))

    def _order(self) -> np.ndarray:
        return np.argsort(self._read("id"))

    def _describe(self) -> dict[str, Any]:
        phases = [asdict(self.phases[name]) for name in self._names]
        described = {**asdict(self.settings), "phases": phases, "walls": False}
        return json.loads(json.dumps(described, default=lambda v: np.asarray(v).tolist()))

    def state(self) -> dict[str, np.ndarray]:
        """Everything that `set_state` needs to go on bit by bit (on the CPU)."""
        arrays = {name: self._read(name) for name in _ARRAYS}
        counts = [self._core.next_id(), self.n_steps]
        clock = {"time": np.array(self.time), "counts": np.array(counts, np.uint64)}
        return {**arrays, **self._tissue_state(), **clock}

    def set_state(self, state: Mapping[str, np.ndarray]) -> None:
        """Go on from what `state` gave."""
        next_id, n_steps = (int(c) for c in state["counts"])
        gone = np.setdiff1d(self._read("id"), state["id"])  # or their slots would pass for taken
        if len(gone):
            self._core.remove(len(gone), address(gone))
        self._core.resize(len(state["id"]), next_id, float(state["time"]), n_steps)
        for name in _ARRAYS:
            self._write(name, state[name])
        self._core.settle()
        self._set_tissue_state(state)


def _check_finite(name: str, values: np.ndarray) -> None:
    if not np.isfinite(values).all():
        raise ValueError(f"{name}: expected finite numbers, got a NaN or an infinity")


def box_walls(lo: Any, hi: Any, spacing: float, periodic: Any = (False,) * 3) -> np.ndarray:
    """One layer of particles half a spacing outside of a box's faces: (M, 3) float32.

    Along a periodic axis the layer has no end, and no face closes it.
    """
    lo, hi = np.asarray(lo, float), np.asarray(hi, float)
    n = np.maximum(np.rint((hi - lo) / spacing - 1e-6).astype(int), 1)
    axes, ends = [], []
    for k in range(3):
        step = (hi[k] - lo[k]) / n[k]
        first = 0 if periodic[k] else -1
        i = np.arange(first, n[k] - first)
        axes.append(lo[k] + (i + 0.5) * step)
        ends.append((i < 0) | (i >= n[k]))
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), -1)
    outside = ends[0][:, None, None] | ends[1][None, :, None] | ends[2][None, None, :]
    return np.ascontiguousarray(grid[outside], np.float32)


def _of_particles(particles: Particles) -> dict[str, Any]:
    """A fluid in its own box, with as much room again above it: a full box leaves none to flow."""
    from .spacing import local_spacing

    d = float(np.median(local_spacing(particles.positions, k=3)))
    lo, hi = (corner.astype(float) for corner in particles.bounds())
    hi[1] += hi[1] - lo[1] + d
    return {"spacing": d, "domain": (lo - d / 2, hi + d / 2)}
