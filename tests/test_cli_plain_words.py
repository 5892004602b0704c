"""Mistakes are answered with what is wrong; annotations stay in the image."""

from __future__ import annotations

from pathlib import Path

import globule as gb
import numpy as np
import pytest
from cli_helpers import SMALL, cube, refused, run_json
from globule.cli import main
from globule.render.annotate import Annotation, draw_sheet
from globule.render.canvas import Canvas

pytestmark = pytest.mark.usefixtures("folder")


def test_sizes_that_float32_cannot_square_are_refused(capsys):
    lattice = np.stack(np.mgrid[:8, :8, :8], -1).reshape(-1, 3)
    for size, expected in ((1e-30, "1e-18 to 1e18 apart"), (1e30, "coordinates up to 1e+18")):
        gb.write("a.npz", gb.Particles(lattice * size))
        said = refused(capsys, "render", "a.npz", "-o", "a.png", "--device", "cpu")
        assert expected in said
        assert "scale the positions" in said


def test_a_cut_off_stl_is_named(capsys):
    trimesh = pytest.importorskip("trimesh")
    trimesh.creation.box().export("box.stl")
    whole = Path("box.stl").read_bytes()
    Path("box.stl").write_bytes(whole[:300])
    said = refused(capsys, "render", "box.stl", "-o", "a.png", "--device", "cpu")
    assert "expected 684 bytes for the 12 triangles of its header, got 300" in said


def test_a_label_stays_inside_of_the_image():
    blank = np.full((100, 120, 3), 255, np.uint8)
    drawn = {}
    for place in ((40.0, 50.0), (-30.0, 50.0), (200.0, 50.0), (60.0, -20.0), (60.0, 300.0)):
        canvas = Canvas(blank)
        canvas.text(place, "y, m", "mm", inks=((0, 0, 0), (255, 255, 255)), inside=True)
        drawn[place] = int((canvas.pixels < 128).sum())
    assert len(set(drawn.values())) == 1, drawn
    assert drawn[40.0, 50.0] > 20


def test_a_title_is_in_the_middle_of_image_and_legend():
    blank = np.full((200, 300, 3), 255, np.uint8)
    for strip in (0, 60):
        image = draw_sheet(blank, Annotation(title="Title"), None, strip)
        columns = np.flatnonzero((image < 128).any(axis=(0, 2)))
        assert (columns[0] + columns[-1]) / 2 == pytest.approx((300 + strip) / 2, abs=3)


def test_flags_that_would_be_ignored_are_refused(capsys):
    gb.write("a.npz", gb.Particles(np.random.default_rng(0).random((200, 3))))
    Path("m.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    for words in (["--preset", "water", "--flat"], ["--flat", "--preset", "water"]):
        said = refused(capsys, "render", "a.npz", "-o", "a.png", *words)
        assert "expected one look" in said
        assert "water" in said
    assert main(["render", "a.npz", "-o", "a.png", *SMALL, "--flat", "--preset", "flat"]) == 0
    capsys.readouterr()
    said = refused(capsys, "render", "m.obj", "-o", "a.png", *SMALL, "--surface", "smooth")
    assert "--surface: expected particles" in said


@pytest.mark.parametrize("n", [1, 3, 64])
def test_the_threads_said_are_those_asked_for(n, capsys):
    gb.write("a.npz", gb.Particles(np.random.default_rng(0).random((200, 3))))
    assert main(["render", "a.npz", "-o", "a.png", *SMALL, "--threads", str(n)]) == 0
    assert f" {n} thread{'s' * (n > 1)}," in capsys.readouterr().out


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
