"""`globule figure` and `gb.imshow`: panels, words that stay text, one range, what the file says of itself."""

import json
import re
import sys
import xml.etree.ElementTree as ET
from pathlib import Path

import globule as gb
import numpy as np
import pytest
from cli_helpers import cube, output_of, refused, run_json
from globule.cli import main
from globule.formats.vtk_collections import write_pvd
from globule.render.paper import Sheet, letter
from PIL import Image

matplotlib = pytest.importorskip("matplotlib")
pytest.importorskip("matplotlib.figure")
SVG = "{http://www.w3.org/2000/svg}"
SMALL = ["--dpi", "72", "--device", "cpu"]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """run.pvd of five frames at 0, 0.5 … 2 s, whose speed grows from frame to frame."""
    path = tmp_path_factory.mktemp("paper")
    names = [str(path / f"frame_{k}.vtp") for k in range(5)]
    for k, name in enumerate(names):
        made = cube(6, attributes={"speed": np.linspace(0, 1 + k, 216), "type": np.arange(216) % (k + 1)})
        made.positions[:, 0] += 0.2 * k
        gb.write(name, made)
    write_pvd(path / "run.pvd", names, [0.5 * k for k in range(5)])
    return path


@pytest.fixture
def run(folder, tmp_path, monkeypatch):
    """The folder to write to, as the current one; the sequence is ../run.pvd's path."""
    monkeypatch.chdir(tmp_path)
    return str(folder / "run.pvd")


def texts(path) -> list[str]:
    return ["".join(one.itertext()).strip() for one in ET.parse(path).iter(f"{SVG}text")]


def pictures(path) -> int:
    return len([*ET.parse(path).iter(f"{SVG}image")])


def test_panels_over_time_with_one_legend(run, capsys):
    facts = run_json(capsys, "figure", run, "-o", "a.svg", "--color-by", "speed", "--legend-unit", "m/s",
                     "--unit", "m", *SMALL)  # fmt: skip
    assert [one["number"] for one in facts["frames"]] == [0, 2, 4]
    assert [one["time"] for one in facts["frames"]] == [0, 1, 2]
    assert facts["legend"] == {"colormap": "viridis", "range": [0, 5], "label": "speed, m/s"}
    assert facts["size_mm"][0] == pytest.approx(89, abs=0.4)
    assert len({json.dumps(one["camera"]) for one in facts["frames"]}) == 1
    assert facts["frames"][0]["camera"]["height"] > 0  # a scale that is true everywhere
    words = texts("a.svg")
    assert {"(a) t = 0 s", "(b) t = 1 s", "(c) t = 2 s", "speed, m/s", "0", "5"} <= {*words}
    (length,) = facts["scale_bars"]
    assert words.count(f"{length:g} m") == 1
    assert pictures("a.svg") == 3 + 1  # the panels, and the bar of the legend


def test_more_panels_than_frames_are_said(run, capsys):
    assert main(["figure", run, "-o", "a.png", "--panels", "90", *SMALL]) == 0
    assert "note: --panels 90, of 5 frames: a panel for each" in capsys.readouterr().err


def test_each_choice_of_frames(run, capsys):
    for words, numbers in (
        (["--panels", "2"], [0, 4]),
        (["--panels", "90"], [0, 1, 2, 3, 4]),
        (["--frames", "3,-1,0"], [3, 4, 0]),
        (["--times", "0.6,2"], [1, 4]),
        (["--times", "12,18", "--time", "10,2"], [1, 4]),
    ):
        facts = run_json(capsys, "figure", run, "-o", "a.png", *words, *SMALL)
        assert [one["number"] for one in facts["frames"]] == numbers, words
        assert len(facts["panels"]) == len(numbers)
    assert [one["words"] for one in facts["panels"]] == ["t = 12 s", "t = 18 s"]


