"""Every particle format reads back what it wrote, and reads what other programs write."""

from __future__ import annotations

import gzip
import struct
from pathlib import Path

import numpy as np
import pytest
from globule import formats
from globule.files import atomic_write
from globule.formats import FormatError
from globule.particles import Particles

DATA = Path(__file__).resolve().parents[2] / "shared" / "data" / "particles"
FULL = [e for e in formats.EXTENSIONS if e not in (".txt", ".dat", ".npy")]
N = 40


def sample(n: int = N) -> Particles:
    rng = np.random.default_rng(7)

    def numbers(*shape: int) -> np.ndarray:
        return rng.random(shape, dtype=np.float32)

    return Particles(
        rng.normal(size=(n, 3)),
        support=numbers(n) + np.float32(0.1),
        color=numbers(n, 3),
        attributes={
            "velocity": numbers(n, 3),
            "density": 1000 * numbers(n),
            "id": np.arange(n)[::-1].copy(),
            "flags": np.arange(2 * n, dtype=np.uint8).reshape(n, 2),
            "thing": numbers(n, 1),
        },
    )


def assert_same(got: Particles, expected: Particles) -> None:
    assert np.array_equal(got.positions, expected.positions, equal_nan=True)
    for name in ("support", "weight", "color", "reflection", "refraction", "rigidity"):
        a, b = getattr(got, name), getattr(expected, name)
        assert (a is None) == (b is None), name
        if b is not None:
            assert np.array_equal(np.broadcast_to(a, np.shape(b)), b), name
    assert got.attributes.keys() == expected.attributes.keys()
    for name, array in expected.attributes.items():
        read = got.attributes[name]
        assert read.dtype.kind == array.dtype.kind or array.dtype.kind in "iub", name
        if read.shape != array.shape:  # some formats do not tell (N, 1) from (N,)
            assert array.shape == (len(got), 1) and read.shape == (len(got),), name
        assert np.array_equal(read.astype(array.dtype).reshape(array.shape), array), name
        assert read.flags.owndata or read.base.flags.owndata


@pytest.mark.parametrize("extension", FULL)
def test_round_trip(extension, tmp_path):
    path = tmp_path / f"p{extension}"
    formats.write(path, sample())
    assert_same(formats.read(path), sample())
    assert [file.name for file in tmp_path.iterdir()] == [path.name]


@pytest.mark.parametrize("extension", FULL)
def test_round_trip_of_positions_alone(extension, tmp_path):
    path = tmp_path / f"p{extension.upper()}"
    formats.write(path, Particles([[0.1, 2, np.nan], [1e-20, 5, 6], [7, 8, 9]]))
    assert_same(formats.read(path), Particles([[0.1, 2, np.nan], [1e-20, 5, 6], [7, 8, 9]]))


@pytest.mark.parametrize("extension", formats.EXTENSIONS)
def test_no_particles(extension, tmp_path):
    path = tmp_path / f"p{extension}"
    formats.write(path, Particles(np.empty((0, 3))))
    assert len(formats.read(path)) == 0


@pytest.mark.parametrize("extension", [e for e in FULL if e not in (".xyz", ".csv")])
def test_no_particles_with_attributes(extension, tmp_path):
    empty = sample()[:0]
    formats.write(tmp_path / f"p{extension}", empty)
    assert len(formats.read(tmp_path / f"p{extension}")) == 0


@pytest.mark.parametrize("extension", FULL)
def test_scalar_fields_survive(extension, tmp_path):
    particles = Particles(np.eye(3), support=0.5, weight=-2, color=(0.2, 0.4, 1), rigidity=0.25)
    path = tmp_path / f"p{extension}"
    formats.write(path, particles)
    read = formats.read(path)
    assert np.all(np.asarray(read.support) == 0.5)
    assert np.all(np.asarray(read.weight) == -2)
    assert np.array_equal(np.broadcast_to(read.color, (3, 3))[2], np.float32([0.2, 0.4, 1]))
    assert read.reflection is None
    assert isinstance(read.support, float) == (extension == ".npz")


