"""Random scenes of everything at once, against `light_reference`."""

import functools

import globule as gb
import light_reference
import numpy as np
import pytest
from light_reference import GROUND, KERNELS, Medium
from quick import every

SIZE = (12, 9)
# Shadow rays give up below 0.004.
TOLERANCE = {"color": 6e-3, "distance": 1e-3, "normal": 5e-3, "albedo": 5e-3}
IMAGES = tuple(TOLERANCE)
# Found among some thousand: each with a feature that others lack, most of them once wrong.
SEEDS = (5, 6, 10, 19, 39, 42, 46, 48, 49, 59, 61, 64, 68, 72, 73, 94, 135, 175, 182, 184, 197, 205, 1225, 2359)


def direction(rng):
    v = rng.normal(size=3)
    return v / np.linalg.norm(v)


def random_clip(rng, width):
    kind, keep = rng.integers(4), bool(rng.integers(2))
    if kind < 2:
        n = direction(rng) if kind else np.eye(3)[rng.integers(3)] * rng.choice([-1, 1])
        return gb.ClipPlane(n * rng.uniform(0.5, 3), rng.uniform(-0.3, 0.5) * width)
    middle = rng.normal(0, 0.4 * width, 3)
    if kind == 2:
        half = rng.uniform(0.3, 1.1, 3) * width * (1.2 if keep else 0.7)
        return gb.ClipBox(middle - half, middle + half, keep)
    return gb.ClipSphere(middle, rng.uniform(0.4, 1.2) * width * (1.3 if keep else 0.8), keep)


def random_particles(rng, kernel, octree):
    n = int(rng.integers(3, 31))
    width = rng.uniform(0.3, 1.1)
    p = rng.normal(0, width, (n, 3)) * rng.uniform(0.4, 1, 3)
    fields = {}
    stretched = octree == "sparse" and rng.random() < 0.15
    if stretched:
        turn = np.linalg.qr(rng.normal(size=(n, 3, 3)))[0]
        inverse = 1 / rng.uniform(0.6, 1.3, (n, 3))
        fields["anisotropy"] = np.einsum("nij,nj,nkj->nik", turn, inverse, turn)
    elif rng.random() < 0.5:
        fields["support"] = float(rng.uniform(0.7, 1.3))
    else:
        fields["support"] = rng.uniform(0.5, 1.5, n)
    if rng.random() < 0.4:
        fields["weight"] = rng.uniform(0.5, 2, n) * np.where(rng.random(n) < 0.15, -1, 1)
    elif rng.random() < 0.3:
        fields["weight"] = float(rng.uniform(0.7, 2))
    if rng.random() < 0.8:
        fields["color"] = rng.uniform(0.2, 1, (n, 3))
    for name in ("reflection", "refraction"):
        choice = rng.integers(3)
        if choice:
            fields[name] = rng.uniform(0, 1, n) if choice == 1 else float(rng.uniform(0, 1))
    return gb.Particles(p, **fields)


def random_material(rng):
    kind = rng.integers(5)

    def share():
        return None if rng.random() < 0.3 else float(rng.uniform(0, 1))

    absorb = None if rng.random() < 0.4 else rng.uniform(0, 1.5, 3)
    paint = None if rng.random() < 0.7 else rng.uniform(0.2, 1, 3)
    index = None if rng.random() < 0.4 else float(rng.choice([1.0, rng.uniform(1, 1.6)]))
    if kind == 0:
        return gb.Material()
    if kind == 1:
        return gb.Material(0.0, 1.0, index, paint, absorb)
    if kind == 2:
        return gb.Material(1.0, 0.0)
    shares = share(), share()
    specular = None if rng.random() < 0.5 else 0.4
    return gb.Material(*shares, index, paint, absorb, specular=specular)


def random_picture(seed):
    """Layers' makings, camera, settings and common clips."""
    rng = np.random.default_rng(seed)
    layers = []
    for _ in range(rng.choice([1, 1, 2, 3])):
        octree = str(rng.choice(["sparse", "sparse", "dense"]))
        kernel = str(rng.choice(["murakami", "murakami", *KERNELS]))
        particles = random_particles(rng, kernel, octree)
        width = float(np.std(particles.positions)) + 0.3
        n_clips = rng.choice([0, 0, 1, 2, 3, 4])
        clips = [random_clip(rng, width) for _ in range(n_clips)]
        threshold = float(rng.uniform(0.15, 0.6))
        options = {"kernel": kernel, "threshold": threshold, "octree": octree}
        layers.append((particles, options, random_material(rng), clips))
    common = [random_clip(rng, 1.0)] if rng.random() < 0.25 else []
    lights = [gb.Headlight(rng.uniform(0, 0.4, 3))] if rng.random() < 0.4 else []
    for _ in range(rng.integers(3)):
        if rng.random() < 0.5:
            lights.append(gb.DirectionalLight(direction(rng), rng.uniform(0.2, 0.8, 3)))
        else:
            place = direction(rng) * rng.uniform(0, 4)
            lights.append(gb.PointLight(place, rng.uniform(0.2, 0.8, 3)))
    ground = None
    if rng.random() < 0.4:
        height = float(rng.uniform(-2, -0.3))
        up = direction(rng) if rng.random() < 0.3 else (0, 1, 0)
        check, mirror = float(rng.choice([0, 0.7])), float(rng.choice([0, 0.4]))
        ground = gb.Ground(height, up, check=check, reflection=mirror)
    ambient = "sky" if rng.random() < 0.3 else rng.uniform(0, 0.3, 3)
    background, material = rng.uniform(0, 1, 3), random_material(rng)
    shadows = bool(rng.random() < 0.7)
    sky = gb.Sky(up=direction(rng)) if rng.random() < 0.7 else None
    depth, cutoff = int(rng.integers(6)), float(rng.choice([0.0, 1 / 128]))
    settings = gb.RenderSettings(
        lights, ambient, background, material, shadows=shadows, sky=sky, ground=ground, bounces=depth, cutoff=cutoff
    )
    eye = direction(rng) * rng.choice([rng.uniform(0, 1.2), rng.uniform(3, 6)])
    look_at, up, fov = rng.normal(0, 0.3, 3), direction(rng), float(rng.uniform(20, 70))
    height = float(rng.uniform(1.5, 5)) if rng.random() < 0.25 else None
    return layers, gb.Camera(eye, look_at, up, fov, height), settings, common


