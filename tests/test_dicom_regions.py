"""DICOM cine: mm per pixel and tissue from its Sequence of Ultrasound Regions."""

from __future__ import annotations

import numpy as np
import pytest
from globule.formats.errors import FormatError
from globule.formats.sweeps.poses import PoseTable, write_csv
from globule.ultrasound.calibration import Calibration
from globule.ultrasound.files import read_sweep
from sweep_helpers import random_poses

pydicom = pytest.importorskip("pydicom", reason="needs pydicom")
pytest.importorskip("SimpleITK", reason="DICOM needs SimpleITK")

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


@pytest.mark.parametrize(
    ("bad_region", "said"),
    [
        (region(4, 5, 40, 14, 0.02, 0.03), "expected a region in the 24x16 pixels"),
        (region(9, 5, 4, 14, 0.02, 0.03), "expected a region in the 24x16 pixels"),
        (region(4, 5, 20, 14, 0.0, 0.03), "expected corners and sizes of pixels"),
        (region(4, 5, 20, 14, float("nan"), 0.03), "expected corners and sizes of pixels"),
    ],
)
def test_regions_that_cannot_be(tmp_path, bad_region, said):
    write(tmp_path / "cine.dcm", [bad_region])
    with pytest.raises(FormatError, match=said):
        read_sweep(tmp_path / "cine.dcm", poses=tmp_path / "poses.csv")