@pytest.mark.parametrize("extension", [".vtk", ".vtp", ".vtu", ".npz"])
@pytest.mark.parametrize("dtype", ["i1", "u1", "i2", "u2", "i4", "u4", "i8", "u8", "f4", "f8"])
def test_dtypes_survive(extension, dtype, tmp_path):
    array = np.arange(6, dtype=dtype).reshape(3, 2)
    path = tmp_path / f"p{extension}"
    formats.write(path, Particles(np.eye(3), attributes={"a b%/&<\"'é": array}))
    read = formats.read(path).attributes["a b%/&<\"'é"]
    assert read.dtype == array.dtype and np.array_equal(read, array)


def test_npy_holds_positions(tmp_path):
    formats.write(tmp_path / "p.npy", sample())
    assert_same(formats.read(tmp_path / "p.npy"), Particles(sample().positions))


# Literal files: what each format looks like when somebody else wrote it.


def read_text(tmp_path: Path, name: str, content: str | bytes) -> Particles:
    path = tmp_path / name
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return formats.read(path)


def test_nine_columns(tmp_path):
    p = read_text(tmp_path, "p.txt", "2\n0.45 0.4 0.45 0.4 0.6 0.1 0.6 0.2 1\n1 2 3 0 0 0 0 0 0\n")
    assert np.allclose(p.positions, [[0.45, 0.4, 0.45], [1, 2, 3]])
    assert np.allclose(p.color[0], [0.4, 0.6, 0.1])
    assert np.allclose(p.reflection, [0.6, 0]) and np.allclose(p.refraction, [0.2, 0])
    assert np.allclose(p.rigidity, [1, 0]) and p.support is None
    formats.write(tmp_path / "q.dat", p)
    assert_same(formats.read(tmp_path / "q.dat"), p)


VTK_51 = """# vtk DataFile Version 5.1
written by hand
ASCII
DATASET POLYDATA
FIELD FieldData 1
TIME 1 1 double
0.5
POINTS 3 double
0 0 0 1 0 0
0 1 1e-1
METADATA
INFORMATION 1
NAME L2_NORM_RANGE LOCATION vtkDataArray
DATA 2 0 1.4

VERTICES 4 3
OFFSETS vtktypeint64
0 1 2 3
CONNECTIVITY vtktypeint64
0 1 2

CELL_DATA 3
SCALARS material int 1
LOOKUP_TABLE default
5 5 5
POINT_DATA 3
SCALARS density float
LOOKUP_TABLE mine
10 nan 30
LOOKUP_TABLE mine 1
1 0 0 1
VECTORS velocity double
1 2 3 4 5 6 7 8 9
COLOR_SCALARS tint 3
1 0 0  0 1 0  0 0 0.5
NORMALS n float
0 0 1 0 0 1 0 0 1
FIELD FieldData 2
two%20words 2 3 unsigned_char
1 2 3 4 5 6
METADATA
COMPONENT_NAMES
X
Y

h 1 3 float
0.25 0.25 0.5
"""


@pytest.mark.parametrize("newline", ["\n", "\r\n"])
def test_vtk_ascii_51(tmp_path, newline):
    p = read_text(tmp_path, "p.vtk", VTK_51.replace("\n", newline))
    assert np.allclose(p.positions, [[0, 0, 0], [1, 0, 0], [0, 1, 0.1]])
    assert list(p.attributes) == ["density", "velocity", "n", "two words", "h"]
    assert np.array_equal(p.attributes["density"], [10, np.nan, 30], equal_nan=True)
    assert p.attributes["velocity"].dtype == np.float64
    assert np.array_equal(p.attributes["velocity"][2], [7, 8, 9])
    assert np.array_equal(p.attributes["two words"], [[1, 2], [3, 4], [5, 6]])
    assert np.array_equal(p.color, np.float32([[1, 0, 0], [0, 1, 0], [0, 0, 0.5]]))
    assert np.array_equal(p.support, np.float32([0.5, 0.5, 1]))


def test_vtk_ascii_old_cells(tmp_path):
    p = read_text(
        tmp_path,
        "p.vtk",
        "# vtk DataFile Version 2.0\n\nascii\ndataset unstructured_grid\npoints 2 int\n"
        "1 2 3\n4 5 6\ncells 1 3\n2 0 1\ncell_types 1\n3\npoint_data 2\nscalars id int 1\n7 8",
    )
    assert np.array_equal(p.positions, [[1, 2, 3], [4, 5, 6]])
    assert np.array_equal(p.attributes["id"], [7, 8])


