"""The method frames, and what every method calls measured, filled and extrapolated."""

import functools

import numpy as np
import pytest
import sweep_oracle
from globule.ultrasound import phantoms
from globule.ultrasound.reconstruct import reconstruct
from globule.ultrasound.sweep import Sweep
from globule.ultrasound.trust import cross_validate
from globule.volumes.slices import reslice_frame
from test_reconstruct import grid_of


def sweep_at(places, shape=(30, 40), spacing=0.4, values=None, dtype=np.uint8):
    """Frames in planes of constant z at `places` (F, 3), mm, of noise or of values(points)."""
    rng = np.random.default_rng(3)
    poses = np.tile(np.diag([spacing, spacing, spacing, 1.0]), (len(places), 1, 1))
    poses[:, :3, 3] = places
    columns, rows = np.meshgrid(np.arange(shape[1]), np.arange(shape[0]))
    points = np.stack([columns, rows, 0 * rows, 1 + 0 * rows], axis=-1) @ poses.swapaxes(1, 2)[:, None]
    if values is None:
        frames = rng.integers(0, 256, (len(places), *shape)).astype(dtype)
    else:
        frames = values(points[..., :3]).astype(dtype)
    return Sweep(frames, poses)


def line(n, step, start=0.0):
    places = np.zeros((n, 3))
    places[:, 2] = start + step * np.arange(n)
    return places


def centers(volume):
    z, y, x = np.indices(volume.shape)
    m = volume.world_from_voxel
    return np.stack([x, y, z], axis=-1) @ m[:3, :3].T + m[:3, 3]


def hand(n_frames=14, seed=1, passes=1, size=(60, 50)):
    """Hand-like passes over noise; every second one goes back, a bit beside the one before."""
    parts = [phantoms.hand_path(n_frames, 8.0, seed + i, 0.3, size) for i in range(passes)]
    for i, part in enumerate(parts):
        part[:, :3, 3] += (0.8 * i, 0.2 * i, 0.1 * i)
    poses = np.concatenate([part[::-1] if i % 2 else part for i, part in enumerate(parts)])
    rng = np.random.default_rng(seed)
    frames = rng.integers(0, 256, (len(poses), size[1], size[0]), np.uint8)
    return Sweep(frames, poses)


@functools.cache
def two_hand_passes(spacing, masked):
    """A sweep, the place of its volume, and the oracle's values and radius."""
    sweep = hand(passes=2, size=(40, 34))
    if masked:
        rows, columns = np.indices((34, 40))
        sweep.mask = (columns - 20) ** 2 + rows**2 < 30**2
        sweep.mask[14:18, 20:23] = False
    volume = reconstruct(sweep, spacing=spacing, device="cpu")
    right = sweep_oracle.reconstruct(sweep, grid_of(volume), "frames")
    return sweep, volume.world_from_voxel, *right


@pytest.mark.few_backends
@pytest.mark.parametrize("spacing", [0.23, 0.6, 1.0])  # of 1, 2 x 2 and 3 x 3 pixels
@pytest.mark.parametrize("masked", [True, pytest.param(False, marks=pytest.mark.slow)])
def test_hand_paths_equal_the_reference(backend, spacing, masked):
    sweep, place, values, radius = two_hand_passes(spacing, masked)
    volume = reconstruct(sweep, spacing=spacing, **backend)
    np.testing.assert_array_equal(volume.world_from_voxel, place)
    differ = volume.radius != radius  # a voxel's center within 1e-5 voxels of a plane or an edge
    assert differ.mean() < 1e-4
    off = np.abs(volume.values.astype(int) - values)[~differ]
    assert off.max() <= 1
    assert np.count_nonzero(off) < 1e-3 * off.size
    assert volume.n_measured
    assert volume.n_empty


@pytest.mark.parametrize("dtype", [np.uint16, np.float32])
def test_a_linear_field_is_reproduced(backend, dtype):
    """Between frames that also move sideways; a projection onto the nearer frame would not do."""

    def field(p):
        return 3000 + 20 * p[..., 0] - 15 * p[..., 1] + 40 * p[..., 2]

    places = line(6, 1.7)
    places[:, 0] = [0, 0.9, 0.4, 1.5, 1.1, 2.0]
    sweep = sweep_at(places, values=field, dtype=dtype)
    volume = reconstruct(sweep, spacing=0.3, **backend)
    filled = volume.filled == 2
    # At an image's edge half a pixel is its outermost pixel.
    x, y = centers(volume)[..., 0], centers(volume)[..., 1]
    inner = filled & (x > 2.0) & (x < 15.6) & (y > 0.0) & (y < 11.6)
    assert inner.sum() > 10_000
    tolerance = 0.51 if dtype == np.uint16 else 0.01
    rounding = 20 if dtype == np.uint16 else 0  # of the frames: below 0.5 each
    error = np.abs(volume.values - field(centers(volume)))[inner]
    assert error.max() < tolerance + (0.5 if rounding else 0)


def two_passes():
    """Two passes, 40 mm apart, in one recording."""
    there, back = line(10, 0.8), line(10, 0.8)[::-1].copy()
    back[:, 1:] += (40, -0.6)
    return sweep_at(np.concatenate([there, back]))


