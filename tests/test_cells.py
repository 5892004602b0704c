"""Cells of VTK's files: faces are triangles, data of vertices are attributes, ghosts are none."""

import json
import re
from functools import partial

import globule as gb
import numpy as np
import pytest
from cli_helpers import refuses, run_json
from format_helpers import by_vtk, data_array, naming, vtk, vtk_write, vtu, words
from globule.cli import main
from globule.formats import read_contents, triangles
from globule.formats.frames import FrameOf
from globule.formats.triangles import has_faces
from globule.render.sequence import frames_of

X = np.array([[0, 0, 0], [2, 0, 0], [2, 1, 0], [0, 1, 0], [0, 0, 1], [2, 0, 1], [2, 1, 1], [0, 1, 1]])
TETRAS = [[0, 1, 3, 4], [1, 2, 3, 6], [1, 6, 4, 5], [3, 4, 6, 7], [1, 3, 4, 6]]  # the whole box
SMALL = ("--size", "64x48", "--device", "cpu")


def area(mesh: gb.Mesh) -> float:
    a, b, c = (np.asarray(mesh.vertices, np.float64)[mesh.faces[:, k]] for k in range(3))
    return float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2)


def volume(mesh: gb.Mesh) -> float:
    a, b, c = (np.asarray(mesh.vertices, np.float64)[mesh.faces[:, k]] for k in range(3))
    return float(np.sum(a * np.cross(b, c)) / 6)


pieces = partial(naming, "PUnstructuredGrid")
blocks = partial(naming, "vtkMultiBlockDataSet")
collection = partial(naming, "Collection")


@pytest.mark.parametrize("write", [vtu, vtk])
@pytest.mark.parametrize(
    ("cells", "types", "expected", "solid"),
    [
        ([[0, 1, 2], [0, 2, 3]], [5, 5], 2, False),
        ([[0, 1, 2, 3]], [9], 2, False),
        ([[0, 1, 3, 2]], [8], 2, False),
        ([[0, 1, 3, 2]], [6], 2, False),
        ([[0, 1], [0, 1, 2, 3], [4]], [3, 7, 1], 2, False),
        ([range(8)], [12], 10, True),
        ([[0, 1, 3, 2, 4, 5, 7, 6]], [11], 10, True),
        (TETRAS, [10] * 5, 10, True),
        ([[0, 1, 3, 4, 5, 7], [1, 2, 3, 5, 6, 7]], [13, 13], 10, True),
    ],
)
def test_outer_faces(tmp_path, write, cells, types, expected, solid):
    path = write(tmp_path / f"a.{write.__name__}", X, cells, types)
    assert has_faces(path)
    mesh = gb.Mesh(path)
    assert area(mesh) == pytest.approx(expected, rel=1e-6)
    assert mesh.solid == solid
    if solid:
        assert volume(mesh) == pytest.approx(2, rel=1e-6)
    assert len(gb.read(path)) == 8  # its points, for --as-particles


def test_polyhedra(tmp_path):
    faces = [[0, 4, 7, 3], [1, 2, 6, 5], [0, 1, 5, 4], [3, 7, 6, 2], [0, 3, 2, 1], [4, 5, 6, 7]]
    stream = [6, *(i for face in faces for i in (4, *face))]
    old = data_array("faces", "Int64", stream) + data_array("faceoffsets", "Int64", [-1, len(stream)])
    new = (
        data_array("face_connectivity", "Int64", faces) + data_array("face_offsets", "Int64", range(4, 25, 4))
        + data_array("polyhedron_to_faces", "Int64", range(6))
        + data_array("polyhedron_offsets", "Int64", [0, 6])
    )  # fmt: skip
    for more in (old, new):
        path = vtu(tmp_path / "a.vtu", X, [[0], range(8)], [1, 42], more=more)
        assert volume(gb.Mesh(path)) == pytest.approx(2)
    path = vtk(tmp_path / "a.vtk", X, [[0], stream], [1, 42])
    assert volume(gb.Mesh(path)) == pytest.approx(2)
    with pytest.raises(gb.FormatError, match="faces of polyhedra, got too few numbers"):
        gb.Mesh(vtk(tmp_path / "b.vtk", X, [stream[:-2]], [42]))
    with pytest.raises(gb.FormatError, match="expected the arrays faces and faceoffsets"):
        gb.Mesh(vtu(tmp_path / "b.vtu", X, [range(8)], [42]))


