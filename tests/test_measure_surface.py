"""Gauges, meshes, volumes and areas against analysis, the float64 oracle and other programs."""

import globule as gb
import numpy as np
import oracle
import pytest
from cli_helpers import refuses
from format_helpers import by_vtk
from globule.measure import mesh as mesh_module
from scenes import SPLASH, lattice

pytest.importorskip("skimage", reason="pip install 'globule[measure]'")

RADIUS = 0.8 * np.sqrt(1 - np.sqrt(0.6))  # of one murakami ball of support 0.8
BALL = np.float32([[0.1, -0.2, 0.3]])


def ball(**options) -> gb.Scene:
    return gb.Scene(gb.Particles(BALL, support=0.8), **options)


def residual(scene: gb.Scene, vertices: np.ndarray) -> np.ndarray:
    """Distance of vertices to the surface, to first order, by the float64 oracle."""
    p = scene.particles
    shape = p.anisotropy if p.anisotropy is not None else scene.support
    weight = 1.0 if p.weight is None else p.weight
    f, g = oracle.field(p.positions, shape, weight, scene.kernel, vertices)
    return np.abs(f - scene.threshold) / np.linalg.norm(g, axis=1)


# Gauges


def flat_pool_height(column: np.ndarray, support: float) -> float:
    """Height of a lattice of spacing 1 above its topmost layer: by bisection of the float64 sum."""
    n = int(np.ceil(support)) + 1
    i = np.arange(-n, n + 1)
    places = np.stack(np.meshgrid(i, i, np.arange(-3 * n, 1), indexing="ij"), -1).reshape(-1, 3)

    def field(z):
        x = ((places - [*column, z]) ** 2).sum(1) / support**2
        return ((1 - x[x < 1]) ** 2).sum()

    low, high = 0.0, support
    for _ in range(60):
        middle = (low + high) / 2
        low, high = (middle, high) if field(middle) > 0.6 else (low, middle)
    return low


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("sign", [1, -1])
def test_flat_pool(axis, sign, backend):
    """A gauge in the middle of a pool: the analytic height, whatever axis is up."""
    pool = lattice(15, 15, 8)
    pool[:, 2] -= pool[:, 2].max()
    columns = np.array([(0, 0), (0.5, 0.5), (0.25, -0.4), (2.1, 1.7)])
    across = [i for i in range(3) if i != axis]
    positions = np.empty_like(pool)
    positions[:, across], positions[:, axis] = pool[:, :2], sign * pool[:, 2]
    up = np.zeros(3)
    up[axis] = sign
    scene = gb.Scene(gb.Particles(positions, support=2.0), **backend)
    found = gb.measure.gauge(scene, columns, up)
    truth = [flat_pool_height(column, 2.0) for column in columns]
    np.testing.assert_allclose(found, truth, atol=2e-6)
    assert gb.measure.gauge(scene, columns[2], up) == pytest.approx(found[2], abs=2e-6)
    assert np.isnan(gb.measure.gauge(scene, (50, 0), up))


def test_height_map(backend):
    scene = ball(**backend)
    found = gb.measure.map_heights(scene, 0.05, up=(0, 0, 1))
    assert found.dims == ("v", "u")
    away = np.hypot(found.points[..., 0] - 0.1, found.points[..., 1] + 0.2)
    clear = np.abs(away - RADIUS) > 1e-3
    with np.errstate(invalid="ignore"):
        truth = 0.3 + np.sqrt(RADIUS**2 - away**2)
    np.testing.assert_array_equal(np.isnan(truth[clear]), np.isnan(found["height"][clear]))
    np.testing.assert_allclose(found["height"][clear], truth[clear], atol=2e-5)
    known = np.isfinite(found["height"])
    np.testing.assert_array_equal(found.points[known][:, 2], found["height"][known])
    assert (found.points[~known][:, 2] == np.nanmin(found["height"])).all()
    below = gb.measure.map_heights(scene, 0.05, up=(0, 0, -1))
    np.testing.assert_allclose(np.nanmax(below["height"]), RADIUS - 0.3, atol=1e-3)


def test_gauge_refused():
    for at, up, message in (
        ((0, 0, 0), (0, 1, 0), "at: expected two horizontal"),
        ((0, np.nan), (0, 1, 0), "at: expected finite"),
        ((0, 0), (1, 1, 0), "up: expected a direction along x, y or z"),
        ((0, 0), (0, 0, 0), "up: expected a direction along x, y or z"),
        ((0, 0), "y", "up: expected three numbers"),
    ):
        refuses(message, gb.measure.gauge, ball(device="cpu"), at, up, error=(TypeError, ValueError))


