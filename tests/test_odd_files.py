"""Files with odd but legal content, as programs write them, and what must be read from them."""

import globule as gb
import numpy as np
import pytest
from format_helpers import naming
from globule.cli import main
from globule.data.radii import find_radii
from globule.formats import read_contents
from globule.formats.ranges import has_ranges, ranges
from globule.render.sequence import time_of
from test_cells import area

TURNED = np.array([[0, 2, 0], [-3, 0, 0], [1, 0, 4]], float)  # edges of a box
CORNER = np.array([10, 20, -5.0])
SHARES = np.random.default_rng(3).random((30, 3))
PLACES = CORNER + SHARES @ TURNED


def lines(table) -> str:
    return "".join(" ".join(f"{v:.9g}" for v in row) + "\n" for row in table)


@pytest.mark.parametrize(("names", "table"), [("x y z", PLACES + TURNED[0]), ("xs ys zs", SHARES)])
def test_a_general_triclinic_box_of_a_lammps_dump(tmp_path, names, table):
    box = lines(np.column_stack([TURNED, CORNER]))
    (tmp_path / "a.dump").write_text(
        "ITEM: TIMESTEP\n0\nITEM: NUMBER OF ATOMS\n30\nITEM: BOX BOUNDS abc origin pp pp pp\n"
        f"{box}ITEM: ATOMS {names}\n{lines(table)}"
    )
    found = read_contents(tmp_path / "a.dump")
    assert np.allclose(found.box.edges, TURNED)
    assert np.allclose(found.box.origin, CORNER)
    assert np.allclose(found.particles.world_positions(), PLACES, atol=1e-5)  # wrapped


def test_a_general_triclinic_box_of_lammps_data(tmp_path):
    edges = "".join(f"{a} {b} {c} {name}\n" for (a, b, c), name in zip(TURNED, ("avec", "bvec", "cvec"), strict=True))
    atoms = "".join(f"{i} 1 {line}\n" for i, line in enumerate(lines(PLACES).splitlines(), 1))
    head = f"LAMMPS data\n\n30 atoms\n1 atom types\n\n{edges}10 20 -5 abc origin\n\nAtoms # atomic\n\n"
    (tmp_path / "a.lmp").write_text(head + atoms)
    found = read_contents(tmp_path / "a.lmp")
    assert np.allclose(found.box.edges, TURNED)
    assert np.allclose(found.box.origin, CORNER)
    assert np.allclose(found.particles.world_positions(), PLACES, atol=1e-5)


@pytest.mark.parametrize("before", [False, True])
@pytest.mark.parametrize("n", [30, 29])
def test_velocities_of_lammps_data(tmp_path, before, n):
    """In any order, and before the atoms or behind them; not where some have none."""
    order = np.random.default_rng(0).permutation(30)
    rows = lines(np.column_stack([np.arange(30), 2 * PLACES])).splitlines()
    velocities = "Velocities # atomic\n\n" + "".join(f"{rows[i]} # of {i}\n" for i in order[:n]) + "\n"
    atoms = "Atoms # atomic\n\n" + "".join(f"{i} 1 {line}\n" for i, line in enumerate(lines(PLACES).splitlines()))
    sections = (velocities + atoms + "\n") if before else (atoms + "\n" + velocities)
    head = "LAMMPS data\n\n30 atoms\n1 atom types\n\n0 99 xlo xhi\n0 99 ylo yhi\n-99 99 zlo zhi\n\n"
    (tmp_path / "a.lmp").write_text(f"{head}{sections}\nBonds\n\n1 1 1 2\n")
    found = gb.read(tmp_path / "a.lmp")
    assert ("velocity" in found.attributes) == (n == 30)
    if n == 30:
        assert np.allclose(found.attributes["velocity"], 2 * PLACES, rtol=1e-6)


