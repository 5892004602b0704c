"""Tracked sweeps: files, poses between times, regions, and what is refused."""

import json
import re
import warnings
import zlib
from pathlib import Path

import globule as gb
import numpy as np
import pytest
from globule.cli import main
from globule.formats.errors import FormatError
from globule.formats.sweeps import igs
from globule.formats.sweeps.poses import PoseTable, interpolate, read_poses, write_csv
from globule.formats.sweeps.transforms import format_matrix
from globule.formats.volumes import nrrd
from globule.ultrasound.calibration import Calibration, write_calibration
from globule.ultrasound.files import is_sweep, read_sweep
from globule.ultrasound.marks import read_tracked
from globule.ultrasound.region import Clip, Fan, region_mask
from globule.ultrasound.sweep import Sweep
from globule.ultrasound.sweep_writing import write_sweep
from PIL import Image
from scipy.spatial.transform import Rotation
from sweep_helpers import random_poses, same, small_sweep, spine_data, write_recording

pytestmark = pytest.mark.usefixtures("folder")
PIXEL = np.diag([0.5, 0.25, 0.3, 1.0])  # probe_from_image


def refused(*args, **kwargs) -> str:
    with pytest.raises((ValueError, TypeError)) as caught:
        read_sweep(*args, **kwargs)
    text = str(caught.value)
    assert "\n" not in text
    assert "expected" in text
    assert len(text) < 500
    return text


def test_real_sweep_and_its_exact_round_trip():
    data = spine_data()
    sweep = read_sweep(data / "SpinePhantomFreehand.igs.mha", plus=data / "NNMEAN.xml")
    assert (sweep.frames.shape, sweep.frames.dtype) == ((21, 616, 820), np.uint8)
    assert sweep.valid.all()
    assert (sweep.mask, sweep.world) == (None, "Reference")
    # The published reference volume starts where the lowest corner of all frames lies.
    low, high = sweep.bounds()
    assert low == pytest.approx([-74.5217, 165.573, 29.072], abs=5e-4)  # six digits
    assert np.rint((high - low) / 0.5 + 1).tolist() == [147, 106, 105]
    assert sweep.spacing == pytest.approx((0.08542, 0.07900), abs=1e-5)
    fan = read_sweep(data / "SpinePhantomFreehand.igs.mha", plus=data / "NNLATE.xml")
    assert np.flatnonzero(fan.mask.any(axis=1))[0] >= 16
    assert 0.1 < fan.mask.mean() < 0.5
    for name in ("a.igs.nrrd", "a.npz", "folder", "a.igs.mha"):
        part = sweep if name == "a.igs.mha" else sweep[:2]
        write_sweep(name, part)
        assert same(part, read_sweep(name)), name
        assert is_sweep(name)
    write_sweep("b.igs.mha", read_sweep("a.igs.mha"))
    assert Path("a.igs.mha").read_bytes() == Path("b.igs.mha").read_bytes()
    # Nothing the file said is lost or altered.
    assert header(data / "SpinePhantomFreehand.igs.mha").items() <= header("a.igs.mha").items()


def header(path) -> dict[str, str]:
    text = Path(path).read_bytes().split(b"ElementDataFile")[0].decode()
    pairs = (line.split("=", 1) for line in text.splitlines())
    return {name.strip(): value.strip() for name, value in pairs}


def test_changed_poses_and_statuses_are_what_is_written():
    edges = {"ProbeToTracker": random_poses(4, 1), "ReferenceToTracker": random_poses(4, 2)}
    write_igs("a.igs.mha", edges)
    sweep = read_sweep("a.igs.mha", calibration=Calibration(PIXEL))
    expected = np.linalg.inv(edges["ReferenceToTracker"]) @ edges["ProbeToTracker"] @ PIXEL
    assert np.allclose(sweep.world_from_image, expected)
    write_sweep("b.igs.mha", sweep)
    fields = header("b.igs.mha")
    written = fields["Seq_Frame0001_ProbeToTrackerTransform"].split()
    assert written == [repr(number) for number in edges["ProbeToTracker"][1].ravel().tolist()]
    assert "Seq_Frame0001_ImageToReferenceTransform" not in fields  # PLUS allows one way only
    assert same(sweep, read_sweep("b.igs.mha"))
    sweep.valid[2] = False
    sweep.world_from_image[1, 0, 3] += 1
    write_sweep("c.igs.mha", sweep)
    assert same(sweep, read_sweep("c.igs.mha"))