def vtu(data: str, head: str = "", n: int = 2, tail: str = "") -> str:
    return (
        f'<?xml version="1.0"?><VTKFile type="UnstructuredGrid" version="0.1" {head}>'
        f'<UnstructuredGrid><Piece NumberOfPoints="{n}" NumberOfCells="0"><Points>{data}</Points>'
        f"</Piece></UnstructuredGrid>{tail}</VTKFile>"
    )


def test_vtu_ascii_and_binary(tmp_path):
    import base64
    import zlib

    points = [[1, 2, 3], [4, 5, 6]]
    array = '<DataArray type="Float64" NumberOfComponents="3" format="{}">{}</DataArray>'
    p = read_text(tmp_path, "p.vtu", vtu(array.format("ascii", "\n1 2 3\n4 5 6\n")))
    assert np.array_equal(p.positions, points)
    raw = np.array(points, ">f8").tobytes()
    for text in (
        base64.b64encode(struct.pack(">I", 48) + raw),
        base64.b64encode(struct.pack(">I", 48)) + base64.b64encode(raw),
    ):
        text = array.format("binary", f"\n {text.decode()}\n")
        p = read_text(tmp_path, "p.vtu", vtu(text, 'byte_order="BigEndian"'))
        assert np.array_equal(p.positions, points)
    raw = np.array(points, "<f8").tobytes()
    packed = [zlib.compress(raw[:32]), zlib.compress(raw[32:])]
    sizes = struct.pack("<5Q", 2, 32, 16, *map(len, packed))
    text = base64.b64encode(sizes) + base64.b64encode(b"".join(packed))
    head = 'header_type="UInt64" compressor="vtkZLibDataCompressor"'
    p = read_text(tmp_path, "p.vtu", vtu(array.format("binary", text.decode()), head))
    assert np.array_equal(p.positions, points)


def test_vtp_pieces(tmp_path):
    piece = (
        '<Piece NumberOfPoints="{n}"><PointData><DataArray type="Int32" Name="id" format="ascii">'
        '{ids}</DataArray>{more}</PointData><Points><DataArray type="Float32" format="ascii" '
        'NumberOfComponents="3">{xyz}</DataArray></Points></Piece>'
    )
    only_here = '<DataArray type="Int8" Name="x" format="ascii">1</DataArray>'
    p = read_text(
        tmp_path,
        "p.vtp",
        '<VTKFile type="PolyData"><PolyData>'
        + piece.format(n=1, ids="5", more=only_here, xyz="1 2 3")
        + piece.format(n=0, ids="", more="", xyz="")
        + piece.format(n=2, ids="6 7", more="", xyz="4 5 6 7 8 9")
        + "</PolyData></VTKFile>",
    )
    assert np.array_equal(p.positions, np.arange(1, 10).reshape(3, 3))
    assert list(p.attributes) == ["id"] and np.array_equal(p.attributes["id"], [5, 6, 7])


def test_bgeo_of_houdini(tmp_path):
    """A file with an indexed string and a radius, plain and gzipped under the same extension."""
    head = struct.pack(">4sc9i", b"Bgeo", b"V", 5, 2, 0, 0, 0, 2, 0, 0, 0)
    head += struct.pack(">H4sHiiH1sH2s", 4, b"name", 1, 4, 2, 1, b"a", 2, b"bb")
    head += struct.pack(">H6sHif", 6, b"pscale", 1, 0, 0.0)
    points = struct.pack(">4fif", 1, 2, 3, 1, 0, 0.25) + struct.pack(">4fif", 4, 5, 6, 1, 1, 0.5)
    for content in (head + points + b"\x00\xff", gzip.compress(head + points + b"\x00\xff")):
        p = read_text(tmp_path, "p.bgeo", content)
        assert np.array_equal(p.positions, [[1, 2, 3], [4, 5, 6]])
        assert np.array_equal(p.attributes["name"], [0, 1])
        assert np.array_equal(p.attributes["pscale"], np.float32([0.25, 0.5]))
        assert np.array_equal(p.support, [1, 2])


PLY = """ply
format ascii 1.0
comment by hand
element face 1
property list uchar int vertex_indices
element vertex 2
property float x
property float y
property float z
property uchar red
property uchar green
property uchar blue
property int id
element edge 1
property int vertex1
end_header
3 0 1 1
1 2 3 255 0 51 7
4 5 6 0 255 0 8
0
"""


