"""The thesis's rigidity of a particle: 0 is fluid, 1 is fixed, and between them is tissue.

Tissue's Young's modulus grows with its rigidity, E = 100 Pa · 10^(4 rigidity):
0.35 is brain (2.5 kPa), 0.5 is muscle at rest (10 kPa), 0.75 is 100 kPa.
"""

from __future__ import annotations

from typing import Any

import numpy as np

SOFTEST = 100.0  # Pa
DECADES = 4.0


def young_of_rigidity(rigidity: Any) -> np.ndarray:
    """Young's modulus, Pa, of rigidities in (0, 1)."""
    return SOFTEST * 10.0 ** (DECADES * np.asarray(rigidity, np.float64))


def rigidity_of_young(young: Any) -> np.ndarray:
    """The rigidity of a Young's modulus, Pa, kept within tissue's range, 0.001 to 0.999."""
    return np.clip(np.log10(np.asarray(young, np.float64) / SOFTEST) / DECADES, 0.001, 0.999)
