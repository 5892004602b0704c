"""Volumes along other axes than the world's, voxels that are no cubes, and projections."""

import globule as gb
import numpy as np
import pytest
from cli_helpers import run_json
from globule.cli import main
from globule.ultrasound.lattice import sweep_axes
from globule.ultrasound.trust import compare_methods
from globule.volumes.slices import max_projections, save_three_view
from PIL import Image
from scipy.spatial.transform import Rotation

TURN = Rotation.from_quat([0.3, -0.5, 0.2, 0.8]).as_matrix()
OBLIQUE = Rotation.from_quat([0.1, 0.7, -0.3, 0.5]).as_matrix()
FIELD = np.array([0.7, -0.4, 1.1])  # gray levels a mm


def linear_sweep(turn=TURN) -> gb.ultrasound.Sweep:
    """30 frames, parallel within a degree, whose values are 120 + FIELD · place."""
    rng, poses = np.random.default_rng(2), np.tile(np.eye(4), (30, 1, 1))
    for i, pose in enumerate(poses):
        small = Rotation.from_quat([*rng.normal(size=3) * 0.004, 1.0]).as_matrix()
        pose[:3, :3] = turn @ small @ np.diag([0.5, 0.4, 0.5])
        pose[:3, 3] = turn @ (-15, -10, 0.9 * i - 13)
    pixels = np.stack(np.meshgrid(np.arange(60), np.arange(50), indexing="xy"), axis=-1)
    places = np.einsum("fik,hwk->fhwi", poses[:, :3, :2], pixels) + poses[:, None, None, :3, 3]
    return gb.ultrasound.Sweep((120 + places @ FIELD).astype(np.float32), poses)


@pytest.mark.parametrize("spacing", [0.8, (0.6, 0.8, 1.7)])
@pytest.mark.parametrize("axes", ["world", "sweep", OBLIQUE])
def test_every_lattice_holds_the_field_s_values(spacing, axes):
    """The interpolation of a linear field is the field, on any lattice."""
    volume = gb.ultrasound.reconstruct(linear_sweep(), spacing=spacing, axes=axes, device="cpu")
    assert np.allclose(volume.spacing, spacing)
    turn = volume.world_from_voxel[:3, :3] / volume.spacing
    assert np.allclose(turn.T @ turn, np.eye(3), atol=1e-9)
    assert np.linalg.det(turn) > 0
    if not isinstance(axes, str):
        assert np.allclose(turn, axes)
    z, y, x = np.nonzero(volume.radius != 255)
    assert len(z) > 3000
    places = np.stack([x, y, z], axis=1) @ volume.world_from_voxel[:3, :3].T
    error = volume.values[z, y, x] - (120 + (places + volume.world_from_voxel[:3, 3]) @ FIELD)
    # Images are averaged over a voxel, also beyond their borders; at the sweep's ends voxels hold
    # the mean of their pixels.
    assert np.median(np.abs(error)) < 0.05
    assert np.percentile(np.abs(error), 80) < 0.1
    assert np.abs(error).max() < 2.0


