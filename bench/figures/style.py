"""Drawings in space, and over rendered images."""

from __future__ import annotations

from typing import Any

import numpy as np
from globule.render.camera import Camera

# Rows right, up and towards the eye, of the parallel projection of drawings in space.
_TURN, _TILT = np.radians(-32), np.radians(24)
VIEW = np.array(
    [
        [np.cos(_TURN), 0, np.sin(_TURN)],
        [np.sin(_TILT) * np.sin(_TURN), np.cos(_TILT), -np.sin(_TILT) * np.cos(_TURN)],
        [-np.cos(_TILT) * np.sin(_TURN), np.sin(_TILT), np.cos(_TILT) * np.cos(_TURN)],
    ]
)


def bare(ax: Any, title: str = "") -> None:
    """Axes without ticks and frame, x and y of the same scale."""
    ax.set_aspect("equal")
    ax.axis("off")
    if title:
        ax.set_title(title)


def box_edges(lo: Any, hi: Any) -> np.ndarray:
    """The twelve edges (12, 2, 3) of a box."""
    lo, hi = np.asarray(lo, float), np.asarray(hi, float)
    corners = np.array([[(i >> a) & 1 for a in range(3)] for i in range(8)])
    edges = [(i, i | 1 << a) for i in range(8) for a in range(3) if not i >> a & 1]
    return (lo + corners * (hi - lo))[np.array(edges)]


def draw_cubes(
    ax: Any,
    corners: np.ndarray,
    side: float,
    colors: Any,
    alpha: float = 1.0,
    width: float = 0.6,
    edge: str = "#33506b",
) -> None:
    """Draw cubes of one grid, y up, seen from the front, the right and above, far cubes first.

    corners: (M, 3) lowest corners. colors: one for all, or one per cube.
    """
    from matplotlib.collections import PolyCollection
    from matplotlib.colors import to_rgb

    order = np.argsort(corners @ VIEW[2], kind="stable")
    each = np.array([to_rgb(c) for c in ([colors] if isinstance(colors, str) else colors)])
    each = np.broadcast_to(each, (len(corners), 3))[order]
    # The sides towards the eye: +y, +z and +x, the top lightest.
    faces = np.array(
        [
            [[0, 1, 0], [1, 1, 0], [1, 1, 1], [0, 1, 1]],
            [[0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1]],
            [[1, 0, 0], [1, 1, 0], [1, 1, 1], [1, 0, 1]],
        ]
    )
    points = corners[order][:, None, None] + side * faces
    shade = np.array([1.0, 0.86, 0.72])[:, None]
    ax.add_collection(
        PolyCollection(
            list(flattened(points).reshape(-1, 4, 2)),
            facecolors=(each[:, None] * shade).reshape(-1, 3),
            edgecolors=edge,
            linewidths=width,
            alpha=alpha,
            joinstyle="round",
        )
    )
    ax.autoscale_view()


def flattened(points: Any) -> np.ndarray:
    """Drawing coordinates (..., 2) of points (..., 3), in the projection of `draw_cubes`."""
    return np.asarray(points) @ VIEW[:2].T


def projected(camera: Camera, size: tuple[int, int], points: Any) -> tuple[np.ndarray, np.ndarray]:
    """Pixel coordinates (..., 2), right and down from the top left corner, of world points
    (..., 3), and their distances from the eye."""
    eye, forward, right, up = camera.frame(size)
    v = np.asarray(points, float) - eye
    depth = v @ forward
    x, y = v @ right / (right @ right), v @ up / (up @ up)
    if camera.height is None:
        x, y = x / depth, y / depth
    pixels = np.stack([(x + 1) * size[0] / 2, (1 - y) * size[1] / 2], axis=-1)
    return pixels, np.linalg.norm(v, axis=-1)


def show_frame(ax: Any, picture: np.ndarray) -> None:
    """A rendered picture, pixel coordinates as the axes'."""
    height, width = picture.shape[:2]
    ax.imshow(picture, extent=(0, width, height, 0), interpolation="antialiased")
    ax.axis("off")


def draw_boxes(
    ax: Any, camera: Camera, frame: Any, edges: np.ndarray, color: str, width: float = 1.2, hidden: float = 0.15
) -> None:
    """Edges (M, 2, 3) over a rendered frame; what the surface hides is drawn faintly, with
    the opacity `hidden`."""
    from matplotlib.collections import LineCollection

    size = frame.size
    at = np.linspace(0, 1, 41)
    points = edges[:, :1] + at[:, None] * (edges[:, 1:] - edges[:, :1])
    pixels, distance = projected(camera, size, points)
    depth = frame.distance
    column = np.clip(pixels[..., 0].astype(int), 0, size[0] - 1)
    row = np.clip(pixels[..., 1].astype(int), 0, size[1] - 1)
    seen = distance <= depth[row, column] * 1.002
    pieces = np.stack([pixels[:, :-1], pixels[:, 1:]], axis=2).reshape(-1, 2, 2)
    in_front = (seen[:, :-1] & seen[:, 1:]).ravel()
    ax.add_collection(LineCollection(pieces[in_front], colors=color, linewidths=width))
    ax.add_collection(LineCollection(pieces[~in_front], colors=color, linewidths=width, alpha=hidden))
    ax.set_xlim(0, size[0])
    ax.set_ylim(size[1], 0)
