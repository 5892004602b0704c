"""A check that a fluid and another body of a scene do not fill the same places."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations
from typing import Any

import numpy as np

from .limits import OVERFULL
from .schema import SceneError

EDGE = 2.0  # spacings, of the cubes in which particles are counted
LEAST = 0.5  # of a cube's volume that each body fills, and
FULL = 1.6  # that both fill: more than one body's lattice has, wherever it begins


def check_overlap(scene: Any, found: Sequence[tuple[str, Any]]) -> None:
    """Refuse fluid that other fluid or a rigid body compresses so far that the first step fails.

    Args:
        scene: a `SceneFile`.
        found: every `Body`, after the name that messages give it.

    Raises:
        SceneError: names both bodies.
    """
    solver, edge = scene.solver, EDGE * scene.spacing
    if scene.solids or solver.method == "wcsph":  # these do not stop, as Record has it
        return
    loose = [(name, body) for name, body in found if body.kind in ("fluid", "rigid") and len(body.positions)]
    if len(loose) < 2:
        return
    bodies = [(name, body, *_corners(body.positions)) for name, body in loose]
    share = {"fluid": (scene.fluid_spacing / edge) ** 3, "rigid": (scene.spacing / edge) ** 3}
    total = share["fluid"] * sum(len(body.positions) for _, body in loose if _is_fluid(body))
    for (name, body, *ends), (other, second, *other_ends) in combinations(bodies, 2):
        lo, hi = np.maximum(ends[0], other_ends[0]), np.minimum(ends[1], other_ends[1])
        if not (_is_fluid(body) or _is_fluid(second)) or (hi - lo < edge).any():
            continue
        cells, volume = _volumes(body, share[body.kind], lo, hi, edge)
        others, more = _volumes(second, share[second.kind], lo, hi, edge)
        _, i, j = np.intersect1d(cells, others, assume_unique=True, return_indices=True)
        volume, more = volume[i], more[j]
        full = (volume + more > FULL) & (volume > LEAST) & (more > LEAST)
        fluid = volume * _is_fluid(body) + more * _is_fluid(second)
        compression = float((fluid * (volume + more - 1))[full].sum()) / total
        if compression > max(OVERFULL, 10 * solver.max_error):
            corners = " to ".join("(" + ", ".join(f"{x:.3g}" for x in at) + ")" for at in (lo, hi))
            raise SceneError(
                f"{other}: expected room beside {name}, got particles of both in the same places, in {corners}"
            )


def _is_fluid(body: Any) -> bool:
    return body.kind == "fluid"


def _corners(positions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Axis by axis, which takes a tenth of the time of all at once."""
    return np.array([x.min() for x in positions.T]), np.array([x.max() for x in positions.T])


def _volumes(body: Any, share: float, lo: np.ndarray, hi: np.ndarray, edge: float) -> tuple[np.ndarray, np.ndarray]:
    """The numbers of the cubes between two corners that have particles, and the share of each that
    the particles fill."""
    inside = np.ones(len(body.positions), bool)
    for x, a, b in zip(body.positions.T, lo, hi, strict=True):
        inside &= (x >= a) & (x <= b)
    # A quarter: the first layer of one body is at lo, not to be counted here or there by rounding.
    index = ((body.positions[inside] - lo) / edge + 0.25).astype(np.int64)
    n = ((hi - lo) / edge + 0.25).astype(np.int64) + 1
    cells, counts = np.unique((index[:, 0] * n[1] + index[:, 1]) * n[2] + index[:, 2],
                              return_counts=True)  # fmt: skip
    return cells, share * counts
