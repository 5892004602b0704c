"""One file with several frames is a sequence."""

import copy
import csv
import gzip
import os
import pickle
from pathlib import Path

import globule as gb
import numpy as np
import pytest
from cli_helpers import SMALL, output_of, refused, run_json
from format_helpers import write_dump, write_extxyz
from globule.cli import main
from globule.formats import packed, read_contents
from globule.formats.frames import FrameOf
from globule.formats.ranges import has_ranges
from globule.render.sequence import with_frames
from globule.viewer.open import open_source
from globule.viewer.state import State

pytestmark = pytest.mark.usefixtures("folder")
N = 4


def lattice(n: int) -> np.ndarray:
    return np.stack(np.meshgrid(*[np.arange(n)] * 3, indexing="ij"), -1).reshape(-1, 3) * 0.1


def dump() -> list[np.ndarray]:
    """frames.lammpstrj: lattices of 5, 6, 7 and 8 particles an edge."""
    frames = [lattice(5 + k) for k in range(N)]
    write_dump("frames.lammpstrj", *frames, faces="ff ff ff")
    return frames


def extended() -> list[np.ndarray]:
    """frames.xyz: the same lattices."""
    frames = [lattice(5 + k) for k in range(N)]
    write_extxyz("frames.xyz", *frames)
    return frames


@pytest.mark.parametrize("make", [dump, extended])
def test_images_tables_and_files_of_all_frames(make, capsys):
    frames = make()
    name = f"frames.{'lammpstrj' if make is dump else 'xyz'}"
    counts = [len(p) for p in frames]
    assert [len(gb.read(f)) for f in with_frames([name])] == counts
    times = [read_contents(name, frame=k).time for k in range(N)]
    assert times == [k * (1.0 if make is dump else 0.5) for k in range(N)]
    shown = output_of(capsys, "render", name, "-o", "p_%d.png", *SMALL)
    assert sorted(p.name for p in Path().glob("p_*.png")) == [f"p_{k}.png" for k in range(N)]
    assert "those of the last frame of" in shown.err  # it has most particles
    assert main(["track", name, "-o", "t.csv"]) == 0
    with open("t.csv") as file:
        volumes = [float(row["volume"]) for row in csv.DictReader(file)]
    np.testing.assert_allclose(volumes, np.array(counts) * 1e-3, rtol=0.2)  # small ones are round
    np.testing.assert_allclose(gb.measure.track_surface(name)["volume"], volumes, rtol=1e-6)
    assert main(["convert", name, "c_%d.vtk"]) == 0
    assert [len(gb.read(f"c_{k}.vtk")) for k in range(N)] == counts


def test_one_image_says_which_frame_it_shows(capsys):
    frames = dump()
    assert main(["render", "frames.lammpstrj", "-o", "p.png", *SMALL]) == 0
    assert "frames.lammpstrj has 4 frames, and this is the first" in capsys.readouterr().err
    out, err = output_of(capsys, "render", "frames.lammpstrj", "--frame", "-1", "-o", "p.png", *SMALL)
    assert f"{len(frames[-1])} particles" in out
    assert "note: up is 0,0,1" in err
    assert err.count("\n") == 1  # and nothing about frames
    assert "has 4 frames" in output_of(capsys, "convert", "frames.lammpstrj", "c.vtk").err
    assert main(["convert", "frames.lammpstrj", "c.vtk", "--frame", "1"]) == 0
    assert len(gb.read("c.vtk")) == len(frames[1])
    capsys.readouterr()
    assert run_json(capsys, "info", "frames.lammpstrj", "--frame", "-2")["particles"] == len(frames[-2])


def test_options_of_files_that_do_not_have_them(capsys):
    extended()
    gb.write("a.ply", gb.Particles(lattice(3)))
    np.save("a.npy", lattice(3))
    for words, said in (
        (["a.npy", "--frame", "1"], "frame: expected -1 to 0"),
        (["a.ply", "--frame", "1"], "--frame: expected a file of table, "),
        (["frames.xyz", "--species", "O"], "--species: expected a file of NumPy archive, HDF5"),
        (["frames.xyz", "--frame", "4"], "frame: expected -4 to 3"),
    ):
        assert said in refused(capsys, "info", *words)


