"""What owns memory of the core is not copied in silence; values are, and stay what they were when made."""

import copy
import gc
import pickle

import globule as gb
import numpy as np
import pytest
from cli_helpers import refuses
from globule.sim.emitter import Emitter
from light import QUIET, ball

POINTS = np.random.default_rng(0).random((300, 3)).astype(np.float32)
CAMERA, SIZE = gb.Camera((0, 0, 5), (0, 0, 0)), (24, 20)
WAYS = [copy.copy, copy.deepcopy, lambda made: pickle.loads(pickle.dumps(made))]


def scene():
    return gb.Scene(POINTS, support=0.1, device="cpu")


def frame():
    return gb.render(scene(), gb.Camera((0.5, 0.5, 4), (0.5, 0.5, 0.5)), (8, 6))


def simulation():
    return gb.Simulation("dam-break", spacing=0.1, device="cpu")


def parts_of_a_simulation():
    """Each shares the solver's memory, which the simulation of the original would go on with."""
    sim = gb.Simulation("cut-block", spacing=0.005, device="cpu")
    return [sim.record, sim.steer, sim.arrays, sim.foam, sim.tissue, sim.tools, *sim.tools.values()]


OWNERS = {
    "scene": lambda: [scene(), scene().octree, frame()],
    "mesh": lambda: [gb.Mesh(np.eye(3), [[0, 1, 2]])],
    "simulation": lambda: [simulation(), simulation().scene, *parts_of_a_simulation()],
    "reconstructor": lambda: [gb.ultrasound.Reconstructor(1.0, device="cpu")],
}


@pytest.mark.parametrize("make", OWNERS.values(), ids=OWNERS)
def test_copies_are_refused(make):
    for made in make():
        for way in WAYS:
            refuses("cannot be copied or pickled, since it owns memory", way, made, error=TypeError)


def picture(settings=QUIET, camera=CAMERA, **options):
    return gb.render(ball(), camera, SIZE, settings, **options).color


@pytest.mark.parametrize("way", WAYS)
def test_values_are_copied(way):
    particles = way(gb.Particles(POINTS, support=0.1, attributes={"a": POINTS[:, 0]}))
    assert np.array_equal(particles.positions, POINTS)
    assert way(CAMERA) == CAMERA
    settings = gb.RenderSettings(sky=gb.Environment(POINTS[:32].reshape(4, 8, 3)), ambient="sky", ambient_rays=2)
    cut = gb.ClipPlane((1, 0, 0), 0.1)
    before = picture(settings, clips=[cut])
    np.testing.assert_array_equal(picture(way(settings), way(CAMERA), clips=[way(cut)]), before)
    sim = simulation()
    sim.emitters["tap"] = Emitter((0.2, 0.3, 0.1), (0, -1, 0), 0.05, 1e-4)
    phases = way(sim.phases)
    assert phases == sim.phases
    with pytest.raises(KeyError, match="phases: expected one of water"):
        phases["x"]
    assert way(sim.emitters)["tap"].rate == 1e-4


def test_what_has_arrays_is_compared_as_itself():
    frames = frame(), frame()
    for one, other in (frames, [f.pick(4, 3) for f in frames]):
        assert one != other
        assert one == one
        assert len({one, other}) == 2


def test_what_is_given_may_change_afterwards():
    lights, radiance = [gb.Headlight()], np.array([0.5, 0.25, 0.125])
    light, color, low = gb.PointLight([3, 3, 3], radiance), [0.2, 0.9, 0.3], np.zeros(3)
    lights.append(light)
    settings = gb.RenderSettings(lights=lights, material=gb.Material(color=color))
    cut = gb.ClipBox(low, [9, 9, 9])
    before = picture(settings, clips=[cut])
    lights.clear()
    radiance[:], color[1], low[:] = 0, 0, -9
    np.testing.assert_array_equal(picture(settings, clips=[cut]), before)
    assert settings.lights == (gb.Headlight(), light)
    assert light.position == (3, 3, 3)
    with pytest.raises(ValueError, match="read-only"):
        light.radiance[0] = 1


def test_a_frame_keeps_its_environment():
    def frame():
        image = np.random.default_rng(0).random((64, 128, 3))
        return gb.render(ball(), CAMERA, SIZE, gb.RenderSettings(sky=gb.Environment(image)))

    kept, other = frame(), frame()
    gc.collect()
    np.testing.assert_array_equal(kept.refine(2).color, other.refine(2).color)


def test_one_camera_for_several_sizes():
    scene = ball()
    for size in ((24, 20), (20, 24), (24, 20)):
        fresh = gb.render(scene, gb.Camera((0, 0, 5), (0, 0, 0)), size, QUIET)
        again = gb.render(scene, CAMERA, size, QUIET)
        np.testing.assert_array_equal(again.distance, fresh.distance)


def test_one_material_under_several_settings():
    shiny, dull = (gb.RenderSettings(specular=s, material=gb.Material()) for s in (0.9, 0.0))
    layer = gb.Layer(ball(), gb.Material(specular=0.4))
    own = [gb.render(layer, CAMERA, SIZE, s).color for s in (shiny, dull)]
    np.testing.assert_array_equal(*own)
    assert picture(shiny).max() > picture(dull).max()


def test_how_far_ambient_rays_look_is_each_scenes_own():
    settings = gb.RenderSettings(ambient_rays=16)
    for size in (1.0, 10.0):
        p = size * np.random.default_rng(1).random((200, 3))
        scene = gb.Scene(p, support=0.3 * size, device="cpu")
        camera = gb.Camera.fit(scene, size=SIZE)
        told = gb.RenderSettings(ambient_rays=16, ambient_distance=0.1 * scene.octree.extent)
        expected = gb.render(scene, camera, SIZE, told).color
        np.testing.assert_array_equal(gb.render(scene, camera, SIZE, settings).color, expected)
