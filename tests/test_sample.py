"""Samples of a scene: places, values against the float64 oracle, files read back by others."""

import csv
import warnings

import globule as gb
import numpy as np
import oracle
import pytest
from format_helpers import by_vtk
from globule._base.checks import MissingPackageError
from scenes import lattice

POSITIONS = lattice(6, 5, 4, 0.1)


def particles() -> gb.Particles:
    p = gb.Particles(POSITIONS, support=2.0)
    p.attributes["height"] = POSITIONS[:, 2].astype(np.float64)
    p.attributes["velocity"] = np.stack([POSITIONS[:, 0], 2 + 0 * POSITIONS[:, 0]], axis=1)
    return p


def blended(points: np.ndarray, values: np.ndarray) -> np.ndarray:
    x = ((points[:, None] - POSITIONS[None]).astype(np.float64) ** 2).sum(2) / 4
    w = np.where(x < 1, (1 - x) ** 2, 0)
    with np.errstate(invalid="ignore"):
        return (w @ values) / w.sum(1)


PLACES = {
    "plane": gb.measure.SamplePlane((0, 0, 2), 0.5, spacing=0.3),
    "line": gb.measure.SampleLine((-4, 0.1, 0), (4, 0.1, 0.2), 50),
    "grid": gb.measure.SampleGrid(0.7),
    "points": np.random.default_rng(0).uniform(-4, 4, (40, 3)),
}


@pytest.mark.parametrize("where", PLACES.values(), ids=PLACES)
def test_values_are_the_oracle_s(where, backend):
    scene = gb.Scene(particles(), **backend)
    found = gb.measure.sample(scene, where, ["field", "inside", "gradient", "height", "velocity", "x"])
    points = found.points.reshape(-1, 3)
    field, gradient = oracle.field(POSITIONS, 2.0, 1.0, "murakami", points)
    np.testing.assert_allclose(found["field"].ravel(), field, atol=1e-6)
    np.testing.assert_allclose(found["gradient"].reshape(-1, 3), gradient, atol=1e-5)
    apart = np.abs(field - 0.6) > 1e-5
    assert apart.any()
    assert (found["inside"].ravel() == (field >= 0.6))[apart].all()
    heights = blended(points, POSITIONS[:, 2].astype(np.float64))
    np.testing.assert_allclose(found["height"].ravel(), heights, atol=2e-5)
    assert np.isnan(heights).any() == np.isnan(found["height"]).any()
    assert found["velocity"].shape == (*found.shape, 2)
    known = np.isfinite(heights)
    np.testing.assert_allclose(found["velocity"].reshape(-1, 2)[known, 1], 2, atol=1e-6)
    np.testing.assert_array_equal(found["x"].ravel()[known], found["velocity"][..., 0].ravel()[known])


