"""The transport of light once more, slow and plain, in float64, of `reference_medium`'s media.

Randomness is left out: no ambient rays, no soft lights, no roughness, one sample a pixel.
"""

from __future__ import annotations

import globule as gb
import numpy as np
from globule.render.lights import uniform_sky
from light import dot, fresnel, mirrored, rays, refracted, unit
from reference_medium import SAMPLES, Medium

GROUND = 254


def sky_of(settings, d):
    sky = settings.sky or uniform_sky(settings.background)
    s = dot(d, unit(sky.up))
    w = np.sqrt(np.abs(s))
    pole = np.where(s > 0, color(sky.zenith), color(sky.ground))
    return color(sky.horizon) * (1 - w) + pole * w


def color(value):
    return np.broadcast_to(np.asarray(value, np.float64), (3,))


def meet_ground(ground, o, d, below):
    """It lets nothing through, so that all of a path is on one side of it."""
    if ground is None:
        return np.full(len(o), np.inf)
    n = unit(ground.normal)
    towards = d @ n * np.where(below, 1, -1) > 0
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(towards, np.maximum((ground.height - o @ n) / (d @ n), 0), np.inf)


def ground_color(ground, p):
    n = unit(ground.normal)
    sign = 1.0 if n[2] >= 0 else -1.0  # axes along the plane: Duff et al. 2017
    a = -1 / (sign + n[2])
    s = np.array([1 + sign * n[0] ** 2 * a, sign * n[0] * n[1] * a, -sign * n[0]])
    t = np.array([n[0] * n[1] * a, sign + n[1] ** 2 * a, -n[1]])
    if ground.check == 0:
        return np.broadcast_to(color(ground.color), p.shape)
    odd = (np.floor(p @ s / ground.check) + np.floor(p @ t / ground.check)) % 2 == 1
    return np.where(odd[:, None], color(ground.other), color(ground.color))


