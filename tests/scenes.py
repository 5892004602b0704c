"""Small named scenes with rays that are over-sampled where surfaces end; all seeds are fixed."""

import dataclasses
import functools
from pathlib import Path
from typing import Any

import globule as gb
import numpy as np
import oracle
import pytest

SPLASH = Path(__file__).resolve().parents[2] / "shared/data/particles/splash_117649.npz"
KERNELS = ("murakami", "nishimura", "wyvill", "blinn", "cubic_spline", "wendland_c2", "solid")


@dataclasses.dataclass
class Case:
    """Particles and a surface, with the rays to try and what the oracle says about them."""

    positions: np.ndarray
    support: Any = 1.0
    weight: Any = 1.0
    kernel: str = "murakami"
    threshold: float = 0.6
    origins: np.ndarray | None = None
    directions: np.ndarray | None = None
    depth: np.ndarray | None = None
    matrices: np.ndarray | None = None  # instead of the support, which is then their shortest axis

    def particles(self) -> gb.Particles:
        shape = "support" if self.matrices is None else "anisotropy"
        return gb.Particles(self.positions, weight=self.weight, **{shape: self.shape()})

    def shape(self):
        return self.support if self.matrices is None else self.matrices

    def scene(self, **options) -> gb.Scene:
        options = {"kernel": self.kernel, "threshold": self.threshold, **options}
        return gb.Scene(self.particles(), **options)

    def first_hit(self, origins, directions) -> np.ndarray:
        return oracle.first_hit(
            self.positions, self.shape(), self.weight, self.kernel, self.threshold, origins, directions
        )

    def field(self, points):
        return oracle.field(self.positions, self.shape(), self.weight, self.kernel, points)

    def smallest(self, points: np.ndarray) -> np.ndarray:
        support = np.broadcast_to(np.asarray(self.support, np.float64), len(self.positions))
        out = np.full(len(points), support.max() if len(support) else 1.0)
        if np.ptp(support) == 0:
            return out
        for i, p in enumerate(points):
            reached = ((self.positions - p) ** 2).sum(1) <= support**2
            out[i] = support[reached].min(initial=out[i])
        return out


def unit(v: np.ndarray) -> np.ndarray:
    v = np.asarray(v, np.float64)
    return (v / np.linalg.norm(v, axis=-1, keepdims=True)).astype(np.float32)


def with_camera(case: Case, camera: gb.Camera, pixels: int, pairs: int, halvings: int) -> Case:
    """Rays of a coarse picture, and then, from pairs of neighbors between which the oracle's
    depth jumps, rays ever closer to the jump: by halving, down to 2^-halvings of a pixel."""
    eye, forward, right, up = camera.frame((pixels, pixels))

    def rays(s):
        across = s[:, :1] * right + s[:, 1:] * up
        if camera.height is not None:
            return (eye + across).astype(np.float32), unit(np.broadcast_to(forward, across.shape))
        return np.broadcast_to(eye, across.shape).astype(np.float32), unit(forward + across)

    rng, x = np.random.default_rng(1), (np.arange(pixels) + 0.5) * 2 / pixels - 1
    grid = np.stack(np.meshgrid(x, x), -1).reshape(-1, 2)
    grid = grid + rng.uniform(-0.4, 0.4, grid.shape) * 2 / pixels
    origins, directions = ([a] for a in rays(grid))
    depth = [case.first_hit(origins[0], directions[0])]

    far = 1e9  # stands for a miss
    t, number = np.minimum(depth[0], far), np.arange(pixels * pixels).reshape(pixels, pixels)
    ends = np.concatenate(
        [
            np.stack([number[:, :-1].ravel(), number[:, 1:].ravel()], 1),
            np.stack([number[:-1].ravel(), number[1:].ravel()], 1),
        ]
    )
    ends = ends[np.abs(t[ends[:, 0]] - t[ends[:, 1]]) > 0.5 * np.median(np.asarray(case.support))]
    ends = rng.permutation(ends)[:pairs]
    a, b, ta, tb = grid[ends[:, 0]], grid[ends[:, 1]], t[ends[:, 0]], t[ends[:, 1]]
    for _ in range(halvings if len(ends) else 0):
        middle = (a + b) / 2
        o, d = rays(middle)
        found = case.first_hit(o, d)
        origins.append(o)
        directions.append(d)
        depth.append(found)
        tm = np.minimum(found, far)
        to_a = np.abs(tm - ta) < np.abs(tm - tb)
        a, ta = np.where(to_a[:, None], middle, a), np.where(to_a, tm, ta)
        b, tb = np.where(to_a[:, None], b, middle), np.where(to_a, tb, tm)
    return dataclasses.replace(
        case, origins=np.concatenate(origins), directions=np.concatenate(directions), depth=np.concatenate(depth)
    )


