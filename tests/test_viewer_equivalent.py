"""What the viewer prints as a command and as Python makes the viewer's picture."""

import os
import shlex

import globule as gb
import numpy as np
import pytest
from globule.cli import main
from globule.viewer.equivalent import command_line, python_code
from globule.viewer.recording import Shot, checked_size
from PIL import Image
from quick import every
from viewer_helpers import engine_of, until

STATES = {
    "plain": {},
    "surface": {"surface__threshold": 0.9, "surface__support": 0.5, "surface__kernel": "wendland_c2"},
    "color": {"color__by": "speed", "color__colormap": "turbo", "color__legend": True},
    "range": {"color__by": "y", "color__automatic": False, "color__low": -1.0, "color__high": 0.5},
    "cuts": {"cuts__plane": True, "cuts__normal": (0.3, 0.1, 1.0), "cuts__point": (0.0, 0.0, 0.1),
             "cuts__box": True, "cuts__lo": (0.0, -2.0, -2.0), "cuts__hi": (2.0, 0.0, 2.0)},
    "sphere": {"cuts__sphere": True, "cuts__center": (0.5, 0.0, 0.2), "cuts__radius": 0.6},
    "water": {"look__preset": "water", "look__shadows": True, "look__bounces": 6},
    "own": {"look__lights": "own", "look__azimuth": 40.0, "look__matter": "own", "look__reflection": 0.4,
            "look__sky": "gradient", "look__ambient_rays": 2},
    "thesis": {"surface__root": "march"},
    "bright": {"look__preset": "water", "look__exposure": 1.7, "look__sky": "none",
               "look__background": (0.1, 0.2, 0.3)},
    "bare": {"look__preset": "clay", "look__ground": "none", "look__background": (1.0, 0.0, 0.0)},
    "checks": {"look__preset": "clay", "look__ground": "checker", "look__ambient_rays": 2},
    "plain ground": {"look__preset": "glass", "look__ground": "plain", "look__bounces": 2},
    "crops": {"cuts__sphere": True, "cuts__keep_sphere": True, "cuts__radius": 0.7, "cuts__box": True,
              "cuts__keep_box": True, "cuts__lo": (0.0, -2.0, -2.0), "cuts__hi": (2.0, 2.0, 2.0)},
    "notes": {"notes__title": "- A title", "notes__scale_bar": True, "notes__axes": True, "notes__box": True,
              "notes__unit": "mm"},
    "legend": {"color__by": "speed", "color__legend_at": "upper-left", "color__legend_title": "height",
               "color__legend_unit": "m/s", "notes__axes": True},
    "flat": {"look__preset": "flat", "color__by": "speed"},
    "colored clay": {"look__preset": "clay", "color__by": "speed", "color__legend": False},
}  # fmt: skip


CAMERA, SIZE = gb.Camera((1.6, 1.2, 3.0), (0.1, 0.0, 0.0), fov=42.0), (80, 60)
FAR = gb.Camera((1.6, 1.2, 6.0), (0.1, 0.0, 0.0))
pytestmark = pytest.mark.usefixtures("folder")


@pytest.fixture
def engine(folder):
    positions = (np.random.default_rng(4).normal(size=(200, 3)) * 0.4).astype(np.float32)
    np.savez("some cloud.npz", positions=positions, support=np.float32(0.4), speed=positions[:, 1])
    with engine_of("some cloud.npz") as made:
        yield made


@pytest.mark.parametrize("name", every(3, STATES))
def test_command_and_program_make_the_same_picture(engine, name):
    engine.state.set(quality__samples=3, **STATES[name])
    check(engine, CAMERA, size=(160, 120))


def picture() -> np.ndarray:
    found = np.asarray(Image.open("picture.png").convert("RGB")).astype(int)
    os.unlink("picture.png")
    return found


def printed(engine, camera, size=SIZE) -> tuple[str, str]:
    about = engine.source, engine.state, camera, size, engine.up
    return command_line(*about), python_code(*about)


def check(engine, camera, without: str = "", size=SIZE) -> np.ndarray:
    """What is printed makes the picture of the viewer, whose hits come back."""
    shot = Shot(engine, camera, size, engine.state.quality.samples)
    expected = shot.picture
    command, code = printed(engine, camera, size)
    command, _, comment = command.partition("  # ")
    assert comment == (without and f"without: {without}")
    if not command.startswith("globule view"):
        for part in command.split(" && "):
            assert main(shlex.split(part)[1:]) == 0
        assert np.abs(picture() - expected).mean() < 0.05, command
    exec(compile(code, "printed", "exec"), {})
    assert np.abs(picture() - expected).mean() < 0.05, code
    return shot.frame.mask


