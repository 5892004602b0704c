"""The plugin for ParaView, run by its own pvpython and pvbatch."""

import functools
import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import globule as gb
import numpy as np
import pytest
from globule._demo.data import dam_break_particles
from globule.formats.vtk_collections import write_pvd
from waiting import PATIENCE

PLUGIN = Path(__file__).resolve().parents[1] / "integrations" / "paraview"
PROGRAMS = os.pathsep.join(["/usr/bin", "/usr/local/bin"])  # where a package's MPI is, beside ParaView
SPLASH = Path(__file__).resolve().parents[2] / "shared" / "data" / "particles" / "splash_117649.npz"
pytestmark = [pytest.mark.interop, pytest.mark.slow]
BEGIN = """
import json, sys, time
import numpy as np
from paraview.simple import *
from vtkmodules.util.numpy_support import vtk_to_numpy
LoadPlugin({plugin!r}, remote=False, ns=globals())

def of(proxy):
    return proxy.GetClientSideObject().GetOutputDataObject(0)

def points(proxy):
    return vtk_to_numpy(of(proxy).GetPoints().GetData())

def number(proxy, name):
    return proxy.FieldData[name].GetRange()[0]

found = {{}}
"""
END = "\njson.dump(found, open('found.json', 'w'))\n"


@functools.cache
def version_of(program: str) -> str:
    code = "import sys; print('Python', *sys.version_info[:2], sep='.')"
    Path("version.py").write_text(code)
    done = subprocess.run([program, "version.py"], capture_output=True, text=True, timeout=PATIENCE)
    return done.stdout


def patient(command: list[str]) -> subprocess.CompletedProcess[str]:
    """Run a command, again where its X server was lost: two of xvfb-run may take the same number."""
    for _ in range(3):
        done = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE)
        if "bad X server connection" not in done.stderr:
            break
    return done


@pytest.fixture
def paraview(tmp_path, monkeypatch):
    """Runs a program by pvpython, or by pvbatch on ranks of MPI, and returns what it found."""
    if not PLUGIN.is_dir():
        pytest.skip("needs integrations/paraview of the repository")
    if shutil.which("pvpython") is None:
        pytest.skip("no pvpython: apt-get install paraview python3-paraview")
    monkeypatch.chdir(tmp_path)
    if "Python.{}.{}".format(*sys.version_info) not in version_of("pvpython"):
        pytest.skip("pvpython has another Python")
    # All packages but VTK, which ParaView has of its own.
    packages = tmp_path / "packages"
    packages.mkdir()
    for folder in {Path(np.__file__).parents[1], *(Path(p) for p in sys.path if p.endswith("site-packages"))}:
        for path in folder.iterdir():
            if not path.name.startswith(("vtk", "pyvista", "mpi4py", "globule")) and path.suffix != ".pth":
                (packages / path.name).exists() or (packages / path.name).symlink_to(path)
    (packages / "globule").symlink_to(Path(gb.__file__).parent)
    # A name that Python 3.11 no longer has.
    monkeypatch.setenv("PYTHONPATH", f"{PLUGIN / 'debian12'}{os.pathsep}{packages}")
    monkeypatch.setenv("OMP_WAIT_POLICY", "passive")
    for name in ("OMPI_ALLOW_RUN_AS_ROOT", "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM"):
        monkeypatch.setenv(name, "1")

    def run(program, ranks=0, screen=False):
        command = ["pvpython"]
        if ranks:
            mpiexec = shutil.which("mpiexec.openmpi", path=PROGRAMS)
            if mpiexec is None or shutil.which("pvbatch") is None:
                pytest.skip("no mpiexec beside pvbatch")
            command = [mpiexec, "--oversubscribe", "-n", str(ranks), "pvbatch"]
        if screen and shutil.which("xvfb-run") is None:
            pytest.skip("no xvfb-run for a window of ParaView")
        if shutil.which("xvfb-run"):
            command = ["xvfb-run", "-a", *command]
        Path("program.py").write_text(BEGIN.format(plugin=str(PLUGIN / "globule_paraview.py")) + program + END)
        Path("found.json").unlink(missing_ok=True)
        done = patient([*command, "program.py"])
        assert Path("found.json").is_file(), done.stdout + done.stderr
        assert "Traceback" not in done.stderr, done.stderr
        return {**json.loads(Path("found.json").read_text()), "errors": done.stderr}

    return run


def frames(n: int = 3) -> list[gb.Particles]:
    """Frames of a dam break that moves, with an attribute."""
    splash, spacing = dam_break_particles()
    positions = np.asarray(splash.positions)[:6000]
    speed = np.linspace(0, 2, len(positions), dtype=np.float32)
    return [gb.Particles(positions + i * spacing, attributes={"speed": speed}) for i in range(n)]


