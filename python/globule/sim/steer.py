"""Steering: forces, boundaries that follow poses, rigid bodies, and sinks."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from .._base.arrays import VectorLike
from .._base.checks import number, shown
from .._base.interrupts import whole
from .arrays import check_finite, ids_of, numbers, vector
from .blade import check_rigid
from .part import Part
from .solver import Solver

MOST_SINKS = 32


class Steer(Part):
    """External actions on a simulation: forces, moved boundaries, rigid bodies, sinks."""

    def __init__(self, solver: Solver):
        super().__init__(solver)
        self._forces = np.empty(0, np.uint32), np.empty((0, 3), np.float32)  # of these ids
        self._moving: set[int] = set()  # phases of boundaries that have a pose
        self._reach: dict[str, float] = {}  # m, of their particles from the point that they turn about
        self._poses: dict[str, np.ndarray] = {}  # the last of each
        self._ways: dict[str, float] = {}  # m, that the next step leads each at most
        self._fastest_body = 0.0  # m/s, at a start
        self._sinks: list[list[float]] = []
        self._bodies: set[int] = set()  # phases that make_rigid was given

    @whole
    def apply_force(self, force: VectorLike, ids: Any = None) -> None:
        """Apply a force to each particle during the next step; several calls add up.

        Args:
            force: N on each particle: (3,), or (M, 3) for M ids.
            ids: (M,) of the particles; None: all, in id order.

        Raises:
            ValueError: a force that is not finite or has a wrong shape; unknown ids, or one twice.
        """
        known = self._solver.ids()
        chosen = known if ids is None else ids_of(ids)
        unknown = np.setdiff1d(chosen, known)
        if len(unknown):
            raise ValueError(f"ids: expected particles of this simulation, got {unknown[0]}")
        if n_again := len(chosen) - len(np.unique(chosen)):
            raise ValueError(f"ids: expected each particle once, got {n_again} again")
        total = self._forces_of(known)
        more = np.zeros_like(total)
        more[np.searchsorted(known, chosen)] = numbers("force", force, (3,), (len(chosen), 3))
        self._forces = known, total + more

    def _forces_of(self, ids: np.ndarray) -> np.ndarray:
        """(N, 3) N: what acts on each of these ids during the next step."""
        found = np.zeros((len(ids), 3), np.float32)
        _, here, there = np.intersect1d(ids, self._forces[0], return_indices=True)
        found[here] = self._forces[1][there]
        return found

    @whole
    def move_boundary(self, phase: str, pose: Any) -> None:
        """Set the pose of a boundary at the end of the next step.

        The first call sets the current pose.

        Args:
            phase: name of a phase of kind "boundary".
            pose: (4, 4) world_from_body, m.

        Raises:
            ValueError: an unknown phase, or a pose that is not a rotation and a position.
        """
        which = self._solver.number_of(phase)
        if self._solver.phases[phase].kind != "boundary":
            raise ValueError(f"phase: expected one of kind boundary, got {phase!r}")
        numbers("pose", pose, (4, 4))
        pose = check_rigid("pose", pose)
        if phase not in self._reach:
            away = self._solver.positions()[self._solver.phase() == which] - pose[:3, 3]
            self._reach[phase] = float(np.linalg.norm(away, axis=1).max(initial=0.0))
        before = self._poses.get(phase, pose)
        cosine = (np.trace(before[:3, :3].T @ pose[:3, :3]) - 1) / 2
        turned = self._reach[phase] * np.arccos(np.clip(cosine, -1.0, 1.0))
        self._ways[phase] = float(np.linalg.norm(pose[:3, 3] - before[:3, 3]) + turned)
        self._poses[phase] = pose
        if which in self._moving:
            domain, near = self._solver.file.domain, pose.copy()
            for axis in map("xyz".index, domain.periodic):  # far away, float32 would not tell small ways
                lo, length = domain.lo[axis], domain.hi[axis] - domain.lo[axis]
                near[axis, 3] -= length * np.floor((pose[axis, 3] - lo) / length)
            self._solver.core.move_to(which, near.reshape(16).tolist())
        else:
            self._solver.core.capture(which, pose.reshape(16).tolist())
            self._moving.add(which)

    @whole
    def make_rigid(
        self, phase: str, density: float, velocity: VectorLike = (0, 0, 0), spin: VectorLike = (0, 0, 0)
    ) -> None:
        """Make one rigid body of the particles of a phase, which fill the body.

        Args:
            phase: name of a phase of kind "rigid".
            density: 0.001 to 1e6 kg/m³.
            velocity: (3,) m/s.
            spin: (3,) rad/s.

        Raises:
            ValueError: a phase of another kind, or a phase without particles; a density beyond
                these, or motion that is not finite.
        """
        solver = self._solver
        which = solver.number_of(phase)
        if solver.phases[phase].kind != "rigid":
            raise ValueError(f"phase: expected one of kind rigid, got {phase!r}")
        at = solver.positions()[solver.phase() == which].astype(float)
        if len(at) == 0:
            raise ValueError(f"phase: expected particles of {phase!r} to be added first")
        density = number("density", density, 1e-3, 1e6)
        velocity, spin = vector("velocity", velocity), vector("spin", spin)
        each = density * solver.settings.spacing**3
        center = at.mean(0)
        x = at - center
        # A particle's own cube keeps the inertia of a few from being singular.
        own = each * solver.settings.spacing**2 / 6
        inertia = np.eye(3) * (each * (x**2).sum() + own * len(x)) - each * x.T @ x
        solver.core.make_body(which, each * len(at), inertia.ravel(), center, velocity, spin)
        self._bodies.add(which)
        fastest = np.linalg.norm(velocity) + np.linalg.norm(spin) * np.linalg.norm(x, axis=1).max()
        self._fastest_body = max(self._fastest_body, float(fastest))

    @whole
    def body(self, phase: str) -> dict[str, np.ndarray]:
        """The state of a rigid body: center m, velocity m/s, spin rad/s, (3,) each, and rotation
        (3, 3), world_from_body.

        Raises:
            ValueError: an unknown phase, or a phase that is no rigid body.
        """
        which = self._solver.number_of(phase)
        if which not in self._bodies:
            raise ValueError(f"phase: expected a rigid body, got {phase!r}")
        center, velocity, spin, rotation = map(np.array, self._solver.core.body(which))
        return {"center": center, "velocity": velocity, "spin": spin, "rotation": rotation.reshape(3, 3)}

    def _send_forces(self) -> None:
        """Hand the forces of the next step to the core, and forget them."""
        if len(self._forces[0]):
            forces = self._forces_of(self._solver.read("id"))
            self._solver.core.set_forces(forces)
            self._forces = self._forces[0][:0], self._forces[1][:0]

    def _state(self) -> dict[str, np.ndarray]:
        """Motion of boundaries, and the forces of the next step."""
        ids, force = self._forces
        return {
            "motion": np.frombuffer(self._solver.core.motion(), np.uint8),
            "moving": np.array(sorted(self._moving), np.uint8), "force_ids": ids, "force": force,
        }  # fmt: skip

    def _check_state(self, state: Mapping[str, np.ndarray]) -> None:
        """Refuse others than `_state` returns: raises ValueError."""
        ids, force = np.asarray(state["force_ids"]), np.asarray(state["force"])
        if ids.ndim != 1 or ids.dtype != np.uint32 or force.shape != (len(ids), 3):
            raise ValueError("force: expected (M, 3) for as many ids")
        if force.dtype != np.float32:
            raise ValueError(f"force: expected float32, got {force.dtype}")
        check_finite("force", force)
        moving, most = np.asarray(state["moving"]), max(len(self._solver.phases), 1)
        if moving.ndim != 1 or moving.dtype != np.uint8 or moving.max(initial=0) >= most:
            raise ValueError(f"moving: expected numbers of phases below {len(self._solver.phases)}")

    def _set_state(self, state: Mapping[str, np.ndarray]) -> None:
        """Continue from what `_state` returned."""
        self._solver.core.set_motion(np.asarray(state["motion"], np.uint8).tobytes())
        self._moving = {int(phase) for phase in state["moving"]}
        self._forces = state["force_ids"], state["force"]

    def _by_hand(self) -> dict[str, Any]:
        """Sinks and rigid bodies, as JSON holds them."""
        return {"sinks": self._sinks, "bodies": sorted(self._bodies)}

    def _take_up(self, by_hand: dict[str, Any]) -> None:
        """Sinks and bodies of a checkpoint. Raises ValueError for others than it can hold."""
        sinks = [numbers("sinks", sink, (10,)).tolist() and list(sink) for sink in by_hand["sinks"]]
        if len(sinks) > MOST_SINKS:
            raise ValueError(f"sinks: expected at most {MOST_SINKS}, got {len(sinks)}")
        known = list(range(len(self._solver.phases)))
        found = by_hand["bodies"]
        if not all(isinstance(which, int) and which in known for which in found):
            raise ValueError(f"bodies: expected numbers of phases, got {shown(found)}")
        self._sinks, self._bodies = sinks, set(found)
        self._solver.core.set_sinks(sinks)

    @whole
    def set_sinks(self, sinks: Any) -> None:
        """Replace the regions that remove fluid.

        Args:
            sinks: at most 32 of (lo, hi), corners of a box, or (center, radius) of a ball, m.

        Raises:
            ValueError: more than 32 sinks, or numbers that are not finite.
        """
        packed = []
        for i, sink in enumerate(sinks):
            name = f"sinks[{i}]"
            try:
                a, b = sink
            except (TypeError, ValueError):
                expected = "expected (lo, hi) or (center, radius)"
                raise ValueError(f"{name}: {expected}, got {shown(sink)}") from None
            a = vector(name, a)
            if np.ndim(b) == 0:
                packed.append([0.0] * 6 + [*a, number(name, b, 0.0)])
            else:
                packed.append([*a, *vector(name, b), 0.0, 0.0, 0.0, 0.0])
        if len(packed) > MOST_SINKS:
            raise ValueError(f"sinks: expected at most {MOST_SINKS}, got {len(packed)}")
        self._sinks = packed
        self._solver.core.set_sinks(packed)
