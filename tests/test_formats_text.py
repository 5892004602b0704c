"""Packed files, elements, LAMMPS' atom styles, and tables as other programs write them."""

import bz2
import gzip
import lzma
import os
import re
import sys
import warnings
from pathlib import Path

import globule as gb
import numpy as np
import pytest
from cli_helpers import SMALL, output_of, refused, refuses
from format_helpers import naming
from globule.cli import main
from globule.formats import FormatError, kind_of, packed, read_contents, size
from globule.formats.frames import FrameOf
from globule.formats.ranges import ranges

N = 24
RNG = np.random.default_rng(41)
X = np.round(RNG.random((N, 3)), 6)


def zstd(data: bytes) -> bytes:
    return pytest.importorskip("zstandard").ZstdCompressor().compress(data)


PACKERS = {".gz": gzip.compress, ".bz2": bz2.compress, ".xz": lzma.compress, ".zst": zstd}
packers = pytest.mark.parametrize("ending", PACKERS)


pytestmark = pytest.mark.usefixtures("folder")


def rows(separator: str = " ", comma: str = ".") -> list[str]:
    return [separator.join(f"{v:.6f}".replace(".", comma) for v in x) for x in X]


def assert_places(path: str, expected: np.ndarray = X, **options: object) -> gb.Particles:
    particles = gb.read(path, **options)
    assert np.allclose(particles.positions, expected, atol=1e-6)
    return particles


# Packed files


def csv(path: str) -> str:
    Path(path).write_text("\n".join(["x,y,z", *rows(",")]))
    return path


def written(path: str) -> str:
    gb.write(path, gb.Particles(X))
    return path


@packers
@pytest.mark.parametrize("name", ["a.csv", "a.vtk", "a.vtp", "a.ply", "a.npz", "a.npy", "a.bgeo"])
def test_packed_particles(name, ending, capsys):
    (csv if name == "a.csv" else written)(name)
    path = name + ending
    Path(path).write_bytes(PACKERS[ending](Path(name).read_bytes()))
    Path(name).unlink()
    assert_places(path)
    assert kind_of(path).kind == "particles"
    assert re.match(r"a\..*, (packed|gzipped), ", output_of(capsys, "info", path).out)
    Path("no_ending").write_bytes(Path(path).read_bytes())
    assert_places("no_ending")


@packers
def test_several_members_and_padding(ending):
    pack = PACKERS[ending]
    halves = ["x,y,z", *rows(",")]
    data = pack("\n".join(halves[:9] + [""]).encode()) + pack("\n".join(halves[9:]).encode())
    Path("a" + ending).write_bytes(data + bytes(8))
    assert_places("a" + ending)


