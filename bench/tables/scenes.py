"""Particle scenes of any size for benchmarks, made by formulas.

Axes are right-handed with y up, lengths in meters. The same arguments give the same bytes.
"""

from __future__ import annotations

import numpy as np

#: Share of a pool's particles that fly above it as droplets.
DROPLET_SHARE = 0.004


def pool(n: int = 302_751, seed: int = 1, spacing: float = 0.02) -> tuple[np.ndarray, float]:
    """A square pool with gentle waves and some droplets above, exactly `n` particles.

    The water is a jittered lattice, about three times as wide as deep. Its columns are stretched
    by a few percent to end at the wave's height. The particles left over become droplets, small
    balls of the same lattice. Slab by slab, peak memory stays near 12 bytes per particle.

    Returns `positions` (n, 3) float32, m, and the lattice `spacing`, m. Support of two spacings and
    a threshold of 0.6 give a closed surface.
    """
    if n < 1:
        raise ValueError(f"n: expected at least 1, got {n}")
    rng = np.random.default_rng(seed)
    counts, heights = _columns(int(n * (1 - DROPLET_SHARE)))
    positions: np.ndarray = np.empty((n, 3), np.float32)
    filled = 0
    for i, (row, height) in enumerate(zip(counts, heights, strict=True)):  # one slab of the lattice per x
        m = int(row.sum())
        slab = positions[filled : filled + m]
        slab[:, 0] = i
        slab[:, 2] = np.repeat(np.arange(row.size, dtype=np.float32), row)
        starts: np.ndarray = np.repeat(np.cumsum(row) - row, row)
        slab[:, 1] = (np.arange(m) - starts + 0.5) * np.repeat(height / np.maximum(row, 1), row)
        slab += rng.random((m, 3), np.float32) * np.float32(0.1) - np.float32(0.05)
        filled += m
    _droplets(positions[filled:], counts, rng)
    positions *= np.float32(spacing)
    return positions, spacing


def _columns(n: int) -> tuple[np.ndarray, np.ndarray]:
    """Number of particles of each column, (X, Z) int64, and heights in spacings, (X, Z) float64.

    The sum is at most `n`, and near `n`.
    """
    width = max(1, round((3 * n) ** (1 / 3)))
    u = np.arange(width) / width * (2 * np.pi)
    x, z = u[:, None], u[None, :]
    wave = (np.sin(2 * x + z) + 0.7 * np.sin(3 * z - x + 1.0) + 0.35 * np.sin(7 * x + 4 * z + 2.0)) * (0.01 * width)
    heights = np.maximum(n / width**2 + wave - wave.mean(), 0.0)
    counts = np.floor(heights).astype(np.int64)
    # Rounding down loses about half a particle a column: give it back where the loss was largest.
    missing = max(0, n - int(counts.sum()))
    counts.ravel()[np.argsort((counts - heights).ravel(), kind="stable")[:missing]] += 1
    while counts.sum() > n:  # only in pools of a few columns, where a wave is cut at the floor
        counts[np.unravel_index(counts.argmax(), counts.shape)] -= 1
    return counts, heights


def _droplets(out: np.ndarray, counts: np.ndarray, rng: np.random.Generator) -> None:
    """Fill `out` (M, 3) with balls of lattice points above the columns, in units of the spacing."""
    g: np.ndarray = np.arange(-3, 4, dtype=np.float32)
    ball = np.stack(np.meshgrid(g, g, g, indexing="ij"), -1).reshape(-1, 3)
    r2 = (ball**2).sum(1)
    ball = ball[np.argsort(r2, kind="stable")]  # any prefix is a ball
    sizes = np.array([7, 19, 33, 57, 81, 123])
    top, width = float(counts.max()), counts.shape[0]
    filled = 0
    while filled < len(out):
        m = min(int(rng.choice(sizes)), len(out) - filled)
        center = np.array(
            [rng.uniform(0, width), top + 4 + rng.exponential(0.12 * width), rng.uniform(0, width)], np.float32
        )
        out[filled : filled + m] = ball[:m] + center + rng.uniform(-0.05, 0.05, (m, 3))
        filled += m
