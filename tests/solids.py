"""A float64 reference of a solid's energy and forces."""

from typing import Any

import numpy as np
from globule.sim.bonds import Bonds
from globule.sim.materials import Elasticity

STEADINESS = 3.0  # energy against zero-energy modes, shear moduli; src/sim/solid.hpp has the same
LEAST_STEADY = 0.1  # of it, however much of the shear modulus relaxes; as there


def weight(q: np.ndarray) -> np.ndarray:
    """-W'(q) / q of the cubic spline with a support of two spacings, but for a factor and a faster
    fall beyond one spacing; q: distances in spacings."""
    return np.where(q < 1, 3 - 2.25 * q, 0.75 * np.maximum(2 - q, 0) ** 4 / np.maximum(q, 1))


def relaxed(past: np.ndarray, F: np.ndarray, material: Elasticity, dt: float) -> np.ndarray:
    """Inverse metrics (K, N, 3, 3) of the parts that relax, after dt seconds at F (N, 3, 3): the
    oracle of src/sim/memory.hpp."""
    to = np.linalg.inv(F.transpose(0, 2, 1) @ F)
    kept = np.array([np.exp(-dt / time) for _, time in material.relaxation])
    return to + kept[:, None, None, None] * (past - to)


def yielded(stays: np.ndarray, F: np.ndarray, material: Elasticity, at: float, rate: float, dt: float) -> np.ndarray:
    """Inverse metric (N, 3, 3) of the part that does not relax, after dt seconds at F: what is
    beyond the yield strain `at` falls at `rate`, in principal logarithmic stretches."""
    ratio = material.lame / (2 * (material.lame + material.shear))
    squares, axes = np.linalg.eigh(F @ stays @ F.transpose(0, 2, 1))
    h = 0.5 * np.log(squares)
    swelling = h.mean(1, keepdims=True)
    h -= swelling
    beyond = np.maximum(1 - at / np.maximum(np.sqrt(1.5 * (h**2).sum(1)) / (1 + ratio), 1e-300), 0)
    kept = 1 - beyond * (1 - np.exp(-1.5 / (1 + ratio) * rate * dt))
    squares, inner = np.exp(2 * (h * kept[:, None] + swelling)), np.linalg.inv(F) @ axes
    return (inner * squares[:, None, :]) @ inner.transpose(0, 2, 1)


def gradients(positions: Any, rest: Any, bonds: Bonds, spacing: float) -> np.ndarray:
    return _gradients(positions, rest, bonds, spacing)[0]


def _gradients(positions: Any, rest: Any, bonds: Bonds, spacing: float) -> Any:
    """F; Σ c X X^T, C; c, x and X of the pairs."""
    x, X = np.asarray(positions, np.float64), np.asarray(rest, np.float64)
    i, j = bonds.first_ends, bonds.other.astype(np.int64)
    c = weight(bonds.length.astype(np.float64) / spacing)
    r, R = x[j] - x[i], X[j] - X[i]
    shape = _summed(i, c[:, None, None] * R[:, :, None] * R[:, None, :], len(x))
    C = np.linalg.inv(shape)
    return _summed(i, c[:, None, None] * r[:, :, None] * R[:, None, :], len(x)) @ C, shape, C, c, r, R


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
    n, J = len(F), np.linalg.det(F)
    cofactor = J[:, None, None] * np.linalg.inv(F).transpose(0, 2, 1)
    mu, lam, volume = material.shear, material.lame, spacing**3
    P, memory = mu[:, None, None] * F + ((lam + mu) * (J - 1) - mu)[:, None, None] * cofactor, np.zeros(n)
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
