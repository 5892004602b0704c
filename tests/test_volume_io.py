"""Volume files, slices and three-view pictures."""

import os
import re
from pathlib import Path

import globule as gb
import numpy as np
import pytest
from format_helpers import structured_points
from globule.formats.errors import FormatError
from globule.formats.volumes import WRITABLE, map_path, metaimage, nrrd
from globule.volumes.files import read_volume, write_volume
from globule.volumes.slices import render_three_view, reslice, reslice_frame, save_three_view
from globule.volumes.volume import EMPTY, FILLED, MEASURED, Volume
from PIL import Image
from sweep_helpers import random_poses

pytestmark = pytest.mark.usefixtures("folder")
FORMATS = sorted(set(WRITABLE) - {".dcm"})  # which has tests of its own
ODD = np.array([-74.52170039, 165.57342384663468, 1 / 3])  # an origin that needs all its digits


def volume(dtype="uint8", turned: bool = False, space: str = "LPS") -> Volume:
    """17x19x23 voxels of 0.1, 0.3 and 1/7 mm: a measured corner, a filled one, emptiness."""
    rng, values = np.random.default_rng(2), np.zeros((17, 19, 23), dtype)
    radius = np.full(values.shape, 255, np.uint8)
    values[:9, :5, :12] = 1 + rng.random((9, 5, 12)) * 200
    radius[:9, :5, :12] = 0
    radius[6:9, :5, :12] = 3
    matrix = np.diag([0.1, 0.3, 1 / 7, 1.0])
    if turned:
        matrix = random_poses(1, 9)[0] @ matrix
    matrix[:3, 3] = ODD
    maps = {
        "count": (radius == 0).astype(np.uint32) * 3,
        "variance": (values * np.float32(0.3)).astype(np.float32),
        "source": np.where(radius == 0, 4, -1).astype(np.int32),
    }
    return Volume(values, matrix, radius, space, {}, maps.__getitem__)


@pytest.mark.parametrize("extension", FORMATS)
def test_maps(extension):
    before = volume()
    write_volume("a" + extension, before, maps=True)
    for name in ("count", "variance", "source", "radius"):
        expected = getattr(before, name)
        if extension in (".vti", ".npz", ".sparse.npz"):
            found = getattr(read_volume("a" + extension), name)
            assert (found.dtype, read_volume("a" + extension).info["origin"]) == (expected.dtype, "stored")
        else:
            assert read_volume("a" + extension).info["origin"] == "assumed"
            found = read_volume(map_path("a" + extension, name)).values
        assert np.array_equal(found, expected), name


@pytest.mark.parametrize("binary", [True, False])
def test_structured_points_of_legacy_vtk(binary):
    Path("a.vtk").write_bytes(structured_points(binary))
    found = read_volume("a.vtk")
    assert np.array_equal(found.values, np.arange(24).reshape(2, 3, 4))
    expected = np.diag([0.5, 1, 2, 1])
    expected[:3, 3] = 10, -20, 30.25
    assert np.array_equal(found.world_from_voxel, expected)
    with pytest.raises(FormatError, match=r"got a volume .*read_volume"):
        gb.read("a.vtk")
    content = structured_points(binary)
    for old, new, said in (
        (b"DIMENSIONS 4 3 2", b"DIMENSIONS 4 3", "expected a count after 'DIMENSIONS'"),
        (b"DIMENSIONS 4 3 2", b"DIMENSIONS 99999999 99999999 9", "expected POINT_DATA 8999"),
        (b"SPACING 0.5", b"SPACING nan", "three numbers after 'SPACING'"),
        (b"SPACING 0.5 1 2", b"SPACING 0.5 0 2", "expected"),
        (b"SCALARS eta short 1", b"SCALARS eta short 2", "expected|after this line"),
        (b"DIMENSIONS 4 3 2\n", b"", "expected POINT_DATA 0, got 24"),
    ):
        Path("b.vtk").write_bytes(content.replace(old, new))
        with pytest.raises(FormatError, match=said):
            read_volume("b.vtk")


