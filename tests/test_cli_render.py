"""`globule render`: pictures of one file and of several, mistakes, particles that make trouble."""

import json
import os
import stat
from pathlib import Path

import globule as gb
import numpy as np
import pytest
from cli_helpers import SMALL, cube, output_of, refused, refuses, run_json
from globule._base.colormaps import CATEGORICAL, NAMES, colorize
from globule.cli import main
from PIL import Image

pytestmark = pytest.mark.usefixtures("folder")


def test_render_json(particles, capsys):
    facts = run_json(capsys, "render", particles, "-o", "a.png", "--aov", "a.npz", *SMALL)
    scene = gb.Scene(gb.read(particles), device="cpu", surface="smooth")
    hashes = {"key_hash": scene.octree.key_hash, "node_hash": scene.octree.node_hash}
    expected = {"images": ["a.png"], "aov": "a.npz", "kernel": "murakami", "threshold": 0.5, "surface": "smooth"}
    assert (expected | {"hashes": hashes}).items() <= facts.items()
    assert set(facts["times"]) == {"read", "build", "trace", "write", "total"}
    assert min(facts["times"].values()) >= 0
    assert facts["memory"]["octree"] > 0
    counts = facts["counts"]
    assert {"particles": 216, "inside": 216, "outside": 0}.items() <= counts.items()
    assert counts["leaves"] <= counts["nodes"]
    assert 0 < counts["hits"] < 40 * 30
    assert "CPU" in facts["device"]
    assert facts["support"] == pytest.approx(2.25 * facts["spacing"])
    assert facts["spacing"] == pytest.approx(1 / 6, rel=0.02)
    with np.load("a.npz") as arrays:
        assert set(arrays) == {"color", "distance", "position", "normal", "albedo", "mask"}
        assert arrays["mask"].sum() == counts["hits"]


def test_render_is_what_the_library_makes(particles):
    words = "--eye -1,2,3 --look-at 0,0,0 --up 0,0,1 --fov 30 --kernel wyvill --support 0.4 "
    words += "--threshold 0.5 --ambient 0.2 --background 0.1,0.2,0.3 --light head "
    words += "--light dir:-1,0,1 --light point:-3,3,3"
    assert main(["render", particles, "-o", "a.png", *SMALL, *words.split()]) == 0
    scene = gb.Scene(gb.read(particles), "wyvill", 0.5, 0.4, device="cpu")
    third = (1 / 3,) * 3
    settings = gb.RenderSettings(
        lights=(gb.Headlight(third), gb.DirectionalLight((-1, 0, 1), third), gb.PointLight((-3, 3, 3), third)),
        ambient=0.2,
        background=(0.1, 0.2, 0.3),
    )
    camera = gb.Camera((-1, 2, 3), (0, 0, 0), (0, 0, 1), 30)
    frame = gb.render(scene, camera, (40, 30), settings)
    assert frame.mask.any()
    assert (np.asarray(Image.open("a.png")) == frame.picture).all()


def test_orthographic_and_octree_options(particles, capsys):
    command = ["render", particles, "-o", "a.png", *SMALL]
    words = ["--ortho", "4", "--octree", "dense", "--octree-level", "4", "--threads", "1"]
    wide = run_json(capsys, *command, *words)["counts"]["hits"]
    words = ["--ortho", "2", "--key-bits", "64", "--octree-level", "18", "--surface", "balls"]
    assert run_json(capsys, *command, *words)["counts"]["hits"] > 3 * wide


def test_color_by_values_that_are_not_finite(folder, capsys):
    p = cube()
    gb.write("a.npz", gb.Particles(p.positions, attributes={"t": np.full(216, np.nan)}))
    words = ["render", "a.npz", "-o", "a.png", "--color-by", "t", *SMALL]
    error = refused(capsys, *words)  # a legend would show a range that no particle has
    assert "--color-by: expected a finite t of a.npz, got none; give a range" in error
    refuses("color_by: expected a finite t, got none; give a range", gb.color_by, gb.read("a.npz"), "t")
    assert "216 of 216 particles without a finite t" in output_of(capsys, *words, "--range", "0,2").err
    gb.write("b.npz", gb.Particles(p.positions, attributes={"t": np.arange(216.0)}))
    series = ["render", "a.npz", "b.npz", "-o", "%d.png", "--color-by", "t", *SMALL]
    assert main(series) == 0  # the range is that of b.npz
    assert gb.color_by(gb.Particles(np.zeros((0, 3)), attributes={"t": []}), "t").color.size == 0


