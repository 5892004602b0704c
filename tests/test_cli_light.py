"""Light, matter and cuts on the command line, presets, and phases as layers."""

import dataclasses
import json

import globule as gb
import numpy as np
import pytest
from cli_helpers import refused, refuses, run_json
from globule.cli import main
from globule.render.presets import PRESETS, ground_height
from PIL import Image

SMALL = ["--size", "48x36", "--device", "cpu"]
CAMERA = ["--eye", "1,1.2,3", "--look-at", "0,0,0"]


@pytest.fixture(autouse=True)
def file(folder):
    """A ball of radius 1, red for x < 0, else blue, in ball.npz."""
    gb.write("ball.npz", ball())


def ball(radius: float = 1.0, n: int = 9) -> gb.Particles:
    axis = np.linspace(-radius, radius, n, dtype=np.float32)
    positions = np.stack(np.meshgrid(axis, axis, axis), axis=-1).reshape(-1, 3)
    positions = positions[np.linalg.norm(positions, axis=1) <= radius]
    side = (positions[:, 0] >= 0).astype(np.float32)
    color = np.stack([1 - side, 0 * side, side], axis=1)
    return gb.Particles(positions, support=0.5, color=color, attributes={"side": side})


def picture(*words: str) -> np.ndarray:
    assert main(["render", "ball.npz", "-o", "a.png", *SMALL, *CAMERA, *words]) == 0
    return np.asarray(Image.open("a.png")).astype(int)


EYE = gb.Camera((1, 1.2, 3), (0, 0, 0))


def test_every_cut():
    for words, clips in (
        ("--clip -1,0,2,0", [gb.ClipPlane((-1, 0, 2), 0)]),
        ("--clip-box -9,-9,0,9,9,9", [gb.ClipBox((-9, -9, 0), (9, 9, 9))]),
        ("--clip-sphere 0,0,1,1", [gb.ClipSphere((0, 0, 1), 1)]),
        ("--crop -9,-9,-9,9,0,9", [gb.ClipBox((-9, -9, -9), (9, 0, 9), keep=True)]),
        ("--clip 1,0,0,0 --clip 0,1,0,0", [gb.ClipPlane((1, 0, 0), 0), gb.ClipPlane((0, 1, 0), 0)]),
    ):
        picture(*words.split(), "--aov", "a.npz")
        frame = gb.render(gb.Scene(ball(), device="cpu", surface="smooth"), EYE, (48, 36), clips=clips)
        assert frame.mask.sum() > 100
        with np.load("a.npz") as arrays:
            np.testing.assert_array_equal(arrays["distance"], frame.distance)


@pytest.mark.parametrize("name", PRESETS)
def test_presets(name):
    plain = picture()
    seen = picture("--preset", name, "--samples", "1", "--json")
    assert seen.std() > 8
    assert (seen != plain).any()
    scene = gb.Scene(ball(), device="cpu", surface="smooth")
    settings = gb.load_preset(name, scene)
    frame = gb.render(scene, EYE, (48, 36), dataclasses.replace(settings, samples=1))
    assert (np.abs(frame.picture.astype(int) - seen) <= 1).all()


def test_a_preset_does_not_depend_on_the_unit_of_length():
    meters, millimeters = ball(), ball()
    millimeters.positions = millimeters.positions * np.float32(1000)
    millimeters.support = 500.0
    seen = []
    for particles, unit in ((meters, 1), (millimeters, 1000)):
        scene = gb.Scene(particles, device="cpu", surface="smooth")
        settings = dataclasses.replace(gb.load_preset("water", scene), samples=1)
        camera = gb.Camera(np.multiply((1, 1.2, 3), unit), (0, 0, 0))
        seen.append(gb.render(scene, camera, (48, 36), settings).picture.astype(int))
    assert (np.abs(seen[0] - seen[1]) > 12).mean() < 0.02


def test_options_win_over_the_preset():
    ground = picture("--preset", "clay", "--samples", "1")
    low = picture("--preset", "clay", "--samples", "1", "--ground", "-30")
    assert (ground != low).any()
    white = picture("--preset", "blood", "--samples", "1", "--background", "1", "--eye", "0,9,0.1")
    assert (white != picture("--preset", "blood", "--samples", "1", "--eye", "0,9,0.1")).any()
    bare = picture("--preset", "tissue", "--samples", "1")
    lit = picture("--preset", "tissue", "--samples", "1", "--background", "0,1,0")
    assert (bare[0, 0] != [0, 255, 0]).any()
    assert (lit[0, 0] == [0, 255, 0]).all()


def test_the_ground_is_where_the_surface_ends():
    scene = gb.Scene(ball(), device="cpu", surface="smooth")
    down = gb.render(scene, gb.Camera((0, -5, 0), (0, 0, 0), (0, 0, 1)), (60, 60))
    lowest = float(np.nanmin(down.position[..., 1]))
    assert ground_height(scene) - 0.01 <= lowest < ground_height(scene) + 0.1
    assert ground_height(scene, (0, 0, 2)) == pytest.approx(ground_height(scene), abs=1e-5)


