"""Media and the transport of light once more, slow and plain, in float64: every particle at every point, no
octree, no cells, no intervals. A ray is sampled densely, and a surface is where the answer to "is the medium
here?" changes. Randomness is left out: no ambient rays, no soft lights, no roughness, one sample a pixel.
"""

import globule as gb
import numpy as np
from globule.render.lights import uniform_sky
from globule.scene.scene import DEFAULT_COLOR
from light import dot, fresnel, mirrored, rays, refracted, unit

GROUND = 254
EPS = 1e-6  # how far beside a surface its two sides are looked at
SAMPLES = 300  # of a ray's way through all supports
KERNELS = {  # b of q = distance / support, 0 <= q <= 1
    "murakami": lambda q: (1 - q**2) ** 2,
    "wyvill": lambda q: 1 - 22 / 9 * q**2 + 17 / 9 * q**4 - 4 / 9 * q**6,
    "cubic_spline": lambda q: np.where(q < 0.5, 1 - 6 * q**2 + 6 * q**3, 2 * (1 - q) ** 3),
    "wendland_c2": lambda q: (1 - q) ** 4 * (1 + 4 * q),
    "solid": lambda q: (1 - q**2) ** 2 * (1 - 2 * q**2),
}


def per_particle(value, n, default, shape=()):
    value = default if value is None else value
    return np.broadcast_to(np.asarray(value, np.float64), (n, *shape))


class Medium:
    """One layer: where it is, and what a point of it looks like."""

    def __init__(self, layer: gb.Layer, settings: gb.RenderSettings, clips):
        scene, p = layer.scene, layer.scene.particles
        n = len(p)
        self.b, self.threshold = KERNELS[scene.kernel], float(np.float32(scene.threshold))
        self.positions = p.positions.astype(np.float64)
        support = per_particle(scene.support, n, None)
        if p.anisotropy is not None:
            self.matrices = p.anisotropy.astype(np.float64)
        else:
            self.matrices = np.eye(3) / support[:, None, None]
        self.weights = per_particle(p.weight, n, 1.0)
        self.colors = per_particle(p.color, n, DEFAULT_COLOR, (3,))
        self.reflections = per_particle(p.reflection, n, 0.0)
        self.refractions = per_particle(p.refraction, n, 0.0)
        self.clips = [*layer.clips, *clips]
        self.material = layer.material or settings.material
        self.middle = self.positions.mean(0)
        self.reach = (np.linalg.norm(self.positions - self.middle, axis=1) + support).max()

    def shares(self, points):
        """Every particle's weight * b: (M, N)."""
        out = np.empty((len(points), len(self.weights)))
        for some in np.array_split(np.arange(len(points)), 1 + out.size // 50_000):
            for k, (q, matrix) in enumerate(zip(self.positions, self.matrices, strict=True)):
                away = (points[some] - q) @ matrix
                x = np.minimum(np.sqrt((away * away).sum(1)), 1)
                out[some, k] = self.weights[k] * self.b(x)
        return out

    def kept(self, points):
        """Which clips keep each point: (M, clips)."""
        out = np.ones((len(points), len(self.clips)), bool)
        for k, c in enumerate(self.clips):
            if isinstance(c, gb.ClipPlane):
                out[:, k] = points @ np.asarray(c.normal, float) <= c.offset
            elif isinstance(c, gb.ClipBox):
                out[:, k] = ((points > c.lo) & (points < c.hi)).all(1) == c.keep
            else:
                out[:, k] = (np.linalg.norm(points - c.center, axis=1) < c.radius) == c.keep
        return out

    def holds(self, points):
        return (self.shares(points).sum(1) > self.threshold) & self.kept(points).all(1)

    def normals(self, points, d):
        """Out of the medium, at points of its surface where rays cross it along d; cut faces', of
        the clip that keeps one side of the point and not the other."""
        h = 1e-5 * self.reach
        f = [self.shares(points + h * e).sum(1) - self.shares(points - h * e).sum(1) for e in np.eye(3)]
        gradient = np.stack(f, -1)
        out = -unit(np.where(np.linalg.norm(gradient, axis=1, keepdims=True) > 0, gradient, 1.0))
        changes = self.kept(points - EPS * d) != self.kept(points + EPS * d)
        for k, c in enumerate(self.clips):
            at = points[changes[:, k]]
            if isinstance(c, gb.ClipPlane):
                n = np.broadcast_to(unit(c.normal), at.shape)
            elif isinstance(c, gb.ClipBox):
                sides = np.concatenate([at - c.lo, c.hi - at], 1)
                face = np.abs(sides).argmin(1)
                n = np.concatenate([-np.eye(3), np.eye(3)])[face] * (1 if c.keep else -1)
            else:
                n = unit(at - c.center) * (1 if c.keep else -1)
            out[changes[:, k]] = n
        return out

    def looks(self, points):
        """Blended color, reflection and refraction factor."""
        w = np.maximum(self.shares(points), 0)
        w = w / np.maximum(w.sum(1, keepdims=True), 1e-30)
        return w @ self.colors, w @ self.reflections, w @ self.refractions

    def changes(self, o, d, inside, far=np.inf, samples=SAMPLES):
        """All places where rays that begin inside or not pass the surface, in order: the ray, how
        far on it, and whether inside begins there."""
        along = dot(self.middle - o, d)[:, 0]
        begin, end = np.maximum(along - self.reach, EPS), np.minimum(along + self.reach, far)
        aside = np.linalg.norm(o + along[:, None] * d - self.middle, axis=1)
        passes = (aside < self.reach) & (begin < end)
        number = np.flatnonzero(passes)
        o, d, inside, begin, end = (v[passes] for v in (o, d, inside, begin, end))
        t = begin[:, None] + np.linspace(0, 1, samples) * (end - begin)[:, None]
        t = np.concatenate([np.full((len(o), 1), EPS), t], 1)
        points = o[:, None] + t[..., None] * d[:, None]
        held = self.holds(points.reshape(-1, 3)).reshape(t.shape)
        before = np.concatenate([inside[:, None], held[:, :-1]], 1)
        ray, k = np.nonzero(held != before)
        low, high, side = np.where(k > 0, t[ray, k - 1], 0), t[ray, k], held[ray, k]
        for _ in range(40):
            middle = (low + high) / 2
            same = self.holds(o[ray] + middle[:, None] * d[ray]) == side
            low, high = np.where(same, low, middle), np.where(same, middle, high)
        return number[ray], np.where(k > 0, high, 0), side


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
    """What part of a light comes through: `transmission` at each surface, the mean absorption between."""
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
