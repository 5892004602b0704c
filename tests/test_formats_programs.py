"""Files of VTK, meshio and plyfile, and of other people's simulations."""

import numpy as np
import pytest
from format_helpers import DATA, N, assert_same, by_vtk, sample, vtk_write
from globule import formats
from globule.data.particles import Particles


@pytest.mark.parametrize(
    ("name", "n", "attributes"),
    [
        ("splash_117649.npz", 117_649, {"velocities", "density"}),
        ("bunny_frame_14_7705_particles.vtk", 7_706, {"id", "velocity"}),
        ("dam_break_frame_23_24389_particles.bgeo", 24_389, set()),
        ("double_dam_break_frame_01_4732_particles.vtk", 4_732, {"id", "velocity"}),
        ("double_dam_break_frame_26_4732_particles.vtk", 4_732, {"id", "velocity"}),
        ("fluid_250_particles.vtu", 250, {"velocity", "pressure", "density", "index"}),
        ("fluid_encoded_250_particles.vtu", 250, {"velocity", "pressure", "density", "index"}),
        ("hilbert2_18856_particles.vtk", 18_856, {"id"}),
    ],
)
def test_data_files(name, n, attributes):
    if not (DATA / name).exists():
        pytest.skip(f"no {DATA / name}")
    p = formats.read(DATA / name)
    assert len(p) == n
    assert set(p.attributes) == attributes
    assert np.isfinite(p.positions).all()
    for key in ("id", "index"):
        if key in attributes:
            assert len(np.unique(p.attributes[key])) == n
    if "encoded" in name:
        assert_same(formats.read(DATA / name.replace("_encoded", "")), p)


def vtk_points(kind: str):
    from vtkmodules.util.numpy_support import numpy_to_vtk
    from vtkmodules.vtkCommonCore import vtkPoints
    from vtkmodules.vtkCommonDataModel import vtkCellArray, vtkPolyData, vtkUnstructuredGrid

    p = sample()
    points = vtkPoints()
    points.SetData(numpy_to_vtk(p.positions, deep=True))
    cells = vtkCellArray()
    for i in range(N):
        cells.InsertNextCell(1, [i])
    grid = vtkPolyData() if kind == "poly" else vtkUnstructuredGrid()
    grid.SetPoints(points)
    if kind == "poly":
        grid.SetVerts(cells)
    else:
        grid.SetCells(1, cells)
    arrays = {"support": p.support, "color": p.color, **p.attributes}
    for name, values in arrays.items():
        array = numpy_to_vtk(values, deep=True)
        array.SetName(name)
        grid.GetPointData().AddArray(array)
    grid.GetPointData().SetActiveScalars("density")
    grid.GetPointData().SetActiveVectors("velocity")
    return grid


def assert_vtk_same(p: Particles) -> None:
    """VTK writes the active arrays first."""
    fields = vars(sample())
    fields["attributes"] = {name: fields["attributes"][name] for name in p.attributes}
    assert_same(p, Particles(**fields))


@pytest.mark.parametrize("kind", ["poly", "grid"])
@pytest.mark.parametrize("binary", [False, True])
@pytest.mark.parametrize("version", [42, 51])
@pytest.mark.interop
def test_vtk_writes_legacy(kind, binary, version, tmp_path):
    pytest.importorskip("vtk")
    from vtkmodules.vtkIOLegacy import vtkPolyDataWriter, vtkUnstructuredGridWriter

    writer = vtkPolyDataWriter() if kind == "poly" else vtkUnstructuredGridWriter()
    writer.SetFileVersion(version)
    writer.SetFileType(2 if binary else 1)
    vtk_write(writer, tmp_path / "p.vtk", vtk_points(kind))
    p = formats.read(tmp_path / "p.vtk")
    expected = sample()
    if not binary:  # VTK prints few digits
        assert np.allclose(p.positions, expected.positions, atol=1e-5)
        assert np.array_equal(p.attributes["id"], expected.attributes["id"])
        assert np.allclose(p.attributes["velocity"], expected.attributes["velocity"], atol=1e-5)
    else:
        assert_vtk_same(p)