def write_igs(path: str, edges: dict, n: int = 4, orientation: str = "MFA", **fields) -> np.ndarray:
    frames = np.arange(n * 15, dtype=np.uint8).reshape(n, 3, 5)
    lines = ["ObjectType = Image", "NDims = 3", f"DimSize = 5 3 {n}", "ElementType = MET_UCHAR",
             f"UltrasoundImageOrientation = {orientation}"]  # fmt: skip
    for i in range(n):
        for name, matrices in edges.items():
            numbers = " ".join(map(repr, np.asarray(matrices[i]).ravel().tolist()))
            lines.append(f"Seq_Frame{i:04d}_{name}Transform = {numbers}")
            lines.append(f"Seq_Frame{i:04d}_{name}TransformStatus = OK")
        lines.append(f"Seq_Frame{i:04d}_Timestamp = {i}")
    lines += [f"{name} = {value}" for name, value in fields.items()]
    text = "\n".join([*lines, "ElementDataFile = LOCAL\n"])
    Path(path).write_bytes(text.encode() + frames.tobytes())
    return frames


@pytest.mark.parametrize(
    ("orientation", "rows", "columns"),
    [("MFA", 1, 1), ("UFA", 1, -1), ("MN", -1, 1), ("UND", -1, -1), ("FM", 1, 1), ("NM", -1, 1), ("FUA", 1, -1)],
)
def test_orientation(orientation, rows, columns):
    stored = write_igs("a.mha", {"ImageToReference": [PIXEL] * 4}, orientation=orientation)
    sweep = read_sweep("a.mha")
    upright = stored.swapaxes(1, 2) if orientation[0] in "FN" else stored
    assert np.array_equal(sweep.frames, upright[:, ::rows, ::columns])
    write_sweep("b.mha", sweep)
    assert np.array_equal(read_sweep("b.mha").frames, sweep.frames)
    assert header("b.mha")["UltrasoundImageOrientation"] == orientation
    assert zlib.decompress(Path("b.mha").read_bytes().split(b"LOCAL\n", 1)[1]) == stored.tobytes()


def test_an_orientation_that_is_unknown_is_refused():
    """UNK begins as UN does."""
    for orientation in ("UNK", "XX", "MFX"):
        write_igs("a.mha", {"ImageToReference": [PIXEL] * 4}, orientation=orientation)
        with pytest.raises(FormatError, match=f"UltrasoundImageOrientation: expected .*, got '{orientation}'"):
            read_sweep("a.mha")


def tracker_buffer(name: str, tool: str, poses, times) -> None:
    """What PLUS records of a tracker alone: no pixels."""
    lines = ["ObjectType = Image", "NDims = 3", f"DimSize = 0 0  {len(poses)}", "ElementType = MET_OTHER",
             "UltrasoundImageOrientation = XX"]  # fmt: skip
    for i, (pose, time) in enumerate(zip(poses, times, strict=True)):
        lines += [f"Seq_Frame{i:04d}_{tool}ToTrackerTransform = {format_matrix(pose)}",
                  f"Seq_Frame{i:04d}_{tool}ToTrackerTransformStatus = OK",
                  f"Seq_Frame{i:04d}_ImageStatus = INVALID", f"Seq_Frame{i:04d}_Timestamp = {time}"]  # fmt: skip
    Path(name).write_text("\n".join([*lines, "ElementDataFile = LOCAL\n"]), encoding="utf-8")


def test_the_buffer_of_a_tracker_holds_poses_alone(capsys):
    poses = random_poses(6)
    tracker_buffer("probe.mha", "Probe", poses, np.arange(6) / 10)
    np.save("frames.npy", np.arange(24, dtype=np.uint8).reshape(2, 3, 4))
    calibration = Calibration(np.diag([0.5, 0.5, 0.5, 1.0]))
    sweep = read_sweep("frames.npy", calibration, poses="probe.mha", frame_times=[0.1, 0.3])
    assert np.allclose(sweep.world_from_image, poses[[1, 3]] @ calibration.probe_from_image)
    tracker_buffer("stylus.mha", "Stylus", poses, np.arange(6) / 10)
    tracked = read_tracked("stylus.mha", tool="Stylus")
    assert np.allclose(tracked.poses, poses)
    assert tracked.ok.all()
    fields = [line.replace(" = ", ":=", 1) for line in Path("probe.mha").read_text().splitlines() if "Frame" in line]
    about = ["NRRD0005", "type: uint8", "dimension: 3", "sizes: 0 0 6", "encoding: raw", *fields, "", ""]
    Path("probe.nrrd").write_text("\n".join(about), encoding="utf-8")
    assert np.array_equal(read_tracked("probe.nrrd").poses, read_tracked("probe.mha").poses)
    with pytest.raises(FormatError, match="poses alone"):
        read_sweep("probe.mha", calibration)
    assert main(["calibrate", "--delay", "--sweep", "probe.mha"]) == 2
    assert main(["info", "probe.nrrd"]) == 0
    assert capsys.readouterr().out.startswith("probe.nrrd: poses of 6 frames without images\n")
    with pytest.raises(FormatError, match="got a sweep"):
        gb.volumes.read_volume("probe.mha")


