"""Cuts: where they are met, what their faces show; where cuts, layers, the ground, lights and hollows meet."""

import functools

import globule as gb
import numpy as np
import pytest
from globule.render.lights import uniform_sky
from light import CAMERA, CENTER, ONE_SKY, RADIUS, ball, block, first_change, quiet, rays, unit
from quick import every
from scenes import cloud

SIZE = (48, 40)
C, R = CENTER, RADIUS
OFF = float(np.dot(C, (1, 2, 2)))
CUTS = {
    "plane": [gb.ClipPlane((1, 2, 2), OFF + 0.6 * R)],
    "plane not of unit normal": [gb.ClipPlane((10, 20, 20), 10 * OFF)],
    "half away": [gb.ClipPlane((-1, 0, 0), -C[0])],
    "box": [gb.ClipBox(C + (0, 0, 0), C + (2, 2, 2))],
    "box inside": [gb.ClipBox(C - 0.3 * R, C + 0.3 * R)],
    "box kept": [gb.ClipBox(C - (0.5, 0.4, 0.3) * np.array(R), C + R * 0.6, keep=True)],
    "sphere": [gb.ClipSphere(C + (0.3, 0.4, 0.5), 0.6 * R)],
    "sphere kept": [gb.ClipSphere(C + (0.2, 0.1, 0.0), 0.9 * R, keep=True)],
    "slab": [gb.ClipPlane((0, 0, 1), C[2] + 0.2 * R), gb.ClipPlane((0, 0, -1), 0.1 * R - C[2])],
    "corner": [gb.ClipPlane((1, 0, 0), C[0]), gb.ClipPlane((0, 1, 0), C[1]), gb.ClipPlane((0, 0, 1), C[2] + 0.3 * R)],
    "many": [
        gb.ClipPlane((1, 2, 2), OFF + 0.8 * R),
        gb.ClipBox(C, C + (2, 2, 2)),
        gb.ClipSphere(C + (0.3, -0.4, 0.5), 0.7 * R),
        gb.ClipBox(C - 0.9 * R, C + 0.9 * R, keep=True),
        gb.ClipSphere(C, 0.98 * R, keep=True),
    ],
    "nothing cut": [gb.ClipPlane((0, 0, 1), 1e6)],
    "all cut": [gb.ClipPlane((0, 0, 1), -1e6)],
    "disjoint": [gb.ClipBox(C - 5, C - 4, keep=True), gb.ClipBox(C + 4, C + 5, keep=True)],
}
CAMERAS = {
    "outside": CAMERA,
    "orthographic": gb.Camera((2, 3, 2), C, height=2.4 * R),
    "inside": gb.Camera(C + (0.12, 0.1, 0.5) * np.array(R), C, fov=100),
    "close": gb.Camera(C + (0.5, 0.6, 0.7) * np.array(R), C, fov=60),
}


def normal_of(clip, p):
    """Outward normals of the medium on a cut face."""
    if isinstance(clip, gb.ClipPlane):
        return np.broadcast_to(unit(clip.normal), p.shape)
    if isinstance(clip, gb.ClipSphere):
        n = unit(p - np.asarray(clip.center))
    else:
        middle, half = (np.add(clip.lo, clip.hi)) / 2, np.subtract(clip.hi, clip.lo) / 2
        x = (p - middle) / half
        n = np.sign(x) * (np.abs(x) == np.abs(x).max(-1, keepdims=True))
    return n if clip.keep else -n


@functools.cache
def changes(name, view, radii=(RADIUS,), aside=1e-4):
    """Where rays first change sides, at which clip, and which are sure: those a little aside meet the same."""
    clips, (o, d) = CUTS[name], rays(CAMERAS[view], SIZE)
    t, which = first_change(o, d, clips, radius=radii[0])
    sure = np.ones(t.shape, bool)
    for shift in aside * np.concatenate([np.eye(3), -np.eye(3)]):
        for radius in radii:
            t2, which2 = first_change(o, unit(d + shift), clips, radius=radius)
            with np.errstate(invalid="ignore"):
                sure &= (which2 == which) & ~(np.abs(t2 - t) > 0.03)
    return t, which, sure