def with_rays(case: Case, origins, directions) -> Case:
    o, d = np.ascontiguousarray(origins, np.float32), unit(directions)
    return dataclasses.replace(case, origins=o, directions=d, depth=case.first_hit(o, d))


def lattice(nx: int, ny: int, nz: int, jitter: float = 0.0, seed: int = 0) -> np.ndarray:
    p = np.stack(np.meshgrid(*(np.arange(n) for n in (nx, ny, nz)), indexing="ij"), -1)
    p = p.reshape(-1, 3) - np.array([nx - 1, ny - 1, nz - 1]) / 2
    return (p + np.random.default_rng(seed).uniform(-jitter, jitter, p.shape)).astype(np.float32)


def cloud(n: int, seed: int = 0, size: float = 1.0) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-size, size, (n, 3)).astype(np.float32)


def one(**options) -> Case:
    """A ball seen at R (1 ± 10^-k) from its center, k = 2 … 6."""
    case = Case(np.array([[0.1, -0.2, 0.3]], np.float32), support=0.8, **options)
    if options:
        return with_camera(case, gb.Camera((1, 2, 3), case.positions[0]), 16, 40, 16)
    rng, radius = np.random.default_rng(2), 0.8 * np.sqrt(1 - np.sqrt(0.6))
    k = rng.integers(2, 7, 2000)
    h = radius * (1 + rng.choice([-1, 1], len(k)) * 10.0**-k)
    d = unit(rng.normal(size=(len(k), 3))).astype(np.float64)
    side = np.cross(d, rng.normal(size=d.shape))
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    eye = case.positions[0] + side * h[:, None] - d * rng.uniform(0.5, 20, (len(k), 1))
    return with_rays(case, eye, d)


def mixed() -> Case:
    rng = np.random.default_rng(3)
    case = Case(cloud(600, 3), support=0.7 * 10 ** rng.uniform(-2, 0, 600))
    return with_camera(case, gb.Camera((1.2, 0.9, 3.9), (0, 0, 0)), 40, 150, 14)


def carved() -> Case:
    """Negative weights take pieces out of a block."""
    block, holes = lattice(8, 8, 8, 0.1), cloud(40, 4, 4.0)
    weight = np.concatenate([np.ones(len(block)), -np.linspace(0.3, 4, len(holes))])
    support = np.concatenate([np.full(len(block), 1.9), np.linspace(0.5, 3, len(holes))])
    case = Case(np.concatenate([block, holes]), support, weight.astype(np.float32))
    return with_camera(case, gb.Camera((7, 9, 12), (0, 0, 0)), 36, 120, 14)


def sheet() -> Case:
    """One layer seen almost edge on, from 0.3 to 3 degrees."""
    case, rng = Case(lattice(40, 40, 1, 0.15, 5), support=1.4), np.random.default_rng(5)
    n = 2400
    angle, turn = np.radians(rng.uniform(0.3, 3, n)), rng.uniform(0, 2 * np.pi, n)
    d = np.stack([np.cos(turn) * np.cos(angle), np.sin(turn) * np.cos(angle), -np.sin(angle)], 1)
    target = np.concatenate([rng.uniform(-18, 18, (n, 2)), rng.uniform(-0.6, 0.6, (n, 1))], 1)
    return with_rays(case, target - 40 * d, d)


