"""Meshes from files and from objects of other packages, and on the command line."""

from types import SimpleNamespace

import globule as gb
import numpy as np
import pytest
from cli_helpers import run_json
from globule._base.colormaps import to_linear
from globule.cli import main
from globule.formats.pictures.environment import read_environment
from globule.formats.triangles import has_faces, read
from test_mesh_layers import BOX, BOX_FACES, sphere

BALL = sphere(8, 0.5)
SMALL = ("--size", "48x36", "--device", "cpu")


def ply(path, vertices, faces, colors=None):
    head = ["ply", "format ascii 1.0", f"element vertex {len(vertices)}"]
    head += [f"property float {axis}" for axis in "xyz"]
    head += [] if colors is None else [f"property uchar {c}" for c in ("red", "green", "blue")]
    head += [f"element face {len(faces)}", "property list uchar int vertex_indices", "end_header"]
    rows = [" ".join(map(str, v)) for v in vertices]
    if colors is not None:
        rows = [f"{row} {' '.join(map(str, c))}" for row, c in zip(rows, colors, strict=True)]
    rows += [f"{len(f)} {' '.join(map(str, f))}" for f in faces]
    path.write_text("\n".join([*head, *rows, ""]))


QUADS = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]


def legacy(path, lines):
    head = "# vtk DataFile Version 3.0\nbox\nASCII\nDATASET POLYDATA\nPOINTS 8 float\n"
    points = "\n".join(" ".join(map(str, p)) for p in BOX)
    path.write_text(f"{head}{points}\n{lines}\n")


def volume(mesh: gb.Mesh) -> float:
    a, b, c = (np.asarray(mesh.vertices, np.float64)[mesh.faces[:, k]] for k in range(3))
    return float(np.sum(a * np.cross(b, c)) / 6)


def test_ply_with_quads_and_colors_and_legacy_vtk(tmp_path):
    ply(tmp_path / "box.ply", BOX, QUADS, (BOX * 255).astype(int))
    mesh = gb.Mesh(tmp_path / "box.ply")
    assert (len(mesh), mesh.solid, volume(mesh)) == (12, True, pytest.approx(1))
    np.testing.assert_allclose(read(tmp_path / "box.ply").color, to_linear(BOX), atol=1e-6)
    assert has_faces(tmp_path / "box.ply")

    def cells(faces):
        return "\n".join(f"{len(face)} {' '.join(map(str, face))}" for face in faces)

    mixed = [[0, 1, 3], [0, 3, 2], *QUADS[1:]]
    strips = [[0, 1, 2, 3], [4, 6, 5, 7], [0, 4, 1, 5], [2, 3, 6, 7], [0, 2, 4, 6], [1, 5, 3, 7]]
    for lines in (
        f"POLYGONS 6 30\n{cells(QUADS)}",
        f"VERTICES 1 2\n1 0\nPOLYGONS 7 33\n{cells(mixed)}",
        f"TRIANGLE_STRIPS 6 30\n{cells(strips)}",
    ):
        legacy(tmp_path / "a.vtk", lines)
        mesh = gb.Mesh(tmp_path / "a.vtk")
        assert (len(mesh), mesh.solid, volume(mesh)) == (12, True, pytest.approx(1)), lines
        assert has_faces(tmp_path / "a.vtk")
    for lines, said in (
        ("VERTICES 1 2\n1 0", "expected a mesh with faces, got none"),
        ("POLYGONS 1 4\n3 0 1 8", "expected indices from 0 to 7, got 0 to 8"),
        ("POLYGONS 2 7\n3 0 1 2\n3 0 1", "cells"),
    ):
        legacy(tmp_path / "b.vtk", lines)
        assert has_faces(tmp_path / "b.vtk") == lines.startswith("P")
        with pytest.raises(gb.FormatError, match=said):
            gb.Mesh(tmp_path / "b.vtk")


@pytest.mark.parametrize("mode", ["ascii", "binary", "appended"])
@pytest.mark.parametrize("form", ["vtp", "vtk"])
def test_files_of_vtk(tmp_path, form, mode):
    vtk = pytest.importorskip("vtk", reason="vtk is not installed")
    source = vtk.vtkSphereSource()
    source.SetThetaResolution(12)
    source.Update()
    path = str(tmp_path / f"ball.{form}")
    writer = vtk.vtkXMLPolyDataWriter() if form == "vtp" else vtk.vtkPolyDataWriter()
    if form == "vtp":
        getattr(writer, f"SetDataModeTo{mode.title()}")()
    else:
        getattr(writer, "SetFileTypeToASCII" if mode == "ascii" else "SetFileTypeToBinary")()
    writer.SetFileName(path)
    writer.SetInputData(source.GetOutput())
    writer.Write()
    mesh = gb.Mesh(path)
    assert has_faces(path)
    assert len(mesh) == source.GetOutput().GetNumberOfPolys()
    assert mesh.solid
    assert 0.3 < volume(mesh) < 0.53


