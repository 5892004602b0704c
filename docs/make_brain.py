"""The brain of the gallery, opened and cut in two, 1920×1080, in docs/images/gallery/*.jpg.

python docs/make_brain.py [CHECKPOINT]    # without one, simulates 1.8 s at 2 mm
"""

import io
import sys
from dataclasses import replace
from pathlib import Path

import globule as gb
import numpy as np
from PIL import Image

FOLDER = Path(__file__).resolve().parent / "images/gallery"
LARGEST = 300_000  # bytes
SIZE = (1920, 1080)
UP = (0, 0, 1)
VIEWS = {
    "wound": (gb.Camera((-0.115, 0.075, 0.155), (-0.036, -0.005, 0.055), UP, 18), ()),
    "gray-and-white": (
        gb.Camera((-0.09, 0.36, 0.17), (-0.006, 0.0, 0.005), UP, 20),
        (gb.ClipPlane((0, 1, 0), 0.008),),
    ),
}


def lamp(scene: gb.Scene) -> gb.RenderSettings:
    """The preset of tissue, whose light is warm, under white light: the particles have colors."""
    settings = gb.load_preset("tissue", scene, UP)
    lights = (gb.Headlight(0.28), gb.DirectionalLight((0.6, 0.2, 1.0), 0.62, 8.0))
    return replace(settings, lights=lights, ambient=0.30)


def save(frame: gb.Frame, path: Path) -> None:
    """As JPEG, as good as the size allows."""
    picture = Image.fromarray(np.asarray(frame.image))
    for quality in range(92, 40, -4):
        written = io.BytesIO()
        picture.save(written, "JPEG", quality=quality, optimize=True)
        if len(written.getvalue()) < LARGEST:
            break
    path.write_bytes(written.getvalue())


def main() -> None:
    if sys.argv[1:]:
        sim = gb.Simulation.load(sys.argv[1])
    else:
        sim = gb.Simulation("brain-surgery", spacing=0.002)
        sim.run_to(1.8)
    for name, (camera, clips) in VIEWS.items():
        save(gb.render(sim, camera, SIZE, lamp(sim.scene), clips), FOLDER / f"{name}.jpg")


if __name__ == "__main__":
    main()
