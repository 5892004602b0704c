"""What is written is read again, whole or not at all, whatever its shape, type and place; transforms compose."""

import gc
import os
import string
import tempfile
import zipfile
from pathlib import Path

import globule as gb
import numpy as np
import pytest
from cli_helpers import refuses
from format_helpers import FULL, assert_same, sample
from globule import formats
from globule._base import files
from globule._base.files import atomic_write
from globule.data.particles import Particles
from globule.formats import FormatError
from globule.formats.sweeps.poses import PoseTable, interpolate, read_poses, write_csv
from globule.formats.sweeps.transforms import (
    Transform,
    chain,
    find_path,
    format_matrix,
    inverse,
    parse_matrix,
    split_name,
)
from globule.formats.volumes import HOLD_MAPS, WRITABLE
from globule.volumes.volume import Volume
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from interrupts import count, interrupted, lines
from scipy.spatial.transform import Rotation
from sweep_helpers import same

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
    refuses("32-bit", formats.write, path, Particles(np.eye(3), attributes={"id": ids}))
    refuses("int32", formats.write, tmp_path / "p.bgeo", Particles(np.eye(3), attributes={"id": ids}))

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
        refuses("a name of its own", formats.write, tmp_path / "p.csv", p)
    blank = Particles(np.eye(3), attributes={"two words": np.zeros(3)})
    for extension in (".ply", ".xyz"):
        refuses("blanks", formats.write, tmp_path / f"p{extension}", blank)
    assert not list(tmp_path.iterdir())


# Anything that hypothesis makes

QUICK = settings(max_examples=15, deadline=None)
FLOATS = st.floats(-1e6, 1e6, width=32)
FACTORS = st.floats(0, 1, width=32)
PREFIX = "a_"  # so that no name means a field: "h", "radius" …
NAMES = st.text(string.ascii_lowercase, min_size=1, max_size=6).map(PREFIX.__add__)


@st.composite
def particles(draw: st.DrawFn) -> gb.Particles:
    n = draw(st.integers(1, 9))

    def array(elements: st.SearchStrategy, *shape: int, dtype: str = "f4") -> np.ndarray:
        return draw(hnp.arrays(dtype, shape, elements=elements))

    attributes = {}
    for name in draw(st.lists(NAMES, max_size=3, unique=True)):
        dtype = draw(st.sampled_from(["u1", "i2", "i4", "f4"]))
        elements = FLOATS if dtype == "f4" else hnp.from_dtype(np.dtype(dtype))
        shape = draw(st.sampled_from([(n,), (n, 2), (n, 3)]))
        attributes[name] = array(elements, *shape, dtype=dtype)
    given_fields = {
        "support": array(st.floats(0.125, 1024, width=32), n),
        "weight": array(FLOATS, n),
        "color": array(FACTORS, n, 3),
        "reflection": array(FACTORS, n),
    }
    kept = {name: value for name, value in given_fields.items() if draw(st.booleans())}
    return gb.Particles(array(FLOATS, n, 3), **kept, attributes=attributes)


@pytest.mark.parametrize("extension", FULL)
@given(made=particles())
@QUICK
def test_particles(extension, made):
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, f"a{extension}")
        gb.write(path, made)
        assert_same(gb.read(path), made)


@given(
    positions=hnp.arrays("f4", st.tuples(st.integers(0, 9), st.just(3)), elements=FLOATS),
    color=st.tuples(FACTORS, FACTORS, FACTORS),
)
@QUICK
def test_text_and_npy(positions, color):
    colors = np.tile(np.float32(color), (len(positions), 1))
    made = gb.Particles(positions, color=colors)
    with tempfile.TemporaryDirectory() as folder:
        for name in ("a.txt", "a.npy"):
            gb.write(Path(folder, name), made)
        text, plain = (gb.read(Path(folder, name)) for name in ("a.txt", "a.npy"))
    assert np.array_equal(text.positions, positions)
    assert np.array_equal(text.color, colors)
    assert np.array_equal(plain.positions, positions)


