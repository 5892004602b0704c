"""Tomographies as metaballs: which voxels, where in the world, in what color; bad files."""

import os
import sys

import globule as gb
import numpy as np
import pytest
from cli_helpers import run_json
from globule._base.colormaps import categorical
from globule.cli import main
from globule.formats import FormatError
from globule.volumes import iso_surface as surfaces
from globule.volumes.iso_surface import otsu
from globule.volumes.tomography import tissue_voxels

sitk = pytest.importorskip("SimpleITK", reason="SimpleITK is not installed")
pytestmark = pytest.mark.interop

ROTATION = np.array([[0.6, -0.8, 0], [0.8, 0.6, 0], [0, 0, 1]])
SPACING = (0.5, 1.0, 2.0)
ORIGIN = (-10.0, 20.0, 30.0)


def image(values: np.ndarray, spacing=SPACING, origin=ORIGIN, direction=ROTATION):
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


def test_voxels_lie_where_the_image_says_and_series_of_one_moment(tmp_path):
    """Files: test_volume_places.py. Supports are two voxels."""
    particles = gb.volumes.sample_tomography(image(ramp()), labels=list(range(50, 60)))
    assert sorted(particles.attributes["label"]) == list(range(50, 60))
    for position, value in zip(particles.positions, particles.attributes["label"], strict=True):
        index = np.unravel_index(int(value), (3, 4, 5))
        assert np.allclose(position, np.array(ORIGIN) + ROTATION @ (np.array(SPACING) * index), atol=1e-4)
    for spacing, support in [((2, 2, 2), 4), (SPACING, 2), ((1, 1, 10), 10)]:
        # Slices far apart: a support below their distance would leave gaps between them.
        particles = gb.volumes.sample_tomography(image(ball(), spacing), labels=1000)
        assert particles.support == pytest.approx(support)
    sitk.WriteImage(sitk.JoinSeries(image(ramp())), str(tmp_path / "a.nii"))
    exact = gb.volumes.sample_tomography(image(ramp()), level=50)
    read = gb.volumes.sample_tomography(tmp_path / "a.nii", level=50)
    assert np.allclose(read.positions, exact.positions, atol=1e-4)
    sitk.WriteImage(sitk.JoinSeries([image(ramp())] * 2), str(tmp_path / "b.nii"))
    with pytest.raises(FormatError, match="expected a volume of 3 axes, got sizes"):
        gb.volumes.read_volume(tmp_path / "b.nii")


def test_colors_of_labels_and_of_finite_values_and_otsus_peaks():
    values = np.zeros((4, 4, 4), np.uint8)
    values[0], values[1], values[2] = 1, 2, 13
    particles = gb.volumes.sample_tomography(image(values), labels=[2, 13])
    found = particles.attributes["label"]
    assert (np.bincount(found)[[2, 13]] == 16).all()
    assert len(found) == 32
    assert np.allclose(particles.color, categorical(found))
    assert not np.allclose(categorical([1]), categorical([2]))
    assert len(gb.volumes.sample_tomography(image(values), labels=1)) == 16
    assert len(gb.volumes.sample_tomography(image(values), labels=99)) == 0
    particles = gb.volumes.sample_tomography(image(ramp("f4")), level=10)
    order = np.argsort(particles.attributes["intensity"])
    gray = particles.color[order][particles.attributes["intensity"][order] >= 10]
    assert (np.ptp(gray, axis=1) == 0).all()
    assert (np.diff(gray[:, 0]) >= 0).all()
    assert gray[0, 0] < 0.12
    assert gray[-1, 0] == 1
    values = ramp("f4")
    values[0, 0, 0], values[2, 3, 4] = np.nan, np.inf
    particles = gb.volumes.sample_tomography(image(values), level=30)
    assert (particles.attributes["intensity"] >= 30).sum() == 29
    assert np.isfinite(particles.color).all()
    rng = np.random.default_rng(1)
    low, high = rng.normal(100, 8, 50_000), rng.normal(400, 30, 10_000)
    values = np.concatenate([low, high, [1e6]]).astype("f4")
    assert 130 < otsu(values) < 330
    values[::10] = np.nan
    assert 130 < otsu(values) < 330
    assert otsu(np.full(5, 7)) == 7
    with pytest.raises(ValueError, match="expected finite numbers, got none"):
        otsu(np.full(5, np.nan))