def test_panels_have_the_shape_of_their_content(run, capsys):
    found = {}
    for name, sides in (("wide", (2.5, 1, 0.5)), ("high", (1, 1.6, 0.5)), ("thin", (1, 90, 1))):
        places = np.stack(np.meshgrid(*[np.linspace(0, side, 12) for side in sides]), -1).reshape(-1, 3)
        gb.write(f"{name}.npz", gb.Particles(places, support=0.1))
        facts = run_json(capsys, "figure", f"{name}.npz", "-o", "a.png", "--views", "front", *SMALL)
        width, height = facts["panel_size"]
        found[name] = width / height
    assert 2 < found["wide"] < 2.5  # the surface reaches around the particles
    assert 0.625 < found["high"] < 0.8
    assert found["thin"] == pytest.approx(0.5, rel=0.01)
    for words, shape in ((["--aspect", "3:1"], 3), (["--eye", "1,2,9"], 4 / 3)):
        width, height = run_json(capsys, "figure", "wide.npz", "-o", "a.png", *words, *SMALL)["panel_size"]
        assert width / height == pytest.approx(shape, rel=0.02), words


def test_views_are_rows_and_share_a_scale(run, capsys):
    facts = run_json(capsys, "figure", run, "-o", "a.svg", "--views", "front,top", "--panels", "3", *SMALL)
    found = facts["panels"]
    assert [one["view"] for one in found] == ["front"] * 3 + ["top"] * 3
    assert [one["letter"] for one in found] == [*"abcdef"]
    assert len({one["corner"][1] for one in found}) == 2
    assert len(facts["scale_bars"]) == 2
    assert facts["scale_bars"][0] == facts["scale_bars"][1]
    assert "(d) top, t = 0 s" in texts("a.svg")


def test_a_pdf_has_text_fonts_and_what_made_it(run, capsys, monkeypatch):
    monkeypatch.delenv("SOURCE_DATE_EPOCH", raising=False)
    words = ["figure", run, "-o", "a.pdf", "--panels", "2", "--title", "A $1 dam_break", *SMALL]
    output_of(capsys, *words)
    pdf = Path("a.pdf").read_bytes()
    assert pdf.startswith(b"%PDF-")
    assert b"/FontFile2" in pdf  # TrueType, no outlines of letters
    assert b"/Type3" not in pdf
    assert pdf.count(b"/Subtype /Image") == 2
    said = f"globule {gb.__version__}"
    assert f"/Creator ({said})".encode() in pdf
    subject = re.search(rb"/Subject \((globule figure [^)]*)\)", pdf)[1].decode()
    assert "--panels 2" in subject
    assert f"{said}, matplotlib {matplotlib.__version__}, numpy".encode() in pdf
    assert b"CreationDate" not in pdf
    output_of(capsys, *words)
    assert Path("a.pdf").read_bytes() == pdf
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "86400")
    output_of(capsys, *words)
    assert b"/CreationDate (D:19700102000000Z)" in Path("a.pdf").read_bytes()


def test_the_same_command_makes_the_same_bytes_whatever_the_user_s_style(run, capsys):
    for name in ("a.svg", "a.png"):
        words = ["figure", run, "-o", name, "--color-by", "type", "--axes", *SMALL]
        output_of(capsys, *words)
        first = Path(name).read_bytes()
        with matplotlib.rc_context({"font.size": 30, "svg.fonttype": "path", "axes.facecolor": "red"}):
            output_of(capsys, *words)
        assert Path(name).read_bytes() == first, name
    assert Image.open("a.png").info["Description"].startswith("globule figure ")
    assert {"type", "0", "1", "2", "3", "4"} <= {*texts("a.svg")}  # the types of all panels


def test_words_that_are_too_long_are_smaller_and_all_types_are_listed(run, capsys):
    many = cube(6, attributes={"type": np.arange(216) % 30})
    gb.write("many.npz", many)
    words = ["figure", "many.npz", "-o", "a.svg", "--color-by", "type", "--legend-title", "m" * 90, *SMALL]
    facts = run_json(capsys, *words)
    sizes = {}
    for one in ET.parse("a.svg").iter(f"{SVG}text"):
        sizes["".join(one.itertext()).strip()] = float(re.search(r"font(?:-size)?: ([\d.]+)px", one.get("style"))[1])
    assert {str(k) for k in range(30)} <= {*sizes}
    assert sizes["m" * 90] < 3
    assert 30 * sizes["29"] < facts["size_mm"][1] / 25.4 * 72  # points
    assert facts["legend"]["label"] == "m" * 90


