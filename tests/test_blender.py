"""The add-on for Blender, in a Python that has bpy: this one, or the one that BPY_PYTHON names."""

import json
import os
import subprocess
import sys
from pathlib import Path

import globule as gb
import numpy as np
import pytest
from globule._demo.data import dam_break_particles
from PIL import Image
from waiting import PATIENCE

ADDON = Path(__file__).resolve().parents[1] / "integrations" / "blender"
PYTHON = os.environ.get("BPY_PYTHON", sys.executable)
pytestmark = [pytest.mark.interop, pytest.mark.slow]
BEGIN = f"""
import json, os, sys
import bpy
import numpy as np
sys.path.insert(0, {str(ADDON.parent)!r})
import blender
bpy.ops.wm.read_factory_settings(use_empty=True)
blender.register()
scene, found = bpy.context.scene, {{}}

def points():
    data = bpy.context.view_layer.objects.active.data
    places = np.empty(3 * len(data.vertices), np.float32)
    data.vertices.foreach_get("co", places)
    return places.reshape(-1, 3)

def values(name, kind, n):
    data = bpy.context.view_layer.objects.active.data.attributes[name].data
    found = np.empty(n * len(data), np.float32)
    data.foreach_get(kind, found)
    return found.reshape(-1, n)
"""
# bpy may wait for ever for its threads at the end of a program.
END = "\njson.dump(found, open('found.json', 'w'))\nsys.stdout.flush()\nos._exit(0)\n"


@pytest.fixture
def blender(tmp_path, monkeypatch):
    """Runs a program with the add-on, and returns what it found."""
    if not ADDON.is_dir():
        pytest.skip("needs integrations/blender of the repository")
    monkeypatch.chdir(tmp_path)
    (tmp_path / "globule").symlink_to(Path(gb.__file__).parent)
    environment = {**os.environ, "PYTHONPATH": str(tmp_path)}
    code = "import bpy, globule, os; print('both'); os._exit(0)"
    both = subprocess.run([PYTHON, "-c", code], env=environment, capture_output=True, text=True, timeout=PATIENCE)
    if "both" not in both.stdout:
        pytest.skip("no bpy: pip install bpy, or name a Python that has it: BPY_PYTHON")

    def run(program):
        Path("program.py").write_text(BEGIN + program + END)
        command = [PYTHON, "program.py"]
        done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=PATIENCE)
        assert Path("found.json").is_file(), done.stdout + done.stderr
        return json.loads(Path("found.json").read_text())

    return run


def frames() -> list[gb.Particles]:
    splash, spacing = dam_break_particles()
    positions = np.asarray(splash.positions)[:3000]
    velocity = np.tile(np.float32([24 * 20 * spacing, 0, 0]), (len(positions), 1))  # 20 spacings a frame
    speed = np.linspace(0, 2, len(positions), dtype=np.float32)
    arrays = {"velocity": velocity, "speed": speed}
    return [gb.Particles(positions + np.float32([i * spacing, 0, 0]), attributes=arrays) for i in range(3)]


def test_a_sequence_as_surfaces_and_as_points(blender):
    given = frames()
    for i, particles in enumerate(given):
        gb.write(f"run_{i}.vtp", particles)
    found = blender("""
settings = dict(start=5, color_by="speed", high=2, seconds=0.5 / 24)
found["done"] = list(bpy.ops.import_scene.globule(filepath="run_%d.vtp", **settings))
thing = bpy.context.view_layer.objects.active
found["turned"] = thing.rotation_euler.x
for frame in (1, 5, 6, 7, 30):
    scene.frame_set(frame)
    np.savez(f"surface_{frame}.npz", points=points(), velocity=values("velocity", "vector", 3),
             speed=values("speed", "value", 1), color=values("Color", "color", 4))
found["triangles"] = len(thing.data.polygons)
normals = np.empty(9 * found["triangles"], np.float32)
thing.data.corner_normals.foreach_get("vector", normals)
found["smooth"] = bool(thing.data.has_custom_normals)
bpy.ops.wm.save_as_mainfile(filepath=os.path.abspath("kept.blend"))
bpy.ops.wm.open_mainfile(filepath=os.path.abspath("kept.blend"))
bpy.context.scene.frame_set(6)
np.save("again.npy", points())
bpy.ops.import_scene.globule(filepath="run_0.vtp", kind="POINTS", options="where='speed > 1'")
np.save("points.npy", points())
found["radius"] = float(values("radius", "value", 1)[0, 0])
found["cloud"] = bpy.context.view_layer.objects.active.evaluated_get(
    bpy.context.evaluated_depsgraph_get()).data is not None
for wrong in ({"filepath": "none.vtp"}, {"filepath": "run_0.vtp", "color_by": "heat"}):
    try:
        bpy.ops.import_scene.globule(**wrong)
    except RuntimeError as error:
        found[list(wrong)[-1]] = str(error)
found["objects"] = len(bpy.data.objects), len(bpy.data.meshes)
""")
    assert found["done"] == ["FINISHED"]
    assert found["turned"] == pytest.approx(np.pi / 2)
    scene = gb.Scene(given[0], surface="smooth")
    mesh = gb.measure.mesh_surface(scene, 0.8 * scene.spacing)
    spacing = scene.spacing
    shown = {frame: dict(np.load(f"surface_{frame}.npz")) for frame in (1, 5, 6, 7, 30)}
    for frame, i in ((1, 0), (5, 0), (6, 1), (7, 2), (30, 2)):
        scene.update(given[i])
        places = shown[frame]["points"]
        away = np.abs(scene.field(places) - scene.threshold) / np.linalg.norm(scene.gradient(places), axis=1)
        assert len(places) > 0.5 * len(mesh.vertices)
        assert away.max() < 1e-3 * spacing
    assert len(shown[5]["points"]) == len(mesh.vertices)
    assert found["triangles"] > 1000
    assert found["smooth"]
    # A way in a second of the movie, for motion blur; values and their colors.
    way = given[0].attributes["velocity"][0] * 0.5
    assert np.allclose(shown[6]["velocity"], way, rtol=1e-4, atol=1e-6)
    assert np.ptp(shown[6]["speed"]) > 1.5
    assert shown[6]["color"][:, :3].std(axis=0).max() > 0.1
    assert np.array_equal(np.load("again.npy"), shown[6]["points"])
    chosen = gb.read("run_0.vtp", where="speed > 1")
    assert np.allclose(np.load("points.npy"), chosen.positions)
    assert found["radius"] == pytest.approx(spacing / 2, rel=0.2)
    assert "none.vtp" in found["filepath"]
    assert "heat" in found["color_by"]
    assert found["objects"] == [2, 2]


