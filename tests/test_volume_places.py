"""One oblique volume with voxels of three different edges, written by four programs and by us, is
read as the same values at the same place, and gives the same image."""

from __future__ import annotations

import globule as gb
import numpy as np
import pytest
from globule.volumes.volume import Volume

EDGES = (0.7, 1.1, 1.6)  # mm
ORIGIN = (-31.25, 42.5, 17.125)
MIDDLE, DENT = (10.5, 7.5, 5.5), (16.0, 10.5, 4.5)  # voxels
LEVEL = 100.0
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
    x, y, z = np.radians((20, -35, 50))
    about_x = [[1, 0, 0], [0, np.cos(x), -np.sin(x)], [0, np.sin(x), np.cos(x)]]
    about_y = [[np.cos(y), 0, np.sin(y)], [0, 1, 0], [-np.sin(y), 0, np.cos(y)]]
    about_z = [[np.cos(z), -np.sin(z), 0], [np.sin(z), np.cos(z), 0], [0, 0, 1]]
    return np.array(about_z) @ about_y @ about_x


@pytest.fixture(scope="module")
def volume() -> Volume:
    """A ball that is dented on one side, so that no turned or mirrored reading looks the same."""
    shape = (12, 16, 22)
    z, y, x = np.meshgrid(*map(np.arange, shape), indexing="ij")
    index = np.stack([x, y, z], -1)
    distance = np.linalg.norm((index - MIDDLE) * EDGES, axis=-1)
    dent = np.linalg.norm((index - DENT) * EDGES, axis=-1)
    values = np.clip(100 + 25 * (6 - distance), 0, 250) * np.clip(dent / 4, 0, 1)
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = rotation() * EDGES, ORIGIN
    return Volume(values.astype(np.uint8), matrix)


def image_of(volume: Volume) -> np.ndarray:
    """The surface, seen by a camera that does not move with the volume."""
    particles, threshold, _ = gb.iso_surface(volume, LEVEL)
    scene = gb.Scene(particles, threshold=threshold, device="cpu")
    middle, dent = (np.array(p) @ (rotation() * EDGES).T + ORIGIN for p in (MIDDLE, DENT))
    camera = gb.Camera(middle + 9 * (dent - middle), middle, up=(0, 0, 1), height=20)
    return gb.render(scene, camera, (64, 48)).picture


@pytest.fixture(scope="module")
def expected(volume) -> np.ndarray:
    picture = image_of(volume)
    background = (picture == picture[0, 0]).all(axis=2).mean()
    assert 0.3 < background < 0.9
    return picture


def same(path, volume: Volume, expected: np.ndarray, exact: bool = True) -> None:
    """`exact`: the place to 1e-12 mm and the image bit by bit; else, where a format rounds its
    geometry to float32, to 1e-4 mm, and at most 2 % of the pixels change by more than 4 of 255."""
    found = gb.read_volume(path)
    assert found.space == "LPS"
    assert found.values.dtype == volume.values.dtype
    assert np.array_equal(found.values, volume.values)
    tolerance = 1e-12 if exact else 1e-4
    assert np.abs(found.world_from_voxel - volume.world_from_voxel).max() < tolerance
    picture = image_of(found)
    if exact:
        assert np.array_equal(picture, expected)
    else:
        changed = np.abs(picture.astype(int) - expected).max(axis=2) > 4
        assert changed.mean() < 0.02


@pytest.mark.parametrize("space", ["LPS", "RAS"])
@pytest.mark.parametrize(
    "ending", [".mha", ".nrrd", ".vti", ".npz", ".sparse.npz", ".nii", ".nii.gz"]
)
def test_our_files(ending, space, volume, expected, tmp_path):
    gb.write_volume(tmp_path / f"a{ending}", volume.in_space(space))
    same(tmp_path / f"a{ending}", volume, expected, exact=not ending.startswith(".nii"))


