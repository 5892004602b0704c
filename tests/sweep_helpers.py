"""What the tests of sweeps share."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from globule.sweep import Sweep
from globule.sweeps.poses import rotation

DATA = Path(__file__).resolve().parents[2] / "shared" / "data" / "ultrasound"


def spine_data() -> Path:
    """The folder of the real sweep, or a skipped test."""
    if not (DATA / "SpinePhantomFreehand.igs.mha").is_file():
        pytest.skip("needs ../shared/data/ultrasound")
    return DATA


def random_poses(n: int, seed: int = 0, reach: float = 40.0) -> np.ndarray:
    """(n, 4, 4) rigid, mm."""
    rng = np.random.default_rng(seed)
    poses = np.tile(np.eye(4), (n, 1, 1))
    for pose in poses:
        pose[:3, :3] = rotation(rng.normal(size=4))
        pose[:3, 3] = rng.uniform(-reach, reach, 3)
    return poses


def small_sweep(n: int = 5, dtype: str = "uint8", **fields) -> Sweep:
    """n frames of 7x6 in random poses, 0.5 mm a pixel."""
    rng = np.random.default_rng(1)
    frames = (rng.random((n, 6, 7)) * 250).astype(dtype)
    poses = random_poses(n) @ np.diag([0.5, 0.5, 0.5, 1.0])
    fields.setdefault("timestamps", 10 + 0.1 * np.arange(n))
    return Sweep(frames, poses, **fields)


def same(a: Sweep, b: Sweep) -> bool:
    """Whether two sweeps hold the same bits."""
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
