"""Wrong pixels and wrong normals: what a program drew against float64 rays.

Two questions are asked of a picture. Is it the surface that the program says it draws (`Surface`,
found by brute force in float64)? Is it the body that the particles fill (the scene's truth)?
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from globule.scene import oracle

PAIRS = 2e8  # of rays and particles that the brute force tests for a surface of balls
PAIRS_STRETCHED = 2e7  # for kernels with matrices, which take longer


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

    def first_hit(self, origins: np.ndarray, directions: np.ndarray) -> tuple:
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


def pixels(size: tuple[int, int], surface: Surface | None, n: int) -> np.ndarray:
    """The pixels that are judged: all, or a fixed random choice where all would take too long."""
    count = size[0] * size[1]
    stretched = surface is not None and np.ndim(surface.support) == 3
    most = int((PAIRS_STRETCHED if stretched else PAIRS) / max(n, 1))
    if count <= most:
        return np.arange(count)
    return np.sort(np.random.default_rng(0).choice(count, most, replace=False))


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
