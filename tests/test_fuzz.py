"""The fuzzer of `make fuzz`, for a short time, and all that it ever found."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from random import Random

import pytest
from fuzz_mutations import mutate

HERE = Path(__file__).parent
MUTANTS = int(os.environ.get("GLOBULE_FUZZ", 50))


def fuzz(*words: str) -> str:
    """The last line of a run without a fault."""
    made = subprocess.run(
        [sys.executable, str(HERE / "fuzz.py"), *words], capture_output=True, text=True
    )
    assert made.returncode == 0, made.stdout + made.stderr
    return made.stdout.splitlines()[-1]


@pytest.fixture
def libraries():
    for name in ("SimpleITK", "nibabel", "trimesh", "OpenEXR", "vtk", "PIL", "h5py", "gsd.hoomd",
                 "pyvista"):  # fmt: skip
        pytest.importorskip(name)


@pytest.mark.parametrize("seed", ["7", "8"])
def test_new_mutants(libraries, tmp_path, seed):
    line = fuzz("-n", str(MUTANTS), "--seed", seed, "--keep", str(tmp_path))
    assert line.startswith(f"{MUTANTS} files in ")
    assert line.endswith(" 0 faults")


def test_every_finding_stays_mended(libraries):
    line = fuzz("--open", str(HERE / "corpus"))
    assert int(line.split()[0]) >= len(list((HERE / "corpus").glob("*@*@*"))) > 10


def test_every_array_of_a_checkpoint_is_checked():
    assert int(fuzz("--damage").split()[0]) > 150


def test_mutants_are_the_same_again_and_differ():
    content = b"ply\nformat ascii 1.0\nelement vertex 3\n"
    first = [mutate(Random(str(i)), content, [content]) for i in range(50)]
    assert first == [mutate(Random(str(i)), content, [content]) for i in range(50)]
    assert len({*first} - {content}) > 40
