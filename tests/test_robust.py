"""What nobody should pass, and what will be passed: a clear result or a clear error, no hang."""

import functools
import re

import globule as gb
import numpy as np
import pytest
from scenes import KERNELS, Case, cloud, lattice, unit, with_rays

AHEAD = np.array([[0, 0, -1]], np.float32)
SIZE = (48, 36)


def look(scene: gb.Scene, camera: gb.Camera | None = None) -> gb.Frame:
    frame = gb.render(scene, camera, SIZE)
    for image in ("picture", "color", "distance", "position", "normal", "albedo", "mask"):
        assert getattr(frame, image).shape[:2] == SIZE[::-1]
    points = cloud(20)
    for values in (frame.color, frame.normal, scene.field(points), scene.gradient(points)):
        assert np.isfinite(values).all()
    assert (frame.distance >= 0).all()
    offsets, indices = scene.neighbors(points, 0.5)
    assert offsets[-1] == len(indices)
    assert (indices < max(len(scene), 1)).all()
    assert len(scene.octree.key_hash) == len(scene.octree.node_hash) == 16
    assert scene.octree.n_inside <= len(scene)
    assert repr(scene)
    assert repr(scene.octree)
    return frame


def hits(scene: gb.Scene, origins, directions) -> np.ndarray:
    return scene.intersect(np.asarray(origins, np.float32), unit(directions))[0]


