"""Figures 2.2 and 2.3: how an octree divides real particles."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
from globule._base.plot import BLUE, INK, Figure
from globule._demo.data import splash
from globule.pieces.scene import Scene
from globule.scene.octree import morton

from .style import bare, draw_cubes

LEAF_SIZE = 32  # a cell with more particles is split (src/octree/types.hpp)
LEVELS = 10  # of a 32-bit key
N_PARTICLES = 20_000


def scene_and_codes(device: str = "auto") -> tuple[Scene, np.ndarray, np.ndarray]:
    """The demo's splash: scene, sorted keys (N,) int64 without descriptor, sorted positions."""
    positions, _, spacing = splash(N_PARTICLES)
    scene = Scene(positions, support=2 * spacing, device=device)
    keys, index = scene.octree.sorted_keys(len(positions))
    return scene, keys.astype(np.int64) & (8**LEVELS - 1), positions[index]


def leaf_cells(codes: np.ndarray) -> np.ndarray:
    """Level and corner in octree coordinates of every leaf (M, 4), from the sorted keys alone: a
    cell is a run of keys that share their first triplets."""
    cells, todo = [], [(0, 0, len(codes))]
    while todo:
        level, first, last = todo.pop()
        if last - first <= LEAF_SIZE or level == LEVELS:
            low = 3 * (LEVELS - level)
            cells.append((level, *morton.decode(int(codes[first]) >> low << low)))
            continue
        prefix = codes[first:last] >> 3 * (LEVELS - level - 1)
        ends = [0, *(np.flatnonzero(np.diff(prefix)) + 1), last - first]
        todo += [(level + 1, first + a, first + b) for a, b in itertools.pairwise(ends)]
    return np.array(cells)


def occupied_cells(codes: np.ndarray, level: int) -> np.ndarray:
    """Grid coordinates (M, 3) of a level's cells that hold particles."""
    low = 3 * (LEVELS - level)
    cells = [morton.decode(int(c) << low) for c in np.unique(codes >> low)]
    return np.array(cells) >> (LEVELS - level)


def in_the_plane(path: Any, device: str = "auto", dpi: float = 110) -> None:
    """The leaves that a vertical plane through the demo's splash meets: a cell with more than 32
    particles is split, so cells are small only where particles are dense."""
    from matplotlib.collections import PatchCollection
    from matplotlib.patches import Rectangle

    scene, codes, positions = scene_and_codes(device)
    tree, cells = scene.octree, leaf_cells(codes)
    unit = tree.extent / 2**LEVELS
    side = unit * 2.0 ** (LEVELS - cells[:, 0])
    corner = tree.lo + unit * cells[:, 1:]
    z = 0.02
    met = (corner[:, 2] <= z) & (z < corner[:, 2] + side)
    near = np.abs(positions[:, 2] - z) < 0.02
    with Figure(path, 9, 4.6, dpi) as figure:
        ax = figure.subplots()
        bare(
            ax,
            f"{met.sum()} of {len(cells):,} leaves, levels {cells[met, 0].min()} to "
            f"{cells[met, 0].max()}; in blank places there are none",
        )
        ax.plot(*positions[near, :2].T, ".", color=BLUE, ms=2.6, zorder=1)
        squares = [Rectangle(c[:2], s, s) for c, s in zip(corner[met], side[met], strict=True)]
        ax.add_collection(PatchCollection(squares, facecolor="none", edgecolor=INK, lw=0.7))
        top = float((corner + side[:, None])[met, 1].max())
        ax.set_xlim(tree.lo[0] - 0.01, tree.lo[0] + tree.extent + 0.01)
        ax.set_ylim(tree.lo[1] - 0.01, top + 0.01)


def in_space(path: Any, device: str = "auto", dpi: float = 110) -> None:
    """The cells that the demo's splash occupies at four levels of its octree: each level halves the
    cells, and empty space costs nothing."""
    _, codes, _ = scene_and_codes(device)
    with Figure(path, 9, 6.2, dpi) as figure:
        for ax, level in zip(figure.subplots(2, 2).flat, (2, 3, 4, 5), strict=True):
            cells = occupied_cells(codes, level)
            bare(ax, f"level {level}: {len(cells):,} of {8**level:,} cells")
            width = 0.9 if level < 5 else 0.4
            draw_cubes(ax, cells / 2**level, 1 / 2**level, "#b4d4ee", width=width)
