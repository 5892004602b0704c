"""Small connected components are left out, and how many is said."""

import globule as gb
import numpy as np
import pytest
from cli_helpers import SMALL, refuses, run_json
from globule.cli import main
from globule.data.components import component_sizes, without_small_components

pytestmark = pytest.mark.usefixtures("folder")


def block(*shape: int) -> np.ndarray:
    return np.stack(np.mgrid[tuple(map(slice, shape))], -1).reshape(-1, 3).astype(float)


BODY, CRUMB, SPECK = block(8, 8, 8), block(2, 2, 1) + (20, 0, 0), block(1, 1, 1) + (0, 20, 0)
ALL = np.r_[BODY, CRUMB, SPECK]


@pytest.mark.parametrize("scale", [1e-9, 1.0, 1e9])
def test_sizes(scale):
    sizes = component_sizes(gb.Particles(scale * ALL))
    assert np.array_equal(sizes, [512] * 512 + [4] * 4 + [1])
    flat = np.r_[block(9, 9, 1), block(3, 1, 1) + (30, 0, 0)]
    assert np.array_equal(component_sizes(gb.Particles(scale * flat)), [81] * 81 + [3] * 3)
    line = np.r_[block(20, 1, 1), block(2, 1, 1) + (30, 0, 0)]
    assert np.array_equal(component_sizes(gb.Particles(scale * line)), [20] * 20 + [2] * 2)


def test_sizes_of_disorder_and_of_what_has_no_place():
    jitter = np.random.default_rng(0).uniform(-0.3, 0.3, ALL.shape)
    assert np.array_equal(component_sizes(gb.Particles(ALL + jitter))[:512], [512] * 512)
    holes = np.r_[[[np.nan] * 3], ALL, [[1e30, 0, 0]]]
    sizes = component_sizes(gb.Particles(holes))
    assert (sizes[0], sizes[-1], sizes[1]) == (0, 0, 512)
    assert component_sizes(gb.Particles(np.empty((0, 3)))).tolist() == []
    assert component_sizes(gb.Particles([[1, 2, 3]])).tolist() == [1]
    assert component_sizes(gb.Particles([[1, 2, 3]] * 5)).tolist() == [5] * 5


def test_small_ones_are_left_out():
    particles = gb.Particles(ALL, attributes={"id": np.arange(len(ALL))})
    kept, said = without_small_components(particles, 2)
    assert kept.attributes["id"].tolist() == list(range(516))
    assert said == "1 component of fewer than 2 particles left out: 1 of 517 particles"
    kept, said = without_small_components(particles, 5)
    assert len(kept) == 512
    assert said == "2 components of fewer than 5 particles left out: 5 of 517 particles"
    assert without_small_components(kept, 512) == (kept, "")
    refuses("min_component: expected", without_small_components, particles, 0)


def test_files_and_commands(capsys):
    gb.write("a.npz", gb.Particles(ALL))
    with pytest.warns(UserWarning, match=r"a\.npz: 2 components .* left out: 5 of 517"):
        assert len(gb.read("a.npz", min_component=5)) == 512
    with pytest.warns(UserWarning, match="69 of 389"):
        assert len(gb.read("a.npz", where="x < 5 or x > 6", min_component=100)) == 5 * 64
    words = ["--min-component", "5"]
    assert run_json(capsys, "render", "a.npz", "-o", "a.png", *SMALL, *words)["counts"][
        "particles"] == 512  # fmt: skip
    assert main(["track", "a.npz", *words, "-o", "a.csv"]) == 0
    said = "globule: warning: a.npz: 2 components of fewer than 5 particles left out"
    assert said in capsys.readouterr().err
    row = np.genfromtxt("a.csv", delimiter=",", names=True)
    assert row["volume"] == pytest.approx(512, rel=0.05)  # of a block with sharp edges
    assert row["x_max"] < 8 > row["y_max"]
    assert main(["convert", "a.npz", "b.npz", *words]) == 0
    assert len(gb.read("b.npz")) == 512
    capsys.readouterr()
    assert main(["render", "a.npz", "-o", "c.png", "--min-component", "1000"]) == 2
    error = capsys.readouterr().err.splitlines()[-1]
    assert error.endswith("--min-component: expected a component of so many particles, got 1000")
