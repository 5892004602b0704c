"""The smooth surface of a simulated pool at rest: how flat, how steady, and at which height."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from globule.pieces.scene import Scene
from globule.sim.simulation import Simulation

SPACING = 0.05  # m
WIDTH, DEPTH = 20, 8  # spacings
MARGIN = 5  # spacings from the walls
JITTER = 0.1  # spacings, at the beginning


class RestingPool(NamedTuple):
    """angle: root mean square of the normals' angles to the vertical, degrees. height: of the
    surface over the height that the particles' number tells, mean, spacings. flicker: root mean
    square change of the depth of a ray from frame to frame, spacings."""

    n: int
    angle: float
    height: float
    flicker: float


def resting_pool(settle: float = 2.4, frames: int = 20, **backend: Any) -> RestingPool:
    """A pool of 3,200 particles, `settle` seconds after it was filled, and then `frames` frames,
    20 ms apart, seen from above and away from the walls.

    The number of particles above a level inside the water, times a particle's volume over the area,
    is the surface's height above that level; the mean over many levels and areas is taken.
    """
    size = WIDTH * SPACING
    simulation = Simulation(
        {
            "spacing": SPACING,
            "gravity": (0, -9.81, 0),
            "domain": {"lo": (0, 0, 0), "hi": (size, 2 * DEPTH * SPACING, size), "walls": True},
            "fluids": [{"name": "water", "viscosity": 0.5}],
        },
        **backend,
    )
    axes = np.meshgrid(np.arange(WIDTH), np.arange(DEPTH), np.arange(WIDTH), indexing="ij")
    points = np.stack(axes, -1).reshape(-1, 3) + 0.5
    points += np.random.default_rng(0).uniform(-JITTER, JITTER, points.shape)
    simulation.add((points * SPACING).astype(np.float32), "water")
    simulation.run(settle)

    x = np.linspace(MARGIN, WIDTH - MARGIN, 40)
    x, z = np.meshgrid(x, x + 0.01)
    top = 1.5 * DEPTH
    origins = np.stack([x, np.full_like(x, top), z], -1).reshape(-1, 3) * SPACING
    down = np.tile(np.array([0, -1, 0], np.float32), (len(origins), 1))
    scene = Scene(simulation.shown_particles.positions, surface="smooth", spacing=SPACING, **backend)
    heights, angles, expected = [], [], []
    for _ in range(frames):
        simulation.run(0.02)
        positions = np.asarray(simulation.shown_particles.positions)
        scene.update(positions=positions)
        hits = scene.intersect(origins.astype(np.float32), down)
        heights.append(top - hits.distance.astype(float) / SPACING)
        angles.append(np.degrees(np.arccos(np.clip(hits.normal[:, 1].astype(float), -1, 1))))
        expected.append(_height(positions / SPACING))
    return RestingPool(
        len(points),
        float(np.sqrt(np.mean(np.square(angles)))),
        float(np.mean(np.mean(heights, axis=1) - expected)),
        float(np.sqrt(np.mean(np.square(np.diff(heights, axis=0))))),
    )


def _height(positions: np.ndarray) -> float:
    levels = np.linspace(2, DEPTH - 3, 31)
    found = []
    for margin in np.linspace(MARGIN - 1, MARGIN + 1, 41):
        inside = (np.abs(positions[:, [0, 2]] - WIDTH / 2) < WIDTH / 2 - margin).all(axis=1)
        above = (positions[inside, 1][:, None] > levels).sum(axis=0)
        found.append(np.mean(levels + above / (WIDTH - 2 * margin) ** 2))
    return float(np.mean(found))
