"""Chemical elements: numbers, van der Waals radii and colors, by the words of files of atoms."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np

from .._base.colormaps import colorize
from .._base.elements import ELEMENTS


def of_elements(words: Sequence[str]) -> dict[str, np.ndarray]:
    """What the elements of N atoms give, by name: `atomic_number` (N,) int64, `radius` (N,)
    float64, Å, and `color` (N, 3) float32. A charge or number behind a symbol does not count.

    Words that are not all elements are types: `type` (N,) int64, from 1 in alphabetical order.
    """
    kinds, place = np.unique(np.asarray(words, str), return_inverse=True)
    symbols = [re.sub(r"[\d+-]+$", "", kind).capitalize() for kind in kinds.tolist()]
    if not all(symbol in ELEMENTS for symbol in symbols):
        return {"type": place.astype(np.int64) + 1}
    known = [ELEMENTS[symbol] for symbol in symbols]
    numbers, radii = (np.array([row[i] for row in known])[place] for i in (0, 1))
    colors = colorize(numbers, "elements", 0, 1)
    return {"atomic_number": numbers, "radius": radii, "color": colors}


def type_names(words: Sequence[str]) -> dict[str, dict[int, str]]:
    """The names of the types that `of_elements` makes of N words; none of elements."""
    kinds = sorted({*words})
    if "type" not in of_elements(kinds):
        return {}
    return {"type": {i + 1: kind for i, kind in enumerate(kinds)}}
