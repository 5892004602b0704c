"""Figures 5.5 and 5.7: a ray's samples under several thresholds, and the neighbors it skips."""

from __future__ import annotations

from typing import Any

import numpy as np
from globule._base.plot import BLUE, GRAY, INK, ORANGE, RED, SKY, Figure
from globule.scene.octree import morton

from .rays import CENTERS, THRESHOLD, flat_scene, plane_field
from .style import VIEW, bare, draw_cubes, flattened

LADDER = (0.05, 0.2, 0.35, THRESHOLD)  # τ_0 < τ_1 < … < τ
STEP = 0.2  # below the first threshold, in supports; half of it after each


def march(scene: Any, origin: np.ndarray, direction: np.ndarray, end: float) -> np.ndarray:
    """Distances (M,) at which a marching ray looks: with each threshold that the field has passed
    the step is halved; after the last, bisection between the last two."""

    def f(t: float) -> float:
        return float(scene.field((origin + t * direction).astype(np.float32)[None])[0])

    t, looked = 0.0, []
    while t < end:
        looked.append(t)
        value = f(t)
        if value >= THRESHOLD:
            low, high = looked[-2], t
            for _ in range(5):
                t = (low + high) / 2
                looked.append(t)
                low, high = (low, t) if f(t) >= THRESHOLD else (t, high)
            break
        t += STEP / 2 ** sum(value >= level for level in LADDER)
    return np.array(looked)


def several_thresholds(path: Any, device: str = "auto", dpi: float = 110) -> None:
    """A marching ray's samples under the thresholds 0.05 < 0.2 < 0.35 < τ = 0.5: the step is halved
    at each threshold that the field passes, and the samples are dense near the surface."""
    scene = flat_scene(device)
    origin, direction = np.array([-3.6, -0.75, 0.0]), np.array([0.966, 0.26, 0.0])
    direction /= np.linalg.norm(direction)
    t = march(scene, origin, direction, 5.0)
    with Figure(path, 9, 6.6, dpi) as figure:
        above, below = figure.subplots(2, 1, height_ratios=[1.4, 1])
        bare(above)
        x, y = np.meshgrid(np.linspace(-3.8, -0.2, 500), np.linspace(-1.2, 0.75, 300))
        values = plane_field(scene, x, y)
        shades = ["#eef5fb", "#d9e9f6", "#bed9ef", SKY]
        above.contourf(x, y, values, levels=[*LADDER, 9], colors=shades)
        above.contour(x, y, values, levels=LADDER, colors=[GRAY, GRAY, GRAY, BLUE], linewidths=[0.8, 0.8, 0.8, 2.2])
        inside = CENTERS[CENTERS[:, 0] < -0.3]
        above.plot(*inside.T, ".", color=BLUE)
        tip = origin + (t[-1] + 0.25) * direction
        above.annotate("", tip[:2], origin[:2], arrowprops={"arrowstyle": "->", "color": INK, "shrinkA": 0, "lw": 1})
        points = (origin + t[:, None] * direction).astype(np.float32)
        above.plot(*points[:, :2].T, "o", color=RED, ms=4.5, zorder=5)
        above.set_xlim(-3.8, -0.2)
        above.set_ylim(-1.2, 0.75)
        fine = np.linspace(0, t[-1] + 0.3, 400)
        curve = scene.field((origin + fine[:, None] * direction).astype(np.float32))
        below.plot(fine, curve, color=BLUE, lw=1.8)
        values = scene.field(points)
        below.vlines(t, 0, values, color=RED, lw=0.8, alpha=0.6)
        below.plot(t, values, "o", color=RED, ms=4.5)
        for i, level in enumerate(LADDER):
            last = i == len(LADDER) - 1
            below.axhline(level, color=ORANGE if last else GRAY, lw=1.1, ls="--")
            name = f"τ = {level:g}" if last else f"τ{'₀₁₂'[i]} = {level:g}"
            below.text(0.02, level + 0.01, name, color=ORANGE if last else GRAY)
        below.set(xlim=(0, fine[-1]), ylim=(0, 0.62), xlabel="distance along the ray", ylabel="field")


def skipped_neighbors(path: Any, device: str = "auto", dpi: float = 110) -> None:
    """A ray enters the middle cell through its left face: the search has already visited the
    nine neighbors on that side, and 17 of 26 remain."""
    level, levels = 2, 10
    middle = (1 << 30) + (morton.encode(1, 1, 1) << 3 * (levels - level))
    found = []
    for dx in (-1, 0, 1):
        for dy in (-1, 0, 1):
            for dz in (-1, 0, 1):
                key = morton.neighbor(middle, level, dx, dy, dz)
                assert key is not None  # not at the octree's edge
                found.append(np.array(morton.decode(key - (1 << 30))) >> (levels - level))
    cells = np.array(found, float)
    with Figure(path, 9, 4.8, dpi) as figure:
        ax = figure.subplots()
        bare(ax)
        # Drawn apart, layer by layer, so that the middle can be seen.
        apart = cells * [2.05, 1, 1]
        names = (("9 skipped", RED), ("the cell, and 8 to look at", INK), ("9 to look at", INK))
        for layer, (name, color) in enumerate(names):
            here = cells[:, 0] == layer
            for one in apart[here][np.argsort(apart[here] @ VIEW[2])]:
                middle = (one == [2.05, 1, 1]).all()
                face = RED if layer == 0 else "#f0b73c" if middle else "#c6dcef"
                draw_cubes(ax, one[None], 0.86, face, alpha=1 if middle else 0.5, width=0.9, edge="#3c4650")
            if layer == 0:
                start, face = flattened([[0.86, 1.43, 1.43], [2.05, 1.43, 1.43]])
                outside = flattened([-1.6, 1.43, 1.43])
                ax.plot(*np.stack([outside, start]).T, color=INK, lw=2, ls=(0, (2, 1.5)))
                ax.annotate(
                    "", face, start, arrowprops={"arrowstyle": "-|>", "color": INK, "lw": 2, "shrinkA": 0, "shrinkB": 0}
                )
            place = flattened([2.05 * layer + 0.43, -0.55, 2.9])
            ax.text(*place, name, ha="center", va="top", color=color, fontsize=12)
        ax.autoscale_view()
