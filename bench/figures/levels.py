"""Figures 3.5, 3.6 and 3.8: levels and neighbors by keys, quantized positions, the array L."""

from __future__ import annotations

from typing import Any

import numpy as np
from globule._base.plot import AXES, BLUE, GRAY, GREEN, INK, ORANGE, PALE, RED, Figure
from globule.pieces.scene import Scene
from globule.scene.octree import morton

from .style import bare

LEVELS = 10  # of a 32-bit key
INSIDE = 1 << 30


def triplets(key: int, level: int) -> str:
    """A node key's triplets, in binary."""
    return " ".join(f"{key >> 3 * (LEVELS - k) & 7:03b}" for k in range(1, level + 1))


def octree_coordinate(u: float, extent: float, device: str = "auto") -> int:
    """Where u in [0, extent] falls among 1024 cells, as the octree decides it."""
    box = ((0, 0, 0), (extent,) * 3)
    scene = Scene(np.array([[u, 0, 0]], np.float32), support=1.0, bounds=box, device=device)
    keys, _ = scene.octree.sorted_keys(1)
    return morton.decode(int(keys[0]) & (INSIDE - 1))[0]


def keys_and_neighbors(path: Any, device: str = "auto", dpi: float = 110) -> None:
    """Keys say where cells are: a cell's key begins with its parent's, and a neighbor's differs in
    bits of the crossed axis only, up to the level at which the step stays inside."""
    from matplotlib.patches import Rectangle

    with Figure(path, 10, 4.9, dpi) as figure:
        left, right = figure.subplots(1, 2)
        bare(left, "one cell of levels 1, 2 and 3 (the layer z = 0)")
        _grid(left, 8)
        shades = ("#e3eef8", "#b5d3ec", "#6aa7d8")
        key = INSIDE
        x = y = 0.0
        for level, octant in enumerate((0b001, 0b010, 0b001), 1):
            key = morton.child(key, level - 1, octant)
            cell = np.array(morton.decode(key - INSIDE)) >> (LEVELS - 3)
            side = 8 / 2**level
            x, y = float(cell[0]), float(cell[1])
            left.add_patch(Rectangle((x, y), side, side, facecolor=shades[level - 1], edgecolor=BLUE, lw=1.8))
        places = (((6, 0.9), None), ((6.9, 5.2), (5, 3.5)), ((1.9, 1.0), (5.3, 2.4)))
        for level, (place, tip) in enumerate(places, 1):
            node = key >> 3 * (LEVELS - level) << 3 * (LEVELS - level)
            arrow = {"arrowstyle": "->", "color": INK} if tip else None
            label = f"level {level}\n{triplets(node, level)}"
            left.annotate(
                label,
                tip or place,
                place,
                ha="center",
                va="center",
                fontsize=10.5,
                family="DejaVu Sans Mono",
                arrowprops=arrow,
            )
        bare(right, "a cell of level 3 and its neighbors in that layer")
        middle = INSIDE + (morton.encode(3, 5, 0) << 3 * (LEVELS - 3))
        for dx in (-1, 0, 1):
            for dy in (-1, 0, 1):
                beside = morton.neighbor(middle, 3, dx, dy, 0)
                assert beside is not None  # not at the octree's edge
                face = "#6aa7d8" if dx == dy == 0 else "#fdf0dc" if dx and dy else "#fbdcae"
                right.add_patch(Rectangle((dx, dy), 1, 1, facecolor=face, edgecolor=GRAY, lw=1.2))
                _changed_bits(right, dx + 0.5, dy + 0.56, middle, beside)
                cell = np.array(morton.decode(beside - INSIDE)) >> (LEVELS - 3)
                right.text(
                    dx + 0.5,
                    dy + 0.26,
                    f"x = {cell[0]}, y = {cell[1]}",
                    ha="center",
                    color=INK if dx == dy == 0 else GRAY,
                    fontsize=9,
                )
        right.text(0.5, -1.28, "red: bits of x, green: bits of y that changed", ha="center", color=GRAY)
        right.set_xlim(-1.05, 2.05)
        right.set_ylim(-1.4, 2.05)


