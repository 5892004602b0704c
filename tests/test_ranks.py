"""Scenes whose pieces lie on MPI ranks, through mpiexec."""

import json
import shlex
from pathlib import Path

import globule as gb
import numpy as np
import pytest
from cli_helpers import cube
from globule._demo.data import splash
from globule.cli import main
from globule.pieces.pieces import Pieces
from launcher import mpirun
from PIL import Image

COMMANDS = """
import shlex, sys
from globule.cli import main
for words in sys.argv[1:]:
    assert main(["render", *shlex.split(words), "--threads", "1"]) == 0
"""


@pytest.mark.slow
def test_the_splash_with_defaults(folder):
    """On ranks and in pieces, no pixel differs from one process's by more than one level."""
    np.savez_compressed("splash.npz", positions=splash()[0])  # which rank 0 reads whole
    words = ["render", "splash.npz", "--size", "640x480", "--threads", "1", "--device", "cpu"]
    assert main([*words, "-o", "one.png"]) == 0
    one = np.asarray(Image.open("one.png")).astype(int)
    for n in (2, 3, 7):
        run = mpirun(n, "-m", "globule", *words, "-o", f"{n}.png")
        assert run.returncode == 0, run.stderr
        pieces = Pieces(gb.read("splash.npz"), n=n, surface="auto", device="cpu")
        for image in (np.asarray(Image.open(f"{n}.png")), gb.render(pieces, (640, 480)).image):
            assert np.abs(one - image).max() <= 1


@pytest.mark.slow
def test_commands_on_ranks(folder, capsys):
    pytest.importorskip("av")
    from globule.formats.pictures.video import movie_facts

    for k in range(6):  # the first has no particles: camera and support come from the second
        moved = cube(5).positions * (1 + 0.05 * k) if k else np.empty((0, 3))
        gb.write(f"f_{k}.npz", gb.Particles(moved))
    gb.write("a.npz", cube(8))
    gb.write("b.npz", cube(5))
    plain = "a.npz --size 40x30 --support 0.3"
    light = "b.npz --size 140x100 --support 0.3 --shadows --reflection 0.3 --ambient-rays 1"
    series, movie = "f_*.npz --size 60x40 --color-by x", "f_[1-4].npz --size 60x40 --support 0.5"

    def ranks(*commands):
        run = mpirun(3, "-c", COMMANDS, *commands)
        assert run.returncode == 0, run.stderr
        return run

    run = ranks(f"{plain} -o a.png", f"{light} -o many.png", f"{series} -o many_%d.png", f"{movie} -o a.mp4")
    assert (run.stdout.count("a.png: 512 particles"), run.stderr.count("in 3 pieces")) == (1, 1)
    assert (run.stdout.count("many.png"), run.stdout.count("a.mp4: 4 frames")) == (1, 1)
    assert movie_facts("a.mp4")[0] == 4
    assert not Path("a.mp4.frames").exists()
    for words in (f"{light} -o one.png", f"{series} -o one_%d.png"):
        assert main(["render", *shlex.split(words), "--threads", "1"]) == 0
    names = [f"many_{k}.png" for k in range(6)]
    for name in ("many.png", *names):
        assert Path(name).read_bytes() == Path(name.replace("many", "one")).read_bytes()
    Path("many_3.png").unlink()
    times = {k: Path(f"many_{k}.png").stat().st_mtime_ns for k in (1, 5)}
    run = ranks(f"{series} -o many_%d.png --resume --json")
    assert json.loads(run.stdout)["images"] == ["many_3.png"]  # made in this run
    assert Path("many_3.png").read_bytes() == Path("one_3.png").read_bytes()
    assert all(Path(f"many_{k}.png").stat().st_mtime_ns == t for k, t in times.items())
    run = ranks(f"{light} --ground -0.5 --ranks pieces -o pieces.png")
    assert "in 3 pieces" in run.stderr
    assert main(["render", *shlex.split(f"{light} --ground -0.5 -o one.png")]) == 0
    one, many = (np.asarray(Image.open(n)).astype(int) for n in ("one.png", "pieces.png"))
    assert np.abs(one - many).max() <= 1
    grains = "ITEM: TIMESTEP\n0\nITEM: NUMBER OF ATOMS\n64\nITEM: BOX BOUNDS ff ff ff\n0 9\n0 9\n0 9\n"
    rows = "".join(f"{x:g} {y:g} {z:g} 0.1\n" for x, y, z in cube(4).positions)
    Path("g.dump").write_text(f"{grains}ITEM: ATOMS x y z radius\n{rows}")
    capsys.readouterr()
    assert main(["render", "g.dump", "-o", "g.png", "--size", "40x30"]) == 0
    notes = capsys.readouterr().err
    assert notes.count("note: ") == 2  # the radii, and the direction up
    run = ranks("g.dump -o g.png --size 40x30")
    assert [line for line in run.stderr.splitlines() if "in 3 pieces" not in line] == notes.splitlines()


