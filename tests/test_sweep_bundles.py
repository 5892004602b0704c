"""Scenes of 3D Slicer (.mrb) and recordings of Stradwin (.sw, .sxi)."""

import os
import re
import zipfile
from pathlib import Path

import globule as gb
import numpy as np
import pytest
from globule.formats.errors import FormatError
from globule.formats.kind import kind_of
from globule.formats.sweeps.transforms import format_matrix
from globule.ultrasound.calibration import Calibration
from globule.ultrasound.files import read_sweep
from scipy.spatial.transform import Rotation
from sweep_helpers import random_poses

pytestmark = pytest.mark.usefixtures("folder")
N, HEIGHT, WIDTH = 6, 10, 14
FRAMES = np.random.default_rng(4).integers(0, 255, (N, HEIGHT, WIDTH), np.uint8)
TIMES = 100 + np.arange(N) / 30
LPS_FROM_RAS = np.diag([-1.0, -1.0, 1.0, 1.0])


def refused(path, **options) -> str:
    with pytest.raises(FormatError) as error:
        read_sweep(path, **options)
    assert str(error.value).startswith(f"{path}: ")
    assert "\n" not in str(error.value)
    return str(error.value)


def sequence(name, frames=FRAMES, space="right-anterior-superior", step=1.0, times=TIMES, first=False) -> None:
    """A sequence of images as Slicer writes it, by pynrrd; the list of items is its last axis, or
    its first."""
    nrrd = pytest.importorskip("nrrd", reason="needs pynrrd")
    array, axis = frames.transpose(2, 1, 0)[:, :, None], 3  # i, j, k, list
    kinds, labels = ["domain", "domain", "domain", "list"], ["", "", "", "time"]
    steps = [[step, 0, 0], [0, step, 0], [0, 0, 1], [np.nan] * 3]
    if first:
        array, axis = np.moveaxis(array, 3, 0), 0
        kinds, steps, labels = (one[3:] + one[:3] for one in (kinds, steps, labels))
    header = {
        "kinds": kinds, "labels": labels, "space": space, "space directions": np.array(steps),
        "space origin": [0, 0, 0], f"axis {axis} index type": "numeric",
        f"axis {axis} index values": " ".join(repr(float(t)) for t in times),
        "DataNodeClassName": "vtkMRMLScalarVolumeNode",
    }  # fmt: skip
    nrrd.write(name, array, header)


def transforms(name, key, matrices, times, bad=()) -> None:
    """A sequence of transforms as vtkMRMLLinearTransformSequenceStorageNode writes it."""
    lines = [
        "ObjectType = Image", "NDims = 3", "AnatomicalOrientation = RAI", "BinaryData = True",
        "CompressedData = False", f"DimSize = 0 0 {len(matrices)}", "ElementSpacing = 1 1 1",
        "Offset = 0 0 0", "TransformMatrix = 1 0 0 0 1 0 0 0 1", "ElementType = MET_UCHAR",
        "Kinds = domain domain list",
    ]  # fmt: skip
    for i, (matrix, time) in enumerate(zip(matrices, times, strict=True)):
        place = f"Seq_Frame{i:04d}"
        lines.append(f"{place}_{key}Transform ={format_matrix(matrix)}")
        lines.append(f"{place}_{key}TransformStatus = {'INVALID' if i in bad else 'OK'}")
        lines.append(f"{place}_Timestamp = {float(time)!r}")
    Path(name).write_text("\n".join([*lines, "ElementDataFile = LOCAL"]))


