"""What all pictures have in common: samples, threads, sizes, backends, picking, hard particles."""

import dataclasses
import functools

import globule as gb
import numpy as np
import pytest
from cli_helpers import refuses
from globule.render.lights import uniform_sky
from light import CENTER, ONE_SKY, ball, direction_sky, quiet
from scenes import CASES, case, cloud

IMAGES = ("picture", "color", "distance", "position", "normal", "albedo")
LIGHTS = (
    gb.Headlight((0.1, 0.1, 0.1)),
    gb.DirectionalLight((-0.4, 1, 0.6), (0.6, 0.6, 0.5), angle=8),
    gb.PointLight((1.5, 2, 1), (0.3, 0.3, 0.4), radius=0.2),
)
EVERYTHING = gb.RenderSettings(
    lights=LIGHTS,
    shadows=True,
    ambient="sky",
    ambient_rays=3,
    ambient_distance=1.0,
    sky=gb.Sky(),
    ground=gb.Ground(-1.2, check=0.4, reflection=0.2),
    material=gb.Material(roughness=0.1),
    bounces=5,
)
CUTS = [gb.ClipPlane((1, 1, 0), 0.8), gb.ClipSphere((0.3, 0.4, 0.8), 0.45)]
VIEW = gb.Camera((1.6, 1.3, 2.6), (0, 0, 0), fov=35)  # the horizon is above the picture


def busy(n=400, seed=64, alike=False, **fields) -> gb.Particles:
    rng = np.random.default_rng(seed)
    support = 0.3 if alike else rng.uniform(0.05, 0.5, n)
    given = {
        "support": support,
        "color": rng.uniform(0, 1, (n, 3)),
        "reflection": rng.uniform(0, 0.6, n),
        "refraction": rng.uniform(0, 0.9, n),
        **fields,
    }
    positions = given.pop("positions", None)
    return gb.Particles(cloud(n, seed) if positions is None else positions, **given)


def look(scene, size=(41, 33), settings=EVERYTHING, clips=CUTS, camera=VIEW):
    return gb.render(scene, camera, size, settings, clips)


def assert_same(a, b, images=IMAGES):
    for image in images:
        np.testing.assert_array_equal(getattr(a, image), getattr(b, image), err_msg=image)


def test_refine_is_one_render_of_all_samples(backend):
    scene = gb.Scene(busy(), **backend)
    size = (17, 13)
    at_once = look(scene, size, dataclasses.replace(EVERYTHING, samples=7))
    for first, *steps in ((1, 1, 1, 4), (3, 4), (6, 1)):
        frame = look(scene, size, dataclasses.replace(EVERYTHING, samples=first))
        for n in steps:
            assert frame.refine(n) is frame
        assert frame.samples == at_once.samples == 7
        assert_same(frame, at_once)


def test_refine_of_a_plain_picture(backend):
    """Also where the first sample took the short way."""
    scene = gb.Scene(busy(reflection=None, refraction=None), **backend)
    look(scene)  # leaves other sums behind
    plain = gb.RenderSettings()
    frame = look(scene, settings=plain, clips=()).refine(3)
    at_once = look(scene, settings=dataclasses.replace(plain, samples=4), clips=())
    np.testing.assert_allclose(frame.color, at_once.color, atol=1e-6)


def test_one_plain_sample_is_the_first_of_several(backend):
    """The short way and the waves are the same picture where nothing is mirrored or cut."""
    scene = gb.Scene(busy(reflection=None, refraction=None), **backend)
    plain = gb.RenderSettings(specular=0.4)
    short = look(scene, settings=plain, clips=())
    sky = uniform_sky(plain.background)
    waves = look(scene, settings=dataclasses.replace(plain, sky=sky), clips=())
    np.testing.assert_allclose(short.color, waves.color, atol=2e-4)
    assert np.abs(short.picture.astype(int) - waves.picture).max() <= 1


def test_samples_leave_depth_and_normals(backend):
    frame = look(gb.Scene(busy(), **backend))
    kept = ("distance", "position", "normal", "albedo", "mask", "_layer")
    before = {k: getattr(frame, k) for k in kept}
    color = frame.color
    frame.refine(3)
    for k, v in before.items():
        np.testing.assert_array_equal(getattr(frame, k), v, err_msg=k)
    assert (frame.color != color).any()