@pytest.mark.parametrize("name", [name for name in NAMES if name not in CATEGORICAL])
def test_colormaps(name):
    ends = colorize([0.0, 1.0], name, 0, 1)
    assert ends.dtype == np.float32
    assert ((ends >= 0) & (ends <= 1)).all()
    assert (colorize([-5.0, np.inf], name, 0, 1) == ends).all()
    assert np.isfinite(colorize([3.0, np.nan], name, 3, 3)).all()
    assert np.isfinite(colorize([-1e308, 1e308], name, -1e308, 1e308)).all()
    with np.errstate(over="raise"):
        assert (colorize([-1e300, 1e300], name, 0, 1e-300) == ends).all()


@pytest.mark.parametrize(
    ("output", "names"),
    [
        ("pictures", ["pictures/a.png", "pictures/b.c.png"]),
        ("pictures/", ["pictures/a.png", "pictures/b.c.png"]),
        ("p_{}.png", ["p_a.png", "p_b.c.png"]),
        ("p%03d.png", ["p000.png", "p001.png"]),
    ],
)
def test_several_files(folder, capsys, output, names):
    (folder / "pictures").mkdir()
    gb.write("a.ply", cube())
    gb.write("b.c.bgeo.gz", cube())
    facts = run_json(capsys, "render", "a.ply", "b.c.bgeo.gz", "-o", output, *SMALL)
    assert facts["images"] == names
    assert len(facts["frames"]) == 2
    assert all(os.path.getsize(name) for name in names)
    assert facts["counts"]["particles"] == 432


def test_several_files_need_a_pattern(particles, capsys):
    gb.write("other.ply", cube())
    assert "%d" in refused(capsys, "render", particles, "other.ply", "-o", "a.png")
    gb.write("cube.ply", cube())
    assert "twice" in refused(capsys, "render", particles, "cube.ply", "-o", "a_{}.png")


def test_mistakes_of_render(particles, capsys):
    for words, part in (
        (["-o", "a"], ".png"),
        ([], "-o"),
        (["-o", "a.png", "--size", "99999x99999"], "99999x99999"),
        (["-o", "a.png", "--eye", "1,2,3", "--look-at", "1,2,3"], "--look-at"),
        (["-o", "a.png", "--look-at", "1,2,3"], "--eye"),
        (["-o", "a.png", "--fit", "--eye", "1,2,3"], "--fit"),
        (["-o", "a.png", "--fov", "180"], "--fov: expected degrees"),
        (["-o", "a.png", "--octree-level", "11"], "--octree-level: expected 0 to 10"),
        (["-o", "a.png", "--octree", "dense", "--key-bits", "64"], "--key-bits: the dense"),
        (["-o", "a.png", "--color-by", "x", "--range", "0,0"], "LO,HI apart"),
        (["-o", "a.png", "--color-by", "sped"], "speed, flow of cube.npz, got sped"),
        (["-o", "a.png", "--color-by", "flow:3"], "flow:2"),
        (["-o", "a.png", *["--light", "head"] * 9], "at most 8"),
        (["-o", "a.png", "--device", "tpu"], "tpu"),
        (["-o", "a.png", "--device", "cuda:99"], "cuda:99"),
        (["-o", "a.png", "--aov", "cube.npz"], "cube.npz"),
        (["-o", "a.png", "--no-such-option"], "--no-such-option"),
        (["-o", "a.png", "--siz", "4x4"], "--siz"),
    ):
        assert part in refused(capsys, "render", particles, *words)


