"""Tomographies as metaballs: which voxels, where in the world, in what colour; bad files."""

from __future__ import annotations

import builtins
import json
import os
import struct

import globule as gb
import numpy as np
import pytest
from globule._base.colormaps import categorical
from globule.cli import main
from globule.formats import FormatError, tomography

sitk = pytest.importorskip("SimpleITK", reason="SimpleITK is not installed")

EXTENSIONS = [".nii", ".nii.gz", ".nrrd", ".nhdr", ".mha", ".mhd"]
ROTATION = np.array([[0.6, -0.8, 0], [0.8, 0.6, 0], [0, 0, 1]])
SPACING = (0.5, 1.0, 2.0)
ORIGIN = (-10.0, 20.0, 30.0)


def image(values: np.ndarray, spacing=SPACING, origin=ORIGIN, direction=ROTATION):
    """values[x, y, z] as an image with a frame of its own."""
    made = sitk.GetImageFromArray(np.ascontiguousarray(values.transpose(2, 1, 0)))
    made.SetSpacing(spacing)
    made.SetOrigin(origin)
    made.SetDirection(np.ravel(direction))
    return made


def ramp(dtype="i2") -> np.ndarray:
    return np.arange(3 * 4 * 5, dtype=dtype).reshape(3, 4, 5)


def ball(n: int = 24) -> np.ndarray:
    x, y, z = np.mgrid[-1 : 1 : n * 1j, -1 : 1 : n * 1j, -1 : 1 : n * 1j]
    return (1000 * (x * x + y * y + z * z < 0.5)).astype("i2")


@pytest.mark.parametrize("extension", EXTENSIONS)
def test_voxels_lie_where_the_file_says(extension, tmp_path):
    sitk.WriteImage(image(ramp()), str(tmp_path / f"a{extension}"))
    particles = gb.read(tmp_path / f"a{extension}", level=50)
    assert sorted(particles.attributes["intensity"]) == list(range(50, 60))
    for position, value in zip(particles.positions, particles.attributes["intensity"], strict=True):
        index = np.unravel_index(int(value), (3, 4, 5))
        expected = np.array(ORIGIN) + ROTATION @ (np.array(SPACING) * index)
        assert np.allclose(position, expected, atol=1e-4)


def test_nifti_is_turned_to_lps(tmp_path):
    """NIfTI's own frame is RAS: written there by hand, x and y change their signs."""
    header = struct.pack("<i", 348) + bytes(36) + struct.pack("<8h", 3, 2, 2, 2, 1, 1, 1, 1)
    header += bytes(14) + struct.pack("<hhh", 2, 8, 0)  # uint8
    header += struct.pack("<8f", 1, 2, 2, 2, 0, 0, 0, 0) + struct.pack("<f", 352)
    header += bytes(252 - len(header)) + struct.pack("<hh", 0, 1) + bytes(24)
    header += struct.pack("<12f", 2, 0, 0, 10, 0, 2, 0, 20, 0, 0, 2, 30)
    header += bytes(344 - len(header)) + b"n+1\0" + bytes(4)
    (tmp_path / "a.nii").write_bytes(header + bytes([0, 0, 0, 0, 0, 0, 0, 200]))
    particles = gb.read(tmp_path / "a.nii", level=100)
    assert np.allclose(particles.positions, [[-12, -22, 32]])


def test_series_of_one_moment(tmp_path):
    sitk.WriteImage(sitk.JoinSeries(image(ramp())), str(tmp_path / "a.nii"))
    exact = gb.tomography_particles(image(ramp()), level=50)
    assert np.allclose(gb.read(tmp_path / "a.nii", level=50).positions, exact.positions, atol=1e-4)
    assert tomography.describe(tmp_path / "a.nii")["size"] == [3, 4, 5]
    sitk.WriteImage(sitk.JoinSeries([image(ramp())] * 2), str(tmp_path / "b.nii"))
    with pytest.raises(FormatError, match="expected a volume of 3 axes, got 4"):
        gb.read(tmp_path / "b.nii")


