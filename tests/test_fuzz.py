"""The fuzzer of `make fuzz`, a few mutants, and all that it ever found."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path
from random import Random

import pytest
from fuzz_mutations import mutate

HERE = Path(__file__).parent
MUTANTS = 40


@pytest.fixture(scope="module")
def run(tmp_path_factory) -> tuple[dict[str, int], str]:
    """Counts of files that were opened, and what one run of the fuzzer prints."""
    words = [
        sys.executable, str(HERE / "fuzz.py"), "-n", str(MUTANTS), "--seed", "7", "--damage", "7",
        "--open", str(HERE / "corpus"), "--keep", str(tmp_path_factory.mktemp("found")),
        "--together",
    ]  # fmt: skip
    made = subprocess.run(
        words, capture_output=True, text=True, env={**os.environ, "OMP_NUM_THREADS": "1"}
    )
    assert made.returncode == 0, made.stdout + made.stderr
    found = re.findall(r"^(\d+) (mutants|kept files|damaged arrays), 0 faults$", made.stdout, re.M)
    return {what: int(n) for n, what in found}, made.stdout


def test_new_mutants(run):
    counts, said = run
    assert counts["mutants"] == MUTANTS
    assert said.splitlines()[-1] == f"{MUTANTS} mutants, 0 faults"


def test_every_finding_stays_mended(run):
    """Most of them by Python and by a command, where the originals can be made."""
    assert run[0]["kept files"] >= len(list((HERE / "corpus").glob("*@*@*"))) > 10


def test_arrays_of_a_checkpoint_are_checked(run):
    assert run[0]["damaged arrays"] > 40


@pytest.mark.slow
def test_every_array_of_a_checkpoint_is_checked():
    words = [sys.executable, str(HERE / "fuzz.py"), "--damage", "--only", "checkpoints"]
    made = subprocess.run(words, capture_output=True, text=True)
    assert made.returncode == 0, made.stdout + made.stderr
    assert int(made.stdout.splitlines()[-1].split()[0]) > 150


def test_mutants_are_the_same_again_and_differ():
    content = b"ply\nformat ascii 1.0\nelement vertex 3\n"
    first = [mutate(Random(str(i)), content, [content]) for i in range(50)]
    assert first == [mutate(Random(str(i)), content, [content]) for i in range(50)]
    assert len({*first} - {content}) > 40
