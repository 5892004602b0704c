"""Malformed files: only FormatError or valid particles may come out, at once."""

import base64
import gzip
import io
import struct
import zipfile
import zlib
from pathlib import Path

import globule as gb
import numpy as np
import pytest
from cli_helpers import refuses
from format_helpers import sample
from globule import formats
from globule.formats import FormatError
from globule.formats.kind import kind_of

N = 25


def ascii_vtk() -> bytes:
    numbers = "\n".join(" ".join(map(str, row)) for row in np.arange(3 * N).reshape(N, 3) / 8)
    ids = " ".join(map(str, range(N)))
    offsets = " ".join(map(str, range(N + 1)))
    return (
        f"# vtk DataFile Version 5.1\nt\nASCII\nDATASET POLYDATA\nPOINTS {N} float\n{numbers}\n"
        f"METADATA\nINFORMATION 0\n\nVERTICES {N + 1} {N}\nOFFSETS vtktypeint64\n{offsets}\n"
        f"CONNECTIVITY vtktypeint64\n{ids}\nPOINT_DATA {N}\nSCALARS s double 1\n"
        f"LOOKUP_TABLE default\n{ids}\nFIELD FieldData 1\nid 1 {N} long\n{ids}\n"
    ).encode()


def xml(mode: str) -> bytes:
    """A .vtu with the points ascii, binary or appended, compressed where that is possible."""
    points = np.random.default_rng(5).random((N, 3)).astype("<f4").tobytes()
    packed = zlib.compress(points)
    sizes = struct.pack("<4I", 1, len(points), 0, len(packed))
    text = base64.b64encode(sizes) + base64.b64encode(packed)
    inline, appended = b"", b""
    if mode == "ascii":
        inline = " ".join(map(str, np.frombuffer(points, "<f4"))).encode()
    elif mode == "binary":
        inline = text
    else:
        data = text if mode == "base64" else sizes + packed
        appended = b'<AppendedData encoding="%s">_%s</AppendedData>' % (mode.encode(), data)
        mode = "appended"
    return (
        b'<VTKFile type="UnstructuredGrid" byte_order="LittleEndian" '
        b'compressor="vtkZLibDataCompressor"><UnstructuredGrid><Piece NumberOfPoints="%d">'
        b'<Points><DataArray type="Float32" Name="Points" NumberOfComponents="3" format="%s" '
        b'offset="0">%s</DataArray></Points></Piece></UnstructuredGrid>%s</VTKFile>'
    ) % (N, mode.encode(), inline, appended)


def ascii_ply() -> bytes:
    rows = "\n".join(f"{i} {i / 8} {-i} {i}" for i in range(N))
    return (
        f"ply\nformat ascii 1.0\nelement face 1\nproperty list uchar int vertex_indices\n"
        f"element vertex {N}\nproperty float x\nproperty float y\nproperty double z\n"
        f"property ushort id\nend_header\n{N} {' '.join(map(str, range(N)))}\n{rows}\n"
    ).encode()


def list_ply() -> bytes:
    header = (
        f"ply\nformat binary_little_endian 1.0\nelement vertex {N}\nproperty float x\n"
        "property float y\nproperty float z\nproperty list uchar int l\nend_header\n"
    )
    return header.encode() + b"".join(struct.pack("<3fB2i", i, i, i, 2, 5, 6) for i in range(N))


def packed_npz() -> bytes:
    file = io.BytesIO()
    np.savez_compressed(file, positions=np.zeros((N, 3)), id=np.arange(N), support=0.5)
    return file.getvalue()


FOREIGN = {
    "ascii.vtk": ascii_vtk,
    "ascii.vtu": lambda: xml("ascii"),
    "binary.vtu": lambda: xml("binary"),
    "base64.vtu": lambda: xml("base64"),
    "raw.vtu": lambda: xml("raw"),
    "ascii.ply": ascii_ply,
    "lists.ply": list_ply,
    "packed.npz": packed_npz,
    "packed.bgeo": lambda: gzip.compress(bgeo(N, bytes(16 * N)), mtime=0),
    "mol.xyz": lambda: b"%d\ntitle\n" % N + b"".join(b"H 1 2 %d\n" % i for i in range(N)),
}


