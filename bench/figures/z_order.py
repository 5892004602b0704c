"""Figures 2.1, 3.4 and 3.7: the order of Morton keys."""

from __future__ import annotations

from typing import Any

import numpy as np
from globule._base.plot import AXES, GRAY, INK, PALE, Figure
from globule.scene.octree import morton

from .style import bare


def z_order(level: int, n_axes: int) -> np.ndarray:
    """Cells (n, n_axes) of a grid with 2^level cells an axis, in the order of their keys."""
    cells = np.stack(np.meshgrid(*[np.arange(2**level)] * n_axes, indexing="ij"), axis=-1)
    cells = cells.reshape(-1, n_axes)
    keys = [morton.encode(*map(int, cell), *[0] * (3 - n_axes)) for cell in cells]
    return cells[np.argsort(keys)]


def in_the_plane(path: Any, device: str = "auto", dpi: float = 110) -> None:
    """The Morton curve through 4, 16 and 64 cells: each refinement puts a small Z in the place of
    every cell, and the curve visits every cell once."""
    with Figure(path, 9, 3.5, dpi) as figure:
        for ax, level in zip(figure.subplots(1, 3), (1, 2, 3), strict=True):
            bare(ax, f"level {level}: {4**level} cells")
            cells = z_order(level, 2)
            n = 2**level
            for i in range(n + 1):
                width = 1.6 if i % (n // 2) == 0 else 0.7
                ax.plot([i, i], [0, n], color=PALE, lw=width, zorder=0)
                ax.plot([0, n], [i, i], color=PALE, lw=width, zorder=0)
            _curve(ax, cells + 0.5)
            for i, (x, y) in enumerate(cells):
                label = f"{i:0{2 * level}b}" if level < 3 else str(i)
                shift = 0.3 if level < 3 else 0.27
                ax.text(
                    x + 0.5,
                    y + 0.5 - shift,
                    label,
                    ha="center",
                    va="center",
                    color=INK,
                    fontsize=(13, 9.5, 6.5)[level - 1],
                    family="DejaVu Sans Mono" if level < 3 else None,
                    zorder=4,
                    bbox={"facecolor": "white", "edgecolor": "none", "pad": 0.6},
                )
            _axes_arrows(ax, n)


def in_space(path: Any, device: str = "auto", dpi: float = 110) -> None:
    """The Morton curve through 8 and 64 cells of space: octant after octant, x first, then y, then
    z."""
    with Figure(path, 9, 4.6, dpi) as figure:
        for i, level in enumerate((1, 2)):
            ax = figure.add_subplot(1, 2, i + 1, projection="3d")
            ax.set_title(f"level {level}: {8**level} cells")
            ax.view_init(20, -66)
            n = 2**level
            for j in range(n + 1):
                for k in range(n + 1):
                    width = 1.1 if (j % n, k % n) == (0, 0) else 0.5
                    for axis in range(3):
                        ends = np.insert([[j, k], [j, k]], axis, [0, n], axis=1)
                        ax.plot(*ends.T, color="#c4cad2", lw=width, zorder=0)
            cells = z_order(level, 3) + 0.5
            _curve(ax, cells, 3.2 if level == 1 else 2.2)
            if level == 1:
                for j, cell in enumerate(cells):
                    ax.text(*(cell + [0.06, 0, 0.1]), f"{j:03b}", fontsize=11, family="DejaVu Sans Mono")
            ax.set_box_aspect((1, 1, 1), zoom=1.12)
            for name, color in zip("xyz", AXES, strict=True):
                getattr(ax, f"set_{name}label")(name, color=color, labelpad=-10)
                getattr(ax, f"set_{name}ticks")([])
                getattr(ax, f"{name}axis").pane.set_visible(False)
                getattr(ax, f"{name}axis").line.set_color((0, 0, 0, 0))


def interleaving(path: Any, device: str = "auto", dpi: float = 110) -> None:
    """The key of cell (10, 3, 15): the bits of its coordinates, interleaved as triplets z y x; the
    first triplet names the octant of level 1, and so on down."""
    cell, n_bits = (10, 3, 15), 4
    key = morton.encode(*cell)
    with Figure(path, 8, 4.2, dpi) as figure:
        ax = figure.subplots()
        bare(ax)
        for row, (name, value, color) in enumerate(zip("xyz", cell, AXES, strict=True)):
            y = 4.4 - 1.1 * row
            ax.text(2.6, y, f"{name} = {value}", ha="right", va="center", color=color, fontsize=14)
            for bit in range(n_bits):
                _bit(ax, 3.3 + bit, y, value >> (n_bits - 1 - bit) & 1, color)
        for place in range(3 * n_bits):
            level, axis = place // 3, 2 - place % 3
            x, color = place * 0.95 + 0.25 * level, AXES[axis]
            _bit(ax, x, 0, key >> (3 * n_bits - 1 - place) & 1, color)
            start = (3.3 + level, 4.4 - 1.1 * axis - 0.42)
            ax.annotate(
                "",
                (x, 0.46),
                start,
                zorder=0,
                arrowprops={"arrowstyle": "->", "color": color, "alpha": 0.45, "lw": 1.1},
            )
        for level in range(n_bits):
            x = 3 * level * 0.95 + 0.25 * level
            ax.plot([x - 0.4, x + 2.3], [-0.62, -0.62], color=GRAY, lw=1)
            ax.text(x + 0.95, -0.98, f"level {level + 1}", ha="center", va="center", color=GRAY)
        ax.text(12.5, 0, f"= {key}\n= 0x{key:X}", va="center", fontsize=14)
        ax.set_xlim(-0.6, 14.4)
        ax.set_ylim(-1.3, 5.1)


def _curve(ax: Any, points: np.ndarray, width: float = 2.4) -> None:
    """A line from the first point to the last, dark to light."""
    from matplotlib import colormaps

    shade = colormaps["viridis"](np.linspace(0, 0.92, len(points)))
    for i in range(len(points) - 1):
        ax.plot(*points[i : i + 2].T, color=shade[i], lw=width, solid_capstyle="round")
    solid = {"depthshade": False} if points.shape[1] == 3 else {}
    ax.scatter(*points.T, color=shade, s=9 * width, zorder=3, **solid)


def _bit(ax: Any, x: float, y: float, value: int, color: str) -> None:
    from matplotlib.patches import Rectangle

    face = color if value else "white"
    ax.add_patch(Rectangle((x - 0.42, y - 0.42), 0.84, 0.84, facecolor=face, edgecolor=color, lw=1.4))
    ax.text(
        x,
        y - 0.02,
        str(value),
        ha="center",
        va="center",
        fontsize=13,
        color="white" if value else color,
        family="DejaVu Sans Mono",
    )


def _axes_arrows(ax: Any, n: int) -> None:
    for end, name, color in (((1, 0), "x", AXES[0]), ((0, 1), "y", AXES[1])):
        start = np.full(2, -0.05 * n)
        tip = start + 0.3 * n * np.array(end)
        ax.annotate("", tip, start, arrowprops={"arrowstyle": "->", "color": color})
        ax.text(*(tip + 0.04 * n * np.array(end)), name, color=color, ha="center", va="center")
