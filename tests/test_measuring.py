"""Distances and volumes with their uncertainty: against a Monte Carlo, on maps and on sweeps."""

import globule as gb
import numpy as np
import pytest
from cli_helpers import output_of, refused, refuses, run_json
from globule.cli import main
from globule.ultrasound import phantoms
from globule.ultrasound.measuring import _variance, find_error_length, measure_distance, measure_volume
from globule.ultrasound.wires import read_phantom
from globule.volumes.volume import FAR
from sweep_helpers import calibration_data

RADIUS = 6.0
SPACING = 0.8


def ball(points: np.ndarray) -> np.ndarray:
    """A dark ball with an edge of 1 mm in bright tissue."""
    r = np.linalg.norm(points - [0, 14, 0], axis=-1)
    return 60 + 80 / (1 + np.exp(-(r - RADIUS) / 0.5))


def known(values: np.ndarray, error: np.ndarray, radius=None) -> gb.volumes.Volume:
    place = np.diag([SPACING, SPACING, SPACING, 1.0])
    place[:3, 3] = -10, 4, -10
    return gb.volumes.Volume(values.astype(np.float32), place, radius, maps=lambda name: error)


def grid() -> np.ndarray:
    axis = SPACING * np.arange(26)
    z, y, x = np.meshgrid(axis, axis, axis, indexing="ij")
    return np.stack([x - 10, y + 4, z - 10], axis=-1)


def test_variance_of_a_cell_is_that_of_its_pairs():
    rng = np.random.default_rng(0)
    p, cells = rng.random(60), rng.integers(0, 7, 60)
    want = sum(np.minimum.outer(p[cells == c], p[cells == c]).sum() - p[cells == c].sum() ** 2 for c in range(7))
    assert _variance(p, cells) == pytest.approx(want)


@pytest.mark.slow
def test_against_errors_of_a_known_kind():
    """120 volumes whose errors are equal in cubes of 2 voxels, and independent between them."""
    rng = np.random.default_rng(1)
    truth, sigma = ball(grid()), 10.0
    volumes, distances = [], []
    for _ in range(120):
        cubes = rng.normal(0, sigma, (13, 13, 13))
        noisy = truth + np.kron(cubes, np.ones((2, 2, 2)))
        volume = known(noisy, np.full(truth.shape, sigma, np.float32))
        near = {"center": (0, 14, 0), "radius": 8.5}
        volumes.append(measure_volume(volume, 2 * SPACING, below=100, **near))
        distances.append(measure_distance(volume, (-9, 14, 0.1), (9, 14, 0.1), 2 * SPACING))
    found = np.array([v.volume for v in volumes])
    # Voxels far from the edge flip less often than their noisy values say: never too small.
    assert 0.9 < np.mean([v.std for v in volumes]) / found.std() < 1.5
    found = np.array([d.distance for d in distances])
    assert np.mean([d.std for d in distances]) == pytest.approx(found.std(), rel=0.25)
    assert found.mean() == pytest.approx(2 * RADIUS, abs=0.1)


def scanned(seed: int) -> gb.ultrasound.Sweep:
    """A pass over the ball, with noise of its own in every pixel and a path of its own."""
    size, pixel = (56, 64), 0.4
    poses = phantoms.hand_path(22, 19.0, seed, pixel, size)
    columns, rows = np.meshgrid(np.arange(size[0]), np.arange(size[1]))
    pixels = np.stack([columns, rows, 0 * rows, 0 * rows + 1], axis=-1)
    frames = np.stack([ball((pixels @ pose.T)[..., :3]) for pose in poses])
    frames += np.random.default_rng(seed).normal(0, 18, frames.shape)
    return gb.ultrasound.Sweep(frames.clip(0, 255).astype(np.uint8), poses)


@pytest.mark.slow
def test_against_many_sweeps():
    """What the trust map predicts holds what 16 sweeps of the phantom show, and is not far above."""
    volumes, distances = [], []
    for seed in range(16):
        sweep = scanned(seed)
        volume = gb.ultrasound.reconstruct(sweep, spacing=SPACING, device="cpu")
        length = find_error_length(sweep, SPACING)
        assert SPACING <= length <= 2
        options = {"below": 100.0, "center": (0, 14, 0), "radius": 8.5}
        volumes.append(measure_volume(volume, length, **options))
        distances.append(measure_distance(volume, (0, 5, 0), (0, 23, 0), length, width=2))
    for results, name, truth in ((volumes, "volume", 4 / 3 * np.pi * RADIUS**3), (distances, "distance", 2 * RADIUS)):
        found = np.array([getattr(r, name) for r in results])
        predicted = np.mean([r.std for r in results])
        seen = found.std(ddof=1)
        assert 0.8 * seen < predicted < 4 * seen
        assert abs(found.mean() - truth) < 0.03 * truth


def test_parts_without_data_are_told():
    truth = ball(grid())
    radius = np.zeros(truth.shape, np.uint8)
    radius[:13] = FAR
    volume = known(truth, np.full(truth.shape, 5, np.float32), radius)
    found = measure_volume(volume, 1.0, below=100, center=(0, 14, 0), radius=7)
    assert found.unknown == pytest.approx(4 / 3 * np.pi * 7**3 / 2, rel=0.1)
    assert found.measured == 1
    with pytest.raises(ValueError, match=r"^start: expected data along the line, got an empty"):
        measure_distance(volume, (0, 14, -9), (0, 14, 9), 1.0)