def bgeo(n_points: int, content: bytes, n_attributes: int = 0) -> bytes:
    head = struct.pack(">4sc9i", b"Bgeo", b"V", 5, n_points, 0, 0, 0, n_attributes, 0, 0, 0)
    return head + content


@pytest.fixture(params=[*(f"own{e}" for e in formats.EXTENSIONS), *FOREIGN])
def good_file(request, tmp_path) -> Path:
    path = tmp_path / request.param
    if request.param in FOREIGN:
        path.write_bytes(FOREIGN[request.param]())
    else:
        formats.write(path, sample(N))
    assert len(formats.read(path)) == N
    return path


def reads_or_refuses(path: Path) -> str:
    """The error, or "" if valid particles came out."""
    try:
        particles = formats.read(path)
    except FormatError as error:
        text = str(error)
        assert path.name in text
        assert "\n" not in text
        assert len(text) < 500
        assert "expected" in text
        return text
    assert particles.positions.dtype == np.float32
    assert particles.positions.shape[1:] == (3,)
    for array in particles.attributes.values():
        assert len(array) == len(particles)
        assert array.dtype.kind in "biuf"
    return ""


def test_truncated(good_file):
    content = good_file.read_bytes()
    survivors = []
    for size in sorted({*np.linspace(0, len(content) - 1, 60).astype(int), 1, 2, 3}):
        good_file.write_bytes(content[:size])
        if not reads_or_refuses(good_file):
            survivors.append(int(size))
    if good_file.suffix in (".bgeo", ".gz", ".npz", ".npy", ".ply", ".txt", ".vtp", ".vtu"):
        # The last byte may be a line end or the end mark behind the data.
        assert all(size >= len(content) - 2 for size in survivors)


def test_random_bytes_changed(good_file):
    rng = np.random.default_rng(11)
    content = np.frombuffer(good_file.read_bytes(), np.uint8)
    for trial in range(60):
        changed = content.copy()
        # Headers are where a wrong byte does most.
        reach = len(content) if trial % 2 else min(len(content), 300)
        at = rng.integers(0, reach, 1 + trial % 3)
        changed[at] = rng.integers(0, 256, len(at))
        good_file.write_bytes(changed.tobytes())
        reads_or_refuses(good_file)


@pytest.mark.parametrize("extension", formats.EXTENSIONS)
def test_wrong_content(extension, tmp_path):
    path = tmp_path / f"p{extension}"
    for content in (
        b"",
        b"\n",
        b"\0" * 300,
        b"\x89PNG\r\n\x1a\n" + bytes(range(256)),
        b"<html><body>404 not found</body></html>",
        b"PK\x05\x06" + b"\0" * 10,
        gzip.compress(b"nothing"),
        "∞ 1 2\n".encode(),
    ):
        path.write_bytes(content)
        assert reads_or_refuses(path), content


