"""Every particle format reads back what it wrote, whole or not at all."""

import gc
import os
import zipfile
from pathlib import Path

import globule as gb
import numpy as np
import pytest
from format_helpers import FULL, assert_same, sample
from globule import formats
from globule._base import files
from globule._base.files import atomic_write
from globule.data.particles import Particles
from globule.formats import FormatError
from interrupts import count, interrupted, lines

SLOW = pytest.mark.slow
PACKAGES = {".parquet": "pyarrow", ".arrow": "pyarrow", ".usda": "pxr.Usd", ".usdc": "pxr.Usd"}
STRETCH = np.random.default_rng(3).normal(size=(5, 3, 3)).astype(np.float32)
STRETCH = STRETCH @ STRETCH.transpose(0, 2, 1) + np.eye(3, dtype=np.float32)
ROUND_TRIPS = {
    "all fields": sample(),
    "positions alone": Particles([[0.1, 2, np.nan], [1e-20, 5, 6], [7, 8, 9]]),
    "stretched kernels": Particles(STRETCH[:, 0], anisotropy=STRETCH),
    "one particle": sample()[:1],
    "none": Particles(np.empty((0, 3))),
    "none with attributes": sample()[:0],
}


@pytest.mark.parametrize(
    "extension", [*FULL, ".parquet", ".usdc", *(pytest.param(e, marks=SLOW) for e in (".arrow", ".usda"))]
)
def test_round_trip(extension, tmp_path):
    pytest.importorskip(PACKAGES.get(extension, "numpy"))
    for name, particles in ROUND_TRIPS.items():
        path = tmp_path / f"P{extension.upper()}"
        formats.write(path, particles)
        read = formats.read(path)
        assert len(read) == len(particles), name
        if len(particles):
            assert_same(read, particles)
            stretch = particles.anisotropy
            assert stretch is None or np.array_equal(read.anisotropy, stretch), name
        assert [file.name for file in tmp_path.iterdir()] == [path.name]


def test_matrices_that_stretch_nothing_are_refused(tmp_path):
    np.savez(tmp_path / "p.npz", positions=np.eye(3), anisotropy=-np.ones((3, 3, 3)))
    with pytest.raises(FormatError, match=r"p\.npz: anisotropy: expected symmetric positive"):
        formats.read(tmp_path / "p.npz")
    np.savez(tmp_path / "p.npz", positions=np.eye(3), anisotropy=np.ones(3))
    assert formats.read(tmp_path / "p.npz").attributes.keys() == {"anisotropy_attribute"}


@pytest.mark.parametrize("extension", FULL)
def test_scalar_fields_survive(extension, tmp_path):
    particles = Particles(np.eye(3), support=0.5, weight=-2, color=(0.2, 0.4, 1), rigidity=0.25)
    path = tmp_path / f"p{extension}"
    formats.write(path, particles)
    read = formats.read(path)
    assert np.all(np.asarray(read.support) == 0.5)
    assert np.all(np.asarray(read.weight) == -2)
    assert np.array_equal(np.broadcast_to(read.color, (3, 3))[2], np.float32([0.2, 0.4, 1]))
    assert read.reflection is None
    assert isinstance(read.support, float) == (extension == ".npz")


@pytest.mark.parametrize("extension", [".vtk", ".vtp", ".vtu", ".npz"])
def test_dtypes_survive(extension, tmp_path):
    dtypes = ("i1", "u1", "i2", "u2", "i4", "u4", "i8", "u8", "f4", "f8")
    arrays = {f"a b%/&<\"'é {d}": np.arange(6, dtype=d).reshape(3, 2) for d in dtypes}
    path = tmp_path / f"p{extension}"
    formats.write(path, Particles(np.eye(3), attributes=arrays))
    read = formats.read(path).attributes
    for name, array in arrays.items():
        assert read[name].dtype == array.dtype
        assert np.array_equal(read[name], array)


@pytest.mark.parametrize("extension", formats.EXTENSIONS)
def test_missing_file_and_folder(extension, tmp_path):
    with pytest.raises(FileNotFoundError):
        formats.read(tmp_path / f"p{extension}")
    with pytest.raises(FileNotFoundError, match=f"none/p{extension}"):
        formats.write(tmp_path / "none" / f"p{extension}", Particles(np.eye(3)))


def test_a_failed_write_leaves_the_old_file(tmp_path):
    path = tmp_path / "p.ply"
    path.write_text("old")
    ids = np.array([0, 2**40, 1])
    with pytest.raises(ValueError, match="32-bit"):
        formats.write(path, Particles(np.eye(3), attributes={"id": ids}))
    with pytest.raises(ValueError, match="int32"):
        formats.write(tmp_path / "p.bgeo", Particles(np.eye(3), attributes={"id": ids}))

    def interrupted():
        with atomic_write(path) as file:
            file.write(b"half")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert path.read_text() == "old"
    assert [file.name for file in tmp_path.iterdir()] == ["p.ply"]


