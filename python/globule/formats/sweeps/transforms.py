"""Named transforms between coordinate frames, and the way from one frame to another.

The field's names say source and target: ProbeToTracker maps points of Probe to Tracker, which here
is tracker_from_probe.
"""

from __future__ import annotations

import re
from typing import Any, NamedTuple

import numpy as np

_NAME = re.compile(r"([A-Z][A-Za-z0-9]*?)To([A-Z][A-Za-z0-9]*)")
_NO_NUMBER = re.compile(r"[+-]?(\d\.#[A-Z]+\d*|nan\(\w*\))", re.IGNORECASE)
WORLDS = ("Reference", "World", "Tracker")  # the first that can be reached is the world


class Transform(NamedTuple):
    """matrices (F, 4, 4) or (4, 4) float64, target from source; ok (F,) or () bool."""

    matrices: np.ndarray
    ok: np.ndarray


Edges = dict[tuple[str, str], Transform]  # (source, target)


def split_name(name: str) -> tuple[str, str] | None:
    """("Probe", "Tracker") of "ProbeToTracker"; None if the name is of another form."""
    match = _NAME.fullmatch(name)
    return (match[1], match[2]) if match else None


def find_path(edges: Edges, source: str, target: str) -> list[tuple[str, str]] | None:
    """The edges of the shortest way, each as it is walked; None if there is none."""
    came_from: dict[str, str] = {source: ""}
    frontier = [source]
    while frontier and target not in came_from:
        reached = []
        for here in frontier:
            for one, other in edges:
                there = other if one == here else one if other == here else None
                if there is not None and there not in came_from:
                    came_from[there] = here
                    reached.append(there)
        frontier = reached
    if target not in came_from:
        return None
    path = []
    while target != source:
        path.append((came_from[target], target))
        target = came_from[target]
    return path[::-1]


def chain(edges: Edges, path: list[tuple[str, str]], n: int) -> Transform:
    """The product along a path for `n` frames: matrices (n, 4, 4), and ok where all of it is."""
    matrices = np.tile(np.eye(4), (n, 1, 1))
    ok = np.ones(n, bool)
    for step in path:
        if step in edges:
            edge, factor = edges[step], edges[step].matrices
        else:
            edge = edges[step[1], step[0]]
            factor = inverse(edge.matrices)
        with np.errstate(over="ignore", invalid="ignore"):  # what is not finite is not ok
            matrices = factor @ matrices
        ok = ok & edge.ok & np.isfinite(factor).all(axis=(-2, -1))
    return Transform(matrices, ok & np.isfinite(matrices).all(axis=(-2, -1)))


def inverse(matrices: np.ndarray) -> np.ndarray:
    """The inverse of each matrix, NaN where there is none."""
    usable = np.isfinite(matrices).all(axis=(-2, -1))
    safe = np.where(usable[..., None, None], matrices, np.eye(4))
    with np.errstate(over="ignore", invalid="ignore"):
        usable &= np.abs(np.linalg.det(safe)) > 1e-300
        safe = np.where(usable[..., None, None], safe, np.eye(4))
        return np.where(usable[..., None, None], np.linalg.inv(safe), np.nan)


def parse_matrix(text: str) -> np.ndarray:
    """The 4x4 matrix of 16 numbers, row by row; -1.#IND and others of Windows are NaN. Raises
    ValueError."""
    words = ["nan" if _NO_NUMBER.fullmatch(word) else word for word in text.split()]
    try:
        values = np.array([float(word) for word in words])
    except ValueError as error:
        raise ValueError(str(error).removeprefix("could not convert string to float: ")) from None
    if len(values) != 16:
        raise ValueError(f"{len(values)} numbers")
    return values.reshape(4, 4)


def format_matrix(matrix: np.ndarray) -> str:
    """16 numbers, each of which survives exactly."""
    return " ".join(repr(value) for value in np.asarray(matrix, np.float64).ravel().tolist())


def check_pixel_matrix(name: str, value: Any) -> np.ndarray:
    """A 4x4 that maps pixels to mm: finite, last row 0 0 0 1, columns 0 and 1 not parallel. Raises
    ValueError for others."""
    try:
        matrix = np.array(value, np.float64)
    except (TypeError, ValueError, OverflowError):
        matrix = np.empty(0)
    if matrix.shape != (4, 4):
        raise ValueError(f"{name}: expected 4x4 numbers, got shape {matrix.shape}")
    if not np.isfinite(matrix).all():
        raise ValueError(f"{name}: expected finite numbers, got {matrix[~np.isfinite(matrix)][0]}")
    if not np.array_equal(matrix[3], (0, 0, 0, 1)):
        raise ValueError(f"{name}: expected 0 0 0 1 as the last row, got {matrix[3].tolist()}")
    u, v = matrix[:3, 0], matrix[:3, 1]
    area = np.linalg.norm(np.cross(u, v))
    if area <= 1e-9 * (u @ u + v @ v) or area == 0:
        raise ValueError(f"{name}: expected columns 0 and 1 to span a plane, got a singular matrix")
    return matrix
