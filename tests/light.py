"""Closed forms for the tests of light: a sky that tells directions, balls, glass, cuts."""

import dataclasses

import globule as gb
import numpy as np
from globule.render.lights import uniform_sky

CENTER = np.array([0.2, -0.1, 0.4])
SUPPORT = 1.3
RADIUS = SUPPORT * np.sqrt(1 - np.sqrt(0.6))  # of one murakami metaball at threshold 0.6
CAMERA = gb.Camera((1.6, 1.1, 2.9), CENTER, fov=30)
ONE_SKY = uniform_sky((1.0, 1.0, 1.0))
# Nothing but what the materials mirror, let through and scatter; every ray is followed to the end.
QUIET = gb.RenderSettings(lights=(), ambient=0.0, background=0.0, specular=0.0, cutoff=0.0)
CLEAR = gb.Material(reflection=0.0, transmission=1.0, absorption=0.0)
MIRROR = gb.Material(reflection=1.0, transmission=0.0)


def quiet(**changes) -> gb.RenderSettings:
    return dataclasses.replace(QUIET, **changes)


def glass(index: float, **changes) -> gb.Material:
    return dataclasses.replace(CLEAR, index=index, **changes)


def ball(center=CENTER, support=SUPPORT, color=(1.0, 0.5, 0.25), **options) -> gb.Scene:
    particles = gb.Particles(np.reshape(center, (1, 3)), support=support, color=color)
    return gb.Scene(particles, threshold=0.6, **options)


def block(n=9, support=2.0, color=None, **options) -> gb.Scene:
    """A cube of n^3 particles one apart: the field inside is nearly constant, above the threshold."""
    x = np.arange(n) - (n - 1) / 2
    p = np.stack(np.meshgrid(x, x, x), -1).reshape(-1, 3).astype(np.float32)
    return gb.Scene(gb.Particles(p, support=support, color=color), threshold=0.6, **options)


def rays(camera: gb.Camera, size) -> tuple[np.ndarray, np.ndarray]:
    """Eye and unit directions (H, W, 3), float64."""
    eye, forward, right, up = camera.frame(size)
    x = (np.arange(size[0]) + 0.5) * 2 / size[0] - 1
    y = 1 - (np.arange(size[1]) + 0.5) * 2 / size[1]
    across = x[None, :, None] * right + y[:, None, None] * up
    if camera.height is not None:
        return eye + across, np.broadcast_to(forward, across.shape)
    return np.broadcast_to(eye, across.shape), unit(forward + across)


def unit(v) -> np.ndarray:
    v = np.asarray(v, np.float64)
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


def dot(a, b) -> np.ndarray:
    return np.sum(np.asarray(a) * np.asarray(b), -1, keepdims=True)


def direction_sky(rows: int = 256) -> gb.Environment:
    """Radiance (d + 1) / 2 from direction d; its poles, where an image is coarse, lie along z."""
    up, east = np.array([0.0, 0.0, 1.0]), np.array([1.0, 0.0, 0.0])
    tilt = (np.arange(rows) + 0.5)[:, None, None] / rows * np.pi
    turn = ((np.arange(2 * rows) + 0.5)[None, :, None] / (2 * rows) - 0.5) * 2 * np.pi
    level = east * np.cos(turn) + np.cross(up, east) * np.sin(turn)
    return gb.Environment((1 + up * np.cos(tilt) + level * np.sin(tilt)) / 2, up=up)


def sky_of(d) -> np.ndarray:
    return (1 + np.asarray(d)) / 2


def meet_ball(o, d, center=CENTER, radius=RADIUS):
    """Both distances to a ball, NaN where missed, and the rays' distance from its center."""
    v = o - center
    along = dot(v, d)
    away = np.linalg.norm(v - along * d, axis=-1, keepdims=True)
    with np.errstate(invalid="ignore"):
        half = np.sqrt(radius**2 - away**2)
    return -along - half, -along + half, away


def fresnel(cosine, eta) -> np.ndarray:
    """Unpolarised reflectance from the two polarisations' amplitudes; eta: far index over near."""
    sine2 = (1 - cosine**2) / eta**2
    far = np.sqrt(np.maximum(1 - sine2, 0))
    s = (cosine - eta * far) / (cosine + eta * far)
    p = (eta * cosine - far) / (eta * cosine + far)
    return np.where(sine2 >= 1, 1.0, (s**2 + p**2) / 2)