@pytest.mark.few_backends
@pytest.mark.parametrize("settings", [gb.RenderSettings(), EVERYTHING], ids=["plain", "everything"])
def test_frames_of_moving_scenes_do_not_mix(backend, settings):
    """Frames may be asked for faster than they are made; each shows its own particles."""
    n, size = (20_000, (320, 240)) if backend["device"] == "cuda" else (400, (41, 33))
    sets = [cloud(n, 70 + k) for k in range(3)]
    still = busy(60, 80, alike=True, positions=cloud(60, 80) + np.float32(0.4))

    def scenes(positions):
        moving = busy(n, 70, alike=True, support=0.05, positions=positions)
        return gb.Scene(moving, **backend), gb.Scene(still, **backend)

    alone = [look(scenes(positions), size, settings) for positions in sets]
    both = scenes(sets[0])
    frames = []
    for i in range(6):
        both[0].update(positions=sets[i % 3])
        frames.append((look(both[0], size, settings), look(both, size, settings)))
        both[1].update(positions=still.positions + np.float32(0.1 * i))  # after its picture
        both[1].update(positions=still.positions)
    for i, (one, two) in enumerate(frames):
        assert_same(one, frames[i % 3][0])
        assert_same(two, alone[i % 3])


@pytest.mark.parametrize("samples", [0, -1, 70000])
def test_refine_by_no_or_too_many_samples_is_refused(samples):
    refuses("samples", look(ball(), (4, 4)).refine, samples)


WAYS = pytest.mark.parametrize("way", [(gb.RenderSettings(), ()), (EVERYTHING, CUTS)], ids=["plain", "everything"])


@WAYS
@pytest.mark.parametrize("alike", [True, False])
def test_threads_do_not_change_a_bit(alike, way):
    one, *many = (look(gb.Scene(busy(alike=alike), device="cpu", threads=n), (41, 33), *way) for n in (1, 2, 5))
    for other in many:
        assert_same(one, other)


@WAYS
def test_two_runs_give_the_same_bits(backend, way):
    scene = gb.Scene(busy(), **backend)
    first = look(scene, (41, 33), *way)
    assert_same(first, look(scene, (41, 33), *way))
    assert_same(first, look(gb.Scene(busy(), **backend), (41, 33), *way))


@pytest.mark.parametrize("size", [(1, 1), (3, 5), (65, 63), (7, 300), (1023, 7)], ids=str)
def test_odd_sizes(backend, size):
    frame = look(gb.Scene(busy(60), **backend), size)
    assert frame.color.shape == (size[1], size[0], 3)
    assert np.isfinite(frame.color).all()
    assert (frame.color >= 0).all()
    assert np.isfinite(frame.normal).all()


def test_rows_do_not_depend_on_the_band_they_are_in(backend):
    """A tall picture is traced in bands of rows; the sky and depth go on across them."""
    camera = gb.Camera(CENTER + (0, 0, 9), CENTER, height=40.0)
    frame = gb.render(ball(**backend), camera, (3, 2000), quiet(sky=direction_sky(64)))
    y = (0.5 - (np.arange(2000) + 0.5) / 2000) * 40
    seen = np.abs(y) < 0.6
    assert frame.mask[seen, 1].all()
    assert not frame.mask[np.abs(y) > 0.7].any()
    np.testing.assert_allclose(frame.position[seen, 1, 1], y[seen] + CENTER[1], atol=1e-4)


@pytest.mark.parametrize("alike", [True, False])
@pytest.mark.parametrize("kind", ["plain", "everything", "glass", "mirror"])
def test_pictures_agree_between_backends(backend, reference, alike, kind):
    plain = gb.Ground(-1.2, reflection=0.2)  # a checkerboard far away would be noise
    settings = {
        "plain": gb.RenderSettings(),
        "everything": dataclasses.replace(EVERYTHING, ground=plain),
        "glass": quiet(sky=gb.Sky(), material=gb.Material(0.0, 1.0, 1.4, absorption=1.0)),
        "mirror": quiet(sky=gb.Sky(), material=gb.Material(0.9, 0.0)),
    }[kind]
    clips = () if kind == "plain" else CUTS
    mine, other = (
        look(make(busy(100, alike=alike), **options), (80, 60), settings, clips)
        for make, options in ((gb.Scene, backend), (reference, {}))
    )
    assert np.mean(mine.mask != other.mask) <= 1e-3
    difference = np.abs(mine.picture.astype(int) - other.picture).max(-1)
    assert np.mean(difference > 1) <= 1e-3