@pytest.mark.few_backends
@pytest.mark.parametrize("view", CAMERAS)
@pytest.mark.parametrize("name", every(3, CUTS))
def test_cut_ball(backend, name, view):
    """Depth, normal and which pixels are hit, against brute force over all intervals."""
    clips, camera = CUTS[name], CAMERAS[view]
    frame = gb.render(ball(**backend), camera, SIZE, quiet(), clips)
    o, d = rays(camera, SIZE)
    t, which, sure = changes(name, view)
    assert sure.mean() > 0.85
    np.testing.assert_array_equal(frame.mask[sure], np.isfinite(t)[sure])
    seen = sure & np.isfinite(t)
    np.testing.assert_allclose(frame.distance[seen], t[seen], atol=2e-4)
    p = o + np.where(np.isfinite(t), t, 0)[..., None] * d
    for k in range(-1, len(clips)):
        here = seen & (which == k)
        n = (p[here] - C) / R if k < 0 else normal_of(clips[k], p[here])
        np.testing.assert_allclose(frame.normal[here], n, atol=2e-3)


@pytest.mark.parametrize("octree", ["sparse", "dense"])
@pytest.mark.parametrize("kernel", ["murakami", "blinn", "wendland_c2"])
def test_the_cut_face_shows_the_colors_inside(backend, kernel, octree):
    """Deep inside, where cells hold no lists of particles, as at the rim."""
    rng = np.random.default_rng(62)
    p = cloud(900, 62, 2.0)
    color = rng.uniform(0, 1, p.shape).astype(np.float32)
    scene = gb.Scene(gb.Particles(p, support=1.0, color=color), kernel=kernel, octree=octree, **backend)
    for clip in (
        gb.ClipPlane((1, 1, 2), 0.5),
        gb.ClipBox((0, -0.5, 0.2), (5, 5, 5)),
        gb.ClipSphere((1, 1, 2), 1.7),
        gb.ClipSphere((0, 0, 0), 1.4, keep=True),
    ):
        look = quiet(ambient=1.0)
        frame = gb.render(scene, gb.Camera((3, 4, 9), (0, 0, 0), fov=30), SIZE, look, [clip])
        at = frame.position.astype(np.float64)
        if isinstance(clip, gb.ClipPlane):
            face = np.abs(at @ (1, 1, 2) - 0.5) < 1e-5
        elif isinstance(clip, gb.ClipSphere):
            face = np.abs(np.linalg.norm(at - clip.center, axis=-1) - clip.radius) < 1e-5
        else:
            face = (np.abs(at - clip.lo) < 1e-5).any(-1)
        assert face.sum() > 150
        blend = scene.blend(frame.position[face], color)
        np.testing.assert_allclose(frame.albedo[face], blend, atol=1e-3)
        np.testing.assert_allclose(frame.color[face], blend, atol=1e-3)
        n = normal_of(clip, at[face])
        np.testing.assert_allclose(np.abs((frame.normal[face] * n).sum(-1)), 1, atol=1e-3)
        assert np.ptp(blend, axis=0).min() > 0.2


@pytest.mark.parametrize("own", [False, True], ids=["material", "particles"])
def test_light_falls_into_a_hollow(backend, own):
    """A shadow ray that begins where the medium was taken away and meets a cut face first."""
    k = 0.6
    factors = (None, None) if own else (0.0, k)
    particles = gb.Particles(C.reshape(1, 3), support=1.3, color=(1, 1, 1), reflection=[0.0], refraction=[k])
    look = quiet(
        lights=[gb.DirectionalLight((0, 1, 0), (1, 1, 1))],
        shadows=True,
        bounces=0,
        material=gb.Material(*factors, 1.0, absorption=1.5),
    )
    camera = gb.Camera(C, C + (0.02, -1, 0.01), up=(0, 0, 1), fov=70)
    clips = [gb.ClipSphere(C, 0.5 * R)]
    frame = gb.render(gb.Scene(particles, threshold=0.6, **backend), camera, (15, 11), look, clips)
    p = frame.position.astype(np.float64) - C
    np.testing.assert_allclose(np.linalg.norm(p, axis=-1), 0.5 * R, rtol=1e-4)
    up = -p[..., 1]  # straight up: past the hollow's ceiling, as high as its floor is low
    chord = np.sqrt(R**2 - p[..., 0] ** 2 - p[..., 2] ** 2) - up
    expected = (1 - k) * up / (0.5 * R) * k**2 * np.exp(-1.5 * chord)
    np.testing.assert_allclose(frame.color[..., 0], expected, rtol=5e-3)


