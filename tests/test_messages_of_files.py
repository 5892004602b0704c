"""What messages call files, columns, numbers and elements."""

import gzip
import zipfile

import globule as gb
import numpy as np
import pytest
from cli_helpers import run_json
from globule.cli import main
from globule.data.radii import find_radii
from PIL import Image

pytestmark = pytest.mark.usefixtures("folder")
X = np.stack(np.mgrid[:4, :4, :4], -1).reshape(-1, 3) * 0.1


def rows(mark: str = " ", before: str = "") -> str:
    return "".join(before + mark.join(f"{v:.4f}" for v in place) + "\n" for place in X)


def text(name: str, content: str) -> str:
    with open(name, "w", encoding="utf-8") as file:
        file.write(content)
    return name


CAMERA = gb.Camera((0.15, 0.15, 3), (0.15, 0.15, 0))
DUMP = "ITEM: TIMESTEP\n0\nITEM: NUMBER OF ATOMS\n64\nITEM: BOX BOUNDS ff ff ff\n0 9\n0 9\n0 9\nITEM: ATOMS x y z\n"


@pytest.mark.parametrize(
    ("name", "content", "called"),
    [
        ("a.csv", f"x;y;z\n{rows(';')}", "table"),
        ("a.txt", f"x\ty\tz\n{rows(chr(9))}", "table"),
        ("a.xyz", rows(), "table, blank-separated"),
        ("a.txt", DUMP + rows(), "LAMMPS dump"),
        ("a.dat", f"64\nProperties=species:S:1:pos:R:3\n{rows(before='Ar ')}", "extended XYZ"),
    ],
)
def test_a_file_is_called_by_its_content(name, content, called, capsys):
    assert run_json(capsys, "info", text(name, content))["format"] == called


def test_columns_are_named_as_in_the_file_and_all_listed():
    names = [f"column_{k}" for k in range(12)]
    head = ",".join(["X [mm]", "Y [mm]", "Z [mm]", *names])
    text("a.csv", f"{head}\n" + "".join(f"{row}{',1' * 12}\n" for row in rows(",").splitlines()))
    for unit in ("", " [mm]"):
        found = gb.read("a.csv", columns={"x": f"X{unit}", "y": f"Y{unit}", "z": "Z", "a": "column_3"})
        np.testing.assert_allclose(found.positions, X, atol=1e-6)
        assert [*found.attributes] == ["a"]
    with pytest.raises(ValueError, match=r"the column 'Q', got 'X, Y, Z, .*column_10, column_11'"):
        gb.read("a.csv", columns={"x": "X", "y": "Q"})


@pytest.mark.parametrize(
    ("row", "word"),
    [("1500,25;2,5;1.500,25", "1.500,25"), ("1,500.25;2.5;3.5", "1,500.25"), ("1.000.000,5;2,5;3,5", "1.000.000,5")],
)
def test_thousands_are_quoted_as_they_stand(row, word):
    text("a.csv", f"x;y;z\n0{word[-3 if word[-3] in ',.' else -2]}5;1;1\n{row}\n")
    with pytest.raises(ValueError, match=f"line 3: .*separators of thousands, got '{word}'"):
        gb.read("a.csv")
    text("b.csv", 'x,y,z\n1,2,3\n"1,500.25",2,3\n')
    with pytest.raises(ValueError, match=r"line 3: .*got '1,500.25'"):
        gb.read("b.csv")


def test_few_words_that_are_no_elements_are_said():
    words = ["Qq", *["O"] * 32, *["C"] * 31]
    text("a.xyz", "64\n\n" + "".join(f"{w} {row}\n" for w, row in zip(words, rows().splitlines(), strict=True)))
    with pytest.warns(UserWarning, match="'Qq': no such element; it has the mean radius of the others"):
        found = gb.read("a.xyz")
    radii = find_radii(found)
    assert radii[0] == pytest.approx(radii[1:].mean(), rel=1e-6)
    assert found.attributes["atomic_number"][:2].tolist() == [0, 8]
    text("b.xyz", "64\n\n" + "".join(f"{'AB'[i % 2]} {row}\n" for i, row in enumerate(rows().splitlines())))
    found = gb.read("b.xyz")
    assert found.names == {"type": {1: "A", 2: "B"}}
    assert find_radii(found) is None


