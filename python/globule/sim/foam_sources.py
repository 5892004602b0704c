"""Where a fluid makes spray, foam and bubbles: potentials after Ihmsen et al. 2012."""

from __future__ import annotations

import itertools

import numpy as np

from .scene_file import Foam
from .solver import Solver

Pairs = tuple[np.ndarray, ...]  # of `Flow.pairs`
REACH = 2.0  # spacings, of all sums here and of the solver
SURFACE = 0.15  # of the mean direction away from neighbors; 0.30 at a flat face, 0 one layer below
ALONG = 0.6  # least cosine of velocity and normal at a crest
_ROWS = 1 << 16  # at a time, for the memory


class Flow:
    """The particles of a simulation as they are now, in the solver's order, as float64.

    Args:
        solver: of a simulation; its neighbor lists are brought up to date.
    """

    def __init__(self, solver: Solver):
        kinds = np.array([phase.kind == "fluid" for phase in solver.phases.values()], bool)
        self.reach = REACH * solver.settings.spacing
        self.ids = solver.read("id")
        self.positions = solver.read("place")[:, :3].astype(float)
        self.velocities = solver.read("velocity")[:, :3].astype(float)
        self.is_fluid = kinds[solver.read("phase")]
        self.lo, hi = solver.settings.domain.bounds()
        self.size = hi - self.lo
        self.periodic = np.array(["xyz"[k] in solver.settings.domain.periodic for k in range(3)])
        rows, offsets, self._neighbors = solver.core.neighbors()
        self._first = np.zeros(len(self.ids), np.int64)
        self._count = np.zeros(len(self.ids), np.int64)
        self._first[rows] = offsets[:-1]
        self._count[rows] = np.diff(offsets.astype(np.int64))

    def apart(self, a: np.ndarray, b: np.ndarray) -> np.ndarray:
        """a - b (M, 3), m, the short way through periodic sides."""
        d = a - b
        for k in np.flatnonzero(self.periodic):
            d[:, k] -= np.round(d[:, k] / self.size[k]) * self.size[k]
        return d

    def pairs(self, rows: np.ndarray) -> Pairs:
        """All pairs of rows with their neighbors: index into rows (P,), neighbor (P,), unit vector
        from the neighbor (P, 3), and weight (P,), 1 - distance / reach."""
        count = self._count[rows]
        i = np.arange(len(rows)).repeat(count)
        at = np.arange(len(i)) + (self._first[rows] - np.cumsum(count) + count).repeat(count)
        j = self._neighbors[at]
        away = self.apart(self.positions.take(rows, 0).take(i, 0), self.positions.take(j, 0))
        r = np.sqrt(np.einsum("ij,ij->i", away, away))
        away /= np.maximum(r, 1e-30)[:, None]
        return i, j, away, np.maximum(1.0 - r / self.reach, 0.0)

    def around(self, places: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """How many fluid particles lie within two spacings of places (M, 3), and their mean
        velocity (M, 3) m/s, weighted by 1 - distance / reach."""
        fluid = np.flatnonzero(self.is_fluid)
        n = np.maximum(self.size // self.reach, 1).astype(np.int64)

        def cells(points: np.ndarray) -> np.ndarray:
            at = np.floor((points - self.lo) / self.size * n).astype(np.int64)
            return np.clip(at, 0, n - 1)

        def key(cell: np.ndarray) -> np.ndarray:
            return (cell[:, 0] * n[1] + cell[:, 1]) * n[2] + cell[:, 2]

        keys = key(cells(self.positions[fluid]))
        order = np.argsort(keys, kind="stable")
        keys, fluid = keys[order], fluid[order]
        positions, velocities = self.positions.take(fluid, 0), self.velocities.take(fluid, 0)
        own, m = cells(places), len(places)
        order = np.argsort(key(own), kind="stable")  # searches that go together are fast
        places, own = places[order], own[order]
        n_near, total, momentum = np.zeros(m, np.int64), np.zeros(m), np.zeros((m, 3))
        # Cells one above the other have keys in a row: one run, but for a domain that repeats.
        runs = [(-1, -1), (0, 0), (1, 1)] if self.periodic[2] else [(-1, 1)]
        for (x, y), (low, high) in itertools.product(np.ndindex(3, 3), runs):
            cell = own + (x - 1, y - 1, low)
            cell = np.where(self.periodic, cell % n, cell)
            inside = np.flatnonzero(((cell[:, :2] >= 0) & (cell[:, :2] < n[:2])).all(axis=1))
            first = cell[inside]
            top = np.minimum(first[:, 2] + high - low, n[2] - 1)
            first[:, 2] = np.maximum(first[:, 2], 0)
            begin = np.searchsorted(keys, key(first), "left")
            first[:, 2] = top
            count = np.searchsorted(keys, key(first), "right") - begin
            q = inside.repeat(count)
            j = np.arange(len(q)) + (begin - np.cumsum(count) + count).repeat(count)
            away = self.apart(places.take(q, 0), positions.take(j, 0))
            r2 = np.einsum("ij,ij->i", away, away)
            near = np.flatnonzero(r2 <= self.reach**2)
            q, j, w = q[near], j[near], 1.0 - np.sqrt(r2[near]) / self.reach
            n_near += np.bincount(q, minlength=m)
            total += np.bincount(q, w, m)
            momentum += _sums(q, w[:, None] * velocities.take(j, 0), m)
        back = np.argsort(order)
        n_near, total, momentum = n_near[back], total[back], momentum[back]
        return n_near, momentum / np.maximum(total, 1e-30)[:, None]


def limits_of(table: Foam, gravity: float, spacing: float) -> dict[str, tuple[float, float]]:
    """Speeds of approach, curvatures and speeds at which potentials begin and are 1: those of the
    scene, else those that gravity and spacing give (docs/design/simulation.md)."""
    fall = np.sqrt(gravity * spacing)  # m/s
    return {
        "approach": table.approach or (2.0 * fall, 8.0 * fall),
        "curvature": table.curvature,
        "speed": table.speed or (3.0 * fall, 10.0 * fall),
    }


def potentials(
    flow: Flow, rows: np.ndarray, limits: dict[str, tuple[float, float]]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Potentials of fluid particles, (M,) each, 0 to 1.

    Args:
        flow: the particles.
        rows: (M,) of fluid particles, in the solver's order.
        limits: where each begins and ends, as of `limits_of`.

    Returns:
        trapped air, wave crest and kinetic energy.
    """
    v2 = np.einsum("ij,ij->i", flow.velocities[rows], flow.velocities[rows])
    slow, fast = limits["speed"]
    kinetic = ramp(v2, slow**2, fast**2)
    trapped, crest = np.zeros(len(rows)), np.zeros(len(rows))
    for k in range(0, len(rows), _ROWS):
        part = rows[k : k + _ROWS]
        pairs = flow.pairs(part)
        trapped[k : k + _ROWS] = _approach(flow, part, pairs)
        crest[k : k + _ROWS] = _curvature(flow, part, pairs)
    return ramp(trapped, *limits["approach"]), ramp(crest, *limits["curvature"]), kinetic


def ramp(value: np.ndarray, lo: float, hi: float) -> np.ndarray:
    """0 up to lo, 1 from hi on, and a straight line between."""
    return np.clip((value - lo) / (hi - lo), 0.0, 1.0)


def _approach(flow: Flow, rows: np.ndarray, pairs: Pairs) -> np.ndarray:
    """Sum of the speeds, m/s, with which fluid neighbors come closer: 0 in a rigid motion."""
    i, j, away, w = pairs
    closing = -np.einsum("ij,ij->i", flow.velocities[rows[i]] - flow.velocities[j], away)
    w = np.where(flow.is_fluid[j], w, 0.0)
    return np.bincount(i, np.maximum(closing, 0.0) * w, len(rows))


def _normals(n: int, pairs: Pairs) -> np.ndarray:
    """Outward unit normals (n, 3) of particles at the free surface, 0 of others. All neighbors
    count, so that fluid at a wall has no surface there."""
    i, _, away, w = pairs
    total = np.maximum(np.bincount(i, w, n), 1e-30)
    mean = _sums(i, w[:, None] * away, n) / total[:, None]
    length = np.linalg.norm(mean, axis=1)
    return np.where(length > SURFACE, 1.0 / np.maximum(length, 1e-30), 0.0)[:, None] * mean


def _curvature(flow: Flow, rows: np.ndarray, pairs: Pairs) -> np.ndarray:
    """Convex curvature of the surface where it moves along its normal, else 0: the sum over surface
    neighbors below of 1 - cosine of both normals."""
    normals = _normals(len(rows), pairs)
    along = np.einsum("ij,ij->i", normals, flow.velocities[rows])
    speed = np.linalg.norm(flow.velocities[rows], axis=1)
    moving = (along >= ALONG * speed) & (along > 0)
    i, j, away, w = (values[moving[pairs[0]]] for values in pairs)
    own = normals[i]
    below = (np.einsum("ij,ij->i", away, own) > 0) & flow.is_fluid[j]
    i, j, w, own = i[below], j[below], w[below], own[below]
    others, of = np.unique(j, return_inverse=True)
    beside = _normals(len(others), flow.pairs(others))[of]
    bend = 1.0 - np.einsum("ij,ij->i", own, beside)
    bend = np.where(beside.any(axis=1), np.maximum(bend, 0.0), 0.0)
    return np.bincount(i, w * bend, len(rows))


def _sums(index: np.ndarray, vectors: np.ndarray, n: int) -> np.ndarray:
    """Sums (n, 3) of the vectors of each index."""
    return np.stack([np.bincount(index, vectors[:, k], n) for k in range(3)], axis=1)