def test_resampling_and_the_spacing_that_is_enough(monkeypatch):
    fine = image(ball(48), (0.5, 0.5, 1.0))
    coarse = gb.volumes.sample_tomography(fine, level=500, spacing=2.0)
    assert coarse.support == pytest.approx(2 * surfaces.VOXELS["murakami"])
    coarse = tissue_voxels(fine, level=500, spacing=2.0)[0]
    exact = tissue_voxels(fine, level=500)[0]
    assert 8 * len(coarse) == pytest.approx(0.25 * len(exact), rel=0.1)  # the volume in mm³
    assert np.allclose(coarse.mean(axis=0), exact.mean(axis=0), atol=0.3)
    assert set(gb.volumes.sample_tomography(fine, labels=1000, spacing=0.4).attributes["label"]) == {1000}
    monkeypatch.setattr(surfaces, "MOST_PARTICLES", 500)
    fine = image(ball(), (1, 1, 1))
    with pytest.raises(ValueError, match="at most 500 voxels to show, got") as caught:
        gb.volumes.sample_tomography(fine, labels=1000)
    enough = float(str(caught.value).split()[-2])
    assert 300 < len(gb.volumes.sample_tomography(fine, labels=1000, spacing=enough)) <= 500


def test_dicom_series(tmp_path):
    values, writer = image(ramp("i2"), (1, 1, 3), (5, 6, 7), np.eye(3)), sitk.ImageFileWriter()
    writer.KeepOriginalImageUIDOn()
    for uid, n in (("1.2.3.4", 5), ("1.2.3.5", 2)):
        for i in range(n):
            part = values[:, :, i]
            for tag, value in {
                "0020|000e": uid, "0008|0060": "CT", "0008|0018": f"{uid}.{i}", "0020|0013": str(i),
                "0020|0032": f"5\\6\\{7 + 3 * i}", "0020|0037": "1\\0\\0\\0\\1\\0",
            }.items():  # fmt: skip
                part.SetMetaData(tag, value)
            writer.SetFileName(str(tmp_path / f"{uid}.{i}.dcm"))
            writer.Execute(part)
    particles = gb.volumes.sample_tomography(tmp_path, labels=59)  # of the series with 5 slices
    assert np.allclose(particles.positions, [[7, 9, 19]])
    volume = gb.volumes.read_volume(tmp_path)
    assert (volume.shape, volume.space) == ((5, 4, 3), "LPS")


@pytest.mark.parametrize(("options", "what"), [
    ({"level": np.nan}, "level: expected a finite number"),
    ({"level": 1, "labels": [1]}, "level: expected none beside labels"),
    ({"labels": 1.5}, "labels: expected one or more whole numbers"),
    ({"spacing": 0}, "spacing: expected a positive number"),
    ({"spacing": 1e-4}, r"spacing: expected at least 0\.\d+ mm"),
])  # fmt: skip
def test_wrong_arguments(options, what):
    with pytest.raises(ValueError, match=what):
        gb.volumes.sample_tomography(image(ramp()), **options)


def test_what_is_no_volume(tmp_path):
    for other in (sitk.Image(4, 4, sitk.sitkInt16), sitk.Image(4, 4, 4, sitk.sitkComplexFloat32)):
        with pytest.raises(FormatError, match="expected"):
            gb.volumes.sample_tomography(other)
    with pytest.raises(FormatError, match="one number per voxel, got 3"):
        gb.volumes.sample_tomography(sitk.Image([4, 4, 4], sitk.sitkVectorUInt8, 3))
    with pytest.raises(TypeError, match=r"expected a path, Volume or SimpleITK.Image, got list"):
        gb.volumes.sample_tomography([1, 2])
    made = image(ramp())
    made.SetMetaData("Seq_Frame0000_ProbeToTrackerTransform", "1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1")
    sitk.WriteImage(made, str(tmp_path / "a.mha"))
    with pytest.raises(FormatError, match=r"expected a volume, got a sweep .* globule.ultrasound.read_sweep"):
        gb.volumes.read_volume(tmp_path / "a.mha")


@pytest.mark.parametrize("extension", [".nhdr", ".mhd"])
def test_cut_files(extension, tmp_path, capfd):
    path = tmp_path / f"a{extension}"
    sitk.WriteImage(image(np.random.default_rng(3).integers(0, 999, (9, 9, 9))), str(path))
    cut = path.with_suffix(".raw")
    whole = cut.read_bytes()
    for share in (0.3, 0.9):
        cut.write_bytes(whole[: int(share * len(whole))])
        with pytest.raises(FormatError) as caught:
            gb.volumes.read_volume(path)
        assert "\n" not in str(caught.value)
    assert capfd.readouterr() == ("", "")


def test_without_the_packages(monkeypatch, tmp_path):
    (tmp_path / "a.nii").write_bytes(bytes(344) + b"n+1\0")
    (tmp_path / "a.dcm").write_bytes(bytes(128) + b"DICM")
    for name in ("SimpleITK", "nibabel"):
        monkeypatch.setitem(sys.modules, name, None)
    for name, package in (("a.nii", "nibabel"), ("a.dcm", "SimpleITK")):
        with pytest.raises(gb.MissingPackageError, match=rf'{package} .* "globule\[medical\]"'):
            gb.volumes.read_volume(tmp_path / name)