def test_places_and_values_that_are_not_finite(folder):
    scene = gb.Scene(particles(), device="cpu")
    lo, hi = (np.array(c, np.float64) for c in scene.particles.bounds())
    plane = gb.measure.sample(scene, PLACES["plane"], "field")
    assert plane.dims == ("v", "u")
    assert np.all(plane.points[..., 2] == np.float32(0.25))
    np.testing.assert_allclose(plane.points[0, :, 0], plane.coords["u"], atol=1e-6)
    np.testing.assert_allclose(plane.points[:, 0, 1], plane.coords["v"], atol=1e-6)
    np.testing.assert_allclose(plane.points[0, 0, :2], lo[:2] - 2, atol=1e-6)
    assert (plane.points[-1, -1, :2] <= hi[:2] + 2).all()
    assert (plane.points[-1, -1, :2] > hi[:2] + 2 - 0.3).all()
    grid = gb.measure.sample(scene, gb.measure.SampleGrid(0.5, ((0, 0, 0), (1, 0.5, 2))), "field")
    assert (grid.shape, grid.dims) == ((5, 2, 3), ("z", "y", "x"))
    np.testing.assert_allclose(grid.points[4, 1, 2], (1, 0.5, 2))
    line = gb.measure.sample(scene, PLACES["line"], "field")
    np.testing.assert_allclose(line.points[[0, -1]], [(-4, 0.1, 0), (4, 0.1, 0.2)], atol=1e-6)
    np.testing.assert_allclose(np.diff(line.coords["s"]).sum(), np.hypot(8, 0.2))
    for normal in ((1, 0, 0), (0, 1, 0), (0, -1, 0), (1, 2, 3), (-3, 1, 0)):
        oblique = gb.measure.SamplePlane(normal, 0.4, 0.2).lattice(scene)
        length = np.linalg.norm(normal)
        np.testing.assert_allclose(oblique.points() @ normal, 0.4, atol=2e-6 * length)
        np.testing.assert_allclose(oblique.steps @ oblique.steps.T, 0.04 * np.eye(2), atol=1e-12)
    default = gb.measure.SamplePlane((0, 1, 0)).lattice(scene)
    assert np.linalg.norm(default.steps[0]) == pytest.approx(scene.spacing / 2)
    np.testing.assert_array_equal(np.sign(default.steps), [[0, 0, 1], [1, 0, 0]])
    p = particles()
    p.attributes["pressure"] = 101_325 + POSITIONS[:, 2].astype(np.float64)
    points = np.float32([[0.1, 0.2, 0.3], [1, 1, 1]])
    truth = blended(points, p.attributes["pressure"])
    np.testing.assert_allclose(
        gb.measure.sample(gb.Scene(p, device="cpu"), points, "pressure")["pressure"], truth, atol=0.01
    )
    p = particles()
    p.attributes["velocity"][:, 1] = np.nan
    p.attributes["height"][0] = np.inf
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = gb.measure.sample(p, POSITIONS[[0, 119]], device="cpu")
    assert np.isnan(found["velocity"][:, 1]).all()
    assert np.isfinite(found["velocity"][:, 0]).all()
    assert found["height"][0] == np.inf
    assert np.isfinite(found["height"][1])
    gb.write("few.vtk", particles())
    for source in (particles(), "few.vtk"):
        found = gb.measure.sample(source, [[0, 0, 0], [9, 9, 9]], device="cpu")
        assert [*found.values] == ["field", "inside", "height", "velocity"]
        assert found["inside"].tolist() == [True, False]
    assert gb.measure.sample(POSITIONS, [[0, 0, 0]])["inside"].all()
    none = gb.Particles(np.empty((0, 3)))
    found = gb.measure.sample(none, [[0, 0, 0]], "field", device="cpu")
    assert found["field"].tolist() == [0]
    with pytest.raises(ValueError, match="bounds: expected a finite position"):
        gb.measure.sample(none, gb.measure.SampleGrid(1), device="cpu")


