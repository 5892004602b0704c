"""A simulation's particles as arrays, in id order; its whole state, in the solver's order."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from typing import Any

import numpy as np

from .._base.arrays import address, to_host
from .._base.checks import shown
from .._base.interrupts import whole
from ..scene.particles import Particles
from .part import Part
from .state_checks import check_clock, check_crowds, check_tissue

_ARRAYS = {
    "place": (np.float32, 4),
    "velocity": (np.float32, 4),
    "id": (np.uint32, 1),
    "phase": (np.uint8, 1),
    "pressure": (np.float32, 1),
    "growth": (np.float32, 1),
    "divergence_impulse": (np.float32, 1),
}


def check_finite(name: str, values: np.ndarray) -> None:
    """Raise ValueError for a NaN or an infinity."""
    if not np.isfinite(values).all():
        raise ValueError(f"{name}: expected finite numbers, got a NaN or an infinity")


def vector(name: str, value: Any) -> list[float]:
    """Three finite numbers; anything else is a ValueError."""
    try:
        found = np.asarray(value, np.float64)
    except (TypeError, ValueError, OverflowError):
        found = np.empty(0)
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

    @property
    @whole
    def ids(self) -> np.ndarray:
        """(N,) uint32, ascending: the order of all arrays here."""
        return np.sort(self._read("id"))

    @property
    @whole
    def positions(self) -> np.ndarray:
        """(N, 3) float32, m. Assigning other shapes or values that are not finite is a
        ValueError."""
        return np.ascontiguousarray(self._read("place")[self._order(), :3])

    @positions.setter
    @whole
    def positions(self, value: Any) -> None:
        place = self._read("place")
        place[self._order(), :3] = numbers("positions", value, (len(self._sim), 3))
        self._write("place", place)
        self._sim._core.settle()

    @property
    @whole
    def velocities(self) -> np.ndarray:
        """(N, 3) float32, m/s. A program may also assign (3,) or a number; errors as for
        positions."""
        return np.ascontiguousarray(self._read("velocity")[self._order(), :3])

    @velocities.setter
    @whole
    def velocities(self, value: Any) -> None:
        velocity = self._read("velocity")
        shapes = (len(self._sim), 3), (3,), ()
        velocity[self._order(), :3] = numbers("velocities", value, *shapes)
        self._write("velocity", velocity)
        self._sim._core.settle()

    @property
    @whole
    def pressure(self) -> np.ndarray:
        """(N,) float32, Pa, of the last step."""
        return self._read("pressure")[self._order()]

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
        order, rho = self._order(), self._read("place")[:, 3]
        density, vorticity = np.empty(len(order), np.float32), np.empty((len(order), 3), np.float32)
        if len(order):
            self._sim._core.flow(address(density), address(vorticity))
            density[rho < 0] /= -rho[rho < 0]  # a fluid's place holds -1 / density
        return density[order], vorticity[order]

    @property
    @whole
    def phase(self) -> np.ndarray:
        """(N,) uint8: the number of each particle's phase in the order of `Simulation.phases`."""
        return self._read("phase")[self._order()]

    @whole
    def particles(self) -> Particles:
        """All particles in id order, with colors, and the attributes velocity (m/s), pressure (Pa,
        of the last step), density (kg/m³), vorticity (1/s), phase and id."""
        density, vorticity = self._flow()
        sim, order = self._sim, self._order()
        phase = self._read("phase")[order]
        colors = np.array([p.color for p in sim.phases.values()], np.float32).reshape(-1, 3)
        shown = np.array([bool(p.shown) for p in sim.phases.values()], np.float32)
        return Particles(
            self._read("place")[order, :3],
            support=self._supports(phase),
            color=colors[phase],
            weight=shown[phase],
            attributes={
                "velocity": self._read("velocity")[order, :3],
                "pressure": self._read("pressure")[order],
                "density": density,
                "vorticity": vorticity,
                "phase": phase,
                "id": self._read("id")[order],
            },
        )

    def _supports(self, phase: np.ndarray) -> Any:
        """Of particles of these phases, m: one, or (N,)."""
        sim = self._sim
        if not sim.settings.fine_fluids:
            return 2.0 * sim.settings.spacing
        of_phase = [2.0 * sim._spacing_of(p) for p in sim.phases.values()]
        return np.array(of_phase, np.float32)[phase]

    @whole
    def neighbors(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The solver's neighbor lists as compressed rows.

        Returns:
            ids (R,) uint32 of the particles that the solver moves, offsets (R + 1,), and ids (M,)
            uint32 of their neighbors within two spacings (of a pair: the mean of both).
        """
        ids = self._read("id")
        rows, offsets, indices = self._sim._core.neighbors()
        return ids[rows], offsets, ids[indices]

    @whole
    def hash(self) -> str:
        """16 hexadecimal digits of the state's bits: equal for equal runs."""
        h = hashlib.sha256()
        for name in ("id", "place", "velocity"):
            h.update(self._read(name).tobytes())
        return h.hexdigest()[:16]

    def _read(self, name: str) -> np.ndarray:
        dtype, columns = _ARRAYS[name]
        n = len(self._sim)
        out = np.empty((n, columns) if columns > 1 else n, dtype)
        if n:
            self._sim._core.read(name, address(out))
        return out

    def _write(self, name: str, values: np.ndarray) -> None:
        if len(self._sim):
            self._sim._core.write(name, address(np.ascontiguousarray(values, _ARRAYS[name][0])))

    def _order(self) -> np.ndarray:
        return np.argsort(self._read("id"))

    @whole
    def state(self) -> dict[str, np.ndarray]:
        """The state for `set_state`, which continues with the same bits on the CPU: arrays by name,
        in the solver's order."""
        sim = self._sim
        arrays = {name: self._read(name) for name in _ARRAYS}
        counts = [sim._core.next_id(), sim.n_steps]
        clock = {"time": np.array(sim.time), "counts": np.array(counts, np.uint64)}
        motion = {
            "motion": np.frombuffer(sim._core.motion(), np.uint8),
            "moving": np.array(sorted(sim.steer._moving), np.uint8),
        }
        ids, force = sim.steer._forces
        forces = {"force_ids": ids, "force": force}
        return {**arrays, **motion, **forces, **sim.tissue._state(), **clock}

    def _check(self, state: Mapping[str, np.ndarray]) -> None:
        """Refuse arrays that would be read past their end, or are no state of this simulation."""
        sim = self._sim
        n, n_phases = np.asarray(state["id"]).size, len(sim.phases)
        for name, (dtype, columns) in _ARRAYS.items():
            shape = (n, columns) if columns > 1 else (n,)
            values = np.asarray(state[name])
            if values.shape != shape or values.dtype != dtype:
                got = f"{values.dtype} {values.shape}"
                raise ValueError(f"{name}: expected {np.dtype(dtype)} {shape}, got {got}")
        ids, force = np.asarray(state["force_ids"]), np.asarray(state["force"])
        if ids.ndim != 1 or ids.dtype != np.uint32 or force.shape != (len(ids), 3):
            raise ValueError("force: expected (M, 3) for as many ids")
        if force.dtype != np.float32:
            raise ValueError(f"force: expected float32, got {force.dtype}")
        for name in ("place", "velocity", "pressure", "growth", "divergence_impulse", "force"):
            check_finite(name, state[name])
        check_clock(state)
        if n and (int(np.max(state["id"])) >= int(state["counts"][0])
                  or len(np.unique(state["id"])) != n):  # fmt: skip
            raise ValueError("id: expected each once and below the number of ids given")
        if n and int(np.max(state["phase"])) >= n_phases:
            raise ValueError(f"phase: expected numbers below {n_phases}")
        moving = np.asarray(state["moving"])
        if (
            moving.ndim != 1
            or moving.dtype != np.uint8
            or moving.max(initial=0) >= max(n_phases, 1)
        ):
            raise ValueError(f"moving: expected numbers of phases below {n_phases}")
        check_crowds(np.asarray(state["place"]), sim.settings.spacing)
        n_vessels, longest = len(sim.tissue.vessels), sim.settings.max_dt
        check_tissue(state, int(state["counts"][0]), n_phases, n_vessels, longest)
        pools = np.asarray(state.get("tissue_pools", np.empty(0)))
        if pools.ndim != 1 or len(pools) > n_vessels or pools.dtype.kind not in "iuf":
            raise ValueError(f"tissue_pools: expected at most {n_vessels} numbers")
        check_finite("tissue_pools", pools)
        if sim._core.tissue().n() and "tissue_hold" not in state:
            raise ValueError("tissue_hold: expected the tissue of the scene, got none")

    @whole
    def set_state(self, state: Mapping[str, np.ndarray]) -> None:
        """Continue from a result of `state` of this simulation, or of a simulation with the same
        phases.

        Raises:
            ValueError: arrays that do not fit together, before anything changes.
            KeyError: a missing array.
        """
        self._check(state)
        sim = self._sim
        next_id, n_steps = (int(c) for c in state["counts"])
        sim._core.resize(len(state["id"]), next_id, float(state["time"]), n_steps)
        for name in _ARRAYS:
            self._write(name, state[name])
        sim._core.settle()
        sim._core.set_motion(np.asarray(state["motion"], np.uint8).tobytes())
        sim.steer._moving = {int(phase) for phase in state["moving"]}
        sim.steer._forces = state["force_ids"], state["force"]
        sim.tissue._set_state(state)
        sim._core.tissue()  # particles learn what is held now
