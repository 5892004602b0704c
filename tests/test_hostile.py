"""What a clumsy or hostile user gives is refused in one short line, and changes nothing."""

import json
import logging
import os
import pickle
import struct
import zipfile
from pathlib import Path

import globule as gb
import numpy as np
import pytest
from cli_helpers import refused, refuses
from globule.formats import FormatError, kind_of
from globule.formats.pictures.environment import read_environment
from test_sim_checkpoints import SCENE

NAN = float("nan")
POSITIONS = np.random.default_rng(1).normal(size=(40, 3)).astype(np.float32)
SMALL = {
    "spacing": 0.1,
    "domain": {"lo": [0, 0, 0], "hi": [1, 0.4, 0.8], "walls": True},
    "fluids": [{"name": "water", "box": {"lo": [0, 0, 0], "hi": [0.4, 0.4, 0.4]}}],
}
pytestmark = pytest.mark.usefixtures("folder")


@pytest.fixture
def scene():
    return gb.Scene(POSITIONS, device="cpu")


def one_line(error: pytest.ExceptionInfo) -> str:
    text = str(error.value)
    assert "\n" not in text
    assert len(text) < 320
    return text


# Calls


def test_the_argument_is_named_in_one_line(scene):
    for call, named in (
        (lambda s: gb.Camera.fit(s, size="x"), "size"),
        (lambda s: gb.Camera.fit(s, fov=0), "fov"),
        (lambda s: gb.Camera.fit(s, up=(1, 2)), "up"),
        (lambda s: gb.Camera.fit(s, margin="1"), "margin"),
        (lambda s: gb.Camera.fit(s, orthographic=np.zeros(2)), "orthographic"),
        (lambda s: gb.Scene(POSITIONS, kernel=np.zeros(3)), "kernel"),
        (lambda s: gb.Scene(POSITIONS, octree=np.zeros(3)), "octree"),
        (lambda s: gb.Scene(POSITIONS, key_bits=np.zeros(3)), "key_bits"),
        (lambda s: gb.Scene(POSITIONS, bounds="x"), "bounds"),
        (lambda s: gb.Scene(POSITIONS, level=10**5000), "level"),
        (lambda s: gb.Scene(POSITIONS, device="cuda:²"), "device"),
        (lambda s: gb.Particles(POSITIONS, anisotropy=[[1, 2], [3]]), "anisotropy"),
        (lambda s: gb.RenderSettings(shadows=np.zeros((30, 30))), "shadows"),
        (lambda s: gb.RenderSettings(exposure="x" * 5000), "exposure"),
        (lambda s: gb.RenderSettings(lights=memoryview(POSITIONS)), "lights"),
        (lambda s: gb.Material(color=np.zeros((9, 9, 9))), "color"),
        (lambda s: gb.render(s, color_by="x", colormap=[]), "colormap"),
        (lambda s: gb.render(s, color_by=np.zeros((9, 9))), "color_by"),
        (lambda s: gb.render(s, color_by="x", range=np.zeros((3, 3, 3))), "range"),
        (lambda s: gb.render(s, size=list(range(10000))), "size"),
    ):
        with pytest.raises((TypeError, ValueError)) as error:
            call(scene)
        assert one_line(error).startswith(f"{named}: expected ")


def test_a_number_is_no_path():
    """Python's `open` takes numbers, and closes what they stand for."""
    number = os.open(os.devnull, os.O_RDONLY)
    for reader in (gb.read, gb.volumes.read_volume, gb.ultrasound.read_sweep, read_environment):
        for value in (number, True, b"a.npz", None):
            refuses("path: expected a path, got", reader, value, error=TypeError)
        refuses("path: expected a path without a null byte", reader, "a\0.npz")
    os.close(number)  # still open


class Stop(Exception):
    pass


@pytest.mark.parametrize("at", [1, 2, 4])
def test_what_progress_raises_comes_through_and_leaves_the_scene_usable(scene, at):
    settings = {"samples": 4}
    expected = gb.render(scene, (24, 16), settings=settings).color

    def stop(done, total):
        if done == at:
            raise Stop

    with pytest.raises(Stop):
        gb.render(scene, (24, 16), settings=settings, progress=stop)
    again = gb.render(scene, (24, 16), settings=settings, progress=lambda *_: gb.render(scene, (4, 4)))
    assert np.array_equal(again.color, expected)