def test_words_that_are_no_numbers_cost_their_frame_only():
    write_igs("a.mha", {"ImageToReference": [PIXEL] * 4})
    text = Path("a.mha").read_bytes()
    for word in (b"-1.#IND", b"1.#QNAN", b"-nan(ind)", b"1.#INF00"):
        Path("b.mha").write_bytes(re.sub(rb"(Frame0002_ImageToReferenceTransform = )\S+", rb"\g<1>" + word, text))
        assert read_sweep("b.mha").valid.tolist() == [True, True, False, True]
    lost = re.sub(rb"(Frame0002_ImageToReferenceTransform = ).*", rb"\1?", text)
    Path("b.mha").write_bytes(lost.replace(b"Frame0002_ImageToReferenceTransformStatus = OK",
                                           b"Frame0002_ImageToReferenceTransformStatus = INVALID"))  # fmt: skip
    assert read_sweep("b.mha").valid.tolist() == [True, True, False, True]


def test_a_header_without_a_last_line_end():
    stored = write_igs("a.mha", {"ImageToReference": [PIXEL] * 4})
    head = Path("a.mha").read_bytes().split(b"LOCAL\n")[0]
    Path("a.raw").write_bytes(stored.tobytes())
    Path("b.mhd").write_bytes(head + b"a.raw")
    assert np.array_equal(read_sweep("b.mhd").frames, stored)


def test_time_stamps_that_go_back_are_named():
    write_igs("a.mha", {"ImageToReference": [PIXEL] * 4})
    Path("a.mha").write_bytes(Path("a.mha").read_bytes().replace(b"0002_Timestamp = 2", b"0002_Timestamp = 0"))
    with pytest.warns(UserWarning, match="go back at frame 2;"):
        assert len(read_sweep("a.mha")) == 4


@pytest.mark.parametrize("kinds", ["list domain domain", "domain list domain", "list RGB-color domain domain"])
def test_frames_of_an_nrrd_lie_along_its_list(kinds):
    made = small_sweep(4)
    write_sweep("a.igs.nrrd", made)
    head = Path("a.igs.nrrd").read_bytes().split(b"\n\n", 1)[0].decode()
    words = kinds.split()
    axes = {"list": 0, "domain": [2, 1], "RGB-color": 3}
    frames = np.repeat(made.frames[..., None], 3, -1) if "RGB-color" in words else made.frames
    order = [axes[word] if word != "domain" else axes["domain"].pop(0) for word in words][::-1]
    stored = np.ascontiguousarray(frames.transpose(order))
    sizes = " ".join(map(str, stored.shape[::-1]))
    head = re.sub("sizes: .*", f"sizes: {sizes}", re.sub("kinds: .*", f"kinds: {kinds}", head))
    head = head.replace("encoding: gzip", "encoding: raw").replace("dimension: 3", f"dimension: {len(words)}")
    Path("b.igs.nrrd").write_bytes(head.encode() + b"\n\n" + stored.tobytes())
    assert np.array_equal(read_sweep("b.igs.nrrd").frames, made.frames)


def test_frames_or_poses_with_one_time_stamp_are_refused_unless_rows_tell():
    """Frames of one stamp took one pose of a table that runs on."""
    made = small_sweep(4)
    poses = made.world_from_image
    for name, stamps in (("run", np.arange(4.0)), ("still", np.full(4, 1.0)), ("twice", np.array([0, 1.0, 0, 1]))):
        write_csv(f"{name}.csv", PoseTable(stamps, poses, made.valid))
        fields = [{"Timestamp": repr(stamp)} for stamp in stamps.tolist()]
        igs.write(f"{name}.mha", igs.Recording(made.frames, None, {}, made.valid, {}, fields))
    write_csv("more.csv", PoseTable(np.full(8, 1.0), np.concatenate([poses, poses]), np.ones(8, bool)))
    assert "got 1 s for all frames; give the frames' rate" in refused("still.mha", poses="run.csv")
    assert "got 1 s for all poses; give the frames' rate" in refused("run.mha", poses="more.csv")
    write_igs("own.mha", {"ImageToReference": [PIXEL] * 4})
    Path("own.mha").write_bytes(re.sub(rb"Timestamp = .*", b"Timestamp = 1", Path("own.mha").read_bytes()))
    assert "times that advance, for a temporal offset, got 1 s" in refused("own.mha", temporal_offset=0.1)
    for frames, table in (("run", "still"), ("still", "still"), ("twice", "twice")):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            read = read_sweep(f"{frames}.mha", poses=f"{table}.csv")
        assert np.allclose(read.world_from_image, made.world_from_image)