# Meshes


def shapes() -> dict[str, gb.Scene]:
    """Scenes on the CPU: kernels, weights of both signs, anisotropy, touching balls."""
    jittered = lattice(7, 6, 5, 0.2)
    rng = np.random.default_rng(1)
    stretched = np.diag([1.0, 2.0, 3.0])[None] + 0.3
    two = np.float32([[0, 0, 0], [0.94, 0, 0]])
    options = {"device": "cpu"}
    return {
        "ball": ball(**options),
        "lattice": gb.Scene(gb.Particles(jittered, support=2.0), **options),
        "spline": gb.Scene(gb.Particles(jittered), "cubic_spline", **options),
        "solid": gb.Scene(gb.Particles(jittered), "solid", **options),
        "weights": gb.Scene(gb.Particles(jittered, support=1.9, weight=rng.uniform(-0.5, 1.5, 210)), **options),
        "ellipsoid": gb.Scene(gb.Particles(BALL, anisotropy=stretched), **options),
        "neck": gb.Scene(gb.Particles(two, support=1.0), **options),
        "far": gb.Scene(gb.Particles(jittered + 1000, support=2.0), **options),
    }


@pytest.mark.parametrize("name", ["lattice", "solid", "weights", "neck"])
def test_blocks_leave_no_seam(name, monkeypatch):
    """However the grid is cut into blocks, the mesh is the same."""
    trimesh = pytest.importorskip("trimesh")
    scene = shapes()[name]
    monkeypatch.setattr(mesh_module, "CELLS", 64)
    whole = gb.measure.mesh_surface(scene)
    for cells in (3, 8, 32):
        monkeypatch.setattr(mesh_module, "CELLS", cells)
        found = gb.measure.mesh_surface(scene)
        assert len(found.vertices) == len(whole.vertices)
        assert len(found.faces) == len(whole.faces)
        assert trimesh.Trimesh(found.vertices, found.faces, process=False).is_watertight
        assert found.volume == pytest.approx(whole.volume, rel=1e-6)


def spray():
    """A smooth surface: a body with a bubble, thin sheets, drops of a few particles."""
    rng = np.random.default_rng(3)
    body = lattice(12, 10, 9, 1.0)
    body = body[np.linalg.norm(body - body.mean(axis=0), axis=1) > 1.2]
    drops = rng.uniform(-4, 16, (150, 3))
    drops = drops[np.abs(drops[:, None] - body).max(axis=2).min(axis=1) > 1.5]
    sheet = lattice(20, 1, 14, 1.0) - (0, 7, 0)
    return np.concatenate([body, drops, sheet, drops[:9] + (0.7, 0, 0)]) + rng.normal(0, 0.05, 3)


@pytest.mark.parametrize("spacing", [0.8, 0.4])
def test_where_no_surface_is_the_field_is_not_asked(spacing, monkeypatch):
    """The mesh is the one of a field that is known at every node."""
    scene, asked = gb.Scene(spray(), surface="smooth", spacing=1.0, device="cpu"), []
    known = gb.Scene.field
    monkeypatch.setattr(gb.Scene, "field", lambda self, points: asked.append(len(points)) or known(self, points))
    found = gb.measure.mesh_surface(scene, spacing)
    few = sum(asked)
    asked.clear()
    monkeypatch.setattr(mesh_module, "_may_skip", lambda *_: False)
    whole = gb.measure.mesh_surface(scene, spacing)
    assert few < 0.6 * sum(asked)
    np.testing.assert_array_equal(found.vertices, whole.vertices)
    np.testing.assert_array_equal(found.faces, whole.faces)
    np.testing.assert_array_equal(found.normals, whole.normals)