HUGE = 999_999_999_999
HUGE_COUNTS = [
    ("a.txt", f"{HUGE}\n1 2 3 0 0 0 0 0 0\n"),
    ("a.xyz", f"{HUGE}\n\n1 2 3\n"),
    ("a.xyz", "9" * 5000 + "\n\n1 2 3\n"),
    *[
        ("a.vtk", f"# vtk DataFile Version 3.0\n\n{mode}\nDATASET POLYDATA\n{text}")
        for mode in ("ASCII", "BINARY")
        for text in (
            f"POINTS {HUGE} float\n1 2 3\n",
            f"POINTS {'9' * 5000} float\n1 2 3\n",
            f"POINTS 0 float\nVERTICES 1 {HUGE}\n",
            f"POINTS 0 float\nPOINT_DATA 0\nFIELD F {HUGE}\na 1 0 int\n",
            f"POINTS 0 float\nFIELD F 1\na {HUGE} {HUGE} int\n1",
            f"POINTS 0 float\nCELL_DATA {HUGE}\nSCALARS s int {HUGE}\n1",
            f"POINTS 0 float\nCELL_DATA 0\nLOOKUP_TABLE t {HUGE}\n1",
        )
    ],
    ("a.ply", f"ply\nformat ascii 1.0\nelement vertex {HUGE}\nproperty int x\nend_header\n1\n"),
    ("a.ply", f"ply\nformat binary_little_endian 1.0\nelement vertex {HUGE}\nproperty int x\nend_header\n1\n"),
    (
        "a.ply",
        f"ply\nformat binary_little_endian 1.0\nelement e {HUGE}\nelement vertex 1\nproperty char x\nend_header\n1\n",
    ),
    (
        "a.ply",
        "ply\nformat binary_little_endian 1.0\n"
        f"element e {HUGE}\nproperty list uint double x\nend_header\n\xff\xff\xff\x7f",
    ),
    ("a.bgeo", bgeo(0x7FFFFFFF, b"1234")),
    ("a.bgeo", gzip.compress(bgeo(0x7FFFFFFF, b"1234"))),
    ("a.bgeo", bgeo(1, b"\0\0\xff\xff\0\0\0\0", 0x7FFFFFFF)),
    ("a.bgeo", bgeo(-1, b"")),
    ("a.bgeo", bgeo(1, struct.pack(">HHiI", 0, 1, 4, 0x7FFFFFFF), 1)),
]


def test_huge_counts(tmp_path):
    for name, content in HUGE_COUNTS:
        path = tmp_path / name
        path.write_bytes(content if isinstance(content, bytes) else content.encode("latin-1"))
        assert reads_or_refuses(path), content  # to count so far would never end


@pytest.mark.parametrize("mode", ["ascii", "binary", "base64", "raw"])
def test_huge_counts_in_xml(mode, tmp_path):
    path = tmp_path / "a.vtu"
    content = xml(mode)
    n, huge = b'NumberOfPoints="%d"' % N, b'NumberOfPoints="%d"' % HUGE
    path.write_bytes(content.replace(n, huge))
    assert reads_or_refuses(path)
    components = b'NumberOfComponents="%d"' % HUGE
    path.write_bytes(content.replace(b'NumberOfComponents="3"', components))
    assert reads_or_refuses(path)
    path.write_bytes(content.replace(b'offset="0"', b'offset="%d"' % HUGE))
    assert bool(reads_or_refuses(path)) == (mode in ("base64", "raw"))


@pytest.mark.parametrize(
    "sizes", [(2**32 - 1, 1, 0, 9), (1, 2**31, 0, 9), (1, 300, 2**31, 9), (1, 300, 0, 2**31), None]
)
def test_xml_blocks_lie(sizes, tmp_path):
    """None: a block that unpacks to a thousand times what it announces."""
    packed = zlib.compress(bytes(12 * N * (1 if sizes else 1000)))
    sizes_or_honest = sizes or (1, 12 * N, 0, len(packed))
    text = base64.b64encode(struct.pack("<4I", *sizes_or_honest)) + base64.b64encode(packed)
    good = xml("binary")
    begin, end = good.index(b'offset="0">') + 11, good.index(b"</DataArray>")
    (tmp_path / "a.vtu").write_bytes(good[:begin] + text + good[end:])
    said = reads_or_refuses(tmp_path / "a.vtu")
    assert said if sizes else "another size" in said


def test_xml_entities_and_depth(tmp_path):
    lol = '<!ENTITY a "lol">' + "".join(f'<!ENTITY {chr(98 + i)} "{f"&{chr(97 + i)};" * 10}">' for i in range(9))
    path = tmp_path / "a.vtp"
    path.write_text(f"<!DOCTYPE x [{lol}]><VTKFile>&j;</VTKFile>")
    assert "DOCTYPE" in reads_or_refuses(path)
    for inside in ("", '[<!ENTITY a SYSTEM "file:///etc/passwd">]'):
        path.write_text(f'<!DOCTYPE x SYSTEM "file:///etc/passwd" {inside}><VTKFile>&a;</VTKFile>')
        assert "expected a DOCTYPE without declarations" in reads_or_refuses(path)
    path.write_text("<a>" * 100_000)
    assert "nested" in reads_or_refuses(path)
    path.write_text('<?xml version="1.0" encoding="no-such-thing"?><VTKFile/>')
    assert "expected XML" in reads_or_refuses(path)