@pytest.mark.parametrize(
    "encoding", ["utf-32", "utf-32-le", "utf-32-be", "utf-16", "utf-16-le", "utf-16-be", "utf-8-sig"]
)
@pytest.mark.parametrize("name", ["a.csv", "a.txt", "a.xyz"])
def test_encodings(tmp_path, encoding, name):
    mark = "" if encoding in ("utf-32", "utf-16", "utf-8-sig") else "\ufeff"
    comma = "," if name == "a.csv" else " "
    text = (
        comma.join(["x", "y", "z", "größe"]) + "\n" + lines(np.column_stack([SHARES, SHARES[:, 0]])).replace(" ", comma)
    )
    (tmp_path / name).write_bytes((mark + text).encode(encoding))
    found = gb.read(tmp_path / name)
    assert len(found) == 30
    assert np.allclose(found.positions, SHARES, atol=1e-6)
    assert list(found.attributes) == ["größe"]


CENTERS = np.stack(np.mgrid[:4, :3, :2], -1).reshape(-1, 3) * 0.5
RADII = 0.1 + 0.005 * np.arange(24)
SPHERES = np.column_stack([CENTERS, RADII])


def is_spheres(particles) -> bool:
    return np.allclose(particles.positions, CENTERS, atol=1e-6) and np.allclose(find_radii(particles), RADII, rtol=1e-5)


def liggghts(again: str = "1") -> str:
    """A dump as the tutorials of LIGGGHTS have it, with the column of types twice."""
    rows = "".join(f"{i} 1 {again} {line} \n" for i, line in enumerate(lines(SPHERES).splitlines(), 1))
    head = "ITEM: TIMESTEP\n5\nITEM: NUMBER OF ATOMS\n24\nITEM: BOX BOUNDS ff ff ff\n-1 9\n-1 9\n-1 9\n"
    return f"{head}ITEM: ATOMS id type type x y z radius \n{rows}"


@pytest.mark.parametrize("end", ["\n", "\r\n"])
@pytest.mark.parametrize("name", ["dump5.liggghts", "dump.5", "a.dump"])
def test_a_column_twice_in_a_dump(tmp_path, name, end):
    (tmp_path / name).write_text(liggghts(), newline=end)
    assert is_spheres(gb.read(tmp_path / name))
    (tmp_path / name).write_text(liggghts("2"))
    with pytest.raises(gb.FormatError, match="expected different names, got 'type' twice"):
        gb.read(tmp_path / name)


@pytest.mark.parametrize("nothing", [";;;", '"";"";"";""', ";;; ", "\t;;;"])
def test_rows_of_separators_alone(tmp_path, nothing):
    rows = lines(SPHERES).replace(" ", ";").replace(".", ",").splitlines()
    table = "\r\n".join(['"X";"Y";"Z";"Radius"', nothing, *rows[:9], nothing, *rows[9:], nothing, nothing, ""])
    (tmp_path / "a.csv").write_text(table, encoding="utf-16", newline="")
    assert is_spheres(gb.read(tmp_path / "a.csv"))


def test_a_missing_place_is_a_mistake(tmp_path):
    (tmp_path / "a.csv").write_text("x,y,z,a\n1,2,3,4\n,,,5\n1,2,3,4\n")
    with pytest.raises(gb.FormatError, match="line 3"):
        gb.read(tmp_path / "a.csv")


def test_letters_of_windows(tmp_path):
    for name, text in (("a.csv", "x,y,z,Größe °C\n"), ("b.csv", "# Łódź \ufffd\nx,y,z,Größe °C\n")):
        for code in ("latin-1", "utf-8"):
            if "Ł" in text and code == "latin-1":
                continue
            (tmp_path / name).write_bytes(f"{text}1,2,3,20\n4,5,6,21\n".encode(code))
            assert list(gb.read(tmp_path / name).attributes) == ["Größe °C"]
    many = "x,y,z,größe\n" + 5000 * "1,2,3,4\n"  # a letter lies across the place up to which is looked
    for shift in range(4):
        (tmp_path / "c.csv").write_text(f"#{'é' * 2040}{' ' * shift}\n{many}", encoding="utf-8")
        assert list(gb.read(tmp_path / "c.csv").attributes) == ["größe"]