def mirrored(d, n) -> np.ndarray:
    return d - 2 * dot(d, n) * n


def refracted(d, n, eta) -> np.ndarray:
    """Snell by the tangential part: it shrinks by the ratio of the indices."""
    tangent = (d - dot(d, n) * n) / eta
    return tangent - np.sqrt(np.maximum(1 - dot(tangent, tangent), 0)) * n


def glass_ball(o, d, index: float, depth: int, inside=False, absorption=0.0) -> np.ndarray:
    """Radiance of `sky_of` through a ball of clear glass, after `depth` generations and where missed the sky's."""
    near, far, away = meet_ball(o, d)
    out = np.where(away < RADIUS, 0.0, sky_of(d))
    weight = np.where(away < RADIUS, 1.0, 0.0)
    generation = 0
    if not inside:
        p = o + np.where(away < RADIUS, near, 0) * d
        n = (p - CENTER) / RADIUS
        mirror = fresnel(np.minimum(-dot(d, n), 1), index)
        out = out + weight * mirror * sky_of(mirrored(d, n))
        weight, o, d = weight * (1 - mirror), p, refracted(d, n, index)
        if depth == 0:
            return out + weight * sky_of(d)
        generation = 1
    while True:
        far = np.nan_to_num(meet_ball(o, d)[1])
        weight = weight * np.exp(-absorption * far)
        p = o + far * d
        n = (CENTER - p) / RADIUS
        mirror = fresnel(np.minimum(np.abs(dot(d, n)), 1), 1 / index)
        out = out + weight * (1 - mirror) * sky_of(refracted(d, n, 1 / index))
        weight, o, d = weight * mirror, p, mirrored(d, n)
        if generation == depth:
            return out + weight * sky_of(d)
        generation += 1


def spans(clip, o, d):
    """The rays' part inside a clip's shape."""
    inf = np.full(d.shape[:-1] + (1,), np.inf)
    with np.errstate(divide="ignore", invalid="ignore"):
        if isinstance(clip, gb.ClipPlane):
            n = unit(clip.normal)
            t = (clip.offset / np.linalg.norm(clip.normal) - dot(o, n)) / dot(d, n)
            return np.where(dot(d, n) > 0, t, -inf), np.where(dot(d, n) > 0, inf, t)
        if isinstance(clip, gb.ClipBox):
            a, b = (clip.lo - o) / d, (clip.hi - o) / d
            low = np.minimum(a, b).max(-1, keepdims=True)
            return low, np.maximum(low, np.maximum(a, b).min(-1, keepdims=True))
    near, far, _ = meet_ball(o, d, np.asarray(clip.center), clip.radius)
    return np.nan_to_num(near), np.nan_to_num(far)


def first_change(o, d, clips, center=CENTER, radius=RADIUS):
    """Brute force: where a ray first enters or leaves a cut ball, and which clip (-1: the ball
    itself) bounds it there; inf where nowhere. (H, W)"""
    near, far, _ = meet_ball(o, d, center, radius)
    shapes = [(np.nan_to_num(near), np.nan_to_num(far), True)]
    shapes += [(*spans(c, o, d), getattr(c, "keep", False)) for c in clips]

    def solid(t):
        held = np.ones(t.shape, bool)
        for low, high, keep in shapes:
            held &= ((low < t) & (t < high)) == keep
        return held

    at = np.concatenate([np.zeros_like(near)] + [e for s in shapes for e in s[:2]], -1)
    which = np.repeat(np.arange(len(shapes)), 2) - 1
    at = np.where(np.isfinite(at) & (at >= 0), at, np.inf)
    which = np.broadcast_to(np.concatenate([[-1], which]), at.shape)
    order = np.argsort(at, -1)
    at, which = np.take_along_axis(at, order, -1), np.take_along_axis(which, order, -1)
    finite = np.where(np.isfinite(at), at, 1e9)
    after = np.concatenate([finite[..., 1:], np.full_like(finite[..., :1], 2e9)], -1)
    held = solid((finite + after) / 2)
    # Events before the eye were moved to infinity, so the first one left is at 0.
    changed = np.isfinite(at) & (held != held[..., :1])
    first = changed.argmax(-1)[..., None]
    found = changed.any(-1)
    t = np.where(found, np.take_along_axis(at, first, -1)[..., 0], np.inf)
    return t, np.where(found, np.take_along_axis(which, first, -1)[..., 0], -2)
