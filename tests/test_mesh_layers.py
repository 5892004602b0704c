"""Triangle meshes in images: first hits by brute force, light and cuts by closed forms."""

import globule as gb
import numpy as np
import pytest
from cli_helpers import at_edge
from globule.render.fit import corners_of
from light import CENTER, MIRROR, block, direction_sky, glass, quiet, rays, sky_of, unit
from oracle import mesh_first_hit
from quick import every
from test_light_cuts import CAMERAS, CUTS, changes, normal_of

SIZE = (48, 40)
BOX = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], np.float32)
BOX_FACES = np.array(
    [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1],
     [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]]
)  # fmt: skip
SUN = gb.DirectionalLight((0, 1, 0), (1, 1, 1))


def box(low, high, **options) -> gb.Mesh:
    low, high = np.asarray(low, np.float32), np.asarray(high, np.float32)
    return gb.Mesh(low + BOX * (high - low), BOX_FACES, **options)


def sphere(n: int, radius=1.0, center=(0.0, 0.0, 0.0)) -> tuple[np.ndarray, np.ndarray]:
    theta, phi = np.linspace(0, np.pi, n + 1)[1:-1], np.linspace(0, 2 * np.pi, 2 * n + 1)[:-1]
    ring = np.stack([np.cos(phi), np.sin(phi)], -1)
    points = [[[0, 0, 1]], *(np.c_[np.sin(t) * ring, np.full(2 * n, np.cos(t))] for t in theta)]
    vertices = np.concatenate([*points, [[0, 0, -1]]]) * radius + center
    k, j = np.arange(2 * n), (np.arange(2 * n) + 1) % (2 * n)
    faces = [np.c_[np.zeros(2 * n), 1 + k, 1 + j]]
    for r in range(n - 2):
        a, b = 1 + 2 * n * r, 1 + 2 * n * (r + 1)
        faces += [np.c_[a + k, b + k, b + j], np.c_[a + k, b + j, a + j]]
    last = 1 + 2 * n * (n - 2)
    faces += [np.c_[last + k, np.full(2 * n, len(vertices) - 1), last + j]]
    return vertices.astype(np.float32), np.concatenate(faces).astype(np.int64)


def random_rays(n: int, seed: int, spread=2.0, at=0.9) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    o = rng.uniform(-spread, spread, (n, 3)).astype(np.float32)
    return o, unit(rng.uniform(-at, at, (n, 3)) - o).astype(np.float32)


# All boxes hold the middle, and the tree is deep.
NESTED = np.random.default_rng(8).normal(size=(1200, 3, 3)) * 0.97 ** np.arange(1200)[:, None, None]
SOUP = np.random.default_rng(5).uniform(-1, 1, (400, 1, 3)) + np.random.default_rng(6).normal(
    size=(400, 3, 3)
) * np.random.default_rng(7).choice([1e-3, 0.1, 0.7], (400, 1, 1))
MESHES = {
    "ball": sphere(16),
    "soup": (SOUP.reshape(-1, 3).astype(np.float32), np.arange(1200).reshape(-1, 3)),
    "box": (BOX * 1.4 - 0.7, BOX_FACES),
    "nested": (NESTED.reshape(-1, 3).astype(np.float32), np.arange(3600).reshape(-1, 3)),
    "one": (np.float32([[-1, -1, 0], [1, -1, 0], [0, 1, 0.3]]), np.array([[0, 1, 2]])),
    "all at one place": (np.float32([[-1, -1, 0], [1, -1, 0], [0, 1, 0.3]]), np.array([[0, 1, 2]] * 300)),
}