def test_polygons_with_inward_corners(tmp_path):
    arrow = np.array([[0, 0, 0], [3, 0, 0], [3, 3, 0], [0, 3, 0], [1, 2, 0], [1, 1, 0]])
    u_shape = np.array([[0, 0, 0], [5, 0, 0], [5, 3, 0], [4, 3, 0], [4, 1, 0], [1, 1, 0],
                        [1, 3, 0], [0, 3, 0]])  # fmt: skip
    dart = np.array([[0, 0, 0], [2, 1, 0], [0, 2, 0], [1, 1, 0]])
    for points, expected in ((arrow, 7), (u_shape, 9), (dart, 1)):
        for turned in (points, points[:, [2, 0, 1]], points[::-1][:, [0, 2, 1]]):
            for first in range(len(points)):
                path = vtu(tmp_path / "a.vtu", np.roll(turned, first, 0), [range(len(points))], [7])
                mesh = gb.Mesh(path)
                assert area(mesh) == pytest.approx(expected)
                assert len(mesh) == len(points) - 2


def test_ghost_and_hidden_cells(tmp_path):
    """A cell that another piece has covers faces, and is not drawn; a hidden cell uncovers them."""
    x = np.array([[i, j, k] for k in (0, 1) for j in (0, 1) for i in (0, 1, 2)])
    two = [[0, 1, 4, 3, 6, 7, 10, 9], [1, 2, 5, 4, 7, 8, 11, 10]]
    for flag, expected in ((0, 10), (1, 5), (8, 6), (32, 6)):
        data = data_array("vtkGhostType", "UInt8", [0, flag])
        path = vtu(tmp_path / "a.vtu", x, two, [12, 12], cell_data=data)
        assert area(gb.Mesh(path)) == pytest.approx(expected), flag
    hidden = data_array("vtkGhostType", "UInt8", [2 * (i == 2) for i in range(12)])
    path = vtu(tmp_path / "b.vtu", x, two, [12, 12], point_data=hidden)
    assert area(gb.Mesh(path)) == pytest.approx(6)
    a = vtu(tmp_path / "a.vtu", x, two, [12, 12], cell_data=data_array("vtkGhostType", "UInt8", [0, 1]))
    b = vtu(tmp_path / "b.vtu", x, two, [12, 12], cell_data=data_array("vtkGhostType", "UInt8", [1, 0]))
    mesh = gb.Mesh(pieces(tmp_path / "ab.pvtu", a.name, b.name))
    assert area(mesh) == pytest.approx(10)
    assert volume(mesh) == pytest.approx(2)


def test_ghost_points_are_no_particles(tmp_path):
    cells, types = [[i] for i in range(8)], [1] * 8
    flags = [0, 1, 0, 2, 0, 0, 1, 0]
    ids = data_array("id", "Int64", range(8))
    data = ids + data_array("vtkGhostType", "UInt8", flags)
    found = gb.read(vtu(tmp_path / "a.vtu", X, cells, types, point_data=data))
    assert found.attributes["id"].tolist() == [0, 2, 4, 5, 7]
    assert list(found.attributes) == ["id"]
    on_cells = data_array("vtkGhostType", "UInt8", flags)
    found = gb.read(vtu(tmp_path / "b.vtu", X, cells, types, point_data=ids, cell_data=on_cells))
    assert found.attributes["id"].tolist() == [0, 2, 3, 4, 5, 7]  # 2 means another thing on cells
    old = f"POINT_DATA 8\nSCALARS vtkGhostLevels int 1\nLOOKUP_TABLE default\n{words(flags)}\n"
    found = gb.read(vtk(tmp_path / "c.vtk", X, cells, types, old))
    np.testing.assert_array_equal(found.positions, X[[0, 2, 4, 5, 7]])
    whole = gb.read(pieces(tmp_path / "all.pvtu", "a.vtu", "b.vtu"))
    assert whole.attributes["id"].tolist() == [0, 2, 4, 5, 7, 0, 2, 3, 4, 5, 7]


def test_ghosts_of_a_file_in_ranges(tmp_path):
    from globule.formats.ranges import has_ranges

    gb.write(tmp_path / "a.vtu", gb.Particles(X))
    gb.write(tmp_path / "b.vtu", gb.Particles(X, attributes={"vtkGhostType": np.arange(8) % 2}))
    assert has_ranges(tmp_path / "a.vtu")
    assert not has_ranges(tmp_path / "b.vtu")


