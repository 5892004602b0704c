"""Scenes whose pieces lie on MPI ranks, through mpiexec."""

from __future__ import annotations

import json

import globule as gb
import numpy as np
import pytest
from cli_helpers import cube
from launcher import mpirun

SIZE = (96, 72)


PROGRAM = """
import sys
import globule as gb, numpy as np
from mpi4py import MPI

comm, case = MPI.COMM_WORLD, sys.argv[1]
data = np.load("data.npz")
p, color = data["positions"], data["color"]
mine = slice(comm.rank, None, comm.size)
if case == "one":  # all on the last rank
    mine = slice(None) if comm.rank == comm.size - 1 else slice(0)
if case == "few":
    mine = slice(comm.rank, comm.rank + 1) if comm.rank < 2 else slice(0)
weight = np.where(np.arange(len(p)) % 5 == 0, -0.6, 1.0)[mine] if case == "negative" else None
options = {"surface": "smooth", "spacing": 1.0} if case == "smooth" else {"support": 2.0}
particles = gb.Particles(p[mine], color=color[mine], weight=weight)
pieces = gb.Pieces(particles, comm=comm, device="cpu", threads=1, **options)
camera = gb.Camera.fit(p, size=(96, 72), margin=1)
frame = gb.render(pieces, camera, (96, 72), clips=[gb.ClipPlane((1, 0.2, 0), 7.0)])
if comm.rank == 0:
    frame.save(f"{case}.npz")
    np.save(f"{case}.npy", frame.image)
"""


@pytest.fixture
def data(tmp_path):
    rng = np.random.default_rng(3)
    lattice = np.stack(np.meshgrid(*[np.arange(14)] * 3, indexing="ij"), -1).reshape(-1, 3)
    positions = (lattice + rng.uniform(-0.25, 0.25, lattice.shape)).astype(np.float32)
    color = rng.random(positions.shape).astype(np.float32)
    np.savez(tmp_path / "data.npz", positions=positions, color=color)
    (tmp_path / "program.py").write_text(PROGRAM)
    return positions, color


@pytest.mark.parametrize(
    ("n", "case"), [(2, "plain"), (3, "smooth"), (3, "negative"), (4, "one"), (4, "few")]
)
def test_ranks_give_the_image_of_one_device(n, case, data, tmp_path):
    run = mpirun(n, "program.py", case, cwd=tmp_path)
    assert run.returncode == 0, run.stderr[-2000:]
    positions, color = data
    some = slice(2) if case == "few" else slice(None)
    weight = np.where(np.arange(len(positions)) % 5 == 0, -0.6, 1.0) if case == "negative" else None
    particles = gb.Particles(positions[some], color=color[some], weight=weight)
    options = {"surface": "smooth", "spacing": 1.0} if case == "smooth" else {"support": 2.0}
    scene = gb.Scene(particles, device="cpu", **options)
    camera = gb.Camera.fit(positions, size=SIZE, margin=1)
    one = gb.render(scene, camera, SIZE, clips=[gb.ClipPlane((1, 0.2, 0), 7.0)])
    assert one.mask.any()
    np.testing.assert_array_equal(one.mask, np.load(tmp_path / f"{case}.npz")["mask"])
    image = np.load(tmp_path / f"{case}.npy")
    assert np.abs(one.image.astype(int) - image.astype(int)).max() <= 1


COMMAND = ["-m", "globule", "render"]


def test_the_command_on_ranks(tmp_path):
    gb.write(tmp_path / "a.npz", cube(8))
    words = [*COMMAND, "a.npz", "--size", "40x30", "--support", "0.3", "--threads", "1"]
    run = mpirun(2, *words, "-o", "a.png", cwd=tmp_path)
    assert run.returncode == 0, run.stderr
    assert (tmp_path / "a.png").exists()
    assert run.stdout.count("a.png: 512 particles") == 1
    assert run.stderr.count("in 2 pieces") == 1


def test_a_mistake_is_one_line(tmp_path):
    gb.write(tmp_path / "a.npz", cube(4))
    words = [*COMMAND, "a.npz", "-o", "a.png", "--preset", "water", "--ranks", "pieces"]
    run = mpirun(2, *words, cwd=tmp_path)
    assert run.returncode != 0
    assert run.stderr.count("globule: error: ") == 1
    assert "--preset" in run.stderr
    assert not (tmp_path / "a.png").exists()


def test_memory_is_not_for_ranks(tmp_path):
    gb.write(tmp_path / "a.npz", cube(4))
    run = mpirun(2, *COMMAND, "a.npz", "-o", "a.png", "--memory", "1K", cwd=tmp_path)
    assert run.returncode != 0
    assert run.stderr.count("globule: error: --memory: expected none on several ranks") == 1
    assert not (tmp_path / "a.png").exists()


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


