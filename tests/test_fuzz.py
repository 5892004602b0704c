"""The fuzzer of `make fuzz`, a few mutants, and all that it ever found."""

import os
import re
import subprocess
import sys
from pathlib import Path
from random import Random

import pytest
from fuzz_mutations import mutate

HERE = Path(__file__).parent
MUTANTS = 20


def fuzz(*words: str) -> str:
    """What the fuzzer prints."""
    made = subprocess.run(
        [sys.executable, str(HERE / "fuzz.py"), *words],
        capture_output=True, text=True, env={**os.environ, "OMP_NUM_THREADS": "1"},
    )  # fmt: skip
    assert made.returncode == 0, made.stdout + made.stderr
    return made.stdout


@pytest.mark.slow
def test_new_mutants_and_all_findings(tmp_path):
    """Most findings by Python and by a command, where the originals can be made."""
    said = fuzz(
        "-n", str(MUTANTS), "--seed", "7", "--together",
        "--open", str(HERE / "corpus"), "--keep", str(tmp_path / "found"),
    )  # fmt: skip
    found = re.findall(r"^(\d+) (mutants|kept files), 0 faults$", said, re.M)
    counts = {what: int(n) for n, what in found}
    assert counts["mutants"] == MUTANTS
    assert counts["kept files"] >= len(list((HERE / "corpus").glob("*@*@*"))) > 10
    assert said.splitlines()[-1] == f"{MUTANTS} mutants, 0 faults"


@pytest.mark.slow
def test_every_array_of_a_checkpoint_is_checked():
    said = fuzz("--damage", "--only", "checkpoints")
    assert int(said.splitlines()[-1].split()[0]) > 150


def test_mutants_are_the_same_again_and_differ():
    content = b"ply\nformat ascii 1.0\nelement vertex 3\n"
    first = [mutate(Random(str(i)), content, [content]) for i in range(50)]
    assert first == [mutate(Random(str(i)), content, [content]) for i in range(50)]
    assert len({*first} - {content}) > 40