@pytest.mark.few_backends
@pytest.mark.parametrize("name", MESHES)
def test_first_hits_are_those_of_brute_force(backend, name):
    vertices, faces = MESHES[name]
    mesh = gb.Mesh(vertices, faces, **backend)
    o, d = random_rays(30_000, 1)
    found = mesh.intersect(o, d)
    t, face, edge = mesh_first_hit(vertices, mesh.faces, o, d)
    differs = np.isfinite(t) != np.isfinite(found.distance)
    assert (edge[differs] < 1e-5).all()
    assert differs.sum() <= 3
    hit = np.isfinite(t) & ~differs
    assert hit.sum() > 2000
    same, cosine = found.face[hit] == face[hit], np.abs(np.sum(found.normal * d, axis=1))[hit]
    error = np.abs(found.distance[hit] - t[hit]) * np.maximum(cosine, 1e-3)
    np.testing.assert_array_less(error[same], 2e-6)
    assert (edge[hit][~same] < 1e-4).all()
    assert same.mean() > 0.999
    assert (found.face[~np.isfinite(found.distance)] == -1).all()


def test_no_ray_slips_between_triangles_and_normals_are_smooth(backend):
    vertices, faces = sphere(12)
    rng = np.random.default_rng(3)
    u = rng.random((len(faces), 1))
    targets = np.concatenate([vertices[faces[:, 0]], vertices[faces[:, 0]] * u + vertices[faces[:, 1]] * (1 - u)])
    targets = np.tile(targets, (10, 1))
    for shift in (0.0, 1000.0):  # where positions are rounded to 6e-5
        o = rng.uniform(-0.4, 0.4, targets.shape)
        mesh = gb.Mesh(vertices + np.float32(shift), faces, **backend)
        at = (o + shift).astype(np.float32)
        d = unit(targets.astype(np.float32) + shift - at).astype(np.float32)
        assert np.isfinite(mesh.intersect(at, d).distance).all()
    vertices, faces = sphere(24)
    camera, off = gb.Camera((2, 1.5, 3), (0, 0, 0), fov=30), []
    for options in ({}, {"smooth": 0}):
        frame = gb.render(gb.Mesh(vertices, faces, **options, **backend), camera, SIZE)
        off.append(np.linalg.norm(frame.normal[frame.mask] - unit(frame.position[frame.mask]), axis=1).mean())
    assert off[0] < 0.01 < 0.03 < off[1]


def test_a_pose_and_new_vertices_move_the_mesh(backend):
    vertices, faces = MESHES["soup"]
    angle = 0.7
    turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = turn, (0.3, -0.2, 0.5)
    mesh = gb.Mesh(vertices, faces, **backend)
    o, d = random_rays(20_000, 5)
    mesh.intersect(o, d)
    mesh.pose = pose
    moved = gb.Mesh(vertices @ turn.T + pose[:3, 3], faces, **backend)
    a, b = mesh.intersect(o, d), moved.intersect(o, d)
    hit, same = np.isfinite(a.distance) & np.isfinite(b.distance), a.face == b.face
    assert same.mean() > 0.999
    np.testing.assert_allclose(a.distance[hit & same], b.distance[hit & same], rtol=1e-3, atol=1e-6)
    np.testing.assert_allclose(a.normal[hit & same], b.normal[hit & same], atol=1e-4)
    np.testing.assert_allclose(mesh.bounds(), moved.bounds(), atol=1e-5)
    mesh = box((0, 0, 0), (1, 1, 1), **backend)
    o, d = np.float32([[0.3, 0.4, 5]] * 3), np.float32([[0, 0, -1], [0, 0, 0], [np.nan, 0, 1]])
    np.testing.assert_array_equal(mesh.intersect(o, d).distance, [4, np.inf, np.inf])
    mesh.update(mesh.vertices * 2)
    np.testing.assert_array_equal(mesh.intersect(o, d).distance, [3, np.inf, np.inf])
    assert mesh.contains([[1.5, 1.5, 1.5], [2.5, 1, 1]]).tolist() == [True, False]
    nothing = gb.Mesh(np.zeros((0, 3)), np.zeros((0, 3), int), **backend)
    assert not np.isfinite(nothing.intersect(o, d).distance).any()
    assert not gb.render(nothing, gb.Camera((0, 0, 3), (0, 0, 0)), (8, 8)).mask.any()