def test_a_cut_off_stl(tmp_path):
    trimesh = pytest.importorskip("trimesh")
    path = tmp_path / "box.stl"
    trimesh.creation.box().export(path)
    good = path.read_bytes()
    for cut in (good[:300], b"solid box".ljust(80) + good[80:300]):
        path.write_bytes(cut)
        assert "expected 684 bytes for the 12 triangles of its header, got 300" in reads_or_refuses(path)


def test_text_of_a_mesh_in_latin_1(tmp_path):
    pytest.importorskip("trimesh")
    path = tmp_path / "a.obj"
    path.write_bytes("# für\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n".encode("latin-1"))
    assert reads_or_refuses(path) == ""


def npy(shape: str, descr: str = "'<f8'", data: bytes = b"12345678") -> bytes:
    header = f"{{'descr': {descr}, 'fortran_order': False, 'shape': {shape}, }}\n".encode()
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header + data


def test_npy_headers(tmp_path):
    for content in (
        npy(f"({HUGE}, 3)"),
        npy("(-1, 3)"),
        npy(f"(0, {HUGE})"),
        npy(f"({2**63}, {2**63}, 0)"),
        npy("(1, 3)", "'|O'"),
        npy("(1, 3)", "[('a', '<f8')]"),
        npy("(1, 3)", "'<U1'", b"123456789012"),
        npy("__import__('os').getcwd()"),
        npy("(True, 3)", data=bytes(24)),
        npy("(" * 200 + ")" * 200),
        npy("(1, 3)").replace(b"\x01\x00", b"\x09\x00", 1),
    ):
        (tmp_path / "a.npy").write_bytes(content)
        with zipfile.ZipFile(tmp_path / "a.npz", "w") as archive:
            archive.writestr("positions.npy", content)
        for name in ("a.npy", "a.npz"):
            assert reads_or_refuses(tmp_path / name) or b"True" in content, content


def test_pickles_are_never_loaded(tmp_path):
    objects = np.array([[object()] * 3])
    np.save(tmp_path / "a.npy", objects, allow_pickle=True)
    np.savez(tmp_path / "a.npz", positions=objects, allow_pickle=True)
    for name in ("a.npy", "a.npz"):
        assert "plain numbers" in reads_or_refuses(tmp_path / name)


def test_zip_that_announces_too_much(tmp_path):
    path = tmp_path / "a.npz"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("positions.npy", npy("(100, 3)", data=bytes(2400)))
    # The central directory's uncompressed size, made 2 GB, with a shape to match it.
    content = bytearray(path.read_bytes())
    at = content.rindex(b"PK\x01\x02")
    content[at + 24 : at + 28] = struct.pack("<I", 2**31)
    path.write_bytes(content)
    assert "a claim of" in reads_or_refuses(path)


def test_nine_columns_name_the_place(tmp_path):
    for content, message in (
        ("", "line 1: expected the number of particles"),
        ("two\n", "line 1: expected the number of particles, got 'two'"),
        ("2\n1 2 3 0 0 0 0 0 0\n", "line 3: expected 2 particles (line 1), got 1"),
        ("0\n1 2 3 0 0 0 0 0 0\n", "line 3: expected 0 particles (line 1), got 1"),
        ("2\n1 2 3 0 0 0 0 0 0\n\n1 2 3 0\n", "line 4: expected 9 numbers, got 4"),
        ("1\n1 2 3 0 0 0 0 0 0 0\n", "line 2: expected 9 numbers, got 10"),
        ("1\n1 2 3 0 0 green 0 0 0\n", "line 2, column 6: expected a number, got 'green'"),
        ("1\n1 nan 3 0 0 0 0 0 0\n", "line 2, column 2: expected a finite number for y, got nan"),
        (
            "2\n1 2 3 0 0 0 0 0 0\n\n1 2 3 0 1.5 0 0 0 0\n",
            "line 4, column 5: expected a number in [0, 1] for g, got 1.5",
        ),
        ("1\n1 2 3 0 0 0 0 0 -1\n", "line 2, column 9: expected a number in [0, 1] for rigidity"),
        ("1\n1 2 3 0 0 0 nan 0 0\n", "line 2, column 7: expected a number in [0, 1]"),
        ("1\n# 2 3 0 0 0 0 0 0\n", "line 2, column 1: expected a number, got '#'"),
    ):
        path = tmp_path / "p.txt"
        path.write_text(content)
        assert f"{path}: {message}" in reads_or_refuses(path)


