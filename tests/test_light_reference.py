"""Random scenes of everything at once, against `light_reference`."""

import globule as gb
import light_reference
import numpy as np
import pytest

SIZE = (12, 9)
TOLERANCE = 6e-3   # shadow rays give up below 0.004


def direction(rng):
    v = rng.normal(size=3)
    return v / np.linalg.norm(v)


def random_clip(rng, about, width):
    kind, keep = rng.integers(4), bool(rng.integers(2))
    if kind < 2:
        n = direction(rng) if kind else np.eye(3)[rng.integers(3)] * rng.choice([-1, 1])
        return gb.ClipPlane(n * rng.uniform(0.5, 3), 0.0 + n @ about * 0 + rng.uniform(-0.3, 0.5) * width)
    middle = about + rng.normal(0, 0.4 * width, 3)
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
        fields["anisotropy"] = np.einsum("nij,nj,nkj->nik", turn, 1 / rng.uniform(0.6, 1.3, (n, 3)), turn)
    else:
        fields["support"] = float(rng.uniform(0.7, 1.3)) if rng.random() < 0.5 else rng.uniform(0.5, 1.5, n)
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
    share = (lambda: None if rng.random() < 0.3 else float(rng.uniform(0, 1)))
    absorb = None if rng.random() < 0.4 else rng.uniform(0, 1.5, 3)
    paint = None if rng.random() < 0.7 else rng.uniform(0.2, 1, 3)
    index = None if rng.random() < 0.4 else float(rng.choice([1.0, rng.uniform(1, 1.6)]))
    if kind == 0:
        return gb.Material()
    if kind == 1:
        return gb.Material(0.0, 1.0, index, paint, absorb)
    if kind == 2:
        return gb.Material(1.0, 0.0)
    return gb.Material(share(), share(), index, paint, absorb, specular=None if rng.random() < 0.5 else 0.4)


def random_picture(seed):
    """Layers' makings, camera, settings and common clips."""
    rng = np.random.default_rng(seed)
    layers = []
    for _ in range(rng.choice([1, 1, 2, 3])):
        octree = str(rng.choice(["sparse", "sparse", "dense"]))
        kernel = str(rng.choice(["murakami", "murakami", *light_reference.KERNELS]))
        particles = random_particles(rng, kernel, octree)
        width = float(np.std(particles.positions)) + 0.3
        clips = [random_clip(rng, np.zeros(3), width) for _ in range(rng.choice([0, 0, 1, 2, 3, 4]))]
        options = {"kernel": kernel, "threshold": float(rng.uniform(0.15, 0.6)), "octree": octree}
        layers.append((particles, options, random_material(rng), clips))
    common = [random_clip(rng, np.zeros(3), 1.0)] if rng.random() < 0.25 else []
    lights = [gb.Headlight(rng.uniform(0, 0.4, 3))] if rng.random() < 0.4 else []
    for _ in range(rng.integers(3)):
        if rng.random() < 0.5:
            lights.append(gb.DirectionalLight(direction(rng), rng.uniform(0.2, 0.8, 3)))
        else:
            lights.append(gb.PointLight(direction(rng) * rng.uniform(0, 4), rng.uniform(0.2, 0.8, 3)))
    ground = None
    if rng.random() < 0.4:
        ground = gb.Ground(float(rng.uniform(-2, -0.3)), direction(rng) if rng.random() < 0.3 else (0, 1, 0),
                           check=float(rng.choice([0, 0.7])), reflection=float(rng.choice([0, 0.4])))
    settings = gb.RenderSettings(
        lights, "sky" if rng.random() < 0.3 else rng.uniform(0, 0.3, 3), rng.uniform(0, 1, 3), random_material(rng),
        shadows=bool(rng.random() < 0.7), sky=gb.Sky(up=direction(rng)) if rng.random() < 0.7 else None, ground=ground,
        depth=int(rng.integers(6)), cutoff=float(rng.choice([0.0, 1 / 128])))
    eye = direction(rng) * rng.choice([rng.uniform(0, 1.2), rng.uniform(3, 6)])
    look_at = rng.normal(0, 0.3, 3)
    camera = gb.Camera(eye, look_at, direction(rng), fov=float(rng.uniform(20, 70)),
                       height=float(rng.uniform(1.5, 5)) if rng.random() < 0.25 else None)
    return layers, camera, settings, common


def build(layers, **backend):
    return [gb.Layer(gb.Scene(particles, **options, **backend), material, clips)
            for particles, options, material, clips in layers]


def differences(frame, truth, pixels=None):
    """Which pixels differ, by image."""
    flat = {k: getattr(frame, k).reshape(-1, *getattr(frame, k).shape[2:]).astype(np.float64)
            for k in ("color", "depth", "normal", "albedo")}
    if pixels is not None:
        flat = {k: v[pixels] for k, v in flat.items()}
    out = {}
    tolerance = {"color": TOLERANCE, "depth": 1e-3, "normal": 5e-3, "albedo": 5e-3}
    for k, v in flat.items():
        with np.errstate(invalid="ignore"):
            near = np.abs(v - truth[k]) <= tolerance[k] * (1 + np.abs(np.nan_to_num(truth[k], posinf=0.0)))
        same = near | (v == truth[k])
        out[k] = ~(same if same.ndim == 1 else same.all(1))
    return out


def compare(layers, camera, settings, clips):
    """(wrong pixels by image, how many differ where the reference itself is unsteady)."""
    frame = gb.render(layers, camera, SIZE, settings, clips)
    truth = light_reference.render(layers, camera, SIZE, settings, clips)
    wrong = differences(frame, truth)
    suspects = np.flatnonzero(np.any(list(wrong.values()), 0))
    if not len(suspects):
        return {}, 0, frame, truth
    # Edges: where the picture of rays a little aside differs.
    some = [light_reference.render(layers, camera, SIZE, settings, clips, suspects, shift, 4 * light_reference.SAMPLES)
            for shift in 1e-3 * np.concatenate([np.zeros((1, 3)), np.eye(3), -np.eye(3), 0.1 * np.eye(3)])]
    wrong = differences(frame, some[0], suspects)
    result = {}
    for k, v in wrong.items():
        all_of = np.stack([s[k] for s in some])
        with np.errstate(invalid="ignore"):
            spread = np.nan_to_num(np.ptp(all_of, axis=0), nan=0.0, posinf=9.0)
        spread = spread if spread.ndim == 1 else spread.max(1)
        sure = spread < 2e-2
        if (v & sure).any():
            result[k] = suspects[v & sure]
    return result, len(suspects), frame, truth