@pytest.mark.parametrize("write", [vtu, vtk])
def test_cell_data_of_vertices_are_attributes(tmp_path, write):
    """Vertices in another order than the points, and one point without a vertex."""
    order, mass = [3, 1, 0, 2], [30, 10, 0, 20]
    more = f"CELL_DATA 4\nSCALARS radius double 1\nLOOKUP_TABLE default\n{words(mass)}\n"
    options = {"cell_data": data_array("radius", "Int32", mass)} if write is vtu else {"more": more}
    path = write(tmp_path / f"a.{write.__name__}", X[:4], [[i] for i in order], [1] * 4, **options)
    found = gb.read(path)
    assert not has_faces(path)
    assert found.attributes["radius"].tolist() == [0, 10, 20, 30]
    assert found.attributes["radius"].dtype.kind == ("i" if write is vtu else "f")
    path = write(tmp_path / f"b.{write.__name__}", X[:5], [[i] for i in order], [1] * 4, **options)
    np.testing.assert_array_equal(gb.read(path).attributes["radius"], [0, 10, 20, 30, np.nan])
    poly = [[3, 1], [0, 2]]  # two cells of two points each
    options = {"cell_data": data_array("kind", "Int32", [7, 8])} if write is vtu else {
        "more": "CELL_DATA 2\nSCALARS kind int 1\nLOOKUP_TABLE default\n7 8\n"}  # fmt: skip
    path = write(tmp_path / f"c.{write.__name__}", X[:4], poly, [2, 2], **options)
    assert gb.read(path).attributes["kind"].tolist() == [8, 7, 8, 7]


def test_cell_data_of_polydata(tmp_path):
    """The cells' data begin with the vertices', wherever these stand in the file."""
    lines = "LINES 1 3\n2 0 1\nVERTICES 3 6\n1 2\n1 1\n1 0\n"
    data = "CELL_DATA 4\nSCALARS id int 1\nLOOKUP_TABLE default\n12 11 10 99\n"
    head = "# vtk DataFile Version 3.0\na\nASCII\nDATASET POLYDATA\nPOINTS 3 float\n"
    (tmp_path / "a.vtk").write_text(f"{head}{words(X[:3])}\n{lines}{data}")
    assert gb.read(tmp_path / "a.vtk").attributes["id"].tolist() == [10, 11, 12]
    (tmp_path / "b.vtk").write_text(f"{head}{words(X[:3])}\n{lines}{data.replace('A 4', 'A 3')}")
    refuses("expected CELL_DATA 4, got 3", gb.read, tmp_path / "b.vtk", error=gb.FormatError)


def test_collections_of_meshes(tmp_path):
    a = vtu(tmp_path / "a.vtu", X, [range(8)], [12]).name
    b = vtk(tmp_path / "b.vtk", X + [0, 0, 5], TETRAS[:1], [10]).name
    none = vtu(tmp_path / "none.vtu", X[:0], [], []).name
    p = vtu(tmp_path / "p.vtu", X, [[i] for i in range(8)], [1] * 8).name
    assert area(gb.Mesh(pieces(tmp_path / "a.pvtu", a, none, a))) == pytest.approx(20)
    both = blocks(tmp_path / "both.vtm", a, b)
    assert has_faces(both)
    assert area(gb.Mesh(both)) == pytest.approx(10 + area(gb.Mesh(tmp_path / "b.vtk")))
    times = collection(tmp_path / "t.pvd", a, b, "both.vtm")
    assert frames_of(str(times)) == 3
    faces = [len(gb.Mesh(FrameOf(str(times), k))) for k in range(3)]
    assert faces == [12, 4, 16]
    series = {"file-series-version": "1.0", "files": [{"name": n, "time": 1} for n in (a, b)]}
    (tmp_path / "s.vtu.series").write_text(json.dumps(series))
    assert len(gb.Mesh(FrameOf(str(tmp_path / "s.vtu.series"), 1))) == 4
    mixed = blocks(tmp_path / "mixed.vtm", a, p, none)
    assert not has_faces(mixed)
    with pytest.warns(UserWarning, match=r"mixed\.vtm: a mesh is left out beside the particles"):
        assert len(read_contents(mixed).particles) == 8
    assert len(gb.Mesh(mixed)) == 12
    only = pieces(tmp_path / "only.pvtu", p, p)
    assert not has_faces(only)
    assert len(gb.read(only)) == 16