@pytest.mark.parametrize("place", ["write", "close"])
@pytest.mark.parametrize("what", ["particles", "volume", "checkpoint", "frame"])
def test_ctrl_c_in_an_archive_stays_ctrl_c(tmp_path, monkeypatch, place, what):
    """zipfile's end complained of the half member: a ValueError took the place of Ctrl-C."""
    volume = gb.volumes.Volume(np.ones((2, 2, 2)), np.eye(4))
    frame = gb.render(sample(), gb.Camera((0, 0, 4), (0, 0, 0)), (8, 6))
    sim = gb.Simulation("dam-break", spacing=0.2, device="cpu")
    writes = {
        "particles": lambda: gb.write(tmp_path / "a.npz", sample()),
        "volume": lambda: gb.volumes.write_volume(tmp_path / "a.npz", volume),
        "checkpoint": lambda: sim.save(tmp_path / "a.npz"),
        "frame": lambda: frame.save(tmp_path / "a.npz"),
    }  # fmt: skip
    writes[what]()
    before = (tmp_path / "a.npz").read_bytes()

    def interrupted(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(zipfile._ZipWriteFile, place, interrupted)
    with pytest.raises(KeyboardInterrupt):
        writes[what]()
    monkeypatch.undo()
    gc.collect()
    assert [file.name for file in tmp_path.iterdir()] == ["a.npz"]
    assert (tmp_path / "a.npz").read_bytes() == before


def test_a_replaced_file_keeps_its_permissions(tmp_path):
    for mode in (0o600, 0o640, 0o755):
        path = tmp_path / f"{mode:o}.ply"
        path.write_text("secret")
        path.chmod(mode)
        formats.write(path, sample())
        assert path.stat().st_mode & 0o777 == mode


def test_an_interrupt_at_any_moment_leaves_no_temporary_file(tmp_path, monkeypatch):
    """Also when the file has just been opened: then it is there, but nobody has it yet."""

    def write():
        with atomic_write(tmp_path / "p.bin") as file:
            file.write(b"x" * 3000)

    for stop in range(1, count(write, lines) + 1):
        assert interrupted(write, lines, stop)
        assert {file.name for file in tmp_path.iterdir()} <= {"p.bin"}

    def interrupted_after(work):
        def call(*args, **options):
            work(*args, **options)
            raise KeyboardInterrupt

        return call

    for module, name in ((files, "open"), (os, "urandom"), (os, "replace"), (os.path, "realpath")):
        with monkeypatch.context() as change:
            work = interrupted_after(getattr(module, name, open))
            change.setattr(module, name, work, raising=False)
            with pytest.raises(KeyboardInterrupt):
                write()
        assert {file.name for file in tmp_path.iterdir()} <= {"p.bin"}


@pytest.mark.parametrize("name", ["\x1b[2J", "a\0b", "\ud800"])
@pytest.mark.parametrize("extension", [".vtp", ".csv", ".npz"])
def test_names_that_no_file_can_hold(name, extension, tmp_path):
    """A .vtp with them could not be read, an .npz lost the array."""
    with pytest.raises(ValueError, match=r"attributes\['.*'\]: expected a name without control characters"):
        formats.write(tmp_path / f"p{extension}", Particles(np.eye(3), attributes={name: np.ones(3)}))
    assert not os.listdir(tmp_path)


@pytest.mark.parametrize("name", ["a;b", "a|b", "a\tb", "a,b", 'a"b', "v (m; s)"])
def test_names_with_separators(name, tmp_path):
    formats.write(tmp_path / "p.csv", Particles(np.eye(3), attributes={name: np.arange(3)}))
    assert {*formats.read(tmp_path / "p.csv").attributes} == {name.replace(" (m; s)", "")}


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="no device without space")
@pytest.mark.parametrize("extension", [".npy", ".npz", ".csv", ".ply", ".vtp", ".bgeo.gz"])
def test_a_full_disk_is_said_with_the_file(extension, tmp_path):
    path = tmp_path / f"p{extension}"
    path.symlink_to("/dev/full")
    with pytest.raises(OSError, match=f"No space left on device: '.*/p{extension}'"):
        formats.write(path, Particles(np.eye(3)))


def test_a_file_that_is_read_only_is_not_replaced(tmp_path, monkeypatch):
    path = tmp_path / "p.csv"
    path.write_text("old")
    path.chmod(0o400)
    may = os.access  # of root, anything
    monkeypatch.setattr(os, "access", lambda name, how: may(name, how) and not how & os.W_OK)
    with pytest.raises(PermissionError, match=r"Permission denied: '.*/p\.csv'"):
        formats.write(path, Particles(np.eye(3)))
    assert path.read_text() == "old"
    assert os.listdir(tmp_path) == ["p.csv"]


def test_atomic_write_follows_links(tmp_path):
    (tmp_path / "real.txt").write_text("old")
    (tmp_path / "link.txt").symlink_to("real.txt")
    with atomic_write(tmp_path / "link.txt", "w") as file:
        file.write("new")
    assert (tmp_path / "real.txt").read_text() == "new"
    assert (tmp_path / "link.txt").is_symlink()
    with atomic_write("/dev/null") as file:
        file.write(b"gone")
    assert Path("/dev/null").is_char_device()


def test_names_that_a_format_cannot_hold(tmp_path):
    for name in ("x", "red"):
        p = Particles(np.eye(3), color=(1, 0, 0), attributes={name: np.zeros(3)})
        with pytest.raises(ValueError, match="a name of its own"):
            formats.write(tmp_path / "p.csv", p)
    blank = Particles(np.eye(3), attributes={"two words": np.zeros(3)})
    for extension in (".ply", ".xyz"):
        with pytest.raises(ValueError, match="blanks"):
            formats.write(tmp_path / f"p{extension}", blank)
    assert not list(tmp_path.iterdir())