def test_no_crop_is_advised_that_would_take_most_away(capsys):
    few = np.r_[np.random.default_rng(0).random((5, 3)), [[1000, 0, 0]]]
    gb.write("a.npz", gb.Particles(few))
    assert main(["render", "a.npz", "-o", "a.png", "--size", "64x48"]) == 0
    said = capsys.readouterr().err
    assert "smaller than a pixel" in said
    assert "--crop" not in said


def test_a_legend_in_a_corner_covers_no_other_words():
    """Nothing of it is drawn where the time, the axes or the scale bar are."""
    p = gb.Particles(X, attributes={"type": np.arange(64) % 12})
    words = {"time": 1.5, "step": 10, "axes": True, "scale_bar": True}
    for place in ("upper-left", "upper-right", "lower-left", "lower-right"):
        images = []
        for legend, more in ((False, {}), (place, {}), (place, words)):
            notes = gb.Annotation(title="A title", legend=legend, **more)
            gb.render(p, CAMERA, (320, 240), color_by="type", annotate=notes).save("a.png")
            images.append(np.asarray(Image.open("a.png").convert("RGB")).astype(int))
        plain, legend, both = images
        assert (np.abs(both - legend).max(2) > 0).any()
        assert not ((np.abs(both - legend).max(2) > 0) & (np.abs(legend - plain).max(2) > 0)).any(), place


@pytest.mark.parametrize(
    ("name", "content", "advice"),
    [
        ("positions", b"FoamFile\n{\n  version 2.0;\n}\n", "OpenFOAM's own: foamToVTK writes .vtk"),
        ("a.in", b"#==\n# by ASE\n\nlattice_vector 9 0 0\natom 1 2 3 H\natom 1 2 4 H\n", "FHI-aims' own: ASE writes"),
        ("a.msh", b"$MeshFormat\n4.1 0 8\n$EndMeshFormat\n", "Gmsh's own"),
        ("a.inp", b"** made by CAE\n*HEADING\n*Node\n1, 0., 0., 0.\n2, 1., 0., 0.\n", "Abaqus' own: meshio convert"),
        ("a.json", b'[{"x": 1, "y": 2, "z": 3},\n{"x": 1, "y": 2, "z": 3}]', "JSON: read it with its own library"),
        ("a.json", b'{"1": {\n "numbers": [8, 1, 1],\n "positions": [1, 2]}}', "JSON: read it with its own library"),
        ("a.ptx", b"2\n1\n" + 4 * b"0 0 1\n" + 4 * b"0 0 0 1\n" + 2 * b"1 2 3 0.5\n", "a scan of Leica"),
        ("a.xsf", b"CRYSTAL\nPRIMVEC\n1 0 0\n", r"no known format; .* pass gb\.Particles"),
        (
            "a.dump",
            b"ITEM: TIMESTEP\n0\nITEM: NUMBER OF ENTRIES\n2\nITEM: ENTRIES index c_1[1]\n1 2\n2 3\n",
            "expected ITEM: NUMBER OF ATOMS, got none: only dumps of atoms",
        ),
        ("a.htg", b'<VTKFile type="HyperTreeGrid"></VTKFile>', "another VTK XML: ParaView saves"),
    ],
)
def test_formats_that_are_not_read_say_what_helps(name, content, advice):
    with open(name, "wb") as file:
        file.write(content)
    with pytest.raises(ValueError, match=advice):
        gb.read(name)
    with open("packed.gz", "wb") as file:
        file.write(gzip.compress(content))
    if not content.startswith(b"ITEM"):
        with pytest.raises(ValueError, match=advice):
            gb.read("packed.gz")
    with zipfile.ZipFile("a.usdz", "w") as package:
        package.writestr("scene.usdc", b"PXR-USDC")
    with pytest.raises(ValueError, match="a package of USD: unzip it"):
        gb.read("a.usdz")
    with zipfile.ZipFile("a.xlsx", "w") as book:
        book.writestr("xl/workbook.xml", "<workbook/>")
    with pytest.raises(ValueError, match="an Excel workbook"):
        gb.read("a.xlsx")