@pytest.mark.parametrize("kind", ["poly", "grid"])
@pytest.mark.parametrize("variant", [
    "None", "None big-endian 64", "ZLib", "ZLib blocks", "LZ4 blocks", "LZMA blocks",
])  # fmt: skip
@pytest.mark.interop
def test_vtk_writes_xml(kind, variant, tmp_path):
    pytest.importorskip("lz4" if "LZ4" in variant else "vtk")
    pytest.importorskip("vtk")
    from vtkmodules.vtkIOXML import vtkXMLPolyDataWriter, vtkXMLUnstructuredGridWriter

    path = tmp_path / ("p.vtp" if kind == "poly" else "p.vtu")
    for mode in ("ascii", "binary", "appended raw", "appended base64"):
        writer = vtkXMLPolyDataWriter() if kind == "poly" else vtkXMLUnstructuredGridWriter()
        writer.SetDataMode(["ascii", "binary", "appended"].index(mode.split()[0]))
        writer.SetEncodeAppendedData(mode.endswith("base64"))
        writer.SetHeaderTypeToUInt32()
        getattr(writer, f"SetCompressorTypeTo{variant.split()[0]}")()
        if "blocks" in variant:
            writer.SetBlockSize(64)
        if "big-endian 64" in variant:
            writer.SetByteOrderToBigEndian()
            writer.SetHeaderTypeToUInt64()
        vtk_write(writer, path, vtk_points(kind))
        assert_vtk_same(formats.read(path))


@pytest.mark.parametrize("extension", [".vtk", ".vtp", ".vtu"])
@pytest.mark.interop
def test_vtk_reads(extension, tmp_path):
    pytest.importorskip("vtk")
    from vtkmodules.util.numpy_support import vtk_to_numpy

    p = sample()
    formats.write(tmp_path / f"p{extension}", p)
    output = by_vtk(tmp_path / f"p{extension}")
    assert output.GetNumberOfCells() == N
    assert output.GetCell(7).GetPointId(0) == 7
    assert np.array_equal(vtk_to_numpy(output.GetPoints().GetData()), p.positions)
    for name, array in {"support": p.support, **p.attributes}.items():
        values = vtk_to_numpy(output.GetPointData().GetArray(name))
        assert np.array_equal(values.reshape(array.shape), array)


@pytest.mark.parametrize("binary", [False, True])
@pytest.mark.parametrize("extension", [".vtu", ".vtk", ".ply"])
@pytest.mark.interop
def test_meshio_writes(extension, binary, tmp_path):
    meshio = pytest.importorskip("meshio")
    p = sample()
    cells = [("vertex", np.arange(N)[:, None])] if extension != ".ply" else []
    data = {"density": p.attributes["density"], "velocity": p.attributes["velocity"]}
    mesh = meshio.Mesh(p.positions, cells, point_data={} if extension == ".ply" else data)
    mesh.write(tmp_path / f"p{extension}", binary=binary)
    read = formats.read(tmp_path / f"p{extension}")
    assert np.array_equal(read.positions, p.positions)
    if extension != ".ply":
        assert np.array_equal(read.attributes["velocity"], p.attributes["velocity"])


@pytest.mark.parametrize("order", ["<", ">", "ascii"])
@pytest.mark.interop
def test_plyfile_agrees(order, tmp_path):
    plyfile = pytest.importorskip("plyfile")
    rows = np.zeros(5, [("x", "f4"), ("y", "f4"), ("z", "f8"), ("q", "u2"), ("red", "u1")])
    rows["x"], rows["q"], rows["z"] = np.arange(5) / 3, np.arange(5), 0.25
    faces = np.empty(2, [("vertex_indices", "i4", (3,))])
    faces["vertex_indices"] = [[0, 1, 2], [2, 3, 4]]
    elements = [plyfile.PlyElement.describe(faces, "face"), plyfile.PlyElement.describe(rows, "vertex")]
    ascii = order == "ascii"
    data = plyfile.PlyData(elements, text=ascii, byte_order="=" if ascii else order)
    data.write(str(tmp_path / "p.ply"))
    p = formats.read(tmp_path / "p.ply")
    assert np.array_equal(p.positions[:, 0], rows["x"])
    assert np.all(p.positions[:, 2] == 0.25)
    assert np.array_equal(p.attributes["q"], rows["q"])
    assert p.attributes["q"].dtype == np.uint16

    formats.write(tmp_path / "q.ply", sample())
    vertices = plyfile.PlyData.read(str(tmp_path / "q.ply"))["vertex"]
    assert np.array_equal(vertices["vy"], sample().attributes["velocity"][:, 1])
    assert np.array_equal(vertices["support"], sample().support)


def test_ply_colors_are_bytes_where_exact(tmp_path):
    formats.write(tmp_path / "p.ply", Particles(np.eye(3), color=np.uint8([[0, 7, 255]] * 3)))
    assert b"property uchar green" in (tmp_path / "p.ply").read_bytes()
    assert np.array_equal(formats.read(tmp_path / "p.ply").color[0], np.float32([0, 7, 255]) / 255)
