"""Files of simulation programs: GSD, LAMMPS, extended XYZ, DualSPHysics, VTK, tables."""

import json
import struct
from pathlib import Path

import globule as gb
import numpy as np
import pytest
from cli_helpers import refuses, run_json
from format_helpers import vtk_write
from globule.data.radii import find_radii
from globule.formats import FormatError, read_contents

N = 30
RNG = np.random.default_rng(4)
INSIDE = RNG.random((N, 3))  # of a unit box
OUTSIDE = INSIDE + RNG.integers(-2, 3, (N, 3))
RADII = (0.05 + 0.1 * RNG.random(N)).astype(np.float32)


def close(got: object, expected: object) -> bool:
    return bool(np.allclose(np.asarray(got), expected, rtol=1e-5, atol=1e-5))


@pytest.mark.interop
def test_gsd(tmp_path):
    hoomd = pytest.importorskip("gsd.hoomd")
    with hoomd.open(tmp_path / "run.gsd", "w") as file:
        for i in range(3):
            frame = hoomd.Frame()
            frame.configuration.step = 10 * i
            frame.configuration.box = [1, 1, 1, 0.2, 0, 0]
            frame.particles.N = N
            frame.particles.position = (OUTSIDE - 0.5).astype(np.float32)
            if i == 0:  # the others have what this one has
                frame.particles.types = ["A", "B"]
                frame.particles.typeid = np.arange(N) % 2
                frame.particles.diameter = 2 * RADII
                frame.particles.mass = np.full(N, 0.5)
            frame.particles.velocity = np.full((N, 3), float(i))
            frame.log["particles/energy"] = np.arange(N) + float(i)
            file.append(frame)
    got = read_contents(tmp_path / "run.gsd", frame=2)
    assert (got.n_frames, got.time) == (3, 20)
    particles = got.particles
    assert np.array_equal(particles.support, 4 * RADII)
    assert np.array_equal(particles.attributes["type"], np.arange(N) % 2)
    assert np.array_equal(particles.attributes["velocity"], np.full((N, 3), 2.0))
    assert np.array_equal(particles.attributes["energy"], np.arange(N) + 2.0)
    cells = (particles.positions - got.box.origin) @ np.linalg.inv(got.box.edges)
    assert (cells > -1e-5).all()
    assert (cells < 1 + 1e-5).all()
    moved = (particles.positions - (OUTSIDE - 0.5)) @ np.linalg.inv(got.box.edges)
    assert np.allclose(moved, np.rint(moved), atol=1e-4)  # by whole edges of the box
    assert close(got.box.edges, [[1, 0, 0], [0.2, 1, 0], [0, 0, 1]])


@pytest.mark.interop
def test_gsd_with_the_box_that_is_not_written(tmp_path):
    """HOOMD leaves out what is the default of its schema: a periodic box with edges of 1."""
    hoomd = pytest.importorskip("gsd.hoomd")
    with hoomd.open(tmp_path / "run.gsd", "w") as file:
        frame = hoomd.Frame()
        frame.configuration.box = [1, 1, 1, 0, 0, 0]
        frame.particles.N, frame.particles.position = 1, [[0.75, 0, 0]]
        file.append(frame)
    with pytest.warns(UserWarning, match="no diameters"):
        got = read_contents(tmp_path / "run.gsd")
    assert got.box.periodic == (True, True, True)
    assert np.array_equal(got.box.edges, np.eye(3))
    assert close(got.particles.positions, [[-0.25, 0, 0]])


@pytest.mark.interop
@pytest.mark.parametrize("second", [None, 0.8, "shape"])
def test_gsd_with_diameters_that_are_not_written(tmp_path, second, recwarn, capsys):
    """HOOMD leaves out diameters of 1: they are known by another frame, or by spheres of types."""
    hoomd = pytest.importorskip("gsd.hoomd")
    places = [[0, 0, 0], [2, 0, 0], [0, 2, 0], [0, 0, 2]]
    with hoomd.open(tmp_path / "run.gsd", "w") as file:
        for diameter in (1, second) if second == 0.8 else (1,):
            frame = hoomd.Frame()
            frame.configuration.box = [9, 9, 9, 0, 0, 0]
            frame.particles.N, frame.particles.position = 4, places
            frame.particles.diameter = np.full(4, diameter, np.float32)
            if second == "shape":
                frame.particles.types, frame.particles.typeid = ["A", "B"], [0, 0, 1, 1]
                frame.particles.type_shapes = [{"type": "Sphere", "diameter": d} for d in (0.5, 1.5)]
            file.append(frame)
    radii = find_radii(gb.read(tmp_path / "run.gsd", frame=0))
    said = [str(one.message) for one in recwarn if "no diameters" in str(one.message)]
    assert len(said) == (second is None)
    if second is None:
        assert radii is None
        how = said[0].partition("they are, ")[2].partition(" draws")[0].split()
        volume = run_json(capsys, "track", str(tmp_path / "run.gsd"), *how)["volume"]
        assert volume == pytest.approx([4 * np.pi / 6], rel=1e-5)
    else:
        assert close(radii, [0.25, 0.25, 0.75, 0.75] if second == "shape" else [0.5] * 4)


