"""Settings, cameras, materials and cuts are what they were when made, however often they serve."""

import copy
import gc
import pickle

import globule as gb
import numpy as np
import pytest
from light import QUIET, ball

CAMERA = gb.Camera((0, 0, 5), (0, 0, 0))
SIZE = (24, 20)


def picture(settings=QUIET, camera=CAMERA, **options):
    return gb.render(ball(), camera, SIZE, settings, **options).color


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


@pytest.mark.parametrize("copied", [copy.copy, copy.deepcopy, lambda made: pickle.loads(pickle.dumps(made))])
def test_copies_of_what_was_used(copied):
    image = np.random.default_rng(0).random((4, 8, 3))
    settings = gb.RenderSettings(sky=gb.Environment(image), ambient="sky", ambient_rays=2)
    cut = gb.ClipPlane((1, 0, 0), 0.1)
    before = picture(settings, clips=[cut])
    after = picture(copied(settings), copied(CAMERA), clips=[copied(cut)])
    np.testing.assert_array_equal(after, before)


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
