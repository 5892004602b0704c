"""Spray, foam and bubbles that a fluid carries: particles that images show and nothing feels.

After Ihmsen, Akinci, Akinci & Teschner 2012, "Unified spray, foam and bubbles for particle-based
fluids". They never act on the fluid: a simulation has the same bits with and without them.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from .._base.interrupts import whole
from ..data.particles import Particles
from ..pieces.scene import Scene
from ..render.layers import Layer
from ..render.materials import Material
from ..scene.scene import DEFAULTS
from .foam_sources import Flow, limits_of, potentials
from .part import Part
from .solver import Solver

SPRAY, FOAM, BUBBLE = range(3)
KINDS = ("spray", "foam", "bubbles")
FEW, MANY = 6, 20  # fluid neighbors within two spacings: of spray fewer, of bubbles more
BUOYANCY = 2.0  # of a bubble, in gravities
SIZE = 0.25  # diameter in images, spacings
COLOR = (0.9, 0.9, 0.9)
_ARRAYS = {"at": 3, "velocity": 3, "carried": 3, "kind": 0, "age": 0, "life": 0}


class Foam(Part):
    """Spray, foam and bubbles of a simulation whose scene has a table `foam`.

    Each step moves them, creates new ones where the fluid traps air or throws a crest, removes
    those whose life or domain ends, and finds each one's kind from its fluid neighbors. The work is
    NumPy on the host, also where the simulation runs on a GPU. All arrays have the order in which
    the particles came up.
    """

    def __init__(self, solver: Solver):
        super().__init__(solver)
        self._table = solver.file.foam
        self._shown: Scene | None = None
        self._clear()

    def _clear(self) -> None:
        """Remove all of them."""
        self._at, self._velocity, self._carried = (np.zeros((0, 3)) for _ in range(3))
        self._kind, self._age, self._life = np.zeros(0, np.uint8), np.zeros(0), np.zeros(0)
        self._shown_is_old = True

    @property
    def on(self) -> bool:
        """Whether the scene has a table `foam`."""
        return self._table is not None

    def __len__(self) -> int:
        return len(self._at)

    @property
    @whole
    def positions(self) -> np.ndarray:
        """(M, 3) float32, m."""
        return self._at.astype(np.float32)

    @property
    @whole
    def velocities(self) -> np.ndarray:
        """(M, 3) float32, m/s."""
        return self._velocity.astype(np.float32)

    @property
    @whole
    def kind(self) -> np.ndarray:
        """(M,) uint8: 0 spray, 1 foam, 2 bubbles."""
        return self._kind.copy()

    @property
    @whole
    def age(self) -> np.ndarray:
        """(M,) float32, s since each came up."""
        return self._age.astype(np.float32)

    @property
    def counts(self) -> dict[str, int]:
        """Number of spray, foam and bubbles."""
        return dict(zip(KINDS, np.bincount(self._kind, minlength=3).tolist(), strict=True))

    @whole
    def particles(self) -> Particles:
        """All of them, white, with the attributes velocity (m/s), kind and age (s)."""
        return Particles(
            self.positions,
            support=DEFAULTS["murakami"][0] * SIZE * self._solver.settings.spacing,
            color=COLOR,
            attributes={"velocity": self.velocities, "kind": self.kind, "age": self.age},
        )

    @whole
    def layer(self) -> Layer:
        """White spheres, a quarter of a spacing wide, for an image beside the fluid:
        `gb.render([sim.scene, sim.foam.layer()])`. All calls return the same scene; the first call
        after a step updates it."""
        if self._shown is None:
            self._shown = Scene(self.particles(), device=self._solver.device.name)
        elif self._shown_is_old:  # an update ends the refinement of earlier frames
            self._shown.update(self.particles())
        self._shown_is_old = False
        return Layer(self._shown, Material(reflection=0.0, transmission=0.0))

    @whole
    def potentials(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """What the fluid is about to create.

        Returns:
            ids (M,) uint32 of all fluid particles, ascending, and their potentials, (M,) from 0 to
            1 each: trapped air, wave crest, kinetic energy.

        Raises:
            ValueError: the scene has no table `foam`.
        """
        if self._table is None:
            raise ValueError("foam: expected a table foam in the scene, got none")
        flow = Flow(self._solver)
        rows = np.flatnonzero(flow.is_fluid)
        rows = rows[np.argsort(flow.ids[rows])]
        return flow.ids[rows], *potentials(flow, rows, self._limits())

    def _limits(self) -> dict[str, tuple[float, float]]:
        assert self._table is not None  # asked where there is foam
        file = self._solver.file
        return limits_of(self._table, float(np.linalg.norm(file.gravity)), file.spacing)

    def _advance(self, dt: float) -> None:
        """After a step of dt seconds."""
        if self._table is None:
            return
        self._shown_is_old = True
        self._move(dt)
        flow = Flow(self._solver)
        self._create(flow, dt)
        self._keep(np.arange(len(self)) >= len(self) - self._table.max_particles)
        self._classify(flow)

    def _move(self, dt: float) -> None:
        """Spray flies, foam goes with the fluid, bubbles rise in it: each along the exact solution
        of its motion with the fluid and the gravity of the step."""
        gravity = np.asarray(self._solver.settings.gravity, float)
        spray, foam, bubble = (self._kind == kind for kind in (SPRAY, FOAM, BUBBLE))
        self._at[spray] += self._velocity[spray] * dt + 0.5 * dt * dt * gravity
        self._velocity[spray] += gravity * dt
        self._velocity[foam] = self._carried[foam]
        self._at[foam] += self._velocity[foam] * dt
        # dv/dt = -BUOYANCY g + (fluid - v) / tau, with the terminal speed sqrt(g spacing)
        pull, spacing = float(np.linalg.norm(gravity)), self._solver.settings.spacing
        tau = np.sqrt(spacing / pull) / BUOYANCY if pull else 0.0
        rest = np.exp(-dt / tau) if pull else 0.0
        end = self._carried[bubble] - BUOYANCY * tau * gravity
        excess = self._velocity[bubble] - end
        self._at[bubble] += end * dt + excess * (tau * (1.0 - rest))
        self._velocity[bubble] = end + excess * rest
        self._age += dt
        self._life[foam] -= dt
        lo, hi = self._solver.settings.domain.bounds()
        for k in range(3):
            if "xyz"[k] in self._solver.settings.domain.periodic:
                self._at[:, k] = lo[k] + (self._at[:, k] - lo[k]) % (hi[k] - lo[k])
        inside = ((self._at >= lo) & (self._at <= hi)).all(axis=1)
        self._keep(inside & (self._life > 0))

    def _create(self, flow: Flow, dt: float) -> None:
        """New ones: n = kinetic (air_rate trapped + crest_rate crest) dt of each fluid particle,
        up or down to a whole number so that the mean is n."""
        table, limits = self._table, self._limits()
        assert table is not None
        v2 = np.einsum("ij,ij->i", flow.velocities, flow.velocities)
        rows = np.flatnonzero(flow.is_fluid & (v2 > limits["speed"][0] ** 2))
        rows = rows[np.argsort(flow.ids[rows])]
        trapped, crest, kinetic = potentials(flow, rows, limits)
        n = kinetic * (table.air_rate * trapped + table.crest_rate * crest) * dt
        step = self._solver.core.n_steps()
        count = np.floor(n + uniform(table.seed, flow.ids[rows], step, 0)).astype(np.int64)
        from_ = np.repeat(rows, count)
        nth = np.arange(len(from_)) - np.repeat(np.cumsum(count) - count, count)
        radius, angle, back, life = (uniform(table.seed, flow.ids[from_], step, 4 * nth + k) for k in range(1, 5))
        velocity = flow.velocities[from_]
        axis = velocity / np.linalg.norm(velocity, axis=1, keepdims=True)
        helper = np.eye(3)[np.argmin(np.abs(axis), axis=1)]
        u = np.cross(axis, helper)
        u /= np.linalg.norm(u, axis=1, keepdims=True)
        turn = 2 * np.pi * angle[:, None]
        across = np.cos(turn) * u + np.sin(turn) * np.cross(axis, u)
        across *= 0.5 * self._solver.settings.spacing * np.sqrt(radius)[:, None]
        at = flow.positions[from_] + across - (back * dt)[:, None] * velocity
        self._add(at, velocity, table.lifetime * (0.5 + life))

    def _add(self, at: np.ndarray, velocity: np.ndarray, life: np.ndarray) -> None:
        self._at = np.concatenate([self._at, at])
        self._velocity = np.concatenate([self._velocity, velocity])
        self._life = np.concatenate([self._life, life])
        more = len(self._at) - len(self._age)
        self._carried = np.concatenate([self._carried, np.zeros((more, 3))])
        self._kind = np.concatenate([self._kind, np.zeros(more, np.uint8)])
        self._age = np.concatenate([self._age, np.zeros(more)])

    def _classify(self, flow: Flow) -> None:
        """Kinds, and the fluid's velocity around each."""
        if len(self):
            n, self._carried = flow.around(self._at)
            self._kind = np.where(n < FEW, SPRAY, np.where(n > MANY, BUBBLE, FOAM)).astype(np.uint8)

    def _keep(self, which: np.ndarray) -> None:
        if not which.all():
            for name in _ARRAYS:
                setattr(self, f"_{name}", getattr(self, f"_{name}")[which])

    def _state(self) -> dict[str, np.ndarray]:
        """Copies of what a checkpoint keeps of it."""
        if not self.on:
            return {}
        return {f"foam_{name}": getattr(self, f"_{name}").copy() for name in _ARRAYS}

    def _take_up(self, state: Mapping[str, np.ndarray]) -> None:
        """From what `_state` gave; without foam in it, there is none. Raises ValueError for
        anything else."""
        self._clear()
        if not self.on or "foam_at" not in state:
            return
        n = len(np.atleast_1d(state["foam_at"]))
        for name, columns in _ARRAYS.items():
            now, value = getattr(self, f"_{name}"), np.asarray(state[f"foam_{name}"])
            shape = (n, columns) if columns else (n,)
            if value.shape != shape or value.dtype != now.dtype or not np.isfinite(value).all():
                expected = f"expected finite {now.dtype} {shape}"
                raise ValueError(f"foam_{name}: {expected}, got {value.dtype} {value.shape}")
        if state["foam_kind"].max(initial=0) > BUBBLE:
            raise ValueError(f"foam_kind: expected 0 to {BUBBLE}")
        for name in _ARRAYS:
            setattr(self, f"_{name}", np.array(state[f"foam_{name}"]))


def uniform(seed: int, ids: Any, step: int, counter: Any) -> np.ndarray:
    """Numbers (M,) from 0 to below 1 that depend on these whole numbers alone: rounds of
    splitmix64 (Steele, Lea & Flood 2014)."""
    found = np.zeros(np.broadcast(ids, counter).shape, np.uint64)
    with np.errstate(over="ignore"):
        for part in (seed, ids, step, counter):
            found = (found ^ np.asarray(part, np.uint64)) + np.uint64(0x9E3779B97F4A7C15)
            found = (found ^ (found >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
            found = (found ^ (found >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
            found ^= found >> np.uint64(31)
    return (found >> np.uint64(11)) * 2.0**-53