@pytest.mark.parametrize(("width", "mm"), [("single", 89), ("double", 183), ("120", 120)])
def test_widths_of_journals(run, capsys, width, mm):
    facts = run_json(capsys, "figure", run, "-o", "a.png", "--figure-width", width, "--color-by", "speed", *SMALL)
    pixels = Image.open("a.png")
    assert pixels.width == round(mm / 25.4 * 72)
    assert facts["size_mm"] == pytest.approx([v * 25.4 / 72 for v in pixels.size], abs=0.01)


def test_the_paper_is_white_and_a_sky_is_not(run, capsys):
    for more, white in (([], True), (["--color-by", "speed"], True), (["--light", "head"], True),
                        (["--background", "#204060"], False), (["--sky", "gradient"], False)):  # fmt: skip
        facts = run_json(capsys, "figure", run, "-o", "a.png", "--panels", "1", *more, *SMALL)
        image = np.asarray(Image.open("a.png").convert("RGB"))
        assert (image[1, 1] == 255).all() == white, more
        assert facts["frames"][0]["counts"]["hits"] > 100


def test_a_state_of_the_viewer(run, capsys):
    Path("view.toml").write_text('[color]\nby = "speed"\n[notes]\nbox = true\n[surface]\nthreshold = 0.7\n')
    assert main(["figure", run, "-o", "a.png", "--state", "view.toml", "--json", *SMALL]) == 0
    out, err = capsys.readouterr()
    facts = json.loads(out)
    assert facts["legend"]["label"] == "speed"
    assert facts["frames"][0]["threshold"] == 0.7
    assert "without --box" in err


def test_it_has_the_flags_of_render_but_those_of_whole_images():
    from globule.cli import figure, render
    from globule.cli.parser import Parser

    names = []
    for command in (render, figure):
        parser = Parser()
        command.add_arguments(parser)
        names.append({name for action in parser._actions for name in action.option_strings})
    assert names[0] - names[1] == {
        "--size", "--aov", "--pick", "--legend-at", "--box", "--step-number", "--frame", "--camera-path",
        "--turntable", "--fps", "--resume", "--ranks", "--memory",
    }  # fmt: skip


def test_mistakes_name_the_flag_and_write_nothing(run, capsys, folder, monkeypatch):
    for words, said in (
        (["--frames", "5"], "--frames: expected numbers of 5 frames, -5 to 4, got 5"),
        (["--frames", "1,-4"], "--frames: expected another frame for each panel, got frame 1 twice"),
        (["--times", "9"], "--times: expected 0 to 2, got 9"),
        (["--frames", "1", "--times", "1"], "not allowed with argument"),
        (["--figure-width", "3"], "--figure-width: expected single, double or 20 to 1000 (mm), got '3'"),
        (["--aspect", "20:1", "--dpi", "50"], "--figure-width: expected panels of at least 32 pixels"),
        (["--aspect", "4"], "--aspect: expected W:H such as 4:3, got '4'"),
        (["--legend"], "--legend: expected --color-by"),
        (["--color-by", "sped"], "--color-by: expected"),
        (["--views", "front", "--eye", "1,2,3"], "--views: expected no --eye"),
    ):
        assert said in refused(capsys, "figure", run, "-o", "a.pdf", *words, *SMALL), words
    assert ".pdf .svg .png" in refused(capsys, "figure", run, "-o", "a.jpg")
    assert "--time T,DT" in refused(capsys, "figure", str(folder / "frame_0.vtp"), "-o", "a.pdf", "--times", "0")
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    assert "globule[figures]" in refused(capsys, "figure", run, "-o", "a.pdf")


def test_words_that_no_font_has_are_escaped(run, capsys):
    odd = ["--title", "a\nb\x1b[0m \udcff", "--legend-title", "c\udcff", "--unit", "m\x07"]
    for name in ("a.svg", "a.pdf", "a.png"):
        run_json(capsys, "figure", run, "-o", name, "--color-by", "speed", *odd, *SMALL)
    assert {r"a\nb\x1b[0m \udcff", r"c\udcff"} < {*texts("a.svg")}
    assert any(text.endswith(r"m\x07") for text in texts("a.svg"))


