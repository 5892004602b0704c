"""Sweeps and pose tables of other programs, each made with a library of its own where there is
one."""

import csv
import warnings
from pathlib import Path

import globule as gb
import numpy as np
import pytest
from globule.formats.errors import FormatError
from globule.formats.sweeps.poses import read_poses
from globule.ultrasound.calibration import Calibration, read_calibration
from globule.ultrasound.files import read_sweep
from PIL import Image
from scipy.spatial.transform import Rotation
from sweep_helpers import random_poses
from test_sweep import refused, write_igs
from test_sweep_bundles import sequence

pytestmark = pytest.mark.usefixtures("folder")
N = 12
PIXEL = np.diag([0.5, 0.25, 0.3, 1.0])
TIMES = 1_700_000_000.125 + np.arange(N) / 30  # s since 1970


def images(dtype="uint8") -> np.ndarray:
    return np.random.default_rng(5).integers(0, 250, (N, 10, 14)).astype(dtype)


def quaternions(poses: np.ndarray) -> np.ndarray:
    return Rotation.from_matrix(poses[:, :3, :3]).as_quat()


def write_rows(name: str, rows, delimiter: str = ",") -> None:
    with open(name, "w", encoding="utf-8", newline="") as file:
        csv.writer(file, delimiter=delimiter).writerows(rows)


def refuses(name: str, problem: str) -> None:
    with pytest.raises(FormatError, match=problem):
        read_poses(name)


def close(table, poses, atol=1e-6) -> bool:
    return np.allclose(table.matrices[table.ok], poses[table.ok], atol=atol)


def test_tum():
    poses = random_poses(N)
    rows = np.column_stack([TIMES, poses[:, :3, 3] / 1000, quaternions(poses)])
    np.savetxt("track.txt", rows, fmt="%.9f", header="timestamp tx ty tz qx qy qz qw")
    table = read_poses("track.txt")
    assert close(table, poses, 1e-5)
    assert np.allclose(table.times, TIMES, atol=1e-6)
    for text, said in (
        ("1 2 3 4 0 0 0 1\n1 2 3\n", r"line 2: expected 8 numbers \(TUM\), got 3"),
        ("1 2 3 4 0 0 0 2\n", "quaternion of length 1"),
        ("hello\n", "expected a pose table"),
    ):
        Path("bad.txt").write_text(text, encoding="utf-8")
        refuses("bad.txt", said)


