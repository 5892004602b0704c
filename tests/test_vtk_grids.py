"""Grids of VTK's files: points, outer faces, volumes where they are evenly spaced; against VTK itself."""

import globule as gb
import numpy as np
import pytest
from format_helpers import naming, vtk_write
from globule.formats import kind_of
from globule.formats.ranges import ranges
from globule.formats.triangles import has_faces
from globule.measure.mesh import measure_surface
from globule.volumes import read_volume
from test_cells import area

vtk = pytest.importorskip("vtk")
SIZE = (4, 5, 6)


def numbers(name, values):
    from vtk.util.numpy_support import numpy_to_vtk

    found = numpy_to_vtk(np.ascontiguousarray(values), deep=True)
    found.SetName(name)
    return found


def places(*axes):
    return np.stack(np.meshgrid(*axes, indexing="ij"), -1).transpose(2, 1, 0, 3).reshape(-1, 3)


def curved(points, size=SIZE):
    grid = vtk.vtkStructuredGrid()
    grid.SetDimensions(*size)
    found = vtk.vtkPoints()
    found.SetData(numbers("Points", points))
    grid.SetPoints(found)
    return grid


def rectilinear(*axes):
    grid = vtk.vtkRectilinearGrid()
    grid.SetDimensions(*map(len, axes))
    for axis, x in zip("XYZ", axes, strict=True):
        getattr(grid, f"Set{axis}Coordinates")(numbers(axis, x))
    return grid


def outer_area(data):
    surface = vtk.vtkDataSetSurfaceFilter()
    surface.SetInputData(data)
    cut = vtk.vtkTriangleFilter()
    cut.SetInputConnection(surface.GetOutputPort())
    mass = vtk.vtkMassProperties()
    mass.SetInputConnection(cut.GetOutputPort())
    mass.Update()
    return mass.GetSurfaceArea()


EVEN = [10 + 0.1 * np.arange(n) for n in SIZE]
UNEVEN = [np.cumsum(0.1 + 0.02 * np.arange(n)) for n in SIZE]
BENT = places(*EVEN) + 0.3 * np.sin(places(*EVEN)[:, [1, 2, 0]])
WRITERS = {
    ".vts": vtk.vtkXMLStructuredGridWriter,
    ".vtr": vtk.vtkXMLRectilinearGridWriter,
    "s.vtk": vtk.vtkStructuredGridWriter,
    "r.vtk": vtk.vtkRectilinearGridWriter,
}
GRIDS = [
    (".vts", lambda: curved(BENT), BENT),
    (".vtr", lambda: rectilinear(*UNEVEN), places(*UNEVEN)),
    ("s.vtk", lambda: curved(BENT), BENT),
    ("r.vtk", lambda: rectilinear(*UNEVEN), places(*UNEVEN)),
]


@pytest.mark.parametrize(("ending", "make", "points"), GRIDS, ids=[grid[0] for grid in GRIDS])
def test_points_and_outer_faces(tmp_path, ending, make, points):
    grid, path = make(), tmp_path / f"a{ending}"
    grid.GetPointData().AddArray(numbers("p", points[:, 0]))
    grid.GetCellData().AddArray(numbers("q", np.arange(60.0)))
    vtk_write(WRITERS[ending](), path, grid)
    assert kind_of(path).kind == "particles"
    particles = gb.read(path)
    assert np.allclose(particles.world_positions(), points, atol=1e-5)
    assert np.allclose(particles.attributes["p"], points[:, 0])
    assert particles.attributes["q"].shape == (120,)
    assert has_faces(path)
    assert area(gb.Mesh(path)) == pytest.approx(outer_area(grid), rel=1e-6)


@pytest.mark.parametrize("ending", WRITERS)
@pytest.mark.parametrize("of", ["points", "cells"])
def test_even_grids_are_volumes(tmp_path, ending, of):
    grid = curved(places(*EVEN)) if "s" in ending.split(".")[ending[0] == "."] else rectilinear(*EVEN)
    path = tmp_path / f"a{ending}"
    n = np.array(SIZE) - (of == "cells")
    values = np.arange(float(n.prod()))
    data = grid.GetPointData() if of == "points" else grid.GetCellData()
    data.AddArray(numbers("v", np.tile(values[:, None], (1, 3))))
    data.AddArray(numbers("other", -values))
    data.SetScalars(numbers("rho", values))
    vtk_write(WRITERS[ending](), path, grid)
    assert kind_of(path).kind == "volume"
    volume = read_volume(path)
    assert np.array_equal(volume.values if ".vt" in ending[:3] else np.abs(volume.values), values.reshape(n[::-1]))
    first = np.asarray(volume.world_from_voxel) @ (0, 0, 0, 1)
    assert np.allclose(first[:3], 10.05 if of == "cells" else 10)
    assert np.allclose(np.diag(volume.world_from_voxel)[:3], 0.1)
    assert not has_faces(path)
    assert len(gb.read(path)) == 120  # wanted as particles
    assert area(gb.Mesh(path)) == pytest.approx(2 * (0.3 * 0.4 + 0.3 * 0.5 + 0.4 * 0.5), rel=1e-5)


