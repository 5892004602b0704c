"""What the particles of a solid are made of: moduli, relaxation, and the substeps they take."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from .._base.checks import shown

MODELS = ("bonds", "solid")
MODEL = "solid"  # default
POISSON = 0.45  # default of solids
MOST_POISSON = 0.49
MOST_TERMS = 2  # of a Prony series; src/sim/memory.hpp has the same
MOST_SHARE = 0.999  # of the shear modulus that relaxes: a solid stays one
SHORTEST, LONGEST = 1e-6, 1e6  # relaxation times, s
MOST_SUBSTEPS = 100_000  # of tissue in the longest step
# Stiffest motions of blocks of a lattice: density (frequency spacing)² <= 7 λ + 13 μ.
_STIFFEST_LAME, _STIFFEST_SHEAR = 7.0, 13.0
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


def substep_rate(young: float, poisson: float | None, density: float, spacing: float, model: str) -> float:
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
        raise ValueError(f"relaxation: expected shares of at most {MOST_SHARE:g} together, got {total:g}")
    return pairs
