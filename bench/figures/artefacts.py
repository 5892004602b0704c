"""Figures 5.1, 5.6 and 5.8: what the source's tracing shows where a part of it is left out."""

from __future__ import annotations

from typing import Any

import numpy as np
from globule._base.plot import INK, Figure
from globule.data.particles import Particles
from globule.pieces.scene import Scene
from globule.render.camera import Camera
from globule.render.fit import fit_camera
from globule.render.lights import DirectionalLight, Headlight
from globule.render.render import render
from globule.render.settings import RenderSettings
from globule.scene.thesis import Thesis

from .style import box_edges, draw_boxes, show_frame

COLOR = (0.20, 0.45, 0.75)
# From the side, so that steps and creases throw some shade.
SETTINGS = RenderSettings(
    lights=(Headlight((0.25,) * 3), DirectionalLight((-1.0, 0.8, 0.4), (0.85,) * 3)), background=(1, 1, 1)
)
LARGE_STEP, SMALL_STEP = 0.16, 0.01  # in supports
SPACE = ((0, 0, 0), (4, 4, 4))  # of figure 5.6: leaves of edge 1, as large as the supports
ALONE, PAIR = [[1.72, 1.45, 1.5]], [[1.5, 1.42, 1.5], [2.42, 1.62, 1.5]]


def dense_scene(centers: Any, support: float, level: int, device: str = "auto", bounds: Any = None) -> Scene:
    """Metaballs of one color in a dense octree, as the thesis's tracing needs it."""
    particles = Particles(np.array(centers, np.float32), support=support, color=np.array(COLOR, np.float32))
    return Scene(particles, threshold=0.4, octree="dense", level=level, device=device, bounds=bounds)


def marched(step: float) -> Thesis:
    """Marching with one step length, and its last point taken for the surface."""
    return Thesis(exterior=False, refine=False, thresholds=0, step=step)


def two_fused(device: str = "auto") -> tuple[Scene, Camera]:
    """Two metaballs that fuse, and a camera that sees both."""
    scene = dense_scene([[-0.62, 0, 0], [0.62, 0.1, 0]], 1.3, 0, device)
    return scene, Camera((0.5, 0.8, 4.2), (0, 0.05, 0), fov=29)


def step_size(path: Any, device: str = "auto", dpi: float = 110) -> None:
    """Two fused metaballs by marching: with steps of 0.16 supports the surface is a staircase of
    terraces, with steps of 0.01 it looks smooth, at sixteen times the evaluations."""
    scene, camera = two_fused(device)
    with Figure(path, 9, 3.6, dpi) as figure:
        for ax, step in zip(figure.subplots(1, 2), (LARGE_STEP, SMALL_STEP), strict=True):
            size = (int(9 * dpi), int(6.4 * dpi))
            show_frame(ax, render(scene, camera, size, SETTINGS, thesis=marched(step)).picture)
            ax.set_title(f"step {step:g} a")


def ghosts(path: Any, device: str = "auto", dpi: float = 110) -> None:
    """A leaf that sees only its own particles: (a) the surface ends where it reaches into empty
    leaves, (b) two metaballs in different leaves do not fuse; the images on the right use the
    particles of the neighbors."""
    camera = Camera((3.0, 2.9, 6.2), (2, 1.5, 1.5), fov=24)
    size = (int(4.2 * dpi * 2), int(2.7 * dpi * 2))
    with Figure(path, 8.4, 5.8, dpi) as figure:
        axes = figure.subplots(2, 2)
        for row, name, centers in ((0, "a", ALONE), (1, "b", PAIR)):
            scene = dense_scene(centers, 1.0, 2, device, SPACE)
            leaves = np.unique(np.floor(np.array(centers, np.float32)), axis=0)
            edges = np.concatenate([box_edges(leaf, leaf + 1) for leaf in leaves])
            for column, seen in ((0, False), (1, True)):
                ax = axes[row, column]
                frame = render(scene, camera, size, SETTINGS, thesis=Thesis(ghosts=seen))
                show_frame(ax, frame.picture)
                draw_boxes(ax, camera, frame, edges, INK, 0.8, 0.25)
                ax.set_title(f"({name}) {'own and neighbors’' if seen else 'own'} particles")


def cluster(device: str = "auto") -> Scene:
    """48 metaballs at random positions."""
    positions = np.random.default_rng(58).normal(0, 0.42, (48, 3))
    return dense_scene(np.clip(positions, -0.9, 0.9), 0.55, 1, device)


def normals(path: Any, device: str = "auto", dpi: float = 110) -> None:
    """The same surface shaded with normals away from the mean of the centers nearby, which jump
    where a support begins, and with the field's gradient, which is smooth everywhere."""
    scene = cluster(device)
    size = (int(9 * dpi), int(7.2 * dpi))
    camera = fit_camera(scene, size, fov=30)
    with Figure(path, 9, 4, dpi) as figure:
        titles = ("averaged centers", "gradient of the field")
        for ax, averaged in zip(figure.subplots(1, 2), (True, False), strict=True):
            thesis = Thesis(averaged_normals=averaged)
            show_frame(ax, render(scene, camera, size, SETTINGS, thesis=thesis).picture)
            ax.set_title(titles[not averaged])
