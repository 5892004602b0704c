"""The six scenes of the benchmark: particles, spacing, camera, and the truth where there is one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import globule as gb
import numpy as np

from bench.tables.scenes import pool as waves

SPLASH = Path(__file__).parents[3] / "shared" / "data" / "particles" / "splash_117649.npz"

# A truth: rays (M, 3), (M, 3) -> distances (M,), inf where missed, and normals (M, 3).
Truth = Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]


@dataclass
class Case:
    """positions  (N, 3) float32, world
    spacing    cube root of a particle's volume; with mixed radii, of the smallest
    radii      (N,) half a spacing of each particle, or None: all are equal
    truth      the body that the particles fill, or None where nobody knows it
    """

    positions: np.ndarray
    spacing: float
    radii: np.ndarray | None = None
    truth: Truth | None = None

    def radius(self) -> np.ndarray:
        """(N,) float64: half the spacing of each particle."""
        one = np.full(len(self.positions), 0.5 * self.spacing)
        return one if self.radii is None else np.asarray(self.radii, np.float64)


def _lattice(*counts: int) -> np.ndarray:
    axes = np.meshgrid(*map(np.arange, counts), indexing="ij")
    return np.stack(axes, -1).reshape(-1, 3) - (np.array(counts) - 1) / 2


def ball(n: int) -> Case:
    """A lattice cut to a ball of the same volume as its particles."""
    edge = int(np.ceil((n * 6 / np.pi) ** (1 / 3))) + 3
    grid = _lattice(edge, edge, edge) + (0.13, 0.29, 0.41)  # no particle in the middle
    x = grid[np.argsort((grid**2).sum(1), kind="stable")[:n]]
    radius = (3 * n / (4 * np.pi)) ** (1 / 3)

    def truth(origins: np.ndarray, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        along = (origins * directions).sum(1)
        under = along**2 - (origins**2).sum(1) + radius**2
        t = np.where(under >= 0, -along - np.sqrt(np.maximum(under, 0)), np.inf)
        hit = origins + np.where(np.isfinite(t), t, 0)[:, None] * directions
        return t, hit / np.linalg.norm(hit, axis=1, keepdims=True)

    return Case(x.astype(np.float32), 1.0, truth=truth)


def _slab(half: np.ndarray, turn: np.ndarray) -> Truth:
    """A box about the origin with half edges `half` (3,), turned by a matrix."""

    def truth(origins: np.ndarray, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        o, d = origins @ turn, directions @ turn
        with np.errstate(divide="ignore"):
            side = np.where(d < 0, -1.0, 1.0)
            near, far = (-half * side - o) / d, (half * side - o) / d
        axis = near.argmax(1)
        t = near.max(1)
        t = np.where((t <= far.min(1)) & (t > 0), t, np.inf)
        normal = -np.sign(np.take_along_axis(d, axis[:, None], 1)) * np.eye(3)[axis]
        return t, normal @ turn.T

    return truth


def pool(n: int) -> Case:
    """A pool at rest: a lattice that fills a flat box."""
    edge = max(round((4 * n) ** (1 / 3)), 4)
    counts = (edge, edge // 4, edge)
    half = np.array(counts) / 2.0
    return Case(_lattice(*counts).astype(np.float32), 1.0, truth=_slab(half, np.eye(3)))


def sheet(n: int) -> Case:
    """A sheet of two layers, turned against all axes."""
    edge = max(round((n / 2) ** 0.5), 2)
    a, b = np.cos(0.5), np.sin(0.5)
    c, d = np.cos(0.35), np.sin(0.35)
    turn = np.array([[a, 0, b], [0, 1, 0], [-b, 0, a]]) @ [[1, 0, 0], [0, c, -d], [0, d, c]]
    x = _lattice(edge, 2, edge) @ turn.T
    return Case(x.astype(np.float32), 1.0, truth=_slab(np.array([edge, 2, edge]) / 2.0, turn))


def splash(n: int) -> Case:
    """A developed dam-break splash (SPlisHSPlasH), or the wavy pool where the file is not there."""
    if SPLASH.exists():
        x = np.asarray(gb.read(SPLASH).positions)
        if n < len(x):  # one end of it, as dense
            x = x[np.argsort(x[:, 0], kind="stable")[:n]]
        return Case(x, 0.02)
    return ten_million(n)


def mixed(n: int) -> Case:
    """Balls with radii from 0.5 to 2 on a jittered lattice of cells that hold the largest."""
    rng = np.random.default_rng(2)
    edge = max(round(n ** (1 / 3)), 2)
    grid = _lattice(edge, edge, edge)
    radii = 0.5 * 4.0 ** rng.random(len(grid))
    x = 2.2 * grid + rng.uniform(-0.5, 0.5, grid.shape)
    return Case(x.astype(np.float32), 1.0, radii.astype(np.float32))


def ten_million(n: int) -> Case:
    """A wide pool with waves and droplets."""
    positions, spacing = waves(n)
    return Case(positions, spacing)


# Name: maker, particles. `--particles` caps the number, except that of a file.
SCENES = {
    "ball": (ball, 20_000),
    "pool at rest": (pool, 60_000),
    "splash": (splash, 117_649),
    "sheet": (sheet, 20_000),
    "mixed radii": (mixed, 20_000),
    "ten million": (ten_million, 10_000_000),
}


def moved(case: Case, step: int) -> np.ndarray:
    """Positions (N, 3) float32 of frame `step`: each particle sways by a tenth of a spacing."""
    x = case.positions
    if step == 0:
        return x
    sway = np.sin(0.2 * x[:, (1, 2, 0)] / case.spacing + step) * (0.1 * case.spacing)
    return x + sway.astype(np.float32)


def cameras(case: Case, size: tuple[int, int], n: int) -> list[gb.Camera]:
    """`n` cameras around the scene; the first is the one that is judged."""
    angles = np.radians(31.0 + 20.0 * np.arange(n))
    x = case.positions[:: max(len(case.positions) // 100_000, 1)]
    return [gb.Camera.fit(x, direction=(np.sin(a), 0.45, np.cos(a)), size=size) for a in angles]
