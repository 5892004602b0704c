"""Objects that own memory of the core are not copied in silence."""

from __future__ import annotations

import copy
import pickle

import globule as gb
import numpy as np
import pytest
from globule.sim.emitter import Emitter

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


def test_parts_of_a_simulation_are_refused():
    """Each shares the solver's memory, which the simulation of the original would go on with."""
    sim = gb.Simulation("cut-block", spacing=0.005, device="cpu")
    parts = [sim.record, sim.steer, sim.arrays, sim.foam, sim.tissue, sim.tools, *sim.tools.values()]
    for part in parts:
        for way in (copy.copy, copy.deepcopy, pickle.dumps):
            with pytest.raises(TypeError, match="cannot be copied or pickled, since it owns memory"):
                way(part)


def test_phases_and_emitters_are_values():
    sim = simulation()
    sim.emitters["tap"] = Emitter((0.2, 0.3, 0.1), (0, -1, 0), 0.05, 1e-4)
    for way in (copy.copy, copy.deepcopy, lambda x: pickle.loads(pickle.dumps(x))):
        again = way(sim.phases)
        assert again == sim.phases
        with pytest.raises(KeyError, match="phases: expected one of water"):
            again["x"]
        assert way(sim.emitters)["tap"].rate == 1e-4


def test_what_has_arrays_is_compared_as_itself():
    frames = frame(), frame()
    for one, other in (frames, [f.pick(4, 3) for f in frames]):
        assert one != other
        assert one == one
        assert len({one, other}) == 2