DUMP = """ITEM: TIME
{time}
ITEM: TIMESTEP
{step}
ITEM: NUMBER OF ATOMS
{n}
ITEM: BOX BOUNDS pp pp ff
0 1
0 1
-5 5
ITEM: ATOMS id type element {columns} radius vx vy vz
{rows}
"""


def dump(path: Path, columns: str, positions: np.ndarray) -> None:
    text = "ITEM: UNITS\nsi\n"
    for step in (0, 500):
        rows = [
            f"{i + 1} 1 Si {x:.9g} {y:.9g} {z:.9g} {RADII[i]:.9g} {step} 0 -1" for i, (x, y, z) in enumerate(positions)
        ]
        text += DUMP.format(time=0.001 * step, step=step, n=N, columns=columns, rows="\n".join(rows))
    path.write_text(text, encoding="utf-8")


def test_lammps_dump(tmp_path):
    dump(tmp_path / "a.dump", "xu yu zu", OUTSIDE)
    got = read_contents(tmp_path / "a.dump", frame=-1)
    assert (got.n_frames, got.time, got.units["positions"]) == (2, 0.5, "LAMMPS si")
    expected = OUTSIDE.copy()
    expected[:, :2] = INSIDE[:, :2]  # z is not periodic
    assert close(got.particles.positions, expected)
    assert close(got.particles.support, 4 * RADII)
    assert close(got.particles.attributes["velocity"], np.tile([500, 0, -1], (N, 1)))
    assert got.particles.attributes["id"].dtype.kind == "i"
    dump(tmp_path / "scaled.dump", "xs ys zs", INSIDE)
    expected = INSIDE * [1, 1, 10] + [0, 0, -5]
    assert close(gb.read(tmp_path / "scaled.dump").positions, expected)


def test_lammps_triclinic_dump(tmp_path):
    """The bounds are those of the corners: LAMMPS, "Howto triclinic"."""
    head = "ITEM: TIMESTEP\n0\nITEM: NUMBER OF ATOMS\n1\nITEM: BOX BOUNDS xy xz yz pp pp pp\n"
    body = "0 3.5 0.5\n0 2 0\n0 1 0\nITEM: ATOMS id type xs ys zs\n1 1 0.5 0.5 0.5\n"
    (tmp_path / "a.dump").write_text(head + body)
    got = read_contents(tmp_path / "a.dump")
    assert close(got.box.edges, [[3, 0, 0], [0.5, 2, 0], [0, 0, 1]])
    assert close(got.particles.positions, [[1.75, 1.0, 0.5]])


@pytest.mark.interop
def test_lammps_by_ase(tmp_path):
    ase = pytest.importorskip("ase")
    from ase.io.lammpsdata import write_lammps_data

    atoms = ase.Atoms("Si" * N, positions=INSIDE, cell=[1, 1, 1], pbc=True)
    write_lammps_data(tmp_path / "in.data", atoms, atom_style="atomic", masses=True)
    got = read_contents(tmp_path / "in.data")
    assert close(got.particles.positions, INSIDE)
    assert close(got.box.edges, np.eye(3))