def test_damaged_cells_are_refused(tmp_path):
    with pytest.raises(gb.FormatError, match="expected indices from 0 to 7, got 0 to 8"):
        gb.Mesh(vtu(tmp_path / "a.vtu", X, [[0, 1, 8]], [5]))
    with pytest.raises(gb.FormatError, match="expected indices from 0 to 7, got -1 to 1"):
        gb.Mesh(vtk(tmp_path / "a.vtk", X, [[0, 1, -1]], [5]))
    text = vtk(tmp_path / "b.vtk", X, [[0, 1, 2]] * 2, [5, 5]).read_text()
    (tmp_path / "b.vtk").write_text(text.replace("CELL_TYPES 2\n5 5", "CELL_TYPES 1\n5"))
    refuses("expected CELL_TYPES 2, got 1", gb.Mesh, tmp_path / "b.vtk", error=gb.FormatError)
    path = vtu(tmp_path / "c.vtu", X, [[0, 1, 2]], [5])
    path.write_text(re.sub("Int64. Name=.offsets", 'Int64" Name="ends', path.read_text()))
    refuses("expected the arrays connectivity and offsets", gb.Mesh, path, error=gb.FormatError)
    with pytest.raises(gb.FormatError, match="expected a mesh with faces, got none"):
        gb.Mesh(vtu(tmp_path / "d.vtu", X, [[0, 1]], [3]))


def test_render_frames_of_meshes(folder, capsys):
    a = vtu(folder / "a.vtu", X, [range(8)], [12]).name
    b = vtu(folder / "b.vtu", X, TETRAS[:1], [10]).name
    collection(folder / "t.pvd", a, b)
    still = run_json(capsys, "render", "t.pvd", "-o", "a.png", *SMALL)
    assert still["counts"]["triangles"] == 12
    assert "t.pvd has 2 frames, and this is the first" in still["warnings"][0]
    last = run_json(capsys, "render", "t.pvd", "-o", "a.png", *SMALL, "--frame", "-1")
    assert last["counts"]["triangles"] == 4
    assert last["warnings"] == []
    both = run_json(capsys, "render", "t.pvd", "-o", "f_%02d.png", *SMALL)
    assert [frame["counts"]["triangles"] for frame in both["frames"]] == [12, 4]


NAMES = (
    "TRIANGLE", "QUAD", "PIXEL", "POLYGON", "TETRA", "VOXEL", "HEXAHEDRON", "WEDGE", "PYRAMID",
    "QUADRATIC_TRIANGLE", "QUADRATIC_QUAD", "QUADRATIC_TETRA", "QUADRATIC_HEXAHEDRON",
    "QUADRATIC_WEDGE", "QUADRATIC_PYRAMID", "BIQUADRATIC_QUAD", "POLYHEDRON",
    "LAGRANGE_TRIANGLE", "LAGRANGE_QUADRILATERAL", "LAGRANGE_TETRAHEDRON", "PENTAGONAL_PRISM",
    "HEXAGONAL_PRISM", "TRIQUADRATIC_HEXAHEDRON", "LAGRANGE_HEXAHEDRON", "LAGRANGE_WEDGE",
    "BEZIER_TRIANGLE", "BEZIER_HEXAHEDRON",
)  # fmt: skip
STRAIGHT = NAMES[NAMES.index("PENTAGONAL_PRISM") :]  # drawn to 1e-6 where their faces are plane