def test_frames_that_cannot_be_read_show_nothing(blender):
    given = frames()[0]
    hole = np.array(given.positions[:9])
    hole[4] = np.nan
    gb.write("run_0.vtp", given)
    gb.write("run_1.vtp", given[:0])
    Path("run_2.vtp").write_bytes(Path("run_0.vtp").read_bytes()[:3000])
    gb.write("run_3.vtp", gb.Particles(given.positions))  # without speed
    gb.write("run_4.vtp", given)
    gb.write("hole.vtp", gb.Particles(hole, attributes={"speed": np.arange(9.0)}))
    found = blender("""
found["points"] = {}
for kind in ("SURFACE", "POINTS"):
    bpy.ops.import_scene.globule(filepath="run_%d.vtp", color_by="speed", kind=kind)
    thing = bpy.context.view_layer.objects.active
    found["points"][kind] = []
    for frame in (1, 2, 3, 1, 4, 5):
        scene.frame_set(frame)
        found["points"][kind].append(len(thing.data.vertices) > 0)
for change in (5, "{}", "junk"):  # settings that are none leave the others alone
    bpy.data.objects[0]["globule"] = change
    scene.frame_set(1)
    found[str(change)] = len(bpy.data.objects[1].data.vertices)
    scene.frame_set(2)
bpy.ops.import_scene.globule(filepath="hole.vtp", kind="POINTS")
found["finite"] = [len(points()), bool(np.isfinite(points()).all()), values("speed", "value", 1).ravel().tolist()]
for options in ("scale=abs", "speed"):
    try:
        bpy.ops.import_scene.globule(filepath="hole.vtp", options=options)
    except RuntimeError as error:
        found[options] = str(error)
found["meshes"] = len(bpy.data.meshes)
""")
    shown = [True, False, False, True, False, True]
    assert found["points"] == {"SURFACE": shown, "POINTS": shown}
    assert found["5"] == found["{}"] == found["junk"] == len(given)
    assert found["finite"] == [8, True, [0, 1, 2, 3, 5, 6, 7, 8]]
    assert "Options: expected arguments such as where=" in found["scale=abs"]
    assert "got 'speed'" in found["speed"]
    assert found["meshes"] == 3


def test_images_by_cycles_with_motion_blur(blender):
    gb.write("one.vtp", frames()[0])
    blender("""
camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
sun = bpy.data.objects.new("sun", bpy.data.lights.new("sun", "SUN"))
for one in (camera, sun):
    scene.collection.objects.link(one)
scene.camera = camera
scene.render.engine, scene.cycles.device, scene.cycles.samples = "CYCLES", "CPU", 4
scene.render.resolution_x, scene.render.resolution_y, scene.render.film_transparent = 96, 72, True
for kind in ("SURFACE", "POINTS"):
    bpy.ops.import_scene.globule(filepath="one.vtp", kind=kind)
    thing = bpy.context.view_layer.objects.active
    middle = np.array([thing.matrix_world @ corner.co for corner in thing.data.vertices]).mean(axis=0)
    middle = [middle[0], -middle[2], middle[1]] if abs(thing.matrix_world[1][2]) < 0.5 else middle
    camera.location, camera.rotation_euler = (middle[0], middle[1] - 2.5, middle[2]), (np.pi / 2, 0, 0)
    for blurred in (False, True):
        scene.render.use_motion_blur = blurred
        scene.render.filepath = os.path.abspath(f"{kind}_{blurred}.png")
        bpy.ops.render.render(write_still=True)
    thing.hide_render = True
""")
    for kind in ("SURFACE", "POINTS"):
        still, blurred = (np.asarray(Image.open(f"{kind}_{b}.png"))[..., 3] / 255 for b in (False, True))
        assert 0.01 < still.mean() < 0.9
        wide = (blurred > 0.02).any(axis=0).sum() - (still > 0.02).any(axis=0).sum()
        high = (blurred > 0.02).any(axis=1).sum() - (still > 0.02).any(axis=1).sum()
        assert wide >= 3  # along x, on which all move
        assert abs(high) <= 2
