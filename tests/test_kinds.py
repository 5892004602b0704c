"""What a file holds is found in its content: endings may be wrong or missing."""

import shutil
from pathlib import Path

import globule as gb
import numpy as np
import pytest
from cli_helpers import refuses
from format_helpers import assert_same, sample
from globule.formats import EXTENSIONS, FormatError, kind_of
from globule.formats.kind import Kind
from globule.formats.volumes import WRITABLE
from globule.volumes.volume import Volume
from PIL import Image

ODD_NAMES = ("no-ending", "wrong.stl", "wrong.csv", "wrong.mha")
OBJ = "mtllib a.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"
STL = "solid a\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\nendloop\n"


pytestmark = pytest.mark.usefixtures("folder")


def names_of(file):
    """The file, and copies of it under other names."""
    for name in ODD_NAMES:
        shutil.copy(file, name)
    return (file, *ODD_NAMES)


def volume() -> Volume:
    values = np.random.default_rng(1).integers(1, 255, (4, 5, 6), np.uint8)
    return Volume(values, np.diag([0.5, 0.7, 0.9, 1.0]))


@pytest.mark.parametrize("extension", EXTENSIONS)
def test_particles(extension):
    gb.write(f"a{extension}", sample())
    expected = gb.read(f"a{extension}")
    kind = kind_of(f"a{extension}")
    assert kind.kind == "particles"
    for name in names_of(f"a{extension}"):
        assert kind_of(name) == kind
        assert_same(gb.read(name), expected)


@pytest.mark.parametrize("extension", WRITABLE)
def test_volumes(extension):
    gb.volumes.write_volume(f"a{extension}", volume())
    for name in names_of(f"a{extension}"):
        assert kind_of(name).kind == "volume"
        assert np.array_equal(gb.volumes.read_volume(name).values, volume().values)
        for reader, door in ((gb.read, "read_volume"), (gb.read, "sample_tomography")):
            refuses(rf"{name}: expected particles .*{door}", reader, name, error=FormatError)


@pytest.mark.parametrize("extension", [".igs.mha", ".mha", ".igs.nrrd", ".npz"])
def test_sweeps(extension):
    made = gb.ultrasound.phantoms.cylinders(n_frames=4, size=(9, 8), spacing=4.0)
    gb.ultrasound.write_sweep(f"a{extension}", made)
    for name in names_of(f"a{extension}"):
        assert kind_of(name).kind == "sweep"
        assert np.array_equal(gb.ultrasound.read_sweep(name).frames, made.frames)
        for reader in (gb.read, gb.volumes.read_volume):
            refuses(r"got a sweep .* with globule.ultrasound.read_sweep", reader, name, error=FormatError)


def test_folders():
    made = gb.ultrasound.phantoms.cylinders(n_frames=3, size=(9, 8), spacing=4.0)
    gb.ultrasound.write_sweep("frames", made)
    assert kind_of("frames") == Kind("sweep", "pictures")
    assert len(gb.ultrasound.read_sweep("frames")) == 3


def test_content_without_an_ending():
    for content, kind in (
        (OBJ, ("mesh", "obj")),
        ("# made by hand\n" + OBJ, ("mesh", "obj")),
        (STL, ("mesh", "stl")),
        (bytes(80) + (1).to_bytes(4, "little") + bytes(50), ("mesh", "stl")),
        (b"solid but binary".ljust(80) + (2).to_bytes(4, "little") + bytes(100), ("mesh", "stl")),
        (b"glTF\x02\0\0\0", ("mesh", "glb")),
        ("1\n0 0 0 1 1 1 0 0 0\n", ("particles", "text")),
        ("1\nwater\nO 0 0 0\n", ("particles", "xyz")),
        ("# x y z h\n1 2 3 4\n", ("particles", "csv")),
        ("# made by hand\nO 0 0 0\n", ("particles", "xyz")),
        ("# made by hand\n1\n0 0 0 1 1 1 0 0 0\n", ("particles", "text")),
        ("x,y,z\n1,2,3\n", ("particles", "csv")),
        ("1e3,-2,nan\n", ("particles", "csv")),
        ("title = 'dam'\n[domain]\nlo = [0, 0, 0]\n", ("scene", "toml")),
        ("[[fluids]]\nname = 'water'\n", ("scene", "toml")),
        (b"\x76\x2f\x31\x01" + bytes(9), ("picture", "exr")),
        (b"#?RADIANCE\n", ("picture", "hdr")),
        (b"\0\0\0\x20ftypisom", ("picture", "video")),
        (bytes(128) + b"DICM", ("sweep", "dicom")),
        (b"MM\0*", ("picture", "tiff")),
    ):
        Path("file").write_bytes(content if isinstance(content, bytes) else content.encode())
        assert kind_of("file") == kind


@pytest.mark.parametrize("form", ["PNG", "JPEG", "TIFF", "BMP", "GIF"])
def test_pictures(form):
    Image.new("RGB", (4, 3)).save("file", form)
    assert kind_of("file") == ("picture", form.lower())
    refuses(r"got a picture .*globule.Environment", gb.read, "file", error=FormatError)


def test_endings_break_ties_only():
    """Nine columns after a count are text, or an .xyz with such a title; what nobody knows is the ending's."""
    Path("a.xyz").write_text("1\n1 2 3 4 5 6 7 8 9\n0 0 0\n", encoding="utf-8")
    assert kind_of("a.xyz").format == "xyz"
    shutil.copy("a.xyz", "a")
    assert kind_of("a").format == "text"
    for name in ("a.npz", "a.mha", "a.ply", "a.vtu"):
        Path(name).write_bytes(b"PK\3\4 cut off")
        assert kind_of(name).format in ("npz", "metaimage", "ply", "vtu")
    assert kind_of("a.npz", "volume") == ("volume", "npz")
    assert kind_of("a.npz").kind == "particles"


@pytest.mark.parametrize("content", [b"", b"\0\1\2\3" * 99, b"dear reader,\nnumbers: none\n", b"<html>"])
def test_what_nobody_knows(content):
    Path("letter").write_bytes(content)
    for reader in (gb.read, gb.volumes.read_volume, gb.ultrasound.read_sweep):
        refuses(r"letter: expected .*, got data of no known format", reader, "letter", error=FormatError)
        with pytest.raises(FileNotFoundError):
            reader("nowhere.npz")


def test_meshes_by_content():
    pytest.importorskip("trimesh")
    Path("a.ply").write_text(OBJ, encoding="utf-8")
    assert len(gb.read("a.ply")) == 3
    assert len(gb.sample_mesh("a.ply", spacing=0.5)) > 3
