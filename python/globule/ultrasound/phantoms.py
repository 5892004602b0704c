"""Simulated tracked sweeps over phantoms whose truth is known.

A freehand sweep is a hand-like path of a probe over a phantom; each frame shows the phantom's
echogenicity times speckle that is fixed in space. The recorded poses carry noise; the images are
taken at the true ones. The same arguments give the same bytes.

The world: x across the probe, y away from it, z along the path; mm; the middle of the phantom is at
x = 0, z = 0 and the skin at y = 0.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from ..volumes.slices import sample
from .calibration import turn_by
from .sweep import Sweep

SIZE = (387, 400)  # columns and rows of the source's frames
SPACING = 0.12  # mm per pixel
_TEXTURE = 128  # side of the speckle's texture, cells
_CELL = 0.12  # mm; a speckle is about three cells
_RATE = 25.0  # frames per second

Echo = Callable[[np.ndarray], np.ndarray]  # (..., 3) mm to echogenicity in [0, 1]


def cylinders(
    diameter: float = 3.0, n_frames: int | None = None, separation: float = 12.6, seed: int = 0, **options: Any
) -> Sweep:
    """Three dark cylinders along z, `diameter` mm thick, their axes `separation` mm apart along x.

    Like the rods of the source's phantom (CIRS 044): 66 frames for those of 1.5 mm, 51 for 3 mm.
    Axes are at y = 24 mm, x = -separation, 0, separation. Options are those of `scan`.
    """
    if not 0 < diameter < separation:
        expected = f"0 < diameter < separation = {separation:g}"
        raise ValueError(f"diameter: expected {expected}, got {diameter:g}")
    n_frames = n_frames or (66 if diameter < 2 else 51)

    def echo(points: np.ndarray) -> np.ndarray:
        x, y = points[..., 0], points[..., 1] - 24.0
        nearest = np.clip(np.rint(x / separation), -1, 1) * separation
        inside = (x - nearest) ** 2 + y**2 < (diameter / 2) ** 2
        return np.where(inside, np.float32(0.08), np.float32(0.6))

    return scan(echo, n_frames, seed=seed, **options)


def breast(n_frames: int = 131, seed: int = 0, **options: Any) -> Sweep:
    """A breast-like phantom: skin, fat lobules, glandular tissue and a dark lesion of 9 mm at
    (4, 22, 0) with a brighter rim. Options are those of `scan`."""
    fat, corner, step = _lobules(seed)
    middle, axes = np.array([4, 22, 0], np.float32), np.array([1, 0.8, 1], np.float32)

    def echo(points: np.ndarray) -> np.ndarray:
        p = points.astype(np.float32)
        cells = np.clip(np.rint((p - corner) / step).astype(np.int32), 0, np.array(fat.shape) - 1)
        value = np.where(fat[cells[..., 0], cells[..., 1], cells[..., 2]], 0.38, 0.62)
        value[p[..., 1] < 2] = 0.85
        lesion = np.sqrt((((p - middle) / axes) ** 2).sum(-1))
        value[lesion < 5.2] = 0.75
        value[lesion < 4.5] = 0.12
        return value

    return scan(echo, n_frames, seed=seed, **options)


def _lobules(seed: int) -> tuple[np.ndarray, np.ndarray, Any]:
    """Balls of fat in a grid (x, y, z) of bool, the place of its first cell and the cells' size."""
    rng = np.random.default_rng((seed, 1))
    corner, step = np.array([-30, -4, -36], np.float32), np.float32(0.4)
    fat = np.zeros((150, 140, 180), bool)
    for _ in range(60):
        center, radius = rng.uniform((-26, 6, -32), (26, 44, 32)), rng.uniform(3, 7)
        middle, reach = (center - corner) / step, radius / step
        low, high = np.floor(middle - reach).astype(int), np.ceil(middle + reach).astype(int) + 1
        low, high = np.maximum(low, 0), np.minimum(high, fat.shape)
        x, y, z = (np.arange(a, b) - m for a, b, m in zip(low, high, middle, strict=True))
        ball = x[:, None, None] ** 2 + y[:, None] ** 2 + z**2 < reach**2
        fat[low[0] : high[0], low[1] : high[1], low[2] : high[2]] |= ball
    return fat, corner, step


def scan_volume(values: Any, world_from_voxel: Any, world_from_image: Any, size: tuple[int, int]) -> np.ndarray:
    """Frames (F, rows, columns) float32 of any volume along any path, 0 outside; trilinear.

    values (Z, Y, X); world_from_voxel (4, 4); world_from_image (F, 4, 4), mm; size columns, rows.
    """
    values = np.asarray(values)
    voxel_from_image = np.linalg.inv(world_from_voxel) @ np.asarray(world_from_image, np.float64)
    measured = np.zeros(values.shape, np.uint8)  # all of it
    frames = np.empty((len(voxel_from_image), size[1], size[0]), np.float32)
    for frame, matrix in zip(frames, voxel_from_image, strict=True):
        frame[:] = sample(values, measured, _pixels(matrix, size), True)[0]
    return frames


