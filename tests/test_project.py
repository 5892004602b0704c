"""Projections: line integrals against float64 quadrature, and what must be conserved."""

import functools
import itertools

import globule as gb
import numpy as np
import oracle
import pytest
from globule.measure.project import kernel_volume
from quick import every
from scenes import KERNELS, cloud, lattice, unit


def quadrature(positions, matrices, values, kernel, origins, directions) -> np.ndarray:
    """Sums of value * integral of b along rays from their origins on, particle by particle, with
    Gauss's rule on pieces of each chord on which b is smooth; float64.

    matrices: (N, 3, 3), b is evaluated by the oracle's field of one ball of support 1.
    """
    x, weight = np.polynomial.legendre.leggauss(48)
    out = np.zeros((len(origins), values.shape[1]))
    for i, (o, d) in enumerate(zip(origins.astype(np.float64), directions, strict=True)):
        d = d.astype(np.float64)
        for p, m, value in zip(positions.astype(np.float64), matrices, values, strict=True):
            w, e = m @ (o - p), m @ d
            speed = np.linalg.norm(e)
            at = w @ e / speed
            h2 = w @ w - at * at
            if h2 >= 1:
                continue
            ends = {at, 0.0}  # the ray's origin, and the kinks
            for bound in (1, 1 / 2, 1 / 3):
                if h2 < bound**2:
                    u = np.sqrt(bound**2 - h2)
                    ends |= {-u, u}
            ends = sorted(end for end in ends if at <= end and end**2 <= 1 - h2 + 1e-15)
            for lo, hi in itertools.pairwise(ends):
                # Denser at both ends: near the middle odd powers of q turn sharply.
                t = (lo + hi) / 2 - (hi - lo) / 2 * np.cos(np.pi * (x + 1) / 2)
                slope = (hi - lo) / 2 * np.sin(np.pi * (x + 1) / 2) * np.pi / 2
                points = np.stack([np.full_like(t, np.sqrt(max(h2, 0))), t, 0 * t], axis=1)
                b, _ = oracle.field(np.zeros((1, 3)), 1.0, 1.0, kernel, points)
                out[i] += value * float(np.sum(weight * slope * b)) / speed
    return out


