"""Wrong pixels and wrong normals: what a program drew against float64 rays.

Two questions are asked of a picture. Is it the surface that the program says it draws (`Surface`,
found by brute force in float64)? Is it the body that the particles fill (the scene's truth)?
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from tests import oracle

TILE = 16  # pixels: an edge of the squares that are judged together
WORK = 1e8  # particles looked at for all squares of an image
PARTICLES = 100_000  # that a square costs at least, in particles looked at


@dataclass
class Surface:
    """Where sum_j weight_j b(|x - x_j| / support_j) is the threshold; or, of kernel "union", the
    union of balls with the radii `support`.

    support  (N,) world, or (N, 3, 3) matrices G
    """

    positions: np.ndarray
    support: Any
    weight: Any
    kernel: str
    threshold: float

    def __post_init__(self) -> None:
        reach = np.asarray(self.support, np.float64)
        if reach.ndim == 3:  # a kernel ends where |G x| = 1
            reach = 1 / np.linalg.svd(reach, compute_uv=False)[:, -1]
        self.reach = np.broadcast_to(reach, len(self.positions))

    def near(self, origins: np.ndarray, directions: np.ndarray) -> Surface:
        """The particles alone that these rays may meet: all that reach into a cone about them."""
        o, axis = origins.mean(0), directions.mean(0)
        axis /= np.linalg.norm(axis)
        along = directions @ axis
        slope = 1.01 * (np.linalg.norm(directions - along[:, None] * axis, axis=1) / along).max()
        wide = 1.01 * np.linalg.norm(origins - o, axis=1).max()
        to = self.positions - o
        far = to @ axis
        apart = np.sqrt(np.maximum((to**2).sum(1) - far**2, 0))
        kept = apart <= wide + slope * np.maximum(far + self.reach, 0) + 1.01 * self.reach
        cut = (np.broadcast_to(a, (len(kept), *np.shape(a)[1:]))[kept] for a in (self.support, self.weight))
        return Surface(self.positions[kept], *cut, self.kernel, self.threshold)

    def first_hit(self, origins: np.ndarray, directions: np.ndarray) -> tuple:
        if not len(self.positions):
            return np.full(len(origins), np.inf), np.zeros_like(directions)
        if self.kernel == "union":
            return _balls(self.positions, self.support, origins, directions)
        field = (self.positions, self.support, self.weight, self.kernel)
        t = oracle.first_hit(*field, self.threshold, origins, directions)
        hit = np.isfinite(t)
        normals = np.zeros_like(directions)
        if hit.any():
            points = origins[hit] + t[hit, None] * directions[hit]
            g = oracle.field(*field, points)[1]
            normals[hit] = -g / np.maximum(np.linalg.norm(g, axis=1, keepdims=True), 1e-30)
        return t, normals


def _balls(x: np.ndarray, radii: np.ndarray, origins: np.ndarray, directions: np.ndarray) -> tuple:
    t, which = np.full(len(origins), np.inf), np.zeros(len(origins), int)
    x = x.astype(np.float64)
    block = max(int(4e6 // len(x)), 1)
    for k in range(0, len(origins), block):
        s = slice(k, k + block)
        o, d = origins[s], directions[s]
        along = d @ x.T - (o * d).sum(1)[:, None]
        apart = (o**2).sum(1)[:, None] - 2 * (o @ x.T) + (x**2).sum(1) - along**2
        under = radii**2 - apart
        found = np.where(under >= 0, along - np.sqrt(np.maximum(under, 0)), np.inf)
        which[s] = found.argmin(1)
        t[s] = found[np.arange(len(found)), which[s]]
    hit = np.isfinite(t)
    normals = np.zeros_like(directions)
    normals[hit] = origins[hit] + t[hit, None] * directions[hit] - x[which[hit]]
    normals[hit] /= radii[which[hit], None]
    return t, normals


def squares(size: tuple[int, int], n: int) -> list[np.ndarray]:
    """The pixels that are judged, square by square: all of them, or a fixed random choice of
    squares where all would take too long for `n` particles."""
    numbers = np.arange(size[0] * size[1]).reshape(size[1], size[0])
    found = [
        numbers[y : y + TILE, x : x + TILE].ravel() for y in range(0, size[1], TILE) for x in range(0, size[0], TILE)
    ]
    most = max(int(WORK / (n + PARTICLES)), 1)
    if len(found) > most:
        chosen = np.random.default_rng(0).choice(len(found), most, replace=False)
        found = [found[k] for k in np.sort(chosen)]
    return found


def compare(mask: np.ndarray, normals: np.ndarray | None, chosen: np.ndarray, expected: tuple,
            directions: np.ndarray) -> dict:  # fmt: skip
    """Counts of pixels judged, hit, and wrong in hit or miss; and the median and the 99th
    percentile of the angle between the normals, degrees."""
    t, true = expected
    hit = np.isfinite(t)
    drawn = mask.reshape(-1)[chosen]
    found: dict = {"judged": len(chosen), "hit": int(hit.sum()), "wrong": int((drawn != hit).sum())}
    both = drawn & hit
    if normals is not None and both.any():
        n = normals.reshape(-1, 3)[chosen][both].astype(np.float64)
        m = true[both]
        facing = (n * directions[both]).sum(1) > 0  # a mesh's normals may point inwards
        n[facing] *= -1
        angle = np.degrees(np.arctan2(np.linalg.norm(np.cross(n, m), axis=1), (n * m).sum(1)))
        found["normal"], found["normal_99"] = np.median(angle), np.quantile(angle, 0.99)
    return found
