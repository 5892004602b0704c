"""Particles chosen by a condition."""

import json
import re

import globule as gb
import numpy as np
import pytest
from globule.cli import main
from globule.data.radii import find_radii
from globule.data.where import where

N = 50


@pytest.fixture(scope="module")
def particles():
    rng = np.random.default_rng(3)
    return gb.Particles(
        rng.random((N, 3), np.float32),
        attributes={
            "type": rng.integers(0, 4, N).astype(np.uint8),
            "id": 2**53 + np.arange(N, dtype=np.uint64),
            "velocity": rng.normal(size=(N, 3)).astype(np.float32),
            "Temp [K]": np.where(np.arange(N) % 5, rng.random(N) * 500, np.nan).astype(np.float32),
        },
    )


def values(p):
    speed = np.linalg.norm(np.asarray(p.attributes["velocity"], float), axis=1)
    return p.positions, np.asarray(p.attributes["type"], int), speed, p.attributes["Temp [K]"]


CASES = {
    "type == 1 and speed > 0.2": lambda x, t, s, k: (t == 1) & (s > 0.2),
    "type in (1, 3) or not x < 0.5": lambda x, t, s, k: np.isin(t, (1, 3)) | ~(x[:, 0] < 0.5),
    "type not in [0, 2]": lambda x, t, s, k: ~np.isin(t, (0, 2)),
    "0.2 < y <= z": lambda x, t, s, k: (x[:, 1] > 0.2) & (x[:, 1] <= x[:, 2]),
    "type - 1 < 0": lambda x, t, s, k: t < 1, "-type + 2 >= 1": lambda x, t, s, k: t <= 1,
    "(x - 0.5)**2 + (y - 0.5)**2 < 0.1": lambda x, t, s, k: ((x[:, :2].astype(float) - 0.5) ** 2).sum(1) < 0.1,
    "`Temp [K]` > 300": lambda x, t, s, k: k > 300,
    "not isfinite(`Temp [K]`)": lambda x, t, s, k: ~np.isfinite(k), "x > 2": lambda x, t, s, k: x[:, 0] > 2,
    "sqrt(abs(x - 1)) >= 0 and 1 < 2": lambda x, t, s, k: x[:, 0] > -1,
    " type % 2 == 1 ": lambda x, t, s, k: t % 2 == 1,
}  # fmt: skip


@pytest.mark.parametrize("condition", CASES)
def test_those_for_which_it_holds(particles, condition):
    expected, chosen = CASES[condition](*values(particles)), where(particles, condition)
    np.testing.assert_array_equal(chosen.attributes["id"], particles.attributes["id"][expected])
    np.testing.assert_array_equal(chosen.positions, particles.positions[expected])


def test_components_and_large_ids(particles):
    chosen = where(particles, "velocity[0] > 0 and `velocity:1` > 0")
    assert (chosen.attributes["velocity"][:, :2] > 0).all()
    assert 0 < len(chosen) < N
    for numbers, condition in (
        (np.array([5, 7, 2**64 - 1], np.uint64), "id - 6 > 0"),
        (np.array([5, 7, 2**64 - 1], np.uint64), "-id < -6"),
        (np.array([2, 4_000_000_001, 4_000_000_003]), "id * id > 4"),
    ):  # unsigned numbers must not wrap around, nor long ones overflow
        ids = gb.Particles(np.zeros((3, 3)), attributes={"id": numbers})
        assert len(where(ids, condition)) == 2, condition
    assert list(where(particles, f"id == {2**53 + 1}").attributes["id"]) == [2**53 + 1]


@pytest.mark.parametrize(("condition", "said"), [
    ("", "expected a condition like"), ("type =", "expected a condition like"),
    ("type = 1", "expected a condition like"), ("speed", "expected a comparison"),
    ("type and x > 1", "expected a comparison, got 'type'"),
    ("typ == 1", "expected one of x, y, z, .*type.*, got typ"),
    ("velocity[3] > 0", "velocity:0 to velocity:2"), ("velocity[x] > 0", "number of a component"),
    ("x is 1", "comparison of numbers"), ("type in 1", r"expected 'in \(1, 2\)'"),
    ("type in ()", r"expected 'in \(1, 2\)'"), ("type == 'water'", "expected numbers, and names without quotes"),
    ("__import__('os').system('false') == 0", "expected names, numbers"),
    ("x.__class__ == 1", "expected names, numbers"), ("[x for x in y] == 1", "expected names, numbers"),
    ("(lambda: 1)() == 1", "expected names, numbers"), ("abs(x, y) > 1", "expected names, numbers"),
    ("`Temp [K] > 1", "backticks in pairs"), ("`Temp` > 1", "got Temp"),
    (f"x < {10**40}", "expected numbers up to"), ("x == 1 " * 1000, "characters"),
    ("(" * 300 + "x" + ")" * 300 + " > 1", "condition like"), ("-" * 300 + "x > 1", "brackets in each other"),
    ("x > 1\nand y > 1", "expected a condition like"), ("\0", "expected a condition like"),
])  # fmt: skip
def test_others_are_refused(particles, condition, said):
    with pytest.raises(ValueError, match=f"^where: .*{said}"):
        where(particles, condition)


