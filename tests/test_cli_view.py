"""`globule view` from the command line: mistakes in one line, with status 2 and no server."""

import sys

import numpy as np
import pytest
from cli_helpers import refused
from globule.cli import main

pytest.importorskip("websockets")


@pytest.fixture
def cloud(folder):
    np.savez("cloud.npz", positions=np.zeros((2, 3), np.float32), support=np.float32(1))
    return "cloud.npz"


def test_mistakes(cloud, capsys, folder, monkeypatch):
    for options, message in (
        (["empty.csv"], "empty.csv"),
        (["missing.vtk"], "missing.vtk: cannot be read: No such file or directory"),
        (["frame_*.vtk"], "frame_*.vtk"),
        (["no-such-scene.toml"], "no-such-scene.toml"),
        (["cloud.npz", "--port", "99999"], "--port: expected a whole number from 0 to"),
        (["cloud.npz", "--eye", "1,2,3"], "--eye: expected --eye and --look-at together"),
        (["cloud.npz", "--ortho", "2"], "--ortho: expected --eye and --look-at beside --ortho"),
        (["cloud.npz", "--color-by", "speed"], "--color-by: expected one of x, y, z, support, got"),
        (["cloud.npz", "--state", "none.toml"], "none.toml: cannot be read"),
        (["cloud.npz", "--state", "bad.toml"], "bad.toml: cuts.plane: expected true or false"),
        (["cloud.npz", "--host", "203.0.113.7"], "host: expected an address of this machine"),
        (["cloud.npz", "--host", "nowhere.invalid"], "host: expected an address of this machine"),
        (["igtl://127.0.0.1:18944"], '-m pip install "globule[live]"'),
        (["brain-surgery"], '-m pip install "globule[atlas]"'),
        (["cloud.npz", "--up", "0,0,0"], "--up: expected a direction other than 0,0,0"),
        (["igtl://"], "live: expected igtl://host:port, got 'igtl://'"),
    ):
        for missing in ("pyigtl", "pyigtl.messages", "nilearn"):
            monkeypatch.setitem(sys.modules, missing, None)
        (folder / "empty.csv").write_text("x,y,z\n")
        (folder / "bad.toml").write_text("[cuts]\nplane = 3\n")
        assert message in refused(capsys, "view", "--no-browser", "--port", "0", *options)


def test_options_become_settings(cloud, monkeypatch, tmp_path):
    from globule import viewer

    seen = {}

    def show(source, host, port, up, camera, state, preset, browser, **options):
        seen.update(locals())
        raise KeyboardInterrupt

    monkeypatch.setattr(viewer, "show", show)
    state = tmp_path / "view.toml"
    state.write_text("[quality]\nsamples = 3\n")
    words = f"--state {state} --threshold 0.8 --color-by y --range -1,2 --clip 0,2,0,1 "
    words += "--eye 0,0,5 --look-at 0,0,0 --port 8123 --no-browser"
    assert main(["view", cloud, *words.split()]) == 130
    settings = seen["state"]
    assert settings.quality.samples == 3
    assert settings.surface.threshold == 0.8
    assert (settings.color.by, settings.color.low, settings.color.high) == ("y", -1.0, 2.0)
    assert settings.cuts.plane
    assert settings.cuts.point == pytest.approx((0, 0.5, 0))
    assert seen["camera"].eye == (0.0, 0.0, 5.0)
    assert seen["port"] == 8123
    assert not seen["browser"]


@pytest.fixture
def served(monkeypatch):
    """The viewers that commands would show, which end at once."""
    from globule.viewer.app import Viewer

    viewers = []
    monkeypatch.setattr(Viewer, "open_browser", lambda viewer: viewers.append("a browser"))
    monkeypatch.setattr(Viewer, "wait", lambda viewer: (viewers.append(viewer), viewer.close()))
    return viewers


def test_simulate_opens_the_viewer(served, folder, capsys):
    words = ["simulate", "dam-break", "--spacing", "0.08", "--port", "0"]
    assert main([*words, "--view", "--no-browser"]) == 0
    (viewer,) = served
    assert viewer.source.simulation.n_steps == 0
    assert viewer.state.look.preset == "water"
    assert viewer.source.simulation.settings.spacing == 0.08
    assert not list(folder.iterdir())
    assert main([*words, "--seconds", "0.05", "--no-frames"]) == 0
    assert main([*words, "--view", "--resume"]) == 0
    _, opened, viewer = served
    assert opened == "a browser"
    assert viewer.source.simulation.time == pytest.approx(1 / 30)
    capsys.readouterr()
    assert "expected no --video beside --view" in refused(capsys, *words, "--view", "--video", "dam.mp4")
    assert "expected none/checkpoint.npz" in refused(capsys, *words, "--view", "--resume", "-o", "none")


def test_a_simulation_looks_as_its_scene_says(served, tmp_path):
    assert main(["view", "poiseuille", "--no-browser", "--port", "0"]) == 0
    (viewer,) = served
    color = viewer.state.color
    assert (color.by, color.automatic, color.low, color.high) == ("speed", False, 0.0, 0.125)
    import globule as gb
    from globule.sim.pictures import Eye
    from globule.viewer.recording import Shot

    viewer.state.set(color__legend=False)
    source = viewer.source
    picture = Shot(viewer.engine, source.camera, (160, 120), 1).picture
    headless = Eye(source.simulation.file, (160, 120)).picture(source.simulation).picture
    assert isinstance(source.simulation, gb.Simulation)
    # Shots have no more samples at edges, images of `globule simulate` do.
    assert np.abs(picture.astype(int) - headless).mean() < 0.5
