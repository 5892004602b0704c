"""`globule reconstruct`, and what info, convert and --live do with sweeps and volumes."""

from __future__ import annotations

import json
import os
import socket
import threading
import time
from pathlib import Path

import globule as gb
import numpy as np
import pytest
from globule.calibration import Calibration, write_calibration
from globule.cli import main
from globule.sweeps.live import parse_address, receive, receive_sweep
from globule.volume_io import read_volume
from PIL import Image
from sweep_helpers import same, small_sweep, spine_data

CPU = ["--device", "cpu"]


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("GLOBULE_TRACEBACK", raising=False)


@pytest.fixture
def sweep():
    """A phantom of 24 small frames in phantom.igs.mha."""
    made = gb.phantoms.cylinders(n_frames=24, size=(64, 60), spacing=0.8)
    gb.write_sweep("phantom.igs.mha", made)
    return made


def refused(capsys, *words: str) -> str:
    before = sorted(os.listdir())
    assert main(["reconstruct", *words]) == 2
    out, err = capsys.readouterr()
    assert out == "" and err.startswith("globule: error: ") and err.count("\n") == 1, err
    assert sorted(os.listdir()) == before
    return err


def run_json(capsys, *words: str) -> dict:
    assert main([*words, "--json"]) == 0
    return json.loads(capsys.readouterr().out)


def test_a_volume_and_its_figures(sweep, capsys):
    words = ["reconstruct", "phantom.igs.mha", "-o", "v.npz", "--spacing", "1", *CPU]
    assert main(words) == 0
    out, err = capsys.readouterr()
    assert out.startswith("v.npz: ") and "24 frames" in out and "measured" in out and err == ""
    facts = run_json(capsys, *words, "--three-view", "v.png")
    volume = read_volume("v.npz")
    assert facts["volume"]["size"] == list(volume.values.shape[::-1])
    assert facts["counts"]["measured"] == volume.n_measured
    assert facts["counts"]["filled"] == volume.n_filled
    assert sum(facts["counts"][k] for k in ("measured", "filled", "empty")) == volume.values.size
    assert set(facts["times"]) == {"read", "reconstruct", "write", "total"}
    assert facts["frames"]["used"] == 24 and facts["method"] == "pvn-om"
    assert Image.open("v.png").size[0] > 50
    low, high = sweep.bounds()
    origin = volume.world_from_voxel[:3, 3]
    assert (np.abs(origin - low) <= 1).all()
    far = origin + (np.array(volume.values.shape[::-1]) - 1) * volume.spacing
    assert (far >= high - 1).all()


@pytest.mark.parametrize("extension", [".nrrd", ".mha", ".nii.gz", ".vti", ".sparse.npz"])
def test_every_format(sweep, capsys, extension):
    name = "v" + extension
    facts = run_json(capsys, "reconstruct", "phantom.igs.mha", "-o", name, "--size", "32", *CPU)
    assert max(facts["volume"]["size"]) == 32
    assert list(read_volume(name).values.shape[::-1]) == facts["volume"]["size"]
    about = run_json(capsys, "info", name)
    assert about["kind"] == "volume" and about["size"] == facts["volume"]["size"]


@pytest.mark.parametrize("method", ["pvn-om", "vvn-om", "pvn", "vvn", "bezier"])
def test_every_method(sweep, capsys, method):
    words = ["--method", method, "--spacing", "1.5", "--max-kernel", "5"]
    facts = run_json(capsys, "reconstruct", "phantom.igs.mha", "-o", "v.npz", *words, *CPU)
    assert facts["method"] == method and facts["counts"]["measured"] > 0
    seen = read_volume("v.npz")
    assert 40 < seen.values[seen.measured].mean() < 130


def test_plus_exact(capsys):
    data = spine_data()
    words = [str(data / "SpinePhantomFreehand.igs.mha"), "--plus", str(data / "NNLATE.xml")]
    facts = run_json(capsys, "reconstruct", *words, "-o", "v.mha", *CPU)
    assert facts["method"] == "plus"
    ours, theirs = read_volume("v.mha"), read_volume(data / "NNLATE.reference.mha")
    assert np.array_equal(ours.values, theirs.values)
    assert np.abs(ours.world_from_voxel - theirs.world_from_voxel).max() < 5e-4


