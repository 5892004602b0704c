"""Laser scans and molecules: PCD by globule, LAS, PDB and GRO through other packages."""

import struct

import globule as gb
import numpy as np
import pytest
from globule.formats import read_contents
from globule.formats.pcd import unpack_lzf

N = 200
RNG = np.random.default_rng(5)
POINTS = RNG.random((N, 3)).astype(np.float32)
NORMALS = RNG.normal(size=(N, 3)).astype(np.float32)
COLORS = RNG.integers(0, 256, (N, 3), np.uint8)
LABELS = RNG.integers(0, 7, N).astype(np.uint16)
ROW = np.dtype([("p", "<f4", 3), ("n", "<f4", 3), ("rgb", "<u4"), ("pad", "u1", 2), ("label", "<u2")])
HEADER = """# .PCD v0.7 - Point Cloud Data file format
VERSION 0.7
FIELDS x y z normal_x normal_y normal_z rgb _ label
SIZE 4 4 4 4 4 4 4 1 2
TYPE F F F F F F {rgb} U U
COUNT 1 1 1 1 1 1 1 2 1
WIDTH {n}
HEIGHT 1
VIEWPOINT 0 0 0 1 0 0 0
POINTS {n}
DATA {how}
"""


def rows() -> np.ndarray:
    made = np.zeros(N, ROW)
    made["p"], made["n"], made["label"] = POINTS, NORMALS, LABELS
    made["rgb"] = COLORS.astype(np.uint32) @ [1 << 16, 1 << 8, 1]
    return made


def pack_lzf(data: bytes) -> bytes:
    """Stores runs of equal bytes as one copy, all else as it is."""
    out, at = bytearray(), 0
    while at < len(data):
        run = 1
        while run < 250 and at + run < len(data) and data[at + run] == data[at]:
            run += 1
        if run > 10:  # one byte as it is, the rest from the byte before
            out += bytes([0, data[at], 7 << 5, run - 1 - 2 - 7, 0])
            at += run
            continue
        part = data[at : at + 32]
        out += bytes([len(part) - 1]) + part
        at += len(part)
    return bytes(out)


def write_pcd(path, how: str) -> None:
    table = rows()
    head = HEADER.format(n=N, how=how, rgb="F" if how == "binary" else "U").encode()
    if how == "ascii":
        lines = [
            " ".join(map(repr, [*p.tolist(), *n.tolist(), int(c), 0, 0, int(label)])) for p, n, c, _, label in table
        ]
        path.write_bytes(head + "\n".join(lines).encode() + b"\n")
    elif how == "binary":
        path.write_bytes(head + table.tobytes())
    else:
        columns = [POINTS.T, NORMALS.T, table["rgb"], table["pad"], LABELS]
        plain = b"".join(np.ascontiguousarray(c).tobytes() for c in columns)
        packed = pack_lzf(plain)
        path.write_bytes(head + struct.pack("<II", len(packed), len(plain)) + packed)


@pytest.mark.parametrize("how", ["ascii", "binary", "binary_compressed"])
def test_pcd(tmp_path, how):
    write_pcd(tmp_path / "a.pcd", how)
    got = gb.read(tmp_path / "a.pcd")
    np.testing.assert_array_equal(got.positions, POINTS)
    np.testing.assert_array_equal(got.attributes["normal"], NORMALS)
    np.testing.assert_array_equal(got.attributes["label"], LABELS)
    np.testing.assert_allclose(got.color, gb.Particles(POINTS, color=COLORS).color)
    assert {*got.attributes} == {"normal", "label"}


def test_images_of_points_and_copies_of_lzf(tmp_path):
    head = "VERSION .7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 3\nHEIGHT 2\n"
    (tmp_path / "a.pcd").write_text(head + "DATA ascii\n" + "1 2 3\n" * 6)
    assert gb.read(tmp_path / "a.pcd").positions.tolist() == [[1, 2, 3]] * 6
    assert unpack_lzf(bytes([2, 97, 98, 99, 0b11100000, 3, 2]), 15) == b"abc" * 5
    assert unpack_lzf(bytes([0, 97, 0b00100000, 0]), 4) == b"aaaa"
    for wrong in (bytes([0b00100000, 0]), bytes([0b11100000]), bytes([5, 97])):
        assert unpack_lzf(wrong, 4) is None


@pytest.mark.parametrize(("change", "said"), [
    ((b"POINTS 200", b"POINTS 99999999999"), "POINTS: expected at most 200 times"),
    ((b"POINTS 200", b"POINTS -1"), "POINTS: expected a number"),
    ((b"POINTS 200", b"POINTS 300"), "DATA: expected"),
    ((b"DATA binary", b"DATA zip"), "DATA: expected ascii, binary or binary_compressed"),
    ((b"DATA binary\n", b""), "header: expected a line DATA"),
    ((b"SIZE 4", b"SIZE 3"), "x: expected a known TYPE"),
    ((b"TYPE F F", b"TYPE F"), "FIELDS: expected as many"),
    ((b"FIELDS x y", b"FIELDS u v"), "FIELDS: expected x, y and z"),
    ((b"COUNT 1", b"COUNT 9999999"), "x: expected a known TYPE"),
])  # fmt: skip
def test_damaged_pcd(tmp_path, change, said):
    write_pcd(tmp_path / "a.pcd", "binary")
    data = (tmp_path / "a.pcd").read_bytes()
    assert data.count(change[0]) == 1
    (tmp_path / "a.pcd").write_bytes(data.replace(*change))
    with pytest.raises(gb.FormatError, match=said):
        gb.read(tmp_path / "a.pcd")


