"""Arrays know where they lie and on which stream: used there, copied, or refused with a reason."""

import globule as gb
import numpy as np
import pytest
from conftest import has_gpu
from sweep_helpers import small_sweep

SIZE = (64, 48)


class Pretender:
    """Says that it lies on a GPU."""

    def __init__(self, array):
        self.array, self.shape, self.dtype = array, array.shape, array.dtype

    @property
    def __cuda_array_interface__(self):
        return {
            "version": 3, "shape": self.shape, "typestr": "<f4", "strides": None,
            "data": (self.array.ctypes.data, False), "stream": 7,
        }  # fmt: skip


@pytest.mark.skipif(has_gpu(), reason="there is a GPU here")
def test_gpu_memory_is_never_read_as_the_hosts():
    points = np.random.default_rng(1).random((500, 3)).astype(np.float32)
    with pytest.raises(ValueError, match=r"^positions: expected memory that can be reached"):
        gb.Scene(Pretender(points), device="cpu", support=0.2)
    scene = gb.Scene(points, device="cpu", support=0.2)
    with pytest.raises(ValueError, match=r"^points: expected memory that can be reached"):
        scene.field(Pretender(points))


@pytest.fixture
def cupy():
    if not has_gpu():
        pytest.skip("no GPU")
    return pytest.importorskip("cupy")


def points_of(n=4000, seed=1):
    return np.random.default_rng(seed).random((n, 3)).astype(np.float32)


def test_cpu_scene_takes_gpu_arrays(cupy):
    points = points_of()
    scene = gb.Scene(cupy.asarray(points), device="cpu", support=0.1)
    right = gb.Scene(points, device="cpu", support=0.1)
    assert scene.octree.key_hash == right.octree.key_hash
    assert (scene.field(cupy.asarray(points)) == right.field(points)).all()


def test_colors_on_a_gpu_outlive_the_update_of_a_cpu_scene(cupy):
    points = points_of()
    color = np.random.default_rng(2).random(points.shape).astype(np.float32)
    given = gb.Particles(cupy.asarray(points), support=0.1, color=cupy.asarray(color))
    scene = gb.Scene(given, device="cpu")
    right = gb.Scene(gb.Particles(points, support=0.1, color=color), device="cpu")
    camera = gb.Camera.fit(points, size=SIZE)
    picture = gb.render(right, camera, SIZE).picture
    assert (gb.render(scene, camera, SIZE).picture == picture).all()


def test_pinned_memory_is_the_hosts(cupy):
    points = points_of()
    pinned = np.frombuffer(cupy.cuda.alloc_pinned_memory(points.nbytes), np.float32, points.size)
    pinned = pinned.reshape(points.shape)
    pinned[:] = points
    scene = gb.Scene(pinned, device="cuda", support=0.1)
    assert scene.octree.key_hash == gb.Scene(points, device="cpu", support=0.1).octree.key_hash


@pytest.mark.parametrize("n", [1_300, 6_000, 40_000, 90_000])
def test_pinned_memory_may_be_overwritten_after_the_call(cupy, n):
    """While the device is busy with an image, so that a copy from there would come too late."""
    points = [points_of(n, seed) for seed in range(8)]
    right = [gb.Scene(p, device="cpu", support=0.1).octree.key_hash for p in points]
    pinned = np.frombuffer(cupy.cuda.alloc_pinned_memory(12 * n), np.float32, 3 * n).reshape(n, 3)
    pinned[:] = points[-1]
    scene = gb.Scene(pinned, device="cuda", support=0.1)
    camera = gb.Camera.fit(points[0], size=(640, 480))
    look = gb.RenderSettings(shadows=True, ambient_rays=16)
    for p, key_hash in zip(points, right, strict=True):
        frame = gb.render(scene, camera, (640, 480), look)
        pinned[:] = p
        scene.update(positions=pinned)
        pinned[:] = 0.5
        assert scene.octree.key_hash == key_hash
        assert frame.picture.any()


def test_build_waits_for_the_callers_stream(cupy):
    """Positions that are still being written on a stream of the caller's own."""
    points = points_of(200_000)
    right = gb.Scene(points, device="cpu", support=0.02).octree.key_hash
    scene = gb.Scene(cupy.zeros((4, 3), "f4"), device="cuda", support=0.02)
    slow = cupy.ones((3000, 3000), "f4")
    with cupy.cuda.Stream(non_blocking=True):
        for _ in range(3):
            positions = cupy.zeros((200_000, 3), "f4")
            for _ in range(20):
                slow = slow @ slow / 3000
            positions += cupy.asarray(points)
            scene.update(positions=positions)
            positions[:] = 0  # given to the stream after the call: read before
            assert scene.octree.key_hash == right


def test_two_gpus(cupy):
    if cupy.cuda.runtime.getDeviceCount() < 2:
        pytest.skip("one GPU")
    points, camera = points_of(50_000), gb.Camera.fit(points_of(50_000), size=SIZE)
    right = gb.render(gb.Scene(points, device="cuda:0", support=0.05), camera, SIZE).picture
    for current in (0, 1):
        with cupy.cuda.Device(current):
            for here in (0, 1):
                with cupy.cuda.Device(here):
                    positions = cupy.asarray(points)
                for there in (0, 1):
                    scene = gb.Scene(positions, device=f"cuda:{there}", support=0.05)
                    assert cupy.cuda.runtime.getDevice() == current
                    for _ in range(3):
                        scene.update(positions=positions)
                        assert cupy.cuda.runtime.getDevice() == current
                    frame = gb.render(scene, camera, SIZE)
                    assert (frame.picture == right).all()
                    assert (scene.field(positions[:100]) > 0).all()
                    del scene, frame
                    assert cupy.cuda.runtime.getDevice() == current


def test_the_current_gpu_stays(cupy):
    before = cupy.cuda.runtime.getDevice()
    scene = gb.Scene(points_of(), device="cuda", support=0.1)
    gb.render(scene, size=SIZE).picture  # noqa: B018
    assert cupy.cuda.runtime.getDevice() == before


def test_results_on_the_gpu_are_ordered_for_the_consumers_stream(cupy):
    sweep = small_sweep()
    right = gb.ultrasound.reconstruct(sweep, spacing=0.5, device="cpu")
    there = gb.ultrasound.Sweep(cupy.asarray(sweep.frames), sweep.world_from_image)
    volume = gb.ultrasound.reconstruct(there, spacing=0.5, device="cuda")
    with cupy.cuda.Stream(non_blocking=True) as stream:
        for array in (cupy.asarray(volume.device_values), cupy.from_dlpack(volume.device_values)):
            assert (cupy.asnumpy(array + 0, stream=stream) == right.values).all()


def test_images_may_be_kept_after_their_frames():
    scene = gb.Scene(points_of(), device="auto", support=0.1)
    kept = [gb.render(scene, size=SIZE).picture for _ in range(12)]
    assert all((picture == kept[0]).all() for picture in kept)
    kept[0][:] = 0
    assert not (kept[1] == kept[0]).all()


def test_rays_of_a_gpu_without_length_meet_nothing(cupy):
    scene = gb.Scene(points_of(), support=0.1, device="cuda")
    origins = cupy.zeros((3, 3), cupy.float32) + cupy.asarray([0.5, 0.5, 9], cupy.float32)
    directions = cupy.asarray([[0, 0, 0], [0, 0, -1e-6], [0, 0, -1]], cupy.float32)
    depth, _, _ = scene.intersect(origins, directions)
    assert np.isinf(depth[:2]).all()
    assert depth[2] < 9