def test_ply_ascii(tmp_path):
    p = read_text(tmp_path, "p.ply", PLY)
    assert np.array_equal(p.positions, [[1, 2, 3], [4, 5, 6]])
    # A face makes it a mesh: bytes of colour are sRGB, supports are the longest edges.
    assert np.allclose(p.color, [[1, 0, 0.0331], [0, 1, 0]], atol=1e-4)
    assert np.allclose(p.support, 27**0.5)
    assert np.array_equal(p.attributes["id"], [7, 8])


def test_ply_big_endian_with_lists(tmp_path):
    header = (
        "ply\nformat binary_big_endian 1.0\nelement face 2\nproperty list uchar short v\n"
        "element vertex 1\nproperty double x\nproperty double y\nproperty list uchar int l\n"
        "property double z\nend_header\n"
    )
    faces = struct.pack(">B2hB", 2, 0, 1, 0)
    p = read_text(tmp_path, "p.ply", header.encode() + faces + struct.pack(">ddBid", 1, 2, 1, 9, 3))
    assert np.array_equal(p.positions, [[1, 2, 3]]) and not p.attributes


def test_xyz(tmp_path):
    p = read_text(tmp_path, "p.xyz", "# any comment\n1 2 3 0.5\n\n4\t5 6 0.25 # one more\n")
    assert np.array_equal(p.positions, [[1, 2, 3], [4, 5, 6]])
    assert np.array_equal(p.attributes["column4"], [0.5, 0.25])
    p = read_text(tmp_path, "p.xyz", "2\nwater # 1\nO 0 0 0\nH 0.1 0 1e-1\n")
    assert np.array_equal(p.positions, np.float32([[0, 0, 0], [0.1, 0, 0.1]]))
    assert not p.attributes


def test_csv(tmp_path):
    p = read_text(
        tmp_path,
        "p.csv",
        '\ufeff"Points:0","Points:1","Points:2","v:0","v:1",kind,id,smoothing_length\r\n'
        "1,2,3,0.5,0.25,a b,7,0.5\r\n4,5,6,1,2,c,8,1\r\n",
    )
    assert np.array_equal(p.positions, [[1, 2, 3], [4, 5, 6]])
    assert np.array_equal(p.attributes["v"], [[0.5, 0.25], [1, 2]])
    assert p.attributes["id"].dtype == np.int64 and "kind" not in p.attributes
    assert np.array_equal(p.support, [1, 2])
    p = read_text(tmp_path, "p.csv", "X,Y,Z,vx,vy,vz\n1,2,3,4,5,6\n")
    assert np.array_equal(p.attributes["velocity"], [[4, 5, 6]])
    p = read_text(tmp_path, "p.csv", "1,2,3\n4,5,6\n")
    assert np.array_equal(p.positions, [[1, 2, 3], [4, 5, 6]])


def test_npz_names(tmp_path):
    path = tmp_path / "p.npz"
    np.savez(
        path,
        pos=np.eye(3)[:2],
        velocities=np.ones((2, 3)),
        stress=np.ones((2, 3, 3)),
        radius=0.25,
        time=3.0,
        rgb=np.uint8([[255, 0, 0], [0, 0, 51]]),
        names=np.array(["a", "b"]),
    )
    p = formats.read(path)
    assert p.support == 1 and set(p.attributes) == {"velocities", "stress"}
    assert p.attributes["stress"].shape == (2, 9)
    assert np.array_equal(p.color, np.float32([[1, 0, 0], [0, 0, 0.2]]))
    np.savez(path, positions=np.eye(3)[:2], radius=0.25, support=0.5, weight=np.ones((2, 2)))
    p = formats.read(path)
    assert p.support == 0.5 and p.weight is None
    assert p.attributes["weight_attribute"].shape == (2, 2)


def test_npy_fortran_and_wide(tmp_path):
    table = np.asfortranarray(np.arange(10.0).reshape(2, 5))
    np.save(tmp_path / "p.npy", table)
    p = formats.read(tmp_path / "p.npy")
    assert np.array_equal(p.positions, table[:, :3])
    assert np.array_equal(p.attributes["column5"], [4, 9])


# Other programs' files.


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
    assert len(p) == n and set(p.attributes) == attributes
    assert np.isfinite(p.positions).all()
    for key in ("id", "index"):
        if key in attributes:
            assert len(np.unique(p.attributes[key])) == n