# Files


@pytest.mark.parametrize(
    "reader", [gb.read, gb.volumes.read_volume, gb.ultrasound.read_sweep, gb.Environment, gb.render]
)
def test_pipes_and_devices_are_refused_at_once(reader):
    os.mkfifo("pipe.npz")
    os.symlink("/dev/zero", "zero.vti")
    for name in ("pipe.npz", "zero.vti"):
        refuses(f"{name}: .* got a pipe or a device", reader, name, error=FormatError)


def test_data_beside_a_header_that_is_no_file():
    gb.volumes.write_volume("v.mha", gb.volumes.Volume(np.zeros((2, 2, 2), np.uint8), np.eye(4)))
    head = Path("v.mha").read_bytes().partition(b"ElementDataFile")[0]
    os.mkfifo("pipe")
    os.mkdir("d")
    for name in (b"pipe", b"d", b"none", b"a\0b"):
        Path("v.mhd").write_bytes(head + b"ElementDataFile = " + name + b"\n")
        refuses("ElementDataFile", gb.volumes.read_volume, "v.mhd", error=FormatError)


def test_a_picture_s_damage_is_a_format_error():
    gb.save_png("a.png", np.zeros((8, 16, 3), np.uint8))
    content = Path("a.png").read_bytes()
    for place, number in ((8, 5), (16, 2**31 - 1)):
        damaged = content[:place] + struct.pack(">I", number) + content[place + 4 :]
        Path("b.png").write_bytes(damaged)
        refuses(r"b\.png: ", gb.Environment, "b.png", error=FormatError)


def test_an_obj_whose_vertex_lacks_a_number(caplog):
    Path("a.obj").write_text("v 0 0 0\nv  0 0\nv 0 1 0\nf 1 2 3\n", encoding="utf-8")
    refuses(r"a\.obj: ", gb.read, "a.obj", error=FormatError)
    assert logging.getLogger("trimesh").handlers  # else Python prints what trimesh logs


def test_a_dicom_file_that_says_it_is_larger_than_its_bytes():
    sitk = pytest.importorskip("SimpleITK")
    sitk.WriteImage(sitk.GetImageFromArray(np.ones((16, 16), np.uint8)), "a.dcm")
    with open("a.dcm", "rb") as file:
        content = bytearray(file.read())
    for tag in (b"\x28\0\x10\0\2\0\0\0", b"\x28\0\x11\0\2\0\0\0"):
        at = content.index(tag) + len(tag)
        content[at : at + 2] = b"\xff\xff"
    Path("a.dcm").write_bytes(content)
    for reader in (gb.volumes.read_volume, gb.ultrasound.read_sweep):
        with pytest.raises(FormatError) as error:
            reader("a.dcm")
        assert "expected at most" in one_line(error)


def test_a_name_of_two_lines_stays_one_line():
    gb.save_png("a\nb", np.zeros((2, 2, 3), np.uint8))
    with pytest.raises(FormatError) as error:
        gb.read("a\nb")
    one_line(error)


def test_endless_nesting_is_no_crash():
    Path("deep.toml").write_text("a = " + "[" * 5000, encoding="utf-8")
    Path("deep.json").write_text("[" * 100_000, encoding="utf-8")
    assert kind_of("deep.toml").kind == "scene"
    for call in (
        lambda: gb.Simulation("deep.toml", device="cpu"),
        lambda: gb.CameraPath.load("deep.toml"),
        lambda: gb.CameraPath.load("deep.json"),
    ):
        refuses(r"deep\.(toml|json)", call)


