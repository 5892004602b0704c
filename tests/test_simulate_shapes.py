"""Shapes to particles, and instruments along their key frames."""

import globule as gb
import numpy as np
import pytest
from globule.sim.instruments import Key, Motion
from globule.sim.sampling import BEHIND, fill, surface, thinned
from globule.sim.shapes import Box, Cylinder, Grid, Mesh, Plane, Sphere
from scipy.spatial import cKDTree

D = 0.05


def box_mesh():
    corners = np.array([(x, y, z) for x in (0, 1) for y in (0, 1) for z in (0, 1)], float)
    faces = [(0, 1, 3), (0, 3, 2), (4, 6, 7), (4, 7, 5), (0, 4, 5), (0, 5, 1),
             (2, 3, 7), (2, 7, 6), (0, 2, 6), (0, 6, 4), (1, 5, 7), (1, 7, 3)]  # fmt: skip
    return Mesh(corners[np.array(faces)])


def ball_grid():
    axes = np.mgrid[-1.5:1.5:61j, -1.5:1.5:61j, -1.5:1.5:61j]
    affine = np.diag([0.05, 0.05, 0.05, 1.0])
    affine[:3, 3] = -1.5
    return Grid(np.linalg.norm(axes, axis=0) - 1, affine)


@pytest.mark.parametrize(("shape", "volume"), [
    (Box((0, 0, 0), (1, 0.5, 0.25)), 0.125), (Sphere((1, 2, 3), 0.6), 4 / 3 * np.pi * 0.6**3),
    (Cylinder((0, 0, 0), (1, 1, 0), 0.4), np.pi * 0.16 * np.sqrt(2)), (box_mesh(), 1.0),
    (ball_grid(), 4 / 3 * np.pi),
])  # fmt: skip
def test_filled_volume(shape, volume):
    points = fill(shape, D)
    assert len(points) * D**3 == pytest.approx(volume, rel=0.02)
    assert np.unique(np.round(points / D, 3), axis=0).shape == points.shape


@pytest.mark.parametrize(
    "shape", [Sphere((0, 0, 0), 1.0), *(pytest.param(s, marks=pytest.mark.slow) for s in (ball_grid(), box_mesh()))]
)
@pytest.mark.parametrize("hollow", [False, True])
def test_layer_is_behind_the_surface(shape, hollow):
    points = surface(shape, D, hollow)
    if isinstance(shape, Mesh):
        shape = Box((0, 0, 0), (1, 1, 1))
        flat = (np.abs(points - 0.5) < 0.45).sum(axis=1) == 2  # away from the edges
        points = points[flat]
    expected = BEHIND * D if hollow else -BEHIND * D
    assert np.allclose(shape.distance(points), expected, atol=0.02 * D)


@pytest.mark.slow
def test_layer_is_dense_enough_and_has_no_twins():
    for shape in (Sphere((0, 0, 0), 1.0), ball_grid(), Cylinder((0, 0, 0), (0, 0, 2), 1.0)):
        points = surface(shape, D)
        gaps = cKDTree(points).query(points, k=2)[0][:, 1]
        assert gaps.min() > 0.45 * D
        assert gaps.max() < 1.45 * D


def test_open_faces_planes_and_thinned_points():
    points = surface(Box((0, 0, 0), (1, 1, 1)), 0.1, hollow=True, open_faces=["+z"])
    assert points[:, 2].min() == pytest.approx(-0.1 * BEHIND)
    assert points[:, 2].max() < 1
    assert len(points) == 12**3 - 10**3 - 12**2
    points = surface(Plane((0, 0, 0.5), (0, 0, 1)), 0.1, domain=((0, 0, 0), (1, 1, 1)))
    assert np.allclose(points[:, 2], 0.5 - 0.1 * BEHIND)
    assert len(points) >= 100
    with pytest.raises(ValueError, match="got a plane"):
        fill(Plane((0, 0, 0), (0, 0, 1)), 0.1)
    with pytest.raises(ValueError, match=r"got 1,000,000,000; a spacing of 0.00274 m would fit"):
        fill(Box((0, 0, 0), (1, 1, 1)), 0.001)
    points = np.random.default_rng(1).random((3000, 3))
    kept = thinned(points, 0.1)
    assert np.linalg.norm(points[:, None] - kept[None], axis=2).min(axis=1).max() < 0.1
    assert (np.linalg.norm(kept[:, None] - kept[None], axis=2) + np.eye(len(kept))).min() >= 0.0999


