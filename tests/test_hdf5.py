"""HDF5 files of simulation programs, written by their own libraries where there are any."""

import os
import re
from pathlib import Path

import globule as gb
import numpy as np
import pytest
from cli_helpers import refused, refuses, run_json
from format_helpers import vtk_write
from globule import cli
from globule.formats import FormatError, hdf5, read_contents
from globule.formats.frames import FrameOf
from globule.formats.triangles import has_faces
from test_cells import area

h5py = pytest.importorskip("h5py")
N = 50
RNG = np.random.default_rng(3)
POSITIONS = RNG.random((N, 3))
VELOCITY = RNG.normal(size=(N, 3)).astype(np.float32)
H = (0.1 + 0.05 * RNG.random(N)).astype(np.float32)
MASS, DENSITY = np.full(N, 0.02), 900 + 100 * RNG.random(N)


def gadget(path: Path, **options) -> None:
    with h5py.File(path, "w") as file:
        header = file.create_group("Header")
        header.attrs.update({"BoxSize": 1.0, "Time": 0.25, "NumPart_ThisFile": [N, 7, 0, 0, 0, 0]})
        file.create_group("Parameters").attrs["PeriodicBoundariesOn"] = 1
        gas, dark = file.create_group("PartType0"), file.create_group("PartType1")
        for name, values in (("Coordinates", POSITIONS), ("Velocities", VELOCITY),
                             ("Masses", MASS), ("Density", DENSITY), ("SmoothingLength", H),
                             ("ParticleIDs", np.arange(N, dtype=np.uint64))):  # fmt: skip
            gas.create_dataset(name, data=values, **options)
        dark["Coordinates"] = POSITIONS[:7] + 1.0


@pytest.mark.parametrize("options", [{}, {"compression": "gzip", "chunks": True, "shuffle": True}])
def test_gadget(tmp_path, options):
    path = tmp_path / "snapshot.hdf5"
    gadget(path, **options)
    got = read_contents(path)
    particles = got.particles
    assert np.array_equal(particles.positions, POSITIONS.astype(np.float32))
    assert np.array_equal(particles.attributes["velocity"], VELOCITY)
    assert particles.attributes["id"].dtype == np.uint64
    assert np.array_equal(particles.support, H)  # where Gadget's kernel ends
    expected = 8 * MASS / (DENSITY * H.astype(float) ** 3)
    assert np.allclose(particles.weight, expected, rtol=1e-6)
    assert got.time == 0.25
    assert got.box.periodic == (True, True, True)
    assert np.array_equal(got.box.edges, np.eye(3))
    dark = gb.read(path, species="PartType1")
    assert np.allclose(dark.positions, POSITIONS[:7], atol=1e-6)  # wrapped
    refuses(r"species: expected one of PartType0, PartType1 .*'gas'", gb.read, path, species="gas")


@pytest.mark.parametrize("mass", [0.02, 0.0])
def test_gadget_with_one_mass_in_the_header(tmp_path, mass):
    """MassTable holds the mass of a kind whose particles are all alike; 0 where they are not."""
    path = tmp_path / "snapshot.hdf5"
    gadget(path)
    with h5py.File(path, "a") as file:
        del file["PartType0/Masses"]
        file["Header"].attrs["MassTable"] = np.array([mass, 3.0, 0, 0, 0, 0])
    gas = gb.read(path)
    assert ("mass" in gas.attributes) == (mass > 0)
    if mass:
        assert np.array_equal(gas.attributes["mass"], MASS)
        assert np.allclose(gas.weight, 8 * MASS / (DENSITY * H.astype(float) ** 3), rtol=1e-6)
    assert gb.read(path, species="PartType1").attributes["mass"].tolist() == [3.0] * 7


def test_one_file_of_several_says_so(tmp_path):
    gadget(tmp_path / "snapshot.0.hdf5")
    with h5py.File(tmp_path / "snapshot.0.hdf5", "a") as file:
        file["Header"].attrs["NumFilesPerSnapshot"] = 4
    with pytest.warns(UserWarning, match=r"snapshot\.0\.hdf5: one of 4 files of this snapshot"):
        assert len(gb.read(tmp_path / "snapshot.0.hdf5")) == N


def test_half_the_support_as_spacing_has_weight_one(tmp_path):
    """Equal particles with a support of two spacings: the weight is that of the default."""
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["positions"] = POSITIONS
        file["h"], file["rho"] = np.full(N, 0.05), np.full(N, 1000.0)
        file["mass"] = np.full(N, 1000.0 * 0.05**3)
    particles = gb.read(tmp_path / "a.h5")
    assert np.allclose(particles.support, 0.1)
    assert np.allclose(particles.weight, 1.0)


