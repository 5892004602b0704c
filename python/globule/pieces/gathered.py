"""All particles of the ranks on every one of them, and the memory that this takes."""

from __future__ import annotations

from typing import Any

import numpy as np

from .._base.arrays import to_host
from .._base.ranks import Alone
from ..data.particles import Particles
from .pieces import BYTES
from .store import COLUMNS, TELLING, Layout, check_reach

LIGHT_BYTES = 1470  # a particle of a pool of a million: the cells that light needs, on a CPU
FACTORS = ("reflection", "refraction")


def replicated_bytes(n: int, surface: str) -> float:
    """Bytes that n particles take with the cells that light needs, which lie at the surface."""
    return n * (BYTES[surface] + LIGHT_BYTES * (1e6 / max(n, 1)) ** (1 / 3))


def gathered(ranks: Alone, particles: Particles) -> Particles:
    """All ranks' particles, in the order of the ranks, on every one; without attributes but `radius`."""

    def fields() -> tuple[tuple[str, ...], dict[str, Any]]:
        each, one = [], {}
        for name in (*COLUMNS, *FACTORS):
            value = None if name == "positions" else getattr(particles, name)
            if value is None:
                continue
            if np.ndim(value) > (name == "color"):
                each.append(name)
            else:
                one[name] = value if np.ndim(value) == 0 else np.asarray(to_host(value)).tolist()
        if TELLING["radius"](particles) is not None:
            each.append("radius")
        return tuple(each), one

    found = [f for f, n in ranks.all((ranks.together(fields), len(particles))) if n]
    found = found or [((), {})]
    check_reach([Layout(*f) for f in found])
    names = sorted({name for each, one in found for name in (*each, *one)})
    if not all("radius" in each for each, _ in found):
        names = [name for name in names if name != "radius"]
    ones = [[one.get(name) for _, one in found] for name in names]
    same = {
        name: values[0]
        for name, values in zip(names, ones, strict=True)
        if values[0] is not None and all(v == values[0] for v in values)
    }
    layout = Layout(tuple(n for n in names if n not in same), same)
    rows = ranks.together(lambda: layout.rows(particles))
    everything = layout.particles(ranks.concatenated(rows))
    everything.up = particles.up
    return everything