def test_what_is_no_volume(tmp_path):
    path = tmp_path / "a.vtr"
    for axes, more in ((EVEN, False), ([EVEN[0], EVEN[1], EVEN[2][:1]], True), ([*EVEN[:2], -EVEN[2]], True)):
        grid = rectilinear(*axes)
        if more:
            grid.GetPointData().AddArray(numbers("p", np.zeros(grid.GetNumberOfPoints())))
        vtk_write(WRITERS[".vtr"](), path, grid)
        assert kind_of(path).kind == "particles"
        assert has_faces(path)
    with pytest.raises(gb.FormatError, match="expected a volume, got particles"):
        read_volume(path)


def test_blanked_cells_are_left_out(tmp_path):
    grid, path = curved(BENT), tmp_path / "a.vts"
    for cell in range(12):
        grid.BlankCell(cell)
    vtk_write(WRITERS[".vts"](), path, grid)
    rest = curved(BENT[20:], (4, 5, 5))
    assert area(gb.Mesh(path)) == pytest.approx(outer_area(rest), rel=1e-6)


@pytest.mark.parametrize(
    ("mode", "packer"), [("Ascii", ""), ("Binary", ""), ("Appended", "ZLib"), ("Appended", "LZMA")]
)
def test_encodings(tmp_path, mode, packer):
    writer, path = vtk.vtkXMLRectilinearGridWriter(), tmp_path / "a.vtr"
    getattr(writer, f"SetDataModeTo{mode}")()
    getattr(writer, f"SetCompressorTypeTo{packer or 'None'}")()
    vtk_write(writer, path, rectilinear(*UNEVEN))
    assert np.allclose(gb.read(path).positions, places(*UNEVEN), atol=1e-6)


def test_pieces_of_grids(tmp_path):
    for ending, kind in (("vtr", "RectilinearGrid"), ("vts", "StructuredGrid")):
        for k in (0, 1):
            axes = [EVEN[0], EVEN[1], EVEN[2] + 5 * k]
            grid = rectilinear(*axes) if ending == "vtr" else curved(places(*axes))
            grid.GetPointData().AddArray(numbers("p", np.zeros(120)))
            vtk_write(WRITERS[f".{ending}"](), tmp_path / f"{k}.{ending}", grid)
        path = naming(f"P{kind}", tmp_path / f"a.p{ending}", f"0.{ending}", f"1.{ending}")
        assert len(gb.read(path)) == 240
        assert has_faces(path)
        assert area(gb.Mesh(path)) == pytest.approx(4 * (0.3 * 0.4 + 0.3 * 0.5 + 0.4 * 0.5), rel=1e-5)


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ('<Piece Extent="0 1 0 1"/>', "Extent of six whole numbers"),
        ('<Piece Extent="0 -2 0 1 0 1"/>', "sizes from 0"),
        ('<Piece Extent="0 9999999 0 9999999 0 9999999"/>', "sizes from 0"),
        ('<Piece Extent="0 1 0 1 0 1"/>', "expected three arrays, got 0"),
        ("", "expected a <Piece>"),
    ],
)
def test_damaged_grids(tmp_path, content, said):
    path = tmp_path / "a.vtr"
    path.write_text(f'<VTKFile type="RectilinearGrid"><RectilinearGrid>{content}</RectilinearGrid></VTKFile>')
    with pytest.raises(gb.FormatError, match=said):
        gb.read(path)


def test_an_empty_piece(tmp_path):
    path = tmp_path / "a.vtr"
    path.write_text(
        '<VTKFile type="RectilinearGrid"><RectilinearGrid><Piece Extent="0 -1 0 -1 0 -1"/></RectilinearGrid></VTKFile>'
    )
    assert len(gb.read(path)) == 0


