"""Volumes from sweeps: every method against the brute-force reference, on every backend."""

import importlib
import re
from dataclasses import dataclass

import numpy as np
import pytest
import sweep_oracle
from globule._base.device import choose
from globule.ultrasound import reconstruct as reconstruction
from globule.ultrasound.grid import VoxelGrid
from globule.ultrasound.options import METHODS
from globule.ultrasound.reconstructor import Reconstructor
from globule.ultrasound.sweep import Sweep
from interrupts import interrupts
from sweep_helpers import OnGpu


def reconstruct(sweep, method="pvn-om", *args, **options):
    return reconstruction(sweep, method, *args, **options)


@dataclass
class Frames:
    frames: np.ndarray
    world_from_image: np.ndarray
    valid: np.ndarray
    mask: np.ndarray | None = None


def make_sweep(n=7, shape=(20, 24), dtype=np.uint8, gap=2.0, seed=0, mask=None):
    """A fan of tilted frames of noise, pixels of 0.5 mm, about `gap` mm apart."""
    rng = np.random.default_rng(seed)
    if dtype == np.float32:
        frames = rng.normal(0, 50, (n, *shape)).astype(dtype)
    else:
        frames = rng.integers(0, np.iinfo(dtype).max + 1, (n, *shape), dtype)
    poses = np.tile(np.eye(4), (n, 1, 1))
    for f in range(n):
        a, b = 0.05 * f + 0.1, 0.3 + 0.02 * rng.normal()
        tilt = np.array([[1, 0, 0], [0, np.cos(a), -np.sin(a)], [0, np.sin(a), np.cos(a)]])
        turn = np.array([[np.cos(b), -np.sin(b), 0], [np.sin(b), np.cos(b), 0], [0, 0, 1]])
        poses[f, :3, :3] = 0.5 * turn @ tilt
        poses[f, :3, 3] = (100 + 0.1 * f, -40, gap * f)
    return Frames(frames, poses, np.ones(n, bool), mask)


def grid_of(volume):
    spacing = float(volume.spacing[0])
    return VoxelGrid(volume.world_from_voxel[:3, 3] - 0.5 * spacing, spacing, volume.shape[::-1])


def agree(volume, expected, radius):
    np.testing.assert_array_equal(volume.radius, radius)
    if volume.info["method"] == "frames":  # floats of 24 bits against float64
        error = np.abs(volume.values.astype(np.float64) - expected)
        scale = max(float(np.abs(expected).max()), 255.0)
        assert error.max() <= 1e-5 * scale + (volume.values.dtype.kind == "u")
        return
    if volume.values.dtype.kind == "u":
        # Weights of 24 bits against float64: a value next to a half may round the other way.
        off = np.abs(volume.values.astype(np.int64) - expected.astype(np.int64))
        assert off.max() <= 1
        assert np.count_nonzero(off) <= max(1, 1e-3 * off.size)
        assert not off[volume.measured].any() or volume.info["method"] not in ("pvn-om", "pvn")
    else:
        np.testing.assert_allclose(volume.values, expected, rtol=2e-6, atol=2e-5)


def as_reference(sweep, backend, method="pvn-om", spacing=0.6, region=None, **options):
    volume = reconstruct(sweep, method, spacing=spacing, region=region, **options, **backend)
    agree(volume, *sweep_oracle.reconstruct(sweep, grid_of(volume), method, **options))
    return volume


@pytest.mark.parametrize("method", METHODS)
def test_equals_reference(backend, method):
    for dtype in (np.uint8, np.uint16, np.float32):
        volume = as_reference(make_sweep(dtype=dtype), backend, method, max_kernel=7)
        assert volume.values.dtype == dtype
        assert min(volume.n_filled, volume.n_empty, volume.n_measured) > 0


@pytest.mark.parametrize("compounding", ["maximum", "latest", "first", "median"])
def test_compounding(backend, compounding):
    for dtype in (np.uint8, np.float32):
        as_reference(make_sweep(dtype=dtype, gap=0.3), backend, spacing=1.3, compounding=compounding)


