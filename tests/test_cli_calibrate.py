"""`globule calibrate`: marks and poses in, a calibration out that `reconstruct` takes."""

from pathlib import Path

import numpy as np
import pytest
from cli_helpers import output_of, refused, run_json
from globule.cli import main
from globule.formats.sweeps import igs
from globule.formats.sweeps.transforms import format_matrix
from globule.ultrasound.calibration import Calibration, read_calibration, write_calibration
from PIL import Image
from sweep_helpers import calibration_data
from test_calibration import TARGET, TRUTH, images_to_and_fro, observations, small_turns, to_and_fro

pytestmark = pytest.mark.usefixtures("folder")
POSE = [f"m{row}{column}" for row in range(3) for column in range(4)]


def write_marks(pixels, poses, name: str = "marks.csv") -> None:
    rows = [",".join(["column", "row", *POSE])]
    for (column, row), pose in zip(pixels, poses, strict=True):
        numbers = [column, row, *pose[:3].ravel()]
        rows.append(",".join(repr(float(number)) for number in numbers))
    Path(name).write_text("\n".join(rows) + "\n", encoding="utf-8")


def write_recording(poses, frames=None, times=None) -> None:
    """A PLUS file wires.igs.mha of frames that know their probe's pose."""
    n = len(poses)
    frames = np.zeros((n, 4, 5), np.uint8) if frames is None else frames
    times = np.arange(n) / 20 if times is None else times
    fields = [
        {
            "ProbeToTrackerTransform": format_matrix(pose),
            "ProbeToTrackerTransformStatus": "OK" if np.isfinite(pose).all() else "INVALID",
            "Timestamp": repr(float(time)),
        }
        for pose, time in zip(poses, times, strict=True)
    ]
    for field in fields:
        field["ProbeToTrackerTransform"] = field["ProbeToTrackerTransform"].replace("nan", "0")
    ok = np.ones(n, bool)
    igs.write("wires.igs.mha", igs.Recording(frames, times, {}, ok, {}, fields))


def report(capsys, *words: str) -> dict:
    return run_json(capsys, "calibrate", *words)


def test_marks_with_poses(capsys):
    write_marks(*observations(12))
    facts = report(capsys, "marks.csv", "-o", "probe.toml")
    assert len(facts["residuals"]) == 12
    assert max(facts["residuals"]) < 1e-6
    assert facts["target"] == pytest.approx(TARGET)
    assert facts["warnings"] == []
    assert np.allclose(read_calibration("probe.toml").probe_from_image, TRUTH, atol=1e-7)
    assert "12 marks: rms 0.000 mm" in output_of(capsys, "calibrate", "marks.csv").out


def test_marks_in_a_recording(capsys):
    pixels, poses = observations(12)
    write_recording(np.concatenate([poses[::-1], np.full((1, 4, 4), np.nan)]))
    lines = [f"{11 - i},{x!r},{y!r}" for i, (x, y) in enumerate(pixels.tolist())]
    Path("marks.csv").write_text("\n".join(["frame,column,row", *lines]) + "\n", encoding="utf-8")
    words = ["marks.csv", "--sweep", "wires.igs.mha"]
    write_calibration("old.toml", Calibration(np.eye(4), -0.25, (1, 1, 3, 2)))
    facts = report(capsys, *words, "-o", "probe.toml", "--calibration", "old.toml")
    assert facts["rms"] < 1e-6
    found = read_calibration("probe.toml")
    assert np.allclose(found.probe_from_image, TRUTH, atol=1e-7)
    assert (found.temporal_offset, found.clip) == (-0.25, (1, 1, 3, 2))
    for row, what in (("12,3,4", "valid pose"), ("13,3,4", "frame of 0 to 12"),
                      ("1.5,3,4", "frame"), ("1,3", "row 14"), ("1,x,3", "number")):  # fmt: skip
        Path("marks.csv").write_text("\n".join(["frame,column,row", *lines, row]) + "\n", encoding="utf-8")
        error = refused(capsys, "calibrate", *words)
        assert what in error
        assert "row 14" in error


def test_a_wrong_mark_is_named(capsys):
    pixels, poses = observations(30, noise=1.0)
    pixels[7] += 90
    write_marks(pixels, poses)
    facts = report(capsys, "marks.csv")
    assert "mark 8 (" in facts["warnings"][0]
    assert int(np.argmax(facts["residuals"])) == 7