def test_closed_meshes_are_solids():
    vertices, faces = sphere(6)
    inside_out = gb.Mesh(vertices, faces[:, ::-1])
    assert inside_out.contains([[0, 0, 0]]).all()
    flipped = faces.copy()
    flipped[0] = flipped[0, ::-1]
    corners = vertices[faces].reshape(-1, 3)  # an STL file has each vertex once a triangle
    for mesh, solid in (
        (gb.Mesh(vertices, faces), True), (inside_out, True), (gb.Mesh(vertices, faces[1:]), False),
        (gb.Mesh(vertices, flipped), False),
        (gb.Mesh(corners, np.arange(len(corners)).reshape(-1, 3)), True),
        (gb.Mesh(vertices, faces, solid=False), False),
    ):  # fmt: skip
        assert mesh.solid == solid


TRIANGLE = [[0, 1, 2]]


@pytest.mark.parametrize(("call", "message"), [
    (lambda: gb.Mesh(np.zeros((3, 2)), TRIANGLE), "vertices: expected shape (n, 3)"),
    (lambda: gb.Mesh(np.full((3, 3), np.nan), TRIANGLE), "vertices: expected finite coordinates"),
    (lambda: gb.Mesh(np.zeros((3, 3)), [[0, 1, 3]]), "faces: expected indices from 0 to 2, got 0 to 3"),
    (lambda: gb.Mesh(np.zeros((3, 3)), [[0.0, 1, 2]]), "faces: expected integers of shape (M, 3)"),
    (lambda: gb.Mesh(np.zeros((3, 3)), None), "vertices: expected (N, 3) numbers with faces"),
    (lambda: gb.Mesh(7), "vertices: expected (N, 3) numbers with faces"),
    (lambda: gb.Mesh(BOX, BOX_FACES, color=(2, 0, 0)), "color: expected linear RGB from 0 to 1"),
    (lambda: gb.Mesh(BOX, BOX_FACES, face_color=np.zeros((3, 3))), "face_color: expected shape (12, 3)"),
    (lambda: gb.Mesh(BOX, BOX_FACES, color=(1, 1, 1), face_color=BOX[:1]), "face_color: expected no color"),
    (lambda: gb.Mesh(BOX, BOX_FACES, pose=np.eye(3)), "pose: expected a (4, 4) matrix"),
    (lambda: gb.Mesh(BOX, BOX_FACES, pose=np.diag([2, 2, 2, 1])), "pose: expected a rotation and a translation"),
    (lambda: gb.Mesh(BOX, BOX_FACES, solid=1), "solid: expected True, False or None"),
    (lambda: gb.Mesh(BOX, BOX_FACES[1:], solid=True), "solid: expected a closed mesh"),
    (lambda: gb.Mesh(BOX, BOX_FACES).update(np.zeros((3, 3))), "vertices: expected 8, got 3"),
    (lambda: gb.render(gb.Mesh(BOX, BOX_FACES), color_by="speed"), "color_by: expected one of x, y, z, got speed"),
    (lambda: gb.render(gb.Mesh(BOX, BOX_FACES), (8, 8)).attribute(np.zeros(8)),
     "attribute: expected a layer of particles"),
])  # fmt: skip
def test_mistakes_are_named(call, message):
    with pytest.raises((TypeError, ValueError)) as error:
        call()
    assert message in str(error.value)


