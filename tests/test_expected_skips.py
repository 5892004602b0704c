"""The tests' own options: --expected-skips, --matrix for slow tests, and files that take long."""

import os
import subprocess
import sys
from pathlib import Path

import globule as gb
import pytest
from conftest import LONG_FILES, lines_of, too_long
from waiting import PATIENCE

SMALL = """
import pytest

def test_skipped():
    pytest.skip("no moon tonight")

def test_it_passes():
    pass

@pytest.mark.slow
def test_slow():
    pass
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
        timeout=PATIENCE,
    )
    return done.returncode, done.stdout + done.stderr


@pytest.mark.slow
def test_skips_that_are_expected_or_not_and_slow_tests(tmp_path):
    (tmp_path / "expected.txt").write_text("# moon\n\nno moon\n")
    found, shown = run(tmp_path, "--expected-skips", "expected.txt", "--matrix")
    assert found == 0, shown
    assert "2 passed, 1 skipped" in shown
    (tmp_path / "expected.txt").write_text("# no moon\nno sun\n")
    found, shown = run(tmp_path, "--expected-skips", "expected.txt")
    assert found == 1, shown
    assert "unexpected skip: test_small.py::test_skipped: Skipped: no moon tonight" in shown
    assert "1 passed, 1 skipped, 1 deselected" in shown
    _, shown = run(tmp_path, "test_small.py::test_slow")
    assert "2 passed, 1 skipped" in shown


def test_files_that_take_long_are_listed():
    found = [(30.0, "tests/test_a.py"), (25.0, "tests/test_b.py"), (19.0, "tests/test_c.py")]
    (said,) = too_long(found, ["test_a.py  solves large systems"])
    assert "tests/test_b.py: 25 CPU s, expected at most 20" in said
    for line in lines_of(LONG_FILES):
        file, _, reason = line.partition(" ")
        assert LONG_FILES.with_name(file).is_file()
        assert reason.strip()
