"""Colors of types and elements, and the legends that name them."""

from __future__ import annotations

import globule as gb
import numpy as np
import pytest
from cli_helpers import SMALL, run_json
from globule.data.attributes import colormap_of, kinds_of

pytestmark = pytest.mark.usefixtures("folder")
X = np.array([[0, 0, 0], [3, 0, 0], [0, 3, 0], [3, 3, 0]], float)
JMOL = {"H": "ffffff", "C": "909090", "O": "ff0d0d"}
OKABE_ITO = ["e69f00", "56b4e9", "009e73"]


def srgb(linear: np.ndarray) -> list[str]:
    from globule.render.display import displayed

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
    with open("a.xyz", "w") as file:
        file.write("4\n\n" + "".join(f"{w} {x} {y} {z}\n" for w, (x, y, z) in zip("BACA", X, strict=True)))
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
    from PIL import Image

    image = np.asarray(Image.open("a.png"))
    assert np.array_equal(image, frame.image)
    shown = {bytes(pixel).hex() for pixel in image.reshape(-1, 3)}
    assert {*OKABE_ITO} <= shown
    legend = np.asarray(Image.open("legend.png"))[:, 240:]
    found = {bytes(pixel).hex() for pixel in legend.reshape(-1, 3)}
    assert {*OKABE_ITO} <= found