def test_errors_name_the_place(tmp_path):
    for name, content, message in (
        ("a.csv", "x,y,z\n1,2,3\n4,five,6\n", "line 3, column 2: expected a number, got 'five'"),
        ("a.csv", "x,y,z\n1,2,3\n4,5\n", "line 3: expected 3 numbers, got 2"),
        ("a.csv", "x,a\n1,2\n", "expected columns x, y and z"),
        ("a.csv", "x,y,z,x\n1,2,3,4\n", "got 'x' twice"),
        ("a.xyz", "1 2 3\n1 2\n", "line 2: expected 3 numbers, got 2"),
        ("a.xyz", "2\n\nH 1 2 3\nH 1 b 3\n", "line 4, column 3: expected a number, got 'b'"),
        ("a.xyz", "3\n\nH 1 2 3\n", "expected 3 particles (line 1), got 1"),
        ("a.vtk", "# vtk DataFile Version 3.0\n\nASCII\nDATASET POINTED_GRID\n", "line 4: "),
        ("a.vtk", ascii_vtk().decode().replace("DATA 25", "DATA 26"), "expected POINT_DATA 25"),
        ("a.vtk", ascii_vtk().decode().replace(" 24\n", " x\n"), "expected 25 numbers of type"),
        ("a.vtu", "<VTKFile>\n<a></VTKFile>", "line 2, column 6: expected XML, got mismatched tag"),
    ):
        path = tmp_path / name
        path.write_text(content)
        assert message in reads_or_refuses(path)


def test_an_npz_array_of_another_length_is_refused(tmp_path):
    for arrays, expected in (
        ({"support": np.ones(N - 1)}, f"support: expected shape ({N},) or one number, got (24,)"),
        ({"velocity": np.ones((7, 3))}, f"velocity: expected shape ({N}, 3), got (7, 3)"),
        ({"color": np.ones((N + 1, 3))}, f"color: expected shape ({N}, 3) or (3,), got (26, 3)"),
        ({"radius": np.ones(1)}, f"radius: expected shape ({N},) or one number, got (1,)"),
    ):
        path = tmp_path / "p.npz"
        np.savez(path, positions=np.ones((N, 3)), **arrays)
        with pytest.raises(FormatError) as refused:
            formats.read(path)
        assert str(refused.value) == f"{path}: {expected}"


def test_npz_arrays_that_are_about_something_else_are_left_out(tmp_path):
    about = {"support": 0.5, "color": (1, 0, 0), "box": [1, 2]}
    np.savez(tmp_path / "p.npz", positions=np.ones((N, 3)), **about)
    particles = formats.read(tmp_path / "p.npz")
    assert particles.attributes == {}
    assert particles.support == 0.5


