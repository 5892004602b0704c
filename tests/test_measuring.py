"""Distances and volumes with their uncertainty: against a Monte Carlo, on maps and on sweeps."""

from __future__ import annotations

import globule as gb
import numpy as np
import pytest
from globule.ultrasound import phantoms
from globule.ultrasound.measuring import (
    _variance,
    error_length,
    measure_distance,
    measure_volume,
)
from globule.volumes.volume import FAR

RADIUS = 6.0
SPACING = 0.8


def ball(points: np.ndarray) -> np.ndarray:
    """A dark ball with an edge of 1 mm in bright tissue."""
    r = np.linalg.norm(points - [0, 14, 0], axis=-1)
    return 60 + 80 / (1 + np.exp(-(r - RADIUS) / 0.5))


def known(values: np.ndarray, error: np.ndarray, radius=None) -> gb.Volume:
    place = np.diag([SPACING, SPACING, SPACING, 1.0])
    place[:3, 3] = -10, 4, -10
    return gb.Volume(values.astype(np.float32), place, radius, maps=lambda name: error)


def grid() -> np.ndarray:
    axis = SPACING * np.arange(26)
    z, y, x = np.meshgrid(axis, axis, axis, indexing="ij")
    return np.stack([x - 10, y + 4, z - 10], axis=-1)


def test_variance_of_a_cell_is_that_of_its_pairs():
    rng = np.random.default_rng(0)
    p, cells = rng.random(60), rng.integers(0, 7, 60)
    want = sum(
        np.minimum.outer(p[cells == c], p[cells == c]).sum() - p[cells == c].sum() ** 2
        for c in range(7)
    )
    assert _variance(p, cells) == pytest.approx(want)


def test_against_errors_of_a_known_kind():
    """120 volumes whose errors are equal in cubes of 2 voxels, and independent between them."""
    rng = np.random.default_rng(1)
    truth, sigma = ball(grid()), 10.0
    volumes, distances = [], []
    for _ in range(120):
        cubes = rng.normal(0, sigma, (13, 13, 13))
        noisy = truth + np.kron(cubes, np.ones((2, 2, 2)))
        volume = known(noisy, np.full(truth.shape, sigma, np.float32))
        near = {"center": (0, 14, 0), "radius": 8.5}
        volumes.append(measure_volume(volume, 2 * SPACING, below=100, **near))
        distances.append(measure_distance(volume, (-9, 14, 0.1), (9, 14, 0.1), 2 * SPACING))
    found = np.array([v.volume for v in volumes])
    # Voxels far from the edge flip less often than their noisy values say: never too small.
    assert 0.9 < np.mean([v.std for v in volumes]) / found.std() < 1.5
    found = np.array([d.distance for d in distances])
    assert np.mean([d.std for d in distances]) == pytest.approx(found.std(), rel=0.25)
    assert found.mean() == pytest.approx(2 * RADIUS, abs=0.1)


def scanned(seed: int) -> gb.Sweep:
    """A pass over the ball, with noise of its own in every pixel and a path of its own."""
    size, pixel = (56, 64), 0.4
    poses = phantoms.hand_path(22, 19.0, seed, pixel, size)
    columns, rows = np.meshgrid(np.arange(size[0]), np.arange(size[1]))
    pixels = np.stack([columns, rows, 0 * rows, 0 * rows + 1], axis=-1)
    frames = np.stack([ball((pixels @ pose.T)[..., :3]) for pose in poses])
    frames += np.random.default_rng(seed).normal(0, 18, frames.shape)
    return gb.Sweep(frames.clip(0, 255).astype(np.uint8), poses)


def test_against_many_sweeps():
    """What the trust map predicts holds what 16 sweeps of the phantom show, and is not far
    above."""
    volumes, distances = [], []
    for seed in range(16):
        sweep = scanned(seed)
        volume = gb.reconstruct(sweep, spacing=SPACING, device="cpu")
        length = error_length(sweep, SPACING)
        assert SPACING <= length <= 2
        options = {"below": 100.0, "center": (0, 14, 0), "radius": 8.5}
        volumes.append(measure_volume(volume, length, **options))
        distances.append(measure_distance(volume, (0, 5, 0), (0, 23, 0), length, width=2))
    for results, name, truth in (
        (volumes, "volume", 4 / 3 * np.pi * RADIUS**3),
        (distances, "distance", 2 * RADIUS),
    ):
        found = np.array([getattr(r, name) for r in results])
        predicted = np.mean([r.std for r in results])
        print(name, found.mean(), truth, "seen", found.std(), "predicted", predicted)
        seen = found.std(ddof=1)
        assert 0.8 * seen < predicted < 4 * seen
        assert abs(found.mean() - truth) < 0.03 * truth


def test_parts_without_data_are_told():
    truth = ball(grid())
    radius = np.zeros(truth.shape, np.uint8)
    radius[:13] = FAR
    volume = known(truth, np.full(truth.shape, 5, np.float32), radius)
    found = measure_volume(volume, 1.0, below=100, center=(0, 14, 0), radius=7)
    assert found.unknown == pytest.approx(4 / 3 * np.pi * 7**3 / 2, rel=0.1)
    assert found.measured == 1
    with pytest.raises(ValueError, match=r"^start: expected data along the line, got an empty"):
        measure_distance(volume, (0, 14, -9), (0, 14, 9), 1.0)


def test_mistakes():
    volume = known(np.full((26, 26, 26), 50.0), np.full((26, 26, 26), 5, np.float32))
    with pytest.raises(ValueError, match=r"^above: expected one of above and below"):
        measure_volume(volume, 1.0)
    with pytest.raises(ValueError, match=r"^correlation: "):
        measure_volume(volume, 0.0, above=3)
    with pytest.raises(ValueError, match="crosses two clear edges"):
        measure_distance(volume, (-8, 14, 0), (8, 14, 0), 1.0)
    with pytest.raises(ValueError, match=r"^end: expected a line of"):
        measure_distance(volume, (0, 14, 0), (1, 14, 0), 1.0)
