"""Colors that stand for values: they survive the light, and are exact where there is none."""

import dataclasses
import itertools

import globule as gb
import numpy as np
import pytest
from globule._base.colormaps import map_colors, to_linear
from globule.data.attributes import attribute_names, attribute_values
from globule.render.display import displayed, shoulder
from globule.render.settings import for_values
from globule.sim.sources import ParticleFile
from scipy import ndimage


@pytest.fixture(scope="module")
def particles() -> gb.Particles:
    rng = np.random.default_rng(8)
    positions = rng.normal(size=(400, 3)).astype(np.float32) * (0.6, 0.3, 0.3)
    attributes = {"x0": positions[:, 0], "noise": rng.uniform(-3, 5, 400)}
    return gb.Particles(positions, support=0.4, attributes=attributes)


def steps_off(image: np.ndarray, values: np.ndarray, lo: float, hi: float) -> np.ndarray:
    """By how many of the map's 255 steps colors (N, 3) uint8 differ from values (N,)."""
    steps = np.linspace(0, 255, 2041)
    light = gb.colorize(steps, "viridis", 0, 255).astype(np.float64)
    low = light <= 0.0031308
    table = 255 * np.where(low, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)
    colors, which = np.unique(image, axis=0, return_inverse=True)
    nearest = np.square(colors[:, None] - table[None]).sum(axis=2).argmin(axis=1)[which.reshape(-1)]
    return np.abs(steps[nearest] - 255 * (values - lo) / (hi - lo))


@pytest.mark.parametrize("name", ["x0", "noise"])
def test_flat_pixels_have_the_map_s_color_of_their_value(particles, name, backend):
    values, scene = particles.attributes[name], gb.Scene(particles, **backend)
    frame = gb.render(scene, size=(160, 120), settings=gb.load_preset("flat", scene), color_by=name)
    shown = frame.attribute(values)
    hit = np.isfinite(shown)
    assert hit.sum() > 2000
    assert steps_off(frame.image[hit], shown[hit], values.min(), values.max()).max() <= 1.0
    # What is beside the surface is the background.
    assert (frame.image[~hit] == frame.image[0, 0]).all()


def test_flat_is_exact_and_without_values_shows_the_particles_own_colors(particles):
    color = to_linear(np.array([30, 200, 120]) / 255)
    scene = gb.Scene(gb.Particles(np.zeros((1, 3)), support=1.0, color=color.astype(np.float32)))
    frame = gb.render(scene, size=(64, 64), settings=gb.load_preset("flat", scene))
    assert (frame.image[frame.mask] == (30, 200, 120)).all()
    assert (displayed(to_linear(np.arange(256) / 255).astype(np.float32)) == np.arange(256)).all()
    assert displayed(np.float32([0, 1, 7, np.inf])).tolist() == [0, 255, 255, 255]
    light = np.linspace(0, 3, 50)
    curved = shoulder(light)
    assert (curved[light <= 0.8] == light[light <= 0.8]).all()
    assert (np.diff(curved) > 0).all()
    assert curved.max() < 1
    flat = dataclasses.replace(gb.load_preset("flat", gb.Scene(particles)), samples=8)
    frame = gb.render(particles, size=(160, 120), settings=flat, color_by="noise")
    values, shown = particles.attributes["noise"], frame.attribute(particles.attributes["noise"])
    inside = ndimage.binary_erosion(np.isfinite(shown), np.ones((3, 3)))
    assert steps_off(frame.image[inside], shown[inside], values.min(), values.max()).max() <= 1.0
    assert ((frame.alpha > 0) & (frame.alpha < 1)).sum() > 100


def test_light_keeps_the_hue_of_values(particles, backend):
    frame = gb.render(gb.Scene(particles, **backend), size=(160, 120), color_by="x0")
    hit = frame.mask
    color, albedo = frame.color[hit].astype(np.float64), frame.albedo[hit].astype(np.float64)
    share = color.sum(axis=1) / albedo.sum(axis=1)
    assert np.abs(color - share[:, None] * albedo).max() < 1e-5
    assert share.min() >= 0.55 - 1e-4
    assert share.max() <= 1.0 + 1e-4
    assert share.max() > 0.95
    assert np.ptp(share) > 0.2  # the shape is still seen
    assert (np.abs(frame.image.astype(int) - displayed(frame.color)) == 0).all()
    # The hue alone gives the value back, as it does in the map's own colors.
    table = to_linear(map_colors("viridis", 256) / 255)
    table /= np.linalg.norm(table, axis=1, keepdims=True)
    known = particles.attributes["x0"]
    shown = 255 * (frame.attribute(known)[hit] - known.min()) / np.ptp(known)
    found = (color / np.linalg.norm(color, axis=1, keepdims=True) @ table.T).argmax(axis=1)
    assert np.percentile(np.abs(found - shown), 99) <= 2.0


def test_lights_presets_and_highlights_that_are_asked_for_stay(particles):
    scene, own = gb.Scene(particles), (gb.DirectionalLight((0, 0, 1), 0.5),)
    frame = gb.render(scene, size=(64, 48), settings={"lights": own, "specular": 0.7}, color_by="x0")
    assert (frame._settings.lights, frame._settings.specular) == (own, 0.7)
    clay = gb.load_preset("clay", scene)
    lit = for_values(clay)
    assert (lit.lights, lit.tone, lit.material.color) == (clay.lights, True, None)
    plain = for_values(gb.RenderSettings())
    assert (plain.specular, plain.tone, for_values(plain)) == (0, False, plain)
    assert for_values(gb.RenderSettings(exposure=1.5)).tone