@pytest.mark.parametrize("max_kernel", [1, 3, 9, 19])
def test_kernel_sizes(backend, max_kernel):
    for weights in ("normalized", "printed"):
        sweep = make_sweep(n=3, gap=5.0)
        as_reference(sweep, backend, spacing=0.5, max_kernel=max_kernel, hole_weights=weights)


def test_mask_region_invalid_frames_many_pixels_and_wide_kernels(backend):
    mask = np.zeros((20, 24), bool)
    mask[3:15, 5:20] = True
    mask[8, 9] = False
    sweep = make_sweep(mask=mask)
    sweep.valid[[0, 4]] = False
    sweep.world_from_image[4] = np.nan
    region = ((102, -39, 1.5), (108.3, -35, 11))
    for method in METHODS:
        assert as_reference(sweep, backend, method, 0.7, region).shape == (14, 6, 9)
    sweep = make_sweep(n=12, shape=(40, 50), gap=0.7)
    volume = reconstruct(sweep, spacing=0.45, **backend)
    one = reconstruct(sweep, spacing=0.45, device="cpu", threads=1)
    np.testing.assert_array_equal(volume.values, one.values)
    np.testing.assert_array_equal(volume.radius, one.radius)
    n = 4200
    frames = np.full((n, 64, 64), 65535, np.uint16)
    frames[: n // 2] = 65000
    sweep = Frames(frames, np.tile(np.diag([1e-3, 1e-3, 1e-3, 1.0]), (n, 1, 1)), np.ones(n, bool))
    volume = reconstruct(sweep, spacing=1.0, **backend)
    assert volume.shape == (1, 1, 1)
    assert volume.values[0, 0, 0] == 65268  # 65267.5, halves up
    assert volume.count[0, 0, 0] == frames.size
    sweep = make_sweep(n=2, shape=(6, 6), gap=25.0)
    volume = as_reference(sweep, backend, spacing=0.7, max_kernel=67, extrapolate=True)
    assert volume.n_empty == 0
    assert volume.radius.max() > 15


def test_maps_distance_limit_and_one_pixel(backend):
    for dtype in (np.uint8, np.uint16, np.float32):
        sweep = make_sweep(dtype=dtype, gap=0.4)
        sweep.valid[2] = False
        volume = reconstruct(sweep, spacing=1.5, **backend)
        grid, count = grid_of(volume), np.zeros(volume.shape, np.uint32)
        total, square = np.zeros(volume.shape), np.zeros(volume.shape)
        source, poses = np.full(volume.shape, -1), grid.poses(sweep.world_from_image)
        j, i = np.indices(sweep.frames.shape[1:])
        for f in np.flatnonzero(sweep.valid):
            o, x, y = poses[f].reshape(3, 3)
            v = [(o[k] + i * x[k] + j * y[k]) >> 32 for k in (2, 1, 0)]
            np.add.at(count, tuple(v), 1)
            np.add.at(total, tuple(v), sweep.frames[f].astype(float))
            np.add.at(square, tuple(v), sweep.frames[f].astype(float) ** 2)
            source[tuple(v)] = f
        np.testing.assert_array_equal(volume.count, count)
        np.testing.assert_array_equal(volume.source, source)
        n = np.maximum(count, 1)
        variance = square / n - (total / n) ** 2
        np.testing.assert_allclose(volume.variance, np.maximum(variance, 0), rtol=1e-4, atol=1e-4 * variance.max())
    sweep = make_sweep(n=2, gap=6.0)
    near = reconstruct(sweep, spacing=0.5, max_distance=1.0, extrapolate=True, **backend)
    far = reconstruct(sweep, spacing=0.5, extrapolate=True, **backend)
    assert (near.radius[near.filled >= 2] % 128).max() == 2
    assert far.hole_distance[far.filled >= 2].max() == pytest.approx(2.0)
    assert np.isinf(far.hole_distance[far.empty]).all()
    assert not far.values[far.empty].any()
    counts = [far.n_empty, far.n_measured, far.n_filled, far.n_extrapolated]
    assert sum(counts) == far.values.size
    assert (np.bincount(far.filled.ravel()) == counts).all()
    assert min(counts) > 0
    sweep = Frames(np.full((1, 1, 1), 7, np.uint8), np.eye(4)[None], np.ones(1, bool))
    for method in METHODS:
        volume = reconstruct(sweep, method, spacing=1.0, **backend)
        assert (volume.values.tolist(), volume.n_measured) == ([[[7]]], 1)
        np.testing.assert_allclose(volume.world_from_voxel[:3, 3], 0, atol=1e-12)
        as_reference(make_sweep(n=1), backend, method, 0.8)


@pytest.mark.parametrize(("change", "message"), [
    ({"method": "vnn"}, "method: expected one of frames, pvn-om"),
    ({"spacing": 0.0}, "spacing: expected a positive number"),
    ({"spacing": None}, "spacing, size: expected one of them, got neither"),
    ({"threads": 100_000}, "threads: expected 0 to 4096, got 100000"),
    ({"size": 10}, "spacing, size: expected one of them, got both"),
    ({"max_kernel": 4}, "max_kernel: expected an odd number"),
    ({"compounding": "mode"}, "compounding: expected one of mean"),
    ({"method": "vvn", "compounding": "latest"}, "compounding: expected mean"),
    ({"hole_weights": "none"}, "hole_weights: expected normalized or"),
    ({"region": ((0, 0, 0), (1, 0, 1))}, "region: expected two corners"),
    ({"region": ((900, 0, 0), (910, 9, 9))}, r"region: expected a box that meets the frames', \("),
    ({"max_distance": -1}, "max_distance: expected a number of at least 0"),
])  # fmt: skip
def test_wrong_arguments(change, message):
    with pytest.raises(ValueError, match=message):
        reconstruct(make_sweep(), **{"spacing": 1.0, "device": "cpu", **change})


@pytest.mark.parametrize(("change", "message"), [
    (lambda sweep: sweep.valid.fill(False), "at least one valid frame"),
    (lambda sweep: sweep.world_from_image[1, :3, 1].fill(0), "singular calibration"),
    (lambda sweep: sweep.frames[0, 0].fill(np.nan), "expected finite values"),
])  # fmt: skip
def test_wrong_sweeps(change, message):
    sweep = make_sweep(dtype=np.float32)
    change(sweep)
    with pytest.raises(ValueError, match=message):
        reconstruct(sweep, spacing=1.0)


def same_volume(live, sweep, frames, **options):
    """The live volume against all frames at once on the same voxels."""
    low = live.world_from_voxel[:3, 3] - 0.5 * live.spacing
    region = (low, low + live.spacing * live.shape[::-1])
    part = Frames(sweep.frames[frames], sweep.world_from_image[frames], np.ones(len(frames), bool))
    whole = reconstruct(part, spacing=float(live.spacing[0]), region=region, **options)
    np.testing.assert_array_equal(live.radius, whole.radius)
    np.testing.assert_array_equal(live.values, whole.values)


@pytest.mark.parametrize("compounding", ["mean", "latest", "maximum", "first"])
@pytest.mark.parametrize("dtype", [np.uint8, np.float32])
def test_incremental(backend, compounding, dtype):
    sweep = make_sweep(n=10, gap=3.0, dtype=dtype)
    order = [4, 5, 6, 3, 7, 9, 8, 0, 2, 1]  # grows on both sides
    live = Reconstructor(0.7, compounding=compounding, **backend)
    for k, f in enumerate(order):
        live.add(sweep.frames[f], sweep.world_from_image[f])
        if k % 3 != 1:
            same_volume(live.volume(), sweep, order[: k + 1], compounding=compounding, **backend)
    live.undo()
    live.undo()
    same_volume(live.volume(), sweep, order[:-2], compounding=compounding, **backend)
    live.add(sweep.frames[[2, 1]], sweep.world_from_image[[2, 1]])
    same_volume(live.volume(), sweep, order, compounding=compounding, **backend)
    assert live.n_frames == 10


@pytest.mark.parametrize(("dtype", "max_kernel"), [(np.uint8, 9), (np.uint16, 1), (np.float32, 13)])
def test_a_volume_that_grows_on_all_sides(backend, dtype, max_kernel):
    sweep = make_sweep(n=9, dtype=dtype)
    steps = [(0, 0, 0), (9, 0, 0), (-60, 3, 0), (0, -30, 4), (0, 40, -9), (-66, 0, 30), (1, 2, -31)]
    sweep.world_from_image[: len(steps), :3, 3] += np.array(steps)
    live = Reconstructor(0.9, max_kernel=max_kernel, **backend)
    for f in range(9):
        live.add(sweep.frames[f], sweep.world_from_image[f])
        live.volume()
    same_volume(live.volume(), sweep, list(range(9)), max_kernel=max_kernel, **backend)
    live.undo()
    live.volume()
    for _ in range(3):
        live.undo()
    same_volume(live.volume(), sweep, list(range(5)), max_kernel=max_kernel, **backend)


def test_a_frame_that_cannot_fit_undo_region_and_history(backend):
    sweep, live = make_sweep(n=3), Reconstructor(0.5, **backend)
    live.add(sweep.frames[:2], sweep.world_from_image[:2])
    for distance, error in ((1e8, ValueError), (3e5, MemoryError)):
        far = sweep.world_from_image[2].copy()
        far[:3, 3] += distance
        with pytest.raises(error):
            live.add(sweep.frames[2], far)
    live.add(sweep.frames[2], sweep.world_from_image[2])
    assert live.n_frames == 3
    same_volume(live.volume(), sweep, [0, 1, 2], **backend)
    sweep, live = make_sweep(n=3), Reconstructor(0.5, **backend)
    live.add(sweep.frames[:2], sweep.world_from_image[:2])
    shape, far = live.volume().shape, sweep.world_from_image[2].copy()
    far[:3, 3] += 40
    live.add(sweep.frames[2], far)
    assert live.volume().shape > shape
    live.undo()
    assert live.volume().shape == shape
    same_volume(live.volume(), sweep, [0, 1], **backend)
    sweep, region = make_sweep(n=6), ((100, -40, 0), (106, -35, 9))
    live = Reconstructor(0.5, region=region, history=2, **backend)
    for f in range(6):
        live.add(sweep.frames[f], sweep.world_from_image[f])
    same_volume(live.volume(), sweep, list(range(6)), **backend)
    live.undo()
    live.undo()
    same_volume(live.volume(), sweep, list(range(4)), **backend)
    with pytest.raises(ValueError, match="undo: expected frames that are still remembered"):
        live.undo()


def test_a_volume_that_was_interrupted_is_filled_again_and_what_is_refused():
    sweep = make_sweep(n=4, gap=3.0)

    def half_filled():
        live = Reconstructor(0.5, max_kernel=13, device="cpu", threads=1)
        live.add(sweep.frames[:2], sweep.world_from_image[:2])
        live.volume()
        live.add(sweep.frames[2:], sweep.world_from_image[2:])
        return live

    for live in interrupts(half_filled, lambda live: live.volume(), few=5):
        same_volume(live.volume(), sweep, list(range(4)), max_kernel=13, device="cpu")
    live, frame = Reconstructor(0.5, device="cpu"), np.zeros((4, 5), np.uint8)
    with pytest.raises(ValueError, match="volume: expected frames"):
        live.volume()
    live.add(frame, np.eye(4))
    with pytest.raises(ValueError, match="expected 4 x 5 uint8 as before, got 5 x 4 uint8"):
        live.add(frame.T, np.eye(4))
    with pytest.raises(ValueError, match="poses: expected 1, one a frame, got 2"):
        live.add(frame, np.stack([np.eye(4)] * 2))
    with pytest.raises(ValueError, match="median needs all frames"):
        Reconstructor(0.5, compounding="median")


@pytest.mark.parametrize("method", ["pvn-om", "pvn", "vvn-om"])
def test_the_spacing_that_would_fit_does(monkeypatch, method):
    module = importlib.import_module("globule.ultrasound.reconstruct")
    monkeypatch.setattr(module, "free_host_bytes", lambda: 5 * 2**20)
    sweep = make_sweep(n=6, shape=(40, 50))
    with pytest.raises(MemoryError, match="mm would fit") as caught:
        reconstruct(sweep, method, spacing=0.005, device="cpu")
    fits = float(re.search(r"([0-9.]+) mm would fit", str(caught.value))[1])
    volume = reconstruct(sweep, method, spacing=fits, device="cpu")
    assert volume.info["estimated_bytes"] > 5 / 3 * 2**20  # and not by a lot
    monkeypatch.setattr(module, "free_host_bytes", lambda: 1000)
    with pytest.raises(MemoryError, match="take fewer frames"):
        reconstruct(sweep, "vvn-om", spacing=0.5, device="cpu")


@pytest.mark.parametrize(("frames", "error", "message"), [
    (OnGpu((3, 20, 24), "<f4"), TypeError, "frames: expected uint8 or uint16 on the device, got flo"),
    (OnGpu((3, 20, 24), "|u1", (1000, 24, 1)), TypeError, "C-contiguous"),
    (OnGpu((20, 24), "|u1"), ValueError, r"expected shape \(F, H, W\), got \(20, 24\)"),
])  # fmt: skip
def test_frames_on_a_gpu_must_lie_as_they_are_used(frames, error, message):
    with pytest.raises(error, match=message):
        Sweep(frames, make_sweep(n=3).world_from_image)


def test_frames_on_a_gpu_are_copied_for_the_cpu():
    sweep = Sweep(OnGpu((3, 20, 24), "|u1"), make_sweep(n=3).world_from_image)
    volume = reconstruct(sweep, spacing=0.6, device="cpu")
    assert set(volume.values[volume.measured]) == {7}
    live = Reconstructor(0.6, device="cpu")
    live.add(sweep.frames, sweep.world_from_image)
    assert live.volume().n_measured
    assert volume.device_values is None


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("method", METHODS)
def test_frames_on_the_gpu_that_reconstructs(method, dtype):
    try:
        choose("cuda")
    except RuntimeError as error:
        pytest.skip(f"cuda: {error}")
    cupy, made = pytest.importorskip("cupy"), make_sweep(dtype=dtype)
    made.world_from_image[3] = np.nan
    for part in (slice(0, 3), slice(0, 7)):  # all valid; some not
        frames, poses = made.frames[part], made.world_from_image[part]
        there = reconstruct(Sweep(cupy.asarray(frames), poses), method, spacing=0.6, device="cuda")
        here = reconstruct(Sweep(frames, poses), method, spacing=0.6, device="cuda")
        if there.device_values is not None:
            np.testing.assert_array_equal(cupy.asarray(there.device_values).get(), here.values)
            np.testing.assert_array_equal(cupy.asarray(there.device_radius).get(), here.radius)
        for name in ("values", "radius", "count"):
            np.testing.assert_array_equal(getattr(there, name), getattr(here, name))
        assert (there.device_values is not None) == (part.stop == 3)


def test_one_lattice_for_batch_live_and_region(backend):
    """Pixels on multiples of the spacing: before, live and region= put them on voxel faces, and a
    plane appeared half a voxel from its place."""
    poses = np.tile(np.diag([0.5, 0.5, 0.5, 1.0]), (20, 1, 1))
    poses[:, 2, 3] = 0.5 * np.arange(20) - 3
    frames = np.zeros((20, 30, 40), np.uint8)
    frames[:, 12] = 200  # y = 6
    sweep = Frames(frames, poses, np.ones(20, bool))
    whole, box = reconstruct(sweep, spacing=0.5, **backend), ((0, 0, -3), (20, 15, 7))
    live, boxed = Reconstructor(0.5, **backend), Reconstructor(0.5, region=box, **backend)
    for f in range(20):
        live.add(frames[f], poses[f])
        boxed.add(frames[f], poses[f])
    part = reconstruct(sweep, spacing=0.5, region=box, **backend)
    for volume in (whole, live.volume(), part, boxed.volume()):
        bright = np.argwhere(volume.values == 200)
        np.testing.assert_allclose(volume.world_from_voxel[1, 3] + 0.5 * bright[:, 1], 6.0, atol=1e-9)
    np.testing.assert_array_equal(whole.world_from_voxel, live.volume().world_from_voxel)
    np.testing.assert_array_equal(whole.values, live.volume().values)
    np.testing.assert_array_equal(part.values, boxed.volume().values)
    shift = (part.world_from_voxel - whole.world_from_voxel)[:3, 3] / 0.5
    np.testing.assert_allclose(shift, np.rint(shift), atol=1e-9)
