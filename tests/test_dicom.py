"""DICOM: output as pydicom, SimpleITK and globule's own reader see it; mm per pixel and tissue of cine."""

import datetime
import itertools

import globule as gb
import numpy as np
import pytest
from cli_helpers import output_of, refused, refuses
from globule.cli import main
from globule.formats.errors import FormatError
from globule.formats.kind import kind_of
from globule.formats.sweeps.poses import PoseTable, write_csv
from globule.ultrasound.calibration import Calibration
from globule.ultrasound.files import read_sweep
from globule.volumes.files import read_volume, write_volume
from globule.volumes.volume import Volume
from sweep_helpers import random_poses, small_sweep

pydicom = pytest.importorskip("pydicom", reason="needs pydicom")
sitk = pytest.importorskip("SimpleITK", reason="DICOM needs SimpleITK")
pytestmark = pytest.mark.usefixtures("folder")


def volume(dtype="uint8", turned=True, mirrored=False, space="LPS", shape=(5, 7, 9)) -> Volume:
    """Random voxels of 0.1, 0.3 and 1/7 mm at an odd place."""
    values = np.random.default_rng(2).integers(1, 250, shape).astype(dtype)
    matrix = np.diag([0.1, 0.3, -1 / 7 if mirrored else 1 / 7, 1.0])
    if turned:
        matrix = random_poses(1, 9)[0] @ matrix
    matrix[:3, 3] = -74.52170039, 165.57342384663468, 1 / 3
    return Volume(values, matrix, None, space)


def places(matrix, shape):
    """The world's places of all voxels, (Z, Y, X, 3)."""
    z, y, x = np.indices(shape)
    return np.stack([x, y, z, np.ones(shape)], axis=-1) @ matrix[:3].T


@pytest.mark.parametrize("dtype", ["uint8", "uint16"])
def test_every_voxel_keeps_its_place(dtype):
    """Values sit at the same millimeters for SimpleITK and globule, whatever the axes."""
    for turned, mirrored, space in itertools.product((0, 1), (0, 1), ("LPS", "RAS")):
        before = volume(dtype, turned, mirrored, space)
        write_volume("a.dcm", before)
        after = read_volume("a.dcm")
        assert after.values.dtype == dtype
        assert after.space == "LPS"
        lps = before.in_space("LPS").world_from_voxel
        flip = np.linalg.det(lps[:3, :3]) < 0
        order = slice(None, None, -1 if flip else 1)
        assert np.array_equal(after.values, before.values[order])
        here, there = (places(m, before.shape) for m in (lps, after.world_from_voxel))
        np.testing.assert_allclose(there, here[order], rtol=0, atol=1e-9)
        image = sitk.ReadImage("a.dcm")
        assert np.array_equal(sitk.GetArrayFromImage(image), before.values[order])
        seen = image.TransformIndexToPhysicalPoint((8, 6, 4))
        assert seen == pytest.approx(tuple(here[order][4, 6, 8]), abs=1e-9)


def test_what_pydicom_sees():
    """The elements themselves: the plane's place, its directions, its spacing, its pixels."""
    before = volume("uint16")
    write_volume("a.dcm", before)
    file = pydicom.dcmread("a.dcm")
    assert file.SOPClassUID.name == "Multi-frame Grayscale Word Secondary Capture Image Storage"
    assert (file.Modality, file.PatientName, file.PatientID) == ("US", "", "")
    assert file.ContentDate == datetime.date.today().strftime("%Y%m%d")
    shared, frames = file.SharedFunctionalGroupsSequence[0], file.PerFrameFunctionalGroupsSequence
    measures = shared.PixelMeasuresSequence[0]
    assert list(measures.PixelSpacing) == pytest.approx([0.3, 0.1], rel=1e-12)  # rows first
    assert measures.SpacingBetweenSlices == pytest.approx(1 / 7, rel=1e-9)
    directions = np.array(shared.PlaneOrientationSequence[0].ImageOrientationPatient, float)
    unit = before.world_from_voxel[:3, :2] / before.spacing[:2]
    np.testing.assert_allclose(directions.reshape(2, 3).T, unit, atol=1e-11)
    for z, frame in enumerate(frames):
        place = np.array(frame.PlanePositionSequence[0].ImagePositionPatient, float)
        here = before.world_from_voxel @ [0, 0, z, 1]
        np.testing.assert_allclose(place, here[:3], atol=1e-10)
    assert np.array_equal(file.pixel_array, before.values)
    write_volume("b.dcm", before)
    assert pydicom.dcmread("b.dcm").SOPInstanceUID != file.SOPInstanceUID


