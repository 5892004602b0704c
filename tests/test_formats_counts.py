"""Counts, types and names that a text file says and does not keep: refused, not read in silence."""

from __future__ import annotations

from pathlib import Path

import globule as gb
import pytest

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


@pytest.mark.parametrize(
    ("name", "good", "wrong", "problem"),
    [
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
    ],
)
def test_what_a_file_says_of_its_rows_holds(tmp_path: Path, name: str, good: str, wrong: str, problem: str) -> None:
    path = tmp_path / name
    path.write_text(good)
    assert 1 <= len(gb.read(path)) <= 3
    path.write_text(wrong)
    with pytest.raises(ValueError, match=problem) as refusal:
        gb.read(path)
    assert "\n" not in str(refusal.value)


@pytest.mark.parametrize(
    ("content", "columns", "problem"),
    [
        ('x,y,z\n"1,000",2.5,3\n', None, "line 2: expected one decimal mark in all numbers, got '1,000' and '2.5'"),
        ("x,y,z\n1,\u0662,3\n", None, "line 2, column 2: expected a number, got '\u0662'"),
        ("x,y,z\n1,2,3\n", {"x": "x", "y": "y", "z": "z", "density": "x"}, "got 'x' for x and density"),
    ],
)
def test_tables_name_what_is_wrong(tmp_path: Path, content: str, columns: dict | None, problem: str) -> None:
    path = tmp_path / "a.csv"
    path.write_text(content, encoding="utf-8")
    with pytest.raises(ValueError, match=problem):
        gb.read(path, columns=columns)