def test_data_files_agree():
    plain, encoded = (DATA / f"fluid_{kind}250_particles.vtu" for kind in ("", "encoded_"))
    if not plain.exists():
        pytest.skip(f"no {plain}")
    assert_same(formats.read(plain), formats.read(encoded))


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


@pytest.mark.parametrize("kind", ["poly", "grid"])
@pytest.mark.parametrize("binary", [False, True])
@pytest.mark.parametrize("version", [42, 51])
def test_vtk_writes_legacy(kind, binary, version, tmp_path):
    pytest.importorskip("vtk")
    from vtkmodules.vtkIOLegacy import vtkPolyDataWriter, vtkUnstructuredGridWriter

    writer = vtkPolyDataWriter() if kind == "poly" else vtkUnstructuredGridWriter()
    writer.SetFileName(str(tmp_path / "p.vtk"))
    writer.SetFileVersion(version)
    writer.SetFileType(2 if binary else 1)
    writer.SetInputData(vtk_points(kind))
    assert writer.Write()
    p = formats.read(tmp_path / "p.vtk")
    expected = sample()
    if not binary:  # VTK prints few digits
        assert np.allclose(p.positions, expected.positions, atol=1e-5)
        assert np.array_equal(p.attributes["id"], expected.attributes["id"])
        assert np.allclose(p.attributes["velocity"], expected.attributes["velocity"], atol=1e-5)
    else:
        assert_same(p, Particles(**{**vars(expected), "attributes": reordered(p, expected)}))


def reordered(p: Particles, expected: Particles) -> dict[str, np.ndarray]:
    """VTK writes the active arrays first."""
    return {name: expected.attributes[name] for name in p.attributes}


@pytest.mark.parametrize("kind", ["poly", "grid"])
@pytest.mark.parametrize("mode", ["ascii", "binary", "appended raw", "appended base64"])
@pytest.mark.parametrize("variant", ["plain", "zlib", "zlib small blocks", "big-endian 64"])
def test_vtk_writes_xml(kind, mode, variant, tmp_path):
    pytest.importorskip("vtk")
    from vtkmodules.vtkIOXML import vtkXMLPolyDataWriter, vtkXMLUnstructuredGridWriter

    writer = vtkXMLPolyDataWriter() if kind == "poly" else vtkXMLUnstructuredGridWriter()
    path = tmp_path / ("p.vtp" if kind == "poly" else "p.vtu")
    writer.SetFileName(str(path))
    writer.SetInputData(vtk_points(kind))
    writer.SetDataMode(["ascii", "binary", "appended"].index(mode.split()[0]))
    writer.SetEncodeAppendedData(mode.endswith("base64"))
    writer.SetHeaderTypeToUInt32()
    if "zlib" in variant:
        writer.SetCompressorTypeToZLib()
    else:
        writer.SetCompressorTypeToNone()
    if "blocks" in variant:
        writer.SetBlockSize(64)
    if variant == "big-endian 64":
        writer.SetByteOrderToBigEndian()
        writer.SetHeaderTypeToUInt64()
    assert writer.Write()
    p = formats.read(path)
    assert_same(p, Particles(**{**vars(sample()), "attributes": reordered(p, sample())}))


@pytest.mark.parametrize("extension", [".vtk", ".vtp", ".vtu"])
def test_vtk_reads(extension, tmp_path):
    pytest.importorskip("vtk")
    from vtkmodules.util.numpy_support import vtk_to_numpy
    from vtkmodules.vtkIOLegacy import vtkPolyDataReader
    from vtkmodules.vtkIOXML import vtkXMLPolyDataReader, vtkXMLUnstructuredGridReader

    reader = {
        ".vtk": vtkPolyDataReader,
        ".vtp": vtkXMLPolyDataReader,
        ".vtu": vtkXMLUnstructuredGridReader,
    }[extension]()
    p = sample()
    formats.write(tmp_path / f"p{extension}", p)
    reader.SetFileName(str(tmp_path / f"p{extension}"))
    reader.Update()
    output = reader.GetOutput()
    assert output.GetNumberOfCells() == N
    assert output.GetCell(7).GetPointId(0) == 7
    assert np.array_equal(vtk_to_numpy(output.GetPoints().GetData()), p.positions)
    for name, array in {"support": p.support, **p.attributes}.items():
        values = vtk_to_numpy(output.GetPointData().GetArray(name))
        assert np.array_equal(values.reshape(array.shape), array)


