"""One oblique volume with voxels of three different edges, written by four programs, is read as the
same values at the same place. Our own files: test_formats.py."""

import globule as gb
import numpy as np
import pytest
from globule.volumes.volume import Volume
from scipy.spatial.transform import Rotation

EDGES = (0.7, 1.1, 1.6)  # mm
ORIGIN = (-31.25, 42.5, 17.125)
LPS_FROM_RAS = np.diag([-1.0, -1.0, 1.0, 1.0])
VTK_MODES = [  # data mode, compressed, base64 in the appended data, header
    ("appended", True, True, 64),  # VTK's default
    ("appended", True, True, 32),
    ("appended", True, False, 32),
    ("appended", False, True, 64),
    ("appended", False, False, 32),
    ("binary", True, True, 64),
    ("binary", False, True, 32),
    ("ascii", False, True, 64),
]


def rotation() -> np.ndarray:
    return Rotation.from_euler("xyz", (20, -35, 50), degrees=True).as_matrix()


@pytest.fixture(scope="module")
def volume() -> Volume:
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = rotation() * EDGES, ORIGIN
    return Volume(np.random.default_rng(3).integers(0, 250, (12, 16, 22), np.uint8), matrix)


def same(path, volume: Volume, tolerance: float = 1e-12) -> None:
    """`tolerance`: of the place, mm; 1e-4 where a format rounds its geometry to float32."""
    found = gb.volumes.read_volume(path)
    assert (found.space, found.values.dtype) == ("LPS", volume.values.dtype)
    assert np.array_equal(found.values, volume.values)
    assert np.abs(found.world_from_voxel - volume.world_from_voxel).max() < tolerance


@pytest.mark.parametrize("kind", ["Nifti1Image", "Nifti2Image"])
@pytest.mark.parametrize("form", ["sform", "qform"])
@pytest.mark.interop
def test_nibabel(kind, form, volume, tmp_path):
    nibabel, affine = pytest.importorskip("nibabel"), LPS_FROM_RAS @ volume.world_from_voxel
    made = getattr(nibabel, kind)(volume.values.T, affine)
    made.set_sform(affine if form == "sform" else None, int(form == "sform"))
    made.set_qform(affine if form == "qform" else None, int(form == "qform"))
    made.header.set_xyzt_units("mm")
    nibabel.save(made, tmp_path / "a.nii.gz")
    same(tmp_path / "a.nii.gz", volume, 1e-4)


@pytest.mark.interop
def test_nibabel_in_metres_and_scaled(volume, tmp_path):
    nibabel, affine = pytest.importorskip("nibabel"), LPS_FROM_RAS @ volume.world_from_voxel
    affine[:3] /= 1000
    made = nibabel.Nifti1Image(volume.values.T.astype(np.int16), affine)
    made.header.set_xyzt_units("meter")
    made.header.set_slope_inter(0.5, -20)
    nibabel.save(made, tmp_path / "a.nii")
    found = gb.volumes.read_volume(tmp_path / "a.nii")
    assert np.array_equal(found.values, volume.values * np.float32(0.5) - 20)
    assert np.allclose(found.world_from_voxel, volume.world_from_voxel, atol=1e-4)


@pytest.mark.parametrize("encoding", ["gzip", "raw"])
@pytest.mark.parametrize("space", ["left-posterior-superior", "right-anterior-superior"])
@pytest.mark.interop
def test_pynrrd(encoding, space, volume, tmp_path):
    nrrd, matrix = pytest.importorskip("nrrd"), volume.world_from_voxel
    if space.startswith("right"):
        matrix = LPS_FROM_RAS @ matrix
    header = {
        "space": space, "space directions": matrix[:3, :3].T, "space origin": matrix[:3, 3],
        "encoding": encoding, "kinds": ["domain"] * 3,
    }  # fmt: skip
    nrrd.write(str(tmp_path / "a.nrrd"), volume.values.T, header)
    same(tmp_path / "a.nrrd", volume)
    nrrd.write(str(tmp_path / "b.nhdr"), volume.values.T, header)
    if encoding == "raw":
        same(tmp_path / "b.nhdr", volume)


@pytest.mark.parametrize("ending", [".mha", ".mhd", ".nrrd", ".nii.gz"])
@pytest.mark.parametrize("compressed", [False, True])
@pytest.mark.interop
def test_simpleitk(ending, compressed, volume, tmp_path):
    sitk = pytest.importorskip("SimpleITK")
    made = sitk.GetImageFromArray(volume.values)
    made.SetSpacing(EDGES)
    made.SetOrigin(ORIGIN)
    made.SetDirection(rotation().ravel().tolist())
    sitk.WriteImage(made, str(tmp_path / f"a{ending}"), compressed)
    same(tmp_path / f"a{ending}", volume, 1e-4 if ending == ".nii.gz" else 1e-12)


@pytest.mark.parametrize("mode", VTK_MODES, ids=str)
@pytest.mark.interop
def test_vtk(mode, volume, tmp_path):
    pytest.importorskip("vtk")
    from vtkmodules.util.numpy_support import numpy_to_vtk
    from vtkmodules.vtkCommonDataModel import vtkImageData
    from vtkmodules.vtkIOXML import vtkXMLImageDataWriter

    data_mode, compressed, base64, header = mode
    made = vtkImageData()
    made.SetDimensions(volume.shape[::-1])
    made.SetSpacing(EDGES)
    made.SetOrigin(ORIGIN)
    made.SetDirectionMatrix(rotation().ravel().tolist())
    array = numpy_to_vtk(volume.values.ravel(), deep=True)
    array.SetName("intensity")
    made.GetPointData().SetScalars(array)
    writer = vtkXMLImageDataWriter()
    writer.SetFileName(str(tmp_path / "a.vti"))
    writer.SetInputData(made)
    if mode is not VTK_MODES[0]:
        getattr(writer, f"SetDataModeTo{data_mode.capitalize()}")()
        writer.SetEncodeAppendedData(base64)
        getattr(writer, f"SetHeaderTypeToUInt{header}")()
        if not compressed:
            writer.SetCompressorTypeToNone()
    assert writer.Write()
    same(tmp_path / "a.vti", volume)
