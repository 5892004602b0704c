"""The part of a browser's window that no bar covers."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from ..render.camera import Camera

LEAST = 0.2  # share of the window that stays free, whatever the bars cover


@dataclass(frozen=True)
class Room:
    """Shares of the window's sides that bars cover.

    Attributes:
        left, top, right, bottom: 0 to 1.
    """

    left: float = 0.0
    top: float = 0.0
    right: float = 0.0
    bottom: float = 0.0

    def shares(self) -> tuple[float, float]:
        """The free shares of width and height."""
        return max(LEAST, 1 - self.left - self.right), max(LEAST, 1 - self.top - self.bottom)

    def free(self, size: tuple[int, int]) -> tuple[int, int]:
        """(width, height) of the free part of a window, pixels."""
        width, height = self.shares()
        return max(1, round(width * size[0])), max(1, round(height * size[1]))

    def part(self, shape: tuple[int, ...]) -> tuple[slice, slice]:
        """Rows and columns of the free part of an image of a shape (H, W, …)."""
        height, width = shape[:2]
        if self.shares() == (1, 1):
            return slice(0, height), slice(0, width)
        rows = slice(round(self.top * height), round((1 - self.bottom) * height))
        return rows, slice(round(self.left * width), round((1 - self.right) * width))

    def seated(self, camera: Camera, size: tuple[int, int]) -> Camera:
        """A camera for the free part of a window, changed so that the whole window shows the same
        there.

        Args:
            camera: fitted to an image of the free part's size.
            size: (width, height) of the window, pixels.
        """
        width, height = self.shares()
        if (width, height) == (1, 1):
            return camera
        eye, look_at = np.asarray(camera.eye, float), np.asarray(camera.look_at, float)
        away = (eye - look_at) / height
        _, _, right, up = camera.frame((1, 1))
        tall = float(np.linalg.norm(away)) * 2 * np.tan(np.radians(camera.fov) / 2)
        if camera.height is not None:
            tall = camera.height / height
        right, up = right / np.linalg.norm(right), up / np.linalg.norm(up)
        # The middle of the free part, from that of the window, in heights of the window
        x = (self.left - self.right) / 2 * size[0] / size[1]
        y = (self.bottom - self.top) / 2
        aside = tall * (-x * right - y * up)
        eye, look_at = look_at + away + aside, look_at + aside
        more = {} if camera.height is None else {"height": tall}
        return dataclasses.replace(camera, eye=tuple(eye.tolist()), look_at=tuple(look_at.tolist()), **more)
