"""A volume's iso-surface as metaballs: one particle a voxel, no mesh in between."""

from __future__ import annotations

import os
from typing import NamedTuple

import numpy as np

from ..render.camera import Camera
from ..render.frame import render
from ..scene.particles import Particles
from ..scene.query import field
from ..scene.scene import KERNELS, Scene
from .volume import Volume

# Supports in voxels at which a lattice's field is nearly even, so that the normals show the lattice
# least (measured on a ball, docs/measured.md); a scene's default supports suit free particles.
VOXELS = {
    "murakami": 2.2,
    "nishimura": 3.1,
    "wyvill": 2.25,
    "blinn": 3.5,
    "cubic_spline": 2.9,
    "wendland_c2": 3.0,
    "solid": 2.6,
}
_MOST_RATIO = 30  # of a voxel's longest edge to its shortest
_REACH = 3  # voxels around the inside that can still touch the surface


class IsoSurface(NamedTuple):
    """particles with weights, the scene's threshold at which they show value = level, the level."""

    particles: Particles
    threshold: float
    level: float


def iso_surface(volume: Volume, level: float | None = None, kernel: str = "murakami") -> IsoSurface:
    """Particles whose field is the threshold where the volume, smoothed by the kernel, is `level`.

    Every voxel is a particle of weight value / level; a lattice of unit weights has the field
    `threshold` everywhere inside, so that the field is threshold · (mean value around) / level.
    Where values are negative, value and level count from the lowest. Voxels too far from any
    value >= level to matter are left out, and empty ones.

    Args:
        volume: with different values somewhere.
        level: default: Otsu's, which splits the values best into two.
        kernel: one of `globule.scene.KERNELS`.

    Raises ValueError if no value reaches the level.
    """
    if kernel not in KERNELS:
        raise ValueError(f"kernel: expected one of {', '.join(KERNELS)}, got {kernel!r}")
    lowest = min(0.0, float(volume.values.min()))
    known = ~volume.empty & (volume.values > lowest)
    if level is None:
        level = otsu(volume.values[known])
    if not level > lowest:
        raise ValueError(f"level: expected a number above {lowest:g}, got {level:g}")
    near = volume.values >= level
    if not near.any():
        most = float(volume.values.max())
        raise ValueError(f"level: expected at most the highest value, {most:g}, got {level:g}")
    for axis in range(3):
        near = _dilated(near, axis)
    edges = volume.spacing
    if not (np.isfinite(edges).all() and 0 < edges.max() <= _MOST_RATIO * edges.min()):
        got = " x ".join(f"{edge:g}" for edge in edges)
        raise ValueError(f"spacing: expected edges within a factor of {_MOST_RATIO}, got {got} mm")
    index = np.argwhere(near & known)
    values = volume.values[tuple(index.T)].astype(np.float32)
    matrix = volume.world_from_voxel
    positions = index[:, ::-1] @ matrix[:3, :3].T + matrix[:3, 3]
    spacing = float(volume.spacing.max())
    support = VOXELS[kernel] * spacing
    particles = Particles(
        positions, support=support, weight=(values - lowest) / np.float32(level - lowest),
        attributes={"value": values},
    )  # fmt: skip
    return IsoSurface(particles, _lattice_field(volume, support, kernel), float(level))


def save_surface(
    path: str | os.PathLike, volume: Volume, level: float | None = None, device: str = "auto",
    threads: int = 0, size: tuple[int, int] = (1024, 782),
) -> None:  # fmt: skip
    """Draw the iso-surface, seen whole, as a picture. Raises ValueError as `iso_surface` does."""
    particles, threshold, _ = iso_surface(volume, level)
    scene = Scene(particles, threshold=threshold, device=device, threads=threads)
    margin = float(np.max(particles.support))
    render(scene, Camera.fit(particles, size=size, margin=margin), size).save(path)


def otsu(values: np.ndarray) -> float:
    """The level that splits values into two groups with the largest variance between them."""
    if values.size == 0:
        raise ValueError("level: expected different values, got one only in the volume")
    counts, edges = np.histogram(values, 256)
    middles = (edges[:-1] + edges[1:]) / 2
    below, total = np.cumsum(counts), counts.sum()
    sums = np.cumsum(counts * middles)
    with np.errstate(invalid="ignore", divide="ignore"):
        split = (sums[-1] * below / total - sums) ** 2 / (below * (total - below))
    return float(edges[int(np.nanargmax(np.where(np.isfinite(split), split, -1))) + 1])


def _dilated(mask: np.ndarray, axis: int) -> np.ndarray:
    """The mask and what lies within reach along an axis."""
    grown = mask.copy()
    for step in range(1, _REACH + 1):
        ahead = [slice(None)] * 3
        behind = [slice(None)] * 3
        ahead[axis], behind[axis] = slice(step, None), slice(None, -step)
        grown[tuple(ahead)] |= mask[tuple(behind)]
        grown[tuple(behind)] |= mask[tuple(ahead)]
    return grown


def _lattice_field(volume: Volume, support: float, kernel: str) -> float:
    """The mean field inside a lattice of the volume's voxels with unit weights."""
    reach = np.ceil(support / volume.spacing).astype(int) + 1
    axes = [np.arange(-r, r + 2) for r in reach]
    index = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    steps = volume.world_from_voxel[:3, :3].T
    scene = Scene(Particles(index @ steps, support=support), kernel, device="cpu")
    inside = (np.stack(np.meshgrid(*[np.arange(6) / 6] * 3), axis=-1).reshape(-1, 3)) @ steps
    return float(field(scene, inside).mean())