def test_a_collection_of_windows(tmp_path):
    (tmp_path / "sub dir").mkdir()
    for k in (0, 1):
        gb.write(tmp_path / "sub dir" / f"p{k}.vtp", gb.Particles(CENTERS + k))
    sets = "".join(f'<DataSet timestep="{k}" file=".\\sub dir\\p{k}.vtp"/>' for k in (0, 1))
    (tmp_path / "a.pvd").write_text(f'<VTKFile type="Collection"><Collection>{sets}</Collection></VTKFile>')
    found = read_contents(tmp_path / "a.pvd", frame=1)
    assert (found.n_frames, found.time) == (2, 1.0)
    assert np.allclose(found.particles.positions, CENTERS + 1)
    (tmp_path / "a.pvd").write_text(f'<VTKFile type="Collection"><Collection>{2 * sets}</Collection></VTKFile>')
    assert len(gb.read(tmp_path / "a.pvd")) == 24  # also where a run that went on names a file again
    (tmp_path / "out.vtp").write_bytes((tmp_path / "sub dir" / "p0.vtp").read_bytes())
    (tmp_path / "sub dir" / "b.pvd").write_text(
        '<VTKFile type="Collection"><Collection><DataSet file="..\\out.vtp"/></Collection></VTKFile>'
    )
    with pytest.raises(gb.FormatError, match="below the same folder"):
        gb.read(tmp_path / "sub dir" / "b.pvd")


IMAGE = (
    '<VTKFile type="ImageData"><ImageData WholeExtent="0 1 0 1 0 1"><Piece Extent="0 1 0 1 0 1"><PointData>'
    '<DataArray type="Float32" Name="p" format="ascii">0 0 0 0 1 1 1 1</DataArray></PointData></Piece></ImageData>'
    "</VTKFile>"
)


def test_a_volume_beside_particles_is_left_out(tmp_path):
    gb.write(tmp_path / "p.vtp", gb.Particles(CENTERS))
    (tmp_path / "i.vti").write_text(IMAGE)
    with pytest.warns(UserWarning, match="volumes are left out beside the particles: i.vti"):
        found = gb.read(naming("vtkMultiBlockDataSet", tmp_path / "a.vtm", "p.vtp", "i.vti"))
    assert len(found) == 24
    with pytest.raises(gb.FormatError, match=r"i\.vti: expected a file of particles, got a volume"):
        gb.read(naming("vtkMultiBlockDataSet", tmp_path / "b.vtm", "i.vti"))


@pytest.mark.parametrize("name", ["positions.npz", "coords.npz", "pos.npz", "positions.h5", "only.npz", "only.npy"])
@pytest.mark.filterwarnings("ignore:.*taken as columns")
def test_a_row_for_each_axis(tmp_path, name):
    """As MATLAB's h5write, Julia and R lay (N, 3) out, and all of a file, or a range of it, is read."""
    key, _, ending = name.partition(".")
    x = np.random.default_rng(0).random((40, 2 if key == "pos" else 3))
    path = tmp_path / f"a.{ending}"
    if ending == "h5":
        with pytest.importorskip("h5py").File(path, "w") as file:
            file["positions"], file["radius"] = x.T, x[:, 0]
    elif ending == "npy":
        np.save(path, x.T)
    else:
        np.savez(path, **{key: x.T} | ({} if key == "only" else {"radius": x[:, 0]}))
    whole, part = gb.read(path), ranges(path).read(10, 13)
    for found, of in ((whole, slice(0, 40)), (part, slice(10, 13))):
        assert np.allclose(found.positions[:, : x.shape[1]], x[of])
        assert key == "only" or np.allclose(found.attributes["radius"], x[of, 0])


def test_frames_in_a_plane(tmp_path):
    np.save(tmp_path / "a.npy", np.stack([CENTERS[:, :2], CENTERS[:, :2] + 1]))
    found = read_contents(tmp_path / "a.npy", frame=1)
    assert found.n_frames == 2
    assert np.allclose(found.particles.positions, CENTERS * (1, 1, 0) + (1, 1, 0))