def test_light_that_turns_is_replicated(tmp_path):
    """By itself; the same file as one rank writes."""
    gb.write(tmp_path / "a.npz", cube(5))
    words = [*COMMAND, "a.npz", "--size", "140x100", "--support", "0.3", "--threads", "1",
             "--shadows", "--reflection", "0.3", "--ambient-rays", "1"]  # fmt: skip
    assert mpirun(1, *words, "-o", "one.png", cwd=tmp_path).returncode == 0
    run = mpirun(3, *words, "-o", "many.png", cwd=tmp_path)
    assert run.returncode == 0, run.stderr
    assert run.stdout.count("many.png") == 1
    assert "pieces" not in run.stderr
    assert (tmp_path / "one.png").read_bytes() == (tmp_path / "many.png").read_bytes()


def test_images_of_a_sequence_are_dealt(tmp_path):
    """The first file has no particles: support and camera come from the second, on every rank."""
    particles = cube(5)
    for k in range(6):
        moved = gb.Particles(particles.positions * (1 + 0.05 * k) if k else np.empty((0, 3)))
        gb.write(tmp_path / f"f_{k}.npz", moved)
    words = [*COMMAND, "f_*.npz", "--size", "60x40", "--color-by", "x", "--threads", "1"]
    assert mpirun(1, *words, "-o", "one_%d.png", cwd=tmp_path).returncode == 0
    run = mpirun(3, *words, "-o", "many_%d.png", "--json", cwd=tmp_path)
    assert run.returncode == 0, run.stderr
    report = json.loads(run.stdout)
    assert report["images"] == [f"many_{k}.png" for k in range(6)]
    for k in range(6):
        one, many = (tmp_path / f"{name}_{k}.png" for name in ("one", "many"))
        assert one.read_bytes() == many.read_bytes()
    (tmp_path / "many_3.png").unlink()
    times = {k: (tmp_path / f"many_{k}.png").stat().st_mtime_ns for k in (1, 5)}
    run = mpirun(3, *words, "-o", "many_%d.png", "--resume", cwd=tmp_path)
    assert run.returncode == 0, run.stderr
    assert (tmp_path / "many_3.png").read_bytes() == (tmp_path / "one_3.png").read_bytes()
    assert all((tmp_path / f"many_{k}.png").stat().st_mtime_ns == t for k, t in times.items())


def test_a_movie_of_ranks(tmp_path):
    pytest.importorskip("av")
    for k in range(4):
        gb.write(tmp_path / f"f_{k}.npz", gb.Particles(cube(4).positions * (1 + 0.1 * k)))
    words = [*COMMAND, "f_*.npz", "--size", "60x40", "--support", "0.5", "--threads", "1"]
    run = mpirun(2, *words, "-o", "a.mp4", cwd=tmp_path)
    assert run.returncode == 0, run.stderr
    assert run.stdout.count("a.mp4: 4 frames") == 1
    from globule.formats.pictures.video import movie_facts

    assert movie_facts(tmp_path / "a.mp4")[0] == 4
    assert not (tmp_path / "a.mp4.frames").exists()


def test_a_rank_that_fails_ends_the_run(tmp_path):
    """Rank 1 cannot read its rows."""
    gb.write(tmp_path / "a.npz", cube(6))
    program = (
        "import sys\nfrom mpi4py import MPI\nfrom globule.cli import main, pieces\n"
        "def share(path, comm):\n"
        "    if comm.rank == 1:\n        raise OSError('no such disk')\n"
        "    return own(path, comm)\n"
        "own, pieces._share = pieces._share, share\n"
        "sys.exit(main(['render', 'a.npz', '-o', 'a.png', '--support', '0.4']))\n"
    )
    (tmp_path / "broken.py").write_text(program)
    run = mpirun(3, "broken.py", cwd=tmp_path)
    assert run.returncode != 0
    assert run.stderr.count("globule: error: rank 1: a.npz: no such disk") == 1
    assert run.stderr.count("globule: error:") == 1
    assert not (tmp_path / "a.png").exists()


@pytest.mark.parametrize("interrupted", ["all", "one"])
def test_an_interrupt_is_one_line(interrupted, tmp_path):
    gb.write(tmp_path / "a.npz", cube(6))
    program = (
        "import sys\nfrom globule.cli import main, pieces\n"
        "def share(path, comm):\n"
        "    if comm.rank == 1 or sys.argv[1] == 'all':\n        raise KeyboardInterrupt\n"
        "    return own(path, comm)\n"
        "own, pieces._share = pieces._share, share\n"
        "sys.exit(main(['render', 'a.npz', '-o', 'a.png', '--support', '0.4']))\n"
    )
    (tmp_path / "program.py").write_text(program)
    run = mpirun(2, "program.py", interrupted, cwd=tmp_path)
    line = "globule: interrupted" if interrupted == "all" else "globule: error: rank 1: interrupted"
    assert run.returncode != 0
    assert [x for x in run.stderr.splitlines() if x.startswith("globule")] == [line]
    assert not (tmp_path / "a.png").exists()
