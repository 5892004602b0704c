"""Rigid bodies of SPlisHSPlasH: files written byte by byte, and where the meshes then are."""

import struct

import globule as gb
import numpy as np
import pytest
from cli_helpers import SMALL, refused, run_json
from scipy.spatial.transform import Rotation

trimesh = pytest.importorskip("trimesh")


def pose_bytes(position, rotation) -> bytes:
    columns = np.asarray(rotation).T.ravel()
    return struct.pack("<3f", *position) + struct.pack("<9f", *columns)


def write_run(folder, poses, scales=((1, 1, 1), (2, 3, 4)), walls=(0, 0)) -> None:
    """A box and a ball; poses: a list of (position, rotation) a body, for each frame from 1 on."""
    trimesh.creation.box((1, 2, 3)).export(folder / "box.obj")
    trimesh.creation.icosphere(1).export(folder / "ball.obj")
    header = struct.pack("<I", 2)
    for name, scale, wall in zip((b"box.obj", b"ball.obj"), scales, walls, strict=True):
        header += struct.pack("<I", len(name)) + name + struct.pack("<3fb4f", *scale, wall, *[1] * 4)
    for frame, bodies in enumerate(poses, 1):
        data = b"".join(pose_bytes(*body) for body in bodies)
        (folder / f"rb_data_{frame}.bin").write_bytes((header if frame == 1 else b"") + data)


def moves(n: int) -> list:
    turn = Rotation.from_rotvec
    return [[((k, 0, 0), np.eye(3)), ((0, k, 5), turn((0.3 * k, 0.1, -0.2 * k)).as_matrix())] for k in range(n)]


def test_meshes_are_where_the_files_say_and_walls_are_left_out(tmp_path):
    write_run(tmp_path, moves(1))
    bodies = gb.RigidBodies(tmp_path, device="cpu")
    before = bodies.meshes[1].pose
    bodies.place(7)
    assert (bodies.meshes[1].pose == before).all()
    write_run(tmp_path, moves(2), walls=(1, 0))
    assert gb.RigidBodies(tmp_path, device="cpu").names == ["ball.obj"]
    bodies = gb.RigidBodies(tmp_path, device="cpu", walls=True)
    bodies.place(2)
    assert np.allclose(bodies.meshes[0].pose[:3, 3], (1, 0, 0))
    poses = moves(12)
    write_run(tmp_path, poses)
    bodies = gb.RigidBodies(tmp_path, device="cpu")
    assert (len(bodies), bodies.names) == (2, ["box.obj", "ball.obj"])
    assert bodies.frames == list(range(1, 13))  # by number
    for frame in (1, 12, 5):
        bodies.place(frame)
        for mesh, (position, rotation) in zip(bodies.meshes, poses[frame - 1], strict=True):
            assert np.allclose(mesh.pose[:3, 3], position)
            assert np.allclose(mesh.pose[:3, :3], rotation, atol=1e-6)
    bodies.place(3)
    position, rotation = poses[2][1]
    world = trimesh.creation.icosphere(1).vertices * (2, 3, 4) @ np.asarray(rotation).T + position
    assert np.allclose(bodies.meshes[1].bounds(), [world.min(0), world.max(0)], atol=1e-5)
    assert gb.render(list(bodies.meshes), (40, 30)).mask.any()


def test_damaged_files_are_refused(tmp_path):
    with pytest.raises(gb.FormatError, match=r"expected files rb_data_1.bin"):
        gb.RigidBodies(tmp_path)
    write_run(tmp_path, moves(2))
    first, second = tmp_path / "rb_data_1.bin", tmp_path / "rb_data_2.bin"
    whole = first.read_bytes()
    for n in (0, 3, 6, 20, 60, len(whole) - 1):
        first.write_bytes(whole[:n])
        with pytest.raises(gb.FormatError, match="expected"):
            gb.RigidBodies(tmp_path, device="cpu")
    first.write_bytes(struct.pack("<I", 2**31) + whole)
    with pytest.raises(gb.FormatError, match="at most 10000 bodies"):
        gb.RigidBodies(tmp_path, device="cpu")
    first.write_bytes(whole)
    bodies = gb.RigidBodies(tmp_path, device="cpu")
    second.write_bytes(second.read_bytes() + b"1")
    with pytest.raises(gb.FormatError, match=r"rb_data_2.bin: expected 96 bytes for 2 bodies, got 97"):
        bodies.place(2)
    second.write_bytes(pose_bytes((0, 0, 0), 2 * np.eye(3)) * 2)
    with pytest.raises(gb.FormatError, match="body 0: pose: expected a rotation"):
        bodies.place(2)


def test_a_sequence_of_images_moves_them(tmp_path, folder, capsys):
    (tmp_path / "bodies").mkdir()
    write_run(tmp_path / "bodies", moves(3))
    for k in (1, 3):
        gb.write(f"fluid_{k}.npz", gb.Particles(np.zeros((1, 3)), support=0.1))
    words = ["--mesh", "bodies", "-o", "out_%d.npz.png", "--aov", "out_%d.npz", "--eye", "2,3,30"]
    run_json(capsys, "render", "fluid_1.npz", "fluid_3.npz", *words, *SMALL)
    bodies = gb.RigidBodies("bodies", device="cpu")
    for i, frame in enumerate((1, 3)):
        bodies.place(frame)
        camera = gb.Camera((2, 3, 30), (0, 0, 0), fov=40)
        want = gb.render([gb.Scene(gb.read(f"fluid_{frame}.npz")), bodies.together], camera, (40, 30))
        shown = np.load(f"out_{i}.npz")["distance"]
        assert np.isfinite(shown).sum() > 20
        assert (np.isfinite(shown) == want.mask).mean() > 0.97
    (tmp_path / "none").mkdir()
    line = refused(capsys, "render", "fluid_1.npz", "--mesh", "none", "-o", "x.png")
    assert "expected files rb_data_1.bin" in line