@functools.cache
def truth(name):
    """Camera, size, and the oracle's picture of a case."""
    c = case(name)
    camera, size = gb.Camera.fit(c.positions, margin=float(np.mean(c.support))), (40, 30)
    o, d = (v.reshape(-1, 3) for v in camera.rays(size))
    return camera, size, c.first_hit(o, d).reshape(size[::-1])


QUICK = ("one", "mixed", "carved", "sheet_edge", "hundred", "inside", "cloud blinn",
         "weights solid", "stretched murakami True")  # fmt: skip
FAR_PLANE = [gb.ClipPlane((0.3, 0.2, 1), 1e5)]


@pytest.mark.few_backends
@pytest.mark.parametrize(
    ("octree", "name"),
    [  # ellipsoids: in the sparse octree only
        pytest.param(octree, name, marks=[] if name in QUICK else [pytest.mark.slow])
        for octree in ("sparse", "dense")
        for name in CASES
        if name != "splash" and not (octree == "dense" and name.startswith("stretched"))
    ],
)
def test_waves_meet_what_the_oracle_meets(backend, name, octree):
    """A plane that cuts nothing sends the camera's rays the way of secondary ones, cell by cell."""
    c = case(name)
    scene = c.scene(octree=octree, **backend)
    camera, size, expected = truth(name)
    cell = gb.render(scene, camera, size, quiet(), FAR_PLANE)
    o, d = camera.rays(size)
    assert np.count_nonzero(np.isfinite(expected) != cell.mask) <= 2
    steep = cell.mask & np.isfinite(expected) & (-(cell.normal * d).sum(-1) > 0.1)
    assert steep.sum() > 5
    typical = float(np.sqrt(np.min(c.support) * np.max(c.support)))
    far = np.abs(cell.distance[steep] - expected[steep]) > 1e-4 * typical + 1e-6 * expected[steep]
    assert np.count_nonzero(far) <= 1
    depth, normal, _ = scene.intersect(o.reshape(-1, 3), d.reshape(-1, 3))
    assert np.count_nonzero(np.isfinite(depth).reshape(30, 40) != cell.mask) <= 2
    np.testing.assert_allclose(normal.reshape(30, 40, 3)[steep], cell.normal[steep], atol=2e-2)


@pytest.mark.few_backends
@pytest.mark.parametrize("octree", ["sparse", "dense"])
@pytest.mark.parametrize("kind", ["none", "one", "NaN", "all NaN", "negative", "mixed", "coincident", "64-bit keys"])
def test_hard_particles_under_all_lights(backend, kind, octree):
    options = {"octree": octree, "threshold": 0.5}
    rng = np.random.default_rng(3)
    p = {
        "none": lambda: gb.Particles(np.zeros((0, 3)), support=0.5),
        "one": lambda: gb.Particles(np.zeros((1, 3)), support=0.8, reflection=0.2, refraction=0.7),
        "negative": lambda: busy(200, weight=rng.uniform(-1, 1, 200)),
        "mixed": lambda: busy(200, support=0.5 * 10 ** rng.uniform(-2.3, 0, 200)),
        "coincident": lambda: busy(200, positions=np.repeat(cloud(4, 1), 50, 0)),
    }.get(kind, lambda: busy(200))()
    if kind == "64-bit keys":
        options["key_bits"] = 64 if octree == "sparse" else 32
    if "NaN" in kind:
        p.positions[:: 1 if kind == "all NaN" else 3] = np.nan
    scene, size = gb.Scene(p, **options, **backend), (24, 18)
    frame = look(scene, size).refine(1)
    assert np.isfinite(frame.color).all()
    assert (frame.color >= 0).all()
    assert (frame.color < 20).all()
    assert np.isfinite(frame.normal).all()
    assert np.isfinite(frame.albedo).all()
    length = np.linalg.norm(frame.normal, axis=-1)
    np.testing.assert_allclose(length[frame.mask], 1, atol=1e-4)
    furnace = quiet(
        sky=ONE_SKY,
        ambient="sky",
        material=gb.Material(0.3, 0.5, color=1.0),
        ground=gb.Ground(-1.2, color=1.0, other=1.0),
    )
    color = look(scene, size, furnace).color
    np.testing.assert_allclose(color, 1, atol=1e-2)


