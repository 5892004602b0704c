"""Figures 5.3 and 5.4: spheres around the surface, and what one ray meets of them."""

from __future__ import annotations

from typing import Any

import numpy as np
from globule._base.plot import BLUE, GRAY, GREEN, INK, ORANGE, PURPLE, RED, SKY, Figure
from globule.data.particles import Particles
from globule.pieces.scene import Scene

from .kernels import radius
from .style import bare

THRESHOLD = 0.5
CENTERS = np.array(
    [
        [-2.3, 0.25],
        [-1.6, -0.3],
        [-0.95, 0.2],
        [-0.25, -0.25],
        [0.4, 0.3],
        [1.1, 0.0],
        [1.75, 0.5],
        [0.75, 1.05],
        [3.1, -0.35],
    ]
)


# Of figure 5.4: the ray along y = 0 passes the first two without a hit, and the last not at all.
ON_A_RAY = np.array([[-1.7, 0.75], [-0.75, -0.6], [0.45, 0.35], [1.6, -0.1], [2.95, 1.1]])


def flat_scene(device: str = "auto", centers: np.ndarray = CENTERS) -> Scene:
    """Metaballs of support 1 with their centers in the plane z = 0."""
    positions = np.array([[x, y, 0] for x, y in centers], np.float32)
    return Scene(Particles(positions, support=1.0), threshold=THRESHOLD, device=device)


