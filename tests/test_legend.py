"""The color bar in a picture, and the color maps behind it."""

from __future__ import annotations

import globule as gb
import numpy as np
import pytest
from globule._base.colormaps import CATEGORICAL, NAMES, colorize, map_colors, to_linear
from globule.cli import main
from globule.render.legend import add_legend, tick_labels
from PIL import Image


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


@pytest.mark.parametrize(
    ("lo", "hi", "texts"),
    [
        (0, 1, ["0", "0.2", "0.4", "0.6", "0.8", "1"]),
        (-1.234567, 8.9, ["-1.23", "0", "2", "4", "6", "8.9"]),
        (1, 0, ["1", "0.8", "0.6", "0.4", "0.2", "0"]),
        (5, 5, ["5"]),
        (101325.2, 101327.9, ["101325.2", "101325.5", "101326", "101326.5", "101327", "101327.5", "101327.9"]),
    ],
)
def test_ticks(lo, hi, texts):
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


@pytest.mark.parametrize(
    ("arguments", "what"),
    [
        ((gray(63, 100), "viridis", 0, 1), "image: expected at least 64 pixels a side"),
        ((gray(100, 100)[..., :1], "viridis", 0, 1), "image: expected"),
        ((gray(100, 100) / 255, "viridis", 0, 1), "image: expected .*uint8"),
        ((gray(100, 100), "jet", 0, 1), "colormap: expected one of"),
        ((gray(100, 100), "viridis", np.nan, 1), "range: expected two finite"),
    ],
)
def test_wrong_arguments(arguments, what):
    with pytest.raises(ValueError, match=what):
        add_legend(*arguments)


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


def test_command(folder):
    points = np.stack(np.mgrid[0:5, 0:5, 0:5], axis=-1).reshape(-1, 3)
    gb.write("a.npz", gb.Particles(points, attributes={"speed": np.arange(125.0)}))
    words = ["render", "a.npz", "--size", "160x120", "--device", "cpu"]
    color = ["--color-by", "speed", "--colormap", "turbo"]
    assert main([*words, *color, "-o", "plain.png"]) == 0
    assert main([*words, *color, "--legend", "-o", "legend.png"]) == 0
    plain, legend = (np.asarray(Image.open(f"{name}.png")) for name in ("plain", "legend"))
    assert np.array_equal(legend, add_legend(plain, "turbo", 0, 124, "speed"))
