"""The exact first intersection: hit or miss as the float64 oracle says, for every ray."""

import dataclasses

import globule as gb
import numpy as np
import pytest
from scenes import CASES, KERNELS, Case, case, cloud, lattice, unit, with_rays


def check(c: Case, scene: gb.Scene) -> None:
    depth, normal, color = scene.intersect(c.origins, c.directions)
    hit, points = check_depth(c, depth)
    np.testing.assert_array_equal(normal[~hit], 0)
    np.testing.assert_array_equal(color[~hit], 0)
    check_normals(c, points, normal[hit])


def check_depth(c: Case, depth: np.ndarray, share: float = 2e-7) -> tuple[np.ndarray, np.ndarray]:
    """Which rays hit, and where. share: of the depth, that an error may have; 2e-7: a float32's, from the eye."""
    hit = np.isfinite(c.depth)
    wrong = np.nonzero(np.isfinite(depth) != hit)[0]
    assert len(wrong) == 0, [(c.origins[i].tolist(), c.directions[i].tolist(), c.depth[i], depth[i]) for i in wrong[:5]]
    points = c.origins[hit] + c.depth[hit, None] * c.directions[hit].astype(np.float64)
    allowed = 1e-4 * c.smallest(points) + share * c.depth[hit]
    error = np.abs(depth[hit] - c.depth[hit])
    far = np.nonzero(error > allowed)[0][:5]
    assert len(far) == 0, [
        (c.origins[hit][i].tolist(), c.directions[hit][i].tolist(), c.depth[hit][i], error[i]) for i in far
    ]
    return hit, points


def check_normals(c: Case, points: np.ndarray, normal: np.ndarray) -> None:
    gradient = c.field(points)[1]
    steep = np.linalg.norm(gradient, axis=1)
    clear = steep > 0.2 * np.abs(c.weight).max() / np.median(c.support)
    np.testing.assert_allclose(np.linalg.norm(normal, axis=1)[clear], 1, atol=1e-5)
    cosine = -(normal * gradient).sum(1)[clear] / steep[clear]
    assert (cosine > 0.999).all()


@pytest.mark.few_backends
@pytest.mark.parametrize("name", [pytest.param(n, marks=[pytest.mark.slow] if n == "splash" else []) for n in CASES])
def test_first_hit(backend, name):
    c = case(name)
    check(c, c.scene(**backend))


def test_there_are_enough_rays():
    names = [n for n in CASES if n != "splash"]
    assert sum(len(case(n).depth) for n in names) >= 20_000
    for n in names:
        assert np.isfinite(case(n).depth).any()
    assert sum(np.isinf(case(n).depth).sum() for n in names) >= 5_000


@pytest.mark.few_backends
@pytest.mark.parametrize("name", ["one", "mixed", "carved", "sheet", "sheet_edge", "inside"])
@pytest.mark.parametrize("options", [{"octree": "dense", "level": 5}, {"key_bits": 64}, {"level": 2}], ids=str)
def test_first_hit_in_other_octrees(backend, name, options):
    c = case(name)
    check(c, c.scene(**options, **backend))


@pytest.mark.parametrize("offset", [100, 10_000, 1_000_000])
def test_first_hit_far_from_the_origin(backend, offset):
    """Positions are rounded to float32 where they are; from there on nothing more is lost."""
    p = cloud(300, 60) + np.float32(offset)
    c = Case(p, support=0.5)
    rng = np.random.default_rng(61)
    target = p[rng.integers(0, 300, 800)]
    d = unit(rng.normal(size=(800, 3)))
    c.origins, c.directions = target - 4 * d, d
    c.depth = c.first_hit(c.origins, c.directions)
    check(c, c.scene(**backend))