def test_ranges_of_tables(tmp_path):
    """Of arrays without a name, also where three rows look like three columns; of fields none."""
    table = np.random.default_rng(0).random((50, 40))
    np.savez(tmp_path / "a.npz", table)
    np.save(tmp_path / "b.npy", table)
    for name in ("a.npz", "b.npy"):
        found = ranges(tmp_path / name).read(20, 23)
        assert np.allclose(found.positions, table[20:23, :3])
        assert np.allclose(found.attributes["column40"], table[20:23, 39])
    np.save(tmp_path / "c.npy", np.zeros(5, [("x", "f4"), ("y", "f4")]))
    assert not has_ranges(tmp_path / "c.npy")


def test_points_without_faces_are_a_fluid_as_in_other_files(tmp_path):
    pytest.importorskip("trimesh")
    (tmp_path / "a.obj").write_text("# points\n" + "".join(f"v {line}\n" for line in lines(CENTERS).splitlines()))
    with pytest.warns(UserWarning, match="its 24 vertices are shown as points"):
        found = gb.read(tmp_path / "a.obj")
    assert found.support is None
    assert found.color is None
    assert np.allclose(found.positions, CENTERS)
    (tmp_path / "b.obj").write_text("".join(f"v {line} 1 0.5 0\n" for line in lines(CENTERS).splitlines()))
    with pytest.warns(UserWarning, match="24 vertices are shown as points"):
        color = gb.read(tmp_path / "b.obj").color
    assert np.allclose(color, (1, 0.214, 0), atol=0.005)  # linear, as those of faces


@pytest.mark.parametrize("name", ["TimeValue", "TIME"])
def test_the_time_of_vtk_files(tmp_path, name):
    data = f'<FieldData><DataArray type="Float64" Name="{name}" NumberOfTuples="1">2.5</DataArray></FieldData>'
    for k, ending in enumerate((".vtp", ".vtu")):
        path = tmp_path / f"a{ending}"
        gb.write(path, gb.Particles(CENTERS))
        kind = ("PolyData", "UnstructuredGrid")[k]
        path.write_bytes(path.read_bytes().replace(f"<{kind}>".encode(), f"<{kind}>{data}".encode(), 1))
        assert read_contents(path).time == 2.5
        assert time_of(str(path)) == 2.5
        assert read_contents(naming(f"P{kind}", tmp_path / f"a.p{ending[1:]}", path.name)).time == 2.5
    head = f"# vtk DataFile Version 2.0\ntitle\nASCII\nDATASET POLYDATA\nFIELD FieldData 1\n{name} 1 1 double\n2.5\n"
    (tmp_path / "a.vtk").write_text(f"{head}POINTS 24 float\n{lines(CENTERS)}")
    assert read_contents(tmp_path / "a.vtk").time == 2.5
    assert read_contents(naming("Collection", tmp_path / "a.pvd", "a.vtk")).time == 0  # it says its own


def test_a_file_in_a_folder_is_not_called_packed(tmp_path, capsys):
    gb.write(tmp_path / "a.vtp", gb.Particles(CENTERS))
    assert main(["info", str(tmp_path / "a.vtp")]) == 0
    said = capsys.readouterr().out
    assert "VTK XML PolyData, " in said
    assert "packed" not in said


@pytest.mark.parametrize(
    ("name", "head"),
    [
        ("a.csv", "'x','y','z','radius'\n"),
        ("a.csv", "x,y,z,radius\nm,m,m,m\n"),
        ("a.csv", "X,Y,Z,Radius\n[m],[m],[m],[m]\n"),
        ("a.txt", "% Model: a.mph\n% Nodes: 24\n% x     y     z     radius (m)\n"),
        ("a.txt", "% Model: a.mph\n% x     y     z     Particle radius (m)\n"),
        ("a.txt", "# x (m) y (m) z (m) radius (m)\n"),
        ("a.asc", "//X Y Z Radius\n24\n"),  # CloudCompare says how many follow
        ("a.csv", "x,y,z,radius\n24\n"),
        ("a.csv", "# Columns: x, y, z, radius\n# 24 rows\n"),
        ("a.txt", "# [1]=x [2]=y [3]=z [4]=radius\n"),
        ("a.txt", "# 1:x 2:y 3:z 4:radius\n"),
        ("a.txt", '"x" "y" "z" "radius"\n'),
        ("a.txt", "   x      y      z    radius\n ----- ----- ------ ------\n"),
    ],
)
def test_heads_of_tables(tmp_path, name, head):
    rows = lines(SPHERES).replace(" ", "," if name == "a.csv" else "     ")
    (tmp_path / name).write_text(head + rows)
    assert is_spheres(gb.read(tmp_path / name))


