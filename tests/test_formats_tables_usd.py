"""Parquet, Arrow and USD: their own libraries as the other side, and links."""

from pathlib import Path

import globule as gb
import numpy as np
import pytest
from cli_helpers import refuses
from globule.data.particles import Particles
from globule.formats import FormatError, read_contents

N = 30
RNG = np.random.default_rng(11)
X = RNG.random((N, 3)).astype(np.float32)


@pytest.fixture
def arrow():
    return pytest.importorskip("pyarrow")


@pytest.fixture
def usd():
    return pytest.importorskip("pxr.Usd")


@pytest.mark.slow
def test_parquet_of_pandas_with_a_map_of_columns(tmp_path, arrow):
    import pyarrow.parquet as pq

    rho = arrow.array([None if i == 3 else 900.0 + i for i in range(N)])
    table = arrow.table({
        "lon": X[:, 0], "lat": X[:, 1], "depth": X[:, 2], "rho": rho,
        "name": [f"p{i}" for i in range(N)], "fast": arrow.array([i % 2 == 0 for i in range(N)]),
    })  # fmt: skip
    path = tmp_path / "run.parquet"
    pq.write_table(table, path, compression="gzip", row_group_size=7)
    refuses(r"expected columns x, y and z, got 'lon, .*--columns x", gb.read, path, error=FormatError)
    named = {"x": "lon", "y": "lat", "z": "depth", "density": "rho"}
    particles = gb.read(path, columns=named)
    assert np.array_equal(particles.positions, X)
    assert set(particles.attributes) == {"density"}
    density = particles.attributes["density"]
    assert np.isnan(density[3])
    assert np.array_equal(np.delete(density, 3), 900 + np.delete(np.arange(N), 3))
    refuses("expected the column 'u'", gb.read, path, columns={**named, "h": "u"}, error=FormatError)
    refuses("frame: expected no such option", gb.read, path, frame=1)


def test_arrow_lists_units_and_what_pyarrow_reads_of_ours(tmp_path, arrow):
    from pyarrow import feather

    lists = arrow.FixedSizeListArray.from_arrays(arrow.array(X.ravel()), 3)
    unit = {"unit": "m"}
    schema = arrow.schema([arrow.field("Position", lists.type, metadata=unit),
                           arrow.field("h", arrow.float32(), metadata=unit)])  # fmt: skip
    h = np.full(N, 0.1, np.float32)
    path = tmp_path / "a.arrow"
    table = arrow.table([lists, arrow.array(h)], schema=schema)
    feather.write_feather(table, path)  # lz4
    contents = read_contents(path)
    assert np.array_equal(contents.particles.positions, X)
    assert np.allclose(contents.particles.support, 0.2)
    assert contents.units["h"] == "m"
    gb.write(tmp_path / "b.parquet", Particles(X, attributes={"velocity": -X}))
    import pyarrow.parquet as pq

    theirs = pq.read_table(tmp_path / "b.parquet")
    assert theirs.column_names == ["x", "y", "z", "vx", "vy", "vz"]
    assert np.array_equal(theirs["vz"].to_numpy(), -X[:, 2])
    ragged = arrow.array([[0.0, 1, 2]] * (N - 1) + [[0.0, 1, 2, 3]])
    feather.write_feather(arrow.table({"positions": ragged}), path)
    refuses("rows of the same length in the column positions", gb.read, path)


def _stage(path: Path, usd) -> None:
    from pxr import Gf, UsdGeom, Vt

    stage = usd.Stage.CreateNew(str(path))
    stage.SetTimeCodesPerSecond(50)
    UsdGeom.SetStageMetersPerUnit(stage, 0.01)
    UsdGeom.Xform.Define(stage, "/World").AddTranslateOp().Set(Gf.Vec3d(1, 2, 3))
    points = UsdGeom.Points.Define(stage, "/World/fluid")
    points.AddScaleOp().Set(Gf.Vec3f(2, 2, 2))
    for step in range(3):
        points.CreatePointsAttr().Set(Vt.Vec3fArray.FromNumpy(X + step), 5 * step)
    points.CreateWidthsAttr([0.1])
    points.CreateVelocitiesAttr(Vt.Vec3fArray.FromNumpy(X))
    points.CreateDisplayColorAttr([(0.5, 0.25, 1)])
    beads = UsdGeom.PointInstancer.Define(stage, "/World/beads")
    beads.CreatePositionsAttr([(0, 0, 0), (1, 0, 0)])
    beads.CreateIdsAttr([7, 9])
    stage.GetRootLayer().Save()


