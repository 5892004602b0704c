"""What a fluid's state is, measured by one code for every program: density, energy, front, losses.

Density is sum V W over fluid and walls with the cubic spline of support 2 spacings. A fluid
particle has the volume of its place in the lattice, 1 / sum W. A wall's particle has
WALL_SHARE times what its plane has in the lattice, over sum W of the walls (Akinci et al. 2012).
"""

from __future__ import annotations

import numpy as np

REST_DENSITY = 1000.0  # kg/m³
GRAVITY = 9.81  # m/s²
WALL_SHARE = 1.2  # kWallShare in src/sim/boundary.hpp


def spline(q: np.ndarray) -> np.ndarray:
    """The cubic spline times spacing³; q: distance over the support of 2 spacings."""
    near, far = 6 * (q**3 - q**2) + 1, 2 * np.maximum(1 - q, 0) ** 3
    return np.where(q < 0.5, near, far) / np.pi


def lattice_sums() -> tuple[float, float]:
    """Sums of the spline over the cubic lattice, and over a plane of it."""
    x = np.stack(np.meshgrid(*3 * [np.arange(-2, 3)], indexing="ij"), -1).reshape(-1, 3)
    w = spline(np.linalg.norm(x, axis=1) / 2)
    return w.sum(), w[x[:, 0] == 0].sum()


def wall_factor() -> float:
    """A wall's volume times sum W over the walls."""
    whole, plane = lattice_sums()
    return WALL_SHARE * plane / whole


def sums(at: np.ndarray, of: np.ndarray, weight: np.ndarray, spacing: float) -> np.ndarray:
    """(N,) sum of weight (M,) times the spline around points (N, 3) over points (M, 3), m.

    The points lie in cubes of the support's size; each cube looks into 27.
    """
    both = np.concatenate([at, of]).astype(float)
    low = both.min(0)
    cells = np.floor((both - low) / (2 * spacing)).astype(np.int64) + 1
    size = cells.max(0) + 2
    key = np.ravel_multi_index(tuple(cells.T), tuple(size))
    order = np.argsort(key[len(at) :], kind="stable")
    sorted_key, of, weight = key[len(at) :][order], both[len(at) :][order], weight[order]
    total = np.zeros(len(at))
    for step in np.ndindex(3, 3, 3):
        there = key[: len(at)] + np.dot(np.array(step) - 1, [size[1] * size[2], size[2], 1])
        first = np.searchsorted(sorted_key, there, "left")
        count = np.searchsorted(sorted_key, there, "right") - first
        i = np.repeat(np.arange(len(at)), count)
        j = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count) + first[i]
        q = np.linalg.norm(both[i] - of[j], axis=1) / (2 * spacing)
        total += np.bincount(i, weight[j] * spline(q), len(at))
    return total


def relative_density(fluid: np.ndarray, walls: np.ndarray, spacing: float) -> np.ndarray:
    """(N,) density over rest density of fluid (N, 3) beside walls (M, 3)."""
    volumes = wall_factor() / sums(walls, walls, np.ones(len(walls)), spacing)
    points = np.concatenate([fluid, walls])
    weights = np.concatenate([np.full(len(fluid), 1 / lattice_sums()[0]), volumes])
    return sums(fluid, points, weights, spacing)


def lost(case, positions: np.ndarray) -> np.ndarray:
    """(N,) whether a particle is no number, or more than half a spacing beyond a wall's face."""
    d = float(case["spacing"])
    out = ~np.isfinite(positions).all(1)
    out |= ((positions < case["lo"] - d / 2) | (positions > case["hi"] + d / 2)).any(1)
    for low, high in case["obstacles"]:
        out |= ((positions > low + d / 2) & (positions < high - d / 2)).all(1)
    return out


def flow(case, positions: np.ndarray, velocities: np.ndarray) -> dict:
    """Figures of a state; positions (N, 3) m, velocities (N, 3) m/s of the case's particles."""
    d, gone = float(case["spacing"]), lost(case, positions)
    x, v = positions[~gone].astype(float), velocities[~gone].astype(float)
    mass = REST_DENSITY * d**3
    compression = np.maximum(relative_density(x, case["walls"].astype(float), d) - 1, 0)
    kinetic = 0.5 * mass * np.square(v).sum()
    return {
        "compression": compression.mean(),
        "high_compression": np.quantile(compression, 0.999),
        "most_compression": compression.max(),
        "kinetic": kinetic,
        "energy": kinetic + mass * GRAVITY * x[:, 1].sum(),
        "height": x[:, 1].mean(),
        "front": np.quantile(x[:, 0], 0.999),
        "lost": int(gone.sum() + len(case["fluid"]) - len(positions)),
    }
