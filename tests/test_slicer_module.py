"""The work of the module for 3D Slicer, outside of Slicer."""

import ast
import importlib
import socket
import sys
from pathlib import Path
from types import SimpleNamespace

import globule as gb
import numpy as np
import pytest
from waiting import until

FOLDER = Path(__file__).resolve().parents[1] / "integrations" / "slicer" / "Globule"
pytestmark = pytest.mark.usefixtures("folder", "sweep")


@pytest.fixture
def work(monkeypatch):
    if not FOLDER.is_dir():
        pytest.skip("needs integrations/slicer of the repository")
    monkeypatch.syspath_prepend(str(FOLDER))
    import globule_slicer

    return globule_slicer


def test_what_pip_installs_and_the_command_of_a_live_run(work, tmp_path):
    assert work.installed()
    assert work.requirement() == "globule[live,medical,measure,figures]"
    wheel = Path("globule-1.0-cp312-abi3-linux_x86_64.whl")
    wheel.write_bytes(b"")
    assert work.requirement(str(wheel)) == f"{wheel.absolute()}[live,medical,measure,figures]"
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


def test_what_is_no_file_and_no_sequence(work):
    with pytest.raises(ValueError, match="sweep: expected a file, got none"):
        work.reconstruct_file("", 1.0)
    one, pose = np.zeros((4, 5), np.uint8), np.eye(4)
    with pytest.raises(ValueError, match="sequence: expected images of one size, got none"):
        work.reconstruct_frames([], [], 1.0)
    with pytest.raises(ValueError, match=r"sequence: expected images of one size, got \(4, 5\), \(5, 4\)"):
        work.reconstruct_frames([one, one.T], [pose, pose], 1.0)
    with pytest.raises(ValueError, match=r"frames: expected shape \(F, H, W\)"):
        work.reconstruct_frames([one[..., None]] * 2, [pose, pose], 1.0)


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


@pytest.fixture
def panel(work, monkeypatch, tmp_path):
    """The panel, in a stub of Slicer."""
    pytest.importorskip("vtk", reason="vtk is not installed")
    import slicer_stub

    seen = slicer_stub.installed(monkeypatch, tmp_path)
    monkeypatch.delitem(sys.modules, "Globule", raising=False)
    module = importlib.import_module("Globule")
    about = SimpleNamespace()
    module.Globule(about)
    assert about.title == "Globule"
    widget = module.GlobuleWidget()
    widget.setup()
    yield widget, seen
    widget.cleanup()
    assert not widget.timer.on
    monkeypatch.delitem(sys.modules, "Globule", raising=False)


def press(seen, button):
    seen.buttons[button].clicked.emit()


def test_the_panel_installs_and_reconstructs_a_file(panel):
    widget, seen = panel
    press(seen, "Install globule")
    assert seen.pip == ["globule[live,medical,measure,figures]"]
    assert widget.status.text == "globule is installed"
    widget.sweep.currentPath, widget.voxelSize.value = "phantom.igs.mha", 1.0
    press(seen, "Reconstruct file")
    image, trust = seen.scene.nodes
    expected = gb.ultrasound.reconstruct(gb.ultrasound.read_sweep("phantom.igs.mha"), spacing=1.0)
    assert (image.name, image.kind) == ("Ultrasound", "vtkMRMLScalarVolumeNode")
    assert (trust.name, trust.kind) == ("Trust", "vtkMRMLLabelMapVolumeNode")
    assert seen.background is image
    assert image.values.shape == trust.values.shape
    assert image.values.mean() == pytest.approx(expected.values.mean(), rel=0.05)
    assert "24 of 24 frames" in widget.status.text
    widget.sweep.currentPath = "none.mha"
    press(seen, "Reconstruct file")
    assert len(seen.errors) == 1
    assert "none.mha" in seen.errors[0]


def test_the_panel_reconstructs_a_sequence(panel, sweep):
    """Images and poses of the nodes that the browser changes."""
    from slicer_stub import Browser, Image, Transform

    widget, seen = panel
    press(seen, "Reconstruct sequence")
    assert "expected a sequence browser, got none" in seen.errors.pop()
    ras = np.diag([-1.0, -1.0, 1.0, 1.0])
    transform = Transform("vtkMRMLLinearTransformNode", "ImageToReference", world=np.eye(4))
    # The pose is partly the image's own and partly its transform's.
    own = np.diag([2.0, 2.0, 2.0, 1.0])
    image = Image("vtkMRMLScalarVolumeNode", "Image", values=None, ras_from_ijk=own, parent=transform)
    worlds = ras @ sweep.world_from_image @ np.linalg.inv(own)
    browser = Browser("vtkMRMLSequenceBrowserNode", image=image, transform=transform,
                      images=[frame[None] for frame in sweep.frames], worlds=worlds)  # fmt: skip
    widget.browser.node, widget.voxelSize.value = browser, 1.0
    press(seen, "Reconstruct sequence")
    assert seen.errors == []
    found = seen.background
    widget.sweep.currentPath = "phantom.igs.mha"
    press(seen, "Reconstruct file")
    of_file = seen.background
    assert found is not of_file
    assert np.abs(np.subtract(found.values.shape, of_file.values.shape)).max() <= 1
    # The same place, in RAS.
    z, y, x = np.array(of_file.values.shape) // 2
    at = np.rint(np.linalg.inv(found.ras_from_ijk) @ of_file.ras_from_ijk @ (x, y, z, 1)).astype(int)[:3]
    assert abs(int(found.values[tuple(at[::-1])]) - int(of_file.values[z, y, x])) < 60
    assert found.values.mean() == pytest.approx(of_file.values.mean(), rel=0.05)


