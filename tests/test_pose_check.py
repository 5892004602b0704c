"""Poses that are wrong: jumps, bursts, steps, frozen trackers, and what is none of these."""

import itertools

import globule as gb
import numpy as np
import pytest
from globule.ultrasound.sweep import Sweep
from globule.ultrasound.trust import check_poses
from sweep_helpers import random_poses


def test_outliers_are_found_and_only_they():
    sweep = gb.ultrasound.phantoms.cylinders(n_frames=40, size=(9, 9), pose_noise=(0.02, 0.02))
    assert not check_poses(sweep).outliers.any()
    for wrong in ([7], [20, 21], [0], [39], [5, 9, 30]):
        broken = sweep.world_from_image.copy()
        for k, i in enumerate(wrong):
            broken[i, :3, 3] += np.array([15, -8, 3]) * (k + 1)
        assert wrong_frames(sweep, broken)[0] == wrong
    turned = sweep.world_from_image.copy()
    turned[12, :3, :3] = random_poses(1)[0, :3, :3] @ turned[12, :3, :3]
    assert wrong_frames(sweep, turned)[0] == [12]


@pytest.fixture(scope="module")
def hand():
    return gb.ultrasound.phantoms.cylinders(n_frames=80, size=(20, 20), pose_noise=(0.02, 0.02))


def wrong_frames(hand, poses, frames=None, times=True):
    """Frames that are outliers, and the kinds of what was found."""
    check = check_poses(Sweep(hand.frames if frames is None else frames, poses, hand.timestamps if times else None))
    return np.flatnonzero(check.outliers).tolist(), [f.kind for f in check.findings]


@pytest.mark.parametrize("n", [2, 3, 5, 10])
def test_bursts_of_wrong_poses(hand, n):
    """Of 300 random bursts, the ones missed are displaced by less than 5 mm, 11 times the distance
    between frames."""
    for first, times in itertools.product((0, 30, 70), (True, False)):
        rng = np.random.default_rng(n)
        for wrong in (np.array([8.0, -6, 2]), rng.normal(0, 20, (n, 3))):
            poses = hand.world_from_image.copy()
            poses[first : first + n, :3, 3] += wrong
            found = wrong_frames(hand, poses, times=times)
            assert found == (list(range(first, first + n)), ["burst"]), (first, times)


@pytest.mark.parametrize("size", [10, 1000])
def test_a_step_is_named_and_keeps_all_frames(hand, size):
    poses = hand.world_from_image.copy()
    poses[40:, 0, 3] += size
    check = check_poses(Sweep(hand.frames, poses, hand.timestamps))
    assert not check.outliers.any()
    assert check.findings == [("step", 39, 40, pytest.approx(size, rel=0.02))]


@pytest.mark.parametrize(("first", "n"), [(20, 30), (20, 6), (60, 20)])
def test_a_tracker_that_freezes(hand, first, n):
    poses = hand.world_from_image.copy()
    poses[first : first + n] = poses[first]
    assert wrong_frames(hand, poses) == (list(range(first + 1, first + n)), ["freeze"])


@pytest.mark.parametrize("n", [48, 72])
def test_a_probe_at_rest_is_no_outlier_nor_are_its_moves(hand, n):
    """Nor where all its poses at rest, 60 % of the frames, are identical."""
    for jitter, noise in itertools.product((0, 0.02), (0, 3)):
        rng = np.random.default_rng(0)
        poses, frames = hand.world_from_image.copy(), hand.frames.copy()
        poses[:n], frames[:n] = poses[n], frames[n]
        poses[:n, :3, 3] += rng.normal(0, jitter, (n, 3))
        frames[:n] = np.clip(frames[:n] + rng.normal(0, noise, frames[:n].shape), 0, 255)
        expected = ([], [] if jitter else ["identical"])
        assert wrong_frames(hand, poses, frames) == expected, (jitter, noise)


def test_a_tracker_slower_than_the_images_and_another_speed_limit(hand):
    poses = hand.world_from_image.copy()
    poses[1::2] = poses[::2]
    assert wrong_frames(hand, poses) == ([], [])
    poses[:] = poses[0]
    assert wrong_frames(hand, poses) == ([], ["identical"])
    poses = hand.world_from_image.copy()
    poses[40, 0, 3] += 1.5
    moved = Sweep(hand.frames, poses, hand.timestamps)
    for limit, found in (({}, []), ({"most_speed": 25}, [40])):  # mm/s, at 25 images a second
        assert np.flatnonzero(check_poses(moved, **limit).outliers).tolist() == found


@pytest.mark.parametrize("back", ["to the start", "a little", "a second pass", "none"])
def test_a_clock_that_is_set_back_makes_no_jumps(hand, back):
    """Also two passes in one file, and stamps of 0."""
    poses, times = hand.world_from_image.copy(), np.arange(80) / 25 + 100
    times[40:] = 0 if back == "none" else times[40:] - (times[40] if back == "to the start" else 0.55)
    if back == "a second pass":
        poses[40:, 0, 3] += 40
    assert not check_poses(Sweep(hand.frames, poses, times)).findings
    poses[60, 0, 3] += 15
    assert np.flatnonzero(check_poses(Sweep(hand.frames, poses, times)).outliers).tolist() == [60]