def test_cross_validation(sweep, capsys):
    words = ["phantom.igs.mha", "--cross-validate", "4", "--spacing", "0.8", *CPU]
    facts = run_json(capsys, "reconstruct", *words)
    assert set(facts["cross_validation"]) == {"pvn-om", "vvn-om", "bezier"}
    for result in facts["cross_validation"].values():
        assert result["n_frames"] == 22 and 0.5 < result["coverage"] <= 1
        assert 0 < result["mean_error"] < result["rms_error"] < 60
    assert main(["reconstruct", *words, "--method", "vvn-om"]) == 0
    out = capsys.readouterr().out
    assert out.count("\n") == 1 and "vvn-om" in out and "22 frames left out" in out


def test_jumping_poses_are_left_out_with_a_warning(sweep, capsys):
    sweep.world_from_image[11, :3, 3] += 60
    gb.write_sweep("jump.npz", sweep)
    words = ["reconstruct", "jump.npz", "-o", "v.npz", "--spacing", "2", *CPU]
    assert main(words) == 0
    assert "the pose jumps: 11" in capsys.readouterr().err
    assert run_json(capsys, *words)["frames"]["outliers"] == [11]
    assert run_json(capsys, *words, "--keep-outliers")["frames"]["used"] == 24


def test_a_stack_with_poses(capsys):
    made = small_sweep(12)
    gb.write_sweep("frames", made)
    Path("frames/poses.csv").rename("poses.csv")
    words = ["frames", "--poses", "poses.csv", "-o", "v.npz", "--spacing", "2", *CPU]
    assert run_json(capsys, "reconstruct", *words, "--keep-outliers")["frames"]["used"] == 12


def test_mistakes_get_one_line(sweep, capsys):
    write_calibration("probe.toml", Calibration(np.diag([0.1, 0.1, 0.1, 1])))
    Path("singular.toml").write_text("probe_from_image = [[0,0,0,0],[0,0,0,0],[0,0,0,0],[0,0,0,1]]")
    Path("broken.igs.mha").write_bytes(Path("phantom.igs.mha").read_bytes()[:20000])
    lost = small_sweep(valid=[False] * 5)
    gb.write_sweep("lost.npz", lost)
    for words, what in [
        ([], "SWEEP"),
        (["phantom.igs.mha"], "-o"),
        (["phantom.igs.mha", "-o", "v.stl"], "v.stl"),
        (["phantom.igs.mha", "-o", "no/v.nrrd"], "no"),
        (["nowhere.igs.mha", "-o", "v.nrrd"], "nowhere"),
        (["broken.igs.mha", "-o", "v.nrrd"], "broken.igs.mha"),
        (["lost.npz", "-o", "v.nrrd"], "lost.npz"),
        (["phantom.igs.mha", "-o", "v.nrrd", "--calibration", "nowhere.toml"], "nowhere.toml"),
        (["phantom.igs.mha", "-o", "v.nrrd", "--calibration", "singular.toml"], "singular"),
        (["phantom.igs.mha", "-o", "v.nrrd", "--calibration", "probe.toml"], "a way from Image"),
        (["phantom.igs.mha", "-o", "v.nrrd", "--plus", "probe.toml"], "probe.toml"),
        (["phantom.igs.mha", "-o", "v.nrrd", "--clip", "1,2"], "clip"),
        (["phantom.igs.mha", "-o", "v.nrrd", "--clip", "900,0,5,5"], "region"),
        (["phantom.igs.mha", "-o", "v.nrrd", "--fan", "1,2,3,4,5,x"], "number"),
        (["phantom.igs.mha", "-o", "v.nrrd", "--mask", "nowhere.png"], "nowhere.png"),
        (["phantom.igs.mha", "-o", "v.nrrd", "--spacing", "0"], "--spacing"),
        (["phantom.igs.mha", "-o", "v.nrrd", "--spacing", "1", "--size", "9"], "--size"),
        (["phantom.igs.mha", "-o", "v.nrrd", "--max-kernel", "4"], "--max-kernel"),
        (["phantom.igs.mha", "-o", "v.nrrd", "--method", "magic"], "--method"),
        (["phantom.igs.mha", "-o", "v.nrrd", "--device", "tpu"], "device"),
        (["phantom.igs.mha", "-o", "v.nrrd", "--spacing", "0.0001"], "spacing"),
        (["phantom.igs.mha", "-o", "v.nrrd", "--three-view", "v.bmp"], "--three-view"),
        (["phantom.igs.mha", "--cross-validate", "1"], "--cross-validate"),
        (["phantom.igs.mha", "--cross-validate", "20"], "at most half"),
        (["--live", "igtl://127.0.0.1:1", "-o", "v.nrrd", "--idle", "0.3"], "expected a server"),
        (["--live", "http://x", "-o", "v.nrrd"], "igtl://host:port"),
        (["phantom.igs.mha", "--live", "igtl://h", "-o", "v.nrrd"], "both"),
    ]:
        assert what in refused(capsys, *words, *([] if "--device" in words else CPU)), words