@pytest.mark.parametrize("fields", [True, False])
@pytest.mark.parametrize(("axis", "directions"), [(0, ""), (1, ""), (2, ""), (2, "none (1,0,0) (0,1,0)")])
def test_an_nrrd_without_kinds_says_how_it_was_read(axis, directions, fields):
    """By its fields or the directions of its axes; else along the last one, with a warning."""
    made = small_sweep(5)
    write_sweep("a.igs.nrrd", made)
    write_csv("poses.csv", PoseTable(None, made.world_from_image, made.valid))
    head = Path("a.igs.nrrd").read_bytes().split(b"\n\n", 1)[0].decode()
    stored = np.ascontiguousarray(np.moveaxis(made.frames, 0, axis))
    sizes = " ".join(map(str, stored.shape[::-1]))
    head = re.sub("\nkinds: .*", "\nspace: LPS" * bool(directions), re.sub("sizes: .*", f"sizes: {sizes}", head))
    head = head.replace("encoding: gzip", "encoding: raw")
    head += f"\nspace directions: {directions}" if directions else ""
    if not fields:
        head = "\n".join(line for line in head.split("\n") if "Seq_Frame" not in line)
    Path("b.igs.nrrd").write_bytes(head.encode() + b"\n\n" + stored.tobytes())
    words = {} if fields else {"poses": "poses.csv"}
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        if axis and not fields and not directions:
            with pytest.raises(FormatError, match="poses, one a frame"):
                read_sweep("b.igs.nrrd", **words)
        else:
            assert np.array_equal(read_sweep("b.igs.nrrd", **words).frames, made.frames)
    said = [str(one.message) for one in caught if "no kinds say" in str(one.message)]
    assert len(said) == (not directions and (axis > 0 or not fields))
    if said and fields:
        assert re.search("read as 5 frames, along its .* axis, as it has fields of 5", said[0])


def test_statuses_missing_poses_and_the_way_through_named_frames():
    write_igs(
        "a.mha", {"ImageToReference": [PIXEL] * 4}, Seq_Frame0001_ImageToReferenceTransformStatus="MISSING",
        Seq_Frame0003_ImageStatus="INVALID",
    )  # fmt: skip
    assert read_sweep("a.mha").valid.tolist() == [True, False, True, False]
    poses = [PIXEL, np.full((4, 4), np.nan), PIXEL, PIXEL]
    write_igs("b.mha", {"ImageToReference": poses})
    assert read_sweep("b.mha").valid.tolist() == [True, False, True, True]
    text = Path("a.mha").read_bytes()
    lines = [line for line in text.split(b"\n") if b"Frame0000_ImageTo" not in line]
    Path("c.mha").write_bytes(b"\n".join(lines))
    assert read_sweep("c.mha").valid.tolist() == [False, False, True, False]
    probe, stylus = random_poses(4, 3), random_poses(4, 4)
    write_igs("a.mha", {"TrackerToProbe": probe, "StylusToTracker": stylus})
    sweep = read_sweep("a.mha", calibration=Calibration(PIXEL))
    assert sweep.world == "Tracker"
    assert np.allclose(sweep.world_from_image, np.linalg.inv(probe) @ PIXEL)
    assert "expected a way from Image" in refused("a.mha")
    # A temporal offset shifts every tracked transform.
    poses = np.tile(np.eye(4), (4, 1, 1))
    poses[:, 0, 3] = [0, 2, 4, 8]
    write_igs("a.mha", {"ProbeToTracker": poses})
    sweep = read_sweep("a.mha", calibration=Calibration(PIXEL, temporal_offset=0.25))
    assert sweep.valid.tolist() == [True, True, True, False]  # nothing is extrapolated
    assert sweep.world_from_image[:3, 0, 3] == pytest.approx([0.5, 2.5, 5])


WORDS = {"calibration": "calibration.toml", "poses": "poses.csv"}


@pytest.fixture
def stack():
    Path("frames").mkdir()
    frames = np.random.default_rng(5).integers(0, 255, (12, 6, 7), dtype=np.uint8)
    for i, frame in enumerate(frames):
        Image.fromarray(frame).save(f"frames/{i}.png")  # 10.png sorts before 2.png as text
    times, poses = np.arange(40) * 0.05, np.tile(np.eye(4), (40, 1, 1))
    poses[:, 2, 3] = 10 * times
    poses[:, :3, :3] = Rotation.from_rotvec(np.outer(times, [0, 0, 1])).as_matrix()
    write_csv("poses.csv", PoseTable(times, poses, np.ones(40, bool)))
    write_calibration("calibration.toml", Calibration(PIXEL))
    return frames


