"""The medium once more, by definition: float64, every particle at every point, no octree, no cells,
no intervals. A ray is sampled densely, and a surface is where the answer to "is the medium here?"
changes."""

from __future__ import annotations

import globule as gb
import numpy as np
from globule.scene.scene import DEFAULT_COLOR
from light import dot, unit

EPS = 1e-6  # how far beside a surface its two sides are looked at
SAMPLES = 300  # of a ray's way through all supports
KERNELS = {  # b of q = distance / support, 0 <= q <= 1
    "murakami": lambda q: (1 - q**2) ** 2,
    "wyvill": lambda q: 1 - 22 / 9 * q**2 + 17 / 9 * q**4 - 4 / 9 * q**6,
    "cubic_spline": lambda q: np.where(q < 0.5, 1 - 6 * q**2 + 6 * q**3, 2 * (1 - q) ** 3),
    "wendland_c2": lambda q: (1 - q) ** 4 * (1 + 4 * q),
    "solid": lambda q: (1 - q**2) ** 2 * (1 - 2 * q**2),
}


def per_particle(value, n, default, shape=()):
    value = default if value is None else value
    return np.broadcast_to(np.asarray(value, np.float64), (n, *shape))


class Medium:
    """One layer: where it is, and what a point of it looks like."""

    def __init__(self, layer: gb.Layer, settings: gb.RenderSettings, clips):
        scene, p = layer.scene, layer.scene.particles
        n = len(p)
        self.b, self.threshold = KERNELS[scene.kernel], float(np.float32(scene.threshold))
        self.positions = p.positions.astype(np.float64)
        support = per_particle(scene.support, n, None)
        if p.anisotropy is not None:
            self.matrices = p.anisotropy.astype(np.float64)
        else:
            self.matrices = np.eye(3) / support[:, None, None]
        self.weights = per_particle(p.weight, n, 1.0)
        self.colors = per_particle(p.color, n, DEFAULT_COLOR, (3,))
        self.reflections = per_particle(p.reflection, n, 0.0)
        self.refractions = per_particle(p.refraction, n, 0.0)
        self.clips = [*layer.clips, *clips]
        self.material = layer.material or settings.material
        self.middle = self.positions.mean(0)
        self.reach = (np.linalg.norm(self.positions - self.middle, axis=1) + support).max()

    def shares(self, points):
        """Every particle's weight * b: (M, N)."""
        out = np.empty((len(points), len(self.weights)))
        for some in np.array_split(np.arange(len(points)), 1 + out.size // 50_000):
            for k, (q, matrix) in enumerate(zip(self.positions, self.matrices, strict=True)):
                away = (points[some] - q) @ matrix
                x = np.minimum(np.sqrt((away * away).sum(1)), 1)
                out[some, k] = self.weights[k] * self.b(x)
        return out

    def kept(self, points):
        """Which clips keep each point: (M, clips)."""
        out = np.ones((len(points), len(self.clips)), bool)
        for k, c in enumerate(self.clips):
            if isinstance(c, gb.ClipPlane):
                out[:, k] = points @ np.asarray(c.normal, float) <= c.offset
            elif isinstance(c, gb.ClipBox):
                out[:, k] = ((points > c.lo) & (points < c.hi)).all(1) == c.keep
            else:
                out[:, k] = (np.linalg.norm(points - c.center, axis=1) < c.radius) == c.keep
        return out

    def holds(self, points):
        return (self.shares(points).sum(1) > self.threshold) & self.kept(points).all(1)

    def normals(self, points, d):
        """Out of the medium, at points of its surface where rays cross it along d; cut faces', of
        the clip that keeps one side of the point and not the other."""
        h = 1e-5 * self.reach
        f = [self.shares(points + h * e).sum(1) - self.shares(points - h * e).sum(1) for e in np.eye(3)]
        gradient = np.stack(f, -1)
        out = -unit(np.where(np.linalg.norm(gradient, axis=1, keepdims=True) > 0, gradient, 1.0))
        changes = self.kept(points - EPS * d) != self.kept(points + EPS * d)
        for k, c in enumerate(self.clips):
            at = points[changes[:, k]]
            if isinstance(c, gb.ClipPlane):
                n = np.broadcast_to(unit(c.normal), at.shape)
            elif isinstance(c, gb.ClipBox):
                sides = np.concatenate([at - c.lo, c.hi - at], 1)
                face = np.abs(sides).argmin(1)
                n = np.concatenate([-np.eye(3), np.eye(3)])[face] * (1 if c.keep else -1)
            else:
                n = unit(at - c.center) * (1 if c.keep else -1)
            out[changes[:, k]] = n
        return out

    def looks(self, points):
        """Blended color, reflection and refraction factor."""
        w = np.maximum(self.shares(points), 0)
        w = w / np.maximum(w.sum(1, keepdims=True), 1e-30)
        return w @ self.colors, w @ self.reflections, w @ self.refractions

    def changes(self, o, d, inside, far=np.inf, samples=SAMPLES):
        """All places where rays that begin inside or not pass the surface, in order: the ray, how
        far on it, and whether inside begins there."""
        along = dot(self.middle - o, d)[:, 0]
        begin, end = np.maximum(along - self.reach, EPS), np.minimum(along + self.reach, far)
        aside = np.linalg.norm(o + along[:, None] * d - self.middle, axis=1)
        passes = (aside < self.reach) & (begin < end)
        number = np.flatnonzero(passes)
        o, d, inside, begin, end = (v[passes] for v in (o, d, inside, begin, end))
        t = begin[:, None] + np.linspace(0, 1, samples) * (end - begin)[:, None]
        t = np.concatenate([np.full((len(o), 1), EPS), t], 1)
        points = o[:, None] + t[..., None] * d[:, None]
        held = self.holds(points.reshape(-1, 3)).reshape(t.shape)
        before = np.concatenate([inside[:, None], held[:, :-1]], 1)
        ray, k = np.nonzero(held != before)
        low, high, side = np.where(k > 0, t[ray, k - 1], 0), t[ray, k], held[ray, k]
        for _ in range(40):
            middle = (low + high) / 2
            same = self.holds(o[ray] + middle[:, None] * d[ray]) == side
            low, high = np.where(same, low, middle), np.where(same, middle, high)
        return number[ray], np.where(k > 0, high, 0), side
