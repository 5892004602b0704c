"""What a simulation can do with tissue: bond it, cut it, hold it, take it away, let it bleed."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from .._base.arrays import address
from .._base.interrupts import whole
from .blade import as_blade
from .bonds import add_body, along, build_bonds, morton_order
from .tissue import BALL, FIXED, FREE, GONE, HALF_SPACE, cut

NOBODY = 0xFFFFFFFF
# Blood leaves a cut end at this speed a pascal: 2 kPa drive it at 5 cm/s.
CONDUCTANCE = 2.5e-5  # m/(s Pa)


@dataclass
class Vessel:
    """A blood vessel: what of the tissue's bonds lies within its radius bleeds when it is cut.

    Attributes:
        path: (K, 3) m, its course.
        radius: m.
        pressure: Pa above the outside; blood leaves at CONDUCTANCE times it, through the area cut.
        pool: m³ of blood that it can lose.
        phase: name of the blood's phase.
    """

    path: Any
    radius: float
    pressure: float
    pool: float
    phase: str


class Operable:
    """The part of `Simulation` that is about tissue; the solver is in the subclass."""

    @whole
    def bond(self, ids: Any, modulus: Any, fixed: Any = None) -> None:
        """Make particles of tissue one elastic body: bonds between all closer than 1.5 spacings.

        Args:
            ids: (M,) that `add` gave, of a phase of kind "tissue" (fixed particles may be of a
                boundary's, and go where that goes).
            modulus: Young's, Pa, one or (M,).
            fixed: (M,) bool; what stays where it is.
        """
        self._send()
        ids = np.asarray(ids, np.uint32).reshape(-1)
        if len(ids) == 0:
            return
        known = self.ids
        at = np.searchsorted(known, ids)
        if (at >= len(known)).any() or (known[np.minimum(at, len(known) - 1)] != ids).any():
            raise ValueError("ids: expected particles of this simulation, got others")
        positions, phase = self.positions[at], self.phase[at]
        kinds = np.array([p.kind for p in self.phases.values()])[phase]
        d = float(self.settings.spacing)
        order = morton_order(positions, d)
        modulus = np.broadcast_to(np.asarray(modulus, np.float64), ids.shape)
        hold = np.where(kinds == "tissue", FREE, FIXED).astype(np.uint8)
        if fixed is not None:
            hold[np.asarray(fixed, bool)] = FIXED
        density = np.array([p.density for p in self.phases.values()])[phase]
        bonds = build_bonds(positions[order], d, modulus[order])
        add_body(
            self._core.tissue(), positions[order], ids[order], bonds, hold[order], phase[order],
            (density * d**3)[order], d,
        )  # fmt: skip

    @whole
    def cut(self, blade: Any, relative: bool = False) -> int:
        """Cut all bonds that cross a blade; the number of them.

        Args:
            blade: a `Blade`, triangles (M, 3, 3) m, or an edge's places (before, now), (K, 3) m.
            relative: the blade's first pose is of before the last step, and is seen from where each
                bond was then: for instruments that move while the tissue does.
        """
        blade = as_blade(blade)
        return cut(self._core.tissue(), blade if relative else replace(blade, n_moving=0))

    @whole
    def ablate(self, center: Any, radius: float) -> np.ndarray:
        """Take away the tissue within a ball; the ids that went. Fixed particles stay."""
        center = [float(v) for v in center]
        if not np.isfinite([*center, radius]).all():
            raise ValueError(f"center, radius: expected finite numbers, got {center}, {radius}")
        core = self._core.tissue()
        if core.remove((BALL, center, center, radius, [0.0] * 3)) == 0:
            return np.empty(0, np.uint32)
        hold, ids = np.empty(core.n(), np.uint8), np.empty(core.n(), np.uint32)
        core.get(0, 0, 0, address(hold), address(ids))
        gone = np.intersect1d(ids[hold == GONE], self.ids)
        self.remove(gone)
        return gone

    @whole
    def grasp(self, center: Any, radius: float, number: int = 0) -> None:
        """Take hold of the free tissue within a ball; it then moves as `move_grasp` says. What
        this number (0 to 7) held before is let go."""
        self._core.tissue().grasp([float(v) for v in center], float(radius), _grasp_number(number))

    @whole
    def release(self, number: int = 0) -> None:
        """Let go."""
        self.grasp((1e9, 1e9, 1e9), 0.0, number)

    @whole
    def move_grasp(
        self, number: int = 0, velocity: Any = (0, 0, 0), spin: Any = (0, 0, 0),
        center: Any = (0, 0, 0),
    ) -> None:  # fmt: skip
        """How a grasp moves from now on: velocity m/s, spin rad/s about center m."""
        motions = self.__dict__.setdefault("_motions", [((0.0,) * 3,) * 3] * 8)
        motion = tuple(tuple(float(v) for v in part) for part in (velocity, spin, center))
        if motions[_grasp_number(number)] != motion:
            motions[number] = motion
            self._send_instruments()

    @whole
    def set_pushers(self, shapes: Any) -> None:
        """Solid instruments that tissue cannot enter, at most 8, where they are now.

        Args:
            shapes: (kind, a, b, radius, velocity): kind tissue.BALL with center a, CAPSULE from a
                to b, or HALF_SPACE with a point a and an outward normal b.
        """
        shapes = list(shapes)
        if len(shapes) > 8:
            raise ValueError(f"shapes: expected at most 8, got {len(shapes)}")
        self._pushers = [
            (int(k), [float(v) for v in a], [float(v) for v in b], float(r), [float(v) for v in u])
            for k, a, b, r, u in shapes
        ]
        self._send_instruments()

    def _move_pushers(self, dt: float) -> None:
        """Where they are after a step, as its substeps left them but for rounding: what comes next
        depends on what is known here, which a checkpoint keeps."""
        pushers = self.__dict__.get("_pushers", [])
        if any(any(velocity) for *_, velocity in pushers):
            self._pushers = [
                (kind, _shifted(a, u, dt), b if kind == HALF_SPACE else _shifted(b, u, dt), r, u)
                for kind, a, b, r, u in pushers
            ]
            self._send_instruments()

    @whole
    def add_vessel(self, vessel: Vessel) -> int:
        """A vessel through the tissue that is bonded by now; its number, from 1."""
        self._send()
        if not (vessel.radius > 0 and vessel.pressure > 0 and vessel.pool > 0):
            raise ValueError("vessel: expected a positive radius, pressure and pool")
        core = self._core.tissue()
        number = len(core.pools()) + 1
        if number > 32:
            raise ValueError("vessel: expected at most 32 of them")
        arrays = self._tissue_arrays()
        first, tag = _first_ends(arrays["first"], core.n()), arrays["vessel"]
        at = arrays["at"].view(np.float32).reshape(-1, 4)[:, :3].astype(np.float64)
        other = arrays["other"].view(np.uint32)
        real = arrays["length"].view(np.float32) != 0
        tag[real & along(vessel.path, vessel.radius, 0.5 * (at[first] + at[other]))] = number
        core.write("vessel", address(tag), tag.nbytes)
        speed = vessel.pressure * CONDUCTANCE
        core.set_vessel(number, speed, vessel.pool, self._phase(vessel.phase))
        self.vessels.append(vessel)
        return number

    @property
    def vessels(self) -> list[Vessel]:
        return self.__dict__.setdefault("_vessels", [])

    @property
    def pools(self) -> list[float]:
        """m³ of blood that each vessel has left."""
        return self._core.tissue().pools()

    @property
    def n_bonds(self) -> int:
        """Bonds that are whole."""
        return self._core.tissue().n_bonds()

    @property
    def elastic_energy(self) -> float:
        """J, of the whole bonds."""
        return self._core.tissue().elastic_energy()

    @property
    def n_pieces(self) -> int:
        """Pieces that the tissue is in."""
        return self._core.tissue().pieces()

    @property
    @whole
    def piece(self) -> np.ndarray:
        """(N,) uint32 in id order: the least id of each piece; NOBODY for what is not tissue."""
        core = self._core.tissue()
        piece, ids = np.empty(core.n(), np.uint32), np.empty(core.n(), np.uint32)
        core.get(0, 0, address(piece), 0, address(ids))
        all_ids = self.ids
        out = np.full(len(all_ids), NOBODY, np.uint32)
        there = np.isin(ids, all_ids)
        out[np.searchsorted(all_ids, ids[there])] = piece[there]
        return out

    def _send_instruments(self) -> None:
        motions = self.__dict__.get("_motions", [])
        self._core.tissue().instruments(motions, self.__dict__.get("_pushers", []))

    def _send_tissue(self) -> None:
        """Tissue's materials, where they changed."""
        packed = [
            [getattr(p, name) for p in self.phases.values()]
            for name in ("damping", "tear", "plastic")
        ]
        packed.append([p.creep if p.plastic else 0.0 for p in self.phases.values()])
        if self.__dict__.get("_materials_sent") != packed:
            self._core.tissue().materials(*packed)
            self._materials_sent = packed

    def _tissue_by_hand(self) -> dict[str, Any]:
        """What was said of vessels, grasps and pushers, as JSON holds it."""
        vessels = [vars(v) | {"path": np.asarray(v.path).tolist()} for v in self.vessels]
        named = {"vessels": vessels}
        return named | {k: self.__dict__.get(f"_{k}", []) for k in ("motions", "pushers")}

    def _take_up_tissue(self, by_hand: dict[str, Any]) -> None:
        self._vessels = [Vessel(**values) for values in by_hand["vessels"]]
        motions = [tuple(tuple(part) for part in motion) for motion in by_hand["motions"]]
        self._motions = motions or [((0.0,) * 3,) * 3] * 8
        self._pushers = [tuple(pusher) for pusher in by_hand["pushers"]]
        self._send_instruments()

    def _tissue_arrays(self) -> dict[str, np.ndarray]:
        core, found = self._core.tissue(), {}
        for name, size in core.arrays().items():
            found[name] = np.empty(size, np.uint8)
            core.read(name, address(found[name]))
        return found

    def _tissue_state(self) -> dict[str, np.ndarray]:
        """What a checkpoint keeps of the tissue."""
        arrays = {f"tissue_{k}": v for k, v in self._tissue_arrays().items() if len(v)}
        return {**arrays, "tissue_pools": np.array(self.pools)}

    def _set_tissue_state(self, state: Any) -> None:
        core = self._core.tissue()
        for name in core.arrays():
            if (key := f"tissue_{name}") in state:
                values = np.ascontiguousarray(state[key], np.uint8)
                core.write(name, address(values), len(values))
        for number, pool in enumerate(np.atleast_1d(state.get("tissue_pools", [])), start=1):
            vessel = self.vessels[number - 1]
            speed = vessel.pressure * CONDUCTANCE
            core.set_vessel(number, speed, float(pool), self._phase(vessel.phase))


def _shifted(point: list[float], velocity: list[float], dt: float) -> list[float]:
    return [x + v * dt for x, v in zip(point, velocity, strict=True)]


def _grasp_number(number: int) -> int:
    if not 0 <= number < 8:
        raise ValueError(f"number: expected 0 to 7, got {number!r}")
    return int(number)


def _first_ends(first: np.ndarray, n: int) -> np.ndarray:
    """The particle at whose row each entry of the interleaved blocks stands."""
    first = first.view(np.uint32).astype(np.int64)
    block = np.repeat(np.arange(len(first) - 1), np.diff(first))
    lane = (np.arange(len(block)) - first[block]) % 32
    return np.minimum(32 * block + lane, n - 1)
