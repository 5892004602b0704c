"""Meshes as metaballs: spacings, closed surfaces, colors, and files that are none."""

import json
import sys

import globule as gb
import numpy as np
import pytest
from globule._base.colormaps import to_linear
from globule.data import spacing, surface
from globule.formats import FormatError
from globule.formats import mesh as mesh_format

TETRAHEDRON = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], np.float32)
FACES = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])


@pytest.fixture
def trimesh():
    return pytest.importorskip("trimesh", reason="trimesh is not installed")


@pytest.mark.parametrize("k", [1, 6, 20])
def test_local_spacing_is_the_mean_of_the_nearest(k):
    rng = np.random.default_rng(1)
    even, clustered = rng.random((400, 3)), rng.normal(size=(400, 3)) ** 3
    for points in (even.astype("f4"), clustered.astype("f4")):
        apart = np.linalg.norm(points[:, None].astype(float) - points[None], axis=2)
        expected = np.sort(apart, axis=1)[:, 1 : k + 1].mean(axis=1)
        middle = np.median(expected)
        expected = np.clip(expected, spacing.LEAST * middle, spacing.MOST * middle)
        assert np.allclose(gb.fluids.measure_spacing(points, k), expected, rtol=1e-5)


def test_spacing_of_troubled_particles_and_of_edges():
    points = np.random.default_rng(2).random((50, 3)).astype("f4")
    twice = np.concatenate([points, points])
    assert np.allclose(gb.fluids.measure_spacing(twice)[:50], gb.fluids.measure_spacing(points))
    points[7] = np.nan
    found = gb.fluids.measure_spacing(points)
    assert found[7] == np.median(np.delete(found, 7))
    assert np.isfinite(found).all()
    assert (gb.fluids.measure_spacing(np.zeros((5, 3))) == 1).all()
    assert gb.fluids.measure_spacing(np.zeros((0, 3))).shape == (0,)
    far = np.concatenate([points[:7], [[1e15, 0, 0]], points[8:] * 1e-9])
    found = gb.fluids.measure_spacing(far)
    assert found.max() <= 1e6 * found.min()
    gb.Scene(gb.Particles(far, support=found), device="cpu")  # refuses a larger factor
    found = spacing.edge_spacing(TETRAHEDRON, FACES)
    assert np.allclose(found, [1, 2**0.5, 2**0.5, 2**0.5])


def covered(mesh, particles) -> float:
    """The share of the rays through the mesh that hit the particles' surface."""
    camera, size = gb.Camera((0, -6, 2), (0, 0, 0), (0, 0, 1), 30), (160, 120)
    mask = gb.render(gb.Scene(particles, device="cpu"), camera, size).mask
    corners = mesh.vertices[mesh.faces].astype("f4")
    dense, weights, _ = surface.sample_triangles(corners, 0.02)
    x, y = camera.project(np.einsum("mk,mkc->mc", weights, corners[dense]), size).T.astype(int)
    return mask[y, x].mean()


@pytest.mark.parametrize("lengths", [None, 0.1])
def test_surfaces_are_closed(trimesh, lengths):
    torus = trimesh.creation.torus(1, 0.35, major_sections=30, minor_sections=12)
    box = trimesh.creation.box((1.2, 0.8, 1.0))
    for mesh in (torus, box):
        assert covered(mesh, gb.sample_mesh(mesh, lengths)) == 1


def test_samples_are_even_at_spacings_that_can_be(trimesh):
    grid = np.array([[0, 0, 0], [2, 0, 0], [2, 2, 0], [0, 2, 0], [0.9, 0.2, 0]], float)
    faces = [[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]]
    particles = gb.sample_mesh(trimesh.Trimesh(grid, faces, process=False), 0.05)
    assert particles.support == pytest.approx(0.1)
    assert particles.weight.max() <= 1 + 1e-6
    assert particles.weight.sum() == pytest.approx(4 / (3**0.5 / 2 * 0.05**2), rel=1e-4)
    points = np.random.default_rng(3).uniform(0.3, 1.7, (500, 3)).astype("f4")
    points[:, 2] = 0.05
    values = gb.Scene(particles, device="cpu").field(points)
    assert values.std() < 0.08 * values.mean()
    assert values.min() > 0.6
    assert (particles.positions[:, 2] == 0).all()
    with pytest.raises(ValueError, match=r"50,000,000 points, got 0.0001 .* try 0.000") as caught:
        gb.sample_mesh(trimesh.creation.box(), 1e-4)
    assert 1e-4 < float(str(caught.value).split()[-1]) < 1e-3
    for value in (0, -1, np.nan, np.inf):
        with pytest.raises(ValueError, match="spacing: expected a positive number"):
            gb.sample_mesh("a.obj", value)


