"""What is written is read again, whatever its shape, type and place; transforms compose."""

import string
import tempfile
from pathlib import Path

import globule as gb
import numpy as np
import pytest
from format_helpers import FULL, assert_same
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
from scipy.spatial.transform import Rotation
from sweep_helpers import same

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


# DICOM holds whole numbers and upright voxels only: test_dicom_write.py.
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
            with pytest.raises(ValueError, match="uint8 or uint16"):
                gb.ultrasound.write_sweep(path, made)
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