@pytest.mark.parametrize("where", PLACES.values(), ids=PLACES)
def test_tables(where, folder):
    found = gb.measure.sample(particles(), where, device="cpu")
    found.save("a.csv")
    with open("a.csv", encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert [*rows[0]] == ["x", "y", "z", "field", "inside", "height", "velocity:0", "velocity:1"]
    for name, column in found.columns().items():
        read = np.array([float(row[name]) for row in rows]).astype(np.float32)
        np.testing.assert_array_equal(read, column.astype(np.float32))
    found.save("a.npz")
    with np.load("a.npz") as arrays:
        np.testing.assert_array_equal(arrays["points"], found.points)
        for name, array in found.values.items():
            np.testing.assert_array_equal(arrays[name], array)


@pytest.mark.parametrize("where", PLACES.values(), ids=PLACES)
def test_vtk(where, folder):
    pytest.importorskip("vtk")
    from vtkmodules.util.numpy_support import vtk_to_numpy

    found = gb.measure.sample(particles(), where, device="cpu")
    if len(found.dims) < 3:
        found.save("a.vtp")
        data = by_vtk("a.vtp")
        points = vtk_to_numpy(data.GetPoints().GetData())
        np.testing.assert_array_equal(points, found.points.reshape(-1, 3))
        cells = (data.GetNumberOfVerts(), data.GetNumberOfLines(), data.GetNumberOfPolys())
        n = np.prod([n - 1 for n in found.shape])
        assert cells == {"point": (len(points), 0, 0), "s": (0, 1, 0), "v": (0, 0, n)}[found.dims[0]]
    if len(found.dims) < 2 or found.dims == ("point",):
        with pytest.raises(ValueError, match=r"use \.vtp"):
            found.save("a.vti")
    else:
        found.save("a.vti")
        data = by_vtk("a.vti")
        for i in (0, data.GetNumberOfPoints() // 3, data.GetNumberOfPoints() - 1):
            np.testing.assert_allclose(data.GetPoint(i), found.points.reshape(-1, 3)[i], atol=1e-5)
    for name in ("field", "velocity", "inside"):
        array, d = vtk_to_numpy(data.GetPointData().GetArray(name)), len(found.dims)
        np.testing.assert_array_equal(array, found[name].reshape(-1, *found[name].shape[d:]))


@pytest.mark.parametrize("where", PLACES.values(), ids=PLACES)
def test_xarray(where):
    xarray = pytest.importorskip("xarray")
    found = gb.measure.sample(particles(), where, device="cpu")
    data = found.to_xarray()
    assert isinstance(data, xarray.Dataset)
    assert data["field"].dims == found.dims
    np.testing.assert_array_equal(data["field"], found["field"])
    np.testing.assert_array_equal(data["velocity"], found["velocity"])
    if len(found.dims) < 3:
        np.testing.assert_array_equal(data["z"], found.points[..., 2])
    else:
        np.testing.assert_allclose(data["z"], found.points[:, 0, 0, 2], atol=1e-6)


def test_without_xarray(monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "xarray", None)
    with pytest.raises(MissingPackageError, match=r"globule\[measure\]"):
        gb.measure.sample(particles(), [[0, 0, 0]], device="cpu").to_xarray()


@pytest.mark.parametrize(("where", "values", "message"), [
    (None, None, "where: expected a SamplePlane, SampleLine, SampleGrid or points"),
    ([1, 2, 3], None, "where: expected a SamplePlane"), ("plane", None, "where: expected a SamplePlane"),
    ([[0, 0, np.nan]], None, "where: expected finite points"),
    ([[0, 0, 0]], "warmth", "values: expected one of field, inside, gradient, x,.*got warmth"),
    ([[0, 0, 0]], "velocity:2", "values: expected velocity:0 to velocity:1"),
    ([[0, 0, 0]], [], "values: expected at least one name"),
    ([[0, 0, 0]], 3, "values: expected names, got 3"), ([[0, 0, 0]], [None], "values: expected names"),
    (gb.measure.SampleGrid(1e-4), None, "spacing: expected one that makes at most .*try 0.0"),
    (gb.measure.SamplePlane((0, 0, 1), 0, 1e-9), None, "spacing: expected one that makes at most"),
    (lambda: gb.measure.SamplePlane((0, 0, 0)), None, "normal: expected a direction"),
    (lambda: gb.measure.SamplePlane((0, 0, 1), np.nan), None, "offset: expected a finite number"),
    (lambda: gb.measure.SamplePlane((0, 0, 1), 0, -1), None, "spacing: expected a positive number"),
    (lambda: gb.measure.SamplePlane((0, 0, 1), box=((1, 0, 0), (0, 1, 1))), None, "box: expected two finite"),
    (lambda: gb.measure.SampleLine((0, 0, 0), (0, 0, 0)), None, "end: expected another point"),
    (lambda: gb.measure.SampleLine((0, 0, 0), (0, 0, 1), 1), None, "n: expected 2 to"),
    (lambda: gb.measure.SampleGrid(0), None, "spacing: expected a positive number"),
    (lambda: gb.measure.SampleGrid(1, "box"), None, "box: expected two finite corners"),
])  # fmt: skip
def test_refused(where, values, message):
    with pytest.raises((TypeError, ValueError), match=message):
        gb.measure.sample(particles(), where() if callable(where) else where, values, device="cpu")


def test_refused_files(folder):
    found = gb.measure.sample(particles(), [[0, 0, 0]], device="cpu")
    for path in ("a.txt", "a", "no/such.csv"):
        with pytest.raises((ValueError, OSError)):
            found.save(path)
    with pytest.raises(TypeError, match="path: expected a path"):
        found.save(3)
    p = gb.Particles(POSITIONS, attributes={"points": POSITIONS[:, 0]})
    with pytest.raises(ValueError, match="named points"):
        gb.measure.sample(p, [[0, 0, 0]], "points", device="cpu").save("a.npz")
    assert not list(folder.iterdir())