def test_motion_goes_straight_and_turns_evenly():
    motion = Motion([
        Key(time=1.0, position=(0.0, 0.0, 0.0)),
        Key(time=3.0, position=(2.0, 0.0, 4.0), axis=(0.0, 0.0, 1.0), angle=90.0), Key(time=4.0, on=False),
    ])  # fmt: skip
    assert np.allclose(motion.pose(0.0), np.eye(4))
    halfway = motion.pose(2.0)
    assert np.allclose(halfway[:3, 3], [1, 0, 2])
    assert np.allclose(halfway[:3, 0], [np.sqrt(0.5), np.sqrt(0.5), 0])
    assert np.allclose(motion.pose(9.0)[:3], [[0, -1, 0, 2], [1, 0, 0, 0], [0, 0, 1, 4]])
    assert [motion.on(t) for t in (0.5, 1.0, 3.9, 4.0)] == [False, True, True, False]


@pytest.mark.parametrize("angle", [170, 206, 360, 720, -1000])
@pytest.mark.parametrize("first", [{}, {"axis": (0, 0, 1), "angle": 30}, {"axis": (0, 0, -1), "angle": -30}])
def test_keys_turn_by_the_angle_asked_for(first, angle):
    begin = abs(first.get("angle", 0))
    motion = Motion([
        Key(time=1.0, position=(1, 0, 0), **first), Key(time=2.0, position=(3, 0, 0), axis=(0, 0, 2), angle=angle)
    ])  # fmt: skip
    for share in (0.0, 0.25, 0.5, 0.9, 1.0):
        at, pose = np.radians(begin + share * (angle - begin)), motion.pose(1 + share)
        assert np.allclose(pose[:3, 0], [np.cos(at), np.sin(at), 0], atol=1e-12)
        assert np.allclose(pose[:3, 3], [1 + 2 * share, 0, 0])
    way = 0.5 * np.radians(abs(angle - begin)) * 0.1 + 1.0
    assert np.isclose(motion.way(1.25, 1.75, 0.1), way)
    assert np.isclose(motion.way(0.0, 9.0, 0.1), 2 * way)


def test_keys_turn_about_an_axis_that_moves():
    axes = np.array([[0, 0, 1.0], [0, 0.6, 0.8], [1.0, 0, 0]])
    motion = Motion([Key(time=i, axis=tuple(axis), angle=720 * i) for i, axis in enumerate(axes)])
    for time in (0.3, 0.95, 1.0, 1.2, 1.7):
        i = int(time)
        arc = np.arccos(axes[i] @ axes[i + 1])
        a, b = np.sin((1 - (time - i)) * arc), np.sin((time - i) * arc)
        axis, turn = (a * axes[i] + b * axes[i + 1]) / np.sin(arc), motion.pose(time)[:3, :3]
        assert np.allclose(turn @ axis, axis)
        assert np.allclose(turn @ turn.T, np.eye(3))
        aside, angle = np.cross(axis, [0.0, 1, 0]), np.radians(720 * time)
        assert np.allclose(turn @ aside, np.cos(angle) * aside + np.sin(angle) * np.cross(axis, aside))


@pytest.mark.parametrize("n", [7, 8, 9])
@pytest.mark.parametrize("kind", ["cylinder", "box"])
def test_shells_of_seven_spacings_have_no_holes_in_images(kind, n):
    """docs/how-to/simulate-own-scene.md tells users so. Thinner ones have holes."""

    def open_share(n):
        half, u = n / 2, np.linspace(-0.97, 0.97, 41)
        if kind == "cylinder":
            shape = Cylinder((0, 0, -half * D), (0, 0, half * D), half * D)
            normal = np.stack([np.cos(np.pi * u), np.sin(np.pi * u), 0 * u], 1)[:, None]
            seen = normal + u[:, None] * [0, 0, 1]
        else:
            shape, normal = Box((-half * D,) * 3, (half * D,) * 3), np.array([0, 0, 1.0])
            seen = normal + np.stack([*np.meshgrid(u, u, indexing="ij"), np.zeros((41, 41))], -1)
        scene = gb.Scene(surface(shape, D), surface="smooth", spacing=D, device="cpu")
        places = (half - BEHIND) * D * seen + np.linspace(-0.6, 0.3, 4)[:, None, None, None] * D * normal
        return (np.reshape(scene.field(places.reshape(-1, 3)), (4, -1)).max(0) < scene.threshold).mean()

    assert open_share(n) == 0
    assert open_share(5) > 0.05


