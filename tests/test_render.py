"""Pictures against what is known exactly: silhouettes, orientation, lights, blended attributes."""

import globule as gb
import numpy as np
import oracle
import pytest
from light import CENTER, RADIUS, ball, meet_ball, rays
from scenes import KERNELS, Case, case, cloud
from test_field import FORMULAS

CAMERAS = {
    "perspective": gb.Camera((2, 1.5, 3), (0, 0, 0), fov=35),
    "orthographic": gb.Camera((2, 1.5, 3), (0, 0, 0), height=2.2),
    "close": gb.Camera((0.9, 0.2, 0.9), (0, 0, 0), up=(0.2, 1, 0.3), fov=75),
}


@pytest.mark.parametrize("name", CAMERAS)
@pytest.mark.parametrize("size", [(120, 90), (37, 61), (1, 1), (9, 200)], ids=str)
def test_one_ball(backend, name, size):
    camera = CAMERAS[name]
    frame = gb.render(ball(**backend), camera, size)
    o, d = rays(camera, size)
    depth, _, distance = (v[..., 0] for v in meet_ball(o, d))
    assert frame.distance.shape == frame.mask.shape == (size[1], size[0])
    clear = np.abs(distance - RADIUS) > 1e-5
    np.testing.assert_array_equal(frame.mask[clear], np.isfinite(depth)[clear])
    np.testing.assert_array_equal(frame.mask, np.isfinite(frame.distance))
    inner = distance < 0.999 * RADIUS
    np.testing.assert_allclose(frame.distance[inner], depth[inner], atol=3e-5)
    position = o + frame.distance[..., None] * d
    np.testing.assert_allclose(frame.position[inner], position[inner], atol=3e-6)
    normal = (frame.position - CENTER) / RADIUS
    np.testing.assert_allclose(frame.normal[inner], normal[inner], atol=2e-4)
    np.testing.assert_allclose(np.linalg.norm(frame.normal[frame.mask], axis=-1), 1, atol=1e-5)
    assert np.isnan(frame.position[~frame.mask]).all()
    np.testing.assert_array_equal(frame.normal[~frame.mask], 0)
    np.testing.assert_allclose(frame.albedo[frame.mask], [[1, 0.5, 0.25]] * frame.mask.sum())


@pytest.mark.parametrize("kernel", KERNELS)
def test_silhouette_in_pixels(backend, kernel):
    """tan(asin(R / D)) / tan(fov / 2) half images for a pinhole, R / (height / 2) without one."""
    q = np.linspace(0, 1, 200_001)
    radius = np.interp(-0.6, -FORMULAS[kernel](q), q)
    scene = gb.Scene(np.zeros((1, 3)), kernel=kernel, support=1.0, threshold=0.6, **backend)
    eye, half = (0, 0, 2.5), 100
    pinhole = gb.Camera(eye, (0, 0, 0), fov=50)
    seen = np.tan(np.arcsin(radius / 2.5)) / np.tan(np.radians(25)) * half
    flat = gb.Camera(eye, (0, 0, 0), height=2.0)
    for camera, expected in ((pinhole, seen), (flat, radius * half)):
        frame = gb.render(scene, camera, (2 * half + 40, 2 * half))
        assert np.sqrt(frame.mask.sum() / np.pi) == pytest.approx(expected, abs=0.15)
        y, x = np.nonzero(frame.mask)
        assert abs(np.ptp(x) + 1 - 2 * expected) <= 1.5
        assert abs(np.ptp(y) + 1 - 2 * expected) <= 1.5
        assert x.mean() == pytest.approx(half + 19.5, abs=0.05)
        assert y.mean() == pytest.approx(half - 0.5, abs=0.05)