ANGLES = hnp.arrays("f8", 4, elements=st.floats(-1, 1)).filter(lambda q: np.linalg.norm(q) > 0.1)
LENGTHS = st.floats(1e-3, 1e3)
PLACES = hnp.arrays("f8", 3, elements=st.floats(-1e4, 1e4))


@st.composite
def rigid(draw: st.DrawFn) -> np.ndarray:
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = Rotation.from_quat(draw(ANGLES)).as_matrix(), draw(PLACES)
    return matrix


@st.composite
def volumes(draw: st.DrawFn) -> Volume:
    shape = draw(st.tuples(*[st.integers(1, 6)] * 3))
    dtype = draw(st.sampled_from(["u1", "u2", "f4"]))
    elements = FLOATS if dtype == "f4" else hnp.from_dtype(np.dtype(dtype))
    values = draw(hnp.arrays(dtype, shape, elements=elements))
    radius = draw(hnp.arrays("u1", shape, elements=st.sampled_from([0, 3, 255])))
    place = draw(rigid())
    place[:3, :3] *= draw(st.tuples(LENGTHS, LENGTHS, LENGTHS))
    values = np.where(radius == 255, 0, values).astype(dtype)
    return Volume(values, place, radius, draw(st.sampled_from(["LPS", "RAS"])))


EXACT = (".nrrd", ".npz", ".sparse.npz")  # the others hold spacing and directions


# DICOM holds whole numbers and upright voxels only: test_dicom.py.
@pytest.mark.parametrize("extension", [e for e in WRITABLE if e != ".dcm"])
@given(made=volumes(), space=st.sampled_from(["LPS", "RAS"]))
@QUICK
def test_volumes(extension, made, space):
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, f"a{extension}")
        made.save(path)
        found = gb.volumes.read_volume(path, space)
    assert found.space == space
    assert found.values.dtype == made.values.dtype
    assert np.array_equal(found.values, made.values)
    expected = made.in_space(space).world_from_voxel
    tolerance = 1e-6 if ".nii" in extension else 0 if extension in EXACT else 1e-14
    largest = np.abs(expected).max(axis=1, keepdims=True)
    assert (np.abs(found.world_from_voxel - expected) <= tolerance * largest).all()
    if extension in HOLD_MAPS:
        assert np.array_equal(found.radius, made.radius)
    else:
        background = made.values == 0 if made.values.min() >= 0 else np.False_
        assert np.array_equal(found.empty, np.broadcast_to(background, made.shape))


@st.composite
def sweeps(draw: st.DrawFn) -> gb.ultrasound.Sweep:
    shape = draw(st.tuples(st.integers(1, 4), st.integers(2, 6), st.integers(2, 6)))
    dtype = draw(st.sampled_from(["u1", "u2", "f4"]))
    elements = FLOATS if dtype == "f4" else hnp.from_dtype(np.dtype(dtype))
    frames = draw(hnp.arrays(dtype, shape, elements=elements))
    poses = np.stack([draw(rigid()) for _ in frames])
    poses[:, :3, :2] *= draw(st.floats(0.01, 0.9))  # mm per pixel, as a scanner has
    valid = draw(hnp.arrays(bool, len(frames)).filter(np.any))
    times = np.cumsum(draw(hnp.arrays("f8", len(frames), elements=LENGTHS)))
    mask = draw(st.none() | hnp.arrays(bool, shape[1:]).filter(lambda m: m.any() and not m.all()))
    return gb.ultrasound.Sweep(frames, poses, times if draw(st.booleans()) else None, valid, mask)