def test_a_volume_s_surface_a_sweep_s_volume_and_a_sequence_s_frame():
    z, y, x = np.mgrid[-9:10, -9:10, -9:10]
    values = np.clip(220 - 18 * np.sqrt(x * x + y * y + z * z), 0, 255).astype(np.uint8)
    volume = gb.volumes.Volume(values, np.diag([2.0, 2.0, 2.0, 1.0]))
    for name in ("v.npz", "v.nii.gz"):
        if name == "v.nii.gz":
            pytest.importorskip("SimpleITK")
        gb.volumes.write_volume(name, volume)
        look = {"slices__level": 120.0, "surface__kernel": "wendland_c2", "quality__samples": 1}
        with engine_of(name, slices__shown=False, **look) as engine:
            camera = gb.Camera((60, 40, 80), engine.source.bounds()[1] / 2)
            assert check(engine, camera).mean() > 0.03
            engine.state.set(slices__shown=True, surface__threshold=0.5)
            assert printed(engine, camera)[0].endswith("# without: slices, threshold")
    made = gb.ultrasound.phantoms.cylinders(n_frames=12, size=(40, 36), spacing=1.0)
    gb.ultrasound.write_sweep("sweep.igs.mha", made)
    with engine_of("sweep.igs.mha", slices__shown=False, quality__samples=1) as engine:
        source = engine.source
        source.start()
        until(lambda: not source.running)
        source.stop()  # shows all that came
        lo, hi = source.bounds()
        camera = gb.Camera(hi + 40, (lo + hi) / 2, (0, 0, 1))
        check(engine, camera, "the images so far")
        source.finish("vvn")
        assert check(engine, camera).mean() > 0.02
    for i in range(3):
        gb.write(f"frame_{i}.npz", gb.Particles(np.eye(3) * (1 + 0.2 * i), support=1.0))
    with engine_of(["frame_*.npz"], time__frame=2, quality__samples=1) as engine:
        until(lambda: engine.source.frame == 2)
        assert "frame_2.npz" in printed(engine, FAR)[0]
        check(engine, FAR)


@pytest.mark.parametrize("foam", ["", "foam = { approach = [0.01, 0.1], speed = [0.01, 0.1] }"])
@pytest.mark.parametrize("color", ["", "speed"])
def test_a_simulation(folder, foam, color):
    (folder / "dam.toml").write_text(f"""
{foam}
spacing = 0.05
domain = {{ lo = [0, 0, 0], hi = [1, 0.4, 0.8], walls = true }}
[[fluids]]
name = "water"
box = {{ lo = [0, 0, 0], hi = [0.4, 0.4, 0.4] }}
""")
    water = {"look__preset": "water", "look__shadows": True, "look__bounces": 6}
    look = {"color__by": color, "color__legend": False} if color else water
    with engine_of("dam.toml", quality__samples=1, **look) as engine:
        for _ in range(5):
            engine.source.simulation.step()
        camera = gb.Camera((0.5, -2, 1), (0.5, 0.2, 0.2), (0, 0, 1))
        assert (len(engine.source.simulation.foam) > 20) == bool(foam)
        passed = f"the simulated {engine.source.simulation.time:.4g} s"
        check(engine, camera, passed)
        engine.source.by_hand = True
        engine.state.set(cuts__plane=True)
        command, _ = printed(engine, camera)
        assert command.endswith(f"# without: {passed}, changes by hand, light, cuts and samples")
        engine.state.set(look__preset="flat", color__by="speed")
        _, code = printed(engine, camera)
        assert ("color_by=" in code) != bool(foam)  # `render` refuses it with several layers
        assert ("# without: " in code and "colors of blended values" in code) == bool(foam)


def test_particles_of_a_program_are_said_to_be():
    particles = gb.Particles(np.eye(3), support=1.0)
    with engine_of(particles, quality__samples=1) as engine:
        assert 'gb.write("particles.npz", particles)' in printed(engine, FAR)[1]
        gb.write("particles.npz", particles)
        check(engine, FAR)


@pytest.mark.parametrize("height", [None, 5.0])
def test_plates_and_marks_stand_where_they_are(height):
    from globule.viewer.overlay import Plate, draw_plates

    camera, size = gb.Camera((3, 4, 6), (0.2, 0.1, 0), height=height), (200, 150)
    texture = np.zeros((40, 60, 3), np.uint8)
    texture[30, 45] = 255
    pose = np.diag([0.05, 0.05, 1.0, 1.0])
    pose[:3, 3] = (-1.5, -1.0, 0.3)
    depth = np.full(size[::-1], np.inf, np.float32)
    drawn = draw_plates(np.full((*size[::-1], 3), 9, np.uint8), depth, camera, [Plate(texture, pose)])
    rows, columns = np.nonzero(drawn[..., 0] == 255)
    ((x, y),) = camera.project([pose[:3] @ (45, 30, 0, 1)], size)
    assert len(rows)
    assert abs(columns.mean() + 0.5 - x) < 0.6
    assert abs(rows.mean() + 0.5 - y) < 0.6
    origin, direction = camera.ray(size, (x / size[0], y / size[1]))
    assert np.linalg.norm(np.cross(pose[:3] @ (45, 30, 0, 1) - origin, direction)) < 1e-6
    assert np.allclose(camera.towards([pose[:3] @ (45, 30, 0, 1)])[0], direction)


def test_a_picture_has_limits_and_waits_for_no_change_in_between(engine, monkeypatch):
    """Settings that change while it is traced: all its samples show one state."""
    said = []

    def change(share):
        said.append(share)
        if len(said) == 2:
            engine.state.set(surface__threshold=1.2)

    shot = Shot(engine, CAMERA, SIZE, 4, progress=change)
    assert said == [0.25, 0.5, 0.25, 0.5, 0.75]
    assert np.array_equal(shot.picture, Shot(engine, CAMERA, SIZE, 4).picture)
    assert checked_size((1920, 1080)) == (1920, 1080)
    for size in ((8, 100), (100, 20000), (16384, 16384 + 1)):
        with pytest.raises(ValueError, match="size: expected"):
            checked_size(size)
    monkeypatch.setattr("globule.viewer.recording.free_bytes", lambda: 200_000_000)
    assert checked_size((1000, 1000)) == (1000, 1000)
    with pytest.raises(ValueError, match="at most 1,000,000 pixels"):
        checked_size((1001, 1000))
