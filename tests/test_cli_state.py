"""`globule render --state view.toml`: what the viewer saved, and flags that win over it."""

import shlex

import globule as gb
import numpy as np
import pytest
from globule.cli import main
from globule.viewer.engine import Engine
from globule.viewer.equivalent import command_line
from globule.viewer.open import open_source
from globule.viewer.state import State
from PIL import Image
from quick import every
from test_viewer_equivalent import STATES

CAMERA, SIZE = gb.Camera((1.6, 1.2, 3.0), (0.1, 0.0, 0.0), fov=42.0), (96, 72)
pytestmark = pytest.mark.usefixtures("folder")


@pytest.fixture
def cloud(folder):
    """Particles with an attribute, in cloud.npz."""
    positions = (np.random.default_rng(4).normal(size=(200, 3)) * 0.4).astype(np.float32)
    np.savez("cloud.npz", positions=positions, support=np.float32(0.4), speed=positions[:, 1])
    return "cloud.npz"


def image(*words: str) -> np.ndarray:
    """The image that `globule render` makes."""
    assert main(["render", *words, "-o", "made.png", "--device", "cpu"]) == 0
    with Image.open("made.png") as made:
        return np.asarray(made.convert("RGB"))


def save(camera: gb.Camera | None = CAMERA, **settings) -> list[str]:
    """Saves view.toml as the viewer does; the words of `render --state`."""
    state = State()
    state.set(quality__samples=2, **settings)
    state.save("view.toml", camera)
    return ["--state", "view.toml", "--size", f"{SIZE[0]}x{SIZE[1]}"]


def printed(file: str, camera: gb.Camera, **settings) -> np.ndarray:
    """The image of the command that the viewer prints."""
    engine = Engine(open_source(file, device="cpu"), State())
    try:
        engine.state.set(quality__samples=2, **settings)
        command = command_line(engine.source, engine.state, camera, SIZE, camera.up)
    finally:
        engine.close()
    words = shlex.split(command.partition("  # ")[0])
    assert words[:2] == ["globule", "render"]
    return image(*(word for word in words[2:] if word not in ("-o", "picture.png")))


@pytest.mark.parametrize("name", every(3, STATES, 1))
def test_the_image_is_that_of_the_printed_command(cloud, name):
    expected = printed(cloud, CAMERA, **STATES[name])
    assert expected.std() > 5
    assert np.array_equal(image(cloud, *save(**STATES[name])), expected)


def test_an_orthographic_camera(cloud):
    camera = gb.Camera((1, 2, 3), (0, 0, 0), (0, 0, 1), height=3.0)
    expected = printed(cloud, camera, look__preset="clay")
    assert np.array_equal(image(cloud, *save(camera, look__preset="clay")), expected)


def test_a_volume_s_surface(capsys):
    z, y, x = np.mgrid[-9:10, -9:10, -9:10]
    values = np.clip(220 - 18 * np.sqrt(x * x + y * y + z * z), 0, 255).astype(np.uint8)
    gb.volumes.write_volume("v.npz", gb.volumes.Volume(values, np.diag([2.0, 2.0, 2.0, 1.0])))
    camera = gb.Camera((60, 40, 80), (18, 18, 18))
    settings = {"slices__shown": False, "slices__level": 120.0, "surface__threshold": 0.5}
    expected = printed("v.npz", camera, **settings)
    capsys.readouterr()
    assert np.array_equal(image("v.npz", *save(camera, **settings)), expected)
    assert capsys.readouterr().err == ""
    lower = image("v.npz", *save(camera, **settings), "--level", "60")
    assert (lower != expected).any()
    settings["slices__shown"] = True
    assert np.array_equal(image("v.npz", *save(camera, **settings)), expected)
    assert "the image has no slices" in capsys.readouterr().err


def test_flags_win(cloud):
    look = {"look__preset": "water", "look__shadows": True, "cuts__plane": True,
            "color__by": "speed", "color__automatic": False, "color__low": -1.0,
            "color__legend": False}  # fmt: skip
    eye = ["--eye", "1.6,1.2,3", "--look-at", "0.1,0,0", "--up", "0,1,0"]
    plain = ["--size", "96x72", *eye]
    for flags, alone in (
        (["--samples", "1", "--clip", "0,1,0,0"],
         ["--fov", "42", "--preset", "water", "--shadows", "--color-by", "speed", "--bounces", "4",
          "--ambient-rays", "0", "--range", "-1,1", "--samples", "1", "--clip", "0,1,0,0"]),
        (["--color-by", "y", "--no-shadows", "--fov", "30"],
         ["--fov", "30", "--preset", "water", "--no-shadows", "--color-by", "y", "--bounces", "4",
          "--ambient-rays", "0", "--samples", "2", "--clip", "1,0,0,0"]),
        (["--ortho", "3", "--preset", "clay", "--bounces", "1", "--background", "1,0,0"],
         ["--ortho", "3", "--preset", "clay", "--shadows", "--color-by", "speed", "--bounces", "1",
          "--ambient-rays", "0", "--range", "-1,1", "--samples", "2", "--clip", "1,0,0,0",
          "--background", "1,0,0"]),
    ):  # fmt: skip
        found = image(cloud, *save(**look), *flags)
        assert np.array_equal(found, image(cloud, *plain, *alone)), flags


def test_fit_wins_over_the_saved_camera(cloud):
    assert np.array_equal(image(cloud, *save(), "--fit", "--up", "0,1,0"), image(cloud, *save(None),
                          "--fov", "42"))  # fmt: skip


def test_a_default_that_is_given_wins(cloud):
    words = save(surface__kernel="wyvill")
    assert (image(cloud, *words) != image(cloud, *save())).any()
    assert np.array_equal(image(cloud, *words, "--kernel", "murakami"), image(cloud, *save()))