def build(layers, **backend):
    return [
        gb.Layer(gb.Scene(particles, **options, **backend), material, clips)
        for particles, options, material, clips in layers
    ]


def differences(frame, truth, pixels=None):
    """Which pixels differ, by image."""
    out = {}
    for k in IMAGES:
        seen, expected = getattr(frame, k).astype(np.float64), truth[k]
        seen = seen.reshape(SIZE[0] * SIZE[1], *expected.shape[1:])
        seen = seen if pixels is None else seen[pixels]
        size = 1 + np.abs(np.nan_to_num(expected, posinf=0.0))
        with np.errstate(invalid="ignore"):
            same = (np.abs(seen - expected) <= TOLERANCE[k] * size) | (seen == expected)
        out[k] = ~same.reshape(len(same), -1).all(1)
    return out


def unsure(layers, camera, settings, clips, pixels):
    """The reference at some pixels, finely, and by image where it differs for rays a little aside: edges."""
    shifts = 1e-3 * np.concatenate([np.zeros((1, 3)), np.eye(3), -np.eye(3), 0.1 * np.eye(3)])
    some = [light_reference.render(layers, camera, SIZE, settings, clips, pixels, shift, 1200) for shift in shifts]
    out = {}
    for k in IMAGES:
        with np.errstate(invalid="ignore"):
            spread = np.ptp(np.stack([s[k] for s in some]), axis=0)
        spread = np.nan_to_num(spread, nan=0.0, posinf=9.0)
        out[k] = spread.reshape(len(pixels), -1).max(1) > 2e-2
    return some[0], out


@functools.cache
def truth(seed):
    layers, camera, settings, clips = random_picture(seed)
    layers = build(layers, device="cpu", threads=1)
    return light_reference.render(layers, camera, SIZE, settings, clips)


def compare(seed, **backend):
    """Pixels that are wrong, by image, and how many were looked at twice."""
    layers, camera, settings, clips = random_picture(seed)
    layers = build(layers, **backend)
    frame = gb.render(layers, camera, SIZE, settings, clips)
    suspects = np.flatnonzero(np.any(list(differences(frame, truth(seed)).values()), 0))
    if not len(suspects):
        return {}, 0
    again, at_edge = unsure(layers, camera, settings, clips, suspects)
    wrong = {k: suspects[v & ~at_edge[k]] for k, v in differences(frame, again, suspects).items()}
    return {k: v for k, v in wrong.items() if len(v)}, len(suspects)


@pytest.mark.few_backends
@pytest.mark.parametrize("seed", every(3, SEEDS))
def test_random_scene(backend, seed):
    wrong, n_suspects = compare(seed, **backend)
    assert not wrong
    assert n_suspects <= 5


@pytest.mark.parametrize("seed", range(3))
def test_rays_from_anywhere(backend, seed):
    """`intersect`, from inside and outside: distance, normal and color."""
    particles, options, _, _ = random_picture(9000 + seed)[0][0]
    scene = gb.Scene(particles, **options, **backend)
    rng = np.random.default_rng(seed)
    o = rng.normal(0, 1.2, (100, 3)).astype(np.float32)
    d = np.array([direction(rng) for _ in o], np.float32)
    found = scene.intersect(o, d)
    medium = Medium(gb.Layer(scene), gb.RenderSettings(), ())
    t = np.full(len(o), np.inf)
    inside = medium.holds(o)
    ray, at, _ = medium.changes(o.astype(float), d.astype(float), inside, samples=1000)
    np.minimum.at(t, ray, at)
    hit = np.isfinite(t)
    assert 0.1 < hit.mean() < 1
    assert (np.isfinite(found[0]) != hit).sum() <= 1
    hit &= np.isfinite(found[0])
    p = o[hit] + t[hit, None] * d[hit]
    np.testing.assert_allclose(found[0][hit], t[hit], atol=1e-3)
    np.testing.assert_allclose(found[1][hit], medium.normals(p, d[hit]), atol=5e-3)
    np.testing.assert_allclose(found[2][hit], medium.looks(p)[0], atol=5e-3)


def test_picks(backend):
    """The layer that is seen, of its particles the nearest by distance over support; nothing on the ground."""
    layers, camera, settings, clips = random_picture(205)
    layers = build(layers, **backend)
    frame = gb.render(layers, camera, SIZE, settings, clips)
    layer = truth(205)["layer"]
    for i in range(0, SIZE[0] * SIZE[1], 3):
        found = frame.pick(i % SIZE[0], i // SIZE[0])
        if layer[i] in (-1, GROUND):
            assert found is None
            continue
        medium = Medium(layers[layer[i]], settings, clips)
        away = np.einsum("nij,nj->ni", medium.matrices, found.position - medium.positions)
        assert (found.layer, found.particle) == (layer[i], np.linalg.norm(away, axis=1).argmin())
