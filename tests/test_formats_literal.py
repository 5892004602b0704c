"""Literal files: what each format looks like when somebody else wrote it."""

import base64
import gzip
import struct
import zlib
from pathlib import Path

import numpy as np
import pytest
from format_helpers import assert_same
from globule import formats
from globule.data.particles import Particles


def read_text(tmp_path: Path, name: str, content: str | bytes) -> Particles:
    path = tmp_path / name
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return formats.read(path)


def test_nine_columns(tmp_path):
    p = read_text(tmp_path, "p.txt", "2\n0.45 0.4 0.45 0.4 0.6 0.1 0.6 0.2 1\n1 2 3 0 0 0 0 0 0\n")
    assert np.allclose(p.positions, [[0.45, 0.4, 0.45], [1, 2, 3]])
    assert np.allclose(p.color[0], [0.4, 0.6, 0.1])
    assert np.allclose(p.reflection, [0.6, 0])
    assert np.allclose(p.refraction, [0.2, 0])
    assert np.allclose(p.rigidity, [1, 0])
    assert p.support is None
    formats.write(tmp_path / "q.dat", p)
    assert_same(formats.read(tmp_path / "q.dat"), p)


VTK_51 = """# vtk DataFile Version 5.1
written by hand
ASCII
DATASET POLYDATA
FIELD FieldData 1
TIME 1 1 double
0.5
POINTS 3 floats
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
    assert list(p.attributes) == ["density", "velocity", "n", "two words", "h", "material"]
    assert np.array_equal(p.attributes["density"], [10, np.nan, 30], equal_nan=True)
    assert p.attributes["velocity"].dtype == np.float64
    assert np.array_equal(p.attributes["velocity"][2], [7, 8, 9])
    assert np.array_equal(p.attributes["two words"], [[1, 2], [3, 4], [5, 6]])
    assert np.array_equal(p.color, np.float32([[1, 0, 0], [0, 1, 0], [0, 0, 0.5]]))
    assert np.array_equal(p.support, np.float32([0.5, 0.5, 1]))


def vtu(data: str, head: str = "", n: int = 2, tail: str = "") -> str:
    return (
        f'<?xml version="1.0"?><VTKFile type="UnstructuredGrid" version="0.1" {head}>'
        f'<UnstructuredGrid><Piece NumberOfPoints="{n}" NumberOfCells="0"><Points>{data}</Points>'
        f"</Piece></UnstructuredGrid>{tail}</VTKFile>"
    )


def test_vtu_ascii_and_binary(tmp_path):
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
    assert list(p.attributes) == ["id"]
    assert np.array_equal(p.attributes["id"], [5, 6, 7])


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
    assert p.support == 1
    assert set(p.attributes) == {"velocities", "stress"}
    assert p.attributes["stress"].shape == (2, 9)
    assert np.array_equal(p.color, np.float32([[1, 0, 0], [0, 0, 0.2]]))
    np.savez(path, positions=np.eye(3)[:2], radius=0.25, support=0.5, weight=np.ones((2, 2)))
    p = formats.read(path)
    assert p.support == 0.5
    assert p.weight is None
    assert p.attributes["weight_attribute"].shape == (2, 2)


def test_npy_fortran_and_wide(tmp_path):
    table = np.asfortranarray(np.arange(10.0).reshape(2, 5))
    np.save(tmp_path / "p.npy", table)
    p = formats.read(tmp_path / "p.npy")
    assert np.array_equal(p.positions, table[:, :3])
    assert np.array_equal(p.attributes["column5"], [4, 9])
