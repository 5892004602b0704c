"""The thesis's figures: each is drawn, and what it shows is so."""

import importlib.util
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from bench.__main__ import main
from bench.figures import FIGURES, caption

needs_matplotlib = pytest.mark.skipif(
    importlib.util.find_spec("matplotlib") is None, reason="matplotlib is not installed (the extra `figures`)"
)


DPI = 24
QUICK = {"3.4", "5.1", "6.1"}  # an octree, a plot, an image


@needs_matplotlib
@pytest.mark.parametrize("name", [pytest.param(n, marks=[pytest.mark.slow] if n not in QUICK else []) for n in FIGURES])
def test_figure(name, tmp_path):
    path = tmp_path / "figure.png"
    FIGURES[name](path, "cpu", DPI)
    picture = np.asarray(Image.open(path).convert("RGB"), np.float32)
    height, width = picture.shape[:2]
    assert 4.25 * DPI <= width <= 10 * DPI
    assert 2.75 * DPI <= height <= 7.5 * DPI
    assert picture.std() > 4
    assert (picture.min(axis=(0, 1)) < 120).all()
    ink = (picture < 200).any(axis=2)
    assert ink.mean() > 0.01
    words = caption(name)
    assert words.endswith(".")
    assert "\n" not in words
    assert "  " not in words


@needs_matplotlib
def test_the_command(folder, capsys):
    words = ["figures", "3.4", "2.4", "-o", "a/b", "--dpi", "20", "--device", "cpu"]
    assert main(words) == 0
    assert capsys.readouterr().out.startswith("a/b: 2 figures")
    assert sorted(p.name for p in (folder / "a/b").iterdir()) == ["2.4.png", "3.4.png"]
    assert main(["figures", "--list"]) == 0
    assert capsys.readouterr().out.count("\n") == len(FIGURES)


def test_mistakes(folder, monkeypatch, capsys):
    (folder / "file").write_text("")
    assert main(["figures", "9.9"]) == 2
    err = capsys.readouterr().err
    assert "9.9" in err
    assert "2.1" in err
    assert err.count("\n") == 1
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    assert main(["figures", "2.1"]) == 2
    assert "globule[figures]" in capsys.readouterr().err
    assert [p.name for p in folder.iterdir()] == ["file"]


def test_the_gallery_is_complete():
    docs = Path(__file__).resolve().parents[1] / "docs"
    page = (docs / "understand/figures.md").read_text(encoding="utf-8")
    for name in FIGURES:
        assert caption(name) in page.replace("\n", " ")
        assert f"(../images/figures/{name}.png)" in page
        assert (docs / "images/figures" / f"{name}.png").stat().st_size < 150_000


# What the figures state.


def test_without_nilearn_shapes_stand_in(monkeypatch):
    from bench.figures import anatomy

    monkeypatch.setitem(sys.modules, "nilearn.datasets", None)
    values, world_from_voxel, name = anatomy.tomography(6)
    assert "phantom" in name
    assert {0.12, 0.62, 0.95} <= set(np.unique(values))
    particles = anatomy.metaballs(values, world_from_voxel)
    assert particles.support == pytest.approx(12)
    assert 3000 < len(particles) < 9000
    assert np.abs(np.mean(particles.bounds(), axis=0)).max() < 10
    vertices, faces, depth, name = anatomy.surface_mesh()
    assert "knot" in name
    assert len(vertices) == len(depth)
    assert faces.max() < len(vertices)
    edges = np.linalg.norm(vertices[faces] - np.roll(vertices[faces], 1, axis=1), axis=2)
    assert edges.max() < 6  # closed: no face spans the tube