def test_a_frame_that_lacks_the_values_is_named(run, capsys, tmp_path):
    gb.write("plain.vtp", cube(3))
    gb.write("speed.vtp", cube(3, attributes={"speed": np.ones(27)}))
    write_pvd("mixed.pvd", ["speed.vtp", "plain.vtp"], [0, 1])
    said = refused(capsys, "figure", "mixed.pvd", "-o", "a.pdf", "--color-by", "speed", *SMALL)
    assert "--color-by: expected one of x, y, z of frame 1 of mixed.pvd, got speed" in said
    assert not Path("a.pdf").exists()


def test_letters_go_on_and_panels_fill_rows():
    assert [letter(i) for i in (0, 25, 26, 27, 52)] == ["a", "z", "aa", "ab", "ba"]
    sheet = Sheet(7, width=183, dpi=300)
    assert (sheet.per_row, sheet.rows) == (4, 2)
    assert sheet.corner(4)[0] == 0
    assert max(sheet.corner(3)[0], 0) + sheet.size[0] <= sheet.whole[0]
    with pytest.raises(ValueError, match="at least 32 pixels"):
        Sheet(100, width=20, dpi=50, per_row=50)


# gb.imshow


@pytest.fixture
def ax():
    return matplotlib.figure.Figure((4, 3), dpi=50).add_subplot()


def test_axes_have_world_units_along_an_axis(ax):
    scene = gb.Scene(cube(attributes={"speed": np.arange(216.0)}), device="cpu")
    camera = gb.Camera((0.4, 0.4, 9), (0.4, 0.4, 0), height=3.0)
    frame = gb.render(scene, camera, (80, 60), color_by="speed", range=(0, 100))
    shown = gb.imshow(ax, frame, unit="m", scale_bar=True, directions=True)
    assert shown.get_extent() == pytest.approx((-1.6, 2.4, -1.1, 1.9))
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("x, m", "y, m")
    assert np.array_equal(shown.get_array(), frame.image)
    assert {one.get_text() for one in ax.texts} >= {"1 m", "x", "y", "z"}
    bar = ax.figure.colorbar(shown)
    assert (bar.vmin, bar.vmax) == (0, 100)
    assert shown.get_cmap().name == "viridis"
    middle = camera.project([[0.4, 0.4, 0.0]], (80, 60))[0]
    assert middle == pytest.approx((40, 30))


def test_axes_from_behind_and_aslant(ax):
    particles = cube()
    behind = gb.Camera((0.4, 0.4, -9), (0.4, 0.4, 0), height=3.0)
    extent = gb.imshow(ax, gb.render(particles, behind, (60, 60))).get_extent()
    assert extent == pytest.approx((1.9, -1.1, -1.1, 1.9))  # x runs to the left
    aslant = gb.Camera((5, 4, 6), (0, 0, 0), height=3.0)
    extent = gb.imshow(ax, gb.render(particles, aslant, (80, 60))).get_extent()
    assert extent == pytest.approx((-2, 2, -1.5, 1.5))
    assert ax.get_xlabel() == ""


def test_a_perspective_image_has_no_scale_on_its_axes(ax):
    shown = gb.imshow(ax, gb.render(cube(), (80, 60)))
    assert not ax.axison
    assert shown.get_extent() == pytest.approx((-0.5, 79.5, 59.5, -0.5))


def test_imshow_says_what_it_takes(ax, monkeypatch):
    frame = gb.render(cube(), (16, 12))
    for call, said in ((lambda: gb.imshow(ax, frame.image), "frame: expected a Frame, got ndarray"),
                       (lambda: gb.imshow(None, frame), "ax: expected axes of matplotlib, got NoneType")):  # fmt: skip
        with pytest.raises(TypeError, match=said):
            call()
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    with pytest.raises(gb.MissingPackageError, match=r"globule\[figures\]"):
        gb.imshow(ax, frame)