@pytest.mark.parametrize("shape", [(1, 4, 6), (3, 1, 1), (1, 1, 1), (3, 3, 3)])
def test_small_and_odd_volumes(shape):
    before = volume(shape=shape)
    write_volume("a.dcm", before)
    after = read_volume("a.dcm")
    assert np.array_equal(after.values, before.values)
    np.testing.assert_allclose(after.world_from_voxel, before.world_from_voxel, atol=1e-9)


def test_it_is_a_volume_and_no_sweep():
    write_volume("a.dcm", volume())
    assert kind_of("a.dcm") == ("volume", "dicom")
    refuses(r"got a volume \(dicom\).*read_volume", gb.ultrasound.read_sweep, "a.dcm", error=FormatError)


def test_what_it_cannot_hold(tmp_path):
    """Refused before a file is there."""
    skewed = volume()
    skewed.world_from_voxel[:3, 1] += 0.1 * skewed.world_from_voxel[:3, 0]
    for wrong, options, problem in (
        (volume("float32"), {}, "values: expected uint8 or uint16 for .dcm, got float32"),
        (skewed, {}, "expected perpendicular axes"),
        (volume(), {"maps": True}, r"a\.dcm: expected \.vti \.npz \.sparse\.npz for maps"),
    ):
        refuses(problem, write_volume, "a.dcm", wrong, **options)
        assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("even", [True, False])
def test_enhanced_us_volumes_of_others(even):
    """Their place is in sequences of their own, which SimpleITK leaves out."""
    before = volume(shape=(4, 7, 9))
    write_volume("a.dcm", before)
    file = pydicom.dcmread("a.dcm")
    file.SOPClassUID = file.file_meta.MediaStorageSOPClassUID = "1.2.840.10008.5.1.4.1.1.6.2"
    shared = file.SharedFunctionalGroupsSequence[0]
    directions = pydicom.Dataset()
    directions.ImageOrientationVolume = [float(v) for v in shared.PlaneOrientationSequence[0].ImageOrientationPatient]
    shared.PlaneOrientationVolumeSequence = [directions]
    del shared.PlaneOrientationSequence
    for frame in file.PerFrameFunctionalGroupsSequence:
        place = pydicom.Dataset()
        position = np.array(frame.PlanePositionSequence[0].ImagePositionPatient, float)
        place.ImagePositionVolume = list(position if even else position**2)
        frame.PlanePositionVolumeSequence = [place]
        del frame.PlanePositionSequence
    file.save_as("other.dcm", enforce_file_format=True)
    assert kind_of("other.dcm") == ("volume", "dicom")
    if even:
        after = read_volume("other.dcm")
        assert np.array_equal(after.values, before.values)
        np.testing.assert_allclose(after.world_from_voxel, before.world_from_voxel, atol=1e-9)
    else:
        refuses("planes at even distances", read_volume, "other.dcm", error=FormatError)


def test_commands(capsys):
    """reconstruct and convert write it, info and convert read it."""
    gb.ultrasound.write_sweep("s.npz", small_sweep())
    for name in ("v.dcm", "v.nrrd"):
        assert main(["reconstruct", "s.npz", "--voxel-size", "2", "-o", name]) == 0
    assert np.array_equal(read_volume("v.dcm").values, read_volume("v.nrrd").values)
    assert main(["convert", "v.dcm", "w.mha"]) == 0
    np.testing.assert_allclose(read_volume("w.mha").world_from_voxel, read_volume("v.nrrd").world_from_voxel, atol=1e-9)
    capsys.readouterr()
    assert "v.dcm: volume" in output_of(capsys, "info", "v.dcm").out
    error = refused(capsys, "reconstruct", "s.npz", "-o", "m.dcm", "--maps")
    assert "m.dcm: expected .vti .npz .sparse.npz for maps" in error


# Cine: its Sequence of Ultrasound Regions

POSES = random_poses(4, seed=3)


def region(x0, y0, x1, y1, dx, dy, spatial=1, unit=3, reference=None):
    item = pydicom.Dataset()
    item.RegionSpatialFormat, item.RegionDataType, item.RegionFlags = spatial, 1, 0
    item.RegionLocationMinX0, item.RegionLocationMinY0 = x0, y0
    item.RegionLocationMaxX1, item.RegionLocationMaxY1 = x1, y1
    item.PhysicalUnitsXDirection = item.PhysicalUnitsYDirection = unit
    item.PhysicalDeltaX, item.PhysicalDeltaY = dx, dy
    if reference:
        item.ReferencePixelX0, item.ReferencePixelY0 = reference
    return item