@packers
def test_packed_hdf5_mesh_volume_and_collection(ending):
    h5py = pytest.importorskip("h5py")
    pytest.importorskip("trimesh")
    values = RNG.random((3, 4, 5)).astype(np.float32)
    with h5py.File("a.h5", "w") as file:
        file["positions"] = X
    Path("a.obj").write_bytes(b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    gb.volumes.write_volume("a.nrrd", gb.volumes.Volume(values, np.eye(4)))
    written("part.vtp")
    naming("Collection", Path("a.pvd"), f"part.vtp{ending}")  # the packed one names a packed one beside it
    for name in ("a.h5", "a.obj", "a.nrrd", "part.vtp", "a.pvd"):
        Path(name + ending).write_bytes(PACKERS[ending](Path(name).read_bytes()))
    assert_places("a.h5" + ending)
    assert gb.Mesh("a.obj" + ending, device="cpu").bounds()[1][0] == 1
    assert np.array_equal(gb.volumes.read_volume("a.nrrd" + ending).values, values)
    assert_places("a.pvd" + ending)


def collection(path: str, *files: str) -> None:
    plain = naming("Collection", Path("plain.pvd"), *files)
    Path(path).write_bytes(gzip.compress(plain.read_bytes()))


def test_packed_frames_of_meshes(capsys):
    triangle = "# vtk DataFile Version 3.0\nt\nASCII\nDATASET POLYDATA\nPOINTS 3 float\n"
    for i in range(3):
        data = f"{triangle}0 0 {i} 1 0 {i} 0 1 {i}\nPOLYGONS 1 4\n3 0 1 2\n"
        Path(f"m{i}.vtk.gz").write_bytes(gzip.compress(data.encode()))
    collection("a.pvd.gz", "m0.vtk", "m1.vtk.gz", "m2.vtk")  # written before they were packed
    for i in range(3):
        assert gb.Mesh(FrameOf("a.pvd.gz", i), device="cpu").bounds()[0][2] == i
    assert main(["render", "a.pvd.gz", "-o", "p_%d.png", *SMALL]) == 0, capsys.readouterr().err
    assert sorted(path.name for path in Path().glob("*.png")) == ["p_0.png", "p_1.png", "p_2.png"]


def test_a_packed_file_beside_stays_below_the_folder():
    folder = Path("own")
    folder.mkdir()
    written("part.vtp")
    Path("part.vtp.gz").write_bytes(gzip.compress(Path("part.vtp").read_bytes()))
    (folder / "link.vtp.gz").symlink_to(Path("part.vtp.gz").resolve())
    collection("own/a.pvd.gz", "link.vtp")
    below = "expected a file below the same folder, got"
    refuses(rf"{below} 'link\.vtp'", gb.read, "own/a.pvd.gz", error=FormatError)
    collection("own/a.pvd.gz", "a.pvd")
    refuses(rf"{below} 'a\.pvd'", gb.read, "own/a.pvd.gz", error=FormatError)


def test_only_files_are_opened_as_packed(capsys):
    assert "none.csv.gz: expected a file to read, got: No such file" in refused(capsys, "info", "none.csv.gz")
    ends = os.pipe()
    with packed.unpacked(ends[0]) as plain:
        assert plain == ends[0]
    for end in ends:
        os.close(end)  # an OSError where it was closed before


@packers
def test_damaged_ones_say_so_in_one_line_without_binary_data(ending, capsys):
    data = PACKERS[ending](Path(csv("a.csv")).read_bytes())
    path = "a.csv" + ending
    Path(path).write_bytes(data[:-9])
    refuses(rf"^a\.csv\{ending}: expected whole \w+ data, got", gb.read, path, error=FormatError)
    for bytes_ in (data[:20], data[:12] + bytes(range(256)), RNG.bytes(300)):
        Path(path).write_bytes(bytes_)
        said = refused(capsys, "info", path)
        assert said.isascii() or "…" in said
        assert said.strip().isprintable()
        assert len(said) < 400


@packers
def test_bombs_are_refused_while_they_unpack(ending, monkeypatch):
    monkeypatch.setattr(size, "ALWAYS", 1 << 20)
    Path("a.csv" + ending).write_bytes(PACKERS[ending](bytes(1 << 25)))
    refuses(rf"^a\.csv\{ending}: expected at most 200 times", gb.read, "a.csv" + ending, error=FormatError)


def test_a_window_larger_than_the_limit_is_refused(monkeypatch):
    monkeypatch.setattr(packed, "_MOST_MEMORY", 1 << 16)
    Path("a.csv.xz").write_bytes(lzma.compress(Path(csv("a.csv")).read_bytes()))
    refuses(r"a\.csv\.xz: expected whole xz data, got Memory", gb.read, "a.csv.xz", error=FormatError)


def test_zstd_without_its_package_is_named(monkeypatch):
    Path("a.csv.zst").write_bytes(zstd(b"x,y,z\n1,2,3\n"))
    monkeypatch.setitem(sys.modules, "zstandard", None)
    refuses(r"zstandard is not installed\. Install it with", gb.read, "a.csv.zst", error=ImportError)


# Elements


@pytest.mark.parametrize("ending", ["", ".gz"])
def test_frames_of_xyz_keep_their_elements(ending):
    words = ["O", "H", "h", "C13", "Na+"]
    frames = []
    for k in range(2):
        lines = [f"{words[i % 5]} {row}" for i, row in enumerate(rows())]
        frames += [str(N), f"frame {k}", *(lines if k == 0 else reversed(lines))]
    data = ("\n".join(frames) + "\n").encode()
    Path("a.xyz" + ending).write_bytes(gzip.compress(data) if ending else data)
    got = read_contents("a.xyz" + ending, frame=1)
    assert got.n_frames == 2
    particles = got.particles
    assert np.allclose(particles.positions, X[::-1])
    numbers = np.array([8, 1, 1, 6, 11])[np.arange(N) % 5]
    assert np.array_equal(particles.attributes["atomic_number"], numbers[::-1])
    radii = np.array([1.52, 1.2, 1.2, 1.7, 2.27])[np.arange(N) % 5]
    assert np.allclose(particles.attributes["radius"], radii[::-1])
    assert np.allclose(particles.support, 4 * radii[::-1])
    red, white = particles.color[::-1][0], particles.color[::-1][1]
    assert red[0] == 1
    assert red[1] < 0.01
    assert np.array_equal(white, [1, 1, 1])


def test_types_of_xyz():
    """Numbers, as LAMMPS writes them, and words that are no elements."""
    for name, words, types in (("a", ["2", "11"], [2, 11]), ("b", ["wall", "fluid"], [2, 1])):
        lines = [f"{words[i % 2]} {row}" for i, row in enumerate(rows())]
        Path(f"{name}.xyz").write_text("\n".join([str(N), "Atoms. Timestep: 0", *lines]) + "\n")
        particles = assert_places(f"{name}.xyz")
        assert particles.attributes["type"].tolist() == types * (N // 2)
        assert particles.color is None
        assert particles.support is None


# LAMMPS' atom styles

ROWS = {
    "atomic": "{i} 1 {x}",
    "angle": "{i} 7 1 {x}",
    "charge": "{i} 1 -0.5 {x}",
    "full": "{i} 7 1 -0.5 {x}",
    "sphere": "{i} 1 0.02 2.5 {x}",
    "ellipsoid": "{i} 1 1 2.5 {x}",
    "bpm/sphere": "{i} 7 1 0.02 2.5 {x}",
    "line": "{i} 7 1 0 2.5 {x}",
    "tri": "{i} 7 1 0 2.5 {x}",
    "dipole": "{i} 1 -0.5 {x} 0 0 1.5",
    "spin": "{i} 1 {x} 0 0 1 2.2",
    "sph": "{i} 1 1.5 2.5 3.5 {x}",
    "peri": "{i} 1 0.3 2.5 {x}",
    "mdpd": "{i} 1 0.7 {x}",
    "dpd": "{i} 1 0.7 {x}",
    "edpd": "{i} 1 0.7 0.3 {x}",
    "body": "{i} 1 0 2.5 {x}",
    "rheo": "{i} 1 0 2.5 {x}",
    "rheo/thermal": "{i} 1 0 2.5 1.5 {x}",
    "electron": "{i} 1 1.5 0 0.4 {x}",
    "template": "{i} 1 7 1 2 {x}",
    "smd": "{i} 1 7 .1 .2 .3 .4 .5 .6 .7 {x}",
    "wavepacket": "{i} 1 1.5 0 0.4 3 .1 .2 {x}",
    "dielectric": "{i} 7 1 -0.5 {x} 0 0 1 .1 .2 .3 .4 .5",
    "tdpd": "{i} 1 {x} 0.25 0.75",
    "hybrid": "{i} 1 {x} 0.1 2.5",
    "hybrid sphere": "{i} 1 {x} 0.02 2.5",
    "hybrid dipole sphere": "{i} 1 {x} -0.5 0 0 1.5 0.02 2.5",
}


def data_file(style: str, row: str, images: str, types: int = 3, more: str = "") -> str:
    head = f"L\n\n{N} atoms\n{types} atom types\n{more}\n0 1 xlo xhi\n0 1 ylo yhi\n0 1 zlo zhi\n\n"
    lines = [row.format(i=i + 1, x=x) + images for i, x in enumerate(rows())]
    Path("a.data").write_text(f"{head}Atoms{style}\n\n" + "\n".join(lines) + "\n")
    return "a.data"


@pytest.mark.parametrize("images", ["", " 0 -1 2"])
@pytest.mark.parametrize("style", ROWS)
def test_every_atom_style(style, images):
    for said, options in ((f" # {style}", {}), ("", {"atom_style": style})):
        particles = assert_places(data_file(said, ROWS[style], images), **options)
        assert (particles.attributes["type"] == 1).all()
        if "sphere" in style:
            assert np.allclose(particles.support, 0.04)
        if style in ("charge", "full", "dipole"):
            assert (particles.attributes["q"] == -0.5).all()


@pytest.mark.parametrize("images", ["", " 0 -1 2"])
@pytest.mark.parametrize("style", [s for s in ROWS if "hybrid" not in s and s != "tdpd"])
def test_positions_without_a_style(style, images):
    """Whatever the style: its columns' number, numbers and the box tell where x is."""
    path = data_file("", ROWS[style], images)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        assert_places(path)


def test_what_is_guessed_is_said():
    with pytest.warns(UserWarning, match="read as full; .*sphere.* would fit, too: --atom-style"):
        gb.read(data_file("", "{i} 1 1 1 {x}", ""))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert_places(data_file("", "{i} 1 {x}", " 0 0 0"))  # nothing else fits
        got = assert_places(data_file("", "{i} 1 1 2.5 {x}", "", more=f"{N} ellipsoids\n"))
    assert "ellipsoidflag" in got.attributes
    refuses(r"atom_style: expected one of atomic .*, got 'sfere'", gb.read, "a.data", atom_style="sfere")
    with pytest.raises(FormatError, match=r"expected the columns id type x y z .atomic., got 7"):
        gb.read("a.data", atom_style="atomic")
    data_file(" # mine", "{i} 1 {x} 1 2 3 4 5 6 7 8 9 10 11 12", "")
    refuses("got 17; name it: --atom-style", gb.read, "a.data", error=FormatError)
    assert main(["info", data_file("", ROWS["sphere"], ""), "--atom-style", "sphere"]) == 0


def test_elements_of_a_data_file():
    masses = "Masses\n\n1 15.999 # O\n2 1.008  # H\n\n"
    path = data_file(" # full", "{i} 1 2 0.5 {x}", "", 2)
    text = Path(path).read_text()
    Path(path).write_text(text.replace("Atoms", masses + "Atoms"))
    particles = assert_places(path)
    assert (particles.attributes["atomic_number"] == 1).all()
    assert np.allclose(particles.support, 4.8)
    Path(path).write_text(text.replace(" 1 2 0.5", " 1 O 0.5"))  # labels of types
    assert (assert_places(path).attributes["atomic_number"] == 8).all()


# Tables


@pytest.mark.parametrize("head", [
    "Pos.x [m];Pos.y [m];Pos.z [m]", '"Points_0";"Points_1";"Points_2"', "pos_x;pos_y;pos_z",
    "pos[0];pos[1];pos[2]", "X-coordinate;Y-coordinate;Z-coordinate", "X;Y;Z", "xpos;ypos;zpos",
    "Points:0;Points:1;Points:2", "Position.X (mm);Position.Y (mm);Position.Z (mm)",
    "x_m;y_m;z_m", "coordinates_0;coordinates_1;coordinates_2", "particle_position_x;"
    "particle_position_y;particle_position_z", "PosX;PosY;PosZ", "X Coord;Y Coord;Z Coord", "rx;ry;rz",
    "Location_Center_X;Location_Center_Y;Location_Center_Z", "Easting;Northing;Elevation", "xp;yp;zp",
    "x1;x2;x3", "pos_x_mm;pos_y_mm;pos_z_mm", "BaryCenterX;BaryCenterY;BaryCenterZ",
    "Center of Mass X (mm);Center of Mass Y (mm);Center of Mass Z (mm)",
])  # fmt: skip
def test_names_of_positions(head):
    for name, separator in (("a.csv", ";"), ("a.csv", ","), ("a.tsv", "\t"), ("a.txt", "\t")):
        title = separator.join(["Idp", *head.split(";")])
        lines = [f"{i}{separator}{row}" for i, row in enumerate(rows(separator))]
        Path(name).write_text("\n".join([title, *lines]))
        particles = assert_places(name)
        assert particles.attributes["Idp"].tolist() == [*range(N)]
    if "[m]" in head or "(mm)" in head:
        assert read_contents("a.csv").units["positions"] in ("m", "mm")


def test_names_that_are_no_positions():
    Path("a.csv").write_text("mx,my,mz,node1,node2\n1,2,3,4,5\n")
    refuses(r"a\.csv: line 1: .* got 'mx, .*--columns x=…,y=…", gb.read, "a.csv", error=FormatError)
    assert main(["info", "a.csv", "--columns", "x=node1,y=node2,density=mz"]) == 0
    particles = gb.read("a.csv", columns={"x": "node1", "y": "node2", "density": "mz"})
    assert particles.positions.tolist() == [[4, 5, 0]]
    assert main(["info", "a.csv", "--columns", "x"]) == 2
    Path("b.csv").write_text("x,y,z,pos_x,pos_y,pos_z\n1,2,3,4,5,6\n")
    assert gb.read("b.csv").positions.tolist() == [[1, 2, 3]]


@pytest.mark.parametrize("code", ["utf-8-sig", "utf-16", "utf-16-le", "utf-16-be"])
@pytest.mark.parametrize(("name", "head", "separator"), [
    ("a.csv", "x,y,z,h [m]", ","), ("a.txt", "X Y Z H", " "), ("a.tsv", "x\ty\tz\tn", "\t"),
    ("a.xyz", "", " "), ("a", "x;y;z;d", ";"),
])  # fmt: skip
def test_codes_of_text(code, name, head, separator):
    lines = [f"{row}{separator}1.5" for row in rows(separator)]
    Path(name).write_bytes("\r\n".join([head, *lines] if head else lines).encode(code))
    particles = assert_places(name)
    assert [a.tolist() for a in particles.attributes.values()] == [[1.5] * N]


@pytest.mark.parametrize(("name", "head", "separator"), [
    ("a.csv", "x;y;z", ";"), ("a.csv", "", ";"), ("a.tsv", "x\ty\tz", "\t"), ("a.tsv", "", "\t"),
    ("a.txt", "x y z", " "), ("a.txt", "", " "), ("a.csv", "x|y|z", "|"),
])  # fmt: skip
def test_decimal_commas(name, head, separator):
    lines = rows(separator, ",")
    Path(name).write_text("\n".join([head, *lines] if head else lines))
    assert_places(name)


def test_decimal_commas_in_quotes_and_behind_whole_numbers():
    cells = [",".join(f'"{v:.6f}"'.replace(".", ",") for v in x) for x in X]
    Path("a.csv").write_text("\n".join(['"x","y","z","name"', *(c + ',"a,b"' for c in cells)]))
    assert_places("a.csv")
    Path("b.csv").write_text("x;y;z\n0;0;1\n0,5;-1,25e1;2\n")
    assert gb.read("b.csv").positions.tolist() == [[0, 0, 1], [0.5, -12.5, 2]]
    Path("c.csv").write_text("0,1,2\n3,4,5\n")  # commas that separate
    assert gb.read("c.csv").positions.tolist() == [[0, 1, 2], [3, 4, 5]]


@pytest.mark.parametrize("title", [True, False])
def test_points_of_a_scanner(title):
    lines = [f"{row} -1200 {i} 128 255" for i, row in enumerate(rows())]
    Path("a.pts").write_text("\n".join([str(N), *lines] if title else lines))
    particles = assert_places("a.pts")
    if title:
        assert (particles.attributes["intensity"] == -1200).all()
        assert np.allclose(particles.color[3] * 255, [3, 128, 255])


LONG = [2**53 + 1, 2**63 - 1]


@pytest.mark.parametrize(("name", "text"), [
    ("a.csv", "x,y,z,id\n0,0,0,{}\n\n1,1,1,{}\n# no row\n"),
    ("b.csv", '"x";"y";"z";"id"\n0;0;0;"{}"\n1;1;1;"{}"\n'),
    ("a.xyz", "# x y z id\n0 0 0 {}\n1 1 1 {} # no word\n"),
    ("e.xyz", "2\nProperties=species:S:1:pos:R:3:id:I:1\nH 0 0 0 {}\nH 1 1 1 {}\n"),
    ("a.lammpstrj", "ITEM: TIMESTEP\n0\nITEM: NUMBER OF ATOMS\n2\nITEM: BOX BOUNDS pp pp pp\n0 2\n0 2\n0 2\n"
     "ITEM: ATOMS x y z element id\n0 0 0 H {}\n1 1 1 H {}\n"),
    ("a.dat", "VARIABLES = X Y Z id\nZONE\n0 0 0 {}\nZONE\n1 1 1 {}\n"),
])  # fmt: skip
def test_whole_numbers_are_exact(name, text):
    for numbers, kind in ((LONG, np.int64), ([2**64 - 1, 1], np.uint64)):
        Path(name).write_text(text.format(*numbers))
        ids = gb.read(name).attributes["id"]
        assert ids.dtype == kind
        assert ids.tolist() == numbers
    Path(name).write_text(text.format(2**64 + 1, -1))
    with pytest.warns(UserWarning, match=f"^{name}: column 'id': float64 rounds '{2**64 + 1}'$"):
        assert gb.read(name).attributes["id"].tolist() == [2.0**64, -1]
    Path(name).write_text(text.format(2**64, -1))  # which float64 holds
    assert gb.read(name).attributes["id"].tolist() == [2**64, -1]


def test_whole_numbers_behind_the_head_are_exact(monkeypatch):
    monkeypatch.setattr("globule.formats.table._PLAIN", 1)
    monkeypatch.setattr("globule.formats.table._HEAD", 1)
    for missing in ("", f"1,1,1,{LONG[0]}\n"):
        Path("a.csv").write_text(f"x,y,z,id\n0,0,0,1\n{missing}1,1,1,{LONG[1]}\n")
        assert gb.read("a.csv").attributes["id"][-1] == LONG[1]


@pytest.mark.parametrize("word", ["NA", "N/A", "#N/A", "null", "None", ""])
def test_missing_numbers(word):
    for separator in ", " if word else ",":
        cells = [[0, 0, 0, word, 1, "Na"], [1, 1, 1, 2.5, word, word], [2, 2, 2, word, word, "O"]]
        lines = [separator.join(map(str, row)) for row in [["x", "y", "z", "t", "n", "kind"], *cells]]
        Path("a.csv").write_text("\n".join(lines))
        found = gb.read("a.csv").attributes
        np.testing.assert_array_equal(found["t"], [np.nan, 2.5, np.nan])
        np.testing.assert_array_equal(found["n"], [1, np.nan, np.nan])
        assert [*found] == ["t", "n"]
    Path("b.csv").write_text(f"x,y,z\n0,{word},0\n")
    refuses("line 2, column 2: expected a number, got", gb.read, "b.csv", error=FormatError)


def test_a_column_named_positions_is_an_attribute():
    Path("a.csv").write_text("x,y,z,positions\n0,0,0,1\n1,1,1,2\n")
    found = gb.read("a.csv")
    assert found.positions.tolist() == [[0, 0, 0], [1, 1, 1]]
    assert found.attributes["positions_attribute"].tolist() == [1, 2]


def ovito(more: str, columns: str, species: str = "O") -> None:
    """Extended XYZ as OVITO writes it: a box around the origin, names with capitals."""
    box = 'Lattice="1 0 0 0 1 0 0 0 1" Origin="-0.5 -0.5 -0.5"'
    about = f"{box} Properties=species:S:1:pos:R:3{more}"
    lines = [f"{species} {a} {b} {c} {columns}" for a, b, c in X - 0.5]
    Path("a.xyz").write_text("\n".join([str(N), about, *lines]))


def test_the_box_of_ovito_has_an_origin():
    ovito("", "")
    found = read_contents("a.xyz")
    assert np.allclose(found.particles.positions, X - 0.5, atol=1e-6)  # nothing to wrap
    assert np.array_equal(found.box.origin, [-0.5] * 3)
    Path("a.xyz").write_text(Path("a.xyz").read_text().replace("-0.5 -0.5 -0.5", "a b c"))
    refuses("line 2: expected 3 numbers in Origin, got 'a b c'", gb.read, "a.xyz", error=FormatError)


def test_radii_and_colors_of_a_file_come_before_those_of_elements():
    ovito(":Radius:R:1:Color:R:3", "0.05 1 0 0.5")
    found = gb.read("a.xyz")
    assert np.allclose(found.attributes["radius"], 0.05)
    assert np.allclose(found.support, 0.2)
    assert np.array_equal(found.color, [[1, 0, 0.5]] * N)
    ovito(":diameter:R:1", "0.1")
    assert np.allclose(gb.read("a.xyz").support, 0.2)
    assert "radius" not in gb.read("a.xyz").attributes


@pytest.mark.parametrize("name", ["Radius [m]", "RADIUS", "Diameter (m)"])
def test_radii_in_capitals_give_the_support(name):
    size_ = 0.1 if "Dia" in name else 0.05
    Path("a.csv").write_text(f"x,y,z,{name}\n" + "".join(f"{row},{size_}\n" for row in rows(",")))
    assert np.allclose(gb.read("a.csv").support, 0.2)
    Path("a.csv").write_text("x,y,z,H\n" + "".join(f"{row},7\n" for row in rows(",")))
    assert gb.read("a.csv").support is None  # an enthalpy


def test_exponents_of_fortran():
    for name, head in (("a.dat", ""), ("a.csv", "x,y,z\n"), ("a.tec", "VARIABLES = x y z\nZONE\n")):
        mark = "," if name == "a.csv" else " "
        lines = (mark.join(f"{v:.5E}".replace("E", "D") for v in place) for place in X)
        Path(name).write_text(head + "".join(f"{line}\n" for line in lines))
        assert np.allclose(gb.read(name).positions, X, atol=1e-4)


def test_tecplot_zones():
    path = Path("a.dat")
    both = 'VARIABLES = "X"\n"Y"\n"T"\nZONE T="a"\n1 2 3\n4 5 6\nZONE T="b"\n7 8 9\n'
    path.write_text(both)
    got = gb.read(path)  # two zones of one time, in a plane
    assert got.positions.tolist() == [[1, 2, 0], [4, 5, 0], [7, 8, 0]]
    assert got.attributes["T"].tolist() == [3, 6, 9]
    path.write_text("VARIABLES = X Y Z\nZONE\nnan 0 0\n-1 2 3\n")
    assert len(gb.read(path)) == 2
    path.write_text("VARIABLES = X Y Z\nZONE N=2, E=1, F=FEPOINT\n0 0 0\n1 0 0\n1 2 2\n")
    assert len(gb.read(path)) == 2  # elements are left out
    for content, problem in (
        ("VARIABLES = X Y Z\nZONE DATAPACKING=ROWS\n1 2\n", "line 2: expected DATAPACKING=POINT"),
        ("VARIABLES = X Y Z\nZONE DATAPACKING=BLOCK\n1 2\n", r"line 2: expected the number of points \(I=, NODES=\)"),
        ("VARIABLES = X Y Z\nZONE I=2, DATAPACKING=BLOCK\n1 2\n3 4\n", "line 3: expected 6 numbers in the zone, got 4"),
        ("VARIABLES = X Y Z\nZONE I=2, DATAPACKING=BLOCK\n1 2 3 4 5 .x\n", "line 3: expected numbers in the blocks"),
        (f"VARIABLES = X Y Z\nZONE I={10**14}, F=BLOCK\n{10**14}*0\n", "line 3: expected data that fit"),
        ("VARIABLES = A B\nZONE\n1 2\n", "expected VARIABLES with x and y among them, got 'A, B'"),
        ("VARIABLES = X Y\nZONE\n", "expected a zone with rows, got none"),
        ("VARIABLES = X Y\nZONE\n1 a\n", "line 3"),
    ):
        path.write_text(content)
        refuses(problem, gb.read, path)


@pytest.mark.parametrize("content", [
    "0 0.5 0 0.1\n1 0.5 0 0.1\n2 0.5 0 0.1\n",  # spheres in a row
    "0 0 0 0.1\n1 1 1 0.1\n2 2 2 0.1\n",
    "0.0 0.5 0.1 0.1\n1.0 0.2 0.3 0.1\n2.0 0.1 0.7 0.1\n",  # written with a point
    "0 0.5 0.1 0.1\n1 0.2 0.3 0.1\n1 0.1 0.7 0.1\n",
    "0 0.5 0.1\n1 0.2 0.3\n2 0.1 0.7\n",
    "# x y z column4\n0 0.5 0.1 0.1\n1 0.2 0.3 0.1\n2 0.1 0.7 0.1\n",
])  # fmt: skip
def test_first_columns_that_are_places(content):
    Path("a.txt").write_text(content, encoding="utf-8")
    expected = np.loadtxt("a.txt")[:, :3]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert_places("a.txt", expected)


def test_ranges_of_rows_that_are_numbered():
    np.save("a.npy", np.column_stack([np.arange(N), X]))
    with pytest.warns(UserWarning, match=r"a\.npy: the first column numbers the rows: taken as id, x, y, z"):
        rows = ranges("a.npy")
    some = rows.read(5, 7)  # two rows do not tell it
    np.testing.assert_allclose(some.positions, X[5:7].astype("f4"))
    assert some.attributes["id"].tolist() == [5, 6]


@pytest.mark.parametrize("content", ["x y z\n", "# x y z\n", "# id x y z\n", "# x y z radius\n", "0\n", "0\ntitle\n"])
def test_tables_of_no_particles(content):
    Path("a.xyz").write_text(content, encoding="utf-8")
    assert len(gb.read("a.xyz")) == 0
    Path("b.xyz").write_text("# x y z\n" + "\n".join(rows()), encoding="utf-8")
    assert [len(p) for p in gb.sequence(["a.xyz", "b.xyz"])] == [0, N]


def test_degrees_are_no_lengths(capsys):
    Path("a.csv").write_text("Lat,Lon,Alt\n" + "\n".join(rows(",")), encoding="utf-8")
    advice = "these are degrees: project them (to UTM), or take them so: --columns x=Lon,y=Lat,z=Alt"
    assert advice in refused(capsys, "info", "a.csv")
    assert_places("a.csv", X[:, [1, 0, 2]], columns={"x": "Lon", "y": "Lat", "z": "Alt"})


def tracks(path: str, head: str = "time,id,x,y,z") -> None:
    """Three frames of the particles, each moved by 1."""
    lines = [f"{k / 2},{i}," + ",".join(f"{v + k:.6f}" for v in x) for k in range(3) for i, x in enumerate(X)]
    Path(path).write_text("\n".join([head, *lines]) + "\n", encoding="utf-8")


def test_a_column_that_tells_frames(capsys):
    tracks("a.csv")
    assert [read_contents("a.csv", frame=k).time for k in range(3)] == [0, 0.5, 1]
    assert_places("a.csv", X + 2, frame=-1)
    with pytest.warns(UserWarning, match="a.csv has 3 frames"):
        gb.read("a.csv")
    columns = {"x": "x", "y": "y", "z": "z", "frame": "time"}
    assert [len(p) for p in gb.sequence("a.csv", columns=columns)] == [N, N, N]
    assert len(gb.read("a.csv", columns={"x": "x", "y": "y", "z": "z"})) == 3 * N
    # A condition on it chooses from all rows, and what is left is no sequence.
    assert_places("a.csv", X + 1, where="time == 0.5")
    assert len(output_of(capsys, "track", "a.csv", "--where", "time == 0.5").out.splitlines()) == 2
    assert len(output_of(capsys, "track", "a.csv", "--where", "id < 20").out.splitlines()) == 4
    output_of(capsys, "convert", "a.csv", "b_%d.npz")
    assert_places("b_2.npz", X + 2)
    text = Path("a.csv").read_text(encoding="utf-8")
    Path("d.xyz").write_text("# " + text.replace(",", " "), encoding="utf-8")
    assert_places("d.xyz", X + 1, frame=1)
    assert len(output_of(capsys, "track", "d.xyz", "--where", "time == 0.5").out.splitlines()) == 2
    Path("c.csv.gz").write_bytes(gzip.compress(Path("a.csv").read_bytes()))
    assert_places("c.csv.gz", X + 1, frame=1)


@pytest.mark.parametrize("head", ["time,id,x,y,z", "t,part,x,y,z", "age,id,x,y,z"])
def test_columns_that_tell_no_frames(head):
    """Ids that come once, times of single rows, and another name."""
    lines = [f"{i // 2},{i},{row}" for i, row in enumerate(rows(","))]
    Path("a.csv").write_text("\n".join([head, *lines]), encoding="utf-8")
    assert read_contents("a.csv").n_frames == 1
    assert_places("a.csv")


def test_parquet_of_several_frames_is_said():
    pytest.importorskip("pyarrow")
    values = {"frame": np.repeat([0, 1], N), "id": np.tile(np.arange(N), 2)}
    gb.write("a.parquet", gb.Particles(np.r_[X, X + 1], attributes=values))
    with pytest.warns(UserWarning, match=r"a\.parquet: the rows are those of several frames, by 'frame'"):
        assert len(gb.read("a.parquet")) == 2 * N