def test_folder_with_poses_at_other_times_in_tables_of_all_kinds(stack):
    sweep = read_sweep("frames", **WORDS, frame_times=10, temporal_offset=0.02)
    assert np.array_equal(sweep.frames, stack)
    assert sweep.valid.all()
    assert sweep.timestamps == pytest.approx(0.1 * np.arange(12))
    pose = sweep.world_from_image[3] @ np.linalg.inv(PIXEL)
    assert (pose[2, 3], np.arctan2(pose[1, 0], pose[0, 0])) == (pytest.approx(10 * 0.32), pytest.approx(0.32))
    table, rows = read_poses("poses.csv"), ["time,x,y,z,qx,qy,qz,qw,status"]
    entries, matrices = [], []
    for time, matrix in zip(table.times, table.matrices, strict=True):
        q, place = Rotation.from_matrix(matrix[:3, :3]).as_quat(), matrix[:3, 3]
        rows.append(",".join(map(repr, [float(time), *place.tolist(), *q.tolist()])) + ",OK")
        entries.append({"time": time, "position": place.tolist(), "quaternion": q.tolist()})
        matrices.append({"t": time, "matrix": matrix.tolist()})
    Path("q.csv").write_text("\n".join(rows), encoding="utf-8")
    Path("q.json").write_text(json.dumps({"poses": entries}), encoding="utf-8")
    Path("m.json").write_text(json.dumps(matrices), encoding="utf-8")
    for name in ("q.csv", "q.json", "m.json"):
        other = read_poses(name)
        assert np.array_equal(other.times, table.times)
        assert np.allclose(other.matrices, table.matrices, atol=1e-12)


def test_times_of_poses_in_milliseconds_are_told(stack):
    rows = Path("poses.csv").read_text().splitlines()
    cells = [row.split(",", 1) for row in rows[1:]]
    for head, said in (("time", "call the column time_ms"), ("time_ms", "")):
        lines = [rows[0].replace("time", head), *(f"{1000 * float(time)!r},{rest}" for time, rest in cells)]
        Path("ms.csv").write_text("\n".join(lines) + "\n")
        words = {"calibration": "calibration.toml", "poses": "ms.csv", "frame_times": 10}
        if said:
            assert said in refused("frames", **words)
            with pytest.raises(FormatError, match=said):
                read_tracked("frames", "ms.csv", 10)
        else:
            right = read_sweep("frames", **WORDS, frame_times=10)
            assert np.allclose(read_sweep("frames", **words).world_from_image, right.world_from_image)


def test_a_missing_picture_of_a_numbered_folder_is_named(stack):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        read_sweep("frames", **WORDS, frame_times=10)
    Path("frames/5.png").unlink()
    missing = r"missing between 4\.png and 6\.png; at a given rate"
    with pytest.warns(UserWarning, match=missing):
        read_sweep("frames", **WORDS, frame_times=10)
    with pytest.warns(UserWarning, match=missing):
        read_tracked("frames", "poses.csv", 10)


def test_gaps_are_not_bridged():
    times = np.array([0, 0.1, 0.2, 0.3, 2.0, 2.1])
    table = PoseTable(times, random_poses(6), np.ones(6, bool))
    _, ok = interpolate(table, np.array([-0.01, 0.0, 0.25, 0.3, 1.0, 2.0, 2.05, 2.1, 2.11]))
    assert ok.tolist() == [False, True, True, True, False, True, True, True, False]
    matrices, _ = interpolate(table, times)
    assert np.array_equal(matrices, table.matrices)  # a known time gives the very bits
    table.ok[1] = False
    assert interpolate(table, np.array([0.1, 0.12]))[1].tolist() == [False, True]  # one lost pose


def test_poses_with_scale_need_no_calibration(stack):
    table = read_poses("poses.csv")
    write_csv("scaled.csv", table._replace(matrices=table.matrices @ PIXEL))
    assert read_sweep("frames", poses="scaled.csv", frame_times=10).spacing == pytest.approx((0.5, 0.25))
    assert "calibration" in refused("frames", poses="poses.csv", frame_times=10)
    line = refused("frames", poses="scaled.csv", frame_times=10, calibration="calibration.toml")
    assert "without scale" in line
    assert "0.375 mm" in line


