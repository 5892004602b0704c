"""Scenes whose pieces lie on MPI ranks, through mpiexec."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys

import globule as gb
import numpy as np
import pytest
from cli_helpers import cube

MPIEXEC = shutil.which("mpiexec", path=f"{os.path.dirname(sys.executable)}:{os.environ['PATH']}")
SIZE = (96, 72)


def mpirun(n: int, *words: str, **options) -> subprocess.CompletedProcess:
    pytest.importorskip("mpi4py")
    if MPIEXEC is None:
        pytest.skip("no mpiexec")
    env = {**os.environ, "OMP_NUM_THREADS": "1"}
    return subprocess.run(
        [MPIEXEC, "-n", str(n), sys.executable, *words],
        capture_output=True, text=True, timeout=110, env=env, **options,
    )  # fmt: skip


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
    run = mpirun(2, *COMMAND, "a.npz", "-o", "a.png", "--preset", "water", cwd=tmp_path)
    assert run.returncode != 0
    assert run.stderr.count("globule: error: ") == 1
    assert "--preset" in run.stderr
    assert not (tmp_path / "a.png").exists()


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