def test_support_is_two_voxels():
    assert gb.tomography_particles(image(ball(), (2, 2, 2))).support == pytest.approx(4)
    assert gb.tomography_particles(image(ball(), SPACING)).support == pytest.approx(2)
    # Slices far apart: a support below their distance would leave gaps between them.
    assert gb.tomography_particles(image(ball(), (1, 1, 10))).support == pytest.approx(10)


def test_a_ball_looks_like_a_ball():
    whole = image(ball(), (1, 1, 1), (0, 0, 0), np.eye(3))
    scene = gb.Scene(gb.tomography_particles(whole), device="cpu")
    frame = gb.render(scene, gb.Camera((11.5, 11.5, 80), (11.5, 11.5, 0), height=40), (80, 80))
    radius = np.sqrt(frame.mask.sum() / 4 / np.pi)  # 4 pixels a mm²
    voxels = 23 / 2 * np.sqrt(0.5)
    assert radius == pytest.approx(voxels + 1.2, abs=0.5)


def test_labels_have_their_colors():
    values = np.zeros((4, 4, 4), np.uint8)
    values[0], values[1], values[2] = 1, 2, 13
    particles = gb.tomography_particles(image(values), labels=[2, 13])
    found = particles.attributes["label"]
    assert (np.bincount(found)[[2, 13]] == 16).all()
    assert len(found) == 32
    assert np.allclose(particles.color, categorical(found))
    assert not np.allclose(categorical([1]), categorical([2]))
    assert len(gb.tomography_particles(image(values), labels=1)) == 16
    assert len(gb.tomography_particles(image(values), labels=99)) == 0


def test_grays_follow_the_intensity():
    particles = gb.tomography_particles(image(ramp("f4")), level=10)
    gray = particles.color[np.argsort(particles.attributes["intensity"])]
    assert (np.ptp(gray, axis=1) == 0).all()
    assert (np.diff(gray[:, 0]) >= 0).all()
    assert gray[0, 0] < 0.12
    assert gray[-1, 0] == 1


def test_otsu_parts_two_peaks():
    rng = np.random.default_rng(1)
    low, high = rng.normal(100, 8, 50_000), rng.normal(400, 30, 10_000)
    values = np.concatenate([low, high, [1e6]]).astype("f4")
    assert 130 < tomography.otsu_level(values) < 330
    values[::10] = np.nan
    assert 130 < tomography.otsu_level(values) < 330
    assert tomography.otsu_level(np.full(5, 7)) == 7
    assert tomography.otsu_level(np.full(5, np.nan)) == 0


def test_nan_and_infinity_are_no_trouble():
    values = ramp("f4")
    values[0, 0, 0], values[2, 3, 4] = np.nan, np.inf
    particles = gb.tomography_particles(image(values), level=30)
    assert len(particles) == 30
    assert np.isfinite(particles.color).all()


def test_resampling():
    fine = image(ball(48), (0.5, 0.5, 1.0))
    coarse = gb.tomography_particles(fine, level=500, spacing=2.0)
    assert coarse.support == pytest.approx(4)
    exact = gb.tomography_particles(fine, level=500)
    assert 8 * len(coarse) == pytest.approx(0.25 * len(exact), rel=0.1)  # the volume in mm³
    middle = (coarse.positions.mean(axis=0), exact.positions.mean(axis=0))
    assert np.allclose(*middle, atol=0.3)
    labels = gb.tomography_particles(fine, labels=1000, spacing=0.4)
    assert set(labels.attributes["label"]) == {1000}


