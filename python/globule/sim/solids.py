"""Solids: what particles are made of, and a float64 reference of energy and forces."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from .._base.checks import shown

if TYPE_CHECKING:
    from .bonds import Bonds

MODELS = ("bonds", "solid")
MODEL = "solid"  # default
POISSON = 0.45  # default of solids
MOST_POISSON = 0.49
MOST_TERMS = 2  # of a Prony series; src/sim/memory.hpp has the same
MOST_SHARE = 0.999  # of the shear modulus that relaxes: a solid stays one
SHORTEST, LONGEST = 1e-6, 1e6  # relaxation times, s
MOST_SUBSTEPS = 100_000  # of tissue in the longest step
STEADINESS = 4.5  # energy against zero-energy modes, shear moduli; src/sim/solid.hpp has the same
LEAST_STEADY = 0.1  # of it, however much of the shear modulus relaxes; as there
# Stiffest motions of blocks of a lattice: density (frequency spacing)² <= 6 λ + 11.1 μ.
_STIFFEST_LAME, _STIFFEST_SHEAR = 6.0, 11.1
_STIFFEST_SPRINGS = 2.45  # substeps of bonds in the time that sound takes for a spacing


@dataclass(frozen=True)
class Elasticity:
    """What the particles of a solid are made of.

    Attributes:
        shear: (N,) shear modulus μ, Pa.
        lame: (N,) Lamé's first parameter λ, Pa.
        relaxation: (share, time) of each part of μ that relaxes: G(t) = μ (1 - Σ share
            (1 - exp(-t / time))), s.
    """

    shear: np.ndarray
    lame: np.ndarray
    relaxation: tuple[tuple[float, float], ...] = ()

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


def substep_rate(
    young: float, poisson: float | None, density: float, spacing: float, model: str
) -> float:
    """Substeps a second that tissue at rest takes: young Pa, density kg/m³, spacing m."""
    if model != "solid":
        return _STIFFEST_SPRINGS * math.sqrt(young / density) / spacing
    material = elasticity(young, POISSON if poisson is None else poisson, 1)
    return material.arrays(density * spacing**3, spacing)[1]


def check_model(model: str, relaxation: Any = ()) -> None:
    """Raise ValueError unless `model` is one of MODELS, and a solid if it relaxes."""
    if model not in MODELS:
        raise ValueError(f"model: expected {' or '.join(MODELS)}, got {shown(model)}")
    if model != "solid" and len(relaxation):
        raise ValueError(f'relaxation: expected model = "solid" beside it, got {shown(model)}')


def elasticity(young: Any, poisson: Any, n: int, relaxation: Any = ()) -> Elasticity:
    """What n particles are made of.

    Args:
        young: Young's modulus, Pa, one or (n,).
        poisson: Poisson's ratio from 0 to 0.49, one or (n,).
        relaxation: pairs (share, time) as in `Elasticity`.

    Raises:
        ValueError: numbers outside of these ranges.
    """
    young = np.broadcast_to(np.asarray(young, np.float64), (n,))
    nu = np.broadcast_to(np.asarray(poisson, np.float64), (n,))
    if not (np.isfinite(young).all() and (young > 0).all()):
        raise ValueError("young: expected positive numbers of Pa")
    if not ((nu >= 0).all() and (nu <= MOST_POISSON).all()):
        wrong = nu[~((nu >= 0) & (nu <= MOST_POISSON))][0]
        raise ValueError(f"poisson: expected 0 to {MOST_POISSON:g}, got {wrong:g}")
    shear, lame = young / (2 * (1 + nu)), young * nu / ((1 + nu) * (1 - 2 * nu))
    return Elasticity(shear, lame, prony_series(relaxation))


def prony_series(relaxation: Any) -> tuple[tuple[float, float], ...]:
    """Checked pairs (share, time). Raises ValueError."""
    expected = f"relaxation: expected up to {MOST_TERMS} pairs (share, seconds)"
    try:
        pairs = tuple((float(share), float(time)) for share, time in relaxation)
    except (TypeError, ValueError):
        raise ValueError(f"{expected}, got {shown(relaxation)}") from None
    if len(pairs) > MOST_TERMS:
        raise ValueError(f"{expected}, got {len(pairs)}")
    for share, time in pairs:
        if not 0 < share < 1:
            raise ValueError(f"relaxation: expected shares between 0 and 1, got {share:g}")
        if not SHORTEST <= time <= LONGEST:
            expected = f"times from {SHORTEST:g} to {LONGEST:g} s"
            raise ValueError(f"relaxation: expected {expected}, got {time:g}")
    if sum(share for share, _ in pairs) > MOST_SHARE:
        total = sum(share for share, _ in pairs)
        raise ValueError(
            f"relaxation: expected shares of at most {MOST_SHARE:g} together, got {total:g}"
        )
    return pairs


def weight(q: np.ndarray) -> np.ndarray:
    """-W'(q) / q of the cubic spline with a support of two spacings, but for a factor; q: distances
    in spacings."""
    return np.where(q < 1, 3 - 2.25 * q, 0.75 * np.maximum(2 - q, 0) ** 2 / np.maximum(q, 1))


def relaxed(past: np.ndarray, F: np.ndarray, material: Elasticity, dt: float) -> np.ndarray:
    """Inverse metrics (K, N, 3, 3) of the parts that relax, after dt seconds at F (N, 3, 3): the
    oracle of src/sim/memory.hpp."""
    to = np.linalg.inv(F.transpose(0, 2, 1) @ F)
    kept = np.array([np.exp(-dt / time) for _, time in material.relaxation])
    return to + kept[:, None, None, None] * (past - to)


def yielded(
    stays: np.ndarray, F: np.ndarray, material: Elasticity, at: float, rate: float, dt: float
) -> np.ndarray:
    """Inverse metric (N, 3, 3) of the part that does not relax, after dt seconds at F: what is
    beyond the yield strain `at` falls at `rate`, in principal logarithmic stretches."""
    ratio = material.lame / (2 * (material.lame + material.shear))
    squares, axes = np.linalg.eigh(F @ stays @ F.transpose(0, 2, 1))
    h = 0.5 * np.log(squares)
    swelling = h.mean(1, keepdims=True)
    h -= swelling
    strain = np.sqrt(1.5 * (h**2).sum(1)) / (1 + ratio)
    beyond = np.maximum(1 - at / np.maximum(strain, 1e-300), 0)
    kept = 1 - beyond * (1 - np.exp(-1.5 / (1 + ratio) * rate * dt))
    squares = np.exp(2 * (h * kept[:, None] + swelling))
    inner = np.linalg.inv(F) @ axes
    return (inner * squares[:, None, :]) @ inner.transpose(0, 2, 1)


def gradients(positions: Any, rest: Any, bonds: Bonds, spacing: float) -> np.ndarray:
    """(N, 3, 3) F of each particle."""
    return _gradients(positions, rest, bonds, spacing)[0]


def _gradients(positions: Any, rest: Any, bonds: Bonds, spacing: float) -> Any:
    """F; Σ c X X^T, C; c, x and X of the pairs."""
    x, X = np.asarray(positions, np.float64), np.asarray(rest, np.float64)
    i, j = bonds.first_ends, bonds.other.astype(np.int64)
    c = weight(bonds.length.astype(np.float64) / spacing)
    r, R = x[j] - x[i], X[j] - X[i]
    shape = _summed(i, c[:, None, None] * R[:, :, None] * R[:, None, :], len(x))
    C = np.linalg.inv(shape)
    F = _summed(i, c[:, None, None] * r[:, :, None] * R[:, None, :], len(x)) @ C
    return F, shape, C, c, r, R


def _summed(i: np.ndarray, values: np.ndarray, n: int) -> np.ndarray:
    out = np.zeros((n, *values.shape[1:]))
    np.add.at(out, i, values)
    return out


def forces(
    positions: Any, rest: Any, bonds: Bonds, material: Elasticity, spacing: float,
    past: Any = (), stays: Any = None,
) -> tuple[float, np.ndarray]:  # fmt: skip
    """Energy and forces of a solid in float64: the oracle of the core's.

    Every particle's neighbors must span space: springs, which the core gives to others, are left
    out.

    Args:
        positions: (N, 3) m.
        rest: (N, 3) m.
        bonds: of the rest, all whole.
        material: of N particles.
        spacing: m.
        past: (K, N, 3, 3) inverse metrics of the parts that relax; none: nothing relaxes.
        stays: (N, 3, 3) inverse metric of the part that does not relax; None: that never yielded.

    Returns:
        J; (N, 3) N.
    """
    i, j = bonds.first_ends, bonds.other.astype(np.int64)
    F, shape, C, c, r, R = _gradients(positions, rest, bonds, spacing)
    n = len(F)
    J = np.linalg.det(F)
    cofactor = J[:, None, None] * np.linalg.inv(F).transpose(0, 2, 1)
    mu, lam, volume = material.shear, material.lame, spacing**3
    s = (lam + mu) * (J - 1) - mu
    P = mu[:, None, None] * F + s[:, None, None] * cofactor
    memory = np.zeros(n)
    shares = [share for share, _ in material.relaxation][: len(past)]
    parts = [*zip(shares, past, strict=True)]
    if stays is not None:
        parts.append((1 - sum(shares), stays))
    for share, G in parts:
        P += share * mu[:, None, None] * F @ (G - np.eye(3))
        strain = np.einsum("nab,nac,nbc->n", F, F, G - np.eye(3))
        memory += share * mu / 2 * (strain - np.log(np.linalg.det(G)))
    lasting = max(1 - sum(share for share, _ in material.relaxation), LEAST_STEADY)
    b = STEADINESS * lasting * volume * mu / np.trace(shape, axis1=1, axis2=2)
    off = r - np.einsum("nab,nb->na", F[i], R)
    energy = volume * (
        mu / 2 * ((F**2).sum((1, 2)) - 3) - mu * (J - 1) + (lam + mu) / 2 * (J - 1) ** 2 + memory
    ) + b / 2 * _summed(i, c * (off**2).sum(1), n)
    T = volume * P @ C - b[:, None, None] * F
    pair = np.einsum("nab,nb->na", T[i] + T[j], R) + (b[i] + b[j])[:, None] * r
    return float(energy.sum()), _summed(i, c[:, None] * pair, n)