def test_light_options_reach_the_picture():
    plain = picture()
    for words in (
        "--transmission 1 --index 1.5",
        "--reflection 0.8 --sky gradient",
        "--sky 0.2,0.4,0.6",
        "--ground",
        "--ground -2",
        "--samples 3",
        "--light dir:0,1,0",
        "--ambient-rays 4 --ambient 0.5",
        "--transmission 0.9 --absorption 3,1,0",
    ):
        assert (picture(*words.split()) != plain).any(), words
    light = ["--light", "dir:1,1,0", "--ground"]
    hard, soft = (picture(*light, "--shadows"), picture("--light", "dir:1,1,0,20", *light[2:], "--shadows"))
    assert hard.sum() < picture(*light).sum()
    assert (soft != hard).any()
    mirror = ["--reflection", "0.8", "--sky", "gradient", "--samples", "2"]
    assert (picture(*mirror, "--roughness", "0.6") != picture(*mirror)).any()
    assert (picture(*mirror, "--bounces", "0") == picture(*mirror, "--bounces", "0")).all()


def test_a_sky_from_a_file():
    image = np.zeros((8, 16, 3), np.uint8)
    image[:4] = [255, 0, 0]
    Image.fromarray(image).save("sky.png")
    seen = picture("--sky", "sky.png", "--eye", "0,0,4")
    assert seen[0, 0, 0] > 200 > seen[-1, 0, 0]
    assert seen[0, 0, 1] == 0


def test_the_mean_of_a_sky():
    image = np.zeros((64, 8, 3), np.float32)
    image[:32] = [1, 0, 0.5]
    assert gb.Environment(image, strength=2).mean() == pytest.approx((1, 0, 0.5), abs=1e-6)
    image[:32], image[0] = 0, 64  # a row at the pole covers little
    assert gb.Environment(image).mean()[0] < 0.1
    image = (image > 0) * np.uint8(255)
    Image.fromarray(image.astype(np.uint8)).save("sky.png")
    assert (picture("--preset", "blood", "--sky", "sky.png") >= 0).all()


def test_a_scene_beside_shows_through():
    inner = ball(0.4, 5)
    inner.color = np.float32([0, 1, 0])
    inner.support = 0.3
    gb.write("inner.npz", inner)
    alone, shown = picture("--opacity", "0.2"), picture("--with", "inner.npz", "--opacity", "0.2")
    middle = (slice(14, 22), slice(20, 28))
    green = [float((p[..., 1] - p[..., 0])[middle].mean()) for p in (shown, alone)]
    assert green[0] > green[1] + 30
    assert (shown[0, 0] == alone[0, 0]).all()
    blue = picture("--with", "inner.npz:0,0,1", "--opacity", "0.2")
    assert (blue[..., 2] - blue[..., 1])[middle].mean() > green[0] / 2
    # A cut opens what is cut, not what is beside it.
    open_ = picture("--with", "inner.npz", "--clip", "0,0,1,0")
    assert open_[middle][..., 1].max() > 150


def test_pick(capsys):
    picture("--pick", "24,18")
    line = capsys.readouterr().out.splitlines()[-1]
    assert line.startswith("pixel 24,18: position ")
    assert "particle " in line
    assert "side " in line
    picture("--pick", "0,0")
    assert capsys.readouterr().out.endswith("pixel 0,0: nothing\n")
    picture("--pick", "24,18", "--clip", "0,0,1,0", "--json")
    picked = json.loads(capsys.readouterr().out)["picked"]
    assert picked["position"][2] == pytest.approx(0, abs=1e-4)
    assert picked["normal"] == [0, 0, 1]
    assert set(picked["attributes"]) == {"side"}
    assert picked["distance"] > 2
    picture("--json")
    assert "picked" not in json.loads(capsys.readouterr().out)


@pytest.mark.parametrize("words", [["--preset", "clay", "--samples", "1"], ["--ground", "plain"], ["--ground", "-1.5"]])
def test_no_ground_hides_a_floor_below_the_particles(capsys, words):
    with open("floor.obj", "w") as file:
        file.write("v -3 -2 -3\nv 3 -2 -3\nv 3 -2 3\nv -3 -2 3\nf 1 4 3 2\n")
    assert main(["render", "ball.npz", "-o", "a.png", *SMALL, "--eye", "0,1.5,9", "--look-at", "0,-1,0",
                 "--mesh", "floor.obj", "--pick", "24,28", *words]) == 0  # fmt: skip
    seen = capsys.readouterr().out.splitlines()[-1]
    assert seen.endswith("nothing" if "-1.5" in words else "of floor.obj"), seen