def test_a_folder_of_neither_asks_for_a_file(folder):
    (folder / "case" / "system").mkdir(parents=True)
    with pytest.raises(gb.FormatError, match="got neither; name a file in it, or a pattern of files"):
        gb.read("case")


def test_arrays_of_other_names_are_to_be_named():
    np.savez("a.npz", centers=X, radii=np.full(64, 0.01))
    with pytest.raises(gb.FormatError, match=r"got 'centers, radii'; name them: --columns positions=…,radius=…"):
        gb.read("a.npz")
    assert find_radii(gb.read("a.npz", columns={"positions": "centers", "radius": "radii"}))[0] == np.float32(0.01)
    np.savez("b.npz")
    with pytest.raises(gb.FormatError, match="got no array of numbers; load it and pass"):
        gb.read("b.npz")
    h5py = pytest.importorskip("h5py")
    with h5py.File("a.h5", "w") as file:
        file["positions"] = np.zeros((64, 5))
    with pytest.raises(gb.FormatError, match=r"expected shape \(N, 3\), got \(64, 5\); read it with h5py and pass"):
        gb.read("a.h5")


@pytest.mark.parametrize("files", [["one.csv"], ["one.csv", "two.csv"]])
def test_names_of_images_and_movies_are_said(folder, capsys, files):
    for name in files:
        (folder / name).write_text("x,y,z\n0,0,0\n1,0,0\n")
    assert main(["render", *files, "-o", "m.gif"]) == 2
    expected = "-o: expected a name ending in .png (images) or .mp4 (a movie), or a folder that exists, got m.gif"
    assert expected in capsys.readouterr().err


@pytest.mark.parametrize("ending", ["vtp", "npz"])
def test_columns_of_words_are_said(capsys, ending):
    text("a.csv", "x,y,z,phase,id\n" + "".join(f"{row},oil,7\n" for row in rows(",").splitlines()))
    assert main(["convert", "a.csv", f"b.{ending}"]) == 0
    assert "phase is dropped: a column of words\n" in capsys.readouterr().err
    for words in (["--color-by", "phase"], ["--where", "phase == 'oil'"]):
        assert main(["render", "a.csv", "-o", "a.png", *words]) == 2
        assert "got phase, a column of words: write numbers in their place" in capsys.readouterr().err
    assert main(["convert", f"b.{ending}", "c.csv"]) == 0
    assert "phase" not in capsys.readouterr().err


@pytest.mark.parametrize("kind", ["string", "large_string", "dictionary"])
def test_columns_of_words_of_parquet_are_said(kind):
    pyarrow = pytest.importorskip("pyarrow")
    words = pyarrow.array(["oil"] * 64)
    words = words.dictionary_encode() if kind == "dictionary" else words.cast(getattr(pyarrow, kind)())
    table = pyarrow.table({axis: X[:, k] for k, axis in enumerate("xyz")} | {"phase": words})
    pytest.importorskip("pyarrow.parquet").write_table(table, "a.parquet")
    with pytest.raises(ValueError, match="got phase, a column of words: write numbers in their place"):
        gb.read("a.parquet", where="phase == 'oil'")


@pytest.mark.parametrize("columns", ["x=x,radius=id", "radius=id", "z=z,y=y"])
def test_places_are_to_be_among_the_named_columns(capsys, columns):
    text("a.csv", "x,y,z,id\n" + "".join(f"{row},7\n" for row in rows(",").splitlines()))
    assert main(["info", "a.csv", "--columns", columns]) == 2
    given = ", ".join(one.partition("=")[0] for one in columns.split(","))
    expected = f"a column for x and for y among those named, got '{given}'; its columns are 'x, y, z, id'"
    assert expected in capsys.readouterr().err