# Where features meet

DOWN = gb.Camera((0, 0, 6), (0, 0, 0), height=1.0)
BELOW = gb.Camera((0, 0, -1), (0.1, 0, -2), fov=20)
SUNLIGHT = {"lights": [gb.DirectionalLight((0, 0, 1), (1, 1, 1))], "shadows": True}
GROUND = gb.Ground(-1.6, (0, 0, 1), color=1.0)


def veil(transmission, absorption=0.0):
    """What lets light straight through."""
    return gb.Material(0.0, transmission, 1.0, absorption=absorption)


def between(low, high):
    return [gb.ClipPlane((0, 0, 1), high), gb.ClipPlane((0, 0, -1), -low)]


@pytest.mark.parametrize("shadow", [False, True])
def test_layers_cut_by_the_same_planes(backend, shadow):
    """Their cut faces lie in the same place: light passes all of them, seen directly and as a shadow."""
    scene = block(**backend)
    veils = veil(0.9, 0.3), veil(0.8, 0.2), veil(0.7, 0.1)
    layers = [gb.Layer(scene, material) for material in veils]
    look, camera = quiet(sky=ONE_SKY, bounces=6), DOWN
    if shadow:
        look, camera = quiet(**SUNLIGHT, ground=GROUND), BELOW
    frame = gb.render(layers, camera, (9, 9), look, between(-0.5, 0.7))
    expected = (0.9 * 0.8 * 0.7) ** 2 * np.exp(-0.6 * 1.2)
    np.testing.assert_allclose(frame.color, expected, rtol=2e-3)


def test_matter_beyond_a_hollow_throws_a_shadow(backend):
    hollow = gb.ClipBox((-3, -3, -0.25), (3, 3, 0.25))
    look = quiet(**SUNLIGHT, material=veil(0.9, 0.5), ground=GROUND)
    frame = gb.render(block(**backend), BELOW, (9, 9), look, [hollow, *between(-0.5, 0.7)])
    np.testing.assert_allclose(frame.color, 0.9**4 * np.exp(-0.5 * 0.7), rtol=2e-3)


@pytest.mark.parametrize("inside", [False, True])
def test_a_light_inside_the_medium_is_absorbed(backend, inside):
    """On the ground, and on the surface seen from inside."""
    k, a = 0.6, 1.5
    look = quiet(
        lights=[gb.PointLight(C, (1, 1, 1))],
        shadows=True,
        material=veil(k, a),
        bounces=0,
        ground=gb.Ground(C[1] - 2 * R, color=1.0),
    )
    camera = gb.Camera(C - (0, 1.5 * R, 0), C - (0.01, 3, 0.02), up=(0, 0, 1), fov=50)
    if inside:
        camera = gb.Camera(C + (0.01, 0.02, 0), C - (0.01, 3, 0.02), up=(0, 0, 1), fov=50)
    frame = gb.render(ball(color=(1, 1, 1), **backend), camera, (9, 9), look)
    p = frame.position.astype(np.float64) - C
    if inside:
        np.testing.assert_allclose(np.linalg.norm(p, axis=-1), R, rtol=1e-4)
        expected = (1 - k) * np.exp(-a * R) * np.exp(-a * frame.distance)
    else:
        expected = 2 * R / np.linalg.norm(p, axis=-1) * k * np.exp(-a * R)
    np.testing.assert_allclose(frame.color[..., 0], expected, rtol=2e-3)


def test_an_opaque_medium_seen_from_inside_absorbs(backend):
    """With and without what makes a picture more than plain."""
    a = np.array([0.5, 1.0, 2.0])
    camera = gb.Camera(C + (0.1, 0.05, 0.02), C + (1, 2, 3), fov=70)
    for sky in (None, ONE_SKY):
        look = quiet(ambient=1.0, sky=sky, material=gb.Material(0.0, 0.0, color=1.0, absorption=a))
        frame = gb.render(ball(**backend), camera, (9, 9), look)
        np.testing.assert_allclose(frame.color, np.exp(-a * frame.distance[..., None]), rtol=1e-4)


