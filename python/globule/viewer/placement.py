"""Between the world and the page, in which every scene is about two units large.

The page's own limits (nearest and farthest distances, speeds, sizes of handles) suit scenes of that
size; a drop of a millimetre and a head of 200 mm get the same.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ..camera import Camera

GROWTH = 0.25  # of what is shown, until all of it is fitted into the picture again


class Placement:
    """page = (world - middle) * scale."""

    def __init__(self, lo: Any, hi: Any):
        self.put(lo, hi)

    def put(self, lo: Any, hi: Any) -> None:
        """The scene is between these corners of the world from now on."""
        self.lo, self.hi = lo, hi = np.asarray(lo, np.float64), np.asarray(hi, np.float64)
        self.middle = (lo + hi) / 2
        self.extent = float(np.max(hi - lo)) or 1.0
        self.scale = 2.0 / self.extent

    def left_by(self, lo: Any, hi: Any) -> bool:
        """Whether a box sticks out of it so far that this is to be seen."""
        return bool(np.max([self.lo - lo, hi - self.hi]) > GROWTH * self.extent)

    def to_page(self, point: Any) -> np.ndarray:
        return (np.asarray(point, np.float64) - self.middle) * self.scale

    def to_world(self, point: Any) -> np.ndarray:
        return np.asarray(point, np.float64) / self.scale + self.middle

    def camera(self, position: Any, look_at: Any, up: Any, fov: float) -> Camera:
        """The camera of the page's; fov: vertical, radians."""
        eye, target = self.to_world(position), self.to_world(look_at)
        if not np.linalg.norm(target - eye) > 0:
            target = eye + np.array([0.0, 0.0, -1.0]) / self.scale
        fov = float(np.clip(np.degrees(fov), 1.0, 175.0))
        return Camera(tuple(eye.tolist()), tuple(target.tolist()), tuple(np.asarray(up).tolist()),
                      fov)
