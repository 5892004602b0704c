"""The documentation's site, which opens from disk: `python docs/site FOLDER`."""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import pages
from sphinx.cmd.build import main

HERE = Path(__file__).parent


def build(folder: Path) -> int:
    """Write the site; a warning is an error. Returns the exit status."""
    with tempfile.TemporaryDirectory() as made:
        pages.write(Path(made))
        doctrees = str(Path(made) / ".doctrees")
        options = ["-q", "-W", "--keep-going", "-E", "-c", str(HERE), "-d", doctrees]
        return main([*options, made, str(folder)])


if __name__ == "__main__":
    sys.exit(build(Path(sys.argv[1])))