def test_what_stands_beside_the_particles_does_no_harm(folder):
    """A title that is a section's name, and columns and names that nobody asks for."""
    Path("a.lmp").write_text(
        "Atoms in a box\n\n1 atoms\n\n0 1 xlo xhi\n0 1 ylo yhi\n0 1 zlo zhi\n\nAtoms # atomic\n\n1 1 0.5 0.5 0.5\n"
    )
    assert gb.read("a.lmp").positions.tolist() == [[0.5, 0.5, 0.5]]
    pa = pytest.importorskip("pyarrow")
    import pyarrow.parquet as pq

    three = {axis: [0.0, 1.0] for axis in "xyz"}
    for ragged in ([[1.0], [1.0, 2.0]], [[1.0, 2.0, 3.0], [1.0]], [[], [1.0, 2.0]]):
        pq.write_table(pa.table({**three, "tags": pa.array(ragged)}), "a.parquet")
        found = gb.read("a.parquet")
        assert len(found) == 2
        assert "tags" not in found.attributes
    with pytest.raises(FormatError, match="expected rows of the same length in the column tags"):
        gb.read("a.parquet", columns={"x": "x", "y": "y", "z": "z", "tag": "tags"})
    h5py = pytest.importorskip("h5py")
    with h5py.File("a.h5", "w") as file:
        file["positions"] = np.zeros((5, 3))
        file.create_dataset(b"\xff\xfe", data=np.zeros(5))
    assert len(gb.read("a.h5")) == 5


def test_what_is_said_of_a_number_that_is_none(folder):
    Path("a.csv").write_text("x,y,z,q\n" + "1,2,3,4\n" * 16 + "1,2,3,1_0\n")
    refuses("line 18, column 4: expected a number, got '1_0'", gb.read, "a.csv", error=FormatError)
    pytest.importorskip("pxr")
    Path("a.usda").write_text('#usda 1.0\ndef Points "p" { point3f[] points = [(0,0,0) }\n')
    refuses(r"a\.usda: expected a USD layer, got text .* at line 2", gb.read, "a.usda", error=FormatError)


DATA = "t\n\n{} atoms\n\nAtoms # atomic\n\n1 1 .1 .2 .3\n2 1 .4 .5 .6\n"
DUMP = "ITEM: TIMESTEP\n0\nITEM: NUMBER OF ATOMS\n{}\nITEM: ATOMS {} x y z\n1 1 .1 .2 .3\n2 1 .4 .5 .6\n"
ZONE = "VARIABLES = X Y {}\nZONE {}\n# rows\n1 2 3\n\n4 5 6\n"
VTK = "# vtk DataFile Version 3.0\nt\nASCII\nDATASET POLYDATA\nPOINTS 1 float\n1 2 3\nPOINT_DATA 1\n"
SCALARS = VTK + "SCALARS a {} 1\nLOOKUP_TABLE default\n{}\n"
XML = (
    '<VTKFile type="PolyData" byte_order="LittleEndian"><PolyData><Piece NumberOfPoints="1"><Points><DataArray '
    'type="Float32" NumberOfComponents="3" format="ascii">1 2 3</DataArray></Points><PointData><DataArray '
    'type="{}" Name="a" format="ascii">{}</DataArray></PointData></Piece></PolyData></VTKFile>'
)
PLY = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
ROWS = "end_header\n1 2 3{0}\n1 3 3{0}\n2 2 3{0}\n"
BYTE = PLY + "property uchar a\n" + ROWS
FACE = PLY + "element face 1\nproperty list uchar int vertex_indices\n" + ROWS.format("") + "3 0 1 {}\n"
PCD = "VERSION 0.7\nFIELDS x y z a\nSIZE 4 4 4 1\nTYPE F F F U\nWIDTH 1\nHEIGHT 1\nDATA ascii\n1 2 3 {}\n"


