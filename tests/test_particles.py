"""Particles themselves: converted once, checked, selected, left where they are."""

import numpy as np
import pytest
from format_helpers import N, sample
from globule.data.particles import Particles
from sweep_helpers import OnGpu


def test_particles_convert_once_and_do_not_copy():
    positions, support = np.zeros((4, 3), np.float32), np.ones(4, np.float32)
    p = Particles(positions, support=support, weight=2, color=[1, 0.5, 0])
    assert p.positions is positions
    assert p.support is support
    assert (p.weight, type(p.weight), p.color.dtype, p.color.shape) == (2.0, float, np.float32, (3,))
    p = Particles(np.zeros((4, 3)), color=np.zeros((4, 3), np.uint8) + 255)
    assert p.positions.dtype == np.float32
    assert np.all(p.color == 1)
    assert len(Particles([])) == 0


def test_numpy_protocols_come_before_dlpack():
    """A DLPack capsule of Warp that outlives Warp ends the process with a crash."""
    positions = np.random.default_rng(1).random((4, 3), np.float32)

    class Foreign:
        __array_interface__ = positions.__array_interface__

        def __dlpack__(self, **_):
            raise AssertionError("DLPack was used")

        def __dlpack_device__(self):
            return 1, 0

    p = Particles(Foreign(), attributes={"a": Foreign()})
    assert np.shares_memory(p.positions, positions)
    assert np.shares_memory(p.attributes["a"], positions)

    class Dlpack:  # JAX-like: nothing else
        __dlpack__, __dlpack_device__ = positions.__dlpack__, positions.__dlpack_device__

    assert np.shares_memory(Particles(Dlpack()).positions, positions)


@pytest.mark.parametrize(("arguments", "error", "message"), [
    ({"positions": np.zeros((4, 4))}, ValueError, r"positions: expected shape \(N, 3\), got"),
    ({"positions": ["a"]}, TypeError, "positions: expected numbers"),
    ({"positions": [[1, 2], [3]]}, TypeError, "positions: expected an array"),
    ({"support": np.zeros(3)}, ValueError, r"support: expected a number or shape \(4,\)"),
    ({"support": -1}, ValueError, "support: expected numbers >= 0, got -1"),
    ({"support": [1, 1, np.nan, 1]}, ValueError, r"got nan \(particle 2\)"),
    ({"weight": 1e300}, ValueError, "weight: expected finite"), ({"weight": "heavy"}, TypeError, "weight"),
    ({"color": [0, 0, 1.5]}, ValueError, r"color: expected \[0, 1\], got 1.5"),
    ({"color": [1, 1]}, ValueError, "color: expected shape"),
    ({"attributes": {"a": np.zeros(5)}}, ValueError, r"attributes\['a'\]: expected shape"),
    ({"attributes": {"a": np.zeros(4, complex)}}, TypeError, "attributes"),
    ({"attributes": {"color": np.zeros(4)}}, ValueError, "a name of its own"),
])  # fmt: skip
def test_particles_name_what_is_wrong(arguments, error, message):
    with pytest.raises(error, match=message):
        Particles(**{"positions": np.zeros((4, 3)), **arguments})


def test_selection_and_bounds():
    p = Particles(sample().positions, support=sample().support, color=(1, 0, 0), weight=3)
    picked = p[p.positions[:, 0] > 0]
    assert np.array_equal(picked.support, p.support[p.positions[:, 0] > 0])
    assert picked.weight == 3
    assert np.array_equal(picked.color, [1, 0, 0])
    assert (len(p[::2]), len(p[-1])) == (N // 2, 1)
    assert np.array_equal(p[-1].positions[0], p.positions[-1])
    with pytest.raises(IndexError):
        p[N]
    assert np.array_equal(Particles([[0, 1, 2], [np.nan, -9, 9], [1, -1, 5]]).bounds(), [[0, -1, 2], [1, 1, 5]])
    with pytest.raises(ValueError, match="finite"):
        Particles([]).bounds()
    assert repr(p[:2]) == "Particles(2, support (2,), weight=3, color (3,))"


def test_gpu_arrays_stay_where_they_are():
    positions, support = OnGpu((4, 3)), OnGpu((4,))
    p = Particles(positions, support=support, color=(1, 0, 0), attributes={"a": OnGpu((4, 2))})
    assert p.positions is positions
    assert p.support is support
    assert len(p) == 4
    with pytest.raises(TypeError, match="positions: expected float32 on the GPU, got float64"):
        Particles(OnGpu((4, 3), "<f8"))
    with pytest.raises(TypeError, match="C-contiguous"):
        Particles(OnGpu((4, 3), strides=(4, 16)))
    with pytest.raises(ValueError, match="support: expected shape"):
        Particles(positions, support=OnGpu((5,)))
    # wp.array(dtype=wp.vec3) has the shape (N,), and (N, 3) for other libraries.
    positions, velocity = OnGpu((4, 3)), OnGpu((4, 3))
    positions.shape = velocity.shape = (4,)
    p = Particles(positions, color=velocity, attributes={"velocity": velocity})
    assert p.positions is positions
    assert len(p) == 4


@pytest.mark.parametrize("n", [1, 255, 256, 257, 1000])
def test_bounds_of_any_number(n):
    points = np.random.default_rng(n).normal(size=(n, 3)).astype(np.float32)
    lost = np.concatenate([points, [[np.nan, 0, 0], [0, 2e18, 0]]]).astype(np.float32)
    expected = np.stack([points.min(axis=0), points.max(axis=0)])
    for positions in (points, lost):
        np.testing.assert_array_equal(Particles(positions).bounds(), expected)
