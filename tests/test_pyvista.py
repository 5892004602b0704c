"""The surface in a VTK window: the same pixels as gb.render, between the window's meshes."""

import globule as gb
import numpy as np
import pytest

pyvista = pytest.importorskip("pyvista")
import globule.pyvista  # noqa: E402

pytestmark = pytest.mark.interop
SIZE = (160, 120)
SETTINGS = {"background": (0, 0, 0)}


def ball(n: int = 3000) -> gb.Scene:
    rng = np.random.default_rng(1)
    positions = rng.normal(size=(n, 3))
    positions /= np.linalg.norm(positions, axis=1, keepdims=True)
    positions *= np.cbrt(rng.random(n))[:, None]
    colors = 0.2 + 0.6 * rng.random((n, 3))
    return gb.Scene(gb.Particles(positions, support=0.3, color=colors), device="cpu")


@pytest.fixture
def plotter():
    made = pyvista.Plotter(off_screen=True, window_size=SIZE, lighting="light kit")
    made.set_background("black")
    yield made
    made.close()


def look_from(plotter: object, *position: object) -> None:
    plotter.camera_position = position
    plotter.reset_camera_clipping_range()


def seen(plotter: object) -> np.ndarray:
    plotter.render()
    return np.asarray(plotter.screenshot(return_img=True))[..., :3].astype(int)


def assert_alone(plotter: object, scene: gb.Scene) -> None:
    image = seen(plotter)
    frame = gb.render(scene, gb.pyvista.camera_of(plotter.camera), SIZE, SETTINGS)
    hit = np.isfinite(frame.distance)
    assert 0.1 < hit.mean() < 0.9
    assert np.array_equal(image[hit], frame.image[hit].astype(int))
    assert not image[~hit].any()


def shown_aslant(plotter, parallel: bool) -> gb.Scene:
    """A ball in the plotter, from above and aside."""
    scene = ball()
    gb.pyvista.add_particles(plotter, scene, SETTINGS)
    if parallel:
        plotter.enable_parallel_projection()
        plotter.camera.parallel_scale = 1.7
    look_from(plotter, (3, 2, 4), (0.2, 0, 0), (0, 1, 0.2))
    return scene


@pytest.mark.parametrize("parallel", [False, True])
def test_the_pixels_are_those_of_render(plotter, parallel):
    scene = shown_aslant(plotter, parallel)
    assert_alone(plotter, scene)
    plotter.camera.azimuth = 50  # the surface follows
    plotter.reset_camera_clipping_range()
    assert_alone(plotter, scene)


def test_depth_against_a_mesh(plotter):
    scene = ball()
    plotter.add_mesh(pyvista.Plane(i_size=8, j_size=8), color=(255, 0, 0), lighting=False)
    actor = gb.pyvista.add_particles(plotter, scene, SETTINGS)
    look_from(plotter, (0.5, 3, 3), (0, 0, 0), (0, 0, 1))
    image, frame = seen(plotter), actor.frame
    hit = np.isfinite(frame.distance)
    above = np.zeros_like(hit)
    above[hit] = frame.position[hit][:, 2] > 0  # the eye is above the plane z = 0
    near = np.zeros_like(hit)
    near[hit] = np.abs(frame.position[hit][:, 2]) < 0.1  # pixels at the mesh's silhouette
    assert above.sum() > 500
    assert (hit & ~above).sum() > 100
    assert np.array_equal(image[above & ~near], frame.image[above & ~near].astype(int))
    assert (image == (255, 0, 0)).all(axis=2)[hit & ~above & ~near].all()


def test_a_translucent_mesh_before_the_surface(plotter):
    actor = gb.pyvista.add_particles(plotter, ball(), SETTINGS)
    plane = pyvista.Plane(center=(0, 0, 2), i_size=9, j_size=9)
    plotter.add_mesh(plane, color=(0, 0, 255), opacity=0.5, lighting=False)
    look_from(plotter, (0, 0, 6), (0, 0, 0), (0, 1, 0))
    image, hit = seen(plotter), np.isfinite(actor.frame.distance)
    expected = 0.5 * actor.frame.image[hit] + 0.5 * np.array([0, 0, 255])
    assert np.abs(image[hit] - expected).max() <= 2


def test_the_window_has_world_coordinates(plotter):
    """Of particles that are given from an origin, the window's meshes are not."""
    scene, origin = ball(), np.array([4e5, 5e6, 30.0])
    far = gb.Scene(gb.Particles(scene.particles.positions, support=0.3, origin=origin, color=scene.particles.color))
    gb.pyvista.add_particles(plotter, far, SETTINGS)
    look_from(plotter, origin + (0, 0, 4), origin, (0, 1, 0))
    image = seen(plotter)
    frame = gb.render(scene, gb.Camera((0, 0, 4), (0, 0, 0), fov=plotter.camera.view_angle), SIZE, SETTINGS)
    hit = np.isfinite(frame.distance)
    assert (np.abs(image[hit] - frame.image[hit].astype(int)) <= 1).all()
    assert not image[~hit].any()
    assert np.allclose(plotter.bounds[::2], origin - 1.2, atol=0.5)


def test_update_and_remove(plotter):
    actor = gb.pyvista.add_particles(plotter, ball(), SETTINGS)
    look_from(plotter, (0, 0, 6), (0, 0, 0), (0, 1, 0))
    first = seen(plotter)
    actor.update(positions=actor.scene.particles.positions + np.float32([0.5, 0, 0]))
    moved = seen(plotter)
    assert np.any(first, axis=2).nonzero()[1].mean() < np.any(moved, axis=2).nonzero()[1].mean() - 5
    actor.remove()
    assert not seen(plotter).any()


@pytest.mark.parametrize("parallel", [False, True])
def test_an_image_larger_than_the_window(plotter, parallel):
    """VTK makes it of parts, whose views are off their axis."""
    scene = shown_aslant(plotter, parallel)
    frame = gb.render(scene, gb.pyvista.camera_of(plotter.camera), (320, 240), SETTINGS)
    image = np.asarray(plotter.screenshot(return_img=True, scale=2))[..., :3].astype(int)
    differ = np.abs(image - frame.image.astype(int)).max(axis=2) > 1
    assert image.shape == (240, 320, 3)
    assert np.isfinite(frame.distance).mean() > 0.1
    assert differ[np.isfinite(frame.distance)].mean() < 0.01


def test_the_window_fits_the_particles(plotter):
    gb.pyvista.add_particles(plotter, ball(), SETTINGS)
    low, high = np.array(plotter.bounds).reshape(3, 2).T
    assert (low < -0.9).all()
    assert (high > 0.9).all()
    with pytest.raises(TypeError, match=r"plotter: expected a pyvista\.Plotter"):
        gb.pyvista.add_particles(object(), ball())