@pytest.fixture
def head(folder):
    sitk.WriteImage(image(ball(), (1, 1, 1)), "head.nii.gz")
    return "head.nii.gz"


def test_commands(head, capsys):
    words = ["--size", "40x30", "--device", "cpu", "--up", "0,0,1"]
    assert main(["render", head, "-o", ".", "--level", "500", *words]) == 0
    assert os.path.exists("head.png")
    assert main(["render", head, "-o", "b.png", "--label", "1000", "--resample", "2", *words]) == 0
    assert main(["convert", head, "out.npz", "--level", "500"]) == 0
    assert (gb.read("out.npz").attributes["intensity"] == 1000).sum() == (ball() > 0).sum()
    capsys.readouterr()
    assert main(["info", head, "--level", "500"]) == 0
    assert "24x24x24 voxels of 1 1 1 mm, uint16" in capsys.readouterr().out
    facts = run_json(capsys, "info", head, "--label", "1000")
    assert (facts["format"], facts["volume"]["size"]) == ("NIfTI volume, gzipped", [24, 24, 24])
    assert facts["attributes"]["label"]["min"] == 1000
    os.mkdir("other")
    gb.write("a.npz", gb.Particles(np.eye(3)))
    for words, what in [
        (["convert", "a.npz", "b.npz", "--level", "1"], "--level: expected a volume to read"),
        (["convert", "a.npz", "b.npz", "--resample", "1"], "--resample: expected a volume or mesh"),
        (["info", head, "--level", "1", "--label", "1"], "--level: expected no --label"),
        (["convert", head, "b.nii", "--level", "1"], "OUT: expected a name ending in"),
        (["render", head, "-o", "b.png", "--level", "1e9"], "at most the highest value, 1000"),
        (["render", head, "-o", "b.png", "--label", "77"], "nii.gz: --label: expected a value"),
        (["info", head, "--label", "77", "--label", "78"], "that voxels have, got 77, 78"),
        (["info", "other", "--level", "1"], "expected pictures or a DICOM series"),
        (["info", head, "--resample", "0.001"], "spacing: expected at least"),
    ]:
        assert main(words) == 2
        error = capsys.readouterr().err
        assert what in error
        assert error.count("\n") == 1


def test_gb_read_names_the_door_of_a_volume(tmp_path):
    sitk.WriteImage(image(ball()), str(tmp_path / "a.nrrd"))
    for options in ({}, {"level": 500}):
        with pytest.raises(FormatError, match=r"a volume \(nrrd\): read it with globule\.volumes\.read_v"):
            gb.read(tmp_path / "a.nrrd", **options)


@pytest.mark.parametrize("shift", [0, -1500])
def test_tomography_and_iso_surface_agree(shift, tmp_path):
    """Same particles, same level by default, the same frame; the surface lies at the level."""
    n, spacing = 20, np.array([0.7, 0.9, 1.1])
    z, y, x = np.meshgrid(*(np.arange(n) - (n - 1) / 2,) * 3, indexing="ij")
    distance = np.linalg.norm(np.stack([x, y, z], -1) * spacing, axis=-1)
    values = (np.clip(1000 - 100 * (distance - 5), 0, 2000) + shift).astype(np.float32)
    sitk.WriteImage(image(values.T, spacing.tolist(), (0, 0, 0)), str(tmp_path / "a.nii.gz"))
    volume = gb.volumes.read_volume(tmp_path / "a.nii.gz")
    for level in (None, 1000.0 + shift):
        surface = gb.volumes.extract_iso_surface(volume, level)
        particles = gb.volumes.sample_tomography(tmp_path / "a.nii.gz", level)
        assert np.array_equal(particles.positions, surface.particles.positions)
        values = surface.particles.attributes["value"]
        assert np.array_equal(particles.attributes["intensity"], values)
    scene = gb.Scene(particles, device="cpu")  # with its default threshold
    middle = (volume.world_from_voxel @ [*[(n - 1) / 2] * 3, 1])[:3]
    frame = gb.render(scene, gb.Camera(middle + [0, 0, 60], middle, height=14), (60, 60))
    radius = np.linalg.norm(frame.position[frame.mask] - middle, axis=1)
    assert np.median(radius) == pytest.approx(5, abs=0.15)
    assert tissue_voxels(volume, level)[0].shape[0] == (volume.values >= level).sum()
    turned = volume.in_space("RAS")
    assert np.array_equal(gb.volumes.sample_tomography(turned, level).positions, particles.positions)
    assert np.array_equal(turned.values, volume.values)
