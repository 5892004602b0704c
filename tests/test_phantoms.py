"""Simulated sweeps: the truth is where it is said to be, and the same seed gives the same bytes."""

import hashlib

import numpy as np
import pytest
from globule.ultrasound import phantoms


def digest(sweep) -> str:
    parts = (sweep.frames, sweep.world_from_image, sweep.valid, sweep.timestamps)
    return hashlib.sha256(b"".join(part.tobytes() for part in parts)).hexdigest()


@pytest.mark.slow
def test_the_same_seed_gives_the_same_bytes():
    options = {"n_frames": 6, "size": (40, 50), "pose_noise": (0.1, 0.2), "gaps": 0.3}
    for make in (phantoms.cylinders, phantoms.breast):
        assert digest(make(seed=4, **options)) == digest(make(seed=4, **options))
        assert digest(make(seed=4, **options)) != digest(make(seed=5, **options))


@pytest.mark.slow
@pytest.mark.parametrize(("diameter", "n_frames"), [(1.5, 66), (3.0, 51)])
def test_cylinders_are_as_thick_and_as_far_apart_as_asked(diameter, n_frames):
    sweep = phantoms.cylinders(diameter, speckle=0.0)
    assert sweep.frames.shape == (n_frames, 400, 387)
    assert sweep.valid.all()
    i = n_frames // 2
    dark = np.argwhere(sweep.frames[i] < 40)
    world = sweep.world_from_image[i] @ np.stack([dark[:, 1], dark[:, 0], np.zeros(len(dark)), np.ones(len(dark))])
    nearest = np.rint(world[0] / 12.6)
    assert set(nearest) == {-1, 0, 1}
    for k in (-1, 0, 1):
        x, y, _, _ = world[:, nearest == k]
        assert (x.mean(), y.mean()) == (pytest.approx(12.6 * k, abs=0.05), pytest.approx(24, abs=0.05))
        assert 2 * np.sqrt(len(x) * np.prod(sweep.spacing) / np.pi) == pytest.approx(diameter, rel=0.03)


@pytest.mark.slow
def test_breast_has_its_lesion():
    sweep = phantoms.breast(n_frames=9, length=2.0)
    assert phantoms.breast.__defaults__[0] == 131
    column, row = np.rint(np.linalg.solve(sweep.world_from_image[4], [4, 22, 0, 1])[:2]).astype(int)
    inside = sweep.frames[4][row - 15 : row + 15, column - 15 : column + 15]
    assert inside.mean() < 0.4 * sweep.frames[4].mean()


def test_speckle_is_fixed_in_space_noise_is_of_poses_and_any_volume_is_scanned():
    def flat(points):
        return np.full(points.shape[:-1], 0.3)

    sweep = phantoms.scan(flat, 2, length=0.0, size=(200, 200))
    values = sweep.frames[0].astype(float)
    assert values.std() / values.mean() == pytest.approx(np.sqrt(4 / np.pi - 1), rel=0.1)
    assert phantoms.scan(flat, 2, speckle=0.0, size=(9, 9)).frames.std() == 0
    # Two frames close to each other see the same speckle; millimeters on, another one.
    for length, least, most in ((0.0, 0.5, 1.01), (3.0, -0.1, 0.1)):
        frames = phantoms.scan(flat, 2, length=length, size=(200, 200)).frames
        assert least < np.corrcoef(frames[0].ravel(), frames[1].ravel())[0, 1] < most
    clean = phantoms.cylinders(n_frames=30, size=(30, 30))
    noisy = phantoms.cylinders(n_frames=30, size=(30, 30), pose_noise=(0.5, 0.0))
    assert np.array_equal(clean.frames, noisy.frames)
    moved = (noisy.world_from_image - clean.world_from_image)[:, :3, 3]
    assert moved.std() == pytest.approx(0.5, rel=0.25)
    turned = phantoms.cylinders(n_frames=30, size=(30, 30), pose_noise=(0.0, 1.0))
    axes = turned.world_from_image[:, :3, :3]
    assert np.allclose(np.swapaxes(axes, 1, 2) @ axes, np.eye(3) * phantoms.SPACING**2)
    # Gaps are frames without a pose.
    sweep = phantoms.cylinders(n_frames=60, size=(10, 10), gaps=0.4)
    assert 25 < sweep.n_valid < 48
    assert sweep.valid[[0, -1]].all()
    assert np.isnan(sweep.world_from_image[~sweep.valid]).all()
    z, y, x = np.meshgrid(np.arange(30), np.arange(30), np.arange(30), indexing="ij")
    volume = (x + 2 * y + 3 * z).astype(np.float32)
    path = phantoms.hand_path(5, 4.0, size=(20, 20), spacing=0.2)
    place = np.array([[0.5, 0, 0, -7], [0, 0.5, 0, -4], [0, 0, 0.5, -7], [0, 0, 0, 1]])
    frames = phantoms.scan_volume(volume, place, path, (20, 20))
    here = np.linalg.inv(place) @ path[3] @ [7, 11, 0, 1]
    assert frames[3, 11, 7] == pytest.approx(here @ [1, 2, 3, 0], abs=1e-3)
    assert frames.shape == (5, 20, 20)
    with pytest.raises(ValueError, match="diameter"):
        phantoms.cylinders(20.0)
    with pytest.raises(ValueError, match="gaps"):
        phantoms.cylinders(n_frames=3, size=(5, 5), gaps=1.0)
    with pytest.raises(ValueError, match="n_frames"):
        phantoms.hand_path(1, 3.0)
