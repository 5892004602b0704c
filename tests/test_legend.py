"""The color bar in a picture, the color maps behind it, and colors and legends of types and elements."""

from pathlib import Path

import globule as gb
import numpy as np
import pytest
from cli_helpers import SMALL, refuses, run_json
from globule._base.colormaps import CATEGORICAL, NAMES, colorize, map_colors, to_linear
from globule.cli import main
from globule.data.attributes import colormap_of, kinds_of
from globule.render.display import displayed
from globule.render.legend import add_legend, tick_labels
from PIL import Image

pytestmark = pytest.mark.usefixtures("folder")
X = np.array([[0, 0, 0], [3, 0, 0], [0, 3, 0], [3, 3, 0]], float)
JMOL = {"H": "ffffff", "C": "909090", "O": "ff0d0d"}
OKABE_ITO = ["e69f00", "56b4e9", "009e73"]


def gray(width: int, height: int, value: int = 240) -> np.ndarray:
    return np.full((height, width, 3), value, np.uint8)


@pytest.mark.parametrize("size", [(64, 64), (100, 80), (640, 480), (1920, 1080), (300, 2000)])
@pytest.mark.parametrize("value", [0, 128, 255])
def test_the_bar_has_the_maps_colors(size, value):
    before = gray(*size, value)
    after = add_legend(before, "viridis", -1.5, 22.25, "speed")
    assert after.shape == before.shape
    assert after.dtype == np.uint8
    assert (before == value).all()
    changed = (after != before).any(axis=2)
    rows, columns = np.nonzero(changed)
    assert rows.min() > size[1] * 0.3 or size[1] < 200 or size[0] < size[1]
    assert columns.max() < size[0]
    assert columns.min() > 0.2 * size[0]
    ends = map_colors("viridis", 2)
    for color in ends:
        assert (after == color).all(axis=2).sum() >= 3
    last, first = (np.argwhere((after == color).all(axis=2))[:, 0].mean() for color in ends)
    assert first < last  # the highest value is on top


def test_text_stands_out():
    for value in (0, 255):
        after = add_legend(gray(400, 300, value), "magma", 0, 1, "pressure")
        label = after[: int(300 * 0.55)]
        assert (np.abs(label.astype(int) - value).max(axis=2) > 150).sum() > 30


def test_ticks():
    for lo, hi, texts in (
        (0, 1, ["0", "0.2", "0.4", "0.6", "0.8", "1"]),
        (-1.234567, 8.9, ["-1.23", "0", "2", "4", "6", "8.9"]),
        (1, 0, ["1", "0.8", "0.6", "0.4", "0.2", "0"]),
        (5, 5, ["5"]),
        (-4, -0.0, ["-4", "-3", "-2", "-1", "0"]),
        (101325.2, 101327.9, ["101325.2", "101325.5", "101326", "101326.5", "101327", "101327.5", "101327.9"]),
    ):
        assert [text for _, text in tick_labels(lo, hi, 6)] == texts


@pytest.mark.parametrize("ends", [(1e300, -1e300), (-1.7e308, 1.7e308), (0, 3e-320), (5, 5 + 1e-9)])
def test_ticks_of_extreme_ranges(ends):
    ticks = tick_labels(*ends, 6)
    shares = [share for share, _ in ticks]
    assert shares[0] == 0
    assert shares[-1] == 1
    assert sorted(shares) == shares
    assert len(ticks) <= 8


def test_ticks_leave_room_for_the_ends():
    for hi in (1.04, 1.01, 2.03, 1.96):
        shares = [share for share, _ in tick_labels(0, hi, 5)]
        assert min(np.diff(shares)) > 0.6 / 5 - 1e-9, hi