@pytest.mark.interop
@pytest.mark.parametrize("name", NAMES)
def test_areas_of_vtk(tmp_path, name):
    """The area of the surface that VTK extracts, in every encoding it writes."""
    vtk = pytest.importorskip("vtk", reason="vtk is not installed")
    from vtkmodules.util.numpy_support import vtk_to_numpy

    source = vtk.vtkCellTypeSource()
    source.SetCellType(getattr(vtk, f"VTK_{name}"))
    source.SetCellOrder(2)
    source.SetBlocksDimensions(2, 2, 2)
    source.SetOutputPrecision(1)
    source.Update()
    grid = source.GetOutput()
    points = vtk_to_numpy(grid.GetPoints().GetData())
    if name not in STRAIGHT:
        bend = np.stack([3 * points[:, 1] + points[:, 2], 2 * points[:, 2], 2.5 * points[:, 0]], 1)
        points += 0.03 * np.sin(bend)
    outer = vtk.vtkDataSetSurfaceFilter()
    outer.SetInputData(grid)
    cut = vtk.vtkTriangleFilter()
    cut.SetInputConnection(outer.GetOutputPort())
    measured = vtk.vtkMassProperties()
    measured.SetInputConnection(cut.GetOutputPort())
    measured.Update()
    for ending, mode in (("vtu", "Ascii"), ("vtu", "Binary"), ("vtu", "Appended"), ("vtk", 42),
                         ("vtk", 51)):  # fmt: skip
        path = tmp_path / f"a.{ending}"
        if ending == "vtu":
            writer = vtk.vtkXMLUnstructuredGridWriter()
            getattr(writer, f"SetDataModeTo{mode}")()
        else:
            writer = vtk.vtkUnstructuredGridWriter()
            writer.SetFileVersion(mode)
            writer.SetFileTypeToBinary()
        vtk_write(writer, path, grid)
        assert area(gb.Mesh(path)) == pytest.approx(measured.GetSurfaceArea(), rel=1e-6)


@pytest.mark.interop
def test_cell_data_as_vtk_orders_them(tmp_path):
    """What VTK says of vertex cells in a .vtp that holds lines and polygons, too."""
    vtk = pytest.importorskip("vtk", reason="vtk is not installed")
    path = tmp_path / "a.vtp"
    lists = {"Polys": [[0, 1, 2]], "Lines": [[0, 1]], "Verts": [[2], [1], [0]]}
    body = "".join(
        f"<{name}>{data_array('connectivity', 'Int64', [i for cell in cells for i in cell])}"
        f"{data_array('offsets', 'Int64', np.cumsum([len(c) for c in cells]))}</{name}>"
        for name, cells in lists.items()
    )
    counts = " ".join(f'NumberOf{name}="{len(cells)}"' for name, cells in lists.items())
    path.write_text(
        f'<VTKFile type="PolyData" version="0.1"><PolyData><Piece NumberOfPoints="3" {counts} '
        f'NumberOfStrips="0"><Points>{data_array("P", "Float32", X[:3], 3)}</Points><CellData>'
        f"{data_array('id', 'Int32', [12, 11, 10, 5, 6])}</CellData>{body}</Piece></PolyData></VTKFile>"
    )
    data = by_vtk(path)
    of_vertex = {}
    for i in range(data.GetNumberOfVerts()):
        ids = vtk.vtkIdList()
        data.GetCellPoints(i, ids)
        of_vertex[ids.GetId(0)] = int(data.GetCellData().GetArray("id").GetValue(i))
    found = gb.read(path).attributes["id"]
    assert found.tolist() == [of_vertex[i] for i in range(3)] == [10, 11, 12]
    assert len(gb.Mesh(path)) == 1


@pytest.mark.parametrize("write", [vtu, vtk])
def test_values_of_volumes_and_faces_are_taken_to_their_points(tmp_path, write):
    """As OpenFOAM writes them: the mean of the cells at a point; of whole numbers one of them."""
    x = np.array([[i, j, k] for k in (0, 1) for j in (0, 1) for i in (0, 1, 2)])
    two = [[0, 1, 4, 3, 6, 7, 10, 9], [1, 2, 5, 4, 7, 8, 11, 10]]
    if write is vtu:
        data = data_array("alpha.water", "Float32", [0, 1]) + data_array("zone", "Int32", [3, 5])
        data += data_array("U", "Float64", [[1, 0, 0], [3, 2, 0]], 3)
        p = data_array("p", "Float64", range(12))
        path = vtu(tmp_path / "a.vtu", x, two, [12, 12], cell_data=data, point_data=p)
    else:
        data = "CELL_DATA 2\nFIELD F 3\nalpha.water 1 2 float\n0 1\nzone 1 2 int\n3 5\nU 3 2 double\n1 0 0 3 2 0\n"
        path = vtk(tmp_path / "a.vtk", x, two, [12, 12], f"{data}POINT_DATA 12\nSCALARS p double\n{words(range(12))}\n")
    for found in (gb.read(path), gb.Mesh(path)):
        np.testing.assert_array_equal(found.attributes["alpha.water"], x[:, 0] / 2)
        np.testing.assert_array_equal(found.attributes["U"][:, 0], 1 + x[:, 0])
        np.testing.assert_array_equal(found.attributes["p"], range(12))
        assert found.attributes["zone"].dtype.kind == "i"
        np.testing.assert_array_equal(
            found.attributes["zone"][x[:, 0] != 1], np.where(x[:, 0] == 0, 3, 5)[x[:, 0] != 1]
        )


