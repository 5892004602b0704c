"""A simulation's particles as arrays, in id order; its whole state, in the solver's order."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from .._base.arrays import to_host
from .._base.checks import array_of_numbers, shown
from .._base.interrupts import whole
from ..data.particles import Particles
from .part import Part, Stateful
from .solver import ARRAYS, Solver
from .state_checks import check_clock, check_crowds


def check_finite(name: str, values: np.ndarray) -> None:
    """Raise ValueError for a NaN or an infinity."""
    if not np.isfinite(values).all():
        raise ValueError(f"{name}: expected finite numbers, got a NaN or an infinity")


def vector(name: str, value: Any) -> list[float]:
    """Three finite numbers; anything else is a ValueError."""
    found = array_of_numbers(value)
    if found.shape != (3,) or not np.isfinite(found).all():
        raise ValueError(f"{name}: expected three finite numbers, got {shown(value)}")
    return found.tolist()


def ids_of(values: Any) -> np.ndarray:
    """Particles' numbers (M,); anything but whole numbers is a ValueError."""
    try:
        found = np.asarray(values).reshape(-1)
    except ValueError:  # ragged
        found = np.empty(1)
    if len(found) and found.dtype.kind not in "iu":
        raise ValueError(f"ids: expected whole numbers, got {shown(values)}")
    return found


def real(name: str, values: Any) -> np.ndarray:
    """Real numbers as float32; anything else is a ValueError."""
    if np.ma.is_masked(values):
        raise ValueError(f"{name}: expected numbers, got a masked array with some hidden")
    try:
        given = np.asarray(to_host(values))
    except (TypeError, ValueError, OverflowError):  # ragged
        given = np.empty(0, object)
    if given.dtype.kind not in "biuf":
        which = "real " if given.dtype.kind == "c" else ""
        raise ValueError(f"{name}: expected {which}numbers, got {shown(values)}")
    with np.errstate(over="ignore"):  # too large becomes infinite
        return np.asarray(given, np.float32)


def numbers(name: str, values: Any, *shapes: tuple[int, ...]) -> np.ndarray:
    """Finite float32 of one of these shapes; anything else is a ValueError."""
    found = real(name, values)
    if found.shape not in shapes:
        listed = " or ".join(str(shape) if shape else "a number" for shape in shapes)
        raise ValueError(f"{name}: expected shape {listed}, got {found.shape}")
    check_finite(name, found)
    return found