def test_a_volume_without_maps_and_a_sparse_one():
    write_volume("a.npz", Volume(np.ones((2, 3, 4), np.uint8), np.eye(4)), maps=True)
    with pytest.raises(ValueError, match=r"a\.npz"):
        _ = read_volume("a.npz").count
    values = np.zeros((128, 128, 128), np.uint8)
    radius = np.full(values.shape, 255, np.uint8)
    values[60:68, 60:68] = 7
    radius[60:68, 60:68] = 0
    write_volume("a.sparse.npz", Volume(values, np.eye(4), radius))
    assert Path("a.sparse.npz").stat().st_size < 0.03 * 2 * values.size
    assert np.array_equal(read_volume("a.sparse.npz").radius, radius)


@pytest.mark.parametrize("extension", [".mha", ".nrrd", ".nii", ".nii.gz"])
@pytest.mark.interop
def test_itk_sees_the_same_place(extension):
    sitk = pytest.importorskip("SimpleITK", reason="compares with SimpleITK")
    before = volume(turned=True)
    write_volume("a" + extension, before)
    image = sitk.ReadImage("a" + extension)
    assert np.array_equal(sitk.GetArrayFromImage(image), before.values)
    for index in ((0, 0, 0), (22, 0, 0), (3, 18, 16)):
        here = before.world_from_voxel @ [*index, 1]  # LPS, as ITK's
        there = image.TransformIndexToPhysicalPoint(index)
        assert there == pytest.approx(here[:3], abs=1e-4 if "nii" in extension else 1e-9)


def test_other_numbers_become_ours():
    for values, expected in [
        (np.array([[[0, 300]]], np.int16), np.uint16), (np.array([[[-1, 300]]], np.int16), np.float32),
        (np.array([[[True, False]]]), np.uint8), (np.array([[[0.5, np.nan]]]), np.float32),
    ]:  # fmt: skip
        np.savez("a.npz", values=values, world_from_voxel=np.eye(4))
        found = read_volume("a.npz")
        assert found.values.dtype == expected
        assert np.isfinite(found.values).all()
    assert found.empty.tolist() == [[[False, True]]]


def refused(path) -> str:
    with pytest.raises(ValueError, match=f"^{re.escape(str(path))}.*expected") as caught:
        read_volume(path)
    text = str(caught.value)
    assert "\n" not in text
    return text


@pytest.mark.parametrize("extension", FORMATS)
def test_truncated_files(extension):
    write_volume("a" + extension, volume())
    whole = Path("a" + extension).read_bytes()
    sizes = {*np.linspace(0, len(whole) - 1, 20).astype(int).tolist(), *range(0, 400, 29)}
    if extension == ".vti":
        sizes -= set(range(len(whole) - 64, len(whole)))  # the closing tags hold nothing
    for size in sorted(sizes):
        Path("cut" + extension).write_bytes(whole[:size])
        refused("cut" + extension)


@pytest.mark.parametrize("packed", [False, True])
@pytest.mark.parametrize("extension", [".mha", ".nrrd"])
def test_bytes_after_the_data_are_refused(extension, packed):
    form = {".mha": metaimage, ".nrrd": nrrd}[extension]
    form.write("a" + extension, np.zeros((2, 3, 4), np.uint8), {}, packed)
    with open("a" + extension, "ab") as file:
        file.write(b"more")
    with pytest.raises(FormatError, match=r"data: expected .*, got (28|4 bytes more)$"):
        form.read("a" + extension)