def run_of_files() -> list[str]:
    names = [f"run_{i}.vtp" for i in range(3)]
    for name, particles in zip(names, frames(), strict=True):
        gb.write(name, particles)
    write_pvd("run.pvd", names, [0.0, 0.5, 1.25])
    return names


def test_reader_and_surface_of_each_time(paraview):
    run_of_files()
    gb.write("one.npz", frames(1)[0])
    found = paraview("""
for name, files in {"pvd": ["run.pvd"], "files": ["run_0.vtp", "run_1.vtp", "run_2.vtp"], "one": ["one.npz"]}.items():
    reader = GlobuleReader(FileNames=files)
    reader.UpdatePipelineInformation()
    found[name] = list(reader.TimestepValues or [])
reader = GlobuleReader(FileNames=["run.pvd"])
surface = GlobuleSurface(Input=reader)
found["first"], found["volume"] = [], []
for time in (0.0, 0.5, 0.7, 1.25):
    surface.UpdatePipeline(time)
    found["first"].append(points(reader)[0].tolist())
    found["volume"].append(number(surface, "volume"))
found["arrays"] = surface.PointData.keys()
np.savez("mesh.npz", vertices=points(surface), speed=vtk_to_numpy(of(surface).GetPointData().GetArray("speed")))
found["cell"], found["area"] = number(surface, "cell size"), number(surface, "area")
few = GlobuleReader(FileNames=["one.npz"], Options="where='speed > 1', scale=2")
few.UpdatePipeline()
found["few"] = [len(points(few)), points(few)[-1].tolist()]
balls = GlobuleSurface(Input=reader, Surface="balls", Support=0.1, Attributes="none")
balls.UpdatePipeline(0.0)
found["balls"] = [number(balls, "volume"), balls.PointData.keys()]
""")
    assert found["pvd"] == [0.0, 0.5, 1.25]
    assert found["files"] == [0.0, 1.0, 2.0]
    assert found["one"] == []
    given = frames()
    expected = [np.asarray(given[i].positions)[0].tolist() for i in (0, 1, 1, 2)]
    assert np.allclose(found["first"], expected, atol=1e-6)
    assert np.ptp(found["volume"]) < 1e-3 * found["volume"][0]  # moved, not changed
    assert {"speed", "Normals"} <= set(found["arrays"])
    # The same mesh as without ParaView, on the exact surface.
    scene = gb.Scene(given[0], surface="smooth")
    scene.update(given[2])
    mesh = gb.measure.mesh_surface(scene, found["cell"], "speed")
    with np.load("mesh.npz") as kept:
        assert np.allclose(kept["vertices"], mesh.vertices, atol=1e-5 * scene.spacing)
        assert np.allclose(kept["speed"], mesh.values["speed"], atol=1e-5)
        steep = np.linalg.norm(scene.gradient(kept["vertices"]), axis=1)
        away = np.abs(scene.field(kept["vertices"]) - scene.threshold) / steep
    assert away.max() <= 1e-3 * scene.spacing
    assert found["volume"][-1] == pytest.approx(mesh.volume, rel=1e-6)
    assert found["volume"][-1] == pytest.approx(gb.measure.measure_surface(scene).volume, rel=0.02)
    assert found["area"] == pytest.approx(mesh.area, rel=1e-5)
    chosen = gb.read("one.npz", where="speed > 1", scale=2)
    assert found["few"][0] == len(chosen) < len(given[0])
    assert np.allclose(found["few"][1], chosen.positions[-1])
    balls = gb.measure.mesh_surface(gb.Scene(given[0], support=0.1))
    assert found["balls"][0] == pytest.approx(balls.volume, rel=1e-6)
    assert found["balls"][1] == ["Normals"]


def test_the_splash_of_117_649_particles(paraview):
    """The vertices are on the exact surface, and the volume within 1 %."""
    if not SPLASH.is_file():
        pytest.skip("needs shared/data")
    found = paraview(f"""
reader = GlobuleReader(FileNames=[{str(SPLASH)!r}])
reader.UpdatePipeline()
surface = GlobuleSurface(Input=reader)
surface.UpdatePipeline()
found["volume"] = number(surface, "volume")
np.save("vertices.npy", points(surface))
""")
    scene = gb.Scene(str(SPLASH), surface="smooth")
    vertices = np.load("vertices.npy")
    steep = np.linalg.norm(scene.gradient(vertices), axis=1)
    away = np.abs(scene.field(vertices) - scene.threshold) / steep
    assert np.quantile(away, 0.999) <= 0.02 * scene.spacing
    assert found["volume"] == pytest.approx(gb.measure.measure_surface(scene).volume, rel=0.01)


