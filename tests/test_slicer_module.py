"""The work of the module for 3D Slicer, outside of Slicer."""

import ast
import socket
import sys
from pathlib import Path

import globule as gb
import numpy as np
import pytest
from waiting import until

FOLDER = Path(__file__).resolve().parents[1] / "integrations" / "slicer" / "Globule"
pytestmark = pytest.mark.usefixtures("folder")


@pytest.fixture
def work(monkeypatch):
    if not FOLDER.is_dir():
        pytest.skip("needs integrations/slicer of the repository")
    monkeypatch.syspath_prepend(str(FOLDER))
    import globule_slicer

    return globule_slicer


def test_what_pip_installs_and_the_command_of_a_live_run(work, tmp_path):
    assert work.installed()
    assert work.requirement() == "globule[live,medical,measure]"
    wheel = Path("globule-1.0-cp312-abi3-linux_x86_64.whl")
    wheel.write_bytes(b"")
    assert work.requirement(str(wheel)) == f"{wheel.absolute()}[live,medical,measure]"
    with pytest.raises(FileNotFoundError):
        work.requirement("globule-2.0.whl")
    with pytest.raises(ValueError, match=r"globule-….whl"):
        work.requirement("numpy-2.0.whl")
    # Into the Python of Slicer.
    with pytest.raises(FileNotFoundError):
        work.slicer_python(str(tmp_path))
    (tmp_path / "bin").mkdir()
    (tmp_path / "bin" / "PythonSlicer").write_text("")
    assert work.slicer_python(str(tmp_path)) == str(tmp_path / "bin" / "PythonSlicer")
    words = work.LiveSettings(tracker="igtl://t:1", record="kept").command("python")
    assert (words[:4], words[words.index("--space") + 1]) == (["python", "-m", "globule", "reconstruct"], "RAS")
    assert (words[words.index("--tracker") + 1], words[words.index("--record") + 1]) == ("igtl://t:1", "kept")
    assert "--calibration" not in words
    with pytest.raises(ValueError, match="voxel size"):
        work.LiveSettings(voxel_size=0).command("python")
    with pytest.raises(ValueError, match="images: expected igtl"):
        work.LiveSettings(images="").command("python")


def test_a_file_and_its_frames_give_the_same_volume(work, sweep):
    of_file, ras = work.reconstruct_file("phantom.igs.mha", 1.0), np.diag([-1.0, -1.0, 1.0, 1.0])
    of_frames = work.reconstruct_frames(sweep.frames, ras @ sweep.world_from_image, 1.0, sweep.timestamps)
    expected = gb.ultrasound.reconstruct(gb.ultrasound.read_sweep("phantom.igs.mha"), spacing=1.0)
    x, y, z = expected.shape[2] // 2, expected.shape[1] // 2, expected.shape[0] // 2
    for shown in (of_file, of_frames):
        assert "24 of 24 frames" in shown.text
        assert set(np.unique(shown.trust)) <= {0, 1, 2}
        # The same place, in RAS.
        place = ras @ expected.world_from_voxel @ (x, y, z, 1)
        at = np.rint(np.linalg.inv(shown.ras_from_voxel) @ place).astype(int)[:3]
        assert abs(int(shown.values[tuple(at[::-1])]) - int(expected.values[z, y, x])) < 60
    assert of_file.values.mean() == pytest.approx(of_frames.values.mean(), rel=0.05)


@pytest.mark.slow
def test_a_live_run_ends_with_a_volume(work, sweep):
    pytest.importorskip("pyigtl", reason="live needs pyigtl")
    from live_helpers import Server

    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    server = Server(sweep)
    settings = work.LiveSettings(images=server.address, voxel_size=1.0, port=port, record="kept", output="v.nrrd")
    run = work.LiveRun(settings, sys.executable)
    assert run.running
    server.serve(slice(None))
    table = Path("kept/poses.csv")
    until(lambda: table.is_file() and table.read_bytes().count(b"\n") == 25, "for all frames")
    text = run.stop()
    assert not run.running
    assert "24 frames" in text
    assert gb.volumes.read_volume("v.nrrd", space="RAS").values.max() > 100


def test_the_panel_s_file_names_what_exists(work):
    """The panel runs in Slicer only; all that it takes from the work exists."""
    tree = ast.parse((FOLDER / "Globule.py").read_text())
    used = {
        node.attr for node in ast.walk(tree)
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name)
        and node.value.id == "work"
    }  # fmt: skip
    assert {"LiveRun", "reconstruct_file", "reconstruct_frames", "requirement"} <= used
    assert all(hasattr(work, name) for name in used)
    names = {node.name for node in tree.body if isinstance(node, ast.ClassDef)}
    assert names == {"Globule", "GlobuleWidget"}
