"""The field and its gradient against the float64 oracle, and the oracle against NumPy."""

import globule as gb
import numpy as np
import oracle
import pytest
from globule.scene import scene as scene_module
from scenes import KERNELS, Case, cloud, lattice

# b(q), q = r / a, as in spec/2 with its errata; blinn is cut where it has fallen to 1e-5.
FORMULAS = {
    "murakami": lambda q: (1 - q**2) ** 2,
    "nishimura": lambda q: np.where(q <= 1 / 3, 1 - 3 * q**2, 1.5 * (1 - q) ** 2),
    "wyvill": lambda q: 1 - 22 / 9 * q**2 + 17 / 9 * q**4 - 4 / 9 * q**6,
    "blinn": lambda q: np.exp(np.log(1e-5) * q**2),
    "cubic_spline": lambda q: np.where(q <= 0.5, 1 - 6 * q**2 + 6 * q**3, 2 * (1 - q) ** 3),
    "wendland_c2": lambda q: (1 - q) ** 4 * (1 + 4 * q),
    "solid": lambda q: (1 - q**2) ** 2 * (1 - 2 * q**2),
}


def make(kernel: str, kind: str) -> Case:
    rng = np.random.default_rng(50)
    n = 800
    case = Case(cloud(n, 51), support=0.4, kernel=kernel)
    if kind == "each its own":
        case.support = 10 ** rng.uniform(-2, 0, n)
        case.weight = rng.uniform(-1, 1, n).astype(np.float32)
    if kind == "one weight":
        case.weight = -2.5
    return case


def scale(case: Case, points: np.ndarray) -> np.ndarray:
    """The field with no negative term: what float32's error is relative to."""
    weight = np.abs(case.weight)
    total = oracle.field(case.positions, case.support, weight, case.kernel, points)[0]
    if case.kernel == "solid":  # negative beyond r^2 = 1/2, never below -1/27
        near = np.linalg.norm(points[:, None] - case.positions, axis=2) < case.support
        total = total + (near * np.broadcast_to(weight, near.shape)).sum(1) * 2 / 27
    return 1e-3 + total


@pytest.mark.parametrize("kernel", KERNELS)
def test_formula(backend, kernel):
    a = 1.5
    q = np.array([0, 0.1, 1 / 3 - 1e-4, 1 / 3 + 1e-4, 0.5 - 1e-4, 0.5, 0.75, 0.9999, 1, 1.001, 3])
    points = np.stack([1 + a * q, 0 * q, 0 * q], 1).astype(np.float32)
    scene = gb.Scene(np.array([[1, 0, 0]]), kernel=kernel, support=a, **backend)
    expected = np.where(q < 1, FORMULAS[kernel](q), 0)
    loose = 2e-4 if kernel == "blinn" else 2e-6
    np.testing.assert_allclose(scene.field(points), expected, atol=loose)
    assert scene.field(points)[0] == pytest.approx(1, abs=loose)
    assert (scene.field(points)[-2:] == 0).all()
    np.testing.assert_array_equal(scene.gradient(points)[[0, -2, -1]], 0)
    # Smooth where pieces meet, and at the support's edge.
    for edge in (1 / 3, 0.5, 1):
        x = np.array([[1 + a * (edge + s * 1e-3), 0, 0] for s in (-1, 1)], np.float32)
        f, g = scene.field(x), scene.gradient(x)[:, 0]
        assert abs(f[1] - f[0]) < 5e-3 * a
        assert abs(g[1] - g[0]) < 0.05


@pytest.mark.parametrize("kernel", KERNELS)
@pytest.mark.parametrize("kind", ["alike", "one weight", "each its own"])
def test_field_and_gradient(backend, kernel, kind):
    case = make(kernel, kind)
    points = np.concatenate([cloud(400, 52, 1.2), case.positions[:60], np.full((2, 3), 9.0)])
    points = points.astype(np.float32)
    f, g = case.field(points)
    most = 1e-6 * scale(case, points)
    steepest = 12 * np.abs(case.weight).max() / np.min(case.support)
    for octree in ("sparse", "dense"):
        scene = case.scene(octree=octree, **backend)
        assert (np.abs(scene.field(points) - f) <= most).all()
        error = np.linalg.norm(scene.gradient(points) - g, axis=1)
        assert (error <= 1e-6 * steepest + 1e-5 * np.linalg.norm(g, axis=1)).all()


@pytest.mark.parametrize("kernel", KERNELS)
def test_gradient_is_the_slope(kernel):
    case = make(kernel, "alike")
    case.weight = np.random.default_rng(53).uniform(-1, 1, 800).astype(np.float32)
    points = cloud(300, 54).astype(np.float64)
    gradient = case.field(points)[1]
    h = 1e-5
    for axis in range(3):
        step = np.eye(3)[axis] * h
        slope = (case.field(points + step)[0] - case.field(points - step)[0]) / (2 * h)
        np.testing.assert_allclose(gradient[:, axis], slope, atol=2e-3)


@pytest.mark.parametrize("kernel", KERNELS)
def test_the_oracle_is_the_sum_of_the_formulas(kernel):
    case = make(kernel, "each its own")
    points = cloud(200, 55).astype(np.float64)
    r = np.linalg.norm(points[:, None] - case.positions[None].astype(np.float64), axis=2)
    q = r / np.float32(case.support).astype(np.float64)
    b = np.where(q < 1, FORMULAS[kernel](np.minimum(q, 1)), 0)
    loose = 5e-3 if kernel == "blinn" else 1e-9
    np.testing.assert_allclose(case.field(points)[0], b @ case.weight.astype(float), atol=loose)


@pytest.mark.parametrize("kernel", KERNELS)
def test_default_support_closes_a_lattice(backend, kernel):
    """No flag given: a block is solid inside, ends within two spacings, and nearly flat."""
    spacing = np.float32(0.37)
    scene = gb.Scene(lattice(12, 12, 12) * spacing, kernel=kernel, **backend)
    assert scene.support == pytest.approx(scene_module.DEFAULTS[kernel][0] * spacing, rel=0.15)
    assert (scene.field(cloud(500, 56, 4 * spacing)) > scene.threshold).all()
    y, z = np.random.default_rng(57).uniform(-3 * spacing, 3 * spacing, (2, 400))
    rays = np.stack([np.full(400, 20 * spacing), y, z], 1)
    depth = scene.intersect(rays, np.tile([-1.0, 0, 0], (400, 1)))[0]
    face = 20 - depth / spacing  # in spacings from the middle; the last layer is at 5.5
    assert (face > 5.5).all()
    assert (face < 7.25).all()
    assert np.ptp(face) < 0.15


def test_shapes(backend):
    scene = gb.Scene(cloud(10), **backend)
    assert scene.field(np.zeros((0, 3))).shape == (0,)
    assert scene.gradient(np.zeros((0, 3))).shape == (0, 3)
    assert scene.field(np.zeros((4, 3), np.float64)).dtype == np.float32
    assert scene.field([[0, 0, 0]]).shape == (1,)
    not_packed = np.zeros((7, 6), np.float32)[:, ::2]
    assert scene.gradient(not_packed).shape == (7, 3)
