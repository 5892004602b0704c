"""Every particle format reads back what it wrote, whole or not at all."""

from __future__ import annotations

import signal
from pathlib import Path

import numpy as np
import pytest
from format_helpers import FULL, assert_same, sample
from globule import formats
from globule._base.files import atomic_write
from globule.formats import FormatError
from globule.scene.particles import Particles


@pytest.mark.parametrize("extension", FULL)
def test_round_trip(extension, tmp_path):
    path = tmp_path / f"p{extension}"
    formats.write(path, sample())
    assert_same(formats.read(path), sample())
    assert [file.name for file in tmp_path.iterdir()] == [path.name]


@pytest.mark.parametrize("extension", FULL)
def test_round_trip_of_stretched_kernels(extension, tmp_path):
    rng = np.random.default_rng(3)
    root = rng.normal(size=(5, 3, 3)).astype(np.float32)
    matrices = root @ root.transpose(0, 2, 1) + np.eye(3, dtype=np.float32)
    path = tmp_path / f"p{extension}"
    formats.write(path, Particles(rng.random((5, 3)), anisotropy=matrices))
    read = formats.read(path)
    assert np.array_equal(read.anisotropy, matrices)
    assert not read.attributes


def test_matrices_that_stretch_nothing_are_refused(tmp_path):
    np.savez(tmp_path / "p.npz", positions=np.eye(3), anisotropy=-np.ones((3, 3, 3)))
    with pytest.raises(FormatError, match=r"p\.npz: anisotropy: expected symmetric positive"):
        formats.read(tmp_path / "p.npz")
    np.savez(tmp_path / "p.npz", positions=np.eye(3), anisotropy=np.ones(3))
    assert formats.read(tmp_path / "p.npz").attributes.keys() == {"anisotropy_attribute"}


@pytest.mark.parametrize("extension", FULL)
def test_round_trip_of_positions_alone(extension, tmp_path):
    path = tmp_path / f"p{extension.upper()}"
    formats.write(path, Particles([[0.1, 2, np.nan], [1e-20, 5, 6], [7, 8, 9]]))
    assert_same(formats.read(path), Particles([[0.1, 2, np.nan], [1e-20, 5, 6], [7, 8, 9]]))


@pytest.mark.parametrize("extension", formats.EXTENSIONS)
def test_no_particles(extension, tmp_path):
    path = tmp_path / f"p{extension}"
    formats.write(path, Particles(np.empty((0, 3))))
    assert len(formats.read(path)) == 0


@pytest.mark.parametrize("extension", [e for e in FULL if e not in (".xyz", ".csv")])
def test_no_particles_with_attributes(extension, tmp_path):
    empty = sample()[:0]
    formats.write(tmp_path / f"p{extension}", empty)
    assert len(formats.read(tmp_path / f"p{extension}")) == 0


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
@pytest.mark.parametrize("dtype", ["i1", "u1", "i2", "u2", "i4", "u4", "i8", "u8", "f4", "f8"])
def test_dtypes_survive(extension, dtype, tmp_path):
    array = np.arange(6, dtype=dtype).reshape(3, 2)
    path = tmp_path / f"p{extension}"
    formats.write(path, Particles(np.eye(3), attributes={"a b%/&<\"'é": array}))
    read = formats.read(path).attributes["a b%/&<\"'é"]
    assert read.dtype == array.dtype
    assert np.array_equal(read, array)


def test_npy_holds_positions(tmp_path):
    formats.write(tmp_path / "p.npy", sample())
    assert_same(formats.read(tmp_path / "p.npy"), Particles(sample().positions))


def test_unknown_extension(tmp_path):
    (tmp_path / "p.xls").write_bytes(b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1")
    with pytest.raises(FormatError, match=r"p\.xls: expected particles, .* no known format"):
        formats.read(tmp_path / "p.xls")
    with pytest.raises(FormatError, match="extensions"):
        formats.write(tmp_path / "p.xls", sample())


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


@pytest.mark.skipif(not hasattr(signal, "setitimer"), reason="needs signal.setitimer")
def test_an_interrupt_at_any_moment_leaves_no_temporary_file(tmp_path):
    """Also while the file is being opened: then it is there, but nobody has it yet."""
    old = signal.signal(signal.SIGALRM, signal.default_int_handler)
    try:
        for i in range(300):
            try:
                signal.setitimer(signal.ITIMER_REAL, 1e-5 + 1e-6 * i)
                for _ in range(1000):
                    with atomic_write(tmp_path / "p.bin") as file:
                        file.write(b"x" * 3000)
            except KeyboardInterrupt:
                pass
            finally:
                signal.setitimer(signal.ITIMER_REAL, 0)
    finally:
        signal.signal(signal.SIGALRM, old)
    assert {file.name for file in tmp_path.iterdir()} <= {"p.bin"}


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