@pytest.mark.parametrize("height", [None, 6.0])
def test_image_orientation(backend, height):
    p = np.array([[2, 0, 0], [0, 1.5, 0], [-2, -1.5, 0], [-2, -1.5, -1]], np.float32)
    colors = np.array([[1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 1]], np.float32)
    scene = gb.Scene(gb.Particles(p, support=0.6, color=colors), **backend)
    frame = gb.render(scene, gb.Camera((0, 0, 8), (0, 0, 0), height=height), (80, 60))
    for color, right, low in (((1, 0, 0), True, None), ((0, 1, 0), None, False), ((0, 0, 1), False, True)):
        ys, xs = np.nonzero((np.abs(frame.albedo - color) < 1e-5).all(-1))
        assert len(xs) > 5
        assert right is None or (xs.mean() > 45 if right else xs.mean() < 35)
        assert low is None or (ys.mean() > 35 if low else ys.mean() < 25)
    np.testing.assert_array_equal(frame.distance[20:40, 35:45], np.inf)


def test_up_turns_the_image(backend):
    scene = gb.Scene(np.array([[0, 1.5, 0]]), support=0.6, **backend)
    for up, (right, down) in {(1, 0, 0): (-1, 0), (0, -1, 0): (0, 1), (-1, 0, 0): (1, 0)}.items():
        y, x = np.nonzero(gb.render(scene, gb.Camera((0, 0, 8), (0, 0, 0), up=up), (64, 64)).mask)
        assert np.sign(np.round((x.mean() - 31.5) / 10)) == right
        assert np.sign(np.round((y.mean() - 31.5) / 10)) == down


def test_directional_and_point_light(backend):
    camera, size = CAMERAS["perspective"], (80, 60)
    toward, place = np.array([1.0, 2.0, 0.5]), np.array([1.5, 0.3, 1.0])
    radiance = (0.8, 0.6, 0.4)
    for light in (gb.DirectionalLight(toward, radiance), gb.PointLight(place, radiance)):
        look = gb.RenderSettings(lights=[light], ambient=(0.1, 0.2, 0.3), specular=0)
        frame = gb.render(ball(**backend), camera, size, look)
        m = frame.mask
        to = place - frame.position[m] if isinstance(light, gb.PointLight) else toward
        to = to / np.linalg.norm(to, axis=-1, keepdims=True)
        cosine = np.maximum((frame.normal[m] * to).sum(-1), 0)[:, None]
        expected = frame.albedo[m] * ([0.1, 0.2, 0.3] + cosine * [0.8, 0.6, 0.4])
        np.testing.assert_allclose(frame.color[m], expected, atol=1e-5)
        assert (cosine == 0).any()
        assert (cosine > 0.9).any()


def test_background_and_tone(backend):
    look = {"background": (0.1, 0.5, 5.0)}
    frame = gb.render(ball(**backend), CAMERAS["perspective"], (60, 40), look)
    outside = ~frame.mask
    np.testing.assert_allclose(frame.color[outside], [[0.1, 0.5, 5.0]] * outside.sum())
    r, g, b = frame.picture[outside][0]
    assert frame.picture.dtype == np.uint8
    assert r == round(255 * (1.055 * 0.1 ** (1 / 2.4) - 0.055))  # sRGB
    assert g == round(255 * (1.055 * 0.5 ** (1 / 2.4) - 0.055))
    assert 245 < b <= 255
    assert (frame.picture[outside] == (r, g, b)).all()
    # Exposure: brighter is never darker, and the linear image stays as it is.
    look["exposure"] = 2
    brighter = gb.render(ball(**backend), CAMERAS["perspective"], (60, 40), look)
    np.testing.assert_array_equal(brighter.color, frame.color)
    assert (brighter.picture >= frame.picture).all()
    assert (brighter.picture > frame.picture).any()


def blend_truth(c: Case, points: np.ndarray, values: np.ndarray) -> np.ndarray:
    """sum w v / sum w, w = max(weight b, 0), from fields of one particle each."""
    n = len(c.positions)
    support, weight = np.broadcast_to(c.support, n), np.broadcast_to(c.weight, n)
    w = np.stack([oracle.field(c.positions[i], support[i], weight[i], c.kernel, points)[0] for i in range(n)], 1).clip(
        0
    )
    return w @ values / w.sum(1, keepdims=True)