@pytest.mark.parametrize("layout", ["rostopic", "columns", "transform"])
def test_ros(layout):
    poses = random_poses(N)
    place, turn = ("translation", "rotation") if layout == "transform" else ("position", "orientation")
    prefix = {"rostopic": "field.pose.", "columns": "pose.pose.", "transform": "transform."}[layout]
    names = [f"{prefix}{place}.{a}" for a in "xyz"] + [f"{prefix}{turn}.{a}" for a in "xyzw"]
    stamps = [round(t * 1e9) for t in TIMES]
    clock = {
        "rostopic": (["%time", "field.header.seq", "field.header.stamp", "field.header.frame_id"],
                     lambda i: [stamps[i] + 7_000_000, i, stamps[i], "camera"]),
        "columns": (["Time", "header.stamp.secs", "header.stamp.nsecs"],
                    lambda i: [TIMES[i] + 1, stamps[i] // 10**9, stamps[i] % 10**9]),
        "transform": (["header.stamp.sec", "header.stamp.nanosec", "child_frame_id"],
                      lambda i: [stamps[i] // 10**9, stamps[i] % 10**9, "probe"]),
    }[layout]  # fmt: skip
    q = quaternions(poses)
    rows = [[*clock[1](i), *(poses[i, :3, 3] / 1000), *q[i]] for i in range(N)]
    write_rows("topic.csv", [clock[0] + names, *rows])
    table = read_poses("topic.csv")
    assert close(table, poses)
    assert np.allclose(table.times, TIMES, atol=1e-6)


def optitrack(unit="Meters", scale=1e-3, bodies=("Probe",), turn="Quaternion") -> np.ndarray:
    """A file as Motive exports it, one row lost."""
    poses = random_poses(N)
    q = quaternions(poses)
    kinds = ["Rotation"] * 4 + ["Position"] * 3 + ["Mean Marker Error"]
    axes, n = [*"XYZW", *"XYZ", ""], len(bodies)
    head = [
        ["Format Version", "1.23", "Take Name", "Take 1", "Capture Frame Rate", "30.000000",
         "Rotation Type", turn, "Length Units", unit, "Coordinate Space", "Global"],
        [],
        ["", "Type"] + ["Rigid Body"] * 8 * n,
        ["", "Name"] + [body for body in bodies for _ in range(8)],
        ["", "ID"] + ["AB"] * 8 * n,
        ["", ""] + kinds * n,
        ["Frame", "Time (Seconds)"] + axes * n,
    ]  # fmt: skip
    rows = [[*q[i], *(poses[i, :3, 3] * scale), 0.0001] * n for i in range(N)]
    rows[4] = [""] * 8 * n
    write_rows("take.csv", [*head, *([i, i / 30, *row] for i, row in enumerate(rows))])
    return poses


def test_optitrack():
    for unit, scale in (("Meters", 1e-3), ("Millimeters", 1.0), ("Centimeters", 0.1)):
        poses, table = optitrack(unit, scale), read_poses("take.csv")
        assert np.array_equal(np.flatnonzero(~table.ok), [4])
        assert close(table, poses)
        assert np.allclose(table.times, np.arange(N) / 30)
    for other, said in (
        ({"bodies": ("Probe", "Stylus")}, "expected one rigid body, got Probe, Stylus"),
        ({"turn": "XYZ"}, "Rotation Type: expected Quaternion"),
        ({"unit": "Furlongs"}, "Length Units: expected millimeters"),
    ):
        optitrack(**other)
        refuses("take.csv", said)


@pytest.mark.parametrize(("separator", "angles"), [(",", False), ("\t", False), (",", True)])
def test_ndi(separator, angles):
    """A tool's frame numbers count sixtieths of a second; a lost tool has no numbers."""
    poses = random_poses(N)
    names, turn = ["Q0", "Qx", "Qy", "Qz"], np.roll(quaternions(poses), 1, axis=1)
    if angles:
        names, turn = ["Rz", "Ry", "Rx"], Rotation.from_matrix(poses[:, :3, :3]).as_euler("ZYX", degrees=True)
    head = ["Tools", "Frame", "Face", "State", *names, "Tx", "Ty", "Tz", "Error"]
    rows = [["Port 1", 6000 + 2 * i, 0, "OK", *turn[i], *poses[i, :3, 3], 0.1] for i in range(N)]
    rows[3][3:] = ["MISSING", *[""] * (len(head) - 4)]
    write_rows("tool.csv", [head, *rows], separator)
    table = read_poses("tool.csv")
    assert np.array_equal(np.flatnonzero(~table.ok), [3])
    assert close(table, poses)
    assert np.allclose(table.times, 100 + np.arange(N) / 30)
    text = Path("tool.csv").read_text(encoding="utf-8").splitlines()
    Path("two.csv").write_text("\n".join(line + separator + line for line in text), encoding="utf-8")
    refuses("two.csv", "expected one tool, got 2")


def write_table(name: str, column: str, times, poses) -> None:
    head = [column, *(f"m{r}{c}" for r in range(3) for c in range(4))]
    rows = ([time, *pose[:3].ravel()] for time, pose in zip(times, poses, strict=True))
    write_rows(name, [head, *rows])


def test_units_of_time_and_a_tracker_s_buffer_of_plus():
    poses = random_poses(N)
    for column, unit in (
        ("time", 1), ("time", 1e3), ("timestamp", 1e6), ("t", 1e9),
        ("time_ms", 1e3), ("time_us", 1e6), ("time_ns", 1e9),
    ):  # fmt: skip
        write_table("poses.csv", column, [repr(float(t) * unit) for t in TIMES], poses)
        assert np.allclose(read_poses("poses.csv").times, TIMES, atol=1e-6), column
    for column, first in (("time_ms", 0.25), ("time", 250)):  # small ones
        write_table("poses.csv", column, [250, 500] * (N // 2), poses)
        assert read_poses("poses.csv").times[0] == first
    np.save("frames.npy", images())
    poses = random_poses(N) @ PIXEL
    write_table("poses.csv", "time", [round(t * 1000) for t in TIMES], poses)
    sweep = read_sweep("frames.npy", poses="poses.csv", frame_times=30)
    assert sweep.n_valid >= N - 1  # the last may lie a fraction of a millisecond too late
    good = np.flatnonzero(sweep.valid)
    assert np.allclose(sweep.world_from_image[good], poses[good], atol=0.5)
    text = refused("frames.npy", poses="poses.csv", frame_times=10)
    assert "as long as the frames at the given rate" in text
    # A table on the clock of the frames is not moved.
    write_table("poses.csv", "time", np.arange(N) / 30 + 0.1, poses)
    sweep = read_sweep("frames.npy", poses="poses.csv", frame_times=30)
    assert not sweep.valid[:3].any()
    poses = random_poses(N)
    about = {f"Seq_Frame{i:04d}_ImageStatus": "INVALID" for i in range(N)}
    lost = {"Seq_Frame0005_ProbeToTrackerTransformStatus": "INVALID"}
    write_igs("tracker.igs.mha", {"ProbeToTracker": poses}, N, **about, **lost)
    np.savez("frames.npz", frames=images(), timestamps=np.arange(N))
    sweep = read_sweep("frames.npz", Calibration(PIXEL), poses="tracker.igs.mha")
    assert np.flatnonzero(~sweep.valid).tolist() == [5]
    assert np.allclose(sweep.world_from_image[sweep.valid], (poses @ PIXEL)[sweep.valid], atol=1e-9)
    write_igs("none.mha", {"StylusToTracker": poses, "AToB": poses}, N, **about)
    refuses("none.mha", "expected a transform from Probe")


def write_calib_matrix(titles: bool) -> np.ndarray:
    """A calib_matrix.csv, whose pixels count from 1."""
    scale, tool = np.diag([0.229, 0.221, 1.0, 1.0]), random_poses(1, seed=4)[0]
    rows: list = []
    for title, matrix in (("scaling_from_pixel_to_mm", scale), ("from_image_mm_to_tool", tool)):
        rows += [[title]] if titles else []
        rows += matrix.tolist()
    write_rows("calib_matrix.csv", rows)
    first = np.eye(4)
    first[:2, 3] = 1
    return tool @ scale @ first


@pytest.mark.parametrize("name", ["scan.h5", "scan.npz"])
def test_tus_rec(name):
    poses, frames = random_poses(N), images()
    if name == "scan.h5":
        h5py = pytest.importorskip("h5py", reason="needs h5py")
        with h5py.File(name, "w") as file:
            file["frames"], file["tforms"] = frames, poses.astype(np.float32)
    else:
        np.savez(name, frames=frames, tforms=poses)
    for titles in (True, False):
        place = write_calib_matrix(titles)
        assert np.allclose(read_calibration("calib_matrix.csv").probe_from_image, place)
        sweep = read_sweep(name, calibration="calib_matrix.csv")
        assert np.array_equal(sweep.frames, frames)
        assert np.allclose(sweep.world_from_image, poses @ place, atol=1e-4)
        assert sweep.world == "Tracker"
    timed = read_sweep(name, calibration="calib_matrix.csv", frame_times=20)
    assert np.allclose(timed.timestamps, np.arange(N) / 20)
    gb.ultrasound.write_sweep("again.igs.mha", timed)
    assert np.allclose(read_sweep("again.igs.mha").world_from_image, sweep.world_from_image, atol=1e-6)
    assert "give a calibration" in refused(name)
    Path("bad.csv").write_text("1,2,3\n", encoding="utf-8")
    assert "two matrices of four rows" in refused(name, calibration="bad.csv")


def test_damaged_and_foreign_h5():
    h5py = pytest.importorskip("h5py", reason="needs h5py")
    write_calib_matrix(True)
    with h5py.File("other.h5", "w") as file:
        file["PartType0"] = np.zeros(3)
    with h5py.File("shape.h5", "w") as file:
        file["frames"], file["tforms"] = images(), np.zeros((3, 4, 4))
    with h5py.File("bomb.h5", "w") as file:
        file.create_dataset("frames", (2000, 2000, 2000), "u1", compression="gzip", chunks=True)
        file["tforms"] = np.zeros((2000, 4, 4))
    data = Path("shape.h5").read_bytes()
    Path("cut.h5").write_bytes(data[: len(data) // 3])
    for name, said in (
        ("other", "expected a scan in HDF5"), ("shape", "tforms (N, 4, 4)"), ("bomb", "times the"),
        ("cut", "expected a scan in HDF5"),
    ):  # fmt: skip
        assert said in refused(f"{name}.h5", calibration="calib_matrix.csv")


@pytest.mark.parametrize("first", [True, False])
def test_a_sequence_of_slicer(first):
    """The list of items is the first or the last axis; the index is the time."""
    frames, times = images(), 100 + np.arange(N) / 30
    sequence("us.seq.nrrd", frames, times=times, first=first)
    poses = random_poses(N) @ PIXEL
    write_table("poses.csv", "time", times, poses)
    sweep = read_sweep("us.seq.nrrd", poses="poses.csv")
    assert np.array_equal(sweep.frames, frames)
    assert np.allclose(sweep.timestamps, times)
    assert np.allclose(sweep.world_from_image, poses, atol=1e-6)


def test_tiff_stack():
    tifffile = pytest.importorskip("tifffile", reason="needs tifffile")
    poses = random_poses(N) @ PIXEL
    write_table("poses.csv", "time", np.arange(N) / 30, poses)
    for dtype in ("uint8", "uint16", "float32"):
        frames = images(dtype)
        tifffile.imwrite("stack.tif", frames, photometric="minisblack")
        sweep = read_sweep("stack.tif", poses="poses.csv", frame_times=30)
        assert np.array_equal(sweep.frames, frames)
        assert sweep.frames.dtype == dtype
        assert np.allclose(sweep.world_from_image, poses)
    Path("cut.tif").write_bytes(Path("stack.tif").read_bytes()[:60])
    refused("cut.tif", poses="poses.csv", frame_times=30)


def test_tiff_by_pillow_in_color():
    pages = [Image.fromarray(np.full((10, 14, 3), (10 * i, 0, 0), np.uint8)) for i in range(N)]
    pages[0].save("color.tif", save_all=True, append_images=pages[1:], compression="tiff_lzw")
    write_table("poses.csv", "time", np.arange(N) / 30, random_poses(N) @ PIXEL)
    whole = read_sweep("color.tif", poses="poses.csv", frame_times=30)
    data, said = Path("color.tif").read_bytes(), []
    for n in range(9, len(data), 7):
        Path("cut.tif").write_bytes(data[:n])
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            try:  # Pillow fills tags in that are missing at the end
                found = read_sweep("cut.tif", poses="poses.csv", frame_times=30)
                assert np.array_equal(found.frames, whole.frames)
            except ValueError as error:
                said.append(str(error))
    assert all(line.startswith("cut.tif: ") for line in said)
    assert len(said) > 0.9 * len(data) / 7
    assert np.array_equal(whole.frames[:, 0, 0], np.rint(0.299 * 10 * np.arange(N)))


@pytest.mark.parametrize("name", ["clip.mp4", "clip.avi"])
def test_video(name):
    av = pytest.importorskip("av", reason="needs PyAV")
    y, x = np.mgrid[:64, :96]
    frames = np.array([127 + 100 * np.sin((x + 3 * i) / 12 + y / 9) for i in range(N)], np.uint8)
    with av.open(name, "w") as file:
        stream = file.add_stream("mpeg4" if name == "clip.mp4" else "mjpeg", rate=25)
        stream.width, stream.height = 96, 64
        stream.pix_fmt = "yuv420p" if name == "clip.mp4" else "yuvj420p"
        stream.bit_rate = 4_000_000
        for frame in frames:
            rgb = np.repeat(frame[..., None], 3, axis=-1)
            for packet in stream.encode(av.VideoFrame.from_ndarray(rgb, format="rgb24")):
                file.mux(packet)
        for packet in stream.encode():
            file.mux(packet)
    write_table("poses.csv", "time", np.arange(N) / 25, random_poses(N) @ PIXEL)
    sweep = read_sweep(name, poses="poses.csv")
    assert sweep.frames.shape == frames.shape
    assert np.abs(sweep.frames.astype(int) - frames).mean() < 6  # lossy
    assert np.allclose(np.diff(sweep.timestamps), 1 / 25, atol=1e-3)
    assert sweep.n_valid >= N - 1
    Path("cut.mp4").write_bytes(Path(name).read_bytes()[:200])
    refused("cut.mp4", poses="poses.csv")