TEXTURED = "mtllib a.mtl\nusemtl m\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\nf 1/1 2/2 3/3\n"  # OBJ


def glb(tree: dict, chunks: bytes) -> bytes:
    text = json.dumps(tree).encode()
    text += b" " * (-len(text) % 4)
    return b"glTF" + np.uint32([2, 20 + len(text) + len(chunks), len(text)]).tobytes() + b"JSON" + text + chunks


@pytest.mark.parametrize("extension", [".ply", ".obj", ".stl", ".glb"])
def test_files(trimesh, extension, tmp_path):
    mesh = trimesh.creation.icosphere(2)
    colors = np.full((len(mesh.vertices), 4), 255, np.uint8)
    colors[:, 0] = np.arange(len(colors)) + 40
    mesh.visual.vertex_colors = colors
    path = tmp_path / f"a{extension}"
    mesh.export(path)
    for particles in (gb.read(path), gb.sample_mesh(path)):
        assert len(particles) == len(mesh.vertices)
        order = [np.abs(mesh.vertices - p).sum(axis=1).argmin() for p in particles.positions]
        assert np.allclose(particles.positions, mesh.vertices[order], atol=1e-6)
        expected = spacing.edge_spacing(mesh.vertices, mesh.faces)
        assert np.allclose(particles.support, expected[order], rtol=1e-5)
        if extension == ".stl":
            assert particles.color is None
            continue
        shown = colors[order, :3] / 255  # glTF's vertex colors are linear by definition
        expected = shown if extension == ".glb" else to_linear(shown)
        assert np.allclose(particles.color, expected, atol=2e-3)
    assert len(gb.read(path, spacing=0.1)) > 2 * len(mesh.vertices)


def ascii_ply(path, field: str, counts: tuple[int, int], rows: str) -> None:
    axes = "".join(f"property float {name}\n" for name in ("x", "y", "z", field))
    path.write_text(
        f"ply\nformat ascii 1.0\nelement vertex {counts[0]}\n{axes}element face {counts[1]}\n"
        f"property list uchar int vertex_index\nend_header\n{rows}"
    )


def test_ply_ascii_polygons_lone_vertices_and_supports(tmp_path):
    path = tmp_path / "a.ply"
    ascii_ply(path, "quality", (6, 2), "0 0 0 1\n2 0 0 2\n2 1 0 3\n0 1 0 4\n9 9 9 5\n0 0 1 6\n4 0 1 2 3\n3 0 1 5\n")
    particles = gb.read(path)
    assert len(particles) == 5
    assert 5 not in particles.attributes["quality"]
    assert np.allclose(particles.support, [5**0.5, 5**0.5, 5**0.5, 2, 5**0.5])
    ascii_ply(path, "support", (3, 1), "0 0 0 7\n1 0 0 7\n0 1 0 7\n3 0 1 2\n")
    assert (gb.read(path).support == 7).all()


def test_coincident_vertices_are_one_nan_is_nowhere_and_texture_is_sampled(trimesh):
    corners = TETRAHEDRON[FACES].reshape(-1, 3)
    mesh = trimesh.Trimesh(corners, np.arange(12).reshape(4, 3), process=False)
    mesh.visual.face_colors = [[255, 0, 0, 255], [0, 255, 0, 255], [0, 0, 255, 255], [0, 0, 0, 255]]
    particles = gb.sample_mesh(mesh)
    assert len(particles) == 4
    at_origin = np.abs(particles.positions).sum(axis=1).argmin()
    assert np.allclose(particles.color[at_origin], 1 / 3, atol=1e-6)
    mesh = trimesh.creation.icosphere(1)
    vertices = mesh.vertices.copy()
    vertices[3] = np.nan
    mesh = trimesh.Trimesh(vertices, mesh.faces, process=False, validate=False)
    assert np.isfinite(gb.sample_mesh(mesh).support).all()
    assert np.isfinite(gb.sample_mesh(mesh, 0.1).positions).all()
    from PIL import Image

    texture = Image.new("RGB", (64, 64), (255, 0, 0))
    texture.paste((0, 0, 255), (32, 0, 64, 64))
    corners = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
    visual = trimesh.visual.TextureVisuals(uv=corners[:, :2], image=texture)
    mesh = trimesh.Trimesh(2 * corners, [[0, 1, 2], [0, 2, 3]], visual=visual, process=False)
    particles = gb.sample_mesh(mesh, 0.05)
    x = particles.positions[:, 0]
    assert np.allclose(particles.color[x < 0.9], [1, 0, 0], atol=1e-3)
    assert np.allclose(particles.color[x > 1.1], [0, 0, 1], atol=1e-3)