def test_beside_particles_the_nearer_surface_shows(backend):
    scene = block(**backend)
    plain = gb.render(scene, CAMERA_FAR, SIZE, quiet(ambient=1.0))
    wall = box((-3, -3, 2), (0, 9, 9), color=(1, 0.5, 0.25))
    both = gb.render([scene, wall], CAMERA_FAR, SIZE, quiet(ambient=1.0))
    o, d = rays(CAMERA_FAR, SIZE)
    found = wall.intersect(*(np.broadcast_to(x, d.shape).reshape(-1, 3).astype("f4") for x in (o, d)))
    t = found.distance.reshape(SIZE[::-1])
    nearest = np.minimum(t, plain.distance)
    hit = np.isfinite(nearest)
    np.testing.assert_array_equal(both.mask, hit)
    np.testing.assert_allclose(both.distance[hit], nearest[hit], atol=1e-4)
    mesh = t < plain.distance - 1e-3
    assert mesh.sum() > 100
    assert (hit & ~mesh).sum() > 100
    assert np.abs(both.color[mesh] - (1, 0.5, 0.25)).max() < 1e-6
    row, column = np.argwhere(mesh)[0]
    seen = both.pick(column, row)
    assert (seen.layer, seen.particle, seen.face) == (1, None, found.face.reshape(SIZE[::-1])[row, column])
    row, column = np.argwhere(hit & (t > plain.distance + 1e-3))[0]
    assert both.pick(column, row).layer == 0
    first = gb.render([wall, scene], CAMERA_FAR, SIZE, quiet(ambient=1.0))
    np.testing.assert_array_equal(first.color[mesh], both.color[mesh])


CAMERA_FAR = gb.Camera((9, 12, 24), (0, 0, 0), fov=40)


def test_colors_of_vertices_and_faces(backend):
    corners = np.float32([[0, 0, 0], [1, 0, 0], [0, 1, 0]])
    camera, size = gb.Camera((0.3, 0.3, 2), (0.3, 0.3, 0), height=0.5), (16, 16)
    mesh = gb.Mesh(corners, [[0, 1, 2]], color=np.eye(3), **backend)
    frame = gb.render(mesh, camera, size, quiet(ambient=1.0))
    p = frame.position[frame.mask]
    expected = np.c_[1 - p[:, 0] - p[:, 1], p[:, 0], p[:, 1]]
    np.testing.assert_allclose(frame.color[frame.mask], expected, atol=1e-5)
    two = gb.Mesh(
        np.concatenate([corners, corners - (0, 0, 1)]), [[3, 4, 5], [0, 1, 2]],
        face_color=[[1, 0, 0], [0, 1, 0]], **backend,
    )  # fmt: skip
    assert (gb.render(two, camera, size, quiet(ambient=1.0)).color[frame.mask] == (0, 1, 0)).all()


def test_shadows_fall_across_both_kinds(backend):
    camera, size = gb.Camera((0, 30, 0.001), (0, 0, 0), height=12), (48, 48)
    settings, scene = quiet(lights=[SUN], shadows=True), block(**backend)
    plate = box((-2, 8, -2), (1, 8.5, 2))

    def draw(*layers, camera=camera):
        return gb.render(list(layers), camera, size, settings)

    lit, dark = draw(scene), draw(scene, plate)
    shaded = draw(scene, gb.Layer(plate, glass(1.0)))
    flat = np.abs(lit.position[..., [0, 2]]).max(-1) < 3.5
    under = flat & (np.abs(lit.position[..., 2]) < 1.9)
    under &= (lit.position[..., 0] > -1.9) & (lit.position[..., 0] < 0.9)
    np.testing.assert_allclose(shaded.color[flat], lit.color[flat], atol=1e-4)  # clear: no shadow
    above = draw(scene, gb.Layer(plate, glass(1.0, transmission=0.25)))
    own = 0.62 * 0.75 * (1 + 1 / 16)  # of the plate's top, and of its bottom from inside
    np.testing.assert_allclose(above.color[under], own + lit.color[under] / 256, atol=1e-4)
    assert (dark._layer[under] == 1).all()
    floor = box((-9, -7, -9), (9, -6, 9), color=(1, 1, 1))
    low = draw(floor, scene, camera=gb.Camera((25, 2, 0), (0, -6, 0), fov=40))
    p, seen = low.position, (low._layer == 0) & (low.normal[..., 1] > 0.9)
    beneath = seen & (np.abs(p[..., [0, 2]]).max(-1) < 4)
    beside = seen & (np.abs(p[..., [0, 2]]).max(-1) > 6.5)
    assert beneath.sum() > 5
    assert beside.sum() > 20
    assert (low.color[beneath] == 0).all()
    np.testing.assert_allclose(low.color[beside], 1.0, atol=1e-5)