def test_wrong_arguments():
    for arguments, what in (
        ((gray(63, 100), "viridis", 0, 1), "image: expected at least 64 pixels a side"),
        ((gray(100, 100)[..., :1], "viridis", 0, 1), "image: expected"),
        ((gray(100, 100) / 255, "viridis", 0, 1), "image: expected .*uint8"),
        ((gray(100, 100), "jet", 0, 1), "colormap: expected one of"),
        ((gray(100, 100), "viridis", np.nan, 1), "range: expected two finite"),
    ):
        refuses(what, add_legend, *arguments)


def test_long_labels_are_shortened():
    after = add_legend(gray(200, 150), "gray", 0, 1, "many words\n" * 100)
    assert after.shape == (150, 200, 3)
    assert (after[:, :3] == 240).all()


@pytest.mark.parametrize("name", [name for name in NAMES if name not in CATEGORICAL])
def test_maps_are_those_of_matplotlib(name):
    matplotlib = pytest.importorskip("matplotlib", reason="matplotlib is not installed")
    table = matplotlib.colormaps[name](np.arange(256))[:, :3]
    assert (map_colors(name, 256) == np.rint(255 * table)).all()
    assert np.allclose(colorize(np.arange(256), name, 0, 255), to_linear(table), atol=1e-6)


def test_command():
    points = np.stack(np.mgrid[0:5, 0:5, 0:5], axis=-1).reshape(-1, 3)
    gb.write("a.npz", gb.Particles(points, attributes={"speed": np.arange(125.0)}))
    words = ["render", "a.npz", "--size", "160x120", "--device", "cpu"]
    color = ["--color-by", "speed", "--colormap", "turbo"]
    assert main([*words, *color, "-o", "plain.png"]) == 0
    assert main([*words, *color, "--legend", "-o", "legend.png"]) == 0
    plain, legend = (np.asarray(Image.open(f"{name}.png")) for name in ("plain", "legend"))
    assert np.array_equal(legend, add_legend(plain, "turbo", 0, 124, "speed"))


# Types and elements


def srgb(linear: np.ndarray) -> list[str]:
    return [bytes(row).hex() for row in displayed(np.asarray(linear, np.float32))]


def test_colors_of_types_and_elements():
    assert srgb(gb.colorize([1, 2, 3, 13], "types", 0, 1)) == [*OKABE_ITO, OKABE_ITO[0]]
    assert srgb(gb.colorize([1, 6, 8], "elements", 8, 1)) == list(JMOL.values())
    # sRGB 0.5 is between two bytes.
    gray = srgb(gb.colorize([np.nan, 0, 97, 1e300, -3], "elements", 0, 1))
    assert {*gray} == {*srgb(gb.colorize([np.nan, np.inf], "types", 0, 1))} == {"7f7f7f"}


@pytest.mark.parametrize("name", ["type", "Type", "TypeId", "species", "label"])
def test_names_choose_the_map(name):
    attributes = {name: np.array([1, 2, 2, 3]), "speed": np.arange(4.0)}
    particles = gb.Particles(X, attributes=attributes)
    colored = gb.color_by(particles, name)
    assert srgb(colored.color) == [OKABE_ITO[k] for k in (0, 1, 1, 2)]
    assert colormap_of(name, "auto") == "types"
    assert colormap_of(name, "magma") == "magma"  # asked for
    same = gb.color_by(particles, "speed").color
    assert np.array_equal(same, gb.color_by(particles, "speed", "viridis").color)


def test_names_of_files():
    Path("a.xyz").write_text("4\n\n" + "".join(f"{w} {x} {y} {z}\n" for w, (x, y, z) in zip("BACA", X, strict=True)))
    found = gb.read("a.xyz")  # C is an element, A is not
    assert found.names == {"type": {1: "A", 2: "B", 3: "C"}}
    assert kinds_of(found[1:3], "type", "auto") == ((1.0, "A"), (3.0, "C"))
    with open("a.extxyz", "w") as file:
        file.write("4\nProperties=species:S:1:pos:R:3\n")
        file.write("".join(f"{w} {x} {y} {z}\n" for w, (x, y, z) in zip("OHHC", X, strict=True)))
    found = gb.read("a.extxyz")
    assert found.names == {}
    named = ((1.0, "H"), (6.0, "C"), (8.0, "O"))
    assert kinds_of(found, "atomic_number", "auto") == named
    assert srgb(gb.color_by(found, "atomic_number").color) == [JMOL[w] for w in "OHHC"]
    assert kinds_of(found, "atomic_number", "viridis") == kinds_of(found, "x", "auto") == ()