def test_pick(backend):
    p = np.array([[-0.6, 0, 0], [0.6, 0, 0], [0, 0.9, 0]], np.float32)
    speed, name = np.array([1.0, 2, 3], np.float32), np.arange(6).reshape(3, 2)
    particles = gb.Particles(p, support=0.8, attributes={"speed": speed, "name": name})
    scene = gb.Scene(particles, **backend)
    other = ball((0, -0.8, 0.2), 0.8, **backend)
    camera, size = gb.Camera((0, 0, 5), (0, 0, 0), height=3.0), (61, 61)
    frame = gb.render([scene, other], camera, size, quiet(ground=gb.Ground(-4.0, (0, 0.2, 1))))

    def at(x, y):
        return frame.pick(round((x / 3 + 0.5) * 61 - 0.5), round((0.5 - y / 3) * 61 - 0.5))

    for k, (x, y, _) in enumerate(p):
        found = at(x, y)
        assert (found.layer, found.particle) == (0, k)
        assert found.attributes["speed"] == speed[k]
        np.testing.assert_array_equal(found.attributes["name"], name[k])
        radius = 0.8 * np.sqrt(1 - np.sqrt(0.6))
        np.testing.assert_allclose(found.position, (x, y, radius), atol=0.06)
        assert found.distance == pytest.approx(5 - found.position[2], abs=1e-4)
        assert found.normal[2] > 0.9
    assert (at(0, -0.8).layer, at(0, -0.8).particle) == (1, 0)
    assert at(1.4, 1.4) is None  # the ground
    none = gb.render(scene, camera, size)
    assert none.pick(0, 0) is None
    for column, row, wrong in ((61, 0, "column"), (0, 61, "row"), (-1, 0, "column")):
        refuses(wrong, frame.pick, column, row)


def test_picking_on_a_cut_face(backend):
    p = cloud(500, 66)
    scene = gb.Scene(gb.Particles(p, support=0.5), **backend)
    frame = gb.render(scene, gb.Camera((0, 0, 5), (0, 0, 0), fov=25), (21, 21), quiet(), [gb.ClipPlane((0, 0, 1), 0.1)])
    for column, row in ((10, 10), (5, 8), (14, 12)):
        found = frame.pick(column, row)
        assert found.position[2] == pytest.approx(0.1, abs=1e-5)
        assert found.particle == np.argmin(np.linalg.norm(p - found.position, axis=1))


# Cells are made where rays can come: behind full ones only for light, cuts and eyes inside.

WIDE = (96, 72)
OUTSIDE = gb.Camera((70.0, 55.0, 90.0), (0.0, 0.0, 0.0))
SHADOWS = {"shadows": True}
WATER = gb.Material(transmission=1.0, index=1.33)


@pytest.fixture(scope="module")
def bubble():
    """A block with a bubble that no ray from outside can reach; spacing 1."""
    at = np.arange(-18.0, 19.0)
    points = np.stack(np.meshgrid(at, at, at), axis=-1).reshape(-1, 3)
    return points[np.linalg.norm(points, axis=1) > 7].astype(np.float32)


def scene_of(points, backend):
    return gb.Scene(points, support=2.0, threshold=0.6, **backend)


OUT_OF_REACH = {
    "light goes inside": (OUTSIDE, {"settings": {"material": WATER, "bounces": 4}}),
    "a cut opens it": (OUTSIDE, {"settings": SHADOWS, "clips": [gb.ClipPlane((1, 0, 0), 0.0)]}),
    "the eye is inside": (gb.Camera((0, 0, 0), (1, 0.3, 0.2)), {"settings": SHADOWS}),
    "from a plane": (gb.Camera((0, 0, 60), (0, 0, 0), (0, 1, 0), height=50), {"settings": SHADOWS}),
}


@pytest.mark.few_backends
@pytest.mark.parametrize("case", OUT_OF_REACH)
def test_what_was_out_of_reach_is_made_when_it_is_not(bubble, backend, case):
    camera, how = OUT_OF_REACH[case]
    fresh = gb.render(scene_of(bubble, backend), camera, WIDE, **how)
    scene = scene_of(bubble, backend)
    before = gb.render(scene, OUTSIDE, WIDE, settings=SHADOWS)
    after = gb.render(scene, camera, WIDE, **how)
    assert before.mask.any()
    assert after.mask.any()
    if case == "the eye is inside":  # it sees the bubble's wall
        assert np.abs(after.distance - 6.7).max() < 1.0
    np.testing.assert_array_equal(after.image, fresh.image)
    np.testing.assert_array_equal(after.distance, fresh.distance)
    again = gb.render(scene, OUTSIDE, WIDE, settings=SHADOWS)
    np.testing.assert_array_equal(again.image, before.image)
