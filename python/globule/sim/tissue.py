"""Elastic tissue by itself, without fluid: bonds, cuts, grasps, pieces."""

from __future__ import annotations

from typing import Any

import numpy as np

from .. import _core
from .._base.arrays import VectorLike
from .._base.device import choose
from .._base.owner import Owner
from .blade import Blade, as_blade
from .bonds import add_body, build_bonds, morton_order
from .materials import MODEL, POISSON, check_model, elasticity

FREE, FIXED, GONE, GRASPED = 0, 1, 2, 3
BALL, CAPSULE, HALF_SPACE = 0, 1, 2
MOST_GRASPS = 8


class Tissue(Owner):
    """Elastic tissue alone. All arrays are in the order of the given positions.

    Args:
        positions: (N, 3) m, at rest.
        spacing: m.
        young: Young's modulus, Pa, one or (N,).
        density: kg/m³.
        fixed: (N,) bool; whether a particle is fixed.
        damping: 1/s; velocities fall by exp(-damping t).
        tear: strain beyond which bonds break; 0: never.
        plastic: strain beyond which a part of the strain is permanent; 0: never. Of a solid: the
            elastic strain of a bar that is pulled, and its equivalent in other motions.
        creep: rate at which the excess strain becomes permanent, 1/s.
        body: (N,) numbers; particles of different bodies are not bonded.
        device, threads: as of `Simulation`.
        model: "solid": total-Lagrangian SPH with the neighbors that bonds connect, stable
            neo-Hookean stress; "bonds": springs along the bonds, Poisson's ratio 1/4.
        poisson: Poisson's ratio of a solid, 0 to 0.49, one or (N,).
        relaxation: up to two pairs (share, time) of a solid: that share of the shear modulus
            relaxes in this time, s (Prony series); young is the modulus of sudden motion.
        friction: coefficient of the contacts with shapes and of cut faces.

    Raises:
        ValueError: particles that nearly coincide; a modulus that is not positive; another model;
            a Poisson ratio outside of its range; shares or times outside of theirs.
    """

    def __init__(
        self,
        positions: Any,
        spacing: float,
        young: Any,
        density: float = 1000.0,
        fixed: Any = None,
        damping: float = 0.0,
        tear: float = 0.0,
        plastic: float = 0.0,
        creep: float = 0.0,
        body: Any = None,
        device: str = "auto",
        threads: int = 0,
        model: str = MODEL,
        poisson: Any = POISSON,
        relaxation: Any = (),
        friction: float = 0.0,
    ):
        check_model(model, relaxation)
        positions = np.ascontiguousarray(positions, np.float32)
        n = self._n = len(positions)
        self.order = morton_order(positions, spacing)
        self._place = np.argsort(self.order)
        young = np.broadcast_to(np.asarray(young, np.float64), (n,))[self.order]
        body = None if body is None else np.asarray(body)[self.order]
        bonds = build_bonds(positions[self.order], spacing, young, body)
        hold = np.zeros(n, np.uint8)
        if fixed is not None:
            hold[np.asarray(fixed, bool)[self.order]] = FIXED
        chosen = choose(device)
        self._core = _core.Tissue(chosen.name, threads)
        add_body(
            self._core, positions[self.order], self.order, bonds, hold, np.zeros(n),
            density * spacing**3, spacing,
            elasticity(young, _arranged(poisson, self.order), n, relaxation)
            if model == "solid" else None,
        )  # fmt: skip
        self._core.materials([[damping, tear, plastic, creep, friction]])

    def __len__(self) -> int:
        return self._n

    def instruments(self, motions: Any = (), shapes: Any = ()) -> None:
        """Replace what holds and what pushes.

        Args:
            motions: (velocity, spin, center) of each grasp, by number.
            shapes: (kind, a, b, radius, velocity): BALL of center a, CAPSULE from a to b, or
                HALF_SPACE with point a and outward normal b; a sixth item is the shape's friction.
        """
        self._core.instruments(list(motions), list(shapes))

    def advance(self, dt: float, gravity: VectorLike = (0, 0, 0), substeps: int = 0, iterations: int = 1) -> int:
        """Move by dt seconds under gravity (3,) m/s²; returns the number of substeps."""
        return self._core.advance(dt, [float(g) for g in gravity], substeps, iterations)

    def tear(self, dt: float) -> int:
        """Break overstretched bonds and let others creep for dt seconds; returns how many broke."""
        return self._core.tear(dt)

    def follow(self) -> None:
        """Store the tissue's positions: a swept blade's first pose is relative to these
        positions."""
        self._core.follow()

    def cut(self, blade: Any) -> int:
        """Cut the bonds that a blade crosses, as `BondedTissue.cut`; returns their number."""
        return cut(self._core, as_blade(blade))

    def grasp(self, center: VectorLike, radius: float, number: int = 0) -> None:
        """Hold the free particles within a ball (m), and release the old grasp `number`."""
        self._core.grasp([float(v) for v in center], radius, number)

    def grasp_force(self, number: int = 0) -> tuple[np.ndarray, np.ndarray]:
        """What a grasp feels, as `Tools.grasp_force`: force (3,) N, torque (3,) N m about its
        center."""
        return self._felt(number)

    def shape_force(self, number: int = 0) -> tuple[np.ndarray, np.ndarray]:
        """What a shape of `instruments` feels: force (3,) N, torque (3,) N m about its point a."""
        return self._felt(MOST_GRASPS + number)

    def _felt(self, which: int) -> tuple[np.ndarray, np.ndarray]:
        own = np.asarray(self._core.felt()).reshape(-1, 6)[which]
        return own[:3], own[3:]

    def remove(self, center: VectorLike, radius: float) -> int:
        """Remove the particles within a ball (m); returns their number."""
        center = [float(v) for v in center]
        return self._core.remove((BALL, center, center, radius, [0.0, 0.0, 0.0]))

    @property
    def n_bonds(self) -> int:
        """Bonds that are whole."""
        return self._core.n_bonds()

    @property
    def elastic_energy(self) -> float:
        """Elastic energy, J."""
        return self._core.elastic_energy()

    @property
    def n_pieces(self) -> int:
        """Pieces that the tissue is in."""
        return self._core.pieces()

    @property
    def positions(self) -> np.ndarray:
        """(N, 3) float32 m."""
        return self._get("positions", np.empty((self._n, 3), np.float32))

    @positions.setter
    def positions(self, value: Any) -> None:
        self._core.set(positions=self._arranged(value))

    @property
    def velocities(self) -> np.ndarray:
        """(N, 3) float32 m/s."""
        return self._get("velocities", np.empty((self._n, 3), np.float32))

    @velocities.setter
    def velocities(self, value: Any) -> None:
        self._core.set(velocities=self._arranged(value))

    def accelerate(self, accelerations: Any) -> None:
        """Accelerations (N, 3) or (3,) m/s² beside gravity, from now on."""
        self._core.accelerate(self._arranged(accelerations))

    @property
    def piece(self) -> np.ndarray:
        """(N,) uint32: the least particle of each particle's piece."""
        return self._get("piece", np.empty(self._n, np.uint32))

    @property
    def hold(self) -> np.ndarray:
        """(N,) uint8: FREE, FIXED, GONE, or GRASPED + the grasp's number."""
        return self._get("hold", np.empty(self._n, np.uint8))

    def _get(self, name: str, out: np.ndarray) -> np.ndarray:
        self._core.get(**{name: out})
        return out[self._place]

    def _arranged(self, value: Any) -> np.ndarray:
        value = np.broadcast_to(np.asarray(value, np.float32), (self._n, 3))
        return np.ascontiguousarray(value[self.order])


def _arranged(value: Any, order: np.ndarray) -> np.ndarray:
    """One number, or those of the particles in the tissue's order."""
    value = np.asarray(value, np.float64)
    return value[order] if value.ndim else value


def cut(core: Any, blade: Blade) -> int:
    """Cut bonds of a core's tissue; returns their number."""
    vertices = np.ascontiguousarray(blade.vertices, np.float64)
    corners = np.ascontiguousarray(blade.triangles, np.uint32)
    return core.cut(vertices, corners, blade.n_moving)