@pytest.mark.parametrize(
    ("name", "head", "row"),
    [
        ("a.txt", '# "Particle Identifier" "Position.X" "Position.Y" "Position.Z" "Radius"\n', "7{} {}"),  # OVITO
        ("a.txt", '"x" "y" "z" "radius"\n', '"{}" {}'),  # R writes the names of rows, and none of their column
        ("a.txt", "x y z radius phase\n", '{1} "liquid water"'),
        ("a.dat", "# x y z radius phase\n", "{1} water"),
        ("a.csv", "# x,y,z,radius,phase\n", "{1},water"),
        ("a.txt", "# x y z radius\n", "{1} # note {0}, more"),
        ("COLVAR", "#! FIELDS time x y z radius\n#! SET min_x 0\n", "0.{} {}"),  # PLUMED
        ("a.imd", "#F A 1 1 0 3 0 1\n#C number x y z radius\n#X 2 0 0\n#E\n", "7{} {}"),
        ("a.txt", "# Fields: id x y z radius\n", "7{} {}"),
        ("a.csv", "x,y,z,radius\n", "{1},"),
        ("a.csv", "ID,X,Y,Z,Radius\nSpot ID,X,Y,Z,R\n,,,,\n,(micron),(micron),(micron),(micron)\n", "{},{}"),
    ],
)
def test_heads_of_tables_with_more_in_their_rows(tmp_path, name, head, row):
    mark = "," if name == "a.csv" else " "
    rows = lines(SPHERES).replace(" ", mark).splitlines()
    (tmp_path / name).write_text(head + "".join(row.format(i, line) + "\n" for i, line in enumerate(rows)))
    assert is_spheres(gb.read(tmp_path / name))


@pytest.mark.parametrize("name", ["a.csv", "a.txt", "a.dat", "a.xyz"])
@pytest.mark.parametrize("head", ["# x y z radius", "# id,x [m],y [m],z [m]", "#! FIELDS x y z"])
def test_tables_of_no_particles(tmp_path, name, head):
    """As an emitter has them before its first particle."""
    (tmp_path / name).write_text(f"# run 7\n{head}\n")
    assert len(gb.read(tmp_path / name)) == 0


def test_matrices_of_no_particles(tmp_path):
    scipy_io = pytest.importorskip("scipy.io")
    for positions in (np.empty((0, 3)), np.empty((0, 0))):
        scipy_io.savemat(tmp_path / "a.mat", {"positions": positions, "radius": np.empty((0, 0))})
        assert len(gb.read(tmp_path / "a.mat")) == 0
    scipy_io.savemat(tmp_path / "a.mat", {"p": {"x": SHARES[:, 0], "y": SHARES[:, 1]}, "dt": 0.1})
    with pytest.raises(gb.FormatError, match=r"got 'dt'; structs are not read: save\('NAME.mat', '-struct', 'p'\)"):
        gb.read(tmp_path / "a.mat")
    h5py = pytest.importorskip("h5py")
    for positions in ((0, 3), (0, 0)):  # of 7.3, which holds the shape
        with h5py.File(tmp_path / "b.mat", "w") as file:
            for name, shape in (("positions", positions), ("radius", (0, 0))):
                file[name] = np.array(shape, np.uint64)
                file[name].attrs["MATLAB_empty"] = np.uint8(1)
                file[name].attrs["MATLAB_class"] = np.bytes_("double")
        assert len(gb.read(tmp_path / "b.mat")) == 0


@pytest.mark.parametrize("comment", ["t = 0.1", "written by version 2.0", "24 particles", "time 0.1 s"])
@pytest.mark.parametrize("name", ["a.csv", "a.txt"])
def test_comments_that_name_no_columns(tmp_path, name, comment):
    for table in (SPHERES, CENTERS):
        (tmp_path / name).write_text(f"# {comment}\n" + lines(table).replace(" ", "," if name == "a.csv" else " "))
        found = gb.read(tmp_path / name)
        assert np.allclose(found.positions, CENTERS)
        assert len(found.attributes) == table.shape[1] - 3


