"""Mirrors and glass against closed forms, energy in a furnace, Fresnel, Beer."""

import globule as gb
import numpy as np
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