def test_regions_and_mask_images_combine(stack):
    shape = (40, 50)
    clip, fan = Clip(10, 5, 20, 30), Fan(25, -10, -20, 30, 20, 40)
    painted = np.zeros(shape)
    painted[:, 15:] = 3
    both = region_mask(shape, clip, fan, painted)
    alone = [region_mask(shape, clip), region_mask(shape, fan=fan), region_mask(shape, mask=painted)]
    assert np.array_equal(both, np.logical_and.reduce(alone))
    assert alone[0].sum() == 600
    column = 25 + round(35 * np.tan(np.radians(29)))
    assert alone[1][25, [column, column + 2]].tolist() == [True, False]
    assert region_mask(shape) is None
    with pytest.raises(ValueError, match="got none"):
        region_mask(shape, Clip(100, 0, 5, 5))
    Image.fromarray(np.eye(6, 7, dtype=np.uint8) * 255).save("mask.png")
    words = WORDS | {"frame_times": 10}
    sweep = read_sweep("frames", mask="mask.png", clip=(0, 0, 3, 3), **words)
    assert np.array_equal(np.argwhere(sweep.mask), [[0, 0], [1, 1], [2, 2]])
    assert "shape (6, 7)" in refused("frames", mask=np.ones((3, 3)), **words)
    Path("broken.png").write_bytes(b"\x89PNG\r\n\x1a\nxx")
    assert "broken.png" in refused("frames", mask="broken.png", **words)


def test_sweep_checks_its_fields_and_write_what_it_cannot_hold():
    frames, poses = np.zeros((2, 3, 4), np.uint8), np.tile(np.eye(4), (2, 1, 1))
    assert Sweep(frames, poses)[1:].frames.shape == (1, 3, 4)
    assert Sweep(frames.astype(np.int16), poses).frames.dtype == np.uint8
    assert Sweep(frames.astype(float) - 1, poses).frames.dtype == np.float32
    singular = poses.copy()
    singular[1, :3, 1] = 2 * singular[1, :3, 0]
    infinite = frames.astype(np.float32)
    infinite[1, 0, 0] = np.inf
    for wrong, what in [
        ((frames[0], poses), "frames: expected shape"),
        ((frames, poses[:1]), "world_from_image: expected shape"),
        ((frames, singular), "singular matrix .frame 1"), ((infinite, poses), "NaN or inf .frame 1"),
        ((frames, poses, [0, np.nan]), "timestamps"), ((frames, poses, None, [True]), "valid"),
        ((frames, poses, None, None, np.ones((4, 3))), "mask"),
    ]:  # fmt: skip
        with pytest.raises(ValueError, match=what):
            Sweep(*wrong)
    assert not Sweep(frames, poses * [[[np.nan]], [[1]]]).valid[0]
    with pytest.raises(TypeError):
        Sweep(np.array([[["a"]]]), poses[:1])
    sweep = small_sweep()
    for name in ("a.dcm", "a.png"):
        with pytest.raises(ValueError, match="expected a folder or"):
            write_sweep(name, sweep)
    Path("there").mkdir()
    with pytest.raises(ValueError, match="new folder"):
        write_sweep("there", sweep)
    with pytest.raises(TypeError):
        write_sweep("a.npz", sweep.frames)


@pytest.mark.parametrize(("table", "what"), [
    ("", "empty file"),
    ("a,b\n1,2\n", "columns"),
    ("time,x,y,z,qx,qy,qz,qw\n", "got none"),
    ("time,x,y,z,qx,qy,qz,qw\n0,1,2\n", "row 2"),
    ("time,x,y,z,qx,qy,qz,qw\n0,1,2,z,0,0,0,1\n", "a number"),
    ("time,x,y,z,qx,qy,qz,qw\n0,1,2,3,0,0,0,5\n", "length 1"),
    ("time,x,y,z,qx,qy,qz,qw\nnan,1,2,3,0,0,0,1\n", "finite time"),
    ("time,x,y,z,qx,qy,qz,qw\n0,1,2,3,nan,0,0,1\n", "status OK"),
    ("time," + ",".join(f"m{r}{c}" for r in range(3) for c in range(4)) + "\n"
     + ",".join(["0"] * 13) + "\n", "singular"),
    ("time,x,y,z,qx,qy,qz,qw\n0,1,2,3,0,0,0,1\n", "way|OK|times"),
])  # fmt: skip
def test_bad_pose_tables(stack, table, what):
    Path("bad.csv").write_text(table, encoding="utf-8")
    line = refused("frames", calibration="calibration.toml", poses="bad.csv", frame_times=[5] * 12)
    assert re.search(what, line), line