def test_rays_in_any_order_are_the_same_rays(backend):
    """A ray's answer does not depend on those that are traced beside it."""
    c = case("hundred")
    scene = c.scene(**backend)
    mixed = np.random.default_rng(62).permutation(len(c.depth))
    straight = scene.intersect(c.origins, c.directions)
    shuffled = scene.intersect(c.origins[mixed], c.directions[mixed])
    np.testing.assert_array_equal(np.isfinite(straight[0][mixed]), np.isfinite(shuffled[0]))
    hit = np.isfinite(shuffled[0])
    np.testing.assert_allclose(straight[0][mixed][hit], shuffled[0][hit], atol=4e-5)
    for i in range(0, len(mixed), 101):
        alone = scene.intersect(c.origins[i : i + 1], c.directions[i : i + 1])[0]
        assert np.isfinite(alone[0]) == np.isfinite(straight[0][i])


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("sign", [-1, 1])
def test_rays_along_the_axes(backend, axis, sign):
    """Directions with exact zeros, through particles and between them."""
    c = Case(lattice(6, 6, 6), support=1.2, threshold=0.7)
    across = np.stack(np.meshgrid(np.linspace(-3.2, 3.2, 33), np.linspace(-3.2, 3.2, 33)), -1)
    c.origins = np.insert(across.reshape(-1, 2), axis, -7 * sign, axis=1).astype(np.float32)
    c.directions = np.tile((sign * np.eye(3)[axis]).astype(np.float32), (len(c.origins), 1))
    c.depth = c.first_hit(c.origins, c.directions)
    assert 0 < np.isfinite(c.depth).sum() < len(c.depth)
    check(c, c.scene(**backend))


def test_depth_counts_the_direction(backend):
    """Depth is along the ray: a thing behind the eye is not seen."""
    scene = gb.Scene(np.zeros((1, 3)), support=1.0, threshold=0.25, **backend)
    radius = np.sqrt(0.5)
    o = np.array([[5, 0, 0], [5, 0, 0], [0, 0, 0], [-5, 0, 0]], np.float32)
    d = np.array([[-1, 0, 0], [1, 0, 0], [0, 0, 1], [1, 0, 0]], np.float32)
    depth, normal, _ = scene.intersect(o, d)
    np.testing.assert_allclose(depth, [5 - radius, np.inf, radius, 5 - radius], rtol=1e-5)
    np.testing.assert_allclose(normal[[0, 2, 3]], [[1, 0, 0], [0, 0, 1], [-1, 0, 0]], atol=1e-5)


def test_no_rays(backend):
    scene = gb.Scene(cloud(10), **backend)
    depth, normal, color = scene.intersect(np.zeros((0, 3)), np.zeros((0, 3)))
    assert depth.shape == (0,)
    assert normal.shape == color.shape == (0, 3)


def aimed(c: Case, n: int, distance: float, seed: int) -> Case:
    """Rays from a distance to points in and just outside of the particles' supports."""
    rng = np.random.default_rng(seed)
    k = rng.integers(0, len(c.positions), n)
    u, v = unit(rng.normal(size=(n, 3))), unit(rng.normal(size=(n, 3)))
    support = np.broadcast_to(c.support, len(c.positions))[k]
    target = c.positions[k] + v * (support * rng.uniform(0, 1.05, n))[:, None]
    return with_rays(c, target + u * distance, target - np.float32(target + u * distance))


def spray(extent: float, mixed: bool) -> Case:
    """Pairs of particles in a box of so many supports."""
    rng = np.random.default_rng(64)
    p = rng.uniform(0, extent, (30, 3))
    p = np.concatenate([p, p + 0.5 * rng.normal(size=p.shape)]).astype(np.float32)
    return Case(p, np.float32(10 ** rng.uniform(-1, 1, 60)) if mixed else 1.0, threshold=0.3)


@pytest.mark.parametrize("mixed", [False, True], ids=["alike", "mixed"])
@pytest.mark.parametrize("extent", [1, 3_300, 1e5, 1e7])
def test_first_hit_at_any_extent(backend, extent, mixed):
    """Spray over the sea, galaxies: supports that are small against the scene and the way to it."""
    c = aimed(spray(extent, mixed), 200, 2 * extent + 3, 65)
    assert np.isfinite(c.depth).sum() > 120
    check(c, c.scene(**backend))


def random_case(seed: int) -> Case:
    """Supports over six orders, extents and offsets of up to 1e7 of the smallest, negative weights, one place."""
    for further in range(seed, seed + 10**9, 10**6):  # past 1e7 a float32 cannot tell supports apart
        c = _random_case(further)
        if max(np.abs(c.positions).max(), np.abs(c.origins).max()) < 1e7 * c.support.min():
            return c
    raise AssertionError


