"""Files with odd but legal content, as programs write them, and what must be read from them."""

import globule as gb
import numpy as np
import pytest
from globule.formats import read_contents

TURNED = np.array([[0, 2, 0], [-3, 0, 0], [1, 0, 4]], float)  # edges of a box
CORNER = np.array([10, 20, -5.0])
SHARES = np.random.default_rng(3).random((30, 3))
PLACES = CORNER + SHARES @ TURNED


def lines(table) -> str:
    return "".join(" ".join(f"{v:.9g}" for v in row) + "\n" for row in table)


@pytest.mark.parametrize(("names", "table"), [("x y z", PLACES + TURNED[0]), ("xs ys zs", SHARES)])
def test_a_general_triclinic_box_of_a_lammps_dump(tmp_path, names, table):
    box = lines(np.column_stack([TURNED, CORNER]))
    (tmp_path / "a.dump").write_text(
        "ITEM: TIMESTEP\n0\nITEM: NUMBER OF ATOMS\n30\nITEM: BOX BOUNDS abc origin pp pp pp\n"
        f"{box}ITEM: ATOMS {names}\n{lines(table)}"
    )
    found = read_contents(tmp_path / "a.dump")
    assert np.allclose(found.box.edges, TURNED)
    assert np.allclose(found.box.origin, CORNER)
    assert np.allclose(found.particles.world_positions(), PLACES, atol=1e-5)  # wrapped


def test_a_general_triclinic_box_of_lammps_data(tmp_path):
    edges = "".join(f"{a} {b} {c} {name}\n" for (a, b, c), name in zip(TURNED, ("avec", "bvec", "cvec"), strict=True))
    atoms = "".join(f"{i} 1 {line}\n" for i, line in enumerate(lines(PLACES).splitlines(), 1))
    head = f"LAMMPS data\n\n30 atoms\n1 atom types\n\n{edges}10 20 -5 abc origin\n\nAtoms # atomic\n\n"
    (tmp_path / "a.lmp").write_text(head + atoms)
    found = read_contents(tmp_path / "a.lmp")
    assert np.allclose(found.box.edges, TURNED)
    assert np.allclose(found.box.origin, CORNER)
    assert np.allclose(found.particles.world_positions(), PLACES, atol=1e-5)


@pytest.mark.parametrize(
    "encoding", ["utf-32", "utf-32-le", "utf-32-be", "utf-16", "utf-16-le", "utf-16-be", "utf-8-sig"]
)
@pytest.mark.parametrize("name", ["a.csv", "a.txt", "a.xyz"])
def test_encodings(tmp_path, encoding, name):
    mark = "" if encoding in ("utf-32", "utf-16", "utf-8-sig") else "\ufeff"
    comma = "," if name == "a.csv" else " "
    text = (
        comma.join(["x", "y", "z", "größe"]) + "\n" + lines(np.column_stack([SHARES, SHARES[:, 0]])).replace(" ", comma)
    )
    (tmp_path / name).write_bytes((mark + text).encode(encoding))
    found = gb.read(tmp_path / name)
    assert len(found) == 30
    assert np.allclose(found.positions, SHARES, atol=1e-6)
    assert list(found.attributes) == ["größe"]
