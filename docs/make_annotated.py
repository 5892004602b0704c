"""The images of the how-to pages about annotations, in docs/images/how-to."""

import subprocess
import sys
import tempfile
from pathlib import Path

import globule as gb
from globule._demo.data import dam_break
from make_gallery import pack

TARGET = Path(__file__).resolve().parent / "images/how-to"
IMAGES = {
    "annotated": "--size 800x600 --samples 4 --color-by y --legend-at outside "
    "--legend-title height --legend-unit m --box --axes --scale-bar --unit m --title Dam_break "
    "--time 0.4",
    "views": "--size 800x620 --samples 4 --views front,top,side,iso --axes --scale-bar --unit m",
}

if __name__ == "__main__":
    positions, color, spacing = dam_break()
    with tempfile.TemporaryDirectory() as folder:
        gb.write(f"{folder}/splash.vtk", gb.Particles(positions, color=color, support=2 * spacing))
        for name, words in IMAGES.items():
            command = [sys.executable, "-m", "globule", "render", "splash.vtk", "-o", "a.png"]
            flags = [word.replace("_", " ") for word in words.split()]
            subprocess.run([*command, *flags], cwd=folder, check=True)
            pack(Path(folder) / "a.png", TARGET / f"{name}.png", 150_000)