def test_input_mistakes(folder, capsys):
    (folder / "folder.ply").mkdir()
    (folder / "bad.ply").write_text("ply\nnonsense\n")
    (folder / "a.xls").write_bytes(b"\xd0\xcf\x11\xe0")
    for command in (["render", "-o", "a.png"], ["info"]):
        assert "no.ply" in refused(capsys, command[0], "no.ply", *command[1:])
        assert "folder.ply" in refused(capsys, command[0], "folder.ply", *command[1:])
        assert "bad.ply" in refused(capsys, command[0], "bad.ply", *command[1:])
        assert "no known format" in refused(capsys, command[0], "a.xls", *command[1:])


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write everywhere")
def test_places_without_permission(particles, folder, capsys):
    (folder / "locked").mkdir()
    (folder / "locked" / "a.ply").write_text("")
    os.chmod(folder / "locked", 0)
    try:
        refused(capsys, "render", particles, "-o", "locked/a.png")
        refused(capsys, "info", "locked/a.ply")
    finally:
        os.chmod(folder / "locked", stat.S_IRWXU)


NONE = [np.zeros((0, 3)), np.full((3, 3), np.nan)]


@pytest.mark.parametrize("more", [[], ["--eye", "0.5,0.5,3", "--look-at", "0.5,0.5,0"],
                                  ["--turntable", "2"]])  # fmt: skip
@pytest.mark.parametrize("positions", NONE)
def test_a_file_without_particles_is_refused(positions, more, capsys):
    gb.write("none.npz", gb.Particles(positions))
    error = refused(capsys, "render", "none.npz", "-o", "a_%d.png", *SMALL, *more)
    assert "none.npz: expected particles, got none with a finite position" in error


@pytest.mark.parametrize("positions", NONE)
def test_a_frame_without_particles_shows_the_background(particles, positions, capsys):
    gb.write("none.npz", gb.Particles(positions))
    out, err = output_of(capsys, "render", "none.npz", particles, "-o", "a_%d.png", "--json", *SMALL)
    counts = json.loads(out)["frames"][0]["counts"]
    assert counts["particles"] == len(positions)
    assert counts["inside"] == counts["hits"] == 0
    note, warning = err.splitlines()
    assert note.endswith("note: surface and support are those of cube.npz, the largest of 2 files")
    assert "warning: none.npz" in warning
    picture = np.asarray(Image.open("a_0.png"))
    assert (picture == picture[0, 0]).all()
    gb.write("other.npz", gb.Particles(positions))
    error = refused(capsys, "render", "none.npz", "other.npz", "-o", "b_%d.png", *SMALL)
    assert "none.npz to other.npz: expected particles, got none" in error


@pytest.mark.parametrize("place", [0.0, 1.0])
def test_particles_at_one_place(place, capsys):
    gb.write("same.npz", gb.Particles(np.full((100, 3), place)))
    assert main(["render", "same.npz", "-o", "a.png", *SMALL]) == 0
    warning = "globule: warning: same.npz: all 100 particles lie at one place\n"
    assert capsys.readouterr().err == warning
    assert run_json(capsys, "info", "same.npz")["why_surface"] == "all at one place"


def test_particles_that_are_there_twice(capsys):
    once = cube(12)
    n = len(once)
    positions = np.concatenate([once.positions, once.positions[::-1]])
    gb.write("twice.npz", gb.Particles(positions))
    line = f"twice.npz: {n:,} of {2 * n:,} particles lie exactly where others do: are they there"
    for words in (["render", "twice.npz", "-o", "a.png", *SMALL],
                  ["mesh", "twice.npz", "-o", "a.ply"],
                  ["project", "twice.npz", "-o", "a.npz"]):  # fmt: skip
        assert line in output_of(capsys, *words).err
    gb.write("once.npz", gb.Particles(positions[: n + 10]))  # less than 1 % are
    assert output_of(capsys, "render", "once.npz", "-o", "a.png", *SMALL).err == ""
    out = output_of(capsys, "info", "once.npz").out
    assert f"particles  {n + 10:,}, 10 of them exactly where others are" in out
    assert run_json(capsys, "info", "once.npz")["coincident"] == 10