@pytest.mark.parametrize("form", ["stl", "obj", "glb", "ply"])
def test_files_of_trimesh(tmp_path, form):
    trimesh = pytest.importorskip("trimesh", reason="trimesh is not installed")
    tri = trimesh.Trimesh(*BALL)
    tri.export(tmp_path / f"ball.{form}")
    mesh = gb.Mesh(tmp_path / f"ball.{form}")
    assert mesh.solid
    assert volume(mesh) == pytest.approx(tri.volume, rel=1e-5)
    assert volume(gb.Mesh(tri)) == pytest.approx(tri.volume, rel=1e-5)
    assert len(gb.Mesh(trimesh.Scene([tri, tri]))) == 2 * len(tri.faces)


def test_objects_of_meshio_and_pyvista():
    meshio = pytest.importorskip("meshio", reason="meshio is not installed")
    assert len(gb.Mesh(meshio.Mesh(BOX, [("quad", QUADS[:3]), ("triangle", BOX_FACES[6:])]))) == 12
    with pytest.raises(ValueError, match="expected a mesh with triangles or quads, got line"):
        gb.Mesh(meshio.Mesh(BOX, [("line", [[0, 1]])]))
    flat = np.insert(BOX_FACES, 0, 3, axis=1).ravel()
    surface = SimpleNamespace(points=BOX, faces=flat, regular_faces=BOX_FACES)
    surface.triangulate = lambda: surface  # what globule asks of a pyvista.PolyData
    assert gb.Mesh(surface).solid


def test_a_file_with_faces_is_drawn_as_its_triangles(tmp_path):
    pytest.importorskip("trimesh")
    path = tmp_path / "hole.obj"
    path.write_text("v 0 0 0\nv 1 nan 0\nv 0 1 0\nf 1 2 3\n")
    with pytest.raises(ValueError, match=r"hole\.obj: vertices: expected finite .*\(vertex 1\)"):
        gb.Mesh(path)
    ply(tmp_path / "ball.ply", *BALL)
    camera = gb.Camera((0, 0, 4), (0, 0, 0), fov=30)
    frame = gb.render(str(tmp_path / "ball.ply"), camera, (40, 40))
    assert frame.distance.min() == pytest.approx(3.5, abs=0.02)
    assert frame.pick(20, 20).face is not None
    balls = gb.render(gb.read(tmp_path / "ball.ply"), camera, (40, 40))
    assert balls.distance.min() < frame.distance.min() - 0.01
    assert balls.pick(20, 20).particle is not None


@pytest.fixture
def files(tmp_path, folder):
    ply(tmp_path / "ball.ply", *BALL)
    ply(tmp_path / "tank.ply", BOX * 4 - 2, QUADS)
    x = np.linspace(-1, 1, 8)
    grid = np.stack(np.meshgrid(x, x, x), -1).reshape(-1, 3).astype(np.float32)
    gb.write(tmp_path / "fluid.ply", gb.Particles(grid))
    return tmp_path


def test_render_a_mesh_alone_and_beside_particles(files, capsys):
    report = run_json(capsys, "render", "ball.ply", "-o", "a.png", *SMALL, "--pick", "24,18")
    assert report["counts"]["triangles"] == len(BALL[1])
    assert report["closed"]
    assert report["picked"]["face"] >= 0
    assert 100 < report["counts"]["hits"] < 48 * 36
    report = run_json(capsys, "render", "ball.ply", "-o", "a.png", *SMALL, "--as-particles")
    assert report["counts"]["particles"] == len(BALL[0])
    report = run_json(capsys, "render", "ball.ply", "-o", "a.png", *SMALL, "--preset", "clay")
    assert report["samples"] == 4
    both = run_json(capsys, "render", "ball.ply", "fluid.ply", "-o", "{}.png", *SMALL)
    assert (both["counts"]["triangles"], both["counts"]["particles"]) == (len(BALL[1]), 512)
    alone = run_json(capsys, "render", "fluid.ply", "-o", "a.png", *SMALL)
    words = ("--mesh", "ball.ply:glass", "--mesh-color", "#ff0000")
    beside = run_json(capsys, "render", "fluid.ply", "-o", "b.png", *SMALL, *words)
    assert beside["warnings"] == []
    assert beside["counts"]["hits"] == pytest.approx(alone["counts"]["hits"], rel=0.1)
    tank = run_json(capsys, "render", "fluid.ply", "-o", "c.png", *SMALL, "--mesh", "tank.ply:glass")
    assert "surrounds the particles: drawn as a thin wall" in tank["warnings"][0]
    assert tank["counts"]["hits"] != alone["counts"]["hits"]  # the camera shows the tank
    assert read_environment("c.png").shape[:2] == (36, 48)
    seen = run_json(
        capsys, "render", "fluid.ply", "-o", "d.png", *SMALL, "--with", "ball.ply:#00ff00",
        "--eye", "0,0,9", "--look-at", "0,0,0", "--clip", "0,0,1,-5", "--pick", "24,18",
    )  # fmt: skip
    assert seen["picked"]["file"] == "ball.ply"