def test_hostile_headers_names_and_writes_that_fail(monkeypatch):
    write_volume("a.mha", volume())
    whole = Path("a.mha").read_bytes()
    for old, new in [
        (b"DimSize = 23 19 17", b"DimSize = 100000 100000 100000"),
        (b"DimSize = 23 19 17", b"DimSize = 1500 1500 900"), (b"DimSize = 23 19 17", b"DimSize = 23 19 18"),
        (b"DimSize = 23 19 17", b"DimSize = -23 19 17"), (b"ElementSpacing = 0.1", b"ElementSpacing = nan"),
        (b"ElementSpacing = 0.1", b"ElementSpacing = 1e300"),
        (b"ElementSpacing = 0.1", b"ElementSpacing = 0"), (b"Offset = ", b"Offset = 1 "),
        (b"TransformMatrix = 1.0 0.0", b"TransformMatrix = 0.0 0.0"),
    ]:  # fmt: skip
        assert old in whole, old
        Path("bad.mha").write_bytes(whole.replace(old, new))
        refused("bad.mha")
    write_volume("a.nrrd", volume())
    whole = Path("a.nrrd").read_bytes()
    for old, new in [
        (b"sizes: 23 19 17", b"sizes: 23 19 99999999"), (b"encoding: gzip", b"encoding: bzip2"),
        (b"left-posterior-superior", b"somewhere"), (b"space directions: (", b"space directions: none ("),
        (b"type: uint8", b"type: block"),
    ]:  # fmt: skip
        assert old in whole, old
        Path("bad.nrrd").write_bytes(whole.replace(old, new))
        refused("bad.nrrd")
    sparse = {"values": np.zeros((1, 8, 8, 8)), "world_from_voxel": np.eye(4)}
    for arrays in (
        {}, {"values": np.zeros((2, 2, 2))}, {"values": np.zeros((2, 2)), "world_from_voxel": np.eye(4)},
        {"values": np.zeros((2, 2, 2)), "world_from_voxel": np.zeros((4, 4))},
        {"values": np.zeros((2, 2, 2)), "world_from_voxel": np.full((4, 4), np.nan)},
        {"values": np.zeros((2, 2, 2)), "world_from_voxel": np.eye(4), "space": np.array("X")},
        sparse | {"blocks": np.array([5]), "shape": np.array([8, 8, 8])},
        sparse | {"blocks": np.array([0]), "shape": np.array([2**40, 8, 8])},
    ):  # fmt: skip
        np.savez("bad.npz", **arrays)
        refused("bad.npz")
    with pytest.raises(ValueError, match="extensions"):
        write_volume("a.stl", volume())
    gb.write("particles.npz", gb.Particles(np.eye(3)))
    with pytest.raises(FormatError, match=r"particles \(npz\): read it with globule.read$"):
        read_volume("particles.npz")
    with pytest.raises(FileNotFoundError):
        read_volume("none.nrrd")
    with pytest.raises(TypeError):
        write_volume("a.nrrd", np.zeros((2, 2, 2)))
    write_volume("a.nrrd", volume())
    before = {path: path.read_bytes() for path in Path().iterdir()}
    monkeypatch.setattr("os.replace", lambda *_: (_ for _ in ()).throw(OSError("full")))
    with pytest.raises(OSError, match="full"):
        write_volume("a.nrrd", volume("uint16"))
    assert {path: path.read_bytes() for path in Path().iterdir()} == before


@pytest.mark.parametrize("stop", ["write", "place"])
def test_maps_appear_with_their_volume_or_not_at_all(monkeypatch, stop):
    """Interrupted while the third of five files is written; and when it gets its place, where it is
    too late for none."""
    calls, kept = {"n": 0}, {"write": metaimage.write, "place": os.replace}

    def third(*arguments, **options):
        calls["n"] += 1
        if calls["n"] == 3 and stop == "write":
            raise KeyboardInterrupt
        kept[stop](*arguments, **options)
        if calls["n"] == 3:
            raise KeyboardInterrupt

    name = {"write": "globule.formats.volumes.metaimage.write", "place": "os.replace"}[stop]
    monkeypatch.setattr(name, third)
    with pytest.raises(KeyboardInterrupt):
        write_volume("a.mha", volume(), maps=True)
    names = sorted(p.name for p in Path().iterdir())
    all_five = ["a.count.mha", "a.mha", "a.radius.mha", "a.source.mha", "a.variance.mha"]
    assert names == ([] if stop == "write" else all_five)