@pytest.mark.parametrize(("words", "hidden"), [
    (["--preset", "water"], True), (["--preset", "glass"], True), (["--preset", "clay"], False), ([], False),
    (["--preset", "water", "--transmission", "0"], False),
])  # fmt: skip
def test_colors_that_no_surface_shows_are_said(capsys, words, hidden):
    images = [
        picture("--color-by", "side", "--colormap", name, "--samples", "1", *words) for name in ("gray", "viridis")
    ]
    said = "--color-by: light goes through the surface, which shows no colors"
    assert capsys.readouterr().err.count(said) == 2 * hidden
    assert (np.abs(images[0] - images[1]).max() == 0) == hidden


def test_a_sequence_keeps_what_was_found_first():
    moved = ball()
    moved.positions = moved.positions + np.float32([0, 0.4, 0])
    gb.write("moved.npz", moved)
    gb.write("inner.npz", ball(0.3, 4))
    words = ["--with", "inner.npz", "--preset", "clay", "--samples", "1", *SMALL, *CAMERA]
    assert main(["render", "ball.npz", "moved.npz", "-o", "p_%d.png", *words]) == 0
    assert main(["render", "moved.npz", "-o", "alone.png", *words]) == 0
    one, two, alone = (np.asarray(Image.open(f"{n}.png")) for n in ("p_0", "p_1", "alone"))
    assert (one != two).any()
    assert (two != alone).any()


def test_a_picked_particle_is_the_file_s(capsys):
    holes = ball()
    positions = np.insert(holes.positions, 0, [[np.nan] * 3] * 7, axis=0)
    gb.write("holes.npz", gb.Particles(positions, support=0.5))
    words = ["render", "holes.npz", "-o", "a.png", *SMALL, *CAMERA, "--pick", "24,18"]
    picked = run_json(capsys, *words)["picked"]
    away = np.linalg.norm(positions - picked["position"], axis=1)
    assert picked["particle"] == np.nanargmin(away)


def test_mistakes(capsys):
    for words, named in (
        ("--clip 0,0,0,1", "--clip"),
        ("--clip-box 0,0,0,1,1,0", "--clip-box"),
        ("--sky missing.hdr", "missing.hdr"),
        ("--opacity 0.5 --transmission 1", "--opacity"),
        ("--light dir:0,0,0", "--light"),
        ("--pick 48,0", "--pick"),
        ("--with missing.npz", "missing.npz"),
        ("--with a.npz --with a.npz --with a.npz --with a.npz", "--with"),
        ("--with ball.npz:#zz", "--with: expected FILE or FILE:COLOR, COLOR being R,G,B"),
        ("--preset thesis --with ball.npz", "--with: expected no --with beside --preset thesis, which"),
        ("--root march --with ball.npz", "--with: expected no --with beside --root march, which"),
        ("--preset thesis --clip 1,0,0,0", "clips"),
    ):
        assert named in refused(capsys, "render", "ball.npz", "-o", "a.png", *SMALL, *words.split())


@pytest.mark.parametrize("words", [
    "--clip 0,0,1,-5", "--clip 1,0,0,0 --clip -1,0,0,-0.2", "--clip-box -9,-9,-9,9,9,9",
    "--clip-sphere 0,0,0,9", "--crop 3,3,3,4,4,4", "--crop-sphere 9,9,9,1",
])  # fmt: skip
def test_cuts_that_take_all_away(words, capsys):
    assert main(["render", "ball.npz", "-o", "a.png", *SMALL, *words.split()]) == 0
    assert capsys.readouterr().err == (
        "globule: warning: no pixel hits the surface: the cuts take all particles away\n"
    )


def test_layers_by():
    particles = ball()
    glass = gb.Material(transmission=1.0, index=1.0, absorption=0.0)
    layers = gb.split_layers(particles, "side", {1: glass, 0: None}, device="cpu")
    assert [layer.material for layer in layers] == [glass, None]
    assert [len(layer.scene) for layer in layers] == [
        int((particles.attributes["side"] == side).sum()) for side in (1, 0)
    ]
    camera = gb.Camera((4, 0, 0), (0, 0, 0))
    middle = gb.render(layers, camera, (21, 21)).color[10, 10]
    assert middle[0] > 2 * middle[2]  # red is seen through what has no color
    # Supports come from all particles, also where a phase is too thin to measure.
    particles.support = None
    one, two = gb.split_layers(particles, "side", {0: None, 7: None}, device="cpu")
    assert one.scene.support == gb.Scene(particles, device="cpu").support
    assert len(two.scene) == 0
    gb.render([one, two], camera, (21, 21))


def test_unknown_presets_and_attributes():
    particles = ball()
    with pytest.raises(ValueError, match=r"name: expected one of blood, .*got 'jelly'"):
        gb.load_preset("jelly", gb.Scene(particles, device="cpu"))
    with pytest.raises(ValueError, match=r"name: expected an attribute \(side\), got 'phase'"):
        gb.split_layers(particles, "phase", {0: None})
    refuses("materials: expected 1 to 4, got 5", gb.split_layers, particles, "side", dict.fromkeys(range(5)))
    particles.attributes["v"] = particles.positions
    refuses(r"got 'v' \(", gb.split_layers, particles, "v", {0: None})