def test_values_of_cells_in_xdmf_and_vtkhdf(tmp_path):
    h5py = pytest.importorskip("h5py")
    item = '<DataItem Format="XML" Dimensions="{}">{}</DataItem>'
    values = f'<Attribute Name="a" Center="Cell">{item.format(2, "0 1")}</Attribute>'
    places, cells = item.format("4 3", "0 0 0 1 0 0 1 1 0 0 1 0"), item.format("2 3", "0 1 2 0 2 3")
    (tmp_path / "a.xdmf").write_text(
        f'<Xdmf><Domain><Grid><Topology TopologyType="Triangle" NumberOfElements="2">{cells}</Topology>'
        f'<Geometry GeometryType="XYZ">{places}</Geometry>{values}</Grid></Domain></Xdmf>'
    )
    for found in (gb.read(tmp_path / "a.xdmf"), gb.Mesh(tmp_path / "a.xdmf")):
        np.testing.assert_array_equal(found.attributes["a"], [0.5, 0, 0.5, 1])
    with h5py.File(tmp_path / "a.vtkhdf", "w") as file:
        group = file.create_group("VTKHDF")
        group.attrs["Type"] = np.bytes_("UnstructuredGrid")
        group["Points"], group["NumberOfPoints"] = np.eye(3), [3]
        group["CellData/alpha.water"] = [1.0]
    with pytest.warns(UserWarning, match="values of cells are left out: alpha.water"):
        gb.read(tmp_path / "a.vtkhdf")


def test_colors_of_meshes_are_those_of_a_ply(tmp_path):
    head = "# vtk DataFile Version 3.0\ntitle\nASCII\nDATASET POLYDATA\nPOINTS 3 float\n0 0 0 1 0 0 0 1 0\n"
    (tmp_path / "a.vtk").write_text(
        f"{head}POLYGONS 1 4\n3 0 1 2\nPOINT_DATA 3\nFIELD f 1\nRGB 3 3 unsigned_char\n255 0 188 0 64 0 9 9 9\n"
    )
    names = "".join(f"property float {axis}\n" for axis in "xyz")
    names += "".join(f"property uchar {name}\n" for name in ("red", "green", "blue"))
    (tmp_path / "a.ply").write_text(
        f"ply\nformat ascii 1.0\nelement vertex 3\n{names}element face 1\nproperty list uchar int vertex_indices\n"
        "end_header\n0 0 0 255 0 188\n1 0 0 0 64 0\n0 1 0 9 9 9\n3 0 1 2\n"
    )
    naming("vtkMultiBlockDataSet", tmp_path / "a.vtm", "a.vtk")
    for name in ("a.ply", "a.vtk", "a.vtm"):
        assert np.allclose(triangles.read(tmp_path / name).color[0], (1, 0, 0.503), atol=0.002), name


def test_a_point_that_no_face_shows_has_no_color_to_miss(tmp_path, capsys):
    """In the hole of a plate, whose cells have values."""
    points = np.stack(np.mgrid[:5, :5], -1).reshape(-1, 2) @ np.eye(2, 3)
    corners = [5 * i + j for i in range(4) for j in range(4) if (i, j) not in ((1, 1), (1, 2), (2, 1), (2, 2))]
    rows = "".join(f"4 {k} {k + 5} {k + 6} {k + 1}\n" for k in corners)
    (tmp_path / "a.vtk").write_text(
        "# vtk DataFile Version 3.0\ntitle\nASCII\nDATASET POLYDATA\nPOINTS 25 float\n"
        + "".join(f"{x:g} {y:g} {z:g}\n" for x, y, z in points)
        + f"POLYGONS 12 60\n{rows}CELL_DATA 12\nSCALARS p float 1\nLOOKUP_TABLE default\n{'1 ' * 6}{'2 ' * 6}\n"
    )
    words = ["-o", str(tmp_path / "a.png"), "--size", "48x36", "--color-by", "p"]
    assert main(["render", str(tmp_path / "a.vtk"), *words]) == 0
    assert capsys.readouterr().err == ""