@pytest.mark.parametrize("name", ["a.igs.mha", "a.igs.nrrd", "a.mha", "a.nrrd", "a.npz", "folder"])
@given(made=sweeps())
@QUICK
def test_sweeps(name, made):
    if name not in ("a.npz", "folder"):  # the others hold no mask
        made.mask = None
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, name)
        if name == "folder" and made.frames.dtype == np.float32:
            refuses("uint8 or uint16", gb.ultrasound.write_sweep, path, made)
            return
        gb.ultrasound.write_sweep(path, made)
        assert same(made, gb.ultrasound.read_sweep(path))


@given(matrices=st.lists(rigid(), min_size=1, max_size=5), flips=st.lists(st.booleans(), min_size=5, max_size=5))
@QUICK
def test_chains(matrices, flips):
    """Along a row of frames, whichever way round the file has each transform."""
    frames = ["Image", *string.ascii_uppercase[: len(matrices)]]
    edges, product = {}, np.eye(4)
    for a, b, matrix, flip in zip(frames, frames[1:], matrices, flips, strict=False):
        back = np.linalg.inv(matrix)
        name, held = ((b, a), back) if flip else ((a, b), matrix)
        edges[name] = Transform(np.stack([held, held]), np.array([True, False]))
        product = matrix @ product
    way = find_path(edges, "Image", frames[-1])
    assert len(way) == len(matrices)
    placed = chain(edges, way, 2)
    assert placed.ok.tolist() == [True, False]
    size = 1 + np.abs(product).max()
    assert np.abs(placed.matrices[0] - product).max() < 1e-9 * size
    back = chain(edges, find_path(edges, frames[-1], "Image"), 2)
    assert np.abs(back.matrices[0] @ placed.matrices[0] - np.eye(4)).max() < 1e-8 * size
    assert find_path(edges, "Image", "Nowhere") is None


@given(hnp.arrays("f8", (4, 4), elements=st.floats(allow_nan=False)))
@QUICK
def test_matrices_as_text(matrix):
    assert np.array_equal(parse_matrix(format_matrix(matrix)), matrix)


@given(st.lists(rigid(), min_size=1, max_size=4), st.integers(0, 3))
@QUICK
def test_inverse(matrices, hole):
    stack = np.stack(matrices)
    stack[hole % len(stack)] = 0
    found = inverse(stack)
    singular = np.arange(len(stack)) == hole % len(stack)
    assert np.isnan(found[singular]).all()
    products = found[~singular] @ stack[~singular]
    assert np.allclose(products, np.eye(4), atol=1e-9)


@given(NAMES, NAMES)
@QUICK
def test_names_of_transforms(source, target):
    source, target = (name.removeprefix(PREFIX).capitalize() for name in (source, target))
    found = split_name(f"{source}To{target}")
    assert found is not None
    assert f"{found[0]}To{found[1]}" == f"{source}To{target}"


@given(
    poses=st.lists(rigid(), min_size=2, max_size=6),
    steps=hnp.arrays("f8", 6, elements=st.floats(0.5, 1.5)),
    share=st.floats(0, 1),
    lost=st.integers(0, 9),
)
@QUICK
def test_pose_tables(poses, steps, share, lost):
    n = len(poses)
    times, ok = np.cumsum(steps[:n]), np.arange(n) != lost
    table = PoseTable(times, np.stack(poses), ok)
    with tempfile.TemporaryDirectory() as folder:
        write_csv(Path(folder, "poses.csv"), table)
        found = read_poses(Path(folder, "poses.csv"))
    assert np.array_equal(found.times, times)
    assert np.array_equal(found.ok, ok)
    assert np.array_equal(found.matrices[ok], table.matrices[ok])
    if not ok.all():
        return
    at, known = interpolate(table, times)
    assert known.all()
    assert np.allclose(at, table.matrices, atol=1e-9)
    (between,), _ = interpolate(table, np.array([times[0] + share * (times[1] - times[0])]))
    assert np.allclose(between[:3, :3] @ between[:3, :3].T, np.eye(3), atol=1e-9)
    expected = (1 - share) * poses[0][:3, 3] + share * poses[1][:3, 3]
    assert np.allclose(between[:3, 3], expected, atol=1e-6)
