"""The offset of a recorder that takes images at another rate than the scanner makes them."""

from __future__ import annotations

import numpy as np
import pytest
from globule.ultrasound.beat import find_beat
from globule.ultrasound.temporal import _compared, temporal_offset


def recording(seed: int, extent: float):
    """Times, image motion, probe and the mean offset of a recording of 17 s; noise of 5 pixels."""
    rng = np.random.default_rng(seed)
    times, late = np.arange(200) * 0.085, rng.uniform(-0.2, 0.2)
    sizes, rates, phases = rng.uniform((0.3, 0.6, 0), (1, 1.6, 7), (6, 3)).T

    def height(t):
        waves = zip(sizes, rates, phases, strict=True)
        return sum(s * np.sin(2 * np.pi * r * t + p) for s, r, p in waves)

    period, phase = rng.uniform(3, 10), rng.uniform()
    lag = late + extent * (np.mod(times / period - phase, 1) - 0.5)
    noise = np.convolve(rng.normal(0, 5, 202), np.ones(3) / 3**0.5, "valid")
    probe = np.outer(height(times), [1.0, 4.0, 0.2]) + rng.normal(0, 0.2, (200, 3))
    return times, 60 * height(times + lag) + noise, probe, late


@pytest.mark.slow
def test_the_mean_of_a_sawtooth():
    """Recordings with an offset that varies by an image period. The error of the mean is 1.9 ms
    (rms of 60), that of a constant offset 5.0 ms; the true mean lies within two deviations in 93 %.
    """
    plain, errors, within = [], [], 0
    for seed in range(8):
        times, motion, probe, late = recording(seed, 0.085)
        constant = _compared(times, motion, times, probe, 0.5, "line", chance=False)
        inside = (times >= 0.5) & (times <= times[-1] - 0.5)
        found = find_beat(times[inside], motion[inside], times, probe, constant.offset, 12)
        assert found is not None
        assert found.extent == pytest.approx(0.085, rel=0.35)
        plain.append(constant.offset - late)
        errors.append(found.offset - late)
        within += abs(found.offset - late) < 2 * found.uncertainty
    assert np.sqrt(np.mean(np.square(errors))) < 0.5 * np.sqrt(np.mean(np.square(plain)))
    assert within >= 6


def test_a_constant_offset_has_no_beat():
    for seed in range(8):
        times, motion, probe, late = recording(seed, 0.0)
        assert find_beat(times, motion, times, probe, late, 12) is None


def test_a_short_recording_has_none():
    times, motion, probe, late = recording(0, 0.085)
    assert find_beat(times[:17], motion[:17], times, probe, late, 4) is None


@pytest.mark.parametrize("extent", [0.085, 0.0])
def test_images_of_a_line(extent):
    times, motion, probe, late = recording(1, extent)
    poses = np.tile(np.eye(4), (len(times), 1, 1))
    poses[:, :3, 3] = probe
    depth = 60 + 40 * motion / np.abs(motion).max()
    rows = np.arange(120)[:, None]
    frames = 200 * np.exp(-(((rows - depth[:, None, None]) / 1.5) ** 2)) * np.ones(48)
    found = temporal_offset(frames.astype(np.uint8), times, poses, times)
    assert found.method == "line"
    assert found.doubt == ""
    assert abs(found.offset - late) < 3 * found.uncertainty < 0.015
    assert (found.beat_extent is None) == (extent == 0)