COMMAND = ["-m", "globule", "render"]


@pytest.mark.slow
@pytest.mark.parametrize(("words", "said"), [
    (["--preset", "water", "--ranks", "pieces"], "--preset"),
    (["--memory", "1K"], "--memory: expected none on several ranks"),
    (["--color-by", "q"], "color_by: expected one of x, y, z"),
])  # fmt: skip
def test_a_mistake_is_one_line(words, said, tmp_path):
    gb.write(tmp_path / "a.npz", cube(4))
    run = mpirun(2, *COMMAND, "a.npz", "-o", "a.png", *words, cwd=tmp_path)
    assert run.returncode != 0
    assert run.stderr.count("globule: error: ") == 1
    assert said in run.stderr
    assert not (tmp_path / "a.png").exists()


@pytest.mark.slow
def test_an_interrupted_movie_is_noted_once(tmp_path):
    """One frame is damaged, and every rank needs it first."""
    pytest.importorskip("av")
    gb.write(tmp_path / "f_0.npz", cube(4))
    (tmp_path / "f_1.npz").write_bytes(b"PK")
    words = [*COMMAND, "f_*.npz", "--size", "60x40", "--support", "0.5", "--threads", "1"]
    run = mpirun(2, *words, "-o", "a.mp4", cwd=tmp_path)
    assert run.returncode != 0
    lines = [x for x in run.stderr.splitlines() if x.startswith("globule")]
    assert [x for x in lines if "f_1.npz" in x and "rank" in x] == lines[:1]
    assert lines[1:] == ["globule: note: 1 finished image is in a.mp4.frames; --resume continues"]
    assert not (tmp_path / "a.mp4").exists()


FAILS = """
import sys
from mpi4py import MPI
from globule.cli import main, pieces


def share(path, given, comm):
    if comm.rank == 1 or sys.argv[1] == "all":
        raise OSError("no such disk") if sys.argv[1] == "disk" else KeyboardInterrupt
    return own(path, given, comm)


own, pieces._share = pieces._share, share
sys.exit(main(["render", "a.npz", "-o", "a.png", "--support", "0.4"]))
"""


@pytest.mark.parametrize(("fails", "line"), [
    pytest.param("disk", "globule: error: rank 1: a.npz: no such disk", marks=pytest.mark.slow),
    pytest.param("all", "globule: interrupted", marks=pytest.mark.slow),
    pytest.param("one", "globule: error: rank 1: interrupted", marks=pytest.mark.slow),
])  # fmt: skip
def test_a_rank_that_fails_ends_the_run(tmp_path, fails, line):
    """Rank 1 cannot read its rows, or is interrupted, as all may be: one line."""
    gb.write(tmp_path / "a.npz", cube(6))
    run = mpirun(2, "-c", FAILS, fails, cwd=tmp_path)
    assert run.returncode != 0
    assert [x for x in run.stderr.splitlines() if x.startswith("globule")] == [line]
    assert not (tmp_path / "a.png").exists()
