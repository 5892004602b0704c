"""The tests' own options: --expected-skips, and --matrix for slow tests."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import globule as gb
import pytest

SMALL = """
import pytest

def test_skipped():
    pytest.skip("no moon tonight")

def test_it_passes():
    pass

@pytest.mark.slow
def test_slow():
    raise AssertionError("it ran")
"""


def run(folder: Path, *options: str) -> tuple[int, str]:
    """Status and output of pytest on the small file, with our conftest.py."""
    (folder / "test_small.py").write_text(SMALL)
    paths = [Path(__file__).parent, Path(gb.__file__).parents[1]]
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-p", "conftest", "test_small.py", *options],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(map(str, paths))},
        capture_output=True,
        text=True,
        timeout=100,
    )
    return done.returncode, done.stdout + done.stderr


@pytest.mark.parametrize(
    ("lines", "status"),
    [("# moon\n\nno moon\n", 0), ("# no moon\nno sun\n", 1), ("", 1)],
    ids=["expected", "another", "empty"],
)
def test_a_skip_must_be_expected(tmp_path, lines, status):
    (tmp_path / "expected.txt").write_text(lines)
    found, shown = run(tmp_path, "--expected-skips", "expected.txt")
    assert found == status, shown
    unexpected = "unexpected skip: test_small.py::test_skipped: Skipped: no moon tonight"
    assert (unexpected in shown) == bool(status)


def test_slow_tests_run_with_the_matrix_only(tmp_path):
    found, shown = run(tmp_path)
    assert found == 0, shown
    assert "1 passed, 1 skipped, 1 deselected" in shown
    found, shown = run(tmp_path, "--matrix")
    assert found == 1
    assert "it ran" in shown