def test_what_a_file_says_of_its_rows_holds(tmp_path):
    for name, good, wrong, problem in (
        ("a.lmp", DATA.format(2), DATA.format(1), "line 5: expected 1 atoms, got '2 1 .4 .5 .6' behind them"),
        ("a.lmp", DATA.format(2), DATA.format(3), "line 5: expected 3 atoms, got 2"),
        ("a.dump", DUMP.format(2, "id type"), DUMP.format(1, "id type"), "line 5: expected 1 atoms, got '2 1 .4"),
        ("a.dump", DUMP.format(2, "id type"), DUMP.format(2, "id id"), "line 5: expected different names, got "),
        ("a.tec", ZONE.format("Z", "I=2, J=1"), ZONE.format("Z", "I=1"), "expected 1 points in the zone, got 2 rows"),
        ("a.tec", ZONE.format("Z", ""), ZONE.format("Z", "I=2, J=2"), "expected 4 points in the zone, got 2 rows"),
        ("a.tec", ZONE.format("T", "N=2"), ZONE.format("T", "N=3"), "expected 3 points in the zone, got 2 rows"),
        ("a.tec", ZONE.format("T", "I=2"), ZONE.format("X", "I=2"), "expected different names, got 'X' twice"),
        ("a.pts", "2\n1 2 3\n4 5 6\n", "1\n1 2 3\n4 5 6\n", r"expected 1 particles \(line 1\), got 2"),
        ("a.xyz", "1\nProperties=pos:R:3:a:R:1\n1 2 3 4\n", "1\nProperties=pos:R:3:pos:R:3\n1 2 3 4 5 6\n", "twice"),
        ("a.vtk", SCALARS.format("unsigned_char", 255), SCALARS.format("unsigned_char", 256), "unsigned_char.*got 256"),
        ("a.vtk", SCALARS.format("int", -(2**31)), SCALARS.format("int", 3 * 10**9), "int.*got 3000000000"),
        ("a.vtk", SCALARS.format("long", 2**63 - 1), SCALARS.format("long", 2**63), "long.*got '9223372036854775808'"),
        ("a.vtp", XML.format("UInt64", 2**64 - 1), XML.format("UInt64", 2**64), "UInt64, got '18446744073709551616'"),
        ("a.vtp", XML.format("Int8", -128), XML.format("Int8", -129), "<DataArray a>: .*Int8, got -129"),
        ("a.ply", BYTE.format(" 255"), BYTE.format(" 300"), "element vertex, property a: .*uint8, got 300"),
        ("a.ply", BYTE.format(" 1.0"), BYTE.format(" 0.5"), "element vertex, property a: .*uint8, got 0.5"),
        ("a.ply", FACE.format(2), FACE.format(1.5), "element face, property vertex_indices: .*got 1.5"),
        ("a.pcd", PCD.format(255), PCD.format(-1), "DATA, field a: .*uint8, got -1"),
    ):
        path = tmp_path / name
        path.write_text(good)
        assert 1 <= len(gb.read(path)) <= 3
        path.write_text(wrong)
        refuses(problem, gb.read, path)


def test_tables_name_what_is_wrong(tmp_path):
    for content, columns, problem in (
        ('x,y,z\n"1,000",2.5,3\n', None, "line 2: expected one decimal mark in all numbers, got '1,000' and '2.5'"),
        ("x,y,z\n1,\u0662,3\n", None, "line 2, column 2: expected a number, got '\u0662'"),
        ("x,y,z\n1,2,3\n", {"x": "x", "y": "y", "z": "z", "density": "x"}, "got 'x' for x and density"),
    ):
        path = tmp_path / "a.csv"
        path.write_text(content, encoding="utf-8")
        refuses(problem, gb.read, path, columns=columns)


def test_a_file_cut_in_its_appended_data_says_so(tmp_path):
    path = tmp_path / "cut.vtu"
    path.write_bytes(xml("raw")[:-40])
    with pytest.raises(formats.FormatError, match="</AppendedData>, got the end of the file: cut off"):
        formats.read(path)


def test_a_folder_of_particles_names_the_pattern(tmp_path):
    for name in ("frame_0.vtp", "frame_1.vtp"):
        formats.write(tmp_path / name, sample(N))
    formats.write(tmp_path / "last.npz", sample(N))
    for name in ("plot.png", ".hidden.bgeo"):
        (tmp_path / name).write_bytes(b"")
    with pytest.raises(FormatError, match=r"expected a file, got a folder; a pattern .* such as '.*[/\\]\*\.vtp'"):
        formats.read(tmp_path)
    (tmp_path / "plot.png").unlink()
    with pytest.raises(FormatError, match="expected a file, got a folder"):
        kind_of(tmp_path)
