"""Bonds between particles of tissue: which particles, rest lengths, stiffnesses."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..data.particles import Particles
from ..scene.scene import SceneBase
from .materials import Elasticity

REACH = 1.5  # spacings: 18 neighbors on a cubic lattice
_LATTICE_SQUARES = 30.0  # Σ L² / d² over those 18
_MARGIN = 1.25  # of the bound on eigenvalues, for bonds that are stretched by a half


@dataclass(frozen=True)
class Bonds:
    """Every bond at both of its ends, in compressed rows.

    Attributes:
        offsets: (N + 1,) uint64; particle i's bonds are offsets[i] to offsets[i + 1].
        other: (B,) uint32, the particle at the other end.
        length: (B,) float32 m, at rest.
        stiffness: (B,) float32 N/m, the inverse of XPBD's compliance.
        bound: (N,) float32, largest eigenvalue of Σ n nᵀ over a particle's bonds, with a margin.
    """

    offsets: np.ndarray
    other: np.ndarray
    length: np.ndarray
    stiffness: np.ndarray
    bound: np.ndarray

    @property
    def first_ends(self) -> np.ndarray:
        """(B,) the particle at whose row a bond stands."""
        return np.repeat(np.arange(len(self.offsets) - 1), np.diff(self.offsets).astype(np.int64))


def build_bonds(positions: Any, spacing: float, young: Any, body: Any = None) -> Bonds:
    """Bonds between all particles closer than 1.5 spacings, as stiff as a solid of that modulus.

    A solid whose bonds have stiffness k and length L, Σ over half of each particle's bonds, has
    E = Σ k L² / (6 V) and ν = 1/4 if they point everywhere alike; on a cubic lattice that is
    k = 0.4 E d. Particles at a surface have fewer bonds of the same stiffness.

    Args:
        positions: (N, 3) m, at rest.
        spacing: m.
        young: Young's modulus, Pa, one or (N,); a bond between two has the compliance of half
            of each.
        body: (N,) numbers; particles of different bodies are not bonded.

    Raises:
        ValueError: a modulus that is not positive, or particles that nearly coincide.
    """
    positions = np.ascontiguousarray(positions, np.float32)
    n = len(positions)
    soft = np.broadcast_to(np.asarray(young, np.float64), (n,))
    if not (np.isfinite(soft).all() and (soft > 0).all()):
        raise ValueError("young: expected positive numbers of Pa")
    first, other = _pairs(positions, spacing)
    if body is not None:
        keep = np.asarray(body)[first] == np.asarray(body)[other]
        first, other = first[keep], other[keep]
    r = positions[first].astype(np.float64) - positions[other]
    length = np.sqrt((r * r).sum(1))
    if len(length) and length.min() < 1e-3 * spacing:
        i = int(length.argmin())
        raise ValueError(
            f"positions: expected particles about {spacing:g} apart, "
            f"got {length[i]:g} between {first[i]} and {other[i]}"
        )
    whole = _whole_squares(np.bincount(first, length**2, n), length, spacing)
    stiffness = 12 * spacing**3 / whole / (0.5 * (1 / soft[first] + 1 / soft[other]))
    counts = np.bincount(first, minlength=n)
    return Bonds(
        np.concatenate([[0], np.cumsum(counts)]).astype(np.uint64),
        other.astype(np.uint32),
        length.astype(np.float32),
        stiffness.astype(np.float32),
        _largest_eigenvalues(first, r / np.maximum(length, 1e-30)[:, None], n).astype(np.float32),
    )


def _pairs(positions: np.ndarray, spacing: float) -> tuple[np.ndarray, np.ndarray]:
    """Both ends of all pairs, each pair twice, by first end."""
    if len(positions) == 0:
        return np.empty(0, np.int64), np.empty(0, np.int64)
    scene = SceneBase(Particles(positions, support=spacing), device="cpu")
    offsets, other = scene.neighbors(positions, REACH * spacing)
    first = np.repeat(np.arange(len(positions)), np.diff(offsets).astype(np.int64))
    keep = first != other
    return first[keep], other[keep].astype(np.int64)


def _whole_squares(squares: np.ndarray, length: np.ndarray, spacing: float) -> float:
    """Σ L² of a particle in the inside: a lattice's own, or nearly the largest."""
    edges = np.minimum(abs(length / spacing - 1), abs(length / spacing - np.sqrt(2)))
    if len(edges) == 0 or edges.max() < 1e-3:
        return _LATTICE_SQUARES * spacing**2
    return float(np.percentile(squares, 95))


def _largest_eigenvalues(first: np.ndarray, unit: np.ndarray, n: int) -> np.ndarray:
    tensor = np.zeros((n, 3, 3))
    for a in range(3):
        for b in range(3):
            tensor[:, a, b] = np.bincount(first, unit[:, a] * unit[:, b], n)
    return _MARGIN * np.linalg.eigvalsh(tensor)[:, 2]


def along(course: Any, radius: float, points: np.ndarray) -> np.ndarray:
    """(M,) bool: whether points (M, 3) m are within `radius`, m, of a polyline (K, 3) m."""
    course = np.asarray(course, np.float64)
    inside = np.zeros(len(points), bool)
    for a, b in itertools.pairwise(course):
        axis = b - a
        share = np.clip((points - a) @ axis / max(float(axis @ axis), 1e-300), 0, 1)
        inside |= np.linalg.norm(points - a - share[:, None] * axis, axis=1) <= radius
    return inside


def morton_order(positions: np.ndarray, spacing: float) -> np.ndarray:
    """(N,) int64: the particles in the octree's order, which keeps neighbors together."""
    if len(positions) == 0:
        return np.empty(0, np.int64)
    scene = SceneBase(Particles(positions, support=spacing), device="cpu")
    return scene.octree.sorted_keys(len(positions))[1].astype(np.int64)


def add_body(
    core: Any, positions: np.ndarray, ids: np.ndarray, bonds: Bonds, hold: np.ndarray,
    phase: np.ndarray, mass: Any, spacing: float, solid: Elasticity | None = None,
) -> None:  # fmt: skip
    """Add a body to the core's tissue; all arrays are (N, ...) in its own order. hold: (N,) FREE,
    FIXED ...; mass: kg, one or (N,); spacing: m, at which particles touch; solid: None: bonds
    alone."""
    n = len(ids)
    movable = hold == 0
    inverse_mass = np.where(movable, 1 / np.asarray(mass, np.float64), 0)
    elasticity: dict[str, Any] = {}
    if solid is not None:
        elasticity["lame"], elasticity["frequency"] = solid.arrays(mass, spacing)
        pairs = [(share, 1 / time) for share, time in solid.relaxation]
        elasticity["relaxation"] = np.array(pairs, np.float32).reshape(-1, 2)
    core.add(
        positions=np.ascontiguousarray(positions, np.float32), ids=np.ascontiguousarray(ids, np.uint32),
        inverse_mass=np.ascontiguousarray(np.broadcast_to(inverse_mass, (n,)), np.float32),
        hold=np.ascontiguousarray(hold, np.uint8), phase=np.ascontiguousarray(phase, np.uint8),
        offsets=bonds.offsets, other=bonds.other, length=bonds.length, stiffness=bonds.stiffness,
        bound=bonds.bound, contact=spacing, **elasticity,
    )  # fmt: skip
