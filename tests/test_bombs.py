"""Small files that claim to be large are refused at once, in one line, within the memory that was set."""

import functools
import gzip
import io
import json
import struct
import subprocess
import sys
import zipfile
import zlib
from pathlib import Path

import globule as gb
import numpy as np
import pytest
from cli_helpers import refused, refuses
from globule._base import memory
from globule.cli import main
from globule.formats import FormatError
from test_formats_hostile import bgeo

pytestmark = pytest.mark.usefixtures("folder")

OPEN = """
import json, operator, resource, sys
import globule as gb
resource.setrlimit(resource.RLIMIT_CPU, (60, 60))  # of a hang, which would take minutes
files, limits = json.loads(sys.argv[1]), map(float, sys.argv[2:])
found = []
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
for most in limits:
    gb.set_limits(memory=most)
    for path, kind in files.items():
        try:
            operator.attrgetter(kind)(gb)(path)
            said = ""
        except gb.FormatError as error:
            said = str(error)
        used = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before
        found.append((path, most, said, used * 1024))
print(json.dumps(found))
"""
MOST = 2**29  # bytes


def opened(files: dict[str, str], *limits: float) -> list[tuple[str, float, str, int]]:
    """File, limit of memory (which rises), what the reader says, and the most bytes taken so far, in one process."""
    words = [sys.executable, "-c", OPEN, json.dumps(files), *map(str, limits)]
    made = subprocess.run(words, capture_output=True, text=True, check=True)
    return json.loads(made.stdout)


@functools.cache
def zeros(n: int) -> bytes:
    """n zeros as one gzip member."""
    return gzip.compress(bytes(n), 9, mtime=0)