@pytest.mark.interop
def test_extended_xyz_by_ase(tmp_path):
    ase = pytest.importorskip("ase")
    ase_io = pytest.importorskip("ase.io")

    frames = []
    for i in range(2):
        atoms = ase.Atoms("OH" * (N // 2), positions=OUTSIDE, cell=[1, 1, 1], pbc=[True, True, False])
        atoms.set_array("radius", RADII.astype(float))
        atoms.set_array("kind", np.arange(N) + i)
        frames.append(atoms)
    ase_io.write(tmp_path / "a.xyz", frames, format="extxyz")
    got = read_contents(tmp_path / "a.xyz", frame=1)
    assert got.n_frames == 2
    assert got.box.periodic == (True, True, False)
    assert close(got.particles.positions[:, :2], INSIDE[:, :2])
    assert close(got.particles.support, 4 * RADII)
    assert np.array_equal(got.particles.attributes["kind"], np.arange(N) + 1)
    del frames[0].arrays["radius"]
    ase_io.write(tmp_path / "b.xyz", frames[0], format="extxyz")
    assert close(gb.read(tmp_path / "b.xyz").support[:2], [4 * 1.52, 4 * 1.20])  # Bondi 1964


def text(word: str) -> bytes:
    return struct.pack("<I", len(word)) + word.encode()


def item(name: str, values: bytes, n_values: int, arrays: bytes, n_arrays: int, items: bytes,
         n_items: int) -> bytes:  # fmt: skip
    values = text("\nVALUES") + struct.pack("<I", n_values) + values if n_values else b""
    head = text("\nITEM\n") + text(name) + bytes(8) + text("%.7E") + text("%.15E")
    head += struct.pack("<III", n_arrays, n_items, len(values))
    return struct.pack("<I", len(head)) + head + values + arrays + items


def array(name: str, kind: int, values: np.ndarray) -> bytes:
    head = text("\nARRAY") + text(name) + struct.pack("<IIII", 0, kind, len(values), values.nbytes)
    return struct.pack("<I", len(head)) + head + values.tobytes()


def bi4() -> bytes:
    """As JPartDataBi4::SaveFileData of DualSPHysics writes it."""
    doubles = {"H": 0.02, "MassBound": 0.3, "MassFluid": 0.4}
    counts = {"CaseNfixed": 5, "CaseNmoving": 0, "CaseNfloat": 2, "CaseNfluid": N - 7}
    values = b"".join(text(k) + struct.pack("<Id", 12, v) for k, v in doubles.items())
    values += b"".join(text(k) + struct.pack("<IQ", 10, v) for k, v in counts.items())
    values += text("RunCode") + struct.pack("<I", 1) + text("abc")
    values += text("MapPosMin") + struct.pack("<Iddd", 23, 0, 0, 0)
    values += text("MapPosMax") + struct.pack("<Iddd", 23, 1, 1, 1)
    arrays = array("Idp", 8, np.arange(N, dtype="<u4")) + array("Posd", 23, INSIDE.astype("<f8"))
    arrays += array("Vel", 22, np.ones((N, 3), "<f4")) + array("Rhop", 11, np.full(N, 1e3, "<f4"))
    part = item("PART_0007", text("TimeStep") + struct.pack("<Id", 12, 0.35), 1, arrays, 4, b"", 0)
    head = b"#FileJBD JPartDataBi4".ljust(58) + b"\n\0" + bytes(4)
    return head + item("JPartDataBi4", values, 10, b"", 0, part, 1)


def test_bi4(tmp_path):
    (tmp_path / "Part_0007.bi4").write_bytes(bi4())
    got = read_contents(tmp_path / "Part_0007.bi4")
    particles = got.particles
    assert np.array_equal(particles.positions, INSIDE.astype(np.float32))
    assert got.time == 0.35
    units = {"positions": "m", "velocity": "m/s", "density": "kg/m³", "mass": "kg", "h": "m"}
    assert got.units.items() <= units.items()
    assert {"positions", "velocity", "density"} <= got.units.keys()
    assert close(got.box.edges, np.eye(3))
    assert particles.attributes["type"].tolist() == [0] * 5 + [2] * 2 + [3] * (N - 7)
    assert close(particles.support, 0.04)
    assert close(particles.weight[-1], 8 * 0.4 / (1000 * 0.04**3))
    assert close(particles.attributes["mass"][:5], 0.3)


@pytest.mark.parametrize(("axes", "spacing"), [(2, 0.01), (2, 40.0), (3, 0.01), (3, 40.0)])
def test_the_weight_of_sph_is_that_of_its_plane_or_space(tmp_path, axes, spacing):
    places = np.stack(np.meshgrid(*[np.arange(6.0)] * axes), -1).reshape(-1, axes) * spacing
    held = [1.3 * spacing, 1000 * spacing**axes, 1000]
    columns = np.concatenate([places, np.tile(held, (len(places), 1))], 1)
    header = ",".join([*"xyz"[:axes], "h", "m", "rho"])
    np.savetxt(tmp_path / "a.csv", columns, delimiter=",", comments="", header=header)
    assert close(gb.read(tmp_path / "a.csv").weight, 1.3**-axes)


def test_collections_of_files(tmp_path):
    names = [f"{i}.vtp" for i in range(3)]
    for i, name in enumerate(names):
        gb.write(tmp_path / name, gb.Particles(INSIDE + i, attributes={"mass": np.full(N, float(i))}))
    times = zip(names, (0.5, 0.5, 1.5), (0, 1, 0), strict=True)
    sets = "".join(f'<DataSet timestep="{t}" part="{p}" file="{name}"/>' for name, t, p in times)
    (tmp_path / "a.pvd").write_text(f'<VTKFile type="Collection"><Collection>{sets}</Collection></VTKFile>')
    got = read_contents(tmp_path / "a.pvd")
    assert (got.n_frames, got.time, len(got.particles)) == (2, 0.5, 2 * N)
    assert close(got.particles.attributes["mass"], np.repeat([0, 1], N))
    assert close(gb.read(tmp_path / "a.pvd", frame=1).positions, INSIDE + 2)
    files = [{"name": name, "time": i} for i, name in enumerate(names)]
    (tmp_path / "a.vtp.series").write_text(json.dumps({"file-series-version": "1.0", "files": files}))
    got = read_contents(tmp_path / "a.vtp.series", frame=2)
    assert (got.n_frames, got.time) == (3, 2.0)
    assert close(got.particles.positions, INSIDE + 2)


@pytest.mark.parametrize("name", ["../secret.vtp", "a.pvd", "", "sub/../../secret.vtp", "no.vtp"])
def test_collections_open_files_below_them_alone(tmp_path, name):
    (tmp_path / "run").mkdir()
    gb.write(tmp_path / "secret.vtp", gb.Particles(INSIDE))
    content = f'<VTKFile type="Collection"><Collection><DataSet file="{name}"/></Collection></VTKFile>'
    (tmp_path / "run/a.pvd").write_text(content)
    refuses(r"a\.pvd: expected (a|the) file ", gb.read, tmp_path / "run/a.pvd", error=FormatError)


def vtk_cloud() -> object:
    pyvista = pytest.importorskip("pyvista")
    cloud = pyvista.PolyData(INSIDE.astype(np.float32))
    cloud["mass"] = np.arange(N) + 0.5
    return cloud


@pytest.mark.interop
def test_blocks_and_pieces_by_vtk(tmp_path):
    vtk = pytest.importorskip("vtk")
    blocks = vtk.vtkMultiBlockDataSet()
    blocks.SetBlock(0, vtk_cloud())
    blocks.SetBlock(2, vtk_cloud())  # block 1 is empty
    blocks.GetMetaData(1).Set(vtk.vtkCompositeDataSet.NAME(), "none")
    vtk_write(vtk.vtkXMLMultiBlockDataWriter(), tmp_path / "a.vtm", blocks)
    assert len(gb.read(tmp_path / "a.vtm")) == 2 * N
    writer = vtk.vtkXMLPPolyDataWriter()
    writer.SetNumberOfPieces(1)
    vtk_write(writer, tmp_path / "b.pvtp", vtk_cloud())
    particles = gb.read(tmp_path / "b.pvtp")
    assert close(particles.positions, INSIDE)
    assert close(particles.attributes["mass"], np.arange(N) + 0.5)


def test_tables(tmp_path):
    for table, units in (
        ("# by hand\nx [m];y [m];z [m];rho [kg/m3]\n1;2;3;1000\n4;5;6;1001\n", {"positions": "m", "rho": "kg/m3"}),
        ("x\ty\tz\trho (kg/m3)\n1\t2\t3\t1000\n# half\n4\t5\t6\t1001\n", {"rho": "kg/m3"}),
        ("# time = 0.5\n# x, y, z, rho\n1,2,3,1000\n4,5,6,1001\n", {}),
    ):
        (tmp_path / "a.csv").write_text(table)
        got = read_contents(tmp_path / "a.csv")
        assert np.array_equal(got.particles.positions, [[1, 2, 3], [4, 5, 6]])
        assert got.particles.attributes["rho"].tolist() == [1000, 1001]
        assert got.units == units


def test_a_column_map(tmp_path):
    (tmp_path / "a.csv").write_text("a,b,c,size,other\n1,2,3,0.5,9\n4,5,6,0.25,9\n")
    columns = {"x": "a", "y": "b", "z": "c", "radius": "size"}
    particles = gb.read(tmp_path / "a.csv", columns=columns)
    assert np.array_equal(particles.positions, [[1, 2, 3], [4, 5, 6]])
    assert np.array_equal(particles.support, [2, 1])
    assert "other" not in particles.attributes
    with pytest.raises(FormatError, match=r"a\.csv: line 1: expected the column 'd'"):
        gb.read(tmp_path / "a.csv", columns={**columns, "z": "d"})
    with pytest.raises(TypeError, match="columns: expected names by name, a dict, got str"):
        gb.read(tmp_path / "a.csv", columns="a")


def test_two_dimensions(tmp_path):
    plane = INSIDE[:, :2].astype(np.float32)
    expected = np.pad(plane, ((0, 0), (0, 1)))
    np.save(tmp_path / "a.npy", plane)
    np.savez(tmp_path / "b.npz", positions=plane, mass=np.ones(N))
    np.savez(tmp_path / "c.npz", x=plane[:, 0], y=plane[:, 1])
    np.savez(tmp_path / "d.npz", x=plane[:, 0], y=plane[:, 1], z=np.zeros(N), h=RADII)
    np.savetxt(tmp_path / "e.csv", plane, header="x,y", delimiter=",", comments="")
    np.savetxt(tmp_path / "f.txt", plane)
    np.savetxt(tmp_path / "g.txt", plane, header="pos_x pos_y")
    np.savetxt(tmp_path / "h.csv", plane, header="Points_0,Points_1", delimiter=",", comments="")
    for name in ("a.npy", "b.npz", "c.npz", "d.npz", "e.csv", "f.txt", "g.txt", "h.csv"):
        assert np.array_equal(gb.read(tmp_path / name).positions, expected), name
    assert np.array_equal(gb.read(tmp_path / "d.npz").support, 2 * RADII)


def test_a_reader_of_another_package(tmp_path, monkeypatch):
    """What its entry point names reads files with its content or ending."""
    from globule.formats import registry

    module = "import globule as gb, numpy as np\nfrom globule.formats import Format\n" + (
        "FORMAT = Format('mine', 'their_reader', ('.mine',), rb'MINE')\n"
        "def read(path):\n    return gb.Particles(np.loadtxt(path, skiprows=1, ndmin=2))\n"
    )
    (tmp_path / "their_reader.py").write_text(module)
    (tmp_path / "theirs-1.0.dist-info").mkdir()
    (tmp_path / "theirs-1.0.dist-info/METADATA").write_text("Name: theirs\nVersion: 1.0\n")
    (tmp_path / "their_tables.py").write_text(
        module.replace("'mine'", "'rows'").replace("('.mine',), rb'MINE'", "('.rows',)")
    )
    points = (
        "[globule.readers]\nmine = their_reader:FORMAT\nbroken = no_such_module:FORMAT\nrows = their_tables:FORMAT\n"
    )
    (tmp_path / "theirs-1.0.dist-info/entry_points.txt").write_text(points)
    monkeypatch.syspath_prepend(tmp_path)
    registry.formats.cache_clear()
    try:
        (tmp_path / "a.mine").write_text("MINE\n1 2 3\n")
        (tmp_path / "no_ending").write_text("MINE\n1 2 3\n")
        with pytest.warns(UserWarning, match="reader broken"):
            first = gb.read(tmp_path / "a.mine")
        assert np.array_equal(first.positions, [[1, 2, 3]])
        assert np.array_equal(gb.read(tmp_path / "no_ending").positions, [[1, 2, 3]])
        (tmp_path / "a.rows").write_text("9 9 9\n1 2 3\n")  # looks like a table of globule's own
        assert np.array_equal(gb.read(tmp_path / "a.rows").positions, [[1, 2, 3]])
        (tmp_path / "a.rows").write_text("damaged\n1 2 three\n")
        with pytest.raises(FormatError, match=r"a\.rows: reader .rows. .their_reader.: ValueE"):
            gb.read(tmp_path / "a.rows")
    finally:
        registry.formats.cache_clear()