def test_random_bytes_are_of_some_kind_or_refused():
    rng = np.random.default_rng(7)
    starts = (b"", b"\x1f\x8b", b"PK\3\4", b"<VTKFile", b"ply\n", b"BM", b"NRRD000", b"\x93NUMPY",
              b"solid ", b"v 1 2 3\n", b"3\n", b"[a]\n", b"NDims = 3\nDimSize")  # fmt: skip
    refusals = []
    kinds = {"particles", "mesh", "volume", "sweep", "picture", "scene"}
    for i in range(800):
        Path("f").write_bytes(starts[i % len(starts)] + rng.bytes(int(rng.integers(0, 300))))
        try:
            assert kind_of("f").kind in kinds
        except FormatError as error:
            refusals.append(str(error))
    assert len(refusals) > 400
    assert all(text.startswith("f: expected ") for text in refusals)


# Commands


def test_state_files(capsys):
    np.savez("c.npz", positions=POSITIONS)
    words = ("render", "c.npz", "-o", "a.png", "--state")
    for content, message in (
        (b"\xff\xfe", "expected text in UTF-8, got data that is no text"),
        (b"[look]\na__b = 1\n", "look.a__b: expected one of"),
        (b"[cuts]\nplane = 3\n", "s.toml: cuts.plane: expected true or false"),
        (b"a = " + b"[" * 5000, "expected fewer tables and lists inside each other"),
        (b"a = " + b"9" * 5000, "digits"),
    ):
        Path("s.toml").write_bytes(content)
        assert message in refused(capsys, *words, "s.toml")
    assert "none.toml: cannot be read" in refused(capsys, *words, "none.toml")


@pytest.mark.parametrize("flag", ["--opacity", "--sky", "--size", "-o"])
def test_two_dashes_are_no_value(capsys, flag):
    np.savez("c.npz", positions=POSITIONS)
    line = refused(capsys, "render", "c.npz", "-o", "a.png", f"{flag}=--")
    assert "expected a value, got '--'" in line


def test_a_camera_path_without_end(capsys):
    np.savez("c.npz", positions=POSITIONS)
    os.symlink("/dev/zero", "path.toml")
    line = refused(capsys, "render", "c.npz", "-o", "a.mp4", "--camera-path", "path.toml")
    assert "expected at most" in line


def test_a_file_is_not_converted_onto_itself(capsys):
    """A volume would become particles."""
    gb.volumes.write_volume("v.npz", gb.volumes.Volume(np.full((4, 4, 4), 9, np.uint8), np.eye(4)))
    os.symlink("v.npz", "link.npz")
    np.savez("c.npz", positions=POSITIONS)
    for words in (("v.npz", "v.npz", "--level", "3"), ("v.npz", "link.npz"), ("c.npz", "c.npz")):
        assert "OUT: expected another file than IN" in refused(capsys, "convert", *words)
    assert gb.volumes.read_volume("v.npz").shape == (4, 4, 4)


# Simulations


@pytest.fixture(scope="module")
def full():
    return gb.Simulation(SCENE, device="cpu")


