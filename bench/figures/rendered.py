"""Figures 6.1, 6.2, 6.3 and 6.5: pictures of metaballs, rendered."""

from __future__ import annotations

from typing import Any

import numpy as np
from globule._base.colormaps import colorize
from globule._base.plot import INK, ORANGE, Figure
from globule.data.particles import Particles
from globule.pieces.scene import Scene
from globule.render.camera import Camera
from globule.render.fit import fit_camera
from globule.render.lights import DirectionalLight, Headlight
from globule.render.render import render
from globule.render.settings import RenderSettings

from .style import box_edges, draw_boxes, show_frame

ON_WHITE = RenderSettings(background=(1, 1, 1))


def nine_leaves(device: str = "auto") -> tuple[Scene, np.ndarray]:
    """100 metaballs in nine cells of side 1, and the cells' corners (9, 3): eight cells around a
    point hold 99, one apart holds the last."""
    rng = np.random.default_rng(61)
    cells = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)] + [[3, 0, 1]])
    # Most lie close to the point where the eight cells meet, so that they fuse across the faces.
    inside = np.clip(rng.normal(1.0, 0.46, (99, 3)), 0.12, 1.88)
    positions = np.concatenate([inside, [[3.5, 0.5, 1.5]]]).astype(np.float32)
    tone = np.concatenate([rng.uniform(0.1, 0.75, 99), [0.95]])
    color = colorize(tone, "viridis", 0, 1)
    scene = Scene(Particles(positions, support=0.4, color=color), threshold=0.5, device=device)
    return scene, cells.astype(float)


def close_up(path: Any, device: str = "auto", dpi: float = 110) -> None:
    """Close up of 100 metaballs within nine leaves: 99 in eight leaves fuse across the leaves'
    faces without a seam; the last metaball, which is apart, stays a sphere."""
    scene, cells = nine_leaves(device)
    camera = Camera((4.4, 3.4, 7.0), (1.95, 0.8, 1.0), fov=31)
    with Figure(path, 8, 4.8, dpi) as figure:
        frame = render(scene, camera, _pixels(8, 4.8, dpi), ON_WHITE)
        ax = _full(figure)
        show_frame(ax, frame.picture)
        edges = np.concatenate([box_edges(c, c + 1) for c in cells])
        draw_boxes(ax, camera, frame, edges, INK, 0.9)


def clusters(n: int = 100_000) -> np.ndarray:
    """Positions (n, 3) float32 in a box of 1 x 1 x 0.25, in clusters, threads and voids: random
    points, moved along the gradient of a random potential (Zel'dovich 1970)."""
    rng = np.random.default_rng(62)
    grid = 96
    k = np.fft.fftfreq(grid) * 2 * np.pi * grid
    kx, ky, kz = np.meshgrid(k, k, k, indexing="ij")
    k2 = kx**2 + ky**2 + kz**2
    k2[0, 0, 0] = np.inf
    noise = np.fft.fftn(rng.normal(size=(grid,) * 3))
    spectrum = noise * np.exp(-k2 / (2 * 32.0**2))
    moves = [np.fft.ifftn(1j * axis / k2 * spectrum).real for axis in (kx, ky, kz)]
    start = rng.uniform(0, 1, (n, 3)) * [1, 1, 0.25]
    cell = tuple((start * grid).astype(int).T)
    moved = np.stack([m[cell] / moves[0].std() for m in moves], axis=1)
    # Within a cell of the potential all points would move alike: a little disorder hides that.
    moved += rng.normal(0, 0.05, moved.shape)
    return (start + 0.034 * moved).astype(np.float32)


