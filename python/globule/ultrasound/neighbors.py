"""Interpolation between neighboring frames in float64: the reference of method `frames`, and the
error of the method, measured on frames that it has not seen."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

_OWN = 1.0  # voxels; src/sweep/frames.hpp kOwn
_FOOTPRINT = 1 / np.sqrt(3)  # voxels; kFootprint
_TESTED = 12  # frames left out to measure the error
_POINTS = 4000  # pixels of each


class Between(NamedTuple):
    """Values at points (P,) between two frames: `value`; `contrast`, the squared difference of both
    frames; `spread`, |d0 d1| / |d0 - d1| in voxels; `nearest`, the smaller distance from a frame's
    plane, voxels; `known`, whether the point lies between the frames."""

    value: np.ndarray
    contrast: np.ndarray
    spread: np.ndarray
    nearest: np.ndarray
    known: np.ndarray


class FramePath:
    """Frames along the path of the probe, in voxel coordinates.

    Args:
        frames: (F, H, W).
        poses: (F, 9) origin, column step, row step, voxels: voxel (0, 0, 0) spans 0 to 1.
        mask: (H, W), nonzero inside; None for all.
        max_gap: longest way of a corner from a frame to the next that are joined, voxels; None:
            five times the usual step.
    """

    def __init__(
        self, frames: np.ndarray, poses: np.ndarray, mask: np.ndarray | None = None, max_gap: float | None = None
    ):
        self.frames, self.poses, self.mask = frames, np.asarray(poses, np.float64), mask
        origin, x, y = (self.poses[:, k : k + 3] for k in (0, 3, 6))
        lengths = np.linalg.norm(x[0]), np.linalg.norm(y[0])
        self.averaged = tuple(
            int(np.clip(np.floor(_FOOTPRINT / length + 1e-6), 1, 64)) if length > 0 else 1 for length in lengths
        )
        normal = np.cross(x, y)
        normal /= np.linalg.norm(normal, axis=1)[:, None]
        step = np.stack([normal, x, y], axis=2)  # columns: voxels per distance, column, row
        self.inverse = np.linalg.inv(step)
        self.origin = origin
        self.steps = self._steps()
        limit = 5 * usual_step(self.steps) if max_gap is None else max_gap
        turned = (normal[1:] * normal[:-1]).sum(axis=1) > 0
        self.joined = (self.steps <= limit) & turned
        self._images: dict[int, tuple[np.ndarray, np.ndarray]] = {}

    def _steps(self) -> np.ndarray:
        height, width = self.frames.shape[1:]
        rows, columns = np.arange(height), np.arange(width)
        if self.mask is not None:
            rows, columns = np.flatnonzero(self.mask.any(1)), np.flatnonzero(self.mask.any(0))
        corners = np.array([[1, c, r] for c in columns[[0, -1]] for r in rows[[0, -1]]], float)
        places = np.einsum("cj,fjk->fck", corners, self.poses.reshape(-1, 3, 3))
        return np.linalg.norm(np.diff(places, axis=0), axis=2).max(axis=1)

    def coordinates(self, f: int, points: np.ndarray) -> np.ndarray:
        """(P, 3): distance from frame f's plane, voxels, and column and row, of points (P, 3)."""
        return (points - self.origin[f]) @ self.inverse[f].T

    def image(self, f: int) -> tuple[np.ndarray, np.ndarray]:
        """The frame in averaged pixels, float64, and whether a pixel holds any that counts."""
        if f not in self._images:
            if len(self._images) > 8:
                self._images.clear()
            nx, ny = self.averaged
            height, width = self.frames.shape[1:]
            used = np.ones((height, width)) if self.mask is None else (self.mask != 0).astype(float)
            padding = ((0, -height % ny), (0, -width % nx))

            def sums(values: np.ndarray) -> np.ndarray:
                whole = np.pad(values, padding)
                h, w = whole.shape
                return whole.reshape(h // ny, ny, w // nx, nx).sum(axis=(1, 3))

            total, count = sums(self.frames[f] * used), sums(used)
            self._images[f] = total / np.maximum(count, 1), count > 0
        return self._images[f]

    def sample(self, f: int, column: np.ndarray, row: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Values of frame f, bilinear among the pixels that count, and whether there are any."""
        nx, ny = self.averaged
        image, used = self.image(f)
        height, width = self.frames.shape[1:]
        inside = (column >= -0.5) & (column < width - 0.5) & (row >= -0.5) & (row < height - 0.5)
        u, v = ((c - (n - 1) / 2) / n for c, n in ((column, nx), (row, ny)))
        i, j = np.floor(u).astype(int), np.floor(v).astype(int)
        total, weights = np.zeros(len(u)), np.zeros(len(u))
        nearest = np.zeros(len(u), bool)
        for dj in (0, 1):
            for di in (0, 1):
                at = (np.clip(j + dj, 0, image.shape[0] - 1), np.clip(i + di, 0, image.shape[1] - 1))
                share = (u - i if di else 1 - (u - i)) * (v - j if dj else 1 - (v - j)) * used[at]
                total += share * image[at]
                weights += share
                closest = ((u - i >= 0.5) == bool(di)) & ((v - j >= 0.5) == bool(dj))
                nearest |= closest & used[at]
        return total / np.where(weights > 0, weights, 1), inside & nearest

    def between(self, a: int, b: int, points: np.ndarray) -> Between:
        """Interpolated values at points (P, 3), voxels, that lie between frames a and b."""
        first, second = self.coordinates(a, points), self.coordinates(b, points)
        d0, d1 = first[:, 0], second[:, 0]
        crossed = (d0 < 0) != (d1 < 0)
        t = d0 / np.where(crossed, d0 - d1, 1)
        at = first[:, 1:] + t[:, None] * (second[:, 1:] - first[:, 1:])
        (p, known), (q, _) = (self.sample(f, at[:, 0], at[:, 1]) for f in (a, b))
        return Between(
            p + t * (q - p), (q - p) ** 2, np.abs(d1 * t), np.minimum(np.abs(d0), np.abs(d1)),
            crossed & known,
        )  # fmt: skip


def usual_step(steps: np.ndarray) -> float:
    """The median of the steps that are no rest, those above a tenth of the upper quartile."""
    if len(steps) == 0:
        return 0.0
    ordered = np.sort(steps)
    moving = ordered[ordered > 0.1 * ordered[3 * (len(ordered) - 1) // 4]]
    return float(moving[len(moving) // 2]) if len(moving) else 0.0


def interpolate(path: FramePath, points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Values, weights and smallest distances, voxels, at points (P, 3) from all joined pairs."""
    total, weights = np.zeros(len(points)), np.zeros(len(points))
    nearest = np.full(len(points), np.inf)
    for f in np.flatnonzero(path.joined).tolist():
        found = path.between(f, f + 1, points)
        weight = np.where(found.known, 1 / (found.spread + _OWN), 0)
        total += weight * found.value
        weights += weight
        nearest = np.where(found.known, np.minimum(nearest, found.nearest), nearest)
    return total / np.where(weights > 0, weights, 1), weights, nearest


class PathError(NamedTuple):
    """Expected squared error of an interpolated value, gray levels squared:

    own + (floor + share * contrast) * (spread / unit) ** power

    own          of a value in a frame's own plane: the texture inside of a voxel
    floor, share where the frames on both sides agree, and per squared difference between them
    unit, power  spread, voxels, of the frames that were left out, and how errors grow with it
    rms          error of frames left out, each predicted from its two neighbors, gray levels
    n_frames     frames left out
    """

    own: float
    floor: float
    share: float
    unit: float
    power: float
    rms: float
    n_frames: int

    def at(self, spread: np.ndarray, contrast: np.ndarray) -> np.ndarray:
        """Expected error, gray levels, float32; infinite where spread is
        negative. Negative contrast is
        unknown and takes the mean."""
        mean = max(self.rms**2 - self.own, 0.0)
        level = np.where(contrast >= 0, self.floor + self.share * contrast, mean)
        scale = (np.maximum(spread, 0) / self.unit) ** self.power
        return np.where(spread >= 0, np.sqrt(self.own + level * scale), np.inf).astype(np.float32)


def path_error(path: FramePath) -> PathError | None:
    """Measure the error of `frames` on up to 12 frames, each predicted from its neighbors; None if
    no frame has two."""
    n = len(path.frames)
    joined = path.joined
    tested = [f for f in range(1, n - 1) if joined[f - 1] and joined[f]]
    if not tested:
        return None
    tested = [tested[i] for i in np.unique(np.linspace(0, len(tested) - 1, _TESTED).astype(int))]
    near, far, steps, own = [], [], [], []
    for f in tested:
        pixels, seen = _pixels(path, f)
        points = np.column_stack([np.ones(len(pixels)), pixels]) @ path.poses[f].reshape(3, 3)
        value, known = path.sample(f, pixels[:, 0], pixels[:, 1])
        own.append(((value - seen) ** 2)[known])
        found = path.between(f - 1, f + 1, points)
        near.append(_errors(found, seen))
        if f >= 2 and f + 2 < n and joined[f - 2] and joined[f + 1]:
            far.append(_errors(path.between(f - 2, f + 2, points), seen))
        other, there = path.sample(f + 1, pixels[:, 0], pixels[:, 1])
        steps.append(((value - other) ** 2)[known & there])
    error, contrast, spread = (np.concatenate(part) for part in zip(*near, strict=True))
    if len(error) == 0:
        return None
    noise = min(float(np.concatenate(own).mean()), float(error.mean()))
    unit = max(float(spread.mean()), 1e-6)
    excess = np.maximum(float(error.mean()) - noise, 1e-9)
    power = 1.0
    if far:
        error2, _, spread2 = (np.concatenate(part) for part in zip(*far, strict=True))
        if len(error2) and spread2.mean() > 1.2 * unit:
            growth = max(float(error2.mean()) - noise, 1e-9) / excess
            power = float(np.clip(np.log(growth) / np.log(spread2.mean() / unit), 0.1, 1.0))
    variance = float(contrast.var())
    share = float(np.mean((error - error.mean()) * (contrast - contrast.mean())))
    share = float(np.clip(share / variance, 0, excess / max(contrast.mean(), 1e-9))) if variance else 0.0
    floor = float(excess - share * contrast.mean())
    # In the volume, the frames on both sides are one step apart instead of two.
    step = float(np.concatenate(steps).mean())
    share *= float(contrast.mean()) / step if step > 0 else 1.0
    rms = float(np.sqrt(error.mean()))
    return PathError(noise, floor, share, unit, power, rms, len(near))


def _errors(found: Between, seen: np.ndarray) -> tuple[Any, Any, Any]:
    known = found.known
    return ((found.value - seen) ** 2)[known], found.contrast[known], found.spread[known]


def _pixels(path: FramePath, f: int) -> tuple[np.ndarray, np.ndarray]:
    """Places (P, 2), column and row, and values of some pixels of a frame, spread evenly."""
    height, width = path.frames.shape[1:]
    step = max(1, int(np.sqrt(height * width / _POINTS)))
    rows, columns = np.mgrid[step // 2 : height : step, step // 2 : width : step]
    used = np.ones(rows.shape, bool) if path.mask is None else path.mask[rows, columns] != 0
    rows, columns = rows[used], columns[used]
    return np.column_stack([columns, rows]).astype(float), path.frames[f][rows, columns].astype(float)