def test_arrays_of_numpy_with_frames(capsys):
    x = np.stack([lattice(3) + k for k in range(4)])
    np.save("a.npy", x)
    np.savez("a.npz", pos=x, mass=np.ones(27), speed=np.arange(108.0).reshape(4, 27), t=[0, 1, 2, 3.5])
    for name in ("a.npy", "a.npz"):
        assert not has_ranges(name)
        assert [one.frame for one in with_frames([name])] == [0, 1, 2, 3]
        np.testing.assert_array_equal(gb.read(name, frame=-1).positions, np.float32(x[3]))
    contents = read_contents("a.npz", frame=3)
    assert contents.time == 3.5
    assert contents.particles.attributes["speed"].tolist() == [*range(81, 108)]
    assert main(["convert", "a.npz", "b.pvd"]) == 0
    assert read_contents("b.pvd", frame=3).time == 3.5
    np.save("rows.npy", np.ascontiguousarray(lattice(4).T))
    with pytest.warns(UserWarning, match="expected a row for each particle, got 3 rows of 64: taken as columns"):
        np.testing.assert_array_equal(gb.read("rows.npy").positions, np.float32(lattice(4)))


def test_the_viewer_plays_them():
    frames = dump()
    source = open_source("frames.lammpstrj", "cpu", 1)
    assert source.n_frames == N
    state = State()
    state.set(time__frame=2)
    source.advance(state)
    assert len(source.particles()) == len(frames[2])
    origin = source.origin(state)
    assert origin.words == ["frames.lammpstrj", "--frame", "2"]
    assert origin.code == ["particles = gb.read('frames.lammpstrj', frame=2)"]
    source.close()


def test_files_of_one_and_of_several_frames_are_one_sequence(capsys):
    dump()
    whole = Path("frames.lammpstrj").read_text()
    first, second = whole.index("ITEM: TIMESTEP"), whole.index("ITEM: TIMESTEP", 1)
    Path("a_1.dump").write_text(whole[first:second])
    Path("a_2.dump").write_text(whole)
    assert len(with_frames(["a_1.dump", "a_2.dump"])) == N + 1
    assert main(["convert", "a_*.dump", "b_%d.npz"]) == 0
    assert [len(gb.read(f"b_{k}.npz")) for k in range(N + 1)] == [len(gb.read("a_1.dump"))] + [
        len(gb.read("a_2.dump", frame=k)) for k in range(N)
    ]
    capsys.readouterr()
    assert "OUT: expected a name with %d for 2 files" in refused(capsys, "convert", "a_*.dump", "c.npz")


def test_all_frames_become_a_collection(capsys):
    dump()
    assert main(["convert", "frames.lammpstrj", "all.pvd"]) == 0
    for k in range(N):
        one, other = read_contents("frames.lammpstrj", frame=k), read_contents("all.pvd", frame=k)
        assert (other.n_frames, other.time) == (N, one.time)
        np.testing.assert_array_equal(other.particles.positions, one.particles.positions)
    assert main(["convert", "frames.lammpstrj", "one.pvd", "--frame", "1"]) == 0
    assert read_contents("one.pvd").n_frames == 1


def test_blank_lines_between_frames_of_xyz():
    frame = "2\n\nH 0 0 0\nH {} 0 0\n"
    Path("a.xyz").write_text("\n\n".join(frame.format(k) for k in (1, 2, 3)) + "\n")
    assert [gb.read("a.xyz", frame=k).positions[1, 0] for k in (0, 1, -1)] == [1, 2, 3]


def test_the_file_itself_is_not_overwritten(capsys):
    extended()
    Path("frames.xyz").rename("f_0.xyz")
    assert "expected another file than IN" in refused(capsys, "convert", "f_0.xyz", "f_%d.xyz")
    assert len(with_frames(["f_0.xyz"])) == N


def test_a_last_frame_that_is_not_whole_stops_nothing_before_it(capsys):
    dump()
    text = Path("frames.lammpstrj").read_text()
    Path("frames.lammpstrj").write_text(text[:-200])
    assert main(["render", "frames.lammpstrj", "-o", "p_%d.png", *SMALL]) == 2
    assert "frames.lammpstrj" in capsys.readouterr().err
    assert len(list(Path().glob("p_*.png"))) == N - 1


def test_lists_of_files_with_frames():
    frames = extended()
    Path("more.xyz").write_bytes(Path("frames.xyz").read_bytes())
    assert len(gb.measure.track_surface(["frames.xyz", "more.xyz"])["frame"]) == 2 * N
    source = open_source(["frames.xyz", "more.xyz"], "cpu", 1)
    assert source.n_frames == 2 * len(frames)
    source.close()


def test_frames_are_not_the_file():
    one, other = FrameOf("a", 1), FrameOf("a", 2)
    assert pickle.loads(pickle.dumps(one)) == copy.deepcopy(one) == one
    assert one == FrameOf("a", 1) != other
    assert len({one, other, FrameOf("a", 1), "a"}) == 3
    assert str(one) == "a"