def scattered(path: Any, device: str = "auto", dpi: float = 110) -> None:
    """100,000 metaballs scattered through the space: they fuse to threads and clusters where they
    are dense, and leave voids between; the color is the number of neighbors."""
    positions = clusters()
    support = 0.007
    scene = Scene(Particles(positions, support=support), threshold=0.5, device=device)
    offsets, _ = scene.neighbors(positions, 3 * support)
    crowd = np.log(np.diff(offsets.astype(np.int64)))
    lo, hi = np.quantile(crowd, [0.05, 0.98])
    scene.update(Particles(positions, support=support, color=colorize(crowd, "viridis", lo, hi)))
    settings = RenderSettings(
        lights=(Headlight((0.5,) * 3), DirectionalLight((-0.5, 1, 0.4), (0.8,) * 3)), background=(1, 1, 1)
    )
    camera = Camera((0.8, 0.75, 2.3), (0.5, 0.49, 0.12), fov=31)
    with Figure(path, 4.9, 4.5, dpi) as figure:
        frame = render(scene, camera, _pixels(4.9, 4.5, dpi), settings)
        show_frame(_full(figure), frame.picture)


def cube(kernel: str, device: str = "auto", n: int = 40) -> Scene:
    """n^3 particles on a lattice of spacing 1 around the origin, colored by height."""
    steps = np.arange(n) - (n - 1) / 2
    positions = np.stack(np.meshgrid(steps, steps, steps, indexing="ij"), -1).reshape(-1, 3)
    color = colorize(positions[:, 1], "viridis", -0.6 * n, 0.6 * n)
    return Scene(Particles(positions, color=color), kernel, device=device)


def solid(path: Any, device: str = "auto", dpi: float = 110) -> None:
    """A cube of 64,000 particles, as metaballs and in solid mode, where the threshold rises with
    the supports that overlap: faces stay flat up to the outermost row, edges are sharper."""
    camera = Camera((62, 54, 90), (0, 0, 0), fov=32)
    lights = (DirectionalLight((0.4, 1, 0.55), (0.75,) * 3), Headlight((0.35,) * 3))
    look = RenderSettings(lights=lights, background=(1, 1, 1))
    with Figure(path, 8.6, 4.2, dpi) as figure:
        for ax, kernel in zip(figure.subplots(1, 2), ("murakami", "solid"), strict=True):
            frame = render(cube(kernel, device), camera, _pixels(4.2, 3.8, dpi), look)
            show_frame(ax, frame.picture)
            ax.set_title("metaballs (murakami)" if kernel == "murakami" else "solid mode")


def at_the_border(device: str = "auto", bounds: Any = None, n: int = 400) -> tuple[Scene, np.ndarray]:
    """Metaballs close to the faces of the unit cube, and its corners (2, 3). The cube is the
    octree's space, unless `bounds` are given; supports reach beyond it."""
    rng = np.random.default_rng(65)
    positions = rng.uniform(0, 1, (n, 3))
    axis, side = rng.integers(0, 3, n), rng.integers(0, 2, n)
    positions[np.arange(n), axis] = side + (1 - 2 * side) * rng.exponential(0.015, n)
    positions[:8] = [[i & 1, i >> 1 & 1, i >> 2] for i in range(8)]  # one in every corner
    box = np.array([[0, 0, 0], [1, 1, 1]], float)
    color = colorize(rng.uniform(0, 1, n), "viridis", -0.1, 1.05)
    scene = Scene(
        Particles(np.clip(positions, 0, 1), support=0.12, color=color),
        threshold=0.4,
        device=device,
        bounds=box if bounds is None else bounds,
    )
    return scene, box


def border(path: Any, device: str = "auto", dpi: float = 110) -> None:
    """Random metaballs at the border of the octree, drawn as lines: surfaces that reach across are
    neither clipped nor doubled, also in the corners."""
    scene, box = at_the_border(device)
    camera = fit_camera(scene, (9, 7), direction=(0.62, 0.42, 1.0), fov=32)
    with Figure(path, 4.5, 3.5, dpi) as figure:
        frame = render(scene, camera, _pixels(4.5, 3.5, dpi), ON_WHITE)
        ax = _full(figure)
        show_frame(ax, frame.picture)
        draw_boxes(ax, camera, frame, box_edges(*box), ORANGE, 1.8, 0.45)


def _pixels(width: float, height: float, dpi: float) -> tuple[int, int]:
    """Twice as many as are shown, so that edges come out smooth."""
    return int(2 * width * dpi), int(2 * height * dpi)


def _full(figure: Any) -> Any:
    """Axes that fill the figure."""
    figure.set_layout_engine("none")
    return figure.add_axes((0, 0, 1, 1))