def npz_of_shared_bytes() -> str:
    """300 members whose entries are one and the same."""
    out = io.BytesIO()
    np.lib.format.write_array(out, np.zeros((2_000_000, 3), np.float32))
    with zipfile.ZipFile("a.npz", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("positions.npy", out.getvalue())
        info = archive.infolist()[0]
        for i in range(300):
            twin = zipfile.ZipInfo(f"{i:08}.npy")
            for name in ("compress_type", "CRC", "compress_size", "file_size", "header_offset"):
                setattr(twin, name, getattr(info, name))
            archive.filelist.append(twin)
    return "a.npz"


def bgeo_of_zeros() -> str:
    n = 2**26
    Path("a.bgeo.gz").write_bytes(gzip.compress(bgeo(n, b"")) + (16 * n >> 27) * zeros(2**27))
    return "a.bgeo.gz"


def vtu_of_shared_bytes() -> str:
    """200 arrays at one place of the appended data."""
    n = 1_000_000
    block = zlib.compress(bytes(12 * n), 9)
    sizes = struct.pack("<4I", 1, 12 * n, 0, len(block))
    arrays = "".join(
        f'<DataArray type="Float32" Name="a{i}" NumberOfComponents="3" format="appended" '
        'offset="0"/>' for i in range(200)
    )  # fmt: skip
    Path("a.vtu").write_bytes(
        f'<VTKFile type="UnstructuredGrid" byte_order="LittleEndian" '
        f'compressor="vtkZLibDataCompressor"><UnstructuredGrid><Piece NumberOfPoints="{n}">'
        '<Points><DataArray type="Float32" NumberOfComponents="3" format="appended" offset="0"/>'
        f'</Points><PointData>{arrays}</PointData></Piece></UnstructuredGrid>'
        '<AppendedData encoding="raw">_'.encode() + sizes + block + b"</AppendedData></VTKFile>"
    )  # fmt: skip
    return "a.vtu"


def nrrd_of_20_gigabytes() -> str:
    head = (b"NRRD0004\ntype: float\ndimension: 3\nsizes: 1760 1760 1760\nendian: little\n"
            b"encoding: gzip\n\n")  # fmt: skip
    Path("a.nrrd").write_bytes(head + 8 * zeros(2**27))
    return "a.nrrd"


def metaimage_of_20_gigabytes() -> str:
    head = (b"ObjectType = Image\nNDims = 3\nDimSize = 1760 1760 1760\nElementType = MET_FLOAT\n"
            b"BinaryData = True\nCompressedData = True\nElementDataFile = LOCAL\n")  # fmt: skip
    Path("a.mha").write_bytes(head + zlib.compress(bytes(2**27), 9))
    return "a.mha"


def nifti(name: str, sizes: tuple[int, int, int], offset: float, behind: bytes) -> str:
    head = bytearray(348)
    struct.pack_into("<i", head, 0, 348)
    struct.pack_into("<8h", head, 40, 3, *sizes, 1, 1, 1, 1)
    struct.pack_into("<2h", head, 70, 16, 32)  # float32
    struct.pack_into("<8f", head, 76, *[1.0] * 8)
    struct.pack_into("<f", head, 108, offset)
    head[344:348] = b"n+1\0"
    Path(f"{name}.nii.gz").write_bytes(gzip.compress(bytes(head), mtime=0) + behind)
    return f"{name}.nii.gz"


def hdr_of_runs() -> str:
    width, height = 16384, 8192
    run = b"".join(bytes((128 + min(127, width - at), 9)) for at in range(0, width, 127))
    row = bytes((2, 2, width >> 8, width & 255)) + 4 * run
    Path("a.hdr").write_bytes(b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n"
                              b"-Y %d +X %d\n" % (height, width) + height * row)  # fmt: skip
    return "a.hdr"


def png_of_one_color() -> str:
    width = height = 8000
    row = b"\0" + bytes(3 * width)
    packer = zlib.compressobj(9)
    data = b"".join(packer.compress(row) for _ in range(height)) + packer.flush()

    def chunk(name: bytes, content: bytes) -> bytes:
        check = zlib.crc32(name + content)
        return struct.pack(">I", len(content)) + name + content + struct.pack(">I", check)

    head = struct.pack(">2I5B", width, height, 8, 2, 0, 0, 0)
    Path("a.png").write_bytes(b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", data)
                              + chunk(b"IEND", b""))  # fmt: skip
    return "a.png"


def sparse_volume() -> str:
    blocks = {"values": np.zeros((1, 8, 8, 8), np.float32), "blocks": np.zeros(1, np.int64)}
    place = {"shape": np.array([2000, 2000, 2000]), "world_from_voxel": np.eye(4)}
    np.savez("a.sparse.npz", **blocks, **place)
    return "a.sparse.npz"


def xml_of_elements() -> str:
    Path("a.vtp").write_bytes(b"<VTKFile>" + b"<a/>" * 2_000_000 + b"</VTKFile>")
    return "a.vtp"


BOMBS = [
    ("read", npz_of_shared_bytes),
    ("read", bgeo_of_zeros),
    ("read", vtu_of_shared_bytes),
    ("read", xml_of_elements),
    ("volumes.read_volume", nrrd_of_20_gigabytes),
    ("volumes.read_volume", metaimage_of_20_gigabytes),
    ("volumes.read_volume", lambda: nifti("a", (1200, 1200, 1200), 352, 4 * zeros(2**27))),
    ("volumes.read_volume", lambda: nifti("short", (30000, 30000, 30000), 352, zeros(100))),
    ("volumes.read_volume", lambda: nifti("offset", (2, 2, 2), 2.0**33, 64 * zeros(2**27))),
    ("volumes.read_volume", sparse_volume),
    ("Environment", hdr_of_runs),
    ("Environment", png_of_one_color),
]


def test_they_are_refused_at_once():
    files = {}
    for kind, make in BOMBS:
        files[make()] = kind
    assert len(files) == len(BOMBS)
    for path, _, said, taken in opened(files, MOST):
        assert said.startswith(f"{path}: ")
        assert "\n" not in said
        assert len(said) < 320
        assert taken < 200e6, path


def test_what_lies_behind_the_data_is_not_read():
    """6.9 GB behind the points, and 6.9 GB behind the voxels."""
    Path("a.bgeo.gz").write_bytes(gzip.compress(bgeo(1, bytes(16))) + 51 * zeros(2**27))
    path = nifti("a", (2, 2, 2), 352, gzip.compress(bytes(4 + 32)) + 51 * zeros(2**27))
    for _, _, said, taken in opened({"a.bgeo.gz": "read", path: "volumes.read_volume"}, MOST):
        assert said == ""
        assert taken < 200e6


@pytest.mark.slow
def test_memory_stays_below_the_limit():
    """Real data near the limit: either they are read within it, or refused before."""
    rng = np.random.default_rng(0)
    n = 100_000
    points = gb.Particles(rng.random((n, 3)), attributes={"a": rng.random((n, 3))})
    names = ["a.npz", "a.npy", "a.vtp", "a.vtk", "a.bgeo", "a.bgeo.gz", "a.ply"]
    for name in names:
        gb.write(name, points)
    rows = "".join(",".join(map(str, row)) + "\n" for row in rng.random((1000, 6)).tolist())
    Path("a.csv").write_text("x,y,z,a_x,a_y,a_z\n" + 50 * rows)
    Path("a.xyz").write_text(50 * rows.replace(",", " "))
    Path("short.xyz").write_bytes(b"1 1 1\n" * 400_000)
    Path("empty.csv").write_bytes(b"x,y,z\n1,2,3\n" + b"\n" * 4_000_000)
    Path("ascii.vtk").write_bytes(
        b"# vtk DataFile Version 3.0\n\nASCII\nDATASET POLYDATA\nPOINTS 400000 double\n" + b"1 1 1 " * 400_000
    )
    values = rng.integers(0, 9, (100, 100, 10)).repeat(16, axis=2)  # is packed fast
    volume = gb.volumes.Volume(values.astype(np.int16), np.eye(4))
    volumes = ["v.mha", "v.nrrd", "v.nii.gz", "v.vti", "v.npz"]
    for name in volumes:
        gb.volumes.write_volume(name, volume)
    files = dict.fromkeys([*names, "a.csv", "a.xyz", "short.xyz", "empty.csv", "ascii.vtk"], "read")
    files |= dict.fromkeys(volumes, "volumes.read_volume")
    for name, most, said, taken in opened(files, 4e6, 1e7, 2e7, 8e8):
        assert taken < most + 1.5e7, (name, most, taken)  # beside what imports take
        assert said == "" or (name in said and most < 8e8)


def test_limits_are_set_and_given_back():
    assert memory.limits() == {"memory": None, "ratio": memory.RATIO}
    before = gb.set_limits(memory=1e9, ratio=7)
    assert before == {"memory": None, "ratio": 200.0}
    assert gb.set_limits(**before) == {"memory": 1e9, "ratio": 7.0}
    for wrong in ({"memory": 0}, {"memory": "1"}, {"ratio": 0.5}, {"ratio": None}):
        refuses(next(iter(wrong)), gb.set_limits, **wrong, error=(TypeError, ValueError))
    assert memory.limits() == before


@pytest.mark.slow
def test_a_sound_file_above_the_ratio_is_read_if_the_ratio_is_raised(capsys):
    volume = gb.volumes.Volume(np.zeros((300, 300, 400), np.uint16), np.eye(4))
    gb.volumes.write_volume("v.nii.gz", volume)
    refuses("expected at most 200 times", gb.volumes.read_volume, "v.nii.gz", error=FormatError)
    before = gb.set_limits(ratio=2000)
    try:
        assert gb.volumes.read_volume("v.nii.gz").shape == (300, 300, 400)
    finally:
        gb.set_limits(**before)
    assert "v.nii.gz: data: expected at most 200 times" in refused(capsys, "info", "v.nii.gz")
    assert main(["info", "v.nii.gz", "--max-ratio", "2000"]) == 0
    capsys.readouterr()
    words = ("info", "v.nii.gz", "--max-ratio", "2000", "--max-memory", "0.01")
    assert "v.nii.gz: data: expected data that fit in 0.01 GB" in refused(capsys, *words)
    assert memory.limits() == before


def test_a_scene_needs_no_more_memory_than_may_be_taken(capsys):
    Path("a.toml").write_text(
        "spacing = 0.01\n[domain]\nlo = [0, 0, 0]\nhi = [2, 2, 2]\n[[fluids]]\nname = 'water'\n"
        "box = {lo = [0, 0, 0], hi = [1, 1, 1]}\n",
        encoding="utf-8",
    )
    line = refused(capsys, "simulate", "a.toml", "-o", "out", "--max-memory", "0.5")
    assert line.startswith("globule: error: a.toml: fluids[0] (water): expected particles that fit")


def test_the_limits_of_a_process_count():
    """`ulimit -v`."""
    code = (
        "import resource as r; from globule._base import memory; n = memory.free_bytes(); "
        "r.setrlimit(r.RLIMIT_AS, (2**34, 2**34)); print(memory.free_bytes() < 2**34, n > 0)"
    )
    made = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert made.stdout.split() == ["True", "True"]


@pytest.mark.slow
def test_meshes():
    """A .glb whose 3,000 parts are one and the same, and text, which needs much memory."""
    trimesh = pytest.importorskip("trimesh")
    content = trimesh.creation.icosphere(5).export(file_type="glb")
    length = struct.unpack_from("<I", content, 12)[0]
    tree = json.loads(content[20 : 20 + length])
    tree["meshes"][0]["primitives"] *= 3000
    text = json.dumps(tree).encode()
    text += b" " * (-len(text) % 4)
    rest = content[20 + length :]
    head = struct.pack("<4sII", b"glTF", 2, 20 + len(text) + len(rest))
    Path("a.glb").write_bytes(head + struct.pack("<I4s", len(text), b"JSON") + text + rest)
    Path("a.obj").write_bytes(b"v 0 0 0\nv 1 0 0\nv 0 1 0\n" + b"f 1 2 3\n" * 400_000)
    for path, most, said, taken in opened({"a.glb": "read", "a.obj": "read"}, 1e8, 3e8):
        assert taken < min(most, 2e8 if path == "a.glb" else 3e8)
        if path == "a.glb":
            assert said.startswith("a.glb: meshes: expected ")
        else:
            assert ("a.obj: expected data that fit" in said) == (most == 1e8)
