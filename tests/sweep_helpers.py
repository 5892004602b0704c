"""What the tests of sweeps share."""

from pathlib import Path

import numpy as np
import pytest
from globule.formats.sweeps import igs
from globule.formats.sweeps.poses import PoseTable, write_csv
from globule.formats.sweeps.transforms import format_matrix
from globule.ultrasound import phantoms
from globule.ultrasound.calibration import Calibration, write_calibration
from globule.ultrasound.sweep import Sweep
from globule.ultrasound.sweep_writing import write_sweep
from globule.volumes.files import write_volume
from globule.volumes.volume import Volume
from scipy.spatial.transform import Rotation

DATA = Path(__file__).resolve().parents[2] / "shared" / "data" / "ultrasound"


def spine_data() -> Path:
    if not (DATA / "SpinePhantomFreehand.igs.mha").is_file():
        pytest.skip("needs ../shared/data/ultrasound")
    return DATA


def calibration_data() -> Path:
    folder = DATA.parent / "calibration"
    if not (folder / "WaterTankBottomTranslationCombined.igs.mha").is_file():
        pytest.skip("needs ../shared/data/calibration")
    return folder


def random_poses(n: int, seed: int = 0, reach: float = 40.0) -> np.ndarray:
    rng, poses = np.random.default_rng(seed), np.tile(np.eye(4), (n, 1, 1))
    for pose in poses:
        pose[:3, :3] = Rotation.from_quat(rng.normal(size=4)).as_matrix()
        pose[:3, 3] = rng.uniform(-reach, reach, 3)
    return poses


def small_sweep(n: int = 5, dtype: str = "uint8", **fields) -> Sweep:
    """n frames of 7x6 in random poses, 0.5 mm a pixel."""
    frames = (np.random.default_rng(1).random((n, 6, 7)) * 250).astype(dtype)
    poses = random_poses(n) @ np.diag([0.5, 0.5, 0.5, 1.0])
    fields.setdefault("timestamps", 10 + 0.1 * np.arange(n))
    return Sweep(frames, poses, **fields)


class OnGpu:
    """What a package's array in GPU memory shows; it has none, and `get` copies sevens."""

    def __init__(self, shape, typestr="<f4", strides=None):
        self.shape = shape
        self.__cuda_array_interface__ = {
            "shape": shape, "typestr": typestr, "data": (4096, False), "strides": strides, "version": 3,
        }  # fmt: skip

    def get(self):
        return np.full(self.shape, 7, np.uint8)


def write_recording(name, frames, times, poses, source="Probe") -> None:
    """A sequence as PLUS writes it, with tracked poses (N, 4, 4)."""
    fields = [
        {
            f"{source}ToReferenceTransform": format_matrix(pose),
            f"{source}ToReferenceTransformStatus": "OK",
            "Timestamp": repr(float(time)),
        }
        for pose, time in zip(poses, times, strict=True)
    ]
    igs.write(name, igs.Recording(frames, times, {}, np.ones(len(frames), bool), {}, fields))


def example_files() -> None:
    """The files that the examples of the command line name, small."""
    probe_from_image = np.diag([0.5, 0.5, 0.5, 1.0])
    made = phantoms.cylinders(n_frames=8, size=(24, 20), spacing=0.5)
    poses = made.world_from_image @ np.linalg.inv(probe_from_image)
    write_recording("sweep.igs.mha", made.frames, made.timestamps, poses)
    write_calibration("probe.toml", Calibration(probe_from_image))
    Path("config.xml").write_text(
        '<PlusConfiguration><Transform From="Image" To="Probe" '
        f'Matrix="{format_matrix(probe_from_image)}"/>'
        '<VolumeReconstruction OutputSpacing="1 1 1" Interpolation="NEAREST_NEIGHBOR" '
        'CompoundingMode="MEAN" FillHoles="OFF"/></PlusConfiguration>',
        encoding="utf-8",
    )
    write_sweep("frames", made)
    Path("frames/poses.csv").unlink()
    write_csv("poses.csv", PoseTable(made.timestamps, poses, np.ones(8, bool)))
    write_volume("volume.npz", Volume(np.ones((3, 4, 5), np.uint8), np.eye(4)))
    _wires(probe_from_image)
    _passes()


def _passes() -> None:
    """first.npz and second.npz, passes over one tissue, and lesion.npz, over a dark ball."""
    size, pixel, rng = (44, 48), 0.5, np.random.default_rng(0)
    noise = rng.normal(size=(30, 34, 34))
    for axis in range(3):
        for _ in range(2):
            noise = noise + np.roll(noise, 1, axis) + np.roll(noise, -1, axis)
    place = np.diag([1.0, 1.0, 1.0, 1.0])
    place[:3, 3] = -16, -4, -15
    values = (110 + 40 * noise / noise.std()).clip(0, 255)
    for seed, name in enumerate(("first.npz", "second.npz")):
        poses = phantoms.hand_path(20, 16.0, seed, pixel, size)
        frames = phantoms.scan_volume(values, place, poses, size).astype(np.uint8)
        poses[:, 0, 3] += 3 * seed
        write_sweep(name, Sweep(frames, poses))
    poses[:, 0, 3] -= 3
    z, y, x = np.mgrid[-15:15, -4:30, -16:18]
    ball = np.where(x**2 + (y - 14) ** 2 + z**2 < 36, 60, 140) + rng.normal(0, 5, noise.shape)
    frames = phantoms.scan_volume(ball, place, poses, size)
    write_sweep("lesion.npz", Sweep(frames.astype(np.uint8), poses))


def _wires(probe_from_image: np.ndarray, n: int = 40) -> None:
    """wires.igs.mha, in which one point is seen, and marks.csv of it."""
    rng = np.random.default_rng(0)
    pixels, poses = rng.uniform(2, 18, (n, 2)), random_poses(n)
    names = [f"m{row}{column}" for row in range(3) for column in range(4)]
    lines = [",".join(["frame", "column", "row", *names])]
    for i, (pixel, pose) in enumerate(zip(pixels, poses, strict=True)):
        pose[:3, 3] = -pose[:3, :3] @ (probe_from_image @ [*pixel, 0, 1])[:3]
        lines.append(",".join(map(repr, [i, *pixel.tolist(), *pose[:3].ravel().tolist()])))
    Path("marks.csv").write_text("\n".join(lines), encoding="utf-8")
    frames = rng.integers(0, 255, (n, 20, 24), np.uint8)
    write_recording("wires.igs.mha", frames, np.arange(n) / 20, poses)


def same(a: Sweep, b: Sweep) -> bool:
    masks = [m if m is None else m.tolist() for m in (a.mask, b.mask)]
    return (
        a.frames.dtype == b.frames.dtype
        and np.array_equal(a.frames, b.frames)
        and np.array_equal(a.world_from_image[a.valid], b.world_from_image[b.valid])
        and np.array_equal(a.valid, b.valid)
        and np.array_equal(a.timestamps, b.timestamps)
        and masks[0] == masks[1]
        and (a.world, a.space) == (b.world, b.space)
    )