@pytest.mark.parametrize("binary", [False, True])
@pytest.mark.parametrize("extension", [".vtu", ".vtk", ".ply"])
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
def test_plyfile_agrees(order, tmp_path):
    plyfile = pytest.importorskip("plyfile")
    rows = np.zeros(5, [("x", "f4"), ("y", "f4"), ("z", "f8"), ("q", "u2"), ("red", "u1")])
    rows["x"], rows["q"], rows["z"] = np.arange(5) / 3, np.arange(5), 0.25
    faces = np.empty(2, [("vertex_indices", "i4", (3,))])
    faces["vertex_indices"] = [[0, 1, 2], [1, 2, 3]]
    elements = [
        plyfile.PlyElement.describe(faces, "face"),
        plyfile.PlyElement.describe(rows, "vertex"),
    ]
    ascii = order == "ascii"
    data = plyfile.PlyData(elements, text=ascii, byte_order="=" if ascii else order)
    data.write(str(tmp_path / "p.ply"))
    p = formats.read(tmp_path / "p.ply")
    assert np.array_equal(p.positions[:, 0], rows["x"]) and np.all(p.positions[:, 2] == 0.25)
    assert np.array_equal(p.attributes["q"], rows["q"]) and p.attributes["q"].dtype == np.uint16

    formats.write(tmp_path / "q.ply", sample())
    vertices = plyfile.PlyData.read(str(tmp_path / "q.ply"))["vertex"]
    assert np.array_equal(vertices["vy"], sample().attributes["velocity"][:, 1])
    assert np.array_equal(vertices["support"], sample().support)


def test_ply_colors_are_bytes_where_exact(tmp_path):
    formats.write(tmp_path / "p.ply", Particles(np.eye(3), color=np.uint8([[0, 7, 255]] * 3)))
    assert b"property uchar green" in (tmp_path / "p.ply").read_bytes()
    assert np.array_equal(formats.read(tmp_path / "p.ply").color[0], np.float32([0, 7, 255]) / 255)


# Writing.


def test_unknown_extension(tmp_path):
    with pytest.raises(FormatError, match=r"\.vtk .*\.csv"):
        formats.read(tmp_path / "p.xls")
    with pytest.raises(FormatError, match="extensions"):
        formats.write(tmp_path / "p.xls", sample())


@pytest.mark.parametrize("extension", formats.EXTENSIONS)
def test_missing_file_and_folder(extension, tmp_path):
    with pytest.raises(FileNotFoundError):
        formats.read(tmp_path / f"p{extension}")
    with pytest.raises(FileNotFoundError, match=f"none/p{extension}"):
        formats.write(tmp_path / "none" / f"p{extension}", Particles(np.eye(3)))


def test_a_failed_write_leaves_the_old_file(tmp_path):
    path = tmp_path / "p.ply"
    path.write_text("old")
    ids = np.array([0, 2**40, 1])
    with pytest.raises(ValueError, match="32-bit"):
        formats.write(path, Particles(np.eye(3), attributes={"id": ids}))
    with pytest.raises(ValueError, match="int32"):
        formats.write(tmp_path / "p.bgeo", Particles(np.eye(3), attributes={"id": ids}))
    with pytest.raises(KeyboardInterrupt), atomic_write(path) as file:
        file.write(b"half")
        raise KeyboardInterrupt
    assert path.read_text() == "old" and [file.name for file in tmp_path.iterdir()] == ["p.ply"]


def test_atomic_write_follows_links(tmp_path):
    (tmp_path / "real.txt").write_text("old")
    (tmp_path / "link.txt").symlink_to("real.txt")
    with atomic_write(tmp_path / "link.txt", "w") as file:
        file.write("new")
    assert (tmp_path / "real.txt").read_text() == "new" and (tmp_path / "link.txt").is_symlink()
    with atomic_write("/dev/null") as file:
        file.write(b"gone")
    assert Path("/dev/null").is_char_device()


def test_names_that_a_format_cannot_hold(tmp_path):
    for name in ("x", "red"):
        p = Particles(np.eye(3), color=(1, 0, 0), attributes={name: np.zeros(3)})
        with pytest.raises(ValueError, match="a name of its own"):
            formats.write(tmp_path / "p.csv", p)
    blank = Particles(np.eye(3), attributes={"two words": np.zeros(3)})
    for extension in (".ply", ".xyz"):
        with pytest.raises(ValueError, match="blanks"):
            formats.write(tmp_path / f"p{extension}", blank)
    assert not list(tmp_path.iterdir())