def test_parts_are_the_whole():
    scene = gb.Scene(spray(), surface="smooth", spacing=1.0, device="cpu")
    whole = gb.measure.mesh_surface(scene, 0.25)
    corners = {tuple(c) for c in whole.vertices.tolist()}
    parts = [gb.measure.mesh_surface(scene, 0.25, part=(i, 3)) for i in range(3)]
    assert sum(len(part.faces) for part in parts) == len(whole.faces)
    assert all(len(part.faces) > 0 for part in parts)
    assert {tuple(c) for part in parts for c in part.vertices.tolist()} == corners
    assert sum(part.area for part in parts) == pytest.approx(whole.area, rel=1e-6)
    for wrong in ((1, 1), (-1, 2), 3, (0.5, 2)):
        with pytest.raises(ValueError, match=r"part: expected \(i, n\)"):
            gb.measure.mesh_surface(scene, part=wrong)


def test_a_drop_far_away():
    """Empty space costs nothing, and mixed supports lose nothing."""
    p = gb.Particles([[0, 0, 0], [1000, -500, 2000], [1, 0, 0]], support=[0.8, 0.8, 3.0])
    found = gb.measure.measure_surface(p, 0.1, device="cpu")
    truth = 4 / 3 * np.pi * RADIUS**3
    both = gb.measure.measure_surface(p[[0, 2]], 0.1, device="cpu")
    assert abs(found.volume - both.volume - truth) <= 2 * found.volume_error


@pytest.mark.parametrize("name", shapes())
def test_vertices_are_on_the_surface(name):
    scene = shapes()[name]
    found = gb.measure.mesh_surface(scene)
    assert len(found.vertices) > 100
    coordinates = np.spacing(np.abs(found.vertices).max())  # a float32's
    assert (residual(scene, found.vertices) <= 1e-4 * found.spacing + coordinates).all()
    trimesh = pytest.importorskip("trimesh")
    solid = trimesh.Trimesh(found.vertices, found.faces, process=False)
    assert solid.is_watertight
    assert solid.is_winding_consistent
    assert found.volume > 0
    assert found.volume == pytest.approx(solid.volume, rel=1e-4)
    assert found.area == pytest.approx(solid.area, rel=1e-5)
    outwards = (solid.vertex_normals * found.normals).sum(1)
    assert np.quantile(outwards, 0.01) > 0.5
    p = scene.particles.positions
    gradient = oracle.field(
        p, scene.particles.anisotropy if name == "ellipsoid" else scene.support,
        1.0 if scene.particles.weight is None else scene.particles.weight, scene.kernel,
        found.vertices,
    )[1]  # fmt: skip
    along = -gradient / np.linalg.norm(gradient, axis=1, keepdims=True)
    np.testing.assert_allclose(found.normals, along, atol=2e-3)


def test_same_mesh_everywhere(backend, reference):
    p = gb.Particles(lattice(7, 6, 5, 0.2), support=2.0)
    there, here = (gb.measure.mesh_surface(reference(p)), gb.measure.mesh_surface(gb.Scene(p, **backend)))
    assert abs(len(there.faces) - len(here.faces)) <= 0.001 * len(there.faces)
    assert here.volume == pytest.approx(there.volume, rel=1e-6)


def test_newton_alone_does_not_decide(monkeypatch):
    """Vertices whose Newton steps fail are found by bisection."""
    monkeypatch.setattr(mesh_module, "_NEWTON_STEPS", 0)
    scene = shapes()["lattice"]
    found = gb.measure.mesh_surface(scene)
    assert residual(scene, found.vertices).max() <= 1e-4 * found.spacing


def test_mesh_files(folder):
    trimesh = pytest.importorskip("trimesh")
    p = gb.Particles(BALL, support=0.8, attributes={"a speed": [7.0], "flow": [[1.0, 2, 3]]})
    found = gb.measure.mesh_surface(p, values=["a speed", "flow", "inside"], device="cpu")
    assert found.values["flow"].shape == (len(found.vertices), 3)
    np.testing.assert_allclose(found.values["a speed"], 7)
    for ending in ("ply", "stl", "obj"):
        found.save(f"a.{ending}")
        read = trimesh.load_mesh(f"a.{ending}", process=False)
        np.testing.assert_array_equal(np.asarray(read.triangles, np.float32), found.vertices[found.faces])
    plyfile = pytest.importorskip("plyfile")
    vertex = plyfile.PlyData.read("a.ply")["vertex"]
    np.testing.assert_array_equal(vertex["nx"], found.normals[:, 0])
    np.testing.assert_array_equal(vertex["flow:2"], found.values["flow"][:, 2])
    np.testing.assert_array_equal(vertex["a_speed"], found.values["a speed"])
    pytest.importorskip("vtk")
    from vtkmodules.util.numpy_support import vtk_to_numpy

    found.save("a.vtp")
    data = by_vtk("a.vtp")
    assert data.GetNumberOfPolys() == len(found.faces)
    np.testing.assert_array_equal(vtk_to_numpy(data.GetPointData().GetArray("flow")), found.values["flow"])
    faces = vtk_to_numpy(data.GetPolys().GetConnectivityArray()).reshape(-1, 3)
    np.testing.assert_array_equal(faces, found.faces)
    refuses(r"path: expected a name ending in \.ply", found.save, "a.glb")