@pytest.mark.parametrize(
    ("mistake", "named"),
    [
        (lambda s: s.tools.set_pushers([(99, (0, 0, 0), (0, 0, 0), 0.1, (0, 0, 0))]), "kind"),
        (lambda s: s.tools.set_pushers([(0, (NAN, 0, 0), (0, 0, 0), 0.1, (0, 0, 0))]), "shapes"),
        (lambda s: s.tools.set_pushers(["x"]), "shapes"),
        (lambda s: s.tools.move_grasp(0, (NAN, 0, 0)), "velocity"),
        (lambda s: s.tools.grasp((NAN, 0, 0), 0.1), "center"),
        (lambda s: s.tools.grasp((0, 0, 0), -1), "radius"),
        (lambda s: s.tools.grasp((0, 0, 0), 0.1, 1.5), "number"),
        (lambda s: s.steer.set_sinks([((NAN, 0, 0), 0.1)]), "sinks"),
        (lambda s: s.steer.set_sinks(["x"]), "sinks"),
        (lambda s: s.steer.body("water"), "rigid"),
        (lambda s: s.steer.make_rigid("raft", NAN), "density"),
        (lambda s: s.steer.make_rigid("raft", 500, (NAN, 0, 0)), "velocity"),
        (lambda s: s.steer.move_boundary("paddle", np.full((4, 4), NAN)), "pose"),
        (lambda s: s.steer.move_boundary("paddle", np.diag([2, 2, 2, 1])), "pose: expected a rot"),
        (lambda s: s.steer.move_boundary("water", np.eye(4)), "boundary"),
        (lambda s: s.steer.apply_force((0, 0, 1), ids=[s.ids[0]] * 3), "each particle once, got 2"),
        (lambda s: s.add([(0.1, 0.1, 0.1)], phase=0), "phase: expected one of"),
        (lambda s: s.add([(0.1, 0.1, 0.1)], phase=[]), "phase: expected one of"),
        (lambda s: s.add(np.ma.masked_array([(0.1, 0.1, 0.1)], [(1, 0, 0)]), "water"), "masked"),
        (lambda s: s.save(""), "name: expected a file's name"),
        (lambda s: s.tissue.ablate((0, 0, 0), -1), "radius"),
        (lambda s: s.tissue.bond(s.ids[:3], young=[1, 2]), "young"),
        (lambda s: s.tissue.bond([-1]), "ids"),
        (lambda s: s.remove([1.5]), "ids"),
        (lambda s: s.remove([True]), "ids"),
        (lambda s: s.steer.apply_force((0, 0, 1), ids=["x"]), "ids"),
        (lambda s: s.step(5e-324), "dt"),
        (lambda s: s.step(1e300), "dt"),
        (lambda s: s.step("1"), "dt"),
        (lambda s: s.run("1"), "seconds"),
        (lambda s: setattr(s, "settings", 1), "settings"),
        (lambda s: setattr(s, "phases", {}), "phases"),
        (lambda s: setattr(s, "gravity", (0, 0, 0)), "gravity"),
        (lambda s: s.phases.pop("water"), "phases"),
        (lambda s: s.phases.clear(), "phases"),
        (lambda s: s.phases.update(oil=1), "phases"),
        (lambda s: s.emitters.update(oil=1), "emitters"),
        (lambda s: s.emitters.setdefault("oil", 1), "emitters"),
        (lambda s: gb.Simulation(SMALL, spacing="x"), "spacing"),
    ],
)
def test_a_mistake_does_not_reach_the_simulation(full, mistake, named):
    before, by_hand = full.hash(), json.dumps(full._by_hand())
    with pytest.raises((TypeError, ValueError, AttributeError)) as error:
        mistake(full)
    assert named in one_line(error)
    assert (full.hash(), json.dumps(full._by_hand())) == (before, by_hand)


def test_it_still_runs_after_all_of_them(full):
    assert full.step().n == len(full)


def test_a_rigid_body_made_by_hand_is_known_after_loading():
    sim = gb.Simulation(SMALL, device="cpu")
    sim.add_phase(gb.sim.Phase("raft", kind="rigid"))
    refuses("expected a rigid body", sim.steer.body, "raft")
    sim.add([[0.7, 0.2, 0.2], [0.8, 0.2, 0.2]], "raft")
    sim.steer.make_rigid("raft", 500)
    sim.save("state")
    again = gb.Simulation.load("state", device="cpu")
    assert np.allclose(again.steer.body("raft")["center"], [0.75, 0.2, 0.2])


def test_a_checkpoint_whose_array_lies_about_its_size():
    gb.Simulation(SMALL, device="cpu").save("a")
    with zipfile.ZipFile("a.npz") as old, zipfile.ZipFile("b.npz", "w") as new:
        for info in old.infolist():
            content = old.read(info)
            if info.filename == "place.npy":
                content = content.replace(b"'shape': (", b"'shape': (9999999999, ", 1)
            new.writestr(info.filename, content)
    with pytest.raises(ValueError, match=r"^b\.npz: expected a checkpoint of a simulation, got (?!b\.npz)"):
        gb.Simulation.load("b", device="cpu")
    with pytest.raises(FileNotFoundError):
        gb.Simulation.load("none")


def test_checked_dicts_are_pickled_as_they_are(full):
    assert dict(full.phases) == dict(full.phases | {})
    assert pickle.loads(pickle.dumps(dict(full.phases))).keys() == full.phases.keys()
