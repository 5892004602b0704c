"""Files in another unit of length."""

import globule as gb
import numpy as np
import pytest
from cli_helpers import run_json
from globule.cli import main
from globule.formats import read_contents
from globule.formats.ranges import ranges

pytestmark = pytest.mark.usefixtures("folder")
POINTS = np.stack(np.mgrid[:6, :6, :6], -1).reshape(-1, 3) * 50.0 + (7, 0, 0)  # mm


def test_all_lengths_follow_also_far_away_and_of_boxes():
    n = len(POINTS)
    given = gb.Particles(
        POINTS, support=np.full(n, 100.0), weight=2.0, anisotropy=[0.01 * np.eye(3)] * n,
        attributes={"radius": np.full(n, 25, np.int32), "mass": np.ones(n)},
    )  # fmt: skip
    gb.write("a.npz", given)
    got = gb.read("a.npz", scale=1e-3)
    np.testing.assert_allclose(got.positions, POINTS / 1000, rtol=1e-6)
    np.testing.assert_allclose(got.support, 0.1, rtol=1e-6)
    np.testing.assert_allclose(got.anisotropy, given.anisotropy * 1000, rtol=1e-6)
    np.testing.assert_allclose(got.attributes["radius"], 0.025, rtol=1e-6)
    assert (got.attributes["mass"] == 1).all()
    assert got.weight == 2
    n, rows, _ = ranges("a.npz", scale=1e-3)
    np.testing.assert_array_equal(rows(3, 9).positions, got.positions[3:9])
    for wrong in (0, -1, np.nan, "mm"):
        with pytest.raises((ValueError, TypeError), match="scale: expected"):
            gb.read("a.npz", scale=wrong)
    far = POINTS + (5e9, 0, 0)  # mm
    np.save("a.npy", far)
    with pytest.warns(UserWarning, match="positions are given from"):
        got = gb.read("a.npy", scale=1e-3)
    np.testing.assert_allclose(got.world_positions(), far / 1000, rtol=0, atol=1e-7)
    with open("a.xyz", "w") as file:
        file.write('1\nLattice="4 0 0 0 4 0 0 0 4" Origin="1 2 -3" ')
        file.write("Properties=species:S:1:pos:R:3\nO 1 2 0\n")
    found = read_contents("a.xyz", scale=0.1)
    np.testing.assert_allclose(found.box.edges, 0.4 * np.eye(3))
    np.testing.assert_allclose(found.box.origin, [0.1, 0.2, -0.3])
    np.testing.assert_allclose(found.particles.positions, [[0.1, 0.2, 0]], rtol=1e-6)


def test_diameters_are_halved_in_ranges_and_commands_take_it(capsys):
    np.savez("a.npz", positions=POINTS, radius=np.full(len(POINTS), 0.1))  # support: 4 radii
    whole = gb.read("a.npz", scale=0.3, radius_is="diameter")
    part = ranges("a.npz", scale=0.3, radius_is="diameter").read(2, 9)
    np.testing.assert_array_equal(part.attributes["radius"], whole.attributes["radius"][2:9])
    np.testing.assert_array_equal(part.support, whole.support[2:9])
    np.testing.assert_allclose(part.support, 0.3 * 4 * 0.05, rtol=1e-6)
    gb.write("a.npz", gb.Particles(POINTS))
    (volume,) = run_json(capsys, "track", "a.npz", "--scale", "0.01")["volume"]
    (whole,) = run_json(capsys, "track", "a.npz")["volume"]
    assert volume == pytest.approx(whole * 1e-6, rel=1e-4)
    assert main(["convert", "a.npz", "b.npz", "--scale", "0.01"]) == 0
    np.testing.assert_allclose(gb.read("b.npz").positions, POINTS / 100, rtol=1e-6)
    assert main(["info", "a.npz", "--scale", "0"]) == 2
