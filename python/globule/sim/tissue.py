"""Bonds between particles: which, how long, how stiff."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from .. import _core
from ..arrays import address
from ..device import choose
from ..particles import Particles
from ..scene import Scene
from .blade import Blade, as_blade

FREE, FIXED, GONE, GRASPED = 0, 1, 2, 3
_REACH = 1.5  # spacings: 18 neighbours on a cubic lattice
_LATTICE_SQUARES = 30.0  # Σ L² / d² over those 18
_MARGIN = 1.25  # of the bound on eigenvalues, for bonds that are stretched by a half


def modulus_from_rigidity(rigidity: Any) -> np.ndarray:
    """Young's modulus, Pa, of rigidity factors in (0, 1): 100 Pa · 10^(4 r).

    0.35 is brain (shear modulus 1 kPa, E = 2.5 kPa at ν = 1/4), 0.5 muscle at rest (10 kPa),
    0.75 cartilage-like (100 kPa); 0 is fluid and 1 is fixed, which no modulus describes.
    """
    return 100.0 * 10.0 ** (4.0 * np.asarray(rigidity, np.float64))


@dataclass(frozen=True)
class Bonds:
    """Every bond at both of its ends, in compressed rows.

    Attributes:
        offsets: (N + 1,) uint64; particle i's bonds are offsets[i] to offsets[i + 1].
        other: (B,) uint32, the particle at the other end.
        length: (B,) float32 m, at rest.
        stiffness: (B,) float32 N/m, the inverse of XPBD's compliance.
        bound: (N,) float32, largest eigenvalue of Σ n nᵀ over a particle's bonds, with a margin.
        vessel: (B,) uint8, the vessel's number, or 0.
    """

    offsets: np.ndarray
    other: np.ndarray
    length: np.ndarray
    stiffness: np.ndarray
    bound: np.ndarray
    vessel: np.ndarray

    @property
    def first_ends(self) -> np.ndarray:
        """(B,) the particle at whose row a bond stands."""
        return np.repeat(np.arange(len(self.offsets) - 1), np.diff(self.offsets).astype(np.int64))


def build_bonds(
    positions: Any, spacing: float, modulus: Any, vessels: Any = (), body: Any = None
) -> Bonds:
    """Bonds between all particles closer than 1.5 spacings, as stiff as a solid of that modulus.

    A solid whose bonds have stiffness k and length L, Σ over half of each particle's bonds, has
    E = Σ k L² / (6 V) and ν = 1/4 if they point everywhere alike; on a cubic lattice that is
    k = 0.4 E d. Particles at a surface have fewer bonds of the same stiffness.

    Args:
        positions: (N, 3) m, at rest.
        spacing: m.
        modulus: Pa, Young's modulus: one or (N,); a bond between two has the compliance of half
            of each.
        vessels: `Vessel`s; bonds along them bleed when they are cut.
        body: (N,) numbers; particles of different bodies are not bonded.
    """
    positions = np.ascontiguousarray(positions, np.float32)
    n = len(positions)
    if n == 0:
        empty = np.empty(0, np.float32)
        return Bonds(
            np.zeros(1, np.uint64), np.empty(0, np.uint32), empty, empty, empty, empty.astype("u1")
        )
    scene = Scene(Particles(positions, support=spacing), device="cpu")
    offsets, other = scene.neighbors(positions, _REACH * spacing)
    first = np.repeat(np.arange(n, dtype=np.uint32), np.diff(offsets).astype(np.int64))
    keep = first != other
    if body is not None:
        keep &= np.asarray(body)[first] == np.asarray(body)[other]
    first, other = first[keep], other[keep]
    r = positions[first].astype(np.float64) - positions[other]
    length = np.sqrt((r * r).sum(1))
    if len(length) and length.min() < 1e-3 * spacing:
        i = int(length.argmin())
        raise ValueError(
            f"positions: expected particles about {spacing:g} apart, "
            f"got {length[i]:g} between {first[i]} and {other[i]}"
        )
    squares = np.bincount(first, length**2, n)
    compliance = np.broadcast_to(np.asarray(modulus, np.float64), (n,))
    if not (np.isfinite(compliance).all() and (compliance > 0).all()):
        raise ValueError("modulus: expected positive numbers of Pa")
    compliance = 1 / compliance
    volume = spacing**3
    whole = _whole_squares(squares, length, spacing)
    stiffness = 12 * volume / whole / (0.5 * (compliance[first] + compliance[other]))
    tensor = np.zeros((n, 3, 3))
    unit = r / length[:, None]
    for a in range(3):
        for b in range(a, 3):
            tensor[:, a, b] = np.bincount(first, unit[:, a] * unit[:, b], n)
            tensor[:, b, a] = tensor[:, a, b]
    bound = _MARGIN * np.linalg.eigvalsh(tensor)[:, 2]
    counts = np.bincount(first, minlength=n)
    bonds = Bonds(
        np.concatenate([[0], np.cumsum(counts)]).astype(np.uint64),
        other.astype(np.uint32),
        length.astype(np.float32),
        stiffness.astype(np.float32),
        bound.astype(np.float32),
        np.zeros(len(other), np.uint8),
    )
    for number, vessel in enumerate(vessels, start=1):
        vessel.tag(bonds, positions, number)
    return bonds


def _whole_squares(squares: np.ndarray, length: np.ndarray, spacing: float) -> float:
    """Σ L² of a particle in the inside: a lattice's own, or nearly the largest."""
    edges = np.minimum(abs(length / spacing - 1), abs(length / spacing - np.sqrt(2)))
    if len(edges) == 0 or edges.max() < 1e-3:
        return _LATTICE_SQUARES * spacing**2
    return float(np.percentile(squares, 95))