def test_each_process_has_a_part(paraview):
    run_of_files()
    program = """
reader = GlobuleReader(FileNames=["run.pvd"])
surface = GlobuleSurface(Input=reader)
surface.UpdatePipeline(0.5)
found["points"] = reader.GetDataInformation().GetNumberOfPoints()
found["triangles"] = surface.GetDataInformation().GetNumberOfCells()
found["here"] = of(surface).GetNumberOfPolys()
found["volume"] = number(surface, "volume")
"""
    alone, two = paraview(program), paraview(program, ranks=2)
    assert two["points"] == alone["points"] == 6000
    assert two["triangles"] == alone["triangles"] == alone["here"]
    assert 0.2 < two["here"] / two["triangles"] < 0.8
    assert two["volume"] == pytest.approx(alone["volume"], rel=1e-6)


SCENE = """
reader = GlobuleReader(FileNames=["run.pvd"])
image = GlobuleImage(Input=reader, ColorBy="speed", Range=[0, 2])
view = GetActiveViewOrCreate("RenderView")
view.ViewSize, view.OrientationAxesVisibility = [240, 180], 0
view.Background, view.UseColorPaletteForBackground, view.UseFXAA = [0, 0, 0], 0, 0
Hide(reader, view)
Show(image, view)
animation = GetAnimationScene()
animation.UpdateAnimationUsingDataTimeSteps()
animation.AnimationTime = 0.5
"""


def picture(name: str) -> np.ndarray:
    from PIL import Image

    with Image.open(name) as image:
        return np.asarray(image.convert("RGB")).astype(int)


def test_the_exact_surface_in_a_view(paraview):
    run_of_files()
    low, high = (np.asarray(a, float) for a in frames()[1].bounds())
    middle = ((low + high) / 2).tolist()
    found = paraview(SCENE + f"""
Render(view)  # the first time, ParaView moves the camera
view.CameraPosition, view.CameraFocalPoint = {(high + 2 * (high - low)).tolist()}, {middle}
view.CameraViewUp = [0, 1, 0]
Render(view)
found["angle"] = view.CameraViewAngle
SaveScreenshot("alone.png", view)
SaveScreenshot("large.png", view, ImageResolution=[480, 360])
SaveState("state.pvsm")
animation.AnimationTime = 0
SaveScreenshot("first.png", view)
animation.AnimationTime = 0.5
wall = Plane(Origin={[middle[0], low[1] - 9, low[2] - 9]}, Point1={[middle[0], high[1] + 9, low[2] - 9]},
             Point2={[middle[0], low[1] - 9, high[2] + 9]})
Show(wall, view)
Render(view)
SaveScreenshot("wall.png", view)
Hide(wall, view)
Hide(image, view)
SaveScreenshot("hidden.png", view)
Show(image, view)
SaveScreenshot("again.png", view)
props = view.GetClientSideObject().GetRenderer().GetViewProps()
found["props"] = [props.GetNumberOfItems()]
Delete(image)
del image
SaveScreenshot("deleted.png", view)
found["props"] += [props.GetNumberOfItems()]
""", screen=True)  # fmt: skip
    given = frames()
    scene = gb.Scene(given[0], surface="smooth")
    scene.update(given[1])
    camera = gb.Camera(tuple(high + 2 * (high - low)), tuple(middle), fov=found["angle"])
    looks = {"color_by": "speed", "range": (0, 2)}
    frame, alone = gb.render(scene, camera, (240, 180), {"edge_samples": 1}, **looks), picture("alone.png")
    hit = np.isfinite(frame.distance)
    assert hit.mean() > 0.05
    assert (np.abs(alone - frame.image[..., :3].astype(int)).max(axis=2) > 3)[hit].mean() < 0.01
    assert not alone[~hit].any(axis=1)[~near(hit)[~hit]].any()
    large = gb.render(scene, camera, (480, 360), {"edge_samples": 1}, **looks)
    differ = np.abs(picture("large.png") - large.image[..., :3].astype(int)).max(axis=2) > 3
    assert differ[np.isfinite(large.distance)].mean() < 0.02
    assert (picture("first.png") != alone).any()
    # A wall through the middle: what lies behind it is hidden.
    before = frame.position[..., 0] > middle[0] + scene.spacing
    behind = frame.position[..., 0] < middle[0] - scene.spacing
    wall = picture("wall.png")
    same = np.abs(wall - alone).max(axis=2) <= 3
    assert same[hit & before].mean() > 0.98
    assert same[hit & behind].mean() < 0.05
    assert not picture("hidden.png").any()
    assert np.array_equal(picture("again.png"), alone)
    assert not picture("deleted.png").any()
    assert found["props"][1] < found["props"][0]
    # In another program, from the state's file.
    paraview("""
LoadState("state.pvsm")
view = GetActiveView()
view.UseFXAA = 0  # a setting of the program
SaveScreenshot("state.png", view)
""", screen=True)  # fmt: skip
    assert (np.abs(picture("state.png") - alone).max(axis=2) > 3).sum() < 0.01 * hit.sum()