@pytest.mark.slow
@pytest.mark.interop
def test_swift(tmp_path):
    swiftsimio = pytest.importorskip("swiftsimio")
    import unyt

    units = swiftsimio.Writer(unit_system="cgs", boxsize=np.ones(3) * unyt.cm, dimension=3,
                              scale_factor=1.0)  # fmt: skip
    cosmo = {"comoving": False, "scale_factor": 1.0, "scale_exponent": 0}
    array = swiftsimio.cosmo_array
    units.gas.coordinates = array(POSITIONS, unyt.cm, **{**cosmo, "scale_exponent": 1})
    units.gas.velocities = array(VELOCITY.astype(float), unyt.cm / unyt.s, **cosmo)
    units.gas.masses = array(MASS, unyt.g, **cosmo)
    units.gas.internal_energy = array(np.ones(N), unyt.erg / unyt.g, **cosmo)
    units.gas.smoothing_lengths = array(H.astype(float), unyt.cm, **{**cosmo, "scale_exponent": 1})
    units.write(str(tmp_path / "swift.hdf5"))
    with h5py.File(tmp_path / "swift.hdf5", "a") as file:  # as the program itself writes it
        file.require_group("HydroScheme").attrs["Kernel gamma"] = np.array([1.936492])
    got = read_contents(tmp_path / "swift.hdf5")
    assert np.array_equal(got.particles.positions, POSITIONS.astype(np.float32))
    assert np.allclose(got.particles.support, 1.936492 * H, rtol=1e-6)
    assert np.allclose(got.box.edges, np.eye(3))
    assert got.box.periodic == (True, True, True)


def h5part(path) -> None:
    with h5py.File(path, "w") as file:
        for i in (0, 2, 10):
            group = file.create_group(f"Step#{i}")
            group.attrs["TimeValue"] = 0.1 * i
            for k, name in enumerate("xyz"):
                group[name] = POSITIONS[:, k] + i
            group["q"] = np.arange(N, dtype=np.int64)


def test_h5part(tmp_path):
    h5part(tmp_path / "run.h5part")
    last = read_contents(tmp_path / "run.h5part", frame=-1)
    assert (last.n_frames, last.time) == (3, 1.0)
    assert np.array_equal(last.particles.positions, (POSITIONS + 10).astype(np.float32))
    assert np.array_equal(last.particles.attributes["q"], np.arange(N))
    refuses(r"frame: expected -3 to 2 for .*, got 3", gb.read, tmp_path / "run.h5part", frame=3)
    with pytest.raises(ValueError, match=r"species: expected none for .*h5part, which has no"):
        gb.read(tmp_path / "run.h5part", species="gas")


def pysph(path) -> None:
    with h5py.File(path, "w") as file:  # as pysph.solver.output writes it
        file.create_group("solver_data").attrs.update({"t": 0.5, "dt": 1e-3, "count": 10})
        for name, n in (("wall", 5), ("fluid", N)):
            arrays = file.create_group(f"particles/{name}/arrays")
            for k, axis in enumerate("xyz"):
                arrays.create_dataset(axis, data=POSITIONS[:n, k], compression="gzip")
            for k, axis in enumerate("uvw"):
                arrays[axis] = VELOCITY[:n, k]
            arrays["h"], arrays["m"], arrays["rho"] = H[:n], MASS[:n], DENSITY[:n]
            arrays.create_dataset("au", (0,), dtype="f8")
            file.create_group(f"particles/{name}/constants")["c0"] = [10.0]


def test_pysph(tmp_path):
    pysph(tmp_path / "drop_10.hdf5")
    got = read_contents(tmp_path / "drop_10.hdf5")
    assert got.time == 0.5
    assert np.allclose(got.particles.positions, POSITIONS)
    assert np.allclose(got.particles.support, 2 * H)
    assert np.array_equal(got.particles.attributes["velocity"], VELOCITY)
    assert set(got.particles.attributes) == {"velocity", "h", "mass", "density"}
    assert len(gb.read(tmp_path / "drop_10.hdf5", species="wall")) == 5


