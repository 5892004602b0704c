"""`globule reconstruct`, and what info and convert do with sweeps and volumes."""

import re
from pathlib import Path

import globule as gb
import numpy as np
import pytest
from cli_helpers import output_of, refused, run_json
from globule.cli import main
from globule.ultrasound.calibration import Calibration, write_calibration
from globule.volumes.files import read_volume
from PIL import Image
from sweep_helpers import same, small_sweep, spine_data

CPU = ["--device", "cpu"]
pytestmark = pytest.mark.usefixtures("folder")


def test_a_volume_and_its_figures(sweep, capsys):
    words = ["reconstruct", "phantom.igs.mha", "-o", "v.npz", "--voxel-size", "1", *CPU]
    out, err = output_of(capsys, *words)
    assert re.match(r"v\.npz: .*24 frames.*measured", out, re.DOTALL)
    assert err == ""
    facts = run_json(capsys, *words, "--three-view", "v.png")
    volume = read_volume("v.npz")
    counts = facts["counts"]
    assert facts["volume"]["size"] == list(volume.values.shape[::-1])
    assert {"measured": volume.n_measured, "filled": volume.n_filled}.items() <= counts.items()
    assert counts["measured"] + counts["filled"] + counts["empty"] == volume.values.size
    assert set(facts["times"]) == {"read", "reconstruct", "write", "total"}
    assert (facts["frames"]["used"], facts["method"]) == (24, "frames")
    assert Image.open("v.png").size[0] > 50
    low, high = sweep.bounds()
    origin = volume.world_from_voxel[:3, 3]
    assert (np.abs(origin - low) <= 1).all()
    far = origin + (np.array(volume.values.shape[::-1]) - 1) * volume.spacing
    assert (far >= high - 1).all()


def test_plus_exact(capsys):
    data = spine_data()
    words = [str(data / "SpinePhantomFreehand.igs.mha"), "--plus", str(data / "NNLATE.xml")]
    facts = run_json(capsys, "reconstruct", *words, "-o", "v.mha", *CPU)
    assert facts["method"] == "plus"
    ours, theirs = read_volume("v.mha"), read_volume(data / "NNLATE.reference.mha")
    assert np.array_equal(ours.values, theirs.values)
    assert np.abs(ours.world_from_voxel - theirs.world_from_voxel).max() < 5e-4


@pytest.mark.slow
def test_cross_validation(sweep, capsys):
    words = ["phantom.igs.mha", "--cross-validate", "4", "--voxel-size", "0.8", *CPU]
    facts = run_json(capsys, "reconstruct", *words)
    assert set(facts["cross_validation"]) == {"frames", "pvn-om", "vvn-om", "bezier"}
    for result in facts["cross_validation"].values():
        assert result["n_frames"] == 22
        assert 0.5 < result["coverage"] <= 1
        assert 0 < result["mean_error"] < result["rms_error"] < 60
    out = output_of(capsys, "reconstruct", *words, "--method", "vvn-om").out
    assert out.count("\n") == 1
    assert "vvn-om" in out
    assert "22 frames left out" in out


def test_jumping_poses_are_left_out_with_a_warning(sweep, capsys):
    sweep.world_from_image[11, :3, 3] += 60
    gb.ultrasound.write_sweep("jump.npz", sweep)
    words = ["reconstruct", "jump.npz", "-o", "v.npz", "--voxel-size", "2", *CPU]
    assert "frame 11: the pose jumps by 105 mm" in output_of(capsys, *words).err
    assert run_json(capsys, *words)["frames"]["outliers"] == [11]
    assert run_json(capsys, *words, "--keep-outliers")["frames"]["used"] == 24


def test_a_step_and_a_probe_at_rest(sweep, capsys):
    """No frame is lost, and the step is said."""
    sweep.world_from_image[12:, :3, 3] += 300
    gb.ultrasound.write_sweep("step.npz", sweep)
    words = ["reconstruct", "step.npz", "-o", "v.npz", "--voxel-size", "4", *CPU]
    facts = run_json(capsys, *words)
    assert facts["frames"]["used"] == 24
    assert "frames 11 to 12: the pose steps by 52" in facts["warnings"][0]
    rest = small_sweep(30)
    rest.world_from_image[:18] = rest.world_from_image[18]
    rest.frames[:18] = rest.frames[18]
    gb.ultrasound.write_sweep("rest.npz", rest)
    facts = run_json(capsys, "reconstruct", "rest.npz", "-o", "v.npz", "--voxel-size", "1", *CPU)
    assert (facts["frames"]["used"], facts["warnings"]) == (30, [])
    assert facts["poses"] == ["frames 0 to 18: one pose in all frames"]
    assert facts["volume"]["size"][2] > 3


def test_a_stack_with_poses(capsys):
    made = small_sweep(12)
    gb.ultrasound.write_sweep("frames", made)
    Path("frames/poses.csv").rename("poses.csv")
    words = ["frames", "--poses", "poses.csv", "-o", "v.npz", "--voxel-size", "2", *CPU]
    assert run_json(capsys, "reconstruct", *words, "--keep-outliers")["frames"]["used"] == 12