def test_too_many_voxels_name_a_spacing(monkeypatch):
    monkeypatch.setattr(tomography, "MOST_METABALLS", 500)
    fine = image(ball(), (1, 1, 1))
    with pytest.raises(ValueError, match="at most 500 voxels to show, got") as caught:
        gb.tomography_particles(fine)
    enough = float(str(caught.value).split()[-2])
    assert 300 < len(gb.tomography_particles(fine, spacing=enough)) <= 500


def test_dicom_series(tmp_path):
    values = image(ramp("i2"), (1, 1, 3), (5, 6, 7), np.eye(3))
    writer = sitk.ImageFileWriter()
    writer.KeepOriginalImageUIDOn()
    series = [("0020|000e", "1.2.3.4", 5), ("0020|000e", "1.2.3.5", 2)]
    for tag, uid, n in series:
        for i in range(n):
            part = values[:, :, i]
            part.SetMetaData(tag, uid)
            part.SetMetaData("0008|0060", "CT")
            part.SetMetaData("0008|0018", f"{uid}.{i}")
            part.SetMetaData("0020|0013", str(i))
            part.SetMetaData("0020|0032", f"5\\6\\{7 + 3 * i}")
            part.SetMetaData("0020|0037", "1\\0\\0\\0\\1\\0")
            writer.SetFileName(str(tmp_path / f"{uid}.{i}.dcm"))
            writer.Execute(part)
    particles = gb.read(tmp_path, level=59)  # of the series with 5 slices
    assert np.allclose(particles.positions, [[7, 9, 19]])
    assert tomography.describe(tmp_path)["size"] == [3, 4, 5]


# wrong arguments and bad files


@pytest.mark.parametrize(
    ("options", "what"),
    [
        ({"level": np.nan}, "level: expected a finite number"),
        ({"level": 1, "labels": [1]}, "level: expected none beside labels"),
        ({"labels": []}, "labels: expected one or more whole numbers"),
        ({"labels": 1.5}, "labels: expected one or more whole numbers"),
        ({"spacing": 0}, "spacing: expected a positive number"),
        ({"spacing": 1e-4}, r"spacing: expected at least 0\.\d+ mm"),
    ],
)
def test_wrong_arguments(options, what):
    with pytest.raises(ValueError, match=what):
        gb.tomography_particles(image(ramp()), **options)


def test_what_is_no_volume():
    for other in (sitk.Image(4, 4, sitk.sitkInt16), sitk.Image(4, 4, 4, sitk.sitkComplexFloat32)):
        with pytest.raises(FormatError, match="expected"):
            gb.tomography_particles(other)
    with pytest.raises(FormatError, match="one number per voxel, got 3"):
        gb.tomography_particles(sitk.Image([4, 4, 4], sitk.sitkVectorUInt8, 3))
    with pytest.raises(TypeError, match="expected a path or SimpleITK.Image, got list"):
        gb.tomography_particles([1, 2])


def test_folder_without_dicom(tmp_path):
    with pytest.raises(FormatError, match="expected a DICOM series in this folder, got none"):
        gb.read(tmp_path)


def test_sweep_is_no_volume(tmp_path):
    made = image(ramp())
    made.SetMetaData("Seq_Frame0000_ImageStatus", "OK")
    sitk.WriteImage(made, str(tmp_path / "a.mha"))
    with pytest.raises(FormatError, match="expected a volume, got a tracked sweep"):
        gb.read(tmp_path / "a.mha")


@pytest.mark.parametrize("size", ["100000 100000 100000", "1500 1500 900", "4 4 5", "-3 4 5"])
def test_sizes_are_checked_before_memory_is_taken(size, tmp_path):
    sitk.WriteImage(image(ramp()), str(tmp_path / "a.mha"))
    data = (tmp_path / "a.mha").read_bytes()
    (tmp_path / "a.mha").write_bytes(data.replace(b"= 3 4 5", f"= {size}".encode()))
    with pytest.raises(FormatError) as caught:
        gb.read(tmp_path / "a.mha")
    assert "a.mha" in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("extension", EXTENSIONS)