def test_marks_that_do_not_determine_the_calibration(capsys):
    write_marks(*small_turns(30, 1, 0, 0.2))
    assert "an error of at most 2 mm" in refused(capsys, "calibrate", "marks.csv", "-o", "probe.toml")
    facts = report(capsys, "marks.csv", "-o", "probe.toml", "--max-error", "50")
    assert max(facts["corner_errors"]) > 2
    assert read_calibration("probe.toml").error == max(facts["corner_errors"])


def recording_with_delay(late: float) -> None:
    """Where the image is, the tracker says `late` afterwards."""
    times = np.arange(200) / 25
    tracked = np.tile(np.eye(4), (len(times), 1, 1))
    tracked[:, 2, 3] = to_and_fro(times - late)
    write_recording(tracked, images_to_and_fro(times), times)


def test_delay(capsys):
    recording_with_delay(0.1)
    write_calibration("old.toml", Calibration(TRUTH, clip=(1, 1, 9, 9)))
    words = ["--delay", "--sweep", "wires.igs.mha"]
    facts = report(capsys, *words, "--calibration", "old.toml", "-o", "new.toml")
    assert facts["temporal_offset"]["offset"] == pytest.approx(0.1, abs=0.015)
    found = read_calibration("new.toml")
    assert found.temporal_offset == facts["temporal_offset"]["offset"]
    assert np.array_equal(found.probe_from_image, TRUTH)
    assert found.clip == (1, 1, 9, 9)


@pytest.mark.slow
def test_delay_of_a_water_tank(capsys):
    """PLUS finds -0.0648 s, in a sawtooth of 0.09 s. By speckle it is uncertain: not written."""
    sweep = str(calibration_data() / "WaterTankBottomTranslationCombined.igs.mha")
    write_calibration("old.toml", Calibration(TRUTH))
    words = ["--delay", "--sweep", sweep, "--calibration", "old.toml", "-o", "new.toml"]
    facts = report(capsys, *words)["temporal_offset"]
    assert facts["offset"] == pytest.approx(-0.0648, abs=0.005)
    assert facts["method"] == "line"
    assert facts["correlation"] > 0.95
    assert abs(facts["offset"] + 0.0648) < 2 * facts["uncertainty"] < 0.01
    assert facts["beat_extent"] == pytest.approx(0.09, abs=0.015)
    assert facts["beat_period"] == pytest.approx(7.6, abs=0.5)
    assert read_calibration("new.toml").temporal_offset == facts["offset"]
    words = ["--delay", "--sweep", sweep, "--calibration", "old.toml", "--motion", "speckle"]
    assert "uncertain" in report(capsys, *words)["warnings"][0]
    error = refused(capsys, "calibrate", *words, "-o", "speckle.toml")
    assert "speckle.toml was not written" in error
    assert "uncertain" in error


@pytest.mark.slow
def test_pictures(capsys):
    pytest.importorskip("matplotlib")
    recording_with_delay(0.1)
    write_marks(*observations(30, noise=1.0))
    for words in (["--delay", "--sweep", "wires.igs.mha"], ["marks.csv"]):
        assert main(["calibrate", *words, "--picture", "p.png"]) == 0
        picture = np.asarray(Image.open("p.png").convert("RGB"), int)
        for color in ((0x1F, 0x6F, 0xB2), (0xE0, 0x86, 0x1A)):  # image or bars; probe or left out
            assert (np.abs(picture - color).max(axis=2) < 40).sum() > 150


@pytest.mark.parametrize(("words", "what"), [
    ([], "MARKS"),
    (["nowhere.csv"], "nowhere.csv"),
    (["marks.toml"], "marks.toml"),
    (["few.csv"], "N >= 6"),
    (["empty.csv"], "columns column row"),
    (["poses.csv"], "columns x y z"),
    (["--delay"], "--sweep"),
    (["few.csv", "--poses", "few.csv"], "--poses"),
    (["few.csv", "-o", "probe.json"], "-o"),
    (["--delay", "--sweep", "few.csv"], "few.csv"),
    (["--delay", "--sweep", "few.csv", "-o", "p.toml"], "-o"),
    (["--delay", "--sweep", "still.igs.mha"], "still.igs.mha"),
])  # fmt: skip
def test_mistakes(words, what, capsys):
    write_marks(*(a[:5] for a in observations(12)), "few.csv")
    Path("empty.csv").write_text("", encoding="utf-8")
    Path("poses.csv").write_text("column,row\n1,2\n", encoding="utf-8")
    assert what in refused(capsys, "calibrate", *words)