def test_a_linear_field_is_resliced_exactly_also_onto_the_frames():
    z, y, x = np.meshgrid(np.arange(20), np.arange(21), np.arange(22), indexing="ij")
    ramp = Volume((2 * x + 3 * y - z + 50).astype(np.float32), np.diag([0.5, 0.5, 0.5, 1]))
    plane = random_poses(1, 4, reach=0.5)[0] @ np.diag([0.1, 0.1, 0.1, 1.0])
    plane[:3, 3] += 5
    seen = reslice(ramp, plane, (25, 15))
    row, column = np.mgrid[:15, :25]
    at = 2 * (plane[:3, 0, None, None] * column + plane[:3, 1, None, None] * row
              + plane[:3, 3, None, None])  # fmt: skip
    assert ((at > 0) & (at < np.array([21, 20, 19])[:, None, None])).all(axis=0).all()
    assert (seen.origin == MEASURED).all()
    assert np.allclose(seen.values, 2 * at[0] + 3 * at[1] - at[2] + 50, atol=1e-4)
    values = np.zeros((5, 5, 5), np.float32)
    values[:, :, :3] = 10
    radius = np.where(values > 0, 0, 255).astype(np.uint8)
    radius[:, :, 2] = 4
    plane = np.diag([0.25, 0.25, 0.25, 1.0])
    plane[2, 3] = 2
    seen = reslice(Volume(values, np.eye(4), radius), plane, (18, 10))
    assert np.unique(seen.values).tolist() == [0, 10]
    assert seen.origin[4, [0, 8, 14]].tolist() == [MEASURED, FILLED, EMPTY]
    outside = plane.copy()
    outside[2, 3] = 100
    assert not reslice(Volume(values, np.eye(4), radius), outside, (4, 4)).origin.any()
    sweep = gb.ultrasound.phantoms.cylinders(n_frames=4, size=(20, 30), gaps=0.4, seed=3)
    box = Volume(np.full((40, 40, 40), 9, np.uint8), np.array(
        [[2, 0, 0, -40], [0, 2, 0, -40], [0, 0, 2, -40], [0, 0, 0, 1.0]]))  # fmt: skip
    seen = reslice_frame(box, sweep, 0)
    assert seen.values.shape == (30, 20)
    assert np.allclose(seen.values, 9)
    lost = int(np.argmin(sweep.valid))
    with pytest.raises(ValueError, match="valid frame"):
        reslice_frame(box, sweep, lost)


def test_three_view_and_the_axes_of_its_planes():
    shown = render_three_view(volume(), overlay=False)
    assert (shown.dtype, shown.ndim) == (np.uint8, 3)
    plain = Volume(np.full((10, 20, 30), 200, np.uint8), np.diag([1.0, 2, 3, 1]))
    picture = render_three_view(plain)
    assert picture.shape == (40, 30 + 30 + 40 + 16, 3)  # square pixels of 1 mm
    tinted = render_three_view(volume(), overlay=True)
    n_colors = [len(np.unique(picture.reshape(-1, 3), axis=0)) for picture in (shown, tinted)]
    assert n_colors[0] < n_colors[1]
    with pytest.raises(ValueError, match="center"):
        render_three_view(plain, center=(900, 0, 0))
    nothing = Volume(np.zeros((4, 4, 4), np.uint8), np.eye(4), np.full((4, 4, 4), 255, np.uint8))
    assert render_three_view(nothing).shape[2] == 3
    rng = np.random.default_rng(0)
    seen = Volume(rng.integers(1, 255, (60, 80, 200), np.uint8), np.diag([0.5, 0.5, 0.5, 1]))
    save_three_view("a.png", seen)
    sheet, margin = np.asarray(Image.open("a.png")), 18
    for i, picture in enumerate((render_three_view(seen), render_three_view(seen, overlay=True))):
        top = i * sheet.shape[0] // 2
        row = sheet[top : top + sheet.shape[0] // 2]
        assert np.array_equal(row[margin : margin + 80, margin : margin + 200], picture[:, :200])
        right, down = row[margin // 2, margin:], row[margin:, margin // 2]
        for line in (right, down):
            assert (line[:40] < 255).all()
            assert (line[41:43] == 255).all()
    names = [sheet[: margin - 1, a + 41 : a + 60] for a in (18, 236)]
    assert np.array_equal(*names)  # x and x
    assert not np.array_equal(names[0], sheet[: margin - 1, 454 + 41 : 454 + 60])  # y