# Particles themselves.


def test_particles_convert_once_and_do_not_copy():
    positions, support = np.zeros((4, 3), np.float32), np.ones(4, np.float32)
    p = Particles(positions, support=support, weight=2, color=[1, 0.5, 0])
    assert p.positions is positions and p.support is support
    assert p.weight == 2.0 and isinstance(p.weight, float)
    assert p.color.dtype == np.float32 and p.color.shape == (3,)
    p = Particles(np.zeros((4, 3)), color=np.zeros((4, 3), np.uint8) + 255)
    assert p.positions.dtype == np.float32 and np.all(p.color == 1)
    assert len(Particles([])) == 0


@pytest.mark.parametrize(
    ("arguments", "error", "message"),
    [
        ({"positions": np.zeros((4, 2))}, ValueError, r"positions: expected shape \(N, 3\), got"),
        ({"positions": ["a"]}, TypeError, "positions: expected numbers"),
        ({"positions": [[1, 2], [3]]}, TypeError, "positions: expected an array"),
        ({"support": np.zeros(3)}, ValueError, r"support: expected a number or shape \(4,\)"),
        ({"support": -1}, ValueError, "support: expected numbers >= 0, got -1"),
        ({"support": [1, 1, np.nan, 1]}, ValueError, r"got nan \(particle 2\)"),
        ({"weight": 1e300}, ValueError, "weight: expected finite"),
        ({"weight": "heavy"}, TypeError, "weight"),
        ({"color": [0, 0, 1.5]}, ValueError, r"color: expected \[0, 1\], got 1.5"),
        ({"color": [1, 1]}, ValueError, "color: expected shape"),
        ({"attributes": {"a": np.zeros(5)}}, ValueError, r"attributes\['a'\]: expected shape"),
        ({"attributes": {"a": np.zeros(4, complex)}}, TypeError, "attributes"),
        ({"attributes": {"color": np.zeros(4)}}, ValueError, "a name of its own"),
    ],
)
def test_particles_name_what_is_wrong(arguments, error, message):
    with pytest.raises(error, match=message):
        Particles(**{"positions": np.zeros((4, 3)), **arguments})


def test_selection_and_bounds():
    p = Particles(sample().positions, support=sample().support, color=(1, 0, 0), weight=3)
    picked = p[p.positions[:, 0] > 0]
    assert np.array_equal(picked.support, p.support[p.positions[:, 0] > 0])
    assert picked.weight == 3 and np.array_equal(picked.color, [1, 0, 0])
    assert (
        len(p[::2]) == N // 2
        and len(p[-1]) == 1
        and np.array_equal(p[-1].positions[0], p.positions[-1])
    )
    with pytest.raises(IndexError):
        p[N]
    low, high = Particles([[0, 1, 2], [np.nan, -9, 9], [1, -1, 5]]).bounds()
    assert np.array_equal(low, [0, -1, 2]) and np.array_equal(high, [1, 1, 5])
    with pytest.raises(ValueError, match="finite"):
        Particles([]).bounds()
    assert repr(p[:2]) == "Particles(2, support (2,), weight=3, color (3,))"


class OnGpu:
    """Stands for an array in GPU memory; nothing may touch its contents."""

    def __init__(self, shape, typestr="<f4", strides=None):
        self.shape = shape
        self.__cuda_array_interface__ = {
            "shape": shape,
            "typestr": typestr,
            "data": (0, False),
            "strides": strides,
            "version": 3,
        }


def test_gpu_arrays_stay_where_they_are():
    positions, support = OnGpu((4, 3)), OnGpu((4,))
    p = Particles(positions, support=support, color=(1, 0, 0), attributes={"a": OnGpu((4, 2))})
    assert p.positions is positions and p.support is support and len(p) == 4
    with pytest.raises(TypeError, match="positions: expected float32 on the GPU, got float64"):
        Particles(OnGpu((4, 3), "<f8"))
    with pytest.raises(TypeError, match="C-contiguous"):
        Particles(OnGpu((4, 3), strides=(4, 16)))
    with pytest.raises(ValueError, match="support: expected shape"):
        Particles(positions, support=OnGpu((5,)))