def quantised_positions(path: Any, device: str = "auto", dpi: float = 110) -> None:
    """A position becomes octree coordinates: each axis is scaled to 1024 cells and the fraction is
    cut off; rounding would move half of a cell's points into the next cell."""
    position, extents = (200, 520, 50), (400, 600, 300)
    with Figure(path, 9, 4.3, dpi) as figure:
        left, right = figure.subplots(1, 2, width_ratios=[1.5, 1])
        bare(left, "position (200, 520, 50) in a space of 400 × 600 × 300")
        left.set_aspect("auto")
        for row, (u, extent, color) in enumerate(zip(position, extents, AXES, strict=True)):
            y, cell = 2 - row, octree_coordinate(u, extent, device)
            left.plot([0, 1024], [y, y], color=color, lw=2)
            for i in range(9):
                left.plot([128 * i] * 2, [y - 0.06, y + 0.06], color=color, lw=1)
            exact = u / extent * 1024
            left.plot(exact, y, "o", color=color, ms=8)
            left.text(
                exact,
                y + 0.15,
                f"{u} / {extent} · 1024 = {exact:.2f} → cell {cell}",
                ha="center" if 200 < exact < 800 else "left" if exact < 200 else "right",
                color=color,
            )
            left.text(-25, y, "xyz"[row], ha="right", va="center", color=color, fontsize=13)
            left.text(0, y - 0.24, "0", ha="center", color=GRAY, fontsize=9)
            left.text(1024, y - 0.24, "1024", ha="center", color=GRAY, fontsize=9)
        left.set_xlim(-60, 1060)
        left.set_ylim(-0.4, 2.5)
        bare(right, "points near z = 50, colored by their cell")
        right.set_aspect("auto")
        values = np.linspace(169.05, 172.95, 40)
        cells = np.array([octree_coordinate(v / 1024 * 300, 300, device) for v in values])
        for cell in range(169, 173):
            right.axvspan(cell, cell + 1, color=PALE if cell % 2 else "white", zorder=0)
            right.text(cell + 0.5, 1.02, f"cell {cell}", ha="center", color=GRAY)
        for height, chosen in ((0.68, cells), (0.28, np.round(values).astype(int))):
            colors = np.array([BLUE, ORANGE, GREEN, RED, INK])[chosen - 169]
            right.scatter(values, np.full(len(values), height), c=colors, s=18)
        for height, name in (
            (0.75, "cut off: a point is in the cell it lies in"),
            (0.35, "rounded: half of them are not"),
        ):
            right.text(
                171,
                height,
                name,
                ha="center",
                zorder=4,
                bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.85, "pad": 1},
            )
        right.plot([50 / 300 * 1024] * 2, [0.2, 0.95], color=AXES[2], lw=1.2, ls=":")
        right.text(50 / 300 * 1024, 0.13, "z = 50", ha="center", color=AXES[2])
        right.set_xlim(169, 173)
        right.set_ylim(0, 1.15)


def dense_array(path: Any, device: str = "auto", dpi: float = 110) -> None:
    """The array L holds all cells of all levels, level after level: a cell's place follows from its
    key and level by arithmetic, and its key from its place."""
    from matplotlib.patches import Rectangle

    node = INSIDE + (0b001_011 << 3 * (LEVELS - 2))
    place = morton.dense_index(node, 2)
    with Figure(path, 10, 4.2, dpi) as figure:
        ax = figure.subplots()
        bare(ax)
        ax.set_aspect("auto")
        first, x = 0, 0.0
        widths = (0.6, 2.6, 5.2, 9.6)
        shades = ("#dbe9f5", "#c3e3d4", "#fbdcae", "#eccfc7")
        starts = []
        for level, (width, shade) in enumerate(zip(widths, shades, strict=True)):
            n = 8**level
            ax.add_patch(Rectangle((x, 0), width, 1, facecolor=shade, edgecolor=INK, lw=1.2))
            shown = n if level < 2 else 64 if level == 2 else 0
            for i in range(1, shown):
                at = x + width * i / n
                ax.plot([at, at], [0, 1], color=INK, lw=0.8 if level < 2 else 0.3)
            last = first + n - 1
            ax.text(x + width / 2, -0.3, f"{first}" if not level else f"{first} … {last}", ha="center", va="center")
            ax.text(x + width / 2, -0.72, f"level {level}", ha="center", va="center", color=GRAY)
            starts.append((x, width, first, n))
            first, x = first + n, x + width
        root = starts[0][0] + starts[0][1] / 2
        octant = starts[1][0] + starts[1][1] * (0b001 + 0.5) / 8
        x2, width2, _, n2 = starts[2]
        target = x2 + width2 * (0b001_011 + 0.5) / n2
        x3, width3, first3, n3 = starts[3]
        other = 180
        key = morton.dense_key(other)
        target3 = x3 + width3 * (other - first3 + 0.5) / n3
        for at, top, label, color in (
            (root, 3.5, "root", INK),
            (octant, 2.8, "001 → 1 + 1 = 2", INK),
            (target, 2.1, f"001 011 → (8² − 1)/7 + 11 = {place}", BLUE),
            (target3, 2.8, f"{other} − (8³ − 1)/7 = {other - first3} → {triplets(key, 3)}", RED),
        ):
            ax.annotate("", (at, 1.02), (at, top - 0.15), arrowprops={"arrowstyle": "->", "color": color})
            ax.text(
                at,
                top,
                label,
                color=color,
                ha="left" if at > 0.5 else "center",
                va="center",
                bbox={"facecolor": "white", "edgecolor": "none", "pad": 1},
            )
        ax.text(x, 0.5, " …", va="center", fontsize=14)
        ax.set_xlim(-0.4, x + 0.6)
        ax.set_ylim(-1, 3.8)


def _grid(ax: Any, n: int) -> None:
    for i in range(n + 1):
        ax.plot([i, i], [0, n], color=PALE, lw=1, zorder=0)
        ax.plot([0, n], [i, i], color=PALE, lw=1, zorder=0)
    ax.set_xlim(-0.2, n + 0.2)
    ax.set_ylim(-0.2, n + 0.2)


def _changed_bits(ax: Any, x: float, y: float, middle: int, node: int) -> None:
    """The node's three triplets around (x, y), bits that differ from the middle's in color."""
    text, known = triplets(node, 3), triplets(middle, 3)
    for i, (bit, old) in enumerate(zip(text, known, strict=True)):
        color = INK if bit == old else AXES[2 - i % 4]
        ax.text(
            x + (i - 5) * 0.078,
            y,
            bit,
            ha="center",
            color=color,
            family="DejaVu Sans Mono",
            fontsize=10.5,
            weight="bold" if bit != old else "normal",
        )