SKY_BELOW = gb.Sky(0.0, 0.0, 1.0, up=(0, 0, 1))  # seen straight down: 1; straight up: 0
DOWN, ONE = gb.Camera((0.01, 0.02, 9), (0.01, 0.02, 0), up=(0, 1, 0), height=0.1), (1, 1)


def through(layers, bounces, **changes) -> float:
    settings = quiet(sky=SKY_BELOW, bounces=bounces, **changes)
    return float(gb.render(layers, DOWN, ONE, settings).color[0, 0, 0])


def kept(a: float, b: float) -> float:
    """What a boundary between two indices lets through at right angles."""
    return 1 - ((a - b) / (a + b)) ** 2


def test_slabs_of_glass_and_a_mirror(backend):
    slab = box((-2, -2, 0), (2, 2, 0.5), **backend)
    np.testing.assert_allclose(through(gb.Layer(slab, glass(1.5)), 2), kept(1, 1.5) ** 2, atol=2e-3)
    tinted = through(gb.Layer(slab, glass(1.0, absorption=(0.7, 0, 0))), 2)
    np.testing.assert_allclose(tinted, np.exp(-0.35), rtol=1e-4)
    filtered = gb.Mesh(slab.vertices, slab.faces, color=(0.3, 1, 1), **backend)
    once = through(gb.Layer(filtered, glass(1.0, absorption=None)), 2)
    np.testing.assert_allclose(once, 0.3, rtol=1e-4)
    # Solids that touch, in any order, and one around the camera.
    lower = gb.Layer(box((-2, -2, 0), (2, 2, 0.5), **backend), glass(1.0, absorption=0.4))
    upper = gb.Layer(box((-2, -2, 0.5), (2, 2, 1.5), **backend), glass(1.0, absorption=0.2))
    for layers in ([lower, upper], [upper, lower]):
        np.testing.assert_allclose(through(layers, 4), np.exp(-0.4), rtol=1e-4)
    inside = gb.Layer(box((-2, -2, -1), (2, 2, 20), **backend), glass(1.0, absorption=0.1))
    np.testing.assert_allclose(through(inside, 2), np.exp(-1.0), rtol=1e-4)
    mirror = gb.Layer(box((-1, -1, -1), (1, 1, 1), **backend), MIRROR)
    camera = gb.Camera((3, 4, 5), (0, 0, 0), fov=40)
    frame = gb.render(mirror, camera, SIZE, quiet(sky=direction_sky()))
    _, d = rays(camera, SIZE)
    n = frame.normal
    expected = sky_of(d - 2 * np.sum(d * n, -1, keepdims=True) * n)
    np.testing.assert_allclose(frame.color[frame.mask], expected[frame.mask], atol=0.02)