# info and convert


def test_info_of_a_sweep(sweep, capsys):
    assert main(["info", "phantom.igs.mha"]) == 0
    out = capsys.readouterr().out
    assert "24 frames of 64x60" in out and "Reference" in out
    facts = run_json(capsys, "info", "phantom.igs.mha")
    assert facts["kind"] == "sweep" and facts["frames"] == 24 and facts["valid"] == 24
    assert facts["spacing"] == pytest.approx([0.8, 0.8])


def test_info_of_a_recording_without_calibration(capsys):
    data = spine_data()
    facts = run_json(capsys, "info", str(data / "SpinePhantomFreehand.igs.mha"))
    assert facts["kind"] == "sweep" and facts["frames"] == 21 and facts["spacing"] is None
    assert facts["transforms"] == ["ProbeToTracker", "ReferenceToTracker", "StylusToTracker"]


def test_convert_sweeps_and_volumes(sweep, capsys):
    for name in ("a.igs.nrrd", "b.npz", "c.igs.mha"):
        assert main(["convert", "phantom.igs.mha", name]) == 0
        assert same(sweep, gb.read_sweep(name))
    assert main(["reconstruct", "b.npz", "-o", "v.npz", "--size", "24", *CPU]) == 0
    assert main(["convert", "v.npz", "w.nrrd"]) == 0
    assert np.array_equal(read_volume("v.npz").values, read_volume("w.nrrd").values)
    assert main(["convert", "v.npz", "w.igs.mha"]) == 2
    assert main(["convert", "a.igs.nrrd", "w.nii"]) == 2
    err = capsys.readouterr().err
    assert err.count("globule: error") == 2


def test_convert_a_recording_without_calibration(capsys):
    data = spine_data()
    source, plus = data / "SpinePhantomFreehand.igs.mha", data / "NNMEAN.xml"
    assert main(["convert", str(source), "a.igs.nrrd"]) == 0
    assert same(gb.read_sweep(source, plus=plus), gb.read_sweep("a.igs.nrrd", plus=plus))
    assert main(["convert", "a.igs.nrrd", "a.npz"]) == 2
    assert "calibration" in capsys.readouterr().err


# Live


class Server:
    """An OpenIGTLink server that replays a sweep, on loopback."""

    def __init__(self, sweep, embedded: bool = False, names=("ImageToReference",)):
        igtl = pytest.importorskip("pyigtl", reason="live needs pyigtl")
        self.messages = []
        for i in range(len(sweep)):
            matrix = sweep.world_from_image[i]
            when = 1000 + float(sweep.timestamps[i])
            place = matrix if embedded else np.eye(4)
            image = igtl.ImageMessage(
                sweep.frames[i][None], ijk_to_world_matrix=place, timestamp=when,
                device_name="Image",
            )  # fmt: skip
            parts = [image]
            if not embedded:
                for name in names:
                    parts.append(igtl.TransformMessage(matrix, timestamp=when, device_name=name))
            self.messages.append([part.pack() for part in parts])
        self.socket = socket.create_server(("127.0.0.1", 0))
        self.address = f"igtl://127.0.0.1:{self.socket.getsockname()[1]}"

    def serve(self, *parts) -> threading.Thread:
        """One connection after the other sends its part of the frames and hangs up."""

        def work():
            for part in parts:
                connection, _ = self.socket.accept()
                with connection:
                    for messages in self.messages[part]:
                        for message in messages:
                            connection.sendall(message)
            self.socket.close()

        thread = threading.Thread(target=work, daemon=True)
        thread.start()
        return thread


def arrived(live, sweep) -> bool:
    """Whether a sweep came over the line: OpenIGTLink's matrices are float32."""
    return (
        np.array_equal(live.frames, sweep.frames)
        and np.allclose(live.world_from_image, sweep.world_from_image, rtol=1e-5, atol=1e-4)
        and np.allclose(np.diff(live.timestamps), np.diff(sweep.timestamps), atol=1e-6)
    )