def test_axes_turn_with_the_sweep_and_mistakes_of_axes():
    sweep = gb.ultrasound.phantoms.cylinders(n_frames=24, size=(64, 60), spacing=0.8)
    frame = np.eye(4)
    frame[:3, :3] = TURN
    for method in ("frames", "pvn-om"):
        plain = gb.ultrasound.reconstruct(sweep, method, spacing=1.0, device="cpu")
        rotated = gb.ultrasound.Sweep(sweep.frames, frame @ sweep.world_from_image, sweep.timestamps)
        turned = gb.ultrasound.reconstruct(rotated, method, spacing=1.0, axes=TURN, device="cpu")
        # A pixel on the face of two voxels may fall to the other one.
        assert plain.shape == turned.shape
        assert (plain.values != turned.values).mean() < 0.02
        assert np.allclose(turned.world_from_voxel, frame @ plain.world_from_voxel, atol=1e-6)
        same = gb.ultrasound.reconstruct(sweep, method, spacing=(1, 1, 1), axes=np.eye(3), device="cpu")
        assert np.array_equal(same.values, plain.values)
    # They need fewer voxels.
    sweep = linear_sweep()
    world = gb.ultrasound.reconstruct(sweep, spacing=0.8, device="cpu")
    along = gb.ultrasound.reconstruct(sweep, spacing=0.8, axes="sweep", device="cpu")
    assert along.values.size < 0.5 * world.values.size
    assert along.n_empty / along.values.size < 0.25
    # Axes have the names of the world's axes that are nearest, and a straight sweep keeps them.
    straight = linear_sweep(np.eye(3))
    assert np.allclose(sweep_axes(straight), np.eye(3), atol=0.03)
    back = gb.ultrasound.Sweep(straight.frames, straight.world_from_image @ np.diag([-1.0, 1, -1, 1]))
    assert np.allclose(sweep_axes(back), np.eye(3), atol=0.03)
    sweep, region = linear_sweep(), ((-5, -5, -5), (5, 5, 5))
    for given, message in (
        ({"axes": "probe"}, "axes: expected world, sweep"),
        ({"axes": np.diag([1, 1, 2])}, "axes: expected a 3x3 matrix with unit"),
        ({"axes": np.diag([1, 1, -1])}, "right-handed"),
        ({"axes": "sweep", "region": region}, "region: expected axes world"),
        ({"spacing": (1, 2)}, "spacing: expected a positive number or three"),
        ({"spacing": (1, 1, 99)}, "differ at most 30 times"),
    ):
        with pytest.raises(ValueError, match=message):
            gb.ultrasound.reconstruct(sweep, **({"spacing": 1.0, "device": "cpu"} | given))


@pytest.mark.parametrize("dtype", ["uint8", "float32"])
def test_projections(dtype, tmp_path):
    values = np.zeros((6, 5, 4), dtype)
    values[4, 1, 2], values[0, 0, 0] = 200, 100
    radius = np.zeros(values.shape, np.uint8)
    radius[:, 4] = 255
    volume = gb.volumes.Volume(values, np.eye(4), radius)
    picture = max_projections(volume)
    gray = picture.astype(int).mean(axis=2)
    assert picture.shape == (6, 4 + 8 + 4 + 8 + 5, 3)
    assert gray[1, 2] > 250  # along z: (x 2, y 1)
    assert gray[4, 12 + 2] > 250  # along y: (x 2, z 4)
    assert gray[4, 24 + 1] > 250  # along x: (y 1, z 4)
    assert 100 < gray[0, 0] < 150
    assert tuple(picture[4, 0]) == (24, 40, 72)  # nothing is known along this line
    save_three_view(tmp_path / "two.png", volume)
    save_three_view(tmp_path / "three.png", volume, projections=True)
    two, three = (np.asarray(Image.open(tmp_path / f"{n}.png")) for n in ("two", "three"))
    assert three.shape[0] == 1.5 * two.shape[0]
    assert np.array_equal(three[: len(two)], two)


def test_a_method_that_fails_does_not_end_the_comparison(caplog):
    """Four frames: bezier needs as many, and has fewer once some are left out."""
    sweep = linear_sweep()[:5]
    found = compare_methods(sweep, 2, ("frames", "no such method", "pvn-om"), spacing=1.0, device="cpu")
    assert list(found) == ["frames", "pvn-om"]
    assert "cross-validation without no such method" in caplog.text
    with pytest.raises(ValueError, match="no such method"):
        compare_methods(sweep, 2, ("no such method",), spacing=1.0, device="cpu")


def test_the_command(folder, capsys):
    gb.ultrasound.write_sweep("oblique.igs.mha", linear_sweep())
    words = ["reconstruct", "oblique.igs.mha", "-o", "v.nrrd", "--device", "cpu"]
    words += ["--method", "frames", "--voxel-size", "1", "--three-view", "v.png"]
    plain = run_json(capsys, *words)["counts"]["voxels"]
    height = np.asarray(Image.open("v.png")).shape[0]
    found = run_json(capsys, *words, "--volume-axes", "sweep", "--projections")
    assert found["counts"]["voxels"] < 0.6 * plain
    assert np.asarray(Image.open("v.png")).shape[0] != height
    for extra, message in (
        (["--volume-axes", "sweep", "--bounds=-5,-5,-5,5,5,5"], "expected no --bounds"),
        (["--volume-axes", "probe"], "--volume-axes"),
    ):
        assert main([*words, *extra]) == 2
        assert message in capsys.readouterr().err
    assert main([*words[:6], "--projections"]) == 2
    assert "--three-view" in capsys.readouterr().err