def check_against_oracle(c: Case, scene: gb.Scene, n: int = 200, seed: int = 80) -> None:
    rng = np.random.default_rng(seed)
    finite = np.isfinite(c.positions).all(1) & (np.abs(c.positions) < 1e18).all(1)
    reach = float(np.max(c.support)) if np.isfinite(np.max(c.support)) else 1.0
    target = c.positions[finite][rng.integers(0, finite.sum(), n)]
    target = target + rng.normal(size=(n, 3)).astype(np.float32) * np.float32(reach / 2)
    d = unit(rng.normal(size=(n, 3)))
    o = (target - np.float32(4 * reach) * d).astype(np.float32)
    o[: n // 4] = target[: n // 4]
    support = np.broadcast_to(c.support, len(finite))[finite]
    weight = np.broadcast_to(c.weight, len(finite))[finite]
    clean = Case(c.positions[finite], support, weight, c.kernel, c.threshold)
    np.testing.assert_allclose(scene.intersect(o, d)[0], clean.first_hit(o, d), rtol=1e-6, atol=1e-4 * reach)


OPTIONS = ({}, {"key_bits": 64}, {"octree": "dense", "level": 4}, {"level": 0})


@pytest.mark.parametrize("options", OPTIONS, ids=str)
def test_no_particles(backend, options):
    scene = gb.Scene(np.zeros((0, 3)), **options, **backend)
    frame = look(scene)
    assert not frame.mask.any()
    assert scene.octree.n_inside == 0
    assert np.isinf(hits(scene, [[0, 0, 5]], AHEAD)).all()
    assert (scene.field(cloud(5)) == 0).all()
    assert frame.attribute(np.zeros(0, np.float32)).shape == SIZE[::-1]
    assert np.isnan(scene.blend(cloud(3), np.zeros((0, 2), np.float32))).all()
    assert len(scene.neighbors(cloud(3), 1.0)[1]) == 0
    scene.update(positions=cloud(100))
    assert scene.octree.n_inside == 100
    assert look(scene).mask.any()


@pytest.mark.parametrize("kernel", KERNELS)
@pytest.mark.parametrize("options", OPTIONS, ids=str)
def test_one_particle_and_nothing_else_said(backend, kernel, options):
    scene = gb.Scene(np.array([[3, 4, 5]]), kernel=kernel, **options, **backend)
    assert scene.support > 0
    assert 0.02 < look(scene).mask.mean() < 0.95
    assert np.isfinite(hits(scene, [[3, 4, 5 + 2 * scene.support]], AHEAD)).all()


@pytest.mark.parametrize("n", [2, 10, 33, 1500])
@pytest.mark.parametrize("options", OPTIONS, ids=str)
def test_all_at_one_place(backend, n, options):
    p = np.full((n, 3), 0.25, np.float32)
    scene = gb.Scene(p, **options, **backend)
    assert look(scene).mask.any()
    scene = gb.Scene(p, support=1.0, threshold=0.6, **options, **backend)
    radius = np.sqrt(1 - np.sqrt(0.6 / n))
    depth = hits(scene, [[0.25, 0.25, 5], [0.25, 0.25, 0.25]], [[0, 0, -1], [0, 1, 0]])
    np.testing.assert_allclose(depth, [4.75 - radius, radius], atol=1e-4)
    assert np.isinf(hits(scene, [[0.25 + 1.001 * radius, 0.25, 5]], AHEAD)).all()


@pytest.mark.few_backends
@pytest.mark.parametrize("alike", [True, False])
@pytest.mark.parametrize("octree", ["sparse", "dense"])
@pytest.mark.parametrize("n", [20_000, pytest.param(100_000, marks=pytest.mark.slow)])
def test_very_many_at_one_place(backend, alike, octree, n):
    support = 1.0 if alike else np.linspace(0.999, 1, n)
    p = gb.Particles(np.full((n, 3), 0.5), support=support)
    low, half, high = (gb.Scene(p, threshold=t, octree=octree, **backend) for t in (0.6, 0.25 * n, 2.0 * n))
    o, d = [[0.5, 0.5, 4], [0.5, 0.5, 0.5], [0.5, 1.6, 4]], [[0, 0, -1], [1, 0, 0], [0, 0, -1]]
    tolerance = 1e-4 if alike else 2e-3
    for scene, radius in ((low, np.sqrt(1 - np.sqrt(0.6 / n))), (half, np.sqrt(0.5))):
        np.testing.assert_allclose(hits(scene, o, d), [3.5 - radius, radius, np.inf], atol=tolerance)
    assert np.isinf(hits(high, o, d)).all()
    assert low.field([[0.5, 0.5, 0.5]])[0] == pytest.approx(n, rel=1e-5)
    for scene, seen in ((low, True), (half, True), (high, False)):
        assert gb.render(scene, gb.Camera((0.5, 0.5, 4), (0.5, 0.5, 0.5)), (4, 3)).mask.any() == seen


@pytest.mark.filterwarnings("ignore:positions")
@pytest.mark.parametrize("options", OPTIONS, ids=str)
def test_what_is_not_finite_has_no_influence(backend, options):
    rng, good = np.random.default_rng(81), cloud(400, 81)
    bad = np.array(
        [
            [np.nan, 0, 0], [0, np.nan, 0], [0, 0, np.nan], [np.inf, 0, 0], [0, -np.inf, 0],
            [np.nan] * 3, [np.inf] * 3, [1e30, 0, 0], [0, 0, -1e30], [3e38] * 3, [1e19, 0, 0],
        ],
        np.float32,
    )  # fmt: skip
    p = np.concatenate([good, bad, bad])[rng.permutation(422)]
    scene = gb.Scene(p, support=0.4, **options, **backend)
    clean = gb.Scene(good, support=0.4, **options, **backend)
    assert scene.octree.n_inside == 400
    assert scene.octree.extent < 3
    at = cloud(100, 82)
    np.testing.assert_allclose(scene.field(at), clean.field(at), rtol=1e-6, atol=1e-7)
    assert look(scene).mask.any()  # the fitted camera looks at what is inside
    assert scene.neighbors(at, 0.3)[0][-1] == clean.neighbors(at, 0.3)[0][-1]
    check_against_oracle(Case(p, support=0.4), scene)
    measured = [gb.Scene(some, **options, **backend).support for some in (p, good)]  # the spacing of the good ones
    assert measured[0] == pytest.approx(measured[1], rel=0.1)
    scene.update(positions=bad)
    assert scene.octree.n_inside == 0
    assert not look(scene, gb.Camera((0, 0, 5), (0, 0, 0))).mask.any()


@pytest.mark.parametrize("options", OPTIONS, ids=str)
@pytest.mark.parametrize("offset", [1e3, 1e6, -1e6])
def test_far_from_the_origin(backend, offset, options):
    c = Case(cloud(500, 83) + np.float32(offset), support=0.5)
    check_against_oracle(c, c.scene(**options, **backend))


@pytest.mark.parametrize("size", [1e-15, 1e-9, 1e-4, 1e4, 1e9, 1e15])
def test_any_unit_of_length(backend, size):
    small = Case(cloud(300, 84), support=0.5)
    d = unit(np.random.default_rng(85).normal(size=(300, 3)))
    o = (small.positions - 3 * d).astype(np.float32)
    scene = gb.Scene(small.positions * np.float32(size), support=0.5 * size, **backend)
    depth = scene.intersect(o * np.float32(size), d)[0].astype(np.float64) / size
    np.testing.assert_allclose(depth, small.first_hit(o, d), atol=2e-4)
    assert gb.render(scene, size=SIZE).mask.any()


@pytest.mark.parametrize("octree", ["sparse", "dense"])
def test_zero_support(backend, octree):
    p, support = cloud(300, 86), np.where(np.arange(300) % 3, 0.4, 0.0)
    c = Case(p, support)
    scene = c.scene(octree=octree, **backend)
    look(scene)
    check_against_oracle(c, scene)
    on_top = p[::3][:50]  # where a support of zero would divide by zero
    kept = Case(p[support > 0], 0.4)
    np.testing.assert_allclose(scene.field(on_top), kept.field(on_top)[0], atol=1e-6)
    assert np.isfinite(scene.blend(on_top, np.ones(300, np.float32))).any()
    nothing = gb.Scene(gb.Particles(p, support=np.zeros(300)), octree=octree, **backend)
    assert not look(nothing, gb.Camera((0, 0, 5), (0, 0, 0))).mask.any()


def scene_or_refusal(particles, backend, **options) -> gb.Scene:
    """Supports past what float32 can square may be refused, by name."""
    try:
        return gb.Scene(particles, **options, **backend)
    except ValueError as error:
        if str(error).startswith("support: expected"):
            pytest.skip(f"refused: {error}")
        raise


@pytest.mark.parametrize("support", [1e3, 1e10, 1e18, 1e30, 3e38])
def test_huge_support(backend, support):
    scene = scene_or_refusal(cloud(200, 87), backend, support=support)
    look(scene, gb.Camera((0, 0, 5), (0, 0, 0)))
    if support <= 1e10:
        assert scene.field([[0.5, 0, 0]])[0] == pytest.approx(200, rel=1e-4)
        radius = support * np.sqrt(1 - np.sqrt(scene.threshold / 200))
        assert hits(scene, [[0, 0, 0]], AHEAD)[0] == pytest.approx(radius, rel=2e-3)


@pytest.mark.parametrize("support", [1e3, 1e6, 1e10, 1e18, 1e30])
def test_huge_supports_among_small_ones(backend, support):
    mixed = np.where(np.arange(200) % 50, 0.2, support)
    scene = scene_or_refusal(gb.Particles(cloud(200, 87), support=mixed), backend)
    look(scene)
    # Four reach everywhere: the way out is where (1 - x)^2 = tau / 4.
    radius = support * np.sqrt(1 - np.sqrt(scene.threshold / 4))
    assert hits(scene, [[0, 0, 5]], AHEAD)[0] == pytest.approx(radius + 5, rel=2e-3)


@pytest.mark.parametrize("support", [1e-6, 1e-10, 1e-20, 1e-38])
def test_tiny_support(backend, support):
    p = cloud(200, 88)
    scene = scene_or_refusal(p, backend, support=support)
    look(scene, gb.Camera((0, 0, 5), (0, 0, 0)))
    assert (scene.field(cloud(50, 89)) == 0).all()
    assert scene.field(p[:1])[0] == pytest.approx(1, abs=1e-5)


@pytest.mark.parametrize("threshold", [1e-30, 1e-6, 1e-3])
@pytest.mark.parametrize("kernel", KERNELS)
def test_tiny_threshold(backend, kernel, threshold):
    """The surface comes close to the supports' own edge, where b is flat."""
    scene = gb.Scene(cloud(100, 90), support=0.3, threshold=threshold, kernel=kernel, **backend)
    assert look(scene).mask.any()
    one = gb.Scene(np.zeros((1, 3)), support=1.0, threshold=threshold, kernel=kernel, **backend)
    depth = hits(one, [[0, 0, 5], [0, 1.001, 5]], [[0, 0, -1]] * 2)
    assert 4 - 1e-4 <= depth[0] < 4.6
    assert np.isinf(depth[1])


@pytest.mark.parametrize("octree", ["sparse", "dense"])
@pytest.mark.parametrize("threshold", [1e3, 1e30])
def test_threshold_that_nothing_reaches(backend, threshold, octree):
    scene = gb.Scene(cloud(500, 91), support=0.5, threshold=threshold, octree=octree, **backend)
    assert not look(scene).mask.any()
    one = gb.Scene(np.zeros((1, 3)), support=1.0, threshold=1.001, octree=octree, **backend)
    assert np.isinf(hits(one, [[0, 0, 5], [0, 0, 0]], [[0, 0, -1]] * 2)).all()


@functools.cache
def crowd(alike: bool) -> Case:
    p = lattice(18, 18, 18, 0.2, 92)
    c = Case(p, 7.0 if alike else np.linspace(6.5, 7.5, len(p)), threshold=300.0)
    origins = 40 * unit(cloud(60, 94))
    origins[:10] = cloud(10, 93, 10)  # some begin inside
    return with_rays(c, origins, cloud(60, 95, 14) - origins)


@pytest.mark.slow
@pytest.mark.few_backends
@pytest.mark.parametrize("alike", [True, False])
@pytest.mark.parametrize("octree", ["sparse", "dense"])
def test_supports_of_many_spacings(backend, alike, octree):
    """A ray meets thousands of supports at once: more than any list holds."""
    c = crowd(alike)
    scene = c.scene(octree=octree, **backend)
    assert 10 < np.isfinite(c.depth).sum() < len(c.depth)
    np.testing.assert_allclose(scene.intersect(c.origins, c.directions)[0], c.depth, atol=7e-4)
    look(scene)


@pytest.mark.parametrize("weight", [-1.0, 0.0])
def test_no_weight_above_zero(backend, weight):
    p = cloud(100, 93)
    for given in (weight, np.full(100, weight)):
        scene = gb.Scene(gb.Particles(p, support=0.5, weight=given), **backend)
        assert not look(scene).mask.any()
        assert np.isnan(scene.blend(p, np.ones(100, np.float32))).all()


@pytest.mark.parametrize("weight", [1e-20, 1e-12, 1e-6, 1e6, 1e20])
def test_weights_of_any_size(backend, weight):
    """Only the weight relative to the threshold matters."""
    p = cloud(200, 94)
    d = unit(np.random.default_rng(94).normal(size=(200, 3)))
    o = (p - 3 * d).astype(np.float32)
    truth = Case(p, 0.5).first_hit(o, d)
    for given in (weight, np.full(200, weight)):
        depth = Case(p, 0.5, given, threshold=0.6 * weight).scene(**backend).intersect(o, d)[0]
        np.testing.assert_allclose(depth, truth, atol=1e-4)


def test_points_and_rays_that_are_none_and_a_camera_inside(backend):
    scene = gb.Scene(cloud(200, 96), support=0.4, **backend)
    bad = np.array([[np.nan] * 3, [np.inf, 0, 0], [1e30, 0, 0], [-3e38] * 3], np.float32)
    assert (scene.field(bad) == 0).all()
    assert (scene.gradient(bad) == 0).all()
    assert np.isnan(scene.blend(bad, np.ones(200, np.float32))).all()
    assert scene.neighbors(bad, 1.0)[0][-1] == 0, "a place that is none is near to nothing"
    assert (scene.neighbors([[0, 0, 0]], 1e30)[0][-1], scene.neighbors([[0, 0, 0]], 1e-30)[0][-1]) == (200, 0)
    for octree in ("sparse", "dense"):
        scene = gb.Scene(cloud(200, 95), support=0.4, octree=octree, **backend)
        good_o, good_d = np.array([0, 0, 5], np.float32), np.array([0, 0, -1], np.float32)
        expected = scene.intersect(good_o[None], good_d[None])[0][0]
        bad = [np.nan, np.inf, -np.inf]
        o = [[b, 0, 5] for b in bad] + [[0, 0, 5]] * 5 + [[1e30, 0, 0], [0, 0, 1e18]]
        d = [[0, 0, -1]] * 3 + [[b, 0, -1] for b in bad] + [[0, 0, 0], [0, 0, -1]]
        d += [[-1, 0, 0], [0, 0, -1]]
        depth = scene.intersect(np.array(o, np.float32), np.array(d, np.float32))[0]
        assert (depth[:7] == np.inf).all()
        assert depth[7] == pytest.approx(expected, abs=1e-4)  # good rays beside them stay good
    scene = gb.Scene(lattice(8, 8, 8), **backend)
    frame = look(scene, gb.Camera((0, 0, 0), (1, 2, 3)))
    assert frame.mask.all()  # the way out, seen from within
    assert ((frame.distance > 3) & (frame.distance < 9)).all()
    for eye, more in (((0, 0, 3.5), {}), ((1e6, 1e6, 1e6), {"fov": 1e-4}), ((0, 0, 9), {"fov": 179})):
        look(scene, gb.Camera(eye, (0, 0, 0), **more))
    look(scene, gb.Camera((0, 0, 9), (0, 0, 0), up=(0, 0, 1)))  # along the view


@pytest.mark.parametrize("options", OPTIONS, ids=str)
def test_lines_planes_and_pairs(backend, options):
    for p in (lattice(200, 1, 1), lattice(1, 40, 40), cloud(2), cloud(3), lattice(2, 1, 1)):
        scene = gb.Scene(p, **options, **backend)
        assert look(scene).mask.any()
        check_against_oracle(Case(p, scene.support), scene)


SCENE_MISTAKES = {
    (TypeError, "positions"): [
        {"particles": [["a", "b", "c"]]},
        {"particles": [[0, 0, 0], [1, 1]]},
        {"particles": np.zeros((3, 3), complex)},
    ],
    (ValueError, "positions"): [
        {"particles": np.zeros(shape)} for shape in ((4, 4), 3, (2, 2, 3))
    ],
    (TypeError, "particles"): [{"particles": None}],
    (ValueError, "kernel"): [{"kernel": "gauss"}],
    (TypeError, "threshold"): [{"threshold": "high"}],
    (ValueError, "threshold"): [{"threshold": value} for value in (0, -1, np.nan)],
    (TypeError, "support"): [{"support": [1, 2, 3]}],
    (ValueError, "support"): [{"support": value} for value in (0, -2.0, np.inf)],
    (ValueError, "key_bits"): [{"key_bits": 48}, {"key_bits": 64, "octree": "dense"}],
    (TypeError, "level"): [{"level": 4.5}],
    (ValueError, "level"): [
        {"level": 11}, {"level": -1}, {"level": 22, "key_bits": 64}, {"level": 9, "octree": "dense"}
    ],
    (ValueError, "octree"): [{"octree": "kd"}],
    (ValueError, "device"): [{"device": "gpu"}, {"device": "cuda:x"}],
    (TypeError, "threads"): [{"threads": 1.5}],
    (ValueError, "threads"): [{"threads": -1}],
    (ValueError, "bounds"): [
        {"bounds": value} for value in
        ((0, 1), ((1, 1, 1), (0, 0, 0)), ((0, 0, 0), (1, 1, np.nan)))
    ],
}  # fmt: skip


@pytest.mark.parametrize(("error", "name"), SCENE_MISTAKES)
def test_mistakes_in_a_scene(error, name):
    for options in SCENE_MISTAKES[error, name]:
        given = {"particles": cloud(5), "device": "cpu", **options}
        with pytest.raises(error, match=f"^{name}: expected|^{name}.*(got|uses)"):
            gb.Scene(given.pop("particles"), **given)


def test_mistakes_in_questions(backend):
    scene = gb.Scene(cloud(5), **backend)

    for error, name, call in [
        (ValueError, "points", lambda: scene.field(np.zeros((4, 2)))),
        (ValueError, "points", lambda: scene.gradient(np.zeros(3))),
        (ValueError, "points", lambda: scene.neighbors(np.zeros((1, 4)), 1)),
        (ValueError, "radius", lambda: scene.neighbors(np.zeros((1, 3)), -1)),
        (TypeError, "radius", lambda: scene.neighbors(np.zeros((1, 3)), None)),
        (ValueError, "values", lambda: scene.blend(np.zeros((1, 3)), np.zeros(4))),
        (ValueError, "origins", lambda: scene.intersect(np.zeros((2, 2)), np.zeros((2, 2)))),
        (ValueError, "directions", lambda: scene.intersect(np.zeros((2, 3)), np.zeros((3, 3)))),
        (ValueError, "directions", lambda: scene.intersect(np.zeros((1, 3)), 2 * AHEAD)),
        (TypeError, "points", lambda: scene.field("here")),
        (TypeError, "points", lambda: scene.field([["a", 0, 0]])),
        (TypeError, "update", lambda: scene.update(position=cloud(3))),
        (TypeError, "update", lambda: scene.update(gb.Particles(cloud(3)), weight=1.0)),
        (ValueError, "weight", lambda: scene.update(weight=np.ones(3))),
    ]:
        with pytest.raises(error, match=f"^{name}: expected|^{name}: unknown"):
            call()
    look(scene)  # and the scene still works


def test_an_update_checks_what_is_new_and_measures_the_first_support(backend):
    n = 50
    support = np.linspace(0.3, 0.5, n, dtype=np.float32)
    scene = gb.Scene(gb.Particles(cloud(n), support=support, color=(1, 0, 0)), **backend)
    scene.update(positions=cloud(n, 7).tolist())
    np.testing.assert_array_equal(scene.particles.positions, np.float32(cloud(n, 7)))
    assert scene.particles.support is support
    assert scene.support is support
    was, image = scene.particles, gb.render(scene, size=SIZE).image
    for name, fields, got in [
        ("positions", {"positions": cloud(n + 1)}, f"{n + 1}; give support too"),
        ("positions", {"positions": np.zeros((3, 4))}, "(3, 4)"),
        ("support", {"support": -support}, "-0.3"),
        ("support", {"support": support * np.logspace(-9, 0, n)}, "3e-10"),
        ("color", {"positions": cloud(n, 8), "color": (0, 0, 2)}, "2"),
        ("anisotropy", {"anisotropy": np.zeros((n, 3, 3))}, "[[0.0, 0.0"),
    ]:
        with pytest.raises(ValueError, match=f"^{name}: expected .*got .*{re.escape(got)}"):
            scene.update(**fields)
        assert scene.particles is was
    np.testing.assert_array_equal(gb.render(scene, size=SIZE).image, image)
    vars(was)["weight"] = [1.0]  # set by hand, so not known to be right
    with pytest.raises(ValueError, match=r"^weight: expected a number or shape"):
        scene.update(positions=cloud(n))
    was.weight = None
    scene.update(positions=cloud(n + 1), support=0.4)
    assert (len(scene), scene.support) == (n + 1, 0.4)
    assert look(scene).mask.any()
    cube = (np.indices((6, 6, 6)).reshape(3, -1).T * 0.05).astype(np.float32)
    scene = gb.Scene(np.zeros((1, 3)), device="cpu")
    scene.update(positions=cube)
    measured = scene.support
    assert measured == gb.Scene(cube, device="cpu").support
    scene.update(positions=2 * cube)
    assert scene.support == measured, "and stays"


def test_simd_level_by_hand(monkeypatch):
    monkeypatch.setenv("GLOBULE_SIMD", "v9")
    with pytest.raises(ValueError, match=r"^GLOBULE_SIMD: expected"):
        gb.Scene(cloud(5), device="cpu")
