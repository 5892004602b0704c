"""Stray particles and anisotropic kernels, against lattices, symmetry and a plain double loop."""

import globule as gb
import numpy as np
import pytest
from globule.fluids import smoothing
from globule.fluids.smoothing import find_anisotropy, remove_strays


def lattice(*shape: int) -> np.ndarray:
    return np.stack(np.mgrid[tuple(slice(n) for n in shape)], axis=-1).reshape(-1, 3).astype("f4")


def at(points: np.ndarray, place) -> int:
    return int(np.abs(points - np.array(place)).sum(axis=1).argmin())


def test_strays_are_left_out():
    block = lattice(6, 6, 6)
    alone, pair = [[20, 0, 0]], [[0, 20, 0], [0.5, 20, 0]]
    points = np.concatenate([block, alone, pair, [[np.nan, 0, 0], [np.inf, 0, 0]]]).astype("f4")
    particles = gb.Particles(points, attributes={"id": np.arange(len(points))})
    scene = gb.Scene(particles, device="cpu")
    for where in (scene, 2.0):
        assert np.array_equal(remove_strays(particles, where).positions, block)
        kept = remove_strays(particles, where, min_neighbors=1)
        assert list(kept.attributes["id"]) == [*range(216), 217, 218]
    assert len(remove_strays(particles, 2.0, 0)) == 219
    # Of nothing, and mistakes.
    for points in (np.zeros((0, 3)), np.full((4, 3), np.nan)):
        assert len(remove_strays(gb.Particles(points), 1.0)) == 0
    with pytest.raises(ValueError, match="radius: expected a positive number"):
        remove_strays(gb.Particles(lattice(2, 2, 2)), -1)
    with pytest.raises(ValueError, match="min_neighbors"):
        remove_strays(gb.Particles(lattice(2, 2, 2)), 1, -1)
    with pytest.raises(ValueError, match="scene: expected 8 particles, got 1"):
        remove_strays(gb.Particles(lattice(2, 2, 2)), gb.Scene(np.zeros((1, 3)), device="cpu"))


@pytest.mark.parametrize(("place", "others"), [((3, 3, 3), 32), ((3, 3, 0), 22), ((3, 0, 0), 15)])
def test_neighbors_of_a_lattice(place, others):
    """The numbers in the docstring."""
    particles = gb.Particles(lattice(7, 7, 7))
    scene = gb.Scene(particles, device="cpu")
    for n, found in ((others, True), (others + 1, False)):
        kept = remove_strays(particles, scene, n).positions
        assert (kept == np.array(place)).all(axis=1).any() == found


def test_kernels_are_round_inside_stretched_in_a_sheet_and_small_of_few():
    points = lattice(9, 9, 9)
    found, middle = find_anisotropy(points, support=2.0), at(points, (4, 4, 4))
    assert np.allclose(found.G[middle], np.eye(3) / 2, atol=0.01)
    assert np.allclose(found.centers[middle], points[middle], atol=1e-6)
    sheet = lattice(15, 15, 1)
    middle = at(sheet, (7, 7, 0))
    for stretch in (1.0, 4.0, 9.0):
        values = np.linalg.eigvalsh(find_anisotropy(sheet, 2.0, most_stretch=stretch).G[middle])
        assert values[2] / values[0] == pytest.approx(stretch, rel=1e-3)
    points = np.concatenate([lattice(9, 9, 9), [[50, 0, 0], [np.nan, 0, 0]]]).astype("f4")
    found = find_anisotropy(points, support=2.0, few_size=0.25)
    assert np.allclose(found.G[-2:], 2 * np.eye(3))
    assert np.array_equal(found.centers[-2:], points[-2:], equal_nan=True)
    assert np.isfinite(found.G).all()
    assert np.isfinite(find_anisotropy(np.zeros((40, 3)), support=2.0).G).all()
    found = find_anisotropy(np.zeros((0, 3)), 1.0)
    assert (found.G.shape, found.centers.shape) == ((0, 3, 3), (0, 3))


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e4])
def test_at_a_face_kernels_are_flat(scale):
    points = lattice(9, 9, 9) * np.float32(scale)
    found = find_anisotropy(points, support=2.0 * scale)
    face = at(points, (4 * scale, 4 * scale, 8 * scale))
    axes = 1 / np.diag(found.G[face]) / (2 * scale)  # by the support
    assert axes[2] < 0.5
    assert axes[:2] == pytest.approx(1, abs=0.1)
    assert np.allclose(found.G[face], np.diag(np.diag(found.G[face])), atol=1e-4 / scale)
    assert found.centers[face, 2] < points[face, 2]  # inwards
    assert np.array_equal(find_anisotropy(points, support=2.0 * scale, smoothing=0).centers, points)


def test_against_a_double_loop(monkeypatch):
    points = np.random.default_rng(5).random((300, 3)).astype("f4")
    expected_G, expected_centers = np.empty((300, 3, 3)), np.empty((300, 3))
    h, radius = 0.12, 0.3
    for i, x in enumerate(points.astype(float)):
        apart = np.linalg.norm(points - x, axis=1)
        near = apart <= radius
        w = 1 - (apart[near] / radius) ** 3
        mean = (w[:, None] * points[near]).sum(axis=0) / w.sum()
        d = points[near] - mean
        R, s, _ = np.linalg.svd(np.einsum("j,ja,jb->ab", w, d, d) / w.sum() / (0.15 * radius**2))
        s = np.maximum(s, s[0] / 4)
        expected_G[i] = R @ np.diag(1 / s) @ R.T / h if near.sum() - 1 > 25 else np.eye(3) / h / 0.5
        expected_centers[i] = 0.1 * x + 0.9 * mean
    monkeypatch.setattr(smoothing, "BLOCK_PAIRS", 500)  # many blocks
    found = find_anisotropy(points, support=h, radius=radius)
    assert np.allclose(found.G, expected_G, rtol=1e-3, atol=1e-3)
    assert np.allclose(found.centers, expected_centers, atol=1e-5)


@pytest.mark.parametrize(("options", "what"), [
    ({}, "support: expected one number"), ({"support": 0}, "support: expected a positive number"),
    ({"support": 1, "radius": np.nan}, "radius: expected a positive number"),
    ({"support": 1, "smoothing": 2}, "smoothing: expected 0 to 1"),
    ({"support": 1, "most_stretch": 0.5}, "most_stretch: expected a number >= 1"),
    ({"support": 1, "few_size": 0}, "few_size: expected a positive number"),
])  # fmt: skip
def test_wrong_arguments(options, what):
    with pytest.raises(ValueError, match=what):
        find_anisotropy(lattice(2, 2, 2), **options)
