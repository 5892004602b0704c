"""Coordinates that float32 would not keep: positions are given from an origin, files keep all."""

import warnings

import globule as gb
import numpy as np
import pytest
from cli_helpers import run_json
from globule.cli import main
from globule.data.particles import HERE, relative
from globule.render.legend import tick_labels
from PIL import Image

pytestmark = pytest.mark.usefixtures("folder")
FAR = np.array([440_750.0, 5_000_000.0, 100.0])
MACHINE = ["--device", "cpu", "--size", "96x72"]


def lattice(n: int = 9) -> np.ndarray:
    return np.stack(np.mgrid[:n, :n, :n], -1).reshape(-1, 3) / 8


def read(name: str) -> gb.Particles:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return gb.read(name)


def test_float64_far_away_gets_an_origin_and_nothing_else_does():
    near = lattice()
    for kept in (near, near + 10, (near + FAR).astype("f4"), near[:4] + FAR, np.empty((0, 3))):
        assert relative(kept)[1] == HERE
    positions, origin = relative(near + FAR)
    assert origin != HERE
    np.testing.assert_array_equal(positions + origin, near + FAR)
    assert np.abs(positions).max() < 10
    flat, origin = relative((near + FAR)[:, :2])  # 2-D
    assert flat.shape[1] == 3
    assert origin[2] == 0


@pytest.mark.parametrize("to", [".npz", ".npy", ".csv", ".ply", ".vtk", ".vtp", ".vtu", ".txt"])
def test_convert_keeps_what_float32_would_destroy(to, capsys):
    np.save("a.npy", lattice() + FAR)
    assert main(["convert", "a.npy", f"b{to}"]) == 0
    assert "a.npy: positions are given from" in capsys.readouterr().err
    got = read(f"b{to}")
    assert got.origin != HERE
    np.testing.assert_allclose(got.world_positions(), lattice() + FAR, rtol=0, atol=2e-9)


def test_a_format_of_float32_refuses_them(capsys):
    np.save("a.npy", lattice() + FAR)
    assert main(["convert", "a.npy", "b.bgeo"]) == 2
    assert "b.bgeo: positions: near 5e+06 float32 has steps of 0.5" in capsys.readouterr().err


def test_the_picture_is_that_of_the_same_particles_here(capsys):
    np.save("far.npy", lattice() + FAR)
    np.save("near.npy", lattice())
    far = run_json(capsys, "render", "far.npy", "-o", "far.png", *MACHINE)
    near = run_json(capsys, "render", "near.npy", "-o", "near.png", *MACHINE)
    assert near["origin"] == [0, 0, 0]
    assert far["counts"] == near["counts"]
    x = np.subtract(near["camera"]["eye"], far["camera"]["eye"])
    np.testing.assert_allclose(x, np.subtract(far["origin"], FAR), atol=1e-4)
    images = [np.asarray(Image.open(f"{name}.png")).astype(int) for name in ("far", "near")]
    assert np.abs(images[0] - images[1]).max() <= 3


def test_all_frames_have_one_origin(capsys):
    for k in range(3):
        np.save(f"s_{k}.npy", lattice() + FAR + (0.4 * k, 0, 0))
    assert main(["track", "s_0.npy", "s_1.npy", "s_2.npy", "-o", "t.csv"]) == 0
    rows = np.genfromtxt("t.csv", delimiter=",", names=True, dtype=None, encoding=None)
    np.testing.assert_allclose(np.diff(rows["x_min"]), 0.4, atol=2e-3)
    np.testing.assert_allclose(rows["volume"], rows["volume"][0], rtol=1e-4)
    assert main(["render", "s_*.npy", "-o", "s_%d.png", *MACHINE]) == 0
    images = [np.asarray(Image.open(f"s_{k}.png")).astype(int) for k in range(3)]
    assert np.abs(images[0] - images[2]).max() > 50  # it moves
    capsys.readouterr()
    words = ["track", "s_0.npy", "--json", "--origin", "440750,5000000,100"]
    assert run_json(capsys, *words)["origin"] == FAR.tolist()


def test_what_is_asked_for_counts():
    np.save("a.npy", lattice() + FAR)
    got = gb.read("a.npy", origin=FAR)
    assert got.origin == tuple(FAR)
    np.testing.assert_allclose(got.positions, lattice(), atol=1e-6)
    with pytest.warns(UserWarning, match="float32 has steps"):
        gb.read("a.npy", origin=(0, 0, 0))
    for wrong in ((1, 2), "here", (0, 0, np.nan), 3):
        with pytest.raises(ValueError, match="origin: expected"):
            gb.read("a.npy", origin=wrong)


def test_scenes_keep_their_origin():
    there = gb.Particles(lattice(), origin=FAR)
    assert there[3:5].origin == tuple(FAR)
    scene = gb.Scene(there, support=0.3)
    scene.update(gb.Particles(lattice() + 1, origin=FAR - 1))
    np.testing.assert_allclose(scene.particles.positions, lattice(), atol=1e-6)
    assert scene.particles.origin == tuple(FAR)
    scene.update(positions=lattice() + 2)
    assert scene.particles.origin == tuple(FAR)


def test_pieces_of_a_file_have_one(capsys, monkeypatch):
    from globule.formats.ranges import ranges

    np.savez("a.npz", positions=lattice() + FAR)
    with pytest.warns(UserWarning, match="positions are given from"):
        n, rows = ranges("a.npz")
    origins = {rows(k, k + 100).origin for k in range(0, n, 100)}
    assert len(origins) == 1
    assert origins != {HERE}
    whole = np.concatenate([rows(k, k + 100).world_positions() for k in range(0, n, 100)])
    np.testing.assert_allclose(whole, lattice() + FAR, atol=1e-7)


def test_a_mesh_beside_stands_where_it_is(capsys):
    images = []
    for name, place in (("near", np.zeros(3)), ("far", FAR)):
        np.save(f"{name}.npy", lattice() + place)
        corners = place + [(0, 0, 3), (1, 0, 3), (0, 1, 3)]
        lines = [f"v {x} {y} {z}" for x, y, z in corners]
        with open(f"{name}.obj", "w") as file:
            file.write("\n".join([*lines, "f 1 2 3", ""]))
        words = [f"{name}.npy", "-o", f"{name}.png", "--mesh", f"{name}.obj", *MACHINE]
        assert main(["render", *words]) == 0
        images.append(np.asarray(Image.open(f"{name}.png")).astype(int))
    assert np.abs(images[0] - images[1]).mean() < 0.1


def test_large_ids_are_said_whole(capsys):
    ids = 2**53 + 1 + 2 * np.arange(729, dtype=np.uint64)
    gb.write("a.npz", gb.Particles(lattice().astype("f4"), attributes={"id": ids}))
    assert main(["info", "a.npz"]) == 0
    assert f"id: uint64 729, {ids[0]} to {ids[-1]}" in capsys.readouterr().out
    words = ["render", "a.npz", "-o", "a.png", "--pick", "48,36", *MACHINE]
    picked = run_json(capsys, *words)["picked"]["attributes"]["id"]
    assert picked in ids.tolist()
    assert main(words) == 0
    assert f"id {picked}" in capsys.readouterr().out
    texts = [text for _, text in tick_labels(float(ids[0]), float(ids[-1]), 5)]
    assert len({*texts}) == len(texts) > 2
