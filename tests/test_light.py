"""Mirrors, glass and shadows against closed forms, energy in a furnace, Fresnel, Beer, ambient occlusion."""

import globule as gb
import numpy as np
import oracle
import pytest
from light import (
    CAMERA,
    CENTER,
    MIRROR,
    ONE_SKY,
    RADIUS,
    SUPPORT,
    ball,
    block,
    direction_sky,
    dot,
    fresnel,
    glass,
    glass_ball,
    meet_ball,
    mirrored,
    quiet,
    rays,
    sky_of,
    unit,
)
from quick import every
from scenes import KERNELS, cloud

SKY = direction_sky()
SIZE = (48, 40)


@pytest.mark.parametrize(
    ("index", "depth", "absorption"),
    [*((n, depth, 0.0) for n in (1.0, 1.33, 1.5, 2.4) for depth in (0, 1, 2, 5)), (1.5, 6, 1.2)],
)
def test_glass_ball(backend, index, depth, absorption):
    """Every internal path absorbs by its own length; rays that miss see the sky."""
    look = quiet(sky=SKY, material=glass(index, absorption=absorption), bounces=depth)
    frame = gb.render(ball(**backend), CAMERA, SIZE, look)
    o, d = rays(CAMERA, SIZE)
    away = meet_ball(o, d)[2][..., 0]
    clear = np.abs(away - RADIUS) > 0.01 * RADIUS
    expected = glass_ball(o, d, index, depth, absorption=absorption)
    error = np.abs(frame.color - expected).max(-1)[clear]
    assert error.max() < 0.01
    assert error.mean() < 4e-4


def test_total_internal_reflection(backend):
    """From inside, directions past the critical angle see the ball's inside mirrored."""
    index = 1.5
    eye = CENTER + np.array([0.75 * RADIUS, 0, 0])
    camera = gb.Camera(eye, eye + (0.1, 0.2, 1.0), fov=100)
    for depth in (0, 1, 6):
        look = quiet(sky=SKY, material=glass(index), bounces=depth)
        frame = gb.render(ball(**backend), camera, SIZE, look)
        o, d = rays(camera, SIZE)
        far = meet_ball(o, d)[1]
        sine = np.sqrt(1 - dot(d, (o + far * d - CENTER) / RADIUS) ** 2)[..., 0]
        total = sine > 1 / index
        assert 200 < total.sum() < total.size - 200
        np.testing.assert_allclose(frame.distance, far[..., 0], atol=3e-5)
        error = np.abs(frame.color - glass_ball(o, d, index, depth, inside=True)).max(-1)
        clear = np.abs(sine - 1 / index) > 0.01
        assert error[clear].max() < 0.012
        assert error[clear].mean() < 5e-4


@pytest.mark.parametrize("index", [1.2, 1.5, 2.0, 4.0])
def test_fresnel(backend, index):
    """Straight on ((n - 1) / (n + 1))^2, at a glance 1, in between the two polarisations' mean."""
    look = quiet(sky=ONE_SKY, bounces=1, material=gb.Material(0.0, 0.0, index))
    camera = gb.Camera(CENTER + (0, 0, 6), CENTER, height=2 * RADIUS)
    color = gb.render(ball(**backend), camera, (201, 201), look).color
    assert color[100, 100, 0] == pytest.approx(((index - 1) / (index + 1)) ** 2, abs=1e-4)
    x = (np.arange(201) + 0.5) / 201 * 2 - 1
    cosine = np.sqrt(1 - x**2)
    np.testing.assert_allclose(color[100, :, 0], fresnel(cosine, index), atol=4e-3)
    rim = CENTER + (RADIUS, 0, 0)
    camera = gb.Camera(rim + (0, 0, 6), rim, height=1e-5 * RADIUS)
    frame = gb.render(ball(**backend), camera, (99, 1), look)
    glance = frame.color[frame.mask][:, 0]
    assert 30 < len(glance) < 70
    assert glance.max() > 0.93
    assert 0.7 < glance.min() < 0.9


def test_schlick(backend):
    """A reflection factor without an index grows towards grazing angles by Schlick's rule."""
    look = quiet(sky=ONE_SKY, material=gb.Material(reflection=0.3, transmission=0.0))
    camera = gb.Camera(CENTER + (0, 0, 6), CENTER, height=2 * RADIUS)
    color = gb.render(ball(**backend), camera, (101, 101), look).color[50, :, 0]
    cosine = np.sqrt(1 - ((np.arange(101) + 0.5) / 101 * 2 - 1) ** 2)
    np.testing.assert_allclose(color, 0.3 + 0.7 * (1 - cosine) ** 5, atol=3e-3)


