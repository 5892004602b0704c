"""A volume's iso-surface as metaballs: one particle a voxel, no mesh in between."""

from __future__ import annotations

import math
import os
from typing import NamedTuple

import numpy as np

from .._base.checks import choice, number
from ..data.particles import Particles
from ..pieces.scene import Scene
from ..render.camera import Camera
from ..render.render import render
from ..scene.scene import KERNELS
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
MOST_PARTICLES = 50_000_000
_SAMPLE = 2_000_000  # values that stand for all where percentiles and the level are looked for
_MIDDLE = (0.1, 99.9)  # percentiles between which Otsu's bins lie
_REACH = 3  # voxels around the inside that can still touch the surface


class IsoSurface(NamedTuple):
    """Particles with weights, the scene's threshold for the surface value = level, and the
    level."""

    particles: Particles
    threshold: float
    level: float


def extract_iso_surface(volume: Volume, level: float | None = None, kernel: str = "murakami") -> IsoSurface:
    """Particles whose field is the threshold where the volume, smoothed by the kernel, is `level`.

    Every voxel is a particle of weight value / level; a lattice of unit weights has the field
    `threshold` everywhere inside, and the field is therefore threshold · (local mean value) /
    level. If values are negative, value and level count from the lowest value. The function omits
    empty voxels, and voxels that are too far from any value >= level to matter.

    Args:
        volume: a volume that is not constant.
        level: iso-value, in the units of the volume's values; default: `default_level(volume)`.
        kernel: one of `globule.scene.scene.KERNELS`.

    Returns:
        IsoSurface; positions in mm in the volume's world, attribute `value` (N,) float32.

    Raises ValueError if no value reaches the level, for voxels whose edges differ more than 30
    times, and for more than 50 million particles.
    """
    choice("kernel", kernel, KERNELS)
    level = default_level(volume) if level is None else number("level", level)
    lowest, known = _known(volume)
    if not level > lowest:
        raise ValueError(f"level: expected a number above {lowest:g}, got {level:g}")
    near = volume.values >= level
    if not near.any():
        most = float(volume.values.max())
        raise ValueError(f"level: expected at most the highest value, {most:g}, got {level:g}")
    for axis in range(3):
        near = _dilated(near, axis)
    near &= known
    edges = volume.spacing
    if not (np.isfinite(edges).all() and 0 < edges.max() <= _MOST_RATIO * edges.min()):
        got = " x ".join(f"{edge:g}" for edge in edges)
        raise ValueError(f"spacing: expected edges within a factor of {_MOST_RATIO}, got {got} mm")
    check_count(volume, int(np.count_nonzero(near)))
    index = np.argwhere(near)
    values = volume.values[tuple(index.T)].astype(np.float32)
    matrix = volume.world_from_voxel
    positions = index[:, ::-1] @ matrix[:3, :3].T + matrix[:3, 3]
    support = VOXELS[kernel] * float(edges.max())
    particles = Particles(
        positions, support=support, weight=(values - lowest) / np.float32(level - lowest),
        attributes={"value": values},
    )  # fmt: skip
    return IsoSurface(particles, _lattice_field(volume, support, kernel), level)


def default_level(volume: Volume) -> float:
    """The default iso-value: Otsu's level of the measured values above the background.

    The background is 0, or the lowest value if this value is negative. If all other values are
    equal, as in a mask, the level lies halfway. Raises ValueError for a volume of one value.
    """
    lowest, known = _known(volume)
    values = volume.values[known]
    if not values.size:
        raise ValueError("level: expected different values, got one only in the volume")
    low, high = float(values.min()), float(values.max())
    return otsu(values) if low < high else (lowest + high) / 2


def check_count(volume: Volume, n: int) -> None:
    """Refuse more than MOST_PARTICLES particles of a volume, and name a spacing that would do."""
    if n > MOST_PARTICLES:
        edge = 1.05 * math.prod(volume.spacing) ** (1 / 3) * (n / MOST_PARTICLES) ** (1 / 3)
        raise ValueError(
            f"volume: expected at most {MOST_PARTICLES:,} voxels to show, got {n:,}; resample to {edge:.3g} mm"
        )


def _known(volume: Volume) -> tuple[float, np.ndarray]:
    """The background's value, and where there is something else."""
    lowest = min(0.0, float(volume.values.min()))
    return lowest, ~volume.empty & (volume.values > lowest)


def save_surface(
    path: str | os.PathLike[str], volume: Volume, level: float | None = None, device: str = "auto",
    threads: int = 0, size: tuple[int, int] = (1024, 782),
) -> None:  # fmt: skip
    """Draw the iso-surface, seen whole, as a picture. Raises ValueError as `iso_surface` does."""
    particles, threshold, _ = extract_iso_surface(volume, level)
    scene = Scene(particles, threshold=threshold, device=device, threads=threads)
    margin = float(np.max(particles.support))
    render(scene, Camera.fit(particles, size=size, margin=margin), size).save(path)


def otsu(values: np.ndarray) -> float:
    """The level that splits values into two classes of least variance (Otsu 1979), of 256 bins.

    Args:
        values: numbers of any shape. NaN and infinite ones are left out; of more than two million,
            a part evenly taken stands for all.

    Returns:
        The lowest value of the upper class; the value itself where all are equal. Raises ValueError
        where no value is finite.
    """
    sample = evenly(values)
    if not sample.size:
        raise ValueError("values: expected finite numbers, got none")
    low, high = np.percentile(sample, _MIDDLE)  # a few bright voxels must not stretch the bins
    if not low < high:
        low, high = sample.min(), sample.max()
    if not low < high:
        return float(low)
    count, ends = np.histogram(np.clip(sample, low, high), 256, (low, high))
    middle = (ends[1:] + ends[:-1]) / 2
    below, above = np.cumsum(count)[:-1], np.cumsum(count[::-1])[-2::-1]
    mass = count * middle
    with np.errstate(invalid="ignore", divide="ignore"):
        mean_below = np.cumsum(mass)[:-1] / below
        mean_above = np.cumsum(mass[::-1])[-2::-1] / above
        between = below * above * (mean_above - mean_below) ** 2
    return float(ends[1 + np.nanargmax(between)])


def evenly(values: np.ndarray) -> np.ndarray:
    """Finite values, float64, at most about two million of them, evenly taken."""
    flat = values.reshape(-1)
    sample = flat[:: 1 + len(flat) // _SAMPLE].astype(np.float64)
    return sample[np.isfinite(sample)]


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
    return float(scene.field(inside).mean())