@pytest.mark.parametrize("name", ["hundred", "weights wyvill", "cloud blinn"])
def test_colors_and_attributes_are_blended_by_influence(backend, name):
    c, rng = case(name), np.random.default_rng(70)
    n = len(c.positions)
    color, speed = rng.uniform(0, 1, (n, 3)), rng.normal(size=n).astype(np.float32)
    particles = gb.Particles(c.positions, support=c.support, weight=c.weight, color=color)
    scene = gb.Scene(particles, kernel=c.kernel, threshold=c.threshold, **backend)
    frame = gb.render(scene, gb.Camera((1.5, 1, 3), (0, 0, 0)), (50, 40))
    points = frame.position[frame.mask].astype(np.float64)
    assert 100 < len(points) < 2000
    truth = blend_truth(c, points, np.column_stack([color, speed]))
    np.testing.assert_allclose(frame.albedo[frame.mask], truth[:, :3], atol=2e-4)
    blended = frame.attribute(speed)
    assert blended.shape == frame.mask.shape
    np.testing.assert_allclose(blended[frame.mask], truth[:, 3], atol=1e-3)
    assert np.isnan(blended[~frame.mask]).all()
    both = frame.attribute(np.column_stack([speed, color]).astype(np.float32))
    assert both.shape == (40, 50, 4)
    np.testing.assert_allclose(both[frame.mask][:, 0], blended[frame.mask], atol=1e-5)
    # And straight at points, with NaN where nothing reaches.
    at = np.concatenate([cloud(50, 71, 0.8), [[40, 0, 0]]]).astype(np.float32)
    with np.errstate(invalid="ignore"):
        expected = blend_truth(c, at, speed[:, None])[:, 0]
    np.testing.assert_allclose(scene.blend(at, speed), expected, atol=1e-3)


def test_a_frame_outlives_the_next_one(backend):
    scene = gb.Scene(gb.Particles(cloud(3000, 72), support=0.15), **backend)
    first, kept = gb.render(scene, size=(64, 48)), gb.render(scene, size=(64, 48)).picture
    scene.update(positions=cloud(500, 74), support=0.1, color=None)
    assert gb.render(scene, CAMERAS["perspective"], size=(128, 96)).picture.shape == (96, 128, 3)
    np.testing.assert_array_equal(first.picture, kept)
    del scene
    np.testing.assert_array_equal(first.picture, kept)


@pytest.mark.parametrize("orthographic", [False, True])
@pytest.mark.parametrize("size", [(160, 120), (60, 150)], ids=str)
def test_fit_shows_everything(backend, orthographic, size):
    scene = gb.Scene(cloud(2000, 75) * np.array([3, 1, 0.5], np.float32) + 7, support=0.3, **backend)
    for direction in ((0.6, 0.45, 1), (0, 1, 0), (-1, 0, 0)):
        camera = gb.Camera.fit(scene, direction=direction, size=size, margin=0.3, orthographic=orthographic)
        mask = gb.render(scene, camera, size).mask
        assert not (mask[0].any())
        assert not (mask[-1].any())
        assert not (mask[:, 0].any())
        assert not (mask[:, -1].any())
        y, x = np.nonzero(mask)
        assert max(np.ptp(x) / size[0], np.ptp(y) / size[1]) > 0.5


def test_save(backend, tmp_path):
    from PIL import Image

    frame = gb.render(ball(**backend), CAMERAS["perspective"], (60, 40))
    frame.save(tmp_path / "a.png")
    np.testing.assert_array_equal(np.asarray(Image.open(tmp_path / "a.png")), frame.picture)
    frame.save(tmp_path / "a.npz")
    with np.load(tmp_path / "a.npz") as images:
        for name in ("color", "distance", "position", "normal", "albedo", "mask"):
            np.testing.assert_array_equal(images[name], getattr(frame, name))
    with pytest.raises(ValueError, match="png"):
        frame.save(tmp_path / "a.jpg")
    assert sorted(f.name for f in tmp_path.iterdir()) == ["a.npz", "a.png"]