MATTERS = {
    "clay": gb.Material(0.0, 0.0),
    "mirror": MIRROR,
    "glass": glass(1.5),
    "water": glass(4 / 3),
    "rough mirror": gb.Material(1.0, 0.0, roughness=0.6),
    "rough glass": glass(1.5, roughness=0.4),
    "half mirror": gb.Material(0.4, 0.0),
    "half glass": gb.Material(0.2, 0.5, 1.4, absorption=0.0),
    "filter": gb.Material(0.1, 0.7),
    "particles' own": gb.Material(),
}


@pytest.mark.few_backends
@pytest.mark.parametrize("matter", every(3, MATTERS))
def test_furnace(backend, matter):
    """Where all around is 1 and nothing absorbs, everything is 1: no energy comes or goes."""
    rng = np.random.default_rng(60)
    particles = gb.Particles(
        cloud(60, 60), support=0.6, color=(1, 1, 1), reflection=rng.uniform(0, 1, 60), refraction=rng.uniform(0, 1, 60)
    )
    scene = gb.Scene(particles, threshold=0.6, **backend)
    camera = gb.Camera((1.5, 1, 2.5), (0, 0, 0), fov=45)
    for depth, cutoff in ((0, 0.0), (3, 1 / 128), (12, 0.0)):
        look = quiet(sky=ONE_SKY, ambient="sky", material=MATTERS[matter], bounces=depth, cutoff=cutoff, samples=2)
        color = gb.render(scene, camera, (40, 30), look).color
        assert color.max() < 1.01
        assert color.min() > 0.99


def test_furnace_with_ambient_rays(backend):
    """A ball alone hides nothing from itself; in a cloud light can only be lost."""
    look = quiet(sky=ONE_SKY, ambient="sky", ambient_rays=16, ambient_distance=9.0, material=gb.Material(0.0, 0.0))
    color = gb.render(ball(color=(1, 1, 1), **backend), CAMERA, SIZE, look).color
    np.testing.assert_allclose(color, 1, atol=1e-2)
    many = gb.Scene(gb.Particles(cloud(60, 60), support=0.6, color=(1, 1, 1)), **backend)
    color = gb.render(many, size=SIZE, settings=look).color
    assert color.max() < 1.01
    assert color.min() < 0.5


@pytest.mark.parametrize("index", [1.0, 1.5])
def test_beer_through_a_slab(backend, index):
    """A block cut flat by two planes, seen from all angles; between its faces light bounces."""
    thick, a = 2.6, np.array([0.2, 0.5, 1.0])
    clips = [gb.ClipPlane((0, 0, 1), thick / 2), gb.ClipPlane((0, 0, -1), thick / 2)]
    look = quiet(sky=ONE_SKY, material=glass(index, absorption=a), bounces=12)
    camera = gb.Camera((0.4, 0.3, 12), (0, 0, 0), fov=12)
    frame = gb.render(block(**backend), camera, (24, 20), look, clips)
    _, d = rays(camera, (24, 20))
    cosine = -d[..., 2:]
    inner = np.sqrt(1 - (1 - cosine**2) / index**2)
    f, left = fresnel(cosine, index), np.exp(-a * thick / inner)
    through = (1 - f) ** 2 * left / (1 - (f * left) ** 2)
    back = f + f * (1 - f) ** 2 * left**2 / (1 - (f * left) ** 2)
    np.testing.assert_allclose(frame.distance, (12 - thick / 2) / cosine[..., 0], rtol=1e-5)
    np.testing.assert_allclose(frame.color, through + back, rtol=0.005)


@pytest.mark.parametrize("kernel", KERNELS)
@pytest.mark.parametrize("octree", ["sparse", "dense"])
def test_mirror_and_glass_of_every_kernel(backend, kernel, octree):
    """One metaball of any kernel is a ball: its mirror and its glass show the same sky."""
    from test_field import FORMULAS

    q = np.linspace(0, 1, 200_001)
    radius = SUPPORT * np.interp(-0.6, -FORMULAS[kernel](q), q)
    scene = ball(kernel=kernel, octree=octree, **backend)
    camera = gb.Camera(CENTER + (0, 0, 5), CENTER, height=2.2 * radius)
    o, d = rays(camera, (24, 24))
    near, _, away = meet_ball(o, d, radius=radius)
    seen = (away < 0.98 * radius)[..., 0]
    normal = (o + near * d - CENTER) / radius
    mirror = gb.render(scene, camera, (24, 24), quiet(sky=SKY, material=MIRROR))
    np.testing.assert_allclose(mirror.color[seen], sky_of(mirrored(d, normal))[seen], atol=3e-3)
    straight = gb.render(scene, camera, (24, 24), quiet(sky=SKY, material=glass(1.0)))
    np.testing.assert_allclose(straight.color, sky_of(d), atol=5e-3)