@pytest.mark.interop
@pytest.mark.parametrize("constant_offset", [True, False])
def test_openpmd(tmp_path, constant_offset):
    openpmd = pytest.importorskip("openpmd_api")
    series = openpmd.Series(str(tmp_path / "run.h5"), openpmd.Access.create)
    offsets = np.arange(N, dtype=np.float64)[:, None] * np.ones(3)
    for i in (5, 40):
        iteration = series.iterations[i]
        iteration.time, iteration.time_unit_SI = float(i), 1e-15
        electrons = iteration.particles["electrons"]
        dataset = openpmd.Dataset(np.dtype(np.float64), [N])
        records = {"position": (1e-6, POSITIONS + i), "positionOffset": (1e-6, offsets), "momentum": (2.0, VELOCITY)}
        for name, (unit, values) in records.items():
            for axis, column in zip("xyz", np.float64(values).T, strict=True):
                component = electrons[name][axis]
                component.reset_dataset(dataset)
                component.unit_SI = unit
                if name == "positionOffset" and constant_offset:
                    component.make_constant(100.0)
                else:
                    component.store_chunk(np.ascontiguousarray(column))
        weighting = electrons["weighting"][openpmd.Record_Component.SCALAR]
        weighting.reset_dataset(dataset)
        weighting.store_chunk(MASS)
        series.flush()
    series.close()
    got = read_contents(tmp_path / "run.h5", frame=1, species="electrons")
    moved = 100.0 if constant_offset else offsets
    assert np.allclose(got.particles.positions, 1e-6 * (POSITIONS + 40 + moved), rtol=1e-6)
    assert np.allclose(got.particles.attributes["momentum"], 2 * VELOCITY)
    assert np.array_equal(got.particles.attributes["weighting"], MASS)
    assert got.units["positions"] == "m"
    assert (got.n_frames, got.time) == (2, pytest.approx(40e-15))


@pytest.mark.interop
def test_vtkhdf_by_vtk(tmp_path):
    vtk = pytest.importorskip("vtk")
    from vtk.util.numpy_support import numpy_to_vtk

    cloud = vtk.vtkPolyData()
    points = vtk.vtkPoints()
    points.SetData(numpy_to_vtk(POSITIONS, deep=True))
    cloud.SetPoints(points)
    speed = numpy_to_vtk(VELOCITY, deep=True)
    speed.SetName("velocity")
    cloud.GetPointData().AddArray(speed)
    vtk_write(vtk.vtkHDFWriter(), tmp_path / "cloud.vtkhdf", cloud)
    particles = gb.read(tmp_path / "cloud.vtkhdf")
    assert np.array_equal(particles.positions, POSITIONS.astype(np.float32))
    assert np.array_equal(particles.attributes["velocity"], VELOCITY)


def vtkhdf(path) -> None:
    with h5py.File(path, "w") as file:
        root = file.create_group("VTKHDF")
        root.attrs["Version"], root.attrs["Type"] = (2, 0), np.bytes_("PolyData")
        root["NumberOfPoints"] = [10, 15, 25]
        root["Points"] = POSITIONS
        root["PointData/mass"] = MASS + np.arange(N)
        steps = root.create_group("Steps")
        steps["Values"], steps["PartOffsets"] = [0.0, 0.5], [0, 1]
        steps["NumberOfParts"], steps["PointOffsets"] = [1, 2], [0, 10]
        steps["PointDataOffsets/mass"] = [0, 10]


def test_vtkhdf_over_time(tmp_path):
    vtkhdf(tmp_path / "run.vtkhdf")
    got = read_contents(tmp_path / "run.vtkhdf", frame=1)
    assert (got.time, got.n_frames) == (0.5, 2)
    assert np.array_equal(got.particles.positions, POSITIONS[10:].astype(np.float32))
    assert np.array_equal(got.particles.attributes["mass"], (MASS + np.arange(N))[10:])


CUBE = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1]], float)


def vtkhdf_mesh(path, **changed) -> None:
    """Two unit cubes that share a face, in parts of their own, then a square away from them, of two triangles."""
    with h5py.File(path, "w") as file:
        root = file.create_group("VTKHDF")
        root.attrs["Version"], root.attrs["Type"] = (2, 0), np.bytes_("UnstructuredGrid")
        tables = {
            "Points": np.concatenate([CUBE, CUBE + (1, 0, 0), CUBE[:4] + (0, 0, 9)]),
            "NumberOfPoints": [8, 8, 4], "NumberOfCells": [1, 1, 2], "NumberOfConnectivityIds": [8, 8, 6],
            "Connectivity": [*range(8), *range(8), 0, 1, 2, 0, 2, 3], "Offsets": [0, 8, 0, 8, 0, 3, 6],
            "Types": np.array([12, 12, 5, 5], np.uint8),
            "Steps/Values": [0.0, 0.5], "Steps/PartOffsets": [0, 2], "Steps/NumberOfParts": [2, 1],
            "Steps/PointOffsets": [0, 16], "Steps/CellOffsets": [0, 2], "Steps/ConnectivityIdOffsets": [0, 16],
        }  # fmt: skip
        for name, values in (tables | changed).items():
            root[name] = values