@pytest.mark.parametrize("ending", ["obj", "glb"])
def test_textures_beside_a_mesh_are_read_and_no_other_file(trimesh, tmp_path, ending):
    from PIL import Image

    folder = tmp_path / "mine"
    (folder / "maps").mkdir(parents=True)
    for place in (tmp_path / "secret.png", folder / "own.png", folder / "maps" / "own.png"):
        Image.new("RGB", (8, 8), (0, 255, 0)).save(place)
    (folder / "linked.png").symlink_to(tmp_path / "secret.png")
    inside = ["own.png", "maps/own.png", "./own.png"]
    outside = ["../secret.png", str(tmp_path / "secret.png"), "linked.png", "maps/../../secret.png"]
    for name in (*inside, *outside):
        if ending == "obj":
            (folder / "a.mtl").write_text(f"newmtl m\nKd 1 0 0\nmap_Kd {name}\n")
            (folder / "a.obj").write_text(TEXTURED)
        else:
            visual = trimesh.visual.TextureVisuals(
                uv=[[0, 0], [1, 0], [0, 1]], image=Image.new("RGB", (8, 8), (255, 0, 0))
            )
            mesh = trimesh.Trimesh(TETRAHEDRON[:3], [[0, 1, 2]], visual=visual, process=False)
            content = mesh.export(file_type="glb")
            length = int.from_bytes(content[12:16], "little")
            tree = json.loads(content[20 : 20 + length])
            tree["images"] = [{"uri": name}]
            (folder / "a.glb").write_bytes(glb(tree, content[20 + length :]))
        try:
            color = gb.sample_mesh(folder / f"a.{ending}", 0.2).color
        except FormatError:
            assert name in outside
            continue
        green = color is not None and np.allclose(color, [0, 1, 0], atol=1e-3)
        assert green == (name in inside), name


def test_scene_of_several_meshes_and_materials_without_pictures(trimesh, tmp_path):
    left, right = trimesh.creation.box(), trimesh.creation.box()
    left.visual.face_colors = [255, 0, 0, 255]
    scene = trimesh.Scene()
    scene.add_geometry(left)
    scene.add_geometry(right, transform=trimesh.transformations.translation_matrix([5, 0, 0]))
    particles = gb.sample_mesh(scene)
    assert (len(particles), particles.positions[:, 0].max()) == (16, pytest.approx(5.5))
    assert np.allclose(particles.color[particles.positions[:, 0] < 1], [1, 0, 0])
    (tmp_path / "a.mtl").write_text("newmtl m\nKd 1 0 0\nmap_Kd nowhere.png\n")
    (tmp_path / "a.obj").write_text(TEXTURED)
    for options in ({}, {"spacing": 0.2}):
        assert (gb.read(tmp_path / "a.obj", **options).color == [1, 0, 0]).all()


def test_points_without_triangles(trimesh, tmp_path):
    points = np.concatenate([np.random.default_rng(5).random((50, 3)), [[9, 9, 9]]])
    (tmp_path / "a.obj").write_text("".join(f"v {x} {y} {z}\n" for x, y, z in points))
    with pytest.warns(UserWarning, match="a.obj: expected a mesh with faces, got none: its 51 ver"):
        particles = gb.read(tmp_path / "a.obj")
    assert np.allclose(particles.positions, points, atol=1e-6)
    assert particles.support is None  # a cloud of points has what is measured of it, as other files


def binary_ply(face: bytes, n_faces: int = 1) -> bytes:
    header = (
        "ply\nformat binary_little_endian 1.0\nelement vertex 4\nproperty float x\n"
        f"property float y\nproperty float z\nelement face {n_faces}\n"
        "property list uchar int vertex_indices\nend_header\n"
    )
    return header.encode() + TETRAHEDRON.tobytes() + face


@pytest.mark.parametrize(("face", "n_faces", "what"), [
    (b"\x03" + np.int32([0, 1, 4]).tobytes(), 1, "expected indices below 4, got 0 to 4"),
    (b"\x03" + np.int32([0, -1, 2]).tobytes(), 1, "expected indices below 4"),
    (b"\x03" + np.int32([0, 1]).tobytes(), 1, "row 0"),
    (b"\x03" + np.int32([0, 1, 2]).tobytes(), 10**12, "row 1"), (b"", 5, "row 0"),
])  # fmt: skip
def test_bad_faces(face, n_faces, what, tmp_path):
    (tmp_path / "a.ply").write_bytes(binary_ply(face, n_faces))
    with pytest.raises(FormatError, match=what) as caught:
        gb.read(tmp_path / "a.ply")
    assert "\n" not in str(caught.value)
    assert "a.ply" in str(caught.value)


