"""Cells are made where rays can come: behind full ones only for light, cuts and eyes inside."""

import globule as gb
import numpy as np
import pytest

SIZE = (96, 72)
OUTSIDE = gb.Camera((70.0, 55.0, 90.0), (0.0, 0.0, 0.0))
SHADOWS = {"shadows": True}
WATER = gb.Material(transmission=1.0, index=1.33)


@pytest.fixture(scope="module")
def block():
    """A block with a bubble that no ray from outside can reach; spacing 1."""
    at = np.arange(-18.0, 19.0)
    points = np.stack(np.meshgrid(at, at, at), axis=-1).reshape(-1, 3)
    return points[np.linalg.norm(points, axis=1) > 7].astype(np.float32)


def scene_of(points, backend):
    return gb.Scene(points, support=2.0, threshold=0.6, **backend)


CASES = {
    "light goes inside": (OUTSIDE, {"settings": {"material": WATER, "bounces": 4}}),
    "a cut opens it": (OUTSIDE, {"settings": SHADOWS, "clips": [gb.ClipPlane((1, 0, 0), 0.0)]}),
    "the eye is inside": (gb.Camera((0, 0, 0), (1, 0.3, 0.2)), {"settings": SHADOWS}),
    "from a plane": (gb.Camera((0, 0, 60), (0, 0, 0), (0, 1, 0), height=50), {"settings": SHADOWS}),
}


@pytest.mark.few_backends
@pytest.mark.parametrize("case", CASES)
def test_what_was_out_of_reach_is_made_when_it_is_not(block, backend, case):
    camera, how = CASES[case]
    fresh = gb.render(scene_of(block, backend), camera, SIZE, **how)
    scene = scene_of(block, backend)
    before = gb.render(scene, OUTSIDE, SIZE, settings=SHADOWS)
    after = gb.render(scene, camera, SIZE, **how)
    assert before.mask.any()
    assert after.mask.any()
    if case == "the eye is inside":  # it sees the bubble's wall
        assert np.abs(after.distance - 6.7).max() < 1.0
    np.testing.assert_array_equal(after.image, fresh.image)
    np.testing.assert_array_equal(after.distance, fresh.distance)
    again = gb.render(scene, OUTSIDE, SIZE, settings=SHADOWS)
    np.testing.assert_array_equal(again.image, before.image)
