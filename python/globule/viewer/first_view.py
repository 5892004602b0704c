"""The first view: a camera that shows everything, for a window of any shape."""

from __future__ import annotations

from typing import Any

import numpy as np

from .._base.arrays import box_corners, on_gpu
from ..render.camera import Camera, first_direction
from ..render.fit import fit_camera, surface_reach
from ..scene.mesh import Mesh
from ..sim.simulation_scene import SimulationScene
from .source import Source

FIRST_SIZE = (1280, 720)
MOST_POINTS, N_DIRECTIONS = 200_000, 96  # that the first camera is fitted to


def outermost(source: Source, scene: Any) -> np.ndarray:
    """Points (M, 3) outside of the outermost particles in many directions, as far as their surface.

    For particles on a GPU: the corners of their box.
    """
    lo, hi = source.bounds()
    particles = source.particles()
    if on_gpu(particles.positions) or not len(particles.finite_positions()):
        return box_corners(lo, hi)
    points = particles.finite_positions()
    points = points[:: 1 + len(points) // MOST_POINTS] - (lo + hi) / 2
    i = np.arange(N_DIRECTIONS) + 0.5
    height, turn = 1 - 2 * i / N_DIRECTIONS, np.pi * (1 + 5**0.5) * i  # evenly over a sphere
    flat = np.sqrt(1 - height**2)
    directions = np.stack([flat * np.cos(turn), flat * np.sin(turn), height], axis=1)
    far = points[[int(np.argmax(points @ towards)) for towards in directions]]
    reach = 0.0 if isinstance(scene, Mesh) else surface_reach(scene)
    return 1.06 * far + reach * directions + (lo + hi) / 2


def left_out(scene: Any) -> list[str]:
    """Warnings about particles that cannot be shown."""
    if isinstance(scene, (Mesh, SimulationScene)):  # a simulation shows some on purpose
        return []
    n_lost = len(scene) - scene.octree.n_inside
    if not n_lost:
        return []
    return [
        f"{n_lost:,} of {len(scene):,} particles {'is' if n_lost == 1 else 'are'} not shown: "
        "expected finite positions below 1e18, got others"
    ]


def first_camera(scene: Any, up: Any, around: Any, like: Camera | None = None, fov: float = 40.0) -> Camera:
    """A camera that shows everything.

    Args:
        scene: to show.
        up: (3,) upward direction, world.
        around: (M, 3) points to show; None: the particles with their surface.
        like: a camera that gives direction and field of view; default: from the front, a little
            right and above.
        fov: vertical field of view, degrees, without `like`.
    """
    if around is None and scene.octree.n_inside == 0:
        return Camera((1.2, 0.9, 2.0), (0, 0, 0), up)
    towards = first_direction(up)
    if like is not None:
        towards, fov = np.subtract(like.eye, like.look_at), like.fov
    return fit_camera(scene, FIRST_SIZE, around, direction=towards, up=up, fov=fov)


def for_window(camera: Camera, aspect: float, around: np.ndarray | None = None) -> Camera:
    """The first camera for a window of another shape.

    Args:
        camera: for a window of `FIRST_SIZE`.
        aspect: width / height of the window.
        around: (M, 3) points to show.

    Returns:
        The nearer of two cameras: fitted to the points, or moved away for a narrow window.
    """
    aside = narrower(camera, aspect)
    if around is None or camera.height is not None:
        return aside
    towards, size = np.subtract(camera.eye, camera.look_at), (round(1000 * max(aspect, 0.1)), 1000)
    fitted = Camera.fit(around, towards, camera.up, camera.fov, size)
    distances = [np.linalg.norm(np.subtract(c.eye, c.look_at)) for c in (aside, fitted)]
    return aside if distances[0] < distances[1] else fitted


def narrower(camera: Camera, aspect: float) -> Camera:
    """A camera, moved away as far as a window narrower than FIRST_SIZE needs."""
    back = max(1.0, FIRST_SIZE[0] / FIRST_SIZE[1] / max(aspect, 0.1))
    away = np.subtract(camera.eye, camera.look_at) * back
    eye = tuple((np.asarray(camera.look_at) + away).tolist())
    height = None if camera.height is None else camera.height * back
    return Camera(eye, camera.look_at, camera.up, camera.fov, height)
