"""Figures 2.4 and 3.9: the basis functions, each as the field of one particle."""

from __future__ import annotations

from typing import Any

import numpy as np
from globule._base.plot import BLUE, GRAY, GREEN, INK, ORANGE, PURPLE, RED, SKY, Figure
from globule.data.particles import Particles
from globule.pieces.scene import Scene
from globule.scene.scene import KERNELS

from .style import bare

COLORS = dict(zip(KERNELS, (BLUE, ORANGE, GREEN, RED, PURPLE, INK, SKY), strict=True))


def profile(kernel: str, r: np.ndarray, device: str = "auto") -> tuple[np.ndarray, np.ndarray]:
    """Value and slope of a kernel of support 1 at distances r (M,), by way of a scene."""
    scene = Scene(Particles(np.zeros((1, 3)), support=1.0), kernel, device=device)
    points = np.zeros((len(r), 3), np.float32)
    points[:, 0] = r
    return scene.field(points), scene.gradient(points)[:, 0]


def radius(kernel: str, threshold: float, device: str = "auto") -> float:
    """Where the surface of one particle of support 1 lies, found by a ray."""
    scene = Scene(Particles(np.zeros((1, 3)), support=1.0), kernel, threshold, device=device)
    depth, _, _ = scene.intersect([[2.0, 0, 0]], [[-1.0, 0, 0]])
    return 2 - float(depth[0])


def one_metaball(path: Any, device: str = "auto", dpi: float = 110) -> None:
    """One metaball: its field falls from 1 at the center to 0 at the support a; the surface is the
    sphere where the field equals the threshold."""
    threshold = 0.6
    d = radius("murakami", threshold, device)
    with Figure(path, 9, 3.9, dpi) as figure:
        left, right = figure.subplots(1, 2, width_ratios=[1, 1.5])
        axis = np.linspace(-1.15, 1.15, 231, dtype=np.float32)
        x, y = np.meshgrid(axis, axis)
        points = np.stack([x, y, np.zeros_like(x)], axis=-1).reshape(-1, 3)
        scene = Scene(Particles(np.zeros((1, 3)), support=1.0), device=device)
        values = scene.field(points).reshape(x.shape)
        bare(left, "the field in a plane")
        left.contourf(x, y, values, levels=np.linspace(0.001, 1, 11), cmap="Blues", vmax=1.35)
        left.contour(x, y, values, levels=[threshold], colors=ORANGE, linewidths=2.5)
        angle = np.linspace(0, 2 * np.pi, 200)
        left.plot(np.cos(angle), np.sin(angle), color=GRAY, lw=1.2, ls="--")
        left.plot(0, 0, "o", color=INK, ms=4)
        left.text(0, -1.1, "support a", ha="center", color=GRAY)
        left.text(0.05, d + 0.05, "surface", color=ORANGE)
        r = np.linspace(0, 1.15, 300)
        right.set_title("the field along a ray from the center (murakami)")
        right.plot(r, profile("murakami", r, device)[0], color=BLUE, lw=2.5)
        right.axhline(threshold, color=ORANGE, lw=1.2, ls="--")
        right.plot([d, d], [0, threshold], color=ORANGE, lw=1.2, ls="--")
        right.plot(d, threshold, "o", color=ORANGE, ms=7)
        right.text(1.16, threshold + 0.02, "threshold τ = 0.6", color=ORANGE, ha="right")
        right.text(d + 0.02, 0.05, f"d = {d:.3f} a", color=ORANGE)
        right.text(0.3, 0.9, "b(r) = (1 − (r/a)²)²", color=BLUE, fontsize=12)
        right.set(xlabel="r / a", ylabel="b(r)", xlim=(0, 1.17), ylim=(0, 1.05))


def all_kernels(path: Any, device: str = "auto", dpi: float = 110) -> None:
    """All seven basis functions and their slopes for the same support: each starts at 1 and reaches
    0 together with its slope, so that no surface has a crease where a support ends."""
    r = np.linspace(0, 1.05, 400)
    with Figure(path, 9, 4, dpi) as figure:
        value, slope = figure.subplots(1, 2)
        for kernel in KERNELS:
            b, db = profile(kernel, r, device)
            value.plot(r, b, color=COLORS[kernel], lw=2)
            slope.plot(r, db, color=COLORS[kernel], lw=2, label=kernel)
        value.axhline(0.6, color=GRAY, lw=1, ls="--")
        value.text(1.05, 0.62, "default threshold (solid: 0.1)", color=GRAY, ha="right")
        value.set(xlabel="r / a", title="b(r)", xlim=(0, 1.05), ylim=(-0.1, 1.03))
        slope.set(xlabel="r / a", title="a · db/dr", xlim=(0, 1.05))
        slope.legend(loc="lower right")