def plane_field(scene: Scene, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """The field at (x, y, 0), of the shape of x and y."""
    points = np.stack([x, y, np.zeros_like(x)], axis=-1).reshape(-1, 3)
    return scene.field(np.ascontiguousarray(points, np.float32)).reshape(x.shape)


def sphere_events(origin: np.ndarray, direction: np.ndarray, centers: np.ndarray) -> list[tuple[float, int, bool]]:
    """Distance, sphere, and whether it is entered, of all supports that the ray meets, in order."""
    events = []
    for i, center in enumerate(centers):
        v = np.append(center, 0) - origin
        middle = float(v @ direction)
        square = 1 - float(v @ v) + middle**2
        if square > 0:
            events += [(middle - square**0.5, i, True), (middle + square**0.5, i, False)]
    return sorted(events)


def exterior_spheres(path: Any, device: str = "auto", dpi: float = 110) -> None:
    """The spheres of the supports stand around the surface like a skeleton: a ray that misses all
    spheres cannot hit the surface; the surface of a lone metaball is at the constant distance d."""
    scene = flat_scene(device)
    with Figure(path, 9, 4.5, dpi) as figure:
        ax = figure.subplots()
        bare(ax)
        _surface(ax, scene)
        for x, y in CENTERS:
            _circle(ax, x, y, 1, GRAY, "--", 1.1)
        alone, d = CENTERS[-1], radius("murakami", THRESHOLD, device)
        _circle(ax, alone[0], alone[1], d, ORANGE, "-", 2.4)
        tip = alone + d * np.array([0.8, 0.6])
        ax.annotate(
            "",
            tip,
            alone,
            zorder=6,
            arrowprops={"arrowstyle": "->", "color": ORANGE, "shrinkA": 0, "shrinkB": 0, "lw": 1.6},
        )
        ax.text(*(alone + [0.12, 0.3]), "d", color=ORANGE, fontsize=13)
        for y, slope, shift, color, text in (
            (1.84, 0.0, 0.08, GREEN, "meets one sphere: searched there, nothing found"),
            (-1.05, 0.11, -0.25, RED, "meets spheres: hit"),
            (-1.62, 0.0, 0.08, INK, "meets no sphere: not searched at all"),
        ):
            origin = np.array([-3.8, y, 0], np.float32)
            direction = np.array([1, slope, 0], np.float32)
            direction /= np.linalg.norm(direction)
            depth = float(scene.intersect(origin[None], direction[None])[0][0])
            end = (origin + min(depth, 8.3) * direction)[:2]
            ax.annotate(
                "",
                end,
                origin[:2],
                arrowprops={"arrowstyle": "->", "color": color, "lw": 1.8, "shrinkA": 0, "shrinkB": 0},
            )
            ax.text(-3.8, y + shift, text, color=color)
        ax.text(3.95, -1.2, "supports", color=GRAY)
        ax.set_xlim(-3.9, 4.6)
        ax.set_ylim(-1.75, 2.2)


def ordered_events(path: Any, device: str = "auto", dpi: float = 110) -> None:
    """One ray enters the spheres A, B, C and D in this order; between two events the same particles
    act, and the search for the first root starts at the nearest entry."""
    scene = flat_scene(device, ON_A_RAY)
    origin, direction = np.array([-3.2, 0, 0], np.float32), np.array([1, 0, 0], np.float32)
    events = sphere_events(origin.astype(float), direction.astype(float), ON_A_RAY)
    names = {i: "ABCD"[k] for k, i in enumerate(i for _, i, entered in events if entered)}
    colors = dict(zip(names, (BLUE, RED, GREEN, PURPLE), strict=True))
    hit = float(scene.intersect(origin[None], direction[None])[0][0])
    with Figure(path, 9, 7, dpi) as figure:
        above, below = figure.subplots(2, 1, height_ratios=[2.4, 1], sharex=True)
        above.axis("off")
        above.set_aspect("equal", adjustable="datalim")
        _surface(above, scene)
        for i, (x, y) in enumerate(ON_A_RAY):
            _circle(above, x, y, 1, colors.get(i, GRAY), "-" if i in names else "--", 1.6)
            above.plot(x, y, "o", color=colors.get(i, GRAY), ms=4)
        above.annotate("", (3.9, 0), origin[:2], arrowprops={"arrowstyle": "->", "color": INK, "lw": 1.6, "shrinkA": 0})
        for t, i, entered in events:
            at = origin[0] + t
            face = colors[i] if entered else "white"
            above.plot(at, 0, "o", color=colors[i], ms=8 if entered else 6, mfc=face, zorder=5)
            below.axvline(at, color=colors[i], lw=1.1, ls="-" if entered else ":")
            if entered:
                for ax, x, y in ((above, at - 0.08, 0.1), (below, at - 0.04, 0.88)):
                    ax.text(x, y, names[i], color=colors[i], fontsize=13, ha="right", weight="bold", zorder=6)
        x = np.linspace(-3.2, 4.05, 600)
        f = plane_field(scene, x, 0 * x)
        below.plot(x, f, color=INK, lw=2)
        below.fill_between(x, THRESHOLD, f, f > THRESHOLD, color=BLUE, alpha=0.2)
        below.axhline(THRESHOLD, color=ORANGE, lw=1.2, ls="--")
        below.text(-3.15, THRESHOLD + 0.03, "τ", color=ORANGE, fontsize=12)
        for ax, y in ((above, 0), (below, THRESHOLD)):
            ax.plot(origin[0] + hit, y, "*", color=ORANGE, ms=16, mec="white", zorder=7)
        below.set(xlim=(-3.2, 4.05), ylim=(0, 1), ylabel="field on the ray", xticks=[])
        below.set_xlabel("full: a sphere is entered; dotted: it is left; star: the first root")


def _surface(ax: Any, scene: Scene) -> None:
    x, y = np.meshgrid(np.linspace(-3.6, 4.4, 500), np.linspace(-1.6, 2.2, 250))
    values = plane_field(scene, x, y)
    ax.contourf(x, y, values, levels=[THRESHOLD, 9], colors=[SKY])
    ax.contour(x, y, values, levels=[THRESHOLD], colors=[BLUE], linewidths=2)


def _circle(ax: Any, x: float, y: float, r: float, color: str, style: str, width: float) -> None:
    from matplotlib.patches import Circle

    ax.add_patch(Circle((x, y), r, fill=False, edgecolor=color, ls=style, lw=width, zorder=4))
