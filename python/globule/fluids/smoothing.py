"""Smoother surfaces of fluid particles: stray particles left out, and anisotropic kernels.

`surface_kernels` is the reference in float64 of what scenes with `surface="smooth"` find on their
device (src/field/surface_kernels.hpp, docs/design/surface.md).

The anisotropy is that of Yu and Turk 2013, "Reconstructing Surfaces of Particle-Based Fluids Using
Anisotropic Kernels", ACM Transactions on Graphics 32(1).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from .._base.arrays import to_host
from .._base.checks import number, positive, whole
from ..data.particles import FARTHEST, Particles
from ..scene.scene import SceneBase

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

BLOCK_PAIRS = 2_000_000  # pairs of neighbors handled together: bounds the memory to some 300 MB


class Anisotropy(NamedTuple):
    """The result of `anisotropy`.

    centers  (N, 3) float32, world: the particles' positions, smoothed
    G        (N, 3, 3) float32, 1 / world: symmetric, positive definite; particle j's field at x is
             weight_j · b(|G_j (x - centers_j)|), b being a kernel of support 1
    """

    centers: np.ndarray
    G: np.ndarray


def remove_strays(
    particles: Particles,
    scene_or_radius: SceneBase | float,
    min_neighbors: int = 3,
    progress: Callable[[int, int], object] | None = None,
) -> Particles:
    """The particles with at least `min_neighbors` other particles within a radius.

    Args:
        particles: N particles.
        scene_or_radius: a radius, world units; or a scene of these particles, whose octree serves
            the search, with a radius of 2.1 of the scene's spacings. Inside a lattice, this radius
            holds 32 other particles, at a face 22, at an edge 15.
        min_neighbors: least number of other particles. Other particles at the same position count.
        progress: called as progress(done, total) with counts of particles; may raise to stop.

    The function also removes particles whose position is not finite.

    Returns:
        The remaining particles, with their fields and attributes.
    """
    scene: SceneBase | None
    if isinstance(scene_or_radius, SceneBase):
        scene, radius = scene_or_radius, 2.1 * scene_or_radius.spacing
        if len(scene) != len(particles):
            raise ValueError(f"scene: expected {len(particles)} particles, got {len(scene)}")
    else:
        radius = positive("radius", scene_or_radius)
        scene = SceneBase(particles, support=radius, device="cpu") if len(particles) else None
    whole("min_neighbors", min_neighbors, 0, 2**31)
    if scene is None or radius == 0:  # too few particles for a spacing
        return particles
    keep = np.zeros(len(particles), bool)
    blocks = _neighbor_blocks(scene, to_host(particles.positions), radius, progress)
    for rows, offsets, _ in blocks:
        keep[rows] = np.diff(offsets) - 1 >= min_neighbors
    return particles[keep]


def find_anisotropy(
    particles: Particles | ArrayLike,
    support: float | None = None,
    radius: float | None = None,
    smoothing: float = 0.9,
    most_stretch: float = 4.0,
    few: int = 25,
    few_size: float = 0.5,
    progress: Callable[[int, int], object] | None = None,
) -> Anisotropy:
    """Kernels stretched along the surface and flattened across it, and smoothed positions.

    With the weights w = 1 - (r / radius)³ of a particle's neighbors (paper, eq. 11), its position
    moves by the factor `smoothing` to their mean (eq. 6), and their covariance C = R diag(s) Rᵀ
    (eq. 9, 10, 12) makes the kernel G = R diag(1 / s̃) Rᵀ / support (eq. 15, 16), where
    s̃ = k · max(s, s_1 / most_stretch). A particle with at most `few` neighbors gets a small
    isotropic kernel, s̃ = few_size. The paper's k_s = 1400 is for its own unit of length; here
    k = 1 / (0.15 radius²), which makes s̃ = 1 where particles fill the radius evenly, in any unit.

    Args:
        particles: N particles, or (N, 3) positions, world. Particles whose position is not finite
            keep the position and get the kernel of a particle with few neighbors.
        support: h, radius at which an isotropic particle's kernel vanishes, world units; default:
            `particles.support` if it is one number.
        radius: radius of the neighbor search, world units; default: 2 h, as in the paper.
        smoothing: λ, 0 (keeps the positions) to 1. The paper has 0.9 to 1.
        most_stretch: k_r, largest ratio of a kernel's axes.
        few: N_ε, number of neighbors, without the particle itself.
        few_size: k_n.
        progress: called as progress(done, total) with counts of particles; may raise to stop.

    Returns:
        `Anisotropy`: smoothed positions (N, 3) and matrices G (N, 3, 3), for `Particles`.
    """
    if not isinstance(particles, Particles):
        particles = Particles(particles)
    if support is None:
        if not isinstance(particles.support, float):
            raise ValueError("support: expected one number for all particles, got none")
        support = particles.support
    support = positive("support", support)
    radius = 2 * support if radius is None else positive("radius", radius)
    smoothing = number("smoothing", smoothing, 0, 1)
    most_stretch = number("most_stretch", most_stretch, 1)
    few_size = positive("few_size", few_size)

    positions = to_host(particles.positions)
    centers = positions.copy()
    G = np.empty((len(positions), 3, 3), np.float32)
    G[:] = np.eye(3) / (few_size * support)
    if not len(positions):
        return Anisotropy(centers, G)
    scene = SceneBase(positions, support=support, device="cpu")
    unit = 1 / (0.15 * radius**2)
    for rows, offsets, index in _neighbor_blocks(scene, positions, radius, progress):
        count = np.diff(offsets)
        away, covariance = _moments(positions, rows, offsets, index, radius)
        centers[rows] = positions[rows] + smoothing * away
        many = count - 1 > few
        G[rows[many]] = _kernels(unit * covariance[many], most_stretch) / support
    return Anisotropy(centers, G)


class SurfaceKernels(NamedTuple):
    """The kernels of a smooth surface, for `Particles`; the threshold is 0.5.

    G       (N, 3, 3) float64, 1 / world: symmetric, positive definite
    weight  (N,) float64; particle j's field at x is weight_j · (1 - |G_j (x - position_j)|²)²
    """

    G: np.ndarray
    weight: np.ndarray


# Lengths in spacings; eigenvalues of the covariance over those where neighbors fill the radius.
RADIUS = 3.375  # of the neighbors: the longest axis that there is
AXIS = 2.25  # support across the surface, and inside
THIN = 1.5  # across a single layer
ALONG = 1.5  # ratio of the supports along and across the surface
TWO_LAYERS, FACE_EIGENVALUE = 0.18, 0.36  # least eigenvalue
FLAT, INSIDE = 0.3, 1.0  # eigenvalue across a face, and inside
FACE = 0.73  # field at a particle in a flat face
DROPLET, CROWD = 0.1, 0.36  # share of the neighborhood that is filled: weights are raised below
EDGE_CROWD, EDGE = 0.482, 0.82  # the same, and raised to, at edges, which are rounded off
EDGE_FROM, EDGE_TO = 0.04, 0.1225  # square of the neighbors' mean over the radius: an edge
ALONE, SOME = 0.04, 0.2  # the same: kernels are round below
SHEET = 0.16  # the same: what is flat is a sheet in full from here, and none below ALONE
ROW, WIDE = 0.3, 0.8  # second eigenvalue of a row of particles, of a sheet
FULL, EVEN = 0.85, 0.02  # the same, and how far off the neighbors' mean may be: inside, round
MASS = 105 / (32 * np.pi)  # 1 / integral of (1 - r²)² over the unit ball


def find_surface_kernels(
    particles: Particles | ArrayLike, spacing: float, progress: Callable[[int, int], object] | None = None
) -> SurfaceKernels:
    """An ellipsoid and a weight for each particle, so that the surface of the summed kernels at the
    threshold 0.5 encloses the particles' volume.

    The function computes in float64 what a scene with `surface="smooth"` computes on its device.
    docs/design/surface.md derives it.

    Args:
        particles: N particles of one fluid, or (N, 3) positions, world.
        spacing: cube root of a particle's volume, world units.
        progress: called as progress(done, total) with counts of particles; may raise to stop.

    Returns:
        `SurfaceKernels`: matrices G (N, 3, 3) and weights (N,), 0 for a particle whose position is
        not finite.
    """
    if not isinstance(particles, Particles):
        particles = Particles(particles)
    spacing = positive("spacing", spacing)
    positions = to_host(particles.positions)
    radius = RADIUS * spacing
    G = np.tile(np.eye(3) / radius, (len(positions), 1, 1))
    weight = np.zeros(len(positions))
    if not len(positions):
        return SurfaceKernels(G, weight)
    scene = SceneBase(positions, support=radius, device="cpu")
    for rows, offsets, index in _neighbor_blocks(scene, positions, radius, progress):
        mean, covariance = _moments(positions, rows, offsets, index, radius, power=4)
        values, axes = np.linalg.eigh(covariance / (7 / 45 * radius**2))
        own = np.repeat(np.arange(len(rows)), np.diff(offsets))
        away = positions[index].astype(np.float64) - positions[rows][own]
        squares = np.einsum("ni,ni->n", away, away) / radius**2
        w = np.maximum(1 - squares**2, 0)
        filled = np.bincount(own, w, len(rows)) / (16 * np.pi / 21 * RADIUS**3)

        flat = 1 - _smooth_step(values, FLAT, INSIDE)
        across = THIN + (AXIS - THIN) * _smooth_step(values, TWO_LAYERS, FACE_EIGENVALUE)
        along = np.maximum(flat.max(axis=1, keepdims=True) - flat, 0)
        wide = across + (ALONG - 1) * AXIS * along
        company = _smooth_step(filled, ALONE, SOME)
        length = THIN + company[:, None] * (wide - THIN)  # of the axes, in spacings
        deep = (filled >= FULL) & (np.einsum("ni,ni->n", mean, mean) <= (EVEN * radius) ** 2)
        length[deep] = AXIS
        G[rows] = np.einsum("mik,mk,mjk->mij", axes, 1 / (length * spacing), axes)
        mass = MASS / length.prod(axis=1)

        seen = np.einsum("nij,nj->ni", G[rows][own], away)
        b = np.maximum(1 - np.einsum("ni,ni->n", seen, seen), 0) ** 2
        field = mass * np.bincount(own, np.where(squares < 1, b, 0), len(rows))
        edge = company * _smooth_step(np.einsum("ni,ni->n", mean, mean) / radius**2, EDGE_FROM, EDGE_TO)
        few = 1 - _smooth_step((filled - DROPLET) / (CROWD + (EDGE_CROWD - CROWD) * edge - DROPLET), 0, 1)
        # A sheet of t particles in a square spacing is t spacings thick:
        # c (1 - (t / 2)² / THIN²)³ = 1/2, t = field / FACE.
        thickness = field / FACE
        in_sheet = 0.5 / (1 - np.minimum(thickness / 2 / THIN, 0.4) ** 2) ** 3
        sheet = _smooth_step(filled, ALONE, SHEET) * _smooth_step(values[:, 1], ROW, WIDE)
        sheet *= 1 - _smooth_step(values[:, 0], 0.0, TWO_LAYERS)
        full = FACE + (EDGE - FACE) * edge
        target = full + sheet * (np.minimum(in_sheet, FACE) - full)
        weight[rows] = mass * (1 + few * np.maximum(target / field - 1, 0))
    return SurfaceKernels(G, weight)


def _smooth_step(x: np.ndarray, low: float, high: float) -> np.ndarray:
    t = np.clip((x - low) / (high - low), 0, 1)
    return t * t * (3 - 2 * t)


def _kernels(covariance: np.ndarray, most_stretch: float) -> np.ndarray:
    """R diag(1 / s̃) Rᵀ of covariances (M, 3, 3), which are 1 where the neighbors lie evenly."""
    values, axes = np.linalg.eigh(covariance)  # ascending; the SVD of a symmetric matrix
    # Neighbors that all are at one place have no extent at all; G must stay finite.
    largest = np.maximum(values[:, 2:], 1e-6)
    stretched = np.maximum(values, largest / most_stretch)
    return np.einsum("mik,mk,mjk->mij", axes, 1 / stretched, axes)


def _moments(
    positions: np.ndarray, rows: np.ndarray, offsets: np.ndarray, index: np.ndarray, radius: float, power: int = 3
) -> tuple[np.ndarray, np.ndarray]:
    """Weighted mean (M, 3), from each particle, and covariance (M, 3, 3) of its neighbors."""
    own = np.repeat(positions[rows], np.diff(offsets), axis=0).astype(np.float64)
    d = positions[index] - own
    w = np.maximum(1 - (np.sqrt(np.einsum("ij,ij->i", d, d)) / radius) ** power, 0)
    starts = offsets[:-1]  # no row is empty: each particle is its own neighbor
    total = np.add.reduceat(w, starts)
    mean = np.add.reduceat(w[:, None] * d, starts) / total[:, None]
    covariance = np.empty((len(rows), 3, 3))
    for i in range(3):
        for j in range(i, 3):
            second = np.add.reduceat(w * d[:, i] * d[:, j], starts) / total
            covariance[:, i, j] = covariance[:, j, i] = second - mean[:, i] * mean[:, j]
    return mean, covariance


def _neighbor_blocks(
    scene: SceneBase, positions: np.ndarray, radius: float, progress: Callable[[int, int], object] | None
) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """The neighbors of the particles with finite positions, as many rows at a time as fit.

    Yields rows (M,), offsets (M + 1,) and indices, each row holding the particle itself.
    """
    inside = np.flatnonzero((np.abs(positions) <= FARTHEST).all(axis=1))
    begin, size = 0, 256
    while begin < len(inside):
        rows = inside[begin : begin + size]
        offsets, index = scene.neighbors(positions[rows], radius)
        yield rows, offsets.astype(np.int64), index
        begin += size
        if progress:
            progress(min(begin, len(inside)), len(inside))
        # The next block by this one's neighbors, growing slowly: the density may change.
        size = min(4 * size, max(1, BLOCK_PAIRS * len(rows) // max(1, len(index))))