def rays(n: int, seed: int, size: float = 1.2):
    rng = np.random.default_rng(seed)
    origins = rng.uniform(-size, size, (n, 3)).astype(np.float32)
    directions = unit(rng.normal(size=(n, 3)))
    directions[: n // 4] = unit(np.eye(3)[rng.integers(0, 3, n // 4)])  # along the axes
    origins[n // 2 :] -= 5 * directions[n // 2 :]  # half of them begin outside
    return origins, directions.astype(np.float32)


@functools.cache
def integrals(kernel: str, kind: str):
    """Particles, values, rays and the integrals along them; the same for every backend."""
    rng, n = np.random.default_rng(7), 80
    values, support = rng.uniform(-1, 2, (n, 3)).astype(np.float32), np.full(n, 0.4, np.float32)
    if kind == "each its own":
        support = (10 ** rng.uniform(-1.5, -0.1, n)).astype(np.float32)
    matrices = np.eye(3) / support.astype(np.float64)[:, None, None]
    shape = {"support": support}
    if kind == "stretched":
        turn, axes = np.linalg.qr(rng.normal(size=(n, 3, 3)))[0], rng.uniform(1.5, 5, (n, 3))
        matrices = np.einsum("nij,nj,nkj->nik", turn, axes, turn)
        matrices = ((matrices + matrices.transpose(0, 2, 1)) / 2).astype(np.float32)
        shape = {"anisotropy": matrices}
    p = gb.Particles(cloud(n, 8), weight=rng.uniform(-1, 1, n), **shape)  # weights count nothing
    at, matrices = rays(40, 9, 0.6), matrices.astype(np.float64)
    return p, values, at, quadrature(p.positions, matrices, values, kernel, *at)


@pytest.mark.few_backends
@pytest.mark.parametrize("kernel", every(3, KERNELS))
@pytest.mark.parametrize("kind", ["alike", "each its own", "stretched"])
def test_integrals_are_the_quadrature_s(kernel, kind, backend):
    p, values, at, truth = integrals(kernel, kind)
    scene = gb.Scene(p, kernel, **backend)
    found = scene.integrate(*at, values)
    assert (np.abs(truth).sum(1) > 0.01).sum() >= 27
    np.testing.assert_allclose(found, truth, atol=3e-6 * np.abs(truth).max())
    np.testing.assert_allclose(scene.integrate(*at, values[:, 1]), found[:, 1], rtol=0, atol=0)


@pytest.mark.parametrize("octree", ["sparse", "dense"])
def test_same_sums_on_any_octree(octree, backend, reference):
    p = gb.Particles(lattice(12, 11, 10, 0.2), support=2.0)
    values = np.random.default_rng(1).uniform(0, 1, (len(p), 11)).astype(np.float32)
    origins, directions = rays(300, 2, 8.0)
    first = reference(p).integrate(origins, directions, values)
    found = gb.Scene(p, octree=octree, **backend).integrate(origins, directions, values)
    np.testing.assert_allclose(found, first, atol=1e-6 * first.max())
    if backend["device"] == "cpu":
        one = gb.Scene(p, octree=octree, **{**backend, "threads": 1})
        np.testing.assert_array_equal(one.integrate(origins, directions, values), found)


def test_particles_on_the_ray_rays_that_meet_nothing_and_kernel_volumes(backend):
    scene = gb.Scene(np.zeros((1, 3)), support=1.0, **backend)
    found = scene.integrate(
        [[-5, 0, 0], [-5, 2, 0], [0, 0, 0], [5, 0, 0], [-5, 0, 0], [-5, 0, 0], [-5, 0.999999, 0]],
        [[1, 0, 0], [1, 0, 0], [1, 0, 0], [1, 0, 0], [0, 0, 0], [np.nan, 0, 0], [1, 0, 0]],
        [1.0],
    )
    whole = 16 / 15  # the integral of (1 - u^2)^2 over [-1, 1]
    np.testing.assert_allclose(found, [whole, 0, whole / 2, 0, 0, 0, 0], atol=1e-7)
    # Behind a camera's eye is nothing.
    p = gb.Particles([[0, 0, 0], [0, 0, 10.0]], support=1.0)
    camera = gb.Camera((0, 0, 5), (0, 0, 0), height=0.1)
    both = gb.measure.project(p, camera, "thickness", (1, 1), volume=1.0, **backend)
    first = gb.measure.project(gb.Scene(p[0], **backend), camera, "thickness", (1, 1), volume=1.0, **backend)
    assert both["thickness"] == first["thickness"] > 0
    exact = {"murakami": 32 * np.pi / 105, "nishimura": 16 * np.pi / 81, "cubic_spline": np.pi / 8,
             "wendland_c2": 2 * np.pi / 21, "solid": 32 * np.pi / 315}  # fmt: skip
    for kernel, volume in exact.items():
        assert kernel_volume(kernel) == pytest.approx(volume, rel=1e-6)


def galaxy(n: int = 3000) -> gb.Particles:
    """A disk with supports over a decade, masses and densities of other units."""
    rng = np.random.default_rng(11)
    radius, turn = rng.exponential(1.0, n), rng.uniform(0, 2 * np.pi, n)
    positions = np.stack([radius * np.cos(turn), radius * np.sin(turn), rng.normal(0, 0.05, n)], 1)
    p = gb.Particles(positions, support=rng.uniform(0.05, 0.5, n))
    p.attributes["mass"] = rng.uniform(0.5, 1.5, n) * 1e33
    p.attributes["density"] = rng.uniform(0.5, 1.5, n) * 1e-24
    p.attributes["temperature"] = rng.uniform(1e4, 1e6, n)
    p.attributes["velocity"] = rng.normal(size=(n, 3))
    return p


def total(found: gb.measure.Samples, name: str, *component: int) -> float:
    values = found[name].astype(np.float64)[(..., *component)]
    return float(values.sum()) * np.prod(np.linalg.norm(found.steps, axis=1))


@pytest.mark.few_backends
@pytest.mark.parametrize("kernel", every(3, KERNELS))
@pytest.mark.parametrize("axis", [(0, 0, 1), (-1, 0, 0), (1, 2, -2)])
def test_masses_add_up(kernel, axis, backend):
    p = galaxy()
    found = gb.measure.project(p, gb.measure.SamplePlane(axis, spacing=0.05), kernel=kernel, **backend)
    assert total(found, "density") == pytest.approx(p.attributes["mass"].sum(), rel=1e-3)


def test_values_supports_below_a_pixel_and_units(backend):
    p = galaxy()
    for spacing in (0.4, 1.0):
        found = gb.measure.project(p, gb.measure.SamplePlane((0, 0, 1), spacing=spacing), **backend)
        assert total(found, "density") == pytest.approx(p.attributes["mass"].sum(), rel=1e-3)
    for unit_of_length in (1e-9, 1e15):
        p = galaxy(300)
        p.positions *= np.float32(unit_of_length)
        p.support *= np.float32(unit_of_length)
        plane = gb.measure.SamplePlane((0, 0, 1), spacing=0.05 * unit_of_length)
        found = gb.measure.project(p, plane, volume=1e3, values="thickness", **backend)
        assert total(found, "thickness") == pytest.approx(300 * 1e3, rel=2e-3)
    p = galaxy(500)
    found = gb.measure.project(p, values=["density", "thickness", "temperature", "velocity"], **backend)
    assert found["velocity"].shape == (*found.shape, 3)
    volume = p.attributes["mass"] / p.attributes["density"]
    heat, flow = p.attributes["temperature"], p.attributes["velocity"][:, 1]
    assert total(found, "thickness") == pytest.approx(volume.sum(), rel=1e-3)
    assert total(found, "temperature") == pytest.approx((volume * heat).sum(), rel=1e-3)
    assert total(found, "velocity", 1) == pytest.approx((volume * flow).sum(), rel=1e-2)
    one = gb.measure.project(p, values="temperature", volume=2.0, **backend)
    assert total(one, "temperature") == pytest.approx(2 * heat.sum(), rel=1e-3)
    positions, box = 0.1 * lattice(30, 30, 8), ((-0.5, -0.5, 0), (0.5, 0.5, 0))
    found = gb.measure.project(positions, gb.measure.SamplePlane((0, 0, 1), 0, 0.013, box), "thickness", **backend)
    np.testing.assert_allclose(found["thickness"], 0.8, rtol=0.02)
    assert found["thickness"].mean() == pytest.approx(0.8, rel=0.015)


def test_camera_sees_what_parallel_lines_see(backend):
    """An orthographic camera, and a far one: the same picture as the plane's, the right way up."""
    p = galaxy(400)
    p.positions[:, 0] *= 2
    camera = gb.Camera((0, 0, 50), (0, 0, 0), (0, 1, 0), height=6.0)
    found = gb.measure.project(p, camera, size=(60, 40), **backend)
    assert found["density"].shape == (40, 60)
    np.testing.assert_allclose(found.points[0, 0], (-4.425, 2.925, 0), atol=1e-5)
    np.testing.assert_allclose(found.points[20, 40, :2], (found.coords["u"][40], -0.075), atol=1e-5)
    box = ((-4.425, -2.925, 0), (4.43, 2.93, 0))
    scene = gb.Scene(p, kernel="cubic_spline", device="cpu")
    plane, values = gb.measure.SamplePlane((0, 0, 1), 0, 0.15, box), np.ones(len(p), np.float32)
    points = plane.lattice(scene).points().reshape(-1, 3)
    down = np.broadcast_to(np.float32([0, 0, -1]), points.shape)
    truth = scene.integrate(points + np.float32([0, 0, 50]), down, values).reshape(40, 60)
    there, flat = gb.Scene(p, kernel="cubic_spline", **backend), found.points.reshape(-1, 3)
    here = there.integrate(flat + np.float32([0, 0, 50]), down, values).reshape(40, 60)
    np.testing.assert_allclose(here[::-1], truth, atol=2e-4 * truth.max())
    far = gb.Camera((0, 0, 4000), (0, 0, 0), (0, 1, 0), fov=2 * np.degrees(np.arctan(3 / 4000)))
    distant, scale = gb.measure.project(p, far, size=(60, 40), **backend), found["density"].max()
    np.testing.assert_allclose(distant["density"] / scale, found["density"] / scale, atol=0.01)


@pytest.mark.parametrize(("arguments", "message"), [
    ({"values": "speed"}, "values: expected one of thickness, x,.*got speed"),
    ({"values": "density"}, "values: expected one of"), ({"view": "z"}, "view: expected three numbers"),
    ({"view": (0, 0, 0)}, "view: expected a direction"), ({"volume": -1}, "volume: expected a number or"),
    ({"volume": "one"}, "volume: expected a number or"), ({"kernel": "gauss"}, "kernel: expected one of murakami"),
    ({"view": gb.Camera((0, 0, 5), (0, 0, 0)), "size": 3}, "size: expected"),
])  # fmt: skip
def test_refused(arguments, message):
    p, given = gb.Particles(cloud(20), support=0.5), {"values": "thickness", **arguments}
    with pytest.raises((TypeError, ValueError), match=message):
        gb.measure.project(p, device="cpu", **given)


def test_integrate_refused():
    scene = gb.Scene(cloud(20), support=0.5, device="cpu")
    for origins, directions, values, message in (
        ([[0, 0, 0]], [[1, 0, 0], [0, 1, 0]], np.ones(20), "directions: expected 1 rows"),
        ([[0, 0, 0]], [[2, 0, 0]], np.ones(20), "directions: expected unit vectors"),
        ([[0, 0, 0]], [[1, 0, 0]], np.ones(19), "values: expected 20 rows, got 19"),
        ([0, 0, 0], [[1, 0, 0]], np.ones(20), "origins: expected shape"),
    ):
        with pytest.raises(ValueError, match=message):
            scene.integrate(origins, directions, values)