def test_image_of_cells_and_vectors(tmp_path):
    image = vtk.vtkImageData()
    image.SetDimensions(*SIZE)
    image.SetSpacing(0.5, 1, 2)
    image.SetOrigin(1, 2, 3)
    image.GetPointData().AddArray(numbers("v", np.zeros((120, 3))))
    image.GetCellData().AddArray(numbers("rho", np.arange(60.0)))
    vtk_write(vtk.vtkXMLImageDataWriter(), tmp_path / "a.vti", image)
    volume = read_volume(tmp_path / "a.vti")
    assert np.array_equal(volume.values, np.arange(60.0).reshape(5, 4, 3))
    assert np.allclose((np.asarray(volume.world_from_voxel) @ (0, 0, 0, 1))[:3], (1.25, 2.5, 4))


def ball(x, n=50):
    data = vtk.vtkPolyData()
    points = vtk.vtkPoints()
    points.SetData(numbers("Points", np.random.default_rng(1).random((n, 3)) + (x, 0, 0)))
    data.SetPoints(points)
    data.GetPointData().AddArray(numbers("mass", np.ones(n)))
    return data


def test_collections_of_partitions(tmp_path):
    whole = vtk.vtkPartitionedDataSetCollection()
    for k in (0, 1):
        part = vtk.vtkPartitionedDataSet()
        part.SetPartition(0, ball(5 * k))
        part.SetPartition(1, ball(5 * k + 1, 20))
        whole.SetPartitionedDataSet(k, part)
        vtk_write(vtk.vtkXMLPartitionedDataSetWriter(), tmp_path / f"{k}.vtpd", part)
    vtk_write(vtk.vtkXMLPartitionedDataSetCollectionWriter(), tmp_path / "a.vtpc", whole)
    assert len(gb.read(tmp_path / "0.vtpd")) == 70
    found = gb.read(tmp_path / "a.vtpc")
    assert len(found) == 140
    assert found.bounds()[1][0] > 6
    assert "mass" in found.attributes


def sphere(x):
    source = vtk.vtkSphereSource()
    source.SetCenter(x, 0, 0)
    source.Update()
    return source.GetOutput()


def partitions(*parts):
    whole = vtk.vtkPartitionedDataSetCollection()
    for k, part in enumerate(parts):
        whole.SetPartition(k, 0, part)
    return whole


def blocks(*parts):
    whole, inner = vtk.vtkMultiBlockDataSet(), vtk.vtkMultiBlockDataSet()
    whole.SetBlock(0, parts[0])
    for k, part in enumerate(parts[1:]):
        inner.SetBlock(k, part)
    whole.SetBlock(1, inner)
    return whole


@pytest.mark.parametrize("joined", [partitions, blocks])
def test_collections_of_vtkhdf(tmp_path, joined):
    pytest.importorskip("h5py")
    path = tmp_path / "a.vtkhdf"
    vtk_write(vtk.vtkHDFWriter(), path, joined(ball(0), ball(5, 20), ball(7, 9)))
    found = gb.read(path)
    assert len(found) == 79
    assert np.allclose(found.positions[50:70, 0], ball_points(5, 20)[:, 0])
    assert found.attributes["mass"].shape == (79,)
    opened = ranges(path)
    assert opened.n == 79
    assert np.allclose(opened.read(45, 72).positions, found.positions[45:72])
    assert not has_faces(path)

    path = tmp_path / "b.vtkhdf"
    vtk_write(vtk.vtkHDFWriter(), path, joined(sphere(0), sphere(5)))
    assert has_faces(path)
    assert area(gb.Mesh(path)) == pytest.approx(2 * outer_area(sphere(0)), rel=1e-6)
    assert np.ptp(np.asarray(gb.Mesh(path).vertices)[:, 0]) == pytest.approx(6, abs=0.1)

    path = tmp_path / "c.vtkhdf"
    vtk_write(vtk.vtkHDFWriter(), path, joined(ball(0), sphere(5)))
    with pytest.warns(UserWarning, match="no particles are left out: Block_?[13]"):
        assert len(gb.read(path)) == 50
    assert not has_faces(path)


def ball_points(x, n):
    return np.random.default_rng(1).random((n, 3)) + (x, 0, 0)


def test_an_even_grid_by_name_in_a_program_is_its_outer_faces(tmp_path):
    grid, path = rectilinear(*EVEN), tmp_path / "a.vtr"
    grid.GetPointData().SetScalars(numbers("rho", np.arange(120.0)))
    vtk_write(WRITERS[".vtr"](), path, grid)
    frames = [gb.render(scene, size=(40, 30)) for scene in (str(path), gb.Mesh(path))]
    assert np.array_equal(*(frame.image for frame in frames))
    with pytest.raises(ValueError, match="got the mesh"):
        measure_surface(str(path))
