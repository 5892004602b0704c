"""The package says that it is typed, and its stub of the compiled core is the core's."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import globule as gb
import pytest

PACKAGE = Path(gb.__file__).parent


def declarations(text: str) -> str:
    """What a stub declares, whatever its layout."""
    return re.sub(r"""#.*|[\s(),'"]|\.\.\.""", "", text)


def test_marker():
    assert (PACKAGE / "py.typed").is_file()


def test_stub_of_the_core(tmp_path):
    pytest.importorskip("nanobind")
    made = tmp_path / "_core.pyi"
    words = ["nanobind.stubgen", "-q", "-m", "globule._core", "--exclude-values", "-o", made]
    subprocess.run([sys.executable, "-m", *words], check=True)
    assert declarations(made.read_text()) == declarations((PACKAGE / "_core.pyi").read_text())