@pytest.mark.few_backends
@pytest.mark.parametrize(("samples", "more"), [
    *itertools.product(
        [{"samples": 1}, {"samples": 8}], [{}, {"shadows": True, "ambient_rays": 2}, {"sky": gb.Sky()}]
    ),
    ({"edge_samples": 3}, {}),
])  # fmt: skip
def test_light_of_the_hits_and_background_make_the_opaque_image(particles, samples, more, backend):
    scene = gb.Scene(particles, **backend)
    settings = gb.RenderSettings(**samples, background=(0.2, 0.4, 0.9), **more)
    clear = dataclasses.replace(settings, transparent=True)
    opaque, frame = (gb.render(scene, size=(120, 90), settings=s) for s in (settings, clear))
    assert frame.image.shape == (90, 120, 4)
    alpha = frame.alpha
    counts = alpha * samples.get("samples", 4)
    assert np.abs(counts - np.rint(counts)).max() < 1e-4
    assert (alpha[0, 0], alpha.max(), len(np.unique(np.rint(counts))) > 4) == (0, 1, samples != {"samples": 1})
    assert (opaque.alpha == alpha).all()
    if "sky" not in more:  # which has another color in each pixel
        behind = (1 - alpha[..., None]) * np.float32(settings.background)
        assert np.abs(frame.color + behind - opaque.color).max() < 2e-5
    solid = alpha == 1
    assert np.abs(frame.image[solid][:, :3].astype(int) - opaque.image[solid]).max() <= 1
    assert (frame.image[..., 3] == np.rint(255 * alpha)).all()


def test_alpha_counts_the_ground_survives_refining_and_has_no_fringe(particles):
    level = gb.Camera((0, 0, 6), (0, 0, 0))  # the horizon is in the middle
    frame = gb.render(particles, level, (80, 60), {"ground": gb.Ground(-1.0), "transparent": True})
    assert 0.5 < frame.mask.mean() < 0.8
    assert (frame.alpha == frame.mask).all()
    before = frame.alpha
    frame.refine(3)
    after = frame.alpha
    assert (after[0, 0], after[-1, -1]) == (0, 1)
    assert (np.abs(after - before) < 1).all()
    assert len(np.unique(after)) > 2
    scene = gb.Scene(gb.Particles(np.zeros((1, 3)), support=1.0, color=np.float32([1, 1, 1])))
    flat = dataclasses.replace(gb.load_preset("flat", scene), samples=16, transparent=True)
    image = gb.render(scene, size=(64, 64), settings=flat).image
    mixed = (image[..., 3] > 0) & (image[..., 3] < 255)
    assert mixed.sum() > 50
    assert image[mixed][:, :3].min() >= 254


def test_a_frame_that_was_refined_knows_what_it_shows_and_speed_is_a_length(particles):
    scene = gb.Scene(particles)
    other = gb.Scene(gb.Particles(particles.positions + np.float32(50), support=0.4))
    camera = gb.Camera.fit(particles, size=(80, 60))
    two = gb.render([other, scene], camera, (80, 60), {"samples": 2})
    assert 1 in np.unique(two._layer)
    del two  # its memory goes to the next frame
    frame = gb.render(scene, camera, (80, 60), {"samples": 2})
    first = frame.attribute(particles.attributes["x0"])
    for _ in range(3):
        frame.refine()
        assert np.array_equal(frame.attribute(particles.attributes["x0"]), first, equal_nan=True)
        assert frame.pick(40, 30).layer == 0
    velocity = np.random.default_rng(2).normal(size=(400, 3))
    moving = gb.Particles(particles.positions, support=0.4, attributes={"velocity": velocity})
    assert attribute_names(moving) == ["x", "y", "z", "support", "speed", "velocity"]
    expected = np.linalg.norm(velocity, axis=1)
    np.testing.assert_allclose(attribute_values(moving, "speed"), expected, rtol=1e-12)
    moving.attributes["speed"] = expected + 1.0  # a file's own is taken as it is
    assert attribute_names(moving).count("speed") == 1
    np.testing.assert_allclose(attribute_values(moving, "speed"), expected + 1.0, rtol=1e-12)
    with pytest.raises(ValueError, match="expected one of x, y, z, support, got speed"):
        attribute_values(gb.Particles(particles.positions, support=0.4), "speed")
    component = gb.Particles(particles.positions, attributes={"v": np.ones(400)})
    assert "speed" not in attribute_names(component)


@pytest.mark.parametrize("name", ["velocities", "vel", "velo", "v", "Velocity"])
def test_speed_by_the_names_of_velocity(particles, tmp_path, name):
    """The names of programs give speed, and start the particles of a simulation."""
    velocity = np.random.default_rng(2).normal(size=(400, 3)).astype(np.float32)
    path = tmp_path / "moving.npz"
    np.savez(path, positions=particles.positions, **{name: velocity}, vel_scalar=velocity[:, 0])
    moving = gb.read(path)
    assert attribute_names(moving)[3:5] == ["speed", name]
    speed = np.linalg.norm(velocity.astype(float), axis=1)
    np.testing.assert_allclose(attribute_values(moving, "speed"), speed, rtol=1e-6)
    assert np.array_equal(ParticleFile(file=str(path)).load()[1], velocity)