def wires(*places: float) -> gb.volumes.Volume:
    """Bright wires along y at these x, 14 mm deep."""
    points = grid()
    away = [(points[..., 0] - x) ** 2 + points[..., 2] ** 2 for x in places]
    values = sum((90 * np.exp(-0.5 * r / 0.8**2) for r in away), np.full(points.shape[:3], 10.0))
    return known(values, np.full(values.shape, 6, np.float32))


def test_two_echoes():
    volume = wires(-3.2, 2.0)
    found = measure_distance(volume, (-8, 14, 0), (8, 14, 0), 1.0)
    assert found.between == "echoes"
    assert found.distance == pytest.approx(5.2, abs=0.03)
    assert 0.01 < found.std < 0.2
    assert np.allclose(found.edges[:, 0], (-3.2, 2.0), atol=0.03)
    assert found.levels == pytest.approx((90, 10, 90), abs=12)
    refuses(r"a third is at \(6", measure_distance, wires(-6.0, 2.0, 7.0), (-8.5, 14, 0), (9, 14, 0), 1.0)
    refuses("clear edges or bright echoes", measure_distance, wires(), (-8, 14, 0), (8, 14, 0), 1.0)


@pytest.mark.slow
def test_echoes_against_errors_of_a_known_kind():
    rng = np.random.default_rng(3)
    truth = wires(-3.2, 2.0).values
    found = []
    for _ in range(120):
        noise = np.kron(rng.normal(0, 6, (13, 13, 13)), np.ones((2, 2, 2)))
        volume = known(truth + noise, np.full(truth.shape, 6, np.float32))
        found.append(measure_distance(volume, (-8, 14, 0.1), (8, 14, 0.1), 2 * SPACING))
    distances = np.array([one.distance for one in found])
    assert distances.mean() == pytest.approx(5.2, abs=0.03)
    assert np.mean([one.std for one in found]) == pytest.approx(distances.std(), rel=0.4)


@pytest.mark.slow
def test_wires_of_a_phantom(tmp_path, capsys):
    """Wires of PLUS's N-wire phantom, 5 and 7.07 mm apart by its definition, in its validation
    sweep. The probe is calibrated with the other sweep, to an expected error of 0.4 mm."""
    folder, probe = calibration_data(), str(tmp_path / "probe.toml")
    sweeps = [str(folder / f"fCal_Test_{n}_3NWires.igs.mha") for n in ("Calibration", "Validation")]
    phantom = folder / "spatial_calibration_1.2.xml"
    words = ["--n-wire", str(phantom), "--delay", "-o", probe]
    assert main(["calibrate", "--sweep", sweeps[0], *words]) == 0
    place = read_phantom(phantom).reference_from_phantom
    words = []
    pairs = [(20, 10, 20, 5), (20, 5, 20, 0), (45, 10, 50, 5), (50, 5, 50, 0)]
    for x0, z0, x1, z1 in pairs:
        ends = np.array([[x0, 20, z0, 1.0], [x1, 20, z1, 1.0]])
        apart = ends[1] - ends[0]
        outside = ends + np.outer((-2, 2), apart / np.linalg.norm(apart))
        line = (outside @ place.T)[:, :3].ravel()
        words.append("--distance=" + ",".join(f"{v:.3f}" for v in line))
    capsys.readouterr()
    options = ["--calibration", probe, "--voxel-size", "0.3", "--width", "1.5"]
    found = run_json(capsys, "measure", sweeps[1], *words, *options)["distances"]
    for one, (x0, z0, x1, z1) in zip(found, pairs, strict=True):
        assert one["between"] == "echoes"
        assert one["distance"] == pytest.approx(np.hypot(x1 - x0, z1 - z0), abs=0.25)
        assert 0.01 < one["std"] < 0.1


def test_mistakes():
    volume = known(np.full((26, 26, 26), 50.0), np.full((26, 26, 26), 5, np.float32))
    refuses(r"^above: expected one of above and below", measure_volume, volume, 1.0)
    refuses(r"^correlation: ", measure_volume, volume, 0.0, above=3)


def test_the_command(tmp_path, capsys):
    path = str(tmp_path / "ball.npz")
    gb.ultrasound.write_sweep(path, scanned(0))
    words = ["measure", path, "--voxel-size", "1", "--device", "cpu"]
    for more, what in [
        (["--distance", "0,0,0,0,0,0"], "--distance: expected a line of"),
        (["--distance", "0,14,0,0,900,0"], "--distance: expected data along the line"),
        (["--within", "0,14,0,8"], "--within: expected --above or --below"),
        (["--below", "100", "--within", "0,14,0,-8"], "--within: expected a radius"),
        (["--below", "100", "--within", "900,14,0,8"], "--within: expected voxels with data"),
        (["--below", "100", "--voxel-size", "1e6"], "--voxel-size: expected voxels smaller than"),
    ]:
        assert what in refused(capsys, *words, *more)
    captured = output_of(capsys, *words, "--above", "1000")
    assert "the level 1000 separates no voxels" in captured.err
    assert "volume 0 mm^3" in captured.out
    assert "separates no voxels" in run_json(capsys, *words, "--above", "1000")["warnings"][0]


def test_transposed_poses():
    poses = scanned(0).world_from_image[:3]
    refuses("probably transposed", gb.ultrasound.Sweep, np.zeros((3, 8, 8), np.uint8), poses.swapaxes(1, 2))