@pytest.mark.parametrize("kind", ["Nifti1Image", "Nifti2Image"])
@pytest.mark.parametrize("form", ["sform", "qform"])
@pytest.mark.interop
def test_nibabel(kind, form, volume, expected, tmp_path):
    nibabel = pytest.importorskip("nibabel")
    affine = LPS_FROM_RAS @ volume.world_from_voxel
    made = getattr(nibabel, kind)(volume.values.T, affine)
    made.set_sform(affine if form == "sform" else None, int(form == "sform"))
    made.set_qform(affine if form == "qform" else None, int(form == "qform"))
    made.header.set_xyzt_units("mm")
    nibabel.save(made, tmp_path / "a.nii.gz")
    same(tmp_path / "a.nii.gz", volume, expected, exact=False)


@pytest.mark.interop
def test_nibabel_in_metres_and_scaled(volume, tmp_path):
    nibabel = pytest.importorskip("nibabel")
    affine = LPS_FROM_RAS @ volume.world_from_voxel
    affine[:3] /= 1000
    made = nibabel.Nifti1Image(volume.values.T.astype(np.int16), affine)
    made.header.set_xyzt_units("meter")
    made.header.set_slope_inter(0.5, -20)
    nibabel.save(made, tmp_path / "a.nii")
    found = gb.read_volume(tmp_path / "a.nii")
    assert np.array_equal(found.values, volume.values * np.float32(0.5) - 20)
    assert np.allclose(found.world_from_voxel, volume.world_from_voxel, atol=1e-4)


@pytest.mark.parametrize("encoding", ["gzip", "raw"])
@pytest.mark.parametrize("space", ["left-posterior-superior", "right-anterior-superior"])
@pytest.mark.interop
def test_pynrrd(encoding, space, volume, expected, tmp_path):
    nrrd = pytest.importorskip("nrrd")
    matrix = volume.world_from_voxel
    if space.startswith("right"):
        matrix = LPS_FROM_RAS @ matrix
    header = {
        "space": space, "space directions": matrix[:3, :3].T, "space origin": matrix[:3, 3],
        "encoding": encoding, "kinds": ["domain"] * 3,
    }  # fmt: skip
    nrrd.write(str(tmp_path / "a.nrrd"), volume.values.T, header)
    same(tmp_path / "a.nrrd", volume, expected)
    nrrd.write(str(tmp_path / "b.nhdr"), volume.values.T, header)
    if encoding == "raw":
        same(tmp_path / "b.nhdr", volume, expected)


@pytest.mark.parametrize("ending", [".mha", ".mhd", ".nrrd", ".nii.gz"])
@pytest.mark.parametrize("compressed", [False, True])
@pytest.mark.interop
def test_simpleitk(ending, compressed, volume, expected, tmp_path):
    sitk = pytest.importorskip("SimpleITK")
    made = sitk.GetImageFromArray(volume.values)
    made.SetSpacing(EDGES)
    made.SetOrigin(ORIGIN)
    made.SetDirection(rotation().ravel().tolist())
    sitk.WriteImage(made, str(tmp_path / f"a{ending}"), compressed)
    same(tmp_path / f"a{ending}", volume, expected, exact=ending != ".nii.gz")


@pytest.mark.parametrize("mode", VTK_MODES, ids=str)
@pytest.mark.interop
def test_vtk(mode, volume, expected, tmp_path):
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
    same(tmp_path / "a.vti", volume, expected)


def test_a_mirrored_reading_looks_different(volume, expected):
    """The image tells places apart: what `same` compares can fail."""
    flipped = Volume(volume.values, volume.in_space("RAS").world_from_voxel)
    assert not np.array_equal(image_of(flipped), expected)
    turned = Volume(volume.values[:, ::-1].copy(), volume.world_from_voxel)
    changed = np.abs(image_of(turned).astype(int) - expected).max(axis=2) > 4
    assert changed.mean() > 0.02


def test_a_place_that_no_scanner_has(tmp_path):
    path = tmp_path / "far.mha"
    gb.write_volume(path, gb.Volume(np.ones((3, 3, 3), np.uint8), np.eye(4)))
    data = path.read_bytes()
    spacing = b"ElementSpacing = 1.0 1.0 1.0"
    assert spacing in data
    path.write_bytes(data.replace(spacing, b"ElementSpacing = 1e300 1 1"))
    with pytest.raises(ValueError, match=r"far\.mha: geometry: expected voxels and places up to"):
        gb.read_volume(path)
