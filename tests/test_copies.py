"""Objects that own memory of the core are not copied in silence."""

from __future__ import annotations

import copy
import pickle

import globule as gb
import numpy as np
import pytest

POINTS = np.random.default_rng(0).random((300, 3)).astype(np.float32)


def scene():
    return gb.Scene(POINTS, support=0.1, device="cpu")


def mesh():
    return gb.Mesh(np.eye(3), [[0, 1, 2]])


def frame():
    return gb.render(scene(), gb.Camera((0.5, 0.5, 4), (0.5, 0.5, 0.5)), (8, 6))


def octree():
    return scene().octree


def simulation():
    return gb.Simulation("dam-break", spacing=0.1, device="cpu")


def simulation_scene():
    return simulation().scene


def reconstructor():
    return gb.ultrasound.Reconstructor(1.0, device="cpu")


@pytest.mark.parametrize("make", [scene, mesh, frame, octree, simulation, simulation_scene, reconstructor])
@pytest.mark.parametrize("way", [copy.copy, copy.deepcopy, pickle.dumps])
def test_copies_are_refused(make, way):
    with pytest.raises(TypeError, match="cannot be copied or pickled, since it owns memory"):
        way(make())


def test_values_are_copied():
    """Particles, cameras, settings and volumes are values; a copy has its own arrays or cannot
    change them."""
    particles = gb.Particles(POINTS, support=0.1, attributes={"a": POINTS[:, 0]})
    for way in (copy.copy, copy.deepcopy, lambda x: pickle.loads(pickle.dumps(x))):
        again = way(particles)
        assert np.array_equal(again.positions, POINTS)
        camera = gb.Camera((0, 0, 4), (0, 0, 0))
        assert way(camera) == camera