@dataclass(frozen=True)
class Vessel:
    """A blood vessel: bonds within its radius bleed when they are cut.

    Attributes:
        points: (K, 3) m, its course.
        radius: m.
        pressure: Pa, above the surroundings.
        pool: m³ of blood that it can lose.
    """

    points: np.ndarray
    radius: float
    pressure: float = 2000.0
    pool: float = 1e-5

    def tag(self, bonds: Bonds, positions: np.ndarray, number: int) -> None:
        """Give the bonds whose middle lies within the vessel its number."""
        first = bonds.first_ends
        middle = 0.5 * (positions[first].astype(np.float64) + positions[bonds.other])
        course = np.asarray(self.points, np.float64)
        inside = np.zeros(len(middle), bool)
        for a, b in zip(course[:-1], course[1:], strict=True):
            axis = b - a
            along = np.clip((middle - a) @ axis / max(float(axis @ axis), 1e-300), 0, 1)
            inside |= np.linalg.norm(middle - a - along[:, None] * axis, axis=1) <= self.radius
        bonds.vessel[inside] = number


class Tissue:
    """Elastic tissue alone, without fluid: bonds, knife, grasps, pieces.

    Arrays go in and come out in the order of the positions given.
    """

    def __init__(
        self,
        positions: Any,
        spacing: float,
        modulus: Any,
        density: float = 1000.0,
        fixed: Any = None,
        damping: float = 0.0,
        tear_strain: float = 0.0,
        yield_strain: float = 0.0,
        creep_rate: float = 0.0,
        body: Any = None,
        device: str = "auto",
        threads: int = 0,
    ):
        positions = np.ascontiguousarray(positions, np.float32)
        n = len(positions)
        self.order = morton_order(positions, spacing)
        self._place = np.argsort(self.order)
        modulus = np.broadcast_to(np.asarray(modulus, np.float64), (n,))[self.order]
        if body is not None:
            body = np.asarray(body)[self.order]
        arranged = np.ascontiguousarray(positions[self.order])
        self.bonds = build_bonds(arranged, spacing, modulus, body=body)
        hold = np.zeros(n, np.uint8)
        if fixed is not None:
            hold[np.asarray(fixed, bool)[self.order]] = FIXED
        self.mass = density * spacing**3
        inverse_mass = np.where(hold == FIXED, 0, 1 / self.mass).astype(np.float32)
        ids, phase = self.order.astype(np.uint32), np.zeros(n, np.uint8)
        chosen = choose(device)
        self._core = _core.Tissue(chosen.backend, chosen.index, threads)
        b = self.bonds
        self._core.build(
            {
                "n": n,
                "contact": spacing,
                "ids": address(ids),
                "positions": address(arranged),
                "inverse_mass": address(inverse_mass),
                "bound": address(b.bound),
                "hold": address(hold),
                "phase": address(phase),
                "offsets": address(b.offsets),
                "other": address(b.other),
                "length": address(b.length),
                "stiffness": address(b.stiffness),
                "vessel": address(b.vessel) if b.vessel.any() else 0,
            }
        )
        self._core.materials([damping], [tear_strain], [yield_strain], [creep_rate])
        self._n = n
        self.motions: list = []
        self.shapes: list = []

    def __len__(self) -> int:
        return self._n

    def advance(
        self, dt: float, gravity: Any = (0, 0, 0), substeps: int = 0, iterations: int = 1
    ) -> int:
        """Move by dt seconds; the number of substeps done."""
        return self._core.advance(
            dt, substeps, iterations, list(map(float, gravity)), self.motions, self.shapes
        )

    def tear(self, dt: float) -> int:
        """Break what is overstretched, let creep what yields; the number of torn bonds."""
        return self._core.tear(dt)

    def follow(self) -> None:
        """Remember where the tissue is; the next sweep's first pose is seen from there."""
        self._core.follow()

    def cut(self, blade: Any) -> int:
        """Cut the bonds that a blade crosses; their number."""
        blade: Blade = as_blade(blade)
        vertices = np.ascontiguousarray(blade.vertices, np.float64)
        corners = np.ascontiguousarray(blade.triangles, np.uint32)
        return self._core.cut(
            address(vertices), len(vertices), blade.n_moving, address(corners), len(corners)
        )

    def grasp(self, center: Any, radius: float, number: int = 0) -> None:
        """Hold the free particles within a ball, and let go of what `number` held before."""
        self._core.grasp([float(v) for v in center], radius, number)

    def remove(self, center: Any, radius: float) -> int:
        """Take away the particles within a ball; their number."""
        center = [float(v) for v in center]
        return self._core.remove((0, center, center, radius, [0.0, 0.0, 0.0]))

    @property
    def n_bonds(self) -> int:
        """Bonds that are whole."""
        return self._core.n_bonds()

    @property
    def n_pieces(self) -> int:
        return self._core.pieces()

    @property
    def positions(self) -> np.ndarray:
        """(N, 3) float32 m."""
        return self._get(np.empty((self._n, 3), np.float32), 0)

    @positions.setter
    def positions(self, value: Any) -> None:
        self._core.set(address(self._arranged(value)), 0)

    @property
    def velocities(self) -> np.ndarray:
        """(N, 3) float32 m/s."""
        return self._get(np.empty((self._n, 3), np.float32), 1)

    @velocities.setter
    def velocities(self, value: Any) -> None:
        self._core.set(0, address(self._arranged(value)))

    def accelerate(self, accelerations: Any) -> None:
        """Accelerations (N, 3) or (3,) m/s² beside gravity, from now on."""
        self._core.accelerate(address(self._arranged(accelerations)))

    @property
    def piece(self) -> np.ndarray:
        """(N,) uint32: the least particle of the piece that each belongs to."""
        return self._get(np.empty(self._n, np.uint32), 2)

    @property
    def hold(self) -> np.ndarray:
        """(N,) uint8: FREE, FIXED, GONE, or GRASPED + the grasp's number."""
        return self._get(np.empty(self._n, np.uint8), 3)

    def _get(self, out: np.ndarray, which: int) -> np.ndarray:
        self._core.get(*[address(out) if k == which else 0 for k in range(4)])
        return out[self._place]

    def _arranged(self, value: Any) -> np.ndarray:
        value = np.broadcast_to(np.asarray(value, np.float32), (self._n, 3))
        self._kept = np.ascontiguousarray(value[self.order])
        return self._kept


def morton_order(positions: np.ndarray, spacing: float) -> np.ndarray:
    """(N,) the particles in the octree's order: neighbours in space are neighbours in memory."""
    if len(positions) == 0:
        return np.empty(0, np.int64)
    scene = Scene(Particles(positions, support=spacing), device="cpu")
    return scene.octree.sorted_keys(len(positions))[1].astype(np.int64)
