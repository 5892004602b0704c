"""Spheres and lines in images: first hits by float64 closed forms, light as on meshes."""

import functools

import globule as gb
import numpy as np
import pytest
from cli_helpers import SMALL, cube, refused, refuses, run_json
from globule.render.fit import corners_of
from light import CAMERA, CENTER, RADIUS, direction_sky, glass, glass_ball, meet_ball, quiet, rays
from test_surface import ball, smooth

SIZE = (64, 48)


def sphere_interval(o, d, c, r):
    """Where rays are inside of a ball, (M, 2) float64; NaN where they miss."""
    b = np.einsum("mi,mi->m", c - o, d)
    off = c - o - b[:, None] * d
    half = np.sqrt(np.where((s := r * r - np.einsum("mi,mi->m", off, off)) >= 0, s, np.nan))
    return np.stack([b - half, b + half], 1)


def capsule_interval(o, d, a, b, r):
    """The same for all within r of a segment: by the quadric of the cylinder, and the two balls."""
    parts = [sphere_interval(o, d, a, r), sphere_interval(o, d, b, r)]
    axis = b - a
    if (length := np.linalg.norm(axis)) > 0:
        u = axis / length
        across = np.eye(3) - np.outer(u, u)
        p, e = (o - a) @ across, d @ across
        A, B, C = (e * e).sum(1), (p * e).sum(1), (p * p).sum(1) - r * r
        with np.errstate(all="ignore"):
            root = np.sqrt(B * B - A * C)
            side = np.stack([(-B - root) / A, (-B + root) / A], 1)
            ends = np.sort(np.stack([-(o - a) @ u, length - (o - a) @ u], 1) / (d @ u)[:, None], 1)
        low, high = np.maximum(side[:, 0], ends[:, 0]), np.minimum(side[:, 1], ends[:, 1])
        parts.append(np.where((low <= high)[:, None], np.stack([low, high], 1), np.nan))
    with np.errstate(all="ignore"):
        both = np.stack(parts)
        return np.stack([np.fmin.reduce(both[:, :, 0]), np.fmax.reduce(both[:, :, 1])], 1)


def oracle(shape, o, d):
    """First hits in float64: distance, index, and how near the ray passes to a silhouette."""
    places = np.asarray(shape.vertices, float)
    radius = np.broadcast_to(shape.radius, len(places)).astype(float)
    best, index = np.full(len(o), np.inf), np.full(len(o), -1)
    for k, (i, j) in enumerate(shape.faces):
        t = capsule_interval(o, d, places[i], places[j], radius[i])
        first = np.where(t[:, 0] >= 0, t[:, 0], np.where(t[:, 1] >= 0, t[:, 1], np.inf))
        nearer = first < best
        best[nearer], index[nearer] = first[nearer], k
    return best, index


def some_rays(n, seed=1, reach=3.0):
    rng = np.random.default_rng(seed)
    o = rng.normal(size=(n, 3))
    o = 4 * reach * o / np.linalg.norm(o, axis=1, keepdims=True)
    d = rng.uniform(-reach, reach, (n, 3)) - o
    o = o.astype("f4")
    return o, (d / np.linalg.norm(d, axis=1, keepdims=True)).astype("f4")


def shapes(name: str, **options):
    rng = np.random.default_rng(5)
    points = rng.uniform(-2, 2, (400, 3)).astype("f4")
    if name == "spheres":
        return gb.Spheres(points, rng.uniform(0.02, 0.3, 400).astype("f4"), **options)
    if name == "equal spheres":
        return gb.Spheres(points, 0.15, **options)
    if name == "one line":
        return gb.Lines(np.cumsum(rng.normal(0, 0.3, (200, 3)), 0).astype("f4"), 0.08, **options)
    return gb.Lines([points[k : k + 1 + k % 7] for k in range(0, 360, 9)], 0.05, **options)


@functools.cache
def truth(name: str):
    """Some rays, and what they hit first."""
    o, d = some_rays(12_000)
    d64 = d.astype(float)
    d64 /= np.linalg.norm(d64, axis=1, keepdims=True)
    return o, d, *oracle(shapes(name, device="cpu"), o.astype(float), d64)


@pytest.mark.few_backends
@pytest.mark.parametrize("name", ["spheres", "equal spheres", "one line", "lines"])
def test_first_hits_are_those_of_closed_forms(backend, name):
    shape = shapes(name, **backend)
    o, d, want, index = truth(name)
    found = shape.intersect(o, d)
    hit = np.isfinite(want)
    assert 0.05 < hit.mean() < 0.99
    # The rays are unit vectors in float32: they differ by 1e-7 of 12 units from the reference's.
    wrong = (np.isfinite(found.distance) != hit) | ((found.face != index) & hit)
    assert wrong.mean() < 2e-4  # grazing, or two at one distance
    good = hit & ~wrong
    assert np.median(np.abs(found.distance - want)[good]) < 1e-6
    assert np.quantile(np.abs(found.distance - want)[good], 0.999) < 2e-3
    assert (found.face[~hit & ~wrong] == -1).all()
    at = o[good] + found.distance[good, None] * d[good]
    i, j = shape.faces[index[good]].T
    a, axis = shape.vertices[i], shape.vertices[j] - shape.vertices[i]
    square = np.maximum((axis * axis).sum(1), 1e-30)
    along = np.clip(((at - a) * axis).sum(1) / square, 0, 1)
    normal = at - a - along[:, None] * axis
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    assert np.abs(found.normal[good] - normal).max() < 1e-3