def test_a_slab_shifts_what_lies_behind_and_a_sheet_is_a_thin_pane(backend):
    """Snell: a slanted ray goes on parallel, a sine's difference aside."""
    index, thick, tilt = 1.5, 0.5, 0.6
    slab = gb.Layer(box((-4, -4, 0), (4, 4, thick), **backend), glass(index, reflection=0.0))
    direction = np.array([np.sin(tilt), 0, -np.cos(tilt)])
    camera = gb.Camera(-6 * direction, (0, 0, 0), up=(0, 1, 0), height=1.0)
    ground = gb.Ground(-1.0, (0, 0, 1), (1, 1, 1), (0, 0, 0), 0.2)
    settings, size = quiet(ground=ground, ambient=1.0), (64, 16)
    seen = gb.render(slab, camera, size, settings).color[..., 0]
    inner = np.arcsin(np.sin(tilt) / index)
    shift = thick * np.sin(tilt - inner) / np.cos(inner)  # across the ray
    across = np.array([np.cos(tilt), 0, np.sin(tilt)])
    moved = gb.Camera(camera.eye - shift * across, -shift * across, up=(0, 1, 0), height=1.0)
    plain = gb.render(gb.Mesh(np.zeros((0, 3)), []), moved, size, settings).color[..., 0]
    other = gb.render(gb.Mesh(np.zeros((0, 3)), []), camera, size, settings).color[..., 0]
    bright = seen > 0.5
    assert (bright != (plain > 0.5)).mean() < 0.05 < (bright != (other > 0.5)).mean()
    pane = gb.Mesh(np.float32([[-3, -3, 0], [3, -3, 0], [0, 4, 0]]), [[0, 1, 2]], **backend)
    once = 1 - kept(1, 1.5)
    mirror = 2 * once / (1 + once)
    np.testing.assert_allclose(through(gb.Layer(pane, glass(1.5)), 1), 1 - mirror, rtol=1e-5)
    np.testing.assert_allclose(through(gb.Layer(pane, glass(1.0, transmission=0.4)), 1), 0.4, rtol=1e-5)
    shell = box((-2, -2, 0), (2, 2, 0.5), solid=False, **backend)
    expected = (1 - mirror) ** 2 * (1 + mirror**2)  # and what goes down after two reflections
    np.testing.assert_allclose(through(gb.Layer(shell, glass(1.5)), 3), expected, atol=1e-3)


def test_water_touches_glass_without_a_gap(backend):
    """Where the fluid reaches into the glass only the glass's border counts, once."""
    water = block(5, 1.9, **backend)  # its surface is flat enough in the middle
    top = gb.render(water, DOWN, ONE, quiet()).position[0, 0, 2]
    slab = box((-9, -9, 1.0), (9, 9, top + 1))
    layers = [gb.Layer(water, glass(1.33)), gb.Layer(slab, glass(1.5))]
    expected = kept(1, 1.5) * kept(1.5, 1.33) * kept(1.33, 1)
    np.testing.assert_allclose(through(layers, 3 + 1), expected, atol=2e-3)
    np.testing.assert_allclose(through(layers[::-1], 3 + 1), expected, atol=2e-3)
    layers = [gb.Layer(water, glass(1.0, absorption=0.5)), gb.Layer(slab, glass(1.0))]
    np.testing.assert_allclose(through(layers, 4), np.exp(-0.5 * (1.0 + top)), rtol=1e-3)
    same = [gb.Layer(water, glass(1.4)), gb.Layer(slab, glass(1.4))]
    np.testing.assert_allclose(through(same, 4), kept(1, 1.4) ** 2, atol=2e-3)
    whole = [gb.Layer(water, glass(1.33)), gb.Layer(box((-9, -9, -9), (9, 9, 9)), glass(1.5))]
    np.testing.assert_allclose(through(whole, 4), kept(1, 1.5) ** 2, atol=2e-3)


@pytest.mark.few_backends
@pytest.mark.parametrize("view", CAMERAS)
@pytest.mark.parametrize("name", every(3, CUTS))
def test_a_cut_solid(backend, name, view):
    """Depth, normal and which pixels are hit, against brute force over all intervals."""
    clips, camera = CUTS[name], CAMERAS[view]
    n, radius = 60, 0.6
    frame = gb.render(gb.Mesh(*sphere(n, radius, CENTER), **backend), camera, SIZE, quiet(), clips)
    o, d = rays(camera, SIZE)
    t, which, sure = changes(name, view, (radius, radius * (1 - 2 / n**2)), 1e-3)
    assert sure.mean() > 0.7
    np.testing.assert_array_equal(frame.mask[sure], np.isfinite(t)[sure])
    seen = sure & np.isfinite(t)
    np.testing.assert_allclose(frame.distance[seen], t[seen], atol=0.012)
    p = o + np.where(np.isfinite(t), t, 0)[..., None] * d
    for k in range(-1, len(clips)):
        here = seen & (which == k)
        expected = (p[here] - CENTER) / radius if k < 0 else normal_of(clips[k], p[here])
        np.testing.assert_allclose(frame.normal[here], expected, atol=0.06 if k < 0 else 2e-3)
        if k >= 0:
            np.testing.assert_allclose(frame.distance[here], t[here], atol=2e-5)