def scene(name, *members, single="") -> None:
    text = f'<?xml version="1.0"?>\n<MRML version="Slicer 5">\n{single}\n</MRML>\n'
    with zipfile.ZipFile(name, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("Scan/Scan.mrml", text)
        for member in members:
            archive.write(member, f"Scan/Data/{member}")


def whole(name="scan.mrb", **options) -> np.ndarray:
    """A scene with images at ImageToReference; the poses, (N, 4, 4), RAS."""
    poses = random_poses(N, 5) @ np.diag([0.2, 0.2, 0.2, 1])
    sequence("Image-Sequence.seq.nrrd", **options)
    transforms("ImageToReference-Sequence.seq.mha", "ImageToReference", poses, TIMES)
    scene(name, "Image-Sequence.seq.nrrd", "ImageToReference-Sequence.seq.mha")
    return poses


def test_a_scene_of_slicer_and_the_place_of_the_image():
    poses = whole()
    assert kind_of("scan.mrb") == ("sweep", "mrb")
    sweep = read_sweep("scan.mrb")
    assert np.array_equal(sweep.frames, FRAMES)
    np.testing.assert_allclose(sweep.timestamps, TIMES)
    np.testing.assert_allclose(sweep.world_from_image, poses, atol=1e-12)
    assert (sweep.space, sweep.world) == ("RAS", "Reference")
    os.rename("scan.mrb", "renamed.zip")
    assert np.array_equal(gb.ultrasound.read_sweep("renamed.zip").frames, FRAMES)
    poses = whole(space="left-posterior-superior", step=0.5)
    expected = poses @ LPS_FROM_RAS @ np.diag([0.5, 0.5, 1, 1])
    np.testing.assert_allclose(read_sweep("scan.mrb").world_from_image, expected, atol=1e-12)


def test_a_probe_a_calibration_and_other_times():
    """Poses of the probe at 60 Hz, a calibration in the scene; one of them is not known."""
    calibration = np.diag([0.2, 0.2, 0.2, 1.0])
    calibration[:3, 3] = 3, -4, 5
    when = 99.9 + np.arange(40) / 60
    poses = np.tile(np.eye(4), (len(when), 1, 1))
    poses[:, 2, 3] = 30 * (when - 100)  # mm along z at 30 mm/s
    sequence("Image.seq.nrrd")
    transforms("Probe.seq.mha", "ProbeToReference", poses, when, bad=(39,))
    single = (
        '<LinearTransform id="vtkMRMLLinearTransformNode4" name="ImageToProbe" '
        f'matrixTransformToParent="{format_matrix(calibration)}"/>'
    )
    scene("scan.mrb", "Image.seq.nrrd", "Probe.seq.mha", single=single)
    sweep, expected = read_sweep("scan.mrb"), np.tile(calibration, (N, 1, 1))
    expected[:, 2, 3] += 30 * (TIMES - 100)
    np.testing.assert_allclose(sweep.world_from_image, expected, atol=1e-9)
    own = Calibration(np.diag([0.3, 0.3, 0.3, 1.0]))
    scales = np.linalg.norm(read_sweep("scan.mrb", own).world_from_image[:, :3, 0], axis=1)
    np.testing.assert_allclose(scales, 0.3)  # the calibration given here replaces the scene's
    scene("none.mrb", "Image.seq.nrrd", "Probe.seq.mha")
    assert "ProbeToReference; give a calibration" in refused("none.mrb")


def test_scenes_that_cannot_be_read():
    whole()
    sequence("Other.seq.nrrd")
    scene("two.mrb", "Image-Sequence.seq.nrrd", "Other.seq.nrrd")
    assert "expected one sequence of images (.seq.nrrd) in the scene, got" in refused("two.mrb")
    scene("empty.mrb")
    assert "got none" in refused("empty.mrb")
    transforms("Named.seq.mha", "LinearTransform_4", np.eye(4)[None], [100])
    scene("named.mrb", "Image-Sequence.seq.nrrd", "Named.seq.mha")
    assert "expected a way from Image" in refused("named.mrb")
    Path("bad.seq.mha").write_text("Seq_Frame0000_ImageToReferenceTransform = 1 2\n")
    scene("bad.mrb", "Image-Sequence.seq.nrrd", "bad.seq.mha")
    assert "bad.seq.mha, item 0: expected a time and 16 numbers" in refused("bad.mrb")
    transforms("Few.seq.mha", "ImageToReference", np.full((N, 4, 4), np.nan), TIMES)
    scene("nan.mrb", "Image-Sequence.seq.nrrd", "Few.seq.mha")
    assert "expected a frame with image and pose OK, got none" in refused("nan.mrb")
    with zipfile.ZipFile("scan.mrb", "a", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("Scan/Data/bomb.mha", bytes(200 * 2**20))
    assert "times the" in refused("scan.mrb")


def stradwin(name="scan", moves=None, frames=FRAMES, without="", **fields) -> np.ndarray:
    """A recording; world from pixel by SciPy's rotations, (N, 4, 4), mm."""

    def rigid(move):
        matrix = np.eye(4)
        matrix[:3, :3] = Rotation.from_euler("ZYX", move[3:], degrees=True).as_matrix()
        matrix[:3, 3] = 10 * np.array(move[:3])
        return matrix

    rng = np.random.default_rng(6)
    if moves is None:
        moves = np.hstack([rng.uniform(-9, 9, (N, 3)), rng.uniform(-80, 80, (N, 3))])
    own = (0.3, -1.2, 4.5, 10.0, -20.0, 30.0)
    names = ("RES_XTRANS", "RES_YTRANS", "RES_ZTRANS", "RES_AZIMUTH", "RES_ELEVATION", "RES_ROLL")
    settings = {
        "RES_BUF_FRAMES": len(frames), "RES_BUF_WIDTH": WIDTH, "RES_BUF_HEIGHT": HEIGHT,
        "RES_POS_REC": "true", "RES_BUF_RF": "false", "RES_BUF_DOPPLER": "false",
        "RES_BIN_IM_FILENAME": f"{name}.sxi", "RES_XSCALE": 0.02, "RES_YSCALE": 0.03,
        **dict(zip(names, own, strict=True)), **fields,
    }  # fmt: skip
    settings.pop(without, None)
    lines = ["A comment", *(f"{key} {value}" for key, value in settings.items())]
    lines += [f"IM {0.04 * i!r} " + " ".join(repr(float(value)) for value in move) for i, move in enumerate(moves)]
    Path(f"{name}.sw").write_text("\n".join(lines) + "\n")
    Path(f"{name}.sxi").write_bytes(frames.tobytes())
    pixel = np.diag([0.2, 0.3, 1, 1])  # mm
    pixel[:2, 3] = 0.1, 0.15  # the middle of the first pixel lies half a pixel from the corner
    return np.stack([rigid(move) @ rigid(own) @ pixel for move in moves])


def test_a_recording_of_stradwin_and_frames_without_a_position():
    poses = stradwin()
    assert kind_of("scan.sw") == ("sweep", "stradwin")
    sweep = read_sweep("scan.sw")
    assert np.array_equal(sweep.frames, FRAMES)
    np.testing.assert_allclose(sweep.world_from_image, poses, atol=1e-12)
    np.testing.assert_allclose(sweep.timestamps, 0.04 * np.arange(N))
    own = Calibration(np.diag([0.5, 0.5, 0.5, 1.0]))
    scales = np.linalg.norm(read_sweep("scan.sw", own).world_from_image[:, :3, 0], axis=1)
    np.testing.assert_allclose(scales, 0.5)  # the calibration given here replaces the recording's
    os.rename("scan.sw", "scan.txt")  # the content tells
    assert np.array_equal(read_sweep("scan.txt").frames, FRAMES)
    moves = np.zeros((N, 6))
    moves[:, 2] = np.arange(N)
    moves[3] = np.nan
    stradwin(moves=moves)
    assert read_sweep("scan.sw").valid.tolist() == [True, True, True, False, True, True]


@pytest.mark.parametrize(("fields", "problem"), [
    ({"RES_BUF_RF": "true"}, "RES_BUF_RF: expected false, got true; save the recording as B-s"),
    ({"RES_BUF_DICOM": "true"}, "the images are in DICOM files"),
    ({"RES_INVERT_BSCAN": "true"}, "probe at the top"),
    ({"RES_POS_REC": "false"}, "expected positions with the images, got none"),
    ({"RES_BUF_FRAMES": 7}, "expected a line for each of 7 frames, got 6"),
    ({"RES_BUF_WIDTH": 0}, "RES_BUF_WIDTH: expected a number from 1, got '0'"),
    ({"RES_BUF_WIDTH": 15}, "expected 900 bytes of gray images, got 840 bytes in 'scan.sxi'"),
    ({"RES_XSCALE": 0}, "expected cm per pixel above 0"),
    ({"RES_XSCALE": "nan"}, "RES_XSCALE: expected a number, got 'nan'"),
    ({"RES_ROLL": "a"}, "RES_ROLL: expected a number, got 'a'"),
    ({"RES_BIN_IM_FILENAME": "gone.sxi"}, "got no file 'gone.sxi'"),
    ({"without": "RES_YSCALE"}, "RES_YSCALE: expected a number, got ''"),
    ({"moves": np.zeros((N, 5))}, "expected IM time x y z azimuth elevation roll"),
])  # fmt: skip
def test_what_stradwin_reads_otherwise_is_refused(fields, problem):
    if "moves" in fields:
        stradwin()
        text = Path("scan.sw").read_text()
        Path("scan.sw").write_text(re.sub(r"(IM .*) \S+\n", r"\1\n", text))
    else:
        stradwin(**fields)
    assert problem in refused("scan.sw")


def test_another_folder_is_never_looked_into_and_pixels_alone_are_refused():
    """Only the name of the .sxi counts."""
    stradwin(RES_BIN_IM_FILENAME="../../scan.sxi")
    assert np.array_equal(read_sweep("scan.sw").frames, FRAMES)
    assert "expected the .sw of the recording" in refused("scan.sxi")
    Path("scan.sw").unlink()
    assert "expected the .sw of the recording" in refused("scan.sxi")