def test_a_mesh_that_turns_shortens_the_steps(tmp_path):
    """Whatever the shape, its particles go at most 0.4 spacings in a step."""
    corners = np.array([[0, 0, 0], [0.5, 0, 0], [0, 0.1, 0], [0, 0, 0.1]])
    faces = [[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]]
    lines = [f"v {x} {y} {z}" for x, y, z in corners] + ["f " + " ".join(str(i + 1) for i in face) for face in faces]
    (tmp_path / "blade.obj").write_text("\n".join(lines))
    turning = [{"time": 0, "axis": [0, 0, 1], "angle": 0}, {"time": 1, "axis": [0, 0, 1], "angle": 3600}]
    sim = gb.Simulation(
        {
            "spacing": 0.02, "gravity": [0, 0, 0], "domain": {"lo": [-1, -1, -1], "hi": [1, 1, 1]},
            "boundaries": [{"name": "blade", "mesh": {"file": str(tmp_path / "blade.obj")}, "keys": turning}],
        },
        device="cpu", threads=1,
    )  # fmt: skip
    reach = np.linalg.norm(sim.positions, axis=1).max()
    assert 0.45 < reach < 0.55
    assert sim.dt == pytest.approx(0.4 * 0.02 / (20 * np.pi * reach), rel=1e-3)


def _led(shape, periodic, keys, **more):
    scene = {
        "spacing": 0.05, "gravity": [0, 0, 0], "fluids": [{"name": "water"}],
        "domain": {"lo": [-0.5, -0.5, -0.5], "hi": [0.5, 0.5, 0.5], "periodic": list(periodic)},
        "boundaries": [{"name": "wall", **shape, "keys": keys}],
    } | more  # fmt: skip
    return gb.Simulation(scene, device="cpu", threads=1)


WALLS = {
    "plane": {"plane": {"point": [0, 0, 0], "normal": [1, 1, 0]}},
    "box": {"box": {"lo": [-0.2, -0.1, -0.1], "hi": [0.2, 0.1, 0.1]}},
    "sphere": {"sphere": {"center": [0.3, 0, 0], "radius": 0.25}},
    "cylinder": {"cylinder": {"start": [0, 0, -0.2], "end": [0, 0, 0.2], "radius": 0.15}},
}


@pytest.mark.parametrize("periodic", ["x", "y", "z", "xy", "xyz"])
@pytest.mark.parametrize("shape", WALLS)
def test_walls_go_across_periodic_sides_for_ever(shape, periodic):
    """A thousand lengths of the domain away, a wall is where it is asked to be, and as fast."""
    way = np.array([1000.25 * (axis in periodic) for axis in "xyz"])
    keys = [{"time": 0}, {"time": 1, "position": way.tolist()}, {"time": 2, "position": (way * 1.0001).tolist()}]
    sim = _led(WALLS[shape], periodic, keys)
    begin = sim.positions.astype(float)
    sim.step(1.0)  # as after a long run
    for _ in range(2):
        sim.step(0.01)
        off = sim.positions - begin - way * (1 + 1e-4 * (sim.time - 1))
        off -= np.round(off) * [axis in periodic for axis in "xyz"]
        assert np.abs(off).max() < 1e-5
    assert np.abs(sim.velocities - 1e-4 * way).max() < 1e-3


def test_a_wall_comes_in_from_outside_and_fluid_under_one_that_slides_stays_calm():
    """Couette's flow for three lengths of the domain."""
    d, keys = 0.05, [{"time": 0}, {"time": 2, "position": [3, 0, 0]}]
    sim = _led(
        {"plane": {"point": [0, 0, 0.2], "normal": [0, 0, -1]}}, "xy", keys,
        domain={"lo": [-0.5, 0, -0.35], "hi": [0.5, 8 * d, 0.35], "periodic": ["x", "y"]},
        fluids=[{"name": "oil", "viscosity": 200.0, "box": {"lo": [-0.5, 0, -0.2], "hi": [0.5, 8 * d, 0.2]}}],
        boundaries=[
            {"name": "wall", "plane": {"point": [0, 0, 0.2], "normal": [0, 0, -1]}, "keys": keys},
            {"name": "floor", "plane": {"point": [0, 0, -0.2], "normal": [0, 0, 1]}},
        ],
        solver={"max_dt": 0.02},
    )  # fmt: skip
    fluid = np.asarray(sim.arrays.phase) == 0
    sim.run_to(2.0)
    speed, height = sim.velocities[fluid, 0], sim.positions[fluid, 2]
    assert np.abs(speed - 1.5 * (height + 0.2) / 0.4).max() < 0.15
    assert sim.record.diagnostics[-1]["max_speed"] < 1.6
    keys = [{"time": 0}, {"time": 1, "position": [0.8, 0, 0]}, {"time": 2, "position": [-0.1, 0, 0]}]
    sim = _led({"box": {"lo": [-0.9, -0.1, -0.1], "hi": [-0.6, 0.1, 0.1]}}, "", keys)
    begin = sim.positions.copy()
    for time, x in ((0.5, 0.4), (1.0, 0.8), (2.0, -0.1)):
        sim.run_to(time)
        assert np.allclose(sim.positions, begin + np.float32([x, 0, 0]), atol=1e-6)
        assert np.abs(sim.velocities).max() < 1.0
    assert sim.record.diagnostics[-1]["n_escaped"] == len(begin)