def test_names_of_lammps():
    with open("a.data", "w") as file:
        file.write("# words\n\n4 atoms\n2 atom types\n0 9 xlo xhi\n0 9 ylo yhi\n0 9 zlo zhi\n\n")
        file.write("Masses\n\n1 18.0 # water\n2 23.0 # salt\n\nAtoms # atomic\n\n")
        file.write("".join(f"{i + 1} {1 + i % 2} {x} {y} {z}\n" for i, (x, y, z) in enumerate(X)))
    assert gb.read("a.data").names == {"type": {1: "water", 2: "salt"}}
    with open("a.dump", "w") as file:
        file.write("ITEM: TIMESTEP\n0\nITEM: NUMBER OF ATOMS\n4\nITEM: ATOMS id type element x y z\n")
        rows = zip((2, 1, 2, 1), "OHOH", X, strict=True)
        file.write("".join(f"1 {t} {w} {x} {y} {z}\n" for t, w, (x, y, z) in rows))
    found = gb.read("a.dump")
    assert found.names == {"type": {2: "O", 1: "H"}}
    assert found.attributes["atomic_number"].tolist() == [8, 1, 8, 1]
    assert np.allclose(found.support, np.multiply(4, [1.52, 1.2, 1.52, 1.2]))


@pytest.mark.interop
def test_names_of_gsd():
    hoomd = pytest.importorskip("gsd.hoomd")
    frame = hoomd.Frame()
    frame.configuration.box = [20, 20, 20, 0, 0, 0]
    frame.particles.N, frame.particles.position = 4, X
    frame.particles.types, frame.particles.typeid = ["solvent", "B-2"], [0, 1, 1, 0]
    with hoomd.open("a.gsd", "w") as file:
        file.append(frame)
    found = gb.read("a.gsd")
    assert found.names == {"type": {0: "solvent", 1: "B-2"}}
    assert kinds_of(found, "type", "auto") == ((0.0, "solvent"), (1.0, "B-2"))


def test_legends_list_what_there_is():
    blank = np.full((300, 400, 3), 128, np.uint8)
    after = gb.add_legend(blank, "types", 1, 3, "type")
    shown = {bytes(pixel).hex() for pixel in after.reshape(-1, 3)}
    assert {*OKABE_ITO} <= shown
    assert "8c6bb1" not in shown
    many = gb.add_legend(blank, "types", 0, 1000, "type")  # no room for names
    assert (many != blank).any()


def test_images_and_commands(capsys):
    particles = gb.Particles(X, attributes={"type": np.array([1, 2, 2, 3])})
    gb.write("a.npz", particles)
    words = ["--color-by", "type", "--flat", *SMALL]
    run_json(capsys, "render", "a.npz", "-o", "a.png", *words)
    run_json(capsys, "render", "a.npz", "-o", "legend.png", *words, "--size", "300x200", "--legend")
    flat = gb.load_preset("flat", gb.Scene(particles))
    frame = gb.render(particles, (40, 30), settings=flat, color_by="type")
    image = np.asarray(Image.open("a.png"))
    assert np.array_equal(image, frame.image)
    shown = {bytes(pixel).hex() for pixel in image.reshape(-1, 3)}
    assert {*OKABE_ITO} <= shown
    legend = np.asarray(Image.open("legend.png"))[:, 240:]
    found = {bytes(pixel).hex() for pixel in legend.reshape(-1, 3)}
    assert {*OKABE_ITO} <= found
