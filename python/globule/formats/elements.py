"""Chemical elements: numbers, van der Waals radii and colors, by the words of files of atoms."""

from __future__ import annotations

import re
import warnings
from collections.abc import Mapping, Sequence

import numpy as np

from .._base.colormaps import colorize
from .._base.elements import ELEMENTS
from .errors import shown

_MOST_ARE = 0.9  # of the atoms: the others' words are odd ones


def of_elements(words: Sequence[str]) -> dict[str, np.ndarray]:
    """What the elements of N atoms give, by name: `atomic_number` (N,) int64, `radius` (N,)
    float64, Å, and `color` (N, 3) float32. A charge or number behind a symbol does not count. Few
    words that are no element have the number 0 and the others' mean radius, with a warning.

    Words of which more are no elements are types: `type` (N,) int64, from 1 in alphabetical order.
    """
    kinds, place, count = np.unique(np.asarray(words, str), return_inverse=True, return_counts=True)
    symbols = [re.sub(r"[\d+-]+$", "", kind).capitalize() for kind in kinds.tolist()]
    known = np.array([symbol in ELEMENTS for symbol in symbols], bool)
    if not known.all():
        few = known.sum() > len(known) / 2 or count[known].sum() >= _MOST_ARE * count.sum()
        if "A" in symbols or not few:  # A, B and C are no boron and carbon
            return {"type": place.astype(np.int64) + 1}
        odd = ", ".join(shown(kind) for kind in kinds[~known][:3].tolist())
        warnings.warn(f"elements: {odd}: no such element; it has the mean radius of the others", stacklevel=2)
    numbers, radii = (np.array([ELEMENTS.get(symbol, (0, 0.0))[i] for symbol in symbols]) for i in (0, 1))
    if known.any():
        radii[~known] = (radii * count)[known].sum() / count[known].sum()
    numbers, radii = numbers[place], radii[place]
    return {"atomic_number": numbers, "radius": radii, "color": colorize(numbers, "elements", 0, 1)}


def type_names(words: Sequence[str], found: Mapping[str, np.ndarray]) -> dict[str, dict[int, str]]:
    """The names of the types that `of_elements` found in N words; none of elements."""
    return {"type": {i + 1: kind for i, kind in enumerate(sorted({*words}))}} if "type" in found else {}