def test_cells_of_vtkhdf_are_meshes(tmp_path):
    """Points of two parts are two points, so that the shared face is drawn from both sides."""
    vtkhdf_mesh(tmp_path / "a.vtkhdf")
    assert has_faces(tmp_path / "a.vtkhdf")
    mesh = gb.Mesh(tmp_path / "a.vtkhdf")
    assert area(mesh) == pytest.approx(12)
    assert len(mesh.vertices) == 16
    vtkhdf(tmp_path / "points.vtkhdf")
    assert not has_faces(tmp_path / "points.vtkhdf")
    later = gb.Mesh(FrameOf(tmp_path / "a.vtkhdf", 1))
    assert len(later.vertices) == 4
    assert area(later) == pytest.approx(1)
    assert np.all(np.asarray(later.vertices)[:, 2] == 9)


def test_damaged_cells_of_vtkhdf(tmp_path):
    cases = [
        ({"Offsets": [0, 8, 0]}, "/VTKHDF/Offsets: expected at least 4 rows, got 3"),
        ({"Offsets": [0, 9, 0, 8, 0, 3, 6]}, "expected offsets from 0 up to"),
        ({"Offsets": [5, 2, 0, 8, 0, 3, 6]}, "expected offsets from 0 up to"),
        ({"NumberOfCells": [10**12, 1, 2]}, "/VTKHDF/Types: expected at least 1000000000000 rows"),
        ({"NumberOfConnectivityIds": []}, "/VTKHDF/Steps: expected 1 entries, got 0"),
        ({"Connectivity": [*range(8), *range(1, 9), 0, 1, 2, 0, 2, 3]}, "expected indices from 0 to 7, got 1 to 8"),
        ({"Types": np.array([12, 42, 5, 5], np.uint8)}, "expected cells other than polyhedra"),
    ]
    for n, (changed, problem) in enumerate(cases):
        path = tmp_path / f"{n}.vtkhdf"  # HDF5 locks a file until nothing holds its reader
        vtkhdf_mesh(path, **changed)
        refuses(re.escape(problem), gb.Mesh, path, error=gb.FormatError)


@pytest.mark.interop
def test_meshes_by_vtks_hdf_writer(tmp_path):
    vtk = pytest.importorskip("vtk")
    grid = vtk.vtkCellTypeSource()
    grid.SetCellType(vtk.VTK_TETRA)
    grid.SetBlocksDimensions(2, 3, 4)
    sphere = vtk.vtkSphereSource()
    for source, expected in ((grid, 2 * (6 + 8 + 12)), (sphere, None)):
        source.Update()
        vtk_write(vtk.vtkHDFWriter(), tmp_path / "a.vtkhdf", source.GetOutput())
        if expected is None:
            mass = vtk.vtkMassProperties()
            mass.SetInputData(source.GetOutput())
            expected = mass.GetSurfaceArea()
        assert area(gb.Mesh(tmp_path / "a.vtkhdf")) == pytest.approx(expected, rel=1e-6)


@pytest.mark.interop
@pytest.mark.parametrize("how", ["HDF", "XML"])
def test_xdmf_by_meshio(folder, how):
    meshio = pytest.importorskip("meshio")
    data = {"mass": MASS, "velocity": VELOCITY.astype(float)}
    cells = [("vertex", np.arange(N)[:, None])]
    mesh = meshio.Mesh(POSITIONS, cells, point_data=data)
    meshio.write("a.xdmf", mesh, data_format=how)
    particles = gb.read("a.xdmf")
    assert np.allclose(particles.positions, POSITIONS, atol=1e-6)
    assert np.array_equal(particles.attributes["mass"], MASS)
    assert particles.attributes["velocity"].shape == (N, 3)
    if how == "HDF":
        Path("a.xdmf").write_text(
            Path("a.xdmf").read_text(encoding="utf-8").replace("a.h5:", "../b.h5:"), encoding="utf-8"
        )
        refuses(r"a\.xdmf: expected a file below the same folder", gb.read, "a.xdmf", error=FormatError)