# Shadows hard and soft, and ambient occlusion

ABOVE = gb.Camera((0.2, 5, 2.5), (0.2, -1, 0.2), fov=35)
GROUND = gb.Ground(-1.0, color=1.0)
CLAY = gb.Material(0.0, 0.0)


@pytest.mark.parametrize("shadows", [False, True])
def test_terminator(backend, shadows):
    """A ball alone is lit exactly where n·l > 0, by n·l, with shadows as without."""
    sun = unit((-1, 0.7, 0.2))
    light = gb.DirectionalLight(sun, (1, 0.5, 0.25))
    look = quiet(lights=[light], shadows=shadows, ground=gb.Ground(-50, color=0.0))
    frame = gb.render(ball(color=(1, 1, 1), **backend), CAMERA, SIZE, look)
    o, d = rays(CAMERA, SIZE)
    near, _, away = meet_ball(o, d)
    inner = (away < 0.99 * RADIUS)[..., 0]
    cosine = (o + near * d - CENTER) @ sun / RADIUS
    assert (cosine[inner] < -0.1).sum() > 30
    assert (cosine[inner] > 0.1).sum() > 30
    expected = np.maximum(cosine, 0)[..., None] * (1, 0.5, 0.25)
    np.testing.assert_allclose(frame.color[inner], expected[inner], atol=1e-3)
    assert (frame.color[inner & (cosine < -1e-3)] == 0).all()


LIGHTS = {
    "sun": gb.DirectionalLight((0.5, 1.0, 0.2), (1, 1, 1)),
    "lamp": gb.PointLight((1.2, 2.0, -0.6), (1, 1, 1)),
    "lamp under the ball": gb.PointLight((0.2, -0.8, 0.4), (1, 1, 1)),
}


@pytest.mark.parametrize("name", LIGHTS)
def test_shadow_on_the_ground(backend, name):
    """The outline is the ellipse in which the cylinder or cone about the ball cuts the ground."""
    light = LIGHTS[name]
    look = quiet(lights=[light], shadows=True, ground=GROUND)
    frame = gb.render(ball(**backend), ABOVE, SIZE, look)
    p = frame.position.astype(np.float64)
    ground = np.abs(p[..., 1] + 1) < 1e-4
    assert ground.sum() > 800
    to = light.position - p if isinstance(light, gb.PointLight) else np.broadcast_to(light.direction, p.shape)
    reach = np.linalg.norm(to, axis=-1)
    near, _, away = meet_ball(p, unit(to))
    beyond = isinstance(light, gb.PointLight) & (near[..., 0] > reach)
    dark = (near[..., 0] > 0) & ~beyond
    sure = ground & (np.abs(away[..., 0] - RADIUS) > 2e-3)
    expected = np.where(dark, 0, unit(to)[..., 1])
    np.testing.assert_allclose(frame.color[sure][:, 0], expected[sure], atol=1e-4)
    assert dark[sure].any() == (name != "lamp under the ball")


