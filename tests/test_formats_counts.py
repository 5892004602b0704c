"""Counts, types and names that a text file says and does not keep: refused, not read in silence."""

from __future__ import annotations

from pathlib import Path

import globule as gb
import pytest

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