def test_bad_times_sizes_and_json_tables(stack):
    for text in ("{", "3", "[1]", '[{"time": 0}]', '[{"time": "x", "matrix": [1]}]',
                 '[{"matrix": [1, 2]}]', "[" * 100000):  # fmt: skip
        Path("bad.json").write_text(text, encoding="utf-8")
        assert "bad.json" in refused("frames", calibration="calibration.toml", poses="bad.json")
    Path("empty").mkdir()
    Path("frames.bmp").write_bytes(b"BM\0\0")
    for source, options, said in (
        ("frames", {}, "times"),  # 40 poses for 12 frames without times
        ("frames", {"frame_times": [1, 2]}, "12 finite times"),
        ("frames", {"temporal_offset": np.nan}, "temporal_offset"),
        ("empty", {}, "pictures"),
        ("frames.bmp", {}, "no known format"),
    ):
        assert said in refused(source, **WORDS, **options)
    Image.fromarray(np.zeros((3, 3), np.uint8)).save("frames/99.png")
    assert "99.png" in refused("frames", frame_times=10, **WORDS)
    Path("frames/99.png").write_bytes(b"no picture")
    assert "99.png" in refused("frames", frame_times=10, **WORDS)
    with pytest.raises(FileNotFoundError):
        read_sweep("nowhere.igs.mha")


def test_truncated_and_hostile_igs_files():
    write_sweep("a.igs.mha", small_sweep())
    write_sweep("a.igs.nrrd", small_sweep())
    for name in ("a.igs.mha", "a.igs.nrrd"):
        whole = Path(name).read_bytes()
        for size in [*range(0, len(whole), 97), len(whole) - 1]:
            Path(f"cut{name[1:]}").write_bytes(whole[:size])
            assert "cut" in refused(f"cut{name[1:]}")
    whole = Path("a.igs.mha").read_bytes()
    for old, new in [
        (b"DimSize = 7 6 5", b"DimSize = 7 6 900000000"), (b"DimSize = 7 6 5", b"DimSize = 7 -6 5"),
        (b"DimSize = 7 6 5", b"DimSize = 7 6 4"), (b"DimSize = 7 6 5", b"DimSize = 210"),
        (b"MET_UCHAR", b"MET_STRING"), (b"NDims = 3", b"NDims = x"), (b"LOCAL", b"../../etc/passwd"),
        (b"LOCAL", b"missing.raw"), (b"Seq_Frame0001_Timestamp = 10.1", b"Seq_Frame0001_Timestamp = soon"),
        (b"MF", b"FF"), (b"MF", b"XX"),
    ]:  # fmt: skip
        assert old in whole, old
        Path("bad.igs.mha").write_bytes(whole.replace(old, new))
        assert "bad.igs.mha" in refused("bad.igs.mha")
    text = re.sub(rb"(Frame0002_ImageToReferenceTransform = )\S+", rb"\1x", whole)
    Path("bad.igs.mha").write_bytes(text)
    assert "Seq_Frame0002_ImageToReferenceTransform" in refused("bad.igs.mha")
    Path("bad.igs.mha").write_bytes(whole.replace(b"Status = OK", b"Status = INVALID"))
    assert "got none in 5" in refused("bad.igs.mha")


def test_bad_plus_configurations_and_archives():
    write_igs("a.mha", {"ProbeToReference": random_poses(4)})
    good = '<PlusConfiguration><Transform From="Image" To="Probe" Matrix="{}"/>{}</PlusConfiguration>'
    matrix = "1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1"
    Path("a.xml").write_text(good.format(matrix, ""), encoding="utf-8")
    assert read_sweep("a.mha", plus="a.xml").valid.all()
    for text, what in [
        ("<a/>", "PlusConfiguration"),
        (good.format("1 2 3", ""), "16 numbers"),
        (good.format(" ".join("0" * 16), ""), "singular"),
        (good.format(matrix, '<VolumeReconstruction ClipRectangleOrigin="0"/>'), "2 numbers"),
        (good.format(matrix, '<VolumeReconstruction ClipRectangleOrigin="900 0" '
                     'ClipRectangleSize="5 5"/>'), "got none"),
        (good.format(matrix, '<VolumeReconstruction FanAnglesDeg="50 20" FanOriginPixel="0 0" '
                     'FanRadiusStartPixel="1" FanRadiusStopPixel="9"/>'), "degrees"),
        ("<PlusConfiguration/>", "a way from Image"),
    ]:  # fmt: skip
        Path("a.xml").write_text(text, encoding="utf-8")
        assert what in refused("a.mha", plus="a.xml")
    sweep = small_sweep()
    for change, what in [
        ({"frames": np.zeros(3)}, "frames"),
        ({"world_from_image": np.zeros((2, 4, 4))}, "world_from_image"),
        ({"world_from_image": np.zeros((5, 4, 4))}, "0 0 0 1"), ({"timestamps": np.zeros(2)}, "timestamps"),
        ({"valid": np.zeros(5, bool)}, "got none"), ({"space": np.array("XYZ")}, "space"),
        ({"mask": np.ones((2, 2), bool)}, "mask"),
    ]:  # fmt: skip
        arrays = {"frames": sweep.frames, "world_from_image": sweep.world_from_image} | change
        np.savez("bad.npz", **arrays)
        assert what in refused("bad.npz")


