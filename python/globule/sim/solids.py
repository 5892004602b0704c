"""Solids: what particles are made of, and a float64 reference of energy and forces."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from .._base.checks import shown

if TYPE_CHECKING:
    from .bonds import Bonds

MODELS = ("bonds", "solid")
POISSON = 0.45  # default of solids
MOST_POISSON = 0.49
STEADINESS = 4.5  # energy against zero-energy modes, shear moduli; src/sim/solid.hpp has the same
# Stiffest motions of blocks of a lattice: density (frequency spacing)² <= 6 λ + 11.1 μ.
_STIFFEST_LAME, _STIFFEST_SHEAR = 6.0, 11.1


@dataclass(frozen=True)
class Elasticity:
    """What the particles of a solid are made of.

    Attributes:
        shear: (N,) shear modulus μ, Pa.
        lame: (N,) Lamé's first parameter λ, Pa.
    """

    shear: np.ndarray
    lame: np.ndarray

    def arrays(self, mass: Any, spacing: float) -> tuple[np.ndarray, float]:
        """What the core takes.

        Args:
            mass: kg, one or (N,).
            spacing: m.

        Returns:
            (2, N) float32 J, μ and λ times the particles' volume; and the frequency of the
            stiffest motion, 1/s.
        """
        volume = spacing**3
        moduli = _STIFFEST_LAME * self.lame + _STIFFEST_SHEAR * self.shear
        stiffest = moduli * volume / np.asarray(mass, np.float64)
        frequency = float(np.sqrt(stiffest.max(initial=0.0))) / spacing
        volumes = np.ascontiguousarray([self.shear * volume, self.lame * volume], np.float32)
        return volumes, frequency


def check_model(model: str) -> None:
    """Raise ValueError unless `model` is one of MODELS."""
    if model not in MODELS:
        raise ValueError(f"model: expected {' or '.join(MODELS)}, got {shown(model)}")


def elasticity(young: Any, poisson: Any, n: int) -> Elasticity:
    """Lamé's parameters of n particles.

    Args:
        young: Young's modulus, Pa, one or (n,).
        poisson: Poisson's ratio from 0 to 0.49, one or (n,).

    Raises:
        ValueError: numbers outside of these ranges.
    """
    young = np.broadcast_to(np.asarray(young, np.float64), (n,))
    nu = np.broadcast_to(np.asarray(poisson, np.float64), (n,))
    if not (np.isfinite(young).all() and (young > 0).all()):
        raise ValueError("young: expected positive numbers of Pa")
    if not ((nu >= 0).all() and (nu <= MOST_POISSON).all()):
        raise ValueError(f"poisson: expected 0 to {MOST_POISSON:g}, got {shown(poisson)}")
    return Elasticity(young / (2 * (1 + nu)), young * nu / ((1 + nu) * (1 - 2 * nu)))


def weight(q: np.ndarray) -> np.ndarray:
    """-W'(q) / q of the cubic spline with a support of two spacings, but for a factor; q: distances
    in spacings."""
    return np.where(q < 1, 3 - 2.25 * q, 0.75 * np.maximum(2 - q, 0) ** 2 / np.maximum(q, 1))


def forces(
    positions: Any, rest: Any, bonds: Bonds, material: Elasticity, spacing: float
) -> tuple[float, np.ndarray]:
    """Energy and forces of a solid in float64: the oracle of the core's.

    Every particle's neighbors must span space: springs, which the core gives to others, are left
    out.

    Args:
        positions: (N, 3) m.
        rest: (N, 3) m.
        bonds: of the rest, all whole.
        material: of N particles.
        spacing: m.

    Returns:
        J; (N, 3) N.
    """
    x, X = np.asarray(positions, np.float64), np.asarray(rest, np.float64)
    i, j, n = bonds.first_ends, bonds.other.astype(np.int64), len(x)
    c = weight(bonds.length.astype(np.float64) / spacing)
    r, R = x[j] - x[i], X[j] - X[i]

    def summed(values: np.ndarray) -> np.ndarray:
        out = np.zeros((n, *values.shape[1:]))
        np.add.at(out, i, values)
        return out

    shape = summed(c[:, None, None] * R[:, :, None] * R[:, None, :])
    C = np.linalg.inv(shape)
    F = summed(c[:, None, None] * r[:, :, None] * R[:, None, :]) @ C
    J = np.linalg.det(F)
    cofactor = J[:, None, None] * np.linalg.inv(F).transpose(0, 2, 1)
    mu, lam, volume = material.shear, material.lame, spacing**3
    s = (lam + mu) * (J - 1) - mu
    P = mu[:, None, None] * F + s[:, None, None] * cofactor
    b = STEADINESS * volume * mu / np.trace(shape, axis1=1, axis2=2)
    off = r - np.einsum("nab,nb->na", F[i], R)
    energy = volume * (
        mu / 2 * ((F**2).sum((1, 2)) - 3) - mu * (J - 1) + (lam + mu) / 2 * (J - 1) ** 2
    ) + b / 2 * summed(c * (off**2).sum(1))
    T = volume * P @ C - b[:, None, None] * F
    pair = np.einsum("nab,nb->na", T[i] + T[j], R) + (b[i] + b[j])[:, None] * r
    return float(energy.sum()), summed(c[:, None] * pair)