@pytest.mark.parametrize("packed", [False, True])
def test_las(tmp_path, packed):
    laspy = pytest.importorskip("laspy")
    if packed:
        pytest.importorskip("lazrs")
    far = np.array([440_000.0, 5_400_000.0, 120.0])
    scan = laspy.LasData(laspy.LasHeader(point_format=3, version="1.2"))
    scan.header.offsets, scan.header.scales = far, np.full(3, 1e-4)
    scan.x, scan.y, scan.z = (POINTS + far).T
    scan.classification = LABELS.astype(np.uint8)
    scan.red, scan.green, scan.blue = (COLORS.astype(np.uint16) * 257).T
    name = tmp_path / ("a.laz" if packed else "a.las")
    scan.write(name)
    with pytest.warns(UserWarning, match="positions are given from"):
        got = gb.read(name)
    np.testing.assert_allclose(got.world_positions(), POINTS + far, atol=6e-5)
    np.testing.assert_array_equal(got.attributes["classification"], LABELS)
    np.testing.assert_allclose(got.color, gb.Particles(POINTS, color=COLORS).color)
    (tmp_path / "b.las").write_bytes(name.read_bytes()[:300])
    with pytest.raises(gb.FormatError, match=r"b\.las: .*(laspy|header)"):
        gb.read(tmp_path / "b.las")


WATER = (("O", 0.0, 0.0, 0.0), ("H", 0.957, 0.0, 0.0), ("H", -0.24, 0.927, 0.0))


def pdb(path, n_frames: int = 1) -> None:
    lines = ["CRYST1   30.000   30.000   30.000  90.00  90.00  90.00 P 1           1"]
    for k in range(n_frames):
        lines += [f"MODEL     {k + 1:4d}"] * (n_frames > 1)
        for i, (e, x, y, z) in enumerate(WATER):
            lines.append(
                f"ATOM  {i + 1:5d}  {e:<3s} HOH A   1    {x + k:8.3f}{y:8.3f}{z:8.3f}  1.00  0.00          {e:>2s}"
            )
        lines += ["ENDMDL"] * (n_frames > 1)
    path.write_text("\n".join([*lines, "END", ""]))


@pytest.mark.interop
@pytest.mark.parametrize("package", ["MDAnalysis", "ase"])
def test_pdb(tmp_path, package, monkeypatch):
    pytest.importorskip(package)
    if package == "ase":
        monkeypatch.setitem(__import__("sys").modules, "MDAnalysis", None)
    pdb(tmp_path / "w.pdb", 2)
    found = read_contents(tmp_path / "w.pdb", frame=1)
    assert found.n_frames == 2
    xyz = np.array([row[1:] for row in WATER]) + (1, 0, 0)
    np.testing.assert_allclose(found.particles.positions, xyz, atol=1e-5)
    np.testing.assert_allclose(found.particles.attributes["radius"], [1.52, 1.2, 1.2], atol=0.11)
    pdb(tmp_path / "one.pdb")
    np.testing.assert_allclose(read_contents(tmp_path / "one.pdb").box.edges, 30 * np.eye(3), atol=1e-4)
    assert found.units["positions"] == "Å"


@pytest.mark.interop
def test_gro(tmp_path):
    pytest.importorskip("MDAnalysis")
    lines = ["water", "    3"]
    for i, (e, x, y, z) in enumerate(WATER):
        lines.append(f"    1SOL  {e + str(i):>5s}{i + 1:5d}{x / 10:8.3f}{y / 10:8.3f}{z / 10:8.3f}")
    (tmp_path / "w.gro").write_text("\n".join([*lines, "   3.0 3.0 3.0", ""]))
    found, xyz = read_contents(tmp_path / "w.gro"), np.array([row[1:] for row in WATER])
    np.testing.assert_allclose(found.particles.positions, xyz, atol=0.006)
    assert found.particles.attributes["atomic_number"].tolist() == [8, 1, 1]


@pytest.mark.interop
def test_gadget(tmp_path):
    pytest.importorskip("pynbody")
    counts, last = [N, *[0] * 5], (1.0, 0.3, 0.7, 0.7)
    head = struct.pack("<6I8d10I4d", *counts, 1e-3, *[0.0] * 7, 0, 0, *counts, 0, 1, *last)
    blocks = [head.ljust(256, b"\0"), POINTS.tobytes(), NORMALS.tobytes(),
              np.arange(N, dtype="u4").tobytes(), np.ones((3, N), "f4").tobytes()]  # fmt: skip
    records = [struct.pack("<I", len(b)) + b + struct.pack("<I", len(b)) for b in blocks]
    (tmp_path / "snap_000").write_bytes(b"".join(records))
    got = gb.read(tmp_path / "snap_000")
    np.testing.assert_array_equal(got.positions, POINTS)
    np.testing.assert_array_equal(got.attributes["velocity"], NORMALS)
    (tmp_path / "snap_001").write_bytes(b"".join(records)[:700])
    with pytest.raises(gb.FormatError, match="snap_001: pynbody: "):
        gb.read(tmp_path / "snap_001")