def test_columns_name_the_data_sets(tmp_path):
    with h5py.File(tmp_path / "own.h5", "w") as file:
        file["run/where"] = POSITIONS[:, :2]
        file["run/size"] = H
    with pytest.raises(FormatError, match=r"own\.h5: expected particles .*; name its data sets: --columns"):
        gb.read(tmp_path / "own.h5")
    particles = gb.read(tmp_path / "own.h5", columns={"positions": "run/where", "radius": "run/size"})
    assert np.array_equal(particles.positions[:, :2], POSITIONS[:, :2].astype(np.float32))
    assert not particles.positions[:, 2].any()  # 2-D data lie in the plane z = 0
    assert np.allclose(particles.support, 4 * H)
    with pytest.raises(FormatError, match=r"own\.h5: /run/no: expected a data set"):
        gb.read(tmp_path / "own.h5", columns={"positions": "run/no"})


def test_other_files_are_not_opened(tmp_path):
    gadget(tmp_path / "secret.hdf5")
    with h5py.File(tmp_path / "link.hdf5", "w") as file:
        file["positions"] = h5py.ExternalLink("secret.hdf5", "/PartType0/Coordinates")
        layout = h5py.VirtualLayout((N, 3), np.float64)
        layout[:] = h5py.VirtualSource("secret.hdf5", "PartType0/Coordinates", (N, 3))
        file.create_virtual_dataset("Coordinates", layout)
    with pytest.raises(FormatError, match=r"link\.hdf5: expected particles .* got 'nothing'"):
        gb.read(tmp_path / "link.hdf5")


def test_large_arrays_are_read_in_pieces(tmp_path, monkeypatch):
    path = tmp_path / "snapshot.hdf5"
    gadget(path)
    whole = gb.read(path)
    monkeypatch.setattr(hdf5, "_PIECE", 56)  # the last piece is shorter
    pieces = gb.read(path)
    assert np.array_equal(pieces.positions, whole.positions)
    assert np.array_equal(pieces.attributes["velocity"], VELOCITY)
    with open(path, "rb") as file:
        memory = memoryview(bytearray(200))
        size = os.fstat(file.fileno()).st_size
        assert hdf5._fill(memory, file.fileno(), size - 200)
        assert not hdf5._fill(memory, file.fileno(), size - 199)


def test_a_claim_without_data_is_refused(tmp_path):
    with h5py.File(tmp_path / "bomb.h5", "w") as file:
        file.create_dataset("positions", (10**9, 3), "f4", chunks=(1 << 20, 3), compression="gzip")
    assert os.path.getsize(tmp_path / "bomb.h5") < 1 << 20
    with pytest.raises(FormatError, match=r"bomb\.h5: header: expected at most .* got a claim of"):
        gb.read(tmp_path / "bomb.h5")


def test_info_lists_what_a_file_holds_and_no_option_is_ignored(tmp_path, capsys):
    path = tmp_path / "run.hdf5"
    gadget(path)
    assert read_contents(path).species == ("PartType0", "PartType1")
    assert cli.main(["info", str(path)]) == 0
    told = capsys.readouterr().out
    assert "species    PartType0, PartType1: --species NAME" in told
    assert "  box        from 0 0 0, edges 1 0 0  0 1 0  0 0 1, periodic along xyz" in told
    assert "  time       " in told
    assert run_json(capsys, "info", str(path), "--species", "PartType1")["particles"] == 7
    assert "species: expected one of PartType0, PartType1" in refused(capsys, "info", str(path), "--species", "gas")
    refuses(r"frame: expected -1 to 0 for .*run\.hdf5, got 3", gb.read, path, frame=3)
    with pytest.raises(ValueError, match="species: expected none beside columns"):
        gb.read(path, species="PartType0", columns={"positions": "PartType0/Coordinates"})
    h5part(tmp_path / "run.h5part")
    assert run_json(capsys, "info", str(tmp_path / "run.h5part"))["frames"] == 3


def test_runs_may_begin_without_particles(tmp_path):
    """openPMD and plain data sets of none, and of tables; the file may be written at once after it was refused."""
    for k, places in enumerate(({"positions": np.empty((0, 3))}, {"x": [], "y": [], "z": []}, {})):
        with h5py.File(tmp_path / "a.h5", "w") as file:
            if not places:
                file.attrs.update({"openPMD": "1.1.0", "basePath": "/data/%T/", "particlesPath": "particles/"})
                places = {f"data/0/particles/e/position/{axis}": np.empty(0) for axis in "xyz"}
            for name, values in places.items():
                file[name] = np.asarray(values, float)
        assert len(gb.read(tmp_path / "a.h5")) == 0, k
        with h5py.File(tmp_path / "a.h5", "w") as file:
            file["nothing"] = np.ones(3)
        with pytest.raises(FormatError, match="expected particles in a known layout"):
            gb.read(tmp_path / "a.h5")