def _random_case(seed: int) -> Case:
    rng = np.random.default_rng(seed)
    n = int(rng.integers(2, 60))
    size = 10 ** rng.uniform(-3, 3)
    support = np.float32(size * 10 ** rng.uniform(-rng.choice([0, 1, 6]), 0, n))
    extent = size * 10 ** rng.uniform(-1, rng.choice([1, 3, 7]))
    offset = size * 10 ** rng.uniform(0, rng.choice([0, 4, 8])) * unit(rng.normal(size=3))
    p = rng.uniform(0, extent, (n, 3)) + (rng.random() < 0.5) * offset
    near = rng.integers(0, n, n)  # half of the particles are near others
    p = np.where(rng.random((n, 1)) < 0.5, p[near] + support[:, None] * rng.normal(size=(n, 3)), p)
    p[rng.random(n) < 0.1] = p[0]
    weight = np.where(rng.random(n) < rng.choice([0, 0.2]), -1, 1) * rng.uniform(0.5, 2, n)
    c = Case(
        p.astype(np.float32), support, weight=weight.astype(np.float32),
        threshold=float(rng.uniform(0.05, 0.7)), kernel=str(rng.choice(KERNELS)),
    )  # fmt: skip
    return aimed(c, 60, float(support.max()) + extent * 10 ** rng.uniform(-2, 1), seed)


@pytest.mark.few_backends
@pytest.mark.parametrize(
    "seeds",
    [
        range(16),
        range(16, 32),
        [170],  # a particle of 1e-5 of its neighbor's support
        pytest.param(range(32, 500), marks=pytest.mark.slow),
    ],
    ids=["0", "16", "170", "32"],
)
def test_random_scenes_of_extreme_sizes(backend, seeds):
    for seed in seeds:
        c = random_case(seed)
        found = c.scene(**backend).intersect(c.origins, c.directions).distance
        check_depth(c, found, 1e-5)


@pytest.mark.parametrize("ratio", [1e3, 1e5, 5e5])
@pytest.mark.parametrize("distance", [1, 100])
def test_a_small_particle_in_the_edge_of_a_large_one(backend, ratio, distance):
    rng = np.random.default_rng(66)
    for _ in range(4):
        large, u = rng.uniform(-1, 1, 3).astype(np.float32), unit(rng.normal(size=3))
        p = np.stack([large + np.float32(0.93) * u, large])  # the large one's field is 0.018 there
        c = Case(p, np.float32([1.001 / ratio, 1]), threshold=0.1)
        across = unit(np.cross(u, rng.normal(size=(40, 3))))
        o = (p[0] + across * np.float32(distance)).astype(np.float32)
        c = with_rays(c, o, p[0] - o)
        scene = c.scene(**backend)
        found = scene.intersect(c.origins, c.directions).distance
        np.testing.assert_array_equal(np.isfinite(found), np.isfinite(c.depth))
        hit = np.isfinite(found)
        assert hit.any()
        np.testing.assert_allclose(found[hit], c.depth[hit], rtol=3e-7)


@pytest.mark.parametrize("distance", [1e5, 3e6, 1e7])
def test_large_and_tiny_particles_from_far_away(backend, distance):
    """From where float32 tells less than a support of the largest, and 10¹² of the smallest."""
    rng = np.random.default_rng(67)
    support = (10 ** rng.uniform(-5.9, 0, 30)).astype(np.float32)
    support[:2] = 1, 1.001e-6
    c = Case((2 * rng.normal(size=(30, 3))).astype(np.float32), support, threshold=0.1)
    u = unit(rng.normal(size=(20, 3)))
    o = (c.positions[0] + distance * u).astype(np.float32)
    c = with_rays(c, o, c.positions[0] - o)
    found = c.scene(**backend).intersect(c.origins, c.directions).distance
    np.testing.assert_array_equal(np.isfinite(found), np.isfinite(c.depth))
    hit = np.isfinite(found)
    assert hit.sum() >= 5
    np.testing.assert_allclose(found[hit], c.depth[hit], rtol=3e-7)