def test_mistakes_get_one_line(sweep, capsys):
    write_calibration("probe.toml", Calibration(np.diag([0.1, 0.1, 0.1, 1])))
    Path("singular.toml").write_text("probe_from_image = [[0,0,0,0],[0,0,0,0],[0,0,0,0],[0,0,0,1]]", encoding="utf-8")
    Path("broken.igs.mha").write_bytes(Path("phantom.igs.mha").read_bytes()[:20000])
    lost = small_sweep(valid=[False] * 5)
    gb.ultrasound.write_sweep("lost.npz", lost)
    sweep, out = "phantom.igs.mha", ("-o", "v.nrrd")
    for words, what in [
        ([], "SWEEP"),
        ([sweep], "-o"),
        ([sweep, "-o", "v.stl"], "v.stl"),
        ([sweep, "-o", "no/v.nrrd"], "no"),
        (["nowhere.igs.mha", *out], "nowhere"),
        (["broken.igs.mha", *out], "broken.igs.mha"),
        (["lost.npz", *out], "lost.npz"),
        ([sweep, *out, "--calibration", "nowhere.toml"], "nowhere.toml"),
        ([sweep, *out, "--calibration", "singular.toml"], "singular"),
        ([sweep, *out, "--calibration", "probe.toml"], "a way from Image"),
        ([sweep, *out, "--plus", "probe.toml"], "probe.toml"),
        ([sweep, *out, "--image-region", "1,2"], "--image-region: expected 4"),
        ([sweep, *out, "--image-region", "900,0,5,5"], "region"),
        ([sweep, *out, "--bounds", "1,1,1,0,0,0"], "--bounds: expected two"),
        ([sweep, *out, "--voxel-size", "1", "--voxels", "9"], "--voxels"),
        ([sweep, *out, "--max-kernel", "4"], "--max-kernel"),
        ([sweep, *out, "--voxel-size", "0.0001"], "--voxel-size: 5"),
        ([sweep, *out, "--three-view", "v.bmp"], "--three-view"),
        ([sweep, "-o", f"./{sweep}"], "-o: expected a name of its own"),
        ([sweep, *out, "--surface-image", "a.png", "--three-view", "a.png"], "a name of its own"),
        ([sweep, "--cross-validate", "1"], "--cross-validate"),
        ([sweep, "--cross-validate", "20"], "at most half"),
        ([sweep, *out, "--voxel-size", "1e6"], "smaller than the sweep"),
        ([sweep, *out, "--temporal-offset", "900"], "offset of +900 s"),
        (["--live", "igtl://127.0.0.1:1", *out, "--idle", "0.3"], "expected a server"),
        (["--live", "http://x", *out], "igtl://host:port"),
        ([sweep, "--live", "igtl://h", *out], "both"),
        ([sweep, "--record", "kept", *out], "--record"),
    ]:
        assert what in refused(capsys, "reconstruct", *words, *CPU), words


def test_info_of_a_sweep(sweep, capsys):
    out = output_of(capsys, "info", "phantom.igs.mha").out
    assert "24 frames of 64x60" in out
    assert "Reference" in out
    facts = run_json(capsys, "info", "phantom.igs.mha")
    assert facts["kind"] == "sweep"
    assert facts["frames"] == facts["valid"] == 24
    assert facts["spacing"] == pytest.approx([0.8, 0.8])
    assert facts["outliers"] == []
    sweep.world_from_image[10, :3, 3] += 60
    gb.ultrasound.write_sweep("jump.npz", sweep)
    assert run_json(capsys, "info", "jump.npz")["outliers"] == [10]
    assert "frame 10: the pose jumps by 105 mm" in output_of(capsys, "info", "jump.npz").out


def test_convert_sweeps_and_volumes(sweep, capsys):
    for name in ("a.igs.nrrd", "b.npz", "c.igs.mha"):
        assert main(["convert", "phantom.igs.mha", name]) == 0
        assert same(sweep, gb.ultrasound.read_sweep(name))
    capsys.readouterr()
    words = ["reconstruct", "b.npz", "-o", "v.sparse.npz", "--voxels", "24"]
    size = run_json(capsys, *words, *CPU)["volume"]["size"]
    assert max(size) == 24
    about = run_json(capsys, "info", "v.sparse.npz")
    assert main(["convert", "v.sparse.npz", "w.nrrd"]) == 0
    assert np.array_equal(read_volume("v.sparse.npz").values, read_volume("w.nrrd").values)
    assert (about["kind"], about["size"]) == ("volume", size)
    capsys.readouterr()
    refused(capsys, "convert", "w.nrrd", "w.igs.mha")
    refused(capsys, "convert", "a.igs.nrrd", "w.nii")


def test_a_recording_without_calibration(capsys):
    data = spine_data()
    source, plus = data / "SpinePhantomFreehand.igs.mha", data / "NNMEAN.xml"
    facts = run_json(capsys, "info", str(source))
    assert (facts["kind"], facts["frames"], facts["spacing"]) == ("sweep", 21, None)
    assert facts["transforms"] == ["ProbeToTracker", "ReferenceToTracker", "StylusToTracker"]
    assert main(["convert", str(source), "a.igs.nrrd"]) == 0
    assert same(gb.ultrasound.read_sweep(source, plus=plus), gb.ultrasound.read_sweep("a.igs.nrrd", plus=plus))
    capsys.readouterr()
    assert "calibration" in refused(capsys, "convert", "a.igs.nrrd", "a.npz")


def test_convert_a_volume_to_a_picture_and_with_its_maps(sweep, capsys):
    words = ["reconstruct", "phantom.igs.mha", "-o", "v.npz", "--voxel-size", "1", "--maps", *CPU]
    assert main([*words, "--three-view", "v.png"]) == 0
    assert main(["convert", "v.npz", "w.png"]) == 0
    assert np.array_equal(np.asarray(Image.open("v.png")), np.asarray(Image.open("w.png")))
    assert main(["convert", "v.npz", "w.vti"]) == 0
    assert np.array_equal(read_volume("v.npz").count, read_volume("w.vti").count)