def test_broken_files(extension, tmp_path):
    path = tmp_path / f"a{extension}"
    sitk.WriteImage(image(ramp()), str(path))
    whole = path.read_bytes()
    rng = np.random.default_rng(2)
    for i in range(30):
        data = bytearray(whole[: len(whole) * i // 30] if i % 2 else whole)
        for place in rng.integers(0, max(1, len(data)), 3 if data and i % 4 < 2 else 0):
            data[place] = rng.integers(256)
        path.write_bytes(data)
        try:
            gb.read(path)
        except FormatError as error:
            assert "\n" not in str(error)
            assert path.name in str(error)


@pytest.mark.parametrize("extension", EXTENSIONS)
def test_cut_files(extension, tmp_path, capfd):
    path = tmp_path / f"a{extension}"
    sitk.WriteImage(image(np.random.default_rng(3).integers(0, 999, (9, 9, 9))), str(path))
    data = path.with_suffix(".raw")
    cut = data if data.exists() else path
    whole = cut.read_bytes()
    for share in (0.3, 0.9):
        cut.write_bytes(whole[: int(share * len(whole))])
        with pytest.raises(FormatError) as caught:
            gb.read(path)
        assert "\n" not in str(caught.value)
    assert capfd.readouterr() == ("", "")


def test_without_simpleitk(monkeypatch, tmp_path):
    real = builtins.__import__

    def without(name, *args, **kwargs):
        if name == "SimpleITK":
            raise ImportError(name)
        return real(name, *args, **kwargs)

    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(ValueError, match=r"SimpleITK, got none: pip install 'globule\[medical\]'"):
        gb.read(tmp_path / "a.nii")


# the command line


@pytest.fixture
def head(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    sitk.WriteImage(image(ball(), (1, 1, 1)), "head.nii.gz")
    return "head.nii.gz"


def test_commands(head, capsys):
    words = ["--size", "40x30", "--device", "cpu", "--up", "0,0,1"]
    assert main(["render", head, "-o", ".", "--level", "500", *words]) == 0
    assert os.path.exists("head.png")
    assert main(["render", head, "-o", "b.png", "--label", "1000", "--resample", "2", *words]) == 0
    assert main(["convert", head, "out.npz", "--level", "500"]) == 0
    assert len(gb.read("out.npz")) == (ball() > 0).sum()
    capsys.readouterr()
    assert main(["info", head, "--level", "500"]) == 0
    assert "24x24x24 voxels of 1 1 1 mm, 16-bit signed integer" in capsys.readouterr().out
    assert main(["info", head, "--json", "--label", "1000"]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert facts["format"] == "NIfTI volume, gzipped"
    assert facts["volume"]["size"] == [24, 24, 24]
    assert facts["attributes"]["label"]["min"] == 1000


def test_mistakes_of_the_commands(head, capsys):
    gb.write("a.npz", gb.Particles(np.eye(3)))
    for words, what in [
        (["convert", "a.npz", "b.npz", "--level", "1"], "--level: expected a volume to read"),
        (["convert", "a.npz", "b.npz", "--resample", "1"], "--resample: expected a volume or mesh"),
        (["info", head, "--level", "1", "--label", "1"], "--level: expected no --label beside --level"),
        (["convert", head, "b.nii", "--level", "1"], "OUT: expected a name ending in"),
        (["render", head, "-o", "b.png", "--level", "1e9"], "--level: expected an iso-value"),
        (["render", head, "-o", "b.png", "--label", "77"], "nii.gz: --label: expected a value"),
        (["info", head, "--label", "77", "--label", "78"], "that voxels have, got 77, 78"),
        (["info", ".", "--level", "1"], "expected a DICOM series in this folder"),
        (["info", head, "--resample", "0.001"], "spacing: expected at least"),
    ]:
        assert main(words) == 2
        error = capsys.readouterr().err
        assert what in error
        assert error.count("\n") == 1