@pytest.mark.parametrize(("change", "what"), [
    (lambda m: np.diag([0.001, 0.001, 0.001, 1]) @ m, "probably in meters: multiply"),
    (lambda m: np.diag([1000, 1000, 1000, 1]) @ m, "probably in micrometers"),
    (np.linalg.inv, "probably inverted"),
])  # fmt: skip
def test_transforms_in_other_units_are_refused(change, what):
    made = gb.ultrasound.phantoms.cylinders(n_frames=4, size=(300, 200))
    poses = change(made.world_from_image)
    write_recording("made.igs.mha", made.frames, made.timestamps, poses, "Image")
    with pytest.raises(FormatError, match=what) as caught:
        read_sweep("made.igs.mha")
    assert "\n" not in str(caught.value)


def test_poses_in_meters_beside_a_calibration_are_warned_of():
    made = gb.ultrasound.phantoms.cylinders(n_frames=12, size=(30, 20))
    poses = made.world_from_image.copy()
    poses[:, :3, :3] /= 0.12
    poses[:, :3, 3] += 300
    calibration = Calibration(np.diag([0.12, 0.12, 0.12, 1]))
    write_recording("made.igs.mha", made.frames, made.timestamps, poses)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        read_sweep("made.igs.mha", calibration)
    poses[:, :3, 3] /= 1000
    write_recording("made.igs.mha", made.frames, made.timestamps, poses)
    with pytest.warns(UserWarning, match="probably in meters"):
        read_sweep("made.igs.mha", calibration)


def test_poses_of_zeros_and_poses_that_mirror(recwarn):
    """Before: one such matrix with status OK rejected the whole recording."""
    made = gb.ultrasound.phantoms.cylinders(n_frames=6, size=(30, 20))
    poses = made.world_from_image.copy()
    poses[3] = 0
    poses[5, :3, :2] = 0
    write_recording("made.igs.mha", made.frames, made.timestamps, poses, "Image")
    sweep = read_sweep("made.igs.mha")
    assert np.flatnonzero(~sweep.valid).tolist() == [3, 5]
    write_sweep("again.igs.mha", sweep)
    assert np.flatnonzero(~read_sweep("again.igs.mha").valid).tolist() == [3, 5]
    sweep = small_sweep()
    write_sweep("right.npz", sweep)
    read_sweep("right.npz")
    assert not recwarn
    write_sweep("swapped.npz", Sweep(sweep.frames, sweep.world_from_image[:, :, [1, 0, 2, 3]]))
    with pytest.warns(UserWarning, match=r"swapped.npz: 5 of 5 poses mirror the image"):
        read_sweep("swapped.npz")


@pytest.mark.parametrize(("kinds", "shape"), [
    ("vector domain domain", (20, 30, 3)), ("RGB-color domain domain", (20, 30, 3)),
    ("RGBA-color domain domain list", (5, 20, 30, 4)), ("3-vector domain domain list", (5, 20, 30, 3)),
    ("domain domain vector list", (5, 3, 20, 30)), ("domain domain list", (5, 20, 30)),
    ("domain domain vector", (1, 20, 30)), ("vector domain domain list", (5, 20, 3, 1)),
])  # fmt: skip
def test_colors_of_nrrd_are_where_its_kinds_say(kinds, shape):
    """Before: `vector domain domain` of 3, 1152 and 648 was read as 648 frames of 3x1152."""
    values = np.random.default_rng(0).integers(0, 255, shape, np.uint8)
    nrrd.write("made.nrrd", values, {"kinds": kinds})
    frames, words = igs.read("made.nrrd").frames, kinds.split()[::-1]
    colors = [axis for axis, word in enumerate(words) if word not in ("domain", "list")]
    if colors:
        values = np.moveaxis(values, colors[0], -1)
        values = values[..., 0] if values.shape[-1] == 1 else igs.to_gray(values[..., :3])
    assert np.array_equal(frames, values.reshape(-1, *values.shape[-2:]))


def test_a_colored_picture_of_metaimage_is_one_frame():
    values = np.random.default_rng(0).integers(0, 255, (20, 30, 3), np.uint8)
    head = "ObjectType = Image\nNDims = 2\nDimSize = 30 20\nElementNumberOfChannels = 3\n"
    head += "ElementType = MET_UCHAR\nElementDataFile = LOCAL\n"
    Path("made.mha").write_bytes(head.encode() + values.tobytes())
    assert np.array_equal(igs.read("made.mha").frames, igs.to_gray(values)[None])
    nrrd.write("made.nrrd", values[..., :2], {"kinds": "vector domain domain"})
    with pytest.raises(FormatError, match="RGB"):
        igs.read("made.nrrd")
