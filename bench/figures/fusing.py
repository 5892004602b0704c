"""Figure 2.5: two metaballs fuse."""

from __future__ import annotations

from typing import Any

import numpy as np
from globule._base.plot import BLUE, GRAY, ORANGE, Figure
from globule.data.particles import Particles
from globule.pieces.scene import Scene
from globule.render.camera import Camera
from globule.render.render import render
from globule.render.settings import RenderSettings

from .style import show_frame

DISTANCES = (1.65, 1.44, 1.38, 1.1, 0.6)  # of the centers, in supports
THRESHOLD = 0.5


def two(distance: float, device: str = "auto") -> Scene:
    """Two metaballs of support 1 at a distance along x."""
    centers = np.array([[-distance / 2, 0, 0], [distance / 2, 0, 0]], np.float32)
    color = np.array([[0.12, 0.36, 0.72], [0.85, 0.40, 0.05]], np.float32)
    return Scene(Particles(centers, support=1.0, color=color), threshold=THRESHOLD, device=device)


def two_metaballs(path: Any, device: str = "auto", dpi: float = 110) -> None:
    """Two metaballs at decreasing distance: apart they are spheres; as their supports overlap the
    field between them rises past the threshold, a neck forms, and in the end there is one body."""
    camera = Camera((0, 0.9, 6), (0, 0, 0), height=3.0)
    pixels = int(1.8 * dpi)
    with Figure(path, 10, 4.3, dpi) as figure:
        rows = figure.subplots(2, len(DISTANCES), sharey="row")
        for column, distance in enumerate(DISTANCES):
            scene = two(distance, device)
            above, below = rows[0, column], rows[1, column]
            settings = RenderSettings(background=(1, 1, 1))
            show_frame(above, render(scene, camera, (2 * pixels, 2 * pixels), settings).picture)
            above.set_title(f"distance {distance:.2f} a")
            x = np.linspace(-1.9, 1.9, 300, dtype=np.float32)
            points = np.stack([x, 0 * x, 0 * x], axis=1)
            total = scene.field(points)
            for center in (-distance / 2, distance / 2):
                place = np.array([[center, 0, 0]], np.float32)
                lone = Scene(Particles(place, support=1.0), device=device)
                below.plot(x, lone.field(points), color=GRAY, lw=1, ls=":")
            below.plot(x, total, color=BLUE, lw=2)
            below.fill_between(x, THRESHOLD, total, total > THRESHOLD, color=BLUE, alpha=0.25)
            below.axhline(THRESHOLD, color=ORANGE, lw=1.2, ls="--")
            below.set(xlim=(-1.9, 1.9), ylim=(0, 1.8), xticks=[-1, 0, 1], xlabel="x / a")
        rows[1, 0].set_ylabel("field on the axis")
        rows[1, 0].text(-1.85, THRESHOLD + 0.06, "τ", color=ORANGE)