@pytest.mark.parametrize("method", ["frames", "bezier", "pvn-om", "vvn-om", "pvn", "vvn"])
def test_measured_means_that_a_pixel_lies_in_the_voxel(backend, method):
    """Before: bezier called the curves through a gap of 40 mm measured."""
    sweep = two_passes()
    volume = reconstruct(sweep, method, spacing=0.5, **backend)
    np.testing.assert_array_equal(volume.measured, volume.count > 0)
    assert volume.n_measured < volume.values.size


def test_a_gap_between_passes_stays_empty(backend):
    sweep = two_passes()
    volume = reconstruct(sweep, spacing=0.5, **backend)
    y = centers(volume)[..., 1]
    gap = (y > 12.5) & (y < 39)
    assert volume.empty[gap].all()
    assert (volume.filled == 2)[y < 11].any()
    joined = reconstruct(sweep, spacing=0.5, max_distance=30.0, **backend)
    assert not joined.empty[gap].all()
    near = reconstruct(sweep, spacing=0.5, max_distance=0.2, **backend)
    assert near.n_filled == 0


def test_a_probe_at_rest_does_not_hide_the_motion(backend):
    places = np.concatenate([np.zeros((20, 3)), line(8, 1.2)])
    volume = reconstruct(sweep_at(places), spacing=0.4, **backend)
    z = centers(volume)[..., 2]
    assert not volume.empty[(z > 0) & (z < 8.0)].any()


@pytest.mark.parametrize("method", ["pvn-om", "vvn-om", "pvn", "vvn"])
def test_holes_are_filled_between_data_only(backend, method):
    """Before: the slab grew by four voxels on each side."""
    sweep = sweep_at(line(5, 2.0))
    box = ((-3, -3, -3), (19, 15, 11))
    volume = reconstruct(sweep, method, spacing=0.5, region=box, **backend)
    p = centers(volume)
    outside = ((p < -0.5) | (p > (16.1, 12.1, 8.5))).any(axis=-1)
    assert volume.empty[outside].all()
    between = (p[..., 2] > 0) & (p[..., 2] < 8) & (p[..., 0] > 0) & (p[..., 0] < 15.5)
    between &= (p[..., 1] > 0) & (p[..., 1] < 11.5)
    assert not volume.empty[between].any()
    more = reconstruct(sweep, method, spacing=0.5, region=box, extrapolate=True, **backend)
    np.testing.assert_array_equal(more.filled == 2, volume.filled == 2)
    assert more.n_extrapolated > 1000
    assert outside[more.filled == 3].mean() > 0.75
    assert (more.hole_distance[more.filled == 3] <= 2.0).all()
    kept = ~volume.empty
    np.testing.assert_array_equal(more.values[kept], volume.values[kept])


@pytest.mark.few_backends
def test_uncertainty_is_the_error_of_frames_left_out(backend):
    """Every third frame: the expected error against the real one, where small and where large."""
    sweep = phantoms.breast(n_frames=46, size=(160, 160), spacing=0.25, length=18.0, speckle=0.2)
    left_out = np.arange(2, 44, 3)
    valid = np.ones(46, bool)
    valid[left_out] = False
    rest = Sweep(sweep.frames, sweep.world_from_image, valid=valid)
    volume = reconstruct(rest, spacing=0.3, **backend)
    expected = Sweep(sweep.frames, sweep.world_from_image)
    map_ = type(volume)(volume.uncertainty, volume.world_from_voxel, volume.radius)
    errors, predicted = [], []
    for f in left_out:
        value = reslice_frame(volume, expected, f)
        known = value.origin == 2
        errors.append((value.values - sweep.frames[f])[known])
        predicted.append(reslice_frame(map_, expected, f, linear=False).values[known])
    error, predicted = np.concatenate(errors), np.concatenate(predicted)
    ratio = np.sqrt((error**2).mean() / (predicted**2).mean())
    assert 0.8 < ratio < 1.25
    order = np.argsort(predicted)
    rms = [np.sqrt((error[part] ** 2).mean()) for part in np.array_split(order, 4)]
    assert rms == sorted(rms)
    assert rms[3] > 1.3 * rms[0]
    assert np.isinf(volume.uncertainty[volume.empty]).all()
    assert volume.info["left_out_rms"] > 0


@pytest.mark.slow
def test_frames_beats_every_other_method():
    sweep = phantoms.breast(n_frames=40, size=(60, 60), spacing=0.6, length=24.0, speckle=0.0)
    found = {
        method: cross_validate(sweep, 5, method, spacing=0.4, device="cpu")
        for method in ("frames", "bezier", "vvn-om", "pvn-om")
    }
    best = found.pop("frames")
    assert all(best.rms_error < other.rms_error for other in found.values())


def test_another_compounding_takes_pvn_om():
    sweep = hand()
    volume = reconstruct(sweep, spacing=0.5, compounding="maximum", device="cpu")
    assert volume.info["method"] == "pvn-om"
    with pytest.raises(ValueError, match="compounding: expected mean for method frames"):
        reconstruct(sweep, "frames", spacing=0.5, compounding="maximum", device="cpu")
    with pytest.raises(ValueError, match="uncertainty: expected a volume of method frames"):
        _ = volume.uncertainty