def test_a_threshold_that_nothing_reaches(particles, capsys):
    command = ["render", particles, "-o", "a.png", *SMALL]
    err = output_of(capsys, *command, "--threshold", "1000").err
    assert "threshold 1000 is above the highest field" in err
    assert output_of(capsys, *command, "--threshold", err.split("--threshold")[1].strip()).err == ""


def test_a_camera_that_looks_past(particles, capsys):
    words = ["--eye", "0,0,9", "--look-at", "0,0,99"]
    assert "looks past" in output_of(capsys, "render", particles, "-o", "a.png", *SMALL, *words).err


def test_flags_that_would_be_ignored_are_refused(capsys):
    gb.write("a.npz", cube())
    Path("m.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    for words in (["--preset", "water", "--flat"], ["--flat", "--preset", "water"]):
        said = refused(capsys, "render", "a.npz", "-o", "a.png", *words)
        assert "expected one look" in said
        assert "water" in said
    assert main(["render", "a.npz", "-o", "a.png", *SMALL, "--flat", "--preset", "flat"]) == 0
    capsys.readouterr()
    said = refused(capsys, "render", "m.obj", "-o", "a.png", *SMALL, "--surface", "smooth")
    assert "--surface: expected particles" in said


def test_particles_left_out_are_counted(capsys):
    positions = cube().positions
    gb.write("a.npz", gb.Particles(positions))
    positions[0], positions[1, 2], positions[2] = np.nan, np.inf, -np.inf
    gb.write("n.npz", gb.Particles(positions, attributes={"speed": np.arange(216.0)}))
    found = run_json(capsys, "render", "n.npz", "-o", "n.png", "--color-by", "speed", *SMALL)
    counts = found["counts"]
    assert (counts["particles"], counts["inside"], counts["outside"]) == (216, 213, 3)
    assert counts["hits"] > 0
    assert any("3 of 216 particles have no finite position" in w for w in found["warnings"])
    assert main(["render", "a.npz", "-o", "a.png", *SMALL, "--spheres", "n.npz:0.1"]) == 0
    assert "3 of 216 particles of n.npz have no finite position" in capsys.readouterr().err


def flat() -> gb.Particles:
    return gb.Particles(np.stack(np.mgrid[:12, :10], -1).reshape(-1, 2) * 0.5)


@pytest.mark.parametrize("kind", ["fluid", "balls", "flat", "ortho"])
def test_the_fitted_camera_is_given_back_by_its_flags(kind, capsys):
    particles = {"flat": flat(), "balls": cube(support=0.4)}.get(kind, cube())
    gb.write("a.npz", particles)
    more = ["--ortho", "2"] if kind == "ortho" else []
    camera = run_json(capsys, "render", "a.npz", "-o", "a.png", *SMALL, *more)["camera"]
    assert ("height" in camera) == (kind in ("flat", "ortho"))
    words = camera["flags"].split()
    assert main(["render", "a.npz", "-o", "b.png", *SMALL, *words]) == 0
    a, b = (np.asarray(Image.open(f"{name}.png")).astype(int) for name in "ab")
    assert np.abs(a - b).max() <= 2
    assert a.std() > 1


@pytest.mark.parametrize("particles", [cube(), cube(support=0.4), flat()])
def test_info_says_the_camera_of_the_image(particles, capsys):
    gb.write("a.npz", particles)
    told = run_json(capsys, "info", "a.npz")["camera"]
    used = run_json(capsys, "render", "a.npz", "-o", "a.png", "--device", "cpu")["camera"]
    assert told.keys() == used.keys()
    for name in told.keys() - {"flags"}:
        assert told[name] == pytest.approx(used[name], rel=1e-6, abs=1e-6), name
    main(["info", "a.npz"])
    assert f"camera     {told['flags']}" in capsys.readouterr().out


def test_each_view_has_its_camera(capsys):
    gb.write("a.npz", cube())
    words = ["render", "a.npz", "-o", "a.png", "--size", "300x150", "--views", "front,iso"]
    front, iso = run_json(capsys, *words)["cameras"]
    assert "height" in front
    assert "fov" in iso