def test_a_ground_never_mirrors_itself(backend):
    """Far away and at grazing angles, where rounding puts its points below it."""
    n = np.array([0.3, 1.0, 0.2])
    sky = gb.Sky((1, 1, 1), (1, 1, 1), (0, 0, 0), up=n)
    look = quiet(sky=sky, ground=gb.Ground(-3.0, n, color=0.0, reflection=1.0))
    along = np.cross(n, (0.3, 0.1, 1.0))
    camera = gb.Camera(C, C + along - 0.004 * n, up=n, fov=0.4)
    frame = gb.render(ball((90, 90, 90), **backend), camera, (48, 48), look)
    _, d = rays(camera, (48, 48))
    down = d @ n < -1e-6
    assert down.mean() > 0.6
    assert frame.distance[down].max() > 1000
    np.testing.assert_allclose(frame.color[down], 1, atol=1e-5)


def test_the_ground_shows_through_a_cut_that_lies_in_it(backend):
    black = uniform_sky((0, 0, 0))
    look = quiet(
        ambient=1.0, sky=black, material=veil(0.9), **SUNLIGHT, ground=gb.Ground(-0.5, (0, 0, 1), color=(0.2, 0.4, 0.6))
    )
    for camera in (DOWN, gb.Camera((0.3, 0.2, 6), (0.1, 0, 0), fov=10)):
        scene = block(color=(0, 0, 0), **backend)
        frame = gb.render(scene, camera, (9, 9), look, between(-0.5, 0.7))
        ground = np.array((0.2, 0.4, 0.6)) * (1 + 0.9**2)
        expected = np.broadcast_to(0.9**2 * ground, frame.color.shape)
        np.testing.assert_allclose(frame.color, expected, atol=1e-3)


def test_picking_takes_the_layer_that_is_seen(backend):
    """Though particles of another are nearer, whose matter is cut away; and never the ground."""

    def one(z, kind):
        p = np.array([[0, 0, z]], np.float32)
        particles = gb.Particles(p, support=2.0, attributes={"kind": np.array([kind])})
        return gb.Scene(particles, threshold=0.6, **backend)

    layers = [gb.Layer(one(0.9, 2.0), None, [gb.ClipPlane((0, 0, 1), 0.0)]), one(0.0, 1.0)]
    camera = gb.Camera((0, 0, 5), (0, 0, 0), height=4.0)
    frame = gb.render(layers, camera, (21, 21), quiet(ground=gb.Ground(-0.8, (0, 0, 1))))
    found = frame.pick(10, 10)
    assert (found.layer, found.particle, found.attributes["kind"]) == (1, 0, 1.0)
    assert found.position[2] == pytest.approx(2.0 * np.sqrt(1 - np.sqrt(0.6)), abs=0.02)
    ground = np.abs(frame.position[..., 2] + 0.8) < 1e-5
    assert ground.mean() > 0.3
    for row, column in np.argwhere(ground)[::17]:
        assert frame.pick(int(column), int(row)) is None
    # Attributes are the first scene's: not where the second one or the ground is seen.
    assert np.isnan(frame.attribute(np.ones(1, np.float32))).all()


def test_camera_inside_where_more_overlap_than_a_list_holds(backend):
    """The side where such a ray begins is found in float64, as of rays from outside."""
    near = np.random.default_rng(5).normal(scale=0.01, size=(3000, 3))
    scene = gb.Scene(gb.Particles(near, support=1.0), threshold=2700, **backend)
    camera = gb.Camera((0.03, 0.02, 0.01), (1, 0, 0), fov=60)
    clear = gb.render(
        scene, camera, (5, 4), quiet(sky=ONE_SKY, material=veil(0.8, 0.5), bounces=1), [gb.ClipPlane((0, 0, 1), 9.0)]
    )
    plain = gb.render(scene, camera, (5, 4))
    assert plain.mask.all()
    assert (plain.distance < 0.3).all()
    np.testing.assert_allclose(clear.distance, plain.distance, atol=1e-5)
    left = 0.8 * np.exp(-0.5 * clear.distance)
    np.testing.assert_allclose(clear.color, np.repeat(left[..., None], 3, -1), atol=1e-4)