@pytest.mark.few_backends
@pytest.mark.parametrize("name", ["sun", "low sun", pytest.param("lamp", marks=pytest.mark.slow)])
def test_penumbra(backend, name):
    """Soft shadows converge to the unhidden part of the light's disc."""
    if name == "sun":
        tangent = np.tan(np.radians(18))
        light = gb.DirectionalLight((0.3, 1.0, 0.1), (1, 1, 1), angle=36)
    elif name == "low sun":  # whose middle is below the horizon
        tangent = np.tan(np.radians(30))
        light = gb.DirectionalLight((1.0, -0.05, 0.1), (1, 1, 1), angle=60)
    else:
        light = gb.PointLight((1.0, 2.5, -0.3), (1, 1, 1), radius=0.6)
    size = (32, 22)
    camera = gb.Camera((-0.4, 30, 0.3), (-0.4, -1.0, 0.3), height=2.4, up=(0, 0, -1))
    look = quiet(lights=[light], shadows=True, ground=GROUND)
    frame = gb.render(ball(**backend), camera, size, look).refine(1023)
    o, d = rays(camera, size)
    ground = (meet_ball(o, d)[2] > 1.2 * RADIUS)[..., 0]
    expected, n = np.zeros(ground.shape), 1500
    for i in range(n):  # even over the pixel (a lattice) and over the disc (a sunflower)
        aside = (np.array([(i * 0.7548777) % 1, 0, (i * 0.5698403) % 1]) - (0.5, 0, 0.5)) * 2.4 / 22
        p = o * (1, 0, 1) + (0, -1, 0) + aside
        to = light.position - p if name == "lamp" else np.broadcast_to(light.direction, p.shape)
        radius = 0.6 / np.linalg.norm(to, axis=-1, keepdims=True) if name == "lamp" else tangent
        to = unit(to)
        side = unit(np.cross(to, (0, 0, 1.0)))
        r, turn = np.sqrt((i + 0.5) / n), i * np.pi * (3 - np.sqrt(5))
        on = np.cos(turn) * side + np.sin(turn) * np.cross(side, to)
        to = unit(to + radius * r * on)
        hidden = np.isfinite(meet_ball(p, to)[0][..., 0])
        expected += np.where(hidden, 0, np.maximum(to[..., 1], 0)) / n
    least, most = (0.02, 0.1) if name == "low sun" else (0.1, 0.7)
    assert (ground & (expected > least) & (expected < most)).sum() > 30
    error = (frame.color[..., 0] - expected)[ground]
    assert np.abs(error).mean() < 0.006
    assert abs(error.mean()) < 0.002
    assert np.abs(error).max() < 0.05


def test_one_sample_of_a_soft_light_is_an_even_pattern(backend):
    """Lit and dark places have no noise; in a penumbra, the mean of any 4 x 4 pixels is near that of many samples."""
    light = gb.DirectionalLight((0.3, 1.0, 0.1), (1, 1, 1), angle=10)
    camera = gb.Camera((-0.4, 30, 0.3), (-0.4, -1.0, 0.3), height=2.4, up=(0, 0, -1))
    look = quiet(lights=[light], shadows=True, ground=GROUND, edge_samples=0)
    frame = gb.render(ball(**backend), camera, (128, 88), look)
    one = frame.color[..., 0].copy()
    many = frame.refine(63).color[..., 0]
    o, d = rays(camera, (128, 88))
    ground = (meet_ball(o, d)[2] > 1.2 * RADIUS)[..., 0]
    full = many[ground].max()
    lit, dark = ground & (many > 0.999 * full), ground & (many == 0)
    assert lit.sum() > 1000
    assert dark.sum() > 50
    assert np.abs(one[lit] - full).max() < 2e-3
    assert one[dark].max() == 0
    blocks = lambda v: v.reshape(22, 4, 32, 4).mean(axis=(1, 3))  # noqa: E731
    whole = blocks(ground.astype(float)) == 1
    off = np.abs(blocks(one) - blocks(many))[whole]
    assert off.max() < 0.2
    assert off.mean() < 0.01


def test_ambient_occlusion_of_an_open_half_space(backend):
    """Over the flat face of a cut block nothing is hidden."""
    look = quiet(ambient=1.0, ambient_rays=16, ambient_distance=50.0, material=CLAY, samples=2)
    camera = gb.Camera((0.5, 6, 1), (0, 0, 0), fov=20)
    frame = gb.render(block(color=(1, 1, 1), **backend), camera, SIZE, look, [gb.ClipPlane((0, 1, 0), 0.5)])
    np.testing.assert_allclose(frame.distance * -rays(camera, SIZE)[1][..., 1], 5.5, rtol=1e-5)
    np.testing.assert_allclose(frame.color, 1, atol=1e-5)


@pytest.mark.parametrize("reach", [1.0, 1.6])
def test_ambient_occlusion_in_a_corner(backend, reach):
    """At h from a wall, rays of length D find it where their sine towards it is above h / D: of the
    cosine-weighted half space the segment (acos c - c sqrt(1 - c^2)) / pi of a disc, c = h / D."""
    clip = gb.ClipBox((0, 0, -9), (9, 9, 9))
    look = quiet(ambient=1.0, ambient_rays=64, ambient_distance=reach, material=CLAY, samples=4)
    camera = gb.Camera((1, 9, 0), (1, 0, 0), up=(0, 0, 1), height=1.9)
    frame = gb.render(block(color=(1, 1, 1), **backend), camera, (32, 12), look, [clip])
    h = frame.position[..., 0].astype(np.float64)
    floor = (np.abs(frame.position[..., 1]) < 1e-5) & (h < 2.2) & (h > 0.05)
    assert floor.sum() > 150
    c = np.minimum(np.abs(h) / reach, 1)
    expected = 1 - (np.arccos(c) - c * np.sqrt(1 - c**2)) / np.pi
    error = (frame.color[..., 0] - expected)[floor]
    assert np.abs(error).max() < 0.04
    assert abs(error.mean()) < 0.005
    assert expected[floor].min() < 0.6
    assert expected[floor].max() == 1