def test_a_packed_file_is_unpacked_once_for_all_of_its_frames(monkeypatch):
    frames, unpacked = dump(), []
    plain = packed._unpack
    monkeypatch.setattr(packed, "_unpack", lambda *given: unpacked.append(plain(*given)) or unpacked[-1])
    for name in ("a.lammpstrj.gz", "b.lammpstrj.gz"):
        with gzip.open(name, "wb") as file:
            file.write(Path("frames.lammpstrj").read_bytes())
    for name in ("a.lammpstrj.gz", "b.lammpstrj.gz"):
        unpacked.clear()
        for k, frame in enumerate(frames):
            np.testing.assert_allclose(gb.read(FrameOf(name, k)).positions, frame, atol=1e-6)
        assert len(unpacked) == 1
    kept = unpacked[0]
    with gzip.open("b.lammpstrj.gz", "wb") as file:  # another content
        file.write(Path("frames.lammpstrj").read_bytes().replace(b"0.1", b"0.2"))
    assert (gb.read(FrameOf("b.lammpstrj.gz", 0)).positions != frames[0]).any()
    assert len(unpacked) == 2
    assert not os.path.exists(kept)


def test_what_takes_one_frame_says_which(capsys):
    dump()
    words = {"mesh": ["-o", "a.ply"], "slice": ["-o", "a.png", "--plane", "0,0,1,0.1"], "project": ["-o", "a.png"]}
    for command, more in words.items():
        assert main([command, "frames.lammpstrj", *more]) == 0
        assert f"frames.lammpstrj has {N} frames, and this is the first" in capsys.readouterr().err
        assert main([command, "frames.lammpstrj", "--frame", "1", *more]) == 0
        assert "frames, and" not in capsys.readouterr().err
    with pytest.warns(UserWarning, match=f"frames.lammpstrj has {N} frames, and this is the first"):
        gb.render("frames.lammpstrj", (16, 12))
    Path("empty.xyz").write_text("0\n\n1\n\n0 0 0\n")
    said = refused(capsys, "render", "empty.xyz", "-o", "a.png")
    assert "got none with a finite position; it has 2 frames: --frame takes another" in said


def test_one_frame_of_a_sequence_comes_once():
    dump()
    assert [len(p) for p in gb.sequence("frames.lammpstrj", frame=2)] == [343]
    assert [len(p) for p in gb.sequence("frames.lammpstrj", frame=-1)] == [512]


@pytest.mark.parametrize(
    ("frame", "name", "made"), [("2", "a_%d.png", "a_2"), ("-1", "a_%03d.png", "a_003"), ("1", "a_%04d.xyz", "a_0001")]
)
def test_the_number_of_one_frame_is_in_the_name(frame, name, made):
    dump()
    how = [name] if name.endswith("xyz") else ["-o", name, *SMALL]
    command = "convert" if name.endswith("xyz") else "render"
    assert main([command, "frames.lammpstrj", *how, "--frame", frame]) == 0
    assert os.path.exists(made + name[-4:])


def test_a_file_of_one_frame_has_a_number_and_a_name():
    np.savetxt("one.csv", lattice(5), delimiter=",", header="x,y,z", comments="")
    assert main(["render", "one.csv", "-o", "{}_%03d.png", *SMALL]) == 0
    assert os.path.exists("one_000.png")


@pytest.mark.parametrize("order", [1, -1])
def test_files_of_one_frame_beside_those_of_several(capsys, order):
    dump()
    np.savetxt("one.csv", lattice(4), delimiter=",", header="x,y,z", comments="")
    files = ["one.csv", "frames.lammpstrj"][::order]
    report = run_json(capsys, "track", *files, "--sample-spacing", "0.05")
    assert report["particles"] == [64, 125, 216, 343, 512] if order > 0 else [125, 216, 343, 512, 64]
    assert [len(p) for p in gb.sequence(files)] == report["particles"]
    assert main(["render", *files, "-o", "p_%d.png", *SMALL]) == 0
    assert os.path.exists("p_4.png")


def test_the_frames_before_a_broken_one_are_measured(capsys):
    dump()
    text = Path("frames.lammpstrj").read_text().splitlines(keepends=True)
    Path("cut.lammpstrj").write_text("".join(text[:-9]))
    for command, name in (["track"], "particles"), (["gauge", "--at", "0.2,0.2"], "height_0"):
        assert main([*command, "cut.lammpstrj", "-o", "rows.csv"]) == 2
        assert "expected 512 atoms, got 503" in capsys.readouterr().err
        with open("rows.csv", newline="") as file:
            rows = [float(row[name]) for row in csv.DictReader(file)]
        assert len(rows) == 3
        assert name != "particles" or rows == [125, 216, 343]
    assert main(["track", "cut.lammpstrj", "--frame", "3", "-o", "none.csv"]) == 2
    assert not os.path.exists("none.csv")