def hand_path(
    n_frames: int, length: float, seed: int = 0, spacing: float = SPACING,
    size: tuple[int, int] = SIZE,
) -> np.ndarray:  # fmt: skip
    """Poses of a probe moved by hand along z: world_from_image (F, 4, 4), mm.

    The speed varies by a third, the probe sways by about 0.7 mm and tilts by about 2 degrees, all
    smoothly.
    """
    if n_frames < 2:
        raise ValueError(f"n_frames: expected at least 2, got {n_frames}")
    rng = np.random.default_rng((seed, 2))
    s = np.linspace(0, 1, n_frames)
    wave = [_smooth(rng, s) for _ in range(6)]
    advance = np.cumsum(1 + 0.33 * _smooth(rng, s))
    advance = (advance - advance[0]) / (advance[-1] - advance[0]) - 0.5
    poses = np.tile(np.eye(4), (n_frames, 1, 1))
    half = (size[0] - 1) / 2 * spacing
    for i in range(n_frames):
        sway = 0.7 * np.array([wave[0][i], 0.5 * wave[1][i], 0.2 * wave[2][i]])
        turn = turn_by(np.radians(2.0) * np.array([w[i] for w in wave[3:]]))
        poses[i, :3, :3] = turn * spacing
        poses[i, :3, 3] = turn @ [-half, 0, 0] + sway + [0, 0, length * advance[i]]
    return poses


def scan(
    echo: Echo,
    n_frames: int,
    seed: int = 0,
    length: float | None = None,
    size: tuple[int, int] = SIZE,
    spacing: float = SPACING,
    speckle: float = 1.0,
    pose_noise: tuple[float, float] = (0.0, 0.0),
    gaps: float = 0.0,
) -> Sweep:
    """Scan what an echo function describes.

    Args:
        echo: (..., 3) mm, world, to echogenicity in [0, 1].
        n_frames: frames of the sweep, gaps included.
        seed: for path, speckle, noise and gaps.
        length: mm along z; default: 0.4 mm a frame.
        size: columns and rows.
        spacing: mm per pixel.
        speckle: 0 for none, 1 for Rayleigh-distributed (fully developed).
        pose_noise: standard deviations of the recorded poses, mm and degrees.
        gaps: share of frames whose pose the tracker lost (not valid).
    """
    if not 0 <= gaps < 1:
        raise ValueError(f"gaps: expected 0 to below 1, got {gaps}")
    length = 0.4 * n_frames if length is None else length
    truth = hand_path(n_frames, length, seed, spacing, size)
    texture = _texture(seed)
    frames = np.empty((n_frames, size[1], size[0]), np.uint8)
    for frame, matrix in zip(frames, truth, strict=True):
        points = _pixels(matrix, size)
        cells = np.floor(points / _CELL).astype(np.int64) % _TEXTURE
        shade = 1 + speckle * (texture[tuple(cells[..., axis] for axis in range(3))] - 1)
        frame[:] = np.clip(255 * 0.55 * echo(points) * shade, 0, 255)
    rng = np.random.default_rng((seed, 3))
    recorded = truth.copy()
    for matrix in recorded:  # about the middle of the probe's face, where a tracker sits
        shift = rng.normal(0, 1, 3) * pose_noise[0]
        turn = turn_by(np.radians(rng.normal(0, 1, 3) * pose_noise[1]))
        pivot = matrix[:3, :2] @ [(size[0] - 1) / 2, 0] + matrix[:3, 3]
        matrix[:3, :3] = turn @ matrix[:3, :3]
        matrix[:3, 3] = turn @ (matrix[:3, 3] - pivot) + pivot + shift
    valid = rng.random(n_frames) >= gaps
    valid[[0, -1]] = True
    recorded[~valid] = np.nan
    return Sweep(frames, recorded, np.arange(n_frames) / _RATE, valid)


def _pixels(matrix: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """Where the pixels of a frame lie: (rows, columns, 3)."""
    columns, rows = np.arange(size[0]), np.arange(size[1])
    return matrix[:3, 0] * columns[None, :, None] + matrix[:3, 1] * rows[:, None, None] + matrix[:3, 3]


def _smooth(rng: np.random.Generator, s: np.ndarray) -> np.ndarray:
    """A smooth random function on [0, 1], about 1 in size."""
    phases, sizes = rng.uniform(0, 2 * np.pi, 3), rng.uniform(0.4, 1.0, 3)
    waves = [sizes[k] / (k + 1) * np.sin(2 * np.pi * (k + 1) * s + phases[k]) for k in range(3)]
    return np.sum(waves, axis=0)


def _texture(seed: int) -> np.ndarray:
    """Speckle (n, n, n) of mean 1, Rayleigh-distributed, about three cells wide; it tiles space."""
    rng = np.random.default_rng((seed, 4))
    real, imaginary = rng.normal(size=(2, _TEXTURE, _TEXTURE, _TEXTURE))
    for axis in range(3):
        for shift in (1, 2):
            real = real + 0.8 * np.roll(real, shift, axis)
            imaginary = imaginary + 0.8 * np.roll(imaginary, shift, axis)
    amplitude = np.hypot(real, imaginary)
    return (amplitude / amplitude.mean()).astype(np.float32)