@pytest.mark.parametrize("words", ["True False", "true false", "TRUE FALSE"])
@pytest.mark.parametrize("mark", [",", ";", " "])
def test_true_and_false_are_numbers(tmp_path, words, mark):
    rows = lines(CENTERS).replace(" ", mark).splitlines()
    text = "".join(f"{line}{mark}{words.split()[i % 2]}{mark}{i}\n" for i, line in enumerate(rows))
    (tmp_path / "a.csv").write_text(f"x{mark}y{mark}z{mark}wall{mark}n\n{text}")
    found = gb.read(tmp_path / "a.csv", where="wall == 1")
    assert found.attributes["n"].tolist() == list(range(0, 24, 2))
    (tmp_path / "a.csv").write_text(f"x{mark}y{mark}z{mark}wall{mark}n\n{text}9{mark}9{mark}9{mark}maybe{mark}9\n")
    assert [*gb.read(tmp_path / "a.csv").attributes] == ["n"]


@pytest.mark.parametrize("name", ["Dp", "d_p", "EqDiameter", "Radius", "Particle Size"])
def test_sizes_in_another_unit(tmp_path, name):
    table = np.column_stack([CENTERS, (1 if name == "Radius" else 2) * 1000 * RADII])
    (tmp_path / "a.csv").write_text(f"X [m],Y [m],Z [m],{name} [mm]\n" + lines(table).replace(" ", ","))
    with pytest.warns(UserWarning, match=f"{name} is in mm and becomes m"):
        assert is_spheres(gb.read(tmp_path / "a.csv"))


@pytest.mark.parametrize("factor", [255, 65535])
@pytest.mark.parametrize("point", ["", ".000"])
def test_colors_in_tables(tmp_path, factor, point):
    """As PDAL and LAStools write them: of 8 or 16 bits, whole numbers with or without a point."""
    colors = np.arange(72).reshape(24, 3) / 71
    whole = np.rint(colors * factor).astype(int)
    rows = zip(lines(CENTERS).replace(" ", ",").splitlines(), whole, strict=True)
    text = "".join(f"{line},{','.join(f'{v}{point}' for v in color)}\n" for line, color in rows)
    (tmp_path / "a.csv").write_text('"X","Y","Z","Red","Green","Blue"\n' + text)
    assert np.allclose(gb.read(tmp_path / "a.csv").color, colors, atol=0.003)
    if factor == 255 and not point:
        names = "".join(f"property float {axis}\n" for axis in "xyz")
        names += "".join(f"property uchar diffuse_{name}\n" for name in ("red", "green", "blue"))
        head = f"ply\nformat ascii 1.0\nelement vertex 24\n{names}end_header\n"
        (tmp_path / "a.ply").write_text(head + text.replace(",", " "))
        assert np.allclose(gb.read(tmp_path / "a.ply").color, colors, atol=0.003)


def test_a_row_of_units(tmp_path):
    table = np.column_stack([CENTERS, 1000 * RADII])
    (tmp_path / "a.csv").write_text("x,y,z,radius\nm,m,m,mm\n" + lines(table).replace(" ", ","))
    with pytest.warns(UserWarning, match="radius is in mm and becomes m"):
        found = read_contents(tmp_path / "a.csv")
    assert is_spheres(found.particles)
    assert found.units["positions"] == "m"
    (tmp_path / "b.csv").write_text("x,y,z\na,b,c\n1,2,3\n")
    with pytest.raises(gb.FormatError, match="line 2, column 1: expected a number, got 'a'"):
        gb.read(tmp_path / "b.csv")