def test_ambient_rays_from_the_sky(backend):
    """Light from a gradient of a sky: its integral over the half space, weighted by cosines."""
    sky = gb.Sky(zenith=1.0, horizon=0.5, ground=0.0)
    look = quiet(sky=sky, ambient="sky", ambient_rays=64, material=CLAY, ambient_distance=9.0)
    camera = gb.Camera(CENTER + (4, 1, 3), CENTER, fov=20)
    frame = gb.render(ball(color=(1, 1, 1), **backend), camera, (24, 20), look)
    seen = meet_ball(*rays(camera, (24, 20)))[2][..., 0] < 0.97 * RADIUS
    n = frame.normal[seen].astype(np.float64)
    k = np.arange(20_000) + 0.5  # even over the sphere
    turn, y = k * np.pi * (3 - np.sqrt(5)), 1 - k / 10_000
    to = np.stack([np.cos(turn) * np.sqrt(1 - y**2), y, np.sin(turn) * np.sqrt(1 - y**2)], 1)
    value = 0.5 + 0.5 * np.sign(y) * np.sqrt(np.abs(y))
    expected = np.mean(np.maximum(n @ to.T, 0) * value, 1) * 4
    error = frame.color[seen][:, 0] - expected
    assert np.abs(error).max() < 0.05
    assert abs(error.mean()) < 0.005


def test_dim_light_throws_shadows_too(backend):
    """A thousandth of the light at a thousand times the exposure is the same picture."""
    scene = ball(**backend)
    pictures = []
    for k in (1.0, 1000.0):
        light = gb.DirectionalLight((0.5, 1.0, 0.2), (0.7 / k,) * 3)
        look = quiet(lights=[light], shadows=True, ground=GROUND, exposure=k, cutoff=1 / 128)
        pictures.append(gb.render(scene, ABOVE, SIZE, look).picture.astype(int))
    assert np.abs(pictures[0] - pictures[1]).max() <= 1


@pytest.mark.parametrize("kind", ["sun", "ambient"])
def test_no_light_from_below_the_ground(backend, kind):
    """The underside of a ball that touches the ground is dark."""
    ground = gb.Ground(CENTER[1] - RADIUS, color=0.0)
    if kind == "sun":
        light = gb.DirectionalLight((0, -1, 0), (1, 1, 1))
        look = quiet(lights=[light], shadows=True, ground=ground)
    else:
        look = quiet(ambient=1.0, ambient_rays=32, ambient_distance=9.0, ground=ground)
    camera = gb.Camera(CENTER + (0, 0, 5), CENTER, height=2 * RADIUS)
    frame = gb.render(ball(color=(1, 1, 1), **backend), camera, (21, 21), look)
    below = frame.mask & (frame.normal[..., 1] < -0.8)
    assert below.sum() > 10
    assert frame.color[below].max() < (1e-5 if kind == "sun" else 0.25)


def test_shadows_are_exact(backend):
    """Light arrives exactly where the float64 oracle finds nothing on the way."""
    rng = np.random.default_rng(5)
    p = (np.stack(np.meshgrid(*[np.arange(10.0)] * 3), -1).reshape(-1, 3) + rng.normal(0, 0.15, (1000, 3))).astype(
        np.float32
    )
    p = p[rng.random(1000) < 0.35]  # drops and gaps: light comes through narrow ones
    a = 1.3
    sun = np.float32(unit((0.9, 0.25, 0.5)))
    camera = gb.Camera((14, 9, 22), (4.5, 4.5, 4.5), fov=40)
    look = quiet(lights=[gb.DirectionalLight(sun, (1, 1, 1))], shadows=True, edge_samples=0)
    frame = gb.render(gb.Scene(p, support=a, threshold=0.4, **backend), camera, (200, 160), look)
    facing = frame.mask & ((frame.normal @ sun) > 0.05)
    o = frame.position[facing] + np.float32(1e-3 * a) * sun
    t = oracle.first_hit(p, a, 1.0, "murakami", 0.4, o, np.broadcast_to(sun, o.shape))
    lit = np.isinf(t)
    assert lit.sum() > 500
    assert (~lit).sum() > 500
    np.testing.assert_array_equal((frame.color[facing] > 0).any(-1), lit)