def test_no_text(particles):
    with pytest.raises(TypeError, match="where: expected a condition, got 3"):
        where(particles, 3)


@pytest.fixture
def file(particles, tmp_path):
    gb.write(tmp_path / "p.npz", particles)
    return tmp_path / "p.npz"


def test_read_and_commands_take_it(file, particles, tmp_path, capsys):
    n, condition = int((particles.attributes["type"] == 1).sum()), ["--where", "type == 1"]
    assert main(["info", str(file), "--json", *condition]) == 0
    assert json.loads(capsys.readouterr().out)["particles"] == n
    assert main(["convert", str(file), str(tmp_path / "q.vtk"), *condition]) == 0
    assert len(gb.read(tmp_path / "q.vtk")) == n
    small = ["--size", "64x48", "--support", "0.3", "--device", "cpu"]
    assert main(["render", str(file), "-o", str(tmp_path / "a.png"), *small, *condition]) == 0
    assert main(["render", str(tmp_path / "q.vtk"), "-o", str(tmp_path / "b.png"), *small]) == 0
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()
    capsys.readouterr()
    assert main(["track", str(file), "--json", "--support", "0.3", *condition]) == 0
    assert json.loads(capsys.readouterr().out)
    assert len(gb.read(file, where="type == 1")) == (particles.attributes["type"] == 1).sum()
    assert len(gb.read(file, where="x > 2")) == 0
    with pytest.raises(ValueError, match="where: expected one of"):
        gb.read(file, where="mass > 2")
    (tmp_path / "m.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    words = ["render", str(tmp_path / "m.obj"), "-o", str(tmp_path / "a.png"), "--where", "x > 0"]
    assert main(words) == 2
    assert "--where: expected particles" in capsys.readouterr().err


@pytest.mark.parametrize(("words", "said"), [
    (["--where", "type = 1"], "where: expected a condition like"),
    (["--where", "x > 2"], "expected a condition that some particle meets, got 'x > 2'"),
    (["--where", "mass > 2"], "where: expected one of x, y, z"),
    (["--where", "x > 0", "--memory", "1k"], "ranges can be read, got {file} with --where;"),
])  # fmt: skip
def test_what_a_command_says(file, words, said, tmp_path, capsys):
    assert main(["render", str(file), "-o", str(tmp_path / "a.png"), *words]) == 2
    assert said.format(file=file) in capsys.readouterr().err
    assert not (tmp_path / "a.png").exists()


@pytest.mark.parametrize(("words", "said"), [
    (["--where", "x > 2"], "p.npz: --where: expected a condition that some particle meets, got 'x > 2'"),
    (["--min-component", "999"], "--min-component: expected a component of so many particles, got 999"),
])  # fmt: skip
@pytest.mark.parametrize("command", [["mesh"], ["slice", "--plane", "0,0,1,0"], ["gauge", "--map"]])
def test_what_measuring_commands_say_of_nothing(file, command, words, said, tmp_path, capsys):
    output = tmp_path / ("m.ply" if command == ["mesh"] else "m.npz")
    assert main([command[0], str(file), "-o", str(output), *command[1:], *words]) == 2
    assert said in capsys.readouterr().err


@pytest.mark.parametrize("name", ["Fluid Type", "a-b", "in", "2nd", "U.x", "rate [1/s]"])
def test_names_that_stand_in_backticks(name):
    particles = gb.Particles(np.eye(3), attributes={name: np.arange(3)})
    for word in (name, f"'{name}'"):
        with pytest.raises(ValueError, match=f"; `{re.escape(name)}` stands in backticks$"):
            where(particles, f"{word} > 1")
    assert len(where(particles, f"`{name}` > 1")) == 1
    with pytest.raises(ValueError, match=r"expected numbers, and names without quotes, got .'oil'.$"):
        where(particles, "x == 'oil'")


def test_places_are_the_files_whatever_the_origin(tmp_path):
    x = np.array([[0, 0, 0], [0, 0, 1], [0, 0, 2]]) + [691234.0, 4812345.0, 512.0]
    for k in range(2):
        np.savetxt(tmp_path / f"u_{k}.csv", x + [3 * k, 0, 0], "%.3f", ",", header="x,y,z", comments="")
    assert len(gb.read(tmp_path / "u_0.csv", where="z < 513.5 and x < 691235")) == 2
    every = gb.sequence(tmp_path / "u_*.csv", where="x > 691236 or z > 513.5")
    assert [len(p) for p in every] == [1, 3]


def test_diameters_beside_radii_are_not_halved_again(tmp_path):
    rows = "\n".join(f"{k} 0 0 0.1" for k in range(3))
    (tmp_path / "a.dump").write_text(
        "ITEM: TIMESTEP\n0\nITEM: NUMBER OF ATOMS\n3\nITEM: BOX BOUNDS pp pp pp\n0 3\n0 3\n0 3\n"
        f"ITEM: ATOMS x y z diameter\n{rows}\n"
    )
    found = gb.read(tmp_path / "a.dump", radius_is="diameter")
    assert find_radii(found) == pytest.approx([0.05] * 3)


def frames_of_xyz(*frames: np.ndarray) -> str:
    """A file with several frames, in the folder where the test runs."""
    with open("a.xyz", "w") as file:
        for x in frames:
            file.write(f"{len(x)}\n\n" + "".join(f"{a} {b} {c}\n" for a, b, c in x))
    return "a.xyz"


def test_frames_are_named_where_one_is_taken_or_none_is_left(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    g = np.stack(np.mgrid[:3, :3, :3], -1).reshape(-1, 3) * 1.0
    name = frames_of_xyz(g, g - 9.0, g + 1.0)
    with pytest.warns(UserWarning, match="a.xyz has 3 frames, and this is the first: read"):
        assert len(gb.read(name)) == 27
    with pytest.warns(UserWarning, match="^frame 1 of a.xyz: no particle meets 'x > 1'"):
        assert [len(one) for one in gb.sequence(name, where="x > 1")] == [9, 0, 18]
    with pytest.warns(UserWarning, match="^a.xyz: no particle meets 'x > 5'"):
        gb.read(name, frame=0, where="x > 5")
    assert gb.find_value_range([name], "x") == gb.find_value_range(name, "x") == (-9, 3)
    with pytest.raises(ValueError, match=r"got speed \(frame 0 of a.xyz\)"):
        gb.find_value_range(name, "speed")
    words = ["--where", "x > 1", "--size", "32x24"]
    assert main(["render", name, "-o", "p%d.png", *words]) == 0
    assert capsys.readouterr().err.count("warning: frame 1 of a.xyz: no particle meets --where 'x > 1'") == 1
    assert main(["track", name, "-o", "t.csv", *words[:2]]) == 0
    assert "warning: frame 1 of a.xyz: no particle meets --where 'x > 1'" in capsys.readouterr().err
    capsys.readouterr()
    assert main(["render", name, "-o", "p%d.png", "--where", "x > 9"]) == 2
    expected = (
        "frame 0 of a.xyz to frame 2 of a.xyz: --where: expected a condition that some particle meets, got 'x > 9'"
    )
    assert expected in capsys.readouterr().err
    assert main(["render", name, "-o", "p.png", "--frame", "1", *words]) == 2
    assert "--where: expected a condition that some particle meets" in capsys.readouterr().err


def test_frames_far_away_have_one_origin_which_is_said_once(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    g = np.stack(np.mgrid[:4, :4, :4], -1).reshape(-1, 3) * 0.1 + (691234.0, 4812345.0, 512.0)
    name = frames_of_xyz(g[:0], g, g + (30.0, 0, 0), g + (60.0, 0, 0))
    with pytest.warns(UserWarning, match="positions are given from") as said:
        frames = list(gb.sequence(name))
    assert len(said) == 1
    assert {one.origin for one in frames[1:]} == {frames[1].origin}
    np.testing.assert_allclose(frames[3].world_positions(), g + (60.0, 0, 0), atol=1e-5)
    for words in (["render", name, "-o", "p%d.png", "--size", "32x24"], ["track", name], ["convert", name, "a%d.ply"]):
        main(words)
        assert capsys.readouterr().err.count("given from") <= 1, words
