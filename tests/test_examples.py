"""Every example runs, in an empty folder, in reasonable time, and writes what it says."""

import ast
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from waiting import PATIENCE

FOLDER = Path(__file__).resolve().parents[1] / "examples"
EXAMPLES = sorted(FOLDER.glob("[0-9][0-9]_*.py"))
QUICK = ("01", "05")  # the others run with --matrix


def test_they_are_numbered():
    assert [int(path.name[:2]) for path in EXAMPLES] == list(range(1, len(EXAMPLES) + 1))


@pytest.mark.parametrize(
    "path",
    [pytest.param(p, marks=() if p.name[:2] in QUICK else pytest.mark.slow) for p in EXAMPLES],
    ids=lambda path: path.stem,
)
def test_example(path, tmp_path):
    text = path.read_text(encoding="utf-8")
    words = ast.get_docstring(ast.parse(text))
    assert words
    assert text.count("\n") <= 60
    done = subprocess.run([sys.executable, str(path)], cwd=tmp_path, capture_output=True, text=True, timeout=PATIENCE)
    assert done.returncode == 0, done.stderr
    said = [line for line in done.stderr.splitlines() if "Warp CUDA warning" not in line]
    assert said == []  # Warp says that it finds no driver
    if done.stdout.startswith("skipped: "):
        pytest.skip(done.stdout.strip())
    assert done.stdout.strip()
    prose = "\n".join(line for line in words.splitlines() if not line.startswith("    "))
    for name in re.findall(r"\w+\.(?:png|mp4)", prose):
        if not (name.endswith(".mp4") and "no movie" in done.stdout):
            assert (tmp_path / name).stat().st_size > 1000
    for name in tmp_path.glob("*.png"):
        assert np.asarray(Image.open(name)).std() > 5, name