@pytest.mark.parametrize("ending", [".usda", ".usdc"])
def test_usd_of_its_own_library(tmp_path, usd, ending):
    path = tmp_path / f"scene{ending}"
    _stage(path, usd)
    got = read_contents(path, frame=-1, species="/World/fluid")
    assert np.allclose(got.particles.positions, 2 * (X + 2) + (1, 2, 3), atol=1e-5)
    assert np.allclose(got.particles.support, 2 * 0.2)  # four radii, of a prim scaled by two
    assert np.allclose(got.particles.attributes["velocity"], 2 * X)
    assert np.allclose(got.particles.color, (0.5, 0.25, 1))
    assert (got.time, got.n_frames, got.units["positions"]) == (0.2, 3, "0.01 m")
    beads = gb.read(path, species="/World/beads")
    assert np.array_equal(beads.positions, [[1, 2, 3], [2, 2, 3]])
    assert beads.attributes["id"].tolist() == [7, 9]
    both = gb.read(path)
    assert len(both) == N + 2
    assert "velocity" not in both.attributes  # the beads have none
    refuses(r"frame: expected -3 to 2 for .*, got 3", gb.read, path, frame=3)
    refuses(r"species: expected one of .*/World/fluid.* got 'water'", gb.read, path, species="water")


def test_usd_points_that_their_prims_move(tmp_path, usd):
    """Points without times of their own have those of the transforms above them."""
    from pxr import Gf, UsdGeom

    path = tmp_path / "a.usda"
    _stage(path, usd)
    stage = usd.Stage.Open(str(path))
    stage.GetPrimAtPath("/World/fluid").SetActive(False)
    move = UsdGeom.Xformable(stage.GetPrimAtPath("/World")).GetOrderedXformOps()[0]
    for step in range(2):
        move.Set(Gf.Vec3d(step, 0, 0), 10 * step)
    stage.GetRootLayer().Save()
    got = read_contents(path, frame=1)
    assert (got.time, got.n_frames) == (0.2, 2)
    assert np.array_equal(got.particles.positions, [[1, 0, 0], [2, 0, 0]])
    stage.GetPrimAtPath("/World/fluid").SetActive(True)
    stage.GetRootLayer().Save()
    assert read_contents(path).n_frames == 3  # of the points alone


def test_usd_library_reads_ours(tmp_path, usd):
    from pxr import UsdGeom

    gb.write(tmp_path / "a.usd", Particles(X, support=0.4, color=X, attributes={"id": np.arange(N)}))
    stage = usd.Stage.Open(str(tmp_path / "a.usd"))
    points = UsdGeom.Points(stage.GetDefaultPrim())
    assert np.array_equal(np.array(points.GetPointsAttr().Get()), X)
    assert np.allclose(points.GetWidthsAttr().Get(), 0.2)
    assert np.array_equal(np.array(points.GetDisplayColorAttr().Get()), X)
    assert list(points.GetIdsAttr().Get()) == list(range(N))
    with pytest.raises(ValueError, match=r"attributes\['2 b'\]: expected a name that USD allows"):
        gb.write(tmp_path / "b.usda", Particles(X, attributes={"2 b": np.arange(N)}))
    assert not (tmp_path / "b.usda").exists()


def test_usd_does_not_open_other_files(tmp_path, usd):
    gb.write(tmp_path / "other.usda", Particles(X))
    path = tmp_path / "links.usda"
    path.write_text(
        "#usda 1.0\n(subLayers = [@./other.usda@])\n"
        'def "a" (references = @./other.usda@</particles>)\n{}\n'
        'def "b" (payload = @./other.usda@</particles>)\n{}\ndef Points "c"\n'
        "{\n point3f[] points = [(1, 2, 3)]\n}\n"
    )
    assert np.array_equal(gb.read(path).positions, [[1, 2, 3]])