class Arrays(Part):
    """A simulation's particles as arrays, all in id order, and its whole state.

    `Simulation` has `ids`, `positions` and `velocities` of its own as well.
    """

    def __init__(self, solver: Solver, parts: Sequence[Stateful]):
        super().__init__(solver)
        self._parts = parts  # that have more of the state

    @property
    @whole
    def ids(self) -> np.ndarray:
        """(N,) uint32, ascending: the order of all arrays here."""
        return self._solver.ids()

    @property
    @whole
    def positions(self) -> np.ndarray:
        """(N, 3) float32, m. Assigning other shapes or values that are not finite is a
        ValueError."""
        return self._solver.positions()

    @positions.setter
    @whole
    def positions(self, value: Any) -> None:
        place = self._solver.read("place")
        place[self._solver.order(), :3] = numbers("positions", value, (len(self._solver), 3))
        self._solver.write("place", place)
        self._solver.core.settle()

    @property
    @whole
    def velocities(self) -> np.ndarray:
        """(N, 3) float32, m/s. A program may also assign (3,) or a number; errors as for
        positions."""
        return np.ascontiguousarray(self._solver.read("velocity")[self._solver.order(), :3])

    @velocities.setter
    @whole
    def velocities(self, value: Any) -> None:
        velocity = self._solver.read("velocity")
        shapes = (len(self._solver), 3), (3,), ()
        velocity[self._solver.order(), :3] = numbers("velocities", value, *shapes)
        self._solver.write("velocity", velocity)
        self._solver.core.settle()

    @property
    @whole
    def pressure(self) -> np.ndarray:
        """(N,) float32, Pa, of the last step."""
        return self._solver.read("pressure")[self._solver.order()]

    @property
    @whole
    def density(self) -> np.ndarray:
        """(N,) float32, kg/m³: the density that the solver sees at the current positions, the sum
        over neighbors of volume times kernel, times the rest density. Less within two spacings of
        a free surface. 0 for boundaries and rigid bodies."""
        return self._flow()[0]

    @property
    @whole
    def vorticity(self) -> np.ndarray:
        """(N, 3) float32, 1/s: the curl of the velocities of fluid and tissue, exact for linear
        fields (corrected gradients, Bonet & Lok 1999). 0 for boundaries and rigid bodies, and where
        neighbors do not span the space."""
        return self._flow()[1]

    def _flow(self) -> tuple[np.ndarray, np.ndarray]:
        """Density and vorticity in id order."""
        order, rho = self._solver.order(), self._solver.read("place")[:, 3]
        density, vorticity = np.empty(len(order), np.float32), np.empty((len(order), 3), np.float32)
        if len(order):
            self._solver.core.flow(density, vorticity)
            density[rho < 0] /= -rho[rho < 0]  # a fluid's place holds -1 / density
        return density[order], vorticity[order]

    @property
    @whole
    def phase(self) -> np.ndarray:
        """(N,) uint8: the number of each particle's phase in the order of `Simulation.phases`."""
        return self._solver.phase()

    @whole
    def particles(self) -> Particles:
        """All particles in id order, with colors, and the attributes velocity (m/s), pressure (Pa,
        of the last step), density (kg/m³), vorticity (1/s), phase and id."""
        density, vorticity = self._flow()
        solver, order = self._solver, self._solver.order()
        phase = self._solver.read("phase")[order]
        colors = np.array([p.color for p in solver.phases.values()], np.float32).reshape(-1, 3)
        shown = np.array([bool(p.shown) for p in solver.phases.values()], np.float32)
        return Particles(
            self._solver.read("place")[order, :3],
            support=self._supports(phase),
            color=colors[phase],
            weight=shown[phase],
            attributes={
                "velocity": self._solver.read("velocity")[order, :3],
                "pressure": self._solver.read("pressure")[order],
                "density": density,
                "vorticity": vorticity,
                "phase": phase,
                "id": self._solver.read("id")[order],
            },
        )

    def _supports(self, phase: np.ndarray) -> Any:
        """Of particles of these phases, m: one, or (N,)."""
        solver = self._solver
        if not solver.settings.fine_fluids:
            return 2.0 * solver.settings.spacing
        of_phase = [2.0 * solver.spacing_of(p) for p in solver.phases.values()]
        return np.array(of_phase, np.float32)[phase]

    @whole
    def neighbors(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The solver's neighbor lists as compressed rows.

        Returns:
            ids (R,) uint32 of the particles that the solver moves, offsets (R + 1,), and ids (M,)
            uint32 of their neighbors within two spacings (of a pair: the mean of both).
        """
        ids = self._solver.read("id")
        rows, offsets, indices = self._solver.core.neighbors()
        return ids[rows], offsets, ids[indices]

    @whole
    def hash(self) -> str:
        """16 hexadecimal digits of the state's bits: equal for equal runs."""
        h = hashlib.sha256()
        for name in ("id", "place", "velocity"):
            h.update(self._solver.read(name).tobytes())
        return h.hexdigest()[:16]

    @whole
    def state(self) -> dict[str, np.ndarray]:
        """The state for `set_state`, which continues with the same bits on the CPU: arrays by name,
        in the solver's order."""
        solver = self._solver
        arrays = {name: solver.read(name) for name in ARRAYS}
        for part in self._parts:
            arrays |= part._state()
        counts = [solver.core.next_id(), solver.core.n_steps()]
        clock = {"time": np.array(solver.time), "counts": np.array(counts, np.uint64)}
        return {**arrays, **clock}

    def _check_state(self, state: Mapping[str, np.ndarray]) -> None:
        """Refuse arrays that would be read past their end, or are no state of this simulation.
        Raises ValueError, and KeyError for a missing array."""
        solver = self._solver
        n, n_phases = np.asarray(state["id"]).size, len(solver.phases)
        for name, (dtype, columns) in ARRAYS.items():
            shape = (n, columns) if columns > 1 else (n,)
            values = np.asarray(state[name])
            if values.shape != shape or values.dtype != dtype:
                got = f"{values.dtype} {values.shape}"
                raise ValueError(f"{name}: expected {np.dtype(dtype)} {shape}, got {got}")
        for name in ("place", "velocity", "pressure", "growth", "divergence_impulse"):
            check_finite(name, state[name])
        check_clock(state)
        if n and (int(np.max(state["id"])) >= int(state["counts"][0])
                  or len(np.unique(state["id"])) != n):  # fmt: skip
            raise ValueError("id: expected each once and below the number of ids given")
        if n and int(np.max(state["phase"])) >= n_phases:
            raise ValueError(f"phase: expected numbers below {n_phases}")
        check_crowds(np.asarray(state["place"]), solver.settings.spacing)
        for part in self._parts:
            part._check_state(state)

    @whole
    def set_state(self, state: Mapping[str, np.ndarray]) -> None:
        """Continue from a result of `state` of this simulation, or of a simulation with the same
        phases.

        Raises:
            ValueError: arrays that do not fit together, before anything changes.
            KeyError: a missing array.
        """
        self._check_state(state)
        solver, core = self._solver, self._solver.core
        next_id, n_steps = (int(c) for c in state["counts"])
        core.resize(len(state["id"]), next_id, float(state["time"]), n_steps)
        for name in ARRAYS:
            solver.write(name, state[name])
        core.settle()
        for part in self._parts:
            part._set_state(state)
        core.tissue()  # particles learn what is held now