def test_a_cut_across_both_kinds_is_one_plane_and_light_goes_through(backend):
    scene = block(color=(1, 0, 0), **backend)
    outer = gb.Layer(box((-8, -8, -8), (8, -2, 8), color=(0, 1, 0)))
    clips, camera = [gb.ClipPlane((0, 0, 1), 0.5)], gb.Camera((1, 2, 30), (0, 0, 0), fov=30)
    frame = gb.render([scene, outer], camera, SIZE, quiet(ambient=1.0), clips)
    cut = np.abs(frame.position[..., 2] - 0.5) < 1e-4
    for layer, color in ((0, (1, 0, 0)), (1, (0, 1, 0))):
        here = cut & (frame._layer == layer)
        assert here.sum() > 50
        assert np.abs(frame.color[here] - color).max() < 1e-5
        assert np.abs(frame.normal[here] - (0, 0, 1)).max() < 1e-5
    slab = box((-2, -2, 0), (2, 2, 1), **backend)
    half = gb.Layer(slab, glass(1.0, absorption=0.6), [gb.ClipPlane((0, 0, 1), 0.5)])
    np.testing.assert_allclose(through(half, 2), np.exp(-0.3), rtol=1e-4)
    hollow = gb.Layer(slab, glass(1.0, absorption=0.6), [gb.ClipBox((-1, -1, 0.2), (1, 1, 0.6))])
    np.testing.assert_allclose(through(hollow, 4), np.exp(-0.36), rtol=1e-4)
    bent = gb.Layer(slab, glass(1.5), [gb.ClipPlane((0, 0, -1), -0.5)])
    np.testing.assert_allclose(through(bent, 2), kept(1, 1.5) ** 2, atol=2e-3)
    clips = [gb.ClipPlane((0, 0, 1), 0.5)]
    inner = gb.Layer(box((-1, -1, -1), (1, 1, 2)), glass(1.0, absorption=0.2))
    both = [gb.Layer(slab, glass(1.0, absorption=0.6)), inner]
    found = gb.render(both, DOWN, ONE, quiet(sky=SKY_BELOW, bounces=6), clips).color[0, 0, 0]
    np.testing.assert_allclose(found, np.exp(-0.3 - 0.3), rtol=1e-4)


def test_fitted_cameras_presets_and_no_refining_of_what_moved():
    mesh = box((-2, -1, -3), (2, 1, 3))
    mask = gb.render(mesh, (64, 48)).mask
    assert 0.1 < mask.mean() < 0.9
    assert not at_edge(mask)
    assert corners_of(mesh).shape == (8, 3)
    for name in ("glass", "clay"):
        assert gb.load_preset(name, mesh).ground.height == pytest.approx(-1)
    assert gb.render(mesh, (32, 24), settings=quiet(ambient=1.0, ambient_rays=2)).mask.any()
    mesh = gb.Mesh(BOX, BOX_FACES)
    frame = gb.render(mesh, (8, 8))
    mesh.pose = np.eye(4)
    with pytest.raises(ValueError, match="refine: expected the scene as it was rendered"):
        frame.refine()


def test_the_same_bits_for_any_number_of_threads():
    vertices, faces = sphere(20, 3.0)
    settings = quiet(lights=[SUN], shadows=True, sky=direction_sky(), samples=2, bounces=4)
    images = []
    for threads in (1, 3):
        options = {"device": "cpu", "threads": threads}
        ball = gb.Mesh(vertices, faces, **options)
        layers = [gb.Layer(ball, glass(1.5)), gb.Layer(block(5, **options), MIRROR)]
        o, d = random_rays(5000, 9, 6.0, 3.0)
        frame = gb.render(layers, CAMERA_FAR, SIZE, settings)
        images.append((frame.color, frame.distance, frame.normal, *ball.intersect(o, d)))
    for one, several in zip(*images, strict=True):
        np.testing.assert_array_equal(one, several)