@pytest.mark.parametrize(("line", "expected"), [
    ("v 1 0 0 0.5 0.", "last vertex: expected 6 numbers, got 5"),
    ("v 1 0", "last vertex: expected 6 numbers, got 2"),
    ("v 1 0 0 1 1 1\nf 1 2 3\nf 1/1 2/", "last face: expected at least 3 corners, got 2"),
])  # fmt: skip
def test_obj_that_breaks_off(trimesh, line, expected, tmp_path):
    (tmp_path / "a.obj").write_text("v 0 0 0 1 1 1\nv 0 0 1 1 1 1\nv 0 1 1 1 1 1\n" + line)
    with pytest.raises(FormatError, match=expected):
        gb.read(tmp_path / "a.obj")


def test_scenes_of_too_many_triangles_and_sizes_of_glb_are_refused(trimesh, monkeypatch, tmp_path):
    monkeypatch.setattr(mesh_format, "MOST_SAMPLES", 100)
    scene = trimesh.Scene([trimesh.creation.icosphere(1)])
    assert len(gb.sample_mesh(scene)) == 42
    scene.graph.update("again", geometry=next(iter(scene.geometry)))
    with pytest.raises(FormatError, match="at most 100 triangles, got 160"):
        gb.sample_mesh(scene)
    accessor = {"count": 10**9, "type": "VEC3", "componentType": 5126}
    tree = {"asset": {"version": "2.0"}, "buffers": [{"byteLength": 4}], "accessors": [accessor]}
    (tmp_path / "a.glb").write_bytes(glb(tree, np.uint32([4]).tobytes() + b"BIN\0" + bytes(4)))
    with pytest.raises(FormatError, match=r"expected at most .* elements, got 1000000000"):
        gb.read(tmp_path / "a.glb")


def test_without_trimesh_and_with_options_of_other_formats(monkeypatch, tmp_path):
    (tmp_path / "a.obj").write_text("v 0 0 0\n")
    monkeypatch.setitem(sys.modules, "trimesh", None)
    with pytest.raises(gb.MissingPackageError, match=r'trimesh .* install "globule\[formats\]"'):
        gb.read(tmp_path / "a.obj")
    gb.write(tmp_path / "a.npz", gb.Particles(TETRAHEDRON))
    with pytest.raises(ValueError, match=r"spacing: expected no such option for .*a\.npz"):
        gb.read(tmp_path / "a.npz", spacing=1.0)


def lathe(profile: np.ndarray, n: int) -> gb.Mesh:
    """What turns around z: rings of n vertices at (radius, z) of the profile, whose ends lie on the
    axis and are one vertex each."""
    angles = 2 * np.pi * np.arange(n) / n
    rings = [np.stack([r * np.cos(angles), r * np.sin(angles), 0 * angles + z], 1)
             for r, z in profile[1:-1]]  # fmt: skip
    vertices = np.concatenate([[[0, 0, profile[0, 1]]], *rings, [[0, 0, profile[-1, 1]]]])
    k = np.arange(n)
    one, last = 1 + k, 1 + (k + 1) % n
    faces = [np.stack([0 * k, last, one], 1)]
    for ring in range(len(rings) - 1):
        a, b = one + n * ring, last + n * ring
        faces += [np.stack([a, b, b + n], 1), np.stack([a, b + n, a + n], 1)]
    top = n * (len(rings) - 1)
    faces.append(np.stack([one + top, last + top, 0 * k + len(vertices) - 1], 1))
    return gb.Mesh(vertices.astype(np.float32), np.concatenate(faces), smooth=30)


@pytest.mark.parametrize("n", [24, 95, 96, 400, 5000])
def test_normals_where_many_corners_meet(n):
    """The pole of a ball is round, and the cap of a cylinder flat with a sharp edge, for any number
    of corners: from 96 on they are added up by direction."""
    camera = gb.Camera((2.5, 0.3, 4), (0, 0, 0), (0, 1, 0), fov=28)
    polar = np.linspace(np.pi, 0, 41)
    frame = gb.render(lathe(np.stack([np.sin(polar), np.cos(polar)], 1), n), camera, (96, 96))
    seen = frame.mask
    cosine = (frame.normal[seen] * frame.position[seen]).sum(1)
    cosine /= np.linalg.norm(frame.position[seen], axis=1)
    assert seen.any()
    assert cosine.min() > np.cos(np.radians(1.5 if n > 24 else 8))
    frame = gb.render(lathe(np.array([[0, -1], [0.5, -1], [0.5, 1], [0, 1]]), n), camera, (96, 96))
    place, normal = frame.position[frame.mask], frame.normal[frame.mask]
    radius = np.linalg.norm(place[:, :2], axis=1)
    cap, side = (place[:, 2] > 0.9999) & (radius < 0.47), place[:, 2] < 0.99
    assert cap.any()
    assert side.any()
    np.testing.assert_allclose(normal[cap], np.tile([0, 0, 1], (cap.sum(), 1)), atol=1e-5)
    assert np.abs(normal[side][:, 2]).max() < 0.05  # at the silhouette turned towards the eye
