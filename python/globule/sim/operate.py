"""Tissue in a simulation: bonded, cut, ablated, and with vessels that bleed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from .._base.arrays import VectorLike
from .._base.checks import number, shown
from .._base.interrupts import whole
from .arrays import check_finite, ids_of, vector
from .blade import as_blade
from .bodies import BRAIN
from .bonds import add_body, along, build_bonds, morton_order
from .limits import check_substeps
from .materials import MODEL, POISSON, check_model, elasticity, substep_rate
from .part import Part
from .rigidity import young_of_rigidity
from .scene_file import Vessel
from .scene_read import as_dict
from .solver import Solver
from .state_checks import check_tissue
from .tissue import BALL, FIXED, FREE, GONE, cut

NOBODY = 0xFFFFFFFF
MOST_VESSELS = 32
# Blood leaves a cut end at this speed a pascal: 2 kPa drive it at 5 cm/s.
CONDUCTANCE = 2.5e-5  # m/(s Pa)
CLOSE = 1.5  # rest lengths: ends of sutured bonds are not farther apart


class BondedTissue(Part):
    """The elastic tissue of a simulation: its bonds, cuts, pieces and vessels."""

    def __init__(self, solver: Solver):
        super().__init__(solver)
        self.vessels: list[Vessel] = []
        self._materials_sent: list[list[Any]] | None = None

    @property
    def _core(self) -> Any:
        return self._solver.core.tissue()

    @whole
    def bond(
        self, ids: Any, young: Any = None, fixed: Any = None, model: str = MODEL,
        poisson: Any = None, relaxation: Any = (),
    ) -> None:  # fmt: skip
        """Make one elastic body: a solid, or springs. Bonds, which a blade cuts, connect all
        particles closer than 1.5 spacings.

        Args:
            ids: (M,) that `add` returned, of a phase of kind "tissue" and of no body yet;
                particles of a boundary are fixed, and move with the boundary.
            young: Young's modulus, Pa, one or (M,); None: brain, 2.5 kPa.
            fixed: (M,) bool; whether a particle is fixed.
            model: "solid" or "bonds" (`globule.sim.tissue.Tissue`); the same of all bodies.
            poisson: Poisson's ratio of a solid, 0 to 0.49, one or (M,); None: 0.45.
            relaxation: (share, time) pairs of a solid, as of `globule.sim.tissue.Tissue`.

        Raises:
            ValueError: unknown ids, ids of fluids or of another body, or an id twice; a modulus
                that is not positive or needs too many substeps; particles that nearly coincide;
                another model, or another than that of the simulation's bodies; a Poisson ratio
                outside of its range or of bonds; relaxation outside of its range or of bonds.
        """
        check_model(model, relaxation)
        if poisson is not None and model != "solid":
            raise ValueError('poisson: expected model "solid", got "bonds" (whose ratio is 1/4)')
        solver = self._solver
        solver.send()
        self._send()
        ids = ids_of(ids)
        if len(ids) == 0:
            return
        known = solver.ids()
        at = np.searchsorted(known, ids)
        if (at >= len(known)).any() or (known[np.minimum(at, len(known) - 1)] != ids).any():
            raise ValueError("ids: expected particles of this simulation, got others")
        ids = ids.astype(np.uint32)
        if n_again := len(ids) - len(np.unique(ids)):
            raise ValueError(f"ids: expected each particle once, got {n_again} again")
        bonded = np.empty(self._core.n(), np.uint32)
        self._core.get(ids=bonded)
        if n_bonded := int(np.isin(ids, bonded).sum()):
            raise ValueError(f"ids: expected particles of no body yet, got {n_bonded} of another")
        positions, phase = solver.positions()[at], solver.phase()[at]
        kinds = np.array([p.kind for p in solver.phases.values()])[phase]
        d = float(solver.settings.spacing)
        order = morton_order(positions, d)
        young = young_of_rigidity(BRAIN) if young is None else young
        try:
            each = np.broadcast_to(np.asarray(young, np.float64), ids.shape)
        except (TypeError, ValueError):
            expected = f"expected one number of Pa or {ids.shape}"
            raise ValueError(f"young: {expected}, got {shown(young)}") from None
        if n_others := int((~np.isin(kinds, ("tissue", "boundary"))).sum()):
            expected = "expected particles of tissue or of boundaries"
            raise ValueError(f"ids: {expected}, got {n_others} of others")
        hold = np.where(kinds == "tissue", FREE, FIXED).astype(np.uint8)
        if fixed is not None:
            if np.shape(fixed) not in ((), ids.shape):
                raise ValueError(f"fixed: expected {ids.shape} bool, got {np.shape(fixed)}")
            hold[np.broadcast_to(np.asarray(fixed, bool), ids.shape)] = FIXED
        density = np.array([p.density for p in solver.phases.values()])[phase]
        material = None
        if model == "solid":
            try:
                nu = np.asarray(POISSON if poisson is None else poisson, np.float64)
            except (TypeError, ValueError):
                expected = f"poisson: expected one number or {ids.shape}"
                raise ValueError(f"{expected}, got {shown(poisson)}") from None
            if nu.shape not in ((), ids.shape):
                raise ValueError(f"poisson: expected one number or {ids.shape}, got {nu.shape}")
            nu = nu[order] if nu.ndim else nu
            material = elasticity(each[order], nu, len(ids), relaxation)
        bonds = build_bonds(positions[order], d, each[order])
        most = float(np.max(POISSON if poisson is None else poisson))
        rate = substep_rate(float(each.max()), most, float(density.min()), d, model)
        frame = 1 / solver.file.output.fps
        check_substeps(("young",), rate, solver.settings.max_dt, frame)
        add_body(
            self._core, positions[order], ids[order], bonds, hold[order], phase[order],
            (density * d**3)[order], d, material,
        )  # fmt: skip

    @whole
    def cut(self, blade: Any, relative: bool = False) -> int:
        """Cut all bonds that cross a blade.

        Args:
            blade: a `Blade`, triangles (M, 3, 3) m, or two positions (before, now) of an edge, (K,
                3) m.
            relative: the blade's first pose belongs to the time before the last step and is
                relative to each bond's position at that time. Use this for instruments that move
                together with the tissue.

        Returns:
            the number of bonds cut.

        Raises:
            ValueError: a blade of another shape or with values that are not finite.
        """
        blade = as_blade(blade)
        return cut(self._core, blade if relative else replace(blade, n_moving=0))

    @whole
    def ablate(self, center: VectorLike, radius: float) -> np.ndarray:
        """Remove the tissue within a ball; fixed particles stay.

        Args:
            center: (3,) m.
            radius: m.

        Returns:
            (M,) uint32 ids of the removed particles.

        Raises:
            ValueError: numbers that are not finite.
        """
        center, radius = vector("center", center), number("radius", radius, 0.0)
        core = self._core
        before = self._gone()  # those that left the domain are still in the simulation
        if core.remove((BALL, center, center, radius, [0.0] * 3)) == 0:
            return np.empty(0, np.uint32)
        gone = np.setdiff1d(self._gone(), before)
        self._solver.remove(gone)
        return gone

    def _gone(self) -> np.ndarray:
        """Ids of tissue that was removed or has left the domain."""
        hold, ids = np.empty(self._core.n(), np.uint8), np.empty(self._core.n(), np.uint32)
        self._core.get(hold=hold, ids=ids)
        return ids[hold == GONE]

    @whole
    def suture(self, center: VectorLike, radius: float) -> int:
        """Join cut tissue again: bonds within a ball that were cut or torn become whole.

        The lips must lie together (hold them with graspers): bonds whose ends are more than
        `CLOSE` rest lengths apart stay cut. A sutured bond has its former length and stiffness, may
        tear, and no longer bleeds. There is no thread.

        Args:
            center: (3,) m.
            radius: m; the ball that the bonds' middles lie in.

        Returns:
            the number of bonds that became whole.

        Raises:
            ValueError: numbers that are not finite.
        """
        ball = vector("center", center), number("radius", radius, 0.0)
        core = self._core
        if core.n() == 0:
            return 0
        arrays = core.arrays()
        length = arrays["length"].view(np.float32)
        entries, apart = _within(arrays, core.n(), np.flatnonzero(length < 0), *ball)
        joined = entries[apart <= CLOSE * -length[entries]]
        if len(joined):
            length[joined] *= -1
            core.write("length", length.view(np.uint8))
            ids = arrays["id"]
            core.write("id", ids)  # what follows from bonds is made anew
        return len(joined) // 2  # each stands at both of its ends

    @whole
    def cauterize(self, center: VectorLike, radius: float) -> int:
        """Close the vessels within a ball: their bonds bleed neither now nor when cut later.

        Args:
            center: (3,) m.
            radius: m; the ball that the bonds' middles lie in.

        Returns:
            the number of bonds that belonged to a vessel.

        Raises:
            ValueError: numbers that are not finite.
        """
        ball = vector("center", center), number("radius", radius, 0.0)
        core = self._core
        if core.n() == 0:
            return 0
        arrays = core.arrays()
        tag, length = arrays["vessel"], arrays["length"].view(np.float32)
        entries, _ = _within(arrays, core.n(), np.flatnonzero((tag != 0) & (length != 0)), *ball)
        if len(entries):
            tag[entries] = 0
            core.write("vessel", tag)
        return len(entries) // 2

    @whole
    def add_vessel(self, vessel: Vessel) -> int:
        """Add a vessel to the tissue that has bonds.

        Args:
            vessel: a table of a scene (`globule.sim.Vessel`). Cut bonds within the
                vessel's radius bleed.

        Returns:
            the number of the vessel, from 1.

        Raises:
            ValueError: a 33rd vessel, an unknown fluid, or no tissue with bonds.
        """
        self._solver.send()
        self._send()
        core = self._core
        number = len(core.pools()) + 1
        if number > MOST_VESSELS:
            raise ValueError(f"vessel: expected at most {MOST_VESSELS} of them")
        if core.n() == 0:
            raise ValueError(f"vessels[{vessel.name!r}]: expected tissue with bonds, got none")
        which = self._solver.number_of(vessel.fluid)
        arrays = core.arrays()
        first, tag = _first_ends(arrays["first"], core.n()), arrays["vessel"]
        at = arrays["at"].view(np.float32).reshape(-1, 4)[:, :3].astype(np.float64)
        other = arrays["other"].view(np.uint32)
        real = arrays["length"].view(np.float32) != 0
        tag[real & along(vessel.path, vessel.radius, 0.5 * (at[first] + at[other]))] = number
        core.write("vessel", tag)
        core.set_vessel(number, vessel.pressure * CONDUCTANCE, vessel.pool, which)
        self.vessels.append(vessel)
        return number

    @property
    def pools(self) -> list[float]:
        """Remaining blood of each vessel, m³."""
        return self._core.pools()

    @property
    def n_bonds(self) -> int:
        """Number of whole bonds."""
        return self._core.n_bonds()

    @property
    def elastic_energy(self) -> float:
        """Elastic energy of the tissue, J."""
        return self._core.elastic_energy()

    @property
    def n_pieces(self) -> int:
        """Number of pieces of the tissue."""
        return self._core.pieces()

    @property
    @whole
    def piece(self) -> np.ndarray:
        """(N,) uint32 in id order: the least id of each particle's piece; NOBODY (2^32 - 1) for
        particles that are not tissue."""
        core = self._core
        piece, ids = np.empty(core.n(), np.uint32), np.empty(core.n(), np.uint32)
        core.get(piece=piece, ids=ids)
        all_ids = self._solver.ids()
        out = np.full(len(all_ids), NOBODY, np.uint32)
        there = np.isin(ids, all_ids)
        out[np.searchsorted(all_ids, ids[there])] = piece[there]
        return out

    def _send(self) -> None:
        """Tissue's materials, where they changed."""
        phases = self._solver.phases.values()
        packed = [[p.damping, p.tear, p.plastic, p.creep if p.plastic else 0.0, p.friction] for p in phases]
        if self._materials_sent != packed:
            self._core.materials(packed)
            self._materials_sent = packed

    def _by_hand(self) -> dict[str, Any]:
        """Vessels, as JSON holds them."""
        return {"vessels": [as_dict(vessel) for vessel in self.vessels]}

    def _take_up(self, by_hand: dict[str, Any]) -> None:
        """From what `_by_hand` returned."""
        self.vessels = [Vessel(**values) for values in by_hand["vessels"]]

    def _state(self) -> dict[str, np.ndarray]:
        """What a checkpoint keeps of the tissue."""
        arrays = {f"tissue_{k}": v for k, v in self._core.arrays().items() if len(v)}
        return {**arrays, "tissue_pools": np.array(self.pools)}

    def _check_state(self, state: Mapping[str, np.ndarray]) -> None:
        """Refuse others than `_state` returns: raises ValueError."""
        solver, n_vessels = self._solver, len(self.vessels)
        next_id, longest = int(state["counts"][0]), solver.settings.max_dt
        check_tissue(state, next_id, len(solver.phases), n_vessels, longest)
        pools = np.asarray(state.get("tissue_pools", np.empty(0)))
        if pools.ndim != 1 or len(pools) > n_vessels or pools.dtype.kind not in "iuf":
            raise ValueError(f"tissue_pools: expected at most {n_vessels} numbers")
        check_finite("tissue_pools", pools)
        if self._core.n() and "tissue_hold" not in state:
            raise ValueError("tissue_hold: expected the tissue of the scene, got none")

    def _set_state(self, state: Mapping[str, np.ndarray]) -> None:
        """Continue from what `_state` returned."""
        core = self._core
        for name in core.arrays():
            if (key := f"tissue_{name}") in state:
                core.write(name, np.ascontiguousarray(state[key], np.uint8))
        for k, pool in enumerate(np.atleast_1d(state.get("tissue_pools", [])), start=1):
            vessel = self.vessels[k - 1]
            which = self._solver.number_of(vessel.fluid)
            core.set_vessel(k, vessel.pressure * CONDUCTANCE, float(pool), which)


def _within(
    arrays: dict[str, np.ndarray], n: int, entries: np.ndarray, center: VectorLike, radius: float
) -> tuple[np.ndarray, np.ndarray]:
    """Those of the entries of n particles' bonds whose middles lie in a ball; how far apart their
    ends are, m."""
    at = arrays["at"].view(np.float32).reshape(-1, 4)[:, :3].astype(np.float64)
    a = at[_first_ends(arrays["first"], n)[entries]]
    b = at[arrays["other"].view(np.uint32)[entries]]
    near = ((0.5 * (a + b) - center) ** 2).sum(1) <= radius**2
    return entries[near], np.linalg.norm(b - a, axis=1)[near]


def _first_ends(first: np.ndarray, n: int) -> np.ndarray:
    """The particle at whose row each entry of the interleaved blocks stands."""
    first = first.view(np.uint32).astype(np.int64)
    block = np.repeat(np.arange(len(first) - 1), np.diff(first))
    lane = (np.arange(len(block)) - first[block]) % 32
    return np.minimum(32 * block + lane, n - 1)