def write(path, regions) -> np.ndarray:
    """An Ultrasound Multi-frame Image of 4 frames of 24x16 pixels, 50 ms apart; and poses.csv."""
    frames = np.random.default_rng(0).integers(0, 255, (4, 16, 24), np.uint8)
    meta = pydicom.dataset.FileMetaDataset()
    meta.MediaStorageSOPClassUID = "1.2.840.10008.5.1.4.1.1.3.1"
    meta.MediaStorageSOPInstanceUID = "1.2.3.4"
    meta.TransferSyntaxUID = pydicom.uid.ExplicitVRLittleEndian
    data = pydicom.dataset.FileDataset(str(path), {}, file_meta=meta, preamble=bytes(128))
    data.SOPClassUID, data.SOPInstanceUID = meta.MediaStorageSOPClassUID, "1.2.3.4"
    data.Modality, data.FrameTime, data.NumberOfFrames = "US", "50", "4"
    data.FrameIncrementPointer = 0x00181063
    data.Rows, data.Columns, data.SamplesPerPixel = 16, 24, 1
    data.PhotometricInterpretation, data.PixelRepresentation = "MONOCHROME2", 0
    data.BitsAllocated = data.BitsStored = 8
    data.HighBit = 7
    if regions:
        data.SequenceOfUltrasoundRegions = pydicom.Sequence(regions)
    data.PixelData = frames.tobytes()
    data.save_as(path, enforce_file_format=True)
    write_csv(path.parent / "poses.csv", PoseTable(None, POSES, np.ones(4, bool)))
    return frames


def test_regions_give_scale_place_and_mask(tmp_path):
    """The largest region of tissue counts; a Doppler trace in seconds does not."""
    regions = [
        region(0, 0, 23, 3, 0.5, 0.5, spatial=3, unit=4),
        region(0, 5, 2, 7, 0.9, 0.9),
        region(4, 5, 20, 14, 0.02, 0.03, reference=(8, 0)),
    ]
    frames = write(tmp_path / "cine.dcm", regions)
    sweep = read_sweep(tmp_path / "cine.dcm", poses=tmp_path / "poses.csv")
    assert np.array_equal(sweep.frames, frames)
    assert sweep.spacing == pytest.approx((0.2, 0.3))
    assert sweep.timestamps == pytest.approx([0, 0.05, 0.1, 0.15])
    # Pixel (12, 5), the reference pixel, is where the pose is; pixel (13, 7) 0.2 and 0.6 mm on.
    places = sweep.world_from_image @ [12, 5, 0, 1]
    np.testing.assert_allclose(places, POSES[:, :, 3], atol=1e-9)
    places = sweep.world_from_image @ [13, 7, 0, 1]
    np.testing.assert_allclose(places, POSES @ [0.2, 0.6, 0, 1], atol=1e-9)
    assert sweep.mask.sum() == 17 * 10
    assert sweep.mask[5:15, 4:21].all()


def test_a_calibration_counts_and_must_agree(tmp_path):
    write(tmp_path / "cine.dcm", [region(4, 5, 20, 14, 0.02, 0.03)])
    good = Calibration(np.diag([0.2, 0.3, 1.0, 1.0]))
    sweep = read_sweep(tmp_path / "cine.dcm", poses=tmp_path / "poses.csv", calibration=good)
    np.testing.assert_allclose(sweep.world_from_image, POSES @ good.probe_from_image)
    assert sweep.mask.sum() == 17 * 10
    other = Calibration(np.diag([0.3, 0.3, 1.0, 1.0]))
    with pytest.raises(FormatError, match=r"the file's 0\.2 x 0\.3 mm per pixel, got 0\.3 x 0\.3"):
        read_sweep(tmp_path / "cine.dcm", poses=tmp_path / "poses.csv", calibration=other)


def test_without_regions_a_calibration_is_asked_for(tmp_path):
    write(tmp_path / "cine.dcm", [])
    with pytest.raises(FormatError, match="expected a calibration"):
        read_sweep(tmp_path / "cine.dcm", poses=tmp_path / "poses.csv")


def test_regions_that_cannot_be(tmp_path):
    for bad_region, said in (
        (region(4, 5, 40, 14, 0.02, 0.03), "expected a region in the 24x16 pixels"),
        (region(9, 5, 4, 14, 0.02, 0.03), "expected a region in the 24x16 pixels"),
        (region(4, 5, 20, 14, 0.0, 0.03), "expected corners and sizes of pixels"),
        (region(4, 5, 20, 14, float("nan"), 0.03), "expected corners and sizes of pixels"),
    ):
        write(tmp_path / "cine.dcm", [bad_region])
        refuses(said, read_sweep, tmp_path / "cine.dcm", poses=tmp_path / "poses.csv", error=FormatError)