@pytest.mark.slow
def test_the_panel_runs_live(panel, sweep):
    pytest.importorskip("pyigtl", reason="live needs pyigtl")
    from live_helpers import Server
    from slicer_stub import Image, Node

    widget, seen = panel
    with socket.create_server(("127.0.0.1", 0)) as free:
        widget.port.value = free.getsockname()[1]
    server = Server(sweep)
    widget.images.text, widget.voxelSize.value, widget.record.text = server.address, 1.0, "kept"
    press(seen, "Start")
    assert seen.errors == []
    (connector,) = seen.scene.nodes
    assert (connector.address, connector.on) == (("localhost", widget.port.value), True)
    assert widget.timer.on
    assert (widget.start.enabled, widget.stop.enabled) == (False, True)
    server.serve(slice(None))
    table = Path("kept/poses.csv")
    until(lambda: table.is_file() and table.read_bytes().count(b"\n") == 25, "for all frames")
    # What the connector makes of the messages.
    seen.scene.nodes += [Image("vtkMRMLScalarVolumeNode", "Volume"),
                         Node("vtkMRMLTextNode", "Counts", GetText=lambda: "24 images")]  # fmt: skip
    widget.timer.timeout.emit()
    assert widget.status.text == "24 images"
    assert seen.background.name == "Volume"
    seen.background = None
    widget.timer.timeout.emit()
    assert seen.background is None  # only once: the user may choose another one
    press(seen, "Stop")
    assert "24 frames" in widget.status.text
    assert not connector.on
    assert (widget.start.enabled, widget.stop.enabled) == (True, False)
    assert gb.volumes.read_volume("globule_live.nrrd", space="RAS").values.max() > 100
    # One that ends by itself is noticed.
    widget.images.text = "igtl://127.0.0.1:1"
    press(seen, "Start")
    widget.run.process.terminate()
    until(lambda: not widget.run.running, "for the end")
    widget.timer.timeout.emit()
    assert widget.run is None
    assert widget.start.enabled
    widget.images.text = "localhost"
    press(seen, "Start")
    assert "images: expected igtl://host:port" in seen.errors[-1]


def test_the_panel_shows_the_report_of_a_calibration(panel):
    """The command itself is tested elsewhere; here it is the shell's."""
    widget, seen = panel
    press(seen, "Calibrate")
    assert "phantom: expected a file, got none" in seen.errors.pop()
    python = Path("slicer/bin/PythonSlicer")

    def answers(status, *files):
        names = " ".join(f"globule_{name}" for name in files)
        python.write_text(f'#!/bin/sh\necho "$@" > words\necho verdict\n{names and "touch " + names}\nexit {status}\n')

    widget.phantom.currentPath, widget.wires.currentPath = "phantom.toml", "wires.igs.mha"
    answers(0, "probe.toml", "report.html")
    press(seen, "Calibrate")
    words = Path("words").read_text().split()
    assert words[:7] == ["-m", "globule", "calibrate", "--n-wire", "phantom.toml", "--sweep", "wires.igs.mha"]
    assert "--validate" not in words
    assert seen.opened == [f"file://{Path('globule_report.html').absolute()}"]
    assert widget.calibration.currentPath == str(Path("globule_probe.toml").absolute())
    assert widget.status.text == "verdict\n"
    widget.calibration.currentPath, widget.more.currentPath = "", "more.igs.mha"
    answers(1, "probe.toml", "report.html")  # not to be used
    press(seen, "Calibrate")
    assert "--validate more.igs.mha" in Path("words").read_text()
    assert len(seen.opened) == 2
    assert widget.calibration.currentPath == ""
    answers(2)
    press(seen, "Calibrate")
    assert seen.errors == ["No calibration: verdict"]
    assert len(seen.opened) == 2


@pytest.mark.slow
def test_a_calibration_by_plus_s_recordings(work, tmp_path):
    pytest.importorskip("matplotlib")
    data = Path(__file__).resolve().parents[2] / "shared" / "data" / "calibration"
    if not data.is_dir():
        pytest.skip("needs shared/data")
    sweeps = [str(data / f"fCal_Test_{name}_3NWires.igs.mha") for name in ("Calibration", "Validation")]
    found = work.calibrate(str(data / "spatial_calibration_1.2.xml"), *sweeps, str(tmp_path))
    assert "N-wire calibration" in Path(found.report).read_text()
    assert gb.ultrasound.read_calibration(found.calibration).error > 0
    assert "verdict: " in found.text
    with pytest.raises(RuntimeError, match=r"none\.xml"):
        work.calibrate("none.xml", *sweeps, str(tmp_path))