@pytest.mark.parametrize(
    ("extent", "kind"),
    [(1, "alike"), (1, "mixed"), (1, "stretched"), (1e7, "mixed")]
    + [
        pytest.param(extent, kind, marks=pytest.mark.slow)
        for extent in (1e5, 1e7)
        for kind in ("alike", "mixed", "stretched")
        if (extent, kind) != (1e7, "mixed")
    ],
)
def test_cells_find_what_tiles_find_at_any_extent(backend, extent, kind):
    """A clip that cuts nothing sends the same rays through cells instead of tiles."""
    c = spray(extent, kind == "mixed")
    if kind == "stretched":
        axes = np.random.default_rng(67).uniform(0.5, 1, (len(c.positions), 3))
        c = dataclasses.replace(c, matrices=axes[:, :, None] * np.eye(3))
    scene = c.scene(**backend)
    rng = np.random.default_rng(68)
    away = gb.ClipSphere((0, 0, 1e3 + 1e3 * extent), 1.0)
    n_hits = 0
    for k in rng.integers(0, len(c.positions), 3):
        # Not so far that the last bit of a direction moves a pixel.
        distance = 3 + min(extent, 1e3) * rng.choice([0.1, 1, 3])
        eye = c.positions[k] + distance * unit(rng.normal(size=3))
        fov = float(np.degrees(2 * np.arctan(2 / distance)))
        camera = gb.Camera(tuple(eye.tolist()), tuple(c.positions[k].tolist()), fov=fov)
        tiles = gb.render(scene, camera, (24, 16)).distance
        cells = gb.render(scene, camera, (24, 16), clips=[away]).distance
        np.testing.assert_array_equal(np.isfinite(cells), np.isfinite(tiles))
        hit = np.isfinite(tiles)
        n_hits += hit.sum()
        np.testing.assert_allclose(cells[hit], tiles[hit], rtol=3e-7, atol=2e-4)
    assert n_hits > 80


# The oracle itself.


def test_the_oracle_on_one_ball():
    """Murakami: (1 - (r/a)^2)^2 = tau is a sphere of radius a sqrt(1 - sqrt(tau))."""
    a, tau, center = 0.8, float(np.float32(0.6)), np.array([0.1, -0.2, 0.3], np.float32)
    radius = float(np.float32(a)) * np.sqrt(1 - np.sqrt(tau))
    c = case("one")
    v = c.origins.astype(np.float64) - center
    d = c.directions.astype(np.float64)
    dd, vd = (d * d).sum(1), (v * d).sum(1)
    disc = vd**2 - dd * ((v * v).sum(1) - radius**2)
    near = np.where(disc >= 0, (-vd - np.sqrt(np.maximum(disc, 0))) / dd, np.inf)
    np.testing.assert_array_equal(np.isfinite(c.depth), disc >= 0)
    np.testing.assert_allclose(c.depth, near, atol=2e-7)


@pytest.mark.parametrize("kernel", KERNELS)
def test_the_oracle_by_dense_sampling(kernel):
    """The first of 40,000 samples past the threshold is right after the oracle's depth."""
    p = np.array([[-0.4, 0, 0], [0.5, 0.1, 0], [0.1, 0.3, 0.2]], np.float32)
    c = Case(p, [1, 0.9, 0.5], [1, 0.8, -0.7], kernel, threshold=0.3)
    rng = np.random.default_rng(63)
    o = np.float32(rng.normal(size=(60, 3)))
    o *= 3 / np.linalg.norm(o, axis=1, keepdims=True)
    d = unit(rng.uniform(-0.7, 0.7, (60, 3)) - o)
    o[:20] = rng.uniform(-0.5, 0.5, (20, 3))  # some inside
    found = c.first_hit(o, d)
    t = np.linspace(0, 5, 40_001)
    for i in range(len(o)):
        f = c.field(o[i].astype(np.float64) + t[:, None] * d[i].astype(np.float64))[0]
        other_side = np.nonzero((f > 0.3) != (f[0] > 0.3))[0]
        if len(other_side):
            after = t[other_side[0]] - found[i]
            assert 0 <= after <= t[1] or (found[i] < t[other_side[0]] and f.max() - 0.3 < 1e-6)
        else:  # at most grazed between two samples
            assert np.isinf(found[i]) or abs(np.interp(found[i], t, f) - 0.3) < 1e-6