# Volumes and areas


def test_one_ball():
    """Anywhere in the grid, the error estimate covers the truth and is no excuse."""
    for where in np.random.default_rng(3).uniform(-5, 5, (5, 3)):
        found = gb.measure.measure_surface(gb.Particles([where], support=0.8), 0.1, device="cpu")
        volume, area = 4 / 3 * np.pi * RADIUS**3, 4 * np.pi * RADIUS**2
        assert abs(found.volume - volume) <= found.volume_error <= 0.05 * volume
        assert abs(found.area - area) <= found.area_error <= 0.03 * area


@pytest.mark.parametrize(
    ("name", "share"),
    [
        ("double_dam_break_frame_26_4732_particles.vtk", 0.15),
        pytest.param("bunny_frame_14_7705_particles.vtk", 1, marks=pytest.mark.slow),
    ],
)
def test_errors_cover_what_half_the_spacing_gives(name, share):
    """A splash and a bunny: what is round and what is hollow does not cancel in the estimates."""
    path = SPLASH.with_name(name)
    if not path.exists():
        pytest.skip(f"no {path}")
    p = gb.read(path)
    p = p[p.positions[:, 0] <= np.quantile(p.positions[:, 0], share)]
    scene = gb.Scene(p, device="cpu")
    found = gb.measure.measure_surface(scene)
    fine = gb.measure.measure_surface(scene, scene.spacing / 4)
    assert abs(found.volume - fine.volume) <= found.volume_error <= 0.01 * fine.volume
    assert abs(found.area - fine.area) <= found.area_error <= 0.01 * fine.area


def test_a_mesh_of_nothing_has_values_of_nothing():
    attributes = {"speed": np.ones(1), "velocity": np.ones((1, 3))}
    scene = gb.Scene(gb.Particles(BALL, support=0.8, weight=0.1, attributes=attributes), device="cpu")
    found = gb.measure.mesh_surface(scene, 0.1, ["velocity", "speed"]).values
    assert {name: array.shape for name, array in found.items()} == {"velocity": (0, 3), "speed": (0,)}


def test_nothing_to_measure():
    for p in (gb.Particles(np.empty((0, 3))), gb.Particles(BALL, support=0.8, weight=0.1)):
        assert gb.measure.measure_surface(p, 0.1, device="cpu") == (0, 0, 0, 0)
        found = gb.measure.mesh_surface(p, 0.1, device="cpu")
        assert found.vertices.shape == found.faces.shape == (0, 3)
        assert np.isnan(gb.measure.gauge(p, [(0, 0)], device="cpu")).all()


@pytest.mark.parametrize(
    ("spacing", "message"),
    [(-1, "spacing: expected a positive"), (np.nan, "spacing: expected a positive"),
     ("a", "spacing: expected a number"), (1e-4, "spacing: expected one that makes at most")],
)  # fmt: skip
def test_refused(spacing, message):
    for measure in (gb.measure.mesh_surface, gb.measure.measure_surface):
        refuses(message, measure, ball(device="cpu"), spacing, error=(TypeError, ValueError))
    with pytest.raises(ValueError, match=r"values: expected one of .*got speed"):
        gb.measure.mesh_surface(ball(device="cpu"), values=["speed"])


def test_a_mesh_file_is_no_particles(tmp_path):
    path = tmp_path / "hull.obj"
    path.write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\nf 1 2 4\n")
    plane = gb.measure.SamplePlane((0, 0, 1), 0.1)
    works = (gb.measure.measure_surface, lambda p: gb.measure.gauge(p, (0, 0)), lambda p: gb.measure.sample(p, plane))
    for work in (*works, gb.measure.project, lambda p: gb.measure.track_surface([p])):
        refuses("expected particles or a volume, got the mesh", work, path)
    assert gb.measure.measure_surface(gb.read(path, spacing=0.1), device="cpu").volume > 0