@pytest.mark.parametrize(
    ("endian", "dtype", "width"), [("Big", ">f8", 8), ("Little", "<f4", 4), ("Native", "f4", None)]
)
def test_binary_data_of_xdmf(tmp_path, endian, dtype, width):
    (tmp_path / "a.bin").write_bytes(b"12345" + CENTERS.astype(dtype).tobytes() + RADII.astype(dtype).tobytes())
    about = f'NumberType="Float" Endian="{endian}" Format="Binary"' + (f' Precision="{width}"' if width else "")
    size = CENTERS.astype(dtype).nbytes

    def xdmf(rows: int) -> None:
        (tmp_path / "a.xdmf").write_text(
            f'<Xdmf Version="3.0"><Domain><Grid><Geometry GeometryType="XYZ"><DataItem Dimensions="{rows} 3" Seek="5" '
            f'{about}>a.bin</DataItem></Geometry><Attribute Name="radius" Center="Node"><DataItem Dimensions="24" '
            f'Seek="{5 + size}" {about}>\na.bin\n</DataItem></Attribute></Grid></Domain></Xdmf>'
        )

    xdmf(24)
    assert is_spheres(gb.read(tmp_path / "a.xdmf"))
    xdmf(10**12)
    with pytest.raises(gb.FormatError, match=r"expected .* bytes from '5' in 'a.bin', got"):
        gb.read(tmp_path / "a.xdmf")


def test_instances_of_spheres_in_usd(tmp_path):
    pytest.importorskip("pxr")

    def usd(scales) -> None:
        (tmp_path / "a.usda").write_text(
            '#usda 1.0\ndef PointInstancer "i"\n{\n rel prototypes = [</i/s>, </i/t>]\n'
            f" int[] protoIndices = [{', '.join(str(i % 2) for i in range(24))}]\n"
            f" point3f[] positions = [{', '.join(f'({a}, {b}, {c})' for a, b, c in CENTERS)}]\n"
            f" float3[] scales = [{', '.join(str(tuple(s)) for s in scales.tolist())}]\n"
            ' def Sphere "s"\n {\n  double radius = 0.5\n }\n'
            ' def Sphere "t"\n {\n  double radius = 1\n  float3 xformOp:scale = (2, 2, 2)\n'
            '  uniform token[] xformOpOrder = ["xformOp:scale"]\n }\n}\n'
        )

    sizes = RADII / np.where(np.arange(24) % 2, 2, 0.5)
    usd(np.repeat(sizes[:, None], 3, axis=1))
    assert is_spheres(gb.read(tmp_path / "a.usda"))
    usd(np.column_stack([sizes, sizes, 2 * sizes]))  # no spheres
    assert find_radii(gb.read(tmp_path / "a.usda")) is None


@pytest.mark.parametrize("form", ["ascii", "binary_little_endian"])
def test_strips_of_triangles_in_ply(tmp_path, form):
    """A square of two strips, all of whose triangles look along z, and a strip that is none."""
    points = np.stack(np.mgrid[:3, :3], -1).reshape(-1, 2) @ np.eye(2, 3)
    strips = [0, 3, 1, 4, 2, 5, -1, 3, 6, 4, 7, 5, 8, -1, 0, 1]
    head = (
        f"ply\nformat {form} 1.0\nelement vertex 9\nproperty float x\nproperty float y\nproperty float z\n"
        "element tristrips 1\nproperty list int int vertex_indices\nend_header\n"
    )
    numbers = np.array([len(strips), *strips], "<i4")
    body = points.astype("<f4").tobytes() + numbers.tobytes()
    if form == "ascii":
        body = (lines(points) + " ".join(map(str, numbers)) + "\n").encode()
    (tmp_path / "a.ply").write_bytes(head.encode() + body)
    mesh = gb.Mesh(tmp_path / "a.ply", device="cpu")
    assert area(mesh) == pytest.approx(4)
    a, b, c = (np.asarray(mesh.vertices)[mesh.faces[:, k]] for k in range(3))
    assert (np.cross(b - a, c - a)[:, 2] > 0).all()
    if form == "ascii":
        (tmp_path / "b.ply").write_bytes((head.encode() + body).replace(b" 8 -1 0 1", b" 9 -1 0 1"))
        with pytest.raises(gb.FormatError, match="tristrips: expected indices below 9, got 0 to 9"):
            gb.Mesh(tmp_path / "b.ply", device="cpu")