def test_small_spheres_far_away(backend):
    """A ball of 1 mm at a kilometer is met to within float32's rounding of the distance."""
    shape = gb.Spheres([[1000.0, 0, 0]], 1e-3, **backend)
    up = np.linspace(-1.5e-3, 1.5e-3, 32).astype("f4")
    o = np.c_[np.zeros(32), up, np.zeros(32)].astype("f4")
    found = shape.intersect(o, np.tile(np.array([1, 0, 0], "f4"), (32, 1)))
    assert (np.isfinite(found.distance) == (np.abs(up) < 1e-3)).all()


def test_inside_and_bounds():
    shape = gb.Lines([[[0, 0, 0], [2, 0, 0]], [[0, 0, 5]]], 0.5, device="cpu")
    assert len(shape) == 2
    assert np.allclose(shape.bounds(), [[-0.5, -0.5, -0.5], [2.5, 0.5, 5.5]])
    points = [[1, 0.4, 0], [1, 0.6, 0], [2.4, 0, 0], [2.6, 0, 0], [0, 0, 4.6], [0, 0, 4.4]]
    assert shape.contains(points).tolist() == [True, False, True, False, True, False]
    shape.pose = [[0, -1, 0, 10], [1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]
    assert np.allclose(shape.bounds(), [[9.5, -0.5, -0.5], [10.5, 2.5, 5.5]])
    assert shape.contains([[10, 1, 0], [1, 0, 0]]).tolist() == [True, False]


def test_beside_particles_the_nearer_surface_shows(backend):
    fluid = smooth(ball(1000), **backend)
    spheres = gb.Spheres([[0, 0, 6.5], [0, 0, -6.5], [12, 0, 0]], [2.0, 2.0, 3.0])
    frame = gb.render([fluid, spheres], gb.Camera((3, 2, 40), (0, 0, 0)), SIZE)
    alone = gb.render(fluid, gb.Camera((3, 2, 40), (0, 0, 0)), SIZE).distance
    o, d = (a.reshape(-1, 3) for a in gb.Camera((3, 2, 40), (0, 0, 0)).rays(SIZE))
    balls, index = oracle(spheres, o.astype(float), d.astype(float))
    want = np.minimum(alone.ravel(), balls)
    both = np.isfinite(frame.distance.ravel()) & np.isfinite(want)
    assert (np.isfinite(want) == np.isfinite(frame.distance.ravel())).mean() > 0.999
    assert np.quantile(np.abs(frame.distance.ravel() - want)[both], 0.99) < 1e-3
    row, column = (int(v) for v in np.argwhere((balls < alone.ravel()).reshape(48, 64))[20])
    seen = frame.pick(column, row)
    assert seen.layer == 1
    assert seen.face == index[row * 64 + column]


def test_a_sphere_casts_the_shadow_of_a_disc(backend):
    """Parallel light from above: on the ground a disc of the sphere's radius is dark."""
    spheres = gb.Spheres([[0, 2, 0]], 1.0, **backend)
    settings = gb.RenderSettings(
        lights=[gb.DirectionalLight((0, 1, 0), (1, 1, 1))], ambient=0.0, shadows=True,
        ground=gb.Ground(0.0, color=0.8), edge_samples=0,
    )  # fmt: skip
    camera = gb.Camera((0, 1.0, 30), (0, 0.5, 0), fov=10)
    frame = gb.render([spheres], camera, (160, 120), settings=settings)
    ground = frame._layer >= 4
    r = np.hypot(frame.position[..., 0], frame.position[..., 2])
    light = frame.color[..., 0]
    assert (light[ground & (r < 0.97)] == 0).all()
    assert (light[ground & (r > 1.03)] > 0.5).all()


def test_a_glass_sphere_bends_light_as_snell_says(backend):
    sky = direction_sky()
    sphere = gb.Spheres([CENTER], RADIUS, **backend)
    o, d = rays(CAMERA, SIZE)
    clear = np.abs(meet_ball(o, d)[2][..., 0] - RADIUS) > 0.01 * RADIUS
    for index, bounces in ((1.0, 8), (1.5, 5)):
        look = quiet(sky=sky, material=glass(index), bounces=bounces)
        frame = gb.render(sphere, CAMERA, SIZE, look)
        error = np.abs(frame.color - glass_ball(o, d, index, bounces)).max(-1)[clear]
        assert error.max() < 0.01


@pytest.mark.parametrize("name", ["spheres", "lines"])
def test_a_cut_sphere_has_a_flat_face(backend, name):
    shape = gb.Spheres([[0, 0, 0]], 1.0, **backend)
    if name == "lines":
        shape = gb.Lines([[-1, 0, 0], [1, 0, 0]], 1.0, **backend)
    frame = gb.render(shape, gb.Camera((1, 2, 9), (0, 0, 0)), SIZE, clips=[gb.ClipPlane((0, 0, 1), 0.25)])
    at, hit = frame.position[frame.mask], frame.mask
    assert at[:, 2].max() < 0.25 + 1e-5
    face = np.abs(at[:, 2] - 0.25) < 1e-5
    assert face.sum() > 100
    assert np.abs(frame.normal[hit][face] - (0, 0, 1)).max() < 1e-6


def test_colors(backend):
    spheres = gb.Spheres([[-2, 0, 0], [2, 0, 0]], 1.0, [[1, 0, 0], [0, 0, 1]], **backend)
    albedo = gb.render(spheres, gb.Camera((0, 0, 20), (0, 0, 0)), SIZE).albedo
    assert np.allclose(albedo[24, 22], (1, 0, 0))
    assert np.allclose(albedo[24, 41], (0, 0, 1))
    line = gb.Lines([[-2, 0, 0], [2, 0, 0]], 0.5, [[1, 0, 0], [0, 0, 1]], **backend)
    frame = gb.render(line, gb.Camera((0, 0, 20), (0, 0, 0)), SIZE)
    share = np.clip((frame.position[..., 0] + 2) / 4, 0, 1)[frame.mask]
    assert np.abs(frame.albedo[frame.mask][:, 2] - share).max() < 1e-5


def test_a_fitted_camera_shows_all(backend):
    spheres = gb.Spheres([[0, 0, 0], [4, 0, 0]], [1.0, 2.0], **backend)
    assert np.allclose(np.ptp(corners_of(spheres), axis=0), (7, 4, 4))
    mask = gb.render(spheres, SIZE).mask
    border = [mask[0], mask[-1], mask[:, 0], mask[:, -1]]
    assert mask.any()
    assert not any(edge.any() for edge in border)


def test_new_places(backend):
    spheres = gb.Spheres([[0, 0, 0]], 1.0, **backend)
    o, d = np.array([[0, 0, 9]], "f4"), np.array([[0, 0, -1]], "f4")
    assert spheres.intersect(o, d).distance[0] == pytest.approx(8)
    spheres.update([[0, 0, 2]])
    assert spheres.intersect(o, d).distance[0] == pytest.approx(6)
    refuses("vertices: expected 1", spheres.update, np.zeros((2, 3)))


def test_mistakes_are_named():
    for make, message in (
        (lambda: gb.Spheres([[0, 0, 0]], 0.0), "radius: expected"),
        (lambda: gb.Spheres(np.zeros((3, 3)), [1, 2]), "radius: expected 3 numbers, got 2"),
        (lambda: gb.Spheres(np.zeros((2, 3)), [1, -2]), r"got -2 \(sphere 1\)"),
        (lambda: gb.Spheres(np.zeros((2, 3)), 1.0, [[1, 0, 0]]), "color"),
        (lambda: gb.Lines(np.zeros((2, 3)), [1, 2]), "radius: expected one number"),
        (lambda: gb.Lines(np.zeros((2, 2)), 1.0), "points"),
        (lambda: gb.Spheres([[0, np.nan, 0]], 1.0), "finite"),
    ):
        refuses(message, make)


def test_nothing_is_drawn_of_nothing(backend):
    nothing = gb.Spheres(np.empty((0, 3)), 1.0, **backend)
    assert not gb.render(nothing, gb.Camera((0, 0, 5), (0, 0, 0)), SIZE).mask.any()
    assert len(gb.Lines([], 1.0)) == 0


def test_on_the_command_line(folder, capsys):
    gb.write("fluid.npz", cube())
    gb.write("tracers.npz", gb.Particles(np.array([[0.4, 0.4, 1.6], [0.4, 0.4, 2.6]])))
    gb.write("path.npz", gb.Particles(np.array([[0, 0, 1.5], [1, 0, 1.5], [1, 1, 1.5]])))
    words = ["--spheres", "tracers.npz:0.2", "--lines", "path.npz:0.05", "--mesh-color", "0.8,0,0"]
    view = ["-o", "a.png", "--eye", "0.4,0.4,9", "--look-at", "0.4,0.4,0", "--pick", "20,15"]
    facts = run_json(capsys, "render", "fluid.npz", *words, *view, *SMALL)
    assert {"file": "tracers.npz", "face": 1}.items() <= facts["picked"].items()
    assert facts["picked"]["distance"] == pytest.approx(9 - 2.8, abs=0.05)
    run_json(capsys, "render", "fluid.npz", "--spheres", "tracers.npz", "--lines", "path.npz",
             "-o", "b.png", *SMALL)  # fmt: skip
    start = ["render", "fluid.npz", "-o", "c.png"]
    assert "nothing.npz" in refused(capsys, *start, "--lines", "nothing.npz")