def test_live_with_transforms_and_with_embedded_poses():
    made = small_sweep(20)
    for embedded in (False, True):
        server = Server(made, embedded)
        server.serve(slice(None))
        assert arrived(receive_sweep(server.address, idle=0.4), made)


def test_live_from_pyigtl_s_own_server():
    igtl = pytest.importorskip("pyigtl", reason="live needs pyigtl")
    made = small_sweep(8)
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    server = igtl.OpenIGTLinkServer(port=port)

    def replay():
        while not server.is_connected():
            time.sleep(0.01)
        for i in range(len(made)):
            when = 1000 + float(made.timestamps[i])
            for message in (
                igtl.ImageMessage(made.frames[i][None], timestamp=when, device_name="Image"),
                igtl.TransformMessage(made.world_from_image[i], timestamp=when,
                                      device_name="ImageToReference"),
            ):  # fmt: skip
                server.send_message(message)

    threading.Thread(target=replay, daemon=True).start()
    try:
        assert arrived(receive_sweep(f"igtl://127.0.0.1:{port}", idle=1.0), made)
    finally:
        server.stop()


def test_a_restarted_stream_loses_nothing():
    made = small_sweep(30)
    server = Server(made)
    server.serve(slice(0, 11), slice(11, 12), slice(12, None))
    assert arrived(receive_sweep(server.address, idle=0.6), made)


def test_live_waits_for_the_better_world():
    made = small_sweep(6)
    server = Server(made, names=("ImageToTracker", "StylusToTracker", "ReferenceToTracker"))
    server.serve(slice(None))
    frames = list(receive(server.address, {}, idle=0.4))
    assert [frame.world for frame in frames] == ["Reference"] * 6
    # All three are the same matrix here, so that Reference is Image.
    assert np.allclose(frames[3].world_from_image, np.eye(4), atol=1e-4)


def test_live_reconstruct(sweep, capsys):
    pytest.importorskip("pyigtl", reason="live needs pyigtl")
    server = Server(sweep)
    server.serve(slice(None))
    words = ["reconstruct", "--live", server.address, "--idle", "0.5", "-o", "v.npz", *CPU]
    facts = run_json(capsys, *words, "--spacing", "1")
    assert facts["frames"]["used"] == 24 and facts["live"]["grew"]
    live = read_volume("v.npz")
    low, high = sweep.bounds()
    first = live.world_from_voxel[:3, 3]
    assert (first - 0.51 <= low).all()
    assert (first + live.values.shape[::-1] - 0.49 >= high).all()
    assert 50 < live.values[live.measured].mean() < 130
    # Without a spacing the frames are collected first, and the file's volume comes out.
    server = Server(sweep)
    server.serve(slice(None))
    words = ["reconstruct", "--live", server.address, "--idle", "0.5", "-o", "v.npz", *CPU]
    assert not run_json(capsys, *words, "--size", "40")["live"]["grew"]
    assert main(["reconstruct", "phantom.igs.mha", "-o", "w.npz", "--size", "40", *CPU]) == 0
    live, file = read_volume("v.npz"), read_volume("w.npz")
    assert live.values.shape == file.values.shape
    # Poses in float32 move a pixel in a thousand to the next voxel.
    assert (live.values != file.values).mean() < 0.02


def test_what_is_no_openigtlink_is_refused():
    listener = socket.create_server(("127.0.0.1", 0))

    def work():
        connection, _ = listener.accept()
        with connection:
            connection.sendall(b"HTTP/1.1 200 OK\r\n" + b"\xff" * 200)

    threading.Thread(target=work, daemon=True).start()
    pytest.importorskip("pyigtl", reason="live needs pyigtl")
    with pytest.raises(ValueError, match="OpenIGTLink") as caught:
        list(receive(f"igtl://127.0.0.1:{listener.getsockname()[1]}", {}, idle=0.5))
    assert "\n" not in str(caught.value)
    listener.close()


def test_addresses():
    assert parse_address("igtl://localhost") == ("localhost", 18944)
    assert parse_address("igtl://10.0.0.1:5000") == ("10.0.0.1", 5000)
    for wrong in ("localhost:3", "igtl://", "igtl://:3", "igtl://a:b", "igtl://a:99999"):
        with pytest.raises(ValueError, match="igtl://host:port"):
            parse_address(wrong)
