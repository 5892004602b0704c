"""What a mesh file has."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np


class Triangles(NamedTuple):
    """The contents of a mesh file.

    vertices    (N, 3), world
    faces       (M, 3) integers, vertices of each triangle
    color       (N, 3) per vertex, linear RGB; or None
    face_color  (M, 3) per triangle, linear RGB; or None
    attributes  values per vertex, (N,) or (N, k), by name; or None
    origin      (x, y, z) from which the vertices are given, world; None where nobody says
    """

    vertices: np.ndarray
    faces: np.ndarray
    color: np.ndarray | None = None
    face_color: np.ndarray | None = None
    attributes: dict[str, np.ndarray] | None = None
    origin: tuple[float, float, float] | None = None