def sheet_edge() -> Case:
    case = Case(lattice(40, 40, 1, 0.15, 5), support=1.4)
    return with_camera(case, gb.Camera((30, 3, 0.4), (0, 0, 0), up=(0, 0, 1), fov=50), 40, 150, 14)


def hundred() -> Case:
    case = Case(cloud(100, 6), support=0.35)
    return with_camera(case, gb.Camera((0.2, 0.1, 1.6), (0, 0, 0), fov=80), 40, 150, 14)


def orthographic() -> Case:
    case = Case(cloud(300, 7), support=0.3, threshold=0.8)
    return with_camera(case, gb.Camera((3, 2, 4), (0, 0, 0), height=2.6), 40, 150, 12)


def inside() -> Case:
    """Rays that begin within the medium, some of them in a hole."""
    positions = lattice(9, 9, 9, 0.2, 8)
    positions = positions[np.linalg.norm(positions - [1, 0, 0], axis=1) > 1.6]
    case, rng = Case(positions, support=1.8), np.random.default_rng(8)
    return with_rays(case, rng.uniform(-4.5, 4.5, (2000, 3)), rng.normal(size=(2000, 3)))


def splash() -> Case:
    if not SPLASH.exists():
        pytest.skip(f"no {SPLASH}")
    positions = np.load(SPLASH)["positions"].astype(np.float32)
    lo, hi = positions.min(0), positions.max(0)
    middle, size = (lo + hi) / 2, float((hi - lo).max())
    case = Case(positions, support=0.04)
    return with_camera(case, gb.Camera(middle + size * np.array([0.5, 0.45, 0.9]), middle), 36, 170, 10)


def of_kernel(kernel: str, weights: bool) -> Case:
    """Every kernel, with one support and weight for all or with one each."""
    rng = np.random.default_rng(9)
    case = Case(cloud(150, 9), support=0.5, kernel=kernel, threshold=0.55)
    if kernel in ("blinn", "cubic_spline", "wendland_c2", "solid"):
        case.support = 0.7
    if weights:
        case.weight = rng.uniform(-0.5, 1.5, 150).astype(np.float32)
        case.support = (case.support * rng.uniform(0.3, 1.5, 150)).astype(np.float32)
    return with_camera(case, gb.Camera((1.5, 1, 2.5), (0, 0, 0)), 24, 80, 12)


def stretched_matrices(axes: np.ndarray, seed: int) -> np.ndarray:
    """Matrices (N, 3, 3) of ellipsoids with these semi-axes (N, 3), turned at random."""
    turns = np.linalg.qr(np.random.default_rng(seed).normal(size=(len(axes), 3, 3)))[0]
    return np.einsum("nij,nj,nkj->nik", turns, 1 / axes, turns).astype(np.float32)


def stretched(kernel: str, weights: bool) -> Case:
    """Ellipsoids instead of balls."""
    case = of_kernel(kernel, weights)
    axes = 0.5 * np.random.default_rng(10).uniform(0.3, 1.6, (150, 3))
    return with_camera(
        dataclasses.replace(case, support=float(axes.min()), matrices=stretched_matrices(axes, 11)),
        gb.Camera((1.5, 1, 2.5), (0, 0, 0)), 24, 80, 12,
    )  # fmt: skip


CASES = {f.__name__: f for f in (one, mixed, carved, sheet, sheet_edge, hundred, orthographic, inside, splash)}
CASES |= {f"one {k}": functools.partial(one, kernel=k) for k in KERNELS[1:]}
CASES |= {f"cloud {k}": functools.partial(of_kernel, k, False) for k in KERNELS}
CASES |= {f"weights {k}": functools.partial(of_kernel, k, True) for k in KERNELS}
CASES |= {
    f"stretched {k} {w}": functools.partial(stretched, k, w)
    for k, w in (("murakami", False), ("murakami", True), ("blinn", False), ("cubic_spline", True), ("solid", False))
}


@functools.cache
def case(name: str) -> Case:
    return CASES[name]()
