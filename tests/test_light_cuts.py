"""Cuts: where they are met, what their faces show, and that every kind of ray goes by them."""

import functools

import globule as gb
import numpy as np
import pytest
from light import CAMERA, CENTER, RADIUS, ball, first_change, quiet, rays, unit
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
