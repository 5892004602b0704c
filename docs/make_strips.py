"""The shipped scenes as strips of pictures, small, in docs/images/simulation: names, or all."""

import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from make_gallery import pack
from PIL import Image

TARGET = Path(__file__).resolve().parent / "images/simulation"
# How many seconds are shown, frames a second, and which frames.
MOMENTS = {
    "dam-break": (2.0, 20, (0, 5, 10, 17, 24, 36)),
    "droplet": (0.02, 400, (0, 1, 2, 3, 5, 8)),
    "poiseuille": (2.0, 10, (1, 2, 4, 6, 10, 20)),
    "beam": (0.5, 40, (0, 2, 4, 6, 10, 20)),
    "cut-block": (0.6, 20, (0, 6, 8, 9, 10, 11)),
    "brain-surgery": (4.0, 5, (0, 6, 9, 12, 16, 20)),
}


def strip(name: str) -> None:
    """Six pictures in two rows."""
    seconds, fps, frames = MOMENTS[name]
    with tempfile.TemporaryDirectory() as folder:
        words = ["simulate", name, "-o", folder, "--no-frames", "--images", folder]
        words += ["--seconds", str(seconds), "--fps", str(fps), "--size", "320x240"]
        subprocess.run([sys.executable, "-m", "globule", *words], check=True)
        shown = [np.asarray(Image.open(f"{folder}/{k:05d}.png")) for k in frames]
        whole = Path(folder) / "strip.png"
        rows = [np.hstack(shown[:3]), np.hstack(shown[3:])]
        Image.fromarray(np.vstack(rows)).save(whole)
        TARGET.mkdir(parents=True, exist_ok=True)
        pack(whole, TARGET / f"{name}.png", 150_000)


if __name__ == "__main__":
    for name in sys.argv[1:] or MOMENTS:
        strip(name)
