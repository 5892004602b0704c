"""Conversion between world coordinates and the page's, where every scene is about two units large.

The limits of the page (near and far distances, speeds, sizes of handles) suit scenes of that size.
A droplet of 1 mm and a head of 200 mm look the same to the page.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ..render.camera import Camera

GROWTH = 0.25  # of the extent; beyond it the camera is fitted again


# The page has perspective cameras only. This field of view, radians, stands for an orthographic
# camera: the image is exact, and handles are within a few percent of their place.
FLAT = float(np.radians(2.0))


class Placement:
    """page = (world - middle) * scale.

    Args:
        lo, hi: (3,) corners of the scene's box, world.

    Attributes:
        extent: longest side of the box, world units.
    """

    def __init__(self, lo: Any, hi: Any):
        self.put(lo, hi)

    def put(self, lo: Any, hi: Any) -> None:
        """Use another box from now on: corners (3,), world."""
        self.lo, self.hi = lo, hi = np.asarray(lo, np.float64), np.asarray(hi, np.float64)
        self.middle = (lo + hi) / 2
        self.extent = float(np.max(hi - lo)) or 1.0
        self.scale = 2.0 / self.extent

    def left_by(self, lo: Any, hi: Any) -> bool:
        """Whether another box (corners (3,), world) exceeds this one by more than `GROWTH`."""
        return bool(np.max([self.lo - lo, hi - self.hi]) > GROWTH * self.extent)

    def to_page(self, point: Any) -> np.ndarray:
        """(..., 3) world to page."""
        return (np.asarray(point, np.float64) - self.middle) * self.scale

    def to_world(self, point: Any) -> np.ndarray:
        """(..., 3) page to world."""
        return np.asarray(point, np.float64) / self.scale + self.middle

    def of_page(self, camera: Camera) -> tuple[np.ndarray, np.ndarray, float]:
        """Position and target (3,), page, and vertical field of view in radians, of a camera."""
        eye, look_at = self.to_page(camera.eye), self.to_page(camera.look_at)
        if camera.height is None:
            return eye, look_at, float(np.radians(camera.fov))
        away = (eye - look_at) / np.linalg.norm(eye - look_at)
        distance = self.scale * camera.height / 2 / np.tan(FLAT / 2)
        return look_at + distance * away, look_at, FLAT

    def camera(self, position: Any, look_at: Any, up: Any, fov: float) -> Camera:
        """The world's camera for position and target, page, and a vertical fov in radians."""
        eye, target = self.to_world(position), self.to_world(look_at)
        if not np.linalg.norm(target - eye) > 0:
            target = eye + np.array([0.0, 0.0, -1.0]) / self.scale
        if fov <= 1.001 * FLAT:
            away = eye - target
            height = float(2 * np.tan(FLAT / 2) * np.linalg.norm(away))
            before = 1.5 * self.extent + float(np.linalg.norm(target - self.middle))
            eye = target + before * away / np.linalg.norm(away)  # in front of everything
            return Camera(eye, target, up, height=height)
        fov = float(np.clip(np.degrees(fov), 1.0, 175.0))
        return Camera(tuple(eye.tolist()), tuple(target.tolist()), tuple(np.asarray(up).tolist()), fov)