def render(layers, camera, size, settings, clips=(), pixels=None, shift=0.0, samples=SAMPLES):
    """Images of the given pixels (flat numbers; default all), their rays moved by `shift`."""
    media = [Medium(x if isinstance(x, gb.Layer) else gb.Layer(x), settings, clips) for x in layers]
    o, d = (np.array(v).reshape(-1, 3) for v in rays(camera, size))
    pixels = np.arange(len(o)) if pixels is None else pixels
    o, d = o[pixels] + shift, unit(d[pixels] + shift)
    out = np.zeros((len(o), 3))
    pixel, weight = np.arange(len(o)), np.ones((len(o), 3))
    inside = np.stack([m.holds(o) for m in media], 1)
    ground, below = settings.ground, np.full(len(o), False)
    if ground is not None:
        below = o @ unit(ground.normal) < ground.height
    images = {"color": out}
    for generation in range(settings.bounces + 1):
        # What each ray meets first; of surfaces at the same place, those of the earlier layer.
        t, which = np.full(len(o), np.inf), np.full(len(o), -1)
        for k, m in enumerate(media):
            ray, at, _ = m.changes(o, d, inside[:, k], samples=samples)
            first = np.full(len(o), np.inf)
            np.minimum.at(first, ray, at)
            nearer = first < t - 1e-9
            t[nearer], which[nearer] = first[nearer], k
        floor = meet_ground(ground, o, d, below)
        t, which = np.minimum(t, floor), np.where(floor < t, GROUND, which)
        missed = which < 0
        normal, albedo = np.zeros(o.shape), np.zeros(o.shape)
        rho, kappa = np.zeros(len(o)), np.zeros(len(o))
        p = o + np.where(missed, 0, t)[:, None] * d
        for k, m in enumerate(media):
            at = which == k
            normal[at], (albedo[at], rho[at], kappa[at]) = m.normals(p[at], d[at]), m.looks(p[at])
        on_ground = which == GROUND
        if on_ground.any():
            normal[on_ground] = unit(ground.normal)
            albedo[on_ground] = ground_color(ground, p[on_ground])
        if generation == 0:
            images |= {"distance": t, "normal": normal.copy()}
            images |= {"albedo": albedo.copy(), "layer": which}
        behind = sky_of(settings, d)
        if generation == 0 and settings.sky is None:
            behind = np.broadcast_to(color(settings.background), d.shape)
        np.add.at(out, pixel[missed], (weight * behind)[missed])
        hit = ~missed
        o, d, inside, below = p[hit], d[hit], inside[hit], below[hit]
        weight, pixel, t, which = weight[hit], pixel[hit], t[hit], which[hit]
        normal, albedo, rho, kappa = normal[hit], albedo[hit], rho[hit], kappa[hit]
        for k, m in enumerate(media):
            if m.material.absorption is not None:
                left = np.exp(-color(m.material.absorption) * t[:, None])
                weight = np.where(inside[:, k, None], weight * left, weight)
        entering = dot(normal, d)[:, 0] < 0
        facing = np.where(entering[:, None], normal, -normal)
        cosine = np.minimum(np.abs(dot(normal, d)), 1)[:, 0]
        mirror, through, matte = np.zeros(len(o)), np.zeros(o.shape), np.zeros(len(o))
        eta, specular, shininess = np.ones(len(o)), np.zeros(len(o)), np.ones(len(o))
        for k, m in enumerate(media):
            at, x = which == k, m.material
            if x.color is not None:
                albedo[at] = color(x.color)
            rest = np.ones(at.sum())
            r = rho[at] if x.reflection is None else rest * x.reflection
            passing = kappa[at] if x.transmission is None else rest * x.transmission
            index = 1 + passing / 3 if x.index is None else rest * x.index
            eta[at] = np.where(entering[at], index, 1 / index)
            schlick = np.where(r > 0, r + (1 - r) * (1 - cosine[at]) ** 5, 0)
            by_index = np.where(index == 1, 0, fresnel(cosine[at], eta[at]))
            mirror[at] = schlick + (1 - schlick) * by_index
            filtered = entering[at, None] & (x.absorption is None)
            passing_through = ((1 - mirror[at]) * passing)[:, None]
            through[at] = np.where(filtered, albedo[at], 1) * passing_through
            matte[at] = (1 - mirror[at]) * (1 - passing)
            specular[at] = settings.specular if x.specular is None else x.specular
            shininess[at] = settings.shininess if x.shininess is None else x.shininess
        if ground:
            mirror[which == GROUND] = ground.reflection
            matte[which == GROUND] = 1 - ground.reflection
        base = albedo * matte[:, None]
        sky_light = isinstance(settings.ambient, str)
        light = base * (sky_of(settings, facing) if sky_light else color(settings.ambient))
        for lamp in settings.lights:
            to, distance, casts = towards(lamp, camera, o, d, generation)
            lambert = np.maximum(dot(facing, to), 0)
            with np.errstate(invalid="ignore"):
                half = np.where(lambert > 0, unit(to - d), 0)
            shine = specular * np.maximum(dot(facing, half), 0)[:, 0] ** shininess
            lit = base * lambert + (shine * (lambert[:, 0] > 0))[:, None]
            lit = lit * color(lamp.radiance)
            if settings.shadows and casts:
                some = lit.max(1) > 0
                some_of = (v[some] for v in (o, to, distance, inside, below))
                lit[some] *= seen(media, ground, *some_of, samples)[:, None]
            light = light + lit
        np.add.at(out, pixel, weight * light)
        # One wave further: mirrored, then transmitted rays.
        passed = inside.copy()
        for k in range(len(media)):
            passed[:, k] = np.where(which == k, entering, passed[:, k])
        with np.errstate(invalid="ignore"):
            bent = unit(refracted(d, facing, eta[:, None]))
        o = np.concatenate([o, o])
        d = np.concatenate([mirrored(d, facing), bent])
        weight = np.concatenate([weight * mirror[:, None], weight * through])
        inside = np.concatenate([inside, passed])
        below, pixel = np.tile(below, 2), np.tile(pixel, 2)
        some = weight.max(1) > 0
        on = some & (weight.max(1) >= settings.cutoff) & (generation < settings.bounces)
        ends = some & ~on
        np.add.at(out, pixel[ends], (weight * sky_of(settings, d))[ends])
        o, d, inside, below = o[on], d[on], inside[on], below[on]
        weight, pixel = weight[on], pixel[on]
        if not len(o):
            break
    return images


def towards(lamp, camera, p, d, generation):
    """Unit directions to a light, its distance, and whether it throws shadows."""
    far = np.full(len(p), np.inf)
    if isinstance(lamp, gb.DirectionalLight):
        return np.broadcast_to(unit(lamp.direction), p.shape), far, True
    if isinstance(lamp, gb.PointLight):
        return unit(lamp.position - p), np.linalg.norm(lamp.position - p, axis=1), True
    if generation == 0:
        return -d, far, False
    if camera.height is not None:
        ahead = np.subtract(camera.look_at, camera.eye)
        return np.broadcast_to(-unit(ahead), p.shape), far, False
    return unit(camera.eye - p), far, False


def seen(media, ground, p, to, distance, inside, below, samples):
    """What part of a light comes through: straight on, `transmission` at each surface, and the mean
    absorption on the way."""
    left = np.where(meet_ground(ground, p, to, below) < distance, 0.0, 1.0)
    for k, m in enumerate(media):
        ray, t, side = m.changes(p, to, inside[:, k], distance, samples)
        own = m.material.transmission is None
        kappa = m.looks(p[ray] + t[:, None] * to[ray])[2] if own else m.material.transmission
        np.multiply.at(left, ray, kappa)
        if m.material.absorption is not None:
            # Ways inside end at each change to outside, or at the light.
            length = np.zeros(len(p))
            np.add.at(length, ray, np.where(side, -t, t))
            last = inside[:, k].copy()
            last[ray] = side  # in order: the last one stays
            length += np.where(last & np.isfinite(distance), distance, 0)
            left *= np.exp(-color(m.material.absorption).mean() * length)
    return left
