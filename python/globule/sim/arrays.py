"""A simulation's particles as arrays, in id order, and its whole state in the solver's order."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from typing import Any

import numpy as np

from .._base.arrays import address, to_host
from .._base.interrupts import whole
from ..scene.particles import Particles
from .schema import shown

_ARRAYS = {
    "place": (np.float32, 4),
    "velocity": (np.float32, 4),
    "id": (np.uint32, 1),
    "phase": (np.uint8, 1),
    "pressure": (np.float32, 1),
    "impulse": (np.float32, 1),
    "divergence_impulse": (np.float32, 1),
}


def check_finite(name: str, values: np.ndarray) -> None:
    if not np.isfinite(values).all():
        raise ValueError(f"{name}: expected finite numbers, got a NaN or an infinity")


def numbers(name: str, values: Any, *shapes: tuple[int, ...]) -> np.ndarray:
    """Finite float32 of one of these shapes."""
    try:
        found = np.asarray(to_host(values), np.float32)
    except (TypeError, ValueError):
        raise ValueError(f"{name}: expected numbers, got {shown(values)}") from None
    if found.shape not in shapes:
        listed = " or ".join(str(shape) if shape else "a number" for shape in shapes)
        raise ValueError(f"{name}: expected shape {listed}, got {found.shape}")
    check_finite(name, found)
    return found


class Arrays:
    """The part of `Simulation` that reads and writes its particles."""

    @property
    @whole
    def ids(self) -> np.ndarray:
        """(N,) uint32, ascending; the order of all arrays here."""
        return np.sort(self._read("id"))

    @property
    @whole
    def positions(self) -> np.ndarray:
        """(N, 3) float32, m."""
        return np.ascontiguousarray(self._read("place")[self._order(), :3])

    @positions.setter
    @whole
    def positions(self, value: Any) -> None:
        place = self._read("place")
        place[self._order(), :3] = numbers("positions", value, (len(self), 3))
        self._write("place", place)
        self._core.settle()

    @property
    @whole
    def velocities(self) -> np.ndarray:
        """(N, 3) float32, m/s."""
        return np.ascontiguousarray(self._read("velocity")[self._order(), :3])

    @velocities.setter
    @whole
    def velocities(self, value: Any) -> None:
        velocity = self._read("velocity")
        velocity[self._order(), :3] = numbers("velocities", value, (len(self), 3), (3,), ())
        self._write("velocity", velocity)
        self._core.settle()

    @property
    @whole
    def pressure(self) -> np.ndarray:
        """(N,) float32, Pa, of the last step."""
        return self._read("pressure")[self._order()]

    @property
    @whole
    def phase(self) -> np.ndarray:
        """(N,) uint8: which of `phases`, by their order."""
        return self._read("phase")[self._order()]

    @property
    @whole
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

    @whole
    def neighbors(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The solver's lists: ids of the moved particles, and as compressed rows (offsets, ids)
        their neighbours within two spacings."""
        ids = self._read("id")
        rows, offsets, indices = self._core.neighbors()
        return ids[rows], offsets, ids[indices]

    @whole
    def totals(self) -> dict[str, Any]:
        """Of fluid and tissue: mass, kinetic and potential energy, momentum, angular_momentum
        (about the origin), center; SI."""
        t = self._core.totals()
        mass = t["mass"] or 1.0
        return {**t, "center": tuple(c / mass for c in t["center"])}

    @whole
    def hash(self) -> str:
        """Of the state's bits; equal for equal runs."""
        h = hashlib.sha256()
        for name in ("id", "place", "velocity"):
            h.update(self._read(name).tobytes())
        return h.hexdigest()[:16]

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

    @whole
    def state(self) -> dict[str, np.ndarray]:
        """Everything that `set_state` needs to go on bit by bit (on the CPU)."""
        arrays = {name: self._read(name) for name in _ARRAYS}
        counts = [self._core.next_id(), self.n_steps]
        clock = {"time": np.array(self.time), "counts": np.array(counts, np.uint64)}
        motion = {
            "motion": np.frombuffer(self._core.motion(), np.uint8),
            "moving": np.array(sorted(self._moving), np.uint8),
        }
        ids, force = self._forces
        forces = {"force_ids": ids, "force": force}
        return {**arrays, **motion, **forces, **self._tissue_state(), **clock}

    def _check(self, state: Mapping[str, np.ndarray]) -> None:
        """Refuse what would be read past its end, or could be no state of this simulation."""
        n = np.shape(state["id"])[0]
        for name, (dtype, columns) in _ARRAYS.items():
            shape = (n, columns) if columns > 1 else (n,)
            values = np.asarray(state[name])
            if values.shape != shape or values.dtype != dtype:
                got = f"{values.dtype} {values.shape}"
                raise ValueError(f"{name}: expected {np.dtype(dtype)} {shape}, got {got}")
        if np.shape(state["force"]) != (*np.shape(state["force_ids"]), 3):
            raise ValueError("force: expected (M, 3) for as many ids")
        for name in ("place", "velocity", "time", "force"):
            check_finite(name, state[name])
        if np.shape(state["counts"]) != (2,) or int(state["counts"][0]) >= 2**31:
            raise ValueError("counts: expected the ids given, below 2^31, and the steps")
        if n and (int(np.max(state["id"])) >= int(state["counts"][0])
                  or len(np.unique(state["id"])) != n):  # fmt: skip
            raise ValueError("id: expected each once and below the number of ids given")
        if n and int(np.max(state["phase"])) >= len(self._names):
            raise ValueError(f"phase: expected numbers below {len(self._names)}")

    @whole
    def set_state(self, state: Mapping[str, np.ndarray]) -> None:
        """Go on from what `state` gave."""
        self._check(state)
        next_id, n_steps = (int(c) for c in state["counts"])
        self._core.resize(len(state["id"]), next_id, float(state["time"]), n_steps)
        for name in _ARRAYS:
            self._write(name, state[name])
        self._core.settle()
        self._core.set_motion(np.asarray(state["motion"], np.uint8).tobytes())
        self._moving = {int(phase) for phase in state["moving"]}
        self._forces = state["force_ids"], state["force"]
        self._set_tissue_state(state)
        self._core.tissue()  # particles learn what is held now