def test_a_mesh_in_the_colors_of_its_values(files, capsys):
    heat = np.linspace(0, 1, 512)
    gb.write("fluid.npz", gb.Particles(gb.read("fluid.ply").positions, attributes={"heat": heat}))
    run_json(capsys, "mesh", "fluid.npz", "-o", "fluid.vtp", "--value", "heat")
    flat = ("--flat", *SMALL, "--eye", "0,0,9", "--look-at", "0,0,0", "--range=-1,1")
    words = ("--color-by", "x", "--colormap", "magma", *flat, "--aov", "a.npz")
    run_json(capsys, "render", "fluid.vtp", "-o", "a.png", *words)
    seen = np.load("a.npz")
    inside = seen["mask"] & (np.abs(seen["position"][..., :2]).max(axis=-1) < 0.9)  # not the silhouette
    assert inside.sum() > 100
    expected = gb.colorize(seen["position"][inside][:, 0], "magma", -1, 1)
    np.testing.assert_allclose(seen["color"][inside], expected, atol=0.05)
    lit = run_json(
        capsys, "render", "fluid.vtp", "-o", "b.png", "--color-by", "heat", "--legend",
        "--size", "320x240", "--device", "cpu",
    )  # fmt: skip
    assert lit["warnings"] == []

    mesh = gb.Mesh("fluid.vtp")
    heights = np.asarray(mesh.vertices)[:, 2]
    assert (mesh.color_by("z"), mesh.color_by("heat", range=(2, 1))) == ((heights.min(), heights.max()), (2, 1))
    assert len(gb.render_views("fluid.vtp", ["front", "top"], size=(96, 48), color_by="x").frames) == 2


def test_a_tank_that_hides_the_particles_and_a_mesh_without_an_area_are_named(files, capsys, folder):
    def warnings(*words: str) -> list[str]:
        return run_json(capsys, "render", "fluid.ply", "-o", "a.png", *SMALL, *words)["warnings"]

    hidden = "no pixel shows the particles, only tank.ply: try --mesh tank.ply:glass or --clip"
    assert warnings("--mesh", "tank.ply")[-1] == hidden
    assert warnings("--mesh", "tank.ply:clay", "--eye", "9,9,9", "--ground=-5")[-1] == hidden
    assert hidden not in warnings("--mesh", "tank.ply:glass")
    assert hidden not in warnings("--mesh", "tank.ply", "--clip", "0,0,1,0")
    assert "above the highest field" in warnings("--mesh", "tank.ply", "--threshold", "99")[-1]
    gb.write("around.npz", gb.Particles(np.zeros((1, 3))))
    hidden = "no pixel shows the particles, only around.npz: try --clip"
    assert hidden in warnings("--spheres", "around.npz:9", "--eye", "99,0,0")
    ply(folder / "flat.ply", np.array([[0, 0, 0], [1, 1, 1], [2, 2, 2.0]]), [(0, 1, 2)] * 3)
    words = ["render", "flat.ply", "-o", "a.png", *SMALL]
    warning = "no pixel hits the mesh: it has no area, 3 triangles of points or lines alone"
    assert run_json(capsys, *words)["warnings"] == [warning]
    ply(folder / "large.ply", np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0.0]]), [(0, 1, 2)])
    words = ["render", "large.ply", "-o", "a.png", *SMALL, "--eye", "0,0,9", "--look-at", "0,0,99"]
    assert "the camera looks past it" in run_json(capsys, *words)["warnings"][0]


@pytest.mark.parametrize(("words", "message"), [
    (("ball.ply", "--color-by", "heat"), "--color-by: expected one of x, y, z of ball.ply"),
    (("ball.ply", "--support", "1"), "--support: expected particles beside --support"),
    (("ball.ply", "--root", "march"), "--root: expected particles beside --root"),
    (("fluid.ply", "--mesh", "ball.ply:brass"), "--mesh: expected a material, blood, water"),
    (("fluid.ply", *("--mesh", "ball.ply") * 4), "--mesh: expected at most 3 files"),
])  # fmt: skip
def test_mistakes_on_the_command_line(files, capsys, words, message):
    assert main(["render", *words, "-o", "a.png", *SMALL]) != 0
    assert message in capsys.readouterr().err