def test_a_mistake_is_one_line_and_shows_nothing(paraview):
    run_of_files()
    Path("cut.vtp").write_bytes(Path("run_0.vtp").read_bytes()[:3000])
    gb.write("empty.vtp", frames()[0][:0])
    gb.write("plain.vtp", gb.Particles(frames()[0].positions))
    found = paraview("""
def triangles(files, options="", **settings):
    surface = GlobuleSurface(Input=GlobuleReader(FileNames=files, Options=options), **settings)
    surface.UpdatePipeline()
    return of(surface).GetNumberOfCells()

found["none"] = [triangles([name]) for name in ("no.vtp", "cut.vtp", "empty.vtp")]
found["none"] += [triangles(["run_0.vtp"], text) for text in ("scale=abs", "speed", "x=1), (2", "where='heat > 1'")]
found["none"] += [triangles(["run_0.vtp"], **wrong) for wrong in (
    {"CellSize": -1}, {"Threshold": 1e9}, {"CellSize": 1e3}, {"Support": -1})]
view = CreateRenderView(ViewSize=[120, 90], Background=[0, 0, 0], UseColorPaletteForBackground=0,
                        OrientationAxesVisibility=0)
image = GlobuleImage(Input=GlobuleReader(FileNames=["run_0.vtp", "empty.vtp", "cut.vtp", "plain.vtp", "run_1.vtp"]),
                     ColorBy="speed")
Show(image, view)
Render(view)
ResetCamera(view)
for i in range(5):
    GetAnimationScene().AnimationTime = i
    view.ViewTime = i
    SaveScreenshot(f"shown_{i}.png", view)
""", screen=True)  # fmt: skip
    assert found["none"] == [0] * len(found["none"])
    assert [picture(f"shown_{i}.png").any() for i in range(5)] == [True, False, False, False, True]
    for said in (
        "GlobuleReader: [Errno 2] No such file or directory: 'no.vtp'",
        "GlobuleReader: cut.vtp: ",
        "GlobuleReader: Options: expected arguments such as where='type == 1', scale=0.001, got 'scale=abs'",
        "got 'speed'",
        "got 'x=1), (2'",
        "GlobuleReader: where: expected one of x, y, z, speed, got heat",
        "GlobuleSurface: spacing: expected a positive number, got -1.0",
        "GlobuleSurface: support: expected a positive number, got -1.0",
        "GlobuleImage: color_by: expected one of x, y, z, got speed",
    ):
        assert said in found["errors"], found["errors"]


def near(hit: np.ndarray) -> np.ndarray:
    """Pixels at an edge."""
    grown = np.zeros_like(hit)
    for i in (-1, 0, 1):
        for k in (-1, 0, 1):
            grown |= np.roll(hit, (i, k), (0, 1))
    return grown & ~hit


def test_the_exact_surface_of_several_processes(paraview):
    run_of_files()
    program = SCENE + 'view.ResetCamera()\nSaveScreenshot(f"image{sys.argv[1:]}.png", view)\n'
    paraview(program.replace("{sys.argv[1:]}", "1"), screen=True)
    paraview(program.replace("{sys.argv[1:]}", "2"), ranks=2, screen=True)
    assert picture("image1.png").any()
    assert (np.abs(picture("image1.png") - picture("image2.png")).max(axis=2) > 3).mean() < 0.002


def test_the_programs_of_the_how_to(paraview):
    """A script, and a simulation that hands its particles to ParaView while it runs."""
    page = PLUGIN.parents[1] / "docs" / "how-to" / "paraview.md"
    script, pipeline, run = re.findall(r"```python\n(.*?)```", page.read_text(encoding="utf-8"), re.S)
    Path("globule").symlink_to(PLUGIN.parents[1])
    Path("demo").mkdir()
    gb.write("demo/splash.npz", frames(1)[0])
    for name, text in (("script.py", script), ("pipeline.py", pipeline), ("run.py", run)):
        Path(name).write_text(text.replace("range(100)", "range(3)"))
    python = "/usr/bin/python3"
    has = subprocess.run([python, "-c", "import paraview.catalyst"], capture_output=True, timeout=PATIENCE)
    if has.returncode or shutil.which("xvfb-run") is None:
        pytest.skip("no pvpython of the system's Python, or no xvfb-run")
    for command, made in ((["pvpython", "script.py"], "image.png surface.vtp state.pvsm"),
                          ([python, "run.py"], "datasets/step_0000.png datasets/step_0003.png")):  # fmt: skip
        done = patient(["xvfb-run", "-a", *command])
        assert "volume" in done.stdout, done.stdout + done.stderr
        assert "Traceback" not in done.stderr, done.stderr
        assert [name for name in made.split() if not Path(name).is_file()] == []
    assert len(np.unique(picture("image.png").reshape(-1, 3), axis=0)) > 50
